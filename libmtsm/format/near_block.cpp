#include "format/near_block.h"

#include <array>

#include "format/near_parts.h"

namespace mtsm::format {
namespace {

constexpr std::size_t kFloats = 6, kTriangles = NearChunk::kTriangles;
constexpr std::size_t kCorners = 3 * kTriangles;  // of a chunk
constexpr std::size_t kChunkBytes = 4 * kFloats + kCorners;
constexpr std::size_t kPointBytes = 6;

/// Before its compression: kChunkBytes for each chunk, kPointBytes for each point.
std::uint64_t contentBytes(std::uint64_t chunks, std::uint64_t points) {
    return kChunkBytes * chunks + kPointBytes * points;
}

using Point = NearChunks::Point;

Point pointOf(const NearChunk& chunk, std::size_t corner) {
    const auto& c = chunk.corner[corner % 3];
    const std::size_t t = corner / 3;
    return {c[0][t], c[1][t], c[2][t]};
}

/// The different points of a chunk in the order in which its corners first name them, and
/// for each corner 0 if it is a new one, else how many new ones ago its point was new.
struct Points {
    std::array<Point, kCorners> point;
    std::size_t count = 0;
    std::array<std::uint8_t, kCorners> ago;

    explicit Points(const NearChunk& chunk) {
        for (std::size_t corner = 0; corner < kCorners; ++corner) {
            const Point p = pointOf(chunk, corner);
            std::size_t known = count;
            while (known > 0 && point[known - 1] != p)
                --known;
            ago[corner] = std::uint8_t(known > 0 ? count - known + 1 : 0);
            if (known == 0) point[count++] = p;
        }
    }
};

/// Where the bytes of a part lie: byte 0 of all floats, then bytes 1, 2 and 3; how long
/// ago each corner was new; byte 0 of all new points, u before v before w, then byte 1.
template <typename Byte>
struct PartLayout {
    Byte* bytes;
    std::size_t chunks, points;

    /// Byte j of element i of a chunk: low u, v, w, step u, v, w.
    [[nodiscard]] Byte& atFloat(std::size_t j, std::size_t i, std::size_t chunk) const {
        return bytes[(j * kFloats + i) * chunks + chunk];
    }
    [[nodiscard]] Byte* atCorners(std::size_t chunk) const {
        return bytes + 4 * kFloats * chunks + kCorners * chunk;
    }
    [[nodiscard]] Byte& atPoint(std::size_t j, std::size_t axis,
                                std::size_t point) const {
        return bytes[kChunkBytes * chunks + (3 * j + axis) * points + point];
    }
};

Bytes contentOf(const NearChunks& chunks, std::size_t first, std::size_t count,
                std::uint32_t& points) {
    std::vector<Points> all;
    all.reserve(count);
    points = 0;
    for (std::size_t i = 0; i < count; ++i) {
        all.emplace_back(chunks[first + i]);
        points += std::uint32_t(all.back().count);
    }
    Bytes content(contentBytes(count, points));
    const PartLayout<std::uint8_t> to{content.data(), count, points};
    std::size_t at = 0;
    for (std::size_t i = 0; i < count; ++i) {
        for (std::size_t f = 0; f < kFloats; ++f) {
            const NearChunks::Place& place = chunks.place(first + i);
            const auto bits =
                std::bit_cast<std::uint32_t>(f < 3 ? place.low[f] : place.step[f - 3]);
            for (std::size_t j = 0; j < 4; ++j)
                to.atFloat(j, f, i) = std::uint8_t(bits >> (8 * j));
        }
        std::copy(all[i].ago.begin(), all[i].ago.end(), to.atCorners(i));
        Point before = {};
        for (std::size_t k = 0; k < all[i].count; ++k, ++at) {
            const Point p = all[i].point[k];
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto r = zigzag16(std::uint16_t(p[axis] - before[axis]));
                to.atPoint(0, axis, at) = std::uint8_t(r);
                to.atPoint(1, axis, at) = std::uint8_t(r >> 8);
            }
            before = p;
        }
    }
    return content;
}

/// Undoes contentOf(). Errors: a corner names a point that is not there.
Status decodeContent(const PartLayout<const std::uint8_t>& from, NearChunks& chunks) {
    chunks.reserve(from.chunks, from.points);
    const std::uint8_t* bytes[2][3];
    for (std::size_t j = 0; j < 2; ++j) {
        for (std::size_t axis = 0; axis < 3; ++axis)
            bytes[j][axis] = &from.atPoint(j, axis, 0);
    }
    std::size_t at = 0;
    for (std::size_t i = 0; i < from.chunks; ++i) {
        float low[3], step[3];
        for (std::size_t f = 0; f < kFloats; ++f) {
            std::uint32_t bits = 0;
            for (std::size_t j = 0; j < 4; ++j)
                bits |= std::uint32_t(from.atFloat(j, f, i)) << (8 * j);
            (f < 3 ? low[f] : step[f - 3]) = std::bit_cast<float>(bits);
        }
        std::array<Point, kCorners> point;
        std::array<std::uint8_t, kCorners> number;
        Point p = {};
        std::size_t count = 0;
        const std::uint8_t* const corners = from.atCorners(i);
        for (std::size_t corner = 0; corner < kCorners; ++corner) {
            const std::size_t ago = corners[corner];
            if (ago > count || (ago == 0 && at == from.points))
                return bad("chunk ", i, ": corner ", corner, " is a point ", ago,
                           " before, of ", count);
            number[corner] = std::uint8_t(count - ago);
            if (ago > 0) continue;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto r =
                    std::uint16_t(bytes[0][axis][at] | bytes[1][axis][at] << 8);
                p[axis] = std::uint16_t(p[axis] + unzigzag16(r));
            }
            point[count++] = p;
            ++at;
        }
        chunks.push_back(low, step, point.data(), count, number.data());
    }
    if (at != from.points) return bad(from.points - at, " points that no corner names");
    chunks.shrink_to_fit();
    return {};
}

struct TriangleParts : AppendedParts<NearChunks> {
    static constexpr std::uint64_t kMostPoints = kCorners;  // of a chunk
    /// Twice: by part, and all together. At most so: as many chunks as points allow have
    /// more of them than can be shared.
    static std::uint64_t memoryBytes(std::uint64_t chunks, std::uint64_t points) {
        constexpr std::uint64_t kShared = NearChunks::kMostShared;
        const std::uint64_t unshared = std::min(chunks, points / (kShared + 1));
        const std::uint64_t shared =
            std::min(points - (kShared + 1) * unshared, kShared * (chunks - unshared));
        const std::uint64_t once = NearChunks::memoryBytes(chunks - unshared, 0) +
                                   NearChunks::memoryBytes(unshared, kCorners) +
                                   shared * sizeof(Point);
        return 2 * once + nearFieldBytes(chunks, 0) - NearChunks::memoryBytes(chunks, 0);
    }
    static bool checkPoints(std::uint64_t points, std::uint64_t chunks) {
        return points >= chunks && points <= kMostPoints * chunks;
    }
    static std::uint64_t contentBytes(std::uint64_t chunks, std::uint64_t points) {
        return format::contentBytes(chunks, points);
    }
    static Bytes contentOf(const Chunks& chunks, std::size_t first, std::size_t count,
                           std::uint32_t& points) {
        return format::contentOf(chunks, first, count, points);
    }
    static Status decode(BytesView content, const ChunkPart& place, std::uint32_t points,
                         Chunks&, Part& part) {
        return decodeContent(
            PartLayout<const std::uint8_t>{content.data(), place.count, points}, part);
    }
};

}  // namespace

bool hasNearField(const ShadowMap& map) noexcept {
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        if (!map.nearField(face).empty()) return true;
    }
    return false;
}

Bytes encodeTriangles(const std::vector<const NearChunks*>& faces, Codec codec,
                      int level) {
    return encodeParts<TriangleParts>(faces, codec, level);
}

Status decodeTriangles(BytesView payload, std::uint64_t most,
                       const std::vector<NearChunks*>& faces) {
    return decodeParts<TriangleParts>(payload, most, faces);
}

Bytes encodeNear(const ShadowMap& map, Codec codec, int level) {
    std::vector<const NearChunks*> faces;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        faces.push_back(&map.nearField(face).chunks);
    return encodeTriangles(faces, codec, level);
}

Status decodeNear(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces) {
    std::vector<NearChunks*> chunks;
    for (MapFace& face : faces)
        chunks.push_back(&face.nearField.chunks);
    return decodeTriangles(payload, most, chunks);
}

}  // namespace mtsm::format
