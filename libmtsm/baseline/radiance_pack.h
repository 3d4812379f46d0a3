// radiance_pack.h - the textures of two triangles in one [Heckbert97, sec. 3.8].
//
// A triangle is the lower left half of its own texture; a second one of the same size is
// turned round and takes the upper right half of the packed texture. That is somewhat
// longer on its shorter side: bilinear lookups within a triangle also read texels just
// beyond its long edge, and those must not be the other's.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <glm/common.hpp>
#include <glm/vec2.hpp>
#include <vector>

namespace mtsm::baseline {

/// Size of the texture that holds two triangles of the size W x H, W <= H: wider by G.
/// In row j the first reads up to column W - W j / H + (1 + W / H) / 2 and the second
/// from column W + G - 1 - (that of row H - 1 - j), so G must exceed 2 + 2 W / H.
[[nodiscard]] inline glm::uvec2 packedSize(glm::uvec2 size) noexcept {
    if (size.x <= size.y) return {size.x + 3 + 2 * size.x / size.y, size.y};
    return {size.x, size.y + 3 + 2 * size.y / size.x};
}

/// Where a lookup at texture coordinates `uv` of a triangle goes, texture coordinates of
/// the packed texture.
[[nodiscard]] inline glm::dvec2 packedCoordinates(glm::dvec2 uv, glm::uvec2 size,
                                                  bool second) noexcept {
    const glm::dvec2 at = uv * glm::dvec2(size) / glm::dvec2(packedSize(size));
    return second ? 1.0 - at : at;
}

/// The packed texture; texels that neither triangle reads are zero. `second` may be
/// empty.
template <typename T>
[[nodiscard]] std::vector<T> packTriangles(const std::vector<T>& first,
                                           const std::vector<T>& second,
                                           glm::uvec2 size) {
    const glm::uvec2 packed = packedSize(size);
    std::vector<T> values(std::size_t(packed.x) * packed.y, T(0.0f));
    const glm::uvec2 end = glm::min(size + 1u, packed);
    for (std::uint64_t y = 0; y < end.y; ++y) {
        for (std::uint64_t x = 0; x < end.x; ++x) {
            // x / W + y / H < 1 + 1 / (2 W) + 1 / (2 H): some lookup reads it.
            const std::uint64_t W = size.x, H = size.y;
            if (2 * (x * H + y * W) > 2 * W * H + W + H) break;
            const std::size_t from = std::min(y, H - 1) * W + std::min(x, W - 1);
            const std::size_t to = y * packed.x + x;
            values[to] = first[from];
            if (!second.empty()) values[values.size() - 1 - to] = second[from];
        }
    }
    return values;
}

}  // namespace mtsm::baseline
