// Casters that let light through: all samples of a band of the map are collected, sorted
// and compressed [Xie07, sec. 5.1]; then the casters are visited again for the next band.
// Where bands end depends on memory, what a pixel ends up with does not.
#include <algorithm>
#include <variant>

#include "bake/face.h"
#include "base/parallel.h"
#include "raster/rasteriser.h"
#include "raster/sample_grid.h"
#include "raster/strand.h"
#include "raster/volume_march.h"

namespace mtsm::bake_detail {
namespace {

using raster::SampleGrid;
using raster::SampleTile;

/// What subsamples of one pixel meet within so many footprints may be one surface: as
/// steep as the z threshold bridges between pixels.
constexpr double kMergeFootprints = 2.0;
/// Part of the memory that the samples of a band may take. The rest is for tiles while
/// they are sorted and compressed, which take up to three times their samples; where a
/// band has few tiles those are all of it.
double samplesShare(std::size_t tiles) {
    constexpr std::size_t kMany = 256;
    return tiles < kMany ? 0.25 : 0.6;
}

/// Depth along the view of so many pixel footprints: constant, and growing with z.
raster::MergeDepth footprints(const Projection& projection, double count) {
    const double depth = count * projection.pixelFootprint(1.0);
    if (projection.kind == ProjectionKind::perspective) return {0.0, depth};
    return {depth, 0.0};
}

/// What one sample of a volume takes at most: so little that samples merge. Of a small
/// tolerance not as little as that, for time's sake, and without one, where every sample
/// is a layer, what is half a hundredth off.
double volumeStep(float tolerance) {
    constexpr double kOfTolerance = 2.0 / 3, kLeast = 0.0005, kUnmerged = 0.01;
    if (!(tolerance > 0.0f)) return kUnmerged;
    return std::max(kOfTolerance * double(tolerance), kLeast);
}

/// Draws casters of all kinds into a grid.
class Drawing {
  public:
    Drawing(const Projection& projection, const FaceSettings& settings,
            const Progress& progress, SampleGrid& grid)
        : settings_(settings),
          progress_(progress),
          grid_(grid),
          meshes_(projection, facing(settings.options.cull), grid,
                  [this](std::uint64_t done) { return tell(triangles_ = done); }),
          strands_(projection, grid, [this](std::uint64_t) { return tell(triangles_); }),
          volumes_(projection, grid, volumeStep(settings.options.tolerance),
                   [this](std::uint64_t) { return tell(triangles_); }) {}

    Status add(const CasterView& caster) {
        if (const auto* mesh = std::get_if<MeshView>(&caster)) return addMesh(*mesh);
        if (const auto* strands = std::get_if<StrandsView>(&caster))
            return strands_.add(*strands);
        return addVolume(std::get<VolumeView>(caster));
    }
    Status finish() {
        if (auto s = meshes_.finish(); !s) return s;
        if (auto s = strands_.finish(); !s) return s;
        return tell(triangles_);
    }
    /// Of all that was drawn, after finish().
    void count(Face& face) const {
        face.triangles = meshes_.counts();
        face.casters = casters_;
        const raster::StrandCounts& hair = strands_.counts();
        face.casters.strands = hair.strands;
        face.casters.segments = hair.segments;
        face.casters.volumes = volumes_.counts().volumes;
        face.leavesWindow = face.triangles.leavesWindow + hair.leavesWindow +
                            volumes_.counts().leavesWindow;
    }

  private:
    Status addMesh(const MeshView& mesh) {
        ++casters_.meshes;
        casters_.triangles += mesh.triangleCount;
        if (mesh.opacity > 0.0f || mesh.texture) return meshes_.add(mesh);
        casters_.transparent += mesh.triangleCount;
        return {};
    }
    Status addVolume(const VolumeView& volume) {
        const float* const end =
            volume.density + volume.blockCount * VolumeView::kBlockVoxels;
        casters_.voxels += std::uint64_t(
            std::count_if(volume.density, end, [](float d) { return d > 0.0f; }));
        return volumes_.add(volume);
    }
    /// Between batches: frees what was given up.
    Status tell(std::uint64_t done) {
        grid_.settle();
        if (grid_.overrun()) return tooLarge(settings_.options);
        const double all = double(settings_.triangles);
        const double part = double(done + casters_.transparent);
        return progress_("rasterising", all > 0.0 && part <= all ? part / all : -1.0);
    }

    const FaceSettings& settings_;
    const Progress& progress_;
    SampleGrid& grid_;
    raster::Rasteriser meshes_;
    raster::StrandRasteriser strands_;
    raster::VolumeMarcher volumes_;
    BakeReport casters_;
    std::uint64_t triangles_ = 0;
};

Status draw(Visits& visits, const Projection& projection, const FaceSettings& settings,
            SampleGrid& grid, Face& face) {
    Drawing drawing(projection, settings, visits.progress(), grid);
    if (auto s = visits.progress()("rasterising", -1.0); !s) return s;
    const Status status =
        visits.each([&](const CasterView& caster) { return drawing.add(caster); });
    if (!status) return status;
    if (auto s = drawing.finish(); !s) return s;
    drawing.count(face);
    return {};
}

CompressOptions compressOptions(const Projection& projection,
                                const FaceSettings& settings) {
    const BakeOptions& o = settings.options;
    const raster::MergeDepth length = footprints(projection, o.layerLength);
    CompressOptions c;
    c.tolerance = o.tolerance * (1.0f - settings.rounding);  // rounding takes the rest
    c.opticalDepth = o.layerOpticalDepth;
    c.lengthBase = length.base;
    c.lengthPerDepth = length.perDepth;
    c.resets = o.resets;
    c.layers = settings.layers;
    c.channels = settings.channels;
    return c;
}

/// Compresses a band's samples, emptying it.
Status compress(SampleGrid& grid, const CompressOptions& options,
                const Progress& progress, std::uint64_t& bytes, Face& face) {
    constexpr const char* kStage = "compressing";
    const std::uint32_t columns = grid.tilesX();
    std::vector<CompressReport> reports(columns);
    std::vector<std::uint64_t> samples(columns);
    for (std::uint32_t ty = grid.firstRow(); ty < grid.endRow(); ++ty) {
        if (auto s = progress(kStage, double(ty) / grid.tilesY()); !s) return s;
        const auto compressTiles = [&](std::uint32_t from, std::uint32_t to) {
            PixelCompressor compressor(options);
            LayerList layers;
            for (std::uint32_t tx = from; tx < to; ++tx) {
                SampleTile& tile = grid.tile(tx, ty);
                reports[tx] = {};
                samples[tx] = tile.samples();
                if (tile.empty()) continue;
                layers.clear();
                std::vector<std::uint32_t> begin(1, 0);
                tile.forEachPixel([&](std::uint32_t, const PixelSamples& pixel) {
                    compressor.compress(pixel, layers, reports[tx]);
                    begin.push_back(std::uint32_t(layers.size()));
                });
                tile.clear();
                face.tiles[std::size_t(ty) * columns + tx] =
                    makeTile(std::move(begin), layers, options.channels);
            }
        };
        base::parallelRanges(0u, columns, 1u, compressTiles);
        for (std::uint32_t tx = 0; tx < columns; ++tx) {
            face.compression.merge(reports[tx]);
            face.samples += samples[tx];
            bytes += bytesOf(face.tiles[std::size_t(ty) * columns + tx]);
        }
    }
    return {};
}

}  // namespace

Result<Face> bakeSamples(Visits& visits, const Projection& projection,
                         const FaceSettings& settings) {
    const BakeOptions& options = settings.options;
    SampleGrid::Shape shape;
    shape.width = options.width;
    shape.height = options.height;
    shape.channels = settings.channels;
    shape.subsamples = options.subsamples;
    shape.merge = footprints(projection, kMergeFootprints);
    const auto tiles = [](std::uint32_t pixels) {
        return (pixels + SampleGrid::kTileSize - 1) / SampleGrid::kTileSize;
    };
    const std::uint32_t tileRows = tiles(shape.height);
    const CompressOptions compression = compressOptions(projection, settings);

    Face face;
    face.tiles.resize(std::size_t(tileRows) * tiles(shape.width));
    std::uint64_t layerBytes = 0;
    std::uint32_t rows = tileRows;  // of a band
    for (std::uint32_t row = 0; row < tileRows; ++face.passes) {
        if (layerBytes >= settings.bytesLeft) return tooLarge(options);
        const std::uint32_t end = std::min(tileRows, row + rows);
        const double share = samplesShare(std::size_t(end - row) * tiles(shape.width));
        const auto limit = std::uint64_t(share * double(settings.bytesLeft - layerBytes));
        SampleGrid grid(shape, row, end, limit);
        const WorkClock clock(visits);
        const Status drawn = draw(visits, projection, settings, grid, face);
        face.rasterSeconds += clock.seconds();
        rows = grid.endRow() - row;
        if (grid.overrun() && rows > 1) {
            rows /= 2;
            continue;
        }
        if (!drawn) return drawn.error();
        const WorkClock compressClock(visits);
        if (auto s = compress(grid, compression, visits.progress(), layerBytes, face); !s)
            return s.error();
        face.compressSeconds += compressClock.seconds();
        row += rows;
        rows *= 2;  // what comes may be sparser
    }
    --face.passes;
    face.samplesDropped =
        face.compression.droppedByLayers + face.compression.droppedByResets;
    return face;
}

}  // namespace mtsm::bake_detail
