// traverse.h - one ray through a map: the definition that faster kernels are tested
// against.
//
// A ray is the points o + t d, t in [tBegin, tEnd], of world space. Of every pixel that
// it crosses it meets the samples whose depth lies within the depths at which it enters
// and leaves, widened on both sides by the bias [Xie07, sec. 4.3].
//
// Why the bias: a pixel's layer is one sample of a surface that may be tilted. Where the
// surface's depth changes more from pixel to pixel than the ray's, the ray is behind the
// layer of one pixel and in front of that of the next without ever being at the depth of
// either: without a bias it would slip through. And because a ray that changes pixels
// close to a sheet then meets two of its layers, as many samples of the next pixel as it
// met close to where it left the last one are not met again: a half-transparent sheet is
// paid for once.
//
// Media. In a map of media (Translucent::media) that holds for surfaces only: layers of
// one sample that are dark. All other layers are met where the ray crosses the depths of
// their samples: those from where it enters to where it leaves, without the latter, so
// that a sample at the very depth at which the ray changes pixels is met once. What they
// take goes by the ray's way per unit of depth, over that of the pixel's centre ray along
// which they were found, at most kMostStretch: so a homogeneous medium takes exp(-s way)
// at any slant. A ray of constant depth crosses none and loses nothing. Subtraction
// (Attenuation::subtract) takes what the paper says, at any slant.
//
// Six faces. A point of the ray belongs to the face in which its depth is greatest, to
// the first of several that are level (map.h). Depths are linear in t, so each face has
// one interval of the ray, and one number ends it and begins the next: they tile the
// ray whatever is rounded, at edges and corners too.
#pragma once
#include <array>
#include <cmath>
#include <glm/vec3.hpp>

#include "mtsm/map.h"
#include "mtsm/shadow.h"

namespace mtsm::trace {

struct Ray {
    glm::dvec3 origin{0.0};  ///< world; finite
    glm::dvec3 delta{0.0};   ///< finite; zero is clear
    double tBegin = 0.0;
    double tEnd = 1.0;  ///< may be infinite
    /// In a map of media, surfaces count from here on only, if that is behind tBegin.
    double tSurfaces = 0.0;
};

/// The z threshold at depth z is base + perDepth * z; world units.
struct ZBias {
    double base = 0.0, perDepth = 0.0;  ///< >= 0
    [[nodiscard]] double at(double z) const noexcept {
        return base + perDepth * std::abs(z);
    }
};

/// A half-space outside which layers do not count: those of the receiver's own surface. A
/// layer, taken at the centre of its pixel, counts if it lies more than `height` pixel
/// footprints (at the layer's depth) above the plane.
struct ReceiverPlane {
    glm::dvec3 point{0.0};   ///< world
    glm::dvec3 normal{0.0};  ///< unit
    double height = 0.0;
};

struct TraceOptions {
    ZBias bias;
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

/// How far beyond its face's window a point may lie by rounding, pixels.
inline constexpr double kFaceMargin = 0x1p-10;

/// The face that a point of world space belongs to.
[[nodiscard]] std::uint32_t faceOf(const ShadowMap& map, glm::dvec3 point) noexcept;

/// Depths from low to high, both included; nothing if low > high.
struct Span {
    double low = -HUGE_VAL, high = HUGE_VAL;
    [[nodiscard]] bool empty() const noexcept { return !(low <= high); }
};

/// Rays across the view meet few samples of a medium, each of which then counts for more.
inline constexpr double kMostStretch = 16.0;

/// A ray on its way through one pixel.
struct PixelCrossing {
    double zEnter = 0.0, zExit = 0.0;
    double bias = 0.0;     ///< z threshold there
    Span counted;          ///< layers outside do not count
    bool surfaces = true;  ///< false, in a map of media: surfaces do not count
    /// Media, multiplied: how much longer the ray's way through a slice of depth is than
    /// the centre ray's, at most kMostStretch.
    double stretch = 1.0;
};

/// What a ray has left.
struct RayState {
    std::array<double, 3> visible{1.0, 1.0, 1.0};
    /// Sheets: how many samples it has paid for close to where it left a pixel, and where
    /// that was.
    std::uint64_t open = 0;
    double tLeft = -HUGE_VAL;
};

/// What is left, as a query sees it: what fell to the threshold or below is 0.
[[nodiscard]] ChannelVisibility channelsOf(const RayState& state, std::uint32_t channels,
                                           double threshold) noexcept;

/// Takes from the ray what the samples of one pixel of a map take; true if it is now at
/// or below the threshold. A layer whose v is that of the layer before takes nothing.
bool attenuate(const PixelLayers& pixel, const MapInfo& info,
               const PixelCrossing& crossing, const TraceOptions& options,
               RayState& state) noexcept;

/// The depths on the centre ray of pixel (x, y) that lie above the plane.
[[nodiscard]] Span clipToPlane(const Projection& projection, const ReceiverPlane& plane,
                               std::uint32_t x, std::uint32_t y) noexcept;

}  // namespace mtsm::trace
