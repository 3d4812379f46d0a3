// A file is read in the order in which its parts prove each other: prefix, trailer,
// index, the blocks that the index lists, then all tiles in parallel. What comes out goes
// through ShadowMap::create, and what the file states about its tiles is compared with
// them.
#include "mtsm/reader.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <mutex>
#include <optional>

#include "base/bytes.h"
#include "base/checksum.h"
#include "base/message.h"
#include "base/parallel.h"
#include "format/bad_file.h"
#include "format/card_block.h"
#include "format/first_error.h"
#include "format/frame.h"
#include "format/guard.h"
#include "format/hair_block.h"
#include "format/hierarchy.h"
#include "format/map_file.h"
#include "format/near_block.h"
#include "format/tree_block.h"

namespace mtsm {
namespace format {
namespace {

using base::makeError;

constexpr std::size_t kSkipBytes = 64 << 10;  // read at a time of what is passed over

/// The error with the place where it happened in front.
template <typename... Parts>
Error located(const Error& error, const Parts&... place) {
    return makeError(error.code, place..., error.message);
}

// --- blocks
// --------------------------------------------------------------------------------

/// The header by itself, and against what the index says of the block.
Status checkBlockHeader(BytesView bytes, const DirectoryEntry& entry) {
    const auto h = base::ByteReader(bytes).get<BlockHeader>();
    if (h.headerChecksum !=
        base::checksum(bytes.first(offsetof(BlockHeader, headerChecksum))))
        return bad("the block header is damaged, its checksum does not fit");
    if (h.type != entry.type) return bad("there is a block ", text(h.type), " instead");
    if (h.flags != entry.flags)
        return bad("the block header says flags ", h.flags, ", the index ", entry.flags);
    if (h.length != entry.length)
        return bad("the block header says ", h.length, " bytes, the index ",
                   entry.length);
    if (h.payloadChecksum != entry.payloadChecksum)
        return bad("the block header's checksum of the payload is not the index's");
    return {};
}

bool allZero(BytesView bytes) {
    return std::all_of(bytes.begin(), bytes.end(), [](auto b) { return b == 0; });
}

/// A whole block into `buffer`, checked; returns its payload. That it lies within the
/// file has been proved.
Result<BytesView> readBlock(const Source& source, const DirectoryEntry& entry,
                            Bytes& buffer) {
    reuse(buffer, blockSpan(entry.length));
    if (auto s = source.read(entry.offset, buffer); !s) return s.error();
    const BytesView bytes(buffer);
    if (auto s = checkBlockHeader(bytes, entry); !s) return s.error();
    const BytesView payload = bytes.subspan(sizeof(BlockHeader), entry.length);
    if (base::checksum(payload) != entry.payloadChecksum)
        return bad("the content is damaged, its checksum does not fit");
    if (!allZero(bytes.subspan(sizeof(BlockHeader) + entry.length)))
        return bad("the padding behind it is not zero");
    return payload;
}

/// Checks a block that nobody looks into, in constant memory.
Status checkUnknownBlock(const Source& source, const DirectoryEntry& entry) {
    Bytes buffer(sizeof(BlockHeader));
    if (auto s = source.read(entry.offset, buffer); !s) return s;
    if (auto s = checkBlockHeader(buffer, entry); !s) return s;
    base::ChecksumStream sum;
    std::uint64_t at = entry.offset + sizeof(BlockHeader);
    for (std::uint64_t left = entry.length; left > 0; left -= buffer.size()) {
        buffer.resize(std::min<std::uint64_t>(left, kSkipBytes));
        if (auto s = source.read(at, buffer); !s) return s;
        sum.add(buffer);
        at += buffer.size();
    }
    if (sum.value() != entry.payloadChecksum)
        return bad("the content is damaged, its checksum does not fit");
    buffer.resize(entry.offset + blockSpan(entry.length) - at);
    if (auto s = source.read(at, buffer); !s) return s;
    if (!allZero(buffer)) return bad("the padding behind it is not zero");
    return {};
}

std::string blockName(BlockType type, std::uint64_t offset) {
    return base::concat("block ", text(type), " at offset ", offset, ": ");
}

// --- prefix, trailer, index
// ----------------------------------------------------------------

Result<Prefix> readPrefix(const Source& source) {
    Bytes bytes(std::min<std::uint64_t>(source.size(), sizeof(Prefix)));
    if (auto s = source.read(0, bytes); !s) return s.error();
    Result<Prefix> prefix = decodePrefix(bytes);
    if (!prefix) return located(prefix.error(), source.name(), ": ");
    return prefix;
}

/// The index block is all that lies between where the trailer says and the trailer.
Result<Index> readIndex(const Source& source, const Prefix& prefix,
                        const ReadLimits& limits, std::uint64_t& indexLength) {
    const std::uint64_t size = source.size();
    if (size < sizeof(Prefix) + sizeof(Trailer))
        return bad(source.name(), ": trailer: missing, the file was not finished or was ",
                   "cut off: it has ", size, " bytes");
    const std::uint64_t end = size - sizeof(Trailer);
    Bytes bytes(sizeof(Trailer));
    if (auto s = source.read(end, bytes); !s) return s.error();
    const Result<Trailer> trailer = decodeTrailer(bytes, size);
    if (!trailer) return located(trailer.error(), source.name(), ": ");

    const std::uint64_t offset = trailer->indexOffset;
    const std::string place =
        base::concat(source.name(), ": index: ", blockName(kIndx, offset));
    bytes.resize(sizeof(BlockHeader));
    if (auto s = source.read(offset, bytes); !s) return s.error();
    const auto h = base::ByteReader(bytes).get<BlockHeader>();
    const DirectoryEntry entry = {kIndx, kCritical, offset, h.length, h.payloadChecksum};
    if (auto s = checkBlockHeader(bytes, entry); !s) return located(s.error(), place);
    if (h.length > mostIndexBytes(prefix) || blockSpan(h.length) != end - offset)
        return bad(place, h.length, " bytes do not fill the ", end - offset,
                   " bytes before the trailer");
    const Result<BytesView> payload = readBlock(source, entry, bytes);
    if (!payload) return located(payload.error(), place);
    indexLength = h.length;
    Result<Index> index = decodeIndex(*payload, prefix, offset, limits);
    if (!index) return located(index.error(), source.name(), ": index: ");
    return index;
}

// --- the blocks of the directory
// -----------------------------------------------------------

/// All that is known of the map once the directory's blocks are read.
struct Frame {
    MapInfo info;
    std::vector<MapFace> faces;
    Totals totals = {};
    Bytes hierarchy;
    Bytes treeBlock;
    std::optional<BytesView> trees;  ///< the payload of TREE, if wanted and known
    std::uint64_t hierarchyOffset = 0, totalsOffset = 0, treesOffset = 0;

    /// That the near field takes so far.
    [[nodiscard]] std::uint64_t nearBytes() const {
        std::uint64_t bytes = 0;
        for (const MapFace& face : faces)
            bytes += mtsm::memoryBytes(face.nearField) +
                     mtsm::memoryBytes(face.nearHair) +
                     mtsm::memoryBytes(face.nearSheets);
        return bytes;
    }
};

/// What of the directory's blocks is wanted.
struct Wanted {
    std::optional<std::uint64_t> nearBytes;  ///< that a near field may take
    bool trees = false;
};

Status readDirectoryBlock(const Source& source, const Prefix& prefix,
                          const DirectoryEntry& entry, const Wanted& wanted,
                          Bytes& buffer, Frame& frame) {
    // Who does without them does so even where they are damaged.
    if (isOfNearField(entry.type) && !wanted.nearBytes) return {};
    if (entry.type == kTree && !wanted.trees) return {};
    if (entry.type != kHead && entry.type != kTotl && entry.type != kHier &&
        !isAncillary(entry.type))
        return checkUnknownBlock(source, entry);
    const Result<BytesView> payload = readBlock(source, entry, buffer);
    if (!payload) return payload.error();
    if (entry.type == kHead) return decodeHead(*payload, prefix, frame.info, frame.faces);
    if (entry.type == kAttr) {
        auto attributes = decodeAttributes(*payload, prefix);
        if (!attributes) return attributes.error();
        frame.info.attributes = *std::move(attributes);
    } else if (entry.type == kNear) {
        return decodeNear(*payload, *wanted.nearBytes - frame.nearBytes(), frame.faces);
    } else if (entry.type == kHair) {
        return decodeHair(*payload, *wanted.nearBytes - frame.nearBytes(), frame.faces);
    } else if (entry.type == kCard) {
        return decodeSheets(*payload, *wanted.nearBytes - frame.nearBytes(), frame.faces);
    } else if (entry.type == kTree) {
        frame.treesOffset = entry.offset;
        if (!hasKnownTrees(*payload)) return {};
        frame.trees = *payload;
        frame.treeBlock = std::move(buffer);  // which it points into
    } else if (entry.type == kTotl) {
        const auto totals = decodeTotals(*payload, prefix, frame.info);
        if (!totals) return totals.error();
        frame.totals = *totals;
        frame.totalsOffset = entry.offset;
    } else {
        frame.hierarchy.assign(payload->begin(), payload->end());
        frame.hierarchyOffset = entry.offset;
    }
    return {};
}

// --- tiles
// ---------------------------------------------------------------------------------

void count(const std::vector<PlaneRecord>& records, FileFacts& facts) {
    for (const PlaneRecord& r : records) {
        Description::Plane& plane = facts.planes[r.kind];
        plane.planes += 1;
        switch (PlaneEncoding(r.encoding)) {
            case PlaneEncoding::raw:
                plane.raw += 1;
                break;
            case PlaneEncoding::constant:
                plane.constant += 1;
                break;
            case PlaneEncoding::zstd:
                plane.compressed += 1;
                break;
        }
        plane.storedBytes += r.storedLength;
        plane.decodedBytes += r.decodedLength;
    }
}

Status readTiles(const Source& source, const Prefix& prefix, const Index& index,
                 std::vector<MapFace>& faces, FileFacts* facts) {
    struct Worker {
        TileDecoder decoder;
        Bytes buffer;
    };
    tbb::enumerable_thread_specific<Worker> workers;
    const TileGrid grid(prefix);
    const std::uint64_t perFace = std::uint64_t(grid.tilesX) * grid.tilesY;
    FirstError firstError;
    std::mutex factsMutex;

    const auto readTile = [&](std::uint64_t i, Worker& worker) -> Status {
        const TileEntry& e = index.tiles[i];
        const Result<BytesView> payload =
            readBlock(source, {kTile, kCritical, e.offset, e.length, e.payloadChecksum},
                      worker.buffer);
        if (!payload) return payload.error();
        Result<Tile> tile = worker.decoder.decode(*payload, grid.facts(i, e));
        if (!tile) return tile.error();
        faces[i / perFace].tiles[i % perFace] = *std::move(tile);
        if (facts) {
            const std::lock_guard lock(factsMutex);
            count(worker.decoder.records(), *facts);
        }
        return {};
    };
    const auto readTiles = [&](std::uint64_t begin, std::uint64_t end) {
        Worker& worker = workers.local();
        for (std::uint64_t i = begin; i < end; ++i) {
            if (index.tiles[i].offset == 0 || firstError.isBehind(i)) continue;
            if (const Status s = readTile(i, worker); !s)
                firstError.add(
                    i, located(s.error(), source.name(), ": ", grid.place(i).text(),
                               " at offset ", index.tiles[i].offset, ": "));
        }
    };
    base::parallelRanges(std::uint64_t(0), std::uint64_t(index.tiles.size()),
                         std::uint64_t(1), readTiles);
    return firstError.status();
}

}  // namespace

namespace {

/// What the map's layers are, of which the index, HIER and TREE tell.
Result<ShadowMap::LayerFacts> layerFacts(const Index& index, const Prefix& prefix,
                                         const Frame& frame) {
    ShadowMap::LayerFacts facts;
    bool anyV = false;
    for (const TileEntry& entry : index.tiles) {
        facts.count += entry.layers;
        anyV = anyV || (entry.planes & kHasV);
    }
    // Planes may say no more than that all v are 0.
    facts.isOpaque = !anyV || areOfOpaque(*frame.trees);
    const TileGrid grid(prefix);
    const auto roots =
        hierarchyRoots(frame.hierarchy, prefix.faces, {grid.tilesX, grid.tilesY});
    if (!roots) return roots.error();
    std::copy(roots->begin(), roots->end(), facts.ranges);
    return facts;
}

/// The map of a frame, its layers read or, where its trees do, passed over.
Result<ShadowMap> makeMap(const Source& source, const Prefix& prefix, const Index& index,
                          const ReadLimits& limits, Frame& frame, FileFacts* facts) {
    const std::string& name = source.name();
    if (mayGoWithoutLayers(index, limits)) {
        if (frame.trees) {
            const auto layers = layerFacts(index, prefix, frame);
            if (!layers)
                return located(layers.error(), name, ": ",
                               blockName(kHier, frame.hierarchyOffset));
            auto map = ShadowMap::createWithoutLayers(std::move(frame.info),
                                                      std::move(frame.faces), *layers);
            if (!map) return bad(name, ": ", map.error().message);
            return map;
        }
        // It was thought that they would.
        const std::uint64_t memory = index.memory + index.tileMemory + frame.nearBytes();
        if (memory > limits.maxBytes)
            return located(overMemory(memory, limits), name, ": ");
    }
    if (auto s = readTiles(source, prefix, index, frame.faces, facts); !s)
        return s.error();
    auto map = ShadowMap::create(std::move(frame.info), std::move(frame.faces));
    if (!map) return bad(name, ": ", map.error().message);
    return map;
}

/// Everything behind the prefix.
Result<ShadowMap> readContent(const Source& source, const Prefix& prefix,
                              const ReadLimits& limits, FileFacts* facts) {
    const std::string& name = source.name();
    if (auto s = checkLimits(prefix, limits); !s) return located(s.error(), name, ": ");
    std::uint64_t indexLength = 0;
    Result<Index> index = readIndex(source, prefix, limits, indexLength);
    if (!index) return index.error();

    const TileGrid grid(prefix);
    Frame frame;
    frame.faces.resize(prefix.faces);
    for (MapFace& face : frame.faces)
        face.tiles.resize(std::size_t(grid.tilesX) * grid.tilesY);
    Bytes buffer;
    const std::uint64_t left =
        limits.maxBytes - index->memory -
        (mayGoWithoutLayers(*index, limits) ? 0 : index->tileMemory);
    Wanted wanted;
    if (limits.nearField) wanted.nearBytes = left;
    wanted.trees = wantsTrees(*index, limits);
    for (const DirectoryEntry& entry : index->blocks) {
        if (auto s = readDirectoryBlock(source, prefix, entry, wanted, buffer, frame); !s)
            return located(s.error(), name, ": ", blockName(entry.type, entry.offset));
    }
    const std::uint64_t nearBytes = frame.nearBytes();
    auto map = makeMap(source, prefix, *index, limits, frame, facts);
    if (!map) return map;
    if (auto s = checkTotals(frame.totals, *map); !s)
        return located(s.error(), name, ": ", blockName(kTotl, frame.totalsOffset));
    if (map->hasLayers()) {
        if (auto s = checkHierarchy(frame.hierarchy, *map); !s)
            return located(s.error(), name, ": ",
                           blockName(kHier, frame.hierarchyOffset));
    }
    if (frame.trees) {
        if (auto s = decodeTrees(*frame.trees, left - nearBytes, *map); !s)
            return located(s.error(), name, ": ", blockName(kTree, frame.treesOffset));
    }
    if (facts) {
        facts->prefix = prefix;
        facts->index = *std::move(index);
        facts->indexLength = indexLength;
    }
    return map;
}

}  // namespace

Result<ShadowMap> readMapFile(const Source& source, const ReadLimits& limits,
                              FileFacts* facts) {
    const Result<Prefix> prefix = readPrefix(source);
    if (!prefix) return prefix.error();
    auto map = readContent(source, *prefix, limits, facts);
    if (map) return map;
    // The file's name comes first, and what the sentence says of it next.
    const std::string name = source.name() + ": ";
    std::string reason = map.error().message;
    if (reason.starts_with(name)) reason.erase(0, name.size());
    return located(
        withWayOut(ofItsVersion({map.error().code, reason}, prefix->versionMinor)), name);
}

}  // namespace format

Result<ShadowMap> readMap(const std::string& path, const ReadLimits& limits) {
    return format::guarded(path, "read", [&]() -> Result<ShadowMap> {
        const auto source = format::openFile(path);
        if (!source) return source.error();
        return format::readMapFile(**source, limits, nullptr);
    });
}

Result<ShadowMap> readMap(const std::uint8_t* bytes, std::size_t size,
                          const std::string& name, const ReadLimits& limits) {
    return format::guarded(name, "read", [&] {
        return format::readMapFile(*format::openMemory({bytes, size}, name), limits,
                                   nullptr);
    });
}

Result<Probe> probe(const std::uint8_t* bytes, std::size_t size,
                    const std::string& name) {
    const auto prefix =
        format::decodePrefix({bytes, std::min(size, sizeof(format::Prefix))});
    if (!prefix) return format::located(prefix.error(), name, ": ");
    return Probe{prefix->versionMajor, prefix->versionMinor, prefix->width,
                 prefix->height,       prefix->faces,        prefix->channels,
                 prefix->tileSize};
}

}  // namespace mtsm
