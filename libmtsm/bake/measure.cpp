#include "bake/measure.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <vector>

#include "base/parallel.h"
#include "raster/clip.h"
#include "raster/light_from_object.h"
#include "raster/mesh_chunk.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {

void Extent::include(glm::dvec3 p, bool perspective) noexcept {
    includeSquare(p, 0.0, perspective);
}

void Extent::includeSquare(glm::dvec3 p, double half, bool perspective) noexcept {
    const glm::dvec2 low(p.x - half, p.y - half), high(p.x + half, p.y + half);
    min = glm::min(min, glm::dvec3(low, p.z));
    max = glm::max(max, glm::dvec3(high, p.z));
    const double perDepth = perspective ? 1.0 / p.z : 1.0;
    const glm::dvec2 first = low * perDepth, last = high * perDepth;
    windowMin = glm::min(windowMin, glm::min(first, last));
    windowMax = glm::max(windowMax, glm::max(first, last));
    const glm::dvec2 far = glm::max(first * first, last * last);
    radius2 = std::max(radius2, far.x + far.y);
}

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

/// One task's triangles. Corners of triangles that lie wholly between near and far are
/// only marked; each is included once.
class ChunkMeasure {
  public:
    ChunkMeasure(const MeshView& mesh, std::size_t first, std::size_t count,
                 const LightFromObject& lightFromObject, const Depths& depths)
        : chunk_(mesh, first, count),
          origin2_(glm::dot(lightFromObject.origin, lightFromObject.origin)),
          depths_(depths),
          light_(chunk_.vertices()),
          within_(chunk_.vertices(), false) {
        for (std::size_t i = 0; i < light_.size(); ++i)
            light_[i] = lightFromObject(chunk_.position(i));
        for (std::size_t i = 0; i < 3 * count; i += 3)
            addTriangle(chunk_.corner(i), chunk_.corner(i + 1), chunk_.corner(i + 2));
        for (std::size_t i = 0; i < light_.size(); ++i) {
            if (within_[i]) extent_.include(light_[i], depths_.perspective);
        }
    }
    [[nodiscard]] const Extent& extent() const { return extent_; }

  private:
    [[nodiscard]] bool within(glm::dvec3 p) const {
        return p.z >= depths_.near && p.z <= depths_.far;
    }

    void addTriangle(std::size_t a, std::size_t b, std::size_t c) {
        const glm::dvec3 p = light_[a], q = light_[b], r = light_[c];
        if (!(usable(p) && usable(q) && usable(r))) {
            ++extent_.nonFinite;
        } else if (!raster::TriangleNormal(p, q, r, origin2_).hasArea) {
            ++extent_.degenerate;
        } else if (within(p) && within(q) && within(r)) {
            within_[a] = within_[b] = within_[c] = true;
        } else {
            if (std::min({p.z, q.z, r.z}) < depths_.near) ++extent_.cut;
            raster::Polygon polygon;
            for (const glm::dvec3 corner : {p, q, r})
                polygon.add(corner);
            polygon = raster::clipDepth(polygon, depths_.near, depths_.far);
            if (polygon.size < 3) ++extent_.outside;
            for (std::size_t i = 0; polygon.size >= 3 && i < polygon.size; ++i)
                extent_.include(polygon.corner[i], depths_.perspective);
        }
    }

    raster::MeshChunk chunk_;
    double origin2_;
    Depths depths_;
    std::vector<glm::dvec3> light_;
    std::vector<unsigned char> within_;
    Extent extent_;
};

Extent measureMesh(const MeshView& mesh, const Projection& frame, const Depths& depths) {
    constexpr std::size_t kChunk = 16384;  // triangles
    const LightFromObject lightFromObject(frame, mesh.worldFromObject);
    const std::size_t chunks = (mesh.triangleCount + kChunk - 1) / kChunk;
    std::vector<Extent> parts(chunks);
    base::parallelFor(std::size_t(0), chunks, [&](std::size_t i) {
        const std::size_t first = i * kChunk;
        const std::size_t count = std::min(kChunk, mesh.triangleCount - first);
        parts[i] = ChunkMeasure(mesh, first, count, lightFromObject, depths).extent();
    });
    Extent extent;
    for (const Extent& part : parts)
        extent.add(part);
    return extent;
}

/// A convex polygon's part between the depths.
void addPolygon(const raster::Polygon& polygon, const Depths& depths, Extent& extent) {
    double nearest = HUGE_VAL;
    for (std::size_t i = 0; i < polygon.size; ++i)
        nearest = std::min(nearest, polygon.corner[i].z);
    if (nearest < depths.near) ++extent.cut;
    const raster::Polygon kept = raster::clipDepth(polygon, depths.near, depths.far);
    if (kept.size == 0) ++extent.outside;
    for (std::size_t i = 0; i < kept.size; ++i)
        extent.include(kept.corner[i], depths.perspective);
}

/// Of strands [first, last), segment by segment, as wide as the strand is there.
Extent measureStrands(const StrandsView& view, std::size_t first, std::size_t last,
                      const LightFromObject& lightFromObject, double scale,
                      const Depths& depths) {
    Extent extent;
    const auto segment = [&](glm::dvec3 a, glm::dvec3 b, double width, double mean) {
        if (!(usable(a) && usable(b) && width > 0.0)) return;
        const double length = glm::distance(a, b);
        ++extent.segments;
        extent.segmentLength += length;
        extent.segmentArea += length * scale * mean;
        // Off the axis a ribbon that faces the eye is wider, and twice that in a bend.
        double half = scale * width;
        if (depths.perspective)
            half *=
                std::max(glm::length(a) / std::abs(a.z), glm::length(b) / std::abs(b.z));
        if (!std::isfinite(half)) half = 0.0;  // in the eye's plane
        const bool within =
            std::min(a.z, b.z) >= depths.near && std::max(a.z, b.z) <= depths.far;
        if (within) {
            extent.includeSquare(a, half, depths.perspective);
            extent.includeSquare(b, half, depths.perspective);
            return;
        }
        const glm::dvec3 sides[2] = {{half, half, 0.0}, {half, -half, 0.0}};
        for (const glm::dvec3 d : sides) {
            raster::Polygon ribbon;
            for (const glm::dvec3 p : {a - d, a + d, b + d, b - d})
                ribbon.add(p);
            addPolygon(ribbon, depths, extent);
        }
    };
    for (std::size_t s = first; s < last; ++s) {
        if (view.begin[s] == view.begin[s + 1]) continue;
        glm::dvec3 a = lightFromObject(view.points[view.begin[s]]);
        for (std::uint32_t i = view.begin[s]; i + 1 < view.begin[s + 1]; ++i) {
            const glm::dvec3 b = lightFromObject(view.points[i + 1]);
            const float begin = view.widths ? view.widths[i] : view.width;
            const float end = view.widths ? view.widths[i + 1] : view.width;
            segment(a, b, std::max(begin, end), 0.5 * (double(begin) + double(end)));
            a = b;
        }
    }
    return extent;
}

Extent measureStrands(const StrandsView& view, const Projection& frame,
                      const Depths& depths) {
    constexpr std::size_t kChunk = 1024;  // strands
    const LightFromObject lightFromObject(frame, view.worldFromObject);
    const double scale =
        std::cbrt(std::abs(glm::determinant(glm::dmat3(view.worldFromObject))));
    const std::size_t chunks = (view.strandCount + kChunk - 1) / kChunk;
    std::vector<Extent> parts(chunks);
    base::parallelFor(std::size_t(0), chunks, [&](std::size_t i) {
        const std::size_t last = std::min(view.strandCount, (i + 1) * kChunk);
        parts[i] = measureStrands(view, i * kChunk, last, lightFromObject, scale, depths);
    });
    Extent extent;
    for (const Extent& part : parts)
        extent.add(part);
    return extent;
}

/// The boxes of the blocks, face by face.
Extent measureVolume(const VolumeView& view, const Projection& frame,
                     const Depths& depths) {
    const LightFromObject lightFromIndex(frame, view.worldFromIndex);
    constexpr int kFaces[6][4] = {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4},
                                  {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}};
    Extent extent;
    for (std::size_t i = 0; i < view.blockCount; ++i) {
        glm::dvec3 corner[8];
        bool finite = true;
        for (int c = 0; c < 8; ++c) {
            const glm::ivec3 at(c & 1, c >> 1 & 1, c >> 2);
            corner[c] = lightFromIndex(
                glm::vec3(view.blocks[i] + at * VolumeView::kBlockSide) - 0.5f);
            finite = finite && usable(corner[c]);
        }
        if (!finite) continue;
        for (const auto& face : kFaces) {
            raster::Polygon polygon;
            for (const int c : face)
                polygon.add(corner[c]);
            addPolygon(polygon, depths, extent);
        }
    }
    return extent;
}

}  // namespace

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
    segments += other.segments;
    segmentLength += other.segmentLength;
    segmentArea += other.segmentArea;
    cut += other.cut;
}

void Extent::addCaster(const CasterView& caster, const Projection& frame, double near,
                       double far) {
    const Depths depths{near, far, frame.kind == ProjectionKind::perspective};
    if (const auto* mesh = std::get_if<MeshView>(&caster)) {
        ++meshes;
        triangles += mesh->triangleCount;
        if (mesh->opacity == 0.0f && !mesh->texture)
            transparent += mesh->triangleCount;
        else
            add(measureMesh(*mesh, frame, depths));
    } else if (const auto* strands = std::get_if<StrandsView>(&caster)) {
        add(measureStrands(*strands, frame, depths));
    } else if (const auto* volume = std::get_if<VolumeView>(&caster)) {
        add(measureVolume(*volume, frame, depths));
    }
}

Projection worldFrame() noexcept {
    Projection p;
    p.kind = ProjectionKind::orthographic;
    p.forward = {0.0, 0.0, 1.0};
    return p;
}

Result<Extent> measure(Visits& visits, const Projection& frame, double near, double far) {
    Extent extent;
    const Status status = visits.each([&](const CasterView& caster) -> Status {
        if (auto s = visits.progress()("reading casters", -1.0); !s) return s;
        extent.addCaster(caster, frame, near, far);
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
