// opaque_casters.h - casters as a plain depth map takes them: there, or not there.
//
//     OpaqueCasters opaque(casters, eyeOf(options));
//     auto baked = bake(opaque, options);
//
// Meshes and strands that stop any light at all stop all of it. Strands become ribbons
// that face the eye, two triangles a segment, joined from segment to segment, so that a
// pixel's centre hits one or does not. Volumes have no depth and are left out. A mesh
// with a texture is handed on as it is, for its holes are found only when it is baked
// (depth_map.h decides them).
#pragma once
#include <glm/vec3.hpp>

#include "mtsm/bake.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

/// What ribbons face.
struct Eye {
    glm::dvec3 at{0.0};    ///< world: a place, or the direction towards the eye
    bool endless = false;  ///< a direction
};

/// The centre of the light.
[[nodiscard]] Eye eyeOf(const BakeOptions& options);

class OpaqueCasters final : public CasterSource {
  public:
    /// `casters` must outlive it.
    OpaqueCasters(CasterSource& casters, Eye eye) : casters_(casters), eye_(eye) {}
    Status visit(const CasterVisitor& visitor) override;

  private:
    CasterSource& casters_;
    Eye eye_;
};

}  // namespace mtsm::baseline
