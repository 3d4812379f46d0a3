// tile_place.h - which tile of a map, and how many pixels it has there.
#pragma once
#include <cstdint>
#include <string>

#include "base/message.h"

namespace mtsm::format {

struct TilePlace {
    std::uint32_t face = 0, tx = 0, ty = 0;
    std::uint32_t width = 0, height = 0;  ///< pixels, after cropping to the map

    [[nodiscard]] std::uint32_t pixels() const noexcept { return width * height; }
    /// "tile face 0 (1, 2)"
    [[nodiscard]] std::string text() const {
        return base::concat("tile face ", face, " (", tx, ", ", ty, ")");
    }
};

}  // namespace mtsm::format
