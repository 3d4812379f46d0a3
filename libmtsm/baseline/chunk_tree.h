// chunk_tree.h - a simple tree of boxes over many small pieces, to leave out of a view
// what lies outside it.
//
// Pieces are ordered along a space-filling curve and cut into chunks of consecutive ones;
// above the chunks stand boxes of two, four, eight of them and so on.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <span>
#include <utility>
#include <vector>

namespace mtsm::baseline {

struct Box {
    glm::dvec3 low{std::numeric_limits<double>::infinity()};
    glm::dvec3 high{-std::numeric_limits<double>::infinity()};

    void include(glm::dvec3 p) noexcept {
        low = glm::min(low, p);
        high = glm::max(high, p);
    }
    void include(const Box& other) noexcept {
        low = glm::min(low, other.low);
        high = glm::max(high, other.high);
    }
};

/// Points with dot(normal, p) + offset >= 0 are inside.
struct HalfSpace {
    glm::dvec3 normal{0.0};
    double offset = 0.0;

    [[nodiscard]] bool misses(const Box& box) const noexcept {
        const glm::dvec3 centre = 0.5 * (box.low + box.high),
                         half = 0.5 * (box.high - box.low);
        return glm::dot(normal, centre) + glm::dot(glm::abs(normal), half) + offset < 0.0;
    }
};

class ChunkTree {
  public:
    ChunkTree() = default;
    /// Of pieces 0..count-1; boxOf(i) is finite.
    template <typename BoxOf>
    ChunkTree(std::size_t count, const BoxOf& boxOf);

    /// order()[k] is the k-th piece along the curve: to be applied to the pieces.
    [[nodiscard]] const std::vector<std::uint32_t>& order() const noexcept {
        return order_;
    }
    void forgetOrder() noexcept { order_ = {}; }
    [[nodiscard]] std::size_t count() const noexcept { return count_; }
    [[nodiscard]] Box bounds() const noexcept {
        return levels_.empty() ? Box{} : levels_.back().front();
    }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return 2 * sizeof(Box) * (levels_.empty() ? 0 : levels_.front().size());
    }

    /// visit(begin, end) for runs of pieces that together hold every piece which meets
    /// the convex region, always in the same order.
    template <typename Visit>
    void visit(std::span<const HalfSpace> region, const Visit& visit) const {
        if (!levels_.empty()) descend(levels_.size() - 1, 0, region, visit);
    }

  private:
    static constexpr std::size_t kChunk = 16;

    template <typename Visit>
    void descend(std::size_t level, std::size_t at, std::span<const HalfSpace> region,
                 const Visit& visit) const {
        const Box& box = levels_[level][at];
        for (const HalfSpace& side : region)
            if (side.misses(box)) return;
        if (level == 0) {
            visit(at * kChunk, std::min(count_, (at + 1) * kChunk));
            return;
        }
        descend(level - 1, 2 * at, region, visit);
        if (2 * at + 1 < levels_[level - 1].size())
            descend(level - 1, 2 * at + 1, region, visit);
    }

    std::size_t count_ = 0;
    std::vector<std::uint32_t> order_;
    std::vector<std::vector<Box>> levels_;  // [0] the chunks', [i + 1] of pairs of [i]
};

namespace detail {

/// Two zeros between any two of the lowest 21 bits.
inline std::uint64_t spread(std::uint64_t x) noexcept {
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffff;
    x = (x | x << 16) & 0x1f0000ff0000ff;
    x = (x | x << 8) & 0x100f00f00f00f00f;
    x = (x | x << 4) & 0x10c30c30c30c30c3;
    return (x | x << 2) & 0x1249249249249249;
}

}  // namespace detail

template <typename BoxOf>
ChunkTree::ChunkTree(std::size_t count, const BoxOf& boxOf) : count_(count) {
    if (count == 0) return;
    Box all;
    for (std::size_t i = 0; i < count; ++i)
        all.include(boxOf(i));
    const glm::dvec3 size = all.high - all.low;
    const glm::dvec3 scale = double(0x1fffff) / glm::max(size, glm::dvec3(1e-300));
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(count);
    for (std::size_t i = 0; i < count; ++i) {
        const Box box = boxOf(i);
        const glm::dvec3 at =
            glm::min((0.5 * (box.low + box.high) - all.low) * scale, double(0x1fffff));
        keys[i] = {detail::spread(std::uint64_t(at.x)) |
                       detail::spread(std::uint64_t(at.y)) << 1 |
                       detail::spread(std::uint64_t(at.z)) << 2,
                   std::uint32_t(i)};
    }
    std::sort(keys.begin(), keys.end());
    order_.resize(count);
    levels_.emplace_back((count + kChunk - 1) / kChunk);
    for (std::size_t k = 0; k < count; ++k) {
        order_[k] = keys[k].second;
        levels_[0][k / kChunk].include(boxOf(order_[k]));
    }
    while (levels_.back().size() > 1) {
        std::vector<Box> above((levels_.back().size() + 1) / 2);
        for (std::size_t i = 0; i < levels_.back().size(); ++i)
            above[i / 2].include(levels_.back()[i]);
        levels_.push_back(std::move(above));
    }
}

}  // namespace mtsm::baseline
