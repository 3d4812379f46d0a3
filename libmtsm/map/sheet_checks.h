// sheet_checks.h - what ShadowMap::create does with the sheets of a near field.
#pragma once
#include "mtsm/map.h"

namespace mtsm::map_detail {

/// What near_sheets.h states, but for the triangles. Errors: badArgument.
[[nodiscard]] Status checkSheets(const NearSheets& sheets, const MapInfo& info,
                                 std::size_t faces, std::uint32_t face);

/// Fills NearTexture::corners. The same for any number of
/// threads.
void buildSheets(NearSheets& sheets);

/// To the last bit.
[[nodiscard]] bool sameSheets(const NearSheets& a, const NearSheets& b) noexcept;

}  // namespace mtsm::map_detail
