// casters.h - meshes for the tests and benchmarks of the bake.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/scene.h"
#include "random.h"

namespace mtsm::test {

/// A mesh that owns its arrays.
struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;
    glm::dmat4 worldFromObject{1.0};
    float opacity = 1.0f;

    [[nodiscard]] MeshView view() const {
        MeshView view;
        view.positions = positions.data();
        view.vertexCount = positions.size();
        view.indices = indices.data();
        view.triangleCount = indices.size() / 3;
        view.worldFromObject = worldFromObject;
        view.opacity = opacity;
        return view;
    }
    void triangle(glm::vec3 a, glm::vec3 b, glm::vec3 c) {
        for (glm::vec3 p : {a, b, c}) {
            indices.push_back(std::uint32_t(positions.size()));
            positions.push_back(p);
        }
    }
    void quad(glm::vec3 a, glm::vec3 b, glm::vec3 c, glm::vec3 d) {
        triangle(a, b, c);
        triangle(a, c, d);
    }
};

class Casters final : public CasterSource {
  public:
    explicit Casters(std::vector<Mesh> m) : meshes(std::move(m)) {}
    Status visit(const CasterVisitor& visitor) override {
        ++visits;
        for (const Mesh& mesh : meshes) {
            if (auto s = visitor(mesh.view()); !s) return s;
        }
        return {};
    }

    std::vector<Mesh> meshes;
    int visits = 0;
};

/// A closed bumpy ball around the origin, radius about 1: a cube of 6 n^2 quads, blown
/// up.
inline Mesh bumpyBall(std::uint32_t n) {
    Mesh mesh;
    for (int face = 0; face < 6; ++face) {
        const auto first = std::uint32_t(mesh.positions.size());
        const int axis = face / 2;
        const double sign = face % 2 ? 1.0 : -1.0;
        for (std::uint32_t j = 0; j <= n; ++j) {
            for (std::uint32_t i = 0; i <= n; ++i) {
                glm::dvec3 p;
                p[axis] = sign;
                p[(axis + 1) % 3] = sign * (2.0 * i / n - 1.0);
                p[(axis + 2) % 3] = 2.0 * j / n - 1.0;
                p = glm::normalize(p);
                const double bump = 1.0 + 0.06 * std::sin(9.0 * p.x) *
                                              std::sin(11.0 * p.y) * std::sin(10.0 * p.z);
                mesh.positions.push_back(glm::vec3(p * bump));
            }
        }
        for (std::uint32_t j = 0; j < n; ++j) {
            for (std::uint32_t i = 0; i < n; ++i) {
                const std::uint32_t a = first + j * (n + 1) + i, b = a + 1;
                const std::uint32_t d = a + n + 1, c = d + 1;
                for (std::uint32_t v : {a, b, c, a, c, d})
                    mesh.indices.push_back(v);
            }
        }
    }
    return mesh;
}

/// The same triangles in another order.
inline void shuffleTriangles(Mesh& mesh, Random& random) {
    std::vector<std::array<std::uint32_t, 3>> triangles;
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3)
        triangles.push_back({mesh.indices[i], mesh.indices[i + 1], mesh.indices[i + 2]});
    random.shuffle(triangles);
    mesh.indices.clear();
    for (const auto& t : triangles)
        mesh.indices.insert(mesh.indices.end(), t.begin(), t.end());
}

}  // namespace mtsm::test
