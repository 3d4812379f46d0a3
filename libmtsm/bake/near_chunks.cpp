#include "bake/near_chunks.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "bake/hilbert.h"
#include "base/parallel.h"

namespace mtsm::bake_detail {
namespace {

constexpr int kAxisBits = 16;                // of a cell of the Hilbert curve
constexpr double kFinestStep = 1.0 / 256.0;  // pixels, footprints
constexpr double kFineReach = 255.0;         // of chunks of triangles up to kFineSize
constexpr double kFineSize = 64.0;
constexpr double kCoarseReach = 2047.0;
constexpr std::size_t kPerTask = 4096;

struct Box {
    float low[3], high[3];

    explicit Box(const NearTriangle& t) {
        for (int axis = 0; axis < 3; ++axis) {
            const float a = t.corner[0][axis], b = t.corner[1][axis],
                        c = t.corner[2][axis];
            low[axis] = std::min({a, b, c});
            high[axis] = std::max({a, b, c});
        }
    }
    void add(const Box& other) {
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], other.low[axis]);
            high[axis] = std::max(high[axis], other.high[axis]);
        }
    }
};

/// Lengths along w in footprints of a pixel.
struct Footprints {
    explicit Footprints(const Projection& projection)
        : perspective(projection.kind == ProjectionKind::perspective),
          perPixel(projection.pixelFootprint(1.0)) {}

    bool perspective;
    double perPixel;

    /// A footprint at the far end of the box, where it is least.
    [[nodiscard]] double unit(const Box& box) const {
        return perspective ? box.low[2] * perPixel : perPixel;
    }
    /// The longest of the three sides.
    [[nodiscard]] double size(const Box& box) const {
        return std::max({double(box.high[0]) - box.low[0],
                         double(box.high[1]) - box.low[1],
                         (double(box.high[2]) - box.low[2]) / unit(box)});
    }
    /// A coordinate of depth that grows by about 1 per footprint. The bits of a float are
    /// its logarithm but for a few hundredths, and the same on every machine.
    [[nodiscard]] double depth(double w) const {
        if (!perspective) return w / perPixel;
        constexpr double kLn2 = 0.6931471805599453;
        return std::bit_cast<std::int32_t>(float(w)) * (kLn2 * 0x1p-23) / perPixel;
    }
    /// Of a triangle's centre.
    [[nodiscard]] glm::dvec3 place(const NearTriangle& t) const {
        glm::dvec3 sum(0.0);
        for (const auto& corner : t.corner)
            sum += glm::dvec3(corner[0], corner[1], corner[2]);
        sum /= 3.0;
        return {sum.x, sum.y, depth(sum.z)};
    }
};

/// 0 up to a pixel, then one more for each factor of four.
std::uint64_t sizeClass(double size) {
    std::uint64_t c = 0;
    for (double most = 1.0; size > most && c < 15; most *= 4.0)
        ++c;
    return c;
}

struct Entry {
    std::uint64_t key;
    std::uint32_t triangle;
};

/// All triangles in the order in which they are cut into chunks.
std::vector<Entry> sorted(const std::vector<NearTriangle>& triangles,
                          const Footprints& footprints) {
    glm::dvec3 low(HUGE_VAL), high(-HUGE_VAL);
    for (const NearTriangle& t : triangles) {
        const glm::dvec3 p = footprints.place(t);
        low = glm::min(low, p);
        high = glm::max(high, p);
    }
    const glm::dvec3 reach = high - low;
    const double side = std::max({reach.x, reach.y, reach.z, 1e-300});
    const double cells = double((1u << kAxisBits) - 1) / side;
    std::vector<Entry> entries(triangles.size());
    base::parallelRanges(
        std::size_t(0), entries.size(), kPerTask, [&](auto begin, auto end) {
            for (std::size_t i = begin; i < end; ++i) {
                const glm::dvec3 p = (footprints.place(triangles[i]) - low) * cells;
                const double size = footprints.size(Box(triangles[i]));
                entries[i] = {sizeClass(size) << (3 * kAxisBits) |
                                  hilbertPlace({std::uint32_t(p.x), std::uint32_t(p.y),
                                                std::uint32_t(p.z)},
                                               kAxisBits),
                              std::uint32_t(i)};
            }
        });
    // Ties go by the triangles themselves: which came first must not matter.
    std::sort(entries.begin(), entries.end(), [&](const Entry& a, const Entry& b) {
        if (a.key != b.key) return a.key < b.key;
        return std::memcmp(&triangles[a.triangle], &triangles[b.triangle],
                           sizeof(NearTriangle)) < 0;
    });
    return entries;
}

/// Where chunks begin among the sorted triangles, and behind them their number.
std::vector<std::size_t> cut(const std::vector<NearTriangle>& triangles,
                             const std::vector<Entry>& order,
                             const Footprints& footprints) {
    std::vector<std::size_t> begins;
    for (std::size_t i = 0; i < order.size();) {
        begins.push_back(i);
        Box box(triangles[order[i].triangle]);
        const bool fine = footprints.size(box) <= kFineSize;
        const std::size_t end = std::min(i + NearChunk::kTriangles, order.size());
        while (++i < end) {
            Box both = box;
            both.add(Box(triangles[order[i].triangle]));
            if (footprints.size(both) > (fine ? kFineReach : kCoarseReach)) break;
            box = both;
        }
    }
    begins.push_back(order.size());
    return begins;
}

/// The finest grid of powers of two, no finer than `least`, on which 16 bits reach from
/// low to high and a float holds every multiple.
struct Grid {
    double step;
    std::int64_t first;

    Grid(double low, double high, double least) {
        int exponent = 0;
        (void)std::frexp(least, &exponent);
        for (step = std::ldexp(1.0, exponent - 1);; step *= 2.0) {
            const double most = std::max(std::abs(low), std::abs(high)) / step;
            if (most >= 0x1p24 - 1.0) continue;
            first = nearest(low);
            if (nearest(high) - first <= 0xffff) break;
        }
    }
    [[nodiscard]] std::int64_t nearest(double x) const {
        return std::int64_t(std::floor(x / step + 0.5));
    }
};

NearChunk chunkOf(const std::vector<NearTriangle>& triangles, const Entry* entries,
                  std::size_t count, const Footprints& footprints) {
    Box box(triangles[entries[0].triangle]);
    for (std::size_t i = 1; i < count; ++i)
        box.add(Box(triangles[entries[i].triangle]));
    NearChunk chunk;
    for (int axis = 0; axis < 3; ++axis) {
        const double unit = axis == 2 ? footprints.unit(box) : 1.0;
        const Grid grid(box.low[axis], box.high[axis], unit * kFinestStep);
        chunk.step[axis] = float(grid.step);
        chunk.low[axis] = float(double(grid.first) * grid.step);
        for (int c = 0; c < 3; ++c) {
            for (std::size_t i = 0; i < NearChunk::kTriangles; ++i) {
                const NearTriangle& t =
                    triangles[entries[std::min(i, count - 1)].triangle];
                chunk.corner[c][axis][i] =
                    std::uint16_t(grid.nearest(t.corner[c][axis]) - grid.first);
            }
        }
    }
    return chunk;
}

}  // namespace

NearPacking packTriangles(const std::vector<NearTriangle>& triangles,
                          const Projection& projection) {
    const Footprints footprints(projection);
    const std::vector<Entry> order = sorted(triangles, footprints);
    const std::vector<std::size_t> begins = cut(triangles, order, footprints);
    NearPacking packing;
    std::vector<NearChunk>& chunks = packing.field.chunks;
    chunks.resize(begins.size() - 1);
    packing.triangle.resize(chunks.size() * NearChunk::kTriangles);
    base::parallelRanges(
        std::size_t(0), chunks.size(), kPerTask / 16, [&](auto first, auto last) {
            for (std::size_t i = first; i < last; ++i) {
                const Entry* const entries = order.data() + begins[i];
                const std::size_t count = begins[i + 1] - begins[i];
                chunks[i] = chunkOf(triangles, entries, count, footprints);
                for (std::size_t t = 0; t < NearChunk::kTriangles; ++t)
                    packing.triangle[i * NearChunk::kTriangles + t] =
                        entries[std::min(t, count - 1)].triangle;
            }
        });
    return packing;
}

NearField packNear(const std::vector<NearTriangle>& triangles,
                   const Projection& projection) {
    return packTriangles(triangles, projection).field;
}

}  // namespace mtsm::bake_detail
