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

bool hasTexture(const aiMaterial& material, aiTextureType type) {
    return material.GetTextureCount(type) > 0;
}

MaterialOpacity gltfOpacity(const aiMaterial& material, std::string_view mode) {
    MaterialOpacity opacity;
    if (mode == "OPAQUE") return opacity;
    // The diffuse colour is the base colour, or a specular-glossiness material's own.
    aiColor4D colour(1, 1, 1, 1);
    material.Get(AI_MATKEY_COLOR_DIFFUSE, colour);
    opacity.value = proportion(colour.a);
    opacity.alphaTexture = hasTexture(material, aiTextureType_DIFFUSE) ||
                           hasTexture(material, aiTextureType_BASE_COLOR);
    if (mode == "MASK") {
        float cutoff = 0.5f;
        material.Get(AI_MATKEY_GLTF_ALPHACUTOFF, cutoff);
        opacity.value = opacity.value < cutoff ? 0.0f : 1.0f;
    }
    return opacity;
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
    opacity.alphaTexture = hasTexture(material, aiTextureType_OPACITY);
    if (format == SourceFormat::collada && opacity.value == 0.0f) {
        opacity.value = 1.0f;
        opacity.takenForOpaque = !opacity.alphaTexture;
    }
    return opacity;
}

}  // namespace mtsm::scene
