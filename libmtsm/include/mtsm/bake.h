// bake.h - from casters and a light to a map.
//
//     mtsm::MeshFiles casters({"dragon.ply"});
//     mtsm::BakeOptions options;
//     options.light.shape = mtsm::LightShape::disk;
//     options.light.position = {2, 5, 3};
//     options.light.radius = 0.3;
//     auto baked = mtsm::bake(casters, options);
//     if (!baked) return complain(baked.error());
//     mtsm::writeMap(baked->map, "key.mtsm");
//
// World units throughout; angles in radians. Work runs in the caller's oneTBB arena; the
// map is the same for any number of threads and any order of triangles.
#pragma once
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <optional>
#include <string>

#include "mtsm/light.h"
#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm {

enum class Cull { none, back, front };

struct BakeOptions {
    AreaLight
        light;  ///< for every shape but sun, `direction` may be replaced by `target`
    /// What the light looks at. Neither target nor aimed: the centre of the casters'
    /// bounds.
    std::optional<glm::dvec3> target;
    /// Use light.direction as it stands, whatever the target (always so for sun).
    bool aimed = false;
    glm::dvec3 up{0.0, 1.0,
                  0.0};  ///< what is up in the map; any vector across the view will do
    /// Full field of view, in (0, pi), of a centred window with square pixels, across its
    /// larger side; not for sun. Without: the window that fits the casters (pixels up to
    /// 4 : 1), which is refused where it would reach further than 85 degrees off the
    /// axis.
    std::optional<double> fov;
    /// Distance along the axis from the light's plane (sun: from the nearest caster's
    /// depth), 0 <= near < far. Without near: the light's plane, a sphere's far side, and
    /// for a light of no size 1e-6 of the distance to the casters' far end.
    std::optional<double> near, far;
    std::uint32_t width = 1024, height = 1024;  ///< 1..kMaxResolution
    std::uint32_t layers = 5;                   ///< nearest samples kept per pixel, 1..64
    /// z threshold, >= 0, world units. Without: a pixel's footprint at a layer's depth.
    std::optional<float> bias;
    Cull cull = Cull::none;  ///< faces turned away from (back) or to (front) the eye
    std::uint64_t maxBytes = std::uint64_t(8)
                             << 30;  ///< for the depth buffer and the map
    std::string settings;            ///< stored in the map as MapInfo::settings
    /// Called now and then with what is being done and the fraction done, 0..1 (negative:
    /// unknown); returning false stops the bake (ErrorCode::cancelled).
    std::function<bool(const char* stage, double fraction)> progress;
};

/// What the bake met.
struct BakeReport {
    std::uint64_t meshes = 0, triangles = 0;
    std::uint64_t degenerate = 0;   ///< no area, or less than a double resolves
    std::uint64_t nonFinite = 0;    ///< a vertex is NaN or infinite
    std::uint64_t culled = 0;       ///< by `cull`
    std::uint64_t transparent = 0;  ///< left out because their opacity is 0
    std::uint64_t outside = 0;      ///< wholly outside window, near and far
    std::uint64_t clipped = 0;      ///< cut by near or far, or reaching out of the window
    double readSeconds = 0, rasterSeconds = 0;
};

struct Baked {
    ShadowMap map;
    BakeReport report;
};

/// Errors: badArgument (the message names the option and the way out), tooLarge,
/// cancelled, and what the source's visit() returns. Casters that leave no usable
/// triangle are a badFile error.
Result<Baked> bake(CasterSource& casters, const BakeOptions& options);

}  // namespace mtsm
