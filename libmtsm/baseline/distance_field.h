// distance_field.h - how far it is from a point to the nearest surface.
//
//     auto field = meshField(casters, 256);
//     const double d = (*field)->at(point);       // world units, negative inside
//
// Analytic fields are exact. A field of meshes is a few grids of OpenVDB's distances to
// the triangles, interpolated trilinearly: narrow bands around the surface, the finest
// with the voxels asked for, each next one with voxels twice as wide and so reaching
// twice as far, and the coarsest fills a box that reaches one longest side of the casters
// beyond them on every side. Outside of that it is the distance to the casters' bounds, a
// lower bound: good for steps, and a little too near where shadows compare distances.
//
// A mesh is closed if every edge has as many triangles that run along it one way as the
// other; corners at the same place count as one. Closed meshes have an inside. Of others
// distances have no sign, and they count as sheets one voxel thick, half of it on each
// side. Opacities and textures are nothing that distances know: a mesh of opacity 0 is
// left out, everything else is opaque. Neither strands nor volumes have a place.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

class DistanceField {
  public:
    virtual ~DistanceField() = default;
    /// Negative inside. Any number of threads may ask at once.
    [[nodiscard]] virtual double at(glm::dvec3 p) const noexcept = 0;
    /// How far along a ray it goes on until nothing is nearer further on; infinite where
    /// that is not known.
    [[nodiscard]] virtual double behind(glm::dvec3 from,
                                        glm::dvec3 direction) const noexcept;
    /// Side of the finest voxels, about what at() may be off by; 0 if it is exact.
    [[nodiscard]] virtual double spacing() const noexcept { return 0.0; }
    [[nodiscard]] virtual std::uint64_t memoryBytes() const noexcept { return 0; }
};

using DistanceFieldPtr = std::unique_ptr<const DistanceField>;

[[nodiscard]] DistanceFieldPtr sphereField(glm::dvec3 centre, double radius);
[[nodiscard]] DistanceFieldPtr boxField(glm::dvec3 low, glm::dvec3 high);
/// What is on the side of `p` that the unit normal does not point to.
[[nodiscard]] DistanceFieldPtr planeField(glm::dvec3 p, glm::dvec3 normal);
[[nodiscard]] DistanceFieldPtr capsuleField(glm::dvec3 a, glm::dvec3 b, double radius);
/// The nearest of all; outside exact if its parts are.
[[nodiscard]] DistanceFieldPtr unionField(std::vector<DistanceFieldPtr> parts);

/// Of all meshes, `resolution` voxels (8..1024) along the longest side of their bounds.
/// unsupported if there are none; tooLarge if OpenVDB cannot get the memory.
[[nodiscard]] Result<DistanceFieldPtr> meshField(CasterSource& casters, int resolution);

}  // namespace mtsm::baseline
