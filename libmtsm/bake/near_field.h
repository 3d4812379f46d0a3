// near_field.h - the near field of a map, if it may have one and fits.
#pragma once
#include <vector>

#include "bake/face.h"

namespace mtsm::bake_detail {

/// Gives every face its near field if options ask for one, the casters allow it and it
/// fits in options.nearField and in a quarter of `bytesLeft`; the report says why not.
Status bakeNearField(Visits& visits, const BakeOptions& options, const CasterKinds& kinds,
                     std::uint64_t bytesLeft, std::vector<MapFace>& faces,
                     BakeReport& report);

}  // namespace mtsm::bake_detail
