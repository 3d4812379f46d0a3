// bundle_query.h - shadow factors of many points of an opaque map at once: neighbours
// share the way of their rays through the patch tree.
//
// A point's answer does not depend on which others are asked with it.
#pragma once
#include <glm/vec3.hpp>
#include <optional>

#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "shadow/light_rays.h"
#include "shadow/query.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {

class BundleQuery {
  public:
    /// Can it answer such queries at all?
    [[nodiscard]] static bool serves(const ShadowMap& map,
                                     const ShadowOptions& options) noexcept;

    struct Receiver {
        glm::dvec3 point{0.0};
        glm::dvec3 normal{0.0};  ///< unit; zero: none, for all of a call or for none
    };
    /// `only`: nothing else will be asked for.
    BundleQuery(const ShadowMap& map, const AreaLight& light,
                const ShadowOptions& options, const Receiver* only = nullptr);

    /// Points that are finite and not behind the light: can it answer this one? Far
    /// outside the view rays in float are too coarse.
    [[nodiscard]] bool takes(glm::dvec3 point) const noexcept;

    /// A number that is close for points whose rays take much the same way, < 2^30.
    [[nodiscard]] std::uint32_t placeOf(glm::dvec3 point) const noexcept;

    /// Shadow factors of 1 to 16 receivers; counts rays.
    void shadowFactors(const Receiver* receivers, int count, float* out,
                       QueryStats& stats) const noexcept;

  private:
    [[nodiscard]] std::uint32_t keyOf(const Receiver& receiver) const noexcept;
    void setLane(const Receiver& receiver, int lane, ReceiverLanes& lanes) const noexcept;

    void traceNear(trace::RayBundle& bundle, const RayFates& fates) const noexcept;

    const ShadowMap& map_;
    const Projection& projection_;
    light::LightSampler light_;
    ShadowOptions options_;
    trace::ZBias bias_;
    const trace::PatchTree& tree_;
    std::uint32_t samples_;
    std::optional<LightRays> withNormals_, without_;
    // Axes of the light in light space, if they are the same for all points.
    bool fixedAxes_;
    glm::dvec3 centre_, axisX_, axisY_, axisZ_, base_;
    double capHeight_;
    float nearHeight_;  // RayBundle's measure of a plane's height
};

}  // namespace mtsm::shadow
