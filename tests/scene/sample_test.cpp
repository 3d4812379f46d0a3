// The sample generator: what it writes is what its help says.
#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <utility>

#include "scene_fixture.h"

using namespace mtsm;

#ifdef MTSM_MAKE_BUMPY

namespace {

int make(const std::string& arguments) {
    return std::system(("\"" MTSM_MAKE_BUMPY "\" " + arguments + " 2>/dev/null").c_str());
}

std::string bytesOfFile(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

TEST_CASE("the sample body is closed, finite and as large as asked", "[scene][sample]") {
    const test::TempFolder folder;
    const std::string path = folder.path("bumpy.glb");
    REQUIRE(make("-n 2000 -o " + path) == 0);
    MeshFileOptions options;
    options.exclude = {"floor"};
    const auto seen = test::seeFile(path, options);
    INFO(seen.error());
    REQUIRE(seen.meshes.size() == 1);
    const test::SeenMesh& body = seen.meshes[0];
    CHECK(double(seen.triangles()) == Approx(2000.0).epsilon(0.05));

    // Closed and turned one way: every edge is used once in each direction.
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
    for (std::size_t i = 0; i < body.indices.size(); i += 3)
        for (std::size_t k = 0; k < 3; ++k)
            ++edges[{body.indices[i + k], body.indices[i + (k + 1) % 3]}];
    for (const auto& [edge, uses] : edges) {
        REQUIRE(uses == 1);
        REQUIRE(edges.count({edge.second, edge.first}) == 1);
    }
    // Turned outside: by the divergence theorem its volume is positive.
    double volume = 0;
    for (std::size_t i = 0; i < body.indices.size(); i += 3)
        volume += glm::dot(body.world[body.indices[i]],
                           glm::cross(body.world[body.indices[i + 1]],
                                      body.world[body.indices[i + 2]])) /
                  6.0;
    CHECK(volume > 0.3);
    CHECK(volume < 4.0);
    double lowest = 1e9;
    for (const glm::dvec3& p : body.world) {
        REQUIRE(glm::length(p - glm::dvec3(0, 1, 0)) < 2.0);  // false for NaN
        lowest = std::min(lowest, p.y);
    }
    CHECK(lowest > 0.0);
    CHECK(lowest < 0.1);
}

TEST_CASE("the sample floor is 6 by 6 at height 0 and faces up", "[scene][sample]") {
    const test::TempFolder folder;
    const std::string path = folder.path("bumpy.glb");
    REQUIRE(make("-n 8 -o " + path) == 0);
    MeshFileOptions options;
    options.include = {"floor"};
    const auto seen = test::seeFile(path, options);
    REQUIRE(seen.meshes.size() == 1);
    CHECK(seen.area() == 36.0);
    const test::SeenMesh& floor = seen.meshes[0];
    for (const glm::dvec3& p : floor.world)
        CHECK(p.y == 0.0);
    const glm::dvec3 a = floor.world[floor.indices[0]];
    CHECK(glm::cross(floor.world[floor.indices[1]] - a, floor.world[floor.indices[2]] - a)
              .y > 0);
}

TEST_CASE("the same arguments make the same sample", "[scene][sample]") {
    const test::TempFolder folder;
    REQUIRE(make("-n 5000 -o " + folder.path("a.glb")) == 0);
    REQUIRE(make("-n 5000 -o " + folder.path("b.glb")) == 0);
    const std::string a = bytesOfFile(folder.path("a.glb"));
    CHECK(a.size() > 50000);
    CHECK(a == bytesOfFile(folder.path("b.glb")));
}

TEST_CASE("the sample generator fails as tools do and leaves no half file",
          "[scene][sample][bad-input]") {
    const test::TempFolder folder;
    const auto code = [](int status) { return WEXITSTATUS(status); };
    CHECK(code(make("-n none")) == 2);
    CHECK(code(make("-n 1")) == 2);
    CHECK(code(make("--unknown")) == 2);
    CHECK(code(make("-o " + folder.path("no/such/folder.glb"))) == 3);
    if (std::filesystem::exists("/dev/full")) {
        CHECK(code(make("-o /dev/full")) == 3);
        CHECK(std::filesystem::exists("/dev/full"));
    }
    CHECK(make("--help > /dev/null") == 0);
    // A file size limit of 8 blocks cuts the file off while it is written.
    const std::string limited = folder.path("limited.glb");
    const int status =
        std::system(("trap '' XFSZ; ulimit -f 8; \"" MTSM_MAKE_BUMPY "\" -n 5000 -o " +
                     limited + " 2>/dev/null")
                        .c_str());
    CHECK(code(status) == 3);
    CHECK(!std::filesystem::exists(limited));
}

#else

TEST_CASE("the sample generator is not built: nothing to test", "[scene][sample]") {
    WARN("mtsm-make-bumpy is not part of this build: skipped");
}

#endif
