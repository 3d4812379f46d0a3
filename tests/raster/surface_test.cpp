// Texture coordinates across a triangle: against barycentric coordinates in light space.
#include "raster/surface.h"

#include <catch2/catch.hpp>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>

#include "bake/casters.h"
#include "raster/triangle.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Random;

namespace {

Projection view(ProjectionKind kind) {
    Projection p;
    p.kind = kind;
    p.scale = {180.0, -150.0};
    p.offset = {60.0, 70.0};
    return p;
}

/// Where the centre ray through raster position r meets the triangle's plane, in light
/// space: from the plane's equation, and the coordinates there from a linear system.
struct Exact {
    glm::dvec3 point;
    glm::dvec2 uv;
};
Exact exact(const Projection& p, const glm::dvec3 (&corner)[3], const glm::vec2 (&t)[3],
            glm::dvec2 r) {
    const glm::dvec3 origin = p.kind == ProjectionKind::perspective
                                  ? glm::dvec3(0.0)
                                  : p.lightFromRaster(r, 0.0);
    const glm::dvec3 direction = p.lightFromRaster(r, 1.0) - origin;
    const glm::dvec3 n = glm::cross(corner[1] - corner[0], corner[2] - corner[0]);
    const double at = glm::dot(n, corner[0] - origin) / glm::dot(n, direction);
    const glm::dvec3 point = origin + at * direction;
    // point = corner0 + b1 e1 + b2 e2 + 0 n
    const glm::dmat3 basis(corner[1] - corner[0], corner[2] - corner[0], n);
    const glm::dvec3 b = glm::inverse(basis) * (point - corner[0]);
    return {point, glm::dvec2(t[0]) + b.x * (glm::dvec2(t[1]) - glm::dvec2(t[0])) +
                       b.y * (glm::dvec2(t[2]) - glm::dvec2(t[0]))};
}

}  // namespace

TEST_CASE("texture coordinates and their change are those of the plane",
          "[raster][exact]") {
    for (const auto kind : {ProjectionKind::perspective, ProjectionKind::orthographic}) {
        const Projection p = view(kind);
        for (std::uint64_t seed = 0; seed < 200; ++seed) {
            Random random(seed);
            glm::dvec3 corner[3];
            glm::vec2 t[3];
            for (int i = 0; i < 3; ++i) {
                corner[i] = {random.in(-1, 1), random.in(-1, 1), random.in(1, 4)};
                t[i] = {float(random.in(-2, 2)), float(random.in(-2, 2))};
            }
            const glm::dvec3 n = glm::cross(corner[1] - corner[0], corner[2] - corner[0]);
            const double tilt =
                kind == ProjectionKind::perspective ? glm::dot(n, corner[0]) : n.z;
            if (std::abs(tilt) < 0.05 * glm::length(n)) continue;  // nearly edge-on
            Surface surface;
            surface.setCoordinates(p, corner, n, t);
            const double x = std::floor(random.in(0, 120));
            const double y = std::floor(random.in(0, 120));
            const auto at = [&](double dx, double dy) {
                return exact(p, corner, t, {x + 0.5 + dx, y + 0.5 + dy});
            };
            const Exact here = at(0, 0);
            constexpr double h = 1e-4;
            const glm::dvec2 q =
                glm::dvec2(1.0 / at(h, 0).point.z - 1.0 / at(-h, 0).point.z,
                           1.0 / at(0, h).point.z - 1.0 / at(0, -h).point.z) /
                (2.0 * h);
            const auto found = surface.coordinates(kind, x, y, here.point.z, q);
            const glm::dvec2 dx = (at(h, 0).uv - at(-h, 0).uv) / (2.0 * h);
            const glm::dvec2 dy = (at(0, h).uv - at(0, -h).uv) / (2.0 * h);
            const double size = 1.0 + glm::length(here.uv);
            INFO("seed " << seed << ", kind " << int(kind));
            CHECK(glm::length(found.uv - here.uv) < 1e-9 * size);
            CHECK(glm::length(found.dx - dx) < 1e-5 * (1.0 + glm::length(dx)));
            CHECK(glm::length(found.dy - dy) < 1e-5 * (1.0 + glm::length(dy)));
        }
    }
}
