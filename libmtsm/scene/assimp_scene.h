// assimp_scene.h - a file through Assimp, inside the importing child.
#pragma once
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <cstdint>
#include <glm/mat4x4.hpp>
#include <string>

#include "scene/frames.h"

namespace mtsm::scene {

/// Formats whose conventions Assimp passes on as they are.
enum class SourceFormat { collada, gltf, obj, other };

/// A scene as Assimp reads it, without any post-processing.
class AssimpScene {
  public:
    /// Reads `path`. If that fails, or if the importer says that it met indices that are
    /// out of range (it leaves such faces out), sends the failure to `out`, and scene()
    /// is null. What else the importer logs as an error is sent as one warning.
    AssimpScene(const std::string& path, FrameWriter& out);

    [[nodiscard]] const aiScene* scene() const { return scene_; }
    [[nodiscard]] SourceFormat format() const;

  private:
    Assimp::Importer importer_;
    const aiScene* scene_ = nullptr;
};

[[nodiscard]] glm::dmat4 toDouble(const aiMatrix4x4& m);

}  // namespace mtsm::scene
