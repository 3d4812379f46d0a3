// Triangles: the fill rule hits each pixel centre once, depths agree with ray tracing.
#include "raster/triangle.h"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <glm/geometric.hpp>
#include <limits>

#include "bake/casters.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Random;

namespace {

/// Light space is raster space with y up: a corner at raster (x, y) is {x, height - y,
/// z}.
Projection flatProjection(std::uint32_t height) {
    Projection p;
    p.kind = ProjectionKind::orthographic;
    p.offset = {0.0, double(height)};
    return p;
}

/// 90 degrees across the width, looking along +z of light space.
Projection pinhole(std::uint32_t width, std::uint32_t height, double near) {
    Projection p;
    p.scale = {width / 2.0, width / -2.0};
    p.offset = {width / 2.0, height / 2.0};
    p.near = near;
    return p;
}

using Triangle = std::array<glm::dvec3, 3>;

struct Sample {
    std::int32_t x, y;
    float z;
};

struct Canvas {
    Projection projection;
    std::uint32_t width, height;
    TriangleCounts counts{};

    std::vector<Sample> samples(const Triangle& t, Facing keep = Facing::any,
                                bool mirrored = false) {
        const TriangleSetup setup(projection, width, height, keep);
        std::vector<PreparedTriangle> prepared;
        setup.triangle(setup.vertex(t[0]), setup.vertex(t[1]), setup.vertex(t[2]),
                       mirrored, 0.0, 0, counts, prepared);
        std::vector<Sample> found;
        const PixelRect all{0, 0, std::int32_t(width) - 1, std::int32_t(height) - 1};
        const auto sink = [&](std::int32_t x, std::int32_t y, float z) {
            found.push_back({x, y, z});
        };
        for (const PreparedTriangle& p : prepared) {
            if (projection.kind == ProjectionKind::perspective)
                drawTriangle<ProjectionKind::perspective>(p, all, sink);
            else
                drawTriangle<ProjectionKind::orthographic>(p, all, sink);
        }
        return found;
    }

    /// How often each pixel is hit by all of them.
    std::vector<int> hits(const std::vector<Triangle>& triangles) {
        std::vector<int> hit(std::size_t(width) * height, 0);
        for (const Triangle& t : triangles) {
            for (const Sample& s : samples(t))
                ++hit[std::size_t(s.y) * width + std::size_t(s.x)];
        }
        return hit;
    }
};

/// Any of the six orders of a triangle's corners.
Triangle anyOrder(Triangle t, Random& random) {
    if (random.below(2)) std::swap(t[0], t[1]);
    std::rotate(t.begin(), t.begin() + std::ptrdiff_t(random.below(3)), t.end());
    return t;
}

double cross2(glm::dvec2 a, glm::dvec2 b) {
    return a.x * b.y - a.y * b.x;
}

/// A rectangle in random triangles: again and again a point splits the triangle that it
/// lies strictly inside of into three. `point` gives candidates.
template <typename Point>
std::vector<std::array<glm::dvec2, 3>> triangulate(glm::dvec2 low, glm::dvec2 high,
                                                   int points, Point&& point) {
    const glm::dvec2 b(high.x, low.y), d(low.x, high.y);
    std::vector<std::array<glm::dvec2, 3>> mesh{{low, b, high}, {low, high, d}};
    for (int i = 0; i < points; ++i) {
        const glm::dvec2 p = point();
        for (std::size_t t = 0; t < mesh.size(); ++t) {
            const auto [u, v, w] = mesh[t];
            if (cross2(v - u, p - u) > 0 && cross2(w - v, p - v) > 0 &&
                cross2(u - w, p - w) > 0) {
                mesh[t] = {u, v, p};
                mesh.push_back({v, w, p});
                mesh.push_back({w, u, p});
                break;
            }
        }
    }
    return mesh;
}

}  // namespace

TEST_CASE("every pixel centre of a randomly triangulated rectangle is hit exactly once",
          "[raster][exact]") {
    const std::uint32_t width = 70, height = 50;
    for (std::uint64_t seed = 0; seed < 12; ++seed) {
        Random random(seed);
        // On the raster's own grid nothing moves: coarse (pixel centres, edges and
        // corners are all hit) for even seeds, fine for odd ones.
        const double grid = seed % 2 ? kSubpixels : 2.0;
        const auto mesh = triangulate({0, 0}, {width, height}, 400, [&] {
            return glm::dvec2(std::floor(random.in(0, width) * grid) / grid,
                              std::floor(random.in(0, height) * grid) / grid);
        });
        REQUIRE(mesh.size() > 300);
        std::vector<Triangle> triangles;
        for (const auto& t : mesh) {
            Triangle corners;
            for (int i = 0; i < 3; ++i)
                corners[i] = {t[i].x, height - t[i].y, 1.0};
            triangles.push_back(anyOrder(corners, random));
        }
        Canvas canvas{flatProjection(height), width, height};
        const auto hits = canvas.hits(triangles);
        INFO("seed " << seed);
        CHECK(std::all_of(hits.begin(), hits.end(), [](int h) { return h == 1; }));
    }
}

TEST_CASE("a fan around a pixel centre hits that centre exactly once",
          "[raster][exact]") {
    const std::uint32_t side = 21;
    for (std::uint64_t seed = 0; seed < 50; ++seed) {
        Random random(seed);
        const std::size_t blades = 4 + random.below(12);
        std::vector<double> angles;
        for (std::size_t i = 0; i < blades; ++i)
            angles.push_back((double(i) + 0.8 * random.unit()) * 6.283185307179586 /
                             double(blades));
        const glm::dvec3 centre(10.5, side - 10.5, 1.0);
        std::vector<Triangle> triangles;
        for (std::size_t i = 0; i < blades; ++i) {
            const auto at = [&](std::size_t k) {
                const double a = angles[k % blades];
                return centre + glm::dvec3(8 * std::cos(a), 8 * std::sin(a), 0);
            };
            triangles.push_back(anyOrder({centre, at(i), at(i + 1)}, random));
        }
        Canvas canvas{flatProjection(side), side, side};
        const auto hits = canvas.hits(triangles);
        CHECK(hits[10 * side + 10] == 1);
        CHECK(*std::max_element(hits.begin(), hits.end()) == 1);
    }
}

TEST_CASE("a quad whose edges run through pixel centres owns its left and top ones",
          "[raster][exact]") {
    Canvas canvas{flatProjection(8), 8, 8};
    const glm::dvec3 a(1.5, 8 - 1.5, 1), b(5.5, 8 - 1.5, 1), c(5.5, 8 - 4.5, 1),
        d(1.5, 8 - 4.5, 1);
    const auto hits = canvas.hits({{a, b, c}, {a, c, d}});
    for (int y = 0; y < 8; ++y) {
        for (int x = 0; x < 8; ++x)
            CHECK(hits[y * 8 + x] == (x >= 1 && x < 5 && y >= 1 && y < 4));
    }
}

TEST_CASE(
    "a triangulated floor that passes the eye is hit once by every ray below the "
    "horizon",
    "[raster][exact]") {
    // Corners lie behind the eye, far off the window and near the horizon: all clips.
    const std::uint32_t width = 64, height = 48;
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
        Random random(seed);
        const double reach = seed % 2 ? 1e6 : 100.0;
        const auto mesh = triangulate({-reach, -reach}, {reach, reach}, 150, [&] {
            const double r = reach * std::pow(random.unit(), 4.0);
            const double a = random.in(0, 6.283185307179586);
            return glm::dvec2(r * std::cos(a), r * std::sin(a));
        });
        std::vector<Triangle> triangles;
        for (const auto& t : mesh) {
            Triangle corners;
            for (int i = 0; i < 3; ++i)
                corners[i] = {t[i].x, -1.0, t[i].y};
            triangles.push_back(anyOrder(corners, random));
        }
        Canvas canvas{pinhole(width, height, 0.01), width, height};
        const auto hits = canvas.hits(triangles);
        INFO("seed " << seed);
        for (std::uint32_t y = 0; y < height; ++y) {
            // The floor at the centre of row y is at z = 1 / slope.
            const double slope = (y + 0.5 - height / 2.0) / (width / 2.0);
            const double z = slope > 0 ? 1.0 / slope : 1e30;
            if (slope > 0 && z > 0.9 * reach) continue;
            for (std::uint32_t x = 0; x < width; ++x) {
                if (hits[y * width + x] != (slope > 0 ? 1 : 0))
                    FAIL("pixel " << x << ", " << y << ": " << hits[y * width + x]);
            }
        }
        CHECK(canvas.counts.clipped > 0);
    }
}

namespace {

/// The ray through raster position r against a triangle, in long double: the depth, or
/// NaN.
long double rayDepth(const Projection& p, const Triangle& t, long double rx,
                     long double ry) {
    using V = std::array<long double, 3>;
    const auto sub = [](const glm::dvec3& a, const glm::dvec3& b) {
        return V{(long double)a.x - b.x, (long double)a.y - b.y, (long double)a.z - b.z};
    };
    const auto cross = [](const V& a, const V& b) {
        return V{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                 a[0] * b[1] - a[1] * b[0]};
    };
    const auto dot = [](const V& a, const V& b) {
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    };
    // Moeller and Trumbore's terms, with direction (.., .., 1), so that t is the depth.
    const V dir{(rx - p.offset.x) / p.scale.x, (ry - p.offset.y) / p.scale.y, 1.0L};
    const V e1 = sub(t[1], t[0]), e2 = sub(t[2], t[0]), s = sub({0, 0, 0}, t[0]);
    const V h = cross(dir, e2), q = cross(s, e1);
    const long double det = dot(e1, h);
    const long double u = dot(s, h) / det, v = dot(dir, q) / det, z = dot(e2, q) / det;
    const bool hit = u >= 0 && v >= 0 && u + v <= 1 && z >= p.near && z <= p.far;
    return hit ? z : std::numeric_limits<long double>::quiet_NaN();
}

}  // namespace

TEST_CASE("coverage and depth of random triangles agree with ray tracing",
          "[raster][exact]") {
    const std::uint32_t width = 40, height = 30;
    Canvas canvas{pinhole(width, height, 0.25), width, height};
    canvas.projection.far = 40.0;
    // A ray this many pixels from an edge is decided alike before and after snapping.
    const long double close = 1.0L / 4096;
    Random random(7);
    int compared = 0, cut = 0;
    for (int n = 0; n < 1500; ++n) {
        // Sizes from a pixel to far more than the window, behind the eye included; every
        // fourth is so steep that rays see it almost edge-on.
        const double size = std::pow(10.0, random.in(-1.0, 2.0));
        const double z = random.in(0.3, 20.0);
        const glm::dvec3 at(random.in(-1, 1) * z, random.in(-1, 1) * z, z);
        Triangle t;
        for (glm::dvec3& corner : t)
            corner = at + size * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                            random.in(-1, 1));
        if (n % 4 == 0)
            t[2] = t[0] + random.in(0.2, 3) * t[0] + 1e-3 * size * (t[1] - t[0]);
        const TriangleCounts before = canvas.counts;
        std::vector<float> depth(width * height, 0.0f);
        for (const Sample& s : canvas.samples(t)) {
            if (depth[s.y * width + s.x] != 0.0f) FAIL("hit twice");
            depth[s.y * width + s.x] = s.z;
        }
        cut += canvas.counts.clipped > before.clipped;
        for (std::uint32_t y = 0; y < height; ++y) {
            for (std::uint32_t x = 0; x < width; ++x) {
                const long double rx = x + 0.5L, ry = y + 0.5L;
                const long double expected = rayDepth(canvas.projection, t, rx, ry);
                bool decided = true;
                for (const auto [dx, dy] : {std::array{1, 1}, {1, -1}, {-1, 1}, {-1, -1}})
                    decided = decided &&
                              std::isnan(expected) ==
                                  std::isnan(rayDepth(canvas.projection, t,
                                                      rx + close * dx, ry + close * dy));
                if (!decided) continue;
                // Half a step of a float, and what double loses on steep planes.
                const float found = depth[y * width + x];
                const bool agree = std::isnan(expected)
                                       ? found == 0.0f
                                       : std::abs(found - expected) <= 0.7e-7L * expected;
                if (!agree)
                    FAIL("triangle " << n << ", pixel " << x << ", " << y << ": " << found
                                     << ", not " << double(expected));
                if (found == 0.0f) continue;
                ++compared;
            }
        }
    }
    CHECK(compared > 10000);
    CHECK(cut > 100);
}

TEST_CASE("depths of a cut triangle never leave near and far", "[raster]") {
    Canvas canvas{pinhole(32, 32, 2.0), 32, 32};
    canvas.projection.far = 3.0;
    const auto samples = canvas.samples({{{-50, -20, -1}, {50, -20, -1}, {0, 30, 6}}});
    REQUIRE(!samples.empty());
    for (const Sample& s : samples) {
        CHECK(s.z >= 2.0f);
        CHECK(s.z <= 3.0f);
    }
    CHECK(canvas.counts.clipped == 1);
    CHECK(canvas.counts.outside == 0);
}

TEST_CASE("the front of a triangle is where its corners run counter-clockwise",
          "[raster]") {
    for (const bool perspective : {true, false}) {
        Projection p = pinhole(16, 16, 0.1);
        if (!perspective) p.kind = ProjectionKind::orthographic;
        // Light space has y up and x right, so this is counter-clockwise to the eye.
        const Triangle front{{{-0.4, -0.4, 1}, {0.4, -0.4, 1}, {0, 0.4, 1}}};
        const Triangle back{front[1], front[0], front[2]};
        Canvas canvas{p, 16, 16};
        CHECK(!canvas.samples(front, Facing::front).empty());
        CHECK(canvas.samples(front, Facing::back).empty());
        CHECK(!canvas.samples(back, Facing::back).empty());
        CHECK(canvas.samples(back, Facing::front).empty());
        CHECK(canvas.counts.culled == 2);
        CHECK(canvas.samples(front, Facing::front, true).empty());
        CHECK(!canvas.samples(front, Facing::back, true).empty());
    }
}

TEST_CASE("each triangle that gives nothing is counted for its reason", "[raster]") {
    Canvas canvas{pinhole(64, 64, 0.5), 64, 64};
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const double inf = std::numeric_limits<double>::infinity();
    const auto count = [&](Triangle t) {
        canvas.counts = {};
        CHECK(canvas.samples(t).empty());
        return canvas.counts;
    };
    const glm::dvec3 a(0, 0, 2), b(1, 0, 2), c(0, 1, 2);
    for (const double bad : {nan, inf, -inf, 1e31}) {
        CHECK(count({a, b, {0, bad, 2}}).nonFinite == 1);
        CHECK(count({glm::dvec3(bad, 0, 2), b, c}).nonFinite == 1);
    }
    CHECK(count({a, a, c}).degenerate == 1);
    CHECK(count({a, b, a + 0.3 * (b - a)}).degenerate == 1);
    CHECK(count({a, a, a}).degenerate == 1);
    CHECK(count({a, a + glm::dvec3(1e-200, 0, 0), a + glm::dvec3(0, 1e-200, 0)})
              .degenerate == 1);
    CHECK(count({a, b, {1.0 / 3, 1e-17, 2}}).degenerate == 1);
    const glm::dvec3 behind(0, 0, -3);
    const auto gone = count({a + behind, b + behind, c + behind});
    CHECK(gone.outside == 1);
    CHECK(gone.behind == 1);
    CHECK(gone.leavesWindow == 0);
    const glm::dvec3 left(-9, 0, 0);
    const auto off = count({a + left, b + left, c + left});
    CHECK(off.outside == 1);
    CHECK(off.behind == 0);
    CHECK(off.leavesWindow == 1);
    // Its bounding box overlaps the window's corner, it does not.
    CHECK(count({{{-4, 1.9, 2}, {-1.9, 4, 2}, {-4, 4, 2}}}).outside == 1);
}

TEST_CASE("a triangle that meets no pixel centre is no error", "[raster]") {
    Canvas canvas{pinhole(16, 16, 0.1), 16, 16};
    // Between centres; and edge-on, holding the eye.
    CHECK(canvas.samples({{{0, 0, 1}, {1e-3, 0, 1}, {0, 1e-3, 1}}}).empty());
    CHECK(canvas.samples({{{0, -0.5, 1}, {0, 0.5, 1}, {0, 0, 5}}}).empty());
    CHECK(canvas.samples({{{0.1, -0.5, 1}, {0.1, 0.5, 1}, {0.5, 0, 5}}}).empty());
    CHECK(canvas.counts.degenerate == 0);
    CHECK(canvas.counts.outside == 0);
}

TEST_CASE("a sliver of a billionth of its length still covers what lies on it",
          "[raster]") {
    // A row of pixel centres, at y = 8 + 1/2: the sliver's upper edge, drawn a hair
    // above.
    Canvas canvas{flatProjection(16), 16, 16};
    const double y = 16 - 8.5 + 1.0 / kSubpixels;
    const auto samples = canvas.samples({{{-1e3, y, 1}, {1e3, y, 1}, {0, y - 1e-4, 2}}});
    CHECK(samples.size() == 16);
    for (const Sample& s : samples)
        CHECK(s.y == 8);
    CHECK(canvas.counts.degenerate == 0);
}

TEST_CASE("the largest raster is covered to its last pixel by triangles of any size",
          "[raster]") {
    const std::uint32_t side = kMaxResolution;
    for (const double size : {1.01, 100.0, 1e9, 1e12}) {
        const Projection p = pinhole(side, side, 1e-6);
        const TriangleSetup setup(p, side, side, Facing::any);
        std::vector<PreparedTriangle> prepared;
        TriangleCounts counts;
        const glm::dvec3 a(-size, -size, 1), b(size, -size, 1), c(size, size, 1),
            d(-size, size, 1);
        for (const Triangle& t : {Triangle{a, b, c}, Triangle{a, c, d}})
            setup.triangle(setup.vertex(t[0]), setup.vertex(t[1]), setup.vertex(t[2]),
                           false, 0.0, 0, counts, prepared);
        const auto last = std::int32_t(side) - 1;
        for (const PixelRect corner :
             {PixelRect{0, 0, 63, 63}, PixelRect{last - 63, last - 63, last, last},
              PixelRect{0, last - 63, 63, last}, PixelRect{last - 63, 0, last, 63}}) {
            int hits = 0;
            float least = 2, most = 0;
            for (const PreparedTriangle& t : prepared)
                drawTriangle<ProjectionKind::perspective>(
                    t, corner, [&](std::int32_t, std::int32_t, float z) {
                        ++hits;
                        least = std::min(least, z);
                        most = std::max(most, z);
                    });
            INFO("size " << size);
            CHECK(hits == 64 * 64);
            CHECK(least == 1.0f);
            CHECK(most == 1.0f);
        }
    }
}

TEST_CASE("depths of 1e-6 and 1e9 live in one map", "[raster]") {
    Canvas canvas{pinhole(16, 16, 1e-7), 16, 16};
    for (const double z : {1e-6, 1e-3, 1.0, 1e6, 1e9}) {
        const auto samples = canvas.samples(
            {{{-2 * z, -2 * z, z}, {4 * z, -2 * z, z}, {-2 * z, 4 * z, z}}});
        CHECK(samples.size() == 16 * 16);
        for (const Sample& s : samples)
            REQUIRE(std::abs(s.z - z) <= 1e-7 * z);
    }
    // One floor from before the eye to 1e9: depth is 1 / slope all along.
    const auto floor = canvas.samples({{{-1e9, -1, -1}, {1e9, -1, -1}, {0, -1, 1e9}}});
    REQUIRE(floor.size() >= 8 * 16 - 2);
    for (const Sample& s : floor) {
        const double expected = 8.0 / (s.y + 0.5 - 8.0);
        CHECK(std::abs(s.z - expected) <= 1e-6 * expected);
    }
}
