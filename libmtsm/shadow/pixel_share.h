// pixel_share.h - which part of the samples of a pixel a point takes.
//
// The points of a pixel share one sequence of samples (base/sampling.h): each takes as
// many that follow each other, a set that is well spread for itself, and all of them
// together are one as well. Who takes which is shuffled: else the place in the pixel
// would go with the place on the light, and what both move (an edge) would be seen
// unevenly.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "base/sampling.h"
#include "mtsm/shadow.h"

namespace mtsm::shadow {

/// A round of shuffling, each a permutation of the numbers of so many bits.
[[nodiscard]] inline std::uint32_t shuffledOnce(std::uint32_t part, int bits,
                                                std::uint64_t key, int round) noexcept {
    const auto more = std::uint32_t(std::rotr(key, 11 * round));
    part = ((part ^ more) * ((more >> 4) | 1u)) & ((1u << bits) - 1);
    return part ^ (part >> ((bits + 1) / 2));
}
inline constexpr int kShuffleRounds = 6;

/// A number below `count` for each part below it, another order for every key.
[[nodiscard]] inline std::uint32_t shuffled(std::uint32_t part, std::uint32_t count,
                                            std::uint64_t key) noexcept {
    if (count <= 1) return 0;
    const int bits = std::bit_width(count - 1);
    do {
        for (int round = 0; round < kShuffleRounds; ++round)
            part = shuffledOnce(part, bits, key, round);
    } while (part >= count);
    return part;
}

/// The same of all parts at once: of a power of two of them in vectors.
inline void shuffledAll(std::uint32_t count, std::uint64_t key,
                        std::uint32_t* parts) noexcept {
    const bool whole = std::has_single_bit(count) && count > 1;
    for (std::uint32_t part = 0; part < count; ++part)
        parts[part] = whole ? part : shuffled(part, count, key);
    const int bits = std::bit_width(count - 1);
    for (int round = 0; whole && round < kShuffleRounds; ++round) {
        for (std::uint32_t part = 0; part < count; ++part)
            parts[part] = shuffledOnce(parts[part], bits, key, round);
    }
}

/// Whose rays count as neighbours of a point's, for it is the mean of a pixel that
/// counts: its own alone (opaque maps of small pieces, as leaves are, whom finer texels
/// cost more than they gain), the root of as many as the pixel has (media), or all of
/// them (other opaque maps, sheets); tests/bench/NOTES.md.
enum class Neighbours : std::uint8_t { own, root, pixel };

/// Texels may be as wide as so many rays to the light are apart: those of a point, and,
/// where they are few, of its neighbours.
[[nodiscard]] inline float neighbours(std::uint32_t samples, std::uint32_t pointsPerPixel,
                                      Neighbours whose) noexcept {
    constexpr float kFew = 64.0f;
    const auto own = float(samples), points = float(pointsPerPixel);
    if (whose == Neighbours::own) return own;
    const float more = whose == Neighbours::pixel ? points : std::sqrt(points);
    return std::max(own, std::min(own * more, kFew));
}

/// Of a batch with pixelPoints, or without.
struct PixelPoint {
    std::uint64_t pixel;
    std::uint32_t number;  ///< of the point in the pixel, below options.pointsPerPixel

    PixelPoint(const ShadowOptions& options, std::size_t i) noexcept {
        const auto count = std::uint32_t(options.pointsPerPixel);
        const std::uint64_t n = options.pixelPoints ? options.pixelPoints[i] : i;
        if (n <= 0xffffffffu) {  // much faster
            pixel = std::uint32_t(n) / count;
            number = std::uint32_t(n) % count;
        } else {
            pixel = n / count;
            number = std::uint32_t(n % count);
        }
    }
};

/// What a point has of its pixel's samples.
struct PixelShare {
    std::uint64_t key;   ///< of the pixel
    std::uint32_t part;  ///< below options.pointsPerPixel

    PixelShare(const ShadowOptions& options, const PixelPoint& point) noexcept
        : PixelShare(options, point, keyOf(options, point)) {}
    /// `pixelKey`: keyOf the point's pixel.
    PixelShare(const ShadowOptions& options, const PixelPoint& point,
               std::uint64_t pixelKey) noexcept
        : key(pixelKey),
          part(shuffled(point.number, std::uint32_t(options.pointsPerPixel),
                        base::mix(pixelKey))) {}
    [[nodiscard]] static std::uint64_t keyOf(const ShadowOptions& options,
                                             const PixelPoint& point) noexcept {
        return base::mix(base::mix(std::uint64_t(options.seed) + 1) ^ point.pixel);
    }
};

/// Where in which sequence a part begins: of a sequence the first kMaxSamples are well
/// spread, and as many from a multiple of a power of two on.
struct SequencePart {
    std::uint32_t sequence, first;

    SequencePart(std::uint32_t part, std::uint32_t samples) noexcept {
        const std::uint32_t each = std::bit_ceil(samples);
        const std::uint32_t perSequence = std::max(1u, std::uint32_t(kMaxSamples) / each);
        sequence = part / perSequence;
        first = part % perSequence * each;
    }
};

}  // namespace mtsm::shadow
