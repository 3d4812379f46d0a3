// object_fixture.h - a floor, a ball and lights, for methods that work on objects.
#pragma once
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <vector>

#include "bumpy_mesh.h"
#include "mtsm/light.h"
#include "mtsm/scene.h"

namespace mtsm::test {

/// A ball of 2 * rings^2 * 2 triangles or so, its corners on the sphere, outward facing.
inline Mesh ballMesh(glm::dvec3 centre, double radius, std::uint32_t rings) {
    Mesh mesh;
    const std::uint32_t columns = 2 * rings;
    for (std::uint32_t r = 0; r <= rings; ++r) {
        for (std::uint32_t c = 0; c < columns; ++c) {
            const double theta = glm::pi<double>() * r / rings,
                         phi = 2 * glm::pi<double>() * c / columns;
            // Exactly one pole on each side, so that the mesh is closed.
            const double ring = r == 0 || r == rings ? 0.0 : std::sin(theta);
            mesh.positions.emplace_back(
                centre + radius * glm::dvec3(ring * std::cos(phi), std::cos(theta),
                                             ring * std::sin(phi)));
        }
    }
    const auto at = [&](std::uint32_t r, std::uint32_t c) {
        return r * columns + c % columns;
    };
    for (std::uint32_t r = 0; r < rings; ++r) {
        for (std::uint32_t c = 0; c < columns; ++c) {
            if (r > 0)
                mesh.indices.insert(mesh.indices.end(),
                                    {at(r, c), at(r, c + 1), at(r + 1, c)});
            if (r + 1 < rings)
                mesh.indices.insert(mesh.indices.end(),
                                    {at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)});
        }
    }
    return mesh;
}

/// Two triangles over the parallelogram at `corner`.
inline Mesh quadMesh(glm::dvec3 corner, glm::dvec3 x, glm::dvec3 y) {
    Mesh mesh;
    for (const glm::dvec3 p : {corner, corner + x, corner + x + y, corner + y})
        mesh.positions.emplace_back(p);
    mesh.indices = {0, 1, 2, 0, 2, 3};
    return mesh;
}

/// A closed box.
inline Mesh boxMesh(glm::vec3 low, glm::vec3 high) {
    Mesh mesh;
    for (int i = 0; i < 8; ++i)
        mesh.positions.emplace_back(i & 1 ? high.x : low.x, i & 2 ? high.y : low.y,
                                    i & 4 ? high.z : low.z);
    mesh.indices = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                    2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
    return mesh;
}

/// side x side points of the floor y = 0 around the origin, facing up.
struct Floor {
    std::vector<glm::dvec3> points, normals;

    Floor(int side, double width) {
        for (int i = 0; i < side * side; ++i)
            points.push_back({(i % side + 0.5) * width / side - 0.5 * width, 0.0,
                              (i / side + 0.5) * width / side - 0.5 * width});
        normals.assign(points.size(), {0.0, 1.0, 0.0});
    }
};

inline AreaLight sphereLight(glm::dvec3 position, double radius) {
    AreaLight light;
    light.shape = LightShape::sphere;
    light.position = position;
    light.radius = radius;
    return light;
}

inline double mean(const std::vector<float>& values) {
    double sum = 0.0;
    for (const float v : values)
        sum += double(v);
    return sum / double(values.size());
}

}  // namespace mtsm::test
