#include "format/card_block.h"

#include <cstring>

#include "format/near_block.h"
#include "format/near_parts.h"

namespace mtsm::format {
namespace {

constexpr std::size_t kWords = 6, kCoordinates = 6 * NearChunk::kTriangles;  // of a chunk

/// Byte j of a chunk's words lies in plane j, word by word; of its coordinates likewise.
struct CoordinateParts : AppendedParts<NearSheetChunks> {
    static constexpr std::uint64_t kMostPoints = 0;

    static std::uint64_t memoryBytes(std::uint64_t chunks, std::uint64_t) {
        // Twice: by part, and all together.
        return 2 * NearSheetChunks::memoryBytes(chunks, NearChunks::kCorners);
    }
    static bool checkPoints(std::uint64_t points, std::uint64_t) { return points == 0; }
    static std::uint64_t contentBytes(std::uint64_t chunks, std::uint64_t) {
        return (4 * kWords + 2 * kCoordinates) * chunks;
    }
    static Bytes contentOf(const Chunks& chunks, std::size_t first, std::size_t count,
                           std::uint32_t&) {
        Bytes content(contentBytes(count, 0));
        std::uint8_t* const rest = content.data() + 4 * kWords * count;
        for (std::size_t i = 0; i < count; ++i) {
            const NearSheetChunk c = chunks[first + i];
            const std::uint32_t words[kWords] = {c.texture,
                                                 c.triangles,
                                                 std::bit_cast<std::uint32_t>(c.low[0]),
                                                 std::bit_cast<std::uint32_t>(c.low[1]),
                                                 std::bit_cast<std::uint32_t>(c.step[0]),
                                                 std::bit_cast<std::uint32_t>(c.step[1])};
            for (std::size_t k = 0; k < kWords; ++k) {
                for (std::size_t j = 0; j < 4; ++j)
                    content[(j * kWords + k) * count + i] =
                        std::uint8_t(words[k] >> (8 * j));
            }
            const std::uint16_t* const uv = &c.uv[0][0][0];
            for (std::size_t k = 0; k < kCoordinates; ++k) {
                for (std::size_t j = 0; j < 2; ++j)
                    rest[(j * count + i) * kCoordinates + k] =
                        std::uint8_t(uv[k] >> (8 * j));
            }
        }
        return content;
    }
    static Status decode(BytesView content, const ChunkPart& place, std::uint32_t,
                         Chunks&, Part& part) {
        const std::size_t count = place.count;
        const std::uint8_t* const rest = content.data() + 4 * kWords * count;
        for (std::size_t i = 0; i < count; ++i) {
            NearSheetChunk c;
            std::uint32_t words[kWords] = {};
            for (std::size_t k = 0; k < kWords; ++k) {
                for (std::size_t j = 0; j < 4; ++j)
                    words[k] |= std::uint32_t(content[(j * kWords + k) * count + i])
                                << (8 * j);
            }
            c.texture = words[0], c.triangles = words[1];
            for (int axis = 0; axis < 2; ++axis) {
                c.low[axis] = std::bit_cast<float>(words[2 + axis]);
                c.step[axis] = std::bit_cast<float>(words[4 + axis]);
            }
            std::uint16_t* const uv = &c.uv[0][0][0];
            for (std::size_t k = 0; k < kCoordinates; ++k)
                uv[k] = std::uint16_t(rest[i * kCoordinates + k] |
                                      rest[(count + i) * kCoordinates + k] << 8);
            part.push_back(c);
        }
        part.shrink_to_fit();
        return {};
    }
};

CardTexture recordOf(const NearTexture& texture, std::uint64_t storedLength) {
    CardTexture record = {};
    record.width = texture.width, record.height = texture.height;
    record.wrapU = std::uint32_t(texture.wrapU);
    record.wrapV = std::uint32_t(texture.wrapV);
    record.cutoff = texture.cutoff, record.opacity = texture.opacity;
    record.storedLength = storedLength;
    return record;
}

/// The textures' records are no more than payload and memory allow; takes what they need
/// from `most`.
Status checkTextures(const std::vector<CardTexture>& records, std::uint64_t& most) {
    constexpr std::uint32_t kMostTexels = OpacityImage::kMostTexels;
    std::uint64_t memory = 0;
    for (std::size_t i = 0; i < records.size(); ++i) {
        const CardTexture& r = records[i];
        if (r.width < 1 || r.width > kMostTexels || r.height < 1 ||
            r.height > kMostTexels)
            return bad("texture ", i, ": ", r.width, " x ", r.height,
                       " texels, each side must have 1 to ", kMostTexels);
        if (r.wrapU > std::uint32_t(TextureWrap::mirror) ||
            r.wrapV > std::uint32_t(TextureWrap::mirror))
            return bad("texture ", i, ": wraps as ", r.wrapU, " and ", r.wrapV,
                       ", each must be 0 to 2");
        const std::uint64_t texels = std::uint64_t(r.width) * r.height;
        if (r.storedLength < 1 || r.storedLength > texels)
            return bad("texture ", i, ": stores ", r.storedLength, " bytes for ", texels);
        memory += nearTextureBytes(r.width, r.height) + sizeof(NearTexture);
    }
    if (memory > most)
        return base::makeError(ErrorCode::tooLarge, "its textures take ", memory,
                               " bytes, more than the ", most,
                               " that ReadLimits::maxBytes leaves for it");
    most -= memory;
    return {};
}

Status decodeTexture(const CardTexture& record, BytesView stored, FrameDecoder& frames,
                     NearTexture& texture) {
    const std::size_t texels = std::size_t(record.width) * record.height;
    Bytes decoded;
    if (stored.size() < texels) {
        if (auto s = frames.decode(stored, texels, decoded); !s) return s;
        stored = decoded;
    }
    texture.width = record.width, texture.height = record.height;
    texture.wrapU = TextureWrap(record.wrapU), texture.wrapV = TextureWrap(record.wrapV);
    texture.cutoff = record.cutoff, texture.opacity = record.opacity;
    texture.texels.assign(stored.begin(), stored.begin() + std::ptrdiff_t(texels));
    return {};
}

/// Reads as far as the texels reach; takes what they need from `most`.
Status decodeTextures(base::ByteReader& in, std::uint64_t& most,
                      std::vector<NearTexture>& textures) {
    const auto count = in.get<std::uint32_t>();
    if (!in.ok() || count > in.left() / sizeof(CardTexture))
        return bad("claims ", count, " textures, whose records do not fit in it");
    std::vector<CardTexture> records;
    for (std::uint32_t i = 0; i < count; ++i)
        records.push_back(in.get<CardTexture>());
    if (auto s = checkTextures(records, most); !s) return s;
    std::vector<BytesView> stored;
    for (const CardTexture& record : records)
        stored.push_back(in.bytes(record.storedLength));
    if (!in.ok()) return bad("a texture reaches past the end");
    textures.resize(count);
    FrameDecoder frames;
    for (std::uint32_t i = 0; i < count; ++i) {
        if (auto s = decodeTexture(records[i], stored[i], frames, textures[i]); !s)
            return bad("texture ", i, ": ", s.error().message);
    }
    return {};
}

}  // namespace

bool hasNearSheets(const ShadowMap& map) noexcept {
    return !map.nearSheets(0).empty();
}

Bytes encodeSheets(const ShadowMap& map, Codec codec, int level) {
    const NearSheets& sheets = map.nearSheets(0);
    Bytes payload;
    base::ByteWriter out(payload);
    out.put(std::uint32_t(sheets.textures.size()));
    std::vector<Bytes> stored;
    for (const NearTexture& texture : sheets.textures) {
        stored.push_back(compressPart(texture.texels, 0, codec, level).bytes);
        out.put(recordOf(texture, stored.back().size()));
    }
    for (const Bytes& texels : stored)
        out.bytes(texels);
    const Bytes triangles = encodeTriangles({&sheets.triangles.chunks}, codec, level);
    out.put(std::uint64_t(triangles.size()));
    out.bytes(triangles);
    out.bytes(encodeParts<CoordinateParts>({&sheets.chunks}, codec, level));
    return payload;
}

Status decodeSheets(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces) {
    if (faces.size() != 1) return bad("is of a map of ", faces.size(), " faces, not 1");
    NearSheets& sheets = faces[0].nearSheets;
    base::ByteReader in(payload);
    if (auto s = decodeTextures(in, most, sheets.textures); !s) return s;
    const auto length = in.get<std::uint64_t>();
    const BytesView triangles = in.bytes(length);
    if (!in.ok()) return bad("its triangles reach past the end");
    if (auto s = decodeTriangles(triangles, most, {&sheets.triangles.chunks}); !s)
        return s;
    const std::size_t chunks = sheets.triangles.chunks.size();
    most -= std::min(most, memoryBytes(sheets.triangles));
    if (auto s =
            decodeParts<CoordinateParts>(in.bytes(in.left()), most, {&sheets.chunks});
        !s)
        return s;
    if (sheets.chunks.size() != chunks)
        return bad(sheets.chunks.size(), " chunks of texture coordinates for ", chunks,
                   " of triangles");
    return {};
}

}  // namespace mtsm::format
