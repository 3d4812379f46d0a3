// hilbert.h - where a point lies along a Hilbert curve through space [Skilling04].
//
// Points that follow each other along the curve are neighbours, so what is sorted by it
// falls into compact runs, wherever a run begins.
#pragma once
#include <array>
#include <cstdint>

namespace mtsm::bake_detail {

/// Bit i goes to bit 3 i; 21 bits.
[[nodiscard]] inline std::uint64_t everyThirdBit(std::uint64_t x) noexcept {
    x = (x | x << 32) & 0x001f00000000ffff;
    x = (x | x << 16) & 0x001f0000ff0000ff;
    x = (x | x << 8) & 0x100f00f00f00f00f;
    x = (x | x << 4) & 0x10c30c30c30c30c3;
    return (x | x << 2) & 0x1249249249249249;
}

/// Place of cell x, each coordinate below 2^bits, on the curve through all 8^bits cells;
/// bits is 1..21.
[[nodiscard]] inline std::uint64_t hilbertPlace(std::array<std::uint32_t, 3> x,
                                                int bits) noexcept {
    // From the coarsest cell to the finest, undo how the curve turns and mirrors in it.
    for (int bit = bits - 1; bit > 0; --bit) {
        const std::uint32_t below = (1u << bit) - 1;
        for (std::uint32_t& axis : x) {
            const std::uint32_t mirrored = 0u - (axis >> bit & 1);  // all bits or none
            const std::uint32_t swapped = (x[0] ^ axis) & below & ~mirrored;
            x[0] ^= swapped | (below & mirrored);
            axis ^= swapped;
        }
    }
    // What is left is a Gray code.
    x[1] ^= x[0];
    x[2] ^= x[1];
    std::uint32_t flip = 0;
    for (int bit = bits - 1; bit > 0; --bit) {
        const std::uint32_t set = 0u - (x[2] >> bit & 1);
        flip ^= ((1u << bit) - 1) & set;
    }
    return everyThirdBit(x[0] ^ flip) << 2 | everyThirdBit(x[1] ^ flip) << 1 |
           everyThirdBit(x[2] ^ flip);
}

}  // namespace mtsm::bake_detail
