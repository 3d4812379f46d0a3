// query.h - one shading point made ready for its rays.
#pragma once
#include <glm/vec3.hpp>

#include "base/sampling.h"
#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "trace/traverse.h"

namespace mtsm::shadow {

// The receiver's own surface, told from its blockers in two ways. The numbers are
// measured (tests/bench/NOTES.md): lower ones leave acne, higher ones lose contact
// shadows.
/// With a normal: layers that lie no higher than this above the tangent plane are the
/// receiver's own. In pixel footprints at the layer's depth.
inline constexpr double kPlaneHeight = 0.3;
/// Without: rays start this many biases from the receiver.
inline constexpr double kStartBiases = 5.0;

/// What a map's layers are thickened by, unless the query says otherwise (`asked` >= 0).
[[nodiscard]] trace::ZBias biasOf(const ShadowMap& map, float asked) noexcept;
/// A threshold that queries accept, whatever was asked for.
[[nodiscard]] double thresholdOf(float asked) noexcept;

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
        glm::dvec3 point;
        bool hasNormal = false;
        trace::ReceiverPlane plane;  // if hasNormal
        double bias = 0.0;           // at the receiver's depth
    };
    [[nodiscard]] float blocked(const Receiver& receiver, std::uint64_t key,
                                QueryStats& stats) const noexcept;
    [[nodiscard]] float traced(const Receiver& receiver,
                               const light::LightSample& sample) const noexcept;
    [[nodiscard]] float filtered(const Receiver& receiver,
                                 const light::LightSample& sample) const noexcept;
    [[nodiscard]] trace::TraceOptions traceOptions(
        const Receiver& receiver) const noexcept;
    [[nodiscard]] bool mayBeTruncated(glm::dvec3 point) const noexcept;

    const ShadowMap& map_;
    light::LightSampler light_;
    ShadowOptions options_;
    trace::ZBias bias_;
    std::uint32_t samples_ = 1;
};

/// The mean of the channels that the map has.
[[nodiscard]] float mean(const trace::ChannelVisibility& v,
                         std::uint32_t channels) noexcept;

}  // namespace mtsm::shadow
