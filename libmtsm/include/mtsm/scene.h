// scene.h - casters: geometry that goes into a map.
//
//     mtsm::MeshFileOptions options;
//     options.exclude = {"floor*"};
//     mtsm::MeshFiles casters({"hero.glb", "props.obj"}, options);
//     auto baked = mtsm::bake(casters, bakeOptions);          // mtsm/bake.h
//
// A caster source hands its meshes over one after another and may be asked more than once
// (for bounds, for the window, for rasterising): the same meshes come in the same order
// every time. Files are read in a child process, because importers die on some broken
// files: a file that kills its importer is an Error like any other.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "mtsm/light.h"
#include "mtsm/result.h"

namespace mtsm {

/// Triangles in object space and where they stand in the world. Pointers are borrowed for
/// the duration of a call.
struct MeshView {
    const glm::vec3* positions = nullptr;  ///< [vertexCount], object space
    std::size_t vertexCount = 0;
    const std::uint32_t* indices = nullptr;  ///< [3 * triangleCount], each < vertexCount
    std::size_t triangleCount = 0;
    glm::dmat4 worldFromObject{1.0};  ///< affine
    float opacity = 1.0f;             ///< in [0, 1]; 0 casts nothing
};

/// Returns an Error to stop the visit.
using MeshVisitor = std::function<Status(const MeshView&)>;

class CasterSource {
  public:
    virtual ~CasterSource() = default;
    /// Calls `visitor` once per mesh, in a fixed order, from the calling thread.
    virtual Status visit(const MeshVisitor& visitor) = 0;
};

struct MeshFileOptions {
    /// Shell patterns (`*`, `?`, `[a-z]`) matched against the names of node, mesh and
    /// material. A mesh is a caster if `include` is empty or one of its names matches one
    /// of them, and none of its names matches one of `exclude`.
    std::vector<std::string> include, exclude;
    std::optional<float> opacity;  ///< replaces every material's, in [0, 1]
    std::uint64_t cacheBytes = std::uint64_t(1) << 30;  ///< geometry kept between visits
    std::uint64_t importerBytes = std::uint64_t(16)
                                  << 30;  ///< address space of an importer
    /// Called with one line each for what was ignored or looks wrong; from the visiting
    /// thread.
    std::function<void(const std::string&)> warn;
    /// Called with the path before each file is read; returning false cancels.
    std::function<bool(const std::string&)> progress;
};

/// Meshes of files that Assimp reads (PLY, OBJ, glTF, GLB, FBX, COLLADA, STL and more),
/// node transforms and instances honoured, polygons triangulated. Points, lines, skins
/// and animations are ignored with one warning per file. visit() fails with io (no such
/// file, importer killed), badFile (not a mesh, no triangle) or badArgument (no mesh
/// passes include and exclude: the message lists the names there are).
class MeshFiles final : public CasterSource {
  public:
    explicit MeshFiles(std::vector<std::string> paths, MeshFileOptions options = {});
    ~MeshFiles() override;
    Status visit(const MeshVisitor& visitor) override;

    MeshFiles(const MeshFiles&) = delete;
    MeshFiles& operator=(const MeshFiles&) = delete;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Meshes that the caller holds in memory; they must outlive the source.
class MeshViews final : public CasterSource {
  public:
    explicit MeshViews(std::vector<MeshView> meshes) : meshes_(std::move(meshes)) {}
    Status visit(const MeshVisitor& visitor) override;

  private:
    std::vector<MeshView> meshes_;
};

/// A light that an input file holds.
struct FileLight {
    std::string name;
    AreaLight light;            ///< point, rect (area lights), or sun (directional)
    std::optional<double> fov;  ///< spot lights: full outer cone angle, radians
};

/// All lights of a file, placed by their nodes. Errors as MeshFiles::visit, no triangle
/// needed.
Result<std::vector<FileLight>> readLights(const std::string& path,
                                          const MeshFileOptions& options = {});

}  // namespace mtsm
