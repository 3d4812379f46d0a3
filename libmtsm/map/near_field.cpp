#include "mtsm/near_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "base/message.h"
#include "base/parallel.h"
#include "map/near_boxes.h"

namespace mtsm {
namespace {

constexpr std::size_t kChildren = NearBoxes::kChildren;
constexpr std::size_t kNodesPerTask = 64;

std::uint64_t nodesAbove(std::uint64_t children) {
    return (children + kChildren - 1) / kChildren;
}

bool sameTriangle(const NearChunk& chunk, int a, int b) {
    for (const auto& corner : chunk.corner) {
        for (const auto& axis : corner) {
            if (axis[a] != axis[b]) return false;
        }
    }
    return true;
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

/// Child i of `boxes` becomes the box of a chunk, no larger than its triangles.
void setBox(NearBoxes& boxes, std::size_t i, const NearChunk& chunk) {
    for (int axis = 0; axis < 3; ++axis) {
        std::uint16_t least = 0xffff, most = 0;
        for (const auto& corner : chunk.corner) {
            for (const std::uint16_t q : corner[axis]) {
                least = std::min(least, q);
                most = std::max(most, q);
            }
        }
        boxes.low[axis][i] = chunk.low[axis] + chunk.step[axis] * float(least);
        boxes.high[axis][i] = chunk.low[axis] + chunk.step[axis] * float(most);
    }
}

/// ... and the box around all children of a node.
void setBox(NearBoxes& boxes, std::size_t i, const NearBoxes& below) {
    for (int axis = 0; axis < 3; ++axis) {
        boxes.low[axis][i] =
            *std::min_element(below.low[axis], below.low[axis] + kChildren);
        boxes.high[axis][i] =
            *std::max_element(below.high[axis], below.high[axis] + kChildren);
    }
}

template <typename Child>
std::vector<NearBoxes> levelAbove(const std::vector<Child>& children) {
    std::vector<NearBoxes> level(nodesAbove(children.size()), emptyBoxes());
    base::parallelRanges(
        std::size_t(0), level.size(), kNodesPerTask, [&](auto first, auto last) {
            for (std::size_t node = first; node < last; ++node) {
                const std::size_t begin = node * kChildren;
                const std::size_t end = std::min(begin + kChildren, children.size());
                for (std::size_t i = begin; i < end; ++i)
                    setBox(level[node], i - begin, children[i]);
            }
        });
    return level;
}

}  // namespace

int NearChunk::triangles() const noexcept {
    int count = kTriangles;
    while (count > 1 && sameTriangle(*this, count - 2, kTriangles - 1))
        --count;
    return count;
}

std::uint64_t NearField::triangles() const noexcept {
    std::uint64_t count = 0;
    for (const NearChunk& chunk : chunks)
        count += std::uint64_t(chunk.triangles());
    return count;
}

std::uint64_t nearFieldBytes(std::uint64_t chunks) noexcept {
    std::uint64_t nodes = 0;
    for (std::uint64_t below = chunks; below > 0; below = below > 1 ? below : 0) {
        below = nodesAbove(below);
        nodes += below;
    }
    return chunks * sizeof(NearChunk) + nodes * sizeof(NearBoxes);
}

namespace map_detail {

Status checkChunks(const NearField& field, std::uint32_t face) {
    for (std::size_t i = 0; i < field.chunks.size(); ++i) {
        const NearChunk& chunk = field.chunks[i];
        for (int axis = 0; axis < 3; ++axis) {
            const float low = chunk.low[axis], step = chunk.step[axis];
            if (std::isfinite(low) && step >= 0.0f &&
                std::isfinite(low + step * 65535.0f))
                continue;
            return base::makeError(ErrorCode::badArgument, "face ", face,
                                   ": near field: chunk ", i, ", axis ", "uvw"[axis],
                                   ": starts at ", low, " with steps of ", step,
                                   ", which must be finite and not go backwards");
        }
    }
    return {};
}

void buildBoxes(NearField& field) {
    field.levels.clear();
    if (field.chunks.empty()) return;
    field.levels.push_back(levelAbove(field.chunks));
    while (field.levels.back().size() > 1)
        field.levels.push_back(levelAbove(field.levels.back()));
}

bool sameChunks(const NearField& a, const NearField& b) noexcept {
    return a.chunks.size() == b.chunks.size() &&
           (a.chunks.empty() || std::memcmp(a.chunks.data(), b.chunks.data(),
                                            a.chunks.size() * sizeof(NearChunk)) == 0);
}

}  // namespace map_detail
}  // namespace mtsm
