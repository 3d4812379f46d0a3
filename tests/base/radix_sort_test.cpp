// radix_sort.h: against the standard library's sort.
#include "base/radix_sort.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "random.h"

using namespace mtsm;

namespace {

struct Entry {
    std::uint64_t key;
    std::uint32_t number;
    bool operator==(const Entry& other) const {
        return key == other.key && number == other.number;
    }
};

}  // namespace

TEST_CASE("entries are sorted by their keys, equal ones as they were", "[base]") {
    test::Random random(7);
    for (const std::size_t count : {0u, 1u, 2u, 511u, 512u, 513u, 2048u, 100'000u}) {
        for (const int bits : {3, 32, 52, 64, -52}) {
            // The last: digits in the middle are all the same.
            const std::uint64_t kept = bits > 0 ? ~std::uint64_t(0) : 0xff00000000003fff;
            std::vector<Entry> entries;
            for (std::size_t i = 0; i < count; ++i) {
                const std::uint64_t high = random.below(1u << 31),
                                    low = random.below(1u << 31);
                const std::uint64_t key =
                    (high << 33 | low << 2 | random.below(4)) & kept;
                entries.push_back({key >> (64 - std::abs(bits)), std::uint32_t(i)});
            }
            std::vector<Entry> expected = entries;
            std::stable_sort(
                expected.begin(), expected.end(),
                [](const Entry& a, const Entry& b) { return a.key < b.key; });
            base::radixSort(entries, std::abs(bits));
            CHECK(entries == expected);
        }
    }
}
