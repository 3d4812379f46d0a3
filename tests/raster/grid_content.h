// grid_content.h - what a sample grid of one channel holds, pixel by pixel.
#pragma once
#include <utility>
#include <vector>

#include "raster/sample_grid.h"

namespace mtsm::test {

struct Pixel {
    std::vector<std::pair<float, float>> samples;  // z, opacity
    friend bool operator==(const Pixel&, const Pixel&) = default;
};

/// The pixels of the rows that the grid holds, row-major.
inline std::vector<Pixel> content(raster::SampleGrid& grid) {
    const std::uint32_t first = grid.firstPixelRow(), end = grid.endPixelRow();
    std::vector<Pixel> pixels(std::size_t(grid.width()) * (end - first));
    for (std::uint32_t ty = grid.firstRow(); ty < grid.endRow(); ++ty) {
        for (std::uint32_t tx = 0; tx < grid.tilesX(); ++tx) {
            const raster::SampleTile& tile = grid.tile(tx, ty);
            tile.forEachPixel([&](std::uint32_t p, const PixelSamples& samples) {
                const std::uint32_t x = tx * 64 + p % tile.width();
                const std::uint32_t y = ty * 64 + p / tile.width() - first;
                for (std::size_t i = 0; i < samples.count; ++i)
                    pixels[std::size_t(y) * grid.width() + x].samples.emplace_back(
                        samples.z[i], samples.opacity[0][i]);
            });
        }
    }
    return pixels;
}

}  // namespace mtsm::test
