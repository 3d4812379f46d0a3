// AreaLight: what is a light, how large it is, and whether one lies within another.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

#include "base/finite.h"
#include "base/message.h"
#include "mtsm/light.h"

namespace mtsm {
namespace {

using base::makeError;

}  // namespace

const char* name(LightShape shape) noexcept {
    switch (shape) {
        case LightShape::point:
            return "point";
        case LightShape::disk:
            return "disk";
        case LightShape::rect:
            return "rect";
        case LightShape::sphere:
            return "sphere";
        case LightShape::sun:
            return "sun";
    }
    return "unknown";
}

Status checkLight(const AreaLight& light) {
    const auto invalid = [](const auto&... parts) -> Status {
        return makeError(ErrorCode::badArgument, parts...);
    };
    if (unsigned(light.shape) > unsigned(LightShape::sun))
        return invalid("light shape ", unsigned(light.shape), " is none of 0 to 4");
    if (!base::isFinite(light.position))
        return invalid("the light's position is not finite");
    const double length = glm::length(light.direction);
    if (!(length > 1e-30 && std::isfinite(length)))
        return invalid("the light's direction has no length or is not finite");
    if (!base::isFinite(light.up)) return invalid("the light's up vector is not finite");
    if (!(light.radius >= 0.0 && std::isfinite(light.radius)))
        return invalid("light radius ", light.radius, " must be finite and not negative");
    if (!(light.size.x >= 0.0 && light.size.y >= 0.0 && std::isfinite(light.size.x) &&
          std::isfinite(light.size.y)))
        return invalid("light size ", light.size.x, " x ", light.size.y,
                       " must be finite and not negative");
    if (!(light.angularDiameter >= 0.0 && light.angularDiameter < glm::pi<double>()))
        return invalid("angular diameter ", light.angularDiameter,
                       " radians must be in [0, pi)");
    return {};
}

double lightRadius(const AreaLight& light) noexcept {
    switch (light.shape) {
        case LightShape::point:
            return 0.0;
        case LightShape::disk:
        case LightShape::sphere:
            return light.radius;
        case LightShape::rect:
            return 0.5 * glm::length(light.size);
        case LightShape::sun:
            return std::tan(0.5 * light.angularDiameter);
    }
    return 0.0;
}

}  // namespace mtsm
