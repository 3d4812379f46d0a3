// map_file.h - a whole file into a map, and what was met on the way.
#pragma once
#include <array>

#include "format/index.h"
#include "format/layout.h"
#include "format/source.h"
#include "mtsm/describe.h"

namespace mtsm::format {

/// For describe(): what a map in memory no longer tells.
struct FileFacts {
    Prefix prefix = {};
    Index index;
    std::uint64_t indexLength = 0;
    std::array<Description::Plane, 4> planes;  ///< by PlaneKind
};

/// readMap() of reader.h from any source; fills `facts` if it is not null. May throw.
Result<ShadowMap> readMapFile(const Source& source, const ReadLimits& limits,
                              FileFacts* facts);

}  // namespace mtsm::format
