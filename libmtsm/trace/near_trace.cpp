// The boxes of the near field are walked with the box around all rays' parts; for each
// chunk that is left, the receivers whose own rays may meet it are found, sixteen at a
// time; for each of those the chunk's triangles that its rays may meet and that rise
// above its tangent plane; and each triangle that is left is tested against sixteen rays
// at once. Close to receivers that is far less than testing all rays together: most of a
// chunk's triangles are the receivers' own surface.
//
// What a ray meets must not depend on the rays beside it. So a ray that is found to cross
// a triangle is closed only if its own part's box overlaps the triangle's: the boxes
// around several rays contain those of each, and pass nothing over that any of them could
// meet. Where rounding decides, it decides for the ray alone. Boxes are a little larger
// than the rays' parts, so that no true crossing is lost.
//
// Fused multiply-adds are not used where crossings are decided, for they would make one
// machine's answer another's rounding.
#include "trace/near_trace.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

// Vectors of a length that is not known in advance cannot be members of a struct.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/near_trace.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "trace/lanes-inl.h"
#include "trace/triangles-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace {
namespace HWY_NAMESPACE {

constexpr std::uint32_t kAll = (1u << hn::MaxLanes(Floats())) - 1;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Of a ray's coordinates, added to its boxes; their rounding is an eighth of it.
constexpr float kMargin = 0x1p-20f;
/// Of the sum of a volume's terms without their signs; their rounding is half of it.
constexpr float kRounding = 0x1p-20f;

/// What cross(a, b) is summed up from, without signs.
HWY_INLINE Vec3 crossTerms(const Vec3& a, const Vec3& b) {
    const auto terms = [](Vec p, Vec q, Vec r, Vec s) {
        return hn::Add(hn::Mul(p, q), hn::Mul(r, s));
    };
    return {terms(a.y, b.z, a.z, b.y), terms(a.z, b.x, a.x, b.z),
            terms(a.x, b.y, a.y, b.x)};
}

HWY_INLINE Vec3 abs(const Vec3& a) {
    return {hn::Abs(a.x), hn::Abs(a.y), hn::Abs(a.z)};
}

HWY_INLINE Vec3 max(const Vec3& a, const Vec3& b) {
    return {hn::Max(a.x, b.x), hn::Max(a.y, b.y), hn::Max(a.z, b.z)};
}

struct Box {
    float low[3] = {kInfinity, kInfinity, kInfinity};
    float high[3] = {-kInfinity, -kInfinity, -kInfinity};

    void include(const Box& b) {
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], b.low[axis]);
            high[axis] = std::max(high[axis], b.high[axis]);
        }
    }
};

Box boxAround(const Triangles& triangles, int t) {
    Box b;
    for (int axis = 0; axis < 3; ++axis) {
        b.low[axis] = triangles.low[axis][t];
        b.high[axis] = triangles.high[axis][t];
    }
    return b;
}

/// Which of the children overlap the box.
std::uint32_t overlapping(const NearBoxes& boxes, const Box& box) {
    const Floats d;
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < NearBoxes::kChildren; i += hn::Lanes(d)) {
        Mask overlap = hn::Le(hn::LoadU(d, boxes.low[0] + i), hn::Set(d, box.high[0]));
        for (int axis = 0; axis < 3; ++axis) {
            overlap = hn::And(overlap, hn::Le(hn::LoadU(d, boxes.low[axis] + i),
                                              hn::Set(d, box.high[axis])));
            overlap = hn::And(overlap, hn::Ge(hn::LoadU(d, boxes.high[axis] + i),
                                              hn::Set(d, box.low[axis])));
        }
        found |= bitsOf(overlap) << i;
    }
    return found;
}

/// Rays that go sideways between two slopes while they rise by `least` to `most`: may
/// they come between two sides, which are so far away from where they start?
HWY_INLINE Mask comesBetween(Vec side0, Vec side1, Vec slopeLow, Vec slopeHigh, Vec least,
                             Vec most) {
    const Vec low = hn::Min(hn::Mul(slopeLow, least), hn::Mul(slopeLow, most));
    const Vec high = hn::Max(hn::Mul(slopeHigh, least), hn::Mul(slopeHigh, most));
    return hn::And(hn::Le(low, side1), hn::Ge(high, side0));
}

/// Seen from a receiver: the planes through the edges of 16 triangles, and how far away
/// their planes are.
struct SeenTriangles {
    alignas(64) float side[3][3][kTriangles];  // [edge][axis][triangle]
    alignas(64) float terms[3][kTriangles];
    alignas(64) float normal[3][kTriangles];
    alignas(64) float distance[kTriangles];

    SeenTriangles(const Triangles& triangles, const float (&start)[3]) {
        const Floats d;
        for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
            const auto load = [&](const Triangles::Axes& p) {
                return Triangles::load(d, p, t);
            };
            const Vec3 origin = broadcast(start);
            Vec3 corners[3], edges[3];
            for (int c = 0; c < 3; ++c)
                corners[c] = load(triangles.corner[c]);
            for (int c = 0; c < 3; ++c)
                edges[c] = subtract(corners[(c + 1) % 3], corners[c]);
            Vec3 furthest = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
            for (int c = 0; c < 3; ++c) {
                // An edge from A to B spans (A + B) x (B - A) with the start: twice A x
                // B, but without its cancellation.
                const Vec3 middle = add(subtract(corners[c], origin),
                                        subtract(corners[(c + 1) % 3], origin));
                store(cross(middle, edges[c]), side[c], t);
                furthest = max(furthest, abs(middle));
            }
            const Vec3 longest = subtract(load(triangles.high), load(triangles.low));
            store(crossTerms(furthest, longest), terms, t);
            const Vec3 n = cross(edges[0], edges[1]);
            store(n, normal, t);
            hn::Store(dot(n, subtract(corners[0], origin)), d, distance + t);
        }
    }

  private:
    static void store(const Vec3& v, float (&to)[3][kTriangles], std::size_t t) {
        const Floats d;
        hn::Store(v.x, d, to[0] + t), hn::Store(v.y, d, to[1] + t);
        hn::Store(v.z, d, to[2] + t);
    }
};

/// One call of traceNear().
class Walk {
  public:
    Walk(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
         float height)
        : field_(field), rays_(rays), end_(end), height_(height) {
        std::uint32_t any = 0;
        for (int receiver = 0; receiver < rays.receivers; ++receiver) {
            const std::uint32_t open = openOf(receiver);
            lanesLeft_ |= std::uint16_t(std::uint32_t(open != 0) << receiver);
            any |= open;
        }
        hasFew_ = rays.groups == 1 && any >> kFew == 0;
        for (int k = 0; k < kMostReceivers; k += int(hn::MaxLanes(Floats())))
            bound(k);
        for (std::uint32_t rest = lanesLeft_ & rays.wide; rest; rest &= rest - 1)
            boundWide(std::countr_zero(rest));
    }

    void run() {
        if (lanesLeft_ && !field_.levels.empty()) node(field_.levels.size() - 1, 0);
    }

  private:
    void startOf(int receiver, float (&start)[3]) const {
        start[0] = rays_.u[receiver], start[1] = rays_.v[receiver];
        start[2] = rays_.w[receiver];
    }

    void bound(int k);
    void boundWide(int receiver);
    [[nodiscard]] std::uint32_t openOf(int receiver) const;
    [[nodiscard]] Box boxOf(int receiver, int row, int lane) const;
    [[nodiscard]] Mask overlaps(int receiver, int row, int k, const Box& box) const;
    void node(std::size_t level, std::size_t index);
    void findLanes(const NearBoxes& boxes, std::uint32_t children, int k,
                   std::uint32_t* lanes) const;
    void chunk(std::size_t index, std::uint32_t lanes);
    [[nodiscard]] std::uint32_t trianglesForAny(const Triangles& triangles) const;
    [[nodiscard]] std::uint32_t lanesFor(const Triangles& triangles, int t,
                                         std::uint32_t lanes) const;
    void crossSeen(int lane, const Triangles& triangles, std::uint32_t found);
    void packRays();
    void crossPacked(const Triangles& triangles, int t, std::uint32_t lanes);
    [[nodiscard]] HWY_INLINE std::uint32_t trianglesFor(int lane,
                                                        const Triangles& triangles) const;
    [[nodiscard]] Mask inBox(int lane, const Triangles& triangles, std::size_t t) const;
    [[nodiscard]] HWY_INLINE Mask inCone(int lane, const Triangles& triangles,
                                         std::size_t t) const;
    [[nodiscard]] HWY_INLINE Mask risesAbove(int lane, const Triangles& triangles,
                                             std::size_t t) const;
    void cross(int lane, const SeenTriangles& seen, int t, const Box& box);
    void crossEach(int lane, const SeenTriangles& seen, const Triangles& triangles,
                   std::uint32_t found);

    const NearField& field_;
    RayBundle& rays_;
    const float (*const end_)[kLanes];
    float height_;
    Box hull_;
    /// Boxes around the open rays' parts, [axis][receiver]; of receivers without any
    /// empty.
    alignas(64) float low_[3][kMostReceivers], high_[3][kMostReceivers];
    /// [axis][receiver]: what places on its rays are rounded by, at most.
    alignas(64) float margin_[3][kMostReceivers];
    /// [receiver]: as far as its rays come in w, margin included.
    alignas(64) float reach_[kMostReceivers];
    std::uint16_t lanesLeft_ = 0;  ///< receivers with a ray that is open
    /// Around all receivers whose rays have bounds: where they start, margins included
    /// ([axis]), their slopes, and how far they come.
    float startLow_[3] = {kInfinity, kInfinity, kInfinity};
    float startHigh_[3] = {-kInfinity, -kInfinity, -kInfinity};
    float slopeLow_[2] = {kInfinity, kInfinity}, slopeHigh_[2] = {-kInfinity, -kInfinity};
    float furthest_ = 0.0f;

    /// Ray number j of each receiver, where receivers have few: [axis][j][receiver].
    static constexpr int kFew = 4;
    bool hasFew_ = false;
    int each_ = 0;  ///< rays of a receiver; 0: not packed
    alignas(64) float way_[3][kFew][kMostReceivers];
    alignas(64) float begin_[kFew][kMostReceivers], endOf_[kFew][kMostReceivers];
    std::uint16_t packedOpen_[kFew];  ///< one bit a receiver
};

/// Lanes of its rows that are.
std::uint32_t Walk::openOf(int receiver) const {
    std::uint32_t open = 0;
    for (int group = 0; group < rays_.groups; ++group)
        open |= rays_.open[rays_.row(receiver, group)];
    return open;
}

/// Where rays go that start between two corners, go sideways between two slopes, and come
/// as far as `rise` in w.
Box boxAround(const float (&startLow)[3], const float (&startHigh)[3],
              const float (&lows)[3], const float (&highs)[3], float rise) {
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const float way = std::max(std::abs(lows[axis]), std::abs(highs[axis])) * rise;
        const float away = std::max(std::abs(startLow[axis]), std::abs(startHigh[axis]));
        const float margin = (away + way) * 2.0f * kMargin;
        box.low[axis] = startLow[axis] + std::min(0.0f, lows[axis] * rise) - margin;
        box.high[axis] = startHigh[axis] + std::max(0.0f, highs[axis] * rise) + margin;
    }
    return box;
}

/// Of as many receivers as a vector holds, from number k on: boxes that contain boxOf()
/// of all their rays, as boxAround() makes them. Those of wide ones are not told here.
void Walk::bound(int k) {
    const Floats d;
    const auto load = [&](const float* p) { return hn::Load(d, p + k); };
    const Mask open = maskOf(std::uint32_t(lanesLeft_ & ~rays_.wide) >> k);
    const Vec zero = hn::Zero(d), rise = load(rays_.rise);
    const Vec never = hn::Set(d, kInfinity);
    const auto least = [&](float& low, Vec x) {
        x = hn::IfThenElse(open, x, never);
        low = std::min(low, hn::GetLane(hn::MinOfLanes(d, x)));
    };
    const auto most = [&](float& high, Vec x) {
        x = hn::IfThenElse(open, x, hn::Neg(never));
        high = std::max(high, hn::GetLane(hn::MaxOfLanes(d, x)));
    };
    const Vec starts[3] = {load(rays_.u), load(rays_.v), load(rays_.w)};
    const Vec lows[3] = {load(rays_.slopeLowU), load(rays_.slopeLowV), zero};
    const Vec highs[3] = {load(rays_.slopeHighU), load(rays_.slopeHighV),
                          hn::Set(d, 1.0f)};
    for (int axis = 0; axis < 3; ++axis) {
        const Vec start = starts[axis], low = lows[axis], high = highs[axis];
        const Vec way = hn::Mul(hn::Max(hn::Abs(low), hn::Abs(high)), rise);
        const Vec margin =
            hn::Mul(hn::Add(hn::Abs(start), way), hn::Set(d, 2.0f * kMargin));
        const Vec from =
            hn::Sub(hn::Add(start, hn::Min(zero, hn::Mul(low, rise))), margin);
        const Vec to =
            hn::Add(hn::Add(start, hn::Max(zero, hn::Mul(high, rise))), margin);
        hn::Store(hn::IfThenElse(open, from, never), d, low_[axis] + k);
        hn::Store(hn::IfThenElse(open, to, hn::Neg(never)), d, high_[axis] + k);
        hn::Store(hn::IfThenElseZero(open, margin), d, margin_[axis] + k);
        least(hull_.low[axis], from), most(hull_.high[axis], to);
        least(startLow_[axis], hn::Sub(start, margin));
        most(startHigh_[axis], hn::Add(start, margin));
        if (axis < 2) {
            least(slopeLow_[axis], low), most(slopeHigh_[axis], high);
        } else {
            const Vec reach = hn::Add(rise, margin);
            hn::Store(hn::IfThenElseZero(open, reach), d, reach_ + k);
            most(furthest_, reach);
        }
    }
}

/// The same of one whose rays have no bounds.
void Walk::boundWide(int receiver) {
    Box box;
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(receiver, group);
        for (std::uint32_t open = rays_.open[row]; open; open &= open - 1)
            box.include(boxOf(receiver, row, std::countr_zero(open)));
    }
    for (int axis = 0; axis < 3; ++axis) {
        low_[axis][receiver] = box.low[axis];
        high_[axis][receiver] = box.high[axis];
    }
    hull_.include(box);
}

Box Walk::boxOf(int receiver, int row, int lane) const {
    float start[3];
    startOf(receiver, start);
    const float ways[3] = {rays_.du[row][lane], rays_.dv[row][lane], rays_.dw[row][lane]};
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const float way = ways[axis];
        const float reach = std::abs(way) * end_[row][lane];
        const float margin = (std::abs(start[axis]) + reach) * kMargin;
        const float from = start[axis] + rays_.begin[row][lane] * way;
        const float to = start[axis] + end_[row][lane] * way;
        box.low[axis] = std::min(from, to) - margin;
        box.high[axis] = std::max(from, to) + margin;
    }
    return box;
}

void Walk::node(std::size_t level, std::size_t index) {
    const NearBoxes& boxes = field_.levels[level][index];
    std::uint32_t found = overlapping(boxes, hull_);
    const std::size_t first = NearBoxes::kChildren * index;
    if (level > 0) {
        for (; found && lanesLeft_; found &= found - 1)
            node(level - 1, first + std::size_t(std::countr_zero(found)));
        return;
    }
    std::uint32_t lanes[NearBoxes::kChildren] = {};
    for (int k = 0; k < kLanes; k += int(hn::Lanes(Floats())))
        findLanes(boxes, found, k, lanes);
    for (; found && lanesLeft_; found &= found - 1) {
        const int i = std::countr_zero(found);
        if (lanes[i] & lanesLeft_) chunk(first + std::size_t(i), lanes[i] & lanesLeft_);
    }
}

/// Of as many receivers as a vector holds, from number k on: whose rays may meet
/// something in a child's box that lies high enough above their planes. No branch depends
/// on what is found.
void Walk::findLanes(const NearBoxes& boxes, std::uint32_t children, int k,
                     std::uint32_t* lanes) const {
    const Floats d;
    const auto load = [&](const float* p) { return hn::Load(d, p + k); };
    const bool planes = rays_.hasPlanes;
    const Vec zero = hn::Zero(d);
    const Vec start[3] = {load(rays_.u), load(rays_.v), load(rays_.w)};
    const Vec normal[3] = {planes ? load(rays_.planeU) : zero,
                           planes ? load(rays_.planeV) : zero,
                           planes ? load(rays_.planeW) : zero};
    const Vec height = hn::Set(d, planes ? height_ : -kInfinity);
    Vec above[3], below[3];  // the starts, moved by the margins
    for (int axis = 0; axis < 3; ++axis) {
        above[axis] = hn::Add(start[axis], load(margin_[axis]));
        below[axis] = hn::Sub(start[axis], load(margin_[axis]));
    }
    const Vec slopeLow[2] = {load(rays_.slopeLowU), load(rays_.slopeLowV)};
    const Vec slopeHigh[2] = {load(rays_.slopeHighU), load(rays_.slopeHighV)};
    const Vec reach = load(reach_);
    const std::uint32_t wide = (std::uint32_t(rays_.wide) >> k) & kAll;
    for (; children; children &= children - 1) {
        const int i = std::countr_zero(children);
        Vec rise = zero, low[3], high[3];
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = hn::Set(d, boxes.low[axis][i]);
            high[axis] = hn::Set(d, boxes.high[axis][i]);
            // Of the box's corners the highest.
            const Vec far =
                hn::IfThenElse(hn::Lt(normal[axis], zero), low[axis], high[axis]);
            rise = hn::Add(rise, hn::Mul(normal[axis], hn::Sub(far, start[axis])));
        }
        const Vec least = hn::Max(zero, hn::Sub(low[2], above[2]));
        const Vec most = hn::Min(reach, hn::Sub(high[2], below[2]));
        Mask may = hn::Le(least, most);
        for (int axis = 0; axis < 2; ++axis) {
            may =
                hn::And(may, comesBetween(hn::Sub(low[axis], above[axis]),
                                          hn::Sub(high[axis], below[axis]),
                                          slopeLow[axis], slopeHigh[axis], least, most));
        }
        std::uint32_t found = bitsOf(may);
        if (wide) {
            Mask overlap = hn::Ge(zero, zero);
            for (int axis = 0; axis < 3; ++axis) {
                overlap = hn::And(overlap, hn::And(hn::Le(load(low_[axis]), high[axis]),
                                                   hn::Ge(load(high_[axis]), low[axis])));
            }
            found = (found & ~wide) | (bitsOf(overlap) & wide);
        }
        lanes[i] |= (found & bitsOf(hn::Gt(rise, height))) << k;
    }
}

void Walk::chunk(std::size_t index, std::uint32_t lanes) {
    const Triangles triangles(field_.chunks, index);
    std::uint32_t any = (1u << field_.chunks.place(index).triangles) - 1;
    if ((lanes & rays_.wide) == 0) any &= trianglesForAny(triangles);
    if (any == 0) return;
    // Which, for all of them first: branches on what is found are foreseen badly. Either
    // triangle by triangle or receiver by receiver, whichever are fewer.
    std::uint32_t foundFor[kMostReceivers], lanesOf[kTriangles];
    std::uint32_t some = 0, met = 0;  // receivers, triangles
    if ((lanes & rays_.wide) == 0 && std::popcount(any) < std::popcount(lanes)) {
        for (; any; any &= any - 1) {
            const int t = std::countr_zero(any);
            lanesOf[t] = lanesFor(triangles, t, lanes);
            some |= lanesOf[t];
            met |= std::uint32_t(lanesOf[t] != 0) << t;
        }
        if (met == 0) return;
        if (hasFew_ && std::popcount(met) <= std::popcount(some)) {
            if (each_ == 0) packRays();
            for (; met; met &= met - 1) {
                const int t = std::countr_zero(met);
                crossPacked(triangles, t, lanesOf[t] & lanesLeft_);
            }
            return;
        }
        std::fill_n(foundFor, kMostReceivers, 0u);
        for (; met; met &= met - 1) {
            const int t = std::countr_zero(met);
            for (std::uint32_t rest = lanesOf[t]; rest; rest &= rest - 1)
                foundFor[std::countr_zero(rest)] |= 1u << t;
        }
    } else {
        for (std::uint32_t rest = lanes; rest; rest &= rest - 1) {
            const int lane = std::countr_zero(rest);
            foundFor[lane] = any & trianglesFor(lane, triangles);
            some |= std::uint32_t(foundFor[lane] != 0) << lane;
        }
    }
    for (; some; some &= some - 1) {
        const int lane = std::countr_zero(some);
        crossSeen(lane, triangles, foundFor[lane]);
    }
}

/// Closes the receiver's rays that cross one of these triangles.
void Walk::crossSeen(int lane, const Triangles& triangles, std::uint32_t found) {
    float start[3];
    startOf(lane, start);
    const SeenTriangles seen(triangles, start);
    if (rays_.groups == 1 && std::popcount(rays_.open[lane]) < std::popcount(found)) {
        crossEach(lane, seen, triangles, found);
        return;
    }
    for (; found && (lanesLeft_ >> lane & 1); found &= found - 1) {
        const int t = std::countr_zero(found);
        cross(lane, seen, t, boxAround(triangles, t));
    }
}

/// Triangles that rays of any receiver may meet that have bounds, whatever their planes:
/// what inCone() finds for one of them is among those.
std::uint32_t Walk::trianglesForAny(const Triangles& triangles) const {
    const Floats d;
    std::uint32_t found = 0;
    for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
        const auto low = [&](int axis) {
            return hn::Sub(hn::Load(d, triangles.low[axis] + t),
                           hn::Set(d, startHigh_[axis]));
        };
        const auto high = [&](int axis) {
            return hn::Sub(hn::Load(d, triangles.high[axis] + t),
                           hn::Set(d, startLow_[axis]));
        };
        const Vec least = hn::Max(hn::Zero(d), low(2));
        const Vec most = hn::Min(high(2), hn::Set(d, furthest_));
        Mask may = hn::Le(least, most);
        for (int axis = 0; axis < 2; ++axis)
            may = hn::And(may,
                          comesBetween(low(axis), high(axis), hn::Set(d, slopeLow_[axis]),
                                       hn::Set(d, slopeHigh_[axis]), least, most));
        found |= bitsOf(may) << t;
    }
    return found;
}

/// Of some receivers, whose rays have bounds, those for which trianglesFor() finds
/// triangle t.
std::uint32_t Walk::lanesFor(const Triangles& triangles, int t,
                             std::uint32_t lanes) const {
    const Floats d;
    std::uint32_t found = 0;
    for (int k = 0; k < kMostReceivers; k += int(hn::Lanes(d))) {
        if (((lanes >> k) & kAll) == 0) continue;
        const auto load = [&](const float* p) { return hn::Load(d, p + k); };
        const Vec start[3] = {load(rays_.u), load(rays_.v), load(rays_.w)};
        const auto low = [&](int axis) {
            return hn::Sub(hn::Set(d, triangles.low[axis][t]),
                           hn::Add(start[axis], load(margin_[axis])));
        };
        const auto high = [&](int axis) {
            return hn::Sub(hn::Set(d, triangles.high[axis][t]),
                           hn::Sub(start[axis], load(margin_[axis])));
        };
        const Vec least = hn::Max(hn::Zero(d), low(2));
        const Vec most = hn::Min(high(2), load(reach_));
        Mask may = hn::Le(least, most);
        may = hn::And(may, comesBetween(low(0), high(0), load(rays_.slopeLowU),
                                        load(rays_.slopeHighU), least, most));
        may = hn::And(may, comesBetween(low(1), high(1), load(rays_.slopeLowV),
                                        load(rays_.slopeHighV), least, most));
        if (rays_.hasPlanes) {
            const Vec normal[3] = {load(rays_.planeU), load(rays_.planeV),
                                   load(rays_.planeW)};
            Vec highest = hn::Set(d, -kInfinity);
            for (const auto& corner : triangles.corner) {
                Vec height = hn::Zero(d);
                for (int axis = 0; axis < 3; ++axis)
                    height = hn::Add(
                        height, hn::Mul(normal[axis], hn::Sub(hn::Set(d, corner[axis][t]),
                                                              start[axis])));
                highest = hn::Max(highest, height);
            }
            // Triangles::roundingAbove().
            Vec rounding = hn::Zero(d);
            for (int axis = 0; axis < 3; ++axis)
                rounding = hn::Add(rounding, hn::Mul(hn::Abs(normal[axis]),
                                                     hn::Set(d, triangles.step[axis])));
            rounding = hn::Mul(rounding, hn::Set(d, 0.5f));
            may = hn::And(may, hn::Gt(highest, hn::Max(hn::Set(d, height_), rounding)));
        }
        found |= bitsOf(may) << k;
    }
    return found & lanes;
}

/// Triangles that the receiver's rays may meet.
std::uint32_t Walk::trianglesFor(int lane, const Triangles& triangles) const {
    const Floats d;
    std::uint32_t found = 0;
    for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
        Mask may = rays_.wide >> lane & 1 ? inBox(lane, triangles, t)
                                          : inCone(lane, triangles, t);
        if (rays_.hasPlanes) may = hn::And(may, risesAbove(lane, triangles, t));
        found |= bitsOf(may) << t;
    }
    return found;
}

/// Of as many triangles as a vector holds, from number t on: those whose boxes overlap
/// the one around the receiver's rays.
Mask Walk::inBox(int lane, const Triangles& triangles, std::size_t t) const {
    const Floats d;
    Mask may = maskOf(kAll);
    for (int axis = 0; axis < 3; ++axis) {
        may = hn::And(may, hn::Le(hn::Load(d, triangles.low[axis] + t),
                                  hn::Set(d, high_[axis][lane])));
        may = hn::And(may, hn::Ge(hn::Load(d, triangles.high[axis] + t),
                                  hn::Set(d, low_[axis][lane])));
    }
    return may;
}

/// The same by what all its rays go sideways, which have bounds.
Mask Walk::inCone(int lane, const Triangles& triangles, std::size_t t) const {
    const Floats d;
    float start[3];
    startOf(lane, start);
    const auto low = [&](int axis) {
        return hn::Sub(hn::Load(d, triangles.low[axis] + t),
                       hn::Set(d, start[axis] + margin_[axis][lane]));
    };
    const auto high = [&](int axis) {
        return hn::Sub(hn::Load(d, triangles.high[axis] + t),
                       hn::Set(d, start[axis] - margin_[axis][lane]));
    };
    const Vec least = hn::Max(hn::Zero(d), low(2));
    const Vec most = hn::Min(high(2), hn::Set(d, reach_[lane]));
    const Mask inU = comesBetween(low(0), high(0), hn::Set(d, rays_.slopeLowU[lane]),
                                  hn::Set(d, rays_.slopeHighU[lane]), least, most);
    const Mask inV = comesBetween(low(1), high(1), hn::Set(d, rays_.slopeLowV[lane]),
                                  hn::Set(d, rays_.slopeHighV[lane]), least, most);
    return hn::And(hn::Le(least, most), hn::And(inU, inV));
}

/// Those that are not the receiver's own surface.
Mask Walk::risesAbove(int lane, const Triangles& triangles, std::size_t t) const {
    const Floats d;
    const float normal[3] = {rays_.planeU[lane], rays_.planeV[lane], rays_.planeW[lane]};
    float start[3];
    startOf(lane, start);
    Vec highest = hn::Set(d, -kInfinity);
    for (const auto& corner : triangles.corner) {
        Vec height = hn::Zero(d);
        for (int axis = 0; axis < 3; ++axis) {
            height = hn::Add(height, hn::Mul(hn::Set(d, normal[axis]),
                                             hn::Sub(hn::Load(d, corner[axis] + t),
                                                     hn::Set(d, start[axis]))));
        }
        highest = hn::Max(highest, height);
    }
    const float least = std::max(height_, triangles.roundingAbove(rays_, lane));
    return hn::Gt(highest, hn::Set(d, least));
}

/// Of as many rays of a row as a vector holds, from lane k on: boxOf() overlaps the box.
Mask Walk::overlaps(int receiver, int row, int k, const Box& box) const {
    const Floats d;
    float start[3];
    startOf(receiver, start);
    const float* const ways[3] = {rays_.du[row], rays_.dv[row], rays_.dw[row]};
    const Vec begin = hn::Load(d, rays_.begin[row] + k);
    const Vec end = hn::Load(d, end_[row] + k);
    Mask overlap = hn::Ge(end, hn::Zero(d));
    for (int axis = 0; axis < 3; ++axis) {
        const Vec origin = hn::Set(d, start[axis]);
        const Vec way = hn::Load(d, ways[axis] + k);
        const Vec reach = hn::Mul(hn::Abs(way), end);
        const Vec margin = hn::Mul(hn::Add(hn::Abs(origin), reach), hn::Set(d, kMargin));
        const Vec from = hn::Add(origin, hn::Mul(begin, way));
        const Vec to = hn::Add(origin, hn::Mul(end, way));
        const Vec low = hn::Sub(hn::Min(from, to), margin);
        const Vec high = hn::Add(hn::Max(from, to), margin);
        overlap = hn::And(overlap, hn::And(hn::Le(low, hn::Set(d, box.high[axis])),
                                           hn::Ge(high, hn::Set(d, box.low[axis]))));
    }
    return overlap;
}

/// Rays that cross triangles between two places on them; of one of the two there is one.
HWY_INLINE Mask meets(const Vec3& delta, Vec begin, Vec end, const Vec3& side0,
                      const Vec3& side1, const Vec3& side2, const Vec3& terms,
                      const Vec3& normal, Vec distance) {
    const Floats d;
    const Vec e0 = dot(delta, side0), e1 = dot(delta, side1), e2 = dot(delta, side2);
    const Vec zero = hn::Mul(dot(abs(delta), terms), hn::Set(d, kRounding));
    const Mask through = hn::Or(hn::Ge(hn::Min(hn::Min(e0, e1), e2), hn::Neg(zero)),
                                hn::Le(hn::Max(hn::Max(e0, e1), e2), zero));
    // It is met at s = distance / speed.
    const Vec speed = dot(delta, normal);
    const Vec towards = hn::Xor(distance, hn::And(speed, hn::Set(d, -0.0f)));
    const Vec rate = hn::Abs(speed);
    const Mask behind = hn::Gt(towards, hn::Mul(rate, begin));
    const Mask before = hn::Le(towards, hn::Mul(rate, end));
    return hn::And(through, hn::And(behind, before));
}

/// Closes the receiver's rays that cross a triangle.
void Walk::cross(int lane, const SeenTriangles& seen, int t, const Box& box) {
    const Floats d;
    const auto at = [&](const float(&p)[3][kTriangles]) {
        return Vec3{hn::Set(d, p[0][t]), hn::Set(d, p[1][t]), hn::Set(d, p[2][t])};
    };
    const Vec3 side[3] = {at(seen.side[0]), at(seen.side[1]), at(seen.side[2])};
    const Vec3 terms = at(seen.terms), n = at(seen.normal);
    const Vec distance = hn::Set(d, seen.distance[t]);
    bool closed = false;
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(lane, group);
        for (int k = 0; k < kLanes; k += int(hn::Lanes(d))) {
            const auto open =
                (std::uint32_t(rays_.open[row]) >> k) & ((1u << hn::Lanes(d)) - 1);
            if (open == 0) continue;
            const Vec3 delta = {hn::Load(d, rays_.du[row] + k),
                                hn::Load(d, rays_.dv[row] + k),
                                hn::Load(d, rays_.dw[row] + k)};
            const Mask met = meets(delta, hn::Load(d, rays_.begin[row] + k),
                                   hn::Load(d, end_[row] + k), side[0], side[1], side[2],
                                   terms, n, distance);
            if (!(open & bitsOf(met))) continue;
            const std::uint32_t hits =
                open & bitsOf(hn::And(met, overlaps(lane, row, k, box)));
            rays_.open[row] = std::uint16_t(rays_.open[row] & ~(hits << k));
            closed = closed || hits != 0;
        }
    }
    if (closed && openOf(lane) == 0)
        lanesLeft_ = std::uint16_t(lanesLeft_ & ~(1u << lane));
}

/// The same ray by ray, each against all the triangles at once: of few rays.
void Walk::crossEach(int lane, const SeenTriangles& seen, const Triangles& triangles,
                     std::uint32_t found) {
    const Floats d;
    for (std::uint32_t open = rays_.open[lane]; open; open &= open - 1) {
        const int i = std::countr_zero(open);
        const Box box = boxOf(lane, lane, i);
        const Vec3 delta = {hn::Set(d, rays_.du[lane][i]), hn::Set(d, rays_.dv[lane][i]),
                            hn::Set(d, rays_.dw[lane][i])};
        const Vec begin = hn::Set(d, rays_.begin[lane][i]);
        const Vec end = hn::Set(d, end_[lane][i]);
        for (int t = 0; t < kTriangles; t += int(hn::Lanes(d))) {
            const std::uint32_t some = (found >> t) & kAll;
            if (some == 0) continue;
            const auto at = [&](const float(&p)[3][kTriangles]) {
                return Vec3{hn::Load(d, p[0] + t), hn::Load(d, p[1] + t),
                            hn::Load(d, p[2] + t)};
            };
            Mask met = meets(delta, begin, end, at(seen.side[0]), at(seen.side[1]),
                             at(seen.side[2]), at(seen.terms), at(seen.normal),
                             hn::Load(d, seen.distance + t));
            for (int axis = 0; axis < 3; ++axis) {
                met = hn::And(met, hn::Le(hn::Set(d, box.low[axis]),
                                          hn::Load(d, triangles.high[axis] + t)));
                met = hn::And(met, hn::Ge(hn::Set(d, box.high[axis]),
                                          hn::Load(d, triangles.low[axis] + t)));
            }
            if ((some & bitsOf(met)) == 0) continue;
            rays_.open[lane] = std::uint16_t(rays_.open[lane] & ~(1u << i));
            break;
        }
    }
    if (rays_.open[lane] == 0) lanesLeft_ = std::uint16_t(lanesLeft_ & ~(1u << lane));
}

/// Where receivers have few rays each, those with the same number become vectors.
void Walk::packRays() {
    std::uint32_t any = 0;
    for (int receiver = 0; receiver < rays_.receivers; ++receiver)
        any |= rays_.open[receiver];
    each_ = int(std::bit_width(any));
    for (int j = 0; j < each_; ++j) {
        packedOpen_[j] = 0;
        for (int receiver = 0; receiver < kMostReceivers; ++receiver) {
            const int row = std::min(receiver, rays_.receivers - 1);
            way_[0][j][receiver] = rays_.du[row][j];
            way_[1][j][receiver] = rays_.dv[row][j];
            way_[2][j][receiver] = rays_.dw[row][j];
            begin_[j][receiver] = rays_.begin[row][j];
            endOf_[j][receiver] = end_[row][j];
        }
        for (int receiver = 0; receiver < rays_.receivers; ++receiver)
            packedOpen_[j] |= std::uint16_t((rays_.open[receiver] >> j & 1) << receiver);
    }
}

/// Closes packed rays of some receivers that cross triangle t: for each as crossEach()
/// does.
void Walk::crossPacked(const Triangles& triangles, int t, std::uint32_t lanes) {
    const Floats d;
    Vec3 corners[3], edges[3];
    for (int c = 0; c < 3; ++c)
        corners[c] = {hn::Set(d, triangles.corner[c][0][t]),
                      hn::Set(d, triangles.corner[c][1][t]),
                      hn::Set(d, triangles.corner[c][2][t])};
    for (int c = 0; c < 3; ++c)
        edges[c] = subtract(corners[(c + 1) % 3], corners[c]);
    const Vec3 boxLow = {hn::Set(d, triangles.low[0][t]), hn::Set(d, triangles.low[1][t]),
                         hn::Set(d, triangles.low[2][t])};
    const Vec3 boxHigh = {hn::Set(d, triangles.high[0][t]),
                          hn::Set(d, triangles.high[1][t]),
                          hn::Set(d, triangles.high[2][t])};
    const Vec3 normal = HWY_NAMESPACE::cross(edges[0], edges[1]);
    for (int k = 0; k < kMostReceivers; k += int(hn::Lanes(d))) {
        const std::uint32_t some = (lanes >> k) & kAll;
        if (some == 0) continue;
        const auto load = [&](const float* p) { return hn::Load(d, p + k); };
        // As SeenTriangles.
        const Vec3 origin = {load(rays_.u), load(rays_.v), load(rays_.w)};
        Vec3 side[3], furthest = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
        for (int c = 0; c < 3; ++c) {
            const Vec3 middle =
                add(subtract(corners[c], origin), subtract(corners[(c + 1) % 3], origin));
            side[c] = HWY_NAMESPACE::cross(middle, edges[c]);
            furthest = max(furthest, abs(middle));
        }
        const Vec3 terms = crossTerms(furthest, subtract(boxHigh, boxLow));
        const Vec distance = dot(normal, subtract(corners[0], origin));
        for (int j = 0; j < each_; ++j) {
            const std::uint32_t open = (std::uint32_t(packedOpen_[j]) >> k) & some;
            if (open == 0) continue;
            const Vec3 delta = {load(way_[0][j]), load(way_[1][j]), load(way_[2][j])};
            const Vec begin = load(begin_[j]), end = load(endOf_[j]);
            Mask met = meets(delta, begin, end, side[0], side[1], side[2], terms, normal,
                             distance);
            if ((open & bitsOf(met)) == 0) continue;
            const auto inBox = [&](Vec start, Vec way, Vec low, Vec high) {
                const Vec reach = hn::Mul(hn::Abs(way), end);
                const Vec margin =
                    hn::Mul(hn::Add(hn::Abs(start), reach), hn::Set(d, kMargin));
                const Vec from = hn::Add(start, hn::Mul(begin, way));
                const Vec to = hn::Add(start, hn::Mul(end, way));
                return hn::And(hn::Le(hn::Sub(hn::Min(from, to), margin), high),
                               hn::Ge(hn::Add(hn::Max(from, to), margin), low));
            };
            met = hn::And(met, inBox(origin.x, delta.x, boxLow.x, boxHigh.x));
            met = hn::And(met, inBox(origin.y, delta.y, boxLow.y, boxHigh.y));
            met = hn::And(met, inBox(origin.z, delta.z, boxLow.z, boxHigh.z));
            const std::uint32_t hits = (open & bitsOf(met)) << k;
            packedOpen_[j] &= std::uint16_t(~hits);
            for (std::uint32_t rest = hits; rest; rest &= rest - 1) {
                const int lane = std::countr_zero(rest);
                rays_.open[lane] &= std::uint16_t(~(1u << j));
                if (rays_.open[lane] == 0) lanesLeft_ &= std::uint16_t(~(1u << lane));
            }
        }
    }
}

void traceNearAt(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
                 float height) {
    Walk(field, rays, end, height).run();
}

/// Does a chunk's box overlap it? Depth first; gives up after some nodes.
bool mayMeetAt(const std::vector<std::vector<NearBoxes>>& levels, const RayHull& hull,
               float rise) {
    if (levels.empty()) return false;
    const float startLow[3] = {hull.uLow, hull.vLow, hull.wLow};
    const float startHigh[3] = {hull.uHigh, hull.vHigh, hull.wHigh};
    const float lows[3] = {hull.slopeLowU, hull.slopeLowV, 0.0f};
    const float highs[3] = {hull.slopeHighU, hull.slopeHighV, 1.0f};
    const Box box = boxAround(startLow, startHigh, lows, highs, rise);
    struct Node {
        std::size_t level, index;
    };
    constexpr int kSize = 64;
    Node stack[kSize] = {{levels.size() - 1, 0}};
    for (int waiting = 1, looks = 0; waiting > 0; ++looks) {
        const Node node = stack[--waiting];
        std::uint32_t found = overlapping(levels[node.level][node.index], box);
        if (found == 0) continue;
        if (node.level == 0 || looks == kSize || waiting + std::popcount(found) > kSize)
            return true;
        for (; found; found &= found - 1)
            stack[waiting++] = {node.level - 1, NearBoxes::kChildren * node.index +
                                                    std::size_t(std::countr_zero(found))};
    }
    return false;
}

}  // namespace HWY_NAMESPACE
}  // namespace mtsm::trace
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(traceNearAt);
HWY_EXPORT(mayMeetAt);

void traceNear(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
               float height) noexcept {
    HWY_DYNAMIC_DISPATCH(traceNearAt)(field, rays, end, height);
}

bool mayMeet(const std::vector<std::vector<NearBoxes>>& levels, const RayHull& hull,
             float rise) noexcept {
    return HWY_DYNAMIC_DISPATCH(mayMeetAt)(levels, hull, rise);
}

}  // namespace mtsm::trace
#endif
