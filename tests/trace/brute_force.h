// brute_force.h - the definition of a traced ray, without hierarchy, order or faces that
// know of each other: each pixel of each face is a pyramid that the ray is clipped
// against on its own, in long double.
#pragma once
#include <algorithm>
#include <cmath>

#include "trace/traverse.h"

namespace mtsm::test {

/// What a medium's samples in pixel (x, y) of a view take counts this much for a ray
/// along d of light space: the ray's way per unit of depth over the centre ray's, at
/// most 16.
inline long double stretchOf(const Projection& p, std::uint32_t x, std::uint32_t y,
                             glm::dvec3 d) {
    using L = long double;
    const L cx = (x + 0.5L - p.offset.x) / p.scale.x;
    const L cy = (y + 0.5L - p.offset.y) / p.scale.y;
    const L centre =
        p.kind == ProjectionKind::perspective ? std::sqrt(cx * cx + cy * cy + 1) : L(1);
    const L way = std::sqrt(L(d.x) * d.x + L(d.y) * d.y + L(d.z) * d.z) / std::abs(d.z);
    return std::min(way / centre, L(16));
}

/// For maps of one channel; of the bias only the constant counts, of sheets that are not
/// opaque it must be 0 (the walk does not know what a ray has paid for before).
inline double bruteForce(const ShadowMap& map, const trace::Ray& ray,
                         const trace::TraceOptions& options) {
    using L = long double;
    const bool media = map.info().translucent == Translucent::media;
    L visible = 1;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        const Projection& p = map.projection(face);
        const glm::dvec3 o = p.lightFromWorld(ray.origin);
        const glm::dvec3 d = p.lightFromWorldDirection(ray.delta);
        const bool perspective = p.kind == ProjectionKind::perspective;
        for (std::uint32_t i = 0; i < map.info().width * map.info().height; ++i) {
            const std::uint32_t x = i % map.info().width, y = i / map.info().width;
            L t0 = ray.tBegin, t1 = ray.tEnd;
            const auto side = [&](L a, L b) {
                if (b > 0) t0 = std::max(t0, -a / b);
                if (b < 0) t1 = std::min(t1, -a / b);
                if (b == 0 && a < 0) t1 = t0 - 1;
            };
            const L ha = perspective ? o.z : 1, hb = perspective ? d.z : 0;
            const auto axis = [&](L scale, L offset, L oa, L da, L low, L high) {
                side(scale * oa + (offset - low) * ha, scale * da + (offset - low) * hb);
                side(-scale * oa - (offset - high) * ha,
                     -scale * da - (offset - high) * hb);
            };
            axis(p.scale.x, p.offset.x, o.x, d.x, x, x + 1);
            axis(p.scale.y, p.offset.y, o.y, d.y, y, y + 1);
            side(ha - 1e-9L, hb);  // in front of the eye
            if (!(t0 < t1)) continue;
            const PixelLayers layers = map.pixel(face, x, y);
            const L stretch = media ? stretchOf(p, x, y, d) : L(1);
            L vBefore = 1;
            for (std::uint32_t k = 0; k < layers.count; ++k) {
                const L v = layers.v ? layers.v[k] : 0;
                const std::uint32_t n = layers.n ? layers.n[k] : 1;
                const L from = k ? layers.z[k - 1] : layers.z[0], to = layers.z[k];
                const bool surface = v == 0 && n == 1;
                const L start = media && surface ? std::max(t0, L(ray.tSurfaces)) : t0;
                const L bias = media && !surface ? 0 : options.bias.base;
                const L a = o.z + d.z * start, b = o.z + d.z * t1;
                const L low = std::min(a, b) - bias, high = std::max(a, b) + bias;
                const auto isMet = [&](L z) {
                    return start < t1 && z >= low && z <= high;
                };
                int met = 0;
                for (std::uint32_t j = 1; j <= n; ++j)
                    met += isMet(j == n ? to : from + j * (to - from) / n);
                if (v == 0 && isMet(to))
                    visible = 0;
                else if (met && options.attenuation == Attenuation::multiply && v > 0)
                    visible *= std::pow(v / vBefore, stretch * met / n);
                else if (met && options.attenuation == Attenuation::subtract)
                    visible = std::max(L(0), visible - (vBefore - v) * met / n);
                vBefore = v == 0 ? 1 : v;
            }
        }
    }
    return double(visible);
}

}  // namespace mtsm::test
