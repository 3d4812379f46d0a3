// method.h - what every way to compute a soft shadow has in common, so that they can be
// measured side by side.
//
//     const MethodInfo* info = findMethod("mvsm");            // methods.h
//     auto settings = Settings::complete(info->settings, {{"samples", 256.0}}, "mvsm");
//     auto method = info->build(scene, *settings);
//     (*method)->shadowFactors(light, receivers, *settings, out);
//
// World units; shadow factor 0 lit to 1 dark, as in mtsm/shadow.h. A method never changes
// once built. Work runs in the caller's oneTBB arena, and answers do not depend on the
// number of threads.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <memory>
#include <string>
#include <vector>

#include "baseline/settings.h"
#include "mtsm/bake.h"
#include "mtsm/light.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

/// Points that are shaded, by pixel. Pointers are borrowed.
struct Receivers {
    const glm::dvec3* points = nullptr;  ///< [count], finite
    /// [count], unit; zero: none (strands, media).
    const glm::dvec3* normals = nullptr;
    /// [count]: where rays through the geometry itself start. On a strand a little off
    /// it, or it would be a matter of rounding whether it shadows itself; else the point.
    const glm::dvec3* starts = nullptr;
    std::size_t count = 0;
    /// [pixels + 1]: pixel p has the points [first[p], first[p + 1]), at least one.
    /// Methods may share work among the points of a pixel, and among pixels that follow
    /// each other, which are neighbours in the picture.
    const std::size_t* first = nullptr;
    std::size_t pixels = 0;
};

/// What a method chose where its settings leave that to it.
struct Choice {
    std::string text;       ///< "resolution 1024, 16 to 256 samples"; empty: nothing
    double expected = 0.0;  ///< the mean error that it expects of it
};

class Method {
  public:
    virtual ~Method() = default;

    /// What it holds while it answers.
    [[nodiscard]] virtual std::uint64_t memoryBytes() const noexcept = 0;

    /// out[i] for point i; NaN where the method has no answer. `light` is the one that
    /// the method was built for, or any if its kind is not built per light. `settings`
    /// may differ in those for queries from what the method was built with.
    virtual Status shadowFactors(const AreaLight& light, const Receivers& at,
                                 const Settings& settings, float* out) const = 0;

    /// For the same question.
    [[nodiscard]] virtual Choice choice(const AreaLight& /*light*/,
                                        const Receivers& /*at*/,
                                        const Settings& /*settings*/) const {
        return {};
    }
};

/// A flat piece of a receiver: corner + u * edgeX + v * edgeY for u and v in [0, 1]. Its
/// lit side is the one that cross(edgeX, edgeY) points to.
struct PlanarReceiver {
    glm::dvec3 corner{0.0}, edgeX{0.0}, edgeY{0.0};
};

/// What a method is built for.
struct MethodScene {
    CasterSource& casters;
    /// The light, aimed, and how a map of it is placed (target, fov, near, far, ...). A
    /// method puts what its own settings say in place of resolution, layers and so on.
    BakeOptions bake;
    std::vector<PlanarReceiver> planes;  ///< flat receivers of the picture
};

struct MethodInfo {
    std::string name;      ///< as scene files spell it: "mvsm"
    std::string title;     ///< "multi-view shadow maps, ray traced"
    std::string source;    ///< "[Agrawala00]"
    bool perLight = true;  ///< false: one build serves every light
    /// An answer has costs that do not fall with the number of points: it is to be timed
    /// on whole pictures.
    bool fixedCost = false;
    bool strands = true, volumes = true;  ///< casters that it takes; meshes always
    std::vector<SettingInfo> settings;
    std::function<Result<std::unique_ptr<Method>>(const MethodScene&, const Settings&)>
        build;
};

}  // namespace mtsm::baseline
