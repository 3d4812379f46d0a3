// light_mean.h - a shadow factor as the mean over points of a light, with the conventions
// of mtsm/shadow.h: the same points on the light, keyed by the point, that maps take.
#pragma once
#include <algorithm>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

#include "base/finite.h"
#include "base/sampling.h"
#include "baseline/method.h"
#include "light/sample.h"

namespace mtsm::baseline {

/// Zero: none.
[[nodiscard]] inline glm::dvec3 normalOf(const Receivers& at, std::size_t i) {
    return at.normals ? at.normals[i] : glm::dvec3(0.0);
}

/// The points on the light that `point` is shaded with.
class PointsOnLight {
  public:
    PointsOnLight(const light::LightSampler& light, glm::dvec3 point)
        : light_(light), point_(point), sequence_(base::pointKey(point, 0)) {}

    /// Of a light without size all are one.
    [[nodiscard]] std::uint32_t atMost(int samples) const {
        return light_.isPoint() ? 1u : std::uint32_t(samples);
    }
    [[nodiscard]] light::LightSample operator()(std::uint32_t i) const {
        return light_.sample(point_, light_.isPoint() ? glm::dvec2(0.5) : sequence_(i));
    }

  private:
    const light::LightSampler& light_;
    glm::dvec3 point_;
    base::SquareSequence sequence_;
};

/// One minus the mean of visible(sample), a number in [0, 1], over `samples` points of
/// the light; those below the horizon of `normal` (unit; zero: none) count as blocked and
/// are not asked for. 0 where the light does not shine, or the point is not finite.
template <typename Visible>
[[nodiscard]] float shadowFactorOf(const light::LightSampler& light, glm::dvec3 point,
                                   glm::dvec3 normal, int samples,
                                   const Visible& visible) {
    if (!base::isFinite(point) || light.isBehind(point)) return 0.0f;
    const bool hasNormal = normal != glm::dvec3(0.0);
    const PointsOnLight points(light, point);
    const std::uint32_t count = points.atMost(samples);
    double sum = 0.0;
    for (std::uint32_t i = 0; i < count; ++i) {
        const light::LightSample sample = points(i);
        if (hasNormal && !(glm::dot(sample.delta, normal) > 0.0)) continue;
        sum += double(visible(sample));
    }
    return float(std::clamp(1.0 - sum / count, 0.0, 1.0));
}

}  // namespace mtsm::baseline
