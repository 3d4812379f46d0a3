// reference_embree.h - the truth that maps are measured against: stochastic ray tracing
// of the casters themselves [Cook84], with Embree.
//
//     auto truth = mtsm::baseline::EmbreeReference::build(casters);
//     truth->shadowFactors(light, points, normals, count, out, options);
//
// Same conventions as shadow.h: world units, shadow factor 0 lit to 1 dark, points of the
// light below the horizon count as blocked. Light samples come from the same sampler as
// the map's, with another seed.
//
// What a ray crosses multiplies up. Meshes: their opacity, or their texture's at the hit,
// magnified. Strands: ribbons that face the ray, as Embree's flat linear curves, with
// flat ends and round joints; a strand that is met in consecutive segments is crossed
// once. A strand does not shadow what lies within it, taken as round: so a point on a
// strand is not shadowed by that place of the strand.
// Volumes: exp(-optical depth), exact for voxels of constant density.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <string>

#include "light/sample.h"
#include "mtsm/light.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"

namespace mtsm::baseline {

struct ReferenceOptions {
    int samples = 4096;  ///< 1..kMaxSamples; the truth takes 4096
    std::uint32_t seed = 0x7472u;
    Weight weight = Weight::uniform;
    /// Rays start off the receiver by this share of how far the casters reach from it
    /// along its normal, or along the way to the light if it has none (rayOffset()): 64
    /// units of float there. So a wide floor does not lift the rays off itself.
    double offset = 0x1p-18;
};

/// A point that looks at a light: at samples first + order[0..count) of its sequence.
struct LightLook {
    glm::dvec3 point{0.0};
    glm::dvec3 normal{0.0};  ///< unit; zero: none
    std::uint64_t key = 0;   ///< of the sequence
    std::uint32_t first = 0;
};

/// What it saw there.
struct LightSeen {
    glm::dvec3 visible{0.0};  ///< sum of weight times visibility, per channel
    double total = 0.0;       ///< sum of weights
    std::uint32_t clear = 0;  ///< samples with a visibility of 1
    std::uint32_t dark = 0;   ///< with 0, those below the horizon among them
};

/// Embree's own, of the library that runs: "3.13.5".
[[nodiscard]] std::string embreeVersion();

class EmbreeReference {
  public:
    /// Holds a copy of all casters. Not `robust`, rays may slip between two triangles:
    /// faster, not for a truth. Errors: what visit() returns, tooLarge if memory runs
    /// out, badFile if Embree fails.
    static Result<EmbreeReference> build(CasterSource& casters, bool robust = true);
    EmbreeReference(EmbreeReference&&) noexcept;
    EmbreeReference& operator=(EmbreeReference&&) noexcept;
    ~EmbreeReference();

    /// Bounds of the casters, world: of vertices that triangles use, of strands without
    /// their width.
    [[nodiscard]] glm::dvec3 boundsMin() const noexcept;
    [[nodiscard]] glm::dvec3 boundsMax() const noexcept;
    [[nodiscard]] bool hasVolumes() const noexcept;
    /// What the casters and Embree's tree over them take, and took at most while it was
    /// built.
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;
    [[nodiscard]] std::uint64_t peakBytes() const noexcept;

    /// As mtsm::shadowFactors: normals may be null; one that is zero is none. Runs in the
    /// caller's oneTBB arena. Tints do not count; of a coloured texture the mean does.
    void shadowFactors(const AreaLight& light, const glm::dvec3* points,
                       const glm::dvec3* normals, std::size_t count, float* out,
                       const ReferenceOptions& options = {}) const noexcept;
    /// The same in red, green and blue, with casters that tint the light.
    void shadowFactors(const AreaLight& light, const glm::dvec3* points,
                       const glm::dvec3* normals, std::size_t count, glm::vec3* out,
                       const ReferenceOptions& options = {}) const noexcept;
    /// Adds to seen[i] what looks[i] sees of the samples first + order[0..count), for
    /// `lookCount` looks that follow each other in a picture: rays to few samples share
    /// streams with those of the next look. `order` is best from neighbourOrder(). On the
    /// caller's thread; the same looks give the same sums, bit by bit. Of the options
    /// `weight` and `offset` count.
    void look(const light::LightSampler& sampler, const LightLook* looks,
              std::size_t lookCount, const std::uint32_t* order, std::size_t count,
              LightSeen* seen, bool color,
              const ReferenceOptions& options) const noexcept;
    /// What is left, per channel, of light that goes along `delta`, or on for ever in its
    /// direction if `endless`. Without `color` all three are as in shadowFactors. A ray
    /// of no length, or one that is not finite, is clear.
    [[nodiscard]] glm::vec3 visibility(glm::dvec3 from, glm::dvec3 delta,
                                       bool endless = false,
                                       bool color = false) const noexcept;

    /// What a ray meets first, for position passes: a mesh where its texture has no hole,
    /// or a strand. Rays pass through volumes.
    struct Hit {
        glm::dvec3 position{0.0};
        /// Unit, turned to where the ray came from: of the triangle, or across the strand
        /// as far as that is possible towards the ray's origin.
        glm::dvec3 normal{0.0};
        bool strand = false;
        double width = 0.0;  ///< of the strand there
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
