#include "trace/fits_trees.h"

#include <cmath>
#include <glm/geometric.hpp>

namespace mtsm::trace {
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

}  // namespace mtsm::trace
