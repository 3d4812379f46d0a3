#include "baseline/light_views.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "light/sample.h"

namespace mtsm::baseline {
namespace {

/// The view of a light of no size that stands `offset` from the given one's centre.
BakeOptions moved(const BakeOptions& aimed, glm::dvec3 offset) {
    BakeOptions view = aimed;
    AreaLight& light = view.light;
    light.position += offset;
    const double ahead = glm::dot(offset, glm::normalize(light.direction));
    if (light.shape == LightShape::sphere && !view.cube && !view.near)
        view.near = light.radius;
    // Counted from the plane through the light's centre.
    if (!view.cube) {
        if (view.near) view.near = std::max(0.0, *view.near - ahead);
        if (view.far) view.far = *view.far - ahead;
    }
    // A disk has a back, behind which nothing casts.
    const bool oneSided =
        light.shape == LightShape::disk || light.shape == LightShape::rect;
    light.shape = oneSided ? LightShape::disk : LightShape::point;
    light.radius = 0.0;
    return view;
}

}  // namespace

BakeOptions viewFrom(const BakeOptions& aimed, glm::dvec2 u) {
    const AreaLight& light = aimed.light;
    switch (light.shape) {
        case LightShape::disk: {
            const light::Frame frame = light::makeFrame(glm::normalize(light.direction));
            const glm::dvec2 d = light.radius * light::sampleDisk(u);
            return moved(aimed, d.x * frame.x + d.y * frame.y);
        }
        case LightShape::rect: {
            const light::Frame frame = light::rectFrame(light);
            const glm::dvec2 d = light.size * (u - 0.5);
            return moved(aimed, d.x * frame.x + d.y * frame.y);
        }
        case LightShape::sphere:
            return moved(aimed, light.radius * light::sampleCap(u, 2.0));
        case LightShape::sun: {
            const glm::dvec3 axis = glm::normalize(light.direction);
            const light::Frame frame = light::makeFrame(axis);
            const double height =
                2.0 * std::pow(std::sin(0.25 * light.angularDiameter), 2);
            const glm::dvec3 d = light::sampleCap(u, height);
            BakeOptions view = aimed;
            view.light.direction = d.x * frame.x + d.y * frame.y + d.z * axis;
            view.light.angularDiameter = 0.0;
            return view;
        }
        default:
            return moved(aimed, glm::dvec3(0.0));
    }
}

BakeOptions viewAcross(const BakeOptions& aimed, glm::dvec2 u) {
    if (aimed.light.shape != LightShape::sphere) return viewFrom(aimed, u);
    const light::Frame frame = light::makeFrame(glm::normalize(aimed.light.direction));
    const glm::dvec2 d = aimed.light.radius * light::sampleDisk(u);
    return moved(aimed, d.x * frame.x + d.y * frame.y);
}

}  // namespace mtsm::baseline
