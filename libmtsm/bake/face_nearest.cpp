// Opaque surfaces: the k nearest samples of every pixel are its layers [Xie07, sec. 4.2].
#include "bake/face.h"
#include "base/parallel.h"
#include "raster/kbuffer.h"
#include "raster/memory_budget.h"
#include "raster/rasteriser.h"

namespace mtsm::bake_detail {
namespace {

using raster::KBuffer;
using raster::KTile;

Tile layersOf(const KTile& tile) {
    Tile t;
    if (tile.empty()) return t;
    t.begin.resize(tile.pixels() + 1);
    std::uint32_t* count = t.begin.data() + 1;
    for (std::uint32_t y = 0; y < tile.height(); ++y, count += tile.width()) {
        for (std::uint32_t k = 0; k < tile.planes(); ++k) {
            const float* const row = tile.plane(k) + std::size_t(y) * tile.stride();
            for (std::uint32_t x = 0; x < tile.width(); ++x)
                count[x] += row[x] < KTile::kNoSample;
        }
    }
    for (std::uint32_t p = 0; p < tile.pixels(); ++p)
        t.begin[p + 1] += t.begin[p];
    t.z.resize(t.begin.back());
    const std::uint32_t* begin = t.begin.data();
    for (std::uint32_t y = 0; y < tile.height(); ++y, begin += tile.width()) {
        for (std::uint32_t k = 0; k < tile.planes(); ++k) {
            const float* const row = tile.plane(k) + std::size_t(y) * tile.stride();
            for (std::uint32_t x = 0; x < tile.width(); ++x) {
                if (begin[x] + k < begin[x + 1]) t.z[begin[x] + k] = row[x];
            }
        }
    }
    return t;
}

/// Turns the buffer into tiles, emptying it, and counts its samples.
Status takeLayers(KBuffer& buffer, const Progress& progress, Face& face) {
    constexpr const char* kStage = "building map";
    std::vector<KTile>& from = buffer.tiles();
    face.tiles.resize(from.size());
    std::vector<std::uint64_t> samples(from.size()), dropped(from.size());
    const std::size_t row = buffer.tilesX();
    for (std::size_t first = 0; first < from.size(); first += row) {
        if (auto s = progress(kStage, double(first) / double(from.size())); !s) return s;
        base::parallelFor(first, first + row, [&](std::size_t i) {
            face.tiles[i] = layersOf(from[i]);
            samples[i] = from[i].samples();
            dropped[i] = samples[i] - face.tiles[i].z.size() - from[i].copies();
            from[i].clear();
        });
        for (std::size_t i = first; i < first + row; ++i) {
            face.samples += samples[i];
            face.samplesDropped += dropped[i];
        }
    }
    return progress(kStage, 1.0);
}

}  // namespace

Result<Face> bakeNearest(Visits& visits, const Projection& projection,
                         const FaceSettings& settings) {
    const BakeOptions& options = settings.options;
    const Progress& progress = visits.progress();
    Face face;
    raster::MemoryBudget budget(settings.bytesLeft);
    KBuffer buffer(options.width, options.height, settings.layers, budget);
    BakeReport& casters = face.casters;
    const auto tell = [&](std::uint64_t done) {
        const double all = double(settings.triangles);
        return progress("rasterising", all > 0.0 ? double(done) / all : -1.0);
    };
    raster::Rasteriser rasteriser(projection, facing(options.cull), buffer,
                                  [&](std::uint64_t done) -> Status {
                                      if (budget.exceeded()) return tooLarge(options);
                                      return tell(done + casters.transparent);
                                  });
    const WorkClock clock(visits);
    if (auto s = tell(0); !s) return s.error();
    const auto status = visits.each(meshesOnly([&](const MeshView& mesh) -> Status {
        ++casters.meshes;
        casters.triangles += mesh.triangleCount;
        if (mesh.opacity > 0.0f || mesh.texture) {
            MeshView solid = mesh;
            solid.texture = nullptr;  // it lets nothing through
            return rasteriser.add(solid);
        }
        casters.transparent += mesh.triangleCount;
        return {};
    }));
    if (!status) return status.error();
    if (auto s = rasteriser.finish(); !s) return s.error();
    face.rasterSeconds = clock.seconds();
    face.triangles = rasteriser.counts();
    face.leavesWindow = face.triangles.leavesWindow;
    if (auto s = takeLayers(buffer, progress, face); !s) return s.error();
    return face;
}

}  // namespace mtsm::bake_detail
