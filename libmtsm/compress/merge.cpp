// The pair of least harm is merged first, again and again: a tournament knows it. What
// harm is has a closed form, since a layer's samples lie behind those of the one before.
//
// A pixel of very many layers is coarsened first, in passes of linear time that merge
// disjoint pairs: each less harmful than its neighbours. What they merge is what would
// have been merged anyhow, but for few.
#include "compress/merge.h"

#include <bit>
#include <cfloat>

namespace mtsm::compress {
namespace {

/// What a channel that goes dark counts as: about that of the least visibility.
constexpr double kDarkDepth = 88.0;

constexpr std::uint32_t kNever = ~0u;         ///< Key of what cannot be merged
constexpr std::uint32_t kBridges = 1u << 31;  ///< of a Key
constexpr std::uint64_t kNoPair = ~0ull;
constexpr double kNotZero = 1e-300;  // to divide by

double depthBetween(float before, float after) {
    if (before <= 0.0f) return 0.0;
    if (after <= 0.0f) return kDarkDepth;
    // ln(x / y) = 2 artanh((x - y) / (x + y)); what is left out of the series is 1e-7.
    const double x = before, y = after;
    const double s = (x - y) / (x + y), s2 = s * s;
    if (s > 0.25) return std::log(x / y);
    return 2.0 * s *
           (1.0 + s2 * (1.0 / 3 + s2 * (1.0 / 5 + s2 * (1.0 / 7 + s2 * (1.0 / 9)))));
}

/// Integral of |f| over a piece of this length on which f is linear.
double area(double f0, double f1, double length) {
    const double sum = std::abs(f0) + std::abs(f1) + kNotZero;
    return 0.5 * (f0 * f0 + f1 * f1 + std::max(0.0, 2.0 * f0 * f1)) / sum * length;
}

/// Optical depth spread evenly over `n` samples `step` apart.
struct Spread {
    double depth, step, n;
};

/// Optical depth times the distance it has to be moved to make a, and b behind it, one
/// layer of this step: the integral of |excess of the whole's depth in front of z|. All z
/// are counted from where a's samples are counted from. The whole's first sample is never
/// behind b's: its step is a mean of theirs.
double transport(const Spread& a, const Spread& b, double step) {
    const double aFirst = a.step, aLast = a.n * a.step;
    const double bFirst = aLast + b.step, last = (a.n + b.n) * step;
    const double slope = (a.depth + b.depth) / (last - step);
    const double atGap = slope * (bFirst - step) - a.depth;
    // The piece of b, at the end of which nothing is in excess.
    double sum = 0.5 * std::abs(atGap) * (last - bFirst);
    // The gap; at first the whole may not have begun.
    const double begun = std::max(aLast, step);
    sum += a.depth * (begun - aLast) +
           area(slope * (begun - step) - a.depth, atGap, bFirst - begun);
    // The piece of a, and what the whole has in front of it.
    const double low = std::min(std::max(step, aFirst), aLast);
    const double ahead = slope * (low - std::min(low, step));
    sum += 0.5 * ahead * (aFirst - std::min(aFirst, step));
    if (a.n == 1.0) return sum;
    const double behind = a.depth * (low - aFirst) / std::max(aLast - aFirst, kNotZero);
    const double atLast = slope * (aLast - std::min(aLast, step)) - a.depth;
    return sum + 0.5 * behind * (low - aFirst) +
           area(ahead - behind, atLast, aLast - low);
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

/// Of pairs of one key the front most comes first.
std::uint64_t pair(std::uint32_t key, std::uint32_t left) {
    return key == kNever ? kNoPair : std::uint64_t(key) << 32 | left;
}

/// A bound on the error of a layer: neither V nor V' leaves what lies between its ends.
double mostError(const Visibility& samples, Group g, const float* vBefore,
                 const float* v) {
    constexpr double kRounding = 1e-9;  // of steps one after the other
    double most = 0.0;
    bool exact = g.size() == 1;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        const double behind = samples.v[c][g.end - 1];
        exact = exact && v[c] == float(behind);
        most = std::max(most, std::max(double(vBefore[c]), samples.before(g.begin, c)) -
                                  std::min(double(v[c]), behind));
    }
    return exact ? 0.0 : most + kRounding;
}

}  // namespace

std::uint64_t Merger::merge(const Visibility& samples, std::uint32_t cap,
                            std::vector<Span>& layers) {
    if (layers.size() <= cap) return 0;
    layers.resize(mergeable(samples, layers, cap));
    const std::uint64_t dropped = samples.size() - layers.back().end;
    if (layers.size() <= cap) return dropped;

    makeNodes(samples, layers);
    if (coarsens_ && nodes_.size() > kCoarsenAbove * cap) coarsen(kCoarsenTo * cap);
    mergeLeast(cap);
    std::size_t kept = 0;
    for (const Node& node : nodes_) {
        if (node.n > 0) layers[kept++] = layers[node.layer];
    }
    layers.resize(kept);
    return dropped;
}

void Merger::makeNodes(const Visibility& samples, const std::vector<Span>& layers) {
    const auto count = std::uint32_t(layers.size());
    nodes_.resize(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        const Group g{i > 0 ? layers[i - 1].end : 0, layers[i].end};
        const Spacing places = spacing(samples, g);
        Node& node = nodes_[i];
        node.from = places.from;
        node.step = places.step;
        node.z = samples.z[g.end - 1];
        node.opticalDepth = 0.0;
        node.moved = g.size() > 1 ? largestMove(samples, g, HUGE_VAL) : 0.0;
        node.n = g.size();
        node.layer = i;
        node.first = i == 0;
        node.reset = isReset(samples, layers[i]);
        for (std::uint32_t c = 0; c < samples.channels; ++c) {
            const float before = samples.startsAt(g.begin) ? 1.0f : layers[i - 1].v[c];
            node.opticalDepth += depthBetween(before, layers[i].v[c]);
        }
    }
}

/// Merges pairs that are less harmful than their neighbours, in passes over the nodes,
/// until `target` are left or few respect gaps.
void Merger::coarsen(std::size_t target) {
    constexpr std::size_t kFewest = 16;  // of so many nodes one has to go
    std::size_t before = 0;
    do {
        before = nodes_.size();
        keys_.resize(before);
        for (std::size_t i = 0; i + 1 < before; ++i)
            keys_[i] = quickKey(nodes_[i], nodes_[i + 1]);
        keys_.back() = kNever;
        std::size_t kept = 0, surplus = before - target;
        for (std::size_t i = 0; i < before; ++i) {
            const bool least = keys_[i] < kBridges &&
                               (i == 0 || keys_[i] <= keys_[i - 1]) &&
                               keys_[i] <= keys_[i + 1];
            if (least && surplus > 0) {
                absorb(nodes_[i], nodes_[i + 1]);
                --surplus;
                ++i;
            }
            nodes_[kept++] = nodes_[i];
        }
        nodes_.resize(kept);
    } while (nodes_.size() > target && nodes_.size() < before - before / kFewest);
}

/// Merges the pair of least harm until `cap` nodes have samples.
void Merger::mergeLeast(std::size_t cap) {
    const auto count = std::uint32_t(nodes_.size());
    least_.resize(2 * std::size_t(count));
    for (std::uint32_t i = 0; i < count; ++i) {
        nodes_[i].previous = i > 0 ? i - 1 : count;
        nodes_[i].next = i + 1;
        least_[count + i] = kNoPair;
        if (i + 1 < count) least_[count + i] = pair(key(nodes_[i], nodes_[i + 1]), i);
    }
    for (std::size_t i = count - 1; i > 0; --i)
        least_[i] = std::min(least_[2 * i], least_[2 * i + 1]);

    for (std::size_t left = count; left > cap && least_[1] != kNoPair; --left) {
        const auto at = std::uint32_t(least_[1]);
        Node& a = nodes_[at];
        Node& b = nodes_[a.next];
        absorb(a, b);
        b.previous = a.previous;
        a.n = 0;
        place(at, kNoPair);
        if (a.previous < count) {
            nodes_[a.previous].next = a.next;
            offer(a.previous);
        }
        offer(a.next);
    }
}

/// b, which keeps its v, gets the samples of a, the node before.
void Merger::absorb(const Node& a, Node& b) {
    const double step = stepOfBoth(a, b);
    b.moved = move(a, b, step);
    b.n += a.n;
    b.opticalDepth += a.opticalDepth;
    b.first = a.first;
    b.from = a.first ? b.z : a.from;
    b.step = step;
}

Merger::Key Merger::key(const Node& a, const Node& b) const {
    const double step = stepOfBoth(a, b);
    if (a.first) {
        // All go to b's last.
        const double harm =
            a.opticalDepth * (b.z - a.z) + b.opticalDepth * 0.5 * (b.n - 1) * b.step;
        return ordered(a, b, step, harm);
    }
    const double harm = step > 0.0
                            ? transport({a.opticalDepth, a.step, double(a.n)},
                                        {b.opticalDepth, b.step, double(b.n)}, step)
                            : 0.0;
    return ordered(a, b, step, harm);
}

/// A bound on the harm, at a fraction of what it takes to know it.
Merger::Key Merger::quickKey(const Node& a, const Node& b) const {
    const double step = stepOfBoth(a, b);
    return ordered(a, b, step, (a.opticalDepth + b.opticalDepth) * (b.z - a.from - step));
}

Merger::Key Merger::ordered(const Node& a, const Node& b, double step,
                            double harm) const {
    // As of single layers, but as if samples were where layers put them.
    const double covered =
        a.n * std::min(step, a.step) + b.n * std::min(step, b.step) - step;
    const double mayMove = std::min(0.5 * bounds_.length(b.z), covered);
    // Not below 0, nor beyond a float, by rounding or huge depths.
    const double finite = std::min(std::max(0.0, harm), double(FLT_MAX));
    const Key bits = std::bit_cast<Key>(float(finite));
    const Key key = bits | (move(a, b, step) > mayMove ? kBridges : 0u);
    return a.reset || b.reset ? kNever : key;
}

void Merger::offer(std::uint32_t left) {
    const std::uint32_t next = nodes_[left].next;
    const bool last = next == nodes_.size();
    place(left, last ? kNoPair : pair(key(nodes_[left], nodes_[next]), left));
}

/// Lets a pair play, or none.
void Merger::place(std::uint32_t left, std::uint64_t player) {
    std::size_t i = nodes_.size() + left;
    least_[i] = player;
    for (i /= 2; i > 0; i /= 2) {
        const std::uint64_t winner = std::min(least_[2 * i], least_[2 * i + 1]);
        if (least_[i] == winner) break;
        least_[i] = winner;
    }
}

double errorOf(const Visibility& samples, const std::vector<Span>& layers,
               double tolerance, double known) {
    double largest = 0.0;
    std::uint32_t begin = 0;
    float vBefore[3] = {1.0f, 1.0f, 1.0f};
    for (const Span& layer : layers) {
        const Group g{begin, layer.end};
        const double most = mostError(samples, g, vBefore, layer.v);
        const bool matters = most > std::max(largest, known);
        if (matters || (largest <= tolerance && most > tolerance))
            largest = std::max(largest, largestError(samples, g, vBefore, layer.v,
                                                     matters ? HUGE_VAL : tolerance));
        const bool reset = isReset(samples, layer);
        for (std::uint32_t c = 0; c < samples.channels; ++c)
            vBefore[c] = reset ? 1.0f : layer.v[c];
        begin = layer.end;
    }
    return largest;
}

}  // namespace mtsm::compress
