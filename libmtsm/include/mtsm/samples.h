// samples.h - what the centre rays of pixels meet, before it is made layers.
//
// Depths are light-space depths in world units, opacities the part of the light that a
// sample stops, in [0, 1], per channel.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mtsm {

/// Many samples, channel by channel.
struct SampleList {
    std::vector<float> z;           ///< [samples]
    std::vector<float> opacity[3];  ///< [channels][samples]

    [[nodiscard]] std::size_t size() const noexcept { return z.size(); }
    void clear() noexcept {
        z.clear();
        for (auto& plane : opacity)
            plane.clear();
    }
};

/// One pixel's samples, borrowed.
struct PixelSamples {
    std::size_t count = 0;
    const float* z = nullptr;      ///< [count], finite, > 0, ascending
    const float* opacity[3] = {};  ///< [channels][count], in [0, 1]
};

}  // namespace mtsm
