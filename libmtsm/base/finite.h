// finite.h - is every component of a vector a number?
#pragma once
#include <cmath>
#include <glm/vec3.hpp>

namespace mtsm::base {

[[nodiscard]] inline bool isFinite(glm::dvec3 v) noexcept {
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

}  // namespace mtsm::base
