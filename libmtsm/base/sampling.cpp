#include "base/sampling.h"

#include <algorithm>
#include <array>
#include <bit>

namespace mtsm::base {
namespace {

constexpr std::uint32_t reverseBits(std::uint32_t x) {
    x = (x >> 16) | (x << 16);
    x = ((x & 0xff00ff00u) >> 8) | ((x & 0x00ff00ffu) << 8);
    x = ((x & 0xf0f0f0f0u) >> 4) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x & 0xccccccccu) >> 2) | ((x & 0x33333333u) << 2);
    return ((x & 0xaaaaaaaau) >> 1) | ((x & 0x55555555u) << 1);
}

// The second coordinate of the sequence: direction numbers v_0 = 1/2, v_{k+1} = v_k ^
// (v_k >> 1), xor-ed over the set bits of the index. Kept with its bits reversed, as the
// scramble wants them.
constexpr std::uint32_t kTableSize = 4096;
constexpr auto kSobolReversed = [] {
    std::array<std::uint32_t, kTableSize> table{};
    for (std::uint32_t i = 0; i < kTableSize; ++i) {
        std::uint32_t value = 0, direction = 1u << 31;
        for (std::uint32_t bits = i; bits; bits >>= 1) {
            if (bits & 1) value ^= direction;
            direction ^= direction >> 1;
        }
        table[i] = reverseBits(value);
    }
    return table;
}();

/// Owen scrambling of a bit-reversed number: multiplying by an even constant and xor-ing
/// lets a bit depend on lower bits alone, which are the higher digits of what it stands
/// for [Laine11, sec. 3].
std::uint32_t scrambleReversed(std::uint32_t x, std::uint32_t seed) {
    x += seed;
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return x;
}

}  // namespace

std::uint64_t mix(std::uint64_t x) noexcept {
    // Two multiply-and-fold rounds; the constants are the fractions of the golden ratio
    // and of sqrt(2), made odd.
    x ^= x >> 32;
    x *= 0x9e3779b97f4a7c15u;
    x ^= x >> 29;
    x *= 0x6a09e667f3bcc909u;
    return x ^ (x >> 32);
}

std::uint64_t pointKey(glm::dvec3 p, std::uint32_t seed) noexcept {
    std::uint64_t key = mix(seed + 1);
    for (int i = 0; i < 3; ++i)
        key = mix(key ^ std::bit_cast<std::uint64_t>(p[i] + 0.0));
    return key;
}

glm::dvec2 SquareSequence::operator()(std::uint32_t i) const noexcept {
    const std::uint32_t x = reverseBits(scrambleReversed(i, seedX_));
    const std::uint32_t y =
        reverseBits(scrambleReversed(kSobolReversed[i % kTableSize], seedY_));
    return {x * 0x1p-32, y * 0x1p-32};
}

void SquareSequence::points(const std::uint32_t* index, std::size_t count, float* x,
                            float* y) const noexcept {
    // In blocks on the stack and without branches: so a compiler can do several at once.
    // It converts signed integers best: halves, exact up to the float's rounding.
    constexpr std::size_t kBlock = 64;
    std::uint32_t a[kBlock], b[kBlock];
    for (std::size_t begin = 0; begin < count; begin += kBlock) {
        const std::size_t n = std::min(kBlock, count - begin);
        for (std::size_t k = 0; k < n; ++k) {
            a[k] = index[begin + k];
            b[k] = kSobolReversed[a[k] % kTableSize];
        }
        for (std::size_t k = 0; k < n; ++k)
            x[begin + k] =
                float(std::int32_t(reverseBits(scrambleReversed(a[k], seedX_)) >> 1)) *
                0x1p-31f;
        for (std::size_t k = 0; k < n; ++k)
            y[begin + k] =
                float(std::int32_t(reverseBits(scrambleReversed(b[k], seedY_)) >> 1)) *
                0x1p-31f;
    }
}

}  // namespace mtsm::base
