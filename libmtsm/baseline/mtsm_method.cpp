// The map itself as a row of the comparison: baked, then traced or filtered.
#include <optional>

#include "base/message.h"
#include "baseline/depth_map.h"
#include "baseline/methods.h"
#include "mtsm/describe.h"
#include "mtsm/quality.h"
#include "mtsm/shadow.h"

namespace mtsm::baseline {
namespace {

class MtsmMethod final : public Method {
  public:
    /// `traced`: by ShadowMethod::trace, which needs more than the map. It is made here,
    /// so that it counts as part of the build. `lean`: and needs no layers.
    MtsmMethod(ShadowMap map, bool traced, bool lean) : map_(std::move(map)) {
        if (traced) prepareQueries(map_);
        // A map that cannot do without its layers keeps them.
        if (lean) (void)releaseLayers(map_);
        memoryBytes_ = traced ? queryMemoryBytes(map_) : map_.memoryBytes();
    }

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return memoryBytes_;
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        ShadowOptions options = optionsOf(settings);
        if (const auto plan = planned(light, at, settings)) options = plan->options;
        if (Status fine = checkQuery(map_, light, options); !fine) return fine;
        const std::vector<std::uint32_t> numbers = pixelPoints(at, options);
        // Where the ray tracer's rays start: beside a strand a tenth of its width
        // matters.
        mtsm::shadowFactors(map_, light, at.starts ? at.starts : at.points, at.normals,
                            at.count, out, options);
        return {};
    }
    [[nodiscard]] Choice choice(const AreaLight& light, const Receivers& at,
                                const Settings& settings) const override {
        const auto plan = planned(light, at, settings);
        if (!plan) return {};
        const ShadowOptions& o = plan->options;
        std::string text = base::concat("resolution ", map_.info().width, ", ");
        if (o.targetError > 0.0f && o.samples > o.firstSamples)
            text += base::concat(o.firstSamples, " to ");
        return {base::concat(text, o.samples, " samples"),
                double(plan->mapError) + double(plan->sampleError)};
    }

  private:
    /// What the points of a pixel need to share its samples; nothing where a pixel has
    /// one.
    static std::vector<std::uint32_t> pixelPoints(const Receivers& at,
                                                  ShadowOptions& options) {
        std::size_t most = 1;
        for (std::size_t p = 0; p < at.pixels; ++p)
            most = std::max(most, at.first[p + 1] - at.first[p]);
        if (most == 1 || most > std::size_t(kMaxPointsPerPixel) ||
            at.pixels > 0xffffffffu / most)
            return {};
        std::vector<std::uint32_t> numbers(at.count);
        for (std::size_t p = 0; p < at.pixels; ++p) {
            for (std::size_t i = at.first[p]; i < at.first[p + 1]; ++i)
                numbers[i] = std::uint32_t(p * most + (i - at.first[p]));
        }
        options.pointsPerPixel = int(most);
        options.pixelPoints = numbers.data();
        return numbers;
    }
    static ShadowOptions optionsOf(const Settings& settings) {
        ShadowOptions options;
        options.samples = settings.whole("samples");
        options.bias = float(settings.number("query-bias"));
        const std::string& lookup = settings.word("lookup");
        options.method = lookup == "pcf"      ? ShadowMethod::pcf
                         : lookup == "scalar" ? ShadowMethod::scalar
                                              : ShadowMethod::trace;
        options.adaptive = settings.word("adaptive") == "true";
        options.attenuation = settings.word("attenuation") == "subtract"
                                  ? Attenuation::subtract
                                  : Attenuation::multiply;
        return options;
    }
    /// How target-error is met; nothing where none is asked for.
    [[nodiscard]] std::optional<QueryPlan> planned(const AreaLight& light,
                                                   const Receivers& at,
                                                   const Settings& settings) const {
        const auto error = float(settings.number("target-error"));
        if (!(error > 0.0f)) return std::nullopt;
        ShadowOptions options = optionsOf(settings);
        if (!settings.given("samples")) options.samples = kMaxSamples;
        return planQueries(map_, light, at.points, at.normals, at.count, error, options);
    }

    ShadowMap map_;
    std::uint64_t memoryBytes_ = 0;
};

std::uint64_t nearFieldOf(const Settings& settings) {
    const std::string& text = settings.word("near-field");
    return text == "auto" ? kAutomaticNearField : parseBytes(text).value_or(0);
}

/// Puts what target-error chooses in place of what was not given, as mtsm-bake does.
Status chooseSettings(const MethodScene& scene, const Settings& settings,
                      BakeOptions& options) {
    const auto casters = measureCasters(scene.casters);
    if (!casters) return casters.error();
    MapForm form{scene.bake.cube, scene.bake.color};
    if (settings.given("near-field")) form.nearField = options.nearField > 0;
    const MapSettings chosen =
        mapSettingsFor(*casters, float(settings.number("target-error")), form);
    if (!settings.given("resolution")) options.width = options.height = chosen.resolution;
    if (!settings.given("tolerance")) options.tolerance = chosen.tolerance;
    if (!settings.given("near-field")) options.nearField = chosen.nearField;
    return {};
}

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    BakeOptions options = scene.bake;
    setResolutionAndBias(options, settings);
    if (const int layers = settings.whole("layers"); layers > 0)
        options.layers = std::uint32_t(layers);
    options.tolerance = float(settings.number("tolerance"));
    options.subsamples = std::uint32_t(settings.whole("subsamples"));
    options.nearField = nearFieldOf(settings);
    if (settings.number("target-error") > 0.0)
        if (Status s = chooseSettings(scene, settings, options); !s) return s.error();
    auto baked = bake(scene.casters, options);
    if (!baked) return baked.error();
    const bool traced = settings.word("lookup") == "trace";
    const bool lean = traced && settings.word("attenuation") == "multiply";
    return std::unique_ptr<Method>(new MtsmMethod(std::move(baked->map), traced, lean));
}

}  // namespace

MethodInfo mtsmMethod() {
    MethodInfo info;
    info.name = "mtsm";
    info.title = "multilayer transparent shadow map, ray traced";
    info.source = "[Xie07]";
    info.settings = {
        wholeSetting("resolution", 1024, 1, kMaxResolution, "pixels per side of the map",
                     SettingUse::build),
        wholeSetting("layers", 0, 0, kMaxPixelLayers,
                     "cap on a pixel's layers; 0: as mtsm-bake", SettingUse::build),
        numberSetting("tolerance", 0.005, 0.0, 1.0, "error that compression may bring",
                      SettingUse::build),
        wholeSetting("subsamples", 1, 1, 8, "centre rays per side of a pixel: 1, 2, 4, 8",
                     SettingUse::build),
        numberSetting("bias", -1.0, -1.0, 1e9,
                      "z threshold of the map, world units; -1: as mtsm-bake",
                      SettingUse::build),
        wordSetting("near-field", {"auto", "none"},
                    "triangles and strands themselves beside the layers: auto up to 64M",
                    SettingUse::build),
        numberSetting(
            "target-error", 0.0, 0.0, 1.0,
            "mean error for which resolution, tolerance, near-field and samples are "
            "chosen unless given (samples: the most); 0: none; quality = draft, preview "
            "or final is 0.02, 0.005 or 0.001",
            SettingUse::build),
        wholeSetting("samples", 256, 1, kMaxSamples, "rays per point"),
        numberSetting("query-bias", -1.0, -1.0, 1e9,
                      "z threshold of the query, world units; -1: the map's own"),
        wordSetting("adaptive", {"false", "true"},
                    "no more than 16 rays where those see the same"),
        wordSetting("lookup", {"trace", "scalar", "pcf"},
                    "traced, traced ray by ray, or filtered as small lights may",
                    SettingUse::build),
        wordSetting("attenuation", {"multiply", "subtract"},
                    "how samples add up; subtract keeps the layers", SettingUse::build),
    };
    for (SettingInfo& setting : info.settings) {
        if (setting.name == "near-field") setting.bytes = true;
        // What target-error chooses adapts in a way of its own.
        if (setting.name == "adaptive") setting.with = "target-error=0";
    }
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
