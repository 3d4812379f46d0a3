// near_boxes.h - what ShadowMap::create does with a near field.
#pragma once
#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm::map_detail {

/// What near_field.h states of chunks. Errors: badArgument.
[[nodiscard]] Status checkChunks(const MapFace& face, std::uint32_t number);

/// Fills the levels of all. The same for any number of threads.
void buildBoxes(MapFace& face);

/// To the last bit.
[[nodiscard]] bool sameChunks(const NearField& a, const NearField& b) noexcept;
[[nodiscard]] bool sameChunks(const NearHair& a, const NearHair& b) noexcept;

}  // namespace mtsm::map_detail
