// light.h - the area lights whose shadows a map holds.
//
//     mtsm::AreaLight key;
//     key.shape = mtsm::LightShape::disk;
//     key.position = {0, 5, 2};
//     key.direction = {0, -1, 0};   // where it shines
//     key.radius = 0.4;
//
// Positions and directions are in world space, lengths in world units, angles in radians.
// Disks and rectangles shine to one side only, the side that `direction` points to.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "mtsm/result.h"

namespace mtsm {

enum class LightShape : std::uint32_t {
    point = 0,
    disk = 1,
    rect = 2,
    sphere = 3,
    sun = 4
};

/// The shape's name as tools spell it: "point", "disk", "rect", "sphere", "sun".
[[nodiscard]] const char* name(LightShape shape) noexcept;

/// One light. Members that a shape does not use are ignored.
struct AreaLight {
    LightShape shape = LightShape::point;
    glm::dvec3 position{0.0};  ///< centre; not for sun
    glm::dvec3 direction{
        0.0, -1.0, 0.0};  ///< unit; where disk and rect shine, how a sun's light travels
    glm::dvec3 up{0.0, 0.0,
                  1.0};    ///< rect: the axis of size.y, made perpendicular to direction
    double radius = 0.0;   ///< disk, sphere; >= 0
    glm::dvec2 size{0.0};  ///< rect: full width and height; >= 0
    double angularDiameter = 0.0;  ///< sun; in [0, pi)
};

/// Refuses what no light can be: non-finite numbers, a direction of no length, a negative
/// radius or size, an angular diameter outside [0, pi). Zero sizes are fine: the light is
/// then a point.
Status checkLight(const AreaLight& light);

/// Half of the largest extent across: radius, half of the diagonal, tan(angularDiameter /
/// 2) for a sun (per unit of distance), 0 for a point.
[[nodiscard]] double lightRadius(const AreaLight& light) noexcept;

/// Succeeds if every point of `light` lies within what a map baked for `baked` can
/// answer: the baked light's own shape, to 1e-6 of its size. The error says which bound
/// is exceeded.
Status lightFits(const AreaLight& light, const AreaLight& baked);

}  // namespace mtsm
