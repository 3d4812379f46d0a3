// header.h - everything about a map but its layers <-> bytes: prefix, HEAD, ATTR, TOTL.
//
// The errors of these functions say what is wrong inside the block; whoever called adds
// the file and the block. Reading checks what the bytes must obey to be understood; what
// a map must obey, ShadowMap::create checks afterwards.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "format/layout.h"
#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm::format {

using Bytes = std::vector<std::uint8_t>;
using BytesView = std::span<const std::uint8_t>;

[[nodiscard]] Prefix makePrefix(const ShadowMap& map);
/// Checks every field; `bytes` may be longer. Errors: badFile, unsupported.
Result<Prefix> decodePrefix(BytesView bytes);

/// An error about a file of 1.`versionMinor`. What looks bad in a version that is newer
/// than ours may be what that version brought: badFile becomes unsupported, and the
/// message, which must not begin with the file's name, says why.
[[nodiscard]] Error ofItsVersion(Error error, std::uint16_t versionMinor);

/// With the way out of what is wrong with a map: another copy, or another bake.
[[nodiscard]] Error withWayOut(Error error);

/// Errors: badArgument (a text that is not UTF-8).
Result<Bytes> encodeHead(const ShadowMap& map);
/// Fills what HEAD holds of `info`, and the projections; `faces` has the right size.
Status decodeHead(BytesView payload, const Prefix& prefix, MapInfo& info,
                  std::vector<MapFace>& faces);

/// Bytes of HEAD without its texts.
[[nodiscard]] std::uint64_t headFixedBytes(std::uint32_t faces) noexcept;

/// Errors: badArgument (a text that is not UTF-8).
Result<Bytes> encodeAttributes(const std::vector<Attribute>& attributes);
Result<std::vector<Attribute>> decodeAttributes(BytesView payload, const Prefix& prefix);

[[nodiscard]] Bytes encodeTotals(const ShadowMap& map);
/// Fills what TOTL holds of `info`.
Result<Totals> decodeTotals(BytesView payload, const Prefix& prefix, MapInfo& info);
/// The sums that TOTL states are those of the map itself.
Status checkTotals(const Totals& totals, const ShadowMap& map);

/// The range of all faces' layers.
[[nodiscard]] ZRange wholeRange(const ShadowMap& map) noexcept;

}  // namespace mtsm::format
