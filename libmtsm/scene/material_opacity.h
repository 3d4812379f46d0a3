// material_opacity.h - how much light a material stops, as its file says it.
#pragma once
#include <assimp/material.h>

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>

#include "mtsm/opacity_texture.h"
#include "scene/assimp_scene.h"

namespace mtsm::scene {

/// Texture coordinates of a mesh to those of an image, both with (0, 0) lower left.
struct UvTransform {
    glm::dvec2 u{1, 0}, v{0, 1};  ///< where the unit vectors go
    glm::dvec2 offset{0, 0};

    [[nodiscard]] glm::dvec2 operator()(glm::dvec2 uv) const {
        return uv.x * u + uv.y * v + offset;
    }
};

/// An image that opacity is read from.
struct TextureUse {
    std::string image;   ///< as the file names it; "*2": the third that is embedded in it
    bool given = false;  ///< by the caller, not by the file: `image` is a path
    /// It was made for opacities. Then they are its alpha, or its brightness where it has
    /// no alpha channel or one that is 1 all over. Else it holds colours, and only alpha
    /// counts.
    bool madeForOpacity = false;
    bool coloured = false;  ///< its colours tint what passes
    bool inverted = false;
    TextureWrap wrapU = TextureWrap::repeat, wrapV = TextureWrap::repeat;
    unsigned uvChannel = 0;
    UvTransform transform;
};

struct MaterialOpacity {
    float value = 1.0f;  ///< in [0, 1]; what a texture says is multiplied by it
    /// >= 0: what is at least this, value and texture multiplied, is opaque, all else is
    /// not there.
    float cutoff = -1.0f;
    glm::vec3 tint{1.0f};  ///< of what passes; a coloured texture is multiplied by it
    std::optional<TextureUse> texture;
    bool guessed = false;  ///< the file does not say that the texture's alpha counts
    bool takenForOpaque = false;  ///< the file says 0, which is not believed
    bool transmissive = false;    ///< glass by KHR_materials_transmission

    /// What a point of this alpha (value and texture multiplied) stops.
    [[nodiscard]] float cut(float alpha) const {
        if (cutoff < 0.0f) return alpha;
        return alpha >= cutoff ? 1.0f : 0.0f;
    }
};

/// glTF: 1 for OPAQUE, whatever the alpha; the base colour's alpha, texture times factor,
/// for BLEND; for MASK the same and a cutoff. The tint is the base colour; masks have
/// none.
///
/// Everything else: what the file calls opacity (OBJ's d and Tr, FBX's Opacity,
/// COLLADA's transparency), 1 where it says nothing, or nothing finite; and the texture
/// that it has for it (OBJ's map_d, FBX's TransparentColor, COLLADA's transparent).
/// Without one the colour texture (OBJ's map_Kd) is tried, for most exporters of foliage
/// leave the alpha there and say no word about it: `guessed`. The tint is OBJ's Tf, or
/// where that is white, and in all other formats, the diffuse colour.
///
/// An opacity of 0 with a texture for it is taken for 1: so some exporters write that the
/// texture is all that counts. In COLLADA it is also without one: exporters have long
/// disagreed on which end of <transparency> is clear, and a material that nobody can see
/// is seldom meant.
[[nodiscard]] MaterialOpacity materialOpacity(const aiMaterial& material,
                                              SourceFormat format);

}  // namespace mtsm::scene
