// Multi-view shadow maps, ray traced [Agrawala00]: depth maps of one layer from the
// light's centre and from points of its rim, each ray tested view by view until one
// blocks it [Xie07, sec. 4.1].
//
// A ray is blocked if in any view it meets what is nearest there in its pixel (within the
// z threshold, traced as rays through any map are). So a ray leaks if all that it crosses
// lies, in each of the views, behind something else: surfaces that some inner point of
// the light sees, past or between others, and no view does. And what is too dark in one
// view, a receiver's own surface or the thickened rim of a strand, is too dark in all.
//
// Rays of a point start with the view that blocked the last one: most blocked rays then
// need a single view [Agrawala00 has such coherence, too]. The answer is the same in any
// order.
#include <array>
#include <cmath>
#include <string>

#include "base/parallel.h"
#include "baseline/depth_map.h"
#include "baseline/light_mean.h"
#include "baseline/light_views.h"
#include "baseline/methods.h"
#include "mtsm/shadow.h"
#include "shadow/query.h"
#include "trace/traverse.h"

namespace mtsm::baseline {
namespace {

/// Centre, corners, middles of the edges. (On a disk, all but the first are on the rim.)
constexpr std::array<std::array<double, 2>, 9> kViews = {{{0.5, 0.5},
                                                          {0.0, 0.0},
                                                          {1.0, 0.0},
                                                          {1.0, 1.0},
                                                          {0.0, 1.0},
                                                          {0.5, 0.0},
                                                          {1.0, 0.5},
                                                          {0.5, 1.0},
                                                          {0.0, 0.5}}};
constexpr std::size_t kPointsPerTask = 256;

/// Rays from one point through all views.
class Rays {
  public:
    Rays(const std::vector<ShadowMap>& views, const std::vector<trace::ZBias>& biases,
         glm::dvec3 point, glm::dvec3 normal)
        : views_(views), biases_(biases), plane_{point, normal, shadow::kPlaneHeight} {
        ray_.origin = point;
        hasNormal_ = normal != glm::dvec3(0.0);
        if (hasNormal_) options_.plane = &plane_;
    }
    Rays(const Rays&) = delete;  // options_ points into it

    [[nodiscard]] bool blocked(const light::LightSample& sample) {
        ray_.delta = sample.delta;
        ray_.tEnd = sample.endless ? HUGE_VAL : 1.0;
        for (std::size_t i = 0; i < views_.size(); ++i) {
            const std::size_t view = (last_ + i) % views_.size();
            if (!blockedIn(views_[view], biases_[view])) continue;
            last_ = view;
            return true;
        }
        return false;
    }

  private:
    /// As shadow/shadow.cpp traces a ray.
    [[nodiscard]] bool blockedIn(const ShadowMap& view, const trace::ZBias& bias) {
        options_.bias = bias;
        if (!hasNormal_) {
            const double length = glm::length(ray_.delta);
            if (!(length > 0.0)) return false;
            const Projection& p = view.projection(trace::faceOf(view, ray_.origin));
            const double z = glm::dot(p.forward, ray_.origin - p.eye);
            ray_.tBegin = ray_.tSurfaces =
                shadow::kStartBiases * options_.bias.at(z) / length;
        }
        return trace::traceRay(view, ray_, options_)[0] == 0.0f;
    }

    const std::vector<ShadowMap>& views_;
    const std::vector<trace::ZBias>& biases_;  // [views]
    trace::ReceiverPlane plane_;
    bool hasNormal_ = false;
    trace::Ray ray_;
    trace::TraceOptions options_;
    std::size_t last_ = 0;
};

class MvsmMethod final : public Method {
  public:
    MvsmMethod(std::vector<ShadowMap> views, const AreaLight& light)
        : views_(std::move(views)), light_(light) {
        for (const ShadowMap& view : views_)
            biases_.push_back(shadow::biasOf(view, -1.0f));
    }

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        std::uint64_t bytes = 0;
        for (const ShadowMap& view : views_)
            bytes += view.memoryBytes();
        return bytes;
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        if (Status fits = lightFits(light, light_); !fits) return fits;
        const light::LightSampler sampler(light);
        const int samples = settings.whole("samples");
        base::parallelRanges(std::size_t(0), at.count, kPointsPerTask,
                             [&](std::size_t begin, std::size_t end) {
                                 for (std::size_t i = begin; i < end; ++i) {
                                     const glm::dvec3 normal = normalOf(at, i);
                                     Rays rays(views_, biases_, at.points[i], normal);
                                     out[i] = shadowFactorOf(
                                         sampler, at.points[i], normal, samples,
                                         [&](const light::LightSample& sample) {
                                             return rays.blocked(sample) ? 0.0f : 1.0f;
                                         });
                                 }
                             });
        return {};
    }

  private:
    std::vector<ShadowMap> views_;
    std::vector<trace::ZBias> biases_;  // [views]
    AreaLight light_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    auto options = aimedOptions(scene.casters, scene.bake);
    if (!options) return options.error();
    setResolutionAndBias(*options, settings);
    const bool isPoint = light::LightSampler(options->light).isPoint();
    const std::size_t count = isPoint ? 1 : std::stoul(settings.word("views"));
    std::vector<ShadowMap> views;
    for (std::size_t i = 0; i < count; ++i) {
        auto view = bakeDepthMap(scene.casters,
                                 viewAcross(*options, {kViews[i][0], kViews[i][1]}), 1);
        if (!view) return view.error();
        views.push_back(*std::move(view));
    }
    return std::unique_ptr<Method>(new MvsmMethod(std::move(views), options->light));
}

}  // namespace

MethodInfo mvsmMethod() {
    MethodInfo info;
    info.name = "mvsm";
    info.title = "multi-view shadow maps, ray traced";
    info.source = "[Agrawala00]";
    info.volumes = false;
    info.settings = {
        wholeSetting("resolution", 1024, 1, kMaxResolution, "pixels per side of a view",
                     SettingUse::build),
        wordSetting("views", {"5", "1", "9"},
                    "the centre; and four corners; and the edges' middles",
                    SettingUse::build),
        numberSetting("bias", -1.0, -1.0, 1e9,
                      "z threshold, world units; -1: a pixel's footprint",
                      SettingUse::build),
        wholeSetting("samples", 256, 1, kMaxSamples, "rays per point"),
    };
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
