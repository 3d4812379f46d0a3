// light_options.h - the --light-... options, which mean the same in every tool.
#pragma once
#include <CLI/CLI.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>

#include "mtsm/light.h"

namespace mtsm::tools {

/// What was given; all of it may be missing.
struct LightOptions {
    std::optional<std::size_t> shapeIndex;
    std::optional<glm::dvec3> position, target, direction, up;
    std::optional<double> radius, angleDegrees;
    std::optional<glm::dvec2> size;

    [[nodiscard]] bool any() const;
    /// The shape asked for, or the one that the size options imply (radius: disk, size:
    /// rect, angle: sun).
    [[nodiscard]] std::optional<LightShape> shape() const;
};

/// --light-shape, -position, -radius, -size and -angle. `shapeDefault` ends the help of
/// --light-shape.
void addLightSizeOptions(CLI::App& app, LightOptions& light, const std::string& group,
                         const std::string& shapeDefault);
/// --light-target, -direction and -up.
void addLightAimOptions(CLI::App& app, LightOptions& light, const std::string& group);

/// Puts what was given into `light`. UsageError where an option is given that the light's
/// shape does not use, or that contradicts another.
void applyLightOptions(const LightOptions& given, AreaLight& light);

}  // namespace mtsm::tools
