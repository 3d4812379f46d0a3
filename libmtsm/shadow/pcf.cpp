// Percentage-closer filtering of the map, for small lights [Xie07, sec. 3].
//
// Samples are taken around the point's own place on the map, within a filter of size
//     resolution * light_radius * (1 / z_min - 1 / z) (eq. 1)
// which is how far the rays to a light at the eye spread until they reach z_min, the
// smallest depth of the map. Here the light may lie in front of the eye (push-back, eq.
// 4) or be a sun, so the spread is taken where the rays to the sample and to the light's
// centre cross z_min: for a light at the eye that is eq. 1.
#include <algorithm>
#include <cmath>

#include "shadow/query.h"

namespace mtsm::shadow {

float Query::filtered(const Receiver& receiver,
                      const light::LightSample& sample) const noexcept {
    for (std::uint32_t face = 0; face < map_.faceCount(); ++face) {
        const ZRange range = map_.zRange(face);
        if (range.empty()) continue;
        const Projection& p = map_.projection(face);
        const glm::dvec3 point = p.lightFromWorld(receiver.point);
        const glm::dvec3 delta = p.lightFromWorldDirection(sample.delta);
        const glm::dvec3 axis = p.lightFromWorldDirection(light_.towards(receiver.point));
        if (!(point.z > range.min) || !(delta.z < 0.0) || !(axis.z < 0.0))
            continue;  // nothing is in front of it
        const auto atNearest = [&](glm::dvec3 d) {
            const double t = (range.min - point.z) / d.z;
            return p.rasterFromLight({point.x + t * d.x, point.y + t * d.y, range.min});
        };
        const glm::dvec2 r =
            p.rasterFromLight(point) + atNearest(delta) - atNearest(axis);
        if (!(r.x >= 0.0 && r.y >= 0.0 && r.x < map_.info().width &&
              r.y < map_.info().height))
            continue;
        const auto x = std::uint32_t(r.x), y = std::uint32_t(r.y);

        // Everything in front of the point along the centre ray, but for its own surface.
        trace::PixelCrossing inFront;
        inFront.zExit = point.z - kStartBiases * receiver.bias;
        if (receiver.hasNormal)
            inFront.counted = trace::clipToPlane(p, receiver.plane, x, y);
        if (!(inFront.zExit > 0.0) || inFront.counted.empty()) continue;
        trace::RayState state;
        if (trace::attenuate(map_.pixel(face, x, y), map_.info().channels, inFront,
                             traceOptions(receiver), state))
            return 0.0f;
        return mean(
            {float(state.visible[0]), float(state.visible[1]), float(state.visible[2])},
            map_.info().channels);
    }
    return 1.0f;
}

}  // namespace mtsm::shadow
