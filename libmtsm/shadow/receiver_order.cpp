#include "shadow/receiver_order.h"

#include <algorithm>
#include <array>

#include "base/parallel.h"

namespace mtsm::shadow {
namespace {

constexpr std::size_t kPointsPerTask = 4096;
constexpr std::uint32_t kPlaces = (1u << 30) - 1;

/// By key, equal keys as they were.
template <typename Entry>
void radixSort(std::vector<Entry>& entries) {
    constexpr int kBits = 11;
    constexpr std::uint32_t kDigits = 1u << kBits;
    std::vector<Entry> other(entries.size());
    for (int shift = 0; shift < 32; shift += kBits) {
        std::array<std::size_t, kDigits> next{};
        for (const Entry& e : entries)
            ++next[e.key >> shift & (kDigits - 1)];
        std::size_t sum = 0;
        for (std::size_t& n : next)
            sum += std::exchange(n, sum);
        for (const Entry& e : entries)
            other[next[e.key >> shift & (kDigits - 1)]++] = e;
        entries.swap(other);
    }
}

}  // namespace

ReceiverOrder::ReceiverOrder(const BundleQuery& bundles, const glm::dvec3* points,
                             const glm::dvec3* normals, std::size_t count)
    : sorted_(count), together_(~kPlaces | bundles.together()) {
    constexpr std::size_t kAtOnce = ReceiverPlaces::kAtOnce;
    base::parallelRanges(
        std::size_t(0), count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
            for (std::size_t first = begin; first < end; first += kAtOnce) {
                const std::size_t some = std::min(kAtOnce, end - first);
                std::uint32_t found[kAtOnce];
                bundles.findPlaces(points + first, int(some), found);
                for (std::size_t k = 0; k < some; ++k) {
                    const std::size_t i = first + k;
                    Kind kind = Kind::alone;
                    if (found[k] != ReceiverPlaces::kNone)
                        kind = normals && saysSomething(normals[i]) ? Kind::withNormal
                                                                    : Kind::without;
                    sorted_[i] = {std::uint32_t(kind) << 30 | (found[k] & kPlaces),
                                  std::uint32_t(i)};
                }
            }
        });
    if (count > 1) radixSort(sorted_);
}

ReceiverOrder::Block ReceiverOrder::block(std::size_t first,
                                          std::size_t end) const noexcept {
    const Kind kind = sorted_[first].kind();
    std::size_t count = 1;
    while (first + count < end &&
           ((sorted_[first + count].key ^ sorted_[first].key) & together_) == 0)
        ++count;
    return {count, kind != Kind::alone};
}

}  // namespace mtsm::shadow
