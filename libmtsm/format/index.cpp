#include "format/index.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "base/bytes.h"
#include "base/checksum.h"
#include "base/message.h"
#include "format/bad_file.h"
#include "format/hierarchy.h"

namespace mtsm::format {
namespace {

using base::makeError;

std::uint32_t ceilDivide(std::uint32_t a, std::uint32_t b) {
    return (a + b - 1) / b;
}

/// What the map takes in memory, as ShadowMap::memoryBytes() counts it, without its
/// layers.
std::uint64_t frameBytes(const Prefix& prefix) {
    std::uint64_t nodes = 0;
    std::uint32_t width = prefix.width, height = prefix.height;
    while (width > 1 || height > 1) {
        width = ceilDivide(width, 2);
        height = ceilDivide(height, 2);
        nodes += std::uint64_t(width) * height;
    }
    return prefix.faces * nodes * sizeof(ZRange) +
           TileGrid(prefix).count() * sizeof(Tile);
}

/// What a tile's layers take in memory.
std::uint64_t decodedBytes(const TileFacts& facts) {
    const std::uint64_t layers = facts.layers;
    std::uint64_t numbers = facts.place.pixels() + 1 + layers;
    if (facts.planes & kHasV) numbers += layers * facts.channels;
    if (facts.planes & kHasN) numbers += layers;
    return 4 * numbers;
}

/// What the threads take at most while they decode tiles, each of the largest ones.
std::uint64_t workBytes(const Index& index, const TileGrid& grid) {
    std::uint64_t largest = 0, tiles = 0;
    for (std::uint64_t i = 0; i < index.tiles.size(); ++i) {
        const TileEntry& entry = index.tiles[i];
        if (entry.offset == 0) continue;
        tiles += 1;
        largest = std::max(largest,
                           blockSpan(entry.length) + scratchBytes(grid.facts(i, entry)));
    }
    const auto threads =
        static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    return std::min(tiles, threads) * largest;
}

/// A block that starts at `offset` and ends before `end`, sizes that nothing overflows.
Status checkExtent(std::uint64_t offset, std::uint64_t length, std::uint64_t end) {
    if (offset % kAlignment != 0)
        return bad("offset ", offset, " is no multiple of ", kAlignment);
    if (offset < sizeof(Prefix) || offset >= end || length > end - offset ||
        blockSpan(length) > end - offset)
        return bad(length, " bytes at offset ", offset,
                   " do not lie between the prefix and the index at ", end);
    return {};
}

}  // namespace

bool wantsTrees(const Index& index, const ReadLimits& limits) noexcept {
    const bool near =
        std::any_of(index.blocks.begin(), index.blocks.end(),
                    [](const DirectoryEntry& e) { return isOfNearField(e.type); });
    return limits.trees && (limits.nearField || !near);
}

bool mayGoWithoutLayers(const Index& index, const ReadLimits& limits) noexcept {
    const bool trees =
        std::any_of(index.blocks.begin(), index.blocks.end(),
                    [](const DirectoryEntry& e) { return e.type == kTree; });
    return !limits.layers && trees && wantsTrees(index, limits);
}

Error overMemory(std::uint64_t needed, const ReadLimits& limits) {
    return makeError(ErrorCode::tooLarge, "takes at least ", needed,
                     " bytes to decode, more than the ", limits.maxBytes,
                     " that ReadLimits::maxBytes allows");
}

// --- tiles of a map
// ------------------------------------------------------------------------

TileGrid::TileGrid(const Prefix& prefix)
    : tilesX(ceilDivide(prefix.width, prefix.tileSize)),
      tilesY(ceilDivide(prefix.height, prefix.tileSize)),
      prefix_(prefix) {}

TilePlace TileGrid::place(std::uint64_t tile) const noexcept {
    TilePlace p;
    p.tx = static_cast<std::uint32_t>(tile % tilesX);
    p.ty = static_cast<std::uint32_t>(tile / tilesX % tilesY);
    p.face = static_cast<std::uint32_t>(tile / tilesX / tilesY);
    p.width = std::min(prefix_.tileSize, prefix_.width - p.tx * prefix_.tileSize);
    p.height = std::min(prefix_.tileSize, prefix_.height - p.ty * prefix_.tileSize);
    return p;
}

TileFacts TileGrid::facts(std::uint64_t tile, const TileEntry& entry) const {
    return {place(tile), prefix_.channels, entry.layers, entry.planes};
}

std::string text(BlockType type) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string out;
    for (char c : type) {
        const auto byte = static_cast<unsigned char>(c);
        if (byte > 0x20 && byte < 0x7f) {
            out += c;
        } else {
            out += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
        }
    }
    return out;
}

// --- writing
// -------------------------------------------------------------------------------

Bytes encodeIndex(const Index& index, const Prefix& prefix) {
    Bytes payload;
    payload.reserve(sizeof(IndexFixed) + 32 * (index.blocks.size() + index.tiles.size()));
    base::ByteWriter out(payload);
    IndexFixed fixed = {};
    fixed.prefixChecksum = prefix.checksum;
    fixed.blocks = static_cast<std::uint32_t>(index.blocks.size());
    fixed.tiles = index.tiles.size();
    out.put(fixed);
    for (const DirectoryEntry& entry : index.blocks)
        out.put(entry);
    for (const TileEntry& entry : index.tiles)
        out.put(entry);
    return payload;
}

Trailer makeTrailer(std::uint64_t indexOffset, std::uint64_t fileLength) {
    Trailer t = {};
    t.indexOffset = indexOffset;
    t.fileLength = fileLength;
    t.finished = kFinished;
    const auto bytes = std::bit_cast<std::array<std::uint8_t, sizeof(Trailer)>>(t);
    t.checksum = base::checksum(BytesView(bytes).first(offsetof(Trailer, checksum)));
    return t;
}

// --- reading
// -------------------------------------------------------------------------------

Result<Trailer> decodeTrailer(BytesView bytes, std::uint64_t fileLength) {
    const auto t = base::ByteReader(bytes).get<Trailer>();
    if (t.finished != kFinished)
        return bad("trailer: no finished mark in the last 32 bytes, so the file was not ",
                   "finished, was cut off, or has bytes added at its end");
    if (t.checksum != base::checksum(bytes.first(offsetof(Trailer, checksum))))
        return bad("trailer: damaged, its checksum does not fit");
    if (t.fileLength != fileLength)
        return bad("trailer: says that the file has ", t.fileLength, " bytes, it has ",
                   fileLength);
    const std::uint64_t end = fileLength - sizeof(Trailer);
    if (t.indexOffset % kAlignment != 0 || t.indexOffset < sizeof(Prefix) ||
        t.indexOffset > end || end - t.indexOffset < sizeof(BlockHeader))
        return bad("trailer: the index cannot lie at offset ", t.indexOffset,
                   " of a file of ", fileLength, " bytes");
    return t;
}

Status checkLimits(const Prefix& prefix, const ReadLimits& limits) {
    const std::uint64_t pixels =
        std::uint64_t(prefix.width) * prefix.height * prefix.faces;
    if (pixels > limits.maxPixels)
        return makeError(ErrorCode::tooLarge, "has ", pixels,
                         " pixels over all faces, more than the ", limits.maxPixels,
                         " that ReadLimits::maxPixels allows");
    if (frameBytes(prefix) > limits.maxBytes)
        return overMemory(frameBytes(prefix), limits);
    return {};
}

std::uint64_t mostIndexBytes(const Prefix& prefix) noexcept {
    return sizeof(IndexFixed) + std::uint64_t(kMaxDirectory) * sizeof(DirectoryEntry) +
           TileGrid(prefix).count() * sizeof(TileEntry);
}

namespace {

/// The numbers of entries are those that the prefix and the length of the payload demand.
Result<Index> splitIndex(BytesView payload, const Prefix& prefix) {
    const std::uint64_t tiles = TileGrid(prefix).count();
    base::ByteReader in(payload);
    const auto fixed = in.get<IndexFixed>();
    if (!in.ok()) return bad("has ", payload.size(), " bytes, too few");
    if (fixed.prefixChecksum != prefix.checksum)
        return bad("belongs to a file with another prefix");
    if (fixed.reserved != 0) return bad("reserved bytes are not zero");
    if (fixed.tiles != tiles) return bad("lists ", fixed.tiles, " tiles, not ", tiles);
    if (fixed.blocks > kMaxDirectory)
        return bad("lists ", fixed.blocks, " blocks, more than ", kMaxDirectory);
    const std::uint64_t expected =
        sizeof fixed + sizeof(DirectoryEntry) * fixed.blocks + sizeof(TileEntry) * tiles;
    if (payload.size() != expected)
        return bad("has ", payload.size(), " bytes, not the ", expected, " of ",
                   fixed.blocks, " blocks and ", tiles, " tiles");
    Index index;
    index.blocks.resize(fixed.blocks);
    index.tiles.resize(tiles);
    for (auto& entry : index.blocks)
        entry = in.get<DirectoryEntry>();
    for (auto& entry : index.tiles)
        entry = in.get<TileEntry>();
    return index;
}

bool isKnown(BlockType type) {
    return type == kHead || isAncillary(type) || type == kHier || type == kTotl;
}

Status checkDirectory(const Index& index, const Prefix& prefix, std::uint64_t indexOffset,
                      const ReadLimits& limits) {
    const auto named = [&](BlockType type) {
        return std::count_if(index.blocks.begin(), index.blocks.end(),
                             [&](const auto& e) { return e.type == type; });
    };
    std::uint64_t texts = 0;   // bytes of the blocks whose length only the file decides
    std::uint64_t before = 0;  // where the last block was
    for (const DirectoryEntry& e : index.blocks) {
        const auto at = base::concat("block ", text(e.type), ": ");
        if (e.offset <= before) return bad(at, "is not listed in the order of the file");
        before = e.offset;
        if (auto s = checkExtent(e.offset, e.length, indexOffset); !s)
            return bad(at, s.error().message);
        if (e.type == kTile || e.type == kIndx)
            return bad(at, "has no place in the directory");
        if (e.flags & ~kCritical) return bad(at, "unknown flags ", e.flags);
        if (!isKnown(e.type)) {
            if (!e.flags) continue;
            return makeError(ErrorCode::unsupported, at, "is at offset ", e.offset,
                             ", cannot be passed over and is unknown to format version ",
                             kVersionMajor, ".", kVersionMinor,
                             ": a newer libmtsm is needed");
        }
        if ((e.flags == kCritical) == isAncillary(e.type))
            return bad(at, "flags ", e.flags, " are not those of its type");
        if (e.type == kHead || e.type == kAttr || e.type == kTotl) texts += e.length;
    }
    for (BlockType type : {kHead, kHier, kTotl}) {
        if (named(type) != 1)
            return bad(named(type), " blocks ", text(type), ", there must be one");
    }
    for (BlockType type : {kAttr, kNear, kHair, kCard, kTree}) {
        if (named(type) > 1)
            return bad(named(type), " blocks ", text(type), ", there may be one");
    }
    if (index.blocks.front().type != kHead ||
        index.blocks.front().offset != sizeof(Prefix))
        return bad("block HEAD is not the first");
    const std::uint64_t fixed = headFixedBytes(prefix.faces) + sizeof(Totals);
    if (texts > fixed && texts - fixed > limits.maxAttributeBytes)
        return makeError(ErrorCode::tooLarge, "attributes and texts take ", texts - fixed,
                         " bytes, more than the ", limits.maxAttributeBytes,
                         " that ReadLimits::maxAttributeBytes allows");
    const TileGrid grid(prefix);
    const std::uint64_t hier =
        HierarchyShape{grid.tilesX, grid.tilesY}.bytes(prefix.faces);
    for (const DirectoryEntry& e : index.blocks) {
        if (e.type == kHier && e.length != hier)
            return bad("block HIER: has ", e.length, " bytes, not ", hier);
    }
    return {};
}

Status checkTileEntry(const TileEntry& e, const TileFacts& facts,
                      std::uint64_t indexOffset) {
    if (e.offset == 0) {
        if (e.length || e.layers || e.planes || e.payloadChecksum)
            return bad("an empty tile whose entry is not all zero");
        return {};
    }
    if (auto s = checkExtent(e.offset, e.length, indexOffset); !s) return s;
    if (e.layers == 0) return bad("has a block but no layers");
    if (e.layers > std::uint64_t(facts.place.pixels()) * kMaxPixelLayers)
        return bad(e.layers, " layers for ", facts.place.pixels(), " pixels, more than ",
                   kMaxPixelLayers, " each");
    if (e.planes & ~(kHasV | kHasN)) return bad("unknown planes ", e.planes);
    if (e.length < leastTileBytes(facts) || e.length > mostTileBytes(facts))
        return bad(e.length, " bytes for ", e.layers, " layers, must be ",
                   leastTileBytes(facts), " to ", mostTileBytes(facts));
    return {};
}

/// Every byte between prefix and index belongs to exactly one block.
Status checkCoverage(const Index& index, const TileGrid& grid,
                     std::uint64_t indexOffset) {
    struct Extent {
        std::uint64_t offset, end, tile;
    };
    constexpr std::uint64_t kNoTile = ~std::uint64_t(0);
    std::vector<Extent> extents;
    extents.reserve(index.blocks.size() + 1);
    for (const DirectoryEntry& e : index.blocks)
        extents.push_back({e.offset, e.offset + blockSpan(e.length), kNoTile});
    for (std::uint64_t i = 0; i < index.tiles.size(); ++i) {
        const TileEntry& e = index.tiles[i];
        if (e.offset) extents.push_back({e.offset, e.offset + blockSpan(e.length), i});
    }
    std::sort(extents.begin(), extents.end(), [](const Extent& a, const Extent& b) {
        return a.offset != b.offset ? a.offset < b.offset : a.tile < b.tile;
    });
    extents.push_back({indexOffset, indexOffset, kNoTile});
    std::uint64_t at = sizeof(Prefix);
    for (const Extent& e : extents) {
        if (e.offset != at) {
            const std::string what = e.tile != kNoTile         ? grid.place(e.tile).text()
                                     : e.offset == indexOffset ? "the index"
                                                               : "a block";
            return bad(what, " at offset ", e.offset,
                       e.offset < at ? " overlaps what ends at "
                                     : " leaves a gap behind what ends at ",
                       at);
        }
        at = e.end;
    }
    return {};
}

}  // namespace

Result<Index> decodeIndex(BytesView payload, const Prefix& prefix,
                          std::uint64_t indexOffset, const ReadLimits& limits) {
    Result<Index> index = splitIndex(payload, prefix);
    if (!index) return index;
    if (auto s = checkDirectory(*index, prefix, indexOffset, limits); !s)
        return s.error();
    const TileGrid grid(prefix);
    const bool tilesCount = !mayGoWithoutLayers(*index, limits);
    std::uint64_t memory = frameBytes(prefix), tileMemory = 0;
    for (std::uint64_t i = 0; i < index->tiles.size(); ++i) {
        const TileEntry& entry = index->tiles[i];
        const TileFacts facts = grid.facts(i, entry);
        if (auto s = checkTileEntry(entry, facts, indexOffset); !s)
            return bad(facts.place.text(), ": ", s.error().message);
        if (entry.offset) tileMemory += decodedBytes(facts);
        if (tilesCount && memory + tileMemory > limits.maxBytes)
            return overMemory(memory + tileMemory, limits);
    }
    tileMemory += workBytes(*index, grid);
    for (const DirectoryEntry& entry : index->blocks) {
        if ((isOfNearField(entry.type) && limits.nearField) ||
            (entry.type == kTree && limits.trees))
            memory += blockSpan(entry.length);
    }
    const std::uint64_t needed = memory + (tilesCount ? tileMemory : 0);
    if (needed > limits.maxBytes) return overMemory(needed, limits);
    index->memory = memory;
    index->tileMemory = tileMemory;
    if (auto s = checkCoverage(*index, grid, indexOffset); !s) return s.error();
    return index;
}

}  // namespace mtsm::format
