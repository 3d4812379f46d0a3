// Batches: transform and set up, sort into bins, draw the bins.
#include "raster/rasteriser.h"

#include <algorithm>
#include <glm/geometric.hpp>

#include "base/parallel.h"
#include "raster/light_from_object.h"
#include "raster/mesh_chunk.h"

namespace mtsm::raster {
namespace {

// A slice's prepared triangles (72 bytes each) fit a core's second-level cache; a batch
// has enough slices for the threads of a large machine.
constexpr std::uint32_t kSliceTriangles = 4096;
constexpr std::uint32_t kSlices = 32;
constexpr std::uint32_t kBatchTriangles = kSlices * kSliceTriangles;
constexpr std::uint32_t kMostBins = 1024;

}  // namespace

Rasteriser::Rasteriser(const Projection& projection, Facing keep, KBuffer& buffer,
                       std::function<Status(std::uint64_t)> afterBatch)
    : projection_(projection),
      setup_(projection, buffer.width(), buffer.height(), keep),
      buffer_(buffer),
      afterBatch_(std::move(afterBatch)),
      slices_(kSlices) {
    const auto bins = [](std::uint32_t pixels, std::uint32_t shift) {
        return ((pixels - 1) >> shift) + 1;
    };
    binShift_ = KBuffer::kTileShift;
    do {
        binsX_ = bins(buffer.width(), binShift_);
        binsY_ = bins(buffer.height(), binShift_);
    } while (binsX_ * binsY_ > kMostBins && ++binShift_);
}

Status Rasteriser::add(const MeshView& mesh) {
    for (std::size_t first = 0; first < mesh.triangleCount;) {
        const std::size_t left = mesh.triangleCount - first;
        const std::uint32_t room = kBatchTriangles - pending_;
        const auto count = std::uint32_t(std::min<std::size_t>(left, room));
        prepare(mesh, first, count);
        first += count;
        pending_ += count;
        if (pending_ == kBatchTriangles) {
            if (auto s = flush(); !s) return s;
        }
    }
    return {};
}

Status Rasteriser::finish() {
    return pending_ ? flush() : Status{};
}

/// Fills the slices from where the triangles before left off.
void Rasteriser::prepare(const MeshView& mesh, std::size_t first, std::uint32_t count) {
    const MeshChunk chunk(mesh, first, count);
    const LightFromObject lightFromObject(projection_, mesh.worldFromObject);
    const bool mirrored = mirrors(mesh.worldFromObject);
    const double origin2 = glm::dot(lightFromObject.origin, lightFromObject.origin);
    if (vertices_.size() < chunk.vertices()) vertices_.resize(chunk.vertices());
    const auto prepareVertices = [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            vertices_[i] = setup_.vertex(lightFromObject(chunk.position(i)));
    };
    base::parallelRanges(std::size_t(0), std::size_t(chunk.vertices()), std::size_t(1024),
                         prepareVertices);
    const std::uint32_t end = pending_ + count;
    const std::uint32_t firstSlice = pending_ / kSliceTriangles;
    const std::uint32_t endSlice = (end + kSliceTriangles - 1) / kSliceTriangles;
    base::parallelFor(firstSlice, endSlice, [&](std::uint32_t s) {
        Slice& slice = slices_[s];
        const std::uint32_t from = std::max(pending_, s * kSliceTriangles);
        const std::uint32_t to = std::min(end, (s + 1) * kSliceTriangles);
        for (std::uint32_t i = from; i < to; ++i) {
            const std::size_t corner = 3 * std::size_t(i - pending_);
            setup_.triangle(vertices_[chunk.corner(corner)],
                            vertices_[chunk.corner(corner + 1)],
                            vertices_[chunk.corner(corner + 2)], mirrored, origin2,
                            mesh.opacity, slice.counts, slice.triangles);
        }
        slice.taken += to - from;
    });
}

/// A counting sort.
void Rasteriser::sortIntoBins(Slice& slice) const {
    const auto forEachBin = [&](std::uint32_t triangle, auto&& visit) {
        const PixelRect r = slice.triangles[triangle].pixels();
        for (std::int32_t y = r.y0 >> binShift_; y <= r.y1 >> binShift_; ++y) {
            for (std::int32_t x = r.x0 >> binShift_; x <= r.x1 >> binShift_; ++x)
                visit(std::uint32_t(y) * binsX_ + std::uint32_t(x));
        }
    };
    const auto triangles = std::uint32_t(slice.triangles.size());
    std::vector<std::uint32_t>& begin = slice.begin;
    begin.assign(std::size_t(binsX_) * binsY_ + 1, 0);
    for (std::uint32_t i = 0; i < triangles; ++i)
        forEachBin(i, [&](std::uint32_t bin) { ++begin[bin]; });
    std::uint32_t total = 0;
    for (std::uint32_t& b : begin) {  // to where each bin ends
        total += b;
        b = total;
    }
    slice.order.resize(total);
    for (std::uint32_t i = triangles; i-- > 0;)
        forEachBin(i, [&](std::uint32_t bin) { slice.order[--begin[bin]] = i; });
}

void Rasteriser::drawBin(std::uint32_t bin) const {
    const auto x = std::int32_t(bin % binsX_), y = std::int32_t(bin / binsX_);
    const std::int32_t side = 1 << binShift_;
    const PixelRect pixels{x * side, y * side,
                           std::min((x + 1) * side, std::int32_t(buffer_.width())) - 1,
                           std::min((y + 1) * side, std::int32_t(buffer_.height())) - 1};
    for (const Slice& slice : slices_) {
        if (slice.taken == 0) continue;
        for (std::uint32_t i = slice.begin[bin]; i < slice.begin[bin + 1]; ++i) {
            const PreparedTriangle& t = slice.triangles[slice.order[i]];
            if (projection_.kind == ProjectionKind::perspective)
                drawInBin<ProjectionKind::perspective>(t, pixels);
            else
                drawInBin<ProjectionKind::orthographic>(t, pixels);
        }
    }
}

template <ProjectionKind kind>
void Rasteriser::drawInBin(const PreparedTriangle& t, PixelRect bin) const {
    constexpr std::int32_t shift = KBuffer::kTileShift, side = KBuffer::kTileSize;
    const PixelRect r = intersect(t.pixels(), bin);
    for (std::int32_t ty = r.y0 >> shift; ty <= r.y1 >> shift; ++ty) {
        for (std::int32_t tx = r.x0 >> shift; tx <= r.x1 >> shift; ++tx) {
            KTile& tile = buffer_.tile(std::uint32_t(tx), std::uint32_t(ty));
            const std::int32_t left = tx * side, top = ty * side;
            const auto width = std::int32_t(tile.width());
            const PixelRect within =
                intersect(r, {left, top, left + side - 1, top + side - 1});
            drawTriangle<kind>(t, within, [&](std::int32_t x, std::int32_t y, float z) {
                tile.insert(std::uint32_t((y - top) * width + (x - left)), z, t.opacity);
            });
        }
    }
}

Status Rasteriser::flush() {
    base::parallelFor(std::uint32_t(0), kSlices, [&](std::uint32_t s) {
        if (slices_[s].taken) sortIntoBins(slices_[s]);
    });
    base::parallelFor(std::uint32_t(0), binsX_ * binsY_,
                      [&](std::uint32_t bin) { drawBin(bin); });
    for (Slice& slice : slices_) {
        counts_.add(slice.counts);
        slice.counts = {};
        slice.taken = 0;
        slice.triangles.clear();
    }
    done_ += pending_;
    pending_ = 0;
    return afterBatch_ ? afterBatch_(done_) : Status{};
}

}  // namespace mtsm::raster
