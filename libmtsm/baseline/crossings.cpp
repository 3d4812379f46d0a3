#include "baseline/crossings.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace mtsm::baseline {
namespace {

// A hit with a barycentric coordinate below the first may be one of two triangles'; two
// such hits nearer to each other than the second, as a share of the way, are one place.
// Both are some times what floats round.
constexpr float kBorder = 0x1p-20f, kSamePlace = 0x1p-16f;

/// `opaque(i, hit)` says whether ray i of the packet ends at a hit; else it goes on.
template <typename Opaque>
void filterHits(const RTCFilterFunctionNArguments* args, const Opaque& opaque) {
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const RTCHit hit = rtcGetHitFromHitN(args->hit, args->N, i);
        if (!opaque(i, hit)) args->valid[i] = 0;
    }
}

/// Where along a segment the ray passes it, 0..1; nothing if it does not meet it. The
/// same test as Embree's for flat linear curves: the point of the segment that is nearest
/// to the ray as the ray sees it, not further than the radius there, and further along
/// the ray than the strand is wide.
std::optional<float> meets(const RibbonStrands& strands, std::size_t segment,
                           glm::vec3 origin, glm::vec3 direction, float reach) {
    const glm::vec4 a = strands.points[strands.first[segment]],
                    b = strands.points[strands.first[segment] + 1];
    const glm::vec3 v = glm::vec3(b) - glm::vec3(a), w = origin - glm::vec3(a);
    const auto across = [&](glm::vec3 x) {
        return x - glm::dot(x, direction) * direction;
    };
    const glm::vec3 flatV = across(v), flatW = across(w);
    const float squared = glm::dot(flatV, flatV);
    const float u =
        squared > 0.0f ? std::clamp(glm::dot(flatW, flatV) / squared, 0.0f, 1.0f) : 0.0f;
    const glm::vec3 apart = u * flatV - flatW;
    const float radius = a.w + u * (b.w - a.w), t = glm::dot(u * v - w, direction);
    if (!(glm::dot(apart, apart) <= radius * radius)) return std::nullopt;
    if (!(t > 2.0f * radius && t <= reach)) return std::nullopt;
    return u;
}

/// Embree rounds the ends of segments: that closes joints, but a strand ends flat.
bool beyondEnd(const RibbonStrands& strands, std::size_t segment, float u) {
    return (u <= 0.0f && !strands.joinsLeft(segment)) ||
           (u >= 1.0f && !strands.joinsRight(segment));
}

}  // namespace

glm::vec3 TranslucentMesh::opacityAt(std::uint32_t triangle, glm::vec2 uv,
                                     bool color) const noexcept {
    if (!texture) return color ? channels : glm::vec3(opacity);
    const std::uint32_t* corner = indices + 3 * std::size_t(triangle);
    const glm::dvec2 a = uvs[corner[0]], b = uvs[corner[1]], c = uvs[corner[2]];
    float out[3];
    texture->opacity(a + double(uv.x) * (b - a) + double(uv.y) * (c - a), glm::dvec2(0.0),
                     glm::dvec2(0.0), out);
    if (texture->channels() == 1) return glm::vec3(out[0]);
    return color ? glm::vec3(out[0], out[1], out[2])
                 : glm::vec3((out[0] + out[1] + out[2]) / 3.0f);
}

float RibbonStrands::opacityAt(std::size_t segment, float u) const noexcept {
    if (opacities.empty()) return opacity;
    const float a = opacities[first[segment]], b = opacities[first[segment] + 1];
    return a + u * (b - a);
}

bool ShadowContext::paidBorder(unsigned ray, const void* mesh, float t) noexcept {
    unsigned& count = borderCount[ray];
    for (unsigned k = 0; k < std::min(count, kBorders); ++k) {
        const Border& b = borders[ray][k];
        if (b.mesh == mesh && std::abs(b.t - t) <= kSamePlace * std::max(b.t, t))
            return true;
    }
    borders[ray][count++ % kBorders] = {mesh, t};
    return false;
}

void payMesh(const RTCFilterFunctionNArguments* args) {
    auto& context = *static_cast<ShadowContext*>(args->context);
    const auto& mesh = *static_cast<const TranslucentMesh*>(args->geometryUserPtr);
    filterHits(args, [&](unsigned i, const RTCHit& hit) {
        const unsigned ray = RTCRayN_id(args->ray, args->N, i);
        // While the filter runs the ray ends at the hit.
        if (std::min({hit.u, hit.v, 1.0f - hit.u - hit.v}) <= kBorder &&
            context.paidBorder(ray, &mesh, RTCRayN_tfar(args->ray, args->N, i)))
            return false;
        return !context.pay(
            ray, mesh.opacityAt(hit.primID, glm::vec2(hit.u, hit.v), context.color));
    });
}

void payStrands(const RTCFilterFunctionNArguments* args) {
    auto& context = *static_cast<ShadowContext*>(args->context);
    const auto& strands = *static_cast<const RibbonStrands*>(args->geometryUserPtr);
    filterHits(args, [&](unsigned i, const RTCHit& hit) {
        const std::size_t segment = hit.primID;
        if (beyondEnd(strands, segment, hit.u)) return false;
        const RTCRay ray = rtcGetRayFromRayN(args->ray, args->N, i);
        // Of a run of segments that the ray meets, the first one pays.
        if (strands.joinsLeft(segment)) {
            const auto u =
                meets(strands, segment - 1, {ray.org_x, ray.org_y, ray.org_z},
                      {ray.dir_x, ray.dir_y, ray.dir_z}, context.reach[ray.id]);
            if (u && !beyondEnd(strands, segment - 1, *u)) return false;
        }
        return !context.pay(ray.id, glm::vec3(strands.opacityAt(segment, hit.u)));
    });
}

void passEnds(const RTCFilterFunctionNArguments* args) {
    const auto& strands = *static_cast<const RibbonStrands*>(args->geometryUserPtr);
    filterHits(args, [&](unsigned, const RTCHit& hit) {
        return !beyondEnd(strands, hit.primID, hit.u);
    });
}

void passHoles(const RTCFilterFunctionNArguments* args) {
    const auto& mesh = *static_cast<const TranslucentMesh*>(args->geometryUserPtr);
    filterHits(args, [&](unsigned, const RTCHit& hit) {
        return mesh.opacityAt(hit.primID, glm::vec2(hit.u, hit.v), false).x > 0.0f;
    });
}

}  // namespace mtsm::baseline
