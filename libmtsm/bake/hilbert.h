// hilbert.h - where points lie along a Hilbert curve through space [Skilling04].
//
// Points that follow each other along the curve are neighbours, so what is sorted by it
// falls into compact runs, wherever a run begins.
#pragma once
#include <cstddef>
#include <cstdint>

namespace mtsm::bake_detail {

/// Places of cells on the curve through all 8^bits of them: cell i is (x[i], y[i], z[i]),
/// each coordinate below 2^bits; bits is 1..21. Coordinates are worked on where they lie,
/// and are not what they were.
void hilbertPlaces(std::uint32_t* x, std::uint32_t* y, std::uint32_t* z,
                   std::size_t count, int bits, std::uint64_t* places) noexcept;

}  // namespace mtsm::bake_detail
