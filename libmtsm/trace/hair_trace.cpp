// As the kernel of triangles (near_trace.cpp) goes: the boxes are walked with the box
// around all rays' parts; for each chunk that is left the receivers are found, sixteen at
// a time, whose own pyramid of rays may meet it; for each of those its segments are taken
// whose boxes the pyramid may meet. They wait until sixteen are together: these are seen
// from the receiver at once, and each that its light may shine through is tested against
// its rays, sixteen at once, where those of a row may meet it at all.
//
// The receiver's own strand is told by its segments being joined end to end, because
// they carry no ids. So those that are close to a receiver wait until all of them are
// known: then those on which it lies are found, and what is joined to them.
// These few are met ray by ray, as a ray tracer's curves are.
//
// What a ray meets does not depend on the rays beside it: which segments a receiver looks
// at follows from its own box and slopes, and so does the order in which it meets them.
//
// Fused multiply-adds are not used where hits are decided, for they would make one
// machine's answer another's rounding.
#include "trace/hair_trace.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

// Vectors of a length that is not known in advance cannot be members of a struct.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/hair_trace.cpp"
#include "hwy/cache_control.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "trace/compress-inl.h"
#include "trace/lanes-inl.h"

#ifndef MTSM_TRACE_HAIR_VIEW
#define MTSM_TRACE_HAIR_VIEW
namespace mtsm::trace {

/// What is the same for all receivers of a map, in float.
struct HairView {
    bool perspective;
    float scaleU, scaleV, offsetU, offsetV;
    float footprint;  // w, over w if perspective
    float height, start;
};

}  // namespace mtsm::trace
#endif

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace {
namespace HWY_NAMESPACE {

constexpr int kSegments = NearHairChunk::kSegments;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Of a ray's coordinates, added to its receiver's box.
constexpr float kMargin = 0x1p-19f;
/// A receiver's own place is no slope: strands count from this part of the near field's
/// depth on at least.
constexpr float kLeastRise = 0x1p-12f;

// From a strand's middle line, in half widths: a receiver that is no further lies on it,
// and one that is further does not meet it within a width.
constexpr float kWithin = 1.05f, kClose = 4.0f;
/// So many of the segments that are close to a receiver are met with what they are joined
/// to in mind, a bit each. If there are more, as where hair is dense or its segments are
/// shorter than wide, only those so much closer are.
constexpr int kMostClose = 64;
constexpr float kCloser = 0.7f;
using CloseSet = std::uint64_t;

/// a + t (b - a)
HWY_INLINE Vec between(Vec a, Vec b, Vec t) {
    return hn::Add(a, hn::Mul(t, hn::Sub(b, a)));
}

/// Segments in floats, [segment].
template <int kRoom>
struct Ends {
    alignas(64) float at[2][3][kRoom];  // [end][axis][segment]
    alignas(64) float half[2][kRoom];

    [[nodiscard]] Vec3 load(int end, std::size_t i) const {
        const Floats d;
        return {hn::Load(d, at[end][0] + i), hn::Load(d, at[end][1] + i),
                hn::Load(d, at[end][2] + i)};
    }
};

/// A chunk's.
struct Segments : Ends<kSegments> {
    alignas(64) float opacity[kSegments];  // 65535ths; 0: there is none
    std::uint32_t present = 0;
    float step[3];  // of the grid on which their ends lie

    Segments(const NearHairChunks& chunks, std::size_t index) {
        const NearHairChunks::Packed& chunk = chunks.packed(index);
        const NearHairChunks::Row* const more = chunks.more(chunk);
        const Floats d;
        const Ints whole;
        const hn::Rebind<std::uint8_t, Floats> bytes;
        for (std::size_t i = 0; i < kSegments; i += hn::Lanes(d)) {
            const auto load = [&](const NearHairChunks::Row& row) {
                return hn::PromoteTo(whole, hn::LoadU(bytes, row.data() + i));
            };
            const auto joined = [](auto low, auto high) {
                return hn::ConvertTo(Floats(), hn::Or(low, hn::ShiftLeft<8>(high)));
            };
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto high = load(chunk.high[axis]);
                const auto put = [&](std::size_t end, auto ofEnd) {
                    const Vec steps = joined(load(chunk.end[end][axis]), ofEnd);
                    hn::Store(hn::Add(hn::Set(d, chunk.low[axis]),
                                      hn::Mul(hn::Set(d, chunk.step[axis]), steps)),
                              d, at[end][axis] + i);
                };
                if (chunk.isShort) {
                    put(0, hn::And(high, hn::Set(whole, 15)));
                    put(1, hn::ShiftRight<4>(high));
                } else {
                    put(0, high);
                    put(1, load(more[axis]));
                }
            }
            for (std::size_t end = 0; end < 2; ++end) {
                const Vec steps = hn::ConvertTo(d, load(chunk.half[end]));
                hn::Store(hn::Mul(hn::Set(d, chunk.halfStep), steps), d, half[end] + i);
            }
            Vec share = hn::Set(d, float(chunk.opacity));
            if (!chunk.isOneOpacity) {
                const NearHairChunks::Row* const row = more + chunk.opacityRow();
                share = joined(load(row[0]), load(row[1]));
            }
            hn::Store(share, d, opacity + i);
            present |= bitsOf(hn::Gt(share, hn::Zero(d))) << i;
        }
        std::copy_n(chunk.step, 3, step);
    }
};

/// Segments that wait for a receiver to look at them, from its start.
struct WaitingSegments {
    static constexpr int kRoom = 2 * kSegments;
    int count = 0;
    alignas(64) float at[2][3][kRoom + kLanes];  // [end][axis]
    alignas(64) float half[2][kRoom + kLanes];
    alignas(64) float opacity[kRoom + kLanes];  // 65535ths

    /// Takes the first `n` off.
    void drop(int n) {
        const auto move = [&](float* of) { std::copy(of + n, of + count, of); };
        for (int e = 0; e < 2; ++e) {
            for (int axis = 0; axis < 3; ++axis)
                move(at[e][axis]);
            move(half[e]);
        }
        move(opacity);
        count -= n;
    }
};

/// Segments seen from a receiver: where a slope lies along each, 0 to 1 between its ends,
/// and how far across, in world units over rise.
struct SeenSegments {
    alignas(64) float firstU[kSegments], firstV[kSegments];
    alignas(64) float alongU[kSegments], alongV[kSegments];
    alignas(64) float acrossU[kSegments], acrossV[kSegments];
    alignas(64) float wide[kSegments], widen[kSegments];  // at 0, and how much more at 1
    float depth[kSegments];
};

/// Segments that may be of a receiver's own strand.
struct CloseSegments {
    struct Segment {
        float at[2][3], half[2], opacity;  // as Segments has them
        float step[3];                     ///< of the grid on which its ends lie
    };
    Segment segments[kMostClose];
    int count = 0;
    float halves = kClose;  ///< how close they are

    int left[kMostClose];  ///< the one that ends where this one begins; -1: none
    CloseSet joinedRight;  ///< those that have one where they end

    void load(Ends<kMostClose>& ends) const {
        for (int i = 0; i < count; ++i) {
            for (int e = 0; e < 2; ++e) {
                for (int axis = 0; axis < 3; ++axis)
                    ends.at[e][axis][i] = segments[i].at[e][axis];
                ends.half[e][i] = segments[i].half[e];
            }
        }
    }
    /// Finds what is joined.
    void join() {
        joinedRight = 0;
        for (int i = 0; i < count; ++i) {
            left[i] = -1;
            for (int j = 0; j < count && left[i] < 0; ++j) {
                // Of two that lie back to back neither hides the other.
                if (i == j || !follows(j, i) || (j < i && left[j] == i)) continue;
                left[i] = j;
                joinedRight |= CloseSet(1) << j;
            }
        }
    }
    /// Those of a set and what is joined to it.
    [[nodiscard]] CloseSet strandOf(CloseSet set) const {
        for (CloseSet before = 0; before != set;) {
            before = set;
            for (int i = 0; i < count; ++i) {
                if (left[i] < 0) continue;
                const CloseSet both = CloseSet(1) << i | CloseSet(1) << left[i];
                if (set & both) set |= both;
            }
        }
        return set;
    }

  private:
    /// Does j begin where i ends?
    [[nodiscard]] bool follows(int i, int j) const {
        for (int axis = 0; axis < 3; ++axis) {
            const float most = 0.51f * (segments[i].step[axis] + segments[j].step[axis]);
            if (!(std::abs(segments[i].at[1][axis] - segments[j].at[0][axis]) <= most))
                return false;
        }
        return true;
    }
};

/// One call of traceHair().
class HairWalk {
  public:
    HairWalk(const NearHair& hair, const HairView& view, RayBundle& rays)
        : hair_(hair), view_(view), rays_(rays) {
        for (int receiver = 0; receiver < rays.receivers; ++receiver) {
            if (!(rays.wide >> receiver & 1)) setUp(receiver);
        }
    }

    void run() {
        if (lanesLeft_ && !hair_.levels.empty()) node(hair_.levels.size() - 1, 0);
        for (std::uint32_t rest = lanesLeft_; rest; rest &= rest - 1) {
            const int lane = std::countr_zero(rest);
            if (waiting_[lane].count > 0) look(lane);
            meetClose(lane);
        }
    }
    /// Adds what was met.
    void settle(float darkDepth, std::uint32_t channels, RayDepths& depths);

  private:
    /// Middle lines of close segments in light space, as toLight() has it, from the
    /// receiver.
    struct CloseLines {
        alignas(64) float from[3][kMostClose], along[3][kMostClose];
        /// along . along, along . from, from . from
        alignas(64) float along2[kMostClose], both[kMostClose], from2[kMostClose];
        /// Where it begins, and how much more where it ends.
        alignas(64) float half[kMostClose], widen[kMostClose];
        float depth[kMostClose];
    };

    void setUp(int receiver);
    void node(std::size_t level, std::size_t index);
    static void fetch(const NearHairChunks::Packed& chunk);
    [[nodiscard]] std::uint32_t lanesAt(const NearBoxes& boxes, int i) const;
    [[nodiscard]] bool isAround(const NearBoxes& boxes, int i, int lane) const;
    void chunk(std::size_t index, std::uint32_t lanes, std::uint32_t around);
    [[nodiscard]] std::uint32_t putAside(int lane, const Segments& segments);
    [[nodiscard]] bool makeRoom(int lane);
    template <int kRoom>
    [[nodiscard]] CloseSet within(int lane, const Ends<kRoom>& ends, int count,
                                  float halves) const;
    void meetClose(int lane);
    [[nodiscard]] Vec3 toLight(int lane, const Vec3& way) const;
    [[nodiscard]] Vec3 fromStart(int lane, const Vec3& place) const;
    void findLines(int lane, int count, CloseLines& lines) const;
    [[nodiscard]] std::uint32_t meets(int lane, const CloseSegments& close,
                                      const CloseLines& lines, int i, bool own,
                                      const Vec3& ray) const;
    [[nodiscard]] std::uint32_t candidates(int lane, const Segments& segments) const;
    void wait(int lane, const Segments& segments, std::uint32_t which);
    void look(int lane);
    [[nodiscard]] std::uint32_t see(int lane, SeenSegments& seen) const;
    struct Slope {
        Vec u, v;
    };
    [[nodiscard]] Slope facing(int lane, const Vec (&first)[2], Vec eu, Vec ev) const;
    void across(int lane, Slope ray, const Vec3& way, Vec (&side)[2]) const;
    [[nodiscard]] float depthOf(std::uint16_t opacity);
    /// What the rays of a row have in common, and how far they are from that at most,
    /// slopes.
    struct RowBounds {
        float u, v, reachU, reachV;
    };
    [[nodiscard]] RowBounds boundsOf(int row) const;
    void cross(int lane, const SeenSegments& seen, std::uint32_t found);
    void crossRow(int row, const SeenSegments& seen, std::uint32_t which);

    const NearHair& hair_;
    const HairView& view_;
    RayBundle& rays_;
    float hullLow_[3] = {kInfinity, kInfinity, kInfinity};
    float hullHigh_[3] = {-kInfinity, -kInfinity, -kInfinity};
    /// What the receivers' places may be off by, [axis][receiver].
    alignas(64) float margin_[3][kMostReceivers] = {};
    float least_[kMostReceivers];  // w above the start from which on strands count
    /// Pixels in u and v that a ribbon reaches from its middle line at most, for each
    /// half width.
    float reach_[2][kMostReceivers];
    std::uint32_t lanesLeft_ = 0;
    // Hair is mostly of one opacity, and logarithms take long.
    std::uint16_t lastOpacity_ = 0;
    float lastDepth_ = 0.0f;
    /// [row][lane], of receivers in lanesLeft_.
    alignas(64) float slopeU_[kMostMediaRows][kLanes], slopeV_[kMostMediaRows][kLanes];
    alignas(64) float met_[kMostMediaRows][kLanes];
    RowBounds bounds_[kMostMediaRows];  // of receivers in bounded_
    std::uint32_t bounded_ = 0;
    CloseSegments close_[kMostReceivers];
    Ends<kMostClose> ends_;  // of those of one receiver, while they are looked at
    WaitingSegments waiting_[kMostReceivers];
};

void HairWalk::setUp(int receiver) {
    const Floats d;
    std::uint32_t open = 0;
    for (int group = 0; group < rays_.groups; ++group)
        open |= rays_.open[rays_.row(receiver, group)];
    const float rise = rays_.rise[receiver];
    if (open == 0 || !(rise > 0.0f)) return;
    lanesLeft_ |= 1u << receiver;
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(receiver, group);
        for (std::size_t i = 0; i < kLanes; i += hn::Lanes(d)) {
            const Vec dw = hn::Load(d, rays_.dw[row] + i);
            hn::Store(hn::Div(hn::Load(d, rays_.du[row] + i), dw), d, slopeU_[row] + i);
            hn::Store(hn::Div(hn::Load(d, rays_.dv[row] + i), dw), d, slopeV_[row] + i);
            hn::Store(hn::Zero(d), d, met_[row] + i);
        }
    }
    const float w = rays_.w[receiver];
    const float footprint = view_.footprint * (view_.perspective ? w : 1.0f);
    least_[receiver] = kLeastRise * rise;
    if (!rays_.hasPlanes)
        least_[receiver] = std::max(least_[receiver], view_.start * footprint);
    const float start[3] = {rays_.u[receiver], rays_.v[receiver], w};
    const float lows[3] = {rays_.slopeLowU[receiver], rays_.slopeLowV[receiver], 0.0f};
    const float highs[3] = {rays_.slopeHighU[receiver], rays_.slopeHighV[receiver], 1.0f};
    for (int axis = 0; axis < 3; ++axis) {
        const float margin =
            kMargin * (std::abs(start[axis]) +
                       rise * std::max(std::abs(lows[axis]), std::abs(highs[axis])));
        margin_[axis][receiver] = margin;
        hullLow_[axis] = std::min(
            hullLow_[axis], start[axis] + std::min(0.0f, lows[axis] * rise) - margin);
        hullHigh_[axis] = std::max(
            hullHigh_[axis], start[axis] + std::max(0.0f, highs[axis] * rise) + margin);
    }
    // The unit normal that across() turns level becomes sqrt(1 + x^2) long at most.
    const auto reach = [&](int axis, float scale, float offset) {
        const float per = (view_.perspective ? w : 1.0f) / scale;
        const float aside = view_.perspective ? (start[axis] - offset) / scale : 0.0f;
        const float x = std::max(std::abs(lows[axis] * per - aside),
                                 std::abs(highs[axis] * per - aside));
        return 1.01f * std::abs(scale) * std::sqrt(1.0f + x * x);
    };
    reach_[0][receiver] = reach(0, view_.scaleU, view_.offsetU);
    reach_[1][receiver] = reach(1, view_.scaleV, view_.offsetV);
}

void HairWalk::node(std::size_t level, std::size_t index) {
    const Floats d;
    const NearBoxes& boxes = hair_.levels[level][index];
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < NearBoxes::kChildren; i += hn::Lanes(d)) {
        Mask overlap = hn::Le(hn::LoadU(d, boxes.low[0] + i), hn::Set(d, hullHigh_[0]));
        for (int axis = 0; axis < 3; ++axis) {
            overlap = hn::And(overlap, hn::Le(hn::LoadU(d, boxes.low[axis] + i),
                                              hn::Set(d, hullHigh_[axis])));
            overlap = hn::And(overlap, hn::Ge(hn::LoadU(d, boxes.high[axis] + i),
                                              hn::Set(d, hullLow_[axis])));
        }
        found |= bitsOf(overlap) << i;
    }
    std::uint32_t lanesOf[NearBoxes::kChildren];
    for (std::uint32_t rest = found; rest; rest &= rest - 1) {
        const int i = std::countr_zero(rest);
        lanesOf[i] = lanesAt(boxes, i) & lanesLeft_;
        if (lanesOf[i] == 0)
            found &= ~(1u << i);
        else if (level == 0)
            fetch(hair_.chunks.packed(NearBoxes::kChildren * index + std::size_t(i)));
    }
    for (; found; found &= found - 1) {
        const int i = std::countr_zero(found);
        const std::uint32_t lanes = lanesOf[i];
        const std::size_t child = NearBoxes::kChildren * index + std::size_t(i);
        if (level > 0) {
            node(level - 1, child);
            continue;
        }
        std::uint32_t around = 0;
        for (std::uint32_t rest = rays_.hasPlanes ? 0 : lanes; rest; rest &= rest - 1) {
            if (isAround(boxes, i, std::countr_zero(rest))) around |= rest & -rest;
        }
        chunk(child, lanes, around);
    }
}

/// Asks for a chunk's memory before it is needed.
void HairWalk::fetch(const NearHairChunks::Packed& chunk) {
    constexpr std::size_t kLine = 64;
    const auto* const bytes = reinterpret_cast<const char*>(&chunk);
    for (std::size_t at = 0; at < sizeof(chunk) + kLine - 1; at += kLine)
        hwy::Prefetch(bytes + std::min(at, sizeof(chunk) - 1));
}

/// May a receiver lie on a strand of the box, or within a width of it?
bool HairWalk::isAround(const NearBoxes& boxes, int i, int lane) const {
    const float start[3] = {rays_.u[lane], rays_.v[lane], rays_.w[lane]};
    for (int axis = 0; axis < 3; ++axis) {
        if (!(start[axis] >= boxes.low[axis][i] && start[axis] <= boxes.high[axis][i]))
            return false;
    }
    return true;
}

/// Receivers whose rays may meet something in the box.
std::uint32_t HairWalk::lanesAt(const NearBoxes& boxes, int i) const {
    const Floats d;
    const Vec zero = hn::Zero(d);
    std::uint32_t lanes = 0;
    for (std::size_t k = 0; k < kLanes; k += hn::Lanes(d)) {
        const auto from = [&](const float* start, int axis, bool high) {
            const Vec margin = hn::Load(d, margin_[axis] + k);
            const Vec way =
                hn::Sub(hn::Set(d, high ? boxes.high[axis][i] : boxes.low[axis][i]),
                        hn::Load(d, start + k));
            return high ? hn::Add(way, margin) : hn::Sub(way, margin);
        };
        // The part of its rise that the rays share with the box.
        const Vec first = hn::Max(from(rays_.w, 2, false), zero);
        const Vec last = hn::Min(from(rays_.w, 2, true), hn::Load(d, rays_.rise + k));
        Mask may = hn::Le(first, last);
        const auto meets = [&](int axis, const float* start, const float* low,
                               const float* high) {
            const Vec l = hn::Load(d, low + k), h = hn::Load(d, high + k);
            may = hn::And(may, hn::Le(from(start, axis, false),
                                      hn::Max(hn::Mul(h, first), hn::Mul(h, last))));
            may = hn::And(may, hn::Ge(from(start, axis, true),
                                      hn::Min(hn::Mul(l, first), hn::Mul(l, last))));
        };
        meets(0, rays_.u, rays_.slopeLowU, rays_.slopeHighU);
        meets(1, rays_.v, rays_.slopeLowV, rays_.slopeHighV);
        lanes |= bitsOf(may) << k;
    }
    return lanes;
}

/// `around`: lanes of receivers that may be close to some of it.
void HairWalk::chunk(std::size_t index, std::uint32_t lanes, std::uint32_t around) {
    const Segments segments(hair_.chunks, index);
    for (; lanes; lanes &= lanes - 1) {
        const int lane = std::countr_zero(lanes);
        std::uint32_t found = candidates(lane, segments);
        if (around >> lane & 1) found &= ~putAside(lane, segments);
        if (found) wait(lane, segments, found);
    }
}

/// Segments whose boxes the receiver's pyramid of rays may meet.
std::uint32_t HairWalk::candidates(int lane, const Segments& segments) const {
    const Floats d;
    const Vec least = hn::Set(d, least_[lane]), rise = hn::Set(d, rays_.rise[lane]);
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < kSegments; i += hn::Lanes(d)) {
        const auto from = [&](float start, int axis, Vec& low, Vec& high) {
            const Vec s = hn::Set(d, start);
            const Vec a = hn::Sub(hn::Load(d, segments.at[0][axis] + i), s);
            const Vec b = hn::Sub(hn::Load(d, segments.at[1][axis] + i), s);
            low = hn::Min(a, b), high = hn::Max(a, b);
        };
        Vec low, high;
        from(rays_.w[lane], 2, low, high);
        const Vec first = hn::Max(low, least), last = hn::Min(high, rise);
        Mask may = hn::Le(first, last);
        const Vec half =
            hn::Max(hn::Load(d, segments.half[0] + i), hn::Load(d, segments.half[1] + i));
        const auto meets = [&](int axis, float start, float slopeLow, float slopeHigh) {
            from(start, axis, low, high);
            const Vec l = hn::Set(d, slopeLow), h = hn::Set(d, slopeHigh);
            const Vec reach = hn::Add(hn::Mul(half, hn::Set(d, reach_[axis][lane])),
                                      hn::Set(d, margin_[axis][lane]));
            may = hn::And(may, hn::Le(hn::Sub(low, reach),
                                      hn::Max(hn::Mul(h, first), hn::Mul(h, last))));
            may = hn::And(may, hn::Ge(hn::Add(high, reach),
                                      hn::Min(hn::Mul(l, first), hn::Mul(l, last))));
        };
        meets(0, rays_.u[lane], rays_.slopeLowU[lane], rays_.slopeHighU[lane]);
        meets(1, rays_.v[lane], rays_.slopeLowV[lane], rays_.slopeHighV[lane]);
        found |= bitsOf(may) << i;
    }
    return found & segments.present;
}

/// Puts some segments of a chunk with those that wait, and looks if there are enough.
void HairWalk::wait(int lane, const Segments& segments, std::uint32_t which) {
    const Floats d;
    WaitingSegments& waiting = waiting_[lane];
    const float start[3] = {rays_.u[lane], rays_.v[lane], rays_.w[lane]};
    for (std::size_t i = 0; i < kSegments; i += hn::Lanes(d)) {
        const Mask mask = maskOf(which >> i);
        const auto put = [&](Vec x, float* to) {
            hn::StoreU(compress(d, x, mask), d, to + waiting.count);
        };
        for (int e = 0; e < 2; ++e) {
            for (int axis = 0; axis < 3; ++axis)
                put(hn::Sub(hn::Load(d, segments.at[e][axis] + i),
                            hn::Set(d, start[axis])),
                    waiting.at[e][axis]);
            put(hn::Load(d, segments.half[e] + i), waiting.half[e]);
        }
        put(hn::Load(d, segments.opacity + i), waiting.opacity);
        waiting.count += int(hn::CountTrue(d, mask));
    }
    if (waiting.count >= kSegments) look(lane);
}

/// Has the receiver's rays meet the first of the segments that wait.
void HairWalk::look(int lane) {
    WaitingSegments& waiting = waiting_[lane];
    SeenSegments seen;
    const std::uint32_t found = see(lane, seen);
    if (!(bounded_ >> lane & 1)) {
        bounded_ |= 1u << lane;
        for (int group = 0; group < rays_.groups; ++group)
            bounds_[rays_.row(lane, group)] = boundsOf(rays_.row(lane, group));
    }
    for (std::uint32_t rest = found; rest; rest &= rest - 1) {
        const int i = std::countr_zero(rest);
        seen.depth[i] = depthOf(std::uint16_t(waiting.opacity[i]));
    }
    if (found) cross(lane, seen, found);
    waiting.drop(std::min(waiting.count, kSegments));
}

/// Segments that wait for meetClose(): those close to the receiver, while there is room.
std::uint32_t HairWalk::putAside(int lane, const Segments& segments) {
    CloseSegments& close = close_[lane];
    const auto closeTo = [&] {
        return std::uint32_t(within(lane, segments, kSegments, close.halves));
    };
    std::uint32_t aside = 0;
    for (std::uint32_t rest = closeTo() & segments.present; rest; rest &= rest - 1) {
        if (close.count == kMostClose) {
            if (!makeRoom(lane)) break;
            rest &= closeTo();
            if (rest == 0) break;
        }
        const int i = std::countr_zero(rest);
        CloseSegments::Segment& to = close.segments[close.count++];
        for (int e = 0; e < 2; ++e) {
            for (int axis = 0; axis < 3; ++axis)
                to.at[e][axis] = segments.at[e][axis][i];
            to.half[e] = segments.half[e][i];
        }
        to.opacity = segments.opacity[i];
        std::copy_n(segments.step, 3, to.step);
        aside |= 1u << i;
    }
    return aside;
}

/// Has the farthest of a receiver's close segments wait with all others; false: none is
/// further than a segment that it lies on.
bool HairWalk::makeRoom(int lane) {
    CloseSegments& close = close_[lane];
    WaitingSegments& waiting = waiting_[lane];
    const float start[3] = {rays_.u[lane], rays_.v[lane], rays_.w[lane]};
    while (close.count == kMostClose && close.halves > kWithin) {
        close.halves = std::max(kCloser * close.halves, kWithin);
        close.load(ends_);
        const CloseSet stay = within(lane, ends_, close.count, close.halves);
        int kept = 0;
        for (int i = 0; i < kMostClose; ++i) {
            const CloseSegments::Segment& segment = close.segments[i];
            if (stay >> i & 1) {
                close.segments[kept++] = segment;
                continue;
            }
            for (int e = 0; e < 2; ++e) {
                for (int axis = 0; axis < 3; ++axis)
                    waiting.at[e][axis][waiting.count] =
                        segment.at[e][axis] - start[axis];
                waiting.half[e][waiting.count] = segment.half[e];
            }
            waiting.opacity[waiting.count] = segment.opacity;
            if (++waiting.count >= kSegments) look(lane);
        }
        close.count = kept;
    }
    return close.count < kMostClose;
}

/// The receiver's rays and what is close to it: ribbons that face each ray, with round
/// joints, of which a ray meets one [as Embree's flat linear curves]. Seen from so close,
/// what faces one ray does not face another, and a joint may be all that a ray meets.
void HairWalk::meetClose(int lane) {
    CloseSegments& close = close_[lane];
    if (close.count == 0) return;
    close.join();
    close.load(ends_);
    const CloseSet own = close.strandOf(within(lane, ends_, close.count, kWithin));
    CloseLines lines;
    findLines(lane, close.count, lines);
    for (int i = 0; i < close.count; ++i)
        lines.depth[i] = depthOf(std::uint16_t(close.segments[i].opacity));
    const Floats d;
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(lane, group);
        for (std::size_t k = 0; k < kLanes; k += hn::Lanes(d)) {
            Vec3 ray = toLight(lane, {hn::Load(d, slopeU_[row] + k),
                                      hn::Load(d, slopeV_[row] + k), hn::Set(d, 1.0f)});
            ray = scaled(ray, hn::Div(hn::Set(d, 1.0f), hn::Sqrt(dot(ray, ray))));
            std::uint32_t met[kMostClose], any = 0;
            for (int i = 0; i < close.count; ++i)
                any |= met[i] = meets(lane, close, lines, i, own >> i & 1, ray);
            for (int i = 0; any && i < close.count; ++i) {
                const std::uint32_t before = close.left[i] >= 0 ? met[close.left[i]] : 0;
                const Vec more = hn::IfThenElseZero(maskOf(met[i] & ~before),
                                                    hn::Set(d, lines.depth[i]));
                hn::Store(hn::Add(hn::Load(d, met_[row] + k), more), d, met_[row] + k);
            }
        }
    }
}

/// A way in straight space from a receiver, in light space times w^2 of a perspective
/// view; near the receiver straight space is as good as linear.
HWY_INLINE Vec3 HairWalk::toLight(int lane, const Vec3& way) const {
    const Floats d;
    const float w = view_.perspective ? rays_.w[lane] : 1.0f;
    const auto across = [&](Vec p, float scale, float start, float offset) {
        const Vec x = hn::Mul(p, hn::Set(d, w / scale));
        if (!view_.perspective) return x;
        return hn::Sub(x, hn::Mul(way.z, hn::Set(d, (start - offset) / scale)));
    };
    return {across(way.x, view_.scaleU, rays_.u[lane], view_.offsetU),
            across(way.y, view_.scaleV, rays_.v[lane], view_.offsetV), hn::Neg(way.z)};
}

Vec3 HairWalk::fromStart(int lane, const Vec3& place) const {
    return subtract(place, broadcast({rays_.u[lane], rays_.v[lane], rays_.w[lane]}));
}

/// Of ends_.
void HairWalk::findLines(int lane, int count, CloseLines& lines) const {
    const Floats d;
    const Vec w = hn::Set(d, view_.perspective ? rays_.w[lane] : 1.0f);
    for (std::size_t i = 0; i < std::size_t(count); i += hn::Lanes(d)) {
        const Vec3 first = ends_.load(0, i);
        const Vec3 from = toLight(lane, fromStart(lane, first));
        const Vec3 along = toLight(lane, subtract(ends_.load(1, i), first));
        const Vec half = hn::Mul(hn::Load(d, ends_.half[0] + i), w);
        const auto store = [&](const Vec3& v, float(&to)[3][kMostClose]) {
            hn::Store(v.x, d, to[0] + i), hn::Store(v.y, d, to[1] + i);
            hn::Store(v.z, d, to[2] + i);
        };
        store(from, lines.from), store(along, lines.along);
        hn::Store(dot(along, along), d, lines.along2 + i);
        hn::Store(dot(along, from), d, lines.both + i);
        hn::Store(dot(from, from), d, lines.from2 + i);
        hn::Store(half, d, lines.half + i);
        hn::Store(hn::Sub(hn::Mul(hn::Load(d, ends_.half[1] + i), w), half), d,
                  lines.widen + i);
    }
}

/// Which rays pass line i no further from it than it is wide, where they are nearest to
/// it; if the receiver lies on its strand, from a width on.
HWY_INLINE std::uint32_t HairWalk::meets(int lane, const CloseSegments& close,
                                         const CloseLines& lines, int i, bool own,
                                         const Vec3& ray) const {
    const Floats d;
    const auto set = [d](float x) { return hn::Set(d, x); };
    const auto place = [&](const float(&p)[3][kMostClose]) {
        return broadcast({p[0][i], p[1][i], p[2][i]});
    };
    const Vec along = dot(place(lines.along), ray), from = dot(place(lines.from), ray);
    const Vec along2 = set(lines.along2[i]), both = set(lines.both[i]);
    const Vec zero = hn::Zero(d), one = set(1.0f);
    // Across the ray: |along|^2, and along times the way back to the receiver.
    const Vec length2 = hn::Sub(along2, hn::Mul(along, along));
    const Vec back = hn::Sub(hn::Mul(along, from), both);
    const Vec at = hn::Div(back, length2);
    const Vec t = hn::Max(zero, hn::Min(at, one));
    const Vec half = hn::Add(set(lines.half[i]), hn::Mul(t, set(lines.widen[i])));
    // |from + t along|^2, and along the ray.
    const Vec twice = hn::Add(hn::Add(both, both), hn::Mul(t, along2));
    const Vec distance2 = hn::Add(set(lines.from2[i]), hn::Mul(t, twice));
    const Vec way = hn::Add(from, hn::Mul(t, along));
    const Vec off2 = hn::Sub(distance2, hn::Mul(way, way));
    const Vec rise = hn::Mul(hn::Neg(ray.z), way);
    Mask hit = hn::Le(off2, hn::Mul(half, half));
    hit = hn::And(hit, hn::Gt(way, own ? hn::Add(half, half) : zero));
    hit = hn::And(hit, hn::Gt(rise, set(least_[lane])));
    hit = hn::And(hit, hn::Le(rise, set(rays_.rise[lane])));
    if (close.left[i] < 0) hit = hn::And(hit, hn::Gt(at, zero));
    if (!(close.joinedRight >> i & 1)) hit = hn::And(hit, hn::Lt(at, one));
    return bitsOf(hit);
}

/// Those of `count` segments from whose middle lines the receiver is no further than so
/// many half widths.
template <int kRoom>
HWY_INLINE CloseSet HairWalk::within(int lane, const Ends<kRoom>& ends, int count,
                                     float halves) const {
    const Floats d;
    const float w = view_.perspective ? rays_.w[lane] : 1.0f;
    CloseSet found = 0;
    for (std::size_t i = 0; i < std::size_t(count); i += hn::Lanes(d)) {
        const Vec3 first = ends.load(0, i);
        const Vec3 from = toLight(lane, fromStart(lane, first));
        const Vec3 way = toLight(lane, subtract(ends.load(1, i), first));
        const Vec t =
            hn::Min(hn::Max(hn::Neg(hn::Div(dot(from, way), dot(way, way))), hn::Zero(d)),
                    hn::Set(d, 1.0f));
        const Vec3 off = add(from, scaled(way, t));
        const Vec half =
            between(hn::Load(d, ends.half[0] + i), hn::Load(d, ends.half[1] + i), t);
        const Vec reach = hn::Mul(half, hn::Set(d, halves * w));
        found |= CloseSet(bitsOf(hn::Le(dot(off, off), hn::Mul(reach, reach)))) << i;
    }
    return found & (~CloseSet(0) >> (64 - count));
}

/// Which of the first segments that wait the receiver's rays may meet.
std::uint32_t HairWalk::see(int lane, SeenSegments& seen) const {
    const Floats d;
    const WaitingSegments& segments = waiting_[lane];
    const int count = std::min(segments.count, kSegments);
    const Vec zero = hn::Zero(d), one = hn::Set(d, 1.0f);
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < kSegments; i += hn::Lanes(d)) {
        Vec a[3], b[3];
        for (int axis = 0; axis < 3; ++axis) {
            a[axis] = hn::Load(d, segments.at[0][axis] + i);
            b[axis] = hn::Load(d, segments.at[1][axis] + i);
        }
        // The part between t0 and t1 counts.
        Vec t0 = zero, t1 = one;
        const auto keep = [&](Vec insideA, Vec insideB) {
            const Vec change = hn::Sub(insideB, insideA);
            const Vec t = hn::Neg(hn::Div(insideA, change));
            t0 = hn::IfThenElse(hn::Gt(change, zero), hn::Max(t0, t), t0);
            t1 = hn::IfThenElse(hn::Lt(change, zero), hn::Min(t1, t), t1);
            const Mask never = hn::And(hn::Eq(change, zero), hn::Lt(insideA, zero));
            t1 = hn::IfThenElse(never, hn::Neg(one), t1);
        };
        const Vec least = hn::Set(d, least_[lane]), rise = hn::Set(d, rays_.rise[lane]);
        keep(hn::Sub(a[2], least), hn::Sub(b[2], least));
        keep(hn::Sub(rise, a[2]), hn::Sub(rise, b[2]));
        if (rays_.hasPlanes) {
            const Vec n[3] = {hn::Set(d, rays_.planeU[lane]),
                              hn::Set(d, rays_.planeV[lane]),
                              hn::Set(d, rays_.planeW[lane])};
            const auto above = [&](const Vec(&p)[3]) {
                const Vec height =
                    hn::Add(hn::Add(hn::Mul(n[0], p[0]), hn::Mul(n[1], p[1])),
                            hn::Mul(n[2], p[2]));
                return hn::Sub(height, hn::Set(d, view_.height));
            };
            keep(above(a), above(b));
        }
        Mask may = hn::Lt(t0, t1);
        if (hn::AllFalse(d, may)) continue;

        Vec slope[2][2], half[2];  // [end][u, v]
        for (int e = 0; e < 2; ++e) {
            const Vec t = e == 0 ? t0 : t1;
            const Vec perRise = hn::Div(one, hn::Max(least, between(a[2], b[2], t)));
            slope[e][0] = hn::Mul(between(a[0], b[0], t), perRise);
            slope[e][1] = hn::Mul(between(a[1], b[1], t), perRise);
            half[e] = hn::Mul(between(hn::Load(d, segments.half[0] + i),
                                      hn::Load(d, segments.half[1] + i), t),
                              perRise);
        }
        const Vec eu = hn::Sub(slope[1][0], slope[0][0]);
        const Vec ev = hn::Sub(slope[1][1], slope[0][1]);
        Vec side[2];
        across(lane, facing(lane, slope[0], eu, ev),
               {hn::Sub(b[0], a[0]), hn::Sub(b[1], a[1]), hn::Sub(b[2], a[2])}, side);
        const Vec per = hn::Div(one, hn::Sub(hn::Mul(eu, side[1]), hn::Mul(ev, side[0])));
        const Vec widest = hn::Max(half[0], half[1]);
        const auto meets = [&](const float* low, const float* high, int axis) {
            const Vec reach = hn::Mul(widest, hn::Abs(side[axis]));
            const Vec first = slope[0][axis], last = slope[1][axis];
            may = hn::And(may, hn::Le(hn::Sub(hn::Min(first, last), reach),
                                      hn::Set(d, high[lane])));
            may = hn::And(
                may, hn::Ge(hn::Add(hn::Max(first, last), reach), hn::Set(d, low[lane])));
        };
        meets(rays_.slopeLowU, rays_.slopeHighU, 0);
        meets(rays_.slopeLowV, rays_.slopeHighV, 1);
        found |= bitsOf(may) << i;
        hn::Store(slope[0][0], d, seen.firstU + i);
        hn::Store(slope[0][1], d, seen.firstV + i);
        hn::Store(hn::Mul(side[1], per), d, seen.alongU + i);
        hn::Store(hn::Neg(hn::Mul(side[0], per)), d, seen.alongV + i);
        hn::Store(hn::Neg(hn::Mul(ev, per)), d, seen.acrossU + i);
        hn::Store(hn::Mul(eu, per), d, seen.acrossV + i);
        hn::Store(half[0], d, seen.wide + i);
        hn::Store(hn::Sub(half[1], half[0]), d, seen.widen + i);
    }
    return found & ((1u << count) - 1);
}

/// The slope of the ray that a ribbon faces: of those that the receiver has, the one
/// nearest to where the middle line comes closest to the middle of its rays.
HairWalk::Slope HairWalk::facing(int lane, const Vec (&first)[2], Vec eu, Vec ev) const {
    const Floats d;
    const float lowU = rays_.slopeLowU[lane], highU = rays_.slopeHighU[lane];
    const float lowV = rays_.slopeLowV[lane], highV = rays_.slopeHighV[lane];
    const Vec u = hn::Sub(hn::Set(d, 0.5f * (lowU + highU)), first[0]);
    const Vec v = hn::Sub(hn::Set(d, 0.5f * (lowV + highV)), first[1]);
    const Vec size = hn::Add(hn::Mul(eu, eu), hn::Mul(ev, ev));
    const Vec at = hn::Div(hn::Add(hn::Mul(u, eu), hn::Mul(v, ev)), size);
    const Vec t = hn::Max(hn::Zero(d), hn::Min(at, hn::Set(d, 1.0f)));
    const auto clamp = [&](Vec x, float low, float high) {
        return hn::Max(hn::Set(d, low), hn::Min(x, hn::Set(d, high)));
    };
    return {clamp(hn::Add(first[0], hn::Mul(t, eu)), lowU, highU),
            clamp(hn::Add(first[1], hn::Mul(t, ev)), lowV, highV)};
}

/// Which way a ribbon along `way` that faces a ray reaches from its middle line, in
/// slopes times rise: the unit normal of both in light space, moved along the ray to
/// where it is level.
void HairWalk::across(int lane, Slope ray, const Vec3& way, Vec (&side)[2]) const {
    const Floats d;
    const Vec3 r = toLight(lane, {ray.u, ray.v, hn::Set(d, 1.0f)});
    const Vec3 n = HWY_NAMESPACE::cross(r, toLight(lane, way));
    const Vec per = hn::Div(hn::Set(d, 1.0f), hn::Sqrt(dot(n, n)));
    // r.z is -1: what n rises, the ray takes back.
    const auto level = [&](Vec along, Vec back, float scale) {
        const Vec flat = hn::Add(along, hn::Mul(n.z, back));
        return hn::Mul(hn::Mul(flat, per), hn::Set(d, scale));
    };
    side[0] = level(n.x, r.x, view_.scaleU);
    side[1] = level(n.y, r.y, view_.scaleV);
}

float HairWalk::depthOf(std::uint16_t opacity) {
    if (opacity != lastOpacity_) {
        const double share = double(opacity) / double(NearHairChunk::kOpaque);
        lastOpacity_ = opacity;
        lastDepth_ = share < 1.0 ? float(-std::log1p(-share)) : kDarkDepth;
    }
    return lastDepth_;
}

HairWalk::RowBounds HairWalk::boundsOf(int row) const {
    const Floats d;
    const auto bounds = [&](const float* slopes, float& middle, float& reach) {
        Vec low = hn::Set(d, kInfinity), high = hn::Set(d, -kInfinity);
        for (std::size_t k = 0; k < kLanes; k += hn::Lanes(d)) {
            const Mask open = maskOf(std::uint32_t(rays_.open[row]) >> k);
            const Vec x = hn::Load(d, slopes + k);
            low = hn::Min(low, hn::IfThenElse(open, x, low));
            high = hn::Max(high, hn::IfThenElse(open, x, high));
        }
        const float least = hn::GetLane(hn::MinOfLanes(d, low));
        const float most = hn::GetLane(hn::MaxOfLanes(d, high));
        middle = 0.5f * (least + most);
        reach = (1.0f + 0x1p-16f) * std::max(most - middle, middle - least);
    };
    RowBounds of;
    bounds(slopeU_[row], of.u, of.reachU);
    bounds(slopeV_[row], of.v, of.reachV);
    return of;
}

/// Has the rays of the rows of a receiver meet segments of `found`.
void HairWalk::cross(int lane, const SeenSegments& seen, std::uint32_t found) {
    const Floats d;
    std::uint32_t which[kMostMediaRows] = {};
    for (std::size_t i = 0; i < kSegments; i += hn::Lanes(d)) {
        // More rows rather than what rounding may hide.
        const Vec rounding = hn::Set(d, 0x1p-16f), one = hn::Set(d, 1.0f + 0x1p-16f);
        const auto load = [&](const float* of) { return hn::Load(d, of + i); };
        const Vec firstU = load(seen.firstU), firstV = load(seen.firstV);
        const Vec alongU = load(seen.alongU), alongV = load(seen.alongV);
        const Vec acrossU = load(seen.acrossU), acrossV = load(seen.acrossV);
        const Vec wide = load(seen.wide);
        const Vec widest = hn::Max(wide, hn::Add(wide, load(seen.widen)));
        for (int group = 0; group < rays_.groups; ++group) {
            const RowBounds& row = bounds_[rays_.row(lane, group)];
            const Vec u = hn::Sub(hn::Set(d, row.u), firstU);
            const Vec v = hn::Sub(hn::Set(d, row.v), firstV);
            const Vec reachU = hn::MulAdd(hn::Abs(u), rounding, hn::Set(d, row.reachU));
            const Vec reachV = hn::MulAdd(hn::Abs(v), rounding, hn::Set(d, row.reachV));
            // Of the row's middle, and how far its rays are from that.
            const Vec along = hn::MulAdd(u, alongU, hn::Mul(v, alongV));
            const Vec across = hn::MulAdd(u, acrossU, hn::Mul(v, acrossV));
            const Vec alongReach =
                hn::MulAdd(reachU, hn::Abs(alongU), hn::Mul(reachV, hn::Abs(alongV)));
            const Vec acrossReach = hn::MulAdd(
                reachU, hn::Abs(acrossU), hn::MulAdd(reachV, hn::Abs(acrossV), widest));
            // Not told apart: what is not a number.
            Mask off = hn::Gt(hn::Abs(across), acrossReach);
            off = hn::Or(off, hn::Lt(hn::Add(along, alongReach), hn::Neg(rounding)));
            off = hn::Or(off, hn::Gt(hn::Sub(along, alongReach), one));
            which[group] |= (~bitsOf(off) & ((1u << hn::Lanes(d)) - 1)) << i;
        }
    }
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(lane, group);
        if (rays_.open[row] != 0 && (which[group] & found))
            crossRow(row, seen, which[group] & found);
    }
}

/// Adds the depths of some segments to the rays of a row that pass through them.
void HairWalk::crossRow(int row, const SeenSegments& seen, std::uint32_t which) {
    const Floats d;
    const Vec one = hn::Set(d, 1.0f), zero = hn::Zero(d);
    for (std::size_t k = 0; k < kLanes; k += hn::Lanes(d)) {
        const Vec slopeU = hn::Load(d, slopeU_[row] + k);
        const Vec slopeV = hn::Load(d, slopeV_[row] + k);
        Vec met = hn::Load(d, met_[row] + k);
        for (std::uint32_t rest = which; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            const auto of = [&](const float* x) { return hn::Set(d, x[i]); };
            const Vec u = hn::Sub(slopeU, of(seen.firstU));
            const Vec v = hn::Sub(slopeV, of(seen.firstV));
            const Vec t =
                hn::Add(hn::Mul(u, of(seen.alongU)), hn::Mul(v, of(seen.alongV)));
            const Vec off =
                hn::Add(hn::Mul(u, of(seen.acrossU)), hn::Mul(v, of(seen.acrossV)));
            const Vec wide = hn::Add(of(seen.wide), hn::Mul(t, of(seen.widen)));
            const Mask inside = hn::Le(hn::Abs(off), wide);
            const Mask hit = hn::And(inside, hn::And(hn::Ge(t, zero), hn::Le(t, one)));
            met = hn::Add(met, hn::IfThenElseZero(hit, of(seen.depth)));
        }
        hn::Store(met, d, met_[row] + k);
    }
}

void HairWalk::settle(float darkDepth, std::uint32_t channels, RayDepths& depths) {
    const Floats d;
    for (std::uint32_t rest = lanesLeft_; rest; rest &= rest - 1) {
        for (int group = 0; group < rays_.groups; ++group) {
            const int row = rays_.row(std::countr_zero(rest), group);
            std::uint32_t left = 0;
            for (std::size_t i = 0; i < kLanes; i += hn::Lanes(d)) {
                const Mask open = maskOf(std::uint32_t(rays_.open[row]) >> i);
                const Vec met = hn::IfThenElseZero(open, hn::Load(d, met_[row] + i));
                for (std::uint32_t c = 0; c < channels; ++c) {
                    float* const depth = depths.depth[c][row] + i;
                    const Vec sum = hn::Add(hn::Load(d, depth), met);
                    hn::Store(sum, d, depth);
                    left |= bitsOf(hn::Lt(sum, hn::Set(d, darkDepth))) << i;
                }
            }
            rays_.open[row] = std::uint16_t(rays_.open[row] & left);
        }
    }
}

void traceHairAt(const NearHair& hair, const HairView& view, float darkDepth,
                 std::uint32_t channels, RayBundle& rays, RayDepths& depths) {
    HairWalk walk(hair, view, rays);
    walk.run();
    walk.settle(darkDepth, channels, depths);
}

}  // namespace HWY_NAMESPACE
}  // namespace mtsm::trace
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(traceHairAt);

void traceHair(const NearHair& hair, const Projection& projection,
               const HairTraceOptions& options, std::uint32_t channels, RayBundle& rays,
               RayDepths& depths) noexcept {
    const HairView view{projection.kind == ProjectionKind::perspective,
                        float(projection.scale.x),
                        float(projection.scale.y),
                        float(projection.offset.x),
                        float(projection.offset.y),
                        float(projection.pixelFootprint(1.0)),
                        options.height,
                        options.start};
    HWY_DYNAMIC_DISPATCH(traceHairAt)
    (hair, view, options.darkDepth, channels, rays, depths);
}

}  // namespace mtsm::trace
#endif
