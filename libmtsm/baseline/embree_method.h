// embree_method.h - ray tracing of the casters themselves as a row of the comparison
// [Cook84]: the strongest rival that a map has, Embree with few samples.
//
// mode fixed: every point takes `samples` of its own.
// mode adaptive: every point takes `samples`; where these do not all agree (each of them
//   sees the light wholly or each of them not at all) it goes on to `most`. With
//   samples = most it is fixed.
// mode pixel: the points of a pixel share one pattern of samples times points cells of
// the
//   light, of which each takes `samples`, so that together they cover the light evenly.
//   Pixels of one point share one as well, up to 16 that follow each other (interleaved
//   sampling). Each point's own answer is as unbiased as in mode fixed.
//
// All of them cost nothing below the receiver's horizon. One build serves every light and
// all settings.
#pragma once
#include <cstdint>

#include "baseline/method.h"

namespace mtsm::baseline {

/// Which samples a point takes: [first, first + samples) of the sequence with this key.
struct SamplePattern {
    std::uint64_t key = 0;
    std::uint32_t first = 0;
};

/// The patterns of mode pixel, one per point.
[[nodiscard]] std::vector<SamplePattern> sharedPatterns(const Receivers& at,
                                                        std::uint32_t samples,
                                                        std::uint32_t seed);

}  // namespace mtsm::baseline
