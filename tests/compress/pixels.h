// pixels.h - samples of single pixels, and what the format's text says that samples and
// layers mean, evaluated by brute force in double.
#pragma once
#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "mtsm/compress.h"

namespace mtsm::test {

/// One sample as a test writes it down.
struct Sample {
    float z = 1.0f;
    std::array<float, 3> opacity{};

    Sample(float depth, float a) : z(depth), opacity{a, a, a} {}
    Sample(float depth, std::array<float, 3> a) : z(depth), opacity(a) {}
};
using Pixel = std::vector<Sample>;

inline SampleList planes(const Pixel& pixel, std::uint32_t channels) {
    SampleList list;
    for (const Sample& s : pixel) {
        list.z.push_back(s.z);
        for (std::uint32_t c = 0; c < channels; ++c)
            list.opacity[c].push_back(s.opacity[c]);
    }
    return list;
}

inline PixelSamples borrow(const SampleList& list) {
    PixelSamples pixel;
    pixel.count = list.size();
    pixel.z = list.z.data();
    for (int c = 0; c < 3; ++c)
        pixel.opacity[c] = list.opacity[c].data();
    return pixel;
}

inline LayerList compressed(const Pixel& pixel, const CompressOptions& options,
                            CompressReport& report) {
    LayerList layers;
    PixelCompressor(options).compress(borrow(planes(pixel, options.channels)), layers,
                                      report);
    return layers;
}

inline LayerList compressed(const Pixel& pixel, const CompressOptions& options) {
    CompressReport report;
    return compressed(pixel, options, report);
}

/// A function of depth that changes at `z`, ascending, to value[i] from z[i] on. Behind
/// what makes all channels dark accumulation starts again: there it is 1.
struct Steps {
    std::vector<double> z;
    std::vector<std::array<double, 3>> value;
    std::vector<std::size_t> step;  ///< [samples]: where in `value` it is

    void add(double depth, const std::array<double, 3>& v, bool dark) {
        step.push_back(z.size());
        z.push_back(depth);
        value.push_back(v);
        if (!dark) return;
        z.push_back(depth);
        value.push_back({1.0, 1.0, 1.0});
    }
    [[nodiscard]] double depth(std::size_t sample) const { return z[step[sample]]; }
    [[nodiscard]] std::array<double, 3> behind(std::size_t sample) const {
        return value[step[sample]];
    }

    [[nodiscard]] std::array<double, 3> at(double depth) const {
        const auto i = std::upper_bound(z.begin(), z.end(), depth) - z.begin();
        return i > 0 ? value[std::size_t(i - 1)] : std::array<double, 3>{1.0, 1.0, 1.0};
    }
};

/// V: the fraction of light left just behind z, accumulated since the last reset.
inline Steps visibility(const Pixel& pixel, std::uint32_t channels) {
    Steps steps;
    std::array<double, 3> v{1.0, 1.0, 1.0};
    for (const Sample& s : pixel) {
        bool dark = true;
        for (std::uint32_t c = 0; c < channels; ++c) {
            v[c] *= 1.0 - double(s.opacity[c]);
            if (v[c] < double(FLT_MIN)) v[c] = 0.0;
            dark = dark && v[c] == 0.0;
        }
        steps.add(s.z, v, dark);
        if (dark) v = {1.0, 1.0, 1.0};
    }
    return steps;
}

/// V': the n samples of a layer sit at z_before + j (z - z_before) / n, those of a
/// pixel's first layer all at its z, and each takes its share of what the layer loses; of
/// what goes dark, the last sample is what does it.
inline Steps visibility(const LayerList& layers, std::uint32_t channels) {
    Steps steps;
    bool restart = true;
    for (std::size_t i = 0; i < layers.size(); ++i) {
        const double z = layers.z[i], zBefore = i > 0 ? layers.z[i - 1] : z;
        const std::uint32_t n = layers.n[i];
        bool dark = true;
        for (std::uint32_t j = 1; j <= n; ++j) {
            std::array<double, 3> v{};
            for (std::uint32_t c = 0; c < channels; ++c) {
                const double before = restart ? 1.0 : double(layers.v[c][i - 1]);
                const double after = layers.v[c][i];
                if (j == n) dark = dark && after == 0.0;
                if (j == n || before == 0.0)
                    v[c] = after;
                else if (after > 0.0)
                    v[c] = before * std::pow(after / before, double(j) / n);
                else
                    v[c] = before;
            }
            steps.add(j == n ? z : zBefore + j * (z - zBefore) / n, v, j == n && dark);
        }
        restart = dark;
    }
    return steps;
}

/// Largest |V - V'| on both sides of every step of both, and at the step.
inline double largestDifference(const Steps& a, const Steps& b, std::uint32_t channels) {
    double largest = 0.0;
    for (const Steps* steps : {&a, &b}) {
        for (const double z : steps->z) {
            for (const double depth :
                 {std::nextafter(z, 0.0), z, std::nextafter(z, HUGE_VAL)}) {
                const auto va = a.at(depth), vb = b.at(depth);
                for (std::uint32_t c = 0; c < channels; ++c)
                    largest = std::max(largest, std::abs(va[c] - vb[c]));
            }
        }
    }
    return largest;
}

/// Random numbers that are the same everywhere.
class Noise {
  public:
    explicit Noise(std::uint64_t seed) : random_(seed) {}
    double unit() { return double(random_() >> 11) * 0x1p-53; }
    double between(double a, double b) { return a + (b - a) * unit(); }
    std::uint32_t below(std::uint32_t n) { return std::uint32_t(unit() * n); }

  private:
    std::mt19937_64 random_;
};

inline void sortByDepth(Pixel& pixel) {
    std::stable_sort(pixel.begin(), pixel.end(), [](const Sample& a, const Sample& b) {
        return a.z != b.z ? a.z < b.z : a.opacity < b.opacity;
    });
}

/// `count` samples at random depths in [from, to], opacities in [low, high].
inline Pixel randomPixel(std::uint64_t seed, std::uint32_t count, double from, double to,
                         double low, double high, bool coloured = false) {
    Noise noise(seed);
    Pixel pixel;
    for (std::uint32_t i = 0; i < count; ++i) {
        const auto z = float(noise.between(from, to));
        std::array<float, 3> a{};
        a.fill(float(noise.between(low, high)));
        for (int c = 1; c < 3 && coloured; ++c)
            a[c] = float(noise.between(low, high));
        pixel.push_back({z, a});
    }
    sortByDepth(pixel);
    return pixel;
}

}  // namespace mtsm::test
