// near_parts.h - chunks of near fields <-> the payload that NEAR and HAIR have in common:
// how many there are, and parts of them, each compressed alone.
//
// `Kind` says what the chunks are:
//   Chunks, Part                       many of them, and what decode() makes of some
//   kMostPoints                        what NearPart::points may be for one
//   memoryBytes(chunks, points)        that they may take, boxes and work included
//   checkPoints(points, chunks)        may a part say so?
//   contentBytes(chunks, points)       of a part, before its compression
//   contentOf(chunks, first, count, points)
//                                      writes it, and says how many points there are
//   begin(chunks, count)               so many will come
//   decode(content, place, points, chunks, part)
//                                      of a part, others at the same time
//   join(chunks, places, parts, count) what was decoded, in order; parts need not last
#pragma once
#include <tbb/enumerable_thread_specific.h>
#include <tbb/task_arena.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <functional>
#include <new>
#include <vector>

#include "base/bytes.h"
#include "base/message.h"
#include "base/parallel.h"
#include "format/bad_file.h"
#include "format/first_error.h"
#include "format/frame.h"
#include "format/layout.h"
#include "mtsm/writer.h"

namespace mtsm::format {

inline constexpr std::uint32_t kPartChunks = 1024;  // 16384 triangles

constexpr std::uint16_t zigzag16(std::uint16_t d) {
    return std::uint16_t(d << 1 ^ (d & 0x8000 ? 0xffff : 0));
}
constexpr std::uint16_t unzigzag16(std::uint16_t r) {
    return std::uint16_t(r >> 1 ^ (r & 1 ? 0xffff : 0));
}

/// A part's chunks, wherever they lie.
struct ChunkPart {
    std::size_t face = 0, first = 0, count = 0;
};

inline std::uint64_t partsOf(std::uint64_t chunks, std::uint32_t partChunks) {
    return chunks / partChunks + (chunks % partChunks != 0);
}

/// Of a Kind whose parts are chunks that become part of all.
template <typename Appended>
struct AppendedParts {
    using Chunks = Appended;
    using Part = Appended;
    static void begin(Chunks&, std::size_t) {}
    static void join(Chunks& chunks, const ChunkPart*, Part* parts, std::size_t count) {
        chunks.append(parts, count);
    }
};

/// Of chunks by face, in the order of the file.
inline std::vector<ChunkPart> partsOf(const std::vector<std::uint64_t>& chunks,
                                      std::uint32_t partChunks) {
    std::vector<ChunkPart> parts;
    for (std::size_t face = 0; face < chunks.size(); ++face) {
        for (std::size_t first = 0; first < chunks[face]; first += partChunks)
            parts.push_back(
                {face, first, std::min<std::size_t>(partChunks, chunks[face] - first)});
    }
    return parts;
}

// --- writing
// -------------------------------------------------------------------------------

/// A part as it is stored.
struct StoredPart {
    NearPart record = {};
    Bytes bytes;
};

inline StoredPart compressPart(Bytes content, std::uint32_t points, Codec codec,
                               int level) {
    StoredPart part;
    part.record.points = points;
    part.bytes = std::move(content);
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

/// `faces`: the chunks of each.
template <typename Kind>
Bytes encodeParts(const std::vector<const typename Kind::Chunks*>& faces, Codec codec,
                  int level) {
    std::vector<std::uint64_t> chunks;
    for (const auto* face : faces)
        chunks.push_back(face->size());
    const std::vector<ChunkPart> parts = partsOf(chunks, kPartChunks);
    std::vector<StoredPart> stored(parts.size());
    base::parallelFor(std::size_t(0), parts.size(), [&](std::size_t i) {
        const ChunkPart& p = parts[i];
        std::uint32_t points = 0;
        Bytes content = Kind::contentOf(*faces[p.face], p.first, p.count, points);
        stored[i] = compressPart(std::move(content), points, codec, level);
    });
    Bytes payload;
    base::ByteWriter out(payload);
    out.put(NearFixed{std::uint32_t(faces.size()), kPartChunks});
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

/// What a block says before its parts, in agreement with itself.
struct PartIndex {
    std::vector<std::uint64_t> chunks;  ///< by face
    std::vector<ChunkPart> parts;
    std::vector<NearPart> records;  ///< by part
    std::vector<BytesView> stored;
};

/// Chunks of so many points, in parts, are no more than memory allows.
template <typename Kind>
Status checkMemory(std::uint64_t chunks, std::uint64_t points, std::uint64_t parts,
                   std::uint32_t partChunks, std::uint64_t most) {
    // Besides, what is known of each part, and for each thread the content of one.
    const auto threads =
        static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    constexpr std::uint64_t part = sizeof(ChunkPart) + sizeof(NearPart) +
                                   sizeof(BytesView) + sizeof(typename Kind::Part);
    const std::uint64_t memory =
        Kind::memoryBytes(chunks, points) + parts * part +
        std::min(parts, threads) *
            Kind::contentBytes(partChunks, Kind::kMostPoints * partChunks);
    if (memory > most)
        return base::makeError(ErrorCode::tooLarge, "takes ", memory,
                               " bytes to decode, more than the ", most,
                               " that ReadLimits::maxBytes leaves for it");
    return {};
}

/// The chunks of all faces are no more than payload and memory allow, however few points
/// they have.
template <typename Kind>
Status checkChunkCounts(const std::vector<std::uint64_t>& chunks,
                        std::uint32_t partChunks, std::uint64_t bytesLeft,
                        std::uint64_t most) {
    std::uint64_t parts = 0, all = 0;
    for (const std::uint64_t count : chunks) {
        // Each part has a record: so no sum can overflow.
        if (count / partChunks > bytesLeft / sizeof(NearPart))
            return bad("claims ", count, " chunks, more than the block can hold");
        parts += partsOf(count, partChunks);
        all += count;
    }
    if (parts > bytesLeft / sizeof(NearPart))
        return bad("claims ", parts, " parts, whose records do not fit in it");
    return checkMemory<Kind>(all, 0, parts, partChunks, most);
}

template <typename Kind>
Result<PartIndex> decodePartIndex(BytesView payload, std::size_t faces,
                                  std::uint64_t most) {
    base::ByteReader in(payload);
    const auto fixed = in.get<NearFixed>();
    if (!in.ok()) return bad("ends within its first ", sizeof fixed, " bytes");
    if (fixed.faces != faces) return bad("has ", fixed.faces, " faces, not ", faces);
    if (fixed.partChunks < 1 || fixed.partChunks > kMaxPartChunks)
        return bad("parts of ", fixed.partChunks, " chunks, must be 1 to ",
                   kMaxPartChunks);
    PartIndex index;
    index.chunks.resize(faces);
    for (std::uint64_t& count : index.chunks)
        count = in.get<std::uint64_t>();
    if (!in.ok()) return bad("ends within its numbers of chunks");
    if (auto s = checkChunkCounts<Kind>(index.chunks, fixed.partChunks, in.left(), most);
        !s)
        return s.error();

    index.parts = partsOf(index.chunks, fixed.partChunks);
    index.records.reserve(index.parts.size());
    index.stored.reserve(index.parts.size());
    std::uint64_t chunks = 0, points = 0;
    for (const ChunkPart& part : index.parts) {
        index.records.push_back(in.get<NearPart>());
        chunks += part.count;
        points += index.records.back().points;
    }
    for (std::size_t i = 0; i < index.parts.size(); ++i) {
        const NearPart& r = index.records[i];
        const std::size_t count = index.parts[i].count;
        if (!Kind::checkPoints(r.points, count))
            return bad("part ", i, ": claims ", r.points, " points for ", count,
                       " chunks");
        const std::uint64_t length = Kind::contentBytes(count, r.points);
        if (r.storedLength < 1 || r.storedLength > length)
            return bad("part ", i, ": stores ", r.storedLength, " bytes for ", length);
        index.stored.push_back(in.bytes(r.storedLength));
        if (!in.ok()) return bad("part ", i, ": reaches past the end");
    }
    if (in.left() != 0) return bad(in.left(), " bytes are left over at its end");
    if (auto s =
            checkMemory<Kind>(chunks, points, index.parts.size(), fixed.partChunks, most);
        !s)
        return s.error();
    return index;
}

/// `faces`: where the chunks of each go.
template <typename Kind>
Status decodeParts(BytesView payload, std::uint64_t most,
                   const std::vector<typename Kind::Chunks*>& faces) {
    const Result<PartIndex> index = decodePartIndex<Kind>(payload, faces.size(), most);
    if (!index) return index.error();
    std::vector<typename Kind::Part> ofPart(index->parts.size());
    for (std::size_t face = 0; face < faces.size(); ++face)
        Kind::begin(*faces[face], index->chunks[face]);
    struct Worker {
        FrameDecoder frames;
        Bytes content;
    };
    tbb::enumerable_thread_specific<Worker> workers;
    FirstError firstError;
    const auto decodePart = [&](std::size_t i, Worker& worker) -> Status {
        const ChunkPart& part = index->parts[i];
        const std::uint32_t points = index->records[i].points;
        const std::uint64_t length = Kind::contentBytes(part.count, points);
        BytesView content = index->stored[i];
        if (content.size() < length) {
            if (auto s = worker.frames.decode(content, length, worker.content); !s)
                return s;
            content = worker.content;
        }
        return Kind::decode(content, part, points, *faces[part.face], ofPart[i]);
    };
    base::parallelFor(std::size_t(0), index->parts.size(), [&](std::size_t i) {
        if (firstError.isBehind(i)) return;
        if (const Status s = decodePart(i, workers.local()); !s)
            firstError.add(i, bad("part ", i, ": ", s.error().message));
    });
    if (Status s = firstError.status(); !s) return s;
    for (std::size_t i = 0; i < ofPart.size();) {
        const std::size_t face = index->parts[i].face, first = i;
        while (i < ofPart.size() && index->parts[i].face == face)
            ++i;
        Kind::join(*faces[face], index->parts.data() + first, ofPart.data() + first,
                   i - first);
    }
    return {};
}

}  // namespace mtsm::format
