// The k nearest samples: against a sort of all of them, in any order.
#include "raster/kbuffer.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <utility>

#include "bake/casters.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Random;

namespace {

using Sample = std::pair<float, float>;  // z, opacity

struct Expected {
    std::vector<Sample> kept;
    std::uint64_t dropped = 0;
};

/// By the definition: sorted, opaque ones at one depth counted once, the first k.
Expected bruteForce(std::vector<Sample> samples, std::size_t k) {
    std::sort(samples.begin(), samples.end());
    Expected e;
    for (const Sample& s : samples) {
        const bool copy = s.second == 1.0f && !e.kept.empty() && e.kept.back() == s;
        if (copy) continue;
        if (e.kept.size() < k)
            e.kept.push_back(s);
        else
            ++e.dropped;
    }
    // Copies of the first of those dropped are dropped as well.
    if (e.dropped) {
        const Sample last = e.kept.back();
        e.dropped = std::uint64_t(std::count_if(
            samples.begin(), samples.end(), [&](const Sample& s) { return s > last; }));
        const auto same = std::count(samples.begin(), samples.end(), last);
        const auto kept = std::count(e.kept.begin(), e.kept.end(), last);
        if (last.second < 1.0f) e.dropped += std::uint64_t(same - kept);
    }
    return e;
}

std::vector<Sample> content(const KTile& tile, std::uint32_t pixel) {
    std::vector<Sample> found;
    if (tile.empty()) return found;
    for (std::uint32_t i = 0; i < tile.count(pixel); ++i)
        found.emplace_back(tile.z(pixel)[i],
                           tile.opacity(pixel) ? tile.opacity(pixel)[i] : 1.0f);
    return found;
}

}  // namespace

TEST_CASE("the k nearest are kept and the others counted, whatever the order",
          "[raster][exact]") {
    for (const std::uint32_t k : {1u, 2u, 3u, 5u, 16u, 64u}) {
        for (std::uint64_t seed = 0; seed < 60; ++seed) {
            Random random(seed);
            // Few depths, so that many coincide; all opaque, mixed, or all translucent.
            const double opaque = std::array{1.0, 0.6, 0.0}[seed % 3];
            std::vector<Sample> samples;
            const std::size_t n = 1 + random.below(3 * k + 5);
            for (std::size_t i = 0; i < n; ++i)
                samples.emplace_back(
                    1.0f + float(random.below(2 * k)),
                    random.unit() < opaque ? 1.0f : 0.25f * float(1 + random.below(3)));
            const Expected expected = bruteForce(samples, k);
            for (int order = 0; order < 5; ++order) {
                random.shuffle(samples);
                MemoryBudget budget(1 << 20);
                KTile tile(3, 2, k, budget);
                for (const Sample& s : samples)
                    tile.insert(4, s.first, s.second);
                INFO("k " << k << ", seed " << seed << ", order " << order);
                REQUIRE(content(tile, 4) == expected.kept);
                REQUIRE(content(tile, 3).empty());
                REQUIRE(content(tile, 5).empty());
                REQUIRE(tile.samples() == n);
                REQUIRE(tile.samples() - tile.count(4) - tile.copies() ==
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
    const std::uint64_t plane = 36 * 6 * 4 * 4;
    tile.insert(0, 1.0f, 1.0f);
    CHECK(tile.bytes() == plane);
    CHECK(tile.opacity(0) == nullptr);
    tile.insert(1, 1.0f, 0.5f);
    CHECK(tile.bytes() == 2 * plane);
    CHECK(tile.opacity(0)[0] == 1.0f);
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
    buffer.tile(0, 0).insert(0, 1.0f, 1.0f);
    CHECK_FALSE(budget.exceeded());
    buffer.tile(0, 1).insert(0, 1.0f, 1.0f);
    CHECK(budget.exceeded());
    CHECK(buffer.tile(0, 1).empty());
}

TEST_CASE("a million samples in one pixel are all counted", "[raster]") {
    MemoryBudget budget(1 << 20);
    KTile tile(1, 1, 5, budget);
    for (int i = 1'000'000; i > 0; --i)
        tile.insert(0, float(i), 1.0f);
    CHECK(
        content(tile, 0) ==
        std::vector<Sample>{{1.f, 1.f}, {2.f, 1.f}, {3.f, 1.f}, {4.f, 1.f}, {5.f, 1.f}});
    CHECK(tile.samples() == 1'000'000);
    CHECK(tile.copies() == 0);
}
