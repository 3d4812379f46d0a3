#include "baseline/sdf_march.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <limits>

#include "base/finite.h"
#include "base/parallel.h"
#include "baseline/methods.h"
#include "light/sample.h"

namespace mtsm::baseline {
namespace {

constexpr double kEpsilon = 1e-3, kHit = 1e-4;  // of exact fields

/// r / A as seen over the distance A, or tan of half a sun's angle. A rectangle counts as
/// the disk of its area.
double tangentOf(const AreaLight& light, double distance) {
    if (light.shape == LightShape::sun) return lightRadius(light);
    const double radius = light.shape == LightShape::rect
                              ? std::sqrt(light.size.x * light.size.y / glm::pi<double>())
                              : lightRadius(light);
    return radius / distance;
}

struct March {
    const DistanceField& field;
    const AreaLight& light;
    const light::LightSampler sampler;
    MarchOptions options;  // size 0: from the light

    [[nodiscard]] float shadow(glm::dvec3 point, glm::dvec3 normal) const noexcept {
        if (!base::isFinite(point) || sampler.isBehind(point)) return 0.0f;
        const double length = glm::length(normal);
        if (length > 0.0) {
            if (!(glm::dot(sampler.towards(point), normal) > 0.0)) return 1.0f;
            point += field.spacing() / length * normal;
        }
        const glm::dvec3 towards = sampler.towards(point);
        const double distance = glm::length(towards);
        if (!(distance > 0.0)) return 0.0f;
        const glm::dvec3 direction = towards / distance;
        const double reach = sampler.shape() == LightShape::sun
                                 ? std::numeric_limits<double>::infinity()
                                 : distance;
        MarchOptions own = options;
        if (!(own.size > 0.0))
            own.size = marchSize(tangentOf(light, distance), own.stride);
        const MarchEnd end{std::min(reach, field.behind(point, direction)), distance,
                           -glm::dot(sampler.shines(), direction), field.spacing()};
        return float(1.0 - march(field, point, direction, end, own));
    }
};

}  // namespace

double march(const DistanceField& field, glm::dvec3 origin, glm::dvec3 direction,
             const MarchEnd& end, const MarchOptions& options) noexcept {
    double visible = 1.0, t = options.epsilon;
    for (int step = 0; step < options.steps && t < end.reach; ++step) {
        const double d = field.at(origin + t * direction);
        const bool mayBeBehind =
            end.cosine > 0.0 && (end.light - t) * end.cosine < d + end.blur;
        if (mayBeBehind && d < options.hit) break;
        t += options.stride * d;
        if (mayBeBehind) continue;
        visible = std::min(visible, d / (t * options.size));
        if (d < options.hit) return 0.0;
    }
    return std::max(0.0, visible);
}

double marchSize(double tangent, double stride) noexcept {
    const double sine = tangent / std::sqrt(1.0 + tangent * tangent);
    return sine / (1.0 + stride * sine);
}

void marchShadowFactors(const DistanceField& field, const AreaLight& light,
                        const glm::dvec3* points, const glm::dvec3* normals,
                        std::size_t count, float* out,
                        const MarchOptions& options) noexcept {
    March rays{field, light, light::LightSampler(light), options};
    const double voxel = field.spacing();
    if (!(rays.options.epsilon > 0.0))
        rays.options.epsilon = voxel > 0.0 ? 2.0 * voxel : kEpsilon;
    if (!(rays.options.hit > 0.0)) rays.options.hit = voxel > 0.0 ? 0.1 * voxel : kHit;
    base::parallelRanges(
        std::size_t(0), count, std::size_t(64), [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                out[i] = rays.shadow(points[i], normals ? normals[i] : glm::dvec3(0.0));
        });
}

namespace {

class SdfMethod final : public Method {
  public:
    explicit SdfMethod(DistanceFieldPtr field) : field_(std::move(field)) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return field_->memoryBytes();
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        MarchOptions options;
        options.steps = settings.whole("steps");
        options.epsilon = settings.number("epsilon");
        options.hit = settings.number("hit");
        options.size = settings.number("size");
        options.stride = settings.number("stride");
        marchShadowFactors(*field_, light, at.points, at.normals, at.count, out, options);
        return {};
    }

  private:
    DistanceFieldPtr field_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    auto field = meshField(scene.casters, settings.whole("resolution"));
    if (!field) return field.error();
    return std::unique_ptr<Method>(new SdfMethod(std::move(*field)));
}

}  // namespace

MethodInfo sdfMethod() {
    MethodInfo info;
    info.name = "sdf";
    info.title = "distance field of meshes, marched";
    info.source = "[Sdf]";
    info.strands = info.volumes = false;
    info.perLight = false;
    info.settings = {
        wholeSetting("resolution", 128, 8, 1024,
                     "voxels along the longest side of all casters together: a large "
                     "ground leaves few for what stands on it",
                     SettingUse::build),
        wholeSetting("steps", 128, 1, 100'000, "most steps of a ray"),
        numberSetting("epsilon", 0.0, 0.0, 1e9,
                      "where a ray starts, world units; 0: two voxels"),
        numberSetting("hit", 0.0, 0.0, 1e9,
                      "a distance that is a hit, world units; 0: a tenth of a voxel"),
        numberSetting("size", 0.0, 0.0, 1e9,
                      "of the light, over its distance; 0: that the penumbra's outer "
                      "border is right"),
        numberSetting("stride", 1.0, 0.01, 1.0, "how much of the distance a step goes"),
    };
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
