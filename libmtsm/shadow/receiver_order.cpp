#include "shadow/receiver_order.h"

#include <algorithm>
#include <array>

#include "base/parallel.h"

namespace mtsm::shadow {
namespace {

constexpr std::size_t kPointsPerTask = 4096;

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

ReceiverOrder::ReceiverOrder(const Query& query, const BundleQuery& bundles,
                             const glm::dvec3* points, const glm::dvec3* normals,
                             std::size_t count)
    : sorted_(count), together_(3u << 30 | bundles.sameFace()) {
    base::parallelRanges(
        std::size_t(0), count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                Kind kind = Kind::alone;
                std::uint32_t place = 0;
                const auto at = query.isShadowed(points[i]) ? bundles.placeOf(points[i])
                                                            : std::nullopt;
                if (at) {
                    kind = normals && saysSomething(normals[i]) ? Kind::withNormal
                                                                : Kind::without;
                    place = *at;
                }
                sorted_[i] = {std::uint32_t(kind) << 30 | place, std::uint32_t(i)};
            }
        });
    if (count > 1) radixSort(sorted_);
}

ReceiverOrder::Group ReceiverOrder::group(std::size_t first,
                                          std::size_t end) const noexcept {
    const Kind kind = sorted_[first].kind();
    if (kind == Kind::alone) return {1, false};
    std::size_t count = 1;
    while (count < std::size_t(trace::kMostReceivers) && first + count < end &&
           ((sorted_[first + count].key ^ sorted_[first].key) & together_) == 0)
        ++count;
    return {count, true};
}

}  // namespace mtsm::shadow
