// density_trace.h - the optical depth that the rays of a bundle meet in a map of media.
//
//     RayDepths depths{};                                    // all 0
//     for (each face) {
//         fill in bundle: the part of the rays that lies in the face, in its space
//         traceDensity(trees[face], {bias, darkDepth}, bundle, depths);
//     }
//     visibility of a ray in channel c = exp(-depths.depth[c][block][lane]), or 0 if that
//     is the threshold or less
//
// What a caller fills in (bundle.h). For a receiver P of depth z, L its way to a point of
// the light, z1 = z + t1 L.z the depth of the ray's end, at t1 of its way: at the latest
// where it leaves the depths of the map (pyramid.low and .high, media and surfaces, tell)
// and always in front of the eye.
// - u, v, w: P's raster position and 1/z (perspective) or -z (orthographic). A point at t
//   of the way is at s = t / t1 of an orthographic ray, at s = (t / t1) z1 / (z + t L.z)
//   of a perspective one.
// - begin: where media begin to count, s of the point kMediaStart pixel footprints from P
//   (0 with a normal, or where the ray is far enough above the receiver's plane).
// - beginSurfaces: the same for opaque surfaces: kStartBiases times the bias from P, or
//   where the ray is clear of the receiver's own surface.
// - texel: pixels between the ends (s = 1) of neighbouring rays times the part of that
//   which a texel may be. Rays to points D apart on the light end D t1 / f pixels apart,
//   f = pixelFootprint(z1). With a quarter of the light's diameter as D t1 the mean over
//   the light is off by less than with 64 rays they differ (tests/bench/NOTES.md).
// Rays that are not finite, and lanes whose open bit is not set, meet nothing.
//
// How a ray goes. At s it walks the texels of the level whose texels are at most texel s
// pixels, so about as many of each level, and their number grows with the logarithm of
// resolution. That follows from the ray alone: what shares its bundle changes nothing.
// Sixteen rays step at a time; texels with something in their way wait in a short queue,
// and each is then answered with as many of its slabs at once as a vector has lanes.
//
// Against the definition (traverse.h) with texel = 0
// and Attenuation::multiply: the samples of a layer are spread evenly over it, instead of
// being met one by one; what lies within a float's rounding of a pixel's border may be
// met on the other side; and a ray's stretch is capped at 16 times that of the centre ray
// at its start, instead of in every pixel. A receiver's plane is the caller's matter.
#pragma once
#include "trace/bundle.h"
#include "trace/density_tree.h"
#include "trace/traverse.h"

namespace mtsm::trace {

struct DensityTraceOptions {
    ZBias bias;  ///< of surfaces
    /// A ray that has met this much in every channel is not followed further.
    float darkDepth = 6.931472f;  // visibility 1/1024
};

/// [channel][block][lane]; channels that the map does not have stay as they are.
struct RayDepths {
    alignas(64) float depth[3][kMostBlocks][kLanes];
};

/// Adds what the rays of the bundle meet to `depths`, and closes rays that are dark
/// afterwards: their depth is then at least darkDepth. Finite for any input (if the
/// depths were). Allocates nothing.
void traceDensity(const DensityTree& tree, const DensityTraceOptions& options,
                  RayBundle& bundle, RayDepths& depths) noexcept;

}  // namespace mtsm::trace
