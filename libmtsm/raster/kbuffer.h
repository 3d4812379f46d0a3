// kbuffer.h - the k nearest samples of every pixel [Xie07, sec. 4.2], for casters that
// are opaque surfaces.
//
//     MemoryBudget budget(options.maxBytes);
//     KBuffer buffer(width, height, layers, budget);
//     buffer.tile(tx, ty).insert(pixel, z);            // one thread per tile at a time
//     if (budget.exceeded()) ...                       // samples are missing
//
// Samples are ordered by z and the first k of them are kept, so what is kept does not
// depend on the order in which they come. Samples at exactly the same z are one: the
// others are its copies.
//
// A layer's plane of a tile takes memory when its first sample comes; numbers of copies
// when the first copy comes.
#pragma once
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "raster/memory_budget.h"

namespace mtsm::raster {

class KTile {
  public:
    static constexpr float kNoSample = std::numeric_limits<float>::infinity();
    /// Rows of a plane begin at multiples of this many samples: so may be read and
    /// written what lies between two multiples.
    static constexpr std::uint32_t kRowAlignment = 8;

    KTile(std::uint32_t width, std::uint32_t height, std::uint32_t layers,
          MemoryBudget& budget) noexcept
        : budget_(&budget),
          width_(width),
          height_(height),
          stride_((width + kRowAlignment - 1) / kRowAlignment * kRowAlignment),
          layers_(layers) {}

    /// Adds a sample at a place of the planes: z finite and positive. Without effect once
    /// the budget is exceeded.
    void insert(std::uint32_t place, float z);
    /// Where the planes hold pixel (x, y) of the tile.
    [[nodiscard]] std::uint32_t place(std::uint32_t x, std::uint32_t y) const noexcept {
        return y * stride_ + x;
    }

    [[nodiscard]] bool empty() const noexcept { return planes_.empty(); }
    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t height() const noexcept { return height_; }
    [[nodiscard]] std::uint32_t pixels() const noexcept { return width_ * height_; }
    /// All that came, copies included.
    [[nodiscard]] std::uint64_t samples() const noexcept { return samples_; }
    /// Of those, the ones that were not kept because they are copies of a kept one.
    [[nodiscard]] std::uint64_t copies() const noexcept;
    /// The nearest samples of all pixels, then the second ones, and so on, up to the last
    /// that some pixel has: row-major, rows `stride` apart, kNoSample where there is
    /// none.
    [[nodiscard]] std::uint32_t planes() const noexcept {
        return std::uint32_t(planes_.size());
    }
    [[nodiscard]] const float* plane(std::uint32_t layer) const noexcept {
        return planes_[layer].get();
    }
    [[nodiscard]] std::uint32_t stride() const noexcept { return stride_; }
    /// Samples kept in a pixel.
    [[nodiscard]] std::uint32_t count(std::uint32_t x, std::uint32_t y) const noexcept;
    /// Bytes that its planes take, and that were taken from the budget besides 4 for each
    /// pixel and one more: so its layers, as a map holds them, never need more.
    [[nodiscard]] std::uint64_t bytes() const noexcept;
    /// Drops the planes and the counts.
    void clear() noexcept;

    // For who inserts many samples at once (draw_nearest.cpp).
    [[nodiscard]] std::uint32_t layers() const noexcept { return layers_; }
    [[nodiscard]] float* plane(std::uint32_t layer) noexcept {
        return planes_[layer].get();
    }
    /// Adds a plane; false beyond the budget.
    bool addPlane();
    [[nodiscard]] bool hasCopies() const noexcept { return copies_ != nullptr; }
    /// Counts a copy of what lies at this place of a plane.
    void addCopy(std::uint32_t layer, std::uint32_t place);
    /// Counts samples that were inserted into the planes.
    void countSamples(std::uint64_t count) noexcept { samples_ += count; }

  private:
    [[nodiscard]] std::size_t planeSize() const noexcept {
        return std::size_t(stride_) * height_;
    }
    std::vector<std::unique_ptr<float[]>> planes_;
    std::unique_ptr<std::uint32_t[]> copies_;  // [layers][place], or null: all are 0
    MemoryBudget* budget_;
    std::uint32_t width_, height_, stride_, layers_;
    std::uint64_t samples_ = 0;
};

class KBuffer {
  public:
    static constexpr std::uint32_t kTileShift = 6;
    static constexpr std::uint32_t kTileSize = 1u << kTileShift;
    static constexpr std::uint32_t kMostLayers = 64;

    /// `budget` must outlive the buffer. Each side 1..kMaxResolution,
    /// layers 1..kMostLayers.
    KBuffer(std::uint32_t width, std::uint32_t height, std::uint32_t layers,
            MemoryBudget& budget);

    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t height() const noexcept { return height_; }
    [[nodiscard]] std::uint32_t layers() const noexcept { return layers_; }
    [[nodiscard]] std::uint32_t tilesX() const noexcept { return tilesX_; }
    [[nodiscard]] std::uint32_t tilesY() const noexcept { return tilesY_; }
    /// Tiles at the right and lower border are cropped to the map.
    [[nodiscard]] KTile& tile(std::uint32_t tx, std::uint32_t ty) noexcept {
        return tiles_[std::size_t(ty) * tilesX_ + tx];
    }
    /// Row-major.
    [[nodiscard]] std::vector<KTile>& tiles() noexcept { return tiles_; }

  private:
    std::uint32_t width_, height_, layers_, tilesX_, tilesY_;
    std::vector<KTile> tiles_;
};

}  // namespace mtsm::raster
