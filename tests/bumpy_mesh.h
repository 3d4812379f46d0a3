// bumpy_mesh.h - a closed, bumpy body for tests and benchmarks, made from nothing.
#pragma once
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::test {

struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;

    [[nodiscard]] MeshView view() const {
        MeshView v;
        v.positions = positions.data();
        v.vertexCount = positions.size();
        v.indices = indices.data();
        v.triangleCount = indices.size() / 3;
        return v;
    }
};

/// A sphere of radius about 1 around the origin with bumps of a few sizes, watertight,
/// outward facing, of about `triangles` triangles.
inline Mesh bumpyBody(std::size_t triangles) {
    // Rings of latitude, twice as many columns: 2 * rings * columns triangles or so.
    const auto rings = std::uint32_t(std::max(3.0, std::sqrt(double(triangles) / 4.0)));
    const std::uint32_t columns = 2 * rings;
    const auto surface = [&](double theta, double phi) {
        const glm::dvec3 d(std::sin(theta) * std::cos(phi), std::cos(theta),
                           std::sin(theta) * std::sin(phi));
        const double bumps = 0.18 * std::sin(3 * d.x + 1) * std::sin(4 * d.y) +
                             0.07 * std::sin(9 * d.y + 2 * d.z) * std::sin(11 * d.x) +
                             0.02 * std::sin(37 * d.z + 5 * d.x) * std::sin(31 * d.y);
        return glm::vec3(d * (1.0 + bumps));
    };
    Mesh mesh;
    mesh.positions.push_back(surface(0, 0));
    for (std::uint32_t r = 1; r < rings; ++r) {
        for (std::uint32_t c = 0; c < columns; ++c)
            mesh.positions.push_back(surface(glm::pi<double>() * r / rings,
                                             2 * glm::pi<double>() * c / columns));
    }
    mesh.positions.push_back(surface(glm::pi<double>(), 0));
    const auto last = std::uint32_t(mesh.positions.size() - 1);
    const auto at = [&](std::uint32_t r, std::uint32_t c) {
        return r == 0 ? 0u : r == rings ? last : 1 + (r - 1) * columns + c % columns;
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

}  // namespace mtsm::test
