// Polygons: their triangles cover them once, and face where they face.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;

namespace {

using Outline = std::vector<std::pair<double, double>>;

/// The area, counter-clockwise positive [shoelace formula].
double area(const Outline& outline) {
    double twice = 0;
    for (std::size_t i = 0; i < outline.size(); ++i) {
        const auto [x, y] = outline[i];
        const auto [u, v] = outline[(i + 1) % outline.size()];
        twice += x * v - u * y;
    }
    return 0.5 * twice;
}

/// Checks count, area and direction of the triangles, in several planes, both ways round
/// and from several first corners.
void checkCovered(const Outline& outline) {
    const test::TempFolder folder;
    const glm::dvec3 x(1, 0, 0), y(0, 1, 0), z(0, 0, 1), tilted(0.6, 0, 0.8);
    const double expected = std::abs(area(outline));
    for (const auto& [across, up] :
         {std::pair(x, y), {y, x}, {y, z}, {z, x}, {tilted, y}}) {
        for (const std::size_t first : {std::size_t(0), outline.size() / 2}) {
            std::string text, face = "f";
            for (std::size_t i = 0; i < outline.size(); ++i) {
                const glm::dvec3 p = outline[i].first * across + outline[i].second * up;
                text += "v " + std::to_string(p.x) + " " + std::to_string(p.y) + " " +
                        std::to_string(p.z) + "\n";
                face += " " + std::to_string((i + first) % outline.size() + 1);
            }
            const auto seen = test::seeFile(folder.write("a.obj", text + face + "\n"));
            INFO(seen.error());
            REQUIRE(seen.status);
            CHECK(seen.triangles() == outline.size() - 2);
            // Overlaps or gaps would make the sum of areas too large or too small.
            CHECK(seen.area() == Approx(expected).epsilon(1e-5));
            const glm::dvec3 facing = glm::cross(across, up) * area(outline);
            const test::SeenMesh& m = seen.meshes[0];
            for (std::size_t i = 0; i < m.indices.size(); i += 3) {
                const glm::dvec3 a = m.world[m.indices[i]];
                CHECK(glm::dot(glm::cross(m.world[m.indices[i + 1]] - a,
                                          m.world[m.indices[i + 2]] - a),
                               facing) >= -1e-6);
            }
        }
    }
}

}  // namespace

TEST_CASE("convex polygons keep area and direction", "[scene][exact]") {
    checkCovered({{0, 0}, {4, 0}, {4, 3}, {0, 3}});
    Outline circle;
    for (int i = 0; i < 50; ++i)
        circle.push_back({std::cos(i * 0.12566370614), std::sin(i * 0.12566370614)});
    checkCovered(circle);
}

TEST_CASE("concave polygons keep area and direction", "[scene][exact]") {
    checkCovered({{0, 0}, {4, 0}, {1, 1}, {0, 4}});          // dart
    checkCovered({{4, 0}, {1, 1}, {0, 4}, {0, 0}});          // from another corner
    checkCovered({{0, 0}, {4, 0}, {4, 4}, {2, 1}, {0, 4}});  // notch
    Outline comb = {{0, 0}, {79, 0}};
    for (int tooth = 39; tooth >= 0; --tooth) {
        if (tooth < 39) comb.push_back({2 * tooth + 1, 1});
        comb.push_back({2 * tooth + 1, 6});
        comb.push_back({2 * tooth, 6});
        if (tooth > 0) comb.push_back({2 * tooth, 1});
    }
    REQUIRE(area(comb) == 79 + 200);
    checkCovered(comb);
    Outline spiral;
    for (int i = 0; i <= 60; ++i)
        spiral.push_back(
            {(2 + i * 0.1) * std::cos(i * 0.3), (2 + i * 0.1) * std::sin(i * 0.3)});
    for (int i = 60; i >= 0; --i)
        spiral.push_back(
            {(1.2 + i * 0.1) * std::cos(i * 0.3), (1.2 + i * 0.1) * std::sin(i * 0.3)});
    checkCovered(spiral);
}

TEST_CASE("star-shaped polygons of random radii keep area and direction",
          "[scene][exact]") {
    std::mt19937 random(7);
    for (const int corners : {5, 9, 30, 101}) {
        Outline star;
        for (int i = 0; i < corners; ++i) {
            const double turn = 2 * 3.14159265358979 * i / corners;
            const double r = 1.0 + double(random() % 1000) / 100.0;
            star.push_back({r * std::cos(turn), r * std::sin(turn)});
        }
        checkCovered(star);
    }
}

TEST_CASE("a polygon that a bridge joins to its hole keeps the hole", "[scene][exact]") {
    const Outline ring = {{0, 0}, {6, 0}, {6, 6}, {0, 6}, {0, 0},
                          {2, 2}, {2, 4}, {4, 4}, {4, 2}, {2, 2}};
    REQUIRE(area(ring) == 32);
    checkCovered(ring);
}

TEST_CASE("corners in a straight line and doubled corners keep the area",
          "[scene][exact]") {
    checkCovered({{0, 0}, {1, 0}, {2, 0}, {3, 0}, {3, 1}, {3, 2}, {0, 2}, {0, 1}});
    checkCovered({{0, 0}, {2, 0}, {2, 0}, {2, 2}, {2, 2}, {0, 2}});
}

TEST_CASE("polygons that are none still give their triangles", "[scene][bad-input]") {
    const test::TempFolder folder;
    for (const std::string bad :
         {"v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n",             // bow tie
          "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\nv 4 0 0\nf 1 2 3 4 5\n",  // a line
          "v 0 0 0\nf 1 1 1 1\n",                                        // a point
          "v nan 0 0\nv 1 0 0\nv 1 1 inf\nv 0 1 0\nv 0 0 1\nf 1 2 3 4 5\n",
          "v 0 0 0\nv 3e38 0 0\nv 3e38 3e38 0\nv -3e38 3e38 0\nf 1 2 3 4\n"}) {
        const auto seen = test::seeFile(folder.write("a.obj", bad));
        INFO(bad << seen.error());
        REQUIRE(seen.status);
        const std::size_t corners = std::size_t(
            std::count(bad.begin() + std::ptrdiff_t(bad.rfind('f')), bad.end(), ' '));
        CHECK(seen.triangles() == corners - 2);
    }
}

TEST_CASE("a made-up polygon of many corners does not take for ever",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    std::mt19937 random(3);
    std::string text, face = "f";
    for (int i = 0; i < 2000; ++i) {
        text += "v " + std::to_string(random() % 1000) + " " +
                std::to_string(random() % 1000) + " 0\n";
        face += " " + std::to_string(i + 1);
    }
    const auto seen = test::seeFile(folder.write("a.obj", text + face + "\n"));
    REQUIRE(seen.status);
    CHECK(seen.triangles() == 1998);
}
