// Soft shadows by percentage-closer filtering [Xie07, sec. 3], of depth maps of one layer
// or several and of maps that let light through (deep shadow maps [Lokovic00]).
//
// A point's place on the map is blurred: lookups (depth_lookup.h) are taken all over a
// filter, and the shadow factor is the mean of what they find in front of the point. How
// large the filter is:
//     zmin     as the rays to the light spread until they reach the smallest depth of the
//              whole map: resolution * light_radius * (1 / z_min - 1 / z) (eq. 1)
//     blocker  the same with the mean depth of the blockers that a first pass finds
//              within the filter of zmin [Fernando05]; nothing found: lit
// The map is that of the light's centre, without push-back: from anywhere else the filter
// would lie in the wrong place.
//
// The light has a shape, and may be a sun: so each lookup stands for a point of the
// light, and lies as far from the filter's centre as the rays to that point and to the
// light's centre are apart at the chosen depth, which for a flat light is eq. 1. That
// pairing is what a horizon needs: filtering alone cannot know which part of the light a
// tilted receiver does not see, but a lookup whose point of the light is below the
// receiver's horizon counts as blocked, without being made.
//
// Several layers [Bavoil06]: a lookup is blocked if any layer lies in front, which is the
// first one's to say; the others serve the slope bias (depth_lookup.h) and are blockers
// of the first pass, all of those that lie in front. On a map that lets light through the
// depths of the first pass are weighted by the visibility that is lost there.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>

#include "base/parallel.h"
#include "baseline/depth_lookup.h"
#include "baseline/depth_map.h"
#include "baseline/light_mean.h"
#include "baseline/light_views.h"
#include "baseline/methods.h"

namespace mtsm::baseline {
namespace {

constexpr std::size_t kPointsPerTask = 256;

/// The filter around one point.
class Filter {
  public:
    Filter(const DepthLookup& lookup, const light::LightSampler& light, glm::dvec3 point,
           glm::dvec3 normal)
        : lookup_(lookup),
          map_(lookup.map()),
          point_(point),
          receiver_(point, normal),
          towards_(light.towards(point)),
          face_(trace::faceOf(map_, point)) {
        const Projection& p = map_.projection(face_);
        inLight_ = p.lightFromWorld(point);
        axis_ = p.lightFromWorldDirection(towards_);
        if (inLight_.z > 0.0) raster_ = p.rasterFromLight(inLight_);
        for (std::uint32_t f = 0; f < map_.faceCount(); ++f)
            zMin_ = std::min(zMin_, double(map_.zRange(f).min));
    }

    /// How large the filter is for blockers at one depth.
    struct Size {
        bool inFront = false;   // can a blocker there be in front of the point?
        double z = 0.0;         // the depth
        glm::dvec2 shift{0.0};  // one face: the point's place less the centre ray's at z
        double spread = 0.0;    // six faces: the filter's size over the light's
    };
    [[nodiscard]] Size sizeFor(double z) const {
        Size size{inLight_.z > z, z, {}, inLight_.z / z - 1.0};
        if (map_.faceCount() > 1) return size;
        size.inFront = size.inFront && axis_.z < 0.0;
        if (size.inFront) size.shift = raster_ - passes(axis_, z);
        return size;
    }

    /// Of the first pass; nothing: nothing is in front.
    [[nodiscard]] std::optional<double> meanBlocker(const PointsOnLight& points,
                                                    std::uint32_t count) const {
        BlockerSum sum;
        const Size size = sizeFor(zMin_);
        for (std::uint32_t i = 0; i < count; ++i) {
            if (const auto at = place(points(i), size))
                lookup_.addBlockers(receiver_, *at, sum);
        }
        if (!(sum.weight > 0.0)) return std::nullopt;
        return sum.depths / sum.weight;
    }
    /// Of the lookup that stands for a point of the light.
    [[nodiscard]] float visibility(const light::LightSample& sample,
                                   const Size& size) const {
        const auto at = place(sample, size);
        return at ? lookup_.visibility(receiver_, *at) : 1.0f;
    }
    [[nodiscard]] double zMin() const { return zMin_; }

  private:
    /// Where the ray from the point along d passes depth z on the only face.
    [[nodiscard]] glm::dvec2 passes(glm::dvec3 d, double z) const {
        const double t = (z - inLight_.z) / d.z;
        return map_.projection(0).rasterFromLight(
            {inLight_.x + t * d.x, inLight_.y + t * d.y, z});
    }
    /// Nothing where no blocker of that depth can be in front.
    [[nodiscard]] std::optional<MapPlace> place(const light::LightSample& sample,
                                                const Size& size) const {
        if (!size.inFront) return std::nullopt;
        return map_.faceCount() == 1 ? onFace(sample, size) : onFaces(sample, size);
    }
    [[nodiscard]] std::optional<MapPlace> onFace(const light::LightSample& sample,
                                                 const Size& size) const {
        const glm::dvec3 delta = map_.projection(0).lightFromWorldDirection(sample.delta);
        if (!(delta.z < 0.0)) return std::nullopt;
        return MapPlace{0, passes(delta, size.z) + size.shift, inLight_.z};
    }
    /// Six faces around the light: eq. 1 in world space, where a filter reaches over the
    /// faces' edges. The place stays as far from the eye as the point is.
    [[nodiscard]] std::optional<MapPlace> onFaces(const light::LightSample& sample,
                                                  const Size& size) const {
        const glm::dvec3 eye = map_.projection(face_).eye, fromEye = point_ - eye;
        const glm::dvec3 moved = fromEye + size.spread * (sample.delta - towards_);
        const double distance = glm::length(moved);
        if (!(distance > 0.0)) return std::nullopt;
        return lookup_.placeOf(eye + moved * (glm::length(fromEye) / distance));
    }

    const DepthLookup& lookup_;
    const ShadowMap& map_;
    glm::dvec3 point_;
    LookupReceiver receiver_;
    glm::dvec3 towards_;  // the light's centre
    std::uint32_t face_;
    glm::dvec3 inLight_, axis_;  // light space: the point, and towards_
    glm::dvec2 raster_{-1.0};
    double zMin_ = HUGE_VAL;
};

class PcfMethod final : public Method {
  public:
    PcfMethod(ShadowMap map, const AreaLight& light)
        : map_(std::move(map)), light_(light) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return map_.memoryBytes();
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        if (Status fits = lightFits(light, light_); !fits) return fits;
        const light::LightSampler sampler(light);
        const DepthLookup lookup(map_);
        const int samples = settings.whole("samples");
        const int search =
            settings.word("filter") == "blocker" ? settings.whole("search") : 0;
        base::parallelRanges(std::size_t(0), at.count, kPointsPerTask,
                             [&](std::size_t begin, std::size_t end) {
                                 for (std::size_t i = begin; i < end; ++i)
                                     out[i] = shadow(lookup, sampler, at.points[i],
                                                     normalOf(at, i), samples, search);
                             });
        return {};
    }

  private:
    /// search: lookups of the first pass; 0: none, the filter is that of zmin.
    static float shadow(const DepthLookup& lookup, const light::LightSampler& light,
                        glm::dvec3 point, glm::dvec3 normal, int samples, int search) {
        if (!base::isFinite(point)) return 0.0f;
        const Filter filter(lookup, light, point, normal);
        std::optional<double> z = filter.zMin();
        if (search > 0) {
            const PointsOnLight points(light, point);
            z = filter.meanBlocker(points, points.atMost(search));
        }
        const Filter::Size size = z ? filter.sizeFor(*z) : Filter::Size{};
        return shadowFactorOf(light, point, normal, samples,
                              [&](const light::LightSample& sample) {
                                  return filter.visibility(sample, size);
                              });
    }

    ShadowMap map_;
    AreaLight light_;
};

SettingInfo resolutionSetting() {
    return wholeSetting("resolution", 1024, 1, kMaxResolution,
                        "pixels per side of the map", SettingUse::build);
}

constexpr glm::dvec2 kCentre(0.5);

/// What both rows have, behind those of their maps.
void addCommon(std::vector<SettingInfo>& settings) {
    settings.push_back(
        numberSetting("bias", -1.0, -1.0, 1e9,
                      "z threshold of the map, world units; -1: a pixel's "
                      "footprint. Without a normal, lookups start five away",
                      SettingUse::build));
    settings.push_back(wholeSetting("samples", 256, 1, kMaxSamples, "lookups per point"));
    settings.push_back(wordSetting("filter", {"zmin", "blocker"},
                                   "size from the map's least depth, or from the mean "
                                   "depth of blockers"));
    settings.push_back(wholeSetting("search", 64, 1, kMaxSamples,
                                    "lookups per point that look for blockers"));
    settings.back().with = "filter=blocker";
}

Result<BakeOptions> commonOptions(const MethodScene& scene, const Settings& settings) {
    auto options = aimedOptions(scene.casters, scene.bake);
    if (!options) return options;
    setResolutionAndBias(*options, settings);
    options->keepHidden = true;  // what no ray meets is still in front of a lookup
    return options;
}

Result<std::unique_ptr<Method>> buildPcf(const MethodScene& scene,
                                         const Settings& settings) {
    auto options = commonOptions(scene, settings);
    if (!options) return options.error();
    auto map = bakeDepthMap(scene.casters, viewAcross(*options, kCentre),
                            std::uint32_t(settings.whole("layers")));
    if (!map) return map.error();
    return std::unique_ptr<Method>(new PcfMethod(*std::move(map), options->light));
}

Result<std::unique_ptr<Method>> buildDeepPcf(const MethodScene& scene,
                                             const Settings& settings) {
    auto options = commonOptions(scene, settings);
    if (!options) return options.error();
    options->tolerance = float(settings.number("tolerance"));
    auto baked = bake(scene.casters, viewAcross(*options, kCentre));
    if (!baked) return baked.error();
    return std::unique_ptr<Method>(new PcfMethod(std::move(baked->map), options->light));
}

}  // namespace

MethodInfo pcfMethod() {
    MethodInfo info;
    info.name = "pcf";
    info.title = "percentage-closer filtering of an opaque shadow map";
    info.source = "[Xie07, sec. 3]";
    info.volumes = false;
    info.settings = {resolutionSetting(),
                     wholeSetting("layers", 1, 1, 64, "nearest surfaces of a pixel",
                                  SettingUse::build)};
    addCommon(info.settings);
    info.build = buildPcf;
    return info;
}

MethodInfo deepPcfMethod() {
    MethodInfo info;
    info.name = "deep-pcf";
    info.title = "percentage-closer filtering of a deep shadow map";
    info.source = "[Xie07, sec. 3], [Lokovic00]";
    info.settings = {
        resolutionSetting(),
        numberSetting("tolerance", 0.005, 0.0, 1.0, "error that compression may bring",
                      SettingUse::build)};
    addCommon(info.settings);
    info.build = buildDeepPcf;
    return info;
}

}  // namespace mtsm::baseline
