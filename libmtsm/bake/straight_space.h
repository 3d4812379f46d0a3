// straight_space.h - triangles from light space to straight space (mtsm/near_field.h),
// with everything that is cut away on the way.
#pragma once
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/bake.h"
#include "mtsm/map.h"
#include "raster/clip.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {

/// Pixels that a triangle may reach over: fewer than 65535 steps of 1/32.
inline constexpr double kMostPixels = 2000.0;
/// Pixels around the window.
inline constexpr double kMargin = 64.0;

struct NearTriangle {
    float corner[3][3];  ///< [corner][u, v, w]
};

/// Light space to straight space, with everything that is cut away on the way.
class StraightSpace {
  public:
    StraightSpace(const Projection& projection, const BakeOptions& options);

    /// Appends what is left of a triangle in light space. `mirrored`, `origin2`: see
    /// TriangleSetup::triangle.
    void add(const glm::dvec3 (&light)[3], bool mirrored, double origin2,
             std::vector<NearTriangle>& out) const;

  private:
    [[nodiscard]] raster::ClipPlane side(glm::dvec2 axis, double scale,
                                         double constant) const {
        const glm::dvec2 xy = axis * scale;
        return perspective_ ? raster::ClipPlane{{xy.x, xy.y, constant}, 0.0}
                            : raster::ClipPlane{{xy.x, xy.y, 0.0}, constant};
    }
    [[nodiscard]] bool culled(glm::dvec3 normal, glm::dvec3 corner, bool mirrored) const;
    [[nodiscard]] raster::Polygon straight(const raster::Polygon& light) const;
    void addSquares(const raster::Polygon& triangle,
                    std::vector<NearTriangle>& out) const;
    /// A convex polygon in straight space as triangles.
    static void addFan(const raster::Polygon& polygon, std::vector<NearTriangle>& out);

    bool perspective_;
    raster::Facing keep_;
    glm::dvec2 scale_, offset_, window_;
    double near_, far_;
    raster::ClipPlane sides_[4];
};

}  // namespace mtsm::bake_detail
