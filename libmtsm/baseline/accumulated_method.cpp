// Accumulated hard shadow maps: the mean over a shadow map [Williams78] from each of many
// points of the light, "around 1000" in [Xie07, sec. 3], where it is the first of the two
// reference methods.
//
// The points of the light are the same all over the picture, stratified over its area. At
// each the casters are baked, all points of the picture are looked up in the nearest
// pixel (depth_lookup.h), and the map is dropped: opaque casters into one layer, others
// into a map that lets light through. So a build holds the casters, decoded, and nearly
// all of the time, every bake but one, is the query's; a map of a view is held at a time.
//
// Of a sphere, a receiver sees the points of the cap that faces it: others are left out
// of its mean. Points below a receiver's horizon count as blocked.
#include <algorithm>
#include <glm/geometric.hpp>

#include "base/parallel.h"
#include "base/sampling.h"
#include "baseline/depth_lookup.h"
#include "baseline/depth_map.h"
#include "baseline/held_casters.h"
#include "baseline/light_mean.h"
#include "baseline/light_views.h"
#include "baseline/methods.h"

namespace mtsm::baseline {
namespace {

constexpr std::size_t kPointsPerTask = 1024;
/// Any key will do: one set of points for all receivers.
constexpr std::uint64_t kKey = 0x6c69676874ull;

/// What the views so far have said of a receiver.
struct Sum {
    double visible = 0.0;
    std::uint32_t views = 0;
};

/// One point of the light, as receivers see it.
class LightPoint {
  public:
    LightPoint(const AreaLight& light, const AreaLight& view)
        : light_(light), view_(view), endless_(light.shape == LightShape::sun) {}

    [[nodiscard]] glm::dvec3 towards(glm::dvec3 p) const {
        return endless_ ? -view_.direction : view_.position - p;
    }
    /// Is it not hidden by the light itself?
    [[nodiscard]] bool faces(glm::dvec3 p) const {
        if (light_.shape != LightShape::sphere) return true;
        const glm::dvec3 toPoint = p - light_.position;
        const double r2 = light_.radius * light_.radius;
        return glm::dot(toPoint, toPoint) <= r2 ||
               glm::dot(toPoint, view_.position - light_.position) >= r2;
    }

  private:
    const AreaLight& light_;
    const AreaLight& view_;
    bool endless_;
};

class AccumulatedMethod final : public Method {
  public:
    AccumulatedMethod(HeldCasters casters, BakeOptions options, std::uint64_t mapBytes)
        : casters_(std::make_unique<HeldCasters>(std::move(casters))),
          options_(std::move(options)),
          mapBytes_(mapBytes) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return casters_->bytes() + mapBytes_;
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        if (Status fits = lightFits(light, options_.light); !fits) return fits;
        BakeOptions aimed = options_;
        aimed.light = light;
        // Of lights that shine to all sides it says where the views look.
        if (light.shape == LightShape::point || light.shape == LightShape::sphere)
            aimed.light.direction = options_.light.direction;
        const light::LightSampler sampler(light);
        const std::uint32_t samples =
            sampler.isPoint() ? 1u : std::uint32_t(settings.whole("samples"));
        const base::SquareSequence sequence(kKey);
        std::vector<Sum> sums(at.count);
        for (std::uint32_t i = 0; i < samples; ++i) {
            const BakeOptions view =
                viewFrom(aimed, sampler.isPoint() ? glm::dvec2(0.5) : sequence(i));
            if (Status s = addView(view, light, at, sums); !s) return s;
        }
        for (std::size_t i = 0; i < at.count; ++i) {
            const bool shines =
                base::isFinite(at.points[i]) && !sampler.isBehind(at.points[i]);
            out[i] =
                shines && sums[i].views > 0
                    ? float(std::clamp(1.0 - sums[i].visible / sums[i].views, 0.0, 1.0))
                    : 0.0f;
        }
        return {};
    }

  private:
    Status addView(const BakeOptions& view, const AreaLight& light, const Receivers& at,
                   std::vector<Sum>& sums) const {
        const LightPoint lightPoint(light, view.light);
        const auto sees = [&](std::size_t i) {
            return base::isFinite(at.points[i]) && lightPoint.faces(at.points[i]);
        };
        bool any = false;
        for (std::size_t i = 0; i < at.count && !any; ++i)
            any = sees(i);
        if (!any) return {};
        auto baked = bake(*casters_, view);
        if (!baked) return baked.error();
        const DepthLookup lookup(baked->map);
        const auto add = [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                if (!sees(i)) continue;
                ++sums[i].views;
                const glm::dvec3 point = at.points[i], normal = normalOf(at, i);
                const bool below = normal != glm::dvec3(0.0) &&
                                   !(glm::dot(lightPoint.towards(point), normal) > 0.0);
                if (below) continue;
                sums[i].visible += double(lookup.visibility(LookupReceiver(point, normal),
                                                            lookup.placeOf(point)));
            }
        };
        base::parallelRanges(std::size_t(0), at.count, kPointsPerTask, add);
        return {};
    }

    std::unique_ptr<HeldCasters> casters_;  // visiting is not const
    BakeOptions options_;                   // aimed, for the whole light
    std::uint64_t mapBytes_;                // of the view from the centre
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    auto casters = HeldCasters::copy(scene.casters);
    if (!casters) return casters.error();
    auto options = aimedOptions(*casters, scene.bake);
    if (!options) return options.error();
    setResolutionAndBias(*options, settings);
    options->tolerance = float(settings.number("tolerance"));
    options->keepHidden = true;  // seen from one point, nothing behind opaque counts
    options->progress = nullptr;
    if (casters->opaque()) options->layers = 1;
    auto centre = bake(*casters, viewAcross(*options, glm::dvec2(0.5)));
    if (!centre) return centre.error();
    return std::unique_ptr<Method>(new AccumulatedMethod(
        *std::move(casters), *std::move(options), centre->map.memoryBytes()));
}

}  // namespace

MethodInfo accumulatedMethod() {
    MethodInfo info;
    info.name = "accumulated";
    info.title = "accumulated hard shadow maps";
    info.source = "[Xie07, sec. 3], [Williams78]";
    info.fixedCost = true;
    info.settings = {
        wholeSetting("resolution", 1024, 1, kMaxResolution, "pixels per side of each map",
                     SettingUse::build),
        numberSetting("tolerance", 0.005, 0.0, 1.0,
                      "error that compression may bring, where casters let light through",
                      SettingUse::build),
        numberSetting("bias", -1.0, -1.0, 1e9,
                      "z threshold of the maps, world units; -1: a pixel's footprint. "
                      "Without a normal, lookups start five away",
                      SettingUse::build),
        wholeSetting("samples", 1024, 1, kMaxSamples, "points of the light, a map each"),
    };
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
