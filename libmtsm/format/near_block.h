// near_block.h - the near fields of all faces <-> NEAR.
//
// Chunks are stored in parts of up to some thousand, each compressed alone, so that all
// threads have something to decode and none needs much memory.
#pragma once
#include "format/header.h"
#include "mtsm/writer.h"

namespace mtsm::format {

/// True if some face has a near field; else there is no block.
[[nodiscard]] bool hasNearField(const ShadowMap& map) noexcept;

/// In parallel; the bytes are the same for any number of threads.
[[nodiscard]] Bytes encodeNear(const ShadowMap& map, Codec codec, int level);

/// Fills the faces' near fields, but for their boxes. No more than `most` bytes are taken
/// for them and for the work. Errors: badFile, tooLarge.
Status decodeNear(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces);

/// The payload alone: `faces` are the chunks of each.
[[nodiscard]] Bytes encodeTriangles(const std::vector<const NearChunks*>& faces,
                                    Codec codec, int level);
Status decodeTriangles(BytesView payload, std::uint64_t most,
                       const std::vector<NearChunks*>& faces);

}  // namespace mtsm::format
