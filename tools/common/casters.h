// casters.h - what a tool that bakes says of the casters that it was given.
#pragma once
#include <string>
#include <vector>

#include "mtsm/caster_files.h"
#include "mtsm/result.h"

namespace mtsm::tools {

/// Throws a Failure (badFile) for the first of the files that is a map, no caster.
void refuseMaps(const std::vector<CasterFile>& casters);

/// The settings of these casters that leave nothing of them to cast, and the way out;
/// empty if there are none.
[[nodiscard]] std::string emptyingSettings(const std::vector<CasterFile>& casters);

/// The error of a bake, and where nothing casts the settings that may be why, with the
/// way out.
[[nodiscard]] Error withEmptying(Error error, const std::vector<CasterFile>& casters);

}  // namespace mtsm::tools
