// describe.h - what is in a map file, in numbers that a person or a script can read.
//
//     auto d = mtsm::describe("key.mtsm");
//     std::cout << d->layers << " layers in " << d->fileBytes << " bytes\n";
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/reader.h"
#include "mtsm/result.h"

namespace mtsm {

/// Where a file's bytes go, and what its layers look like.
struct Description {
    Probe probe;
    std::uint64_t fileBytes = 0;
    struct Block {
        std::string type;  ///< four characters
        bool critical = false;
        std::uint64_t count = 0, bytes = 0;  ///< headers and padding included
    };
    std::vector<Block> blocks;  ///< one entry per type, in order of first appearance
    struct Plane {
        std::string name;  ///< "counts", "z", "v" or "n"
        std::uint64_t planes = 0, constant = 0, raw = 0, compressed = 0;  ///< by encoding
        std::uint64_t storedBytes = 0, decodedBytes = 0;
        /// Planes that are not in the file because they say nothing (tiles without layers
        /// or with opaque ones only, layers of one sample each), and what they would take
        /// as they are.
        std::uint64_t leftOut = 0, leftOutBytes = 0;
    };
    std::vector<Plane> planes;
    std::uint64_t tiles = 0, emptyTiles = 0, opaqueTiles = 0;
    std::uint64_t pixels = 0, emptyPixels = 0, layers = 0;
    std::uint64_t samples = 0;     ///< that the layers stand for
    std::uint32_t mostLayers = 0;  ///< in one pixel
    std::vector<std::uint64_t>
        layerHistogram;  ///< [i]: pixels with i layers; last entry: mostLayers
    ZRange z;            ///< of all faces
    std::uint64_t nearTriangles = 0;  ///< of all faces' near fields
    std::uint64_t nearSegments = 0;   ///< of strands, likewise
    std::uint64_t nearTextures = 0;   ///< of opacities, that some of the triangles have
    std::uint64_t nearChunks = 0;     ///< of 16 that both lie in
    std::uint64_t nearBytes = 0;      ///< that they take in memory
};

/// Reads and checks the whole file, as readMap does.
Result<Description> describe(const std::string& path, const ReadLimits& limits = {});

/// Text of unknown origin, such as a map's attributes, fit for one line of a terminal:
/// control characters and bytes that are no UTF-8 become \n, \r, \t or \xNN. Messages of
/// this library have been through it.
std::string printable(const std::string& text);

/// A number of bytes as people write it: 1000000, 512M, 8G; with K, M, G or T, of either
/// case, so many times a power of 1024. At least 1; else, or if 64 bits are too few,
/// nothing.
std::optional<std::uint64_t> parseBytes(const std::string& text);

}  // namespace mtsm
