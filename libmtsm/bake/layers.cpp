#include "bake/layers.h"

#include <algorithm>
#include <cfloat>

namespace mtsm::bake_detail {

namespace {

std::uint32_t countLayers(const raster::KTile& tile) {
    std::uint32_t layers = 0;
    for (std::uint32_t p = 0; p < tile.pixels(); ++p)
        layers += tile.count(p);
    return layers;
}

/// Appends the visibility behind each of a pixel's samples.
void accumulate(const float* opacity, std::uint32_t count, std::vector<float>& v) {
    double visible = 1.0;
    for (std::uint32_t i = 0; i < count; ++i) {
        visible *= 1.0 - double(opacity[i]);
        const bool dark = visible < double(FLT_MIN);
        v.push_back(dark ? 0.0f : float(visible));
        if (dark) visible = 1.0;
    }
}

}  // namespace

std::uint64_t layerBytes(const raster::KTile& tile) {
    if (tile.empty()) return 0;
    const std::uint64_t planes = tile.opacity(0) ? 2 : 1;
    return 4 * (tile.pixels() + 1 + planes * countLayers(tile));
}

Tile layersOf(const raster::KTile& tile) {
    Tile t;
    if (tile.empty()) return t;
    const std::uint32_t layers = countLayers(tile);
    t.begin.reserve(tile.pixels() + 1);
    t.z.reserve(layers);
    if (tile.opacity(0)) t.v.reserve(layers);
    t.begin.push_back(0);
    for (std::uint32_t p = 0; p < tile.pixels(); ++p) {
        const std::uint32_t count = tile.count(p);
        t.z.insert(t.z.end(), tile.z(p), tile.z(p) + count);
        if (tile.opacity(p)) accumulate(tile.opacity(p), count, t.v);
        t.begin.push_back(std::uint32_t(t.z.size()));
    }
    const bool opaque =
        std::all_of(t.v.begin(), t.v.end(), [](float v) { return v == 0.0f; });
    if (opaque) t.v = {};
    return t;
}

}  // namespace mtsm::bake_detail
