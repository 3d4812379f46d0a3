// draw_nearest.h - triangles into the planes of a k-buffer, some pixels of a row at a
// time. What comes out is what drawTriangle() and KTile::insert() give, bit by bit.
#pragma once
#include <cstdint>
#include <span>

#include "raster/kbuffer.h"
#include "raster/triangle.h"

namespace mtsm::raster {

/// Some of a list of triangles: those that `order` counts.
struct TriangleList {
    const PreparedTriangle* triangles = nullptr;
    std::span<const std::uint32_t> order;
};

/// Draws the triangles of all lists, as far as they lie in `within`. The tiles of that
/// rectangle must be this thread's alone.
void drawNearest(ProjectionKind kind, std::span<const TriangleList> lists,
                 PixelRect within, KBuffer& buffer);

}  // namespace mtsm::raster
