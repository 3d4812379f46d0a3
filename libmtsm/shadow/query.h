// query.h - one shading point made ready for its rays.
#pragma once
#include <glm/vec3.hpp>
#include <optional>

#include "base/finite.h"
#include "base/sampling.h"
#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "shadow/ray_query.h"
#include "shadow/sample_error.h"
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
/// The same for layers of media, which have no bias, in pixel footprints at the receiver.
/// Prototypes had the least error on hair between 0.3 (thin strands) and 1 (layers of
/// several samples), and light that leaked beyond. A map may ask for less: in one of
/// volumes alone nothing is the receiver's own.
inline constexpr double kMediaStart = 1.0;
/// What the map's attribute "mediaStart" says, if it is one number from 0 to kMediaStart.
[[nodiscard]] double mediaStartOf(const ShadowMap& map) noexcept;

/// What a map's layers are thickened by, unless the query says otherwise (`asked` >= 0).
[[nodiscard]] trace::ZBias biasOf(const ShadowMap& map, float asked) noexcept;
/// A threshold that queries accept, whatever was asked for.
[[nodiscard]] double thresholdOf(float asked) noexcept;

/// What is found out about a point.
struct Answer {
    glm::vec3 factors{0.0f};  ///< shadow factors of the channels
    float error = 0.0f;       ///< expected |found - true| of their mean, if asked for
};

/// Whatever stays the same for all points of a series of queries.
class Query {
  public:
    /// `errors`: answers come with their expected error.
    Query(const ShadowMap& map, const AreaLight& light, const ShadowOptions& options,
          bool errors) noexcept;

    /// Is there anything to be found out about the point? It is finite and in front of
    /// the light.
    [[nodiscard]] bool isShadowed(glm::dvec3 point) const noexcept {
        return base::isFinite(point) && !light_.isBehind(point);
    }
    /// Counts a point of which that is true.
    void count(glm::dvec3 point, QueryStats& stats) const noexcept;

    /// Shadow factors at a point, number i of its batch; adds to `stats`.
    [[nodiscard]] Answer shadowFactor(std::size_t i, glm::dvec3 point, glm::dvec3 normal,
                                      QueryStats& stats) const noexcept;

  private:
    struct Receiver {
        glm::dvec3 point;
        bool hasNormal = false;
        trace::ReceiverPlane plane;  // if hasNormal
        std::uint32_t face = 0;      // that it belongs to
        // How far from it surfaces begin to count (without a normal), and media.
        double surfaceStart = 0.0, mediaStart = 0.0;
    };
    /// A place on the map: the raster position, and the depth in that face.
    struct Lookup {
        std::uint32_t face = 0;
        glm::dvec2 raster{-1.0};
        double z = 0.0;
    };
    [[nodiscard]] Receiver receiverAt(glm::dvec3 point, glm::dvec3 normal) const noexcept;
    [[nodiscard]] Answer blocked(const Receiver& receiver, std::uint64_t key,
                                 std::uint32_t firstSample,
                                 QueryStats& stats) const noexcept;
    /// By the place of its sample.
    struct SeenSample {
        std::uint32_t place;
        float visibility;
    };
    [[nodiscard]] float errorOf(SeenSample* seen, std::uint32_t samples) const noexcept;
    [[nodiscard]] trace::ChannelVisibility traced(
        const Receiver& receiver, const light::LightSample& sample) const noexcept;
    [[nodiscard]] trace::ChannelVisibility tracedWithoutLayers(
        const Receiver& receiver, const light::LightSample& sample) const noexcept;
    [[nodiscard]] trace::ChannelVisibility filtered(
        const Receiver& receiver, const light::LightSample& sample) const noexcept;
    [[nodiscard]] Lookup lookupOnFace(const Receiver& receiver,
                                      const light::LightSample& sample) const noexcept;
    [[nodiscard]] Lookup lookupOnFaces(const Receiver& receiver,
                                       const light::LightSample& sample) const noexcept;
    [[nodiscard]] trace::TraceOptions traceOptions(
        const Receiver& receiver) const noexcept;
    [[nodiscard]] bool mayBeTruncated(glm::dvec3 point) const noexcept;

    const ShadowMap& map_;
    light::LightSampler light_;
    ShadowOptions options_;
    trace::ZBias bias_;
    bool media_;         // does the map hold media?
    double mediaStart_;  // footprints
    bool errors_;        // do answers have them?
    SampleSteps steps_;
    std::optional<RayQuery> rays_;  // through the trees of a map without layers
};

/// Of finite place, direction and length above 0; all others are clear.
[[nodiscard]] inline bool isRay(const ShadowRay& ray) noexcept {
    return base::isFinite(ray.origin) && base::isFinite(ray.direction) &&
           ray.length > 0.0;
}
/// The visibilities left to a ray, as trace/traverse.h defines them.
[[nodiscard]] glm::vec3 visibilityByDefinition(const ShadowMap& map, const ShadowRay& ray,
                                               const RayOptions& options) noexcept;

/// Is it finite and not zero?
[[nodiscard]] inline bool saysSomething(glm::dvec3 normal) noexcept {
    return base::isFinite(normal) && normal != glm::dvec3(0.0);
}
/// Of a normal of any length; zero if it says nothing.
[[nodiscard]] glm::dvec3 unitNormal(glm::dvec3 normal) noexcept;

/// The mean of the channels that the map has.
template <typename Channels>
[[nodiscard]] float mean(const Channels& v, std::uint32_t channels) noexcept {
    return channels == 3 ? (v[0] + v[1] + v[2]) / 3.0f : v[0];
}

}  // namespace mtsm::shadow
