// card_block.h - the near sheets of a face <-> CARD.
#pragma once
#include "format/header.h"
#include "mtsm/writer.h"

namespace mtsm::format {

/// True if there are near sheets; else there is no block.
[[nodiscard]] bool hasNearSheets(const ShadowMap& map) noexcept;

/// In parallel; the bytes are the same for any number of threads.
[[nodiscard]] Bytes encodeSheets(const ShadowMap& map, Codec codec, int level);

/// Fills the only face's near sheets, but for what ShadowMap::create makes. No more than
/// `most` bytes are taken for them and for the work. Errors: badFile, tooLarge.
Status decodeSheets(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces);

}  // namespace mtsm::format
