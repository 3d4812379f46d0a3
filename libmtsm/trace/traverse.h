// traverse.h - one ray through a map: the definition that faster kernels are tested
// against.
//
// The ray is given relative to the map's eye in world axes: points o + t d for t in
// [tBegin, tEnd). Of every pixel that it crosses it meets the samples whose depth lies
// within the depths at which it enters and leaves, widened by the bias on both sides
// [Xie07, sec. 4.3].
#pragma once
#include <array>
#include <cmath>
#include <glm/vec3.hpp>

#include "mtsm/map.h"
#include "mtsm/shadow.h"

namespace mtsm::trace {

struct Ray {
    glm::dvec3 origin{0.0};  ///< relative to the eye, world axes; finite
    glm::dvec3 delta{0.0};   ///< finite; zero is clear
    double tBegin = 0.0;
    double tEnd = 1.0;  ///< may be infinite
};

/// A half-space outside which layers do not count: those of the receiver's own surface. A
/// layer, taken at the centre of its pixel, counts if it lies more than `height` above
/// the plane.
struct ReceiverPlane {
    glm::dvec3 point{0.0};   ///< relative to the eye, world axes
    glm::dvec3 normal{0.0};  ///< unit
    double height = 0.0;     ///< world units
};

struct TraceOptions {
    double bias = 0.0;       ///< z threshold, world units, >= 0
    double threshold = 0.0;  ///< stop when no channel has more visibility left than this
    Attenuation attenuation = Attenuation::multiply;
    const ReceiverPlane* plane = nullptr;  ///< null: every layer counts
};

/// Visibility per channel; what fell to the threshold or below is 0.
using ChannelVisibility = std::array<float, 3>;

/// What the layers of `map` leave of the ray [Xie07, sec. 5.2]. Channels that the map has
/// not repeat the first. Never NaN; a ray that crosses nothing gives 1.
[[nodiscard]] ChannelVisibility traceRay(const ShadowMap& map, const Ray& ray,
                                         const TraceOptions& options) noexcept;

/// Depths from low to high, both included; nothing if low > high.
struct Span {
    double low = -HUGE_VAL, high = HUGE_VAL;
    [[nodiscard]] bool empty() const noexcept { return !(low <= high); }
};

/// Takes from `visible` what one pixel's samples take from a ray that crosses the depths
/// `crossed` there; true if the ray is now at or below the threshold. A layer of no
/// visibility blocks if it lies within options.bias of `crossed`. Of the others only the
/// samples within `crossed` itself take their share: a ray that changes pixels near such
/// a layer would else pay for it in both. Layers outside `counted` do not count.
bool attenuate(const PixelLayers& pixel, std::uint32_t channels, Span crossed,
               Span counted, const TraceOptions& options,
               std::array<double, 3>& visible) noexcept;

/// The depths on the centre ray of pixel (x, y) that lie above the plane.
[[nodiscard]] Span clipToPlane(const Projection& projection, const ReceiverPlane& plane,
                               std::uint32_t x, std::uint32_t y) noexcept;

}  // namespace mtsm::trace
