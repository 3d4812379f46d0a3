// merge.h - no more layers than a cap.
#pragma once
#include <vector>

#include "compress/error.h"
#include "compress/visibility.h"

namespace mtsm::compress {

/// Merges neighbours, bottom up, until `cap` layers are left.
class Merger {
  public:
    explicit Merger(const Bounds& bounds) : bounds_(bounds) {}

    /// Layers beyond what can be kept are dropped; returns how many samples those had.
    std::uint64_t merge(const Visibility& samples, std::uint32_t cap,
                        std::vector<Span>& layers);

  private:
    struct Node {
        Group group;
        double opticalDepth = 0.0;  ///< sum over the channels
        double moved = 0.0;         ///< no sample was moved further
        std::uint32_t previous = 0, next = 0;
        bool alive = true;
    };
    /// Merging a node with the next one.
    struct Candidate {
        bool bridges = false;  ///< moves samples further than the bounds allow
        double harm = 0.0;     ///< optical depth times the distance it is moved
        std::uint32_t left = 0;
        Group whole;  ///< what would come of it; stale if that changed

        [[nodiscard]] bool operator>(const Candidate& o) const noexcept {
            if (bridges != o.bridges) return bridges;
            return harm != o.harm ? harm > o.harm : left > o.left;
        }
    };

    void link(const Visibility& samples, const std::vector<Span>& layers);
    bool evaluate(const Visibility& samples, std::uint32_t left,
                  Candidate& candidate) const;
    void offer(const Visibility& samples, std::uint32_t left);
    [[nodiscard]] double move(const Visibility& samples, const Node& a,
                              const Node& b) const;
    [[nodiscard]] double mayMove(const Visibility& samples, const Node& a,
                                 const Node& b) const;

    Bounds bounds_;
    std::vector<Node> nodes_;
    std::vector<Candidate> candidates_;  ///< a heap, the least harm first
};

/// Largest |V - V'| of these layers; that a float v is rounded is no error.
double errorOf(const Visibility& samples, const std::vector<Span>& layers);

}  // namespace mtsm::compress
