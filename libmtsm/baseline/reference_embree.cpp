#include "baseline/reference_embree.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <vector>

#include "base/message.h"
#include "base/parallel.h"
#include "base/sampling.h"
#include "light/sample.h"

namespace mtsm::baseline {
namespace {

constexpr float kDark = 1e-4f;  // rays with less visibility left end

struct Context : RTCIntersectContext {
    float visible = 1.0f;
};

/// Occlusion filter of a mesh with opacity: the hit is let through and the ray pays for
/// it.
void attenuate(const RTCFilterFunctionNArguments* args) {
    auto& context = *static_cast<Context*>(args->context);
    const float opacity = *static_cast<const float*>(args->geometryUserPtr);
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        context.visible *= 1.0f - opacity;
        if (context.visible > kDark) args->valid[i] = 0;
    }
}

}  // namespace

struct EmbreeReference::Scene {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<std::unique_ptr<float>> opacities;
    glm::dvec3 origin{0.0};  // what Embree's floats are relative to
    bool hasOrigin = false;
    glm::dvec3 low{std::numeric_limits<double>::infinity()};
    glm::dvec3 high{-std::numeric_limits<double>::infinity()};

    Scene() = default;
    Scene(const Scene&) = delete;
    Scene& operator=(const Scene&) = delete;
    ~Scene() {
        if (scene) rtcReleaseScene(scene);
        if (device) rtcReleaseDevice(device);
    }

    Status add(const MeshView& mesh);
    [[nodiscard]] float visibility(glm::dvec3 from, glm::dvec3 delta,
                                   bool endless) const noexcept;
};

Status EmbreeReference::Scene::add(const MeshView& mesh) {
    if (mesh.triangleCount == 0 || mesh.opacity <= 0.0f) return {};
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), mesh.vertexCount));
    auto* indices = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), mesh.triangleCount));
    if (!vertices || !indices) {
        rtcReleaseGeometry(geometry);
        return base::makeError(ErrorCode::tooLarge, "Embree has no memory for a mesh of ",
                               mesh.triangleCount, " triangles");
    }
    for (std::size_t i = 0; i < mesh.vertexCount; ++i) {
        const glm::dvec3 world =
            mesh.worldFromObject * glm::dvec4(mesh.positions[i], 1.0);
        if (!hasOrigin && glm::dot(world, world) < 1e300) {
            origin = world;
            hasOrigin = true;
        }
        low = glm::min(low, world);
        high = glm::max(high, world);
        for (int c = 0; c < 3; ++c)
            vertices[3 * i + std::size_t(c)] = float(world[c] - origin[c]);
    }
    std::copy_n(mesh.indices, 3 * mesh.triangleCount, indices);
    if (mesh.opacity < 1.0f) {
        opacities.push_back(std::make_unique<float>(mesh.opacity));
        rtcSetGeometryUserData(geometry, opacities.back().get());
        rtcSetGeometryOccludedFilterFunction(geometry, attenuate);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    return {};
}

float EmbreeReference::Scene::visibility(glm::dvec3 from, glm::dvec3 delta,
                                         bool endless) const noexcept {
    Context context;
    rtcInitIntersectContext(&context);
    const double length = glm::length(delta);
    const glm::dvec3 o = from - origin;
    RTCRay ray{};
    ray.org_x = float(o.x);
    ray.org_y = float(o.y);
    ray.org_z = float(o.z);
    ray.dir_x = float(delta.x / length);
    ray.dir_y = float(delta.y / length);
    ray.dir_z = float(delta.z / length);
    ray.tfar = endless ? std::numeric_limits<float>::infinity() : float(length);
    ray.mask = ~0u;
    rtcOccluded1(scene, &context, &ray);
    return ray.tfar < 0.0f ? 0.0f : context.visible;
}

EmbreeReference::EmbreeReference(std::unique_ptr<Scene> scene)
    : scene_(std::move(scene)) {}
EmbreeReference::EmbreeReference(EmbreeReference&&) noexcept = default;
EmbreeReference& EmbreeReference::operator=(EmbreeReference&&) noexcept = default;
EmbreeReference::~EmbreeReference() = default;

Result<EmbreeReference> EmbreeReference::build(CasterSource& casters) {
    auto scene = std::make_unique<Scene>();
    scene->device = rtcNewDevice(nullptr);
    if (!scene->device)
        return Error{ErrorCode::unsupported, "Embree cannot start on this machine"};
    scene->scene = rtcNewScene(scene->device);
    // Not HIGH: spatial splits would count a transparent triangle twice.
    rtcSetSceneBuildQuality(scene->scene, RTC_BUILD_QUALITY_MEDIUM);
    rtcSetSceneFlags(scene->scene, RTCSceneFlags(RTC_SCENE_FLAG_ROBUST |
                                                 RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
    const Status read =
        casters.visit(meshesOnly([&](const MeshView& mesh) { return scene->add(mesh); }));
    if (!read) return read.error();
    rtcCommitScene(scene->scene);
    if (rtcGetDeviceError(scene->device) != RTC_ERROR_NONE)
        return Error{ErrorCode::badFile, "Embree could not build a scene of the casters"};
    return EmbreeReference(std::move(scene));
}

glm::dvec3 EmbreeReference::boundsMin() const noexcept {
    return scene_->low;
}
glm::dvec3 EmbreeReference::boundsMax() const noexcept {
    return scene_->high;
}

std::optional<EmbreeReference::Hit> EmbreeReference::firstHit(
    glm::dvec3 origin, glm::dvec3 direction) const noexcept {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    const glm::dvec3 o = origin - scene_->origin, d = glm::normalize(direction);
    RTCRayHit ray{};
    ray.ray.org_x = float(o.x);
    ray.ray.org_y = float(o.y);
    ray.ray.org_z = float(o.z);
    ray.ray.dir_x = float(d.x);
    ray.ray.dir_y = float(d.y);
    ray.ray.dir_z = float(d.z);
    ray.ray.tfar = std::numeric_limits<float>::infinity();
    ray.ray.mask = ~0u;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene_->scene, &context, &ray);
    if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
    Hit hit;
    hit.position = origin + double(ray.ray.tfar) * d;
    hit.normal = glm::normalize(glm::dvec3(ray.hit.Ng_x, ray.hit.Ng_y, ray.hit.Ng_z));
    if (glm::dot(hit.normal, d) > 0.0) hit.normal = -hit.normal;
    return hit;
}

void EmbreeReference::shadowFactors(const AreaLight& light, const glm::dvec3* points,
                                    const glm::dvec3* normals, std::size_t count,
                                    float* out,
                                    const ReferenceOptions& options) const noexcept {
    const light::LightSampler sampler(light);
    const double offset = options.offset * glm::length(scene_->high - scene_->low);
    const auto samples = sampler.isPoint()
                             ? 1u
                             : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples));

    const auto one = [&](std::size_t i) -> float {
        const glm::dvec3 point = points[i];
        if (!(glm::dot(point, point) < HUGE_VAL) || sampler.isBehind(point)) return 0.0f;
        const double length = normals ? glm::length(normals[i]) : 0.0;
        const glm::dvec3 normal = length > 0.0 ? normals[i] / length : glm::dvec3(0.0);
        const base::SquareSequence sequence(base::pointKey(points[i], options.seed));
        double visible = 0.0, total = 0.0;
        for (std::uint32_t s = 0; s < samples; ++s) {
            const light::LightSample sample =
                sampler.sample(point, sampler.isPoint() ? glm::dvec2(0.5) : sequence(s));
            const double reach = glm::length(sample.delta);
            if (!(reach > 0.0)) continue;
            const double cosine =
                length > 0.0 ? glm::dot(sample.delta, normal) / reach : 1.0;
            const double weight = options.weight == Weight::cosine && length > 0.0
                                      ? std::max(0.0, cosine) * sample.weight
                                      : 1.0;
            total += weight;
            if (cosine <= 0.0) continue;
            const glm::dvec3 start =
                offset * (length > 0.0 ? normal : sample.delta / reach);
            visible +=
                weight * scene_->visibility(
                             point + start,
                             sample.delta - (sample.endless ? glm::dvec3(0.0) : start),
                             sample.endless);
        }
        return total > 0.0 ? float(1.0 - visible / total) : 1.0f;
    };
    base::parallelRanges(std::size_t(0), count, std::size_t(64),
                         [&](std::size_t begin, std::size_t end) {
                             for (std::size_t i = begin; i < end; ++i)
                                 out[i] = one(i);
                         });
}

}  // namespace mtsm::baseline
