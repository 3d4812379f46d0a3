// bundle_query.h - shadow factors of many points at once: neighbours share the way of
// their rays through a map's trees.
//
// Six faces. Most points have all of their rays in the face that they belong to, until
// these are nearer to the light than any caster. Of the others the rays are followed
// through every face that they may meet something in. Surfaces of a face lie in its
// window, so rays need not be cut where they leave it: what is met twice at a border is
// blocked once. Where casters are as near as the light is wide rays may end in faces that
// their points are behind: there they are followed one by one. What lets light through is
// paid for each time: there a ray is cut into the parts of the definition
// (trace/traverse.h), by the same numbers in both faces.
//
// A point's answer does not depend on which others are asked with it.
#pragma once
#include <algorithm>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "light/sample.h"
#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "shadow/light_outline.h"
#include "shadow/light_rays.h"
#include "shadow/pixel_share.h"
#include "shadow/query.h"
#include "shadow/ray_query.h"
#include "shadow/receiver_places.h"
#include "shadow/sample_error.h"
#include "trace/density_trace.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {

class BundleQuery {
  public:
    /// Can it answer such queries at all? Makes the map's trees.
    [[nodiscard]] static bool serves(const ShadowMap& map, const AreaLight& light,
                                     const ShadowOptions& options);

    /// `only`: nothing else will be asked for; its number in the batch.
    /// `errors`: answers come with their expected error.
    BundleQuery(const ShadowMap& map, const AreaLight& light,
                const ShadowOptions& options, bool errors, const Receiver* only = nullptr,
                std::size_t onlyNumber = 0);

    /// Of 1 to ReceiverPlaces::kAtOnce points numbers as ReceiverPlaces has them.
    void findPlaces(const glm::dvec3* points, int count,
                    std::uint32_t* places) const noexcept;
    /// Bits of a place that those of one call of glance() or look() must have in common.
    [[nodiscard]] std::uint32_t together() const noexcept {
        return faces_.size() > 1 ? kFaceBits : 0u;
    }
    /// The face that a point belongs to.
    [[nodiscard]] std::uint32_t faceOf(glm::dvec3 point) const noexcept {
        return faces_.size() > 1 ? trace::faceOf(map_, point) : 0u;
    }

    /// Sets Receiver::pattern of some points of the batch, whose numbers are first +
    /// points[0..count): best if those of a pixel follow each other.
    void setPatterns(std::size_t first, const std::size_t* points, std::size_t count,
                     Receiver* receivers) const noexcept;

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
    /// Adds what the rays of a step see of 1 to 16 receivers of one face; counts rays.
    void look(const Receiver* receivers, int count, int step, Sums* sums,
              QueryStats& stats) const noexcept;
    /// Does a receiver need no further step?
    [[nodiscard]] bool isEnough(const Sums& sums, int step) const noexcept;
    /// The shadow factors, and their expected error if it was asked for.
    [[nodiscard]] Answer answerOf(const Sums& sums, int step) const noexcept {
        if (!isPlain_) return answerOfAny(sums, step);
        const float visible = sums.visible.x / float(steps_.end[step]);
        return {glm::vec3(1.0f - std::clamp(visible, 0.0f, 1.0f)), 0.0f};
    }
    /// The same for what a glance told.
    [[nodiscard]] Answer answerOf(Glance told) const noexcept;

  private:
    static constexpr std::uint32_t kFaceBits = 15u << 26;  // and if others are met

    /// A face as the rays of the light go through it.
    struct Face {
        Face(const ShadowMap& map, std::uint32_t number, ZRange depths,
             const light::LightSampler& light);

        const Projection& projection;
        glm::dmat3 turn;  ///< world to light space
        ZRange depths;    ///< that rays are followed to
        ReceiverPlaces places;
        LightOutline outline;
        float nearHeight;  ///< RayBundle's measure of a plane's height
        const NearField& nearField;
        const NearHair& nearHair;
        const NearSheets& nearSheets;
        /// Is all that is close to receivers in them? Strands of several faces are not
        /// asked for.
        bool near;
        double nearMost;  ///< depth that triangles or strands answer for, footprints
        Neighbours neighbours;
        const trace::PatchTree* patches = nullptr;    ///< of an opaque map
        const trace::DensityTree* density = nullptr;  ///< of any other
        std::optional<LightRays> withNormals, without;
        /// Axes of the light in light space, if they are the same for all points.
        glm::dvec3 centre{0.0}, axisX, axisY, axisZ, base;
        // Of several:
        bool empty;
        double nearest;                      ///< depth in front of which there is nothing
        double lightLow = 0, lightHigh = 0;  ///< depths of the light
    };
    /// Rays on their way: those of one face as a bundle, and what becomes of them.
    struct Rays {
        trace::RayBundle bundle;
        RayFates fates;
        /// [row]: rays whose depths count.
        std::uint16_t followed[trace::kMostMediaRows];
        trace::RayDepths depths;
    };

    void lookAtOnce(const Receiver* receivers, int count, int step, Sums* sums,
                    QueryStats& stats) const noexcept;
    void findLit(const Face& face, Outlook* outlooks, int count,
                 Glance* told) const noexcept;
    [[nodiscard]] bool isFree(const Face& face, const Outlook& starts) const noexcept;
    void addRays(Face& face, bool normals, std::optional<std::uint32_t> onlyPattern);
    [[nodiscard]] std::uint32_t keyOf(glm::dvec3 point) const noexcept;
    [[nodiscard]] std::uint32_t facesMet(std::uint32_t home,
                                         glm::dvec3 point) const noexcept;
    [[nodiscard]] ReceiverLanes lanesOf(const Face& face, const Receiver* receivers,
                                        int count) const noexcept;

    void followBeyond(std::uint32_t home, const Receiver* receivers, int count,
                      const std::uint32_t* met, int firstGroup,
                      Rays& rays) const noexcept;
    void alongFaces(glm::dvec3 way, double (&depths)[6]) const noexcept;
    [[nodiscard]] bool leadsToEye(const Face& face, glm::dvec3 point) const noexcept;
    void followSingly(std::uint32_t home, std::uint32_t number, const Receiver& receiver,
                      int homeReceiver, Rays& rays) const noexcept;
    void cut(std::uint32_t home, std::uint32_t number, const Receiver& receiver,
             const RayFates& homeFates, int homeRow, int row, Rays& rays) const noexcept;
    void follow(const Face& face, Rays& rays) const noexcept;
    [[nodiscard]] trace::DensityTraceOptions densityOptions() const noexcept;
    [[nodiscard]] glm::vec3 visibleOf(const Sums& sums, int step) const noexcept;
    [[nodiscard]] float errorOf(const Sums& sums, int step) const noexcept;
    [[nodiscard]] Answer answerOfAny(const Sums& sums, int step) const noexcept;
    void traceNear(const Face& face, Rays& rays) const noexcept;
    void traceSheets(const Face& face, Rays& rays) const noexcept;
    void addUp(Rays& rays, const std::uint16_t* valid, bool weights,
               Sums* sums) const noexcept;

    const ShadowMap& map_;
    light::LightSampler light_;
    ShadowOptions options_;
    trace::ZBias bias_;
    bool opaque_, media_;
    double mediaStart_;
    std::uint32_t samples_;
    SampleSteps steps_;
    std::uint32_t patterns_;
    bool errors_;     // do they matter?
    bool isPlain_;    // one channel, neither weights nor errors
    bool fixedAxes_;  // are the light's axes the same for all points?
    double capHeight_;
    std::vector<Face> faces_;
    std::optional<RayQuery> singly_;  // rays in faces that they lead away from the eye of
};

}  // namespace mtsm::shadow
