#include "baseline/reference_embree.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <new>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "base/finite.h"
#include "base/message.h"
#include "base/parallel.h"
#include "base/sampling.h"
#include "baseline/crossings.h"
#include "baseline/shadow_rays.h"
#include "baseline/volume_depth.h"
#include "light/sample.h"

namespace mtsm::baseline {
namespace {

/// Rays enough for a stream of their own; fewer wait for those of the next point.
constexpr std::size_t kEnoughRays = 16;
constexpr std::size_t kLookBlock = 64;  // points that a thread takes at once

/// What Embree holds, in bytes.
struct Memory {
    std::atomic<std::int64_t> now{0}, peak{0};
};

bool countMemory(void* memory, ssize_t bytes, bool) {
    auto& m = *static_cast<Memory*>(memory);
    const std::int64_t now = m.now += bytes;
    std::int64_t peak = m.peak;
    while (now > peak && !m.peak.compare_exchange_weak(peak, now)) {
    }
    return true;
}

template <typename T>
std::uint64_t bytesOf(const std::vector<T>& values) {
    return values.size() * sizeof(T);
}

Error noMemory(const char* kind, std::size_t count, const char* parts) {
    return base::makeError(ErrorCode::tooLarge, "Embree has no memory for ", kind, " of ",
                           count, " ", parts);
}

constexpr std::size_t kPacketRays = 16;

/// Up to 16 rays of a stream as a packet, but those that have ended. That is faster than
/// a stream where origins differ or frustums are of no use.
void tracePacket(RTCScene scene, const RayStream& s, std::size_t first,
                 ShadowContext& context, float* reach) {
    const std::size_t n = std::min(kPacketRays, s.count - first);
    alignas(64) RTCRay16 p{};
    alignas(64) int valid[kPacketRays] = {};
    const float back = context.back;
    bool any = false;
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t i = first + k;
        valid[k] = reach[i] < 0.0f ? 0 : -1;
        any = any || valid[k];
        p.org_x[k] = s.orgX[i] - back * s.dirX[i];
        p.org_y[k] = s.orgY[i] - back * s.dirY[i];
        p.org_z[k] = s.orgZ[i] - back * s.dirZ[i];
    }
    if (!any) return;
    std::copy_n(s.dirX + first, n, p.dir_x);
    std::copy_n(s.dirY + first, n, p.dir_y);
    std::copy_n(s.dirZ + first, n, p.dir_z);
    for (std::size_t k = 0; k < n; ++k)
        p.tfar[k] = s.length[first + k] + back;
    std::fill_n(p.mask, n, ~0u);
    std::iota(p.id, p.id + n, unsigned(first));
    rtcOccluded16(valid, scene, &context, &p);
    for (std::size_t k = 0; k < n; ++k)
        if (valid[k]) reach[first + k] = p.tfar[k];
}

/// What a sample counts.
double weightOf(const light::LightSampler& sampler, const LightLook& look,
                std::uint32_t sample, Weight weight) {
    if (weight == Weight::uniform || look.normal == glm::dvec3(0.0)) return 1.0;
    const light::LightSample s =
        sampler.sample(look.point, base::SquareSequence(look.key)(sample));
    const double reach = glm::length(s.delta);
    if (!(reach > 0.0)) return 0.0;
    return std::max(0.0, glm::dot(s.delta, look.normal) / reach) * s.weight;
}

/// Where a ray meets the plane of a triangle with a corner at 0 and sides b and c, in
/// double, moved into the triangle; nothing where it goes along the plane.
std::optional<glm::dvec2> inTriangle(glm::dvec3 from, glm::dvec3 direction, glm::dvec3 b,
                                     glm::dvec3 c) {
    const glm::dvec3 across = glm::cross(direction, c), other = glm::cross(from, b);
    const double scale = glm::dot(b, across);
    const glm::dvec2 at(glm::dot(from, across) / scale,
                        glm::dot(direction, other) / scale);
    if (!std::isfinite(at.x) || !std::isfinite(at.y)) return std::nullopt;
    const double u = std::clamp(at.x, 0.0, 1.0);
    return glm::dvec2(u, std::clamp(at.y, 0.0, 1.0 - u));
}

}  // namespace

struct EmbreeReference::Scene {
    Memory memory;  // outlives the device
    RTCDevice device = nullptr;
    /// Casters that end a ray at once, for coherent streams, and those at which it pays.
    RTCScene solid = nullptr, paying = nullptr;
    float back = 0.0f;  // the largest width of a strand; see ShadowContext
    std::vector<std::unique_ptr<TranslucentMesh>> meshes;
    std::vector<std::unique_ptr<RibbonStrands>> strands;
    std::vector<bool> isStrands;  // [geometries of `paying`]
    bool hasSolid = false;
    std::vector<VolumeDepth> volumes;
    glm::dvec3 origin{0.0};  // what Embree's floats are relative to
    bool hasOrigin = false;
    glm::dvec3 low{std::numeric_limits<double>::infinity()};
    glm::dvec3 high{-std::numeric_limits<double>::infinity()};

    Scene() = default;
    Scene(const Scene&) = delete;
    Scene& operator=(const Scene&) = delete;
    ~Scene() {
        if (solid) rtcReleaseScene(solid);
        if (paying) rtcReleaseScene(paying);
        if (device) rtcReleaseDevice(device);
    }

    Status add(const MeshView& mesh);
    Status add(const StrandsView& view);
    Status add(const VolumeView& volume);
    void reach(glm::dvec3 world);
    glm::vec3 place(glm::dvec3 world);
    void attach(RTCGeometry geometry, bool pays, bool strands);
    void locate(RTCScene scene, const RTCHit& met, glm::dvec3 from, glm::dvec3 direction,
                Hit& hit) const noexcept;
    [[nodiscard]] glm::vec3 visibility(glm::dvec3 from, glm::dvec3 delta, bool endless,
                                       bool color) const noexcept;
    void trace(RayStream& stream, ShadowContext& context) const noexcept;
    [[nodiscard]] float throughVolumes(const RayStream& stream,
                                       std::size_t ray) const noexcept;
    void look(const light::LightSampler& sampler, const LightLook* looks,
              std::size_t lookCount, const std::uint32_t* order, std::size_t count,
              LightSeen* seen, bool color,
              const ReferenceOptions& options) const noexcept;
    template <typename Out>
    void shadows(const AreaLight& light, const glm::dvec3* points,
                 const glm::dvec3* normals, std::size_t count, bool color,
                 const ReferenceOptions& options, const Out& out) const noexcept;
};

/// Takes a vertex into the bounds.
void EmbreeReference::Scene::reach(glm::dvec3 world) {
    if (!base::isFinite(world)) return;
    low = glm::min(low, world);
    high = glm::max(high, world);
}

/// Takes a vertex, already within the bounds, to Embree's space: around the middle of the
/// bounds as they are when the first one comes.
glm::vec3 EmbreeReference::Scene::place(glm::dvec3 world) {
    if (!hasOrigin && low.x <= high.x) {
        origin = 0.5 * low + 0.5 * high;
        hasOrigin = true;
    }
    return glm::vec3(world - origin);
}

void EmbreeReference::Scene::attach(RTCGeometry geometry, bool pays, bool asStrands) {
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(pays ? paying : solid, geometry);
    rtcReleaseGeometry(geometry);
    if (pays)
        isStrands.push_back(asStrands);
    else
        hasSolid = true;
}

/// Position and width of a hit, relative to the origin, from the triangle or strand
/// itself: along a ray from afar a float is too coarse.
void EmbreeReference::Scene::locate(RTCScene scene, const RTCHit& met, glm::dvec3 from,
                                    glm::dvec3 direction, Hit& hit) const noexcept {
    const RTCGeometry geometry = rtcGetGeometry(scene, met.geomID);
    if (hit.strand) {
        const auto& r =
            *static_cast<const RibbonStrands*>(rtcGetGeometryUserData(geometry));
        const glm::dvec4 a = r.points[r.first[met.primID]],
                         b = r.points[r.first[met.primID] + 1];
        const glm::dvec4 axis = glm::mix(a, b, double(met.u));
        hit.position = from + glm::dot(glm::dvec3(axis) - from, direction) * direction;
        hit.width = 2.0 * axis.w;
        return;
    }
    const auto* vertices = static_cast<const float*>(
        rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_VERTEX, 0));
    const auto* corner = static_cast<const std::uint32_t*>(rtcGetGeometryBufferData(
                             geometry, RTC_BUFFER_TYPE_INDEX, 0)) +
                         3 * std::size_t(met.primID);
    const auto vertex = [&](int i) {
        const float* v = vertices + 3 * std::size_t(corner[i]);
        return glm::dvec3(v[0], v[1], v[2]);
    };
    const glm::dvec3 a = vertex(0), b = vertex(1) - a, c = vertex(2) - a;
    const glm::dvec2 place =
        inTriangle(from - a, direction, b, c).value_or(glm::dvec2(met.u, met.v));
    hit.position = a + place.x * b + place.y * c;
}

Status EmbreeReference::Scene::add(const MeshView& mesh) {
    const bool textured = mesh.texture && mesh.uvs;
    if (mesh.triangleCount == 0 || (!textured && mesh.opacity <= 0.0f)) return {};
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), mesh.vertexCount));
    auto* indices = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), mesh.triangleCount));
    if (!vertices || !indices) {
        rtcReleaseGeometry(geometry);
        return noMemory("a mesh", mesh.triangleCount, "triangles");
    }
    std::vector<bool> used(mesh.vertexCount, false);
    for (std::size_t i = 0; i < 3 * mesh.triangleCount; ++i)
        used[mesh.indices[i]] = true;
    const auto world = [&](std::size_t i) {
        return glm::dvec3(mesh.worldFromObject * glm::dvec4(mesh.positions[i], 1.0));
    };
    for (std::size_t i = 0; i < mesh.vertexCount; ++i)
        if (used[i]) reach(world(i));
    for (std::size_t i = 0; i < mesh.vertexCount; ++i) {
        const glm::vec3 p = used[i] ? place(world(i)) : glm::vec3(0.0f);
        for (int c = 0; c < 3; ++c)
            vertices[3 * i + std::size_t(c)] = p[c];
    }
    std::copy_n(mesh.indices, 3 * mesh.triangleCount, indices);
    const bool pays = textured ? mesh.texture->translucent() : mesh.opacity < 1.0f;
    if (pays) {
        auto translucent = std::make_unique<TranslucentMesh>();
        translucent->opacity = mesh.opacity;
        translucent->channels = channelOpacity(mesh.opacity, mesh.tint);
        translucent->indices = indices;
        if (textured) {
            translucent->texture = *mesh.texture;
            translucent->uvs.assign(mesh.uvs, mesh.uvs + mesh.vertexCount);
            rtcSetGeometryIntersectFilterFunction(geometry, passHoles);
        }
        rtcSetGeometryUserData(geometry, translucent.get());
        rtcSetGeometryOccludedFilterFunction(geometry, payMesh);
        meshes.push_back(std::move(translucent));
    }
    attach(geometry, pays, false);
    return {};
}

Status EmbreeReference::Scene::add(const StrandsView& view) {
    if (view.strandCount == 0 || (!view.opacities && view.opacity <= 0.0f)) return {};
    auto ribbons = std::make_unique<RibbonStrands>();
    RibbonStrands& r = *ribbons;
    r.opacity = view.opacity;
    const double scale =
        0.5 * std::cbrt(std::abs(glm::determinant(glm::dmat3(view.worldFromObject))));
    const std::size_t pointCount = view.begin[view.strandCount];
    r.points.reserve(pointCount);
    r.first.reserve(pointCount + 3);
    for (std::size_t s = 0; s < view.strandCount; ++s) {
        bool joined = false;  // to the point before
        for (std::uint32_t i = view.begin[s]; i < view.begin[s + 1]; ++i) {
            const glm::dvec3 world =
                view.worldFromObject * glm::dvec4(view.points[i], 1.0);
            const double radius = scale * (view.widths ? view.widths[i] : view.width);
            if (!base::isFinite(world) || !std::isfinite(radius)) {
                joined = false;
                continue;
            }
            reach(world);
            const glm::vec3 p = place(world);
            if (joined && glm::vec3(r.points.back()) == p) continue;
            if (joined) r.first.push_back(std::uint32_t(r.points.size() - 1));
            r.points.emplace_back(p, float(std::max(radius, 0.0)));
            if (view.opacities) r.opacities.push_back(view.opacities[i]);
            joined = true;
        }
    }
    r.segments = r.first.size();
    if (r.segments == 0) return {};
    for (const glm::vec4& p : r.points)
        back = std::max(back, 2.0f * p.w);
    r.first.resize(r.segments + 3);  // Embree reads four at a time
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_FLAT_LINEAR_CURVE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4,
                               r.points.data(), 0, sizeof(glm::vec4), r.points.size());
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT,
                               r.first.data(), 0, sizeof(std::uint32_t), r.segments);
    rtcSetGeometryUserData(geometry, ribbons.get());
    rtcSetGeometryOccludedFilterFunction(geometry, payStrands);
    rtcSetGeometryIntersectFilterFunction(geometry, passEnds);
    strands.push_back(std::move(ribbons));
    attach(geometry, true, true);
    return {};
}

Status EmbreeReference::Scene::add(const VolumeView& volume) {
    if (!(volume.extinction > 0.0f)) return {};
    for (std::size_t i = 0; i < volume.blockCount; ++i) {
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 at(corner & 1, corner >> 1 & 1, corner >> 2);
            const glm::dvec3 index =
                glm::dvec3(volume.blocks[i]) - 0.5 + double(VolumeView::kBlockSide) * at;
            const glm::dvec3 world = volume.worldFromIndex * glm::dvec4(index, 1.0);
            reach(world);
            (void)place(world);
        }
    }
    volumes.emplace_back(volume);
    return {};
}

glm::vec3 EmbreeReference::Scene::visibility(glm::dvec3 from, glm::dvec3 delta,
                                             bool endless, bool color) const noexcept {
    ShadowContext context;
    rtcInitIntersectContext(&context);
    context.color = color;
    const double length = glm::length(delta);
    if (!(length > 0.0) || !base::isFinite(from)) return glm::vec3(1.0f);
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
    context.begin(0, ray.tfar);
    if (hasSolid) rtcOccluded1(solid, &context, &ray);
    if (!isStrands.empty() && ray.tfar >= 0.0f) {
        context.back = back;
        ray.org_x -= back * ray.dir_x;
        ray.org_y -= back * ray.dir_y;
        ray.org_z -= back * ray.dir_z;
        ray.tfar += back;
        rtcOccluded1(paying, &context, &ray);
    }
    if (ray.tfar < 0.0f) return glm::vec3(0.0f);
    double depth = 0.0;
    for (const VolumeDepth& volume : volumes)
        depth += volume.along(from, delta, endless);
    return context.visible[0] * float(std::exp(-depth));
}

/// Leaves in the context what each ray of the stream sees.
void EmbreeReference::Scene::trace(RayStream& s, ShadowContext& context) const noexcept {
    alignas(64) float zero[kStreamRays] = {}, reach[kStreamRays];
    alignas(64) std::uint32_t mask[kStreamRays], id[kStreamRays], flags[kStreamRays] = {};
    for (std::size_t i = 0; i < s.count; ++i) {
        mask[i] = ~0u;
        id[i] = std::uint32_t(i);
        reach[i] = s.length[i];
        context.begin(unsigned(i), s.length[i]);
    }
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    context.back = 0.0f;
    if (hasSolid && s.count <= kPacketRays && s.owner[0] != s.owner[s.count - 1]) {
        tracePacket(solid, s, 0, context, reach);
    } else if (hasSolid) {
        RTCRayNp rays{s.orgX, s.orgY, s.orgZ, zero, s.dirX, s.dirY,
                      s.dirZ, zero,   reach,  mask, id,     flags};
        rtcOccludedNp(solid, &context, &rays, unsigned(s.count));
    }
    // Coherent traversal may find a hit twice (seen where the tree is a single leaf): it
    // is for casters that end a ray at once.
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    context.back = back;
    for (std::size_t i = 0; !isStrands.empty() && i < s.count; i += kPacketRays)
        tracePacket(paying, s, i, context, reach);
    for (std::size_t i = 0; i < s.count; ++i) {
        if (reach[i] < 0.0f)
            context.visible[i] = glm::vec3(0.0f);
        else if (!volumes.empty())
            context.visible[i] *= throughVolumes(s, i);
    }
}

float EmbreeReference::Scene::throughVolumes(const RayStream& s,
                                             std::size_t i) const noexcept {
    const bool endless = std::isinf(s.length[i]);
    const glm::dvec3 from = origin + glm::dvec3(s.orgX[i], s.orgY[i], s.orgZ[i]);
    const glm::dvec3 delta = glm::dvec3(s.dirX[i], s.dirY[i], s.dirZ[i]) *
                             (endless ? 1.0 : double(s.length[i]));
    double depth = 0.0;
    for (const VolumeDepth& volume : volumes)
        depth += volume.along(from, delta, endless);
    return float(std::exp(-depth));
}

void EmbreeReference::Scene::look(const light::LightSampler& sampler,
                                  const LightLook* looks, std::size_t lookCount,
                                  const std::uint32_t* order, std::size_t count,
                                  LightSeen* seen, bool color,
                                  const ReferenceOptions& options) const noexcept {
    ShadowContext context;
    rtcInitIntersectContext(&context);
    context.color = color;
    RayStream stream;
    const auto flush = [&] {
        trace(stream, context);
        for (std::size_t i = 0; i < stream.count; ++i) {
            const LightLook& from = looks[stream.owner[i]];
            LightSeen& to = seen[stream.owner[i]];
            const glm::vec3 v = context.visible[i];
            to.visible +=
                weightOf(sampler, from, stream.sample[i], options.weight) * glm::dvec3(v);
            to.clear += v == glm::vec3(1.0f);
            to.dark += v == glm::vec3(0.0f);
        }
        stream.count = 0;
    };
    for (std::size_t l = 0; l < lookCount; ++l) {
        const bool hasNormal = looks[l].normal != glm::dvec3(0.0);
        const PointRays rays(
            sampler, looks[l].point, looks[l].normal, origin,
            rayOffset(looks[l].point,
                      hasNormal ? looks[l].normal : sampler.towards(looks[l].point), low,
                      high, options.offset));
        const base::SquareSequence sequence(looks[l].key);
        for (std::size_t done = 0; done < count;) {
            std::uint32_t index[kStreamRays];
            const std::size_t n = std::min(stream.room(), count - done);
            for (std::size_t k = 0; k < n; ++k) {
                index[k] = looks[l].first + order[done + k];
                seen[l].total += weightOf(sampler, looks[l], index[k], options.weight);
            }
            const std::size_t before = stream.count;
            rays.append(sequence, index, n, std::uint32_t(l), stream);
            seen[l].dark += std::uint32_t(n - (stream.count - before));
            done += n;
            if (stream.count >= kEnoughRays && (done == count || stream.room() == 0))
                flush();
        }
    }
    if (stream.count > 0) flush();
}

template <typename Out>
void EmbreeReference::Scene::shadows(const AreaLight& light, const glm::dvec3* points,
                                     const glm::dvec3* normals, std::size_t count,
                                     bool color, const ReferenceOptions& options,
                                     const Out& out) const noexcept {
    const light::LightSampler sampler(light);
    const auto samples = sampler.isPoint()
                             ? 1u
                             : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples));
    const std::vector<std::uint32_t> order = neighbourOrder(0, samples);
    // Blocks do not depend on the number of threads: neither do the streams.
    const std::size_t blocks = (count + kLookBlock - 1) / kLookBlock;
    base::parallelFor(std::size_t(0), blocks, [&](std::size_t block) {
        LightLook looks[kLookBlock];
        LightSeen seen[kLookBlock];
        std::size_t at[kLookBlock], n = 0;
        const std::size_t begin = block * kLookBlock,
                          end = std::min(count, begin + kLookBlock);
        for (std::size_t i = begin; i < end; ++i) {
            if (!base::isFinite(points[i]) || sampler.isBehind(points[i])) {
                out(i, glm::vec3(0.0f));
                continue;
            }
            glm::dvec3 normal = normals ? normals[i] : glm::dvec3(0.0);
            const double length = glm::length(normal);
            if (length > 0.0) normal /= length;
            at[n] = i;
            looks[n++] = {points[i], normal, base::pointKey(points[i], options.seed), 0};
        }
        look(sampler, looks, n, order.data(), order.size(), seen, color, options);
        for (std::size_t k = 0; k < n; ++k)
            out(at[k], seen[k].total > 0.0
                           ? glm::vec3(1.0 - seen[k].visible / seen[k].total)
                           : glm::vec3(1.0f));
    });
}

std::string embreeVersion() {
    RTCDevice device = rtcNewDevice(nullptr);
    const auto v = device ? rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION) : 0;
    if (device) rtcReleaseDevice(device);
    return std::to_string(v / 10000) + "." + std::to_string(v / 100 % 100) + "." +
           std::to_string(v % 100);
}

EmbreeReference::EmbreeReference(std::unique_ptr<Scene> scene)
    : scene_(std::move(scene)) {}
EmbreeReference::EmbreeReference(EmbreeReference&&) noexcept = default;
EmbreeReference& EmbreeReference::operator=(EmbreeReference&&) noexcept = default;
EmbreeReference::~EmbreeReference() = default;

Result<EmbreeReference> EmbreeReference::build(CasterSource& casters, bool robust) try {
    auto scene = std::make_unique<Scene>();
    scene->device = rtcNewDevice(nullptr);
    if (!scene->device)
        return Error{ErrorCode::unsupported, "Embree cannot start on this machine"};
    rtcSetDeviceMemoryMonitorFunction(scene->device, countMemory, &scene->memory);
    // Measured (tests/bench/NOTES.md): HIGH gains nothing, and its spatial splits would
    // count a transparent triangle twice; COMPACT costs a fifth, and together with ROBUST
    // it does not come back.
    for (RTCScene* part : {&scene->solid, &scene->paying}) {
        *part = rtcNewScene(scene->device);
        rtcSetSceneBuildQuality(*part, RTC_BUILD_QUALITY_MEDIUM);
        rtcSetSceneFlags(*part, robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    }
    const Status read = casters.visit([&](const CasterView& caster) {
        return std::visit([&](const auto& view) { return scene->add(view); }, caster);
    });
    if (!read) return read.error();
    rtcCommitScene(scene->solid);
    rtcCommitScene(scene->paying);
    const RTCError error = rtcGetDeviceError(scene->device);
    if (error == RTC_ERROR_OUT_OF_MEMORY)
        return Error{ErrorCode::tooLarge,
                     "Embree has no memory for a tree over the casters"};
    if (error != RTC_ERROR_NONE)
        return Error{ErrorCode::badFile, "Embree could not build a scene of the casters"};
    return EmbreeReference(std::move(scene));
} catch (const std::bad_alloc&) {
    return Error{ErrorCode::tooLarge, "there is no memory for a copy of the casters"};
} catch (const std::length_error&) {
    return Error{ErrorCode::tooLarge, "there is no memory for a copy of the casters"};
}

glm::dvec3 EmbreeReference::boundsMin() const noexcept {
    return scene_->low;
}
glm::dvec3 EmbreeReference::boundsMax() const noexcept {
    return scene_->high;
}
bool EmbreeReference::hasVolumes() const noexcept {
    return !scene_->volumes.empty();
}
std::uint64_t EmbreeReference::memoryBytes() const noexcept {
    std::uint64_t bytes = std::uint64_t(scene_->memory.now.load());
    for (const auto& mesh : scene_->meshes)
        bytes += bytesOf(mesh->uvs) + (mesh->texture ? mesh->texture->memoryBytes() : 0);
    for (const auto& r : scene_->strands)
        bytes += bytesOf(r->points) + bytesOf(r->first) + bytesOf(r->opacities);
    for (const VolumeDepth& volume : scene_->volumes)
        bytes += volume.memoryBytes();
    return bytes;
}
std::uint64_t EmbreeReference::peakBytes() const noexcept {
    return memoryBytes() +
           std::uint64_t(scene_->memory.peak.load() - scene_->memory.now.load());
}

void EmbreeReference::look(const light::LightSampler& sampler, const LightLook* looks,
                           std::size_t lookCount, const std::uint32_t* order,
                           std::size_t count, LightSeen* seen, bool color,
                           const ReferenceOptions& options) const noexcept {
    scene_->look(sampler, looks, lookCount, order, count, seen, color, options);
}

glm::vec3 EmbreeReference::visibility(glm::dvec3 from, glm::dvec3 delta, bool endless,
                                      bool color) const noexcept {
    return scene_->visibility(from, delta, endless, color);
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
    rtcIntersect1(scene_->solid, &context, &ray);
    const RTCHit behind = ray.hit;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene_->paying, &context, &ray);
    const bool pays = ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
    if (!pays) ray.hit = behind;
    if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
    Hit hit;
    hit.strand = pays && scene_->isStrands[ray.hit.geomID];
    scene_->locate(pays ? scene_->paying : scene_->solid, ray.hit, o, d, hit);
    hit.position += scene_->origin;
    // Of a strand Embree tells the direction along it.
    const glm::dvec3 n =
        glm::normalize(glm::dvec3(ray.hit.Ng_x, ray.hit.Ng_y, ray.hit.Ng_z));
    hit.normal = hit.strand ? glm::normalize(glm::dot(d, n) * n - d) : n;
    if (glm::dot(hit.normal, d) > 0.0) hit.normal = -hit.normal;
    return hit;
}

void EmbreeReference::shadowFactors(const AreaLight& light, const glm::dvec3* points,
                                    const glm::dvec3* normals, std::size_t count,
                                    float* out,
                                    const ReferenceOptions& options) const noexcept {
    scene_->shadows(light, points, normals, count, false, options,
                    [&](std::size_t i, glm::vec3 dark) { out[i] = dark.x; });
}

void EmbreeReference::shadowFactors(const AreaLight& light, const glm::dvec3* points,
                                    const glm::dvec3* normals, std::size_t count,
                                    glm::vec3* out,
                                    const ReferenceOptions& options) const noexcept {
    scene_->shadows(light, points, normals, count, true, options,
                    [&](std::size_t i, glm::vec3 dark) { out[i] = dark; });
}

}  // namespace mtsm::baseline
