// strand.h - strands of hair into a sample grid, by exact area coverage, in parallel.
//
//     StrandRasteriser raster(projection, grid, afterBatch);
//     for (strands : views) if (auto s = raster.add(strands); !s) return s;
//     if (auto s = raster.finish(); !s) return s;
//
// A strand is a ribbon that faces the eye: between two points a quad whose sides lie half
// the width off the line from point to point, across the view ray. On the raster such a
// quad has straight sides, and how far they are off the line is exact where the width is
// small beside the depth: see halfPixels() in strand.cpp. Consecutive quads share their
// corners (a mitre), so they tile; where a strand turns by more than 120 degrees both
// quads end square instead. The ends of a strand are square. A segment along the view ray
// has no area and casts nothing.
//
// Each quad is cut by the pixel grid; areas are exact but for the rounding of doubles.
// The areas of one strand in one pixel are added up over its consecutive segments, that
// is a run, and a run of area c (1 at most) becomes one sample: opacity a c, a being the
// strand's opacity there, at the depth of the run's centroid. (Means over the run are
// weighted by area; for a perspective projection it is 1/z, linear on the raster, that is
// averaged.) A run ends where the strand leaves the pixel, and where its depth has moved
// by more than kRunFootprints pixel footprints from where the run began: a strand seen
// nearly end-on is several samples. So no strand is too thin to be seen, and the areas in
// all pixels add up to that of the ribbon.
//
// Strands are taken in batches of bounded size, whole, but for one that is larger than a
// batch by itself. They are set up in parallel, slice by slice; each slice sorts its
// segments into bins of the raster; then the bins are drawn in parallel, each by one
// thread and tile by tile, so nothing is locked and nothing is atomic. A tile's samples
// come in the order of the strands for any number of threads. Work runs in the caller's
// oneTBB arena.
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "raster/bins.h"
#include "raster/sample_grid.h"

namespace mtsm::raster {

/// Of a run's depth, from where it began.
inline constexpr double kRunFootprints = 4.0;

/// What became of the strands. Each is counted in at most one of nonFinite, transparent,
/// outside and clipped; those that are in none of them were drawn whole.
struct StrandCounts {
    std::uint64_t strands = 0, segments = 0;
    /// A point or width is NaN, infinite or beyond 1e30, or a width is negative, or an
    /// opacity out of [0, 1].
    std::uint64_t nonFinite = 0;
    std::uint64_t transparent = 0;  ///< opacity or width 0 all along, or a single point
    /// Wholly outside window, near and far; or all of it along the view ray.
    std::uint64_t outside = 0;
    std::uint64_t clipped = 0;  ///< cut by near or far, or reaching out of the window
    /// Of those clipped or outside: what lies between near and far leaves the window.
    std::uint64_t leavesWindow = 0;

    void add(const StrandCounts& other) noexcept;
};

/// A piece of ribbon, at most about kPieceLength pixels long.
struct PreparedSegment {
    /// The ends of its middle line, from the corner of pixel (x0, y0).
    float x[2], y[2];
    /// From either end to one of its sides; the other lies as far the other way.
    float sideX[2], sideY[2];
    float q[2];  ///< 1/z for a perspective projection, z for an orthographic one
    float opacity[2];
    std::uint32_t strand;  ///< counts the strands of its slice
    std::uint32_t order;   ///< along the strand: consecutive pieces have consecutive ones
    /// Pixels of the window that it may touch: not empty.
    std::uint16_t x0, y0, x1, y1;
};

class StrandSetup;
class TileRuns;

class StrandRasteriser {
  public:
    /// `grid` must outlive the rasteriser. `afterBatch`, if any, is called from the
    /// calling thread with the number of segments done; an Error stops the work.
    StrandRasteriser(const Projection& projection, SampleGrid& grid,
                     std::function<Status(std::uint64_t)> afterBatch = {});
    ~StrandRasteriser();

    /// Takes all strands of a view; its arrays are not needed after the call.
    Status add(const StrandsView& strands);
    /// Draws what is left. After it counts() is complete.
    Status finish();

    [[nodiscard]] const StrandCounts& counts() const noexcept { return counts_; }

  private:
    /// Some strands of a batch: set up by one thread, sorted by bin.
    struct Slice {
        std::uint64_t taken = 0;    ///< segments that went in
        std::uint32_t strands = 0;  ///< strands that went in
        std::vector<PreparedSegment> segments;
        std::vector<std::uint32_t> begin;  ///< [bins + 1], into `order`
        std::vector<std::uint32_t> order;  ///< indices of segments, bin by bin
        StrandCounts counts;
    };

    void drawBin(std::uint32_t bin);
    void drawTile(std::uint32_t tx, std::uint32_t ty, std::uint32_t bin, TileRuns& runs);
    Status flush();

    Projection projection_;
    SampleGrid& grid_;
    std::function<Status(std::uint64_t)> afterBatch_;
    Bins bins_;
    std::vector<Slice> slices_;
    std::size_t filling_ = 0;  // the slice that takes the next strand
    StrandCounts counts_;
    std::mutex idleMutex_;
    std::vector<std::unique_ptr<TileRuns>> idle_;  // a thread borrows one per bin
};

}  // namespace mtsm::raster
