// query.h - one shading point made ready for its rays.
#pragma once
#include <glm/vec3.hpp>

#include "base/sampling.h"
#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "trace/traverse.h"

namespace mtsm::shadow {

// The receiver's own surface, told from its blockers in two ways. Both numbers are
// measured (tests/bench/NOTES.md): lower ones leave acne, higher ones lose contact
// shadows.
/// With a normal: layers that lie no higher than this above the tangent plane are the
/// receiver's own. In pixel footprints at the receiver's depth.
inline constexpr double kPlaneHeight = 0.3;
/// Without: rays start this many biases from the receiver.
inline constexpr double kStartBiases = 5.0;

/// Whatever stays the same for all points of a series of queries.
class Query {
  public:
    Query(const ShadowMap& map, const AreaLight& light,
          const ShadowOptions& options) noexcept;

    /// Shadow factor at a point; adds to `stats`.
    [[nodiscard]] float shadowFactor(glm::dvec3 point, glm::dvec3 normal,
                                     QueryStats& stats) const noexcept;

  private:
    struct Receiver {
        glm::dvec3 point;   // relative to the eye
        glm::dvec3 normal;  // unit, if hasNormal
        bool hasNormal = false;
        trace::ReceiverPlane plane;
    };
    [[nodiscard]] float blocked(const Receiver& receiver, std::uint64_t key,
                                QueryStats& stats) const noexcept;
    [[nodiscard]] float traced(const Receiver& receiver,
                               const light::LightSample& sample) const noexcept;
    [[nodiscard]] float filtered(const Receiver& receiver,
                                 const light::LightSample& sample) const noexcept;
    [[nodiscard]] bool mayBeTruncated(glm::dvec3 point) const noexcept;

    const ShadowMap& map_;
    light::LightSampler light_;
    ShadowOptions options_;
    double bias_ = 0.0;
    std::uint32_t samples_ = 1;
};

/// The mean of the channels that the map has.
[[nodiscard]] float mean(const trace::ChannelVisibility& v,
                         std::uint32_t channels) noexcept;

}  // namespace mtsm::shadow
