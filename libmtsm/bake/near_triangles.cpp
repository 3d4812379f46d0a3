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

/// A corner of a mesh.
struct Corner {
    glm::dvec3 light;     ///< light space
    glm::dvec3 straight;  ///< straight space, if `between`
    bool usable;
    bool between;  ///< near and far, both included
};

struct Bounds {
    glm::dvec2 min, max;

    explicit Bounds(const Polygon& polygon) : min(polygon.corner[0]), max(min) {
        for (std::size_t i = 1; i < polygon.size; ++i)
            include(polygon.corner[i]);
    }
    Bounds(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c) : min(a), max(a) {
        include(b);
        include(c);
    }
    void include(glm::dvec3 p) {
        min = glm::min(min, glm::dvec2(p));
        max = glm::max(max, glm::dvec2(p));
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

    [[nodiscard]] Corner corner(glm::dvec3 light) const;
    /// Appends what is left of a triangle. `mirrored`, `origin2`: see
    /// TriangleSetup::triangle.
    void add(const Corner& a, const Corner& b, const Corner& c, bool mirrored,
             double origin2, std::vector<NearTriangle>& out) const;

  private:
    [[nodiscard]] ClipPlane side(glm::dvec2 axis, double scale, double constant) const {
        const glm::dvec2 xy = axis * scale;
        return perspective_ ? ClipPlane{{xy.x, xy.y, constant}, 0.0}
                            : ClipPlane{{xy.x, xy.y, 0.0}, constant};
    }
    [[nodiscard]] bool culled(glm::dvec3 normal, glm::dvec3 corner, bool mirrored) const;
    [[nodiscard]] glm::dvec3 straight(glm::dvec3 light) const;
    [[nodiscard]] Polygon straight(const Polygon& light) const;
    [[nodiscard]] bool misses(const Bounds& bounds) const;
    void addSquares(const Polygon& triangle, std::vector<NearTriangle>& out) const;
    static void addTriangle(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c,
                            std::vector<NearTriangle>& out);
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

glm::dvec3 StraightSpace::straight(glm::dvec3 light) const {
    const double w = perspective_ ? 1.0 / light.z : -light.z;
    return {scale_ * glm::dvec2(light) * (perspective_ ? w : 1.0) + offset_, w};
}

Polygon StraightSpace::straight(const Polygon& light) const {
    Polygon polygon;
    for (std::size_t i = 0; i < light.size; ++i)
        polygon.add(straight(light.corner[i]));
    return polygon;
}

Corner StraightSpace::corner(glm::dvec3 light) const {
    Corner c{light, {}, usable(light), light.z >= near_ && light.z <= far_};
    if (c.usable && c.between) c.straight = straight(light);
    return c;
}

/// Does it lie beside the window?
bool StraightSpace::misses(const Bounds& bounds) const {
    return bounds.max.x < 0.0 || bounds.max.y < 0.0 || bounds.min.x > window_.x ||
           bounds.min.y > window_.y;
}

void StraightSpace::add(const Corner& a, const Corner& b, const Corner& c, bool mirrored,
                        double origin2, std::vector<NearTriangle>& out) const {
    if (!(a.usable && b.usable && c.usable)) return;
    const raster::TriangleNormal normal(a.light, b.light, c.light, origin2);
    if (!normal.hasArea || culled(normal.normal, a.light, mirrored)) return;
    if (a.between && b.between && c.between) {
        const Bounds bounds(a.straight, b.straight, c.straight);
        if (misses(bounds)) return;
        if (!bounds.wide()) return addTriangle(a.straight, b.straight, c.straight, out);
    }
    Polygon polygon;
    for (const Corner* p : {&a, &b, &c})
        polygon.add(p->light);
    polygon = raster::clipDepth(polygon, near_, far_);
    if (polygon.size < 3) return;
    Polygon flat = straight(polygon);
    const Bounds bounds(flat);
    if (misses(bounds)) return;
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

void StraightSpace::addTriangle(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c,
                                std::vector<NearTriangle>& out) {
    NearTriangle& t = out.emplace_back();
    for (int axis = 0; axis < 3; ++axis) {
        t.corner[0][axis] = float(a[axis]);
        t.corner[1][axis] = float(b[axis]);
        t.corner[2][axis] = float(c[axis]);
    }
}

void StraightSpace::addFan(const Polygon& polygon, std::vector<NearTriangle>& out) {
    for (std::size_t i = 2; i < polygon.size; ++i)
        addTriangle(polygon.corner[0], polygon.corner[i - 1], polygon.corner[i], out);
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
    std::vector<Corner> corners(chunk.vertices());
    for (std::size_t i = 0; i < corners.size(); ++i)
        corners[i] = space.corner(lightFromObject(chunk.position(i)));
    for (std::size_t i = 0; i < count; ++i) {
        space.add(corners[chunk.corner(3 * i)], corners[chunk.corner(3 * i + 1)],
                  corners[chunk.corner(3 * i + 2)], mirrored, origin2, out.triangles);
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
