// mesh_chunk.h - consecutive triangles of a mesh and the vertices that they use.
//
//     const MeshChunk chunk(mesh, first, count);
//     for (size_t i = 0; i < chunk.vertices(); ++i) v[i] = transform(chunk.position(i));
//     for (size_t i = 0; i < 3 * count; ++i) use(v[chunk.corner(i)]);
//
// Each vertex is transformed once, in memory that is bounded by the chunk, not the mesh.
// Where the indices are spread too thinly over the vertices for that (more than three
// vertices per triangle), corners are transformed one by one instead.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>

#include "mtsm/scene.h"

namespace mtsm::raster {

class MeshChunk {
  public:
    /// Triangles [first, first + count) of the mesh, which must outlive the chunk.
    MeshChunk(const MeshView& mesh, std::size_t first, std::size_t count)
        : positions_(mesh.positions), indices_(mesh.indices + 3 * first) {
        std::uint32_t lowest = 0xffffffffu, highest = 0;
        for (std::size_t i = 0; i < 3 * count; ++i) {
            lowest = std::min(lowest, indices_[i]);
            highest = std::max(highest, indices_[i]);
        }
        const std::size_t range = std::size_t(highest) - lowest + 1;
        shared_ = count > 0 && range <= 3 * count;
        lowest_ = shared_ ? lowest : 0;
        vertices_ = shared_ ? range : 3 * count;
    }

    /// To transform: at most 3 per triangle.
    [[nodiscard]] std::size_t vertices() const noexcept { return vertices_; }
    [[nodiscard]] glm::vec3 position(std::size_t vertex) const noexcept {
        return positions_[shared_ ? lowest_ + vertex : indices_[vertex]];
    }
    /// Which of them is corner i % 3 of the chunk's triangle i / 3.
    [[nodiscard]] std::size_t corner(std::size_t i) const noexcept {
        return shared_ ? indices_[i] - lowest_ : i;
    }

  private:
    const glm::vec3* positions_;
    const std::uint32_t* indices_;
    std::size_t vertices_ = 0;
    std::uint32_t lowest_ = 0;
    bool shared_ = false;
};

}  // namespace mtsm::raster
