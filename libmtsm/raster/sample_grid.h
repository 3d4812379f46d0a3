// sample_grid.h - all samples of the pixels of a raster, in whatever order they come, for
// maps whose casters let light through.
//
//     SampleGrid grid(width, height, channels, subsamples, firstTileRow, limitBytes);
//     if (grid.wants(ty)) grid.tile(tx, ty).add(pixel, z, &opacity); // one thread a tile
//     grid.settle();               // between batches, from one thread
//     grid.tile(tx, ty).sorted(...)
//
// Memory is bounded by giving up rows of tiles: when the samples of all rows do not fit,
// the lower half of the rows is dropped, and the caller visits its casters again for
// them. So a map of any size can be built band by band; what a tile ends up with does not
// depend on the bands.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "mtsm/samples.h"

namespace mtsm::raster {

/// What all tiles of a grid share.
struct SampleMemory {
    std::uint64_t limit = 0;
    std::atomic<std::uint64_t> used{0};
    std::atomic<std::uint32_t> endRow{0};  ///< tile rows from here on are given up
    std::atomic<bool> overrun{false};      ///< even that was not enough: start again
};

class SampleTile {
  public:
    /// A sample of the whole pixel, not of one of its subsamples.
    static constexpr std::uint8_t kWholePixel = 0xff;

    SampleTile(std::uint32_t width, std::uint32_t height, std::uint32_t channels,
               std::uint32_t subsamples, std::uint32_t row, SampleMemory& memory) noexcept
        : memory_(&memory),
          row_(row),
          width_(width),
          pixels_(width * height),
          channels_(channels),
          subsamples_(subsamples) {}

    /// Adds a sample to `pixel` (row-major in the tile): z finite and positive,
    /// opacity [channels], each in [0, 1] and one of them > 0. `subsample` is the
    /// row-major index of the centre ray within the pixel, or kWholePixel for a sample
    /// that says how much of the whole pixel it stops (strands, volumes).
    void add(std::uint32_t pixel, float z, const float* opacity,
             std::uint8_t subsample = kWholePixel) {
        if (used_ == capacity_ && !grow()) return;
        Chunk& chunk = *chunks_.back();
        const std::uint32_t i = used_++ - (capacity_ - kChunk);
        chunk.pixel[i] = std::uint16_t(pixel);
        chunk.subsample[i] = subsample;
        chunk.z[i] = z;
        for (std::uint32_t c = 0; c < channels_; ++c)
            chunk.opacity[c][i] = opacity[c];
    }

    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t pixels() const noexcept { return pixels_; }
    [[nodiscard]] std::uint64_t samples() const noexcept { return used_; }
    [[nodiscard]] bool empty() const noexcept { return used_ == 0; }

    /// The samples of every pixel, nearest first, as they are before compression: ties
    /// in depth by opacity; samples of subsamples made samples of the pixel. Takes memory
    /// for a second copy of them. `begin` is [pixels + 1].
    void sorted(std::vector<std::uint32_t>& begin, SampleList& samples) const;
    /// Drops the samples.
    void clear() noexcept;

  private:
    static constexpr std::uint32_t kChunk = 512;  ///< samples
    struct Chunk {
        float z[kChunk];
        float opacity[3][kChunk];  // of the channels there are; the rest is not touched
        std::uint16_t pixel[kChunk];
        std::uint8_t subsample[kChunk];
    };
    bool grow();

    std::vector<std::unique_ptr<Chunk>> chunks_;
    SampleMemory* memory_;
    std::uint64_t used_ = 0, capacity_ = 0;
    std::uint32_t row_, width_, pixels_, channels_, subsamples_;
};

class SampleGrid {
  public:
    static constexpr std::uint32_t kTileShift = 6;
    static constexpr std::uint32_t kTileSize = 1u << kTileShift;

    /// Width and height in pixels of the map, 1..kMaxResolution; channels 1 or 3;
    /// subsamples per side, 1..8. Holds the tile rows from `firstRow` on.
    SampleGrid(std::uint32_t width, std::uint32_t height, std::uint32_t channels,
               std::uint32_t subsamples, std::uint32_t firstRow,
               std::uint64_t limitBytes);

    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t height() const noexcept { return height_; }
    [[nodiscard]] std::uint32_t channels() const noexcept { return channels_; }
    /// Centre rays per side of a pixel.
    [[nodiscard]] std::uint32_t subsamples() const noexcept { return subsamples_; }
    [[nodiscard]] std::uint32_t tilesX() const noexcept { return tilesX_; }
    [[nodiscard]] std::uint32_t tilesY() const noexcept { return tilesY_; }

    /// Tile rows [firstRow, endRow) are held; endRow may fall while samples come in.
    [[nodiscard]] std::uint32_t firstRow() const noexcept { return firstRow_; }
    [[nodiscard]] std::uint32_t endRow() const noexcept {
        return memory_->endRow.load(std::memory_order_relaxed);
    }
    [[nodiscard]] bool wants(std::uint32_t ty) const noexcept {
        return ty >= firstRow_ && ty < endRow();
    }
    /// Rows of pixels that are held: [firstPixelRow, endPixelRow).
    [[nodiscard]] std::uint32_t firstPixelRow() const noexcept {
        return firstRow_ * kTileSize;
    }
    [[nodiscard]] std::uint32_t endPixelRow() const noexcept {
        return std::min(height_, endRow() * kTileSize);
    }
    /// One of a wanted row. Tiles at the right and lower border are cropped to the map.
    /// Adding to a tile that is no longer wanted is without effect.
    [[nodiscard]] SampleTile& tile(std::uint32_t tx, std::uint32_t ty) noexcept {
        return tiles_[std::size_t(ty - firstRow_) * tilesX_ + tx];
    }

    /// Frees what was given up. Between batches, while no thread adds.
    void settle() noexcept;
    /// Memory ran out in spite of it: the samples are not complete, and what is held
    /// should be started again with fewer rows.
    [[nodiscard]] bool overrun() const noexcept {
        return memory_->overrun.load(std::memory_order_relaxed);
    }

  private:
    std::unique_ptr<SampleMemory> memory_;
    std::uint32_t width_, height_, channels_, subsamples_, firstRow_, tilesX_, tilesY_;
    std::vector<SampleTile> tiles_;
};

}  // namespace mtsm::raster
