#include "baseline/content.h"

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <glm/vec2.hpp>
#include <span>
#include <string_view>
#include <type_traits>

#include "base/checksum.h"
#include "base/file_output.h"
#include "base/message.h"

namespace mtsm::baseline {
namespace {

constexpr std::string_view kMagic = "mtsm values 1\n";

template <typename T>
std::span<const std::uint8_t> rawBytes(const T* values, std::size_t count) {
    static_assert(std::is_trivially_copyable_v<T>);
    return {reinterpret_cast<const std::uint8_t*>(values), count * sizeof(T)};
}

/// Takes arrays one after another, each with its length, so that none can be mistaken for
/// part of another.
class Content {
  public:
    template <typename T>
    void add(const T* values, std::size_t count) {
        const std::uint64_t length = values ? count : ~std::uint64_t(0);
        stream_.add(rawBytes(&length, 1));
        if (values) stream_.add(rawBytes(values, count));
    }
    template <typename T>
    void add(const T& value) {
        add(&value, 1);
    }
    [[nodiscard]] std::uint64_t value() const { return stream_.value(); }

  private:
    base::ChecksumStream stream_;
};

/// Lookups in a square grid, each of the mean over `footprint` of its cell.
void addLookups(Content& content, const OpacityTexture& texture, int side, double low,
                double high, double footprint) {
    const double cell = (high - low) / side;
    for (int y = 0; y < side; ++y) {
        for (int x = 0; x < side; ++x) {
            std::array<float, 3> found{};
            texture.opacity(low + cell * glm::dvec2(x + 0.5, y + 0.5),
                            {footprint * cell, 0.0}, {0.0, footprint * cell},
                            found.data());
            content.add(found);
        }
    }
}

/// Means over cells, which no texel is missing from; points, for what a mask's edge does
/// where it is magnified; and points outside of the image, for how it goes on there.
void add(Content& content, const OpacityTexture& texture) {
    content.add(texture.channels());
    addLookups(content, texture, 64, 0.0, 1.0, 1.0);
    addLookups(content, texture, 64, 0.0, 1.0, 0.0);
    addLookups(content, texture, 21, -1.0, 2.0, 0.0);
}

void add(Content& content, const MeshView& mesh) {
    content.add('m');
    content.add(mesh.positions, mesh.vertexCount);
    content.add(mesh.indices, 3 * mesh.triangleCount);
    content.add(mesh.worldFromObject);
    content.add(mesh.opacity);
    content.add(mesh.tint);
    content.add(mesh.uvs, mesh.vertexCount);
    if (mesh.texture) add(content, *mesh.texture);
}

void add(Content& content, const StrandsView& strands) {
    content.add('s');
    const std::size_t points =
        strands.strandCount ? strands.begin[strands.strandCount] : 0;
    content.add(strands.points, points);
    content.add(strands.begin, strands.strandCount ? strands.strandCount + 1 : 0);
    content.add(strands.widths, points);
    content.add(strands.width);
    content.add(strands.opacities, points);
    content.add(strands.opacity);
    content.add(strands.worldFromObject);
}

void add(Content& content, const VolumeView& volume) {
    content.add('v');
    content.add(volume.blocks, volume.blockCount);
    content.add(volume.density, volume.blockCount * VolumeView::kBlockVoxels);
    content.add(volume.worldFromIndex);
    content.add(volume.extinction);
}

}  // namespace

Result<std::uint64_t> contentOf(CasterSource& casters) {
    Content content;
    const Status read = casters.visit([&](const CasterView& caster) -> Status {
        std::visit([&](const auto& view) { add(content, view); }, caster);
        return {};
    });
    if (!read) return read.error();
    return content.value();
}

std::uint64_t contentOf(const Receivers& r) {
    Content content;
    content.add(r.points, r.count);
    content.add(r.normals, r.count);
    content.add(r.starts, r.count);
    content.add(r.first, r.pixels + 1);
    return content.value();
}

std::uint64_t contentOf(const AreaLight& light) {
    Content content;
    content.add(light.shape);
    content.add(light.position);
    content.add(light.direction);
    content.add(light.up);
    content.add(light.radius);
    content.add(light.size);
    content.add(light.angularDiameter);
    return content.value();
}

std::uint64_t contentOf(const std::string& text) {
    return base::checksum(base::bytesOf(text));
}

std::uint64_t combined(std::uint64_t a, std::uint64_t b) {
    const std::array<std::uint64_t, 2> both{a, b};
    return base::checksum(rawBytes(both.data(), both.size()));
}

std::string contentText(std::uint64_t content) {
    constexpr const char* kDigits = "0123456789abcdef";
    std::string text;
    for (int shift = 60; shift >= 0; shift -= 4)
        text += kDigits[content >> shift & 15];
    return text;
}

Status writeValues(const std::string& path, std::uint64_t key,
                   const std::vector<float>& values) {
    const std::uint64_t head[] = {key, values.size(),
                                  base::checksum(rawBytes(values.data(), values.size()))};
    base::FileOutput out(path);
    if (Status s = out.open(); !s) return s;
    if (Status s = out.write(base::bytesOf(kMagic)); !s) return s;
    if (Status s = out.write(rawBytes(head, 3)); !s) return s;
    if (Status s = out.write(rawBytes(values.data(), values.size())); !s) return s;
    return out.commit();
}

Result<std::optional<std::vector<float>>> readValues(const std::string& path,
                                                     std::uint64_t key,
                                                     std::size_t count) {
    std::ifstream in(path, std::ios::binary);
    if (!in) return std::optional<std::vector<float>>();
    const auto refuse = [&](const char* why) {
        return base::makeError(ErrorCode::badFile, path, ": ", why,
                               "; delete it and it is computed anew");
    };
    std::string magic(kMagic.size(), '\0');
    std::uint64_t head[3] = {};
    in.read(magic.data(), std::streamsize(magic.size()));
    in.read(reinterpret_cast<char*>(head), sizeof head);
    if (!in || magic != kMagic) return refuse("is no file of cached values");
    if (head[0] != key || head[1] != count)
        return refuse("holds the values of another scene, light or picture");
    // Both may be wrong together: no more is allocated than there is to read.
    const auto begin = in.tellg();
    in.seekg(0, std::ios::end);
    const auto bytes = std::uint64_t(in.tellg() - begin);
    in.seekg(begin);
    if (!in || bytes / sizeof(float) < count) return refuse("is cut off");
    if (bytes != count * sizeof(float)) return refuse("has bytes behind its end");
    std::vector<float> values(count);
    in.read(reinterpret_cast<char*>(values.data()), std::streamsize(bytes));
    if (!in) return refuse("is cut off");
    if (base::checksum(rawBytes(values.data(), count)) != head[2])
        return refuse("is damaged: its checksum differs");
    return std::optional(std::move(values));
}

}  // namespace mtsm::baseline
