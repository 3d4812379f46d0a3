// PLY files: every encoding, strips, and what must not pass.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cstdint>
#include <string>

#include "scene_fixture.h"

using namespace mtsm;
using test::bytesOf;
using test::contains;
using test::seeFile;

namespace {

std::string header(const std::string& format, int vertices, int faces) {
    return "ply\nformat " + format + " 1.0\ncomment made by hand\nelement vertex " +
           std::to_string(vertices) +
           "\nproperty float x\nproperty float y\nproperty float z\n"
           "property uchar red\nelement face " +
           std::to_string(faces) +
           "\nproperty list uchar int vertex_indices\nend_header\n";
}

/// Two triangles that make a unit square in z = 2.
const std::string kAscii =
    header("ascii", 4, 2) +
    "0 0 2 255\n1 0 2 255\n1 1 2 255\n0 1 2 255\n3 0 1 2\n3 0 2 3\n";

template <typename T>
std::string swapped(T value, bool swap) {
    std::string bytes = bytesOf<T>({value});
    if (swap) std::reverse(bytes.begin(), bytes.end());
    return bytes;
}

std::string binarySquare(bool bigEndian) {
    std::string file =
        header(bigEndian ? "binary_big_endian" : "binary_little_endian", 4, 2);
    for (const auto& [x, y] : {std::pair(0.f, 0.f), {1.f, 0.f}, {1.f, 1.f}, {0.f, 1.f}}) {
        for (const float c : {x, y, 2.f})
            file += swapped(c, bigEndian);
        file += '\xff';
    }
    for (const auto& face : {std::array{0, 1, 2}, std::array{0, 2, 3}}) {
        file += '\3';
        for (const int i : face)
            file += swapped(std::int32_t(i), bigEndian);
    }
    return file;
}

}  // namespace

TEST_CASE("ASCII and both binary encodings of a PLY give the same mesh",
          "[scene][exact]") {
    const test::TempFolder folder;
    const auto ascii = seeFile(folder.write("a.ply", kAscii));
    REQUIRE(ascii.status);
    REQUIRE(ascii.meshes.size() == 1);
    CHECK(ascii.triangles() == 2);
    CHECK(ascii.area() == 1.0);
    CHECK(ascii.meshes[0].world[2] == glm::dvec3(1, 1, 2));
    CHECK(ascii.meshes[0].opacity == 1.0f);
    for (const bool big : {false, true}) {
        const auto binary = seeFile(folder.write("b.ply", binarySquare(big)));
        REQUIRE(binary.status);
        CHECK(binary.meshes == ascii.meshes);
    }
}

TEST_CASE("a PLY that is cut anywhere in its data is refused", "[scene][bad-input]") {
    const test::TempFolder folder;
    for (const std::string& whole : {kAscii, binarySquare(false)}) {
        const std::size_t data = whole.find("end_header\n") + 11;
        // The last number of the text may lose its newline and be none the worse.
        const std::size_t last = whole.size() - (whole == kAscii ? 2 : 1);
        for (std::size_t n = data; n <= last; n += 3) {
            INFO("first " << n << " of " << whole.size() << " bytes");
            const auto seen = seeFile(folder.write("cut.ply", whole.substr(0, n)));
            REQUIRE(!seen.status);
            CHECK(seen.status.error().code == ErrorCode::badFile);
            CHECK(seen.meshes.empty());
        }
    }
    const std::string oneFace = kAscii.substr(0, kAscii.size() - 8);
    CHECK(contains(seeFile(folder.write("cut.ply", oneFace)).error(),
                   "at face 1 of 2; the file is cut off or damaged"));
}

TEST_CASE("a PLY face that refers to a vertex that is not there is refused",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    for (const std::string bad : {"4", "-1", "2147483647"}) {
        std::string text = kAscii;
        text.replace(text.rfind("3\n"), 1, bad);
        const auto seen = seeFile(folder.write("bad.ply", text));
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), "bad.ply: face 1 refers to vertex " + bad));
    }
}

TEST_CASE("PLY triangle strips become triangles that all face one way",
          "[scene][exact]") {
    const test::TempFolder folder;
    // A strip of four triangles, a restart, and one of a single triangle.
    const auto seen = seeFile(folder.write(
        "strip.ply",
        "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 1\n"
        "property list int int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n1 2 0\n"
        "10 0 1 2 3 4 5 -1 0 1 3\n"));
    REQUIRE(seen.status);
    REQUIRE(seen.triangles() == 5);
    CHECK(seen.area() == 2.5);
    const test::SeenMesh& m = seen.meshes[0];
    for (std::size_t i = 0; i < m.indices.size(); i += 3) {
        const glm::dvec3 a = m.world[m.indices[i]];
        CHECK(
            glm::cross(m.world[m.indices[i + 1]] - a, m.world[m.indices[i + 2]] - a).z ==
            1.0);
    }
}

TEST_CASE("a point cloud is no mesh and says what it is", "[scene][bad-input]") {
    const test::TempFolder folder;
    const auto seen = seeFile(folder.write(
        "cloud.ply",
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n1 0 0\n"));
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::badFile);
    CHECK(contains(seen.error(),
                   "cloud.ply: no triangles: 2 points and 0 lines were ignored"));
}

TEST_CASE("a PLY header that promises too much does no harm", "[scene][bad-input]") {
    const test::TempFolder folder;
    for (const std::string element :
         {"element vertex 18446744073709551615", "element nothing 18446744073709551615",
          "element face 4294967295"}) {
        const auto seen = seeFile(folder.write(
            "huge.ply", "ply\nformat binary_little_endian 1.0\n" + element +
                            "\nproperty float x\nproperty float y\nproperty float z\n"
                            "end_header\n1234567890"));
        CHECK(!seen.status);
    }
    CHECK(!seeFile(folder.write("huge.ply",
                                "ply\nformat ascii 1.0\nelement nothing "
                                "18446744073709551615\nend_header\n"))
               .status);
}
