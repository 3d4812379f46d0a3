// rounding.h - depths and visibilities with fewer bits, so that their file is smaller.
//
// A depth that is off by a small part of the z threshold is met by the same rays, and
// what a sample's visibility is off by less than the tolerance no one can tell from
// compression. Numbers are rounded to powers of two, so order is kept: layers stay in
// their order, and visibilities go on falling.
#pragma once
#include "mtsm/map.h"

namespace mtsm::compress {

/// Rounds every depth to within `share` of the z threshold that `info` has at its power
/// of two, and every v to within `share` of info.toleranceAsked, relative to itself. What
/// is 0 stays 0, what is not does not become it. Returns the largest change of a v.
/// `share` in [0, 1]; `face` has to be valid (map.h).
float roundLayers(const MapInfo& info, double share, MapFace& face);

}  // namespace mtsm::compress
