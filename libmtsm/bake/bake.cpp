// bake(): placement, the faces, the map.
#include "mtsm/bake.h"

#include <algorithm>
#include <bit>
#include <exception>
#include <limits>
#include <new>

#include "bake/face.h"
#include "bake/near_field.h"
#include "bake/placement.h"
#include "bake/visits.h"
#include "base/message.h"
#include "base/utf8.h"
#include "compress/hidden.h"
#include "compress/rounding.h"
#include "raster/kbuffer.h"

namespace mtsm {
namespace {

using bake_detail::CasterKinds;
using bake_detail::Face;
using bake_detail::FaceSettings;
using bake_detail::Placement;
using bake_detail::Progress;
using bake_detail::tooLarge;
using bake_detail::Visits;
using base::makeError;

/// The default z threshold, in footprints of a pixel.
constexpr double kBiasFootprints = 1.0;
/// Layers of opaque casters unless asked otherwise [Xie07, sec. 7].
constexpr std::uint32_t kOpaqueLayers = 5;
constexpr float kRounding = 1.0f / 64.0f;  ///< measured: tests/bench/NOTES.md
constexpr std::uint32_t kMostNearest = raster::KBuffer::kMostLayers;
constexpr std::uint32_t kTileSize = raster::KBuffer::kTileSize;

/// Bytes that a face needs whatever the casters are: tiles, and the map's hierarchy.
std::uint64_t fixedBytes(const BakeOptions& o) {
    const std::uint64_t side = kTileSize;
    const std::uint64_t tiles =
        ((o.width + side - 1) / side) * ((o.height + side - 1) / side);
    std::uint64_t bytes = tiles * (sizeof(Tile) + sizeof(raster::KTile));
    if (!o.keepHidden && !o.cube) bytes += std::uint64_t(7) * o.width * o.height;
    std::uint64_t width = o.width, height = o.height;
    while (width > 1 || height > 1) {
        width = (width + 1) / 2;
        height = (height + 1) / 2;
        bytes += width * height * sizeof(ZRange);
    }
    return bytes;
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

MapInfo describe(const BakeOptions& options, const Placement& placed,
                 const CasterKinds& kinds, const FaceSettings& settings) {
    MapInfo info;
    info.width = options.width;
    info.height = options.height;
    info.tileSize = kTileSize;
    info.channels = settings.channels;
    info.light = placed.light;
    info.translucent = kinds.media ? Translucent::media : Translucent::sheets;
    info.maxLayers = settings.layers;
    info.resets = options.resets;
    info.toleranceAsked = options.tolerance;
    info.software = "libmtsm " MTSM_VERSION;
    info.settings = base::asUtf8(options.settings);
    setBias(options, placed.projections[0], info);
    return info;
}

/// What was met in one face, added to what was met in the others.
void add(const Face& face, bool first, MapInfo& info, BakeReport& report) {
    info.samples += face.samples;
    info.samplesDropped += face.samplesDropped;
    info.toleranceReached =
        std::max(info.toleranceReached, face.compression.toleranceReached);
    report.droppedByLayers += face.samplesDropped - face.compression.droppedByResets;
    report.droppedByResets += face.compression.droppedByResets;
    report.pixelsOverTolerance += face.compression.pixelsOverTolerance;
    report.rasterSeconds += face.rasterSeconds;
    report.compressSeconds += face.compressSeconds;
    report.passes = first ? face.passes : report.passes + face.passes;
    if (!first) return;
    report.meshes = face.casters.meshes;
    report.triangles = face.casters.triangles;
    report.transparent = face.casters.transparent;
    report.strands = face.casters.strands;
    report.segments = face.casters.segments;
    report.volumes = face.casters.volumes;
    report.voxels = face.casters.voxels;
    report.degenerate = face.triangles.degenerate;
    report.nonFinite = face.triangles.nonFinite;
    report.culled = face.triangles.culled;
}

/// Of a map with one face: what lies outside of it casts nothing.
Status checkOutside(const Face& face, MapInfo& info, BakeReport& report) {
    report.outside = face.triangles.outside;
    report.clipped = face.triangles.clipped;
    info.castersClipped = face.leavesWindow > 0;
    if (face.samples > 0) return {};
    if (report.strands > 0 || report.volumes > 0)
        return makeError(ErrorCode::badFile, "nothing casts a shadow: of ",
                         report.strands, " strands, ", report.volumes, " volumes and ",
                         report.triangles, " triangles none lets less than all light ",
                         "through where the light looks, between --near and --far: move ",
                         "the light or turn it, or check widths, opacities and --fov");
    const std::uint64_t usable = report.triangles - report.transparent -
                                 report.degenerate - report.nonFinite - report.culled;
    if (usable > 0 && usable == face.triangles.behind)
        return makeError(ErrorCode::badArgument,
                         "every caster lies behind the light as it ",
                         "is aimed, or in front of --near: move it, or turn it with ",
                         "--light-target or --light-direction");
    if (usable == report.outside) return bake_detail::nothingCasts(report);
    return {};
}

Result<Baked> bakeChecked(CasterSource& casters, const BakeOptions& options) {
    if (auto s = bake_detail::checkOptions(options); !s) return s.error();
    const std::uint64_t fixed = fixedBytes(options) * (options.cube ? 6 : 1);
    if (fixed > options.maxBytes) return tooLarge(options, fixed);

    const Progress progress(options);
    Visits visits(casters, progress);
    const auto placed = bake_detail::place(visits, options);
    if (!placed) return placed.error();
    const auto kinds = bake_detail::kindsOf(visits);
    if (!kinds) return kinds.error();

    FaceSettings settings{options};
    settings.triangles = placed->triangles;
    settings.channels = options.color ? 3 : 1;
    const bool surfaces = !kinds->translucent && options.subsamples == 1;
    settings.layers = options.layers.value_or(surfaces ? kOpaqueLayers : 0);
    settings.rounding =
        options.rounding.value_or(options.tolerance > 0.0f ? kRounding : 0.0f);
    settings.bytesLeft = options.maxBytes - fixed;
    const bool nearest = surfaces && settings.layers <= kMostNearest;
    MapInfo info = describe(options, *placed, *kinds, settings);
    BakeReport report;
    std::vector<MapFace> faces;
    float roundingError = 0.0f;  // of a visibility
    for (const Projection& projection : placed->projections) {
        auto face = nearest ? bake_detail::bakeNearest(visits, projection, settings)
                            : bake_detail::bakeSamples(visits, projection, settings);
        if (!face) return face.error();
        add(*face, faces.empty(), info, report);
        if (!options.cube) {
            if (auto s = checkOutside(*face, info, report); !s) return s.error();
        }
        faces.push_back({projection, std::move(face->tiles), {}, {}});
        if (!options.keepHidden && !options.cube) {
            if (auto s = progress("dropping what no light sees", -1.0); !s)
                return s.error();
            report.droppedHidden = compress::dropHidden(info, faces[0]).layers;
        }
        roundingError = std::max(
            roundingError, compress::roundLayers(info, settings.rounding, faces.back()));
        std::uint64_t bytes = 0;
        for (const Tile& tile : faces.back().tiles)
            bytes += bake_detail::bytesOf(tile);
        if (bytes >= settings.bytesLeft) return tooLarge(options);
        settings.bytesLeft -= bytes;
    }
    if (auto s = bake_detail::bakeNearField(visits, options, *kinds, settings.bytesLeft,
                                            faces, report);
        !s)
        return s.error();
    report.readSeconds = visits.readSeconds();
    report.strandWidth = placed->strandWidth;
    report.segmentLength = placed->segmentLength;
    if (report.droppedHidden > 0)
        info.attributes.push_back({"hiddenLayers", std::int64_t(report.droppedHidden)});
    if (settings.rounding > 0.0f)
        info.attributes.push_back({"rounding", std::vector<double>{settings.rounding}});
    // Of nothing but volumes what is close to a receiver is not its own.
    if (report.volumes > 0 && report.strands == 0 && report.meshes == 0)
        info.attributes.push_back({"mediaStart", std::vector<double>{0.0}});
    if (info.toleranceReached <= info.toleranceAsked)  // unless the cap took more
        info.toleranceReached =
            std::min(info.toleranceReached + roundingError, info.toleranceAsked);
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
