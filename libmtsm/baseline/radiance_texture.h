// radiance_texture.h - soft shadows on flat receivers as the average of hard shadow
// images, one from each of many points of the lights [Heckbert97].
//
//     auto casters = ShadowCasters::build(source);            // hard_shadow.h
//     RadianceLight key{light, glm::dvec3(10.0)};
//     const auto floor = parallelogramReceiver({corner, edgeX, edgeY});
//     auto textures = radianceTextures(*casters, {floor}, {key}, options);
//     if (!textures) return complain(textures.error());
//     (*textures)[0].radiance;                                 // [height][width]
//
// What a texel holds is the radiance that its centre reflects, once and diffusely
// [Heckbert97, eq. 1], in our symbols and with E_l for the irradiance by a light of
// radiance 1:
//
//     L = rho (ambient + sum over lights of L_l E_l / pi)
//     E_l = sum over the light's points of (area / n) cos cos' / r^2 reaches
//
// and beside it, for each light, the visibility: the plain mean of what reaches the texel
// from the points that shine towards it. Points below the receiver's horizon count as
// blocked; where no point of a light shines to, its visibility is 1. So visibility is 1
// minus the shadow factor of mtsm/shadow.h, for a receiver with a normal.
//
// Texture coordinates: u along edgeX, v along edgeY; rows run along u, the first one is
// at v = 0. World units; lights' radiances in any unit, which the textures then have.
// Results are the same for any number of threads; work runs in the caller's oneTBB arena.
#pragma once
#include <cstdint>
#include <functional>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "baseline/hard_shadow.h"
#include "baseline/light_grid.h"
#include "baseline/method.h"
#include "mtsm/light.h"
#include "mtsm/result.h"

namespace mtsm::baseline {

enum class ReceiverShape { parallelogram, triangle, polygon };

/// A flat receiver and the parallelogram around it that its texture covers [Heckbert97,
/// sec. 3.4].
struct RadianceReceiver {
    std::string name;
    ReceiverShape shape = ReceiverShape::parallelogram;
    PlanarReceiver plane;
    std::vector<glm::dvec2> outline;  ///< of a polygon: its corners in u and v
    glm::dvec3 reflectance{1.0};
    glm::uvec2 texels{0};  ///< of the texture; 0: as the options say

    /// Whether texture coordinates lie in the receiver; a triangle is the lower left half
    /// of its parallelogram, u + v <= 1.
    [[nodiscard]] bool contains(glm::dvec2 uv) const noexcept;
};

[[nodiscard]] RadianceReceiver parallelogramReceiver(const PlanarReceiver& plane);
/// The lit side is where the corners run counter-clockwise. The right angle, or what is
/// nearest to one, becomes the parallelogram's corner.
[[nodiscard]] RadianceReceiver triangleReceiver(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c);
/// Corners in order; the box around them lies along the longest edge. badArgument: fewer
/// than three, no area, or corners farther from a common plane than 1e-4 of their extent.
[[nodiscard]] Result<RadianceReceiver> polygonReceiver(
    const std::vector<glm::dvec3>& corners);

/// The flat faces of a mesh, in the world: coplanar triangles that share edges become one
/// parallelogram or polygon, all others stay triangles. Those of no area are left out.
[[nodiscard]] std::vector<RadianceReceiver> meshReceivers(const MeshView& mesh);

struct RadianceLight {
    AreaLight light;
    glm::dvec3 radiance{1.0};  ///< red, green, blue; see lightMeasure() for no area
};

/// How a texture may be drawn without being one [Heckbert97, sec. 3.8].
enum class Flatness { constant, linear, textured };
[[nodiscard]] const char* name(Flatness flatness) noexcept;

struct RadianceTexture {
    std::uint32_t width = 0, height = 0;
    std::vector<glm::vec3> radiance;             ///< [height][width]
    std::vector<std::vector<float>> visibility;  ///< [lights][height][width]
    /// [lights], of the samples that were asked for; 0 where light and receiver do not
    /// face each other [Heckbert97, sec. 3.6].
    std::vector<int> samples;
    /// Of the radiance within the receiver: the same all over, or linear in u and v
    /// (Gouraud shading then does), within RadianceOptions::flatTolerance.
    Flatness flatness = Flatness::textured;
    std::uint64_t looked = 0;  ///< triangles and segments that were transformed
};

struct RadianceOptions {
    double pixelSize = 0.0;  ///< side of a texel, world units; 0: as resolution says
    int resolution = 256;    ///< texels on the longer side
    int supersampling = 1;   ///< 1..16; hard shadows are finer by this on either side
    int samplesPerSide = 8;  ///< 1..kMaxGridSide, of each light's grid
    /// > 0: in place of samplesPerSide, per light and receiver, the smallest grid whose
    /// cells take at most so many steradians as seen from 9 x 9 points of the receiver
    /// [Heckbert97, sec. 3.7]; lights of no area keep samplesPerSide.
    double solidAngle = 0.0;
    LightGrid grid = LightGrid::jittered;
    std::uint32_t seed = 0;
    glm::dvec3 ambient{0.0};           ///< radiance that comes from everywhere
    double flatTolerance = 1 / 256.0;  ///< share of the texture's largest radiance
    bool cull = true;                  ///< see ShadowCasters::draw
    bool radiance = true;              ///< false: visibility alone
    /// Called after 1, 4, 16, ... samples of each light with the textures that these
    /// make [Heckbert97, sec. 3.9], and at the end, from the calling thread; an Error
    /// stops the work.
    std::function<Status(int samples, const std::vector<RadianceTexture>&)> refined;
};

/// Texels of a receiver's texture; kMaxResolution + 1 on a side that would have more.
[[nodiscard]] glm::uvec2 textureSize(const RadianceReceiver& receiver,
                                     const RadianceOptions& options) noexcept;

/// Two triangles that share a texture, or one and none.
struct TrianglePair {
    static constexpr std::size_t kNone = ~std::size_t(0);
    std::size_t first = 0, second = kNone;  ///< receivers
};

/// Puts triangles of similar size together, two by two, and gives both the larger one's
/// texels; radiance_pack.h packs what comes of them.
[[nodiscard]] std::vector<TrianglePair> pairTriangles(
    std::vector<RadianceReceiver>& receivers, const RadianceOptions& options);

/// One texture per receiver, in their order. Errors: badArgument (options, lights or
/// receivers out of range), tooLarge (more than 2^28 texels in a texture, supersampling
/// included, 32 GB in all, or not enough memory), what `refined` returns.
[[nodiscard]] Result<std::vector<RadianceTexture>> radianceTextures(
    const ShadowCasters& casters, const std::vector<RadianceReceiver>& receivers,
    const std::vector<RadianceLight>& lights, const RadianceOptions& options = {});

/// A value of a texture's size at texture coordinates: bilinear between texel centres.
[[nodiscard]] float lookUp(const std::vector<float>& values, glm::uvec2 size,
                           glm::dvec2 uv) noexcept;

}  // namespace mtsm::baseline
