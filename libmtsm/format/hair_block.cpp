#include "format/hair_block.h"

#include "format/near_parts.h"

namespace mtsm::format {
namespace {

constexpr std::size_t kFloats = 7, kSegments = NearHairChunk::kSegments;
constexpr std::size_t kWords = 7;  // of a segment: u, v, w of its ends, opacity
constexpr std::size_t kChunkBytes = 4 * kFloats + kSegments * (2 * kWords + 2);

/// Where the bytes of a part lie: byte 0 of all floats, then bytes 1, 2 and 3; byte 0 of
/// all words, then byte 1; all half widths.
template <typename Byte>
struct HairLayout {
    Byte* bytes;
    std::size_t chunks;

    /// Byte j of element i of a chunk: low u, v, w, step u, v, w, halfStep.
    [[nodiscard]] Byte& atFloat(std::size_t j, std::size_t i, std::size_t chunk) const {
        return bytes[(j * kFloats + i) * chunks + chunk];
    }
    /// Byte j of word i.
    [[nodiscard]] Byte& atWord(std::size_t j, std::size_t i, std::size_t chunk,
                               std::size_t segment) const {
        return bytes[4 * kFloats * chunks +
                     ((j * kWords + i) * chunks + chunk) * kSegments + segment];
    }
    [[nodiscard]] Byte& atHalf(std::size_t end, std::size_t chunk,
                               std::size_t segment) const {
        return bytes[(4 * kFloats + 2 * kWords * kSegments) * chunks +
                     (end * chunks + chunk) * kSegments + segment];
    }
};

/// Goes through the ends of a chunk's segments along an axis: word(end, axis, segment,
/// from) returns the end's number, which is stored as its way from `from`: of the first
/// end that of the segment before, of the second that of the first.
template <typename Word>
void eachWord(std::size_t axis, const Word& word) {
    std::uint16_t before = 0;
    for (std::size_t segment = 0; segment < kSegments; ++segment) {
        const std::uint16_t first = word(0, axis, segment, before);
        word(1, axis, segment, first);
        before = first;
    }
}

void put(const NearHairChunk& chunk, std::size_t i, const HairLayout<std::uint8_t>& to) {
    for (std::size_t f = 0; f < kFloats; ++f) {
        const float value = f < 3   ? chunk.low[f]
                            : f < 6 ? chunk.step[f - 3]
                                    : chunk.halfStep;
        const auto bits = std::bit_cast<std::uint32_t>(value);
        for (std::size_t j = 0; j < 4; ++j)
            to.atFloat(j, f, i) = std::uint8_t(bits >> (8 * j));
    }
    const auto putWord = [&](std::size_t word, std::size_t segment, std::uint16_t value) {
        to.atWord(0, word, i, segment) = std::uint8_t(value);
        to.atWord(1, word, i, segment) = std::uint8_t(value >> 8);
    };
    for (std::size_t axis = 0; axis < 3; ++axis) {
        eachWord(axis, [&](std::size_t end, std::size_t of, std::size_t segment,
                           std::uint16_t from) {
            const std::uint16_t q = chunk.end[end][of][segment];
            putWord(3 * end + of, segment, zigzag16(std::uint16_t(q - from)));
            return q;
        });
    }
    for (std::size_t segment = 0; segment < kSegments; ++segment) {
        putWord(6, segment, chunk.opacity[segment]);
        for (std::size_t end = 0; end < 2; ++end)
            to.atHalf(end, i, segment) = chunk.half[end][segment];
    }
}

/// Undoes put().
NearHairChunk take(const HairLayout<const std::uint8_t>& from, std::size_t i) {
    NearHairChunk chunk;
    for (std::size_t f = 0; f < kFloats; ++f) {
        std::uint32_t bits = 0;
        for (std::size_t j = 0; j < 4; ++j)
            bits |= std::uint32_t(from.atFloat(j, f, i)) << (8 * j);
        (f < 3   ? chunk.low[f]
         : f < 6 ? chunk.step[f - 3]
                 : chunk.halfStep) = std::bit_cast<float>(bits);
    }
    const auto takeWord = [&](std::size_t word, std::size_t segment) {
        return std::uint16_t(from.atWord(0, word, i, segment) |
                             from.atWord(1, word, i, segment) << 8);
    };
    for (std::size_t axis = 0; axis < 3; ++axis) {
        eachWord(axis, [&](std::size_t end, std::size_t of, std::size_t segment,
                           std::uint16_t before) {
            return chunk.end[end][of][segment] = std::uint16_t(
                       before + unzigzag16(takeWord(3 * end + of, segment)));
        });
    }
    for (std::size_t segment = 0; segment < kSegments; ++segment) {
        chunk.opacity[segment] = takeWord(6, segment);
        for (std::size_t end = 0; end < 2; ++end)
            chunk.half[end][segment] = from.atHalf(end, i, segment);
    }
    return chunk;
}

struct HairParts {
    using Chunks = NearHairChunks;
    using Part = std::vector<Chunks::Row>;
    static constexpr std::uint64_t kMostPoints = 0;
    /// At most so: what does not fit in a chunk's place is there three times, by part, in
    /// what parts grew by, and all together.
    static std::uint64_t memoryBytes(std::uint64_t chunks, std::uint64_t) {
        constexpr std::uint64_t most = 3 * Chunks::kMostBytes - 2 * Chunks::kLeastBytes;
        return nearHairBytes(chunks) + chunks * (most - Chunks::kLongBytes);
    }
    static bool checkPoints(std::uint64_t points, std::uint64_t) { return points == 0; }
    static std::uint64_t contentBytes(std::uint64_t chunks, std::uint64_t) {
        return kChunkBytes * chunks;
    }
    static Bytes contentOf(const Chunks& chunks, std::size_t first, std::size_t count,
                           std::uint32_t& points) {
        points = 0;
        Bytes content(kChunkBytes * count);
        for (std::size_t i = 0; i < count; ++i)
            put(chunks[first + i], i, HairLayout<std::uint8_t>{content.data(), count});
        return content;
    }
    static void begin(Chunks& chunks, std::size_t count) { chunks.resize(count); }
    static Status decode(BytesView content, const ChunkPart& place, std::uint32_t,
                         Chunks& chunks, Part& more) {
        const HairLayout<const std::uint8_t> from{content.data(), place.count};
        for (std::size_t i = 0; i < place.count; ++i)
            chunks.set(place.first + i, take(from, i), more);
        return {};
    }
    static void join(Chunks& chunks, const ChunkPart* places, Part* parts,
                     std::size_t count) {
        std::size_t rows = 0;
        for (std::size_t i = 0; i < count; ++i)
            rows += parts[i].size();
        chunks.reserveMore(rows);
        for (std::size_t i = 0; i < count; ++i) {
            chunks.addMore(places[i].first, places[i].count, parts[i]);
            parts[i] = {};
        }
    }
};

}  // namespace

bool hasNearHair(const ShadowMap& map) noexcept {
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        if (!map.nearHair(face).empty()) return true;
    }
    return false;
}

Bytes encodeHair(const ShadowMap& map, Codec codec, int level) {
    std::vector<const NearHairChunks*> faces;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        faces.push_back(&map.nearHair(face).chunks);
    return encodeParts<HairParts>(faces, codec, level);
}

Status decodeHair(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces) {
    std::vector<NearHairChunks*> chunks;
    for (MapFace& face : faces)
        chunks.push_back(&face.nearHair.chunks);
    return decodeParts<HairParts>(payload, most, chunks);
}

}  // namespace mtsm::format
