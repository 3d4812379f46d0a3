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
    float front = 0.0f;                    // depth of the first
    std::uint32_t first = 0, end = 0;      // its hits, once they are in order
    double weight = 0.0, weightedZ = 0.0;  // opacities, and opacities times depths
};

/// A subsample's sample.
struct Hit {
    std::size_t surface = 0;
    std::uint8_t subsample = 0;
    std::array<float, 3> opacity{};
};

/// Makes one pixel's samples of subsamples samples of the pixel.
class SubsampleMerge {
  public:
    SubsampleMerge(std::uint32_t subsamples, std::uint32_t channels, MergeDepth merge)
        : rays_(std::size_t(subsamples) * subsamples),
          channels_(channels),
          merge_(merge) {}

    /// `samples` sorted; replaced by the result, sorted.
    void operator()(std::vector<Sample>& samples) {
        const std::size_t kept = group(samples);
        samples.resize(kept);
        std::stable_sort(hits_.begin(), hits_.end(), [](const Hit& a, const Hit& b) {
            return a.surface < b.surface;
        });
        for (std::uint32_t i = 0; i < hits_.size(); ++i) {
            Surface& surface = surfaces_[hits_[i].surface];
            if (surface.end == 0) surface.first = i;
            surface.end = i + 1;
        }
        std::stable_sort(surfaces_.begin(), surfaces_.end(),
                         [](const Surface& a, const Surface& b) {
                             return a.weightedZ * b.weight < b.weightedZ * a.weight;
                         });
        for (auto& left : left_)
            left.fill(1.0);
        for (const Surface& surface : surfaces_)
            emit(surface, samples);
        std::sort(samples.begin(), samples.end());
    }

  private:
    /// Sorts the hits of subsamples into surfaces: one joins the first surface within
    /// reach that its subsample has not met yet. Samples of the whole pixel move to the
    /// front of `samples`; returns their number.
    std::size_t group(std::vector<Sample>& samples) {
        surfaces_.clear();
        hits_.clear();
        next_.fill(0);
        std::size_t open = 0, kept = 0;  // surfaces before `open` are out of reach
        for (const Sample& s : samples) {
            if (s.subsample == SampleTile::kWholePixel) {
                samples[kept++] = s;
                continue;
            }
            while (open < surfaces_.size() &&
                   double(s.z) - surfaces_[open].front > reach(surfaces_[open].front))
                ++open;
            std::size_t& next = next_[s.subsample];
            const std::size_t i = std::max(open, next);
            next = i + 1;
            if (i == surfaces_.size()) surfaces_.push_back({s.z, 0, 0, 0.0, 0.0});
            const double weight = double(s.opacity[0]) + s.opacity[1] + s.opacity[2];
            surfaces_[i].weight += weight;
            surfaces_[i].weightedZ += weight * s.z;
            hits_.push_back({i, s.subsample, s.opacity});
        }
        return kept;
    }

    /// A surface stops what its hits take of what the subsamples have left, so that the
    /// product over the surfaces is the mean over the subsamples. Once none has anything
    /// left all start again, as layers do.
    void emit(const Surface& surface, std::vector<Sample>& samples) {
        Sample sample;
        sample.z = float(surface.weightedZ / surface.weight);
        bool some = false, dark = true;
        for (std::size_t c = 0; c < channels_; ++c) {
            const double before = sum(c);
            for (std::uint32_t i = surface.first; i < surface.end; ++i)
                left_[hits_[i].subsample][c] *= 1.0 - double(hits_[i].opacity[c]);
            const double after = sum(c);
            sample.opacity[c] =
                before > 0.0 ? float(std::clamp(1.0 - after / before, 0.0, 1.0)) : 0.0f;
            some = some || sample.opacity[c] > 0.0f;
            dark = dark && after <= 0.0;
        }
        if (some) samples.push_back(sample);
        if (!dark) return;
        for (auto& left : left_)
            left.fill(1.0);
    }
    [[nodiscard]] double sum(std::size_t channel) const {
        double total = 0.0;
        for (std::size_t ray = 0; ray < rays_; ++ray)
            total += left_[ray][channel];
        return total;
    }
    [[nodiscard]] double reach(float z) const {
        return merge_.base + merge_.perDepth * z;
    }

    std::size_t rays_, channels_;
    MergeDepth merge_;
    std::vector<Surface> surfaces_;
    std::vector<Hit> hits_;
    std::array<std::size_t, 64> next_{};            // surface that a subsample may join
    std::array<std::array<double, 3>, 64> left_{};  // [subsample][channel]
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
    constexpr std::uint32_t kMost = 0xffffffffu - kChunk;  // samples_ must not wrap
    if (used > shared.limit || samples_ > kMost) {
        shared.overrun.store(true, kRelaxed);
        return false;
    }
    const std::uint32_t rows = shared.settledRow - shared.firstRow;
    if (used > shared.limit / 3 * 2 && end == shared.settledRow && rows > 1)
        shared.endRow.compare_exchange_strong(end, shared.firstRow + rows / 2, kRelaxed);
    chunks_.emplace_back(new std::byte[chunkBytes()]);
    return true;
}

void SampleTile::forEachPixel(
    const std::function<void(std::uint32_t, const PixelSamples&)>& visit) const {
    // Grouped by pixel: a counting sort of their numbers.
    std::vector<std::uint32_t> begin(std::size_t(pixels_) + 1, 0);
    for (std::uint32_t i = 0; i < samples_; ++i)
        ++begin[chunkOf(i).pixel[i % kChunk] + 1u];
    for (std::uint32_t p = 0; p < pixels_; ++p)
        begin[p + 1] += begin[p];
    std::vector<std::uint32_t> order(samples_), next(begin.begin(), begin.end() - 1);
    for (std::uint32_t i = 0; i < samples_; ++i)
        order[next[chunkOf(i).pixel[i % kChunk]]++] = i;

    SubsampleMerge merge(shared_->subsamples, shared_->channels, shared_->merge);
    std::vector<Sample> pixel;
    SampleList list;
    for (std::uint32_t p = 0; p < pixels_; ++p) {
        pixel.clear();
        for (std::uint32_t k = begin[p]; k < begin[p + 1]; ++k) {
            const Chunk chunk = chunkOf(order[k]);
            const std::uint32_t i = order[k] % kChunk;
            Sample& s = pixel.emplace_back();
            s.z = chunk.z[i];
            for (std::uint32_t c = 0; c < shared_->channels; ++c)
                s.opacity[c] = chunk.opacity[c * kChunk + i];
            if (chunk.subsample) s.subsample = chunk.subsample[i];
        }
        std::sort(pixel.begin(), pixel.end());
        if (shared_->subsamples > 1) merge(pixel);
        list.clear();
        for (const Sample& s : pixel) {
            list.z.push_back(s.z);
            for (std::uint32_t c = 0; c < shared_->channels; ++c)
                list.opacity[c].push_back(s.opacity[c]);
        }
        visit(p,
              {list.z.size(),
               list.z.data(),
               {list.opacity[0].data(), list.opacity[1].data(), list.opacity[2].data()}});
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
