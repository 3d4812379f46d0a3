// hair_block.h - the strands of all faces' near fields <-> HAIR, stored as NEAR is.
#pragma once
#include "format/header.h"
#include "mtsm/writer.h"

namespace mtsm::format {

/// True if some face has strands; else there is no block.
[[nodiscard]] bool hasNearHair(const ShadowMap& map) noexcept;

/// In parallel; the bytes are the same for any number of threads.
[[nodiscard]] Bytes encodeHair(const ShadowMap& map, Codec codec, int level);

/// Fills the faces' strands, but for their boxes. No more than `most` bytes are taken for
/// them and for the work. Errors: badFile, tooLarge.
Status decodeHair(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces);

}  // namespace mtsm::format
