// grown_tree.h - a tree of boxes for shadow rays that have a width: what a ray comes near
// is found beside what it hits.
//
//     GrownTree tree(boxes);                       // put your items in tree.takeOrder()
//     tree.search(ray, false, [&](std::size_t begin, std::size_t end) { ...; return true;
//     });
//
// A single-sample soft shadow asks for all objects whose grown outline the ray meets, and
// they grow with their distance from the receiver [Parker98, appendix]. Growing the boxes
// when the tree is built would need the largest growth of the largest light, everywhere.
// Here boxes stay as they are and the ray grows: it is a cone, thin at the receiver. A
// cone against a box costs what a ray against a box costs: slabs with one slope for the
// lower planes and another one for the upper planes. So one tree serves every light.
//
// Four children to a node, split by the surface area heuristic in bins.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <limits>
#include <utility>
#include <vector>

namespace mtsm::baseline {

struct GrownBox {
    glm::vec3 low{std::numeric_limits<float>::infinity()};
    glm::vec3 high{-std::numeric_limits<float>::infinity()};

    void add(glm::vec3 p) noexcept {
        low = glm::vec3(std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z));
        high = glm::vec3(std::max(high.x, p.x), std::max(high.y, p.y),
                         std::max(high.z, p.z));
    }
    void add(const GrownBox& box) noexcept {
        add(box.low);
        add(box.high);
    }
};

/// From `origin` along the unit vector `direction` as far as `reach`, together with all
/// points that are not further than margin + t * growth from its point t.
class WideRay {
  public:
    /// `size`: the largest coordinate of all boxes, for what rounding takes.
    WideRay(glm::dvec3 origin, glm::dvec3 direction, double reach, double growth,
            double margin, float size) noexcept;

    /// The same ray with less growth.
    void narrow(double growth) noexcept;

  private:
    friend class GrownTree;
    /// How an axis bounds t: t >= (near plane - nearOrigin) * nearScale, and the same
    /// with <= for the far plane; an axis that the cone opens around has lower bounds
    /// only.
    struct Axis {
        float nearOrigin = 0, nearScale = 0, farOrigin = 0, farScale = 0;
        bool backwards = false;  // the near plane is the upper one
        bool open = false;
    };
    /// How a child's box lies around the ray, by the sphere around it. Slabs alone let
    /// pass what is up to sqrt(2) too far off.
    struct Place {
        bool missed = false;
        float apart = 0.0f;  // tangent under which the middle is seen, off the direction
    };
    template <std::size_t N>
    [[nodiscard]] Place place(const float (&plane)[2][3][N],
                              std::uint32_t c) const noexcept {
        glm::vec3 q;
        float t = 0.0f, size = 0.0f;
        for (int a = 0; a < 3; ++a) {
            const float low = plane[0][a][c], high = plane[1][a][c];
            q[a] = 0.5f * (low + high) - start_[a];
            t += q[a] * towards_[a];
            size += (high - low) * (high - low);
        }
        q -= t * towards_;
        const float d = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z),
                    radius = 0.5f * std::sqrt(size) + slack_;
        return {d - growth_ * t > radius * secant_,
                t > 0.0f ? d / t : std::numeric_limits<float>::max()};
    }

    std::array<Axis, 3> axes_;
    glm::dvec3 origin_, direction_;
    glm::vec3 start_, towards_;  // the same
    float growth_ = 0.0f, secant_ = 1.0f, slack_ = 0.0f;
    float reach_;
    double margin_;
};

class GrownTree {
  public:
    GrownTree() = default;
    /// Boxes must be finite.
    explicit GrownTree(const std::vector<GrownBox>& boxes);

    /// [boxes]: the box that comes first, second and so on in the order of search(). The
    /// tree does without.
    [[nodiscard]] std::vector<std::uint32_t> takeOrder() { return std::move(order_); }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return nodes_.size() * sizeof(Node) + order_.size() * sizeof(std::uint32_t);
    }

    /// Calls visit(begin, end) with ranges of places in the order that together hold
    /// every box that the ray comes near; on false it stops. With `nearestFirst` what is
    /// near to the ray's middle comes early: good if `visit` narrows the ray. Returns the
    /// number of nodes it went through.
    template <typename Visit>
    std::size_t search(const WideRay& ray, bool nearestFirst, const Visit& visit) const {
        if (nodes_.empty()) return 0;
        std::array<Waiting, kStack> stack;
        std::size_t waiting = 0, nodes = 0;
        std::uint32_t at = 0;
        while (true) {
            const Node& node = nodes_[at];
            ++nodes;
            std::array<bool, kWidth> met;
            meet(node, ray, met);
            const std::size_t first = waiting;
            for (std::uint32_t c = 0; c < kWidth; ++c) {
                if (!met[c]) continue;
                Waiting child{at, c, 0.0f};
                if (nearestFirst) {
                    const WideRay::Place lies = ray.place(node.plane, c);
                    if (lies.missed) continue;
                    child.apart = lies.apart;
                }
                std::size_t place = waiting++;
                for (; place > first && stack[place - 1].apart < child.apart; --place)
                    stack[place] = stack[place - 1];
                stack[place] = child;
            }
            // The next node; leaves on the way are visited.
            for (;;) {
                if (waiting == 0) return nodes;
                const Waiting next = stack[--waiting];
                const Node& parent = nodes_[next.node];
                // The ray may have become narrower.
                if (nearestFirst && ray.place(parent.plane, next.child).missed) continue;
                at = parent.child[next.child];
                const std::uint32_t count = parent.count[next.child];
                if (count == 0) break;
                if (!visit(std::size_t(at), std::size_t(at) + count)) return nodes;
            }
        }
    }

  private:
    static constexpr std::size_t kWidth = 4;    // children of a node
    static constexpr std::uint32_t kLeaf = 4;   // most boxes in a leaf
    static constexpr int kDepth = 40;           // from here on halves, by number
    static constexpr std::size_t kStack = 256;  // > 3 * (kDepth + 32)
    struct Node {
        float plane[2][3][kWidth];      // low, high
        std::uint32_t child[kWidth];    // a node, or the first box of a leaf
        std::uint32_t count[kWidth]{};  // of a leaf
    };
    struct Waiting {
        std::uint32_t node, child;
        float apart;
    };
    struct Range;
    struct Builder;

    static void meet(const Node& node, const WideRay& ray,
                     std::array<bool, kWidth>& met) noexcept {
        float from[kWidth], to[kWidth];
        for (std::size_t c = 0; c < kWidth; ++c) {
            from[c] = 0.0f;
            to[c] = ray.reach_;
        }
        for (std::size_t a = 0; a < 3; ++a) {
            const WideRay::Axis& axis = ray.axes_[a];
            const float* near = node.plane[axis.backwards ? 1 : 0][a];
            const float* far = node.plane[axis.backwards ? 0 : 1][a];
            float bound[kWidth];
            for (std::size_t c = 0; c < kWidth; ++c) {
                const float t = (near[c] - axis.nearOrigin) * axis.nearScale;
                from[c] = t > from[c] ? t : from[c];
                bound[c] = (far[c] - axis.farOrigin) * axis.farScale;
            }
            if (axis.open) {
                for (std::size_t c = 0; c < kWidth; ++c)
                    from[c] = bound[c] > from[c] ? bound[c] : from[c];
            } else {
                for (std::size_t c = 0; c < kWidth; ++c)
                    to[c] = bound[c] < to[c] ? bound[c] : to[c];
            }
        }
        for (std::size_t c = 0; c < kWidth; ++c)
            met[c] = from[c] <= to[c];
    }

    std::vector<Node> nodes_;
    std::vector<std::uint32_t> order_;
};

}  // namespace mtsm::baseline
