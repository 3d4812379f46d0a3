#include "mtsm/near_sheets.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "base/message.h"
#include "base/parallel.h"
#include "map/near_boxes.h"
#include "map/near_points.h"
#include "map/sheet_checks.h"

namespace mtsm {

namespace {
std::uint64_t texelsOf(std::uint32_t width, std::uint32_t height) {
    return std::uint64_t(width) * height;
}
}  // namespace

void NearSheetChunks::push_back(const NearSheetChunk& chunk) {
    const map_detail::NearPoints<2> p(chunk.uv);
    Place place = {};
    place.texture = chunk.texture;
    place.triangles = std::uint16_t(std::min(chunk.triangles, 0xffffu));
    std::copy_n(chunk.low, 2, place.low);
    std::copy_n(chunk.step, 2, place.step);
    place.first = words_.size();
    place.points =
        std::uint16_t(map_detail::areShared(p.count) ? p.count : map_detail::kCorners);
    places_.push_back(place);
    if (p.count == 1) {
        words_.insert(words_.end(), p.points[0].begin(), p.points[0].end());
        return;
    }
    words_.resize(place.first + map_detail::wordsOf(2, p.count));
    map_detail::writePoints(p.points, p.count, p.numbers, words_.data() + place.first);
}

void NearSheetChunks::append(NearSheetChunks* parts, std::size_t count) {
    if (places_.empty() && count == 1) {
        *this = std::exchange(parts[0], {});
        return;
    }
    std::size_t chunks = places_.size(), words = words_.size();
    for (std::size_t i = 0; i < count; ++i) {
        chunks += parts[i].places_.size();
        words += parts[i].words_.size();
    }
    map_detail::growTo(places_, chunks);
    map_detail::growTo(words_, words);
    for (std::size_t i = 0; i < count; ++i) {
        const NearSheetChunks part = std::move(parts[i]);
        parts[i] = {};
        for (Place place : part.places_) {
            place.first += words_.size();
            places_.push_back(place);
        }
        words_.insert(words_.end(), part.words_.begin(), part.words_.end());
    }
}

void NearSheetChunks::shrink_to_fit() {
    places_.shrink_to_fit();
    words_.shrink_to_fit();
}

NearSheetChunk NearSheetChunks::operator[](std::size_t i) const noexcept {
    const Place& place = places_[i];
    NearSheetChunk chunk;
    chunk.texture = place.texture;
    chunk.triangles = place.triangles;
    std::copy_n(place.low, 2, chunk.low);
    std::copy_n(place.step, 2, chunk.step);
    for (int c = 0; c < 3; ++c) {
        for (int t = 0; t < NearChunk::kTriangles; ++t) {
            const auto at = uv(i, c, t);
            chunk.uv[c][0][t] = at[0], chunk.uv[c][1][t] = at[1];
        }
    }
    return chunk;
}

std::uint64_t NearSheetChunks::memoryBytes(std::uint64_t chunks, int points) noexcept {
    const std::size_t words =
        points > 1 ? map_detail::wordsOf(2, std::size_t(points)) : 2;
    return chunks * (sizeof(Place) + words * sizeof(std::uint16_t));
}

std::uint64_t nearSheetBytes(std::uint64_t chunks, int points) noexcept {
    return nearFieldBytes(chunks, points) + NearSheetChunks::memoryBytes(chunks, points);
}

std::uint64_t nearTextureBytes(std::uint32_t width, std::uint32_t height) noexcept {
    const std::uint64_t w = width, h = height;
    return texelsOf(width, height) + (w + 2) * (h + 2);
}

std::uint64_t memoryBytes(const NearSheets& sheets) noexcept {
    std::uint64_t bytes = memoryBytes(sheets.triangles) + sheets.chunks.memoryBytes();
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

Status checkCoordinates(const NearSheetChunks::Place& chunk, std::size_t number,
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

void buildBordered(NearTexture& texture) {
    const std::size_t width = texture.width, height = texture.height;
    texture.bordered.resize((width + 2) * (height + 2));
    base::parallelRanges(
        std::size_t(0), height + 2, std::size_t(64), [&](auto first, auto last) {
            for (std::size_t y = first; y < last; ++y) {
                const std::uint8_t* const from =
                    texture.texels.data() +
                    width * beyond(std::int64_t(y) - 1, texture.height, texture.wrapV);
                std::uint8_t* const to = texture.bordered.data() + (width + 2) * y;
                to[0] = from[beyond(-1, texture.width, texture.wrapU)];
                std::copy_n(from, width, to + 1);
                to[width + 1] =
                    from[beyond(std::int64_t(width), texture.width, texture.wrapU)];
            }
        });
}

bool same(float a, float b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

bool sameCoordinates(const NearSheetChunks& a, const NearSheetChunks& b) {
    if (a.size() != b.size()) return false;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const NearSheetChunk x = a[i], y = b[i];
        if (std::memcmp(&x, &y, sizeof x) != 0) return false;
    }
    return true;
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
        if (auto s =
                checkCoordinates(sheets.chunks.place(i), i, sheets.textures.size(), face);
            !s)
            return s;
    }
    return {};
}

void buildSheets(NearSheets& sheets) {
    for (NearTexture& texture : sheets.textures)
        buildBordered(texture);
}

bool sameSheets(const NearSheets& a, const NearSheets& b) noexcept {
    return sameChunks(a.triangles, b.triangles) && sameCoordinates(a.chunks, b.chunks) &&
           std::equal(a.textures.begin(), a.textures.end(), b.textures.begin(),
                      b.textures.end(), sameTexture);
}

}  // namespace map_detail
}  // namespace mtsm
