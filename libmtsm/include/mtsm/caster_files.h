// caster_files.h - casters of every kind, from a list of files.
//
//     std::vector<mtsm::CasterFile> files(2);
//     files[0].path = "head.glb";
//     files[1].path = "fur.hair";
//     files[1].hairWidth = 0.002f;
//     mtsm::CasterFiles casters(files);
//     auto baked = mtsm::bake(casters, bakeOptions);          // mtsm/bake.h
//
// A file's extension says what it holds: .hair and .tfx strands, .vdb a fog volume,
// everything else meshes (an OBJ may hold strands as well: its polylines). Each file has
// settings of its own and may be moved in the world.
#pragma once
#include <cstdint>
#include <functional>
#include <glm/mat4x4.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm {

enum class CasterKind { mesh, hair, volume };

/// By the extension, in any case.
[[nodiscard]] CasterKind casterKind(const std::string& path);
/// Whether a file of this name may hold casters of that kind: an OBJ may hold two kinds.
[[nodiscard]] bool mayHold(const std::string& path, CasterKind kind);

/// A file and what is to be made of it. Settings that are not of the file's kind must be
/// left as they are here.
struct CasterFile {
    std::string path;
    /// world = transform * the file's; affine, invertible. Widths of strands that are the
    /// file's or the default grow by the cube root of its determinant; the extinction of
    /// a volume stays what it is per world unit of length, so smoke made larger stops
    /// more.
    glm::dmat4 transform{1.0};

    // Meshes: see MeshFileOptions.
    std::optional<float> opacity;
    std::vector<std::string> include, exclude;
    std::vector<MaterialTexture> textures;

    // Strands: see HairFileOptions; but these widths are in world units, whatever
    // transform and hairScale are. With width 0 strands cast nothing.
    std::optional<float> hairWidth, hairTipWidth, hairOpacity;
    float hairScale = 1.0f;

    // Volumes: see VolumeFileOptions.
    std::string densityGrid;
    float densityScale = 1.0f;
};

/// Refuses (badArgument; the message names file and setting) what visit() would refuse
/// without a look into the file: settings out of range or not of the file's kind.
Status checkCaster(const CasterFile& file);

struct CasterFilesOptions {
    bool color = false;  ///< casters tint the light: see MeshFileOptions
    /// Kept between visits, over all files: whole files, in their order, while they fit.
    std::uint64_t cacheBytes = std::uint64_t(1) << 30;
    std::uint64_t importerBytes = std::uint64_t(16) << 30;  ///< see MeshFileOptions
    std::function<void(const std::string&)> warn;           ///< see MeshFileOptions
    std::function<bool(const std::string&)> progress;       ///< see MeshFileOptions
};

/// The casters of all files, one file after another. Mesh files whose settings are the
/// same stand together where the first of them does, and `include` must be met by one
/// of them only.
///
/// visit() fails as checkCaster() does, and as the readers do: mtsm/scene.h,
/// mtsm/hair_files.h, mtsm/volume_files.h.
class CasterFiles final : public CasterSource {
  public:
    explicit CasterFiles(std::vector<CasterFile> files, CasterFilesOptions options = {});
    ~CasterFiles() override;
    Status visit(const CasterVisitor& visitor) override;

    CasterFiles(const CasterFiles&) = delete;
    CasterFiles& operator=(const CasterFiles&) = delete;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace mtsm
