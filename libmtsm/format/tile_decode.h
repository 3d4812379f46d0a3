// tile_decode.h - the payload of a TILE block into the layers of one tile.
#pragma once
#include <memory>
#include <vector>

#include "format/header.h"
#include "format/layout.h"
#include "format/tile_place.h"

namespace mtsm::format {

/// What the index says of a tile: its payload has to agree.
struct TileFacts {
    TilePlace place;
    std::uint32_t channels = 0;
    std::uint32_t layers = 0;  ///< >= 1; memory for them has been granted
    std::uint32_t planes = 0;  ///< kHasV | kHasN
};

/// Bytes that the tile's planes may take at most in the file: no codec makes them larger
/// than raw, so a longer payload is refused before it is read.
[[nodiscard]] std::uint64_t mostTileBytes(const TileFacts& facts) noexcept;
[[nodiscard]] std::uint64_t leastTileBytes(const TileFacts& facts) noexcept;
/// Bytes that a TileDecoder takes beside the tile that comes out.
[[nodiscard]] std::uint64_t scratchBytes(const TileFacts& facts) noexcept;

/// Decodes tiles one after another with the same scratch memory; one per thread.
class TileDecoder {
  public:
    TileDecoder();
    ~TileDecoder();
    TileDecoder(TileDecoder&&) noexcept;

    /// Errors: badFile, without the name of file and tile. Throws std::bad_alloc. Memory
    /// is linear in `facts.layers` whatever the payload says.
    Result<Tile> decode(BytesView payload, const TileFacts& facts);
    /// The records of the planes that decode() read last.
    [[nodiscard]] const std::vector<PlaneRecord>& records() const noexcept;

  private:
    struct Scratch;
    std::unique_ptr<Scratch> scratch_;
};

}  // namespace mtsm::format
