// Batches: set up strands, sort their pieces into bins, draw the bins tile by tile.
#include "raster/strand.h"

#include <algorithm>
#include <cmath>
#include <glm/matrix.hpp>
#include <utility>

#include "base/parallel.h"
#include "raster/light_from_object.h"
#include "raster/strand_setup.h"
#include "raster/tile_runs.h"

namespace mtsm::raster {
namespace {

// A slice's prepared pieces are 64 bytes each; see rasteriser.cpp.
constexpr std::uint64_t kSliceSegments = 4096;
constexpr std::uint32_t kSlices = 32;
constexpr std::uint32_t kMostBins = 1 << 14;

}  // namespace

void StrandCounts::add(const StrandCounts& other) noexcept {
    strands += other.strands;
    segments += other.segments;
    nonFinite += other.nonFinite;
    transparent += other.transparent;
    outside += other.outside;
    clipped += other.clipped;
    leavesWindow += other.leavesWindow;
}

StrandRasteriser::StrandRasteriser(const Projection& projection, SampleGrid& grid,
                                   std::function<Status(std::uint64_t)> afterBatch)
    : projection_(projection),
      grid_(grid),
      afterBatch_(std::move(afterBatch)),
      bins_(grid.width(), grid.height(), SampleGrid::kTileShift, kMostBins),
      slices_(kSlices) {}

StrandRasteriser::~StrandRasteriser() = default;

Status StrandRasteriser::add(const StrandsView& view) {
    struct Share {
        std::size_t slice, first, end;  // strands [first, end)
    };
    const LightFromObject toLight(projection_, view.worldFromObject);
    const double widthScale =
        std::cbrt(std::abs(glm::determinant(glm::dmat3(view.worldFromObject))));
    std::vector<Share> shares;
    for (std::size_t s = 0; s < view.strandCount;) {
        shares.clear();
        for (; s < view.strandCount && filling_ < slices_.size(); ++filling_) {
            Slice& slice = slices_[filling_];
            const std::size_t first = s;
            for (; s < view.strandCount && slice.taken < kSliceSegments; ++s)
                slice.taken += std::max(view.begin[s + 1] - view.begin[s], 1u);
            shares.push_back({filling_, first, s});
            if (slice.taken < kSliceSegments) break;  // the next view fills it
        }
        const StrandSetup setup(projection_, grid_);
        base::parallelFor(std::size_t(0), shares.size(), [&](std::size_t i) {
            Slice& slice = slices_[shares[i].slice];
            StrandSetup::Scratch scratch;
            for (std::size_t k = shares[i].first; k < shares[i].end; ++k)
                setup.strand(view, k, toLight, widthScale, slice.strands++, scratch,
                             slice.counts, slice.segments);
        });
        if (filling_ == slices_.size()) {
            if (Status status = flush(); !status) return status;
        }
    }
    return {};
}

Status StrandRasteriser::finish() {
    return slices_[0].taken > 0 ? flush() : Status{};
}

void StrandRasteriser::drawBin(std::uint32_t bin) {
    const auto empty = [&](const Slice& s) {
        return s.taken == 0 || s.begin[bin] == s.begin[bin + 1];
    };
    if (std::all_of(slices_.begin(), slices_.end(), empty)) return;
    std::unique_ptr<TileRuns> runs;
    {
        const std::lock_guard lock(idleMutex_);
        if (!idle_.empty()) {
            runs = std::move(idle_.back());
            idle_.pop_back();
        }
    }
    if (!runs) runs = std::make_unique<TileRuns>(projection_);
    const std::uint32_t tiles = 1u << (bins_.shift - SampleGrid::kTileShift);
    const std::uint32_t firstX = bin % bins_.x * tiles, firstY = bin / bins_.x * tiles;
    for (std::uint32_t ty = firstY; ty < std::min(firstY + tiles, grid_.tilesY()); ++ty) {
        for (std::uint32_t tx = firstX; tx < std::min(firstX + tiles, grid_.tilesX());
             ++tx) {
            if (grid_.wants(ty)) drawTile(tx, ty, bin, *runs);
        }
    }
    const std::lock_guard lock(idleMutex_);
    idle_.push_back(std::move(runs));
}

void StrandRasteriser::drawTile(std::uint32_t tx, std::uint32_t ty, std::uint32_t bin,
                                TileRuns& runs) {
    runs.begin(grid_.tile(tx, ty), tx, ty);
    for (const Slice& slice : slices_) {
        if (slice.taken == 0) continue;
        std::uint32_t strand = 0;
        for (std::uint32_t i = slice.begin[bin]; i < slice.begin[bin + 1]; ++i) {
            const PreparedSegment& p = slice.segments[slice.order[i]];
            if (!runs.touches(p)) continue;
            if (p.strand != strand) runs.endStrand();
            strand = p.strand;
            runs.draw(p);
        }
        runs.endStrand();
    }
}

Status StrandRasteriser::flush() {
    base::parallelFor(std::size_t(0), slices_.size(), [&](std::size_t s) {
        Slice& slice = slices_[s];
        if (slice.taken) bins_.sort(slice.segments, slice.begin, slice.order);
    });
    base::parallelFor(std::uint32_t(0), bins_.count(),
                      [&](std::uint32_t bin) { drawBin(bin); });
    for (Slice& slice : slices_) {
        counts_.add(slice.counts);
        slice.counts = {};
        slice.taken = 0;
        slice.strands = 0;
        slice.segments.clear();
    }
    filling_ = 0;
    return afterBatch_ ? afterBatch_(counts_.segments) : Status{};
}

}  // namespace mtsm::raster
