// near_field.h - the near field of a map, if it may have one and fits.
#pragma once
#include <string>
#include <vector>

#include "bake/face.h"

namespace mtsm::bake_detail {

/// Gives every face its near field if options ask for one, the casters allow it and it
/// fits in options.nearField and in a quarter of `bytesLeft`; the report says why not.
Status bakeNearField(Visits& visits, const BakeOptions& options, const CasterKinds& kinds,
                     std::uint64_t bytesLeft, std::vector<MapFace>& faces,
                     BakeReport& report);

/// What would hold it, in whole megabytes: why there is none.
[[nodiscard]] std::string nearFieldTooSmall(std::uint64_t needed,
                                            const BakeOptions& options,
                                            std::uint64_t budget);

}  // namespace mtsm::bake_detail
