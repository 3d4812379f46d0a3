// bundle.h - many rays at once: those of up to 16 receivers to a light, or any others.
//
// Straight space. A face's rays are followed in (u, v, w): raster position u and v in
// pixels, and w = 1 / z (perspective) or -z (orthographic), which grows towards the eye.
// Lines and planes of the world are lines and planes there, so a ray is start + s delta
// for s in [0, 1], and nothing is divided as it goes. A ray ends (s = 1) where it leaves
// the depths that the map holds, at the latest: it never reaches the eye.
//
// A receiver has rays in groups of kLanes; a group is a row of the arrays below. Rays of
// the groups with one number should end close together (a part of the light), whatever
// their receivers: what lies off all of them is passed over at once. Answers never depend
// on that, nor on which receivers share a bundle: what a ray meets is decided by its
// receiver alone.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace mtsm::trace {

inline constexpr int kLanes = 16;
inline constexpr int kMostReceivers = 16;
inline constexpr int kMostGroups = 64;
inline constexpr int kMostRows = 256;  ///< receivers times groups
/// The same where optical depths are followed, or rays go on in other faces.
inline constexpr int kMostMediaRows = 64;

struct RayBundle {
    int receivers = 0, groups = 0;
    [[nodiscard]] int row(int receiver, int group) const noexcept {
        return receiver * groups + group;
    }

    /// [receiver]: start. Finite for all kMostReceivers.
    alignas(64) float u[kMostReceivers], v[kMostReceivers], w[kMostReceivers];
    /// [row][lane]: from start to end.
    alignas(64) float du[kMostRows][kLanes], dv[kMostRows][kLanes], dw[kMostRows][kLanes];
    /// [row][lane]: what is met at s <= begin does not count.
    alignas(64) float begin[kMostRows][kLanes];
    /// The same for surfaces among media, whose kernel reads both.
    alignas(64) float beginSurfaces[kMostMediaRows][kLanes];
    /// [row]: bit i is set if the ray of lane i is to be followed. Kernels clear the bits
    /// of rays that are blocked.
    std::uint16_t open[kMostRows];

    // What all rays of a receiver have in common.
    /// [receiver]: pixels that they go in u and v per w, from the least to the most. Rays
    /// that are level or lead away from the eye have no such bounds: then `wide`, one bit
    /// a receiver.
    alignas(64) float slopeLowU[kMostReceivers], slopeHighU[kMostReceivers];
    alignas(64) float slopeLowV[kMostReceivers], slopeHighV[kMostReceivers];
    std::uint16_t wide = 0;
    /// [receiver]: nothing counts (layers) that rises less than this above the start, w.
    alignas(64) float rise[kMostReceivers];
    // If there are several groups (clearGroup, boundRow):
    /// [group]: slopes of the rays of all receivers that are not wide.
    alignas(64) float groupLowU[kMostGroups], groupHighU[kMostGroups];
    alignas(64) float groupLowV[kMostGroups], groupHighV[kMostGroups];
    /// [group][receiver]: those of one receiver.
    alignas(64) float partLowU[kMostGroups][kMostReceivers];
    alignas(64) float partHighU[kMostGroups][kMostReceivers];
    alignas(64) float partLowV[kMostGroups][kMostReceivers];
    alignas(64) float partHighV[kMostGroups][kMostReceivers];
    /// [row]: the same.
    alignas(64) float rowLowU[kMostRows + kLanes], rowHighU[kMostRows + kLanes];
    alignas(64) float rowLowV[kMostRows + kLanes], rowHighV[kMostRows + kLanes];

    struct Slopes {
        float lowU = HUGE_VALF, highU = -HUGE_VALF, lowV = HUGE_VALF, highV = -HUGE_VALF;
    };
    /// Of no rays yet.
    void clearGroup(int group) noexcept {
        groupLowU[group] = groupLowV[group] = HUGE_VALF;
        groupHighU[group] = groupHighV[group] = -HUGE_VALF;
    }
    void boundRow(int receiver, int group, const Slopes& s) noexcept {
        const int number = row(receiver, group);
        partLowU[group][receiver] = rowLowU[number] = s.lowU;
        partHighU[group][receiver] = rowHighU[number] = s.highU;
        partLowV[group][receiver] = rowLowV[number] = s.lowV;
        partHighV[group][receiver] = rowHighV[number] = s.highV;
        if (wide >> receiver & 1) return;
        groupLowU[group] = std::min(groupLowU[group], s.lowU);
        groupHighU[group] = std::max(groupHighU[group], s.highU);
        groupLowV[group] = std::min(groupLowV[group], s.lowV);
        groupHighV[group] = std::max(groupHighV[group], s.highV);
    }

    // How coarsely rays may be answered.
    /// [receiver]: distance between neighbouring rays, pixels, per w that they are away
    /// from the start: something so much coarser than a pixel does.
    alignas(64) float spread[kMostReceivers];
    /// [receiver]: the most that rays to anywhere on the light go sideways, pixels per w:
    /// a surface that is off by so much w seems off by so many pixels.
    alignas(64) float slant[kMostReceivers];
    /// [receiver]: no level above this one may answer.
    std::uint8_t topLevel[kMostReceivers];
    /// [row][lane]: a texel that is covered in part blocks the rays whose threshold
    /// (0..15; exclusive or with a number of the texel) lies within its share.
    std::uint8_t threshold[kMostRows][kLanes];

    /// [receiver]: tangent planes; nothing below them counts. A place is planeU (u -
    /// start u) + planeV (v - start v) + planeW (w - start w) above, in a measure of
    /// which `planeHeight` is needed.
    bool hasPlanes = false;
    alignas(64) float planeU[kMostReceivers], planeV[kMostReceivers],
        planeW[kMostReceivers];
    float planeHeight = 0.0f;
};

/// All rays of some receivers: where they start, and what they go sideways.
struct RayHull {
    float uLow, uHigh, vLow, vHigh, wLow, wHigh;  ///< of the starts
    /// Pixels per w, as RayBundle's; all rays lead towards the eye.
    float slopeLowU, slopeHighU, slopeLowV, slopeHighV;
    float wFirst;  ///< nothing counts below this
    float spread;  ///< as RayBundle's, the largest
};

}  // namespace mtsm::trace
