// Frames: written without a doubt in the child, read without any trust in the parent.
#include "scene/frames.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <tuple>

#include "base/finite.h"
#include "base/printable.h"

namespace mtsm::scene {
namespace {

struct FrameHead {
    FrameKind kind;
    std::uint32_t bytes;
};

template <typename T>
std::span<const std::uint8_t> bytesOf(const T& value) {
    return {reinterpret_cast<const std::uint8_t*>(&value), sizeof(T)};
}

template <typename T>
std::optional<T> recordOf(const std::vector<std::uint8_t>& payload) {
    if (payload.size() < sizeof(T)) return std::nullopt;
    T value;
    std::memcpy(&value, payload.data(), sizeof(T));
    return value;
}

bool isProportion(float x) {
    return x >= 0.0f && x <= 1.0f;
}

bool isAffine(const glm::dmat4& m) {
    return base::isFinite(m[0]) && base::isFinite(m[1]) && base::isFinite(m[2]) &&
           base::isFinite(m[3]) && m[0].w == 0.0 && m[1].w == 0.0 && m[2].w == 0.0 &&
           m[3].w == 1.0;
}

/// True if all are where blocks may be, and none is there twice.
bool areBlocks(std::vector<glm::ivec3> blocks) {
    const auto isBlock = [](glm::ivec3 block) {
        const auto fits = [](int i) {
            return i % VolumeView::kBlockSide == 0 && i >= -kMostIndex && i < kMostIndex;
        };
        return fits(block.x) && fits(block.y) && fits(block.z);
    };
    const auto before = [](glm::ivec3 a, glm::ivec3 b) {
        return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
    };
    std::sort(blocks.begin(), blocks.end(), before);
    return std::all_of(blocks.begin(), blocks.end(), isBlock) &&
           std::adjacent_find(blocks.begin(), blocks.end()) == blocks.end();
}

}  // namespace

void FrameWriter::frame(FrameKind kind, std::span<const std::uint8_t> record,
                        std::string_view text) {
    text = text.substr(0, kMaxFrameBytes - record.size());
    const FrameHead head{kind, std::uint32_t(record.size() + text.size())};
    out_.write(&head, sizeof(head));
    out_.write(record.data(), record.size());
    out_.write(text.data(), text.size());
}

void FrameWriter::failure(ErrorCode code, std::string_view text) {
    frame(FrameKind::failure, bytesOf(std::uint32_t(code)), text);
}

void FrameWriter::mesh(std::span<const float> coordinates, std::span<const glm::vec2> uvs,
                       std::span<const std::uint32_t> indices,
                       std::span<const Instance> instances, std::uint32_t texture,
                       glm::vec3 tint) {
    const MeshHead head{coordinates.size() / 3, indices.size() / 3, instances.size(),
                        texture, tint};
    frame(FrameKind::mesh, bytesOf(head), {});
    out_.write(instances.data(), instances.size_bytes());
    out_.write(coordinates.data(), coordinates.size_bytes());
    out_.write(uvs.data(), uvs.size_bytes());
    out_.write(indices.data(), indices.size_bytes());
}

void FrameWriter::texture(const OpacityImage& image) {
    const TextureHead head{image.width, image.height, image.channels, image.wrapU,
                           image.wrapV, image.cutoff, image.opacity};
    frame(FrameKind::texture, bytesOf(head), {});
    out_.write(image.texels.data(), image.texels.size() * sizeof(float));
}

void FrameWriter::light(const LightRecord& light, std::string_view name) {
    frame(FrameKind::light, bytesOf(light), name);
}

void FrameWriter::volume(const glm::dmat4& worldFromIndex,
                         std::span<const glm::ivec3> blocks) {
    const VolumeHead head{worldFromIndex, blocks.size()};
    frame(FrameKind::volume, bytesOf(head), {});
    out_.write(blocks.data(), blocks.size_bytes());
}

void FrameWriter::densities(std::span<const float, VolumeView::kBlockVoxels> block) {
    out_.write(block.data(), block.size_bytes());
}

std::string Frame::text(std::size_t from) const {
    if (from >= payload.size()) return {};
    return base::printable(
        {reinterpret_cast<const char*>(payload.data()) + from, payload.size() - from});
}

std::optional<Frame> FrameReader::next() {
    FrameHead head;
    if (in_.read(&head, sizeof(head)) != sizeof(head)) return std::nullopt;
    if (head.kind < FrameKind::warning || head.kind > FrameKind::end) return std::nullopt;
    if (head.bytes > kMaxFrameBytes) return std::nullopt;
    Frame frame{head.kind, std::vector<std::uint8_t>(head.bytes)};
    if (in_.read(frame.payload.data(), head.bytes) != head.bytes) return std::nullopt;
    return frame;
}

template <typename T>
bool FrameReader::fill(std::vector<T>& to, std::uint64_t count) {
    constexpr std::uint64_t kStep = (std::uint64_t(16) << 20) / sizeof(T);
    while (to.size() < count) {
        const std::uint64_t have = to.size();
        const std::uint64_t more = std::min(count - have, std::max(have, kStep));
        to.reserve(have + more);
        to.resize(have + more);
        if (in_.read(to.data() + have, more * sizeof(T)) != more * sizeof(T))
            return false;
    }
    return true;
}

std::optional<PlacedMesh> FrameReader::mesh(const Frame& frame) {
    const auto head = recordOf<MeshHead>(frame.payload);
    if (!head) return std::nullopt;
    const auto fits = [&](std::uint64_t count, std::uint64_t bytesEach) {
        return count <= maxBytes_ / bytesEach;
    };
    const bool textured = head->texture != kNoTexture;
    if (!fits(head->vertices, sizeof(glm::vec3)) || !fits(head->triangles, 12) ||
        !fits(head->instances, sizeof(Instance)) ||
        head->vertices > std::numeric_limits<std::uint32_t>::max() ||
        (textured && head->texture >= textures_) || !isProportion(head->tint.x) ||
        !isProportion(head->tint.y) || !isProportion(head->tint.z))
        return std::nullopt;
    PlacedMesh mesh;
    mesh.texture = head->texture;
    mesh.tint = head->tint;
    if (!fill(mesh.instances, head->instances) || !fill(mesh.positions, head->vertices) ||
        !fill(mesh.uvs, textured ? head->vertices : 0) ||
        !fill(mesh.indices, head->triangles * 3))
        return std::nullopt;
    if (!std::all_of(mesh.indices.begin(), mesh.indices.end(),
                     [&](std::uint32_t i) { return i < head->vertices; }) ||
        !std::all_of(mesh.instances.begin(), mesh.instances.end(),
                     [](const Instance& i) { return isProportion(i.opacity); }))
        return std::nullopt;
    return mesh;
}

std::optional<PlacedVolume> FrameReader::volume(const Frame& frame) {
    const auto head = recordOf<VolumeHead>(frame.payload);
    if (!head || !isAffine(head->worldFromIndex) ||
        head->blocks > maxBytes_ / PlacedVolume::kBlockBytes ||
        head->blocks > std::numeric_limits<std::uint32_t>::max())
        return std::nullopt;
    PlacedVolume volume;
    volume.worldFromIndex = head->worldFromIndex;
    if (!fill(volume.blocks, head->blocks) || !areBlocks(volume.blocks) ||
        !fill(volume.density, head->blocks * VolumeView::kBlockVoxels) ||
        !std::all_of(volume.density.begin(), volume.density.end(),
                     [](float d) { return d >= 0.0f && std::isfinite(d); }))
        return std::nullopt;
    return volume;
}

std::optional<OpacityImage> FrameReader::texture(const Frame& frame) {
    const auto head = recordOf<TextureHead>(frame.payload);
    const auto isSide = [](std::uint32_t n) {
        return n >= 1 && n <= OpacityImage::kMostTexels;
    };
    if (!head || !isSide(head->width) || !isSide(head->height) ||
        (head->channels != 1 && head->channels != 3) ||
        head->wrapU > TextureWrap::mirror || head->wrapU < TextureWrap::repeat ||
        head->wrapV > TextureWrap::mirror || head->wrapV < TextureWrap::repeat ||
        !std::isfinite(head->cutoff) || !isProportion(head->opacity))
        return std::nullopt;
    const std::uint64_t count =
        std::uint64_t(head->width) * head->height * head->channels;
    tooLarge_ = count > (maxBytes_ - textureBytes_) / sizeof(float);
    if (tooLarge_) return std::nullopt;
    OpacityImage image{head->width, head->height, head->channels, {},
                       head->wrapU, head->wrapV,  head->cutoff,   head->opacity};
    if (!fill(image.texels, count) ||
        !std::all_of(image.texels.begin(), image.texels.end(), isProportion))
        return std::nullopt;
    ++textures_;
    textureBytes_ += count * sizeof(float);
    return image;
}

std::optional<FileLight> FrameReader::light(const Frame& frame) {
    const auto record = recordOf<LightRecord>(frame.payload);
    if (!record) return std::nullopt;
    FileLight light;
    light.name = frame.text(sizeof(LightRecord));
    light.light.shape = record->shape;
    light.light.position = record->position;
    light.light.direction = record->direction;
    light.light.up = record->up;
    light.light.size = {record->width, record->height};
    if (record->fov > 0.0 && std::isfinite(record->fov)) light.fov = record->fov;
    if (!checkLight(light.light)) return std::nullopt;
    return light;
}

}  // namespace mtsm::scene
