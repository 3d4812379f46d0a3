// Samples to layers: products of (1 - opacity), and where they start again.
#include "bake/layers.h"

#include <catch2/catch.hpp>
#include <cfloat>
#include <cmath>
#include <utility>
#include <vector>

using namespace mtsm;
using bake_detail::layersOf;
using raster::KTile;
using raster::MemoryBudget;

namespace {

/// The layers of a single pixel with these (z, opacity).
Tile layers(const std::vector<std::pair<float, float>>& samples, std::uint32_t k = 64) {
    MemoryBudget budget(1 << 20);
    KTile tile(1, 1, k, budget);
    for (const auto& [z, opacity] : samples)
        tile.insert(0, z, opacity);
    Tile t = layersOf(tile);
    // No more than was reserved.
    CHECK(4 * (t.begin.size() + t.z.size() + t.v.size()) <= tile.bytes() + 4 * 2);
    return t;
}

}  // namespace

TEST_CASE("an opaque tile is depths alone", "[bake][exact]") {
    MemoryBudget budget(1 << 20);
    KTile tile(2, 2, 3, budget);
    tile.insert(1, 2.0f, 1.0f);
    tile.insert(1, 1.0f, 1.0f);
    tile.insert(3, 5.0f, 1.0f);
    const Tile t = layersOf(tile);
    CHECK(t.begin == std::vector<std::uint32_t>{0, 0, 2, 2, 3});
    CHECK(t.z == std::vector<float>{1.0f, 2.0f, 5.0f});
    CHECK(t.v.empty());
    CHECK(t.n.empty());
    CHECK(layersOf(KTile(2, 2, 3, budget)).begin.empty());
}

TEST_CASE("visibility is the product of what each sample lets through", "[bake][exact]") {
    const Tile t = layers({{1, 0.5f}, {2, 0.25f}, {3, 0.5f}});
    CHECK(t.v == std::vector<float>{0.5f, 0.375f, 0.1875f});
    CHECK(t.n.empty());
    // After an opaque sample it starts again at 1.
    const Tile reset = layers({{1, 0.5f}, {2, 1.0f}, {3, 0.25f}, {4, 1.0f}, {5, 0.5f}});
    CHECK(reset.v == std::vector<float>{0.5f, 0.0f, 0.75f, 0.0f, 0.5f});
}

TEST_CASE("two translucent sheets at one depth both dim the light", "[bake][exact]") {
    const Tile t = layers({{1, 0.5f}, {1, 0.5f}, {1, 1.0f}, {1, 1.0f}});
    CHECK(t.z == std::vector<float>{1.0f, 1.0f, 1.0f});
    CHECK(t.v == std::vector<float>{0.5f, 0.25f, 0.0f});
}

TEST_CASE("opacities next to 0 and 1 stay between", "[bake][exact]") {
    for (const float opacity : {1e-7f, 1.0f - 1e-7f}) {
        const Tile t = layers({{1, opacity}});
        CHECK(t.v[0] > 0.0f);
        CHECK(t.v[0] < 1.0f);
        CHECK(t.v[0] == float(1.0 - double(opacity)));
    }
    // Below half a step of a float nothing is left to see, and nothing breaks.
    CHECK(layers({{1, 1e-10f}}).v[0] == 1.0f);
    CHECK(layers({{1, FLT_TRUE_MIN}}).v[0] == 1.0f);
}

TEST_CASE("small opacities add up in double", "[bake][exact]") {
    std::vector<std::pair<float, float>> samples;
    for (int i = 1; i <= 64; ++i)
        samples.emplace_back(float(i), 1e-9f);
    CHECK(layers(samples).v.back() == float(std::pow(1.0 - double(1e-9f), 64)));
}

TEST_CASE("visibility that underflows is zero and starts again", "[bake][exact]") {
    // Each lets 2^-20 through: after seven, 2^-140 is below FLT_MIN = 2^-126.
    std::vector<std::pair<float, float>> samples;
    for (int i = 1; i <= 10; ++i)
        samples.emplace_back(float(i), 1.0f - 0x1p-20f);
    const Tile t = layers(samples);
    for (int i = 1; i <= 6; ++i)
        CHECK(t.v[i - 1] == std::ldexp(1.0f, -20 * i));
    CHECK(t.v[6] == 0.0f);
    CHECK(t.v[7] == 0x1p-20f);
}

TEST_CASE("a tile whose translucent samples were all dropped is opaque", "[bake]") {
    const Tile t = layers({{2, 0.5f}, {1, 1.0f}}, 1);
    CHECK(t.z == std::vector<float>{1.0f});
    CHECK(t.v.empty());
}
