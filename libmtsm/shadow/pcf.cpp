// Percentage-closer filtering of the map, for small lights [Xie07, sec. 3].
//
// Samples are taken around the point's own place on the map, within a filter of size
//     resolution * light_radius * (1 / z_min - 1 / z) (eq. 1)
// which is how far the rays to a light at the eye spread until they reach z_min, the
// smallest depth of the map. Here the light may lie in front of the eye (push-back, eq.
// 4) or be a sun, so the spread is taken where the rays to the sample and to the light's
// centre cross z_min: for a light at the eye that is eq. 1.
//
// At its place a sample gets the visibility in front of the point's depth: the product
// over all layers in front, of any kind and with any number of samples, as a deep shadow
// map has it [Lokovic00].
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "shadow/query.h"

namespace mtsm::shadow {

/// On a map of one face.
Query::Lookup Query::lookupOnFace(const Receiver& receiver,
                                  const light::LightSample& sample) const noexcept {
    const double zMin = map_.zRange(0).min;
    const Projection& p = map_.projection(0);
    const glm::dvec3 point = p.lightFromWorld(receiver.point);
    const glm::dvec3 delta = p.lightFromWorldDirection(sample.delta);
    const glm::dvec3 axis = p.lightFromWorldDirection(light_.towards(receiver.point));
    if (!(point.z > zMin) || !(delta.z < 0.0) || !(axis.z < 0.0))
        return {};  // nothing is in front of it
    const auto atNearest = [&](glm::dvec3 d) {
        const double t = (zMin - point.z) / d.z;
        return p.rasterFromLight({point.x + t * d.x, point.y + t * d.y, zMin});
    };
    return {0, p.rasterFromLight(point) + atNearest(delta) - atNearest(axis), point.z};
}

/// Among six faces around the light, in world space, so that a filter reaches over their
/// edges: for a light at the eye, eq. 1 moves the point by (z / z_min - 1) times the
/// sample's distance from the light's centre. It stays at its distance from the eye; the
/// depth is that of the face that it then belongs to.
Query::Lookup Query::lookupOnFaces(const Receiver& receiver,
                                   const light::LightSample& sample) const noexcept {
    double zMin = HUGE_VAL;
    for (std::uint32_t face = 0; face < map_.faceCount(); ++face)
        zMin = std::min(zMin, double(map_.zRange(face).min));
    const Projection& p = map_.projection(receiver.face);
    const glm::dvec3 fromEye = receiver.point - p.eye;
    const double z = glm::dot(p.forward, fromEye);
    if (!(z > zMin)) return {};
    const glm::dvec3 across = sample.delta - light_.towards(receiver.point);
    const glm::dvec3 moved = fromEye + (z / zMin - 1.0) * across;
    const double distance = glm::length(moved);
    if (!(distance > 0.0)) return {};
    const glm::dvec3 place = p.eye + moved * (glm::length(fromEye) / distance);
    const std::uint32_t face = trace::faceOf(map_, place);
    const Projection& q = map_.projection(face);
    const glm::dvec3 inFace = q.lightFromWorld(place);
    if (!(inFace.z > 0.0)) return {};
    // Where faces meet, rounding must not take a point out of both.
    glm::dvec2 raster = q.rasterFromLight(inFace);
    const glm::dvec2 size(map_.info().width, map_.info().height);
    for (int i = 0; i < 2; ++i) {
        if (raster[i] > -trace::kFaceMargin && raster[i] < size[i] + trace::kFaceMargin)
            raster[i] = std::clamp(raster[i], 0.0, std::nextafter(size[i], 0.0));
    }
    return {face, raster, inFace.z};
}

trace::ChannelVisibility Query::filtered(
    const Receiver& receiver, const light::LightSample& sample) const noexcept {
    constexpr trace::ChannelVisibility kClear = {1.0f, 1.0f, 1.0f};
    const Lookup at = map_.faceCount() == 1 ? lookupOnFace(receiver, sample)
                                            : lookupOnFaces(receiver, sample);
    const glm::dvec2 r = at.raster;
    if (!(r.x >= 0.0 && r.y >= 0.0 && r.x < map_.info().width &&
          r.y < map_.info().height))
        return kClear;
    const auto x = std::uint32_t(r.x), y = std::uint32_t(r.y);

    // Everything in front of the point along the centre ray, but for its own surface.
    trace::PixelCrossing inFront;
    inFront.zEnter = at.z - receiver.surfaceStart;
    inFront.zExit = 0.0;
    if (receiver.hasNormal)
        inFront.counted =
            trace::clipToPlane(map_.projection(at.face), receiver.plane, x, y);
    if (inFront.counted.empty()) return kClear;
    const trace::TraceOptions options = traceOptions(receiver);
    const PixelLayers pixel = map_.pixel(at.face, x, y);
    trace::RayState state;
    if (media_) {
        trace::PixelCrossing media = inFront;
        media.surfaces = false;
        media.zEnter = at.z - receiver.mediaStart;
        media.zExit = std::max(0.0, inFront.zEnter);
        if (media.zEnter > media.zExit)
            trace::attenuate(pixel, map_.info(), media, options, state);
        inFront.zEnter = std::min(inFront.zEnter, media.zEnter);
    }
    if (inFront.zEnter > 0.0)
        trace::attenuate(pixel, map_.info(), inFront, options, state);
    return trace::channelsOf(state, map_.info().channels, options.threshold);
}

}  // namespace mtsm::shadow
