// hard_shadow.h - the picture of a planar receiver from one point of a light: what of the
// light reaches each texel.
//
//     auto casters = ShadowCasters::build(source, warn);
//     const ShadowView view = shadowView(lightPoint, plane, false);
//     casters->draw(view, width, height, {}, reaches);   // 0 dark .. 1 lit, per texel
//
// The pyramid with the light's point as its apex and the receiver as its base is mapped
// to a box [Heckbert97, sec. 3.3]; triangles are scan-converted there by the rasteriser
// of the bake, which only asks for coordinates that are affine in the world: x, y and w.
// So its fill rule holds here, too, and its bounds: a texture has at most kMaxResolution
// texels on a side.
//
// Differs from the paper in the near plane: nothing is drawn but casters, and those must
// lie before the receiver by more than kTouching of the apex' height. So the receiver may
// be one of the casters.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <string>

#include "baseline/chunk_tree.h"
#include "baseline/light_grid.h"
#include "baseline/method.h"
#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

/// Casters that are nearer to the receiver's plane do not cast; a share of the height of
/// the light's point above it (of a sun: of the receiver's longer side).
inline constexpr double kTouching = 1e-5;

/// Maps (x, y, z, 1) to the homogeneous (x, y, 1, w): after the division by w, x and y
/// run from 0 to 1 over the receiver as seen from `apex`, and the third is 1 on the
/// receiver and infinite at the apex [Heckbert97, sec. 3.3]. The apex must not lie in the
/// receiver's plane.
[[nodiscard]] glm::dmat4 pyramidMatrix(glm::dvec3 apex,
                                       const PlanarReceiver& plane) noexcept;

/// How the world is seen from a light's point.
struct ShadowView {
    /// x, y and depth are row . (p - base) + (0, 0, depthAtBase). Depth is w of the
    /// pyramid; for a sun it grows towards the receiver, where it is 0, and is told in
    /// longer sides of the receiver.
    std::array<glm::dvec3, 3> rows;
    glm::dvec3 base{0.0};  ///< the receiver's corner: differences to it are exact
    double depthAtBase = 1.0;
    ProjectionKind kind = ProjectionKind::perspective;
    double near = 0.0, far = 0.0;  ///< depths that casters lie between
    glm::dvec3 origin{0.0};        ///< the apex; of a sun the unit vector towards it

    [[nodiscard]] glm::dvec3 operator()(glm::dvec3 p) const noexcept;
    /// The pyramid, cut off just before the receiver; of a sun a prism.
    [[nodiscard]] std::array<HalfSpace, 6> sides() const noexcept;
};

/// From a point of a finite light, or of a sun. It must lie before the receiver.
[[nodiscard]] ShadowView shadowView(const LightPoint& point, const PlanarReceiver& plane,
                                    bool sun) noexcept;

/// A copy of casters: triangles and strands. Volumes do not cast.
class ShadowCasters {
  public:
    /// `warn`, if not empty, is told what does not cast. Errors: what visit() returns,
    /// tooLarge beyond 2^32 vertices or without enough memory.
    static Result<ShadowCasters> build(
        CasterSource& source, const std::function<void(const std::string&)>& warn = {});
    ShadowCasters(ShadowCasters&&) noexcept;
    ShadowCasters& operator=(ShadowCasters&&) noexcept;
    ~ShadowCasters();

    /// Writes [height][width], first row at v = 0: the part of the light that reaches the
    /// texel's centre, the product of 1 - opacity over all crossings. Strands are ribbons
    /// that face the light's point; a segment's opacity is the mean of its two ends'.
    /// `cull`: what lies outside the pyramid is left out chunk by chunk; without, every
    /// caster is transformed and clipped, with the same result. Returns how many
    /// triangles and strand segments were looked at.
    std::uint64_t draw(const ShadowView& view, std::uint32_t width, std::uint32_t height,
                       bool cull, float* reaches) const;

    [[nodiscard]] std::uint64_t triangles() const noexcept;
    [[nodiscard]] std::uint64_t segments() const noexcept;
    [[nodiscard]] Box bounds() const noexcept;
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    struct Content;
    explicit ShadowCasters(std::unique_ptr<Content> content);
    std::unique_ptr<Content> content_;
};

}  // namespace mtsm::baseline
