// receiver_order.h - the points of a batch, neighbours next to each other.
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
    /// `normals` may be null. At most 2^32 points.
    ReceiverOrder(const BundleQuery& bundles, const glm::dvec3* points,
                  const glm::dvec3* normals, std::size_t count);

    /// The point that comes as number i.
    [[nodiscard]] std::size_t operator[](std::size_t i) const noexcept {
        return sorted_[i].point;
    }
    /// Points of one kind and face, from number `first` on and before `end`.
    struct Block {
        std::size_t count = 0;
        bool bundled = false;  ///< else each goes alone, by ray
    };
    [[nodiscard]] Block block(std::size_t first, std::size_t end) const noexcept;

  private:
    enum class Kind : std::uint32_t { withNormal = 0, without = 1, alone = 2 };
    struct Entry {
        std::uint32_t key, point;  // kind, then place
        [[nodiscard]] Kind kind() const noexcept { return Kind(key >> 30); }
    };
    std::vector<Entry> sorted_;
    std::uint32_t together_;  // bits of a key that those of a block have in common
};

}  // namespace mtsm::shadow
