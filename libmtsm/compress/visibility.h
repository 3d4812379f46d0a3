// visibility.h - the visibility behind each of a pixel's samples.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mtsm/compress.h"

namespace mtsm::compress {

/// What a sample does to the visibility.
enum class Wall : std::uint8_t {
    none,   ///< every channel that had something left still has
    some,   ///< a channel has nothing left behind it
    reset,  ///< nor has any other: behind it, all start again at 1
};

/// The samples of a pixel that are kept, front to back.
struct Visibility {
    std::uint32_t channels = 1;
    std::vector<float> z;
    std::vector<double>
        v[3];  ///< [channels][samples]: behind the sample; 0 or >= FLT_MIN
    std::vector<Wall> wall;

    [[nodiscard]] std::uint32_t size() const noexcept { return std::uint32_t(z.size()); }
    /// Does the accumulation start again at this sample?
    [[nodiscard]] bool startsAt(std::uint32_t sample) const noexcept {
        return sample == 0 || wall[sample - 1] == Wall::reset;
    }
    /// In front of the sample.
    [[nodiscard]] double before(std::uint32_t sample,
                                std::uint32_t channel) const noexcept {
        return startsAt(sample) ? 1.0 : v[channel][sample - 1];
    }
};

/// Replaces what `out` holds. Leaves out copies of opaque samples and what lies behind
/// the last reset, and counts them.
void accumulate(const PixelSamples& samples, std::uint32_t channels, std::uint32_t resets,
                Visibility& out, CompressReport& report);

/// A layer of the samples up to `end` that the layer before it does not hold.
struct Span {
    std::uint32_t end = 0;
    float v[3] = {};  ///< [channels]
};

}  // namespace mtsm::compress
