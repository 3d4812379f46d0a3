#include "mtsm/describe.h"

#include <algorithm>

#include "base/printable.h"
#include "format/guard.h"
#include "format/header.h"
#include "format/map_file.h"

namespace mtsm {
namespace format {
namespace {

void addBlock(Description& d, BlockType type, std::uint32_t flags, std::uint64_t length) {
    const std::string name = text(type);
    auto at = std::find_if(d.blocks.begin(), d.blocks.end(),
                           [&](const auto& block) { return block.type == name; });
    if (at == d.blocks.end())
        at = d.blocks.insert(at, {name, (flags & kCritical) != 0, 0, 0});
    at->count += 1;
    at->bytes += blockSpan(length);
}

/// Directory and tiles in the order in which they lie in the file.
void describeBlocks(const FileFacts& facts, Description& d) {
    std::vector<DirectoryEntry> all = facts.index.blocks;
    for (const TileEntry& e : facts.index.tiles) {
        d.tiles += 1;
        if (e.offset == 0) {
            d.emptyTiles += 1;
            continue;
        }
        if (!(e.planes & kHasV)) d.opaqueTiles += 1;
        all.push_back({kTile, kCritical, e.offset, e.length, e.payloadChecksum});
    }
    std::sort(all.begin(), all.end(),
              [](const auto& a, const auto& b) { return a.offset < b.offset; });
    for (const DirectoryEntry& e : all)
        addBlock(d, e.type, e.flags, e.length);
    addBlock(d, kIndx, kCritical, facts.indexLength);
}

void describePixels(const ShadowMap& map, Description& d) {
    d.layers = map.layerCount();
    d.z = wholeRange(map);
    d.layerHistogram.assign(1, 0);
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        for (std::uint32_t y = 0; y < map.info().height; ++y) {
            for (std::uint32_t x = 0; x < map.info().width; ++x) {
                const std::uint32_t count = map.pixel(face, x, y).count;
                if (count >= d.layerHistogram.size())
                    d.layerHistogram.resize(std::size_t(count) + 1);
                d.layerHistogram[count] += 1;
                d.pixels += 1;
            }
        }
    }
    d.emptyPixels = d.layerHistogram[0];
    d.mostLayers = static_cast<std::uint32_t>(d.layerHistogram.size() - 1);
}

Result<Description> describeFile(const std::string& path, const ReadLimits& limits) {
    const auto source = openFile(path);
    if (!source) return source.error();
    FileFacts facts;
    const auto map = readMapFile(**source, limits, &facts);
    if (!map) return map.error();

    Description d;
    const Prefix& p = facts.prefix;
    d.probe = {p.versionMajor, p.versionMinor, p.width,   p.height,
               p.faces,        p.channels,     p.tileSize};
    d.fileBytes = (*source)->size();
    static constexpr const char* kNames[] = {"counts", "z", "v", "n"};
    for (std::size_t kind = 0; kind < facts.planes.size(); ++kind) {
        if (facts.planes[kind].planes == 0) continue;
        d.planes.push_back(facts.planes[kind]);
        d.planes.back().name = kNames[kind];
    }
    describeBlocks(facts, d);
    describePixels(*map, d);
    return d;
}

}  // namespace
}  // namespace format

Result<Description> describe(const std::string& path, const ReadLimits& limits) {
    return format::guarded(path, "read",
                           [&] { return format::describeFile(path, limits); });
}

std::string printable(const std::string& text) {
    return base::printable(text);
}

}  // namespace mtsm
