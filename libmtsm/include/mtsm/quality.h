// quality.h - settings of bakes and queries by what is needed: a mean error.
//
//     const float error = mtsm::meanError(mtsm::Quality::preview);
//     auto casters = mtsm::measureCasters(source);  // mtsm/bake.h
//     mtsm::MapSettings settings = mtsm::mapSettingsFor(*casters, error);
//     ...  // bake with them
//     mtsm::QueryPlan plan = mtsm::planQueries(map, light, points, normals, count, error,
//                                              options);
//     mtsm::shadowFactors(map, light, points, normals, count, out, plan.options);
//
// An error here is the mean of |shadow factor - true one| over the points that are asked
// for, of a picture say: lit and dark ones count. Half of it is for the map and half for
// the light's samples; what the map does not use, samples may. What maps of a kind and a
// size have was measured (tests/bench/NOTES.md), as the worse ones of several scenes had
// it; what samples have is measured anew for every batch, on some of its points.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>

#include "mtsm/light.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"

namespace mtsm {

enum class Quality {
    draft,    ///< .02: where shadows fall
    preview,  ///< .005: noise that one has to look for
    final     ///< .001: a third of what the method's paper reports [Xie07, table 1]
};

[[nodiscard]] float meanError(Quality quality) noexcept;

/// What decides how large a map has to be.
struct CasterMeasures {
    bool letThrough = false;      ///< surfaces with opacities below 1 or alpha textures
    std::uint64_t triangles = 0;  ///< that can cast
    std::uint64_t strands = 0, volumes = 0;
    /// Of the strands, the mean along them, over the longest side of the box around all
    /// strands and meshes: about the share of a map's side that they are wide.
    float strandWidth = 0.0f;
};

/// What else a bake is asked for that decides it.
struct MapForm {
    bool cube = false, color = false;  ///< BakeOptions of these names
    bool nearField = true;             ///< may it have one, if its casters can?
};

/// How a map tells what is close to a receiver, from the most exact.
enum class MapKind {
    nearField,   ///< opaque triangles, kept beside the layers
    nearSheets,  ///< triangles that let light through, kept likewise
    nearHair,    ///< strands, with opaque triangles or without, kept likewise
    volume,      ///< fog, which has no edges
    sheets,      ///< surfaces that let light through
    surfaces,    ///< opaque ones, by their layers alone
    hair         ///< media: a map does not tell hair from fog, which is less
};
[[nodiscard]] MapKind kindOf(const ShadowMap& map) noexcept;

/// The mean error that a map with `resolution` pixels a side is expected to bring into a
/// picture that its casters fill.
[[nodiscard]] float mapError(MapKind kind, std::uint32_t resolution) noexcept;
/// Of this map.
[[nodiscard]] float mapError(const ShadowMap& map) noexcept;

/// What to bake, and what it will come to.
struct MapSettings {
    std::uint32_t resolution = 1024;  ///< pixels a side
    float tolerance = 0.005f;         ///< BakeOptions::tolerance
    /// BakeOptions::nearField, bytes: of strands and sheets what it may take at most,
    /// because their segments and texels are not counted.
    std::uint64_t nearField = 0;
    MapKind kind = MapKind::surfaces;
    float error = 0.0f;   ///< mapError() of it
    bool reached = true;  ///< is that as little as was asked for?
};

/// The smallest map that leaves samples half of `meanError`; if there is none, the
/// largest that was found to be of use: 4096 of opaque casters without a near field, else
/// 2048. Near fields of strands and sheets make 512 pixels about as good as 1024: they
/// get 1024 from .005 to .01, more below; where strands would be wider than four pixels,
/// fewer, down to 512. With six faces neither is of use, in colour that of sheets is not:
/// such maps are chosen as those without.
[[nodiscard]] MapSettings mapSettingsFor(const CasterMeasures& casters, float meanError,
                                         const MapForm& form = {}) noexcept;

/// How a batch is to be asked.
struct QueryPlan {
    ShadowOptions options;
    float mapError = 0.0f;     ///< expected, of the map
    float sampleError = 0.0f;  ///< expected mean over the points with these options
    /// Together they are no more than was asked for.
    bool reached = true;
};

/// The cheapest options with which the mean error over these points is expected to be
/// `meanError`, at most options.samples at a point. Asks for 512 to 1024 of the points,
/// spread over the batch, with 16 and with 64 samples; the other options are taken as
/// they are. `normals` may be null. Without points, or memory for a part of them, options
/// stay as they are, and nothing is said to be reached.
[[nodiscard]] QueryPlan planQueries(const ShadowMap& map, const AreaLight& light,
                                    const glm::dvec3* points, const glm::dvec3* normals,
                                    std::size_t count, float meanError,
                                    const ShadowOptions& options) noexcept;

}  // namespace mtsm
