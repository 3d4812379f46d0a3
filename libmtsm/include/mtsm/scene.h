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
// files: a file that kills its importer is an Error like any other. The child is a fork
// of the calling thread; that is fine in a process with other threads, TBB's included
// (libmtsm/scene/isolate.h says what it relies on). Different sources may be used from
// different threads at once.
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
    /// Shell patterns (`*`, `?`, `[a-z]`) matched against whole names: those of the mesh,
    /// its material, its node and all nodes above it. A mesh is a caster if `include` is
    /// empty or one of its names matches one of them, and none of its names matches one
    /// of `exclude`. Case counts; a pattern that matches nothing in a file is a warning.
    std::vector<std::string> include, exclude;
    /// Replaces every material's, in [0, 1]. Without it: OBJ's d (or 1 - Tr); FBX's
    /// Opacity; glTF's base colour alpha as the alpha mode has it (BLEND: itself, MASK: 0
    /// or 1 by the cutoff, OPAQUE: 1); COLLADA's transparency, except that 0 is taken for
    /// 1, with a warning, because exporters write it inverted; else 1. The alpha of
    /// textures is not used: one warning per file names a material that has some.
    std::optional<float> opacity;
    /// Geometry kept between visits: whole files, in their order, while they fit. Others
    /// are read again at each visit.
    std::uint64_t cacheBytes = std::uint64_t(1) << 30;
    std::uint64_t importerBytes = std::uint64_t(16)
                                  << 30;  ///< address space an importer may add
    /// Called with one line each for what was ignored or looks wrong, at the first visit;
    /// from the visiting thread.
    std::function<void(const std::string&)> warn;
    /// Called with the path before each file is read; returning false cancels.
    std::function<bool(const std::string&)> progress;
};

/// Meshes of files that Assimp reads (PLY, OBJ, glTF, GLB, FBX, COLLADA, STL and more),
/// node transforms and instances honoured: a mesh is visited once per node that shows it.
/// Polygons and strips are cut into triangles. Points, lines, skins and animations are
/// ignored with one warning per file. Axes and units are the file's own, but COLLADA
/// comes in metres with y up. Degenerate triangles, vertices that are not finite and
/// meshes of opacity 0 are handed on.
///
/// visit() fails with io (no such file, importer killed, file changed between visits),
/// badFile (not a mesh, cut off, no triangle, an index without its vertex, importer
/// crashed), tooLarge (importerBytes), badArgument (no mesh passes include and exclude:
/// the message lists the names there are) or cancelled. Names in COLLADA files are their
/// `name` attributes.
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
    std::string name;  ///< its node's, as formats have it; "light0" and so on without
    /// Point (spot lights too: direction is where they shine), rect (area lights) or sun
    /// (directional). Ambient lights are left out.
    AreaLight light;
    std::optional<double> fov;  ///< spot lights: full outer cone angle, radians
};

/// All lights of a file, placed by their nodes. Errors as MeshFiles::visit, no triangle
/// needed; of the options, importerBytes, warn and progress count. Assimp 5.2 keeps one
/// place per light: a glTF light that several nodes share stands at the last of them.
Result<std::vector<FileLight>> readLights(const std::string& path,
                                          const MeshFileOptions& options = {});

}  // namespace mtsm
