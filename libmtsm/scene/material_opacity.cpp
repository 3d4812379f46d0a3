#include "scene/material_opacity.h"

#include <assimp/GltfMaterial.h>

#include <algorithm>
#include <cmath>
#include <string_view>

namespace mtsm::scene {
namespace {

float proportion(float x) {
    return std::isfinite(x) ? std::clamp(x, 0.0f, 1.0f) : 1.0f;
}

glm::vec3 proportions(const aiColor4D& colour) {
    return {proportion(colour.r), proportion(colour.g), proportion(colour.b)};
}

TextureWrap wrapOf(aiTextureMapMode mode) {
    switch (mode) {
        case aiTextureMapMode_Clamp:
        case aiTextureMapMode_Decal:
            return TextureWrap::clamp;
        case aiTextureMapMode_Mirror:
            return TextureWrap::mirror;
        default:
            return TextureWrap::repeat;
    }
}

/// Assimp turns counter-clockwise around the middle, scales, and moves. It states a glTF
/// texture's transform in these terms, but turns it the wrong way: after an example in
/// KHR_texture_transform's text, which contradicts the text. So the extension's own
/// offset is worked out again, and applied to coordinates with (0, 0) upper left: scaled,
/// turned counter-clockwise as seen on the image, moved.
UvTransform transformOf(const aiUVTransform& t, SourceFormat format) {
    const glm::dvec2 scale(t.mScaling.x, t.mScaling.y);
    const glm::dvec2 offset(t.mTranslation.x, t.mTranslation.y);
    const bool gltf = format == SourceFormat::gltf;
    const double turn = gltf ? -double(t.mRotation) : double(t.mRotation);
    const double c = std::cos(turn), s = std::sin(turn);
    UvTransform to;
    if (gltf) {
        const glm::dvec2 moved(offset.x - 0.5 * scale.x * (1.0 - c + s),
                               0.5 * scale.y * (s + c - 1.0) + 1.0 - scale.y - offset.y);
        // u' = c sx u + s sy (1 - v) + x and 1 - v' = -s sx u + c sy (1 - v) + y
        to.u = {c * scale.x, s * scale.x};
        to.v = {-s * scale.y, c * scale.y};
        to.offset = {moved.x + s * scale.y, 1.0 - moved.y - c * scale.y};
    } else {
        to.u = {c * scale.x, s * scale.y};
        to.v = {-s * scale.x, c * scale.y};
        to.offset = offset + 0.5 * scale - 0.5 * (to.u + to.v);
    }
    return to;
}

std::optional<TextureUse> textureOf(const aiMaterial& material, aiTextureType type,
                                    SourceFormat format) {
    aiString image;
    if (material.Get(AI_MATKEY_TEXTURE(type, 0), image) != aiReturn_SUCCESS ||
        image.length == 0)
        return std::nullopt;
    TextureUse use;
    use.image = image.C_Str();
    int channel = 0, modeU = aiTextureMapMode_Wrap, modeV = aiTextureMapMode_Wrap;
    int flags = 0;
    material.Get(AI_MATKEY_UVWSRC(type, 0), channel);
    material.Get(AI_MATKEY_MAPPINGMODE_U(type, 0), modeU);
    material.Get(AI_MATKEY_MAPPINGMODE_V(type, 0), modeV);
    material.Get(AI_MATKEY_TEXFLAGS(type, 0), flags);
    use.uvChannel = unsigned(std::max(0, channel));
    use.wrapU = wrapOf(aiTextureMapMode(modeU));
    use.wrapV = wrapOf(aiTextureMapMode(modeV));
    use.inverted = (flags & aiTextureFlags_Invert) != 0;
    aiUVTransform transform;
    if (material.Get(AI_MATKEY_UVTRANSFORM(type, 0), transform) == aiReturn_SUCCESS)
        use.transform = transformOf(transform, format);
    return use;
}

std::optional<TextureUse> colourTexture(const aiMaterial& material, SourceFormat format) {
    auto use = textureOf(material, aiTextureType_DIFFUSE, format);
    if (!use) use = textureOf(material, aiTextureType_BASE_COLOR, format);
    if (use) use->coloured = true;
    return use;
}

aiColor4D diffuseColour(const aiMaterial& material) {
    aiColor4D colour(1, 1, 1, 1);
    material.Get(AI_MATKEY_COLOR_DIFFUSE, colour);
    return colour;
}

MaterialOpacity gltfOpacity(const aiMaterial& material, std::string_view mode) {
    MaterialOpacity opacity;
    float transmission = 0.0f;
    material.Get(AI_MATKEY_TRANSMISSION_FACTOR, transmission);
    opacity.transmissive = transmission > 0.0f;
    if (mode == "OPAQUE") return opacity;
    // The diffuse colour is the base colour, or a specular-glossiness material's own.
    const aiColor4D colour = diffuseColour(material);
    opacity.value = proportion(colour.a);
    opacity.texture = colourTexture(material, SourceFormat::gltf);
    if (mode == "MASK") {
        float cutoff = 0.5f;
        material.Get(AI_MATKEY_GLTF_ALPHACUTOFF, cutoff);
        opacity.cutoff = std::isfinite(cutoff) ? std::max(0.0f, cutoff) : 0.5f;
        if (opacity.texture) opacity.texture->coloured = false;
    } else {
        opacity.tint = proportions(colour);
    }
    return opacity;
}

glm::vec3 tintOf(const aiMaterial& material, SourceFormat format) {
    aiColor4D filter(1, 1, 1, 1);
    if (format == SourceFormat::obj &&
        material.Get(AI_MATKEY_COLOR_TRANSPARENT, filter) == aiReturn_SUCCESS &&
        proportions(filter) != glm::vec3(1.0f))
        return proportions(filter);
    return proportions(diffuseColour(material));
}

}  // namespace

MaterialOpacity materialOpacity(const aiMaterial& material, SourceFormat format) {
    aiString mode;
    if (format == SourceFormat::gltf &&
        material.Get(AI_MATKEY_GLTF_ALPHAMODE, mode) == aiReturn_SUCCESS)
        return gltfOpacity(material, mode.C_Str());

    MaterialOpacity opacity;
    float stated = 1.0f;
    if (material.Get(AI_MATKEY_OPACITY, stated) == aiReturn_SUCCESS)
        opacity.value = proportion(stated);
    opacity.tint = tintOf(material, format);
    const auto colours = colourTexture(material, format);
    opacity.texture = textureOf(material, aiTextureType_OPACITY, format);
    if (opacity.texture) {
        opacity.texture->madeForOpacity = true;
        opacity.texture->coloured = colours && colours->image == opacity.texture->image;
    } else {
        opacity.texture = colours;
        opacity.guessed = colours.has_value();
    }
    const bool ownTexture = opacity.texture && !opacity.guessed;
    if (opacity.value == 0.0f && (ownTexture || format == SourceFormat::collada)) {
        opacity.value = 1.0f;
        opacity.takenForOpaque = !ownTexture;
    }
    return opacity;
}

}  // namespace mtsm::scene
