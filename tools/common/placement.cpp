#include "common/placement.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <glm/trigonometric.hpp>

#include "common/arguments.h"
#include "common/tool.h"

namespace mtsm::tools {
namespace {

enum Projections : std::size_t { kFit = 0, kCube = 1 };

void addLight(CLI::App& app, PlacementOptions& a) {
    addLightSizeOptions(
        app, a.light, "Light",
        "what the size given belongs\nto: radius disk, size rect, angle sun; else point");
    addLightAimOptions(app, a.light, "Light");
    addText(app, "--light-name", a.lightName, "NAME",
            "take the light of this name from the inputs; the\n"
            "other options then change single properties of it")
        ->group("Light");
}

void addView(CLI::App& app, PlacementOptions& a) {
    const std::string group = "View";
    addChoice(app, "--projection", a.projection, {"fit", "cube"},
              "one window that fits the casters, or six views of\n"
              "90 degrees from the light to all sides, for lights\n"
              "among their casters (default: fit)")
        ->group(group);
    addNumber(app, "--fov", a.fovDegrees, {0.0, 180.0, true}, "DEG",
              "full field of view of a square window, more than 0 and\n"
              "below 180 (default: the window that fits the\n"
              "casters); not for a sun")
        ->group(group);
    addNumber(app, "--near", a.near, {0.0, kAny}, "Z",
              "keep nothing nearer to the light than this, world\n"
              "units (default: all that is before the light)")
        ->group(group);
    addNumber(app, "--far", a.far, {0.0, kAny}, "Z",
              "keep nothing farther from the light than this, world\n"
              "units (default: no end)")
        ->group(group);
    addChoice(app, "--cull", a.cull, {"none", "back", "front"},
              "leave out faces turned away from (back) or to\n"
              "(front) the light (default: none)")
        ->group(group);
}

/// A light of a file that stands elsewhere in the world.
FileLight moved(FileLight found, const glm::dmat4& transform) {
    AreaLight& light = found.light;
    const glm::dmat3 linear(transform);
    const double grown = std::cbrt(std::abs(glm::determinant(linear)));
    light.position = glm::dvec3(transform * glm::dvec4(light.position, 1.0));
    light.direction = glm::normalize(linear * light.direction);
    light.up = glm::normalize(linear * light.up);
    light.radius *= grown;
    light.size *= grown;
    return found;
}

/// The light called --light-name in one of the inputs.
FileLight findLight(const PlacementOptions& a, const std::vector<CasterFile>& casters,
                    const MeshFileOptions& options) {
    std::string names;
    for (const CasterFile& caster : casters) {
        if (casterKind(caster.path) != CasterKind::mesh) continue;
        for (FileLight& light : unwrap(readLights(caster.path, options))) {
            if (light.name == a.lightName)
                return moved(std::move(light), caster.transform);
            names += (names.empty() ? "" : ", ") + light.name;
        }
    }
    throw UsageError(
        "--light-name: no light \"" + a.lightName + "\" in the inputs; " +
        (names.empty() ? "they hold no light at all" : "there are: " + names));
}

/// Fills everything of `bake` that has to do with the light.
void chooseLight(const PlacementOptions& a, const std::vector<CasterFile>& casters,
                 Talk& talk, BakeOptions& bake) {
    AreaLight& light = bake.light;
    const bool named = !a.lightName.empty();
    if (named) {
        MeshFileOptions options;
        options.warn = [&talk](const std::string& text) { talk.warn(text); };
        const FileLight found = findLight(a, casters, options);
        light = found.light;
        bake.aimed = found.fov || light.shape == LightShape::rect;
        bake.fov = found.fov;
    } else {
        light.up = bake.up;
    }
    if (const auto shape = a.light.shape(); shape && (!named || a.light.shapeIndex))
        light.shape = *shape;
    applyLightOptions(a.light, light);

    const bool sun = light.shape == LightShape::sun;
    if (!named && !sun && !a.light.position)
        throw UsageError(std::string("--light-position is missing: a ") +
                         name(light.shape) +
                         " light needs a place, such as --light-position 2,5,3");
    if (!named && sun && !a.light.direction)
        throw UsageError(
            "--light-direction is missing: a sun needs the way that its light "
            "travels, such as --light-direction -1,-3,-1");
    if (sun && a.fovDegrees)
        throw UsageError(
            "--fov: a sun's map is parallel and has no field of view; its "
            "window fits the casters");
    const bool sized = a.light.radius || a.light.size || a.light.angleDegrees;
    if (!named && !sized && light.shape != LightShape::point)
        throw UsageError(std::string("the light's size is missing: give ") +
                         (sun                               ? "--light-angle DEG"
                          : light.shape == LightShape::rect ? "--light-size W,H"
                                                            : "--light-radius R"));
    if (light.shape != LightShape::point && lightRadius(light) == 0.0)
        talk.warn(std::string("the ") + name(light.shape) +
                  "'s size is zero: its shadows are those of a point, without penumbra");
    else if (light.shape == LightShape::rect &&
             std::min(light.size.x, light.size.y) == 0.0)
        talk.warn(
            "one side of the rect is zero: it is a line, and has no penumbra across it");

    if (a.light.direction) bake.aimed = true;
    if (a.light.target) {
        if (*a.light.target == light.position)
            throw UsageError(
                "--light-target: is where the light is; it must be elsewhere");
        bake.target = a.light.target;
        bake.aimed = false;
    }
    if (a.light.up) bake.up = *a.light.up;
}

/// What has to do with six faces, or with one.
void chooseProjection(const PlacementOptions& a, BakeOptions& bake) {
    bake.cube = a.projection.value_or(kFit) == kCube;
    if (a.fovDegrees) {
        if (*a.fovDegrees == 0.0) throw UsageError("--fov: must be more than 0 degrees");
        if (bake.cube)
            throw UsageError(
                "--fov: the six views of --projection cube have 90 degrees each; leave "
                "one of them out");
        bake.fov = glm::radians(*a.fovDegrees);
    }
    if (!bake.cube) return;
    if (bake.light.shape == LightShape::sun)
        throw UsageError("--projection: a sun has no place among its casters; use fit");
}

}  // namespace

void addPlacementOptions(CLI::App& app, PlacementOptions& placement) {
    addLight(app, placement);
    addView(app, placement);
}

void applyPlacement(const PlacementOptions& given, const std::vector<CasterFile>& casters,
                    Talk& talk, BakeOptions& bake) {
    if (given.near && given.far && !(*given.near < *given.far))
        throw UsageError("--near and --far: found " + numberText(*given.near) + " and " +
                         numberText(*given.far) + ", near must be less than far");
    chooseLight(given, casters, talk, bake);
    chooseProjection(given, bake);
    bake.near = given.near;
    bake.far = given.far;
    bake.cull = static_cast<Cull>(given.cull.value_or(0));
}

}  // namespace mtsm::tools
