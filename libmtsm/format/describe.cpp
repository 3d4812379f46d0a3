#include "mtsm/describe.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <numeric>
#include <string_view>

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

/// Planes of the kind that a tile does not have.
void leaveOut(FileFacts& facts, PlaneKind kind, std::uint64_t planes,
              std::uint64_t bytes) {
    Description::Plane& plane = facts.planes[std::size_t(kind)];
    plane.leftOut += planes;
    plane.leftOutBytes += bytes;
}

void describeLeftOut(const ShadowMap& map, FileFacts& facts) {
    const std::uint32_t channels = map.info().channels;
    for (const TileEntry& e : facts.index.tiles) {
        const std::uint64_t layers = e.layers;
        if (e.offset != 0 && !(e.planes & kHasV))
            leaveOut(facts, PlaneKind::v, channels, channels * layers * sizeof(float));
        if (e.offset != 0 && !(e.planes & kHasN))
            leaveOut(facts, PlaneKind::n, 1, layers);  // ones fit in a byte
    }
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
            for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx) {
                if (!map.tile(face, tx, ty).empty()) continue;
                leaveOut(facts, PlaneKind::counts, 1,
                         std::uint64_t(map.tileWidth(tx)) * map.tileHeight(ty));
            }
        }
    }
}

void describePixels(const ShadowMap& map, Description& d) {
    d.layers = map.layerCount();
    d.z = wholeRange(map);
    d.layerHistogram.assign(1, 0);
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        for (std::uint32_t y = 0; y < map.info().height; ++y) {
            for (std::uint32_t x = 0; x < map.info().width; ++x) {
                const PixelLayers pixel = map.pixel(face, x, y);
                const std::uint32_t count = pixel.count;
                d.samples +=
                    pixel.n ? std::accumulate(pixel.n, pixel.n + count, std::uint64_t(0))
                            : count;
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

void describeNearField(const ShadowMap& map, Description& d) {
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        const NearField& field = map.nearField(face);
        d.nearTriangles += field.triangles();
        d.nearChunks += field.chunks.size();
        d.nearBytes += mtsm::memoryBytes(field);
        const NearHair& hair = map.nearHair(face);
        d.nearSegments += hair.segments();
        d.nearChunks += hair.chunks.size();
        d.nearBytes += mtsm::memoryBytes(hair);
        const NearSheets& sheets = map.nearSheets(face);
        for (std::size_t i = 0; i < sheets.chunks.size(); ++i)
            d.nearTriangles += sheets.chunks.place(i).triangles;
        d.nearTextures += sheets.textures.size();
        d.nearChunks += sheets.chunks.size();
        d.nearBytes += mtsm::memoryBytes(sheets);
    }
}

Result<Description> describeFile(const std::string& path, const ReadLimits& limits) {
    const auto source = openFile(path);
    if (!source) return source.error();
    FileFacts facts;
    ReadLimits all = limits;
    all.layers = true;
    const auto map = readMapFile(**source, all, &facts);
    if (!map) return map.error();

    Description d;
    const Prefix& p = facts.prefix;
    d.probe = {p.versionMajor, p.versionMinor, p.width,   p.height,
               p.faces,        p.channels,     p.tileSize};
    d.fileBytes = (*source)->size();
    describeLeftOut(*map, facts);
    static constexpr const char* kNames[] = {"counts", "z", "v", "n"};
    for (std::size_t kind = 0; kind < facts.planes.size(); ++kind) {
        if (facts.planes[kind].planes + facts.planes[kind].leftOut == 0) continue;
        d.planes.push_back(facts.planes[kind]);
        d.planes.back().name = kNames[kind];
    }
    describeBlocks(facts, d);
    describePixels(*map, d);
    describeNearField(*map, d);
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

std::optional<std::uint64_t> parseBytes(const std::string& text) {
    constexpr std::string_view kSuffixes = "KMGT";
    std::string_view digits = text;
    std::size_t shift = 0;
    if (!digits.empty()) {
        const auto last = char(std::toupper(static_cast<unsigned char>(digits.back())));
        if (const auto at = kSuffixes.find(last); at != std::string_view::npos) {
            shift = 10 * (at + 1);
            digits.remove_suffix(1);
        }
    }
    if (digits.starts_with('+')) digits.remove_prefix(1);
    const char* const end = digits.data() + digits.size();
    std::uint64_t count = 0;
    const auto [at, problem] = std::from_chars(digits.data(), end, count);
    if (problem != std::errc() || at != end || count == 0 || count > UINT64_MAX >> shift)
        return std::nullopt;
    return count << shift;
}

}  // namespace mtsm
