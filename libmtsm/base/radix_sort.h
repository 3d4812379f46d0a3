// radix_sort.h - sorts many entries by a key of few bits.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace mtsm::base {

/// By Entry::key, an unsigned number below 2^bits; equal keys stay as they were. Takes as
/// much memory again.
template <typename Entry>
void radixSort(std::vector<Entry>& entries, int bits) {
    constexpr int kDigit = 11;
    constexpr std::uint32_t kValues = 1u << kDigit;
    if (entries.size() <= kValues / 4) {
        std::stable_sort(entries.begin(), entries.end(),
                         [](const Entry& a, const Entry& b) { return a.key < b.key; });
        return;
    }
    const auto digits = std::size_t((bits + kDigit - 1) / kDigit);
    const auto digitOf = [](const Entry& e, std::size_t digit) {
        return std::size_t(e.key >> (kDigit * digit)) & (kValues - 1);
    };
    // [digit][value]: how many have it, then where the next one goes.
    std::vector<std::array<std::size_t, kValues>> next(digits);
    for (const Entry& e : entries) {
        for (std::size_t digit = 0; digit < digits; ++digit)
            ++next[digit][digitOf(e, digit)];
    }
    std::vector<Entry> other(entries.size());
    for (std::size_t digit = 0; digit < digits; ++digit) {
        auto& to = next[digit];
        if (to[digitOf(entries[0], digit)] == entries.size()) continue;  // all the same
        std::size_t sum = 0;
        for (std::size_t& n : to)
            sum += std::exchange(n, sum);
        for (const Entry& e : entries)
            other[to[digitOf(e, digit)]++] = e;
        entries.swap(other);
    }
}

}  // namespace mtsm::base
