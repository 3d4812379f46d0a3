// volume_walk.h - the voxels of a fog volume that a ray crosses, and how far it runs in
// each: exact, for the volume is constant over a voxel.
//
//     VolumeIndex index(view);                                  // once per volume
//     if (const auto cells = index.cellsFromWorld())            // not singular
//         double depth = opticalDepth(index, *cells, from, to); // any thread, any
//         segment
//
// *Cells* are voxels counted from the lowest corner of the lowest block: voxel (i, j, k)
// of the index covers [i, i + 1) x [j, j + 1) x [k, k + 1) of them, so that all planes
// between voxels are whole numbers. A ray is origin + t * direction in cells, and t is
// what it was in the space that the ray came from, for that mapping is affine.
//
// The blocks hang in a tree of 8 x 8 x 8 children per node, and one and the same digital
// differential analyser [Amanatides87] crosses a node's children and a block's voxels.
// Differs: a crossing is computed from its plane, not by adding up steps, so it is the
// same on every level, chords join without gap or overlap, and empty space costs a step
// per largest empty node, however far blocks are apart.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::raster {

/// A ray in cells.
struct CellRay {
    glm::dvec3 origin, direction;
    glm::dvec3 inverse;  ///< 1 / direction; infinite on an axis that it runs across
    glm::ivec3 step;     ///< -1, 0 or 1

    CellRay(glm::dvec3 from, glm::dvec3 along) noexcept
        : origin(from), direction(along), inverse(1.0 / along), step(0) {
        for (int axis = 0; axis < 3; ++axis) {
            if (!std::isfinite(inverse[axis])) direction[axis] = 0.0;
            if (direction[axis] != 0.0) step[axis] = direction[axis] > 0.0 ? 1 : -1;
        }
    }
    /// Where the ray crosses the plane; infinite if it runs along it.
    [[nodiscard]] double crossing(int axis, double plane) const noexcept {
        return step[axis] == 0 ? std::numeric_limits<double>::infinity()
                               : (plane - origin[axis]) * inverse[axis];
    }
};

/// From some space to cells.
struct CellsFrom {
    glm::dmat3 linear{1.0};
    glm::dvec3 corner{0.0};  ///< where cell (0, 0, 0) begins, in that space

    [[nodiscard]] CellRay ray(glm::dvec3 origin, glm::dvec3 direction) const noexcept {
        return {linear * (origin - corner), linear * direction};
    }
};

/// Finds blocks and densities. Borrows the view's arrays. A block that is there twice
/// counts once.
class VolumeIndex {
  public:
    explicit VolumeIndex(const VolumeView& view);

    [[nodiscard]] const VolumeView& view() const noexcept { return view_; }
    [[nodiscard]] bool empty() const noexcept { return order_.empty(); }
    /// Of the box around all blocks.
    [[nodiscard]] glm::dvec3 sizeInCells() const noexcept { return size_; }
    /// Cells from a space in which index space lies so; nothing if that is singular (the
    /// volume is flat, and nothing runs any length in it) or not finite.
    [[nodiscard]] std::optional<CellsFrom> cellsFrom(const glm::dmat3& linear,
                                                     glm::dvec3 origin) const noexcept;
    [[nodiscard]] std::optional<CellsFrom> cellsFromWorld() const noexcept {
        return cellsFrom(glm::dmat3(view_.worldFromIndex),
                         glm::dvec3(view_.worldFromIndex[3]));
    }

    /// visit(density, t0, t1) for every voxel of density > 0 that the ray runs through
    /// for some length between t0 and t1 (finite), in order.
    template <typename Visit>
    void walk(const CellRay& ray, double t0, double t1, Visit&& visit) const;

  private:
    static constexpr int kSide = VolumeView::kBlockSide;
    static constexpr int kShift = 3;

    /// Which of 512 children there are, and where.
    struct Node {
        std::uint64_t mask[8] = {};
        std::uint16_t before[8] = {};  ///< children in the words before this one
        std::uint32_t first = 0;       ///< child, on the level below

        [[nodiscard]] std::optional<std::uint32_t> child(int cell) const noexcept {
            const std::uint64_t bit = std::uint64_t(1) << (cell & 63);
            const std::uint64_t word = mask[cell >> 6];
            if ((word & bit) == 0) return std::nullopt;
            return first + before[cell >> 6] +
                   std::uint32_t(std::popcount(word & (bit - 1)));
        }
    };
    /// A block's place in the tree, highest level first: nine bits a level, five levels a
    /// word.
    using Key = std::array<std::uint64_t, 2>;

    static Key keyOf(glm::uvec3 block) noexcept;
    static std::uint32_t digit(const Key& key, int level) noexcept {
        return std::uint32_t(key[level < 5] >> (level % 5 * 9)) & 511;
    }
    static void count(Node& node) noexcept;
    void buildTree(std::vector<Key> keys);

    template <typename Visit>
    static void crossCells(const CellRay& ray, glm::dvec3 corner, double side, double t0,
                           double t1, Visit&& visit);
    template <typename Visit>
    void walkNode(const CellRay& ray, std::size_t level, std::uint32_t node,
                  glm::dvec3 corner, double t0, double t1, Visit& visit) const;

    VolumeView view_;
    glm::ivec3 lowest_{0};  // block
    glm::dvec3 size_{0.0};
    std::vector<std::uint32_t> order_;      // blocks, as the tree has them
    std::vector<std::vector<Node>> nodes_;  // [level - 1]; blocks are level 0
};

/// Integral of extinction over the segment from `a` to `b`, points of the space that
/// `cells` came from, `length` apart in the world. Its transmittance is exp(-that).
[[nodiscard]] inline double opticalDepth(const VolumeIndex& index, const CellsFrom& cells,
                                         glm::dvec3 a, glm::dvec3 b, double length) {
    double sum = 0.0;
    index.walk(cells.ray(a, b - a), 0.0, 1.0, [&](float density, double t0, double t1) {
        sum += double(density) * (t1 - t0);
    });
    return sum * length * double(index.view().extinction);
}

/// The same for points of the world.
[[nodiscard]] inline double opticalDepth(const VolumeIndex& index, const CellsFrom& cells,
                                         glm::dvec3 a, glm::dvec3 b) {
    return opticalDepth(index, cells, a, b, glm::length(b - a));
}

// --- the tree --------------------------------------------------------------------------

inline VolumeIndex::Key VolumeIndex::keyOf(glm::uvec3 block) noexcept {
    Key key{};
    for (int level = 0; level < 10; ++level) {
        const glm::uvec3 d = (block >> unsigned(kShift * level)) & 7u;
        const std::uint64_t cell = (d.z * kSide + d.y) * kSide + d.x;
        key[level < 5] |= cell << (level % 5 * 9);
    }
    return key;
}

inline VolumeIndex::VolumeIndex(const VolumeView& view) : view_(view) {
    if (view.blockCount == 0) return;
    glm::ivec3 low(std::numeric_limits<int>::max()),
        high(std::numeric_limits<int>::min());
    for (std::size_t i = 0; i < view.blockCount; ++i) {
        low = glm::min(low, view.blocks[i] >> kShift);
        high = glm::max(high, view.blocks[i] >> kShift);
    }
    lowest_ = low;
    size_ = (glm::dvec3(high) - glm::dvec3(low) + 1.0) * double(kSide);
    std::vector<std::pair<Key, std::uint32_t>> sorted(view.blockCount);
    for (std::size_t i = 0; i < view.blockCount; ++i)
        sorted[i] = {keyOf(glm::uvec3((view.blocks[i] >> kShift) - low)),
                     std::uint32_t(i)};
    std::sort(sorted.begin(), sorted.end());
    std::vector<Key> keys;
    for (const auto& [key, block] : sorted) {
        if (!keys.empty() && keys.back() == key) continue;
        keys.push_back(key);
        order_.push_back(block);
    }
    buildTree(std::move(keys));
}

/// Level by level until one node is left. `keys` are those of the level below.
inline void VolumeIndex::buildTree(std::vector<Key> keys) {
    for (int level = 0; keys.size() > 1; ++level) {
        std::vector<Node> nodes;
        std::vector<Key> parents;
        for (std::uint32_t i = 0; i < keys.size(); ++i) {
            Key parent = keys[i];
            const std::uint32_t cell = digit(parent, level);
            parent[level < 5] &= ~(std::uint64_t(511) << (level % 5 * 9));
            if (parents.empty() || parents.back() != parent) {
                parents.push_back(parent);
                nodes.push_back({});
                nodes.back().first = i;
            }
            nodes.back().mask[cell >> 6] |= std::uint64_t(1) << (cell & 63);
        }
        for (Node& node : nodes)
            count(node);
        nodes_.push_back(std::move(nodes));
        keys = std::move(parents);
    }
}

inline void VolumeIndex::count(Node& node) noexcept {
    for (int word = 1; word < 8; ++word)
        node.before[word] =
            std::uint16_t(node.before[word - 1] + std::popcount(node.mask[word - 1]));
}

inline std::optional<CellsFrom> VolumeIndex::cellsFrom(const glm::dmat3& linear,
                                                       glm::dvec3 origin) const noexcept {
    constexpr double kFlat = 1e-12;  // of the volume that its edges could span
    const double volume = std::abs(glm::determinant(linear));
    const double most =
        glm::length(linear[0]) * glm::length(linear[1]) * glm::length(linear[2]);
    if (!(volume > kFlat * most) || !std::isfinite(most)) return std::nullopt;
    const glm::dvec3 lowest = glm::dvec3(lowest_) * double(kSide) - 0.5;
    const CellsFrom cells{glm::inverse(linear), origin + linear * lowest};
    for (int i = 0; i < 3; ++i)
        if (!std::isfinite(glm::dot(cells.linear[i], cells.corner))) return std::nullopt;
    return cells;
}

// --- the walk --------------------------------------------------------------------------

/// visit(cell, corner, t0, t1) for the 8 x 8 x 8 cells of this side that the ray crosses.
template <typename Visit>
void VolumeIndex::crossCells(const CellRay& ray, glm::dvec3 corner, double side,
                             double t0, double t1, Visit&& visit) {
    glm::ivec3 cell(0);
    glm::dvec3 next(0.0);  // t at which the ray leaves the cell by this axis
    const auto leaves = [&](int axis) {
        const int plane = cell[axis] + (ray.step[axis] > 0 ? 1 : 0);
        return ray.crossing(axis, corner[axis] + side * plane);
    };
    for (int axis = 0; axis < 3; ++axis) {
        const double at = ray.origin[axis] + ray.direction[axis] * t0 - corner[axis];
        cell[axis] = int(std::clamp(std::floor(at / side), 0.0, kSide - 1.0));
        next[axis] = leaves(axis);
    }
    while (true) {
        int axis = next.y < next.x ? 1 : 0;
        if (next.z < next[axis]) axis = 2;
        const double end = std::min(next[axis], t1);
        if (end > t0) {
            visit((cell.z * kSide + cell.y) * kSide + cell.x, cell, t0, end);
            t0 = end;
        }
        if (!(next[axis] < t1)) return;
        cell[axis] += ray.step[axis];
        if (unsigned(cell[axis]) >= unsigned(kSide)) return;
        next[axis] = leaves(axis);
    }
}

template <typename Visit>
void VolumeIndex::walkNode(const CellRay& ray, std::size_t level, std::uint32_t node,
                           glm::dvec3 corner, double t0, double t1, Visit& visit) const {
    if (level == 0) {
        const float* density =
            view_.density + std::size_t(order_[node]) * VolumeView::kBlockVoxels;
        crossCells(ray, corner, 1.0, t0, t1,
                   [&](int cell, glm::ivec3, double enter, double leave) {
                       if (density[cell] > 0.0f) visit(density[cell], enter, leave);
                   });
        return;
    }
    const Node& parent = nodes_[level - 1][node];
    const double side = std::ldexp(1.0, kShift * int(level));
    crossCells(ray, corner, side, t0, t1,
               [&](int cell, glm::ivec3 at, double enter, double leave) {
                   if (const auto child = parent.child(cell))
                       walkNode(ray, level - 1, *child, corner + side * glm::dvec3(at),
                                enter, leave, visit);
               });
}

template <typename Visit>
void VolumeIndex::walk(const CellRay& ray, double t0, double t1, Visit&& visit) const {
    for (int axis = 0; axis < 3; ++axis) {
        if (ray.step[axis] == 0) {
            const double at = ray.origin[axis];
            if (!(at >= 0.0 && at < size_[axis])) return;
            continue;
        }
        const double a = ray.crossing(axis, 0.0), b = ray.crossing(axis, size_[axis]);
        t0 = std::max(t0, std::min(a, b));
        t1 = std::min(t1, std::max(a, b));
    }
    if (!(t0 < t1) || !std::isfinite(t0) || !std::isfinite(t1)) return;
    walkNode(ray, nodes_.size(), 0, glm::dvec3(0.0), t0, t1, visit);
}

}  // namespace mtsm::raster
