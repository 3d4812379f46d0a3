// volume_depth.h - the optical depth of a volume along a ray, from a copy of the volume.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "mtsm/scene.h"
#include "raster/volume_walk.h"

namespace mtsm::baseline {

class VolumeDepth {
  public:
    explicit VolumeDepth(const VolumeView& volume);
    VolumeDepth(VolumeDepth&&) noexcept = default;  // arrays stay where they are

    /// From `from` along `delta`, world: to its end, or on for ever if `endless`.
    [[nodiscard]] double along(glm::dvec3 from, glm::dvec3 delta,
                               bool endless) const noexcept;
    /// Of the copy, without the tree over its blocks.
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    std::vector<glm::ivec3> blocks_;
    std::vector<float> density_;
    raster::VolumeIndex index_;               // over the copy
    std::optional<raster::CellsFrom> cells_;  // nothing: a flat volume
};

}  // namespace mtsm::baseline
