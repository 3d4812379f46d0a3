// depth_map.h - plain depth maps, of one layer [Williams78] or several [Xie07, sec. 4.2]:
// maps whose casters are there or not there.
#pragma once
#include <cstdint>

#include "baseline/settings.h"
#include "mtsm/bake.h"
#include "mtsm/map.h"

namespace mtsm::baseline {

/// The options with their light turned to what it looks at, as bake() turns it for all
/// casters, so that every map of a comparison has one light, whatever casters it leaves
/// out. Bakes a small map of the light if only the casters' bounds can tell. Errors:
/// bake()'s.
Result<BakeOptions> aimedOptions(CasterSource& casters, const BakeOptions& options);

/// What rows that bake a map call "resolution" and "bias" (negative: as bake() has it).
void setResolutionAndBias(BakeOptions& options, const Settings& settings);

/// The nearest `layers` surfaces at every pixel's centre, the casters taken as opaque
/// (opaque_casters.h). Of a textured mesh a pixel has what stops half of the light or
/// more, as an alpha test does; its texture is filtered over the pixel. Surfaces at one
/// and the same depth are one, which stops what all of them stop. Of `options`
/// those that concern light that passes through (tolerance, subsamples, color) do not
/// count. Errors: bake()'s.
Result<ShadowMap> bakeDepthMap(CasterSource& casters, BakeOptions options,
                               std::uint32_t layers);

}  // namespace mtsm::baseline
