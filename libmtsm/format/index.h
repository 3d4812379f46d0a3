// index.h - where everything in a file lies <-> INDX and trailer.
#pragma once
#include <vector>

#include "format/header.h"
#include "format/layout.h"
#include "format/tile_decode.h"
#include "mtsm/reader.h"

namespace mtsm::format {

struct Index {
    std::vector<DirectoryEntry> blocks;  ///< neither TILE nor INDX, in the file's order
    std::vector<TileEntry> tiles;        ///< [face][ty][tx]
    // Not stored: bytes granted for all but layers and what NEAR, HAIR, CARD and TREE
    // hold; for layers and the work of reading them.
    std::uint64_t memory = 0, tileMemory = 0;
};

/// Tiles of a map, from its prefix alone.
struct TileGrid {
    explicit TileGrid(const Prefix& prefix);
    std::uint32_t tilesX, tilesY;
    [[nodiscard]] std::uint64_t count() const noexcept {
        return std::uint64_t(prefix_.faces) * tilesX * tilesY;
    }
    [[nodiscard]] TilePlace place(std::uint64_t tile) const noexcept;
    /// What the index says of a tile.
    [[nodiscard]] TileFacts facts(std::uint64_t tile, const TileEntry& entry) const;

  private:
    Prefix prefix_;
};

/// "HEAD", or with \xNN what is no letter: for messages.
[[nodiscard]] std::string text(BlockType type);

[[nodiscard]] Bytes encodeIndex(const Index& index, const Prefix& prefix);
[[nodiscard]] Trailer makeTrailer(std::uint64_t indexOffset, std::uint64_t fileLength);

/// The last 32 bytes of a file of this size. Errors: badFile.
Result<Trailer> decodeTrailer(BytesView bytes, std::uint64_t fileLength);

/// What can be refused from the prefix alone, before memory is taken for the index.
/// Errors: tooLarge.
Status checkLimits(const Prefix& prefix, const ReadLimits& limits);
/// Bytes that the INDX payload may take at most.
[[nodiscard]] std::uint64_t mostIndexBytes(const Prefix& prefix) noexcept;

/// Are trees in the file those of the queries to come? Trees beside a near field are not
/// if that is passed over.
[[nodiscard]] bool wantsTrees(const Index& index, const ReadLimits& limits) noexcept;
/// May the map be read without its layers? If the trees in the file are good for that.
[[nodiscard]] bool mayGoWithoutLayers(const Index& index,
                                      const ReadLimits& limits) noexcept;

/// The error, tooLarge, of a map that takes so many bytes.
[[nodiscard]] Error overMemory(std::uint64_t needed, const ReadLimits& limits);

/// Checks every entry by itself, that all blocks together cover the file from the prefix
/// to `indexOffset` without gap or overlap, that each block that must be there is there
/// once, and that what the tiles decode to keeps within the limits, if they have to be
/// decoded. Errors: badFile, unsupported, tooLarge.
Result<Index> decodeIndex(BytesView payload, const Prefix& prefix,
                          std::uint64_t indexOffset, const ReadLimits& limits);

}  // namespace mtsm::format
