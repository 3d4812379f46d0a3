// single_sample.h - soft shadows from one ray towards the light's centre [Parker98].
//
//     auto scene = SingleSampleScene::build(casters, spheres);
//     scene->shadowFactors(light, points, normals, count, out, options);
//
// Every object is taken for opaque and surrounded by a larger, outer one that fades out:
// what a ray passes at the distance d from the object loses light as
//     tau = d / b,   s = 3 tau^2 - 2 tau^3,   b = a D / A            [Parker98, sec. 3]
// with D the light's diameter, A the way to its centre and a the way to the object. So a
// penumbra is about as wide as it should be, starts with width 0 where the object touches
// the receiver, and moves without a jump; and it lies wholly outside of the object's hard
// shadow, so that shadows are too large, the more the smaller objects are. A rectangle
// counts as the disk of its area; the sun's D / A is twice the tangent of half its angle.
//
// Spheres are the paper's: a is the way t0 to the point nearest to the centre, and a
// sphere behind the receiver (t0 < 0) or behind the light's centre casts nothing, nor one
// with its centre behind a disk's or rectangle's plane; triangles are cut off there.
//
// Triangles. Let n be the triangle's unit normal, e a side's unit direction, v the ray's.
// Seen along v the outline is to grow by b all round, with rounded corners. A shift x of
// the side within the triangle's plane, along e x n, is seen as x |n . v| / |e x v|: that
// is x times the cosine between n and v projected across the side. So each side has an
// offset of its own, x = b / cos(n, v across e) in the triangle's plane. (The appendix
// has "proportional to the cosine": true of what is seen of a given x, and the only
// reading that makes the penumbra W wide.) We never build the outer triangle, for edge-on
// its offsets have no bound. A point q of the triangle is seen from the receiver under
// the angle phi off the ray, tan phi = d(q) / a(q), so with k = D / A
//     tau = min over q of d(q) / b(q) = (distance of the ray from the triangle's image
//           on the plane at distance 1 in front of the receiver) / k.
// That is the outer triangle with b taken at each point's own distance instead of one for
// all: penumbrae of walls start with width 0 at the floor, and nothing jumps as the
// triangle turns through edge-on.
//
// The tree is grown_tree.h's. With the composition `minimum` of opaque objects the ray
// gets narrower as soon as something is found, for only what is nearer to it matters, and
// what is near to it is looked at first. The other compositions look at every triangle
// that the whole cone meets: of a fine mesh under a large light, thousands.
//
// A closed mesh must not shadow its own lit side. With a normal, only what lies above the
// receiver's tangent plane casts; a light whose centre is below it is blocked. Without
// one, the own surface darkens where the ray leaves it at a slope of less than D / A.
//
// Casters that let light through take their opacity of the light instead of all of it; of
// a texture what it says at the point nearest to the ray, averaged over b. Strands and
// volumes are not cast: a hair is far thinner than a light, and as an opaque inner object
// with a full penumbra round it, fur would be black.
#pragma once
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <vector>

#include "baseline/grown_tree.h"
#include "light/sample.h"
#include "mtsm/light.h"
#include "mtsm/opacity_texture.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm::baseline {

/// From a receiver towards the light's centre.
struct CentreRay {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{0.0, 0.0, 1.0};  ///< unit
    double reach = std::numeric_limits<double>::infinity();
    double growth = 0.0;     ///< k = D / A >= 0: the penumbra's width per unit of way
    double nearest = 1e-12;  ///< > 0: what is nearer on the ray does not count
    /// Unit or zero: what lies below this plane through the origin does not count. The
    /// ray leaves upwards.
    glm::dvec3 normal{0.0};
    /// Where a light shines to one side only: unit, out of the light, which lies at
    /// `lightAt` on the ray; what lies behind the light's plane does not count.
    glm::dvec3 shines{0.0};
    double lightAt = std::numeric_limits<double>::infinity();
};

/// s = 3 tau^2 - 2 tau^3, and 0 or 1 outside of [0, 1].
[[nodiscard]] double penumbra(double tau) noexcept;

/// 0 in the umbra, 0..1 in the penumbra, above that outside.
[[nodiscard]] double tauOfSphere(const CentreRay& ray, glm::dvec3 centre,
                                 double radius) noexcept;
[[nodiscard]] double tauOfTriangle(const CentreRay& ray,
                                   const std::array<glm::dvec3, 3>& corners) noexcept;

struct SoftSphere {
    glm::dvec3 centre{0.0};
    double radius = 0.0;  ///< > 0
    float opacity = 1.0f;
};

/// How the shadows of several objects come together [Parker98, sec. 3]. A mesh is one
/// object, however finely it is cut: the darkest of its triangles counts.
enum class Compose {
    minimum,   ///< never darker than the darkest
    multiply,  ///< s = s1 s2
    add        ///< s = 1 - ((1 - s1) + (1 - s2)), at least 0
};

/// What a search has to find; the answers are the same.
enum class GrownBounds {
    cone,    ///< boxes that the cone of slope D / A meets
    largest  ///< boxes grown by b's bound D all round, as the paper has it
};

struct SingleSampleOptions {
    Compose compose = Compose::minimum;
    GrownBounds bounds = GrownBounds::cone;
    bool hard = false;  ///< plain shadow rays to the light's centre
    /// Rays start this far from the receiver, along its normal if there is one, as a
    /// share of how far the casters reach in that direction from their first corner: what
    /// floats lose. A large ground does not count for a receiver that lies flat on it.
    double offset = 2e-6;
};

/// What batches did: each adds to what is there.
struct SingleSampleWork {
    std::atomic<std::uint64_t> rays{0}, nodes{0}, objects{0};
};

class SingleSampleScene {
  public:
    /// Holds a copy of all meshes. unsupported if there is neither a sphere nor a
    /// triangle to cast; tooLarge above 2^32 of them or without enough memory.
    static Result<SingleSampleScene> build(CasterSource& casters,
                                           const std::vector<SoftSphere>& spheres = {});

    /// Conventions of mtsm/shadow.h; `normals` may be null, one that is zero is none.
    void shadowFactors(const AreaLight& light, const glm::dvec3* points,
                       const glm::dvec3* normals, std::size_t count, float* out,
                       const SingleSampleOptions& options = {},
                       SingleSampleWork* work = nullptr) const noexcept;

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    struct Triangle {
        std::array<glm::vec3, 3> corners;  // relative to origin_
        std::uint32_t material;
    };
    struct Material {
        float opacity = 1.0f;
        std::optional<OpacityTexture> texture;
    };
    using Corners = std::array<glm::vec2, 3>;  // texture coordinates
    struct Search;

    SingleSampleScene() = default;
    Status add(const MeshView& mesh);
    void add(const SoftSphere& sphere);
    void place(glm::dvec3 world);
    void plant();
    [[nodiscard]] float shadow(const light::LightSampler& sampler, double diameter,
                               glm::dvec3 point, glm::dvec3 normal,
                               const SingleSampleOptions& options,
                               SingleSampleWork* work) const noexcept;
    [[nodiscard]] std::optional<CentreRay> centreRay(
        const light::LightSampler& sampler, double diameter, glm::dvec3 point,
        glm::dvec3 normal, const SingleSampleOptions& options) const noexcept;

    glm::dvec3 origin_{0.0};
    bool hasOrigin_ = false;
    glm::dvec3 low_{std::numeric_limits<double>::infinity()};  // world
    glm::dvec3 high_{-std::numeric_limits<double>::infinity()};
    std::vector<Triangle> triangles_;
    std::vector<Corners> uvs_;  // [triangles], or empty if nothing is textured
    std::vector<SoftSphere> spheres_;
    std::vector<Material> materials_;
    GrownTree triangleTree_, sphereTree_;
};

}  // namespace mtsm::baseline
