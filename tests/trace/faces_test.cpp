// Six faces: no ray and no point falls between them or counts twice.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "map_fixture.h"
#include "trace/traverse.h"

using namespace mtsm;
using namespace mtsm::trace;
using test::cubeProjections;
using test::mapOf;
using test::TestLayer;

namespace {

/// What is in a map: a shell around the eye, each pixel with the layers that it has at
/// the direction of its centre ray, which is given at depth 1.
ShadowMap shell(std::uint32_t width, Translucent rule,
                const std::vector<Projection>& views,
                const std::function<std::vector<TestLayer>(glm::dvec3)>& layers) {
    MapInfo info = test::plainInfo(width, width, 8);
    info.translucent = rule;
    return mapOf(info, views, [&](std::uint32_t f, std::uint32_t x, std::uint32_t y) {
        const Projection& p = views[f];
        return layers(p.worldFromLight(p.lightFromRaster({x + 0.5, y + 0.5}, 1.0)) -
                      p.eye);
    });
}

float visibleFrom(const ShadowMap& map, glm::dvec3 from, glm::dvec3 to,
                  const TraceOptions& options = {}) {
    Ray ray;
    ray.origin = from;
    ray.delta = to - from;
    return traceRay(map, ray, options)[0];
}

/// Directions to the 12 edges (middle and elsewhere) and 8 corners of a cube, exact.
std::vector<glm::dvec3> edgesAndCorners() {
    std::vector<glm::dvec3> all;
    for (int a = 0; a < 3; ++a) {
        for (const double x : {-1.0, 1.0}) {
            for (const double y : {-1.0, 1.0}) {
                for (const double z : {-1.0, -0.625, 0.0, 0.25, 1.0}) {
                    glm::dvec3 d;
                    d[a] = z;
                    d[(a + 1) % 3] = x;
                    d[(a + 2) % 3] = y;
                    all.push_back(d);
                }
            }
        }
    }
    return all;
}

/// v = exp(-s (z - 1)) from depth 1 to 5, sampled 512 times.
std::vector<TestLayer> fogOf(double s) {
    std::vector<TestLayer> fog = {{1.0f, 1.0f, 1}};
    for (int i = 1; i <= 32; ++i)
        fog.push_back({1.0f + float(i) / 8, float(std::exp(-s * i / 8)), 16});
    return fog;
}

double largest(glm::dvec3 p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

/// By subtraction, which counts samples: what each takes is the same at any slant.
float countedFrom(const ShadowMap& map, glm::dvec3 from, glm::dvec3 to) {
    TraceOptions options;
    options.attenuation = Attenuation::subtract;
    return visibleFrom(map, from, to, options);
}

const double kSteps[] = {0.0, 1e-300, 1e-17, 1e-16, 3e-16, 1e-15, 1e-12, 1e-8, 1e-4};

}  // namespace

TEST_CASE(
    "a translucent cube around the eye is paid for once by every ray that leaves it",
    "[trace][exact]") {
    // As media: no bias mends a gap, and what is counted twice shows. Each pixel has its
    // sample at depth 4, so the samples are the faces of the cube of half side 4.
    for (const std::uint32_t width : {16u, 13u, 1u}) {
        const auto views = cubeProjections(width);
        const ShadowMap map = shell(width, Translucent::media, views, [](glm::dvec3) {
            return std::vector<TestLayer>{{4.0f, 0.75f, 1}};
        });
        std::mt19937_64 random(5);
        const auto unit = [&] { return 2 * double(random() >> 11) * 0x1p-53 - 1; };
        for (const glm::dvec3 d : edgesAndCorners()) {
            for (const double step : kSteps) {
                const glm::dvec3 off = step * glm::dvec3(unit(), unit(), unit());
                INFO("width " << width << " towards " << d.x << " " << d.y << " " << d.z
                              << " step " << step);
                // Along the edge plane or the corner line from the eye, both ways.
                CHECK(countedFrom(map, 8.0 * d + off, 0.5 * d + off) == 0.75f);
                CHECK(countedFrom(map, 0.5 * d + off, 8.0 * d + off) == 0.75f);
                // Through the eye: out on both sides.
                CHECK(countedFrom(map, 8.0 * d + off, -8.0 * d + off) == 0.5f);
                // Across the edge at the cube itself, and short of it.
                const glm::dvec3 inside(unit(), unit(), unit());
                CHECK(countedFrom(map, 8.0 * d + off - inside, inside) == 0.75f);
                CHECK(countedFrom(map, 3.0 * d + off, inside) == 1.0f);
                CHECK(countedFrom(map, inside, 4.0 * d + off + 4.0 * d - inside) ==
                      0.75f);
            }
        }
        // Rays within the plane between two faces, from anywhere to anywhere in it.
        for (int i = 0; i < 3000; ++i) {
            const int a = i % 3, b = (i + 1) % 3, c = (i + 2) % 3;
            const double sign = i & 4 ? 1.0 : -1.0;
            glm::dvec3 from(0.0), to(0.0);
            from[a] = 6 * unit(), from[b] = sign * from[a], from[c] = 6 * unit();
            to[a] = 3.9 * unit(), to[b] = sign * to[a], to[c] = 3.9 * unit();
            const float expected = largest(from) > 4 ? 0.75f : 1.0f;
            CHECK(countedFrom(map, from, to) == expected);
            CHECK(countedFrom(map, to, from) == expected);
        }
    }
}

TEST_CASE("a cube that is turned and far from the origin has no seams either",
          "[trace][exact]") {
    // Nothing is exact here, and rays run within rounding of the planes between faces.
    const glm::dvec3 x = glm::normalize(glm::dvec3(1, 2, 3));
    const glm::dvec3 y = glm::normalize(glm::cross(x, glm::dvec3(1, 0, 0)));
    const glm::dmat3 turn(x, y, glm::cross(x, y));
    const glm::dvec3 eye(1e7, -3e6, 1e5);
    const ShadowMap map =
        shell(13, Translucent::media, cubeProjections(13, eye, turn), [](glm::dvec3) {
            return std::vector<TestLayer>{{4.0f, 0.75f, 1}};
        });
    std::mt19937_64 random(6);
    const auto unit = [&] { return 2 * double(random() >> 11) * 0x1p-53 - 1; };
    for (const glm::dvec3 d : edgesAndCorners()) {
        for (int i = 0; i < 60; ++i) {
            const glm::dvec3 off = kSteps[i % 9] * glm::dvec3(unit(), unit(), unit());
            const glm::dvec3 far = eye + turn * ((5.0 + unit()) * d + off);
            CHECK(countedFrom(map, far, eye + turn * (0.3 * unit() * d)) == 0.75f);
            CHECK(countedFrom(map, far, eye) == 0.75f);
            CHECK(countedFrom(map, eye + turn * (2.0 * d), far) == 0.75f);
        }
    }
}

TEST_CASE(
    "a half-transparent sphere around the eye is paid for once at edges and corners",
    "[trace][exact]") {
    // Sheets: its depth changes from pixel to pixel and turns at the edges; the bias of
    // 1.5 footprints is more than the step.
    const double R = 4.0;
    for (const float v : {0.5f, 0.0f}) {
        const ShadowMap map =
            shell(64, Translucent::sheets, cubeProjections(64), [&](glm::dvec3 d) {
                return std::vector<TestLayer>{{float(R / glm::length(d)), v, 1}};
            });
        TraceOptions options;
        options.bias.perDepth = 1.5 * map.projection(0).pixelFootprint(1.0);
        std::mt19937_64 random(7);
        const auto unit = [&] { return 2 * double(random() >> 11) * 0x1p-53 - 1; };
        for (const glm::dvec3 d : edgesAndCorners()) {
            for (int i = 0; i < 90; ++i) {
                const glm::dvec3 on =
                    R * glm::normalize(d + kSteps[i % 9] *
                                               glm::dvec3(unit(), unit(), unit()));
                // From outside to inside through that point of the sphere, at an angle of
                // up to 45 degrees to its normal.
                const glm::dvec3 n = on / R;
                const glm::dvec3 across =
                    glm::cross(n, glm::dvec3(unit(), unit(), unit()));
                const glm::dvec3 along = n + 0.9 * across / (1e-9 + glm::length(across));
                CHECK(visibleFrom(map, on + along, on - along, options) == v);
                CHECK(visibleFrom(map, on - along, on + along, options) == v);
            }
        }
        for (int i = 0; i < 3000; ++i) {
            const glm::dvec3 in = glm::dvec3(unit(), unit(), unit());
            const glm::dvec3 out =
                7.0 * glm::normalize(glm::dvec3(unit(), unit(), unit()));
            CHECK(visibleFrom(map, out, in, options) == v);
            CHECK(visibleFrom(map, 0.4 * out, in, options) == 1.0f);
        }
    }
}

TEST_CASE("light leaves a room of opaque walls through its holes only",
          "[trace][exact]") {
    // Walls of a cube of half side 4, with holes a quarter wide around every edge's
    // middle and every corner: there is one where each coordinate of the direction, over
    // the largest one, is near -1, 0 or 1.
    const std::uint32_t width = 32;
    const auto isHole = [](glm::dvec3 d) {
        d /= largest(d);
        bool edge = true;
        int extremes = 0;
        for (int i = 0; i < 3; ++i) {
            const double c = std::abs(d[i]);
            edge = edge && (c < 0.125 || c > 0.875);
            extremes += c > 0.875;
        }
        return edge && extremes >= 2;
    };
    const ShadowMap map =
        shell(width, Translucent::sheets, cubeProjections(width), [&](glm::dvec3 d) {
            return isHole(d) ? std::vector<TestLayer>{}
                             : std::vector<TestLayer>{{4.0f, 0.0f, 1}};
        });
    std::mt19937_64 random(8);
    const auto unit = [&] { return 2 * double(random() >> 11) * 0x1p-53 - 1; };
    int holes = 0;
    for (int i = 0; i < 20000; ++i) {
        const glm::dvec3 light = glm::dvec3(unit(), unit(), unit());
        glm::dvec3 through(unit(), unit(), unit());
        through *= 4.0 / largest(through);
        // Half of them at an edge.
        const std::size_t k = std::size_t(i % 3);
        if (i % 2)
            through[int(k)] = std::copysign(
                4.0 - (i % 5 ? 1e-12 : 0.4) * std::abs(unit()), through[int(k)]);
        through *= 4.0 / largest(through);
        const glm::dvec3 point = light + 1.5 * (through - light);
        const bool hole = isHole(through);
        holes += hole;
        INFO("ray " << i);
        CHECK(visibleFrom(map, point, light) == (hole ? 1.0f : 0.0f));
    }
    CHECK(holes > 1000);
}

TEST_CASE("visibility in a fog around the light is continuous over edges and corners",
          "[trace][exact]") {
    // Fog in cubes around the eye, from depth 1 to 5. Sheets: by depth. Media: by length,
    // as homogeneous fog is, and what a pixel holds is found along its centre ray.
    const double s = 0.5;
    for (const Translucent rule : {Translucent::media, Translucent::sheets}) {
        const bool media = rule == Translucent::media;
        const ShadowMap map = shell(16, rule, cubeProjections(16), [&](glm::dvec3 c) {
            return fogOf(media ? s * glm::length(c) : s);
        });
        for (const glm::dvec3 d : edgesAndCorners()) {
            for (int i = -20; i <= 20; ++i) {
                const glm::dvec3 p = 4.0 * d + 0.003 * i * glm::dvec3(1, -0.7, 0.4);
                const double way = media ? glm::length(p) / largest(p) : 1.0;
                INFO(d.x << " " << d.y << " " << d.z << " step " << i);
                CHECK(visibleFrom(map, p, {0, 0, 0}) ==
                      Approx(std::exp(-s * way * (largest(p) - 1)))
                          .epsilon(1.5 * s * way / 128));
            }
        }
    }
}

TEST_CASE("a ray across faces pays homogeneous fog by its length", "[trace][exact]") {
    const double s = 0.5;
    const ShadowMap map = shell(16, Translucent::media, cubeProjections(16),
                                [&](glm::dvec3 c) { return fogOf(s * glm::length(c)); });
    std::mt19937_64 random(10);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    for (int i = 0; i < 4000; ++i) {
        // From a point of one face to one of the next, over the edge between them.
        const int a = i % 3, b = (i + 1) % 3, c = (i + 2) % 3;
        glm::dvec3 from(0.0), to(0.0);
        from[a] = 3 + 1.9 * unit(), from[b] = 2 * unit() - 1;
        to[b] = 3 + 1.9 * unit(), to[a] = 2 * unit() - 1;
        from[c] = 2 * unit() - 1, to[c] = 2 * unit() - 1;
        if (i & 1) from[a] = -from[a], to[a] = -to[a];
        if (i & 2) from[b] = -from[b], to[b] = -to[b];
        // Chords that stay in the fog: the box of depth 1 is behind their edge's
        // diagonal.
        const double way = glm::length(to - from);
        INFO("ray " << i);
        // Two faces, in each a sample more or less.
        CHECK(visibleFrom(map, from, to) ==
              Approx(std::exp(-s * way)).epsilon(2.5 * s * 3 / 128));
    }
}

TEST_CASE("every point belongs to one face, in whose window it lies", "[trace][exact]") {
    const auto views = cubeProjections(16, {1, 2, 3});
    const ShadowMap map = shell(16, Translucent::media, views,
                                [](glm::dvec3) { return std::vector<TestLayer>{}; });
    std::mt19937_64 random(9);
    const auto unit = [&] { return 2 * double(random() >> 11) * 0x1p-53 - 1; };
    for (int i = 0; i < 3000; ++i) {
        const glm::dvec3 d(unit(), unit(), unit());
        const std::uint32_t face = faceOf(map, map.projection(0).eye + d);
        CHECK(views[face].lightFromWorldDirection(d).z == largest(d));
    }
    CHECK(faceOf(map, {2, 3, 4}) == 0);  // a corner: the first of three
    CHECK(faceOf(map, {1, 3, 4}) == 2);  // an edge
    CHECK(faceOf(map, {1, 2, 3}) == 0);  // the eye
    CHECK(faceOf(map, {NAN, 2, 3}) == 0);
}
