// bundle.h - many rays at once: those of 16 receivers to the cells of a light, of one
// receiver to 16 points of each cell, or any 16 rays.
//
// Straight space. A face's rays are followed in (u, v, w): raster position u and v in
// pixels, and w = 1 / z (perspective) or -z (orthographic), which grows towards the eye.
// Lines and planes of the world are lines and planes there, so a ray is start + s delta
// for s in [0, 1], and nothing is divided as it goes. Where a ray enters the depths that
// the map holds is s = 0 at the earliest, where it leaves them or ends is s = 1: it never
// reaches the eye.
//
// A bundle has up to kMostBlocks blocks of kLanes rays. Lane i of every block starts at
// the same receiver; the rays of one block should end close together (a cell of the
// light): what lies off all of them is passed over at once. Answers never depend on that,
// nor on which rays share a bundle: what a ray meets is decided by that ray alone.
#pragma once
#include <cstdint>

namespace mtsm::trace {

inline constexpr int kLanes = 16;
inline constexpr int kMostBlocks = 64;

struct RayBundle {
    int blocks = 0;
    /// [lane]: start.
    alignas(64) float u[kLanes], v[kLanes], w[kLanes];
    /// [block][lane]: from start to end.
    alignas(64) float du[kMostBlocks][kLanes], dv[kMostBlocks][kLanes],
        dw[kMostBlocks][kLanes];
    /// [block][lane]: what is met at s <= begin does not count (the receiver's own
    /// surface).
    alignas(64) float begin[kMostBlocks][kLanes];
    /// The same for opaque surfaces, if that is behind `begin`, in kernels that know both
    /// (density_trace.h).
    alignas(64) float beginSurfaces[kMostBlocks][kLanes];
    /// [lane]: kernels of maps that are not opaque may answer from texels as large as
    /// texel s pixels at s: a part of how far apart rays to the ends of the light are
    /// there. 0: from single pixels only.
    alignas(64) float texel[kLanes];
    /// [block]: bit i is set if the ray of lane i is to be followed. Kernels clear the
    /// bits of rays that are blocked.
    std::uint16_t open[kMostBlocks];
};

}  // namespace mtsm::trace
