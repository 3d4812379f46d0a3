// light_from_object.h - object space to light space in one affine step, in double.
//
// worldFromObject and Projection::lightFromWorld, composed once per mesh. The translation
// is taken relative to the eye before anything is added to it, so an object far from the
// world's origin (1e7 units) comes out as exactly as one that stands there.
#pragma once
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>

#include "mtsm/map.h"

namespace mtsm::raster {

struct LightFromObject {
    glm::dmat3 linear{1.0};
    glm::dvec3 origin{0.0};  ///< where the object's origin lies, light space

    LightFromObject(const Projection& projection, const glm::dmat4& worldFromObject)
        : linear(projection.lightFromWorldDirection(glm::dvec3(worldFromObject[0])),
                 projection.lightFromWorldDirection(glm::dvec3(worldFromObject[1])),
                 projection.lightFromWorldDirection(glm::dvec3(worldFromObject[2]))),
          origin(projection.lightFromWorld(glm::dvec3(worldFromObject[3]))) {}

    [[nodiscard]] glm::dvec3 operator()(glm::vec3 p) const noexcept {
        return linear[0] * double(p.x) + linear[1] * double(p.y) +
               linear[2] * double(p.z) + origin;
    }
};

/// True if the matrix turns a triangle's winding round.
[[nodiscard]] inline bool mirrors(const glm::dmat4& worldFromObject) noexcept {
    const glm::dvec3 x(worldFromObject[0]), y(worldFromObject[1]), z(worldFromObject[2]);
    return glm::dot(glm::cross(x, y), z) < 0.0;
}

}  // namespace mtsm::raster
