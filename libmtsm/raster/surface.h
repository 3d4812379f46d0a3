// surface.h - how opaque a triangle is from pixel to pixel.
//
// A texture coordinate is linear over the triangle. With the point on a pixel's centre
// ray written as z (X, Y, 1), where X and Y are linear in the raster, it is
// u = z U(x, y) with U linear in the raster (perspective), or u = U(x, y) (orthographic).
#pragma once
#include <array>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "mtsm/map.h"
#include "mtsm/scene.h"

namespace mtsm::raster {

struct Surface {
    std::array<float, 3> opacity{1.0f, 1.0f, 1.0f};  ///< without a texture
    const OpacityTexture* texture = nullptr;
    /// U at raster position (0, 0), and its change along x and y.
    glm::dvec2 at{0.0}, dx{0.0}, dy{0.0};

    /// Sets at, dx and dy for a triangle with corners p (light space), double area vector
    /// `normal` and texture coordinates t.
    void setCoordinates(const Projection& projection, const glm::dvec3 (&p)[3],
                        glm::dvec3 normal, const glm::vec2 (&t)[3]) noexcept {
        const glm::dvec3 e1 = p[1] - p[0], e2 = p[2] - p[0];
        const double scale = 1.0 / glm::dot(normal, normal);
        const glm::dvec3 along1 = glm::cross(e2, normal) * scale,
                         along2 = glm::cross(normal, e1) * scale;
        const glm::dvec2 t0(t[0]), d1 = glm::dvec2(t[1]) - t0, d2 = glm::dvec2(t[2]) - t0;
        const glm::dvec2 perPixel = 1.0 / projection.scale;
        const glm::dvec2 origin = -projection.offset * perPixel;  // X, Y at (0, 0)
        for (int i = 0; i < 2; ++i) {
            // The coordinate is constant + dot(gradient, point); of a perspective map the
            // constant is carried by the plane: dot(normal, point) = dot(normal, p0).
            glm::dvec3 gradient = d1[i] * along1 + d2[i] * along2;
            double constant = t0[i] - glm::dot(gradient, p[0]);
            if (projection.kind == ProjectionKind::perspective) {
                gradient += normal * (constant / glm::dot(normal, p[0]));
                constant = gradient.z;
            }
            at[i] = constant + gradient.x * origin.x + gradient.y * origin.y;
            dx[i] = gradient.x * perPixel.x;
            dy[i] = gradient.y * perPixel.y;
            if (projection.kind == ProjectionKind::orthographic) {
                // z is linear in the raster: dot(normal, point) = dot(normal, p0).
                const double zx = -normal.x / normal.z * perPixel.x;
                const double zy = -normal.y / normal.z * perPixel.y;
                const double z0 =
                    (glm::dot(normal, p[0]) - normal.x * origin.x - normal.y * origin.y) /
                    normal.z;
                at[i] += gradient.z * z0;
                dx[i] += gradient.z * zx;
                dy[i] += gradient.z * zy;
            }
        }
    }

    /// Texture coordinates at a pixel's centre, and how far they move to the next one.
    struct Coordinates {
        glm::dvec2 uv, dx, dy;
    };
    /// For the centre of pixel (x, y), where the triangle's depth is z and 1 / z changes
    /// by q.x and q.y from pixel to pixel (orthographic: not used).
    [[nodiscard]] Coordinates coordinates(ProjectionKind kind, double x, double y,
                                          double z, glm::dvec2 q) const noexcept {
        const glm::dvec2 u = at + (x + 0.5) * dx + (y + 0.5) * dy;
        if (kind == ProjectionKind::orthographic) return {u, dx, dy};
        // u = U z, and z changes by -z^2 times what 1 / z changes by.
        const glm::dvec2 uv = u * z;
        return {uv, (dx - uv * q.x) * z, (dy - uv * q.y) * z};
    }
};

}  // namespace mtsm::raster
