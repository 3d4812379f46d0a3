// hilbert.h - where a point lies along a Hilbert curve through space [Skilling04].
//
// Points that follow each other along the curve are neighbours, so what is sorted by it
// falls into compact runs, wherever a run begins.
#pragma once
#include <array>
#include <cstdint>

namespace mtsm::bake_detail {

/// Place of cell x, each coordinate below 2^bits, on the curve through all 8^bits cells;
/// bits is 1..21.
[[nodiscard]] inline std::uint64_t hilbertPlace(std::array<std::uint32_t, 3> x,
                                                int bits) noexcept {
    const std::uint32_t top = 1u << (bits - 1);
    // From the coarsest cell to the finest, undo how the curve turns and mirrors in it.
    for (std::uint32_t bit = top; bit > 1; bit >>= 1) {
        const std::uint32_t below = bit - 1;
        for (std::uint32_t& axis : x) {
            if (axis & bit) {
                x[0] ^= below;
            } else {
                const std::uint32_t swapped = (x[0] ^ axis) & below;
                x[0] ^= swapped;
                axis ^= swapped;
            }
        }
    }
    // What is left is a Gray code.
    x[1] ^= x[0];
    x[2] ^= x[1];
    std::uint32_t flip = 0;
    for (std::uint32_t bit = top; bit > 1; bit >>= 1) {
        if (x[2] & bit) flip ^= bit - 1;
    }
    std::uint64_t place = 0;
    for (int bit = bits - 1; bit >= 0; --bit) {
        for (const std::uint32_t axis : x)
            place = place << 1 | ((axis ^ flip) >> bit & 1);
    }
    return place;
}

}  // namespace mtsm::bake_detail
