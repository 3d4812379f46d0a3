#include "bake/near_triangles.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>

#include "bake/face.h"
#include "base/parallel.h"
#include "raster/clip.h"
#include "raster/light_from_object.h"
#include "raster/mesh_chunk.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {
namespace {

using raster::ClipPlane;
using raster::Facing;
using raster::Polygon;

constexpr std::size_t kChunk = 16384;  // triangles of a task
constexpr std::size_t kBatch = 64;     // tasks side by side

bool usable(glm::dvec3 p) {
    return std::abs(p.x) < raster::kLargestCoordinate &&
           std::abs(p.y) < raster::kLargestCoordinate &&
           std::abs(p.z) < raster::kLargestCoordinate;
}

struct Bounds {
    glm::dvec2 min, max;

    explicit Bounds(const Polygon& polygon) : min(polygon.corner[0]), max(min) {
        for (std::size_t i = 1; i < polygon.size; ++i) {
            min = glm::min(min, glm::dvec2(polygon.corner[i]));
            max = glm::max(max, glm::dvec2(polygon.corner[i]));
        }
    }
    [[nodiscard]] bool wide() const {
        return max.x - min.x > kMostPixels || max.y - min.y > kMostPixels;
    }
};

/// Light space to straight space, with everything that is cut away on the way.
class StraightSpace {
  public:
    StraightSpace(const Projection& projection, const BakeOptions& options)
        : perspective_(projection.kind == ProjectionKind::perspective),
          keep_(facing(options.cull)),
          scale_(projection.scale),
          offset_(projection.offset),
          window_(options.width, options.height),
          near_(perspective_ ? std::max(projection.near, raster::kSmallestDepth)
                             : projection.near),
          far_(projection.far) {
        // Distances from the sides of the window are linear in light space, too.
        const glm::dvec2 low(-kMargin), high = window_ + kMargin;
        sides_[0] = side({1, 0}, scale_.x, offset_.x - low.x);
        sides_[1] = side({1, 0}, -scale_.x, high.x - offset_.x);
        sides_[2] = side({0, 1}, scale_.y, offset_.y - low.y);
        sides_[3] = side({0, 1}, -scale_.y, high.y - offset_.y);
    }

    /// Appends what is left of a triangle in light space. `mirrored`, `origin2`: see
    /// TriangleSetup::triangle.
    void add(const glm::dvec3 (&light)[3], bool mirrored, double origin2,
             std::vector<NearTriangle>& out) const;

  private:
    [[nodiscard]] ClipPlane side(glm::dvec2 axis, double scale, double constant) const {
        const glm::dvec2 xy = axis * scale;
        return perspective_ ? ClipPlane{{xy.x, xy.y, constant}, 0.0}
                            : ClipPlane{{xy.x, xy.y, 0.0}, constant};
    }
    [[nodiscard]] bool culled(glm::dvec3 normal, glm::dvec3 corner, bool mirrored) const;
    [[nodiscard]] Polygon straight(const Polygon& light) const;
    void addSquares(const Polygon& triangle, std::vector<NearTriangle>& out) const;
    /// A convex polygon in straight space as triangles.
    static void addFan(const Polygon& polygon, std::vector<NearTriangle>& out);

    bool perspective_;
    Facing keep_;
    glm::dvec2 scale_, offset_, window_;
    double near_, far_;
    ClipPlane sides_[4];
};

/// As the rasteriser has it; what is seen edge-on shows both sides.
bool StraightSpace::culled(glm::dvec3 normal, glm::dvec3 corner, bool mirrored) const {
    const double toPlane = perspective_ ? glm::dot(normal, corner) : normal.z;
    if (keep_ == Facing::any || toPlane == 0.0) return false;
    return ((toPlane > 0.0) != mirrored) != (keep_ == Facing::front);
}

Polygon StraightSpace::straight(const Polygon& light) const {
    Polygon polygon;
    for (std::size_t i = 0; i < light.size; ++i) {
        const glm::dvec3 p = light.corner[i];
        const double w = perspective_ ? 1.0 / p.z : -p.z;
        polygon.add(
            glm::dvec3(scale_ * glm::dvec2(p) * (perspective_ ? w : 1.0) + offset_, w));
    }
    return polygon;
}

void StraightSpace::add(const glm::dvec3 (&light)[3], bool mirrored, double origin2,
                        std::vector<NearTriangle>& out) const {
    const auto& [a, b, c] = light;
    if (!(usable(a) && usable(b) && usable(c))) return;
    const raster::TriangleNormal normal(a, b, c, origin2);
    if (!normal.hasArea || culled(normal.normal, a, mirrored)) return;
    Polygon polygon;
    for (const glm::dvec3& p : light)
        polygon.add(p);
    polygon = raster::clipDepth(polygon, near_, far_);
    if (polygon.size < 3) return;
    Polygon flat = straight(polygon);
    const Bounds bounds(flat);
    if (bounds.max.x < 0.0 || bounds.max.y < 0.0 || bounds.min.x > window_.x ||
        bounds.min.y > window_.y)
        return;
    if (!bounds.wide()) return addFan(flat, out);
    for (const ClipPlane& side : sides_)
        polygon = raster::clip(polygon, side);
    flat = straight(polygon);
    for (std::size_t i = 2; i < flat.size; ++i) {
        Polygon triangle;
        for (const std::size_t corner : {std::size_t(0), i - 1, i})
            triangle.add(flat.corner[corner]);
        addSquares(triangle, out);
    }
}

/// Cut where u or v is a multiple of kMostPixels.
void StraightSpace::addSquares(const Polygon& triangle,
                               std::vector<NearTriangle>& out) const {
    const Bounds bounds(triangle);
    const glm::dvec2 first = glm::floor(bounds.min / kMostPixels);
    const glm::dvec2 last = glm::max(first, glm::ceil(bounds.max / kMostPixels) - 1.0);
    const auto strip = [](const Polygon& polygon, glm::dvec3 axis, double square) {
        Polygon kept = raster::clip(polygon, {axis, -square * kMostPixels});
        return raster::clip(kept, {-axis, (square + 1.0) * kMostPixels});
    };
    for (double y = first.y; y <= last.y; ++y) {
        const Polygon row = strip(triangle, {0.0, 1.0, 0.0}, y);
        for (double x = first.x; x <= last.x; ++x)
            addFan(strip(row, {1.0, 0.0, 0.0}, x), out);
    }
}

void StraightSpace::addFan(const Polygon& polygon, std::vector<NearTriangle>& out) {
    for (std::size_t i = 2; i < polygon.size; ++i) {
        NearTriangle& t = out.emplace_back();
        const glm::dvec3* const corners[3] = {&polygon.corner[0], &polygon.corner[i - 1],
                                              &polygon.corner[i]};
        for (int c = 0; c < 3; ++c) {
            for (int axis = 0; axis < 3; ++axis)
                t.corner[c][axis] = float((*corners[c])[axis]);
        }
    }
}

/// What is left of one task's triangles, and of which of the mesh each is.
struct Part {
    std::vector<NearTriangle> triangles;
    std::vector<std::uint32_t> sources;
};

void collectChunk(const MeshView& mesh, std::size_t first, std::size_t count,
                  const raster::LightFromObject& lightFromObject,
                  const StraightSpace& space, Part& out) {
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
        out.sources.resize(out.triangles.size(), std::uint32_t(first + i));
    }
}

}  // namespace

void collectMesh(const MeshView& mesh, const Projection& projection,
                 const BakeOptions& options, std::uint64_t most, NearTriangles& all,
                 std::vector<std::uint32_t>* sources) {
    const StraightSpace space(projection, options);
    const raster::LightFromObject lightFromObject(projection, mesh.worldFromObject);
    const std::size_t chunks = (mesh.triangleCount + kChunk - 1) / kChunk;
    std::vector<Part> parts(std::min(chunks, kBatch));
    for (std::size_t batch = 0; batch < chunks; batch += kBatch) {
        const std::size_t tasks = std::min(kBatch, chunks - batch);
        base::parallelFor(std::size_t(0), tasks, [&](std::size_t i) {
            parts[i].triangles.clear();
            parts[i].sources.clear();
            const std::size_t first = (batch + i) * kChunk;
            collectChunk(mesh, first, std::min(kChunk, mesh.triangleCount - first),
                         lightFromObject, space, parts[i]);
        });
        for (std::size_t i = 0; i < tasks; ++i) {
            all.add(parts[i].triangles, most);
            if (sources && all.count <= most)
                sources->insert(sources->end(), parts[i].sources.begin(),
                                parts[i].sources.end());
        }
    }
}

}  // namespace mtsm::bake_detail
