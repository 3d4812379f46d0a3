// frames.h - what an importing child says to its parent, and how.
//
// The child sends a sequence of frames: an 8-byte head (kind, payload size in bytes) and
// the payload. A mesh frame's payload is a MeshHead; behind it come, outside the frame,
// its instances, positions, texture coordinates and indices as they lie in memory: both
// sides are one binary. A texture frame's is a TextureHead, with the texels behind it;
// meshes refer to textures that came before them by their number. A volume frame is
// followed in the same way by its blocks and their densities. The last frame is `end` or
// `failure`; a stream without either was cut off.
//
// The child has parsed a file that may be hostile, so the parent believes nothing: sizes
// are held against a limit and buffers grow only as bytes arrive, every index is checked
// against the vertex count, and every other number against its range.
#pragma once
#include <cstdint>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "mtsm/opacity_texture.h"
#include "mtsm/scene.h"
#include "scene/isolate.h"

namespace mtsm::scene {

enum class FrameKind : std::uint32_t {
    warning = 1,  ///< text
    name = 2,     ///< text: a name that include and exclude could have matched
    mesh = 3,     ///< MeshHead
    light = 4,    ///< LightRecord, then the name
    volume = 5,   ///< VolumeHead
    texture = 6,  ///< TextureHead
    failure = 7,  ///< ErrorCode as a u32, then the text: the file cannot be used
    end = 8       ///< nothing: all has been said
};

inline constexpr std::uint32_t kMaxFrameBytes = 4096;

inline constexpr std::uint32_t kNoTexture = ~std::uint32_t(0);

struct MeshHead {
    std::uint64_t vertices = 0, triangles = 0, instances = 0;
    std::uint32_t texture = kNoTexture;  ///< which of those sent; then it has coordinates
    glm::vec3 tint{1.0f};
};

/// OpacityImage but for its texels.
struct TextureHead {
    std::uint32_t width = 0, height = 0, channels = 1;
    TextureWrap wrapU = TextureWrap::repeat, wrapV = TextureWrap::repeat;
    float cutoff = -1.0f, opacity = 1.0f;
};

/// One place where a mesh stands.
struct Instance {
    glm::dmat4 worldFromObject{1.0};
    float opacity = 1.0f;
    std::uint32_t padding = 0;
};

/// A mesh and all its places.
struct PlacedMesh {
    std::vector<glm::vec3> positions;
    std::vector<glm::vec2> uvs;  ///< one per position, or none
    std::vector<std::uint32_t> indices;
    std::vector<Instance> instances;
    std::uint32_t texture = kNoTexture;
    glm::vec3 tint{1.0f};

    [[nodiscard]] std::uint64_t bytes() const {
        return positions.size() * sizeof(glm::vec3) + uvs.size() * sizeof(glm::vec2) +
               indices.size() * sizeof(std::uint32_t) +
               instances.size() * sizeof(Instance);
    }
};

struct VolumeHead {
    glm::dmat4 worldFromIndex{1.0};
    std::uint64_t blocks = 0;
};

/// A fog volume: see VolumeView.
struct PlacedVolume {
    std::vector<glm::ivec3> blocks;
    std::vector<float> density;
    glm::dmat4 worldFromIndex{1.0};

    /// Per block.
    static constexpr std::uint64_t kBlockBytes =
        sizeof(glm::ivec3) + VolumeView::kBlockVoxels * sizeof(float);
    [[nodiscard]] std::uint64_t bytes() const { return blocks.size() * kBlockBytes; }
};

/// Blocks lie within [-kMostIndex, kMostIndex) on every axis.
inline constexpr int kMostIndex = 1 << 30;

struct LightRecord {
    glm::dvec3 position, direction, up;
    double width = 0, height = 0;  ///< rect
    double fov = 0;                ///< spot; 0: none
    LightShape shape = LightShape::point;
    std::uint32_t padding = 0;
};

/// The child's side. Texts lose control characters and what is beyond kMaxFrameBytes.
class FrameWriter {
  public:
    explicit FrameWriter(ChildPipe& out) : out_(out) {}
    void warning(std::string_view text) { frame(FrameKind::warning, {}, text); }
    void name(std::string_view text) { frame(FrameKind::name, {}, text); }
    void failure(ErrorCode code, std::string_view text);
    /// `coordinates` are x, y, z of one vertex after another.
    void mesh(std::span<const float> coordinates, std::span<const std::uint32_t> indices,
              std::span<const Instance> instances) {
        mesh(coordinates, {}, indices, instances, kNoTexture, glm::vec3(1.0f));
    }
    /// With one of `uvs` per vertex and a texture, or without both.
    void mesh(std::span<const float> coordinates, std::span<const glm::vec2> uvs,
              std::span<const std::uint32_t> indices, std::span<const Instance> instances,
              std::uint32_t texture, glm::vec3 tint);
    void texture(const OpacityImage& image);
    void light(const LightRecord& light, std::string_view name);
    /// The densities of all blocks follow, one call of densities() for each.
    void volume(const glm::dmat4& worldFromIndex, std::span<const glm::ivec3> blocks);
    void densities(std::span<const float, VolumeView::kBlockVoxels> block);
    void end() { frame(FrameKind::end, {}, {}); }

  private:
    void frame(FrameKind kind, std::span<const std::uint8_t> record,
               std::string_view text);
    ChildPipe& out_;
};

/// One frame as it arrived.
struct Frame {
    FrameKind kind = FrameKind::end;
    std::vector<std::uint8_t> payload;

    [[nodiscard]] std::string text(std::size_t from = 0) const;
};

/// The parent's side.
class FrameReader {
  public:
    /// No mesh or volume may be larger than maxBytes, nor may all textures together.
    FrameReader(Isolated& in, std::uint64_t maxBytes) : in_(in), maxBytes_(maxBytes) {}
    /// The next frame; nothing at the end of the stream or if what comes is no frame.
    [[nodiscard]] std::optional<Frame> next();
    /// What follows a mesh frame; nothing if it is cut off or breaks a rule.
    [[nodiscard]] std::optional<PlacedMesh> mesh(const Frame& frame);
    /// What follows a volume frame; nothing if it is cut off or breaks a rule.
    [[nodiscard]] std::optional<PlacedVolume> volume(const Frame& frame);
    /// What follows a texture frame; nothing if it is cut off or breaks a rule.
    [[nodiscard]] std::optional<OpacityImage> texture(const Frame& frame);
    /// Whether texture() gave nothing because of maxBytes.
    [[nodiscard]] bool tooLarge() const { return tooLarge_; }
    /// What a light frame says; nothing if it breaks a rule.
    [[nodiscard]] static std::optional<FileLight> light(const Frame& frame);

  private:
    template <typename T>
    bool fill(std::vector<T>& to, std::uint64_t count);
    Isolated& in_;
    std::uint64_t maxBytes_;
    std::uint32_t textures_ = 0;      // read so far
    std::uint64_t textureBytes_ = 0;  // of those
    bool tooLarge_ = false;
};

}  // namespace mtsm::scene
