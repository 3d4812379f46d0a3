// send_materials.h - what becomes of a file's materials: opacities, tints, and textures,
// which are sent ahead of the meshes; inside the importing child.
#pragma once
#include <assimp/scene.h>

#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <set>
#include <string>
#include <vector>

#include "mtsm/scene.h"
#include "scene/alpha_image.h"
#include "scene/frames.h"
#include "scene/material_opacity.h"

namespace mtsm::scene {

/// Materials that share an oddity, for one warning about all of them.
class OddMaterials {
  public:
    void add(const aiMaterial& material) { names_.insert(material.GetName().C_Str()); }
    /// `"one", "two" and 8 more`; empty without any.
    [[nodiscard]] std::string list(std::size_t most) const;
    /// Sends `path: material "name" and 2 more: what`.
    void warn(const std::string& path, const char* what, FrameWriter& out) const;

  private:
    std::set<std::string> names_;
};

/// A material as it casts.
struct CastMaterial {
    float opacity = 1.0f;  // where there is no texture
    glm::vec3 tint{1.0f};
    std::uint32_t texture = kNoTexture;
    unsigned uvChannel = 0;
    UvTransform transform;
};

class Materials {
  public:
    Materials(const std::string& path, const aiScene& scene, SourceFormat format,
              const MeshFileOptions& options, FrameWriter& out);

    /// Says that the mesh will be sent; its material's image will be read.
    void use(const aiMesh& mesh);
    /// Reads the images, each once, and sends a texture for each way that one is used.
    /// Fails (io) if one that the caller gave cannot be read.
    [[nodiscard]] Status sendTextures();
    [[nodiscard]] const CastMaterial& of(const aiMesh& mesh) const {
        return cast_[mesh.mMaterialIndex];
    }
    /// [vertex]; none without a texture, or where the mesh has no texture coordinates.
    [[nodiscard]] std::vector<glm::vec2> uvs(const aiMesh& mesh) const;
    /// Sends what was odd.
    void warn() const;

  private:
    /// Materials that need one image, and what of it.
    struct Job {
        std::string image;  // path, or "*2"
        AlphaWanted wanted;
        std::vector<unsigned> materials;
    };
    void replaceTextures();
    void plan(unsigned material);
    [[nodiscard]] Result<AlphaImage> read(const Job& job) const;
    void finish(const Job& job, const AlphaImage& image);
    [[nodiscard]] OpacityImage textureOf(unsigned material,
                                         const AlphaImage& image) const;
    void castConstant(unsigned material);
    void complain(unsigned material, const std::string& image, const std::string& why);

    const std::string& path_;
    const aiScene& scene_;
    const MeshFileOptions& options_;
    FrameWriter& out_;
    std::vector<MaterialOpacity> stated_;  // [material]
    std::vector<CastMaterial> cast_;       // [material]
    std::vector<bool> used_, planned_;     // [material]
    bool asCollada_ = false;               // texture coordinates without images are odd
    std::vector<Job> jobs_;
    std::uint32_t sent_ = 0;
    std::size_t complaints_ = 0;
    OddMaterials noAlpha_, noUvs_, noImage_, guessed_;
    std::vector<std::string> unmatched_;  // patterns of options_.textures
};

}  // namespace mtsm::scene
