// reader.h - map files into memory. What the bytes mean: format-spec/mtsm-format.md.
//
//     auto map = mtsm::readMap("key.mtsm");
//     if (!map) return complain(map.error());
//
// Every byte of a file is covered by a checksum or has a fixed value; sizes are proved
// against the file's length and against ReadLimits before anything is allocated for them.
// A file is read whole and checked whole, but for what ReadLimits pass over: a ShadowMap
// that comes out is right to the last layer, and tracing it cannot fail. Reading is safe
// on untrusted files. Functions may be called from any thread; tiles are decoded in the
// caller's oneTBB arena.
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm {

/// What a file may ask of this process. The error that a limit causes names it.
struct ReadLimits {
    /// Memory that is taken for tiles: the map that comes out (ShadowMap::memoryBytes())
    /// and, for each thread that decodes, the stored bytes of the largest tile and 8 to
    /// 12 bytes for each of its layers or pixels; of a near field the stored bytes,
    /// triangles once more, and, for each thread, the largest of the parts that it is
    /// stored in; of trees the stored bytes and twice what they take. Not counted: the
    /// index and the hierarchy as they are stored, which are a part of the file, and
    /// what maxAttributeBytes bounds, each at most twice.
    std::uint64_t maxBytes = std::uint64_t(8) << 30;
    /// Over all faces. By default all that a map may have.
    std::uint64_t maxPixels = std::uint64_t(6) * kMaxResolution * kMaxResolution;
    std::uint64_t maxAttributeBytes = 64u << 20;  ///< attributes and texts
    /// Without, the near field is passed over unread, so that a map whose near field is
    /// damaged still answers from its layers.
    bool nearField = true;
    /// Without, trees are passed over unread and made of the layers when a query wants
    /// them, as of a file that has none (WriteOptions::trees); and so are trees beside a
    /// near field that is passed over.
    bool trees = true;
    /// Without, layers are passed over unread where the file has trees to answer queries
    /// from, and the map is as after releaseLayers() (mtsm/shadow.h); see
    /// ShadowMap::hasLayers().
    bool layers = true;
};

/// The whole map. Errors: io, badFile (the message names the damaged part, its offset and
/// the way out), unsupported (newer major version, unknown critical block, or anything
/// else that is not understood in a newer minor version), tooLarge (a limit).
Result<ShadowMap> readMap(const std::string& path, const ReadLimits& limits = {});

/// The same from memory; `name` stands for the path in messages.
Result<ShadowMap> readMap(const std::uint8_t* bytes, std::size_t size,
                          const std::string& name, const ReadLimits& limits = {});

/// What the first 64 bytes of a file say. Opens nothing, allocates nothing for the file's
/// sake.
struct Probe {
    std::uint16_t versionMajor = 0, versionMinor = 0;
    std::uint32_t width = 0, height = 0, faces = 0, channels = 0, tileSize = 0;
};
inline constexpr std::size_t kProbeBytes = 64;

/// Errors: badFile (not an MTSM file, or the prefix is damaged), unsupported (newer
/// version).
Result<Probe> probe(const std::uint8_t* bytes, std::size_t size, const std::string& name);

}  // namespace mtsm
