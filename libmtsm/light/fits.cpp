// lightFits: is every point of one light a point of another?
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/trigonometric.hpp>

#include "base/message.h"
#include "light/sample.h"
#include "mtsm/light.h"

namespace mtsm {
namespace {

using base::makeError;

/// How far the light reaches from its centre along the unit vector n.
double reach(const AreaLight& light, glm::dvec3 n) {
    switch (light.shape) {
        case LightShape::disk: {
            const double across = glm::dot(n, glm::normalize(light.direction));
            return light.radius * std::sqrt(std::max(0.0, 1.0 - across * across));
        }
        case LightShape::rect: {
            const light::Frame axes = light::rectFrame(light);
            return 0.5 * (light.size.x * std::abs(glm::dot(n, axes.x)) +
                          light.size.y * std::abs(glm::dot(n, axes.y)));
        }
        case LightShape::sphere:
            return light.radius;
        default:
            return 0.0;
    }
}

/// The largest distance of a point of the light from c. (A disk that lies in a plane with
/// c, or any that is compared with a sphere: the bound centre distance + radius is then
/// conservative.)
double farthest(const AreaLight& light, glm::dvec3 c) {
    if (light.shape != LightShape::rect)
        return glm::length(light.position - c) + lightRadius(light);
    const light::Frame axes = light::rectFrame(light);
    double most = 0.0;
    for (double sx : {-0.5, 0.5}) {
        for (double sy : {-0.5, 0.5}) {
            const glm::dvec3 corner =
                light.position + sx * light.size.x * axes.x + sy * light.size.y * axes.y;
            most = std::max(most, glm::length(corner - c));
        }
    }
    return most;
}

Status sunFits(const AreaLight& light, const AreaLight& baked) {
    const double cosine = std::clamp(
        glm::dot(glm::normalize(light.direction), glm::normalize(baked.direction)), -1.0,
        1.0);
    const double half = std::acos(cosine) + 0.5 * light.angularDiameter;
    if (half <= 0.5 * baked.angularDiameter * (1.0 + 1e-6) + 1e-7) return {};
    return makeError(ErrorCode::badArgument, "the sun reaches ", glm::degrees(half),
                     " degrees from the axis that the map was baked for, which holds ",
                     glm::degrees(0.5 * baked.angularDiameter),
                     ": bake a map for the larger sun");
}

}  // namespace

Status lightFits(const AreaLight& light, const AreaLight& baked) {
    if (auto s = checkLight(light); !s) return s;
    const bool sun = light.shape == LightShape::sun;
    if (sun != (baked.shape == LightShape::sun))
        return makeError(ErrorCode::badArgument, "a ", name(light.shape),
                         " light cannot be answered by a map that was baked for a ",
                         name(baked.shape), " light");
    if (sun) return sunFits(light, baked);

    const double slack =
        1e-6 * lightRadius(baked) + 1e-12 * (glm::length(baked.position) + 1.0);
    const auto beyond = [&](double found, double allowed, const char* what) -> Status {
        return makeError(ErrorCode::badArgument, "the light reaches ", found, " ", what,
                         " of the ", name(baked.shape),
                         " that the map was baked for, which allows ", allowed,
                         ": use a smaller light or bake a map for this one");
    };
    const glm::dvec3 offset = light.position - baked.position;
    if (baked.shape == LightShape::disk || baked.shape == LightShape::rect) {
        const glm::dvec3 normal = glm::normalize(baked.direction);
        const double off = std::abs(glm::dot(offset, normal)) + reach(light, normal);
        if (off > slack) return beyond(off, 0.0, "off the plane");
        const bool flat =
            light.shape == LightShape::disk || light.shape == LightShape::rect;
        if (flat && glm::dot(light.direction, normal) <= 0.0)
            return makeError(
                ErrorCode::badArgument,
                "the light shines to the other side than the one that the map was "
                "baked for");
    }
    if (baked.shape == LightShape::rect) {
        const light::Frame axes = light::rectFrame(baked);
        const double x = std::abs(glm::dot(offset, axes.x)) + reach(light, axes.x);
        const double y = std::abs(glm::dot(offset, axes.y)) + reach(light, axes.y);
        if (x > 0.5 * baked.size.x + slack)
            return beyond(x, 0.5 * baked.size.x, "from the middle");
        if (y > 0.5 * baked.size.y + slack)
            return beyond(y, 0.5 * baked.size.y, "from the middle");
        return {};
    }
    const double far = farthest(light, baked.position);
    if (far > lightRadius(baked) + slack)
        return beyond(far, lightRadius(baked), "from the centre");
    return {};
}

}  // namespace mtsm
