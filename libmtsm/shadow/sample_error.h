// sample_error.h - how far a mean over a light's samples is from the mean over the light,
// told from the samples alone; and in which parts they are taken.
//
// Samples are the first N of a (0, 2)-sequence (base/sampling.h), sorted so that four
// that follow each other lie in neighbouring strata. What such a quad's visibilities
// differ among themselves is the variance within the strata and a little more: the
// collapsed strata estimator [Cochran77, sec. 5A.12]. Along an edge it is too large,
// because the strata of a (0, 2)-sequence are balanced against each other as well: by a
// constant factor, whatever the number of samples. Where blockers are finer than a
// stratum it is right. Which of the two it is the quads tell: how large their variance is
// beside that of all samples.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <glm/vec2.hpp>

#include "mtsm/shadow.h"

namespace mtsm::shadow {

inline constexpr int kQuad = 4;  ///< samples that are compared with each other

/// What samples are sorted by: neighbours in the unit square get numbers close to each
/// other.
[[nodiscard]] inline std::uint32_t placeOfSample(glm::dvec2 u) noexcept {
    std::uint32_t place = 0;
    const auto x = std::uint32_t(u.x * 0x1p16), y = std::uint32_t(u.y * 0x1p16);
    for (int bit = 15; bit >= 0; --bit)
        place = place << 2 | (y >> bit & 1) << 1 | (x >> bit & 1);
    return place;
}

/// The sum of squares that `lit` of `samples` visibilities in a quad, which are 0 or 1,
/// stand for: samples times their variance.
[[nodiscard]] inline float quadSpread(int lit, int samples) noexcept {
    return samples > 1 ? float(lit * (samples - lit)) / float(samples - 1) : 0.0f;
}
/// The same of visibilities of any kind.
[[nodiscard]] inline float quadSpread(const float* v, int samples) noexcept {
    if (samples < 2) return 0.0f;
    float mean = 0.0f, squares = 0.0f;
    for (int i = 0; i < samples; ++i)
        mean += v[i];
    mean /= float(samples);
    for (int i = 0; i < samples; ++i)
        squares += (v[i] - mean) * (v[i] - mean);
    return squares * float(samples) / float(samples - 1);
}

/// In how many parts a query takes its samples: after each it may have enough.
struct SampleSteps {
    static constexpr int kMost = 6;
    int count = 1;
    std::uint32_t end[kMost] = {1};  ///< samples of this part and all before it

    [[nodiscard]] std::uint32_t first(int step) const noexcept {
        return step > 0 ? end[step - 1] : 0;
    }
    /// `samples`: of a point that needs all.
    static SampleSteps of(const ShadowOptions& options, std::uint32_t samples) noexcept {
        SampleSteps steps;
        steps.count = 0;
        auto end = std::uint32_t(std::clamp(options.firstSamples, 1, kMaxSamples));
        end = (end + 15) / 16 * 16;  // whole groups of rays
        if (options.targetError > 0.0f) {
            for (; end < samples; end *= 4)
                steps.end[steps.count++] = end;
        } else if (options.adaptive && end < samples) {
            steps.end[steps.count++] = end;
        }
        // A few samples at the end would tell too little of the error of all: there are
        // no fewer than in the part before, or that is a part of the last.
        if (const int last = steps.count - 1;
            last >= 0 && samples - steps.end[last] < steps.end[last] - steps.first(last))
            steps.count = last;
        steps.end[steps.count++] = samples;
        return steps;
    }
};

/// What is kept of visibilities to tell their error.
struct Seen {
    float sum = 0.0f, squares = 0.0f;  ///< of all, and of their squares
    float spread = 0.0f;               ///< sum of quadSpread() over the last step
};

/// Expected |mean found - mean over the light| of `samples` visibilities, of which the
/// last step begins with number `first`. Nothing is known of fewer than a quad: NaN.
[[nodiscard]] inline float sampleError(const Seen& seen, std::uint32_t first,
                                       std::uint32_t samples) noexcept {
    if (samples < std::uint32_t(kQuad)) return NAN;
    // Measured (tests/bench/NOTES.md): mean errors over the root of the estimated
    // variance, along edges and where blockers are finer than strata; the latter is the
    // normal distribution's sqrt(2 / pi). The least share is a quarter of what an edge
    // has: it may run between the quads.
    const float edge = first > 0 ? 0.36f : 0.43f, leastShare = 0.6f;
    constexpr float kFine = 0.8f;
    const auto n = float(samples);
    const float mean = seen.sum / n;
    const float whole = (seen.squares / n - mean * mean) * n / (n - 1.0f);
    if (!(whole > 1e-7f)) return 0.0f;
    const float within = seen.spread / float(samples - first);
    const float share = std::clamp(within / whole, leastShare / std::sqrt(n), 1.0f);
    const float share4 = share * share * share * share;
    return std::sqrt(share * whole / n) * (edge + (kFine - edge) * share4);
}

}  // namespace mtsm::shadow
