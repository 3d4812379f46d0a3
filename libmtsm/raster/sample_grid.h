// sample_grid.h - all samples of the pixels of a raster, in whatever order they come, for
// maps whose casters let light through.
//
//     SampleGrid grid({width, height}, firstTileRow, endTileRow, limitBytes);
//     if (grid.wants(ty)) grid.tile(tx, ty).add(pixel, z, &opacity);  // a thread a tile
//     grid.settle();               // between batches, from one thread
//     grid.tile(tx, ty).forEachPixel(visit);
//
// Memory is bounded by giving up rows of tiles: when the samples of all rows do not fit,
// the lower half of the rows is dropped, and the caller visits its casters again for
// them. So a map of any size can be built band by band; what a tile ends up with does not
// depend on the bands.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "mtsm/samples.h"

namespace mtsm::raster {

/// Depths this far apart may be one surface, as the rays of one pixel meet it: base +
/// perDepth * z, world units.
struct MergeDepth {
    double base = 0.0, perDepth = 0.0;
};

/// What all tiles of a grid share.
struct SampleShared {
    std::uint32_t channels = 1, subsamples = 1;
    MergeDepth merge;
    std::uint64_t limit = 0;  ///< bytes
    std::atomic<std::uint64_t> used{0};
    std::atomic<std::uint32_t> endRow{0};  ///< tile rows from here on are given up
    std::uint32_t firstRow = 0, settledRow = 0;
    std::atomic<bool> overrun{false};  ///< even that was not enough: start again
};

class SampleTile {
  public:
    /// A sample of the whole pixel, not of one of its subsamples.
    static constexpr std::uint8_t kWholePixel = 0xff;

    SampleTile(std::uint32_t width, std::uint32_t height, std::uint32_t row,
               SampleShared& shared) noexcept
        : shared_(&shared), row_(row), width_(width), pixels_(width * height) {}

    /// Adds a sample to `pixel` (row-major in the tile): z finite and positive,
    /// opacity [channels], each in [0, 1] and one of them > 0. `subsample` is the
    /// row-major index of the centre ray within the pixel, or kWholePixel for a sample
    /// that says how much of the whole pixel it stops (strands, volumes).
    void add(std::uint32_t pixel, float z, const float* opacity,
             std::uint8_t subsample = kWholePixel) {
        const std::uint32_t i = samples_ % kChunk;
        if (i == 0 && !grow()) return;
        const Chunk chunk = chunkOf(samples_);
        chunk.pixel[i] = std::uint16_t(pixel);
        chunk.z[i] = z;
        for (std::uint32_t c = 0; c < shared_->channels; ++c)
            chunk.opacity[c * kChunk + i] = opacity[c];
        if (chunk.subsample) chunk.subsample[i] = subsample;
        ++samples_;
    }

    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t pixels() const noexcept { return pixels_; }
    [[nodiscard]] std::uint64_t samples() const noexcept { return samples_; }
    [[nodiscard]] bool empty() const noexcept { return samples_ == 0; }

    /// Calls visit(pixel, samples) for every pixel in order, also for those without
    /// samples. The samples are as they are before compression, nearest first, ties in
    /// depth by opacity; they are borrowed for the call. What the subsamples of a pixel
    /// met becomes samples of the pixel: what they met within the merge depth of each
    /// other is one surface, each subsample meeting it once at most, and its opacity is
    /// such that the product over the surfaces is the mean over the subsamples at every
    /// depth. Takes 4 bytes of memory for each sample of the tile.
    void forEachPixel(
        const std::function<void(std::uint32_t, const PixelSamples&)>& visit) const;
    /// Drops the samples.
    void clear() noexcept;

  private:
    static constexpr std::uint32_t kChunk = 512;  ///< samples
    /// One chunk's arrays, all in one piece of memory.
    struct Chunk {
        float* z;
        float* opacity;           ///< [channels][kChunk]
        std::uint16_t* pixel;     ///< [kChunk]
        std::uint8_t* subsample;  ///< [kChunk]; null where a pixel has one centre ray

        Chunk(std::byte* memory, const SampleShared& shared) noexcept
            : z(reinterpret_cast<float*>(memory)),
              opacity(z + kChunk),
              pixel(reinterpret_cast<std::uint16_t*>(opacity + shared.channels * kChunk)),
              subsample(shared.subsamples > 1
                            ? reinterpret_cast<std::uint8_t*>(pixel + kChunk)
                            : nullptr) {}
    };
    [[nodiscard]] Chunk chunkOf(std::uint32_t sample) const noexcept {
        return {chunks_[sample / kChunk].get(), *shared_};
    }
    [[nodiscard]] std::size_t chunkBytes() const noexcept;
    bool grow();

    std::vector<std::unique_ptr<std::byte[]>> chunks_;
    SampleShared* shared_;
    std::uint32_t samples_ = 0, row_, width_, pixels_;
};

class SampleGrid {
  public:
    static constexpr std::uint32_t kTileShift = 6;
    static constexpr std::uint32_t kTileSize = 1u << kTileShift;

    struct Shape {
        std::uint32_t width = 0, height = 0;  ///< pixels, 1..kMaxResolution
        std::uint32_t channels = 1;           ///< 1 or 3
        std::uint32_t subsamples = 1;         ///< centre rays per side: 1, 2, 4 or 8
        MergeDepth merge;
    };
    /// Holds tile rows [firstRow, endRow) in at most limitBytes.
    SampleGrid(const Shape& shape, std::uint32_t firstRow, std::uint32_t endRow,
               std::uint64_t limitBytes);

    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t height() const noexcept { return height_; }
    [[nodiscard]] std::uint32_t channels() const noexcept { return shared_->channels; }
    /// Centre rays per side of a pixel.
    [[nodiscard]] std::uint32_t subsamples() const noexcept {
        return shared_->subsamples;
    }
    [[nodiscard]] std::uint32_t tilesX() const noexcept { return tilesX_; }
    [[nodiscard]] std::uint32_t tilesY() const noexcept { return tilesY_; }

    /// Tile rows [firstRow, endRow) are held; endRow may fall while samples come in.
    [[nodiscard]] std::uint32_t firstRow() const noexcept { return firstRow_; }
    [[nodiscard]] std::uint32_t endRow() const noexcept {
        return shared_->endRow.load(std::memory_order_relaxed);
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
        return shared_->overrun.load(std::memory_order_relaxed);
    }

  private:
    std::unique_ptr<SampleShared> shared_;
    std::uint32_t width_, height_, firstRow_, tilesX_, tilesY_;
    std::vector<SampleTile> tiles_;
};

}  // namespace mtsm::raster
