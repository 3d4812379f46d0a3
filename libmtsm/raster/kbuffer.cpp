// KTile: what happens seldom, and what is asked once a map is complete.
#include "raster/kbuffer.h"

#include <algorithm>
#include <utility>

namespace mtsm::raster {

void KTile::insert(std::uint32_t place, float z) {
    ++samples_;
    std::uint32_t copies = 0;  // of what is moved
    for (std::uint32_t k = 0; k < layers_ && z < kNoSample; ++k) {
        if (k == planes() && !addPlane()) return;
        float& kept = planes_[k][place];
        if (kept == z) return addCopy(k, place);
        if (kept < z) continue;
        std::swap(kept, z);
        if (copies_) std::swap(copies_[k * planeSize() + place], copies);
    }
}

bool KTile::addPlane() {
    const std::size_t offsets = empty() ? std::size_t(width_) * height_ + 1 : 0;
    if (!budget_->reserve((planeSize() + offsets) * sizeof(float))) return false;
    planes_.emplace_back(new float[planeSize()]);
    std::fill_n(planes_.back().get(), planeSize(), kNoSample);
    return true;
}

void KTile::addCopy(std::uint32_t layer, std::uint32_t place) {
    if (!copies_) {
        const std::size_t size = planeSize() * layers_;
        if (!budget_->reserve(size * sizeof(std::uint32_t))) return;
        copies_ = std::make_unique<std::uint32_t[]>(size);
    }
    ++copies_[layer * planeSize() + place];
}

std::uint32_t KTile::count(std::uint32_t x, std::uint32_t y) const noexcept {
    std::uint32_t count = 0;
    for (const auto& plane : planes_)
        count += plane[std::size_t(y) * stride_ + x] < kNoSample;
    return count;
}

std::uint64_t KTile::copies() const noexcept {
    std::uint64_t sum = 0;
    for (std::size_t i = 0; copies_ && i < planeSize() * layers_; ++i)
        sum += copies_[i];
    return sum;
}

std::uint64_t KTile::bytes() const noexcept {
    return planeSize() * sizeof(float) * (planes_.size() + (copies_ ? layers_ : 0));
}

void KTile::clear() noexcept {
    planes_.clear();
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
