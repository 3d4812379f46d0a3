// Hair and volumes: samples met at exact crossings, in front of and behind surfaces.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "map_fixture.h"
#include "trace/traverse.h"

using namespace mtsm;
using namespace mtsm::trace;
using test::mapOf;
using test::TestLayer;

namespace {

MapInfo mediaInfo(std::uint32_t width, std::uint32_t height) {
    MapInfo info = test::plainInfo(width, height, 8);
    info.translucent = Translucent::media;
    return info;
}

ShadowMap mediaOf(const std::vector<TestLayer>& layers) {
    return mapOf(mediaInfo(16, 16), test::plainProjection(16, 16),
                 [&](auto, auto) { return layers; });
}

/// A parallel view, in which rays along depth are centre rays.
Projection parallel(std::uint32_t width) {
    Projection p = test::plainProjection(width, width);
    p.kind = ProjectionKind::orthographic;
    p.scale = {width / 20.0, width / -20.0};
    return p;
}

ShadowMap parallelMediaOf(const std::vector<TestLayer>& layers) {
    return mapOf(mediaInfo(16, 16), parallel(16), [&](auto, auto) { return layers; });
}

/// Subtraction counts samples: what each takes is the same at any slant.
struct Half {
    glm::dvec3 from, to;
    double bias = 0.0;
    double tSurfaces = 0.0;
    Attenuation attenuation = Attenuation::subtract;
};

float visibleOf(const ShadowMap& map, const Half& h) {
    Ray ray;
    ray.origin = h.from;
    ray.delta = h.to - h.from;
    ray.tSurfaces = h.tSurfaces;
    TraceOptions options;
    options.bias.base = h.bias;
    options.attenuation = h.attenuation;
    return traceRay(map, ray, options)[0];
}

float multiplied(const ShadowMap& map, glm::dvec3 from, glm::dvec3 to) {
    return visibleOf(map, {from, to, 0, 0, Attenuation::multiply});
}

/// In layers of `samples` samples: v = exp(-s (z - 2)) from depth 2 to 6.
std::vector<TestLayer> slabOf(double s, int samples, int layers) {
    std::vector<TestLayer> slab = {{2.0f, 1.0f, 1}};
    for (int i = 1; i <= layers; ++i) {
        const double z = 4.0 * i / layers;
        slab.push_back(
            {float(2 + z), float(std::exp(-s * z)), std::uint32_t(samples / layers)});
    }
    return slab;
}

}  // namespace

TEST_CASE("a sample of a medium is met at its depth and nowhere else, whatever the bias",
          "[trace][exact]") {
    const ShadowMap map = mediaOf({{4.0f, 0.5f, 1}});
    for (const double bias : {0.0, 0.5}) {
        CHECK(visibleOf(map, {{0.1, 0.2, -8}, {0.1, 0.2, -1}, bias}) == 0.5f);
        CHECK(visibleOf(map, {{0.1, 0.2, -8}, {0.1, 0.2, -4.1}, bias}) == 1.0f);
        CHECK(visibleOf(map, {{0.1, 0.2, -3.9}, {0.1, 0.2, -1}, bias}) == 1.0f);
        // A ray of constant depth crosses none.
        CHECK(visibleOf(map, {{-3, 0.2, -4}, {3, 0.2, -4}, bias}) == 1.0f);
        // There and back are two rays; each pays.
        CHECK(visibleOf(map, {{0.1, 0.2, -1}, {0.1, 0.2, -8}, bias}) == 0.5f);
    }
}

TEST_CASE("a sample met exactly where a ray changes pixels is paid for once",
          "[trace][exact]") {
    const ShadowMap map = mediaOf({{4.0f, 0.5f, 1}});
    // Pixel boundaries at depth 4 are multiples of 1/2; all of these numbers are exact.
    for (const glm::dvec3 to : {glm::dvec3(0.25, 0.125, -2), glm::dvec3(-0.25, 0.0, -2),
                                glm::dvec3(0.5, 0.5, -2), glm::dvec3(0.0, 0.0, -2)}) {
        for (const glm::dvec3 at : {glm::dvec3(0, 0, -4), glm::dvec3(1.5, -0.5, -4),
                                    glm::dvec3(1, 0.25, -4), glm::dvec3(0.25, -2, -4)}) {
            const glm::dvec3 from = 2.0 * at - to;
            CHECK(visibleOf(map, {from, to}) == 0.5f);
            CHECK(visibleOf(map, {to, from}) == 0.5f);
        }
    }
    // Runs of samples, too: of eight at 4.5 .. 8 the ray meets each once.
    const ShadowMap runs = mediaOf({{4.0f, 1.0f, 1}, {8.0f, 0.0625f, 8}});
    for (double slope = -2; slope <= 2; slope += 0.125) {
        CHECK(visibleOf(runs, {{4 * slope, 0.5, -10}, {-slope, 0.5, -2}}) ==
              Approx(0.0625).epsilon(1e-6));
    }
}

TEST_CASE("unrelated samples of neighbouring pixels are paid for each",
          "[trace][exact]") {
    // Depths 4 and 4.25 in a chequerboard, with a bias far beyond the step. As sheets a
    // ray that changes pixels there pays once; as media it pays for what it crosses.
    const auto board = [](std::uint32_t x, std::uint32_t y) {
        return std::vector<TestLayer>{{(x + y) % 2 ? 4.0f : 4.25f, 0.75f, 1}};
    };
    const Projection p = test::plainProjection(16, 16);
    const ShadowMap media = mapOf(mediaInfo(16, 16), p, board);
    const ShadowMap sheets = mapOf(test::plainInfo(16, 16, 8), p, board);
    // From (8 px, .) on: x = -z / 16 + 1/4 is 0, a pixel boundary, at depth 4.125.
    const auto across = [&](double x0, double x1) {
        return Half{{x1, 0.2, -4.75}, {x0, 0.2, -3.5}, 0.5};
    };
    // In the right pixel when it crosses 4.25, in the left one when it crosses 4.
    const float right = visibleOf(media, across(-0.5, 0.5));
    const float left = visibleOf(media, across(0.5, -0.5));
    CHECK(std::min(right, left) == 0.5f);
    CHECK(std::max(right, left) == 1.0f);
    CHECK(visibleOf(sheets, across(-0.5, 0.5)) == 0.75f);
    CHECK(visibleOf(sheets, across(0.5, -0.5)) == 0.75f);
}

TEST_CASE("surfaces in a map of media keep the bias", "[trace][exact]") {
    // Alone, and behind what lets light through.
    const ShadowMap wall = mediaOf({{4.0f, 0.0f, 1}});
    const ShadowMap behind = mediaOf({{2.0f, 0.5f, 3}, {4.0f, 0.0f, 1}, {6.0f, 0.5f, 1}});
    for (const ShadowMap* map : {&wall, &behind}) {
        for (double z : {3.5, 3.95, 4.05, 4.5})
            CHECK(visibleOf(*map, {{-1, 0.1, -z}, {-0.5, 0.3, -z}, 0.1}) ==
                  (std::abs(z - 4) < 0.1 ? 0.0f : 1.0f));
    }
    CHECK(visibleOf(behind, {{0.1, 0.1, -7}, {0.1, 0.1, -5}, 0.1}) == 0.5f);
    CHECK(visibleOf(behind, {{0.1, 0.1, -7}, {0.1, 0.1, -1}, 0.1}) == 0.0f);
}

TEST_CASE("of a run of media that ends dark only the last sample blocks, at its depth",
          "[trace][exact]") {
    // Samples at 5, 6, 7, 8.
    const ShadowMap map = mediaOf({{4.0f, 0.9f, 1}, {8.0f, 0.0f, 4}});
    const auto across = [&](double z, Attenuation attenuation) {
        return visibleOf(
            map, {{0.01, 0.02, -z - 0.1}, {0.01, 0.02, -z + 0.1}, 0.5, 0, attenuation});
    };
    CHECK(across(8.0, Attenuation::multiply) == 0.0f);
    CHECK(across(8.0, Attenuation::subtract) == 0.0f);
    CHECK(across(5.0, Attenuation::multiply) == 1.0f);
    CHECK(across(5.0, Attenuation::subtract) == Approx(1.0 - 0.9 / 4));
    // Beside it, where a surface's bias would reach.
    CHECK(across(8.2, Attenuation::multiply) == 1.0f);
    CHECK(across(7.5, Attenuation::multiply) == 1.0f);
}

TEST_CASE("layers that take nothing take nothing", "[trace][exact]") {
    const std::vector<TestLayer> layers = {
        {2.0f, 1.0f, 4}, {3.0f, 0.5f, 1}, {5.0f, 0.5f, 7}, {6.0f, 0.25f, 1}};
    for (const Translucent rule : {Translucent::sheets, Translucent::media}) {
        MapInfo info = test::plainInfo(16, 16, 8);
        info.translucent = rule;
        const ShadowMap map =
            mapOf(info, parallel(16), [&](auto, auto) { return layers; });
        for (const Attenuation a : {Attenuation::multiply, Attenuation::subtract}) {
            const auto between = [&](double z0, double z1) {
                return visibleOf(map, {{0.1, 0.1, -z1}, {0.1, 0.1, -z0}, 0, 0, a});
            };
            CHECK(between(1.5, 2.5) == 1.0f);
            CHECK(between(3.5, 5.5) == 1.0f);
            CHECK(between(1.0, 5.5) == 0.5f);
            CHECK(between(1.0, 7.0) == 0.25f);
            CHECK(between(5.5, 7.0) == (a == Attenuation::multiply ? 0.5f : 0.75f));
        }
    }
}

TEST_CASE("a channel that is dark already is not asked again, but a wall blocks all",
          "[trace][exact]") {
    // Red glass, clear glass, a wall: behind the first, green and blue are unknown.
    for (const Translucent rule : {Translucent::sheets, Translucent::media}) {
        MapInfo info = test::plainInfo(8, 8, 8);
        info.channels = 3;
        info.translucent = rule;
        std::vector<MapFace> faces(1);
        faces[0].projection = parallel(8);
        Tile t;
        for (std::uint32_t p = 0; p <= 64; ++p)
            t.begin.push_back(3 * p);
        const float v[3][3] = {
            {0.5f, 0.25f, 0.0f}, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}};
        for (int p = 0; p < 64; ++p)
            t.z.insert(t.z.end(), {3.0f, 4.0f, 5.0f});
        for (const auto& channel : v) {
            for (int p = 0; p < 64; ++p)
                t.v.insert(t.v.end(), channel, channel + 3);
        }
        faces[0].tiles.push_back(t);
        auto map = ShadowMap::create(info, faces);
        REQUIRE(map);
        const auto between = [&](double z0, double z1) {
            Ray ray;
            ray.origin = {0.5, 0.5, -z1};
            ray.delta = {0, 0, z1 - z0};
            return traceRay(*map, ray, {});
        };
        CHECK(between(1, 3.5) == ChannelVisibility{0.5f, 0.0f, 0.0f});
        CHECK(between(1, 4.5) == ChannelVisibility{0.25f, 0.0f, 0.0f});
        CHECK(between(3.5, 4.5) == ChannelVisibility{0.5f, 1.0f, 1.0f});
        CHECK(between(3.5, 5.5) == ChannelVisibility{0.0f, 0.0f, 0.0f});
        CHECK(between(4.5, 5.5) == ChannelVisibility{0.0f, 0.0f, 0.0f});
    }
}

TEST_CASE("surfaces may count from further along the ray than media", "[trace][exact]") {
    const ShadowMap map =
        parallelMediaOf({{3.0f, 0.5f, 1}, {5.0f, 0.0f, 1}, {6.0f, 0.5f, 2}});
    const auto from = [&](double z, double distance) {
        return visibleOf(map, {{0.1, 0.1, -z},
                               {0.1, 0.1, -1},
                               0.1,
                               distance / (z - 1),
                               Attenuation::multiply});
    };
    CHECK(from(5.4, 0.0) == 0.0f);
    CHECK(from(5.4, 0.3) == 0.0f);
    CHECK(from(5.4, 0.7) == 0.5f);   // the wall is passed before it counts
    CHECK(from(6.5, 0.7) == 0.0f);   // the sample at 6 counts, then the wall
    CHECK(from(6.5, 1.7) == 0.25f);  // the sample at 6, no wall, the sample at 3
    CHECK(from(6.5, 9.0) == 0.25f);
    // A map of sheets knows no such difference.
    const ShadowMap sheets =
        mapOf(test::plainInfo(16, 16, 8), test::plainProjection(16, 16), [](auto, auto) {
            return std::vector<TestLayer>{{5.0f, 0.0f, 1}};
        });
    CHECK(visibleOf(sheets, {{0.1, 0.1, -5.5}, {0.1, 0.1, -1}, 0.1, 0.9}) == 0.0f);
}

TEST_CASE("a medium takes from a ray by the ray's way through a slice of depth",
          "[trace][exact]") {
    const ShadowMap map = parallelMediaOf({{4.0f, 0.875f, 1}});
    // Through the sample at depth 4, at a given way per unit of depth.
    const auto through = [&](double way) {
        const glm::dvec3 at(0.1, 0.2, -4), along(std::sqrt(way * way - 1), 0, 1);
        const glm::dvec3 half = along * (2 / way);
        const float out = multiplied(map, at - half, at + half);
        CHECK(multiplied(map, at + half, at - half) == out);
        return out;
    };
    CHECK(through(1) == 0.875f);
    CHECK(through(2) == Approx(0.875 * 0.875));  // 60 degrees
    CHECK(through(15) == Approx(std::pow(0.875, 15)));
    // Almost parallel to the image, no sample counts for more than 16.
    for (const double way : {16.0, 17.0, 1e3, 1e9})
        CHECK(through(way) == Approx(std::pow(0.875, 16)));
    // At constant depth a ray crosses none, at the sample's depth and beside it.
    for (const double z : {3.9, 4.0, 4.1})
        CHECK(multiplied(map, {-3, 0.2, -z}, {3, 0.1, -z}) == 1.0f);
    // In a perspective view samples count once for the centre ray of their pixel, for
    // less towards depth and for more away from it.
    const Projection p = test::plainProjection(16, 16);
    const ShadowMap wide = mapOf(mediaInfo(16, 16), p, [](auto, auto) {
        return std::vector<TestLayer>{{4.0f, 0.875f, 1}};
    });
    const glm::dvec3 c = p.lightFromRaster({13.5, 2.5}, 1.0);
    const double centre = glm::length(c);
    const auto along = [&](glm::dvec3 d) {
        return multiplied(wide, p.worldFromLight(4.0 * c + d),
                          p.worldFromLight(4.0 * c - d));
    };
    CHECK(along(2.0 * c) == Approx(0.875));
    CHECK(along({0, 0, 1}) == Approx(std::pow(0.875, 1 / centre)));
    CHECK(along({1, 0, 0.5}) == Approx(std::pow(0.875, std::sqrt(5.0) / centre)));
    // Surfaces block at any slant.
    const ShadowMap wall = parallelMediaOf({{4.0f, 0.0f, 1}});
    CHECK(multiplied(wall, {0.1, 0.2, -4.01}, {6, 0.2, -3.99}) == 0.0f);
}

TEST_CASE("how long a ray's delta is changes nothing", "[trace][extreme]") {
    const ShadowMap map = parallelMediaOf({{4.0f, 0.5f, 1}});
    for (const double size : {1e-300, 1e-200, 1.0, 1e200, 1e300}) {
        Ray ray;
        ray.origin = {0.1, 0.2, -8};
        ray.delta = {0, 0, size};
        ray.tEnd = HUGE_VAL;
        INFO(size);
        CHECK(traceRay(map, ray, {})[0] == 0.5f);
    }
}

TEST_CASE("a homogeneous slab gives exp(-s d) to rays of any slant, compressed or not",
          "[trace][exact]") {
    // Between depths 2 and 6; what a pixel holds is found along its centre ray.
    const double s = 0.7;
    const int samples = 4096;
    Projection parallelView = parallel(32);
    parallelView.scale = {4, -4};
    for (const Projection& p : {parallelView, test::plainProjection(32, 32)}) {
        for (const int layers : {samples, 64, 1}) {
            const ShadowMap map =
                mapOf(mediaInfo(32, 32), p, [&](std::uint32_t x, std::uint32_t y) {
                    const glm::dvec3 c = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
                    const bool perspective = p.kind == ProjectionKind::perspective;
                    return slabOf(s * (perspective ? glm::length(c) : 1.0), samples,
                                  layers);
                });
            std::mt19937_64 random(3);
            const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
            for (int i = 0; i < 200; ++i) {
                const double z = 1 + 6 * unit();
                const glm::dvec3 from(2 * unit() - 1, 2 * unit() - 1, -z);
                const glm::dvec3 to(2 * unit() - 1, 2 * unit() - 1, -1);
                const double slant = glm::length(to - from) / (z - 1);
                const double way = std::clamp(z - 2, 0.0, 4.0) * slant;
                // One sample more or less.
                CHECK(multiplied(map, from, to) ==
                      Approx(std::exp(-s * way)).epsilon(1.1 * s * slant * 4 / samples));
            }
        }
    }
}

TEST_CASE("a ray through media ends below the threshold", "[trace]") {
    const ShadowMap map =
        parallelMediaOf({{3.0f, 0.5f, 1}, {4.0f, 0.25f, 1}, {5.0f, 0.125f, 1}});
    Ray ray;
    ray.origin = {0.1, 0.1, -6};
    ray.delta = {0, 0, 5};
    TraceOptions options;
    options.threshold = 0.2;
    CHECK(traceRay(map, ray, options)[0] == 0.0f);
    options.threshold = 0.12;
    CHECK(traceRay(map, ray, options)[0] == 0.125f);
}
