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
/// Throws a Failure (badFile) if none of the pixels that alpha leaves has a position, and
/// warns if few of them have one, or alpha leaves none. Without an alpha, pixels without
/// a position are background, and nobody is told. `wayOut` ends what is said.
void checkSurfaces(Talk& talk, const Pass& positions, const std::string& path,
                   const char* wayOut);
/// Warns of a layer that may be a picture.
void warnOfNormals(Talk& talk, const Pass& normals, const std::string& path);

}  // namespace mtsm::tools
