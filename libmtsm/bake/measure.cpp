#include "bake/measure.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cmath>
#include <functional>
#include <glm/common.hpp>
#include <glm/geometric.hpp>

#include "raster/clip.h"
#include "raster/light_from_object.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {
namespace {

using raster::LightFromObject;

bool usable(glm::dvec3 p) {
    return std::abs(p.x) < raster::kLargestCoordinate &&
           std::abs(p.y) < raster::kLargestCoordinate &&
           std::abs(p.z) < raster::kLargestCoordinate;
}

struct Depths {
    double near, far;
    bool perspective;
};

void includeTriangle(Extent& extent, const glm::dvec3 (&p)[3], double origin2,
                     const Depths& depths) {
    if (!(usable(p[0]) && usable(p[1]) && usable(p[2]))) {
        ++extent.nonFinite;
        return;
    }
    if (!raster::TriangleNormal(p[0], p[1], p[2], origin2).hasArea) {
        ++extent.degenerate;
        return;
    }
    raster::Polygon polygon;
    for (const glm::dvec3& corner : p)
        polygon.add(corner);
    polygon = raster::clipDepth(polygon, depths.near, depths.far);
    if (polygon.size < 3) ++extent.outside;
    for (std::size_t i = 0; polygon.size >= 3 && i < polygon.size; ++i)
        extent.include(polygon.corner[i], depths.perspective);
}

Extent measureMesh(const MeshView& mesh, const Projection& frame, const Depths& depths) {
    using Range = tbb::blocked_range<std::size_t>;
    const LightFromObject lightFromObject(frame, mesh.worldFromObject);
    const double origin2 = glm::dot(lightFromObject.origin, lightFromObject.origin);
    return tbb::parallel_reduce(
        Range(0, mesh.triangleCount, 4096), Extent{},
        [&](const Range& range, Extent extent) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                const std::uint32_t* const corner = mesh.indices + 3 * i;
                const glm::dvec3 p[3] = {lightFromObject(mesh.positions[corner[0]]),
                                         lightFromObject(mesh.positions[corner[1]]),
                                         lightFromObject(mesh.positions[corner[2]])};
                includeTriangle(extent, p, origin2, depths);
            }
            return extent;
        },
        [](Extent a, const Extent& b) {
            a.add(b);
            return a;
        });
}

}  // namespace

void Extent::include(glm::dvec3 p, bool perspective) noexcept {
    min = glm::min(min, p);
    max = glm::max(max, p);
    const glm::dvec2 w = glm::dvec2(p.x, p.y) * (perspective ? 1.0 / p.z : 1.0);
    windowMin = glm::min(windowMin, w);
    windowMax = glm::max(windowMax, w);
    radius2 = std::max(radius2, glm::dot(w, w));
}

void Extent::add(const Extent& other) noexcept {
    min = glm::min(min, other.min);
    max = glm::max(max, other.max);
    windowMin = glm::min(windowMin, other.windowMin);
    windowMax = glm::max(windowMax, other.windowMax);
    radius2 = std::max(radius2, other.radius2);
    meshes += other.meshes;
    triangles += other.triangles;
    nonFinite += other.nonFinite;
    degenerate += other.degenerate;
    transparent += other.transparent;
    outside += other.outside;
}

Result<Extent> measure(Visits& visits, const Projection& frame, double near, double far) {
    const Depths depths{near, far, frame.kind == ProjectionKind::perspective};
    Extent extent;
    const Status status = visits.each([&](const MeshView& mesh) -> Status {
        if (auto s = visits.progress()("reading casters", -1.0); !s) return s;
        ++extent.meshes;
        extent.triangles += mesh.triangleCount;
        if (mesh.opacity == 0.0f)
            extent.transparent += mesh.triangleCount;
        else
            extent.add(measureMesh(mesh, frame, depths));
        return {};
    });
    if (!status) return status.error();
    // Which of -0 and 0 was met first depends on the order of the triangles.
    for (glm::dvec3* p : {&extent.min, &extent.max})
        *p += 0.0;
    for (glm::dvec2* p : {&extent.windowMin, &extent.windowMax})
        *p += 0.0;
    return extent;
}

}  // namespace mtsm::bake_detail
