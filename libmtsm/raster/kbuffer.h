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
// A tile takes memory when its first sample comes; for numbers of copies when the first
// copy comes.
#pragma once
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "raster/memory_budget.h"

namespace mtsm::raster {

class KTile {
  public:
    static constexpr float kNoSample = std::numeric_limits<float>::infinity();

    KTile(std::uint32_t width, std::uint32_t height, std::uint32_t layers,
          MemoryBudget& budget) noexcept
        : budget_(&budget), width_(width), pixels_(width * height), layers_(layers) {}

    /// Adds a sample at `pixel` (row-major in the tile): z finite and positive. Without
    /// effect once the budget is exceeded.
    void insert(std::uint32_t pixel, float z) {
        ++samples_;
        if (!z_ && !allocate()) return;
        float* const slot = z_.get() + std::size_t(pixel) * layers_;
        const std::uint32_t last = layers_ - 1;
        if (z >= slot[last]) {
            if (z == slot[last]) addCopy(pixel, last);
            return;
        }
        std::uint32_t at = 0;
        while (slot[at] < z)
            ++at;
        if (slot[at] == z) return addCopy(pixel, at);
        if (copies_) shiftCopies(pixel, at);
        // Moves the ones behind along, up to the first that is no sample.
        for (float moved = z; moved < kNoSample && at <= last; ++at)
            std::swap(slot[at], moved);
    }

    [[nodiscard]] bool empty() const noexcept { return !z_; }
    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }
    [[nodiscard]] std::uint32_t pixels() const noexcept { return pixels_; }
    /// All that came, copies included.
    [[nodiscard]] std::uint64_t samples() const noexcept { return samples_; }
    /// Of those, the ones that were not kept because they are copies of a kept one.
    [[nodiscard]] std::uint64_t copies() const noexcept;
    /// [layers], nearest first, kNoSample behind the last. Only if not empty().
    [[nodiscard]] const float* z(std::uint32_t pixel) const noexcept {
        return z_.get() + std::size_t(pixel) * layers_;
    }
    /// Samples kept in a pixel. Only if not empty().
    [[nodiscard]] std::uint32_t count(std::uint32_t pixel) const noexcept;
    /// Bytes that its planes take, and that were taken from the budget besides 4 for each
    /// pixel and one more: so its layers, as a map holds them, never need more.
    [[nodiscard]] std::uint64_t bytes() const noexcept;
    /// Drops the planes and the counts.
    void clear() noexcept;

  private:
    void addCopy(std::uint32_t pixel, std::uint32_t slot);
    void shiftCopies(std::uint32_t pixel, std::uint32_t slot);
    bool allocate();

    std::unique_ptr<float[]> z_;               // [pixels][layers]
    std::unique_ptr<std::uint32_t[]> copies_;  // [pixels][layers], or null: all are 0
    MemoryBudget* budget_;
    std::uint32_t width_, pixels_, layers_;
    std::uint64_t samples_ = 0;
};

class KBuffer {
  public:
    static constexpr std::uint32_t kTileShift = 6;
    static constexpr std::uint32_t kTileSize = 1u << kTileShift;

    /// `budget` must outlive the buffer. Each side 1..kMaxResolution, layers 1..64.
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
