// Places on the Hilbert curve: that it is one, and vectors against the plain method.
#include "bake/hilbert.h"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "random.h"
#include "trace/each_target.h"

using namespace mtsm;

namespace {

/// [axis][cell]
using Cells = std::array<std::vector<std::uint32_t>, 3>;

std::vector<std::uint64_t> placesOf(Cells cells, int bits) {
    std::vector<std::uint64_t> places(cells[0].size());
    bake_detail::hilbertPlaces(cells[0].data(), cells[1].data(), cells[2].data(),
                               places.size(), bits, places.data());
    return places;
}

/// One cell, as [Skilling04] has it.
std::uint64_t placeOf(std::array<std::uint32_t, 3> x, int bits) {
    for (std::uint32_t q = 1u << (bits - 1); q > 1; q >>= 1) {
        const std::uint32_t below = q - 1;
        for (std::uint32_t& axis : x) {
            if (axis & q) {
                x[0] ^= below;
            } else {
                const std::uint32_t swapped = (x[0] ^ axis) & below;
                x[0] ^= swapped;
                axis ^= swapped;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    std::uint32_t flip = 0;
    for (std::uint32_t q = 1u << (bits - 1); q > 1; q >>= 1) {
        if (x[2] & q) flip ^= q - 1;
    }
    std::uint64_t place = 0;
    for (int bit = bits; bit-- > 0;) {
        for (const std::uint32_t axis : x)
            place = place << 1 | ((axis ^ flip) >> bit & 1);
    }
    return place;
}

}  // namespace

TEST_CASE("the Hilbert curve goes through every cell and only to neighbours", "[bake]") {
    constexpr std::uint32_t kSide = 16;
    Cells cells;
    for (std::uint32_t i = 0; i < kSide * kSide * kSide; ++i) {
        cells[0].push_back(i % kSide);
        cells[1].push_back(i / kSide % kSide);
        cells[2].push_back(i / kSide / kSide);
    }
    const std::vector<std::uint64_t> places = placesOf(cells, 4);
    std::vector<std::size_t> cellAt(places.size());
    std::vector<int> seen(places.size());
    for (std::size_t i = 0; i < places.size(); ++i) {
        REQUIRE(places[i] < places.size());
        cellAt[places[i]] = i;
        seen[places[i]] += 1;
    }
    CHECK(std::count(seen.begin(), seen.end(), 1) == long(seen.size()));
    int strides = 0;
    for (std::size_t i = 1; i < cellAt.size(); ++i) {
        for (const std::vector<std::uint32_t>& axis : cells)
            strides += std::abs(int(axis[cellAt[i]]) - int(axis[cellAt[i - 1]]));
    }
    CHECK(strides == int(cellAt.size()) - 1);
}

TEST_CASE("places on the Hilbert curve are those of the plain method", "[bake][twin]") {
    test::onEachTarget([&](const char* name) {
        INFO(name);
        test::Random random(11);
        for (const int bits : {1, 2, 5, 16, 21}) {
            for (const std::size_t count : {0u, 1u, 7u, 16u, 17u, 257u}) {
                Cells cells;
                std::vector<std::uint64_t> expected;
                for (std::size_t i = 0; i < count; ++i) {
                    std::array<std::uint32_t, 3> cell;
                    for (std::size_t axis = 0; axis < 3; ++axis) {
                        cell[axis] = std::uint32_t(random.below(1u << bits));
                        cells[axis].push_back(cell[axis]);
                    }
                    expected.push_back(placeOf(cell, bits));
                }
                CHECK(placesOf(cells, bits) == expected);
            }
        }
    });
}
