// writer.h - a map into a file.
//
//     mtsm::Status done = mtsm::writeMap(map, "key.mtsm");
//     if (!done) return complain(done.error());
//
// The file appears under its name complete or not at all: bytes go to a temporary file in
// the same folder, are synced to the disk and renamed over the target; on any failure the
// temporary is removed and what was there stays. A symbolic link stays and what it points
// to is replaced; a file that is replaced passes its permissions on. What exists and is
// no regular file (a pipe, /dev/stdout) is written to as it is.
//
// The bytes depend on the map and the options alone, never on the number of threads.
// Tiles are encoded in the caller's oneTBB arena.
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm {

enum class Codec : std::uint32_t { none = 0, zstd = 1 };

struct WriteOptions {
    Codec codec = Codec::zstd;  ///< a plane that it does not make smaller is stored raw
    int level = 3;              ///< zstd's, 1..19
    /// Also the trees that queries go through, made if they are not yet: a reader then
    /// makes none, and need not even read the layers (ReadLimits::layers). They make the
    /// file larger, of opaque maps by 1 to 7 bytes a pixel. None are written of maps that
    /// queries know no trees of (more than 2^28 layers, six faces that are no cube's), or
    /// if there is no memory for them.
    bool trees = false;
    /// Called now and then from one thread at a time with the fraction done, 0..1;
    /// returning false stops the writing (ErrorCode::cancelled).
    std::function<bool(double)> progress;
};

/// Errors: io (names the path and the system's reason), badArgument (an option out of its
/// range; a text, an attribute's name or its text that is not UTF-8; more bytes of
/// attributes and texts than ReadLimits allows by default), cancelled, tooLarge (out of
/// memory).
Status writeMap(const ShadowMap& map, const std::string& path,
                const WriteOptions& options = {});

/// The same bytes in memory.
Result<std::vector<std::uint8_t>> encodeMap(const ShadowMap& map,
                                            const WriteOptions& options = {});

}  // namespace mtsm
