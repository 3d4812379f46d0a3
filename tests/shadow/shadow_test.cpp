// Shadow factors against closed forms. The maps are drawn pixel by pixel: a blocker whose
// edge lies on pixel edges is exact in the map, so only the light's samples err.
#include <tbb/global_control.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <memory>
#include <optional>
#include <random>

#include "base/lazy.h"
#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

using namespace mtsm;
using test::mapOf;
using test::TestLayer;

namespace {

constexpr double kPi = glm::pi<double>();
constexpr double kLightZ = 0.5;  // light-space depth of the light's plane
constexpr double kBlockerZ = 2.0;
constexpr double kReceiverZ = 4.0;

/// A light at depth kLightZ on the axis, looking along it (world -z).
AreaLight lightOf(LightShape shape, double size) {
    AreaLight light;
    light.shape = shape;
    light.position = {0, 0, -kLightZ};
    light.direction = {0, 0, -1};
    light.up = {0, 1, 0};
    light.radius = size;
    light.size = glm::dvec2(2 * size);
    return light;
}

ShadowMap mapWith(const AreaLight& light, std::uint32_t resolution,
                  const std::function<bool(glm::dvec2)>& covered, float v = 0.0f) {
    MapInfo info = test::plainInfo(resolution, resolution, 64);
    info.light = light;
    const Projection p = test::plainProjection(resolution, resolution);
    return mapOf(
        info, p, [&](std::uint32_t x, std::uint32_t y) -> std::vector<TestLayer> {
            const glm::dvec3 q = p.lightFromRaster({x + 0.5, y + 0.5}, kBlockerZ);
            if (covered({q.x, q.y})) return {{float(kBlockerZ), v, 1}};
            return {};
        });
}

/// Area of the part of a unit disk with x < s.
double diskBelow(double s) {
    s = std::clamp(s, -1.0, 1.0);
    return kPi - std::acos(s) + s * std::sqrt(1 - s * s);
}

/// Area common to two disks of radii a and b with centres d apart.
double lens(double a, double b, double d) {
    if (d >= a + b) return 0.0;
    if (d <= std::abs(a - b)) return kPi * std::min(a, b) * std::min(a, b);
    const double ca = std::acos((d * d + a * a - b * b) / (2 * d * a));
    const double cb = std::acos((d * d + b * b - a * a) / (2 * d * b));
    return a * a * (ca - std::sin(2 * ca) / 2) + b * b * (cb - std::sin(2 * cb) / 2);
}

/// Receiver at light-space (x, y), in world space.
glm::dvec3 receiver(double x, double y = 0.0) {
    return {x, y, -kReceiverZ};
}

/// Where the blocker plane's point (0, 0) appears on the light's plane from receiver x,
/// and how much larger things there appear.
constexpr double kToLight = (kReceiverZ - kLightZ) / (kReceiverZ - kBlockerZ);

ShadowOptions samplesOf(int n) {
    ShadowOptions o;
    o.samples = n;
    return o;
}

}  // namespace

TEST_CASE("a half-plane blocks the closed-form part of a disk and of a rect",
          "[shadow][exact]") {
    // The half-plane x < 0 at kBlockerZ, seen from receiver x, covers the light up to
    // x' = x (1 - kToLight).
    for (LightShape shape : {LightShape::disk, LightShape::rect}) {
        const double size = 0.3;
        const AreaLight light = lightOf(shape, size);
        const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
        for (double x = -0.6; x <= 0.6; x += 0.01) {
            const double s = x * (1 - kToLight) / size;
            const double expected = shape == LightShape::disk
                                        ? diskBelow(s) / kPi
                                        : std::clamp(0.5 * (s + 1), 0.0, 1.0);
            // N stratified samples cut by an edge: O(sqrt(N)) strata are undecided, each
            // with an error of at most 1/N: 4 of their standard deviations.
            for (int n : {64, 1024}) {
                const double allowed = 4 * std::sqrt(std::sqrt(double(n))) / n;
                INFO(name(shape) << " x " << x << " samples " << n);
                CHECK(shadowFactor(map, light, receiver(x, 0.1), {}, samplesOf(n)) ==
                      Approx(expected).margin(allowed));
            }
        }
    }
}

TEST_CASE("a half-transparent half-plane gives half of the opaque penumbra",
          "[shadow][exact]") {
    const AreaLight light = lightOf(LightShape::disk, 0.3);
    const auto half = [](glm::dvec2 q) { return q.x < 0; };
    const ShadowMap opaque = mapWith(light, 64, half),
                    clear = mapWith(light, 64, half, 0.5f);
    for (double x = -0.6; x <= 0.6; x += 0.05) {
        // The same light samples meet the same pixels: exactly half. (The fast trace
        // keeps an optical depth to one part in 1024.)
        ShadowOptions options;
        for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
            options.method = method;
            const double margin = method == ShadowMethod::trace ? 4e-4 : 1e-6;
            CHECK(shadowFactor(clear, light, receiver(x), {}, options) ==
                  Approx(0.5 * shadowFactor(opaque, light, receiver(x), {}, options))
                      .margin(margin));
        }
    }
}

TEST_CASE("a disk blocks the closed-form part of a disk light", "[shadow][exact]") {
    const double R = 0.25, a = 0.15;
    const AreaLight light = lightOf(LightShape::disk, R);
    const std::uint32_t resolution = 1024;
    const ShadowMap map =
        mapWith(light, resolution, [&](glm::dvec2 q) { return glm::length(q) < a; });
    const double blocker = a * kToLight;
    double sum = 0.0;
    int count = 0;
    for (double x = 0.0; x <= 0.6; x += 0.02) {
        const double expected =
            lens(R, blocker, std::abs(x * (1 - kToLight))) / (kPi * R * R);
        const double found = shadowFactor(map, light, receiver(x), {}, samplesOf(4096));
        // Samples as above, plus the blocker's rim, which is off by a third of a pixel at
        // most along its length on the light.
        const double pixel = kToLight * 2 * kBlockerZ / resolution;
        const double allowed = 4 * std::sqrt(std::sqrt(4096.0)) / 4096 +
                               0.33 * pixel * 2 * kPi * blocker / (kPi * R * R);
        INFO("x " << x);
        CHECK(found == Approx(expected).margin(allowed));
        sum += found - expected;
        ++count;
    }
    CHECK(std::abs(sum / count) < 0.002);  // no bias
}

TEST_CASE("the error falls at least as 1 / sqrt(samples)", "[shadow][statistical]") {
    const double R = 0.3;
    const AreaLight light = lightOf(LightShape::disk, R);
    const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
    const auto rms = [&](int samples) {
        double sum = 0.0;
        int count = 0;
        for (double x = -0.35; x <= 0.35; x += 0.7 / 400) {
            const double error =
                shadowFactor(map, light, receiver(x, 0.05), {}, samplesOf(samples)) -
                diskBelow(x * (1 - kToLight) / R) / kPi;
            sum += error * error;
            ++count;
        }
        return std::sqrt(sum / count);
    };
    const double e16 = rms(16), e256 = rms(256), e4096 = rms(4096);
    INFO("rms " << e16 << " " << e256 << " " << e4096);
    // 16 times the samples: 4 times less error if they were independent.
    CHECK(e256 < e16 / 4);
    CHECK(e4096 < e256 / 4);
    // And independent samples would start at sqrt(v (1 - v) / 16), 0.09 or so on average.
    CHECK(e16 < 0.06);
}

TEST_CASE("lit and dark points are exactly 0 and 1", "[shadow][exact]") {
    const AreaLight light = lightOf(LightShape::disk, 0.1);
    const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
    CHECK(shadowFactor(map, light, receiver(2)) == 0.0f);
    CHECK(shadowFactor(map, light, receiver(-2)) == 1.0f);
    CHECK(shadowFactor(map, light, {1e9, 0, -1}) == 0.0f);
}

TEST_CASE("cosine weights give the ratio of irradiances", "[shadow][exact]") {
    // The unblocked half of a wide rect light, integrated by a fine midpoint rule.
    const AreaLight light = lightOf(LightShape::rect, 3.0);
    const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
    const glm::dvec3 p = receiver(0.0), n = glm::normalize(glm::dvec3(1, 0.5, 1));
    double seen = 0.0, all = 0.0;
    const int steps = 600;
    for (int i = 0; i < steps; ++i) {
        for (int j = 0; j < steps; ++j) {
            const glm::dvec3 q((i + 0.5) / steps * 6 - 3, (j + 0.5) / steps * 6 - 3,
                               -kLightZ);
            const glm::dvec3 d = q - p;
            const double w =
                std::max(0.0, glm::dot(d, n)) * d.z / std::pow(glm::dot(d, d), 2);
            all += w;
            if (q.x >= 0)
                seen += w;  // from the middle, the blocker covers x < 0 of the light
        }
    }
    ShadowOptions options = samplesOf(4096);
    options.weight = Weight::cosine;
    CHECK(shadowFactor(map, light, p, n, options) ==
          Approx(1 - seen / all).margin(0.004));
    options.weight = Weight::uniform;
    CHECK(shadowFactor(map, light, p, {0, 0, 1}, options) == Approx(0.5).margin(0.004));
}

TEST_CASE("points of the light below the receiver's horizon count as blocked",
          "[shadow][exact]") {
    // An empty map: only the horizon blocks. A plane whose horizon cuts the disk in the
    // middle.
    const AreaLight light = lightOf(LightShape::disk, 0.5);
    const ShadowMap map = mapWith(light, 16, [](glm::dvec2) { return false; });
    CHECK(shadowFactor(map, light, receiver(0), {1, 0, 0}, samplesOf(1024)) ==
          Approx(0.5).margin(0.01));
    CHECK(shadowFactor(map, light, receiver(0), {0, 0, 1}) == 0.0f);
    CHECK(shadowFactor(map, light, receiver(0), {0, 0, -1}) == 1.0f);
}

TEST_CASE(
    "percentage-closer filtering is exact for a blocker at the smallest depth and a "
    "light at the eye",
    "[shadow][exact]") {
    // All blockers lie at z_min, so the filter of eq. 1 is the true one: the half-plane's
    // edge appears at x (1 - 4 / (4 - 2)) on the light.
    const double R = 0.3, nearEye = 1e-9;
    AreaLight light = lightOf(LightShape::disk, R);
    light.position.z = -nearEye;
    const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
    ShadowOptions options = samplesOf(1024);
    options.method = ShadowMethod::pcf;
    for (double x = -0.6; x <= 0.6; x += 0.05) {
        CHECK(shadowFactor(map, light, receiver(x), {}, options) ==
              Approx(diskBelow(-x / R) / kPi).margin(0.02));
    }
}

TEST_CASE("percentage-closer filtering leaves a lit plane lit, tilted or not",
          "[shadow][exact]") {
    // The map holds the receiver's own plane and nothing else.
    const Projection p = test::plainProjection(128, 128);
    for (const double slope : {0.0, 0.5, 1.5}) {
        MapInfo info = test::plainInfo(128, 128, 64);
        info.light = lightOf(LightShape::disk, 0.1);
        const ShadowMap map = mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
            const glm::dvec3 d = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
            const double z = kReceiverZ / (1.0 - slope * d.x);
            return z > 1 && z < 20 ? std::vector<TestLayer>{{float(z), 0.0f, 1}}
                                   : std::vector<TestLayer>{};
        });
        ShadowOptions options = samplesOf(256);
        options.method = ShadowMethod::pcf;
        for (double x = -0.5; x <= 0.5; x += 0.05) {
            const glm::dvec3 on(x, 0.2, -(kReceiverZ + slope * x));
            const glm::dvec3 normal(slope, 0, 1);  // towards the light
            CHECK(shadowFactor(map, info.light, on, normal, options) == 0.0f);
        }
    }
}

TEST_CASE("a sun's penumbra is the closed form of its disk", "[shadow][exact]") {
    MapInfo info = test::plainInfo(128, 128, 64);
    info.light.shape = LightShape::sun;
    info.light.direction = {0, 0, -1};
    info.light.angularDiameter = 0.2;
    Projection p = test::plainProjection(128, 128);
    p.kind = ProjectionKind::orthographic;
    p.scale = {16, -16};  // 8 units across
    const ShadowMap map = mapOf(info, p, [](std::uint32_t x, std::uint32_t) {
        return x < 64 ? std::vector<TestLayer>{{float(kBlockerZ), 0.0f, 1}}
                      : std::vector<TestLayer>{};
    });
    // At distance h below the edge the sun's rim is at h tan(a / 2); within the cone the
    // density over tan differs from even by less than 1 %.
    const double h = kReceiverZ - kBlockerZ, rim = h * std::tan(0.1);
    for (double x = -0.4; x <= 0.4; x += 0.02) {
        CHECK(shadowFactor(map, info.light, receiver(x, 0.3), {}, samplesOf(1024)) ==
              Approx(diskBelow(-x / rim) / kPi).margin(0.02));
    }
}

TEST_CASE("a batch equals its single queries whatever the threads", "[shadow][threads]") {
    const AreaLight light = lightOf(LightShape::disk, 0.3);
    const ShadowMap map =
        mapWith(light, 64, [](glm::dvec2 q) { return q.x * q.y < 0.1; });
    std::vector<glm::dvec3> points, normals;
    std::mt19937_64 random(4);
    for (int i = 0; i < 5000; ++i) {
        const auto u = [&] { return double(random() >> 11) * 0x1p-53; };
        points.push_back({4 * u() - 2, 4 * u() - 2, -3 - u()});
        normals.push_back(i % 3 ? glm::dvec3(u(), u(), 1) : glm::dvec3(0.0));
    }
    points[7].x = NAN;
    points[8] = {0, 0, 5};  // behind the light
    std::vector<float> single(points.size());
    for (std::size_t i = 0; i < points.size(); ++i)
        single[i] = shadowFactor(map, light, points[i], normals[i], samplesOf(16));
    for (int threads : {1, 2, 8}) {
        tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        std::vector<float> batch(points.size());
        QueryStats stats;
        shadowFactors(map, light, points.data(), normals.data(), points.size(),
                      batch.data(), samplesOf(16), &stats);
        CHECK(std::memcmp(batch.data(), single.data(), 4 * batch.size()) == 0);
        CHECK(stats.points == points.size());
        CHECK(stats.notFinite == 1);
        CHECK(stats.behindLight == 1);
        CHECK(stats.rays > 0);
    }
}

TEST_CASE("what queries need is made once, beforehand or by the first of them",
          "[shadow]") {
    const auto notAgain = [](const auto& nothing) {
        return [&] {
            FAIL_CHECK("made again");
            return nothing;
        };
    };
    SECTION("an opaque map's patches") {
        test::NoisySpec spec;
        spec.opaque = true;
        spec.width = spec.height = 64;
        spec.emptyTiles = 0.0;
        const ShadowMap prepared = test::noisyMap(spec), other = test::noisyMap(spec);
        REQUIRE(prepared.isOpaque());
        prepareQueries(prepared);
        const std::vector<trace::PatchTree> none;
        const auto& trees =
            prepared.queryData().get<std::vector<trace::PatchTree>>(notAgain(none));
        REQUIRE(trees.size() == 1);
        CHECK(queryMemoryBytes(prepared) ==
              prepared.memoryBytes() + trees[0].memoryBytes());
        // A patch per tile of 16 x 16 pixels at least.
        CHECK(trees[0].memoryBytes() >= 16 * sizeof(trace::PatchGroup) / 4);
        CHECK(queryMemoryBytes(other) == queryMemoryBytes(prepared));
        std::vector<float> dark[2];
        for (const ShadowMap* map : {&prepared, &other}) {
            std::vector<float>& out = dark[map == &other];
            for (double x = -2; x < 2; x += 0.25)
                out.push_back(shadowFactor(*map, map->info().light, receiver(x)));
        }
        CHECK(dark[0] == dark[1]);
    }
    SECTION("a transparent map's densities") {
        const AreaLight light = lightOf(LightShape::disk, 0.3);
        const ShadowMap map = mapWith(
            light, 64, [](glm::dvec2 q) { return q.x < 0; }, 0.5f);
        prepareQueries(map);
        using Kept = std::shared_ptr<std::array<base::Lazy, 2>>;
        const std::vector<trace::DensityTree> none;
        const Kept& kept = map.queryData().get<Kept>(notAgain(Kept()));
        const auto& trees =
            (*kept)[0].get<std::vector<trace::DensityTree>>(notAgain(none));
        REQUIRE(trees.size() == 1);
        CHECK(queryMemoryBytes(map) == map.memoryBytes() + trees[0].memoryBytes());
        CHECK(trees[0].memoryBytes() > 0);
    }
    SECTION("nothing for an empty map, nor for six faces that are no cube") {
        const ShadowMap empty =
            mapWith(lightOf(LightShape::disk, 0.3), 64, [](glm::dvec2) { return false; });
        prepareQueries(empty);
        CHECK(queryMemoryBytes(empty) == empty.memoryBytes());
        test::NoisySpec spec;
        spec.faces = 6;
        const ShadowMap cube = test::noisyMap(spec);
        prepareQueries(cube);
        CHECK(queryMemoryBytes(cube) == cube.memoryBytes());
    }
}

TEST_CASE("a batch is answered whole even in a task group that was cancelled",
          "[shadow]") {
    const AreaLight light = lightOf(LightShape::disk, 0.3);
    const ShadowMap map = mapWith(light, 64, [](glm::dvec2 q) { return q.x < 0; });
    const std::vector<glm::dvec3> points(20000, receiver(-2));
    std::vector<float> out(points.size(), -1.0f);
    tbb::task_group group;
    group.run_and_wait([&] {
        group.cancel();
        shadowFactors(map, light, points.data(), nullptr, points.size(), out.data(),
                      samplesOf(1));
    });
    CHECK(std::count(out.begin(), out.end(), 1.0f) == std::ptrdiff_t(out.size()));
}

TEST_CASE("a point outside a clipped map's view is reported", "[shadow]") {
    MapInfo info = test::plainInfo(16, 16, 16);
    info.light = lightOf(LightShape::disk, 0.1);
    info.castersClipped = true;
    const ShadowMap map = mapOf(info, test::plainProjection(16, 16), [](auto, auto) {
        return std::vector<TestLayer>{{2, 0, 1}};
    });
    const glm::dvec3 points[] = {{0, 0, -4}, {3.4, 0, -4}, {3.6, 0, -4}, {0, -30, -4}};
    float out[4];
    QueryStats stats;
    shadowFactors(map, info.light, points, nullptr, 4, out, {}, &stats);
    CHECK(stats.mayBeTruncated == 2);  // beyond 45 degrees from the light's centre
}

TEST_CASE("a query refuses what the map cannot answer", "[shadow][bad-input]") {
    const AreaLight light = lightOf(LightShape::disk, 0.1);
    const ShadowMap map = mapWith(light, 16, [](glm::dvec2) { return true; });
    CHECK(checkQuery(map, light, {}));
    CHECK_FALSE(checkQuery(map, lightOf(LightShape::disk, 0.2), {}));
    CHECK_FALSE(checkQuery(map, light, samplesOf(0)));
    CHECK_FALSE(checkQuery(map, light, samplesOf(4097)));
    ShadowOptions options;
    options.threshold = 1.0f;
    CHECK_FALSE(checkQuery(map, light, options));
    options = {};
    options.bias = NAN;
    CHECK_FALSE(checkQuery(map, light, options));
}

TEST_CASE("single rays see the layers between their ends", "[shadow]") {
    const AreaLight light = lightOf(LightShape::disk, 0.1);
    const ShadowMap map = mapWith(
        light, 16, [](glm::dvec2) { return true; }, 0.25f);
    ShadowRay ray;
    ray.origin = receiver(0.3, 0.2);
    ray.direction = {0, 0, 1};
    ray.length = 3.0;
    CHECK(visibility(map, ray) == Approx(0.25).margin(4e-4));
    ray.length = 1.9;
    CHECK(visibility(map, ray) == 1.0f);
    ray.length = INFINITY;
    CHECK(visibility(map, ray) == Approx(0.25).margin(4e-4));
    ray.length = 0.0;
    CHECK(visibility(map, ray) == 1.0f);
    ray.length = NAN;
    CHECK(visibility(map, ray) == 1.0f);
    ray.length = 3.0;
    ray.origin.x = NAN;
    CHECK(visibility(map, ray) == 1.0f);
    float out[2];
    ray.origin.x = 0.3;
    const ShadowRay rays[] = {ray, ray};
    visibilities(map, rays, 2, out);
    CHECK(out[0] == Approx(0.25).margin(4e-4));
    CHECK(out[1] == Approx(0.25).margin(4e-4));
}
