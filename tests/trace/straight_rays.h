// straight_rays.h - rays of world space as kernels of the fast trace take them: bundle.h
// and density_trace.h say what is computed here.
#pragma once
#include <algorithm>
#include <cmath>

#include "trace/bundle.h"
#include "trace/density_tree.h"
#include "trace/traverse.h"

namespace mtsm::test {

struct StraightRay {
    glm::dvec3 start{0.0}, delta{0.0};  ///< u, v, w
    double begin = 0.0, beginSurfaces = 0.0;
    double spread = 0.0;
    bool empty = true;  ///< nothing of it lies beyond the depth at which it ends
};

/// The part of `ray` behind depth zNear > 0. `spread` of rays that are `apart` world
/// units apart at t = 1, for one that starts behind zNear.
inline StraightRay straighten(const Projection& p, const trace::Ray& ray, double zNear,
                              double apart = 0.0) {
    StraightRay r;
    const glm::dvec3 o = p.lightFromWorld(ray.origin);
    const glm::dvec3 d = p.lightFromWorldDirection(ray.delta);
    double t0 = 0.0, t1 = std::min(ray.tEnd, 1e6);
    if (d.z < 0.0) t1 = std::min(t1, (zNear - o.z) / d.z);
    if (d.z > 0.0) t0 = std::max(t0, (zNear - o.z) / d.z);
    if (!(t0 < t1) || (d.z == 0.0 && o.z < zNear)) return r;
    r.empty = false;
    const bool perspective = p.kind == ProjectionKind::perspective;
    const auto at = [&](double t) {
        const glm::dvec3 q = o + t * d;
        return glm::dvec3(p.rasterFromLight(q), perspective ? 1.0 / q.z : -q.z);
    };
    const double z1 = o.z + t1 * d.z;
    const auto sOf = [&](double t) {
        t = std::clamp(t, t0, t1);
        return (t - t0) / (t1 - t0) * (perspective ? z1 / (o.z + t * d.z) : 1.0);
    };
    r.start = at(t0);
    r.delta = at(t1) - r.start;
    r.begin = sOf(ray.tBegin);
    r.beginSurfaces = sOf(std::max(ray.tBegin, ray.tSurfaces));
    if (d.z != 0.0)
        r.spread =
            apart / p.pixelFootprint(1.0) * (perspective ? o.z : 1.0) / std::abs(d.z);
    return r;
}

/// As a ray of a receiver, whose rays have one start and one spread.
inline void put(trace::RayBundle& bundle, int receiver, int group, int lane,
                const StraightRay& r) {
    const int row = bundle.row(receiver, group);
    const auto bit = std::uint16_t(1u << lane);
    if (r.empty) {
        bundle.open[row] = std::uint16_t(bundle.open[row] & ~bit);
        return;
    }
    bundle.open[row] = std::uint16_t(bundle.open[row] | bit);
    bundle.u[receiver] = float(r.start.x);
    bundle.v[receiver] = float(r.start.y);
    bundle.w[receiver] = float(r.start.z);
    bundle.spread[receiver] = float(r.spread);
    bundle.du[row][lane] = float(r.delta.x);
    bundle.dv[row][lane] = float(r.delta.y);
    bundle.dw[row][lane] = float(r.delta.z);
    bundle.begin[row][lane] = float(r.begin);
    bundle.beginSurfaces[row][lane] = float(r.beginSurfaces);
}

/// A depth in front of everything in the map's face.
inline double nearestOf(const ShadowMap& map, std::uint32_t face) {
    const double z = map.zRange(face).min,
                 bias = trace::ZBias{map.info().bias, map.info().biasPerDepth}.at(z);
    return std::max(0.99 * z - 1.01 * bias, z / 1024);
}

}  // namespace mtsm::test
