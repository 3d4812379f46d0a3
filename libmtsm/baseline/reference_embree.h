// reference_embree.h - the truth that maps are measured against: stochastic ray tracing
// of the casters themselves [Cook84], with Embree.
//
//     auto truth = mtsm::baseline::EmbreeReference::build(casters);
//     truth->shadowFactors(light, points, normals, count, out, options);
//
// Same conventions as shadow.h: world units, shadow factor 0 lit to 1 dark, points of the
// light below the horizon count as blocked. Light samples come from the same sampler as
// the map's, with another seed. Constant opacities multiply up along a ray.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>

#include "mtsm/light.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"

namespace mtsm::baseline {

struct ReferenceOptions {
    int samples = 4096;  ///< 1..kMaxSamples; the truth takes 4096
    std::uint32_t seed = 0x7472u;
    Weight weight = Weight::uniform;
    /// Rays start this far from the receiver, along its normal if there is one, as a
    /// share of the diagonal of the casters' bounds.
    double offset = 1e-5;
};

class EmbreeReference {
  public:
    /// Holds a copy of all triangles. Errors: what visit() returns, badFile if Embree
    /// fails.
    static Result<EmbreeReference> build(CasterSource& casters);
    EmbreeReference(EmbreeReference&&) noexcept;
    EmbreeReference& operator=(EmbreeReference&&) noexcept;
    ~EmbreeReference();

    /// Bounds of the casters, world.
    [[nodiscard]] glm::dvec3 boundsMin() const noexcept;
    [[nodiscard]] glm::dvec3 boundsMax() const noexcept;

    /// As mtsm::shadowFactors: normals may be null. Runs in the caller's oneTBB arena.
    void shadowFactors(const AreaLight& light, const glm::dvec3* points,
                       const glm::dvec3* normals, std::size_t count, float* out,
                       const ReferenceOptions& options = {}) const noexcept;

    /// What a ray meets first, for position passes.
    struct Hit {
        glm::dvec3 position{0.0};
        glm::dvec3 normal{
            0.0};  ///< unit, of the triangle, turned to where the ray came from
    };
    /// `direction` need not be a unit vector.
    [[nodiscard]] std::optional<Hit> firstHit(glm::dvec3 origin,
                                              glm::dvec3 direction) const noexcept;

  private:
    struct Scene;
    explicit EmbreeReference(std::unique_ptr<Scene> scene);
    std::unique_ptr<Scene> scene_;
};

}  // namespace mtsm::baseline
