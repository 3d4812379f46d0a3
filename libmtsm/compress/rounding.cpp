#include "compress/rounding.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "base/parallel.h"

namespace mtsm::compress {
namespace {

constexpr int kMantissaBits = 23, kBias = 127, kInfinityExponent = 255;

/// Low bits of a float in [2^e, 2^(e + 1)) that may go, if it may be off by `error`.
int bitsToDrop(double error, int e) {
    if (!(error > 0.0)) return 0;
    // The step is at most twice the error, and what is dropped that step by a float's.
    return std::clamp(std::ilogb(2.0 * error) - (e - kMantissaBits), 0,
                      kMantissaBits - 1);
}

/// To the nearest number whose low bits are 0; what would become infinite stays.
float rounded(float x, int dropped) {
    if (dropped == 0) return x;
    const auto bits = std::bit_cast<std::uint32_t>(x);
    const std::uint32_t half = 1u << (dropped - 1);
    const std::uint32_t result = (bits + half) >> dropped << dropped;
    return result >> kMantissaBits < kInfinityExponent ? std::bit_cast<float>(result) : x;
}

}  // namespace

float roundLayers(const MapInfo& info, double share, MapFace& face) {
    std::array<std::uint8_t, kInfinityExponent> ofDepth{};  // by biased exponent
    for (int biased = 1; biased < kInfinityExponent; ++biased) {
        const double low = std::ldexp(1.0, biased - kBias);
        const double threshold = double(info.bias) + double(info.biasPerDepth) * low;
        ofDepth[std::size_t(biased)] =
            std::uint8_t(bitsToDrop(share * threshold, biased - kBias));
    }
    const int ofVisibility = bitsToDrop(share * double(info.toleranceAsked), 0);

    std::vector<float> changes(face.tiles.size());
    base::parallelFor(std::size_t(0), face.tiles.size(), [&](std::size_t i) {
        for (float& z : face.tiles[i].z)
            z = rounded(z, ofDepth[std::bit_cast<std::uint32_t>(z) >> kMantissaBits]);
        for (float& v : face.tiles[i].v) {
            if (!(v >= std::numeric_limits<float>::min())) continue;  // 0, or hardly more
            const float before = v;
            v = rounded(v, ofVisibility);
            changes[i] = std::max(changes[i], std::abs(v - before));
        }
    });
    return face.tiles.empty() ? 0.0f : *std::max_element(changes.begin(), changes.end());
}

}  // namespace mtsm::compress
