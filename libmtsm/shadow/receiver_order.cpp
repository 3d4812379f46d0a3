#include "shadow/receiver_order.h"

#include <algorithm>

#include "base/radix_sort.h"
#include "shadow/pixel_share.h"

namespace mtsm::shadow {
namespace {

constexpr std::uint32_t kPlaces = (1u << 30) - 1;

/// Are places (ReceiverPlaces) no more than three or four cells apart in each axis?
bool areClose(std::uint32_t a, std::uint32_t b) {
    // Axes take turns, three bits on: the numbers 3 and 7 of one.
    constexpr std::uint32_t kAxis = 0x09249249u, kThree = 0x9u, kSeven = 0x49u;
    if (((a ^ b) & kPlaces) <= 0x1ffu) return true;
    for (int axis = 0; axis < 3; ++axis) {
        // Bits of other axes hand on what is carried.
        const std::uint32_t mask = kAxis << axis;
        const std::uint32_t apart = ((a | ~mask) - (b & mask)) & mask;
        const std::uint32_t fromThree = ((apart | ~mask) + (kThree << axis)) & mask;
        if (fromThree & ~(kSeven << axis)) return false;
    }
    return true;
}

}  // namespace

void ReceiverOrder::findKeys(const BundleQuery& bundles, const glm::dvec3* points,
                             const glm::dvec3* normals, std::size_t count,
                             std::uint32_t* keys) {
    constexpr std::size_t kAtOnce = ReceiverPlaces::kAtOnce;
    for (std::size_t at = 0; at < count; at += kAtOnce) {
        const std::size_t some = std::min(kAtOnce, count - at);
        bundles.findPlaces(points + at, int(some), keys + at);
        for (std::size_t i = at; i < at + some; ++i) {
            Kind kind = Kind::alone;
            if (keys[i] != ReceiverPlaces::kNone)
                kind = normals && saysSomething(normals[i]) ? Kind::withNormal
                                                            : Kind::without;
            keys[i] = std::uint32_t(kind) << 30 | (keys[i] & kPlaces);
        }
    }
}

std::size_t ReceiverOrder::alike(const BundleQuery& bundles, const std::uint32_t* keys,
                                 std::size_t count) noexcept {
    const std::uint32_t together = ~kPlaces | bundles.together();
    if (Kind(keys[0] >> 30) == Kind::alone) return 0;
    std::size_t same = 1;
    while (same < count && ((keys[same] ^ keys[0]) & together) == 0)
        ++same;
    return same;
}

ReceiverOrder::ReceiverOrder(const BundleQuery& bundles,
                             const std::vector<std::uint32_t>& keys, std::size_t first,
                             const ShadowOptions& options)
    : together_(~kPlaces | bundles.together()) {
    const std::size_t count = keys.size();
    const std::size_t longest = std::min(std::size_t(options.pointsPerPixel), kMostInRun);
    const auto pixelOf = [&](std::size_t i) -> std::uint64_t {
        return longest > 1 ? PixelPoint(options, first + i).pixel : i;
    };
    sorted_.reserve(count / longest + (longest > 1 ? count / (4 * longest) + 1 : 0));
    for (std::size_t i = 0; i < count;) {
        if (keys[i] == kLeftOut) {
            ++i;
            continue;
        }
        const std::uint64_t pixel = pixelOf(i);
        const std::size_t most = std::min(count, i + longest);
        std::size_t end = i + 1;
        while (end < most && pixelOf(end) == pixel &&
               ((keys[end] ^ keys[i]) & together_) == 0 && areClose(keys[end], keys[i]))
            ++end;
        sorted_.push_back({keys[i], std::uint32_t(i << 4 | (end - i - 1))});
        points_ += end - i;
        i = end;
    }
    base::radixSort(sorted_, 32);
}

ReceiverOrder::Block ReceiverOrder::block(std::size_t first, std::size_t end,
                                          std::size_t mostPoints) const noexcept {
    const Kind kind = sorted_[first].kind();
    std::size_t runs = 1, points = (*this)[first].count;
    for (; first + runs < end; ++runs) {
        points += (*this)[first + runs].count;
        if (points > mostPoints ||
            ((sorted_[first + runs].key ^ sorted_[first].key) & together_) != 0)
            break;
    }
    return {runs, kind != Kind::alone};
}

}  // namespace mtsm::shadow
