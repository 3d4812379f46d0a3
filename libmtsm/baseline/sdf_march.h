// sdf_march.h - soft shadows by marching through a distance field [Sdf].
//
//     auto field = meshField(casters, 256);                    // distance_field.h
//     marchShadowFactors(**field, light, points, normals, count, out, options);
//
// From the receiver towards the light's centre, as the article's code has it:
//     d = distance at the current point
//     t = t + d                                           (t starts at epsilon)
//     visible = min(visible, d / (t size))
//     d < hit: visible = 0, end
// In this order: the ratio is taken with the t of the next point. It ends at the light,
// behind all casters, or after a number of steps with what it has.
//
// A ray that passes an edge far away at the distance a, and beside it by the angle phi,
// has d = a sin(phi) there and comes to no smaller ratio than sin(phi) / (1 + sin(phi)).
// A light of radius r at the distance A is seen whole beyond tan(phi) = r / A. So the
// automatic size is sin(phi) / (1 + sin(phi)) of that angle: the outer border of the
// penumbra is where it should be. With strides s that are shorter than the distance it is
// sin(phi) / (1 + s sin(phi)), towards the plain d / (t size) with size = r / A.
//
// Differs for disks and rectangles: the article's light is a sun, with nothing behind it.
// Where the light's plane is nearer than the nearest surface may be, within a voxel, that
// surface may lie behind the light, and the point says nothing. So a ceiling lamp is not
// darkened by its ceiling, nor a receiver by what is nearer to the lamp than it is to the
// ray.
//
// A ray to the centre that hits is dark: the inner half of the penumbra is missing, and
// there is more shadow than there should be, as the article says.
//
// Voxels are spent on the longest side of all casters together. A ground a hundred times
// as long as the figure on it leaves the figure one or two of 128: leave such a ground
// out of the casters (a receiver need not cast), or ask for more voxels.
#pragma once
#include <cstddef>
#include <glm/vec3.hpp>

#include "baseline/distance_field.h"
#include "mtsm/light.h"

namespace mtsm::baseline {

struct MarchOptions {
    int steps = 128;
    double epsilon = 0.0;  ///< first point's distance; 0: two voxels, or 1e-3
    double hit = 0.0;      ///< nearer is a hit; 0: a tenth of a voxel, or 1e-4
    double size = 0.0;     ///< 0: from the light
    double stride = 1.0;   ///< (0, 1]: how much of the distance a step goes
};

/// Where a ray ends.
struct MarchEnd {
    double reach = 0.0;   ///< no further than this
    double light = 0.0;   ///< one-sided lights only: where it meets the light's plane,
    double cosine = 0.0;  ///< with this cosine to the plane's normal; 0: none
    double blur = 0.0;    ///< by how much the field's distances may be too large
};

/// Visible share of the light on the way from `origin` along the unit vector
/// `direction`. All of `options` must be given: no 0.
[[nodiscard]] double march(const DistanceField& field, glm::dvec3 origin,
                           glm::dvec3 direction, const MarchEnd& end,
                           const MarchOptions& options) noexcept;

/// The size that puts the penumbra's outer border where a light of radius r at the
/// distance A puts it; `tangent` is r / A.
[[nodiscard]] double marchSize(double tangent, double stride) noexcept;

/// Conventions of mtsm/shadow.h; `normals` may be null, one that is zero is none. With a
/// normal, rays start a voxel above the receiver, and a light whose centre is below the
/// receiver's tangent plane is blocked.
void marchShadowFactors(const DistanceField& field, const AreaLight& light,
                        const glm::dvec3* points, const glm::dvec3* normals,
                        std::size_t count, float* out,
                        const MarchOptions& options = {}) noexcept;

}  // namespace mtsm::baseline
