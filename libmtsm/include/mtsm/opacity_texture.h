// opacity_texture.h - how opaque a surface is from point to point: leaves on cards,
// glass.
//
//     auto leaves = mtsm::OpacityTexture::create(image);
//     if (!leaves) return complain(leaves.error());
//     mesh.texture = &*leaves;                                  // mtsm/scene.h
//
// Texture coordinates: (0, 0) is the image's lower left corner, (1, 1) its upper right
// one. A texture never changes once made: any number of threads may look it up at once.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <vector>

#include "mtsm/result.h"

namespace mtsm {

enum class TextureWrap { repeat, clamp, mirror };

struct OpacityImage {
    static constexpr std::uint32_t kMostTexels = 16384;  ///< along a side

    std::uint32_t width = 0, height = 0;  ///< texels, each 1..kMostTexels
    std::uint32_t channels = 1;           ///< 1, or 3: how much of red, green and blue
    std::vector<float> texels;  ///< [height][width][channels], upper row first, in [0, 1]
    TextureWrap wrapU = TextureWrap::repeat, wrapV = TextureWrap::repeat;
    /// >= 0: what is at least this is opaque, all else is not there (a mask). Negative:
    /// texels are opacities.
    float cutoff = -1.0f;
    /// Of what is opaque by its texel, in [0, 1]: multiplies all that opacity() returns.
    float opacity = 1.0f;
};

class OpacityTexture {
  public:
    /// Errors (badArgument): sizes out of range, texels out of [0, 1] or not finite, an
    /// opacity out of [0, 1], a cutoff that is not finite.
    [[nodiscard]] static Result<OpacityTexture> create(OpacityImage image);

    [[nodiscard]] std::uint32_t channels() const noexcept { return channels_; }
    /// The mean opacity over the parallelogram around `uv` with the sides du and dv (how
    /// far uv moves from pixel to pixel), approximately: trilinear between mip levels.
    /// Magnified, a mask is a yes or no and its edge runs where the interpolated alpha
    /// meets the cutoff; minified it is the share of the footprint that is opaque. Writes
    /// channels() numbers in [0, 1]. Where uv is not finite: 1. Where a side is not: the
    /// mean over the whole texture.
    void opacity(glm::dvec2 uv, glm::dvec2 du, glm::dvec2 dv, float* out) const noexcept;
    /// What create() was given.
    [[nodiscard]] OpacityImage image() const;
    /// Some texel lets something through.
    [[nodiscard]] bool translucent() const noexcept { return translucent_; }
    /// Bytes that the levels take.
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    struct Level {
        std::uint32_t width = 0, height = 0;
        std::vector<float> texels;  // [height][width][channels]
    };
    OpacityTexture() = default;
    static Level halved(const Level& from, std::uint32_t channels);
    struct Probe {
        float u = 0, v = 0;   // in [0, 1], from the upper left corner
        bool decide = false;  // yes or no, by the alpha before the cutoff
    };
    template <int C>
    void addLevel(const Probe& probe, std::size_t index, float weight,
                  float* sum) const noexcept;
    template <int C>
    void lookUp(glm::dvec2 uv, glm::dvec2 du, glm::dvec2 dv, float* out) const noexcept;

    std::vector<Level> levels_;    // opacities; of a mask, shares that are opaque
    std::vector<float> original_;  // of a mask: level 0 before the cutoff
    std::uint32_t channels_ = 1;
    TextureWrap wrapU_ = TextureWrap::repeat, wrapV_ = TextureWrap::repeat;
    float cutoff_ = -1.0f, opacity_ = 1.0f;
    bool translucent_ = false;
};

}  // namespace mtsm
