// scene.h - casters: geometry that goes into a map.
//
//     mtsm::MeshFileOptions options;
//     options.exclude = {"floor*"};
//     mtsm::MeshFiles casters({"hero.glb", "props.obj"}, options);
//     auto baked = mtsm::bake(casters, bakeOptions);          // mtsm/bake.h
//
// Casters are triangle meshes (with an opacity, or with a texture of opacities), strands
// of hair, and volumes. A caster source hands them over one after another and may be
// asked more than once (for bounds, for the window, for rasterising): the same casters
// come in the same order every time. Mesh files are read in a child process, because
// importers die on some broken files: a file that kills its importer is an Error like any
// other. The child is a fork of the calling thread; that is fine in a process with other
// threads, TBB's included (libmtsm/scene/isolate.h says what it relies on). Different
// sources may be used from different threads at once.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "mtsm/light.h"
#include "mtsm/opacity_texture.h"
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
    /// Colour that light takes on in passing, each in [0, 1]: see channelOpacity().
    glm::vec3 tint{1.0f};
    /// [vertexCount], texture coordinates; null without a texture.
    const glm::vec2* uvs = nullptr;
    /// If not null it says how opaque every point is, and opacity and tint do not count.
    const OpacityTexture* texture = nullptr;
};

/// How much of red, green and blue a surface of this opacity and tint stops: what passes,
/// 1 - opacity of it, has been tinted as much as there was to pass through. A white tint
/// makes all three `opacity`.
[[nodiscard]] inline glm::vec3 channelOpacity(float opacity, glm::vec3 tint) noexcept {
    // 1 - (1 - a)(1 - a (1 - tint)), so that small opacities stay what they are.
    return glm::vec3(opacity) + opacity * (1.0f - opacity) * (glm::vec3(1.0f) - tint);
}

/// Strands of hair, fur or grass: lines of points with a width. Pointers are borrowed.
struct StrandsView {
    const glm::vec3* points = nullptr;  ///< [begin[strandCount]], object space
    /// [strandCount + 1]: strand s has points [begin[s], begin[s + 1]).
    const std::uint32_t* begin = nullptr;
    std::size_t strandCount = 0;
    /// [points], full width across the strand, object units, >= 0; null: all are `width`.
    const float* widths = nullptr;
    float width = 0.0f;
    /// [points], of light that crosses the strand, in [0, 1]; null: all are `opacity`.
    const float* opacities = nullptr;
    float opacity = 1.0f;
    glm::dmat4 worldFromObject{1.0};  ///< affine; widths grow by the cube root of |det|
};

/// A fog volume: a grid of densities, constant over each voxel, in blocks of 8 x 8 x 8;
/// where there is no block there is nothing. Pointers are borrowed.
struct VolumeView {
    static constexpr int kBlockSide = 8;
    static constexpr int kBlockVoxels = kBlockSide * kBlockSide * kBlockSide;

    /// [blockCount], each once: index of the block's lowest voxel, a multiple of 8.
    const glm::ivec3* blocks = nullptr;
    std::size_t blockCount = 0;
    /// [blockCount][z][y][x]: density, finite, >= 0.
    const float* density = nullptr;
    /// Index space to world, affine: voxel (i, j, k) covers (i, j, k) +- 0.5.
    glm::dmat4 worldFromIndex{1.0};
    float extinction = 1.0f;  ///< per unit of density and world unit of length, >= 0
};

using CasterView = std::variant<MeshView, StrandsView, VolumeView>;

/// Returns an Error to stop the visit.
using CasterVisitor = std::function<Status(const CasterView&)>;

/// A visitor that is shown meshes and passes over everything else.
[[nodiscard]] inline CasterVisitor meshesOnly(
    std::function<Status(const MeshView&)> visitor) {
    return [visitor = std::move(visitor)](const CasterView& caster) -> Status {
        const auto* mesh = std::get_if<MeshView>(&caster);
        return mesh ? visitor(*mesh) : Status{};
    };
}

class CasterSource {
  public:
    virtual ~CasterSource() = default;
    /// Calls `visitor` once per caster, in a fixed order, from the calling thread.
    virtual Status visit(const CasterVisitor& visitor) = 0;
};

/// An image that says how opaque materials are, whatever their file says of textures.
struct MaterialTexture {
    std::string material;  ///< shell pattern, matched against whole names
    std::string image;     ///< path, as the process sees it; empty: no texture

    friend bool operator==(const MaterialTexture& a, const MaterialTexture& b) noexcept {
        return a.material == b.material && a.image == b.image;
    }
};

struct MeshFileOptions {
    /// Shell patterns (`*`, `?`, `[a-z]`) matched against whole names: those of the mesh,
    /// its material, its node and all nodes above it. A mesh is a caster if `include` is
    /// empty or one of its names matches one of them, and none of its names matches one
    /// of `exclude`. Case counts; a pattern that matches nothing in a file is a warning.
    std::vector<std::string> include, exclude;
    /// Replaces every material's number, in [0, 1]. Textures stay: what they say is
    /// multiplied by it, so a mask keeps its holes and has this opacity between them.
    /// Without it, see MeshFiles.
    std::optional<float> opacity;
    /// For files that do not name their textures, or name what is none. Its alpha counts,
    /// or without alpha its brightness. Of several that match, the last counts. An image
    /// that cannot be read is an Error here; a pattern that matches nothing, a warning.
    std::vector<MaterialTexture> textures;
    /// Materials that let some light through tint it: MeshView::tint, and textures of
    /// three channels where colours differ. Without it neither.
    bool color = false;
    /// Lines of OBJ files count as cast, not as ignored: another source casts them as
    /// strands (HairFile).
    bool linesAreStrands = false;
    /// Geometry and textures kept between visits: whole files, in their order, while they
    /// fit. Others are read again at each visit.
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
/// A mesh is as opaque as its material's number times its material's texture:
///   OBJ      d (or 1 - Tr), map_d
///   glTF     BLEND: the base colour's alpha, factor and texture; MASK: 0 or 1, whether
///            that reaches the cutoff; OPAQUE: 1. KHR_texture_transform is honoured.
///   FBX      Opacity, the texture of TransparentColor or TransparencyFactor
///   COLLADA  transparency, the texture of transparent. 0 without a texture is taken for
///            1, with a warning, because exporters write it inverted.
/// and 1 where the file says nothing. A number of 0 beside a texture of its own is taken
/// for 1, for some exporters write so that the texture alone counts. Of a texture made
/// for opacity the alpha counts, or without an alpha channel (or with one that is 1 all
/// over) the brightness. All formats but glTF: without such a texture the alpha of the
/// colour texture (map_Kd) counts if it has any, with a warning, because exporters of
/// foliage leave it there without a word. What passes is tinted by the base colour
/// (glTF), by Tf or, if that is white, by Kd (OBJ), else by the diffuse colour, times the
/// colours of the texture if those are the base or diffuse ones; masks have no colour.
///
/// Images are embedded or files of their own that OpenImageIO reads, up to 16384 pixels
/// on a side; they are looked for where the model says, seen from its own folder, and by
/// their names alone there and in `textures`, `../textures` and
/// `../materials/textures`. One that is missing or cannot be read is a warning, and the
/// number alone counts; so is one without alpha where alpha should count. Glass by
/// KHR_materials_transmission casts as opaque, with a warning. Opacity by vertex is not
/// read.
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
    Status visit(const CasterVisitor& visitor) override;
    /// What it holds until the next visit, of cacheBytes.
    [[nodiscard]] std::uint64_t cachedBytes() const noexcept;

    MeshFiles(const MeshFiles&) = delete;
    MeshFiles& operator=(const MeshFiles&) = delete;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Casters that the caller holds in memory; they must outlive the source.
class CasterViews final : public CasterSource {
  public:
    explicit CasterViews(std::vector<CasterView> casters)
        : casters_(std::move(casters)) {}
    Status visit(const CasterVisitor& visitor) override;

  private:
    std::vector<CasterView> casters_;
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
