// Errors against closed forms and against plain sums in long double.
#include "baseline/errors.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <random>

using namespace mtsm::baseline;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

std::vector<float> randomFloats(std::size_t count, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::vector<float> all(count);
    for (float& v : all)
        v = float(double(random() >> 11) * 0x1p-53);
    return all;
}

/// The same from its definition, slowly.
Errors slowErrors(const std::vector<float>& found, const std::vector<float>& truth,
                  const std::vector<std::uint8_t>& mask,
                  const std::vector<float>& scale) {
    std::vector<long double> all;
    long double sum = 0, bias = 0, squares = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        if (found[i] != found[i] || (!mask.empty() && mask[i] == 0)) continue;
        const long double d = ((long double)found[i] - truth[i]) *
                              (scale.empty() ? 1.0L : (long double)scale[i]);
        bias += d;
        all.push_back(d < 0 ? -d : d);
        sum += all.back();
    }
    std::sort(all.begin(), all.end());
    Errors e;
    e.count = all.size();
    if (all.empty()) return e;
    const auto n = (long double)all.size();
    for (const long double d : all)
        squares += (d - sum / n) * (d - sum / n);
    e.mean = double(sum / n);
    e.bias = double(bias / n);
    e.deviation = double(std::sqrt(squares / n));
    e.p95 = double(all[95 * (all.size() - 1) / 100]);
    e.p99 = double(all[99 * (all.size() - 1) / 100]);
    e.largest = double(all.back());
    return e;
}

void checkSame(const Errors& a, const Errors& b) {
    CHECK(a.count == b.count);
    CHECK(a.mean == Approx(b.mean).epsilon(1e-12).margin(1e-15));
    CHECK(a.bias == Approx(b.bias).epsilon(1e-12).margin(1e-15));
    // What is left of a difference of squares.
    CHECK(a.deviation == Approx(b.deviation).margin(1e-8));
    CHECK(a.p95 == Approx(b.p95).epsilon(1e-12));
    CHECK(a.p99 == Approx(b.p99).epsilon(1e-12));
    CHECK(a.largest == Approx(b.largest).epsilon(1e-12));
}

}  // namespace

TEST_CASE("errors of a ramp have their closed forms", "[baseline][exact]") {
    // Differences 0, 1, ..., 100 percent, half of them to the dark: mean 1/2, variance
    // (n^2 - 1) / 12 of steps.
    std::vector<float> found, truth;
    for (int i = 0; i <= 100; ++i) {
        const float d = float(i) / 128;  // exact
        found.push_back(i % 2 ? d : 0.0f);
        truth.push_back(i % 2 ? 0.0f : d);
    }
    const Errors e = measureErrors(found, truth);
    CHECK(e.count == 101);
    CHECK(e.mean == Approx(50.0 / 128));
    CHECK(e.deviation == Approx(std::sqrt((101.0 * 101 - 1) / 12) / 128));
    CHECK(e.p95 == 95.0 / 128);
    CHECK(e.p99 == 99.0 / 128);
    CHECK(e.largest == 100.0 / 128);
    // 1 + 3 + ... + 99 less 0 + 2 + ... + 100.
    CHECK(e.bias == Approx((2500.0 - 2550.0) / 128 / 101));
}

TEST_CASE("errors are what plain sums and sorting give", "[baseline]") {
    for (const std::size_t count :
         {1u, 2u, 19u, 20u, 21u, 60u, 61u, 101u, 1000u, 4097u}) {
        INFO(count << " values");
        auto found = randomFloats(count, count), truth = randomFloats(count, count + 1);
        const auto scale = randomFloats(count, count + 2);
        std::vector<std::uint8_t> mask(count);
        for (std::size_t i = 0; i < count; ++i)
            mask[i] = std::uint8_t(i % 3 ? 0 : i % 256);
        checkSame(measureErrors(found, truth), slowErrors(found, truth, {}, {}));
        checkSame(measureErrors(found, truth, mask), slowErrors(found, truth, mask, {}));
        checkSame(measureErrors(found, truth, {}, scale),
                  slowErrors(found, truth, {}, scale));
        for (std::size_t i = 1; i < count; i += 7)
            found[i] = kNan;
        checkSame(measureErrors(found, truth, mask, scale),
                  slowErrors(found, truth, mask, scale));
    }
}

TEST_CASE("without a value that counts there is no error", "[baseline]") {
    for (const Errors& e : {measureErrors({}, {}), measureErrors({kNan, kNan}, {0, 1}),
                            measureErrors({0.5f, 1}, {0, 0}, {0, 0}),
                            measureErrors({kNan, 1}, {0, 0}, {1, 0})}) {
        CHECK(e.count == 0);
        CHECK(e.mean == 0.0);
        CHECK(e.largest == 0.0);
    }
}

TEST_CASE("one value and equal values have no deviation", "[baseline]") {
    const Errors one = measureErrors({0.75f}, {0.5f});
    CHECK(one.mean == 0.25);
    CHECK(one.deviation == 0.0);
    CHECK(one.p95 == 0.25);
    CHECK(one.largest == 0.25);
    CHECK(one.bias == 0.25);
    const Errors same =
        measureErrors(std::vector<float>(1000, 0.3f), std::vector<float>(1000, 0.6f));
    CHECK(same.deviation < 1e-8);
    CHECK(same.bias == Approx(-same.mean));
}

TEST_CASE("of runs of neighbours the mean is as uncertain as their means differ",
          "[baseline][exact]") {
    // Means .1 and .3 of runs of 4: deviation .2 / sqrt(2), by sqrt(2) runs .1; a part
    // of 8 of 32 values leaves sqrt(3 / 4) of it.
    const std::vector<float> truth(8, 0.0f);
    const std::vector<float> found = {0.1f, 0.1f, -0.1f, 0.1f, 0.3f, -0.3f, kNan, 0.3f};
    CHECK(standardError(found, truth, 4, 32) == Approx(0.1 * std::sqrt(0.75)));
    CHECK(standardError(found, truth, 4, 8) == 0.0);        // all of them
    CHECK(std::isinf(standardError(found, truth, 8, 32)));  // one run tells nothing
    CHECK(std::isinf(standardError({kNan}, {0.0f}, 1, 9)));
    CHECK(standardError(truth, truth, 4, 32) == 0.0);
}
