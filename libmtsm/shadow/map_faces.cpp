#include "shadow/map_faces.h"

#include <algorithm>

#include "shadow/query.h"
#include "trace/fits_trees.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {

bool hasTrees(const ShadowMap& map, Attenuation attenuation, trace::DensityUse use) {
    if (!trace::fitsTrees(map)) return false;
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
