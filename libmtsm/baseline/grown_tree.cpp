#include "baseline/grown_tree.h"

#include <cmath>
#include <numeric>

#include "base/parallel.h"

namespace mtsm::baseline {
namespace {

// Where the cone's sides are parallel to an axis' planes.
constexpr double kFlat = 1e-30;
// Origins, planes and products are rounded to float, each by 6e-8 of its size.
constexpr float kRounding = 1e-6f;

constexpr int kBins = 16;
constexpr std::uint32_t kTask = 1u << 14;  // boxes that one thread builds over

float halfArea(const GrownBox& box) {
    const glm::vec3 d = box.high - box.low;
    return d.x * d.y + d.y * d.z + d.z * d.x;
}

glm::vec3 centre(const GrownBox& box) {
    return 0.5f * (box.low + box.high);
}

}  // namespace

WideRay::WideRay(glm::dvec3 origin, glm::dvec3 direction, double reach, double growth,
                 double margin, float size) noexcept
    : origin_(origin),
      direction_(direction),
      start_(origin),
      towards_(direction),
      reach_(float(reach * (1.0 + kRounding))) {
    const double far =
        std::max({std::abs(origin.x), std::abs(origin.y), std::abs(origin.z)});
    margin_ = margin + kRounding * (far + double(size));
    slack_ = 2.0f * float(margin_);
    narrow(growth);
}

void WideRay::narrow(double growth) noexcept {
    growth_ = float(growth * (1.0 + kRounding));
    secant_ = float(std::sqrt(1.0 + growth * growth) * (1.0 + kRounding));
    for (int a = 0; a < 3; ++a) {
        // A disk across the ray reaches this far along the axis.
        const double across =
            std::sqrt(std::max(0.0, 1.0 - direction_[a] * direction_[a]));
        double upper = direction_[a] + growth * across,
               lower = direction_[a] - growth * across;
        if (std::abs(upper) < kFlat) upper = kFlat;
        if (std::abs(lower) < kFlat) lower = upper > 0.0 ? kFlat : -kFlat;
        // low <= origin + margin + t * upper and high >= origin - margin + t * lower.
        Axis& axis = axes_[std::size_t(a)];
        axis.backwards = upper < 0.0;
        axis.open = upper > 0.0 && lower < 0.0;
        axis.nearOrigin = float(origin_[a] + margin_);
        axis.nearScale = float(1.0 / upper);
        axis.farOrigin = float(origin_[a] - margin_);
        axis.farScale = float(1.0 / lower);
        if (axis.backwards) {
            std::swap(axis.nearOrigin, axis.farOrigin);
            std::swap(axis.nearScale, axis.farScale);
        }
    }
}

struct GrownTree::Range {
    std::uint32_t begin = 0, end = 0;
    GrownBox box;
    int depth = 0;  // in halvings

    [[nodiscard]] std::uint32_t size() const { return end - begin; }
};

struct GrownTree::Builder {
    const std::vector<GrownBox>& boxes;
    std::vector<Node>& nodes;
    std::vector<std::uint32_t>& order;

    [[nodiscard]] Range range(std::uint32_t begin, std::uint32_t end, int depth) const {
        Range r{begin, end, {}, depth};
        for (std::uint32_t i = begin; i < end; ++i)
            r.box.add(boxes[order[i]]);
        return r;
    }

    /// Where the second half begins: the order within the range is changed to suit.
    std::uint32_t split(const Range& r) {
        GrownBox centres;
        for (std::uint32_t i = r.begin; i < r.end; ++i)
            centres.add(centre(boxes[order[i]]));
        const glm::vec3 extent = centres.high - centres.low;
        int axis = extent.x >= extent.y && extent.x >= extent.z ? 0
                   : extent.y >= extent.z                       ? 1
                                                                : 2;
        const auto first = order.begin() + r.begin, last = order.begin() + r.end;
        if (r.depth < kDepth && extent[axis] > 0.0f) {
            const float scale = float(kBins) / extent[axis], low = centres.low[axis];
            const auto binOf = [&](std::uint32_t item) {
                return std::clamp(int((centre(boxes[item])[axis] - low) * scale), 0,
                                  kBins - 1);
            };
            const int border = cheapest(r, binOf);
            const auto middle = std::partition(
                first, last, [&](std::uint32_t item) { return binOf(item) < border; });
            if (middle != first && middle != last)
                return std::uint32_t(middle - order.begin());
        }
        const auto middle = first + r.size() / 2;
        std::nth_element(first, middle, last, [&](std::uint32_t a, std::uint32_t b) {
            const float x = centre(boxes[a])[axis], y = centre(boxes[b])[axis];
            return x != y ? x < y : a < b;
        });
        return std::uint32_t(middle - order.begin());
    }

    /// The bin at which to cut: the least sum of area times number of both sides.
    template <typename BinOf>
    int cheapest(const Range& r, const BinOf& binOf) const {
        std::array<GrownBox, kBins> bins;
        std::array<std::uint32_t, kBins> counts{};
        for (std::uint32_t i = r.begin; i < r.end; ++i) {
            const auto bin = std::size_t(binOf(order[i]));
            bins[bin].add(boxes[order[i]]);
            ++counts[bin];
        }
        std::array<float, kBins> above{};  // cost of bins [b, kBins)
        GrownBox box;
        std::uint32_t count = 0;
        for (int b = kBins - 1; b > 0; --b) {
            box.add(bins[std::size_t(b)]);
            count += counts[std::size_t(b)];
            above[std::size_t(b)] = count > 0 ? halfArea(box) * float(count) : 0.0f;
        }
        box = {};
        count = 0;
        int best = kBins / 2;
        float least = std::numeric_limits<float>::infinity();
        for (int b = 1; b < kBins; ++b) {
            box.add(bins[std::size_t(b) - 1]);
            count += counts[std::size_t(b) - 1];
            if (count == 0 || count == r.size()) continue;
            const float cost = halfArea(box) * float(count) + above[std::size_t(b)];
            if (cost < least) {
                least = cost;
                best = b;
            }
        }
        return best;
    }

    std::uint32_t build(const Range& whole) {
        // The largest part that is no leaf yet is cut until there are four.
        std::array<Range, kWidth> parts{whole};
        std::size_t count = 1;
        while (count < kWidth) {
            Range* widest = nullptr;
            for (std::size_t i = 0; i < count; ++i) {
                if (parts[i].size() > kLeaf &&
                    (!widest || halfArea(parts[i].box) > halfArea(widest->box)))
                    widest = &parts[i];
            }
            if (!widest) break;
            const Range old = *widest;
            const std::uint32_t middle = split(old);
            *widest = range(old.begin, middle, old.depth + 1);
            parts[count++] = range(middle, old.end, old.depth + 1);
        }
        const auto at = std::uint32_t(nodes.size());
        nodes.emplace_back();
        for (std::size_t c = 0; c < kWidth; ++c) {
            const GrownBox box = c < count ? parts[c].box : GrownBox{};
            for (int a = 0; a < 3; ++a) {
                nodes[at].plane[0][a][c] = box.low[a];
                nodes[at].plane[1][a][c] = box.high[a];
            }
            nodes[at].child[c] = c < count ? parts[c].begin : 0;
            nodes[at].count[c] = c < count ? parts[c].size() : 0;
        }
        const auto hasNodes = [&](std::size_t c) {
            return c < count && parts[c].size() > kLeaf;
        };
        const auto link = [&](std::size_t c, std::uint32_t child) {
            nodes[at].child[c] = child;
            nodes[at].count[c] = 0;
        };
        if (whole.size() <= kTask) {
            for (std::size_t c = 0; c < kWidth; ++c)
                if (hasNodes(c)) link(c, build(parts[c]));
            return at;
        }
        // Side by side, then one behind the other as if built in turn.
        std::array<std::vector<Node>, kWidth> below;
        base::parallelFor(std::size_t(0), kWidth, [&](std::size_t c) {
            if (hasNodes(c)) Builder{boxes, below[c], order}.build(parts[c]);
        });
        for (std::size_t c = 0; c < kWidth; ++c) {
            if (!hasNodes(c)) continue;
            const auto first = std::uint32_t(nodes.size());
            link(c, first);
            for (Node node : below[c]) {
                for (std::size_t i = 0; i < kWidth; ++i)
                    if (node.count[i] == 0) node.child[i] += first;
                nodes.push_back(node);
            }
            below[c] = {};
        }
        return at;
    }
};

GrownTree::GrownTree(const std::vector<GrownBox>& boxes) : order_(boxes.size()) {
    if (boxes.empty()) return;
    std::iota(order_.begin(), order_.end(), 0u);
    Builder builder{boxes, nodes_, order_};
    builder.build(builder.range(0, std::uint32_t(boxes.size()), 0));
    nodes_.shrink_to_fit();
}

}  // namespace mtsm::baseline
