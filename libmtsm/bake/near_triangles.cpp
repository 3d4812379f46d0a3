#include "bake/near_triangles.h"

#include <algorithm>

#include "base/parallel.h"
#include "raster/light_from_object.h"
#include "raster/mesh_chunk.h"

namespace mtsm::bake_detail {
namespace {

constexpr std::size_t kChunk = 16384;  // triangles of a task
constexpr std::size_t kBatch = 64;     // tasks side by side

/// What is left of one task's triangles.
void collectChunk(const MeshView& mesh, std::size_t first, std::size_t count,
                  const raster::LightFromObject& lightFromObject,
                  const StraightSpace& space, bool sources, NearTriangles& out) {
    const raster::MeshChunk chunk(mesh, first, count);
    const bool mirrored = raster::mirrors(mesh.worldFromObject);
    const double origin2 = glm::dot(lightFromObject.origin, lightFromObject.origin);
    std::vector<glm::dvec3> light(chunk.vertices());
    for (std::size_t i = 0; i < light.size(); ++i)
        light[i] = lightFromObject(chunk.position(i));
    for (std::size_t i = 0; i < count; ++i) {
        space.add({light[chunk.corner(3 * i)], light[chunk.corner(3 * i + 1)],
                   light[chunk.corner(3 * i + 2)]},
                  mirrored, origin2, out.triangles);
        if (sources) out.sources.resize(out.triangles.size(), std::uint32_t(first + i));
    }
}

}  // namespace

void collectNearMesh(const MeshView& mesh, const Projection& projection,
                     const StraightSpace& space, std::uint64_t most, bool sources,
                     NearTriangles& all) {
    const raster::LightFromObject lightFromObject(projection, mesh.worldFromObject);
    const std::size_t chunks = (mesh.triangleCount + kChunk - 1) / kChunk;
    std::vector<NearTriangles> parts(std::min(chunks, kBatch));
    for (std::size_t batch = 0; batch < chunks; batch += kBatch) {
        const std::size_t tasks = std::min(kBatch, chunks - batch);
        base::parallelFor(std::size_t(0), tasks, [&](std::size_t i) {
            parts[i].triangles.clear();
            parts[i].sources.clear();
            const std::size_t first = (batch + i) * kChunk;
            collectChunk(mesh, first, std::min(kChunk, mesh.triangleCount - first),
                         lightFromObject, space, sources, parts[i]);
        });
        for (std::size_t i = 0; i < tasks; ++i) {
            all.count += parts[i].triangles.size();
            if (all.count > most) {
                all.triangles = {};
                all.sources = {};
                continue;
            }
            const auto append = [](auto& to, const auto& from) {
                to.insert(to.end(), from.begin(), from.end());
            };
            append(all.triangles, parts[i].triangles);
            append(all.sources, parts[i].sources);
        }
    }
}

Result<NearTriangles> collectNear(Visits& visits, const Projection& projection,
                                  const BakeOptions& options, std::uint64_t most) {
    const StraightSpace space(projection, options);
    NearTriangles all;
    const Status status = visits.each(meshesOnly([&](const MeshView& mesh) -> Status {
        if (auto s = visits.progress()("collecting the near field", -1.0); !s) return s;
        if (mesh.opacity > 0.0f || mesh.texture)
            collectNearMesh(mesh, projection, space, most, false, all);
        return {};
    }));
    if (!status) return status.error();
    return all;
}

}  // namespace mtsm::bake_detail
