// near_field.h - the triangles that a map was baked from, beside its layers.
//
// A texel cannot resolve what lies next to a receiver. A map whose casters are all opaque
// triangles may therefore hold them as well, in the space in which its rays are followed:
//
// Straight space. (u, v, w) of a face: raster position u and v in pixels, and w = 1 / z
// (perspective) or -z (orthographic), which grows towards the eye. Lines and planes of
// the world are lines and planes there.
//
// Triangles lie in chunks of 16, which share a grid: a coordinate is low + step * corner.
// The bake makes step a power of two and low a multiple of it, so that this is exact in
// float, and a corner that several chunks of the same step have in common is the same
// point in all of them. Steps are at most 1/32 of a pixel in u and v, mostly 1/256.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mtsm {

/// Up to 16 triangles that lie close together. Where there are fewer, the last one is
/// repeated to the end. Which way round the corners run means nothing.
struct NearChunk {
    static constexpr int kTriangles = 16;

    float low[3] = {};   ///< [u, v, w], finite
    float step[3] = {};  ///< [u, v, w], >= 0; low + 65535 * step is finite
    std::uint16_t corner[3][3][kTriangles] = {};  ///< [corner][u, v, w][triangle]

    [[nodiscard]] float at(int c, int axis, int triangle) const noexcept {
        return low[axis] + step[axis] * float(corner[c][axis][triangle]);
    }
    /// Those before the repeats of the last one.
    [[nodiscard]] int triangles() const noexcept;
};
static_assert(sizeof(NearChunk) == 312);

/// What 16 chunks, or 16 nodes of the level below, reach over. Where there are fewer, low
/// is +infinity and high is -infinity.
struct NearBoxes {
    static constexpr int kChildren = 16;

    float low[3][kChildren], high[3][kChildren];  ///< [u, v, w][child]
};

/// All triangles of one face; of its window and some way around it.
struct NearField {
    std::vector<NearChunk> chunks;
    /// Child i of node n at level 0 is chunk 16 n + i, at level k node 16 n + i of level
    /// k - 1; the last level has one node. ShadowMap::create builds them, whatever is
    /// there.
    std::vector<std::vector<NearBoxes>> levels;

    [[nodiscard]] bool empty() const noexcept { return chunks.empty(); }
    [[nodiscard]] std::uint64_t triangles() const noexcept;
};

/// What so many chunks take in memory, boxes included.
[[nodiscard]] std::uint64_t nearFieldBytes(std::uint64_t chunks) noexcept;

}  // namespace mtsm
