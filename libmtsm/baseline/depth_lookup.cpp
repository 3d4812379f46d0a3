#include "baseline/depth_lookup.h"

#include <algorithm>
#include <cmath>

namespace mtsm::baseline {
namespace {

/// The first layer that does not lie in front of z.
std::uint32_t firstFrom(const PixelLayers& pixel, double z) {
    std::uint32_t i = 0;
    while (i < pixel.count && double(pixel.z[i]) < z)
        ++i;
    return i;
}

}  // namespace

DepthLookup::DepthLookup(const ShadowMap& map) noexcept
    : map_(map),
      bias_(shadow::biasOf(map, -1.0f)),
      opaque_(map.isOpaque()),
      media_(map.info().translucent == Translucent::media) {}

MapPlace DepthLookup::placeOf(glm::dvec3 point) const noexcept {
    MapPlace at;
    at.face = trace::faceOf(map_, point);
    const Projection& p = map_.projection(at.face);
    const glm::dvec3 q = p.lightFromWorld(point);
    if (!(q.z > 0.0)) return {};
    at.z = q.z;
    at.raster = p.rasterFromLight(q);
    if (map_.faceCount() == 1) return at;
    // Where faces meet, rounding must not take a point out of both.
    const glm::dvec2 size(map_.info().width, map_.info().height);
    for (int i = 0; i < 2; ++i) {
        if (at.raster[i] > -trace::kFaceMargin &&
            at.raster[i] < size[i] + trace::kFaceMargin)
            at.raster[i] = std::clamp(at.raster[i], 0.0, std::nextafter(size[i], 0.0));
    }
    return at;
}

bool DepthLookup::pixelAt(const MapPlace& at, glm::uvec2& pixel) const noexcept {
    const glm::dvec2 r = at.raster;
    if (!(r.x >= 0.0 && r.y >= 0.0 && r.x < map_.info().width &&
          r.y < map_.info().height))
        return false;
    pixel = {std::uint32_t(r.x), std::uint32_t(r.y)};
    return true;
}

/// Depths of layers that are not the receiver's own by its plane; all without one.
trace::Span DepthLookup::counted(const LookupReceiver& receiver, const MapPlace& at,
                                 glm::uvec2 pixel) const noexcept {
    if (!receiver.hasNormal) return {};
    return trace::clipToPlane(map_.projection(at.face), receiver.plane, pixel.x, pixel.y);
}

/// Of an opaque map: does a layer that counts lie in front of depth z?
bool DepthLookup::isInFront(const LookupReceiver& receiver, const PixelLayers& pixel,
                            std::uint32_t layer, double z) const noexcept {
    const double depth = pixel.z[layer];
    if (receiver.hasNormal || !(depth < z)) return depth < z;
    const double bias = bias_.at(z);
    double start = shadow::kStartBiases * bias;
    if (layer + 1 < pixel.count) {
        const double half = 0.5 * (double(pixel.z[layer + 1]) - depth);
        start = std::min(start, std::max(half, bias));
    }
    return depth + start < z;
}

float DepthLookup::visibility(const LookupReceiver& receiver,
                              const MapPlace& at) const noexcept {
    glm::uvec2 p;
    if (!pixelAt(at, p)) return 1.0f;
    if (!opaque_) return deepVisibility(receiver, at, p);
    const PixelLayers pixel = map_.pixel(at.face, p.x, p.y);
    if (pixel.count == 0 || !(pixel.z[0] < at.z)) return 1.0f;
    const trace::Span within = counted(receiver, at, p);
    const std::uint32_t first = firstFrom(pixel, within.low);
    if (first == pixel.count || pixel.z[first] > within.high) return 1.0f;
    return isInFront(receiver, pixel, first, at.z) ? 0.0f : 1.0f;
}

/// Everything in front along the centre ray: media from closer to the receiver on than
/// surfaces (as shadow/pcf.cpp).
float DepthLookup::deepVisibility(const LookupReceiver& receiver, const MapPlace& at,
                                  glm::uvec2 p) const noexcept {
    const PixelLayers pixel = map_.pixel(at.face, p.x, p.y);
    if (pixel.count == 0) return 1.0f;
    trace::PixelCrossing inFront;
    inFront.counted = counted(receiver, at, p);
    if (inFront.counted.empty()) return 1.0f;
    double surfaceStart = 0.0, mediaStart = 0.0;
    if (!receiver.hasNormal) {
        surfaceStart = shadow::kStartBiases * bias_.at(at.z);
        mediaStart =
            shadow::mediaStartOf(map_) * map_.projection(at.face).pixelFootprint(at.z);
    }
    inFront.zEnter = at.z - surfaceStart;
    trace::TraceOptions options;
    options.bias = bias_;
    trace::RayState state;
    if (media_) {
        trace::PixelCrossing media = inFront;
        media.surfaces = false;
        media.zEnter = at.z - mediaStart;
        media.zExit = std::max(0.0, inFront.zEnter);
        if (media.zEnter > media.zExit)
            trace::attenuate(pixel, map_.info(), media, options, state);
        inFront.zEnter = std::min(inFront.zEnter, media.zEnter);
    }
    if (inFront.zEnter > 0.0)
        trace::attenuate(pixel, map_.info(), inFront, options, state);
    const std::uint32_t channels = map_.info().channels;
    return shadow::mean(trace::channelsOf(state, channels, 0.0), channels);
}

void DepthLookup::addBlockers(const LookupReceiver& receiver, const MapPlace& at,
                              BlockerSum& sum) const noexcept {
    glm::uvec2 p;
    if (!pixelAt(at, p)) return;
    if (!opaque_) {
        addDeepBlockers(receiver, at, p, sum);
        return;
    }
    const PixelLayers pixel = map_.pixel(at.face, p.x, p.y);
    if (pixel.count == 0 || !(pixel.z[0] < at.z)) return;
    const trace::Span within = counted(receiver, at, p);
    for (std::uint32_t i = firstFrom(pixel, within.low);
         i < pixel.count && pixel.z[i] <= within.high; ++i) {
        if (!isInFront(receiver, pixel, i, at.z)) return;
        sum.depths += pixel.z[i];
        sum.weight += 1.0;
    }
}

void DepthLookup::addDeepBlockers(const LookupReceiver& receiver, const MapPlace& at,
                                  glm::uvec2 p, BlockerSum& sum) const noexcept {
    const PixelLayers pixel = map_.pixel(at.face, p.x, p.y);
    const std::uint32_t channels = map_.info().channels;
    trace::Span within = counted(receiver, at, p);
    const double start = receiver.hasNormal ? 0.0
                         : media_ ? map_.projection(at.face).pixelFootprint(at.z)
                                  : shadow::kStartBiases * bias_.at(at.z);
    within.high = std::min(within.high, at.z - start);
    double before = 1.0;
    for (std::uint32_t i = 0; i < pixel.count; ++i) {
        double v = 0.0;
        for (std::uint32_t c = 0; c < channels; ++c)
            v += pixel.v ? double(pixel.v[c * pixel.vStride + i]) / channels : 0.0;
        // n samples at a + j (z - a) / n: their mean depth, and those in front of an end.
        const double z = pixel.z[i], a = i > 0 ? double(pixel.z[i - 1]) : z;
        const double n = pixel.n ? pixel.n[i] : 1.0;
        if (!(a <= within.high)) return;
        const double high = std::min(z, within.high);
        const double met = z <= within.high ? n : std::floor((high - a) * n / (z - a));
        const double depth = a + (z - a) * (met + 1.0) / (2.0 * n);
        if (met > 0.0 && depth >= within.low) {
            const double taken = (before - v) * met / n;
            sum.depths += taken * depth;
            sum.weight += taken;
        }
        if (!(v > 0.0)) return;
        before = v;
    }
}

}  // namespace mtsm::baseline
