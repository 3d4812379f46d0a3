// bake(): placement, rasterising, layers, map.
#include "mtsm/bake.h"

#include <algorithm>
#include <exception>
#include <limits>
#include <new>

#include "bake/layers.h"
#include "bake/placement.h"
#include "bake/visits.h"
#include "base/message.h"
#include "base/parallel.h"
#include "base/utf8.h"
#include "raster/kbuffer.h"
#include "raster/memory_budget.h"
#include "raster/rasteriser.h"

namespace mtsm {
namespace {

using bake_detail::Placement;
using bake_detail::Progress;
using bake_detail::Visits;
using base::makeError;
using raster::KBuffer;
using raster::KTile;
using raster::MemoryBudget;
using raster::Rasteriser;

/// The default z threshold, in footprints of a pixel.
constexpr double kBiasFootprints = 1.0;

Error tooLarge(const BakeOptions& o) {
    return makeError(
        ErrorCode::tooLarge, "a map of ", o.width, " x ", o.height, " pixels with up to ",
        o.layers.value_or(5), " layers needs more than the ", o.maxBytes,
        " bytes of --max-memory: raise it, or lower ", "--resolution or --layers");
}

raster::Facing facing(Cull cull) {
    switch (cull) {
        case Cull::none:
            break;
        case Cull::back:
            return raster::Facing::front;
        case Cull::front:
            return raster::Facing::back;
    }
    return raster::Facing::any;
}

/// Bytes that are needed whatever the casters are: tiles, and the map's hierarchy.
std::uint64_t fixedBytes(const BakeOptions& o) {
    const std::uint64_t side = KBuffer::kTileSize;
    const std::uint64_t tiles =
        ((o.width + side - 1) / side) * ((o.height + side - 1) / side);
    std::uint64_t bytes = tiles * (sizeof(Tile) + sizeof(KTile));
    std::uint64_t width = o.width, height = o.height;
    while (width > 1 || height > 1) {
        width = (width + 1) / 2;
        height = (height + 1) / 2;
        bytes += width * height * sizeof(ZRange);
    }
    return bytes;
}

/// Rasterises all casters. The report is complete but for its times.
Status rasterise(Visits& visits, const Placement& placed, const BakeOptions& options,
                 const MemoryBudget& budget, KBuffer& buffer, MapInfo& info,
                 BakeReport& report) {
    const Progress& progress = visits.progress();
    const auto tell = [&](std::uint64_t done) {
        const double all = double(placed.triangles);
        return progress("rasterising", all > 0.0 ? double(done) / all : -1.0);
    };
    Rasteriser rasteriser(placed.projections[0], facing(options.cull), buffer,
                          [&](std::uint64_t done) -> Status {
                              if (budget.exceeded()) return tooLarge(options);
                              return tell(done + report.transparent);
                          });
    if (auto s = tell(0); !s) return s;
    const auto status = visits.each(meshesOnly([&](const MeshView& mesh) -> Status {
        ++report.meshes;
        report.triangles += mesh.triangleCount;
        if (mesh.opacity > 0.0f) return rasteriser.add(mesh);
        report.transparent += mesh.triangleCount;
        return {};
    }));
    if (!status) return status;
    if (auto s = rasteriser.finish(); !s) return s;

    const raster::TriangleCounts& counts = rasteriser.counts();
    report.degenerate = counts.degenerate;
    report.nonFinite = counts.nonFinite;
    report.culled = counts.culled;
    report.outside = counts.outside;
    report.clipped = counts.clipped;
    info.castersClipped = counts.leavesWindow > 0;
    const std::uint64_t usable = report.triangles - report.transparent -
                                 counts.degenerate - counts.nonFinite - counts.culled;
    if (usable > 0 && usable == counts.behind)
        return makeError(ErrorCode::badArgument,
                         "every caster lies behind the light as it ",
                         "is aimed, or in front of --near: move it, or turn it with ",
                         "--light-target or --light-direction");
    if (usable == counts.outside) return bake_detail::nothingCasts(report);
    return {};
}

/// Turns the buffer into tiles, emptying it, and counts its samples.
Result<std::vector<Tile>> takeLayers(KBuffer& buffer, const Progress& progress,
                                     MapInfo& info) {
    constexpr const char* kStage = "building map";
    std::vector<KTile>& from = buffer.tiles();
    std::vector<Tile> tiles(from.size());
    std::vector<std::uint64_t> samples(from.size()), dropped(from.size());
    const std::size_t row = buffer.tilesX();
    for (std::size_t first = 0; first < from.size(); first += row) {
        if (auto s = progress(kStage, double(first) / double(from.size())); !s)
            return s.error();
        base::parallelFor(first, first + row, [&](std::size_t i) {
            tiles[i] = bake_detail::layersOf(from[i]);
            samples[i] = from[i].samples();
            dropped[i] = samples[i] - tiles[i].z.size() - from[i].copies();
            from[i].clear();
        });
        for (std::size_t i = first; i < first + row; ++i) {
            info.samples += samples[i];
            info.samplesDropped += dropped[i];
        }
    }
    if (auto s = progress(kStage, 1.0); !s) return s.error();
    return tiles;
}

/// The z threshold: as asked, or a pixel's footprint at a layer's depth.
void setBias(const BakeOptions& options, const Projection& projection, MapInfo& info) {
    const double footprint = kBiasFootprints * projection.pixelFootprint(1.0);
    const auto byPixel =
        float(std::min(footprint, double(std::numeric_limits<float>::max())));
    if (options.bias)
        info.bias = *options.bias;
    else if (projection.kind == ProjectionKind::perspective)
        info.biasPerDepth = byPixel;
    else
        info.bias = byPixel;
}

MapInfo describe(const BakeOptions& options, const Placement& placed) {
    MapInfo info;
    info.width = options.width;
    info.height = options.height;
    info.tileSize = KBuffer::kTileSize;
    info.light = placed.light;
    info.maxLayers = options.layers.value_or(5);
    info.resets = kAllResets;
    info.software = "libmtsm " MTSM_VERSION;
    info.settings = base::asUtf8(options.settings);
    return info;
}

Result<Baked> bakeChecked(CasterSource& casters, const BakeOptions& options) {
    if (auto s = bake_detail::checkOptions(options); !s) return s.error();
    MemoryBudget budget(options.maxBytes);
    if (!budget.reserve(fixedBytes(options))) return tooLarge(options);

    const Progress progress(options);
    Visits visits(casters, progress);
    auto placed = bake_detail::place(visits, options);
    if (!placed) return placed.error();

    MapInfo info = describe(options, *placed);
    BakeReport report;
    KBuffer buffer(options.width, options.height, options.layers.value_or(5), budget);
    if (auto s = rasterise(visits, *placed, options, budget, buffer, info, report); !s)
        return s.error();
    report.readSeconds = visits.readSeconds();
    report.rasterSeconds = visits.visitorSeconds();

    auto tiles = takeLayers(buffer, progress, info);
    if (!tiles) return tiles.error();
    setBias(options, placed->projections[0], info);
    std::vector<MapFace> faces(1);
    faces[0].projection = placed->projections[0];
    faces[0].tiles = *std::move(tiles);
    auto map = ShadowMap::create(std::move(info), std::move(faces));
    if (!map) return map.error();
    return Baked{*std::move(map), report};
}

}  // namespace

Result<Baked> bake(CasterSource& casters, const BakeOptions& options) {
    try {
        return bakeChecked(casters, options);
    } catch (const std::bad_alloc&) {
        return tooLarge(options);
    } catch (const std::exception& e) {
        return makeError(ErrorCode::io, "the bake failed: ", e.what());
    } catch (...) {  // a callback's
        return makeError(ErrorCode::io, "the bake failed: something unknown was thrown");
    }
}

}  // namespace mtsm
