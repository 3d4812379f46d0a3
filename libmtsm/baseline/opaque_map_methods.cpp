// Ray traced shadow maps of opaque casters, of one layer and of several [Xie07, fig. 1 c
// and b, sec. 4].
#include "baseline/depth_map.h"
#include "baseline/methods.h"
#include "mtsm/shadow.h"

namespace mtsm::baseline {
namespace {

class OpaqueMapMethod final : public Method {
  public:
    explicit OpaqueMapMethod(ShadowMap map) : map_(std::move(map)) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return map_.memoryBytes();
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        ShadowOptions options;
        options.samples = settings.whole("samples");
        if (Status fine = checkQuery(map_, light, options); !fine) return fine;
        mtsm::shadowFactors(map_, light, at.points, at.normals, at.count, out, options);
        return {};
    }

  private:
    ShadowMap map_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene, const Settings& settings,
                                      std::uint32_t layers) {
    auto options = aimedOptions(scene.casters, scene.bake);
    if (!options) return options.error();
    setResolutionAndBias(*options, settings);
    auto map = bakeDepthMap(scene.casters, *options, layers);
    if (!map) return map.error();
    return std::unique_ptr<Method>(new OpaqueMapMethod(*std::move(map)));
}

std::vector<SettingInfo> commonSettings() {
    return {
        wholeSetting("resolution", 1024, 1, kMaxResolution, "pixels per side of the map",
                     SettingUse::build),
        numberSetting("bias", -1.0, -1.0, 1e9,
                      "z threshold, world units; -1: a pixel's footprint",
                      SettingUse::build),
        wholeSetting("samples", 256, 1, kMaxSamples, "rays per point"),
    };
}

}  // namespace

MethodInfo slsmMethod() {
    MethodInfo info;
    info.name = "slsm";
    info.title = "single-layer shadow map, ray traced";
    info.source = "[Xie07, sec. 4.1]";
    info.volumes = false;
    info.settings = commonSettings();
    info.build = [](const MethodScene& scene, const Settings& settings) {
        return build(scene, settings, 1);
    };
    return info;
}

MethodInfo mlsmMethod() {
    MethodInfo info;
    info.name = "mlsm";
    info.title = "multilayer opaque shadow map, ray traced";
    info.source = "[Xie07, sec. 4.2]";
    info.volumes = false;
    info.settings = commonSettings();
    info.settings.insert(info.settings.begin() + 1,
                         wholeSetting("layers", 5, 1, 64, "nearest surfaces of a pixel",
                                      SettingUse::build));
    info.build = [](const MethodScene& scene, const Settings& settings) {
        return build(scene, settings, std::uint32_t(settings.whole("layers")));
    };
    return info;
}

}  // namespace mtsm::baseline
