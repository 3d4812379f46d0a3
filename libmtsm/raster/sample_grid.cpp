// SampleGrid: memory, and the way from a tile's samples to those of its pixels.
#include "raster/sample_grid.h"

#include <algorithm>
#include <array>

namespace mtsm::raster {
namespace {

constexpr auto kRelaxed = std::memory_order_relaxed;

/// One sample on its way through sorting.
struct Sample {
    float z = 0.0f;
    std::array<float, 3> opacity{};  // [channels], the rest 0
    std::uint8_t subsample = SampleTile::kWholePixel;

    friend bool operator<(const Sample& a, const Sample& b) noexcept {
        if (a.z != b.z) return a.z < b.z;
        if (a.opacity != b.opacity) return a.opacity < b.opacity;
        return a.subsample < b.subsample;
    }
};

/// What some subsamples of a pixel met of one surface.
struct Surface {
    float front = 0.0f;            // depth of the first
    std::uint64_t met = 0;         // a bit for each subsample
    double weight = 0.0, z = 0.0;  // z: sum of weight times depth
    std::array<double, 3> opacity{};
};

/// Makes one pixel's samples of subsamples samples of the pixel.
class SubsampleMerge {
  public:
    SubsampleMerge(std::uint32_t subsamples, MergeDepth merge)
        : share_(1.0 / (double(subsamples) * subsamples)), merge_(merge) {}

    /// `samples` sorted; replaced by the result, sorted.
    void operator()(std::vector<Sample>& samples) {
        surfaces_.clear();
        std::size_t open = 0, kept = 0;  // surfaces before `open` are out of reach
        for (const Sample& s : samples) {
            if (s.subsample == SampleTile::kWholePixel) {
                samples[kept++] = s;
                continue;
            }
            while (open < surfaces_.size() &&
                   double(s.z) - surfaces_[open].front > reach(surfaces_[open].front))
                ++open;
            const std::uint64_t bit = std::uint64_t(1) << s.subsample;
            std::size_t i = open;
            while (i < surfaces_.size() && (surfaces_[i].met & bit))
                ++i;
            if (i == surfaces_.size()) surfaces_.push_back({s.z, 0, 0.0, 0.0, {}});
            join(surfaces_[i], s, bit);
        }
        samples.resize(kept);
        for (const Surface& s : surfaces_) {
            Sample sample;
            sample.z = float(s.z / s.weight);
            for (std::size_t c = 0; c < 3; ++c)
                sample.opacity[c] = float(std::min(1.0, s.opacity[c] * share_));
            samples.push_back(sample);
        }
        std::sort(samples.begin(), samples.end());
    }

  private:
    [[nodiscard]] double reach(float z) const {
        return merge_.base + merge_.perDepth * z;
    }
    static void join(Surface& surface, const Sample& s, std::uint64_t bit) {
        const double weight = double(s.opacity[0]) + s.opacity[1] + s.opacity[2];
        surface.met |= bit;
        surface.weight += weight;
        surface.z += weight * s.z;
        for (std::size_t c = 0; c < 3; ++c)
            surface.opacity[c] += s.opacity[c];
    }

    double share_;
    MergeDepth merge_;
    std::vector<Surface> surfaces_;
};

}  // namespace

std::size_t SampleTile::chunkBytes() const noexcept {
    const std::size_t subsample = shared_->subsamples > 1 ? 1 : 0;
    return kChunk *
           ((1 + shared_->channels) * sizeof(float) + sizeof(std::uint16_t) + subsample);
}

/// Takes another chunk. Above two thirds of the limit the lower half of the rows is given
/// up, once until settle() has freed them; above the limit everything has failed.
bool SampleTile::grow() {
    SampleShared& shared = *shared_;
    std::uint32_t end = shared.endRow.load(kRelaxed);
    if (row_ >= end || shared.overrun.load(kRelaxed)) return false;
    const std::uint64_t bytes = chunkBytes();
    const std::uint64_t used = shared.used.fetch_add(bytes, kRelaxed) + bytes;
    if (used > shared.limit) {
        shared.overrun.store(true, kRelaxed);
        return false;
    }
    const std::uint32_t rows = shared.settledRow - shared.firstRow;
    if (used > shared.limit / 3 * 2 && end == shared.settledRow && rows > 1)
        shared.endRow.compare_exchange_strong(end, shared.firstRow + rows / 2, kRelaxed);
    chunks_.emplace_back(new std::byte[chunkBytes()]);
    return true;
}

void SampleTile::sorted(std::vector<std::uint32_t>& begin, SampleList& samples) const {
    // Grouped by pixel: a counting sort.
    begin.assign(std::size_t(pixels_) + 1, 0);
    const auto forEach = [&](auto&& visit) {
        for (std::uint64_t i = 0; i < samples_; ++i) {
            const Chunk chunk(chunks_[i / kChunk].get(), *shared_);
            visit(chunk, std::uint32_t(i % kChunk));
        }
    };
    forEach([&](const Chunk& chunk, std::uint32_t i) { ++begin[chunk.pixel[i] + 1u]; });
    for (std::uint32_t p = 0; p < pixels_; ++p)
        begin[p + 1] += begin[p];
    std::vector<Sample> all(samples_);
    std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
    forEach([&](const Chunk& chunk, std::uint32_t i) {
        Sample& s = all[next[chunk.pixel[i]]++];
        s.z = chunk.z[i];
        for (std::uint32_t c = 0; c < shared_->channels; ++c)
            s.opacity[c] = chunk.opacity[c * kChunk + i];
        if (chunk.subsample) s.subsample = chunk.subsample[i];
    });

    samples.clear();
    SubsampleMerge merge(shared_->subsamples, shared_->merge);
    std::vector<Sample> pixel;
    for (std::uint32_t p = 0, first = 0; p < pixels_; ++p) {
        const std::uint32_t end = begin[p + 1];
        pixel.assign(all.begin() + first, all.begin() + end);
        std::sort(pixel.begin(), pixel.end());
        if (shared_->subsamples > 1) merge(pixel);
        for (const Sample& s : pixel) {
            samples.z.push_back(s.z);
            for (std::uint32_t c = 0; c < shared_->channels; ++c)
                samples.opacity[c].push_back(s.opacity[c]);
        }
        first = end;
        begin[p + 1] = std::uint32_t(samples.size());
    }
}

void SampleTile::clear() noexcept {
    shared_->used.fetch_sub(chunks_.size() * chunkBytes(), kRelaxed);
    chunks_.clear();
    chunks_.shrink_to_fit();
    samples_ = 0;
}

SampleGrid::SampleGrid(const Shape& shape, std::uint32_t firstRow, std::uint32_t endRow,
                       std::uint64_t limitBytes)
    : shared_(std::make_unique<SampleShared>()),
      width_(shape.width),
      height_(shape.height),
      firstRow_(firstRow),
      tilesX_((shape.width + kTileSize - 1) / kTileSize),
      tilesY_((shape.height + kTileSize - 1) / kTileSize) {
    shared_->channels = shape.channels;
    shared_->subsamples = shape.subsamples;
    shared_->merge = shape.merge;
    shared_->limit = limitBytes;
    shared_->firstRow = firstRow;
    shared_->settledRow = endRow;
    shared_->endRow = endRow;
    tiles_.reserve(std::size_t(tilesX_) * (endRow - firstRow));
    for (std::uint32_t ty = firstRow; ty < endRow; ++ty) {
        const std::uint32_t h = std::min(kTileSize, height_ - ty * kTileSize);
        for (std::uint32_t tx = 0; tx < tilesX_; ++tx)
            tiles_.emplace_back(std::min(kTileSize, width_ - tx * kTileSize), h, ty,
                                *shared_);
    }
}

void SampleGrid::settle() noexcept {
    const std::uint32_t end = endRow();
    for (std::uint32_t ty = end; ty < shared_->settledRow; ++ty) {
        for (std::uint32_t tx = 0; tx < tilesX_; ++tx)
            tile(tx, ty).clear();
    }
    shared_->settledRow = end;
}

}  // namespace mtsm::raster
