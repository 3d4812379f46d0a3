// layers.h - the samples of a tile become its layers.
#pragma once
#include <cstdint>

#include "mtsm/map.h"
#include "raster/kbuffer.h"

namespace mtsm::bake_detail {

/// One layer per sample, n = 1 each: v is the product of (1 - opacity) since the last
/// reset, accumulated in double. An opaque sample makes it 0, and so does a product that
/// falls below FLT_MIN; the next layer starts again at 1. Tiles whose layers are all
/// opaque have no v plane. Empty if the tile is.
Tile layersOf(const raster::KTile& tile);

}  // namespace mtsm::bake_detail
