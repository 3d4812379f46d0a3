// Batches: transform and set up, sort into bins, draw the bins.
#include "raster/rasteriser.h"

#include <algorithm>
#include <array>
#include <bit>
#include <glm/geometric.hpp>
#include <span>

#include "base/parallel.h"
#include "raster/draw_nearest.h"
#include "raster/light_from_object.h"
#include "raster/mesh_chunk.h"

namespace mtsm::raster {
namespace {

// A slice's prepared triangles (72 bytes each) fit a core's second-level cache; a batch
// has enough slices for the threads of a large machine, and no more than that: a small
// bake is over before it has used memory twice.
constexpr std::uint32_t kSliceTriangles = 2048;
constexpr std::uint32_t kSlices = 32;
constexpr std::uint32_t kBatchTriangles = kSlices * kSliceTriangles;
constexpr std::uint32_t kMostBins = 4096;

static_assert(KBuffer::kTileShift == SampleGrid::kTileShift);
constexpr std::uint32_t kTileShift = KBuffer::kTileShift;

/// A mesh's surface, as a map of so many channels sees it.
Surface surfaceOf(const MeshView& mesh, std::uint32_t channels) {
    Surface surface;
    const glm::vec3 tint = channels == 3 ? mesh.tint : glm::vec3(1.0f);
    const glm::vec3 opacity = channelOpacity(mesh.opacity, tint);
    surface.opacity = {opacity.r, opacity.g, opacity.b};
    surface.texture = mesh.texture;
    return surface;
}

/// The opacity of a textured surface at a pixel of the fine raster.
template <ProjectionKind kind>
std::array<float, 3> lookUp(const Surface& surface, const PreparedTriangle& t,
                            std::int32_t x, std::int32_t y, float z,
                            std::uint32_t channels) {
    std::array<float, 3> a{};
    const auto at = surface.coordinates(kind, x, y, z, {t.dx, t.dy});
    surface.texture->opacity(at.uv, at.dx, at.dy, a.data());
    if (surface.texture->channels() == 1)
        a.fill(a[0]);
    else if (channels == 1)
        a[0] = (a[0] + a[1] + a[2]) / 3.0f;
    return a;
}

/// The same view on a raster with so many times the pixels a side.
Projection finer(Projection projection, std::uint32_t times) {
    projection.scale *= double(times);
    projection.offset *= double(times);
    return projection;
}

}  // namespace

Rasteriser::Rasteriser(const Projection& fine, std::uint32_t fineWidth,
                       std::uint32_t fineHeight, std::uint32_t subsamples, Facing keep,
                       AfterBatch afterBatch)
    : projection_(fine),
      width_(fineWidth),
      height_(fineHeight),
      setup_(fine, fineWidth, fineHeight, keep),
      subsampleShift_(std::uint32_t(std::countr_zero(subsamples))),
      afterBatch_(std::move(afterBatch)),
      bins_(fineWidth, fineHeight, kTileShift + subsampleShift_, kMostBins),
      slices_(kSlices) {}

Rasteriser::Rasteriser(const Projection& projection, Facing keep, KBuffer& buffer,
                       AfterBatch afterBatch)
    : Rasteriser(projection, buffer.width(), buffer.height(), 1, keep,
                 std::move(afterBatch)) {
    buffer_ = &buffer;
}

Rasteriser::Rasteriser(const Projection& projection, Facing keep, SampleGrid& grid,
                       AfterBatch afterBatch)
    : Rasteriser(finer(projection, grid.subsamples()), grid.width() * grid.subsamples(),
                 grid.height() * grid.subsamples(), grid.subsamples(), keep,
                 std::move(afterBatch)) {
    grid_ = &grid;
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
    // The texture is only borrowed.
    return mesh.texture ? finish() : Status{};
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
        slice.triangles.reserve(kSliceTriangles);
        slice.surfaces.push_back(surfaceOf(mesh, grid_ ? grid_->channels() : 1));
        for (std::uint32_t i = from; i < to; ++i) {
            const std::size_t corner = 3 * std::size_t(i - pending_);
            const Vertex& a = vertices_[chunk.corner(corner)];
            const Vertex& b = vertices_[chunk.corner(corner + 1)];
            const Vertex& c = vertices_[chunk.corner(corner + 2)];
            if (mesh.texture) {
                const std::uint32_t* const at = mesh.indices + 3 * first + corner;
                slice.surfaces.push_back(slice.surfaces.back());
                slice.surfaces.back().setCoordinates(
                    projection_, {a.light, b.light, c.light},
                    TriangleNormal(a.light, b.light, c.light, origin2).normal,
                    {mesh.uvs[at[0]], mesh.uvs[at[1]], mesh.uvs[at[2]]});
            }
            setup_.triangle(a, b, c, mirrored, origin2,
                            std::uint32_t(slice.surfaces.size() - 1), slice.counts,
                            slice.triangles);
        }
        slice.taken += to - from;
    });
}

void Rasteriser::drawBin(std::uint32_t bin) const {
    const auto x = std::int32_t(bin % bins_.x), y = std::int32_t(bin / bins_.x);
    const std::int32_t side = 1 << bins_.shift;
    const PixelRect pixels = intersect(
        {x * side, y * side, (x + 1) * side - 1, (y + 1) * side - 1}, wantedPixels());
    if (pixels.empty()) return;
    if (buffer_) {
        std::array<TriangleList, kSlices> lists;
        for (std::uint32_t i = 0; i < kSlices; ++i) {
            const Slice& slice = slices_[i];
            if (slice.taken == 0) continue;
            const std::uint32_t first = slice.begin[bin], end = slice.begin[bin + 1];
            lists[i] = {slice.triangles.data(),
                        {slice.order.data() + first, end - first}};
        }
        return drawNearest(projection_.kind, lists, pixels, *buffer_);
    }
    const bool perspective = projection_.kind == ProjectionKind::perspective;
    for (const Slice& slice : slices_) {
        if (slice.taken == 0) continue;
        for (std::uint32_t i = slice.begin[bin]; i < slice.begin[bin + 1]; ++i) {
            const PreparedTriangle& t = slice.triangles[slice.order[i]];
            const Surface& surface = slice.surfaces[t.surface];
            if (perspective)
                drawInGrid<ProjectionKind::perspective>(t, surface, pixels);
            else
                drawInGrid<ProjectionKind::orthographic>(t, surface, pixels);
        }
    }
}

/// The part of the fine raster that is drawn.
PixelRect Rasteriser::wantedPixels() const noexcept {
    PixelRect all{0, 0, std::int32_t(width_) - 1, std::int32_t(height_) - 1};
    if (grid_) {
        all.y0 = std::int32_t(grid_->firstPixelRow() << subsampleShift_);
        all.y1 = std::int32_t(grid_->endPixelRow() << subsampleShift_) - 1;
    }
    return all;
}

template <ProjectionKind kind>
void Rasteriser::drawInGrid(const PreparedTriangle& t, const Surface& surface,
                            PixelRect bin) const {
    const std::uint32_t shift = subsampleShift_, mask = (1u << shift) - 1;
    const std::uint32_t channels = grid_->channels();
    const auto draw = [&](std::uint32_t tx, std::uint32_t ty, PixelRect within) {
        SampleTile& tile = grid_->tile(tx, ty);
        const std::uint32_t left = tx << kTileShift, top = ty << kTileShift;
        drawTriangle<kind>(
            t, within, [&](std::int32_t fineX, std::int32_t fineY, float z) {
                const auto x = std::uint32_t(fineX), y = std::uint32_t(fineY);
                const auto opacity =
                    surface.texture ? lookUp<kind>(surface, t, fineX, fineY, z, channels)
                                    : surface.opacity;
                if (*std::max_element(opacity.begin(), opacity.begin() + channels) <=
                    0.0f)
                    return;
                const std::uint32_t pixel =
                    ((y >> shift) - top) * tile.width() + ((x >> shift) - left);
                const auto subsample =
                    shift ? std::uint8_t((y & mask) << shift | (x & mask))
                          : SampleTile::kWholePixel;
                tile.add(pixel, z, opacity.data(), subsample);
            });
    };
    forEachTile(intersect(t.pixels(), bin), kTileShift + shift, draw);
}

Status Rasteriser::flush() {
    base::parallelFor(std::uint32_t(0), kSlices, [&](std::uint32_t s) {
        Slice& slice = slices_[s];
        if (slice.taken) bins_.sort(slice.triangles, slice.begin, slice.order);
    });
    base::parallelFor(std::uint32_t(0), bins_.count(),
                      [&](std::uint32_t bin) { drawBin(bin); });
    for (Slice& slice : slices_) {
        counts_.add(slice.counts);
        slice.counts = {};
        slice.taken = 0;
        slice.triangles.clear();
        slice.surfaces.clear();
    }
    done_ += pending_;
    pending_ = 0;
    return afterBatch_ ? afterBatch_(done_) : Status{};
}

}  // namespace mtsm::raster
