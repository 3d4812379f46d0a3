// near_sheets.h - the near field of a map of sheets: triangles, texture coordinates and
// textures.
//
// Triangles are those of near_triangles.h, packed texture by texture (near_chunks.h).
// Textures that are the same are one; what is as opaque all over is one texel. Textures
// of three channels become the mean of the three, as they do in a map of one.
#pragma once
#include <vector>

#include "bake/visits.h"
#include "mtsm/map.h"

namespace mtsm::bake_detail {

/// Of casters that are all triangles, some of which let light through: gives a single
/// face its near sheets if they fit, as bakeNearField(); the report says why not.
Status bakeNearSheets(Visits& visits, const BakeOptions& options, std::uint64_t bytesLeft,
                      std::vector<MapFace>& faces, BakeReport& report);

}  // namespace mtsm::bake_detail
