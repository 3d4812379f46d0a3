// near_field.h - the triangles and strands that a map was baked from, beside its layers.
//
// A texel cannot resolve what lies next to a receiver. A map whose casters are all opaque
// triangles and strands of hair may therefore hold them as well, in the space in which
// its rays are followed:
//
// Straight space. (u, v, w) of a face: raster position u and v in pixels, and w = 1 / z
// (perspective) or -z (orthographic), which grows towards the eye. Lines and planes of
// the world are lines and planes there.
//
// Triangles lie in chunks of 16, which share a grid: a coordinate is low + step * corner.
// The bake makes step a power of two and low a multiple of it, so that this is exact in
// float, and a corner that several chunks of the same step have in common is the same
// point in all of them. Steps are at most 1/32 of a pixel in u and v, mostly 1/256.
//
// Segments of strands lie in chunks of 16 of their own kind, on the same sort of grid.
// Each is a ribbon that faces the ray, from end to end; `half` is half its width over its
// depth (perspective) or half its width in world units (orthographic), which is linear
// between the ends in straight space, as width is in the world.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mtsm/hair_chunks.h"
#include "mtsm/near_chunks.h"

namespace mtsm {

/// What 16 chunks, or 16 nodes of the level below, reach over. Where there are fewer, low
/// is +infinity and high is -infinity.
struct NearBoxes {
    static constexpr int kChildren = 16;

    float low[3][kChildren], high[3][kChildren];  ///< [u, v, w][child]
};

/// All triangles of one face; of its window and some way around it.
struct NearField {
    NearChunks chunks;
    /// Child i of node n at level 0 is chunk 16 n + i, at level k node 16 n + i of level
    /// k - 1; the last level has one node. ShadowMap::create builds them, whatever is
    /// there.
    std::vector<std::vector<NearBoxes>> levels;

    [[nodiscard]] bool empty() const noexcept { return chunks.empty(); }
    [[nodiscard]] std::uint64_t triangles() const noexcept;
};

/// All segments of strands of one face, likewise.
struct NearHair {
    NearHairChunks chunks;
    /// As NearField::levels. A chunk's box reaches two widths around its segments.
    std::vector<std::vector<NearBoxes>> levels;

    [[nodiscard]] bool empty() const noexcept { return chunks.empty(); }
    [[nodiscard]] std::uint64_t segments() const noexcept;
};

/// What it takes in memory, boxes included.
[[nodiscard]] std::uint64_t memoryBytes(const NearField& field) noexcept;
[[nodiscard]] std::uint64_t memoryBytes(const NearHair& hair) noexcept;
/// What so many chunks take, boxes included; of triangles with so many points each, of
/// segments of one opacity in steps too fine for less.
[[nodiscard]] std::uint64_t nearFieldBytes(std::uint64_t chunks, int points) noexcept;
[[nodiscard]] std::uint64_t nearHairBytes(std::uint64_t chunks) noexcept;

}  // namespace mtsm
