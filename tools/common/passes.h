// passes.h - what a tool says of the passes that it was given.
#pragma once
#include <string>

#include "common/talk.h"
#include "mtsm/passes.h"

namespace mtsm::tools {

/// A layer of an EXR as messages have it.
[[nodiscard]] std::string layerText(const std::string& layer);

/// Warns of a layer that may be a picture, and of one too coarse for positions.
void warnOfPositions(Talk& talk, const Pass& positions, const std::string& path);
/// Warns of a layer that may be a picture.
void warnOfNormals(Talk& talk, const Pass& normals, const std::string& path);

}  // namespace mtsm::tools
