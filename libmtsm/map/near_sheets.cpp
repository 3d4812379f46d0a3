#include "mtsm/near_sheets.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/message.h"
#include "base/parallel.h"
#include "map/near_boxes.h"
#include "map/sheet_checks.h"

namespace mtsm {

namespace {
std::uint64_t texelsOf(std::uint32_t width, std::uint32_t height) {
    return std::uint64_t(width) * height;
}
}  // namespace

std::uint64_t nearSheetBytes(std::uint64_t chunks, int points) noexcept {
    return nearFieldBytes(chunks, points) + chunks * sizeof(NearSheetChunk);
}

std::uint64_t nearTextureBytes(std::uint32_t width, std::uint32_t height) noexcept {
    const std::uint64_t w = width, h = height;
    return texelsOf(width, height) + 4 * (w + 1) * (h + 1);
}

std::uint64_t memoryBytes(const NearSheets& sheets) noexcept {
    std::uint64_t bytes =
        memoryBytes(sheets.triangles) + sheets.chunks.size() * sizeof(NearSheetChunk);
    for (const NearTexture& texture : sheets.textures) {
        bytes += nearTextureBytes(texture.width, texture.height);
        if (texture.texels.empty()) bytes -= texelsOf(texture.width, texture.height);
    }
    return bytes;
}

namespace map_detail {
namespace {

template <typename... Parts>
Error invalid(std::uint32_t face, const Parts&... parts) {
    return base::makeError(ErrorCode::badArgument, "face ", face,
                           ": near sheets: ", parts...);
}

bool isWrap(TextureWrap wrap) {
    return wrap == TextureWrap::repeat || wrap == TextureWrap::clamp ||
           wrap == TextureWrap::mirror;
}

Status checkTexture(const NearTexture& texture, std::size_t number, std::uint32_t face) {
    constexpr std::uint32_t kMost = OpacityImage::kMostTexels;
    for (const std::uint32_t side : {texture.width, texture.height}) {
        if (side < 1 || side > kMost)
            return invalid(face, "texture ", number, ": ", texture.width, " x ",
                           texture.height, " texels, each side must have 1 to ", kMost);
    }
    const std::uint64_t texels = std::uint64_t(texture.width) * texture.height;
    if (texture.texels.size() != texels)
        return invalid(face, "texture ", number, ": ", texture.texels.size(),
                       " texels where its size needs ", texels);
    if (!isWrap(texture.wrapU) || !isWrap(texture.wrapV))
        return invalid(face, "texture ", number, ": wraps as ", int(texture.wrapU),
                       " and ", int(texture.wrapV), ", each must be 0 to 2");
    if (!std::isfinite(texture.cutoff))
        return invalid(face, "texture ", number, ": its cutoff is not finite");
    if (!(texture.opacity >= 0.0f && texture.opacity <= 1.0f))
        return invalid(face, "texture ", number, ": an opacity of ", texture.opacity,
                       ", which must be in [0, 1]");
    return {};
}

Status checkCoordinates(const NearSheetChunk& chunk, std::size_t number,
                        std::size_t textures, std::uint32_t face) {
    if (chunk.texture >= textures)
        return invalid(face, "chunk ", number, ": has texture ", chunk.texture, " of ",
                       textures);
    if (chunk.triangles < 1 || chunk.triangles > NearChunk::kTriangles)
        return invalid(face, "chunk ", number, ": has ", chunk.triangles,
                       " triangles, must be 1 to ", NearChunk::kTriangles);
    for (int axis = 0; axis < 2; ++axis) {
        const float low = chunk.low[axis], step = chunk.step[axis];
        if (std::isfinite(low) && step >= 0.0f && std::isfinite(low + step * 65535.0f))
            continue;
        return invalid(face, "chunk ", number, ", texture coordinate ", "uv"[axis],
                       ": starts at ", low, " with steps of ", step,
                       ", which must be finite and not go backwards");
    }
    return {};
}

/// Row or column i, -1 or `n` being beyond the border.
std::size_t beyond(std::int64_t i, std::uint32_t n, TextureWrap wrap) {
    const std::int64_t last = std::int64_t(n) - 1;
    if (wrap == TextureWrap::repeat) return std::size_t(i < 0 ? last : i > last ? 0 : i);
    return std::size_t(std::clamp<std::int64_t>(i, 0, last));
}

void buildCorners(NearTexture& texture) {
    const std::size_t width = texture.width, height = texture.height;
    texture.corners.resize((width + 1) * (height + 1));
    base::parallelRanges(
        std::size_t(0), height + 1, std::size_t(64), [&](auto first, auto last) {
            for (std::size_t y = first; y < last; ++y) {
                const auto row = [&](std::size_t k) {
                    return texture.texels.data() + width * beyond(std::int64_t(y + k) - 1,
                                                                  texture.height,
                                                                  texture.wrapV);
                };
                const std::uint8_t *upper = row(0), *lower = row(1);
                for (std::size_t x = 0; x <= width; ++x) {
                    const std::size_t left =
                        beyond(std::int64_t(x) - 1, texture.width, texture.wrapU);
                    const std::size_t right =
                        beyond(std::int64_t(x), texture.width, texture.wrapU);
                    texture.corners[y * (width + 1) + x] =
                        std::uint32_t(upper[left]) | std::uint32_t(upper[right]) << 8 |
                        std::uint32_t(lower[left]) << 16 |
                        std::uint32_t(lower[right]) << 24;
                }
            }
        });
}

bool same(float a, float b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

bool sameTexture(const NearTexture& a, const NearTexture& b) {
    return a.width == b.width && a.height == b.height && a.wrapU == b.wrapU &&
           a.wrapV == b.wrapV && same(a.cutoff, b.cutoff) && same(a.opacity, b.opacity) &&
           a.texels == b.texels;
}

}  // namespace

Status checkSheets(const NearSheets& sheets, const MapInfo& info, std::size_t faces,
                   std::uint32_t face) {
    if (sheets.empty() && sheets.triangles.empty()) return {};
    if (faces != 1 || info.channels != 1 || info.translucent != Translucent::sheets)
        return invalid(face, "only a map of sheets with one face and one channel has ",
                       "them");
    if (sheets.chunks.size() != sheets.triangles.chunks.size())
        return invalid(face, sheets.chunks.size(), " chunks of texture coordinates for ",
                       sheets.triangles.chunks.size(), " chunks of triangles");
    for (std::size_t i = 0; i < sheets.textures.size(); ++i) {
        if (auto s = checkTexture(sheets.textures[i], i, face); !s) return s;
    }
    for (std::size_t i = 0; i < sheets.chunks.size(); ++i) {
        if (auto s = checkCoordinates(sheets.chunks[i], i, sheets.textures.size(), face);
            !s)
            return s;
    }
    return {};
}

void buildSheets(NearSheets& sheets) {
    for (NearTexture& texture : sheets.textures)
        buildCorners(texture);
}

bool sameSheets(const NearSheets& a, const NearSheets& b) noexcept {
    return sameChunks(a.triangles, b.triangles) && a.chunks.size() == b.chunks.size() &&
           (a.chunks.empty() ||
            std::memcmp(a.chunks.data(), b.chunks.data(),
                        a.chunks.size() * sizeof(NearSheetChunk)) == 0) &&
           std::equal(a.textures.begin(), a.textures.end(), b.textures.begin(),
                      b.textures.end(), sameTexture);
}

}  // namespace map_detail
}  // namespace mtsm
