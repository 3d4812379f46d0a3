// near_sheets.h - the triangles that a map of sheets was baked from, beside its layers:
// leaves on cards, glass, and the opaque ones among them.
//
// They lie in chunks in straight space, as those of a map of opaque triangles
// (mtsm/near_field.h). All triangles of a chunk have one texture, whose texels say how
// opaque they are; a constant opacity is a texture of one texel. Texture coordinates are
// low + step * uv, one grid a chunk; they run as those of mtsm/opacity_texture.h, and a
// texture is looked up as that is where it is magnified: interpolated, unfiltered.
//
// With w = 1 / z a coordinate times w is linear in straight space, with w = -z (an
// orthographic map) the coordinate is.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mtsm/near_field.h"
#include "mtsm/opacity_texture.h"

namespace mtsm {

/// How opaque the triangles of a chunk are, and where.
struct NearSheetChunk {
    std::uint32_t texture = 0;     ///< of NearSheets::textures
    std::uint32_t triangles = 16;  ///< 1..16; the chunk's others do not count
    float low[2] = {};             ///< [u, v] of the texture, finite
    float step[2] = {};            ///< [u, v], >= 0; low + 65535 * step is finite
    /// [corner][u, v][triangle]
    std::uint16_t uv[3][2][NearChunk::kTriangles] = {};

    [[nodiscard]] float at(int corner, int axis, int triangle) const noexcept {
        return low[axis] + step[axis] * float(uv[corner][axis][triangle]);
    }
};

/// Chunks in a row, mostly in less than that: texture coordinates that corners have in
/// common are kept once, as NearChunks keeps points. A chunk comes out as it went in.
class NearSheetChunks {
  public:
    /// Of one chunk, all but its coordinates.
    struct Place {
        std::uint32_t texture;
        std::uint16_t triangles, points;  ///< points: 1..32, or 48: every corner
        float low[2], step[2];            ///< as NearSheetChunk's
        std::uint64_t first;              ///< of its words
    };
    static_assert(sizeof(Place) == 32);

    void push_back(const NearSheetChunk& chunk);
    /// Those of some others, which are empty from then on.
    void append(NearSheetChunks* parts, std::size_t count);
    void shrink_to_fit();

    [[nodiscard]] std::size_t size() const noexcept { return places_.size(); }
    [[nodiscard]] bool empty() const noexcept { return places_.empty(); }
    [[nodiscard]] NearSheetChunk operator[](std::size_t i) const noexcept;
    [[nodiscard]] ChunkIterator<NearSheetChunks> begin() const noexcept {
        return {this, 0};
    }
    [[nodiscard]] ChunkIterator<NearSheetChunks> end() const noexcept {
        return {this, size()};
    }

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return places_.size() * sizeof(Place) + words_.size() * sizeof(std::uint16_t);
    }
    /// Of so many chunks with so many different pairs of coordinates each.
    [[nodiscard]] static std::uint64_t memoryBytes(std::uint64_t chunks,
                                                   int points) noexcept;

    // What queries read.

    [[nodiscard]] const Place& place(std::size_t i) const noexcept { return places_[i]; }
    /// [u, v] of a corner, in steps.
    [[nodiscard]] std::array<std::uint16_t, 2> uv(std::size_t i, int corner,
                                                  int triangle) const noexcept {
        const Place& place = places_[i];
        const std::uint16_t* q = words_.data() + place.first;
        std::size_t n = 0;
        if (place.points == NearChunks::kCorners) {
            n = std::size_t(NearChunk::kTriangles * corner + triangle);
        } else if (place.points > 1) {
            n = std::size_t(NearChunks::pointOf(q[triangle], corner));
            q += NearChunk::kTriangles;
        }
        return {q[n], q[place.points + n]};
    }

  private:
    std::vector<Place> places_;
    std::vector<std::uint16_t> words_;
};

struct NearTexture {
    std::uint32_t width = 1, height = 1;  ///< 1..OpacityImage::kMostTexels
    TextureWrap wrapU = TextureWrap::repeat, wrapV = TextureWrap::repeat;
    float cutoff = -1.0f;  ///< as OpacityImage::cutoff; finite
    float opacity = 1.0f;  ///< multiplies what texels say, in [0, 1]
    /// [height][width], upper row first, in 255ths. None after releaseLayers()
    /// (mtsm/shadow.h).
    std::vector<std::uint8_t> texels = {255};
    /// [height + 2][width + 2]: the same between what `wrap` says lies beyond the
    /// borders. ShadowMap::create builds them, whatever is there.
    std::vector<std::uint8_t> bordered = {};
};

/// All triangles of one face; of its window and some way around it.
struct NearSheets {
    NearField triangles;
    NearSheetChunks chunks;  ///< [triangles.chunks]
    std::vector<NearTexture> textures;

    [[nodiscard]] bool empty() const noexcept { return chunks.empty(); }
};

/// What so many chunks, of triangles with so many points and pairs of coordinates each,
/// and a texture of this size take in memory.
[[nodiscard]] std::uint64_t nearSheetBytes(std::uint64_t chunks, int points) noexcept;
[[nodiscard]] std::uint64_t nearTextureBytes(std::uint32_t width,
                                             std::uint32_t height) noexcept;
/// What all of it takes.
[[nodiscard]] std::uint64_t memoryBytes(const NearSheets& sheets) noexcept;

}  // namespace mtsm
