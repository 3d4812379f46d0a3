// Bytes leave in one pass from front to back, so that a pipe will do. Tiles are encoded
// in parallel, a bounded number at a time, and written in order: the bytes do not depend
// on the number of threads.
#include "mtsm/writer.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/task_arena.h>

#include <bit>
#include <vector>

#include "base/bytes.h"
#include "base/checksum.h"
#include "base/message.h"
#include "base/parallel.h"
#include "format/card_block.h"
#include "format/guard.h"
#include "format/hair_block.h"
#include "format/header.h"
#include "format/hierarchy.h"
#include "format/index.h"
#include "format/layout.h"
#include "format/near_block.h"
#include "format/sink.h"
#include "format/tile_encode.h"
#include "format/tree_block.h"

namespace mtsm {
namespace format {
namespace {

using base::makeError;

// Enough for the threads to even out; the memory of a batch stays in the megabytes.
constexpr std::size_t kTilesPerThread = 16;

/// A block as it lies in the file, and what the index says of it.
struct Block {
    Bytes bytes;
    BlockHeader header = {};
};

Block makeBlock(BlockType type, std::uint32_t flags, BytesView payload) {
    Block block;
    BlockHeader& h = block.header;
    h.type = type;
    h.flags = flags;
    h.length = payload.size();
    h.payloadChecksum = base::checksum(payload);
    const auto bytes = std::bit_cast<std::array<std::uint8_t, sizeof h>>(h);
    h.headerChecksum =
        base::checksum(BytesView(bytes).first(offsetof(BlockHeader, headerChecksum)));
    block.bytes.reserve(blockSpan(h.length));
    base::ByteWriter out(block.bytes);
    out.put(h);
    out.bytes(payload);
    out.zeros(blockSpan(h.length) - sizeof h - h.length);
    return block;
}

/// Writes a map's parts in order and keeps the index of what it wrote.
class MapWriter {
  public:
    MapWriter(const ShadowMap& map, const WriteOptions& options, Sink& sink)
        : map_(map),
          options_(options),
          sink_(sink),
          prefix_(makePrefix(map)),
          grid_(prefix_) {
        index_.tiles.resize(grid_.count());
    }

    Status run() {
        if (!map_.hasLayers())
            return makeError(ErrorCode::badArgument, "the map has no layers to write: ",
                             "it was read without, or releaseLayers() let them go");
        const Result<Bytes> head = encodeHead(map_);
        if (!head) return head.error();
        const Result<Bytes> attributes = encodeAttributes(map_.info().attributes);
        if (!attributes) return attributes.error();
        if (auto s = checkTexts(*head, *attributes); !s) return s;
        if (auto s = putRecord(prefix_); !s) return s;
        if (auto s = putBlock(kHead, kCritical, *head); !s) return s;
        if (!map_.info().attributes.empty()) {
            if (auto s = putBlock(kAttr, 0, *attributes); !s) return s;
        }
        if (auto s = putTiles(); !s) return s;
        if (hasNearField(map_)) {
            const Bytes near = encodeNear(map_, options_.codec, options_.level);
            if (auto s = putBlock(kNear, 0, near); !s) return s;
        }
        if (hasNearHair(map_)) {
            const Bytes hair = encodeHair(map_, options_.codec, options_.level);
            if (auto s = putBlock(kHair, 0, hair); !s) return s;
        }
        if (hasNearSheets(map_)) {
            const Bytes cards = encodeSheets(map_, options_.codec, options_.level);
            if (auto s = putBlock(kCard, 0, cards); !s) return s;
        }
        if (options_.trees) {
            const Bytes trees = encodeTrees(map_, options_.codec, options_.level);
            if (!trees.empty()) {
                if (auto s = putBlock(kTree, 0, trees); !s) return s;
            }
        }
        if (auto s = putBlock(kHier, kCritical, encodeHierarchy(map_)); !s) return s;
        if (auto s = putBlock(kTotl, kCritical, encodeTotals(map_)); !s) return s;

        const std::uint64_t indexOffset = offset_;
        if (auto s = put(makeBlock(kIndx, kCritical, encodeIndex(index_, prefix_)).bytes);
            !s)
            return s;
        return putRecord(makeTrailer(indexOffset, offset_ + sizeof(Trailer)));
    }

  private:
    Status put(BytesView bytes) {
        offset_ += bytes.size();
        return sink_.write(bytes);
    }
    template <typename Record>
    Status putRecord(const Record& record) {
        return put(std::bit_cast<std::array<std::uint8_t, sizeof(Record)>>(record));
    }

    Status putBlock(BlockType type, std::uint32_t flags, BytesView payload) {
        const Block block = makeBlock(type, flags, payload);
        index_.blocks.push_back(
            {type, flags, offset_, block.header.length, block.header.payloadChecksum});
        return put(block.bytes);
    }

    const Tile& tile(std::uint64_t i) const {
        const TilePlace p = grid_.place(i);
        return map_.tile(p.face, p.tx, p.ty);
    }

    Status putTile(std::uint64_t i, const Block& block) {
        index_.tiles[i] = {offset_, block.header.length,
                           static_cast<std::uint32_t>(tile(i).z.size()),
                           planesNeeded(tile(i)), block.header.payloadChecksum};
        if (auto s = put(block.bytes); !s) return s;
        layersDone_ += tile(i).z.size();
        const double done = double(layersDone_) / double(map_.layerCount());
        if (options_.progress && !options_.progress(done))
            return makeError(ErrorCode::cancelled, "writing was cancelled");
        return {};
    }

    /// What no reader would take unless it was told to.
    Status checkTexts(BytesView head, BytesView attributes) const {
        const std::uint64_t bytes =
            head.size() - headFixedBytes(prefix_.faces) +
            (map_.info().attributes.empty() ? 0 : attributes.size());
        const std::uint64_t most = ReadLimits().maxAttributeBytes;
        if (bytes <= most) return {};
        return makeError(ErrorCode::badArgument, "attributes and texts take ", bytes,
                         " bytes, more than the ", most,
                         " that readers take: shorten them");
    }

    Status putTiles();

    const ShadowMap& map_;
    const WriteOptions& options_;
    Sink& sink_;
    const Prefix prefix_;
    const TileGrid grid_;
    Index index_;
    std::uint64_t offset_ = 0, layersDone_ = 0;
};

Status MapWriter::putTiles() {
    tbb::enumerable_thread_specific<TileEncoder> encoders(
        [&] { return TileEncoder(options_.codec, options_.level); });
    std::vector<std::uint64_t> batch;  // tiles that are encoded side by side
    const auto mostTiles = kTilesPerThread * static_cast<std::size_t>(
                                                 tbb::this_task_arena::max_concurrency());
    std::vector<Block> blocks(mostTiles);

    for (std::uint64_t next = 0; next < index_.tiles.size();) {
        batch.clear();
        for (; next < index_.tiles.size() && batch.size() < mostTiles; ++next) {
            if (!tile(next).empty()) batch.push_back(next);
        }
        base::parallelFor(std::size_t(0), batch.size(), [&](std::size_t i) {
            blocks[i] =
                makeBlock(kTile, kCritical,
                          encoders.local().encode(tile(batch[i]), grid_.place(batch[i]),
                                                  map_.info().channels));
        });
        for (std::size_t i = 0; i < batch.size(); ++i) {
            if (auto s = putTile(batch[i], blocks[i]); !s) return s;
        }
    }
    return {};
}

Status checkOptions(const WriteOptions& options) {
    if (options.codec != Codec::none && options.codec != Codec::zstd)
        return makeError(ErrorCode::badArgument, "codec ", unsigned(options.codec),
                         " is neither none (0) nor zstd (1)");
    if (options.level < 1 || options.level > 19)
        return makeError(ErrorCode::badArgument, "compression level ", options.level,
                         " must be 1 to 19");
    return {};
}

}  // namespace
}  // namespace format

Status writeMap(const ShadowMap& map, const std::string& path,
                const WriteOptions& options) {
    return format::guarded(path, "write", [&]() -> Status {
        if (auto s = format::checkOptions(options); !s) return s;
        base::FileOutput file(path);
        if (auto s = file.open(); !s) return s;
        format::FileSink sink(file);
        if (auto s = format::MapWriter(map, options, sink).run(); !s) {
            if (s.error().code == ErrorCode::io) return s;  // names the path already
            return base::makeError(s.error().code, path, ": ", s.error().message);
        }
        return file.commit();
    });
}

Result<std::vector<std::uint8_t>> encodeMap(const ShadowMap& map,
                                            const WriteOptions& options) {
    return format::guarded("map", "encode", [&]() -> Result<std::vector<std::uint8_t>> {
        if (auto s = format::checkOptions(options); !s) return s.error();
        format::MemorySink sink;
        if (auto s = format::MapWriter(map, options, sink).run(); !s) return s.error();
        return std::move(sink).take();
    });
}

}  // namespace mtsm
