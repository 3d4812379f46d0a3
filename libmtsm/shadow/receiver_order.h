// receiver_order.h - the points of a batch, neighbours next to each other.
//
// Points of a pixel are neighbours as they come: they are put in order together, as a
// run, by the place of the first.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "shadow/bundle_query.h"
#include "shadow/query.h"

namespace mtsm::shadow {

class ReceiverOrder {
  public:
    static constexpr std::size_t kMostPoints = std::size_t(1) << 28;
    static constexpr std::size_t kMostInRun = 16;

    /// By which points are put in order. `normals` may be null.
    static void findKeys(const BundleQuery& bundles, const glm::dvec3* points,
                         const glm::dvec3* normals, std::size_t count,
                         std::uint32_t* keys);
    /// In place of the key of a point that is left out.
    static constexpr std::uint32_t kLeftOut = ~std::uint32_t(0);
    /// How many points from the first on are of one kind and face; none if a bundle does
    /// not answer them.
    [[nodiscard]] static std::size_t alike(const BundleQuery& bundles,
                                           const std::uint32_t* keys,
                                           std::size_t count) noexcept;

    /// At most kMostPoints points, which begin with number `first` of the batch that
    /// `options` are for.
    ReceiverOrder(const BundleQuery& bundles, const std::vector<std::uint32_t>& keys,
                  std::size_t first, const ShadowOptions& options);

    /// Points that follow each other.
    struct Run {
        std::size_t point;
        std::uint32_t count;
    };
    [[nodiscard]] std::size_t runs() const noexcept { return sorted_.size(); }
    /// In all runs together.
    [[nodiscard]] std::size_t points() const noexcept { return points_; }
    /// The run that comes as number i.
    [[nodiscard]] Run operator[](std::size_t i) const noexcept {
        return {sorted_[i].run >> 4, (sorted_[i].run & 15) + 1};
    }
    /// Of one kind and face, and at most so many points.
    struct Block {
        std::size_t runs = 0;
        bool bundled = false;  ///< else each point goes alone, by ray
    };
    /// From run number `first` on and before `end`.
    [[nodiscard]] Block block(std::size_t first, std::size_t end,
                              std::size_t mostPoints) const noexcept;

  private:
    enum class Kind : std::uint32_t { withNormal = 0, without = 1, alone = 2 };
    struct Entry {
        std::uint32_t key;  // kind, then place
        std::uint32_t run;  // its first point, then in four bits how many more it has
        [[nodiscard]] Kind kind() const noexcept { return Kind(key >> 30); }
    };

    std::vector<Entry> sorted_;
    std::size_t points_ = 0;
    std::uint32_t together_;  // bits of a key that those of a block have in common
};

}  // namespace mtsm::shadow
