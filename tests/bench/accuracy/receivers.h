// receivers.h - the points at which a map is compared with ray tracing.
#pragma once
#include <cstddef>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "baseline/reference_embree.h"
#include "mtsm/scene.h"

namespace mtsm::bench {

struct Receivers {
    std::string name;
    std::vector<glm::dvec3> position;
    std::vector<glm::dvec3> normal;  ///< zero: none is given
    /// Where the truth's rays start: on a strand a little off it, or it would be a matter
    /// of rounding whether it shadows itself.
    std::vector<glm::dvec3> truth;
    /// Pixels: first[i] is the first point of pixel i, and one past the end; else empty.
    std::vector<std::size_t> first;

    [[nodiscard]] std::size_t size() const noexcept { return position.size(); }
    void add(glm::dvec3 at, glm::dvec3 n) { add(at, n, at); }
    void add(glm::dvec3 at, glm::dvec3 n, glm::dvec3 start) {
        position.push_back(at);
        normal.push_back(n);
        truth.push_back(start);
    }
    [[nodiscard]] bool hasNormals() const noexcept;
};

/// The casters' bounds, and the floor under them: as wide as three times their largest
/// side, at their lowest point.
struct Stage {
    glm::dvec3 low, high;

    [[nodiscard]] glm::dvec3 centre() const noexcept { return 0.5 * (low + high); }
    [[nodiscard]] double size() const noexcept;
};

Receivers onFloor(const Stage& stage, std::size_t side);
/// Spread evenly by area over triangles that face `towards`; with their normals.
Receivers onMeshes(CasterSource& casters, std::size_t count, glm::dvec3 towards);
/// Spread evenly by length over strands; the truth starts 1e-4 of the stage's size
/// outward.
Receivers onStrands(CasterSource& casters, std::size_t count, const Stage& stage);
/// Spread evenly over the voxels that hold something.
Receivers inVolumes(CasterSource& casters, std::size_t count);

/// A picture of casters and floor, 600 x 300, from slightly above: some of its pixels,
/// each with what its 16 jittered rays meet first (in a volume: where they scatter).
struct Picture {
    Receivers object, floor;   ///< pixels that see more of the one or the other
    double objectShare = 0.0;  ///< of the pixels that see anything
};
Picture takePicture(const baseline::EmbreeReference& scene, const Stage& stage,
                    std::size_t pixels);

}  // namespace mtsm::bench
