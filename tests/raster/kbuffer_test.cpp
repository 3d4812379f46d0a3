// The k nearest samples: against a sort of all of them, in any order.
#include "raster/kbuffer.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <vector>

#include "bake/casters.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Random;

namespace {

struct Expected {
    std::vector<float> kept;
    std::uint64_t dropped = 0;
};

/// By the definition: sorted, equal depths counted once, the first k.
Expected bruteForce(std::vector<float> depths, std::size_t k) {
    std::sort(depths.begin(), depths.end());
    Expected e;
    e.kept = depths;
    e.kept.erase(std::unique(e.kept.begin(), e.kept.end()), e.kept.end());
    if (e.kept.size() > k) e.kept.resize(k);
    // Copies of the ones dropped are dropped as well.
    for (const float z : depths)
        e.dropped += z > e.kept.back();
    return e;
}

std::vector<float> content(const KTile& tile, std::uint32_t x, std::uint32_t y) {
    std::vector<float> z;
    for (std::uint32_t k = 0; k < tile.count(x, y); ++k)
        z.push_back(tile.plane(k)[tile.place(x, y)]);
    return z;
}

}  // namespace

TEST_CASE("the k nearest are kept and the others counted, whatever the order",
          "[raster][exact]") {
    for (const std::uint32_t k : {1u, 2u, 3u, 5u, 16u, 64u}) {
        for (std::uint64_t seed = 0; seed < 60; ++seed) {
            Random random(seed);
            std::vector<float> depths;  // few, so that many coincide
            const std::size_t n = 1 + random.below(3 * k + 5);
            for (std::size_t i = 0; i < n; ++i)
                depths.push_back(1.0f + float(random.below(2 * k)));
            const Expected expected = bruteForce(depths, k);
            for (int order = 0; order < 5; ++order) {
                random.shuffle(depths);
                MemoryBudget budget(1 << 20);
                KTile tile(3, 2, k, budget);
                for (const float z : depths)
                    tile.insert(tile.place(1, 1), z);
                INFO("k " << k << ", seed " << seed << ", order " << order);
                REQUIRE(content(tile, 1, 1) == expected.kept);
                REQUIRE(content(tile, 0, 1).empty());
                REQUIRE(content(tile, 2, 1).empty());
                REQUIRE(tile.samples() == n);
                REQUIRE(tile.samples() - tile.count(1, 1) - tile.copies() ==
                        expected.dropped);
            }
        }
    }
}

TEST_CASE("a tile takes memory when it is needed and not before", "[raster]") {
    MemoryBudget budget(1 << 20);
    KBuffer buffer(100, 70, 4, budget);
    CHECK(buffer.tilesX() == 2);
    CHECK(buffer.tilesY() == 2);
    KTile& tile = buffer.tile(1, 1);
    CHECK(tile.width() == 36);
    CHECK(tile.pixels() == 36 * 6);
    CHECK(tile.empty());
    CHECK(tile.bytes() == 0);
    const std::uint64_t plane = 40 * 6 * 4;  // rows begin at multiples of 8
    tile.insert(tile.place(0, 0), 2.0f);
    CHECK(tile.bytes() == plane);
    tile.insert(tile.place(1, 0), 1.0f);
    CHECK(tile.bytes() == plane);
    tile.insert(tile.place(0, 0), 1.0f);
    CHECK(tile.bytes() == 2 * plane);
    tile.insert(tile.place(0, 0), 1.0f);  // a copy
    CHECK(tile.bytes() == (2 + 4) * plane);
    CHECK(buffer.tile(0, 0).empty());
    tile.clear();
    CHECK(tile.empty());
    CHECK(tile.samples() == 0);
}

TEST_CASE("beyond the budget nothing is allocated and the failure is remembered",
          "[raster]") {
    // Two layers of a tile, and where each pixel's begin.
    MemoryBudget budget(64 * 64 * 4 * 2 + (64 * 64 + 1) * 4);
    KBuffer buffer(64, 192, 2, budget);
    buffer.tile(0, 0).insert(0, 1.0f);
    buffer.tile(0, 0).insert(0, 2.0f);
    CHECK_FALSE(budget.exceeded());
    buffer.tile(0, 1).insert(0, 1.0f);
    CHECK(budget.exceeded());
    CHECK(buffer.tile(0, 1).empty());
}

TEST_CASE("a million samples in one pixel are all counted", "[raster]") {
    MemoryBudget budget(1 << 20);
    KTile tile(1, 1, 5, budget);
    for (int i = 1'000'000; i > 0; --i)
        tile.insert(0, float(i));
    CHECK(content(tile, 0, 0) == std::vector<float>{1, 2, 3, 4, 5});
    CHECK(tile.samples() == 1'000'000);
    CHECK(tile.copies() == 0);
}
