// predict.h - what the filters gradient and delta guess of a layer's bits, so that only
// the difference has to be stored.
//
// Layers with the same number in neighbouring pixels mostly belong to one surface. Were
// it a plane, and its depths integers, left + above - above left would be exact [as the
// plane predictor of lossless image coders has it; Weinberger00, "LOCO-I", sec. III A].
// Hair and smoke have no surfaces; there the layer before in the same pixel is nearest.
// Bits of positive floats are ordered as the floats are, and differences are taken modulo
// 2^32, so nothing can overflow and every bit pattern comes back.
#pragma once
#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>

namespace mtsm::format {

/// Small differences of either sign become small numbers: 0, -1, 1, -2, ... -> 0, 1,
/// 2, 3.
[[nodiscard]] constexpr std::uint32_t zigzag(std::uint32_t d) noexcept {
    return (d << 1) ^ (0u - (d >> 31));
}
[[nodiscard]] constexpr std::uint32_t unzigzag(std::uint32_t r) noexcept {
    return (r >> 1) ^ (0u - (r & 1u));
}

/// Calls code(i, guess) for each layer i of a tile in turn; it returns the layer's bits,
/// and a decoder's has written elements[i] then. `begin` as in Tile, `elements` [layers]
/// of 32 bits. `along`: a layer that is not a pixel's first is guessed to be the one
/// before it; all others as section 6.4 of the specification says.
template <bool along, typename Element, typename Code>
void forEachGuess(std::span<const std::uint32_t> begin, std::uint32_t width,
                  const Element* elements, const Code& code) {
    const auto bits = [&](std::uint32_t i) {
        return std::bit_cast<std::uint32_t>(elements[i]);
    };
    const auto rows = std::uint32_t(begin.size() - 1) / width;
    for (std::uint32_t y = 0; y < rows; ++y) {
        const std::uint32_t* const row = begin.data() + std::size_t(y) * width;
        const std::uint32_t* const rowAbove = y > 0 ? row - width : nullptr;
        // Where the lists of the neighbours begin, and how long they are.
        std::uint32_t left = 0, lefts = 0, corner = 0, corners = 0;
        for (std::uint32_t x = 0; x < width; ++x) {
            const std::uint32_t first = row[x], count = row[x + 1] - first;
            const std::uint32_t above = rowAbove ? rowAbove[x] : 0;
            const std::uint32_t aboves = rowAbove ? rowAbove[x + 1] - above : 0;
            const std::uint32_t sideways = along ? std::min(count, 1u) : count;
            const std::uint32_t onPlane = std::min({sideways, lefts, aboves, corners});
            std::uint32_t k = 0;
            for (; k < onPlane; ++k)
                code(first + k, bits(left + k) + bits(above + k) - bits(corner + k));
            for (; k < std::min(sideways, lefts); ++k)
                code(first + k, bits(left + k));
            for (; k < std::min(sideways, aboves); ++k)
                code(first + k, bits(above + k));
            std::uint32_t before = k > 0 ? bits(first + k - 1) : 0;
            for (; k < count; ++k)
                before = code(first + k, before);
            left = first, lefts = count;
            corner = above, corners = aboves;
        }
    }
}

}  // namespace mtsm::format
