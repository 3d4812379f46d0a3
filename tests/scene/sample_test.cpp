// The sample generators: what they write is what their help says.
#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;

namespace {

[[maybe_unused]] int run(const std::string& program, const std::string& arguments) {
    const std::string line = '"' + program + "\" " + arguments + " 2>/dev/null";
    return WEXITSTATUS(std::system(line.c_str()));
}

[[maybe_unused]] std::string bytesOfFile(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// Runs a generator twice and asks for the same bytes in `files`.
[[maybe_unused]] void checkSameTwice(const std::string& program,
                                     const std::string& arguments,
                                     const std::vector<std::string>& files) {
    const test::TempFolder folder;
    std::filesystem::create_directories(folder.path("a"));
    std::filesystem::create_directories(folder.path("b"));
    for (const std::string copy : {"a/", "b/"})
        REQUIRE(run(program, arguments + " -o " + folder.path(copy + files[0])) == 0);
    for (const std::string& file : files) {
        const std::string a = bytesOfFile(folder.path("a/" + file));
        CHECK(a.size() > 100);
        CHECK(a == bytesOfFile(folder.path("b/" + file)));
    }
}

/// Wrong arguments, a name that does not end as what is written does, a folder that is
/// not there, a full disk.
[[maybe_unused]] void checkFailsAsToolsDo(const std::string& program,
                                          const std::string& ending) {
    const test::TempFolder folder;
    CHECK(run(program, "-n none") == 2);
    CHECK(run(program, "--unknown") == 2);
    CHECK(run(program, "--help > /dev/null") == 0);
    CHECK(run(program, "-o " + folder.path("a.mtsm")) == 2);
    CHECK(run(program, "-o " + folder.path("no/such/folder" + ending)) == 3);
    if (std::filesystem::exists("/dev/full")) CHECK(run(program, "-o /dev/full") == 3);
}

}  // namespace

#ifdef MTSM_MAKE_PALM

TEST_CASE("the sample palm has the triangles asked for, finite and thin",
          "[scene][sample]") {
    const test::TempFolder folder;
    for (const std::string name : {"palm.ply", "palm.obj"}) {
        const std::string path = folder.path(name);
        REQUIRE(run(MTSM_MAKE_PALM, "-n 40000 -o " + path) == 0);
        const auto seen = test::seeFile(path);
        INFO(seen.error());
        REQUIRE(seen.status);
        CHECK(double(seen.triangles()) == Approx(40000.0).epsilon(0.02));
        double height = 0;
        for (const auto& mesh : seen.meshes)
            for (const glm::dvec3& p : mesh.world) {
                REQUIRE(glm::length(p) < 8.0);  // false for NaN
                height = std::max(height, p.y);
            }
        CHECK(height > 5.0);
    }
    MeshFileOptions blades;
    blades.include = {"blades"};
    const auto seen = test::seeFile(folder.path("palm.obj"), blades);
    REQUIRE(seen.status);
    // Strips of 11 triangles that are at most 16 mm wide and 0.8 m long.
    CHECK(seen.area() < double(seen.triangles()) / 11 * 0.016 * 0.8 * 1.2);
    CHECK(seen.area() > double(seen.triangles()) / 11 * 0.012 * 0.2 * 0.4);
}

TEST_CASE("the sample palm is the same each time and fails as tools do",
          "[scene][sample][bad-input]") {
    checkSameTwice(MTSM_MAKE_PALM, "-n 5000", {"palm.ply"});
    checkFailsAsToolsDo(MTSM_MAKE_PALM, ".obj");
}

#endif

#ifdef MTSM_MAKE_LEAF_TREE

TEST_CASE("the sample tree has leaf cards with holes where its texture has them",
          "[scene][sample][texture]") {
    const test::TempFolder folder;
    const std::string path = folder.path("tree.obj");
    REQUIRE(run(MTSM_MAKE_LEAF_TREE, "-n 300 -t 128 -o " + path) == 0);
    MeshFileOptions options;
    options.include = {"leaves"};
    std::vector<std::string> warnings;
    const auto seen = test::seeFile(path, warnings, options);
    INFO(seen.error());
    REQUIRE(seen.meshes.size() == 1);
    CHECK(warnings.empty());
    CHECK(seen.triangles() == 600);
    const test::SeenMesh& leaves = seen.meshes[0];
    REQUIRE(leaves.texture);
    CHECK(leaves.at({0.5, 0.1}).x == 1.0f);    // stem
    CHECK(leaves.at({0.5, 0.65}).x == 1.0f);   // leaf
    CHECK(leaves.at({0.5, 0.78}).x == 0.0f);   // a hole in it
    CHECK(leaves.at({0.03, 0.97}).x == 0.0f);  // beside it
    options.include = {"wood"};
    for (const auto& mesh : test::seeFile(path, options).meshes) {
        CHECK(!mesh.texture);
        CHECK(mesh.opacity == 1.0f);
    }
}

TEST_CASE("the sample tree is the same each time and fails as tools do",
          "[scene][sample][bad-input]") {
    checkSameTwice(MTSM_MAKE_LEAF_TREE, "-n 50 -t 32",
                   {"tree.obj", "tree.mtl", "tree.png"});
    const test::TempFolder folder;
    CHECK(run(MTSM_MAKE_LEAF_TREE, "-n none") == 2);
    CHECK(run(MTSM_MAKE_LEAF_TREE, "-t 1") == 2);
    CHECK(run(MTSM_MAKE_LEAF_TREE, "-t 16 -o " + folder.path("tree.ply")) == 2);
    CHECK(run(MTSM_MAKE_LEAF_TREE, "-t 16 -o " + folder.path("no/such/tree.obj")) == 3);
}

#endif

#ifdef MTSM_MAKE_GLASS

TEST_CASE("the sample pane is glass of the tint and opacity asked for",
          "[scene][sample]") {
    const test::TempFolder folder;
    const std::string path = folder.path("glass.gltf");
    REQUIRE(run(MTSM_MAKE_GLASS,
                "--size 2 1 --tint 1 0.5 0.25 --opacity 0.75 -n 3 -o " + path) == 0);
    MeshFileOptions options;
    options.color = true;
    options.include = {"pane"};
    auto seen = test::seeFile(path, options);
    INFO(seen.error());
    REQUIRE(seen.meshes.size() == 1);
    CHECK(seen.meshes[0].opacity == 0.75f);
    CHECK(seen.meshes[0].tint == glm::vec3(1, 0.5f, 0.25f));
    CHECK(seen.triangles() == 18);
    CHECK(seen.area() == Approx(2.0));
    options.include = {"frame"};
    seen = test::seeFile(path, options);
    REQUIRE(seen.meshes.size() == 1);
    CHECK(seen.meshes[0].opacity == 1.0f);
}

TEST_CASE("the sample pane is the same each time and fails as tools do",
          "[scene][sample][bad-input]") {
    checkSameTwice(MTSM_MAKE_GLASS, "-n 2", {"glass.gltf"});
    checkFailsAsToolsDo(MTSM_MAKE_GLASS, ".gltf");
}

#endif

#ifdef MTSM_MAKE_BUMPY

namespace {

int make(const std::string& arguments) {
    return std::system(("\"" MTSM_MAKE_BUMPY "\" " + arguments + " 2>/dev/null").c_str());
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
    CHECK(code(make("-o " + folder.path("body.obj"))) == 2);
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
