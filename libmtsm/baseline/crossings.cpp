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

// Of a strand's radius: what is nearer to its axis lies within it. Rays from a strand
// start a fifth of the radius off it (picture.cpp): at most 1.02 radii from the axis.
constexpr float kWithin = 1.05f;
// Segments to both sides that are looked at for that: those of bent strands may be
// shorter than these are wide.
constexpr int kAround = 8;

/// `opaque(i, hit)` says whether ray i of the packet ends at a hit; else it goes on.
template <typename Opaque>
void filterHits(const RTCFilterFunctionNArguments* args, const Opaque& opaque) {
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const RTCHit hit = rtcGetHitFromHitN(args->hit, args->N, i);
        if (!opaque(i, hit)) args->valid[i] = 0;
    }
}

struct Ray {
    glm::vec3 origin, direction;
};

/// Where a ray passes a segment: 0..1 along it, t along the ray.
struct Passing {
    float u, t;
};

/// The same test as Embree's for flat linear curves: the point of the segment that is
/// nearest to the ray as the ray sees it, not further than the radius there.
std::optional<Passing> meets(const RibbonStrands& strands, std::size_t segment,
                             const Ray& ray, float reach) {
    const glm::vec4 a = strands.points[strands.first[segment]],
                    b = strands.points[strands.first[segment] + 1];
    const glm::vec3 v = glm::vec3(b) - glm::vec3(a), w = ray.origin - glm::vec3(a);
    const auto across = [&](glm::vec3 x) {
        return x - glm::dot(x, ray.direction) * ray.direction;
    };
    const glm::vec3 flatV = across(v), flatW = across(w);
    const float squared = glm::dot(flatV, flatV);
    const float u =
        squared > 0.0f ? std::clamp(glm::dot(flatW, flatV) / squared, 0.0f, 1.0f) : 0.0f;
    const glm::vec3 apart = u * flatV - flatW;
    const float radius = a.w + u * (b.w - a.w), t = glm::dot(u * v - w, ray.direction);
    if (!(glm::dot(apart, apart) <= radius * radius) || !(t <= reach))
        return std::nullopt;
    return Passing{u, t};
}

/// Embree rounds the ends of segments: that closes joints, but a strand ends flat.
bool beyondEnd(const RibbonStrands& strands, std::size_t segment, float u) {
    return (u <= 0.0f && !strands.joinsLeft(segment)) ||
           (u >= 1.0f && !strands.joinsRight(segment));
}

/// Does a point lie within a segment, or within its extension if `endless`?
bool liesWithin(const RibbonStrands& strands, std::size_t segment, glm::vec3 point,
                bool endless) {
    const glm::vec4 a = strands.points[strands.first[segment]],
                    b = strands.points[strands.first[segment] + 1];
    const glm::vec3 v = glm::vec3(b) - glm::vec3(a), w = point - glm::vec3(a);
    const float along = glm::dot(w, v) / glm::dot(v, v),
                u = std::clamp(along, 0.0f, 1.0f);
    const float radius = a.w + u * (b.w - a.w);
    return glm::length(w - (endless ? along : u) * v) <= kWithin * radius;
}

/// The same of a strand, around one of its segments.
bool liesWithinStrand(const RibbonStrands& strands, std::size_t segment,
                      glm::vec3 point) {
    if (liesWithin(strands, segment, point, true)) return true;
    std::size_t left = segment, right = segment;
    for (int k = 0; k < kAround; ++k) {
        if (strands.joinsLeft(left) && liesWithin(strands, --left, point, false))
            return true;
        if (strands.joinsRight(right) && liesWithin(strands, ++right, point, false))
            return true;
    }
    return false;
}

/// Is a segment crossed there? Not before the ray's true start, `back` on its way, and
/// not where that start lies within the strand itself.
bool isCrossed(const RibbonStrands& strands, std::size_t segment, const Ray& ray,
               Passing at, float back) {
    if (beyondEnd(strands, segment, at.u) || !(at.t > back)) return false;
    const float a = strands.points[strands.first[segment]].w,
                b = strands.points[strands.first[segment] + 1].w;
    return at.t - back > 2.0f * (a + at.u * (b - a)) ||
           !liesWithinStrand(strands, segment, ray.origin + back * ray.direction);
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
        const float t = RTCRayN_tfar(args->ray, args->N, i);
        if (!(t > context.back)) return false;
        if (std::min({hit.u, hit.v, 1.0f - hit.u - hit.v}) <= kBorder &&
            context.paidBorder(ray, &mesh, t))
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
        const RTCRay r = rtcGetRayFromRayN(args->ray, args->N, i);
        const Ray ray{{r.org_x, r.org_y, r.org_z}, {r.dir_x, r.dir_y, r.dir_z}};
        // While the filter runs the ray ends at the hit.
        if (!isCrossed(strands, segment, ray, {hit.u, r.tfar}, context.back))
            return false;
        // Of a run of segments that the ray meets, the first one pays.
        if (strands.joinsLeft(segment)) {
            const auto at =
                meets(strands, segment - 1, ray, context.back + context.reach[r.id]);
            if (at && isCrossed(strands, segment - 1, ray, *at, context.back))
                return false;
        }
        return !context.pay(r.id, glm::vec3(strands.opacityAt(segment, hit.u)));
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
