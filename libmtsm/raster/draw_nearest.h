// draw_nearest.h - triangles into the planes of a k-buffer, some pixels of a row at a
// time. What comes out is what drawTriangle() and KTile::insert() give, bit by bit.
#pragma once
#include <cstdint>
#include <span>

#include "raster/kbuffer.h"
#include "raster/triangle.h"

namespace mtsm::raster {

/// Draws triangles[i] for each i of `order` in turn, as far as it lies in `within`. The
/// tiles of that rectangle must be this thread's alone.
void drawNearest(ProjectionKind kind, std::span<const PreparedTriangle> triangles,
                 std::span<const std::uint32_t> order, PixelRect within, KBuffer& buffer);

}  // namespace mtsm::raster
