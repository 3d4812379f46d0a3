#include "compress/merge.h"

#include <array>
#include <functional>
#include <limits>

namespace mtsm::compress {
namespace {

/// What a channel that goes dark counts as: about that of the least visibility.
constexpr double kDarkDepth = 88.0;

double depthBetween(float before, float after) {
    if (before <= 0.0f) return 0.0;
    return after > 0.0f ? std::log(double(before) / after) : kDarkDepth;
}

/// Optical depth, spread evenly over [first, last].
struct Spread {
    double depth, first, last;

    /// How much of it is in front of z, for z in the open piece (low, high) that holds
    /// neither first nor last.
    [[nodiscard]] double before(double z, double low, double high) const noexcept {
        if (last <= low) return depth;
        if (first >= high) return 0.0;
        return depth * (z - first) / (last - first);
    }
};

Spread spread(const Visibility& samples, Group g, double opticalDepth) {
    const Spacing places = spacing(samples, g);
    return {opticalDepth, places.at(1), samples.z[g.end - 1]};
}

/// Integral of |f| over a piece of this length on which f is linear.
double area(double f0, double f1, double length) {
    if ((f0 < 0.0) == (f1 < 0.0)) return 0.5 * std::abs(f0 + f1) * length;
    return 0.5 * (f0 * f0 + f1 * f1) / (std::abs(f0) + std::abs(f1)) * length;
}

/// Optical depth times the distance it has to be moved to make a and b the whole.
double transport(const Spread& a, const Spread& b, const Spread& whole) {
    std::array<double, 6> z = {a.first, a.last, b.first, b.last, whole.first, whole.last};
    std::sort(z.begin(), z.end());
    double sum = 0.0;
    for (std::size_t i = 0; i + 1 < z.size(); ++i) {
        const double low = z[i], high = z[i + 1];
        if (!(low < high)) continue;
        const auto excess = [&](double at) {
            return a.before(at, low, high) + b.before(at, low, high) -
                   whole.before(at, low, high);
        };
        sum += area(excess(low), excess(high), high - low);
    }
    return sum;
}

bool isReset(const Visibility& samples, const Span& layer) {
    return samples.wall[layer.end - 1] == Wall::reset;
}

/// How many layers, from the front, can be merged into `cap`: all between two resets make
/// at least one.
std::size_t mergeable(const Visibility& samples, const std::vector<Span>& layers,
                      std::uint32_t cap) {
    std::uint32_t least = 0;
    bool open = false;  // layers since the last reset
    for (std::size_t i = 0; i < layers.size(); ++i) {
        const bool reset = isReset(samples, layers[i]);
        if (reset || !open) {
            if (least == cap) return i;
            ++least;
        }
        open = !reset;
    }
    return layers.size();
}

}  // namespace

std::uint64_t Merger::merge(const Visibility& samples, std::uint32_t cap,
                            std::vector<Span>& layers) {
    if (layers.size() <= cap) return 0;
    layers.resize(mergeable(samples, layers, cap));
    const std::uint64_t dropped = samples.size() - layers.back().end;

    link(samples, layers);
    std::size_t left = layers.size();
    while (left > cap && !candidates_.empty()) {
        std::pop_heap(candidates_.begin(), candidates_.end(), std::greater<>());
        const Candidate best = candidates_.back();
        candidates_.pop_back();
        Node& a = nodes_[best.left];
        if (!a.alive || a.next == nodes_.size()) continue;
        Node& b = nodes_[a.next];
        if (a.group.begin != best.whole.begin || b.group.end != best.whole.end) continue;
        // The latter stays, with its v.
        b.moved = move(samples, a, b);
        b.group.begin = a.group.begin;
        b.opticalDepth += a.opticalDepth;
        b.previous = a.previous;
        a.alive = false;
        const auto at = a.next;
        if (a.previous < nodes_.size()) {
            nodes_[a.previous].next = at;
            offer(samples, a.previous);
        }
        offer(samples, at);
        --left;
    }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
        if (nodes_[i].alive) layers[kept++] = layers[i];
    }
    layers.resize(kept);
    return dropped;
}

/// Makes each layer a node and offers all pairs.
void Merger::link(const Visibility& samples, const std::vector<Span>& layers) {
    const auto count = std::uint32_t(layers.size());
    nodes_.resize(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        Node& node = nodes_[i];
        node = {};
        node.group = {i > 0 ? layers[i - 1].end : 0, layers[i].end};
        node.previous = i > 0 ? i - 1 : count;
        node.next = i + 1;
        node.moved = largestMove(samples, node.group, HUGE_VAL);
        for (std::uint32_t c = 0; c < samples.channels; ++c) {
            const float before =
                samples.startsAt(node.group.begin) ? 1.0f : layers[i - 1].v[c];
            node.opticalDepth += depthBetween(before, layers[i].v[c]);
        }
    }
    candidates_.clear();
    for (std::uint32_t i = 0; i < count; ++i) {
        Candidate candidate;
        if (evaluate(samples, i, candidate)) candidates_.push_back(candidate);
    }
    std::make_heap(candidates_.begin(), candidates_.end(), std::greater<>());
}

/// What merging a node with the next one would do; false if one of them is a reset.
bool Merger::evaluate(const Visibility& samples, std::uint32_t left,
                      Candidate& candidate) const {
    const Node& a = nodes_[left];
    if (a.next == nodes_.size()) return false;
    const Node& b = nodes_[a.next];
    if (samples.wall[a.group.end - 1] == Wall::reset ||
        samples.wall[b.group.end - 1] == Wall::reset)
        return false;
    candidate.left = left;
    candidate.whole = {a.group.begin, b.group.end};
    candidate.bridges = move(samples, a, b) > mayMove(samples, a, b);
    candidate.harm =
        transport(spread(samples, a.group, a.opticalDepth),
                  spread(samples, b.group, b.opticalDepth),
                  spread(samples, candidate.whole, a.opticalDepth + b.opticalDepth));
    return true;
}

void Merger::offer(const Visibility& samples, std::uint32_t left) {
    Candidate candidate;
    if (!evaluate(samples, left, candidate)) return;
    candidates_.push_back(candidate);
    std::push_heap(candidates_.begin(), candidates_.end(), std::greater<>());
}

/// A bound on how far samples are from where they were once two nodes are merged: what
/// they were moved before, and what they are now. Both old places and new are linear in
/// the index, so the ends of the pieces decide.
double Merger::move(const Visibility& samples, const Node& a, const Node& b) const {
    const Spacing old[2] = {spacing(samples, a.group), spacing(samples, b.group)};
    const Spacing merged = spacing(samples, {a.group.begin, b.group.end});
    const std::uint32_t nA = a.group.size(), nB = b.group.size();
    double furthest = 0.0;
    for (const std::uint32_t j : {1u, nA})
        furthest = std::max(furthest, std::abs(merged.at(j) - old[0].at(j)));
    for (const std::uint32_t j : {1u, nB})
        furthest = std::max(furthest, std::abs(merged.at(nA + j) - old[1].at(j)));
    return furthest + std::max(a.moved, b.moved);
}

/// The bound on it: as of single layers, but as if samples were where layers put them.
double Merger::mayMove(const Visibility& samples, const Node& a, const Node& b) const {
    const double mean = spacing(samples, {a.group.begin, b.group.end}).step;
    double covered = -mean;
    for (const Node* node : {&a, &b})
        covered +=
            node->group.size() * std::min(mean, spacing(samples, node->group).step);
    return std::min(0.5 * bounds_.length(samples.z[b.group.end - 1]), covered);
}

double errorOf(const Visibility& samples, const std::vector<Span>& layers) {
    double largest = 0.0;
    std::uint32_t begin = 0;
    float vBefore[3] = {1.0f, 1.0f, 1.0f};
    for (const Span& layer : layers) {
        const Group g{begin, layer.end};
        bool exact = g.size() == 1;
        for (std::uint32_t c = 0; c < samples.channels; ++c)
            exact = exact && layer.v[c] == float(samples.v[c][layer.end - 1]);
        if (!exact)
            largest =
                std::max(largest, largestError(samples, g, vBefore, layer.v,
                                               std::numeric_limits<double>::infinity()));
        const bool reset = isReset(samples, layer);
        for (std::uint32_t c = 0; c < samples.channels; ++c)
            vBefore[c] = reset ? 1.0f : layer.v[c];
        begin = layer.end;
    }
    return largest;
}

}  // namespace mtsm::compress
