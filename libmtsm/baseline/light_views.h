// light_views.h - the views from single points of a light, for methods that keep a map
// for each of several points.
//
// All of them look along the axis of the light's own map, with its field of view: each
// sees what its point of the light sees [Xie07, eq. 4 is where these frusta become one].
// What a map clips at the light's plane (a sphere: at its far side) the views clip there
// as well. A sun's views look along their own directions.
#pragma once
#include <glm/vec2.hpp>

#include "mtsm/bake.h"

namespace mtsm::baseline {

/// From a point of the light as the axis sees it. u is in the unit square, whose centre
/// is the light's and whose border is the light's rim: a disk's, a rectangle's, a sun's,
/// a sphere's across the axis. `aimed` as aimedOptions() gives it (depth_map.h).
[[nodiscard]] BakeOptions viewAcross(const BakeOptions& aimed, glm::dvec2 u);

/// The same, but of a sphere from a point anywhere on it. Uniform in area (a sun: in
/// solid angle) for u uniform in the unit square.
[[nodiscard]] BakeOptions viewFrom(const BakeOptions& aimed, glm::dvec2 u);

}  // namespace mtsm::baseline
