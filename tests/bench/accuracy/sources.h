// sources.h - the casters of a measurement.
#pragma once
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::bench {

struct SourceOptions {
    std::vector<std::string> files;  ///< as mtsm/caster_files.h has them
    std::size_t furSegments = 0;     ///< not 0: a ball of fur with about so many instead
    std::optional<float> hairWidth, hairOpacity, densityScale;  ///< of CasterFile
};

std::unique_ptr<CasterSource> openCasters(const SourceOptions& options);

}  // namespace mtsm::bench
