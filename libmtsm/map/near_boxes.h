// near_boxes.h - what ShadowMap::create does with a near field.
#pragma once
#include "mtsm/near_field.h"
#include "mtsm/result.h"

namespace mtsm::map_detail {

/// What near_field.h states of chunks. Errors: badArgument.
[[nodiscard]] Status checkChunks(const NearField& field, std::uint32_t face);

/// Fills NearField::levels. The same for any number of threads.
void buildBoxes(NearField& field);

/// To the last bit.
[[nodiscard]] bool sameChunks(const NearField& a, const NearField& b) noexcept;

}  // namespace mtsm::map_detail
