// light_grid.h - the fixed points that stand for a light while textures are made: a grid
// of n x n points, regular or with each point moved at random within its cell
// [Heckbert97, sec. 3.7].
//
// The order of the points is such that every beginning of the list is spread over the
// light: the first is in the middle, the first 4 lie in different quarters, and so on as
// far as n allows. So work may stop early and refine later.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/light.h"

namespace mtsm::baseline {

enum class LightGrid { jittered, regular };

inline constexpr int kMaxGridSide = 256;

/// n * n points of the unit square, in the order said above.
[[nodiscard]] std::vector<glm::dvec2> gridPoints(int n, LightGrid grid,
                                                 std::uint32_t seed);

/// A piece of a light, as a point.
struct LightPoint {
    glm::dvec3 position{0.0};  ///< world; of a sun the unit vector towards it
    glm::dvec3 normal{0.0};    ///< unit: which way the piece shines; zero: to all sides

    /// Whether light leaves it towards p.
    [[nodiscard]] bool faces(glm::dvec3 p) const noexcept;
};

/// One point for lights of no size. A sphere's points lie all over it, so that about half
/// of them face any one place.
[[nodiscard]] std::vector<LightPoint> lightPoints(const AreaLight& light, int n,
                                                  LightGrid grid, std::uint32_t seed);

/// What the light's radiance is multiplied by, over all points together: the area; of a
/// rect with one side of no size its length; of a sun its solid angle; 1 for lights of no
/// size, so that their radiance is an intensity, or for a sun an irradiance.
[[nodiscard]] double lightMeasure(const AreaLight& light) noexcept;

/// Steradians that the light takes of what p sees, a disk's to 1e-3; 0 for lights of no
/// area and behind one-sided ones.
[[nodiscard]] double solidAngle(const AreaLight& light, glm::dvec3 p);

/// Steradians that the light would take if it lay all where it takes the most of what p
/// sees, area times cosine over squared distance: a cell of an n x n grid takes at most
/// the n^2th part. 0 as above.
[[nodiscard]] double densestAngle(const AreaLight& light, glm::dvec3 p);

}  // namespace mtsm::baseline
