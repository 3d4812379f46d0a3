// map_faces.h - what queries through trees must know of a map's faces.
#pragma once
#include <cmath>

#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "trace/density_tree.h"

namespace mtsm::shadow {

/// The near field answers for so many pixel footprints of depth at least: twice as many
/// halve the error next to receivers and cost little (tests/bench/NOTES.md).
inline constexpr double kNearDepth = 32.0;

/// Can rays go through trees over the map's layers? It fits them (trace/fits_trees.h),
/// and there is memory. Makes the trees.
[[nodiscard]] bool hasTrees(const ShadowMap& map, Attenuation attenuation,
                            trace::DensityUse use);

/// Depths within which rays of a face may meet something; of one without layers, those
/// of all faces. `bias`: as asked for.
[[nodiscard]] ZRange depthsOf(const ShadowMap& map, std::uint32_t face,
                              float bias) noexcept;

/// A part of a ray, t from begin to end; none unless begin < end.
struct RayPart {
    double begin = 0.0, end = HUGE_VAL;
};
/// The part that belongs to one of six faces [trace/traverse.h]: z + t dz, [face], are
/// the ray's depths. What two faces share out between them they cut at one number.
[[nodiscard]] RayPart partIn(std::uint32_t face, const double (&z)[6],
                             const double (&dz)[6]) noexcept;

}  // namespace mtsm::shadow
