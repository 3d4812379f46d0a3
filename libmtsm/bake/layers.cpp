#include "bake/layers.h"

#include <algorithm>
#include <cfloat>

namespace mtsm::bake_detail {

namespace {

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

Tile layersOf(const raster::KTile& tile) {
    Tile t;
    if (tile.empty()) return t;
    t.begin.resize(tile.pixels() + 1);
    for (std::uint32_t p = 0; p < tile.pixels(); ++p)
        t.begin[p + 1] = t.begin[p] + tile.count(p);
    t.z.reserve(t.begin.back());
    if (tile.opacity(0)) t.v.reserve(t.begin.back());
    for (std::uint32_t p = 0; p < tile.pixels(); ++p) {
        const std::uint32_t count = t.begin[p + 1] - t.begin[p];
        t.z.insert(t.z.end(), tile.z(p), tile.z(p) + count);
        if (tile.opacity(p)) accumulate(tile.opacity(p), count, t.v);
    }
    const bool opaque =
        std::all_of(t.v.begin(), t.v.end(), [](float v) { return v == 0.0f; });
    if (opaque) t.v = {};
    return t;
}

}  // namespace mtsm::bake_detail
