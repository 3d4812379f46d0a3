#include "baseline/volume_depth.h"

#include <glm/geometric.hpp>
#include <limits>

namespace mtsm::baseline {
namespace {

VolumeView withArrays(VolumeView volume, const std::vector<glm::ivec3>& blocks,
                      const std::vector<float>& density) {
    volume.blocks = blocks.data();
    volume.density = density.data();
    return volume;
}

}  // namespace

VolumeDepth::VolumeDepth(const VolumeView& volume)
    : blocks_(volume.blocks, volume.blocks + volume.blockCount),
      density_(volume.density,
               volume.density + volume.blockCount * VolumeView::kBlockVoxels),
      index_(withArrays(volume, blocks_, density_)),
      cells_(index_.cellsFromWorld()) {}

double VolumeDepth::along(glm::dvec3 from, glm::dvec3 delta,
                          bool endless) const noexcept {
    if (!cells_ || index_.empty()) return 0.0;
    double sum = 0.0;
    index_.walk(cells_->ray(from, delta), 0.0,
                endless ? std::numeric_limits<double>::infinity() : 1.0,
                [&](float density, double t0, double t1) { sum += density * (t1 - t0); });
    return sum * glm::length(delta) * double(index_.view().extinction);
}

std::uint64_t VolumeDepth::memoryBytes() const noexcept {
    return blocks_.size() * sizeof(glm::ivec3) + density_.size() * sizeof(float);
}

}  // namespace mtsm::baseline
