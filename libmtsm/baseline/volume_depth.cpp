#include "baseline/volume_depth.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <glm/vec4.hpp>
#include <limits>

#include "base/sampling.h"

namespace mtsm::baseline {
namespace {

/// A line q + s d.
struct Line {
    glm::dvec3 q, d;
};

/// visit(cell, from, to) for the cells, `side` wide, of low..high that the line crosses
/// between the parameters s and end, in order, until it returns false.
template <typename Visit>
void walkCells(const Line& line, double s, double end, double side, glm::ivec3 low,
               glm::ivec3 high, const Visit& visit) {
    glm::ivec3 cell;
    for (int c = 0; c < 3; ++c)
        cell[c] = int(std::clamp(std::floor((line.q[c] + s * line.d[c]) / side),
                                 double(low[c]), double(high[c])));
    for (;;) {
        // Each border's parameter is computed anew: no error adds up.
        int axis = 0;
        double leaves = std::numeric_limits<double>::infinity();
        for (int c = 0; c < 3; ++c) {
            if (line.d[c] == 0.0) continue;
            const double border = side * (cell[c] + (line.d[c] > 0.0 ? 1 : 0));
            const double at = (border - line.q[c]) / line.d[c];
            if (at < leaves) {
                leaves = at;
                axis = c;
            }
        }
        const double to = std::clamp(leaves, s, end);
        if (!visit(cell, s, to) || leaves >= end) return;
        cell[axis] += line.d[axis] > 0.0 ? 1 : -1;
        if (cell[axis] < low[axis] || cell[axis] > high[axis]) return;
        s = to;
    }
}

/// Narrows [s, end] to where the line is within the box; false if that is nowhere.
bool clip(const Line& line, glm::dvec3 low, glm::dvec3 high, double& s, double& end) {
    for (int c = 0; c < 3; ++c) {
        if (line.d[c] == 0.0) {
            if (line.q[c] < low[c] || line.q[c] > high[c]) return false;
            continue;
        }
        const double a = (low[c] - line.q[c]) / line.d[c],
                     b = (high[c] - line.q[c]) / line.d[c];
        s = std::max(s, std::min(a, b));
        end = std::min(end, std::max(a, b));
    }
    return s < end;
}

}  // namespace

std::size_t VolumeDepth::BlockHash::operator()(glm::ivec3 block) const noexcept {
    std::uint64_t key = 0;
    for (int c = 0; c < 3; ++c)
        key = base::mix(key + std::uint32_t(block[c]));
    return std::size_t(key);
}

VolumeDepth::VolumeDepth(const VolumeView& volume)
    : density_(volume.density,
               volume.density + volume.blockCount * VolumeView::kBlockVoxels),
      extinction_(volume.extinction) {
    const double determinant = glm::determinant(volume.worldFromIndex);
    if (volume.blockCount == 0 || !(std::abs(determinant) > 0.0) ||
        !std::isfinite(determinant))
        return;  // no blocks: nothing is there
    gridFromWorld_ = glm::inverse(volume.worldFromIndex);
    gridFromWorld_[3] += glm::dvec4(0.5, 0.5, 0.5, 0.0);
    lowBlock_ = glm::ivec3(std::numeric_limits<int>::max());
    highBlock_ = glm::ivec3(std::numeric_limits<int>::min());
    blocks_.reserve(volume.blockCount);
    for (std::size_t i = 0; i < volume.blockCount; ++i) {
        const glm::ivec3 block = volume.blocks[i] >> 3;
        blocks_.emplace(block, std::uint32_t(i));
        lowBlock_ = glm::min(lowBlock_, block);
        highBlock_ = glm::max(highBlock_, block);
    }
}

double VolumeDepth::along(glm::dvec3 from, glm::dvec3 delta, bool endless,
                          double enough) const noexcept {
    constexpr int kSide = VolumeView::kBlockSide;
    if (blocks_.empty()) return 0.0;
    const Line line{gridFromWorld_ * glm::dvec4(from, 1.0),
                    gridFromWorld_ * glm::dvec4(delta, 0.0)};
    double s = 0.0, end = endless ? std::numeric_limits<double>::infinity() : 1.0;
    if (!clip(line, double(kSide) * glm::dvec3(lowBlock_),
              double(kSide) * (glm::dvec3(highBlock_) + 1.0), s, end))
        return 0.0;
    const double perDensity = extinction_ * glm::length(delta);
    double depth = 0.0;
    walkCells(line, s, end, kSide, lowBlock_, highBlock_,
              [&](glm::ivec3 block, double in, double out) {
                  const auto found = blocks_.find(block);
                  if (found == blocks_.end()) return true;
                  const float* voxels =
                      &density_[found->second * std::size_t(VolumeView::kBlockVoxels)];
                  const glm::ivec3 corner = kSide * block;
                  walkCells(line, in, out, 1.0, corner, corner + (kSide - 1),
                            [&](glm::ivec3 voxel, double a, double b) {
                                const glm::ivec3 i = voxel - corner;
                                depth += (b - a) * perDensity *
                                         voxels[(i.z * kSide + i.y) * kSide + i.x];
                                return true;
                            });
                  return depth < enough;
              });
    return depth;
}

std::uint64_t VolumeDepth::memoryBytes() const noexcept {
    return density_.size() * sizeof(float) + blocks_.size() * 32;
}

}  // namespace mtsm::baseline
