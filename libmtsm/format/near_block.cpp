#include "format/near_block.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/task_arena.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <new>

#include "base/bytes.h"
#include "base/message.h"
#include "base/parallel.h"
#include "format/bad_file.h"
#include "format/first_error.h"
#include "format/frame.h"
#include "format/layout.h"

namespace mtsm::format {
namespace {

constexpr std::uint32_t kPartChunks = 1024;  // 16384 triangles, 312 KiB
constexpr std::size_t kFloats = 6, kTriangles = NearChunk::kTriangles;
constexpr std::size_t kCorners = 3 * kTriangles;  // of a chunk
constexpr std::size_t kChunkBytes = 4 * kFloats + kCorners;
constexpr std::size_t kPointBytes = 6;

std::uint64_t partsOf(std::uint64_t chunks, std::uint32_t partChunks) {
    return chunks / partChunks + (chunks % partChunks != 0);
}

/// The part's chunks, wherever they lie.
struct Part {
    std::size_t face = 0, first = 0, count = 0;
};

/// Of chunks by face, in the order of the file.
std::vector<Part> partsOf(const std::vector<std::uint64_t>& chunks,
                          std::uint32_t partChunks) {
    std::vector<Part> parts;
    for (std::size_t face = 0; face < chunks.size(); ++face) {
        for (std::size_t first = 0; first < chunks[face]; first += partChunks)
            parts.push_back(
                {face, first, std::min<std::size_t>(partChunks, chunks[face] - first)});
    }
    return parts;
}

/// Before its compression: kChunkBytes for each chunk, kPointBytes for each point.
std::uint64_t contentBytes(std::uint64_t chunks, std::uint64_t points) {
    return kChunkBytes * chunks + kPointBytes * points;
}

constexpr std::uint16_t zigzag16(std::uint16_t d) {
    return std::uint16_t(d << 1 ^ (d & 0x8000 ? 0xffff : 0));
}
constexpr std::uint16_t unzigzag16(std::uint16_t r) {
    return std::uint16_t(r >> 1 ^ (r & 1 ? 0xffff : 0));
}

using Point = std::array<std::uint16_t, 3>;  // u, v, w on the chunk's grid

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

Bytes contentOf(const NearChunk* chunks, std::size_t count, std::uint32_t& points) {
    std::vector<Points> all;
    all.reserve(count);
    points = 0;
    for (std::size_t i = 0; i < count; ++i) {
        all.emplace_back(chunks[i]);
        points += std::uint32_t(all.back().count);
    }
    Bytes content(contentBytes(count, points));
    const PartLayout<std::uint8_t> to{content.data(), count, points};
    std::size_t at = 0;
    for (std::size_t i = 0; i < count; ++i) {
        for (std::size_t f = 0; f < kFloats; ++f) {
            const auto bits = std::bit_cast<std::uint32_t>(f < 3 ? chunks[i].low[f]
                                                                 : chunks[i].step[f - 3]);
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
Status decodeContent(const PartLayout<const std::uint8_t>& from, NearChunk* chunks) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < from.chunks; ++i) {
        NearChunk& chunk = chunks[i];
        for (std::size_t f = 0; f < kFloats; ++f) {
            std::uint32_t bits = 0;
            for (std::size_t j = 0; j < 4; ++j)
                bits |= std::uint32_t(from.atFloat(j, f, i)) << (8 * j);
            (f < 3 ? chunk.low[f] : chunk.step[f - 3]) = std::bit_cast<float>(bits);
        }
        std::array<Point, kCorners> point;
        std::size_t count = 0;
        for (std::size_t corner = 0; corner < kCorners; ++corner) {
            const std::size_t ago = from.atCorners(i)[corner];
            if (ago > count || (ago == 0 && at == from.points))
                return bad("chunk ", i, ": corner ", corner, " is a point ", ago,
                           " before, of ", count);
            if (ago == 0) {
                Point p = count > 0 ? point[count - 1] : Point{};
                for (std::size_t axis = 0; axis < 3; ++axis) {
                    const auto r = std::uint16_t(from.atPoint(0, axis, at) |
                                                 from.atPoint(1, axis, at) << 8);
                    p[axis] = std::uint16_t(p[axis] + unzigzag16(r));
                }
                point[count++] = p;
                ++at;
            }
            const Point& p = point[count - (ago == 0 ? 1 : ago)];
            for (std::size_t axis = 0; axis < 3; ++axis)
                chunk.corner[corner % 3][axis][corner / 3] = p[axis];
        }
    }
    if (at != from.points) return bad(from.points - at, " points that no corner names");
    return {};
}

/// A part as it is stored.
struct StoredPart {
    NearPart record = {};
    Bytes bytes;
};

StoredPart encodePart(const NearChunk* chunks, std::size_t count, Codec codec,
                      int level) {
    StoredPart part;
    part.bytes = contentOf(chunks, count, part.record.points);
    if (codec == Codec::zstd) {
        Bytes frame(ZSTD_compressBound(part.bytes.size()));
        const std::size_t n = ZSTD_compress(frame.data(), frame.size(), part.bytes.data(),
                                            part.bytes.size(), level);
        if (ZSTD_isError(n)) throw std::bad_alloc();  // the only way left for it to fail
        frame.resize(n);
        if (n < part.bytes.size()) part.bytes = std::move(frame);
    }
    part.record.storedLength = std::uint32_t(part.bytes.size());
    return part;
}

std::vector<std::uint64_t> chunksByFace(const ShadowMap& map) {
    std::vector<std::uint64_t> chunks;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        chunks.push_back(map.nearField(face).chunks.size());
    return chunks;
}

}  // namespace

bool hasNearField(const ShadowMap& map) noexcept {
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        if (!map.nearField(face).empty()) return true;
    }
    return false;
}

// --- writing
// -------------------------------------------------------------------------------

Bytes encodeNear(const ShadowMap& map, Codec codec, int level) {
    const std::vector<std::uint64_t> chunks = chunksByFace(map);
    const std::vector<Part> parts = partsOf(chunks, kPartChunks);
    std::vector<StoredPart> stored(parts.size());
    base::parallelFor(std::size_t(0), parts.size(), [&](std::size_t i) {
        const Part& p = parts[i];
        const auto face = static_cast<std::uint32_t>(p.face);
        stored[i] = encodePart(map.nearField(face).chunks.data() + p.first, p.count,
                               codec, level);
    });
    Bytes payload;
    base::ByteWriter out(payload);
    out.put(NearFixed{map.faceCount(), kPartChunks});
    for (const std::uint64_t count : chunks)
        out.put(count);
    for (const StoredPart& part : stored)
        out.put(part.record);
    for (const StoredPart& part : stored)
        out.bytes(part.bytes);
    return payload;
}

// --- reading
// -------------------------------------------------------------------------------

namespace {

/// What a NEAR block says before its parts, in agreement with itself.
struct NearIndex {
    std::vector<Part> parts;
    std::vector<NearPart> records;  ///< by part
    std::vector<BytesView> stored;
};

/// The chunks of all faces are no more than payload and memory allow.
Status checkChunkCounts(const std::vector<std::uint64_t>& chunks,
                        std::uint32_t partChunks, std::uint64_t bytesLeft,
                        std::uint64_t most) {
    std::uint64_t parts = 0, memory = 0;
    for (const std::uint64_t count : chunks) {
        // Each part has a record: so no sum can overflow.
        if (count / partChunks > bytesLeft / sizeof(NearPart))
            return bad("claims ", count, " chunks, more than the block can hold");
        parts += partsOf(count, partChunks);
        memory += nearFieldBytes(count);
    }
    if (parts > bytesLeft / sizeof(NearPart))
        return bad("claims ", parts, " parts, whose records do not fit in it");
    // Besides, what is known of each part, and for each thread the content of one.
    const auto threads =
        static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    memory += parts * (sizeof(Part) + sizeof(NearPart) + sizeof(BytesView)) +
              std::min(parts, threads) * contentBytes(partChunks, kCorners * partChunks);
    if (memory > most)
        return base::makeError(ErrorCode::tooLarge, "takes ", memory,
                               " bytes to decode, more than the ", most,
                               " that ReadLimits::maxBytes (--max-memory) leaves for it");
    return {};
}

Result<NearIndex> decodeNearIndex(BytesView payload, std::uint64_t most,
                                  std::vector<MapFace>& faces) {
    base::ByteReader in(payload);
    const auto fixed = in.get<NearFixed>();
    if (!in.ok()) return bad("ends within its first ", sizeof fixed, " bytes");
    if (fixed.faces != faces.size())
        return bad("has ", fixed.faces, " faces, not ", faces.size());
    if (fixed.partChunks < 1 || fixed.partChunks > kMaxPartChunks)
        return bad("parts of ", fixed.partChunks, " chunks, must be 1 to ",
                   kMaxPartChunks);
    std::vector<std::uint64_t> chunks(faces.size());
    for (std::uint64_t& count : chunks)
        count = in.get<std::uint64_t>();
    if (!in.ok()) return bad("ends within its numbers of chunks");
    if (auto s = checkChunkCounts(chunks, fixed.partChunks, in.left(), most); !s)
        return s.error();

    NearIndex index;
    index.parts = partsOf(chunks, fixed.partChunks);
    index.records.reserve(index.parts.size());
    index.stored.reserve(index.parts.size());
    for (std::size_t i = 0; i < index.parts.size(); ++i)
        index.records.push_back(in.get<NearPart>());
    for (std::size_t i = 0; i < index.parts.size(); ++i) {
        const NearPart& r = index.records[i];
        const std::size_t count = index.parts[i].count;
        if (r.points < count || r.points > kCorners * count)
            return bad("part ", i, ": claims ", r.points, " points for ", count,
                       " chunks");
        if (r.storedLength < 1 || r.storedLength > contentBytes(count, r.points))
            return bad("part ", i, ": stores ", r.storedLength, " bytes for ",
                       contentBytes(count, r.points));
        index.stored.push_back(in.bytes(r.storedLength));
        if (!in.ok()) return bad("part ", i, ": reaches past the end");
    }
    if (in.left() != 0) return bad(in.left(), " bytes are left over at its end");
    for (std::size_t face = 0; face < faces.size(); ++face)
        faces[face].nearField.chunks.resize(chunks[face]);
    return index;
}

}  // namespace

Status decodeNear(BytesView payload, std::uint64_t most, std::vector<MapFace>& faces) {
    const Result<NearIndex> index = decodeNearIndex(payload, most, faces);
    if (!index) return index.error();
    struct Worker {
        FrameDecoder frames;
        Bytes content;
    };
    tbb::enumerable_thread_specific<Worker> workers;
    FirstError firstError;
    const auto decodePart = [&](std::size_t i, Worker& worker) -> Status {
        const Part& part = index->parts[i];
        const std::uint32_t points = index->records[i].points;
        const std::uint64_t length = contentBytes(part.count, points);
        BytesView content = index->stored[i];
        if (content.size() < length) {
            if (auto s = worker.frames.decode(content, length, worker.content); !s)
                return s;
            content = worker.content;
        }
        return decodeContent(
            PartLayout<const std::uint8_t>{content.data(), part.count, points},
            faces[part.face].nearField.chunks.data() + part.first);
    };
    base::parallelFor(std::size_t(0), index->parts.size(), [&](std::size_t i) {
        if (firstError.isBehind(i)) return;
        if (const Status s = decodePart(i, workers.local()); !s)
            firstError.add(i, bad("part ", i, ": ", s.error().message));
    });
    return firstError.status();
}

}  // namespace mtsm::format
