// placement.h - the options that say which light casts and what of the scene it sees:
// they mean the same in every tool that bakes.
#pragma once
#include <CLI/CLI.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/light_options.h"
#include "common/talk.h"
#include "mtsm/bake.h"
#include "mtsm/caster_files.h"

namespace mtsm::tools {

/// What was given; all of it may be missing.
struct PlacementOptions {
    LightOptions light;
    std::string lightName;
    std::optional<double> fovDegrees, near, far;
    std::optional<std::size_t> projection, cull;
};

/// --light-..., --projection, --fov, --near, --far and --cull.
void addPlacementOptions(CLI::App& app, PlacementOptions& placement);

/// Puts what was given into `bake`. UsageError where something is missing or contradicts;
/// errors of readLights() where a light is taken from a file. Warns of lights without a
/// size.
void applyPlacement(const PlacementOptions& given, const std::vector<CasterFile>& casters,
                    Talk& talk, BakeOptions& bake);

}  // namespace mtsm::tools
