// merge.h - no more layers than a cap.
#pragma once
#include <vector>

#include "compress/error.h"
#include "compress/visibility.h"

namespace mtsm::compress {

/// Merges neighbours, bottom up, until `cap` layers are left.
class Merger {
  public:
    /// Pixels of more than kCoarsenAbove caps of layers are coarsened first, until
    /// kCoarsenTo caps are left.
    static constexpr std::size_t kCoarsenAbove = 4, kCoarsenTo = 4;

    /// Without `coarsens` the least harm is always looked for among all pairs: the twin.
    explicit Merger(const Bounds& bounds, bool coarsens = true)
        : bounds_(bounds), coarsens_(coarsens) {}

    /// Layers beyond what can be kept are dropped; returns how many samples those had.
    std::uint64_t merge(const Visibility& samples, std::uint32_t cap,
                        std::vector<Span>& layers);

  private:
    struct Node {
        double from = 0.0, step = 0.0;  ///< Spacing of its samples
        double z = 0.0;                 ///< of the last of them
        double opticalDepth = 0.0;      ///< sum over the channels
        double moved = 0.0;             ///< no sample was moved further
        std::uint32_t n = 0;            ///< samples; 0: merged into the next node
        std::uint32_t layer = 0;
        std::uint32_t previous = 0, next = 0;
        bool first = false;  ///< of the pixel
        bool reset = false;  ///< merges with none
    };
    /// Orders pairs of neighbours: those that move samples further than the bounds allow
    /// come last, then by harm (optical depth times the distance it is moved).
    using Key = std::uint32_t;

    void makeNodes(const Visibility& samples, const std::vector<Span>& layers);
    void coarsen(std::size_t target);
    void mergeLeast(std::size_t cap);
    [[nodiscard]] Key quickKey(const Node& a, const Node& b) const;
    [[nodiscard]] Key key(const Node& a, const Node& b) const;
    [[nodiscard]] Key ordered(const Node& a, const Node& b, double step,
                              double harm) const;
    void offer(std::uint32_t left);
    void place(std::uint32_t left, std::uint64_t player);
    static void absorb(const Node& a, Node& b);

    /// The step of the samples once a and b, the node behind it, are merged.
    [[nodiscard]] static double stepOfBoth(const Node& a, const Node& b) {
        return a.first ? 0.0 : (b.z - a.from) / double(a.n + b.n);
    }
    /// A bound on how far samples are then from where they were: what they were moved
    /// before, and what they are now. Both old places and new are linear in the index and
    /// the last stays, so it is the last of a that is moved furthest.
    [[nodiscard]] static double move(const Node& a, const Node& b, double step) {
        const double now = a.first ? b.z - a.z : a.n * std::abs(step - a.step);
        return now + std::max(a.moved, b.moved);
    }

    Bounds bounds_;
    bool coarsens_;
    std::vector<Node> nodes_;
    std::vector<Key> keys_;  ///< [pairs]
    /// Tournament of pairs: node i is the least of 2 i and 2 i + 1, those from
    /// nodes_.size() on are Key and, below it, the left node.
    std::vector<std::uint64_t> least_;
};

/// Largest |V - V'| of these layers; that a float v is rounded is no error. If that is at
/// most `known`, anything up to it that is on the same side of the tolerance.
double errorOf(const Visibility& samples, const std::vector<Span>& layers,
               double tolerance, double known);

}  // namespace mtsm::compress
