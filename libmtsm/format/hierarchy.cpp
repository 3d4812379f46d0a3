#include "format/hierarchy.h"

#include <algorithm>
#include <bit>

#include "base/bytes.h"
#include "base/message.h"

namespace mtsm::format {
namespace {

using base::makeError;

std::uint32_t halved(std::uint32_t n, std::uint32_t times) {
    return static_cast<std::uint32_t>((std::uint64_t(n) + (1ull << times) - 1) >> times);
}

/// Calls visit(face, level, x, y, range) for every node in the order of the file; stops
/// when it returns false.
template <typename Visit>
void forEachNode(const ShadowMap& map, Visit&& visit) {
    const HierarchyShape shape{map.tilesX(), map.tilesY()};
    const auto tileLevel = std::uint32_t(std::countr_zero(map.info().tileSize));
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        for (std::uint32_t level = 0; level < shape.levels(); ++level) {
            // A map smaller than a tile has its one node at a finer level of its own.
            const auto mapLevel = std::min(tileLevel + level, map.levels() - 1);
            for (std::uint32_t y = 0; y < shape.height(level); ++y) {
                for (std::uint32_t x = 0; x < shape.width(level); ++x) {
                    if (!visit(face, level, x, y, map.zRange(face, mapLevel, x, y)))
                        return;
                }
            }
        }
    }
}

bool sameBits(DepthRange a, ZRange b) {
    const auto bits = [](float f) { return std::bit_cast<std::uint32_t>(f); };
    return bits(a.min) == bits(b.min) && bits(a.max) == bits(b.max);
}

Status checkFixed(const HierarchyFixed& fixed, std::uint32_t faces,
                  HierarchyShape shape) {
    if (fixed.faces == faces && fixed.levels == shape.levels()) return {};
    return makeError(ErrorCode::badFile, "says ", fixed.faces, " faces and ",
                     fixed.levels, " levels, not ", faces, " and ", shape.levels());
}

}  // namespace

std::uint32_t HierarchyShape::levels() const noexcept {
    return std::uint32_t(std::bit_width(std::max(tilesX, tilesY) - 1)) + 1;
}

std::uint32_t HierarchyShape::width(std::uint32_t level) const noexcept {
    return halved(tilesX, level);
}

std::uint32_t HierarchyShape::height(std::uint32_t level) const noexcept {
    return halved(tilesY, level);
}

std::uint64_t HierarchyShape::bytes(std::uint32_t faces) const noexcept {
    std::uint64_t nodes = 0;
    for (std::uint32_t level = 0; level < levels(); ++level)
        nodes += std::uint64_t(width(level)) * height(level);
    return sizeof(HierarchyFixed) + faces * nodes * sizeof(DepthRange);
}

Bytes encodeHierarchy(const ShadowMap& map) {
    const HierarchyShape shape{map.tilesX(), map.tilesY()};
    Bytes bytes;
    bytes.reserve(shape.bytes(map.faceCount()));
    base::ByteWriter out(bytes);
    out.put(HierarchyFixed{map.faceCount(), shape.levels()});
    forEachNode(map, [&](auto, auto, auto, auto, ZRange z) {
        out.put(DepthRange{z.min, z.max});
        return true;
    });
    return bytes;
}

Status checkHierarchy(BytesView payload, const ShadowMap& map) {
    const HierarchyShape shape{map.tilesX(), map.tilesY()};
    base::ByteReader in(payload);
    if (auto s = checkFixed(in.get<HierarchyFixed>(), map.faceCount(), shape); !s)
        return s;
    Status status;
    forEachNode(map, [&](auto face, auto level, auto x, auto y, ZRange z) {
        const auto stored = in.get<DepthRange>();
        if (sameBits(stored, z)) return true;
        status =
            makeError(ErrorCode::badFile, "face ", face, ", level ", level, ", node (", x,
                      ", ", y, ") says depths from ", stored.min, " to ", stored.max,
                      ", its layers span ", z.min, " to ", z.max);
        return false;
    });
    return status;
}

Result<std::vector<ZRange>> hierarchyRoots(BytesView payload, std::uint32_t faces,
                                           HierarchyShape shape) {
    base::ByteReader in(payload);
    if (auto s = checkFixed(in.get<HierarchyFixed>(), faces, shape); !s) return s.error();
    const std::uint64_t perFace = (shape.bytes(faces) - sizeof(HierarchyFixed)) / faces;
    std::vector<ZRange> roots;
    for (std::uint32_t face = 0; face < faces; ++face) {
        (void)in.bytes(perFace - sizeof(DepthRange));
        const auto z = in.get<DepthRange>();
        roots.push_back({z.min, z.max});
    }
    return roots;
}

}  // namespace mtsm::format
