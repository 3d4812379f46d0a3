// patch_nodes.h - what a patch is while its tree is made, and how it is stored.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "trace/patch_tree.h"

namespace mtsm::trace::patch_detail {

/// Neighbouring samples that differ by no more than this belong to one surface; no plane
/// is steeper either. In pixel footprints per pixel.
inline constexpr float kSteepest = 3.0f;

struct Footprint {
    double perW = 0, constant = 0;  // of a pixel, in w
    [[nodiscard]] float at(double w) const {
        return float(perW * std::abs(w) + constant);
    }
};

/// Sums over samples, enough to fit a plane to them.
struct Moments {
    double n = 0, u = 0, v = 0, w = 0, uu = 0, uv = 0, vv = 0, uw = 0, vw = 0;

    void add(const Moments& m) {
        n += m.n, u += m.u, v += m.v, w += m.w;
        uu += m.uu, uv += m.uv, vv += m.vv, uw += m.uw, vw += m.vw;
    }
};

struct Box {
    float u0, v0, u1, v1;

    void include(const Box& b) {
        u0 = std::min(u0, b.u0), v0 = std::min(v0, b.v0);
        u1 = std::max(u1, b.u1), v1 = std::max(v1, b.v1);
    }
    [[nodiscard]] float area() const { return (u1 - u0) * (v1 - v0); }
};

struct Plane {
    double u = 0, v = 0;  // through this place
    double w = 0, gradientU = 0, gradientV = 0;

    [[nodiscard]] double at(double x, double y) const {
        return w + gradientU * (x - u) + gradientV * (y - v);
    }
};

/// x >= 0, rounded up.
inline UpperHalf halveUp(float x) {
    return UpperHalf((std::bit_cast<std::uint32_t>(x) + 0xffff) >> 16);
}

struct Slope {
    double u = 0, v = 0;
};

/// Least squares; what few samples leave open is as `likely`.
inline Plane fit(const Moments& m, Slope likely, double steepest) {
    const auto limit = [steepest](double slope) {
        return std::clamp(slope, -steepest, steepest);
    };
    if (m.n == 1) return {m.u, m.v, m.w, limit(likely.u), limit(likely.v)};
    const double u = m.u / m.n, v = m.v / m.n, w = m.w / m.n;
    const double xx = std::max(0.0, m.uu - m.n * u * u);
    const double yy = std::max(0.0, m.vv - m.n * v * v);
    const double xy = m.uv - m.n * u * v;
    // Of what is left above the likely plane.
    const double xw = m.uw - m.n * u * w - likely.u * xx - likely.v * xy;
    const double yw = m.vw - m.n * v * w - likely.u * xy - likely.v * yy;
    const double slack = 0.25;
    const double determinant = (xx + slack) * (yy + slack) - xy * xy;
    const double slopeU = likely.u + (xw * (yy + slack) - yw * xy) / determinant;
    const double slopeV = likely.v + (yw * (xx + slack) - xw * xy) / determinant;
    return {u, v, w, limit(slopeU), limit(slopeV)};
}

/// A patch while the tree is made.
struct Node {
    Plane plane;  // through the middle of the box once it is done
    float residual = 0, low = 0, high = 0;
    Box box{};
    Moments moments;
    PatchList children{};
    std::uint32_t cover = 0;
    std::uint32_t masks = 0;  // how many PixelMasks it has
    std::uint8_t level = 0;
    bool shared = false, sheet = false, bumpy = false;

    float above = 0, below = 0;  // of high and low, once it is done

    void centre() {
        const double u = 0.5 * (box.u0 + box.u1), v = 0.5 * (box.v0 + box.v1);
        plane.w = plane.at(u, v);
        plane.u = u, plane.v = v;
    }
};

/// How far the plane is from the node's surface, at most.
inline float mismatch(const Plane& plane, const Node& node) {
    double most = 0;
    for (const float u : {node.box.u0, node.box.u1}) {
        for (const float v : {node.box.v0, node.box.v1})
            most = std::max(most, std::abs(plane.at(u, v) - node.plane.at(u, v)));
    }
    return float(most) + node.residual;
}

/// The pixels that a node covers in one tile of level 0.
struct PixelMask {
    std::uint16_t x, y;     // tile
    std::uint16_t covered;  // pixels
    std::uint16_t row[kTexels];
};

struct Nodes {
    std::vector<Node> nodes;
    std::vector<PixelMask> masks;  // of each node in turn

    void clear() { nodes.clear(), masks.clear(); }
};

/// Where PatchTree::covers begins: for every range of columns as many equal rows as a
/// patch can have, for all those that fill their boxes.
inline constexpr std::uint32_t kFullRows = kTexels * (kTexels + 1) / 2 * kTexels;

/// Of texels [x0, x1) of each row.
inline std::uint32_t fullCover(std::uint32_t x0, std::uint32_t x1) {
    return ((x1 - 1) * x1 / 2 + x0) * kTexels;
}

inline constexpr float kNever = -HUGE_VALF;

inline PatchGroup emptyGroup() {
    PatchGroup g{};
    std::fill_n(g.above, 4, UpperHalf(std::bit_cast<std::uint32_t>(kNever) >> 16));
    return g;
}

/// Texels that are covered in part reach out of the pixels' box.
inline Box wholeTexels(const Node& node) {
    if (!node.shared) return node.box;
    const std::uint32_t texel = 1u << node.level;
    const auto down = [texel](float x) { return float(std::uint32_t(x) & ~(texel - 1)); };
    const auto up = [&](float x) { return down(x + float(texel - 1)); };
    return {down(node.box.u0), down(node.box.v0), up(node.box.u1), up(node.box.v1)};
}

/// Depth of the plane at the middle of a group's box.
inline float middleOf(const Node& node, const Box& box) {
    return float(node.plane.at(0.5 * (box.u0 + box.u1), 0.5 * (box.v0 + box.v1)));
}

/// Rounds bounds as groups have them, outwards, and by what a ray's depth is rounded.
inline void roundBounds(Node& node) {
    node.residual = widen(halveUp(node.residual));
    const float w = middleOf(node, wholeTexels(node));
    const float margin =
        std::max({std::abs(node.low), std::abs(node.high), std::abs(w)}) * 0x1p-18f;
    node.above = widen(halveUp(std::max(0.0f, node.high - w + margin)));
    node.below = widen(halveUp(std::max(0.0f, w - node.low + margin)));
    node.high = w + node.above;
    node.low = w - node.below;
}

inline void store(const Node& node, PatchGroup& g, int i) {
    const Box box = wholeTexels(node);
    g.w[i] = middleOf(node, box);
    g.above[i] = halveUp(node.above);
    g.below[i] = halveUp(node.below);
    g.u0[i] = std::uint16_t(box.u0), g.u1[i] = std::uint16_t(box.u1);
    g.v0[i] = std::uint16_t(box.v0), g.v1[i] = std::uint16_t(box.v1);
    g.gradientU[i] = float(node.plane.gradientU);
    g.gradientV[i] = float(node.plane.gradientV);
    g.residual[i] = halveUp(node.residual);
    g.children[i] = node.children.group | std::uint32_t(node.children.slots)
                                              << PatchGroup::kGroupBits;
    g.childGroups[i] = std::uint8_t(node.children.groups);
    g.cover[i] = node.cover;
    const bool sheet = node.sheet && box.area() == node.box.area();
    g.kind[i] = std::uint8_t(node.level | (node.shared ? PatchGroup::kShared : 0) |
                             (sheet ? PatchGroup::kSheet : 0) |
                             (node.bumpy ? PatchGroup::kBumpy : 0));
}

/// Groups that lists of nodes are put into. What does not fill a group has it together
/// with other lists.
class Groups {
  public:
    template <typename NodeAt>
    PatchList append(std::size_t count, const NodeAt& nodeAt) {
        if (count == 0) return {};
        for (std::size_t left = count; left < 4; ++left) {
            if (open_[left].empty()) continue;
            const std::uint32_t group = open_[left].back();
            open_[left].pop_back();
            return {group, 1, fill(group, 4 - left, 0, count, nodeAt)};
        }
        PatchList list{std::uint32_t(all_.size()), std::uint32_t((count + 3) / 4), 0};
        for (std::size_t i = 0; i < count; i += 4) {
            all_.push_back(emptyGroup());
            list.slots = fill(std::uint32_t(all_.size() - 1), 0, i,
                              std::min(count, i + 4), nodeAt);
        }
        return list;
    }

    [[nodiscard]] std::vector<PatchGroup>& all() { return all_; }

  private:
    /// Puts nodes [begin, end) into a group's slots from `first` on; a bit for each.
    template <typename NodeAt>
    std::uint32_t fill(std::uint32_t group, std::size_t first, std::size_t begin,
                       std::size_t end, const NodeAt& nodeAt) {
        for (std::size_t i = begin; i < end; ++i)
            store(nodeAt(i), all_[group], int(first + i - begin));
        const std::size_t next = first + end - begin;
        if (next < 4) open_[4 - next].push_back(group);
        return (1u << next) - (1u << first);
    }

    std::vector<PatchGroup> all_;
    std::array<std::vector<std::uint32_t>, 4> open_;  // by how many slots are left
};

/// What a task adds to the tree: groups of children and of whole tiles, coverage.
struct Parts {
    Groups children, tiles;
    std::vector<std::uint16_t> covers;
};

}  // namespace mtsm::trace::patch_detail
