// clip.h - a convex polygon in light space, cut by planes.
//
// Two triangles that share an edge must go on sharing it after both were cut, or the fill
// rule cannot hold. So the point where an edge meets a plane is always computed from the
// endpoint inside towards the one outside, whichever way round the polygon runs.
#pragma once
#include <array>
#include <cstddef>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

namespace mtsm::raster {

/// Points p with dot(normal, p) + offset >= 0 are inside.
struct ClipPlane {
    glm::dvec3 normal{0.0};
    double offset = 0.0;

    [[nodiscard]] double distance(glm::dvec3 p) const noexcept {
        return glm::dot(normal, p) + offset;
    }
};

/// A triangle and what six planes can make of it: each adds one corner at most.
struct Polygon {
    static constexpr std::size_t kMaxCorners = 3 + 6;
    std::array<glm::dvec3, kMaxCorners> corner;
    std::size_t size = 0;

    void add(glm::dvec3 p) noexcept { corner[size++] = p; }
};

/// The part inside `plane`: fewer than 3 corners when nothing is left. The new corners
/// are convex combinations with positive weights, so their depth is exact to a few
/// roundings even where the endpoints' depths are many orders apart.
[[nodiscard]] inline Polygon clip(const Polygon& polygon, const ClipPlane& plane) {
    Polygon kept;
    if (polygon.size == 0) return kept;
    glm::dvec3 from = polygon.corner[polygon.size - 1];
    double fromDistance = plane.distance(from);
    for (std::size_t i = 0; i < polygon.size && kept.size < Polygon::kMaxCorners; ++i) {
        const glm::dvec3 to = polygon.corner[i];
        const double toDistance = plane.distance(to);
        const bool fromInside = fromDistance >= 0.0, toInside = toDistance >= 0.0;
        if (fromInside != toInside) {
            const glm::dvec3 in = fromInside ? from : to, out = fromInside ? to : from;
            const double a = fromInside ? fromDistance : toDistance;
            const double b = fromInside ? -toDistance : -fromDistance;
            kept.add((a * out + b * in) / (a + b));
        }
        if (toInside && kept.size < Polygon::kMaxCorners) kept.add(to);
        from = to;
        fromDistance = toDistance;
    }
    return kept;
}

/// The part of a triangle with near <= z <= far; corners made by the cut lie exactly on
/// the plane.
[[nodiscard]] inline Polygon clipDepth(const Polygon& polygon, double near, double far) {
    Polygon kept = polygon;
    bool inFront = false, behind = false;
    for (std::size_t i = 0; i < polygon.size; ++i) {
        inFront = inFront || polygon.corner[i].z < near;
        behind = behind || polygon.corner[i].z > far;
    }
    if (inFront) kept = clip(kept, {{0.0, 0.0, 1.0}, -near});
    if (behind) kept = clip(kept, {{0.0, 0.0, -1.0}, far});
    for (std::size_t i = 0; i < kept.size; ++i) {
        double& z = kept.corner[i].z;
        z = z < near ? near : z > far ? far : z;
    }
    return kept;
}

}  // namespace mtsm::raster
