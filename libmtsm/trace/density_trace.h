// density_trace.h - the optical depth that the rays of a bundle meet in a map that is not
// opaque: the fast trace of media and sheets.
//
//     RayDepths depths{};                                    // all 0
//     for (each face) {
//         fill in bundle: the part of the rays that lies in the face, in its space
//         traceDensity(trees[face], {bias, darkDepth}, bundle, depths);
//     }
//     visibility of a ray in channel c = exp(-depths.depth[c][row][lane]), or 0 if that
//     is the threshold or less
//
// What a caller fills in (bundle.h). For a receiver P of depth z, L its way to a point of
// the light, whose depth along L changes by l: the ray ends at t1 of its way, at depth
// z1 = z + t1 l, and that is at the latest where it leaves the depths of the map
// (DensityPyramid::low and high; two biases further for sheets) and always in front of
// the eye.
// - u, v, w: P's raster position and 1/z (perspective) or -z (orthographic). The point at
//   t of the way is at s = t / t1 of an orthographic ray, at s = (t / t1) z1 / (z + t l)
//   of a perspective one.
// - begin: where media begin to count, the s of the point kMediaStart pixel footprints
//   from P, or as few as the map says; with a normal, where the ray is clear of the
//   receiver's plane. In maps of sheets: as beginSurfaces.
// - beginSurfaces: where sheets begin to count, the s of the point kStartBiases times the
//   bias from P, or where the ray is clear of the receiver's plane. What is in front of
//   `begin` does not count either way.
// - spread: a texel at s may be as large as spread dw s pixels (half of that for sheets),
//   as far as neighbouring rays are apart there (tests/bench/NOTES.md). A ray that comes
//   from another face begins where it enters this one: its texels are then finer than
//   they need be.
// Rays that are not finite, and lanes whose open bit is not set, meet nothing.
//
// How a ray goes. At s it walks the texels of the level whose texels are at most so
// large, so about as many of each level, and their number grows with the logarithm of
// resolution. That follows from the ray alone: what shares its bundle changes nothing.
// Sixteen rays step at a time, of several rows if these are few; texels with something in
// their way wait in a short queue, and each is then answered with as many of its slabs at
// once as a vector has lanes.
//
// Against the definition (traverse.h) with spread = 0 and Attenuation::multiply (a map
// asked with `subtract` stays with the definition):
// - the samples of a layer are spread evenly over it, instead of being met one by one;
// - what lies within a float's rounding of where a ray changes pixels, or of the bias,
// may
//   be met or not;
// - a ray's stretch is capped at 16 times that of the centre ray at its start, instead of
//   that of every pixel;
// - of several sheets within two biases of one another, of which a ray has paid for some
//   in the pixel before, parts of each are not paid for again, instead of the nearest.
// Above level 0 sheets are met within the bias times the texel's side in pixels. The
// receiver's plane is the caller's matter.
#pragma once
#include "trace/bundle.h"
#include "trace/density_tree.h"
#include "trace/traverse.h"

namespace mtsm::trace {

struct DensityTraceOptions {
    ZBias bias;  ///< of sheets
    /// A ray that has met this much in every channel is not followed further.
    float darkDepth = 6.931472f;  // visibility 1/1024
};

/// [channel][row][lane]; channels that the map does not have stay as they are.
struct RayDepths {
    alignas(64) float depth[3][kMostMediaRows][kLanes];
};

/// Adds what the rays of the bundle meet to `depths`, and closes rays that are dark
/// afterwards: their depth is then at least darkDepth. Finite for any input (if the
/// depths were). Allocates nothing.
void traceDensity(const DensityTree& tree, const DensityTraceOptions& options,
                  RayBundle& bundle, RayDepths& depths) noexcept;

/// Turns the depths of `rows` rows into what they leave of the light: exp(-depth), 0 if
/// that is the threshold or less. Of rays that are not in `followed` [row] it is 1 if
/// they are in `clear`, else 0.
void seeThrough(int rows, std::uint32_t channels, float threshold,
                const std::uint16_t* followed, const std::uint16_t* clear,
                RayDepths& depths) noexcept;

/// May any ray of the hull meet something? Where that is not soon found out, it may. What
/// is told to be free is so for any ray's texels. Allocates nothing.
[[nodiscard]] bool mayMeet(const DensityTree& tree, const DensityTraceOptions& options,
                           const RayHull& hull) noexcept;

}  // namespace mtsm::trace
