// near_chunks.h - triangles and segments in straight space into chunks on grids of 16
// bits.
//
// Triangles, and segments as well, are sorted by size, in classes of a factor of four,
// and in a class along a Hilbert curve through (u, v, log z in pixel footprints), and
// then taken 16 at a time; fewer where 16 would reach so far that their grid became too
// coarse. Sizes and steps in w are counted in footprints of a pixel, too: w = w0
// footprints is w0 times what w changes where z changes by a pixel's side.
//
//   largest triangle   a chunk reaches over   its steps are at most
//   64 footprints      255                    1/128 (u, v: 1/256)
//   more               2047                   1/16  (u, v: 1/32)
//
// A triangle that alone reaches further in w has a chunk of its own: its plane is off by
// no more than 1/40 of a pixel's footprint nevertheless, because where depth changes so
// fast an error in w is hardly one across the plane.
#pragma once
#include <vector>

#include "bake/near_segments.h"
#include "bake/near_triangles.h"

namespace mtsm::bake_detail {

/// Different corners of a chunk of 16 triangles: hardly any has fewer; a closed mesh's
/// chunks commonly have so many; those of cards of two triangles.
inline constexpr int kFewestPoints = 10, kMeshPoints = 20, kCardPoints = 32;

/// Chunks, and which triangle each place in them holds: [chunks][16].
struct NearPacking {
    NearField field;
    std::vector<std::uint32_t> triangle;
};

/// The same for any order of triangles (that differ) and any number of threads. Time
/// grows as n log n.
NearPacking packTriangles(const std::vector<NearTriangle>& triangles,
                          const Projection& projection);
NearField packNear(const std::vector<NearTriangle>& triangles,
                   const Projection& projection);
NearHair packNear(const std::vector<NearSegment>& segments, const Projection& projection);

}  // namespace mtsm::bake_detail
