// ray_query.h - the visibility of many rays of a caller's at once, through a map's trees.
//
// A ray is followed in each face that it is in, from its deeper end to its shallower one.
// Rays of one origin that follow each other, a run, share their way, up to 256 of them;
// others go by up to 16. A ray's answer depends on that ray alone, or, if its spread is
// given, on its run: never on what else is asked.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/shadow.h"
#include "shadow/map_faces.h"
#include "trace/density_trace.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

namespace mtsm::shadow {

class RayQuery {
  public:
    /// Can it answer such queries at all? Makes the map's trees. While there are layers
    /// it leaves single rays through opaque maps to the definition, which is as fast
    /// (tests/bench/NOTES.md).
    [[nodiscard]] static bool serves(const ShadowMap& map, const RayOptions& options);
    /// `treesAlone`: nothing is left to the definition, as where there are no layers.
    RayQuery(const ShadowMap& map, const RayOptions& options,
             bool treesAlone = false) noexcept;

    /// Most rays of one call of look().
    static constexpr std::size_t kAtOnce = 256;
    /// Where calls of look() should begin, so that none cuts a run that need not be cut;
    /// the last is `count`.
    [[nodiscard]] static std::vector<std::size_t> beginnings(const ShadowRay* rays,
                                                             std::size_t count);
    /// The visibilities of the map's channels; those that it has not are the first.
    void look(const ShadowRay* rays, std::size_t count, glm::vec3* out) const noexcept;

    /// A part of a ray in one face, in straight space (trace/bundle.h).
    struct Piece {
        std::uint32_t ray;
        std::uint32_t place;  ///< of its way among those of its run
        bool shares;          ///< its start is the ray's origin, whatever its way
        float start[3], way[3], begin;
    };
    /// What becomes of a ray.
    struct Fate {
        bool blocked = false;
        bool alone = false;  ///< to be followed by the definition, through layers
        float depth[3] = {};
    };

  private:
    struct Face {
        const Projection* projection;
        glm::dmat3 turn;           // world to light space
        double nearest, farthest;  // depths beyond which there is nothing
        double furthest;           // from the eye, of a start that floats resolve
        const NearField* nearField;
        float nearPerW, nearConstant;      // its depth, in w
        float spreadPerZ, spreadConstant;  // of rays that start at depth z
        float highest;                     // w of nearest
        const trace::PatchTree* patches;
        const trace::DensityTree* density;
        bool empty;
    };
    class Bundle;

    [[nodiscard]] bool isSeen(const Face& face, glm::dvec3 inLight) const noexcept;
    [[nodiscard]] RayPart partOf(std::uint32_t face, const ShadowRay& ray, glm::dvec3 o,
                                 glm::dvec3 d) const noexcept;
    [[nodiscard]] std::optional<Piece> pieceOf(std::uint32_t face, const ShadowRay& ray,
                                               Fate& fate) const noexcept;
    void followAll(const Face& face, const ShadowRay* rays, Piece* pieces,
                   std::size_t count, Fate* fates) const noexcept;

    const ShadowMap& map_;
    RayOptions options_;
    trace::ZBias bias_;
    float threshold_;
    bool treesAlone_;
    float border_ = 0.0f;  // as of LightRays, of several faces
    std::uint32_t faceCount_;
    Face faces_[6];
};

}  // namespace mtsm::shadow
