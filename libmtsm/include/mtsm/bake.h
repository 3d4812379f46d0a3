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
#include "mtsm/quality.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm {

enum class Cull { none, back, front };

/// BakeOptions::nearField for bakes that are not told how large it may be.
inline constexpr std::uint64_t kAutomaticNearField = std::uint64_t(64) << 20;

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
    /// Six views of 90 degrees from the light's centre, to all sides: for lights among
    /// their casters. width and height are a face's and must be equal; no fov, no sun.
    /// near and far then count from the light's centre along each view's axis; without
    /// near, what lies in the largest cube inside a sphere casts nothing.
    bool cube = false;
    /// Cap on the layers of a pixel, >= 1. Of opaque surfaces the nearest are kept; what
    /// lets light through is merged into as many layers, beyond the tolerance if it must
    /// be. Without: 5 if every caster is an opaque surface, else no cap.
    std::optional<std::uint32_t> layers;
    /// Bound on |V - V'| along the centre ray that compression may introduce, in [0, 1];
    /// 0 keeps every sample as it is. A voxel is as many samples as that needs: one for
    /// each two thirds of it (of 0: for each 0.01, at least for each 0.0005) that the
    /// voxel takes of the light.
    float tolerance = 0.005f;
    /// Bounds on what one layer of several samples may hold, so that rays across the
    /// centre ray are right too: its optical depth, and its length in pixel footprints.
    float layerOpticalDepth = 0.4f, layerLength = 8.0f;
    /// Times that the accumulation of visibility may start again in a pixel.
    std::uint32_t resets = kAllResets;
    std::uint32_t subsamples = 1;  ///< centre rays per side of a pixel: 1, 2, 4 or 8
    /// Three visibility channels, for casters that tint the light.
    bool color = false;
    /// Keeps layers that no point of the light can see. Without, their number is stored
    /// in the map as the attribute "hiddenLayers".
    bool keepHidden = false;
    /// Depths may be off by this share of the z threshold, and visibilities, relative to
    /// themselves, by this share of the tolerance, so that the file is smaller; in [0,
    /// 1]. Stored in the map as the attribute "rounding" unless it is 0, which keeps
    /// every bit. Without: 1/64, or 0 if the tolerance is 0.
    std::optional<float> rounding;
    /// z threshold, >= 0, world units. Without: a pixel's footprint at a layer's depth.
    std::optional<float> bias;
    /// Bytes that the near field (mtsm/near_field.h) may take in memory; 0: none. Only
    /// casters that are all opaque triangles and strands have one, or, in a map of one
    /// face without colour, all triangles of any opacity. It is kept whole or not at all:
    /// BakeReport says what came of it. It takes no more than a quarter of what layers
    /// leave of maxBytes, because its making takes more.
    std::uint64_t nearField = 0;
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
    std::uint64_t strands = 0, segments = 0;  ///< of hair
    /// Of hair, means, world units; 0: none, or options that say all of the view had no
    /// need to look.
    double strandWidth = 0.0, segmentLength = 0.0;
    std::uint64_t volumes = 0, voxels = 0;  ///< voxels with a density
    std::uint64_t degenerate = 0;           ///< no area, or less than a double resolves
    std::uint64_t nonFinite = 0;            ///< a vertex is NaN or infinite
    std::uint64_t culled = 0;               ///< by `cull`
    std::uint64_t transparent = 0;          ///< left out because their opacity is 0
    std::uint64_t outside = 0;              ///< wholly outside window, near and far
    std::uint64_t clipped = 0;  ///< cut by near or far, or reaching out of the window
    std::uint64_t passes = 1;   ///< times that the casters were rasterised, band by band
    std::uint64_t droppedByLayers = 0;  ///< samples, because of the cap on layers
    std::uint64_t droppedByResets = 0;  ///< samples behind the last reset
    std::uint64_t droppedHidden = 0;    ///< layers that no point of the light sees
    /// Pixels in which the cap on layers took more than the tolerance allows.
    std::uint64_t pixelsOverTolerance = 0;
    /// In the near field, or that it would have held.
    std::uint64_t nearTriangles = 0, nearSegments = 0;
    std::uint64_t nearBytes = 0;  ///< that it takes in memory, or would take
    std::string noNearField;      ///< why there is none, although there was to be one
    double readSeconds = 0, rasterSeconds = 0, compressSeconds = 0, nearSeconds = 0;
};

struct Baked {
    ShadowMap map;
    BakeReport report;
};

/// Errors: badArgument (the message names the option and the way out), tooLarge,
/// cancelled, and what the source's visit() returns. Casters that leave no usable
/// triangle are a badFile error.
Result<Baked> bake(CasterSource& casters, const BakeOptions& options);

/// What decides how large a map has to be (mapSettingsFor() in mtsm/quality.h). Visits
/// the casters once; errors are the source's.
Result<CasterMeasures> measureCasters(CasterSource& casters);

}  // namespace mtsm
