#include "bake/near_chunks.h"

#include <hwy/cache_control.h>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <mutex>
#include <utility>

#include "bake/hilbert.h"
#include "base/parallel.h"
#include "base/radix_sort.h"

namespace mtsm::bake_detail {
namespace {

constexpr int kAxisBits = 16;                // of a cell of the Hilbert curve
constexpr int kClassBits = 4;                // of a class of sizes
constexpr double kFinestStep = 1.0 / 256.0;  // pixels, footprints
constexpr double kFineReach = 255.0;         // of chunks of items up to kFineSize
constexpr double kFineSize = 64.0;
constexpr double kCoarseReach = 2047.0;
constexpr std::size_t kPerTask = 4096;
constexpr std::size_t kChunksPerTask = kPerTask / NearChunk::kTriangles;

std::size_t tasksFor(std::size_t chunks) {
    return (chunks + kChunksPerTask - 1) / kChunksPerTask;
}

// What makes a chunk of triangles and of segments differ: their points, [u, v, w] each.
using Triangle = NearTriangle;
using Segment = NearSegment;
const float (&pointsOf(const Triangle& t))[3][3] {
    return t.corner;
}
const float (&pointsOf(const Segment& s))[2][3] {
    return s.end;
}

struct Box {
    float low[3], high[3];

    template <typename Item>
    explicit Box(const Item& item) {
        const auto& points = pointsOf(item);
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = high[axis] = points[0][axis];
            for (const auto& p : points) {
                low[axis] = std::min(low[axis], p[axis]);
                high[axis] = std::max(high[axis], p[axis]);
            }
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
    /// Of the centre.
    template <typename Item>
    [[nodiscard]] glm::dvec3 place(const Item& item) const {
        glm::dvec3 sum(0.0);
        const auto& points = pointsOf(item);
        for (const auto& p : points)
            sum += glm::dvec3(p[0], p[1], p[2]);
        sum /= double(std::size(points));
        return {sum.x, sum.y, depth(sum.z)};
    }
};

/// 0 up to a pixel, then one more for each factor of four.
std::uint64_t sizeClass(double size) {
    std::uint64_t c = 0;
    for (double most = 1.0; size > most && c < (1u << kClassBits) - 1; most *= 4.0)
        ++c;
    return c;
}

struct Entry {
    std::uint64_t key;
    std::uint32_t item;
};

/// The box around the places of all items.
template <typename Item>
std::pair<glm::dvec3, glm::dvec3> bounds(const std::vector<Item>& items,
                                         const Footprints& footprints) {
    std::mutex mutex;
    glm::dvec3 low(HUGE_VAL), high(-HUGE_VAL);
    base::parallelRanges(std::size_t(0), items.size(), kPerTask,
                         [&](auto begin, auto end) {
                             glm::dvec3 least(HUGE_VAL), most(-HUGE_VAL);
                             for (std::size_t i = begin; i < end; ++i) {
                                 const glm::dvec3 p = footprints.place(items[i]);
                                 least = glm::min(least, p);
                                 most = glm::max(most, p);
                             }
                             const std::lock_guard lock(mutex);
                             low = glm::min(low, least);
                             high = glm::max(high, most);
                         });
    return {low, high};
}

/// All triangles or segments in the order in which they are cut into chunks.
template <typename Item>
std::vector<Entry> sorted(const std::vector<Item>& items, const Footprints& footprints) {
    if (items.empty()) return {};
    const auto [low, high] = bounds(items, footprints);
    const glm::dvec3 reach = high - low, first = low;
    const double side = std::max({reach.x, reach.y, reach.z, 1e-300});
    const double cells = double((1u << kAxisBits) - 1) / side;
    std::vector<Entry> entries(items.size());
    base::parallelRanges(
        std::size_t(0), entries.size(), kPerTask, [&](auto begin, auto end) {
            constexpr std::size_t kAtOnce = 256;
            std::uint32_t cell[3][kAtOnce];
            std::uint64_t places[kAtOnce];
            for (std::size_t from = begin; from < end; from += kAtOnce) {
                const std::size_t count = std::min(kAtOnce, end - from);
                for (std::size_t k = 0; k < count; ++k) {
                    const glm::dvec3 p =
                        (footprints.place(items[from + k]) - first) * cells;
                    for (int axis = 0; axis < 3; ++axis)
                        cell[axis][k] = std::uint32_t(p[axis]);
                }
                hilbertPlaces(cell[0], cell[1], cell[2], count, kAxisBits, places);
                for (std::size_t k = 0; k < count; ++k) {
                    const double size = footprints.size(Box(items[from + k]));
                    entries[from + k] = {sizeClass(size) << (3 * kAxisBits) | places[k],
                                         std::uint32_t(from + k)};
                }
            }
        });
    base::radixSort(entries, 3 * kAxisBits + kClassBits);
    // Ties go by the items themselves: which came first must not matter.
    for (auto same = entries.begin(); same != entries.end();) {
        auto next = same + 1;
        while (next != entries.end() && next->key == same->key)
            ++next;
        std::sort(same, next, [&](const Entry& a, const Entry& b) {
            const int order = std::memcmp(&items[a.item], &items[b.item], sizeof(Item));
            return order != 0 ? order < 0 : a.item < b.item;
        });
        same = next;
    }
    return entries;
}

/// In their order items lie anywhere: has those come that will be asked for soon.
template <typename Item>
void fetch(const std::vector<Item>& items, const std::vector<Entry>& order,
           std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < std::min(end, order.size()); ++i) {
        const auto* const bytes = reinterpret_cast<const char*>(&items[order[i].item]);
        hwy::Prefetch(bytes);
        hwy::Prefetch(bytes + sizeof(Item) - 1);
    }
}

/// Strands of a chunk have their widths in steps of a 255th of its widest: none may be so
/// wide that others are lost beside it.
class Widths {
  public:
    /// Does it go with those before?
    bool include(const Segment& s) {
        const float half = std::max(s.half[0], s.half[1]);
        const float low = std::min(low_, half), high = std::max(high_, half);
        if (high > kMostRatio * low) return false;
        low_ = low, high_ = high;
        return true;
    }
    static bool include(const Triangle&) { return true; }

  private:
    static constexpr float kMostRatio = 16.0f;
    float low_ = HUGE_VALF, high_ = 0.0f;
};

/// Where chunks begin among what was sorted, and behind them its number.
template <typename Item>
std::vector<std::size_t> cut(const std::vector<Item>& items,
                             const std::vector<Entry>& order,
                             const Footprints& footprints) {
    static_assert(NearChunk::kTriangles == NearHairChunk::kSegments);
    std::vector<std::size_t> begins;
    for (std::size_t i = 0; i < order.size();) {
        begins.push_back(i);
        fetch(items, order, i + NearChunk::kTriangles, i + 2 * NearChunk::kTriangles);
        Box box(items[order[i].item]);
        Widths widths;
        widths.include(items[order[i].item]);
        const bool fine = footprints.size(box) <= kFineSize;
        const std::size_t end = std::min(i + NearChunk::kTriangles, order.size());
        while (++i < end) {
            Box both = box;
            both.add(Box(items[order[i].item]));
            if (footprints.size(both) > (fine ? kFineReach : kCoarseReach)) break;
            if (!widths.include(items[order[i].item])) break;
            box = both;
        }
    }
    begins.push_back(order.size());
    return begins;
}

/// The finest grid of powers of two, no finer than `least`, on which 16 bits reach from
/// low to high and a float holds every multiple.
struct Grid {
    double step, perStep;
    std::int32_t first;

    Grid(double low, double high, double least) {
        int exponent = 0;
        (void)std::frexp(least, &exponent);
        for (step = std::ldexp(1.0, exponent - 1);; step *= 2.0) {
            const double most = std::max(std::abs(low), std::abs(high)) / step;
            if (most >= 0x1p24 - 1.0) continue;
            perStep = 1.0 / step;
            first = nearest(low);
            if (nearest(high) - first <= 0xffff) break;
        }
    }
    /// Of what lies between low and high: floor(), without a call.
    [[nodiscard]] std::int32_t nearest(double x) const {
        const double steps = x * perStep + 0.5;
        const auto whole = std::int32_t(steps);
        return whole - int(double(whole) > steps);
    }
};

/// The items of a chunk.
template <typename Item>
struct Run {
    const std::vector<Item>& items;
    const Entry* entries;
    std::size_t count;

    [[nodiscard]] const Item& operator[](std::size_t i) const {
        return items[entries[i].item];
    }
    [[nodiscard]] Box box() const {
        Box all((*this)[0]);
        for (std::size_t i = 1; i < count; ++i)
            all.add(Box((*this)[i]));
        return all;
    }
};

/// A chunk's grid along an axis, which its fields say.
template <typename Chunk>
Grid setGrid(Chunk& chunk, int axis, const Box& box, const Footprints& footprints) {
    const double unit = axis == 2 ? footprints.unit(box) : 1.0;
    const Grid grid(box.low[axis], box.high[axis], unit * kFinestStep);
    chunk.step[axis] = float(grid.step);
    chunk.low[axis] = float(double(grid.first) * grid.step);
    return grid;
}

NearChunk chunkOf(const Run<Triangle>& triangles, const Footprints& footprints) {
    const Box box = triangles.box();
    NearChunk chunk;
    for (int axis = 0; axis < 3; ++axis) {
        const Grid grid = setGrid(chunk, axis, box, footprints);
        for (int c = 0; c < 3; ++c) {
            for (std::size_t i = 0; i < NearChunk::kTriangles; ++i) {
                const Triangle& t = triangles[std::min(i, triangles.count - 1)];
                chunk.corner[c][axis][i] =
                    std::uint16_t(grid.nearest(t.corner[c][axis]) - grid.first);
            }
        }
    }
    return chunk;
}

NearHairChunk chunkOf(const Run<Segment>& segments, const Footprints& footprints) {
    const Box box = segments.box();
    NearHairChunk chunk;
    for (int axis = 0; axis < 3; ++axis) {
        const Grid grid = setGrid(chunk, axis, box, footprints);
        for (int e = 0; e < 2; ++e) {
            for (std::size_t i = 0; i < segments.count; ++i)
                chunk.end[e][axis][i] =
                    std::uint16_t(grid.nearest(segments[i].end[e][axis]) - grid.first);
        }
    }
    float widest = 0.0f;
    for (std::size_t i = 0; i < segments.count; ++i)
        widest = std::max({widest, segments[i].half[0], segments[i].half[1]});
    constexpr float kSteps = 255.0f;
    // Rounded down, so that 255 steps are no more than there may be.
    chunk.halfStep = std::nextafter(widest / kSteps, 0.0f);
    for (std::size_t i = 0; i < segments.count; ++i) {
        const Segment& s = segments[i];
        for (int e = 0; e < 2; ++e) {
            const float steps = chunk.halfStep > 0.0f ? s.half[e] / chunk.halfStep : 0.0f;
            // No strand is too thin to be there.
            const float least = s.half[e] > 0.0f ? 1.0f : 0.0f;
            chunk.half[e][i] = std::uint8_t(std::clamp(steps + 0.5f, least, kSteps));
        }
        chunk.opacity[i] = s.opacity;
    }
    return chunk;
}

/// Calls make(task, i, run, footprints) for the i-th chunk's items, kChunksPerTask of
/// them in each task in their order, tasks in parallel. Before that, begin(chunks).
template <typename Item, typename Begin, typename Make>
void pack(const std::vector<Item>& items, const Projection& projection,
          const Begin& begin, const Make& make) {
    const Footprints footprints(projection);
    const std::vector<Entry> order = sorted(items, footprints);
    const std::vector<std::size_t> begins = cut(items, order, footprints);
    const std::size_t chunks = begins.size() - 1;
    begin(chunks);
    base::parallelFor(std::size_t(0), tasksFor(chunks), [&](std::size_t task) {
        const std::size_t first = task * kChunksPerTask;
        const std::size_t last = std::min(first + kChunksPerTask, chunks);
        for (std::size_t i = first; i < last; ++i) {
            if (i + 1 < chunks) fetch(items, order, begins[i + 1], begins[i + 2]);
            make(task, i,
                 Run<Item>{items, order.data() + begins[i], begins[i + 1] - begins[i]},
                 footprints);
        }
    });
}

/// `places`, if not null: which triangle each place of the chunks holds.
NearField packTriangles(const std::vector<Triangle>& triangles,
                        const Projection& projection,
                        std::vector<std::uint32_t>* places) {
    constexpr std::size_t kPlaces = NearChunk::kTriangles;
    std::vector<NearChunks> tasks;
    pack(
        triangles, projection,
        [&](std::size_t chunks) {
            tasks.resize(tasksFor(chunks));
            if (places) places->resize(kPlaces * chunks);
        },
        [&](std::size_t task, std::size_t i, const Run<Triangle>& run,
            const Footprints& footprints) {
            tasks[task].push_back(chunkOf(run, footprints));
            for (std::size_t k = 0; places && k < kPlaces; ++k)
                (*places)[kPlaces * i + k] = run.entries[std::min(k, run.count - 1)].item;
        });
    NearField field;
    field.chunks.append(tasks.data(), tasks.size());
    return field;
}

}  // namespace

NearPacking packTriangles(const std::vector<NearTriangle>& triangles,
                          const Projection& projection) {
    NearPacking packing;
    packing.field = packTriangles(triangles, projection, &packing.triangle);
    return packing;
}

NearField packNear(const std::vector<NearTriangle>& triangles,
                   const Projection& projection) {
    return packTriangles(triangles, projection, nullptr);
}

NearHair packNear(const std::vector<NearSegment>& segments,
                  const Projection& projection) {
    NearHair hair;
    std::vector<std::vector<NearHairChunks::Row>> more;
    pack(
        segments, projection,
        [&](std::size_t chunks) {
            hair.chunks.resize(chunks);
            more.resize(tasksFor(chunks));
        },
        [&](std::size_t task, std::size_t i, const Run<Segment>& run,
            const Footprints& footprints) {
            hair.chunks.set(i, chunkOf(run, footprints), more[task]);
        });
    std::size_t rows = 0;
    for (const std::vector<NearHairChunks::Row>& part : more)
        rows += part.size();
    hair.chunks.reserveMore(rows);
    for (std::size_t task = 0; task < more.size(); ++task) {
        const std::size_t first = task * kChunksPerTask;
        hair.chunks.addMore(first, std::min(kChunksPerTask, hair.chunks.size() - first),
                            more[task]);
    }
    return hair;
}

}  // namespace mtsm::bake_detail
