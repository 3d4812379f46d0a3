// material_opacity.h - how much light a material stops, as far as one number can say.
#pragma once
#include <assimp/material.h>

#include "scene/assimp_scene.h"

namespace mtsm::scene {

struct MaterialOpacity {
    float value = 1.0f;         ///< in [0, 1]
    bool alphaTexture = false;  ///< the material also has a texture with alpha; not used
    bool takenForOpaque = false;  ///< the file says 0, which is not believed
};

/// glTF: 1 for OPAQUE, whatever the alpha; the base colour's alpha for BLEND; for MASK 0
/// or 1, by the cutoff. Textures are not looked at: alphaTexture says that one could have
/// made a difference.
///
/// COLLADA: an opacity of 0 is taken for 1. Exporters have long disagreed on which end of
/// <transparency> is clear, and a material that nobody can see is seldom meant.
/// With a texture for it, which is not looked at, that is no surprise and no oddity.
///
/// Everything else: what the file calls opacity (OBJ's d and Tr, FBX's Opacity); 1 where
/// it says nothing, or nothing finite.
[[nodiscard]] MaterialOpacity materialOpacity(const aiMaterial& material,
                                              SourceFormat format);

}  // namespace mtsm::scene
