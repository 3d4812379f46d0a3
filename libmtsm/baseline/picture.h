// picture.h - the points that a comparison shades: what a camera sees, or a position
// pass.
//
//     auto scene = EmbreeReference::build(casters);
//     const Camera camera = Camera::framing(scene->boundsMin(), scene->boundsMax());
//     const Picture picture = takePicture(camera, *scene, nullptr);
//     method->shadowFactors(light, picture.receivers(), settings, out);
//
// World units, angles in radians.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <vector>

#include "baseline/method.h"
#include "baseline/reference_embree.h"
#include "mtsm/result.h"

namespace mtsm::baseline {

struct Camera {
    glm::dvec3 position{0.0}, target{0.0, 0.0, -1.0}, up{0.0, 1.0, 0.0};
    double fov = 0.7;  ///< full, across the larger side, in (0, pi)
    std::uint32_t width = 600, height = 300;
    /// Points per side of a pixel, jittered; 1: one, in the middle.
    int pointsPerSide = 1;

    /// Looks at a box from slightly above, a little from the right; its corners fill nine
    /// tenths of the picture.
    [[nodiscard]] static Camera framing(glm::dvec3 low, glm::dvec3 high,
                                        std::uint32_t width = 600,
                                        std::uint32_t height = 300);
};

/// Refuses (badArgument) a camera that cannot see: no distance to the target, `up` along
/// the view, a field of view out of range, no pixels.
Status checkCamera(const Camera& camera);

/// Pixels that see something, in an order in which neighbours follow each other (a
/// Z-order curve), and their points.
struct Picture {
    /// Pixels that follow each other in samples of a picture: 8 x 8 of them.
    static constexpr std::size_t kRun = 64;

    std::uint32_t width = 0, height = 0;
    std::vector<glm::dvec3> points, normals, starts;  ///< as Receivers has them
    std::vector<std::size_t> first{0};                ///< [pixels + 1]
    std::vector<std::uint32_t> pixel;                 ///< [pixels], y * width + x
    /// [pixels]: 1 where at least half of the points lie on a caster.
    std::vector<std::uint8_t> object;

    [[nodiscard]] std::size_t pixels() const noexcept { return pixel.size(); }
    [[nodiscard]] Receivers receivers() const noexcept;
    /// Some of its pixels, in the order given.
    [[nodiscard]] Picture part(const std::vector<std::size_t>& pixels) const;
    /// Runs of `run` pixels that follow each other, spread over the picture: `count`
    /// pixels in all, or all that there are.
    [[nodiscard]] std::vector<std::size_t> spread(std::size_t count,
                                                  std::size_t run) const;
    /// The mean over each pixel's points; NaN where one is NaN.
    [[nodiscard]] std::vector<float> pixelMeans(const std::vector<float>& values) const;
    /// [height][width]: values of the pixels in their places, `nothing` elsewhere.
    [[nodiscard]] std::vector<float> image(const std::vector<float>& values,
                                           float nothing) const;
    /// For each pixel the mean cosine between its normals and the way to the light's
    /// centre, at least 0; 1 where there is no normal.
    [[nodiscard]] std::vector<float> cosines(const AreaLight& light) const;
};

/// What a camera sees of casters and, if not null, of receivers that cast nothing. On
/// meshes the normal is the triangle's, turned to the camera. On strands there is none,
/// and `starts` lies a tenth of its width off it. In volumes points lie where light
/// from the camera would scatter, without a normal. The same picture for any number of
/// threads. `progress` is called with the share that is done.
[[nodiscard]] Picture takePicture(const Camera& camera, const EmbreeReference& casters,
                                  const EmbreeReference* receivers,
                                  const std::function<void(double)>& progress = {});

/// Points of a position pass, one a pixel: [height][width] positions, `surface` 0 where
/// there is none, normals of any length, or none at all. Points lie as far above their
/// surface as floats may have rounded them. What is caster and what is not cannot be
/// told: all count as object.
[[nodiscard]] Picture pictureOfPass(std::uint32_t width, std::uint32_t height,
                                    const std::vector<glm::vec3>& positions,
                                    const std::vector<std::uint8_t>& surface,
                                    const std::vector<glm::vec3>& normals);

}  // namespace mtsm::baseline
