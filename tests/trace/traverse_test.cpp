// The traversal against a brute-force walk over every pixel, and the cases with a known
// answer.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "map_fixture.h"
#include "trace/brute_force.h"
#include "trace/traverse.h"

using namespace mtsm;
using namespace mtsm::trace;
using test::mapOf;
using test::TestLayer;

namespace {

Projection orthographic(std::uint32_t width, std::uint32_t height) {
    Projection p = test::plainProjection(width, height);
    p.kind = ProjectionKind::orthographic;
    p.scale = {width / 20.0, height / -20.0};
    return p;
}

/// Without the planes of v and n, which say nothing of a map of opaque surfaces.
ShadowMap withoutImpliedPlanes(const ShadowMap& map) {
    std::vector<MapFace> faces(map.faceCount());
    for (std::uint32_t f = 0; f < faces.size(); ++f) {
        faces[f].projection = map.projection(f);
        for (std::uint32_t i = 0; i < map.tilesX() * map.tilesY(); ++i) {
            faces[f].tiles.push_back(map.tile(f, i % map.tilesX(), i / map.tilesX()));
            faces[f].tiles.back().v.clear();
            faces[f].tiles.back().n.clear();
        }
    }
    return *ShadowMap::create(map.info(), std::move(faces));
}

}  // namespace

TEST_CASE("a traced ray meets what a walk over all pixels meets", "[trace][exact]") {
    // With a bias only opaque layers, unless they are media: what a ray has paid for in
    // one pixel of a sheet it need not pay again in the next, which the walk knows
    // nothing of.
    enum class Kind { sheets, opaque, media };
    for (const Kind kind : {Kind::sheets, Kind::opaque, Kind::media}) {
        std::mt19937_64 random(11);
        const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
        const bool opaque = kind == Kind::opaque;
        const auto layers = [&](auto...) {
            std::vector<TestLayer> pixel;
            float z = float(2 + 6 * unit()), v = 1.0f;
            for (int i = int(unit() * (opaque ? 2 : 5)); i > 0; --i) {
                v *= float(0.5 + 0.5 * unit());
                if (opaque || unit() < 0.1) v = 0.0f;
                const std::uint32_t n =
                    i % 2 && (v > 0.0f || kind == Kind::media) && !opaque
                        ? 1 + std::uint32_t(unit() * 6)
                        : 1;
                pixel.push_back({z, v, n});
                z += float(unit());
                if (v == 0.0f) v = 1.0f;
            }
            return pixel;
        };
        for (int view = 0; view < 4; ++view) {
            MapInfo info = test::plainInfo(37, 23, 8);
            if (kind == Kind::media) info.translucent = Translucent::media;
            const std::uint32_t side = view == 2 ? 16 : 13;
            if (view >= 2) info.width = info.height = side;
            const std::vector<Projection> views =
                view == 0   ? std::vector{test::plainProjection(37, 23)}
                : view == 1 ? std::vector{orthographic(37, 23)}
                            : test::cubeProjections(side);
            ShadowMap map = mapOf(info, views, layers);
            if (opaque && view % 2) map = withoutImpliedPlanes(map);
            for (int i = 0; i < 800; ++i) {
                Ray ray;
                // World -z is light +z: depths 1..12 and a light near the eye. Six faces
                // are crossed every which way.
                ray.origin = {20 * unit() - 10, 20 * unit() - 10, -12 * unit()};
                ray.delta =
                    glm::dvec3(4 * unit() - 2, 4 * unit() - 2, -unit()) - ray.origin;
                if (views.size() == 6) {
                    if (i % 2) ray.origin.z = -ray.origin.z;
                    if (i % 4 > 1)
                        ray.delta = glm::dvec3(20 * unit(), 9, 20 * unit()) - ray.origin;
                }
                if (kind == Kind::media) ray.tSurfaces = unit() - 0.5;
                TraceOptions options;
                options.bias.base = kind == Kind::sheets ? 0.0 : 0.2 * unit();
                options.attenuation =
                    i % 2 ? Attenuation::multiply : Attenuation::subtract;
                const double expected = test::bruteForce(map, ray, options);
                INFO("kind " << int(kind) << " view " << view << " ray " << i);
                CHECK(traceRay(map, ray, options)[0] == Approx(expected).margin(1e-6));
            }
        }
    }
}

TEST_CASE(
    "rays along pixel edges, through corners and parallel to the image are met once",
    "[trace][exact]") {
    // Half-transparent everywhere at depth 4: any ray that crosses that depth loses half,
    // once.
    MapInfo info = test::plainInfo(16, 16, 8);
    const ShadowMap map = mapOf(info, test::plainProjection(16, 16), [](auto, auto) {
        return std::vector<TestLayer>{{4.0f, 0.5f, 1}};
    });
    const auto trace = [&](glm::dvec3 from, glm::dvec3 to, double bias = 0.0) {
        TraceOptions options;
        options.bias.base = bias;
        Ray ray;
        ray.origin = from;
        ray.delta = to - from;
        return traceRay(map, ray, options)[0];
    };
    CHECK(trace({0, 0, -8}, {0, 0, -1}) == 0.5f);  // through a corner, along the axis
    CHECK(trace({0.0, 1.0, -8}, {0.0, 0.125, -1}) ==
          0.5f);  // along an edge: x = 8 px throughout
    CHECK(trace({1, 1, -8}, {0.125, 0.125, -1}) == 0.5f);  // a centre ray through corners
    CHECK(trace({-3, -3, -8}, {0.5, 0.5, -1}) == 0.5f);    // diagonally across corners
    CHECK(trace({3, 0.2, -6}, {-0.5, 0.2, -1}) == 0.5f);
    // Along depth 4 itself it stays within one sheet all the way.
    CHECK(trace({-5, 0.3, -4}, {5, 0.3, -4}) == 0.5f);
    // Beside depth 4 it meets nothing, unless the bias reaches.
    CHECK(trace({-5, 0.3, -3.9}, {5, 0.3, -3.9}) == 1.0f);
    CHECK(trace({-1, 0.1, -3.9}, {-0.9, 0.1, -3.9}, 0.11) == 0.5f);
    CHECK(trace({-3, 2, -6}, {2.5, -0.2, -1}, 0.5) == 0.5f);
    // Ends short of the layer, starts beyond it, misses the window, has no length.
    CHECK(trace({0.1, 0.2, -8}, {0.1, 0.2, -4.01}) == 1.0f);
    CHECK(trace({0.1, 0.2, -3.99}, {0, 0, -1}) == 1.0f);
    CHECK(trace({20, 0, -8}, {9, 0, -3}) == 1.0f);
    CHECK(trace({0, 0, -4}, {0, 0, -4}) == 1.0f);
    // From behind the eye and from in front of it, endless rays.
    CHECK(trace({0.3, 0.1, 5}, {0.1, 0.2, -8}) == 0.5f);
    Ray endless;
    endless.origin = {0.1, 0.1, -8};
    endless.delta = {0, 0, 1};
    endless.tEnd = HUGE_VAL;
    CHECK(traceRay(map, endless, {})[0] == 0.5f);
    endless.delta = {0, 0, -1};
    CHECK(traceRay(map, endless, {})[0] == 1.0f);
    endless.delta = {1, 0, 0};
    CHECK(traceRay(map, endless, {})[0] == 1.0f);
}

TEST_CASE("parallel sheets of opacity a leave (1 - a)^N to straight and slanted rays",
          "[trace][exact]") {
    for (float a : {0.1f, 0.5f, 0.9f, 1.0f}) {
        MapInfo info = test::plainInfo(32, 32, 16);
        const ShadowMap map = mapOf(info, test::plainProjection(32, 32), [&](auto, auto) {
            std::vector<TestLayer> sheets;
            double v = 1.0;
            for (int i = 0; i < 7; ++i) {
                v *= 1.0 - double(a);
                sheets.push_back({2.0f + float(i), float(v), 1});
                if (v == 0.0) v = 1.0;
            }
            return sheets;
        });
        TraceOptions options;
        for (double slant : {0.0, 0.3, 2.0}) {
            Ray ray;
            ray.origin = {1 + slant * 3, 0.5, -8.5};
            ray.delta = glm::dvec3(0.05 - slant * 0.5, 0.1, -1) - ray.origin;
            const double expected = std::pow(1.0 - double(a), 7);
            CHECK(traceRay(map, ray, options)[0] ==
                  Approx(expected).epsilon(1e-5).margin(1e-9));
        }
    }
}

TEST_CASE("three channels fade apart", "[trace]") {
    MapInfo info = test::plainInfo(8, 8, 8);
    info.channels = 3;
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    Tile t;
    for (std::uint32_t p = 0; p <= 64; ++p)
        t.begin.push_back(p);
    t.z.assign(64, 3.0f);
    for (float v : {0.75f, 0.5f, 0.0f})
        t.v.insert(t.v.end(), 64, v);
    faces[0].tiles.push_back(t);
    auto map = ShadowMap::create(info, faces);
    REQUIRE(map);
    Ray ray;
    ray.origin = {0.5, 0.5, -5};
    ray.delta = {0, 0, 4};
    CHECK(traceRay(*map, ray, {}) == ChannelVisibility{0.75f, 0.5f, 0.0f});
}

TEST_CASE("an opaque layer blocks within the bias of its depth", "[trace][exact]") {
    const ShadowMap map =
        mapOf(test::plainInfo(16, 16, 8), test::plainProjection(16, 16), [](auto, auto) {
            return std::vector<TestLayer>{{4.0f, 0.0f, 1}};
        });
    for (double z : {3.5, 3.95, 4.05, 4.5}) {
        Ray ray;  // parallel to the layer
        ray.origin = {-1, 0.1, -z};
        ray.delta = {0.5, 0.2, 0};
        TraceOptions options;
        options.bias.base = 0.1;
        CHECK(traceRay(map, ray, options)[0] == (std::abs(z - 4) < 0.1 ? 0.0f : 1.0f));
    }
}

TEST_CASE("a tilted sheet is met exactly once, however opaque", "[trace][exact]") {
    // The plane z = 6 + slope * x of light space, opacity a; rays cross it at all angles.
    // The bias is one and a half of the sheet's step from pixel to pixel.
    for (const double slope : {0.0, 0.5, 1.0, 2.0}) {
        for (const float v : {0.0f, 0.5f, 0.9f}) {
            const Projection p = test::plainProjection(256, 256);
            const ShadowMap map = mapOf(
                test::plainInfo(256, 256, 64), p, [&](std::uint32_t x, std::uint32_t y) {
                    const glm::dvec3 d = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
                    const double z = 6.0 / (1.0 - slope * d.x);
                    return z > 0.5 && z < 40 ? std::vector<TestLayer>{{float(z), v, 1}}
                                             : std::vector<TestLayer>{};
                });
            std::mt19937_64 random(5);
            const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
            TraceOptions options;
            options.bias.perDepth = 1.5 * std::max(1.0, slope) * p.pixelFootprint(1.0);
            int wrong = 0;
            const int rays = 2000;
            for (int i = 0; i < rays; ++i) {
                // Through a point of the sheet, from well behind to well in front of it.
                const glm::dvec3 at(0.6 * unit() - 0.3, 2 * unit() - 1, 0);
                const glm::dvec3 on(at.x, at.y, 6 + slope * at.x);
                const glm::dvec3 along(1.2 * unit() - 0.6, 1.2 * unit() - 0.6, 1);
                // Only rays that do cross it at an angle.
                if (std::abs(along.z - slope * along.x) < 0.3) continue;
                Ray ray;
                ray.origin = p.worldFromLight(on + 2.0 * along);
                ray.delta = p.worldFromLight(on - 2.0 * along) - ray.origin;
                wrong += std::abs(traceRay(map, ray, options)[0] - v) > 1e-6f;
            }
            INFO("slope " << slope << " v " << v);
            CHECK(wrong == 0);
        }
    }
}

TEST_CASE("of a layer that ends dark only the last sample blocks", "[trace]") {
    // Four samples at 5, 6, 7 and 8, the last of which lets nothing through; before them
    // v = 0.9.
    const ShadowMap map =
        mapOf(test::plainInfo(8, 8, 8), test::plainProjection(8, 8), [](auto, auto) {
            return std::vector<TestLayer>{{4.0f, 0.9f, 1}, {8.0f, 0.0f, 4}};
        });
    const auto across = [&](double z, Attenuation attenuation) {
        Ray ray;
        ray.origin = {0.01, 0.02, -z - 0.1};
        ray.delta = {0, 0, 0.2};
        TraceOptions options;
        options.attenuation = attenuation;
        return traceRay(map, ray, options)[0];
    };
    CHECK(across(8.0, Attenuation::multiply) == 0.0f);
    CHECK(across(8.0, Attenuation::subtract) == 0.0f);
    CHECK(across(5.0, Attenuation::multiply) == 1.0f);
    CHECK(across(5.0, Attenuation::subtract) == Approx(1.0 - 0.9 / 4));
}

TEST_CASE("what fell to the threshold is dark", "[trace]") {
    const ShadowMap map =
        mapOf(test::plainInfo(8, 8, 8), test::plainProjection(8, 8), [](auto, auto) {
            return std::vector<TestLayer>{{3.0f, 0.25f, 1}};
        });
    Ray ray;
    ray.origin = {0.5, 0.5, -5};
    ray.delta = {0, 0, 4};
    TraceOptions options;
    options.threshold = 0.2;
    CHECK(traceRay(map, ray, options)[0] == 0.25f);
    options.threshold = 0.25;
    CHECK(traceRay(map, ray, options)[0] == 0.0f);
}

TEST_CASE("layers on the receiver's tangent plane do not count, those above it do",
          "[trace][exact]") {
    // The map holds the slanted plane z = 4 + x / 2 (light space) and a sheet at z = 2.
    MapInfo info = test::plainInfo(64, 64, 16);
    const Projection p = test::plainProjection(64, 64);
    const glm::dvec3 n =
        glm::normalize(glm::dvec3(0.5, 0, -1));  // light space, towards the eye
    const glm::dvec3 onPlane(0, 0, 4);
    const auto depth = [&](std::uint32_t x, std::uint32_t y) {
        const glm::dvec3 ray = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
        return float(glm::dot(n, onPlane) / glm::dot(n, ray));
    };
    for (const bool sheet : {false, true}) {
        const ShadowMap map = mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
            std::vector<TestLayer> layers;
            if (sheet) layers.push_back({2.0f, 0.0f, 1});
            layers.push_back({depth(x, y), 0.0f, 1});
            return layers;
        });
        Ray ray;
        ray.origin = p.worldFromLight({0.3, 0.2, 4.15});
        ray.delta = p.worldFromLight({0.9, 0.1, 0.5}) - ray.origin;
        const ReceiverPlane plane{ray.origin, p.worldFromLight(n), 0.01};
        TraceOptions options;
        options.plane = &plane;
        CHECK(traceRay(map, ray, options)[0] == (sheet ? 0.0f : 1.0f));
    }
}

TEST_CASE("nothing that a ray can be gives NaN or does not end", "[trace][extreme]") {
    const auto layers = [](std::uint32_t, std::uint32_t x, std::uint32_t y) {
        return std::vector<TestLayer>{
            {1e-6f, 0.9f, 1}, {float(x + y + 1), 0.5f, 3}, {1e9f, 0.1f, 1}};
    };
    MapInfo info = test::plainInfo(16, 16, 8);
    std::vector<ShadowMap> maps = {
        mapOf(info, std::vector{test::plainProjection(16, 16)}, layers),
        mapOf(info, test::cubeProjections(16), layers)};
    info.translucent = Translucent::media;
    maps.push_back(mapOf(info, test::cubeProjections(16), layers));
    const double values[] = {0.0, 1e-300, 1e-6, 1.0, 1e9, 1e150, 1e300};
    for (double a : values) {
        for (double b : values) {
            for (double c : values) {
                for (int signs = 0; signs < 8; ++signs) {
                    Ray ray;
                    ray.origin = {a, -b, signs & 1 ? c : -c};
                    ray.delta = {signs & 2 ? c : -c, a, signs & 4 ? b : -b};
                    if (ray.delta == glm::dvec3(0.0)) continue;
                    for (double end : {1.0, HUGE_VAL}) {
                        ray.tEnd = end;
                        ray.tSurfaces = b;
                        TraceOptions options;
                        options.bias.base = a < 1e10 ? a : 0.0;
                        options.bias.perDepth = b < 10 ? b : 0.0;
                        for (const ShadowMap& map : maps) {
                            const float v = traceRay(map, ray, options)[0];
                            REQUIRE((v >= 0.0f && v <= 1.0f));
                        }
                    }
                }
            }
        }
    }
}
