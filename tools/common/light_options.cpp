// The --light-... options.
#include "common/light_options.h"

#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>

#include "common/arguments.h"
#include "common/tool.h"

namespace mtsm::tools {
namespace {

/// Refuses `option` for `shape` unless it is one that uses it.
void checkUse(bool given, bool used, const char* option, LightShape shape,
              const char* wayOut) {
    if (given && !used)
        throw UsageError(std::string(option) + ": a " + name(shape) +
                         " light has none; " + wayOut);
}

void checkUses(const LightOptions& given, LightShape shape) {
    const bool sun = shape == LightShape::sun;
    const char* const sizeOption =
        shape == LightShape::rect    ? "its size is --light-size W,H"
        : shape == LightShape::sun   ? "its size is --light-angle DEG"
        : shape == LightShape::point ? "choose --light-shape disk, rect, sphere or sun"
                                     : "its size is --light-radius R";
    checkUse(given.radius.has_value(),
             shape == LightShape::disk || shape == LightShape::sphere, "--light-radius",
             shape, sizeOption);
    checkUse(given.size.has_value(), shape == LightShape::rect, "--light-size", shape,
             sizeOption);
    checkUse(given.angleDegrees.has_value(), sun, "--light-angle", shape, sizeOption);
    checkUse(given.position.has_value(), !sun, "--light-position", shape,
             "its place is --light-direction X,Y,Z, the way its light travels");
    checkUse(given.target.has_value(), !sun, "--light-target", shape,
             "its place is --light-direction X,Y,Z, the way its light travels");
}

}  // namespace

bool LightOptions::any() const {
    return shapeIndex || position || target || direction || up || radius ||
           angleDegrees || size;
}

std::optional<LightShape> LightOptions::shape() const {
    if (shapeIndex) return static_cast<LightShape>(*shapeIndex);
    if (radius) return LightShape::disk;
    if (size) return LightShape::rect;
    if (angleDegrees) return LightShape::sun;
    return std::nullopt;
}

void addLightSizeOptions(CLI::App& app, LightOptions& light, const std::string& group,
                         const std::string& shapeDefault) {
    addChoice(app, "--light-shape", light.shapeIndex,
              {"point", "disk", "rect", "sphere", "sun"},
              "what shines (default: " + shapeDefault + ")")
        ->group(group);
    addTriple(app, "--light-position", light.position,
              "centre of the light, world space; of a sun none")
        ->group(group);
    addNumber(app, "--light-radius", light.radius, {0.0, kAny}, "R",
              "disk, sphere: radius in world units")
        ->group(group);
    app.add_option_function<std::string>(
           "--light-size",
           [&light](const std::string& text) {
               const auto v = parseNumbers("--light-size", text, 2, "W,H");
               if (v[0] < 0.0 || v[1] < 0.0)
                   throw UsageError("--light-size: found \"" + text +
                                    "\", expected W,H of at least 0 each");
               light.size = glm::dvec2(v[0], v[1]);
           },
           "rect: full width and height in world units")
        ->type_name("W,H")
        ->group(group);
    addNumber(app, "--light-angle", light.angleDegrees, {0.0, 180.0, true}, "DEG",
              "sun: angular diameter in degrees (the real one's\n"
              "is 0.53)")
        ->group(group);
}

void addLightAimOptions(CLI::App& app, LightOptions& light, const std::string& group) {
    auto* target = addTriple(app, "--light-target", light.target,
                             "what the light looks at (default: the centre of\n"
                             "the casters)");
    auto* direction = addTriple(app, "--light-direction", light.direction,
                                "where it shines instead of --light-target; for a\n"
                                "sun the way its light travels, and needed");
    target->group(group);
    direction->group(group)->excludes(target);
    addTriple(app, "--light-up", light.up,
              "what is up in the map; for a rect the axis of its\n"
              "height (default: Y, or Z when looking along Y)")
        ->group(group);
}

void applyLightOptions(const LightOptions& given, AreaLight& light) {
    if (given.shapeIndex) light.shape = static_cast<LightShape>(*given.shapeIndex);
    checkUses(given, light.shape);
    if (given.position) light.position = *given.position;
    if (given.direction) {
        const double length = glm::length(*given.direction);
        if (!(length > 0.0))
            throw UsageError(
                "--light-direction: found " + tripleText(*given.direction) +
                ", a vector of no length; expected X,Y,Z that are not all 0");
        light.direction = *given.direction / length;
    }
    if (given.up) {
        if (!(glm::length(*given.up) > 0.0))
            throw UsageError(
                "--light-up: found " + tripleText(*given.up) +
                ", a vector of no length; expected X,Y,Z that are not all 0");
        light.up = *given.up;
    }
    if (given.radius) light.radius = *given.radius;
    if (given.size) light.size = *given.size;
    if (given.angleDegrees) light.angularDiameter = glm::radians(*given.angleDegrees);
}

}  // namespace mtsm::tools
