// fits_trees.h - which maps have trees.
#pragma once
#include <cstdint>

#include "mtsm/map.h"

namespace mtsm::trace {

/// Trees count in 32 bits, and a layer takes several of what they count.
inline constexpr std::uint64_t kMostLayers = std::uint64_t(1) << 28;

/// Does a map have what trees can be made of? It has layers, not too many, and one face
/// or six that share out space with windows of 90 degrees.
[[nodiscard]] bool fitsTrees(const ShadowMap& map);

}  // namespace mtsm::trace
