// Projection: world <-> light <-> raster.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "mtsm/map.h"

namespace mtsm {

glm::dvec3 Projection::lightFromWorldDirection(glm::dvec3 d) const noexcept {
    return {glm::dot(right, d), glm::dot(up, d), glm::dot(forward, d)};
}

glm::dvec3 Projection::lightFromWorld(glm::dvec3 p) const noexcept {
    return lightFromWorldDirection(p - eye);
}

glm::dvec3 Projection::worldFromLight(glm::dvec3 p) const noexcept {
    return eye + p.x * right + p.y * up + p.z * forward;
}

glm::dvec2 Projection::rasterFromLight(glm::dvec3 p) const noexcept {
    const double w = kind == ProjectionKind::perspective ? p.z : 1.0;
    return scale * glm::dvec2(p.x, p.y) / w + offset;
}

glm::dvec3 Projection::lightFromRaster(glm::dvec2 r, double z) const noexcept {
    const double w = kind == ProjectionKind::perspective ? z : 1.0;
    return {(r - offset) / scale * w, z};
}

double Projection::pixelFootprint(double z) const noexcept {
    const double w = kind == ProjectionKind::perspective ? z : 1.0;
    return w / std::min(std::abs(scale.x), std::abs(scale.y));
}

}  // namespace mtsm
