// content.h - one number for all that a scene holds, so that what was computed for it can
// be found again; and the file in which a truth is kept.
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "baseline/method.h"
#include "mtsm/light.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

/// Of all casters: geometry, opacities, textures (by lookups, see content.cpp), in
/// their order. Errors: what visit() returns.
Result<std::uint64_t> contentOf(CasterSource& casters);
/// Of points, normals and starts, and which of them share a pixel.
[[nodiscard]] std::uint64_t contentOf(const Receivers& receivers);
/// Of all its members, also those that its shape ignores: at worst something is computed
/// anew.
[[nodiscard]] std::uint64_t contentOf(const AreaLight& light);
[[nodiscard]] std::uint64_t contentOf(const std::string& text);
/// Of both, in this order.
[[nodiscard]] std::uint64_t combined(std::uint64_t a, std::uint64_t b);
/// 16 hexadecimal digits.
[[nodiscard]] std::string contentText(std::uint64_t content);

/// Numbers under a key, with a checksum: complete or not there at all.
Status writeValues(const std::string& path, std::uint64_t key,
                   const std::vector<float>& values);
/// Nothing if there is no such file. badFile (the message names the file and the way out)
/// if it is damaged, or holds another number of values or those of another key: of
/// another scene, light or picture.
Result<std::optional<std::vector<float>>> readValues(const std::string& path,
                                                     std::uint64_t key,
                                                     std::size_t count);

}  // namespace mtsm::baseline
