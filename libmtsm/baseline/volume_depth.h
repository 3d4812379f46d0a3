// volume_depth.h - the optical depth of a volume along a line, exactly: density times
// length, summed over the voxels that the line crosses.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <unordered_map>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::baseline {

class VolumeDepth {
  public:
    /// Copies the densities.
    explicit VolumeDepth(const VolumeView& volume);

    /// From `from` along `delta`, world: to its end, or on for ever if `endless`. Stops
    /// counting beyond `enough`.
    [[nodiscard]] double along(glm::dvec3 from, glm::dvec3 delta, bool endless,
                               double enough) const noexcept;

    /// [blocks + density] bytes.
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    struct BlockHash {
        std::size_t operator()(glm::ivec3 block) const noexcept;
    };
    std::unordered_map<glm::ivec3, std::uint32_t, BlockHash> blocks_;  // in blocks
    std::vector<float> density_;
    glm::dmat4 gridFromWorld_{1.0};  // voxel (i, j, k) covers [i, i + 1) and so on
    glm::ivec3 lowBlock_{0}, highBlock_{0};  // in blocks
    double extinction_ = 0.0;
};

}  // namespace mtsm::baseline
