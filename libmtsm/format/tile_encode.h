// tile_encode.h - the layers of one tile into the payload of a TILE block.
#pragma once
#include <memory>

#include "format/header.h"
#include "format/layout.h"
#include "format/tile_place.h"
#include "mtsm/writer.h"

namespace mtsm::format {

/// Which planes the tile needs: v only if some v is not 0, n only if some n is not 1,
/// whatever planes it has in memory. (kHasV | kHasN)
[[nodiscard]] std::uint32_t planesNeeded(const Tile& tile);

/// Encodes tiles one after another with the same scratch memory; one per thread.
class TileEncoder {
  public:
    TileEncoder(Codec codec, int level);
    ~TileEncoder();
    TileEncoder(TileEncoder&&) noexcept;

    /// `tile` has layers. Throws std::bad_alloc.
    Bytes encode(const Tile& tile, const TilePlace& place, std::uint32_t channels);

  private:
    struct Scratch;
    std::unique_ptr<Scratch> scratch_;
};

}  // namespace mtsm::format
