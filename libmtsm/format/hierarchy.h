// hierarchy.h - the min/max z above the tiles <-> HIER, so that a program can refuse
// whole regions of a file before it reads a single tile.
#pragma once
#include "format/header.h"

namespace mtsm::format {

/// Nodes of one level of one face: level 0 has a node per tile, each further level halves
/// both sides, rounding up, until one node is left.
struct HierarchyShape {
    std::uint32_t tilesX = 0, tilesY = 0;

    [[nodiscard]] std::uint32_t levels() const noexcept;
    [[nodiscard]] std::uint32_t width(std::uint32_t level) const noexcept;
    [[nodiscard]] std::uint32_t height(std::uint32_t level) const noexcept;
    /// Bytes of a HIER payload for so many faces.
    [[nodiscard]] std::uint64_t bytes(std::uint32_t faces) const noexcept;
};

[[nodiscard]] Bytes encodeHierarchy(const ShadowMap& map);

/// Succeeds if the payload is, to the last bit, what the layers of `map` give.
Status checkHierarchy(BytesView payload, const ShadowMap& map);

/// By face, what the payload says that all its layers lie between, for a map whose layers
/// nobody reads.
Result<std::vector<ZRange>> hierarchyRoots(BytesView payload, std::uint32_t faces,
                                           HierarchyShape shape);

}  // namespace mtsm::format
