// sources.h - the casters of a measurement.
#pragma once
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::bench {

/// Of files; of a ball of fur with about so many segments, if that is not 0.
std::unique_ptr<CasterSource> openCasters(const std::vector<std::string>& files,
                                          std::size_t furSegments);

}  // namespace mtsm::bench
