// bundle_query.h - shadow factors of many points at once: neighbours share the way of
// their rays through a map's trees.
//
// A point's answer does not depend on which others are asked with it.
#pragma once
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "shadow/light_outline.h"
#include "shadow/light_rays.h"
#include "shadow/query.h"
#include "shadow/receiver_places.h"
#include "shadow/sample_error.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {

class BundleQuery {
  public:
    /// Can it answer such queries at all?
    [[nodiscard]] static bool serves(const ShadowMap& map,
                                     const ShadowOptions& options) noexcept;

    /// `only`: nothing else will be asked for.
    /// `errors`: answers come with their expected error.
    BundleQuery(const ShadowMap& map, const AreaLight& light,
                const ShadowOptions& options, bool errors,
                const Receiver* only = nullptr);

    [[nodiscard]] const ReceiverPlaces& places() const noexcept { return places_; }

    /// What can be told of receivers without their rays.
    enum class Glance : std::uint8_t { unknown, lit, dark };
    static constexpr int kMostGlances = 256;
    /// Of 1 to kMostGlances receivers, better if they are neighbours; counts the rays
    /// that they would take. What it tells is what the rays would.
    void glance(const Receiver* receivers, int count, Glance* told,
                QueryStats& stats) const noexcept;

    /// What is known of a receiver.
    struct Sums {
        glm::vec3 visible{0.0f};          ///< [channel]
        float total = 0.0f;               ///< of the weights
        float least = 1.0f, most = 0.0f;  ///< visibilities of its rays
        bool above = false;               ///< has it rays above its horizon?
        Seen seen;                        ///< if errors matter
    };
    /// Steps in which a query takes its rays.
    [[nodiscard]] int steps() const noexcept { return steps_.count; }
    /// Adds what the rays of a step see of 1 to 16 receivers; counts rays.
    void look(const Receiver* receivers, int count, int step, Sums* sums,
              QueryStats& stats) const noexcept;
    /// Does a receiver need no further step?
    [[nodiscard]] bool isEnough(const Sums& sums, int step) const noexcept;
    /// The shadow factors, and their expected error if it was asked for.
    [[nodiscard]] Answer answerOf(const Sums& sums, int step) const noexcept;
    /// The same for what a glance told.
    [[nodiscard]] Answer answerOf(Glance told) const noexcept;

  private:
    void findLit(Outlook* outlooks, int count, Glance* told) const noexcept;
    [[nodiscard]] bool isFree(const Outlook& starts) const noexcept;
    [[nodiscard]] std::uint32_t keyOf(const Receiver& receiver) const noexcept;
    [[nodiscard]] glm::dvec3 turned(glm::dvec3 direction) const noexcept {
        return turn_ * direction;
    }
    void setLane(const Receiver& receiver, int lane, ReceiverLanes& lanes) const noexcept;

    void follow(trace::RayBundle& bundle, const RayFates& fates,
                const std::uint16_t* valid, bool weights, Sums* sums) const noexcept;
    [[nodiscard]] glm::vec3 visibleOf(const Sums& sums, int step) const noexcept;
    [[nodiscard]] float errorOf(const Sums& sums, int step) const noexcept;
    void traceNear(trace::RayBundle& bundle, const RayFates& fates) const noexcept;

    const ShadowMap& map_;
    const Projection& projection_;
    glm::dmat3 turn_;  // world to light space
    light::LightSampler light_;
    LightOutline outline_;
    ReceiverPlaces places_;
    ShadowOptions options_;
    trace::ZBias bias_;
    const trace::PatchTree* patches_;    // of an opaque map
    const trace::DensityTree* density_;  // of any other
    bool media_;
    std::uint32_t samples_;
    SampleSteps steps_;
    bool errors_;  // do they matter?
    std::optional<LightRays> withNormals_, without_;
    // Axes of the light in light space, if they are the same for all points.
    bool fixedAxes_;
    glm::dvec3 centre_, axisX_, axisY_, axisZ_, base_;
    double capHeight_;
    float nearHeight_;  // RayBundle's measure of a plane's height
};

}  // namespace mtsm::shadow
