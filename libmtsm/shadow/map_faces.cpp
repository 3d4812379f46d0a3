#include "shadow/map_faces.h"

#include <algorithm>
#include <glm/geometric.hpp>

#include "shadow/query.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {
namespace {

/// Do the faces share out space among them, with windows of 90 degrees?
bool isCube(const ShadowMap& map) {
    constexpr double kSlack = 1e-9;
    const auto same = [](double a, double b) { return std::abs(a - b) <= kSlack; };
    const double size = map.info().width;
    if (map.faceCount() != 6 || map.info().height != map.info().width) return false;
    for (std::uint32_t f = 0; f < 6; ++f) {
        const Projection& p = map.projection(f);
        if (p.kind != ProjectionKind::perspective || p.eye != map.projection(0).eye ||
            !same(p.scale.x / size, 0.5) || !same(p.scale.y / size, -0.5) ||
            !same(p.offset.x / size, 0.5) || !same(p.offset.y / size, 0.5))
            return false;
        int opposite = 0, across = 0;
        for (std::uint32_t g = 0; g < 6; ++g) {
            const double cosine = glm::dot(p.forward, map.projection(g).forward);
            opposite += same(cosine, -1.0);
            across += same(cosine, 0.0);
        }
        const Projection& first = map.projection(0);
        const auto alongAxis = [&](glm::dvec3 d) {
            return same(std::abs(glm::dot(d, first.right)) +
                            std::abs(glm::dot(d, first.up)) +
                            std::abs(glm::dot(d, first.forward)),
                        1.0);
        };
        if (opposite != 1 || across != 4 || !alongAxis(p.right) || !alongAxis(p.up))
            return false;
    }
    return true;
}

}  // namespace

bool fitsTrees(const ShadowMap& map) {
    if (map.layerCount() == 0 || map.layerCount() > kMostLayers) return false;
    return map.faceCount() == 1 || isCube(map);
}

bool hasTrees(const ShadowMap& map, Attenuation attenuation, trace::DensityUse use) {
    if (!fitsTrees(map)) return false;
    if (map.isOpaque()) return trace::patchTrees(map);
    return attenuation == Attenuation::multiply && trace::densityTrees(map, use);
}

ZRange depthsOf(const ShadowMap& map, std::uint32_t face, float asked) noexcept {
    ZRange depths = map.zRange(face);
    if (depths.empty()) {
        for (std::uint32_t f = 0; f < map.faceCount(); ++f)
            depths.include(map.zRange(f));
    }
    // Sheets are met within two biases.
    const trace::ZBias bias = biasOf(map, asked);
    const bool perspective = map.projection(face).kind == ProjectionKind::perspective;
    const auto nearest = float(depths.min - 2.0 * bias.at(depths.min));
    depths.min = perspective ? std::max(nearest, depths.min * 0x1p-10f) : nearest;
    depths.max += float(2.0 * bias.at(depths.max));
    return depths;
}

RayPart partIn(std::uint32_t face, const double (&z)[6], const double (&dz)[6]) noexcept {
    RayPart part;
    for (std::uint32_t f = 0; f < 6; ++f) {
        if (f == face) continue;
        // It is in the face while that is ahead of all others, in depth.
        const double lead = z[face] - z[f], gain = dz[face] - dz[f];
        if (gain > 0.0)
            part.begin = std::max(part.begin, -lead / gain);
        else if (gain < 0.0)
            part.end = std::min(part.end, -lead / gain);
        else if (lead < 0.0 || (lead == 0.0 && f < face))
            part.end = 0.0;
    }
    return part;
}

}  // namespace mtsm::shadow
