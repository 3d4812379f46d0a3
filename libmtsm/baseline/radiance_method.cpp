// Radiance textures as a row of the comparison: the visibility of a light on the flat
// receivers of a picture, looked up bilinearly. Points on no receiver have no answer.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <optional>

#include "base/parallel.h"
#include "baseline/depth_map.h"
#include "baseline/light_mean.h"
#include "baseline/methods.h"
#include "baseline/radiance_texture.h"

namespace mtsm::baseline {
namespace {

constexpr double kOnPlane = 1e-4;  // share of the longer side

/// A receiver and the map from points of its plane to texture coordinates.
class Wall {
  public:
    Wall(const PlanarReceiver& plane, RadianceTexture texture)
        : plane_(plane),
          size_(texture.width, texture.height),
          visibility_(std::move(texture.visibility.front())),
          normal_(glm::normalize(glm::cross(plane.edgeX, plane.edgeY))),
          longer_(std::max(glm::length(plane.edgeX), glm::length(plane.edgeY))) {
        const glm::dvec3 acrossY = glm::cross(plane.edgeY, normal_),
                         acrossX = glm::cross(normal_, plane.edgeX);
        toU_ = acrossY / glm::dot(acrossY, plane.edgeX);
        toV_ = acrossX / glm::dot(acrossX, plane.edgeY);
    }

    /// How far the point is off, in longer sides; infinite where it lies elsewhere, is
    /// seen from behind or has no normal: it is then none of the receiver's surface.
    [[nodiscard]] double distance(glm::dvec3 p, glm::dvec3 normal) const noexcept {
        const glm::dvec2 c = coordinates(p);
        const double off =
            std::max({std::abs(glm::dot(normal_, p - plane_.corner)) / longer_, -c.x,
                      -c.y, c.x - 1.0, c.y - 1.0});
        const bool here = off <= kOnPlane && glm::dot(normal, normal_) > 0.0;
        return here ? off : std::numeric_limits<double>::infinity();
    }
    [[nodiscard]] float shadow(glm::dvec3 p) const noexcept {
        return 1.0f - lookUp(visibility_, size_, coordinates(p));
    }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return visibility_.size() * sizeof(float);
    }

  private:
    [[nodiscard]] glm::dvec2 coordinates(glm::dvec3 p) const noexcept {
        return {glm::dot(toU_, p - plane_.corner), glm::dot(toV_, p - plane_.corner)};
    }

    PlanarReceiver plane_;
    glm::uvec2 size_;
    std::vector<float> visibility_;
    glm::dvec3 normal_, toU_{0.0}, toV_{0.0};
    double longer_;
};

class RadianceMethod final : public Method {
  public:
    RadianceMethod(std::vector<Wall> walls, const AreaLight& light)
        : walls_(std::move(walls)), light_(light) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        std::uint64_t bytes = 0;
        for (const Wall& wall : walls_)
            bytes += wall.memoryBytes();
        return bytes;
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at, const Settings&,
                         float* out) const override {
        if (Status fits = lightFits(light, light_); !fits) return fits;
        base::parallelRanges(std::size_t(0), at.count, std::size_t(1024),
                             [&](std::size_t begin, std::size_t end) {
                                 for (std::size_t i = begin; i < end; ++i)
                                     out[i] = shadow(at.points[i], normalOf(at, i));
                             });
        return {};
    }

  private:
    [[nodiscard]] float shadow(glm::dvec3 p, glm::dvec3 normal) const noexcept {
        double least = std::numeric_limits<double>::infinity();
        const Wall* nearest = nullptr;
        for (const Wall& wall : walls_) {
            const double distance = wall.distance(p, normal);
            if (!(distance < least)) continue;
            least = distance;
            nearest = &wall;
        }
        return nearest ? nearest->shadow(p) : std::numeric_limits<float>::quiet_NaN();
    }

    std::vector<Wall> walls_;
    AreaLight light_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    if (scene.planes.empty())
        return Error{ErrorCode::badArgument,
                     "radiance textures need flat receivers and the scene names none"};
    const auto aimed = aimedOptions(scene.casters, scene.bake);
    if (!aimed) return aimed.error();
    auto casters = ShadowCasters::build(scene.casters);
    if (!casters) return casters.error();
    RadianceOptions options;
    options.resolution = settings.whole("resolution");
    options.samplesPerSide = settings.whole("samples");
    options.supersampling = settings.whole("supersampling");
    options.grid =
        settings.word("sampling") == "regular" ? LightGrid::regular : LightGrid::jittered;
    options.radiance = false;
    std::vector<RadianceReceiver> receivers;
    for (const PlanarReceiver& plane : scene.planes)
        receivers.push_back(parallelogramReceiver(plane));
    auto textures = radianceTextures(*casters, receivers, {{aimed->light, {}}}, options);
    if (!textures) return textures.error();
    std::vector<Wall> walls;
    for (std::size_t i = 0; i < receivers.size(); ++i)
        walls.emplace_back(scene.planes[i], std::move((*textures)[i]));
    return std::unique_ptr<Method>(new RadianceMethod(std::move(walls), aimed->light));
}

}  // namespace

MethodInfo radianceMethod() {
    MethodInfo info;
    info.name = "radiance";
    info.title = "radiance textures on flat receivers";
    info.source = "[Heckbert97]";
    info.volumes = false;
    info.settings = {
        wholeSetting("resolution", 512, 1, kMaxResolution,
                     "texels on the longer side of a receiver", SettingUse::build),
        wholeSetting("samples", 16, 1, kMaxGridSide,
                     "points along either side of the light's grid", SettingUse::build),
        wordSetting("sampling", {"jittered", "regular"},
                    "where in its cell of the grid a point lies", SettingUse::build),
        wholeSetting("supersampling", 1, 1, 16,
                     "hard shadows are finer by this on either side", SettingUse::build),
    };
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
