// The expected error of a shadow factor, held against the true one. As in shadow_test.cpp
// blockers end on pixel edges, so the map itself has no error.
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <glm/gtc/constants.hpp>
#include <vector>

#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "shadow/sample_error.h"

using namespace mtsm;
using test::mapOf;
using test::TestLayer;

namespace {

constexpr double kLightZ = 0.5, kBlockerZ = 2.0, kReceiverZ = 4.0, kSize = 0.3;
/// The light is turned about the axis: along its own axes samples are spread better than
/// the estimate knows.
constexpr double kTurn = 0.4;
/// How much larger what lies at the blocker's depth appears on the light.
constexpr double kToLight = (kReceiverZ - kLightZ) / (kReceiverZ - kBlockerZ);

AreaLight lightOf(LightShape shape) {
    AreaLight light;
    light.shape = shape;
    light.position = {0, 0, -kLightZ};
    light.direction = {0, 0, -1};
    light.up = {std::sin(kTurn), std::cos(kTurn), 0};
    light.radius = kSize;
    light.size = glm::dvec2(2 * kSize);
    return light;
}

/// Covered columns of pixels, of 64 x 64; visibility v behind them.
ShadowMap mapOfColumns(const AreaLight& light, const std::function<bool(int)>& covered,
                       float v = 0.0f) {
    MapInfo info = test::plainInfo(64, 64, 64);
    info.light = light;
    return mapOf(info, test::plainProjection(64, 64),
                 [&](std::uint32_t x, std::uint32_t) -> std::vector<TestLayer> {
                     if (covered(int(x))) return {{float(kBlockerZ), v, 1}};
                     return {};
                 });
}

/// Part of a disk of radius 1, or of the square around it turned by kTurn, with x < s.
double below(LightShape shape, double s) {
    if (shape == LightShape::disk) {
        s = std::clamp(s, -1.0, 1.0);
        return 1 - (std::acos(s) - s * std::sqrt(1 - s * s)) / glm::pi<double>();
    }
    // x is the sum of two independent ones, even in [-c, c] and in [-d, d].
    const double c = std::cos(kTurn), d = std::sin(kTurn);
    const auto square = [](double x) { return x > 0 ? 0.5 * x * x : 0.0; };
    return (square(s + c + d) - square(s + c - d) - square(s - c + d) +
            square(s - c - d)) /
           (4 * c * d);
}

/// The part of the light that columns hide from a receiver at x: raster x is at
/// (x - 32) / 32 on the plane z = 1.
double hidden(LightShape shape, const std::function<bool(int)>& covered, double x) {
    double sum = 0.0;
    for (int column = 0; column < 64; ++column) {
        if (!covered(column)) continue;
        // Its edges as they appear on the light's plane, in radii from its centre.
        const auto at = [&](int edge) {
            const double blocker = (edge - 32) / 32.0 * kBlockerZ;
            return (x + (blocker - x) * kToLight) / kSize;
        };
        sum += below(shape, at(column + 1)) - below(shape, at(column));
    }
    return sum;
}

struct Calibration {
    double error = 0.0, expected = 0.0;  // means
    double independent = 0.0;            // what independent samples would have
    [[nodiscard]] double ratio() const { return expected / error; }
};

Calibration calibrate(LightShape shape, const std::function<bool(int)>& covered,
                      const ShadowOptions& options) {
    const AreaLight light = lightOf(shape);
    const ShadowMap map = mapOfColumns(light, covered);
    std::vector<glm::dvec3> points;
    for (double x = -0.45; x <= 0.45; x += 0.9 / 60)
        for (double y = -0.4; y <= 0.4; y += 0.8 / 40)
            points.emplace_back(x, y, -kReceiverZ);
    std::vector<float> found(points.size()), errors(points.size());
    shadowFactors(map, light, points.data(), nullptr, points.size(), found.data(),
                  options, nullptr, errors.data());
    Calibration c;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double truth = hidden(shape, covered, points[i].x);
        c.error += std::abs(found[i] - truth) / double(points.size());
        c.expected += errors[i] / double(points.size());
        c.independent +=
            std::sqrt(truth * (1 - truth) / options.samples * 2 / glm::pi<double>()) /
            double(points.size());
    }
    return c;
}

bool leftHalf(int column) {
    return column < 32;
}
bool everyOther(int column) {
    return column % 2 == 0;
}

}  // namespace

TEST_CASE("the expected error is the true one along an edge, for any number of samples",
          "[shadow][statistical]") {
    // 2501 points: the means are known to 3 %; the estimate errs by the way in which an
    // edge crosses the strata.
    for (const LightShape shape : {LightShape::disk, LightShape::rect}) {
        for (const int samples : {16, 64, 65, 100, 256, 1024}) {
            ShadowOptions options;
            options.samples = samples;
            const Calibration c = calibrate(shape, leftHalf, options);
            INFO(name(shape) << ", " << samples << " samples: error " << c.error
                             << ", expected " << c.expected);
            CHECK(c.ratio() > 0.8);
            CHECK(c.ratio() < 1.7);
            // An estimate from the visibilities alone, v (1 - v) / n, would fail.
            if (samples >= 64) CHECK(c.independent > 1.7 * c.error);
        }
    }
}

TEST_CASE("the expected error is the true one where blockers are finer than samples",
          "[shadow][statistical]") {
    for (const int samples : {16, 64, 256}) {
        ShadowOptions options;
        options.samples = samples;
        const Calibration c = calibrate(LightShape::disk, everyOther, options);
        INFO(samples << " samples: error " << c.error << ", expected " << c.expected);
        // Too large at 64, where columns and strata are about as wide.
        CHECK(c.ratio() > 0.8);
        CHECK(c.ratio() < 2.2);
    }
}

TEST_CASE("ray by ray and in steps the expected error holds as well",
          "[shadow][statistical]") {
    ShadowOptions options;
    options.samples = 64;
    SECTION("by the definition") {
        options.method = ShadowMethod::scalar;
    }
    SECTION("16 samples, then the others") {
        options.adaptive = true;
    }
    SECTION("until there are enough") {
        // From 16 on, a quarter of these points, which see the first 16 samples alike,
        // would stop there with half of all error and an expected one of 0.
        options.samples = 1024;
        options.firstSamples = 64;
        options.targetError = 0.006f;
    }
    const Calibration c = calibrate(LightShape::disk, leftHalf, options);
    INFO("error " << c.error << ", expected " << c.expected);
    CHECK(c.ratio() > 0.8);
    CHECK(c.ratio() < 1.8);
}

TEST_CASE("lit and dark points have no expected error, nor have point lights",
          "[shadow][exact]") {
    for (const LightShape shape : {LightShape::disk, LightShape::point}) {
        const AreaLight light = lightOf(shape);
        const ShadowMap map = mapOfColumns(light, leftHalf);
        const glm::dvec3 points[] = {{2, 0, -kReceiverZ},
                                     {-2, 0, -kReceiverZ},
                                     {NAN, 0, 0},
                                     {0, 0, 1}};  // the last is behind the light
        for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
            ShadowOptions options;
            options.method = method;
            float found[4], errors[4] = {7, 7, 7, 7};
            shadowFactors(map, light, points, nullptr, 4, found, options, nullptr,
                          errors);
            CHECK(found[1] == 1.0f);
            for (const float error : errors)
                CHECK(error == 0.0f);
        }
    }
}

TEST_CASE("fewer than four samples say nothing of their error", "[shadow]") {
    const AreaLight light = lightOf(LightShape::disk);
    const ShadowMap map = mapOfColumns(light, leftHalf);
    const glm::dvec3 point(0.1, 0, -kReceiverZ);
    for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
        ShadowOptions options;
        options.method = method;
        options.samples = 3;
        float found = 0, error = 0;
        shadowFactors(map, light, &point, nullptr, 1, &found, options, nullptr, &error);
        CHECK(std::isnan(error));
    }
}

TEST_CASE("half-transparent blockers have half of the expected error",
          "[shadow][exact]") {
    const AreaLight light = lightOf(LightShape::disk);
    const ShadowMap opaque = mapOfColumns(light, leftHalf),
                    half = mapOfColumns(light, leftHalf, 0.5f);
    for (double x = -0.2; x <= 0.2; x += 0.05) {
        const glm::dvec3 point(x, 0.1, -kReceiverZ);
        float found = 0, whole = 0, error = 0;
        ShadowOptions options;
        options.method = ShadowMethod::scalar;
        shadowFactors(opaque, light, &point, nullptr, 1, &found, options, nullptr,
                      &whole);
        shadowFactors(half, light, &point, nullptr, 1, &found, options, nullptr, &error);
        // Half the spread; how it compares with that of all samples differs a little.
        INFO("x " << x);
        CHECK(error <= 0.5f * whole * 1.001f);
        CHECK(error >= 0.25f * whole);
    }
}

TEST_CASE("points take samples until their error is small enough", "[shadow]") {
    const AreaLight light = lightOf(LightShape::disk);
    const ShadowMap map = mapOfColumns(light, leftHalf);
    std::vector<glm::dvec3> points;
    for (double x = -2; x <= 2; x += 0.01)
        points.emplace_back(x, 0.05, -kReceiverZ);
    std::vector<float> found(points.size()), errors(points.size());
    ShadowOptions options;
    options.samples = 1024;
    std::uint64_t before = points.size() * 16;
    for (const float target : {0.03f, 0.01f, 0.004f}) {
        options.targetError = target;
        QueryStats stats;
        shadowFactors(map, light, points.data(), nullptr, points.size(), found.data(),
                      options, &stats, errors.data());
        for (const float error : errors)
            CHECK(error <= target);
        INFO("target " << target << ", rays " << stats.rays);
        CHECK(stats.rays > before);
        CHECK(stats.rays < points.size() * 256);  // most are lit or dark
        before = stats.rays;
        // A point's answer does not depend on its neighbours, nor on their order.
        for (std::size_t i = 0; i < points.size(); i += 7)
            CHECK(shadowFactor(map, light, points[i], {}, options) == found[i]);
    }
    options.targetError = -1.0f;
    CHECK_FALSE(checkQuery(map, light, options));
}

TEST_CASE("no step takes fewer samples than the one before", "[shadow][exact]") {
    ShadowOptions options;
    options.targetError = 0.01f;
    for (std::uint32_t samples = 1; samples <= std::uint32_t(kMaxSamples); ++samples) {
        const auto steps = shadow::SampleSteps::of(options, samples);
        REQUIRE(steps.count <= shadow::SampleSteps::kMost);
        REQUIRE(steps.end[steps.count - 1] == samples);
        for (int i = 1; i < steps.count; ++i)
            REQUIRE(steps.end[i] - steps.first(i) >= steps.first(i) - steps.first(i - 1));
    }
}

TEST_CASE("a sample more than a step needs does not spoil the expected error",
          "[shadow][statistical]") {
    ShadowOptions options;
    options.samples = 65;
    options.targetError = 0.001f;
    const Calibration c = calibrate(LightShape::disk, leftHalf, options);
    INFO("error " << c.error << ", expected " << c.expected);
    CHECK(c.ratio() > 0.8);
    CHECK(c.ratio() < 1.7);
}
