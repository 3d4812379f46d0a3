// bits.h - how many bits are set, without a call: std::popcount is one where processors
// may lack the instruction.
#pragma once
#include <cstdint>

namespace mtsm::base {

/// Of 16 bits.
[[nodiscard]] constexpr int countBits(std::uint16_t bits) noexcept {
    std::uint32_t x = bits;
    x -= x >> 1 & 0x5555u;
    x = (x & 0x3333u) + (x >> 2 & 0x3333u);
    x = (x + (x >> 4)) & 0x0f0fu;
    return int((x + (x >> 8)) & 0x1fu);
}

}  // namespace mtsm::base
