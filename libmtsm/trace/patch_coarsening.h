// patch_coarsening.h - from the patches of four tiles to those of one of the next level.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "trace/patch_nodes.h"
#include "trace/patch_planes.h"

namespace mtsm::trace::patch_detail {

/// Nodes of two neighbouring tiles, and their masks.
struct TilePair {
    const Node* nodes = nullptr;
    std::size_t count = 0;
    const PixelMask* masks = nullptr;
};

/// Makes tiles of a level of those of the level below.
class Coarsening {
  public:
    Coarsening(std::uint8_t level, std::uint32_t sideBelow, Footprint footprint);

    /// Appends the nodes of tile (x, y); `below`: the upper and the lower two tiles.
    void run(std::uint32_t x, std::uint32_t y, const std::array<TilePair, 2>& below,
             Nodes& made, Parts& parts);

  private:
    /// Pieces of the four tiles below that become one; its members are linked.
    struct Cluster {
        Plane plane;
        Moments moments;
        std::uint32_t first, last, members;
    };
    struct Corner {
        std::uint32_t x = 0, y = 0;
    };
    static constexpr std::uint32_t kNone = 0xffffffffu;

    /// One for each node. Large ones first: they say where the surfaces are.
    void startClusters();
    /// Adds the members of each to the one before it that it fits best, if within so many
    /// pixel footprints.
    void gatherClusters(float tolerance);
    /// Of the first `made`; `made` if it fits none within `least`.
    [[nodiscard]] std::size_t findBest(const Cluster& c, std::size_t made, float least);
    /// Cluster k's plane, in planes_.
    void setPlane(std::size_t k);
    void join(Cluster& to, const Cluster& c);
    void finish(const Cluster& c, Nodes& made, Parts& parts);
    /// Appends the members' masks, those of one tile united.
    void uniteMasks(std::vector<PixelMask>& masks);
    static void unite(PixelMask& to, const PixelMask& from);
    [[nodiscard]] std::size_t placeOf(const PixelMask& mask) const;
    /// Do sheets of all quarters that the box reaches into meet at their borders?
    [[nodiscard]] bool isSheet(const Node& node) const;
    [[nodiscard]] std::pair<std::uint32_t, std::uint32_t> tileOf(const Node& n) const;
    [[nodiscard]] bool meet(const Node& a, const Node& b) const;
    void addCover(Node& node, std::span<const PixelMask> masks, Parts& parts);
    /// Rays meet the plane there.
    void includeTexel(Node& node, std::uint32_t column, std::uint32_t row) const;
    /// Adds the covered pixels of each texel.
    void count(const PixelMask& mask, std::array<std::uint32_t, 256>& counts) const;
    /// Of some pixels' rows in a row of texels: adds `weight` for each.
    static void countRow(const std::uint16_t* rows, std::uint32_t count,
                         std::uint32_t texel, std::uint32_t weight, std::uint32_t* to);
    /// Adds for each pixel in the right half of its texel kRight, in the lower one
    /// kLower.
    void lean(const PixelMask& mask, std::array<std::uint32_t, 256>& leans) const;
    /// The share in sixteenths by ordered dither; 15 stands for all of it. `above`: of
    /// thresholds from above.
    static std::uint32_t sixteenths(std::uint32_t covered, std::uint32_t full,
                                    std::uint32_t place, bool above);

    std::uint8_t level_;
    Footprint footprint_;
    std::uint32_t side_;
    Corner corner_;  // pixels
    // Of the tiles below, and of what is made of them.
    std::vector<const Node*> nodes_;
    std::vector<const PixelMask*> masks_;  // of each node
    std::vector<std::uint32_t> order_;
    std::vector<std::uint32_t> next_;  // member of the same cluster
    std::vector<Cluster> clusters_;
    PlaneList planes_;  // of clusters
    std::vector<std::uint32_t> candidates_;
    std::vector<std::uint32_t> members_;  // of the cluster at hand
    std::vector<std::uint32_t> maskAt_;   // by tile of level 0
};

}  // namespace mtsm::trace::patch_detail
