// KTile: what happens seldom, and what is asked once a map is complete.
#include "raster/kbuffer.h"

#include <algorithm>

namespace mtsm::raster {

bool KTile::allocate() {
    const std::size_t size = std::size_t(pixels_) * layers_;
    const std::size_t offsets = std::size_t(pixels_) + 1;  // of the layers in the map
    if (!budget_->reserve((size + offsets) * sizeof(float))) return false;
    z_.reset(new float[size]);
    std::fill_n(z_.get(), size, kNoSample);
    return true;
}

void KTile::addCopy(std::uint32_t pixel, std::uint32_t slot) {
    if (!copies_) {
        const std::size_t size = std::size_t(pixels_) * layers_;
        if (!budget_->reserve(size * sizeof(std::uint32_t))) return;
        copies_ = std::make_unique<std::uint32_t[]>(size);
    }
    ++copies_[std::size_t(pixel) * layers_ + slot];
}

/// Makes room for a sample that has no copies yet.
void KTile::shiftCopies(std::uint32_t pixel, std::uint32_t slot) {
    std::uint32_t* const copies = copies_.get() + std::size_t(pixel) * layers_;
    std::copy_backward(copies + slot, copies + layers_ - 1, copies + layers_);
    copies[slot] = 0;
}

std::uint32_t KTile::count(std::uint32_t pixel) const noexcept {
    const float* const zs = z(pixel);
    std::uint32_t count = 0;
    for (std::uint32_t i = 0; i < layers_; ++i)
        count += zs[i] < kNoSample;
    return count;
}

std::uint64_t KTile::copies() const noexcept {
    std::uint64_t sum = 0;
    const std::size_t size = std::size_t(pixels_) * layers_;
    for (std::size_t i = 0; copies_ && i < size; ++i)
        sum += copies_[i];
    return sum;
}

std::uint64_t KTile::bytes() const noexcept {
    const std::uint64_t plane = std::uint64_t(pixels_) * layers_ * sizeof(float);
    return plane * ((z_ ? 1 : 0) + (copies_ ? 1 : 0));
}

void KTile::clear() noexcept {
    z_.reset();
    copies_.reset();
    samples_ = 0;
}

KBuffer::KBuffer(std::uint32_t width, std::uint32_t height, std::uint32_t layers,
                 MemoryBudget& budget)
    : width_(width),
      height_(height),
      layers_(layers),
      tilesX_((width + kTileSize - 1) / kTileSize),
      tilesY_((height + kTileSize - 1) / kTileSize) {
    tiles_.reserve(std::size_t(tilesX_) * tilesY_);
    for (std::uint32_t ty = 0; ty < tilesY_; ++ty) {
        const std::uint32_t h = std::min(kTileSize, height - ty * kTileSize);
        for (std::uint32_t tx = 0; tx < tilesX_; ++tx) {
            const std::uint32_t w = std::min(kTileSize, width - tx * kTileSize);
            tiles_.emplace_back(w, h, layers, budget);
        }
    }
}

}  // namespace mtsm::raster
