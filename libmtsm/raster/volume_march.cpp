// VolumeMarcher: tiles in batches, a ray per pixel or subsample.
#include "raster/volume_march.h"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <limits>
#include <vector>

#include "base/parallel.h"
#include "raster/light_from_object.h"
#include "raster/volume_walk.h"

namespace mtsm::raster {
namespace {

// Enough for the threads of a large machine; few enough to settle the grid often.
constexpr std::uint32_t kBatchTiles = 64;
// Below it a float visibility near 1 cannot tell the sample from none.
constexpr double kLeastDepth = 0x1p-24;

/// Pixels [x0, x1) x [y0, y1).
struct PixelBox {
    std::uint32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
    [[nodiscard]] bool empty() const noexcept { return x0 >= x1 || y0 >= y1; }
};

/// The pixels whose rays may meet the volume between near and far: those of its box, or
/// all if that reaches the plane of the eye.
PixelBox pixelsOf(const VolumeIndex& index, const CellsFrom& lightCells,
                  const Projection& projection, const SampleGrid& grid) {
    const glm::dmat3 lightFromCells = glm::inverse(lightCells.linear);
    const double width = grid.width(), height = grid.height();
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    glm::dvec2 low(kInfinity), high(-kInfinity);
    double nearest = kInfinity, farthest = -kInfinity;
    for (unsigned corner = 0; corner < 8; ++corner) {
        const glm::dvec3 at(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
        const glm::dvec3 p =
            lightCells.corner + lightFromCells * (at * index.sizeInCells());
        nearest = std::min(nearest, p.z);
        farthest = std::max(farthest, p.z);
        const glm::dvec2 r = projection.rasterFromLight(p);
        low = glm::min(low, r);
        high = glm::max(high, r);
    }
    if (farthest < projection.near || nearest > projection.far) return {};
    const bool whole = projection.kind == ProjectionKind::perspective &&
                       !(nearest > 1e-9 * std::max(1.0, std::abs(farthest)));
    if (whole) {
        low = {0.0, 0.0};
        high = {width, height};
    }
    const auto clamp = [](double v, double most) {
        return std::uint32_t(std::clamp(v, 0.0, most));
    };
    return {clamp(std::floor(low.x) - 1.0, width), clamp(std::floor(low.y) - 1.0, height),
            clamp(std::ceil(high.x) + 1.0, width),
            clamp(std::ceil(high.y) + 1.0, height)};
}

/// Does a corner of a block lie between near and far, but outside the window?
bool leavesWindow(const VolumeView& view, const LightFromObject& lightFromIndex,
                  const Projection& projection, const SampleGrid& grid) {
    constexpr double kRounding = 1e-6;  // pixels
    for (std::size_t i = 0; i < view.blockCount; ++i) {
        for (int corner = 0; corner < 8; ++corner) {
            const glm::ivec3 at(corner & 1, corner >> 1 & 1, corner >> 2);
            const glm::dvec3 p = lightFromIndex(
                glm::vec3(view.blocks[i] + at * VolumeView::kBlockSide) - 0.5f);
            if (!(p.z > std::max(projection.near, 0.0) && p.z < projection.far)) continue;
            const glm::dvec2 r = projection.rasterFromLight(p);
            if (r.x < -kRounding || r.y < -kRounding || r.x > grid.width() + kRounding ||
                r.y > grid.height() + kRounding)
                return true;
        }
    }
    return false;
}

/// Where the samples of one ray go.
struct RaySink {
    SampleTile& tile;
    VolumeCounts& counts;
    std::uint32_t pixel;
    double step;           ///< most of the light that one sample takes
    double weight;         ///< of the ray in its pixel
    double place;          ///< of samples in their parts, 0 to 1; of each ray another
    double scale = 0.0;    ///< optical depth per unit of density and t
    double visible = 1.0;  ///< of the light, if the pixel's other rays meet the same
    double waiting = 0.0;  ///< optical depth that made no sample yet

    void operator()(float density, double t0, double t1) {
        ++counts.voxels;
        waiting += scale * double(density) * (t1 - t0);
        if (waiting * weight < kLeastDepth) return;
        const double taken = -std::expm1(-waiting), length = (t1 - t0) / waiting;
        const double parts = std::max(1.0, std::ceil(weight * visible * taken / step));
        double begin = 0.0;  // of the part, by optical depth
        for (double i = 1.0; i <= parts; ++i) {
            const double end = i < parts ? -std::log1p(-i / parts * taken) : waiting;
            add(t0 + length * (begin + place * (end - begin)), end - begin);
            begin = end;
        }
        visible *= std::exp(-waiting);
        waiting = 0.0;
    }

  private:
    void add(double z, double depth) {
        const auto o = float(-std::expm1(-weight * depth));
        const float opacities[3] = {o, o, o};
        tile.add(pixel, float(std::clamp(z, double(FLT_MIN), double(FLT_MAX))),
                 opacities);
        ++counts.samples;
    }
};

/// One volume in one grid.
class March {
  public:
    March(const Projection& projection, SampleGrid& grid, double step,
          const VolumeIndex& index, const CellsFrom& lightCells)
        : projection_(projection),
          grid_(grid),
          step_(step),
          index_(index),
          cells_(lightCells),
          pixels_(pixelsOf(index, lightCells, projection, grid)) {}

    /// The tiles that may get samples, row by row.
    [[nodiscard]] std::vector<glm::uvec2> tiles() const {
        constexpr std::uint32_t shift = SampleGrid::kTileShift;
        std::vector<glm::uvec2> tiles;
        if (pixels_.empty()) return tiles;
        for (std::uint32_t ty = pixels_.y0 >> shift; ty <= (pixels_.y1 - 1) >> shift;
             ++ty) {
            if (!grid_.wants(ty)) continue;
            for (std::uint32_t tx = pixels_.x0 >> shift; tx <= (pixels_.x1 - 1) >> shift;
                 ++tx)
                tiles.emplace_back(tx, ty);
        }
        return tiles;
    }

    void tile(glm::uvec2 at, VolumeCounts& counts) const {
        if (!grid_.wants(at.y)) return;
        constexpr std::uint32_t side = SampleGrid::kTileSize;
        SampleTile& tile = grid_.tile(at.x, at.y);
        const std::uint32_t left = at.x * side, top = at.y * side;
        const std::uint32_t right = std::min(left + side, pixels_.x1);
        const std::uint32_t bottom = std::min(top + side, pixels_.y1);
        for (std::uint32_t y = std::max(top, pixels_.y0); y < bottom; ++y) {
            for (std::uint32_t x = std::max(left, pixels_.x0); x < right; ++x)
                pixel({x, y}, tile, (y - top) * tile.width() + (x - left), counts);
        }
    }

  private:
    void pixel(glm::uvec2 at, SampleTile& tile, std::uint32_t inTile,
               VolumeCounts& counts) const {
        const std::uint32_t s = grid_.subsamples();
        const double weight = 1.0 / (double(s) * s);
        for (std::uint32_t j = 0; j < s; ++j) {
            for (std::uint32_t i = 0; i < s; ++i) {
                const glm::dvec2 r =
                    glm::dvec2(at) + (glm::dvec2(i, j) + 0.5) / double(s);
                const double place = weight * (j * s + i + 0.5);
                ray(r, RaySink{tile, counts, inTile, step_, weight, place});
            }
        }
    }

    /// t of a centre ray is depth, whatever the projection.
    void ray(glm::dvec2 raster, RaySink sink) const {
        const bool fromEye = projection_.kind == ProjectionKind::perspective;
        const glm::dvec3 at = projection_.lightFromRaster(raster, 1.0);
        const glm::dvec3 origin = fromEye ? glm::dvec3(0.0) : glm::dvec3(at.x, at.y, 0.0);
        const glm::dvec3 along = fromEye ? at : glm::dvec3(0.0, 0.0, 1.0);
        sink.scale = double(index_.view().extinction) * glm::length(along);
        index_.walk(cells_.ray(origin, along), std::max(projection_.near, 0.0),
                    projection_.far, sink);
    }

    const Projection& projection_;
    SampleGrid& grid_;
    double step_;
    const VolumeIndex& index_;
    const CellsFrom& cells_;
    PixelBox pixels_;
};

}  // namespace

Status VolumeMarcher::add(const VolumeView& volume) {
    ++counts_.volumes;
    const LightFromObject lightFromIndex(projection_, volume.worldFromIndex);
    const VolumeIndex index(volume);
    const auto cells = index.cellsFrom(lightFromIndex.linear, lightFromIndex.origin);
    if (!cells) ++counts_.flat;
    if (!cells || index.empty() || !(volume.extinction > 0.0f)) return {};
    const March march(projection_, grid_, step_, index, *cells);
    counts_.leavesWindow += leavesWindow(volume, lightFromIndex, projection_, grid_);
    const std::vector<glm::uvec2> tiles = march.tiles();
    std::vector<VolumeCounts> counts(kBatchTiles);
    for (std::size_t first = 0; first < tiles.size() && !grid_.overrun();
         first += kBatchTiles) {
        const std::size_t end = std::min(tiles.size(), first + kBatchTiles);
        base::parallelFor(first, end, [&](std::size_t i) {
            VolumeCounts ofTile;
            march.tile(tiles[i], ofTile);
            counts[i - first] = ofTile;
        });
        for (std::size_t i = 0; i < end - first; ++i) {
            counts_.voxels += counts[i].voxels;
            counts_.samples += counts[i].samples;
        }
        grid_.settle();
        if (afterBatch_)
            if (Status s = afterBatch_(counts_.voxels); !s) return s;
    }
    return {};
}

}  // namespace mtsm::raster
