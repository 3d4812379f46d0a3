#include "mtsm/near_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "base/message.h"
#include "base/parallel.h"
#include "map/near_boxes.h"
#include "map/near_points.h"

namespace mtsm {
namespace {

constexpr std::size_t kChildren = NearBoxes::kChildren;
constexpr std::size_t kNodesPerTask = 64;

std::uint64_t nodesAbove(std::uint64_t children) {
    return (children + kChildren - 1) / kChildren;
}

std::uint64_t boxBytes(std::uint64_t chunks) {
    std::uint64_t nodes = 0;
    for (std::uint64_t below = chunks; below > 0; below = below > 1 ? below : 0) {
        below = nodesAbove(below);
        nodes += below;
    }
    return nodes * sizeof(NearBoxes);
}

constexpr NearBoxes emptyBoxes() {
    constexpr float kNone = std::numeric_limits<float>::infinity();
    NearBoxes boxes{};
    for (int axis = 0; axis < 3; ++axis) {
        for (std::size_t i = 0; i < kChildren; ++i) {
            boxes.low[axis][i] = kNone;
            boxes.high[axis][i] = -kNone;
        }
    }
    return boxes;
}

/// Child i of `boxes` becomes the box of chunk k, no larger than its triangles.
void setBox(NearBoxes& boxes, std::size_t i, const NearChunks& chunks, std::size_t k) {
    const NearChunks::Place& place = chunks.place(k);
    const std::size_t count = place.areShort() ? map_detail::kCorners : place.points;
    std::uint16_t room[map_detail::kCorners];
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::uint16_t* const q = map_detail::axisOf(chunks, k, axis, room);
        std::uint16_t least = 0xffff, most = 0;
        for (std::size_t point = 0; point < count; ++point) {
            least = std::min(least, q[point]);
            most = std::max(most, q[point]);
        }
        boxes.low[axis][i] = place.low[axis] + place.step[axis] * float(least);
        boxes.high[axis][i] = place.low[axis] + place.step[axis] * float(most);
    }
}

/// Half widths that a box reaches further than the middle lines in it.
constexpr float kHairReach = 4.0f;

/// Of strands, as far as their ribbons may reach from their middle lines, and what lies
/// within two widths of them: in any direction of the world.
void setBox(NearBoxes& boxes, std::size_t i, const NearHairChunks& chunks, std::size_t k,
            const Projection& p) {
    const NearHairChunk chunk = chunks[k];
    const bool perspective = p.kind == ProjectionKind::perspective;
    constexpr int kSegments = NearHairChunk::kSegments;
    for (int axis = 0; axis < 3; ++axis) {
        const auto scale = axis < 2 ? float(std::abs(p.scale[axis])) : 0.0f;
        const auto offset = axis < 2 ? float(p.offset[axis]) : 0.0f;
        // Of each segment, so that the compiler can do with vectors.
        float low[2][kSegments], high[2][kSegments];
        for (int e = 0; e < 2; ++e) {
            for (int s = 0; s < kSegments; ++s) {
                const float at = chunk.at(e, axis, s);
                // x / z moves by half (1 + |x / z|) / (1 - half) at most.
                const float per = !perspective ? (axis < 2 ? scale : 1.0f)
                                  : axis < 2   ? scale + std::abs(at - offset)
                                               : at;
                const float reach = kHairReach * chunk.halfAt(e, s) * per;
                low[e][s] = at - reach;
                high[e][s] = at + reach;
            }
        }
        float least = std::numeric_limits<float>::infinity(), most = -least;
        for (int s = 0; s < kSegments; ++s) {
            if (chunk.opacity[s] == 0) continue;
            least = std::min({least, low[0][s], low[1][s]});
            most = std::max({most, high[0][s], high[1][s]});
        }
        boxes.low[axis][i] = least;
        boxes.high[axis][i] = most;
    }
}

/// ... and the box around all children of a node.
void setBox(NearBoxes& boxes, std::size_t i, const std::vector<NearBoxes>& children,
            std::size_t k) {
    const NearBoxes& below = children[k];
    for (int axis = 0; axis < 3; ++axis) {
        boxes.low[axis][i] =
            *std::min_element(below.low[axis], below.low[axis] + kChildren);
        boxes.high[axis][i] =
            *std::max_element(below.high[axis], below.high[axis] + kChildren);
    }
}

template <typename Children, typename... With>
std::vector<NearBoxes> levelAbove(const Children& children, const With&... with) {
    std::vector<NearBoxes> level(nodesAbove(children.size()), emptyBoxes());
    base::parallelRanges(
        std::size_t(0), level.size(), kNodesPerTask, [&](auto first, auto last) {
            for (std::size_t node = first; node < last; ++node) {
                const std::size_t begin = node * kChildren;
                const std::size_t end = std::min(begin + kChildren, children.size());
                for (std::size_t i = begin; i < end; ++i)
                    setBox(level[node], i - begin, children, i, with...);
            }
        });
    return level;
}

}  // namespace

std::uint64_t NearField::triangles() const noexcept {
    std::uint64_t count = 0;
    for (std::size_t i = 0; i < chunks.size(); ++i)
        count += chunks.place(i).triangles;
    return count;
}

std::uint64_t NearHair::segments() const noexcept {
    std::uint64_t count = 0;
    for (const NearHairChunk chunk : chunks)
        count += std::uint64_t(chunk.segments());
    return count;
}

std::uint64_t memoryBytes(const NearField& field) noexcept {
    return field.chunks.memoryBytes() + boxBytes(field.chunks.size());
}

std::uint64_t memoryBytes(const NearHair& hair) noexcept {
    return hair.chunks.memoryBytes() + boxBytes(hair.chunks.size());
}

std::uint64_t nearFieldBytes(std::uint64_t chunks, int points) noexcept {
    return NearChunks::memoryBytes(chunks, points) + boxBytes(chunks);
}

std::uint64_t nearHairBytes(std::uint64_t chunks) noexcept {
    return chunks * NearHairChunks::kLongBytes + boxBytes(chunks);
}

namespace map_detail {

namespace {

template <typename Chunk>
Status checkGrid(const Chunk& chunk, std::size_t i, std::uint32_t face) {
    for (int axis = 0; axis < 3; ++axis) {
        const float low = chunk.low[axis], step = chunk.step[axis];
        if (std::isfinite(low) && step >= 0.0f && std::isfinite(low + step * 65535.0f))
            continue;
        return base::makeError(ErrorCode::badArgument, "face ", face,
                               ": near field: chunk ", i, ", axis ", "uvw"[axis],
                               ": starts at ", low, " with steps of ", step,
                               ", which must be finite and not go backwards");
    }
    return {};
}

template <typename Field, typename... With>
void buildLevels(Field& field, const With&... with) {
    field.levels.clear();
    if (field.chunks.empty()) return;
    field.levels.push_back(levelAbove(field.chunks, with...));
    while (field.levels.back().size() > 1)
        field.levels.push_back(levelAbove(field.levels.back()));
}

template <typename Chunks>
bool same(const Chunks& a, const Chunks& b) {
    if (a.size() != b.size()) return false;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const auto &x = a[i], &y = b[i];
        if (std::memcmp(&x, &y, sizeof x) != 0) return false;
    }
    return true;
}

}  // namespace

Status checkChunks(const MapFace& face, std::uint32_t number) {
    for (std::size_t i = 0; i < face.nearField.chunks.size(); ++i) {
        if (auto s = checkGrid(face.nearField.chunks.place(i), i, number); !s) return s;
    }
    for (std::size_t i = 0; i < face.nearSheets.triangles.chunks.size(); ++i) {
        if (auto s = checkGrid(face.nearSheets.triangles.chunks.place(i), i, number); !s)
            return s;
    }
    const float most = face.projection.kind == ProjectionKind::perspective
                           ? 0.5f
                           : std::numeric_limits<float>::max();
    for (std::size_t i = 0; i < face.nearHair.chunks.size(); ++i) {
        const NearHairChunks::Packed& chunk = face.nearHair.chunks.packed(i);
        if (auto s = checkGrid(chunk, i, number); !s) return s;
        if (!(chunk.halfStep >= 0.0f && chunk.halfStep * 255.0f <= most))
            return base::makeError(ErrorCode::badArgument, "face ", number,
                                   ": near field: chunk ", i, " of strands: steps of ",
                                   chunk.halfStep, " in width, must be 0 to ",
                                   most / 255.0f);
    }
    return {};
}

void buildBoxes(MapFace& face) {
    buildLevels(face.nearSheets.triangles);
    buildLevels(face.nearField);
    buildLevels(face.nearHair, face.projection);
}

bool sameChunks(const NearField& a, const NearField& b) noexcept {
    return same(a.chunks, b.chunks);
}

bool sameChunks(const NearHair& a, const NearHair& b) noexcept {
    return same(a.chunks, b.chunks);
}

}  // namespace map_detail
}  // namespace mtsm
