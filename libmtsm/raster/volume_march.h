// volume_march.h - samples of the pixels whose centre rays meet a fog volume.
//
//     VolumeMarcher marcher(projection, grid, 0.005);
//     if (auto s = marcher.add(volume); !s) return s;
//
// Every voxel of density > 0 that a centre ray crosses is one sample: its opacity is
// 1 - exp(-extinction * density * length), length being that of the ray's chord in the
// voxel in world units, and its depth that of the chord's middle. Where it would take
// more than a step of the light that reached the volume it is several, each taking as
// much of that: at any depth the samples in front have taken what the fog has, to a step
// or so (several in single voxels of an optical depth beyond 10). Altogether there is no
// more than a sample for each voxel and one for each step of 1.
//
// The samples of a ray multiply to its exact transmittance. What would be less opaque
// than 2^-24 waits for the next voxel of the ray; what is left of that behind the last
// one is dropped.
//
// With s x s centre rays per pixel each one's optical depths are divided by s * s: the
// pixel's transmittance is then the geometric mean of theirs. Their samples lie at s * s
// different places of their chords, lest chords of one length take in step.
#pragma once
#include <cstdint>
#include <functional>

#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "raster/sample_grid.h"

namespace mtsm::raster {

/// What went in. Rows that a grid gives up meanwhile may count in part.
struct VolumeCounts {
    std::uint64_t volumes = 0;
    std::uint64_t flat = 0;     ///< of those, skipped: their transform is singular
    std::uint64_t voxels = 0;   ///< crossed, of density > 0, over all rays
    std::uint64_t samples = 0;  ///< added
    /// Of the volumes, those with a block that reaches out of the window.
    std::uint64_t leavesWindow = 0;
};

class VolumeMarcher {
  public:
    /// `grid` must outlive the marcher; `step` is > 0. `afterBatch`, if any, is called
    /// from the calling thread with the number of voxels crossed so far; an Error stops
    /// the work.
    VolumeMarcher(const Projection& projection, SampleGrid& grid, double step,
                  std::function<Status(std::uint64_t)> afterBatch = {})
        : projection_(projection),
          grid_(grid),
          step_(step),
          afterBatch_(std::move(afterBatch)) {}

    /// Marches all of a volume through the rows that the grid wants; its arrays are not
    /// needed after the call. Takes 100 to 400 bytes per block meanwhile.
    Status add(const VolumeView& volume);

    [[nodiscard]] const VolumeCounts& counts() const noexcept { return counts_; }

  private:
    Projection projection_;
    SampleGrid& grid_;
    double step_;
    std::function<Status(std::uint64_t)> afterBatch_;
    VolumeCounts counts_;
};

}  // namespace mtsm::raster
