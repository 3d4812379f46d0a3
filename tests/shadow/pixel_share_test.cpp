// Points that share a pixel: together they have a larger, well-spread set of samples.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <numeric>
#include <set>
#include <vector>

#include "base/sampling.h"
#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "shadow/pixel_share.h"

using namespace mtsm;

namespace {

constexpr double kBlockerZ = 2.0, kReceiverZ = 4.0, kRadius = 0.3;

/// The half-plane x < 0 in the middle between the light and its receivers, which so see
/// it move over the light as fast as they move.
ShadowMap halfPlane() {
    MapInfo info = test::plainInfo(64, 64, 64);
    info.light.shape = LightShape::disk;
    info.light.position = {0, 0, 0};
    info.light.direction = {0, 0, -1};
    info.light.up = {0, 1, 0};
    info.light.radius = kRadius;
    return test::mapOf(
        info, test::plainProjection(64, 64),
        [&](std::uint32_t x, std::uint32_t) -> std::vector<test::TestLayer> {
            if (x < 32) return {{float(kBlockerZ), 0.0f, 1}};
            return {};
        });
}

double blockedFrom(double x) {
    const double s = std::clamp(-x / kRadius, -1.0, 1.0);
    return (glm::pi<double>() - std::acos(s) + s * std::sqrt(1 - s * s)) /
           glm::pi<double>();
}

}  // namespace

TEST_CASE("the parts of a pixel are shuffled, none twice", "[shadow]") {
    for (std::uint32_t count = 1; count <= 256; ++count) {
        std::set<std::uint32_t> taken;
        for (std::uint32_t part = 0; part < count; ++part)
            taken.insert(shadow::shuffled(part, count, base::mix(count)));
        INFO(count << " points");
        CHECK(taken.size() == count);
        CHECK(*taken.rbegin() == count - 1);
    }
    for (std::uint32_t count = 1; count <= 16; ++count) {
        for (std::uint64_t pixel = 0; pixel < 100; ++pixel) {
            std::uint32_t parts[16];
            shadow::shuffledAll(count, base::mix(pixel), parts);
            for (std::uint32_t part = 0; part < count; ++part)
                REQUIRE(parts[part] == shadow::shuffled(part, count, base::mix(pixel)));
        }
    }
    // Every part comes first as often: 64 pixels a part, give or take 4 deviations.
    int first[16] = {};
    for (std::uint64_t pixel = 0; pixel < 1024; ++pixel)
        ++first[shadow::shuffled(0, 16, base::mix(pixel))];
    for (const int n : first)
        CHECK(std::abs(n - 64) < 4 * 8);
}

TEST_CASE("points that share a pixel have a better mean", "[shadow][statistical]") {
    const ShadowMap map = halfPlane();
    constexpr int kPixels = 400, kPoints = 16;
    std::vector<glm::dvec3> points;
    std::vector<double> expected(kPixels, 0.0);
    for (int p = 0; p < kPixels; ++p) {
        for (int i = 0; i < kPoints; ++i) {
            // A pixel is a hundredth of the penumbra wide.
            const double x = -0.3 + 0.6 * (p + 0.01 * (i % 4) / 4 * kPixels) / kPixels;
            points.push_back({x, 0.0015 * (i / 4) + 0.001, -kReceiverZ});
            expected[std::size_t(p)] += blockedFrom(x) / kPoints;
        }
    }
    for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
        for (const int samples : {1, 4, 16}) {
            const auto rms = [&](int pointsPerPixel, const std::uint32_t* numbers) {
                ShadowOptions options;
                options.method = method;
                options.samples = samples;
                options.pointsPerPixel = pointsPerPixel;
                options.pixelPoints = numbers;
                std::vector<float> found(points.size());
                shadowFactors(map, map.info().light, points.data(), nullptr,
                              points.size(), found.data(), options);
                double sum = 0.0;
                for (int p = 0; p < kPixels; ++p) {
                    double mean = 0.0;
                    for (int i = 0; i < kPoints; ++i)
                        mean += double(found[std::size_t(p * kPoints + i)]) / kPoints;
                    const double error = mean - expected[std::size_t(p)];
                    sum += error * error;
                }
                return std::sqrt(sum / kPixels);
            };
            const double alone = rms(1, nullptr), shared = rms(kPoints, nullptr);
            INFO("samples " << samples << ": rms " << alone << " " << shared);
            // Sixteen independent points of N samples err a quarter of what one does;
            // an edge over N x 16 stratified ones by their power of 3/4, an eighth. That
            // the points lie apart costs some of the difference.
            CHECK(shared < 0.75 * alone);
            // The same in any order, if the points' numbers say so.
            std::vector<std::uint32_t> numbers(points.size());
            std::iota(numbers.begin(), numbers.end(), 0u);
            CHECK(rms(kPoints, numbers.data()) == shared);
        }
    }
}

TEST_CASE("a point's samples do not depend on where in a batch its pixel is",
          "[shadow]") {
    const ShadowMap map = halfPlane();
    ShadowOptions options;
    options.samples = 4;
    options.pointsPerPixel = 3;
    std::vector<glm::dvec3> points;
    std::vector<std::uint32_t> numbers;
    for (std::uint32_t i = 0; i < 300; ++i) {
        points.push_back({-0.3 + 0.002 * i, 0.0, -kReceiverZ});
        numbers.push_back(i);
    }
    const auto answers = [&] {
        options.pixelPoints = numbers.data();
        std::vector<float> found(points.size());
        shadowFactors(map, map.info().light, points.data(), nullptr, points.size(),
                      found.data(), options);
        return found;
    };
    for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
        options.method = method;
        std::vector<float> forwards = answers();
        std::reverse(points.begin(), points.end());
        std::reverse(numbers.begin(), numbers.end());
        std::vector<float> backwards = answers();
        std::reverse(backwards.begin(), backwards.end());
        CHECK(forwards == backwards);
        std::reverse(points.begin(), points.end());
        std::reverse(numbers.begin(), numbers.end());
        // Points of a pixel that do not follow each other.
        const auto turn = [&](auto& values) {  // of a hundred pixels of three
            auto turned = values;
            for (std::size_t i = 0; i < values.size(); ++i)
                turned[i] = values[i % 100 * 3 + i / 100];
            values = turned;
        };
        const std::vector<glm::dvec3> pointsBefore = points;
        const std::vector<std::uint32_t> numbersBefore = numbers;
        turn(points), turn(numbers);
        const std::vector<float> apart = answers();
        turn(forwards);
        CHECK(forwards == apart);
        points = pointsBefore, numbers = numbersBefore;
    }
}

TEST_CASE("a query refuses pixels of no or too many points", "[shadow][bad-input]") {
    const ShadowMap map = halfPlane();
    ShadowOptions options;
    for (const int n : {0, -1, kMaxPointsPerPixel + 1}) {
        options.pointsPerPixel = n;
        const Status fine = checkQuery(map, map.info().light, options);
        REQUIRE_FALSE(fine);
        CHECK(fine.error().message.find("points per pixel") != std::string::npos);
        // Unchecked it is answered as if it were in range.
        float found = 0.5f;
        const glm::dvec3 point(-0.5, 0, -kReceiverZ);
        shadowFactors(map, map.info().light, &point, nullptr, 1, &found, options);
        CHECK(found == 1.0f);
    }
    options.pointsPerPixel = kMaxPointsPerPixel;
    CHECK(checkQuery(map, map.info().light, options));
}

TEST_CASE("single queries share no pixel", "[shadow]") {
    const ShadowMap map = halfPlane();
    ShadowOptions options, shared;
    options.samples = shared.samples = 4;
    shared.pointsPerPixel = 16;
    for (int i = 0; i < 100; ++i) {
        const glm::dvec3 point(-0.3 + 0.006 * i, 0.01, -kReceiverZ);
        CHECK(shadowFactor(map, map.info().light, point, {}, shared) ==
              shadowFactor(map, map.info().light, point, {}, options));
    }
}
