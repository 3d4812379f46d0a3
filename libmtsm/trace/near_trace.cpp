// The boxes of the near field are walked with a hull of all rays that are asked for; in
// the chunks that are left the 16 triangles' boxes are compared with it side by side; and
// each triangle that is left is tested against 16 rays at once, block by block.
//
// The hull is a box around all rays from s = 1/4 on, one around them from 1/16 to 1/4,
// and so on: one box around slanted or widening rays would hold far too much. What a ray
// meets must not depend on the hull, that is, on the rays beside it. So a ray that is
// found to cross a triangle is closed only if the box around one of its own pieces
// overlaps the triangle's: the hull contains all these boxes, and passes nothing over
// that any of its rays could meet. Where rounding decides, it decides for the ray alone.
// Boxes are a little larger than the pieces, so that no true crossing is lost.
//
// Fused multiply-adds are not used, for they would make one machine's answer another's
// rounding.
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

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using Floats = hn::CappedTag<float, kLanes>;
using Vec = hn::Vec<Floats>;
using Mask = hn::Mask<Floats>;

/// Rays are cut at s = 1/4, 1/16, ... into so many pieces.
constexpr int kPieces = 8;
/// Triangles that are tested against all blocks before boxes around these are worth it.
constexpr int kFewTriangles = 4;
constexpr int kTriangles = NearChunk::kTriangles;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Of a ray's coordinates, added to its boxes; their rounding is an eighth of it.
constexpr float kMargin = 0x1p-20f;
/// Of the sum of a volume's terms without their signs; their rounding is half of it.
constexpr float kRounding = 0x1p-20f;

HWY_INLINE std::uint32_t bitsOf(Floats d, Mask mask) {
    std::uint8_t bytes[8] = {};
    hn::StoreMaskBits(d, mask, bytes);
    return bytes[0] | std::uint32_t(bytes[1]) << 8;
}

HWY_INLINE Mask maskOf(Floats d, std::uint32_t bits) {
    const std::uint8_t bytes[8] = {std::uint8_t(bits), std::uint8_t(bits >> 8)};
    return hn::LoadMaskBits(d, bytes);
}

/// A point or a direction for each lane.
struct Vec3 {
    Vec x, y, z;
};

HWY_INLINE Vec3 add(const Vec3& a, const Vec3& b) {
    return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}

HWY_INLINE Vec3 subtract(const Vec3& a, const Vec3& b) {
    return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}

HWY_INLINE Vec dot(const Vec3& a, const Vec3& b) {
    return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}

HWY_INLINE Vec3 cross(const Vec3& a, const Vec3& b) {
    return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)),
            hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
            hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}

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

HWY_INLINE Vec3 min(const Vec3& a, const Vec3& b) {
    return {hn::Min(a.x, b.x), hn::Min(a.y, b.y), hn::Min(a.z, b.z)};
}

HWY_INLINE Vec3 max(const Vec3& a, const Vec3& b) {
    return {hn::Max(a.x, b.x), hn::Max(a.y, b.y), hn::Max(a.z, b.z)};
}

HWY_INLINE Vec3 broadcast(Floats d, const float (&p)[3]) {
    return {hn::Set(d, p[0]), hn::Set(d, p[1]), hn::Set(d, p[2])};
}

struct Box {
    float low[3] = {kInfinity, kInfinity, kInfinity};
    float high[3] = {-kInfinity, -kInfinity, -kInfinity};

    [[nodiscard]] bool overlaps(const Box& b) const {
        for (int axis = 0; axis < 3; ++axis) {
            if (!(low[axis] <= b.high[axis] && high[axis] >= b.low[axis])) return false;
        }
        return true;
    }
};

Box boxOf(Floats d, const Vec3& low, const Vec3& high) {
    Box box;
    const Vec lows[3] = {low.x, low.y, low.z}, highs[3] = {high.x, high.y, high.z};
    for (int axis = 0; axis < 3; ++axis) {
        box.low[axis] = hn::GetLane(hn::MinOfLanes(d, lows[axis]));
        box.high[axis] = hn::GetLane(hn::MaxOfLanes(d, highs[axis]));
    }
    return box;
}

/// Where piece i of every ray starts and piece i - 1 ends; the first starts, and the last
/// ends, with the ray.
float pieceBegin(int i) {
    if (i == 0) return -kInfinity;
    return i < kPieces ? std::ldexp(1.0f, 2 * (i - kPieces)) : kInfinity;
}

/// From a ray's start to a triangle's plane, times the normal's length.
struct Distances {
    float low, high;
};

/// The corners of a chunk's triangles, and their boxes.
struct Triangles {
    alignas(64) float corner[3][3][kTriangles];  // [corner][axis][triangle]
    alignas(64) float low[3][kTriangles], high[3][kTriangles];

    explicit Triangles(const NearChunk& chunk) {
        const Floats d;
        const hn::Rebind<std::int32_t, Floats> whole;
        const hn::Rebind<std::uint16_t, Floats> stored;
        for (int axis = 0; axis < 3; ++axis) {
            const Vec first = hn::Set(d, chunk.low[axis]);
            const Vec step = hn::Set(d, chunk.step[axis]);
            for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
                Vec p[3];
                for (int c = 0; c < 3; ++c) {
                    const auto q = hn::LoadU(stored, chunk.corner[c][axis] + t);
                    const Vec steps = hn::ConvertTo(d, hn::PromoteTo(whole, q));
                    p[c] = hn::Add(first, hn::Mul(step, steps));
                    hn::Store(p[c], d, corner[c][axis] + t);
                }
                hn::Store(hn::Min(hn::Min(p[0], p[1]), p[2]), d, low[axis] + t);
                hn::Store(hn::Max(hn::Max(p[0], p[1]), p[2]), d, high[axis] + t);
            }
        }
    }
    [[nodiscard]] Box box(int t) const {
        Box b;
        for (int axis = 0; axis < 3; ++axis) {
            b.low[axis] = low[axis][t];
            b.high[axis] = high[axis][t];
        }
        return b;
    }
};

/// One call of traceNear().
class Walk {
  public:
    Walk(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
         const std::uint16_t* asked)
        : field_(field), rays_(rays), end_(end) {
        for (int b = 0; b < rays_.blocks; ++b) {
            left_[b] = rays_.open[b] & asked[b];
            if (left_[b]) blocksLeft_ |= std::uint64_t(1) << b;
        }
        boundRays();
        setHull();
    }

    void run() {
        if (blocksLeft_ && !field_.levels.empty()) node(field_.levels.size() - 1, 0);
    }

  private:
    void boundRays();
    void setHull();
    void boundBlocks();
    [[nodiscard]] std::uint64_t blocksNear(const Box& box);
    [[nodiscard]] Distances distancesMet(const float (&normal)[3]) const;
    [[nodiscard]] Box pieceOf(int b, int lane, int piece) const;
    [[nodiscard]] std::uint32_t inHull(const float (&low)[3][kTriangles],
                                       const float (&high)[3][kTriangles]) const;
    void node(std::size_t level, std::size_t index);
    void chunk(const NearChunk& chunk);
    void triangle(const Triangles& triangles, int t);
    void close(int b, std::uint32_t hits, const Box& box);

    const NearField& field_;
    RayBundle& rays_;
    const float (*const end_)[kLanes];
    std::uint16_t left_[kMostBlocks];              ///< asked for and open
    std::uint64_t blocksLeft_ = 0;                 ///< with a ray that is
    Box start_, way_;                              ///< around all starts and all deltas
    float first_ = kInfinity, last_ = -kInfinity;  ///< least begin, greatest end
    Box hull_[kPieces];
    int pieces_ = 0;     ///< of the hull
    int triangles_ = 0;  ///< that were tested
    /// After kFewTriangles: around each block's rays; empty for blocks without one.
    alignas(64) float low_[3][kMostBlocks], high_[3][kMostBlocks];
};

void Walk::boundRays() {
    const Floats d;
    const Vec none = hn::Set(d, kInfinity);
    Vec first = none, last = hn::Neg(none);
    Vec3 startLow = {none, none, none}, wayLow = startLow;
    Vec3 startHigh = {last, last, last}, wayHigh = startHigh;
    for (std::size_t i = 0; i < kLanes; i += hn::Lanes(d)) {
        std::uint32_t lanes = 0;
        for (std::uint64_t next = blocksLeft_; next; next &= next - 1) {
            const int b = std::countr_zero(next);
            const std::uint32_t bits = std::uint32_t(left_[b]) >> i;
            lanes |= bits;
            const Mask asked = maskOf(d, bits);
            const auto low = [&](Vec v) { return hn::IfThenElse(asked, v, none); };
            const auto high = [&](Vec v) {
                return hn::IfThenElse(asked, v, hn::Neg(none));
            };
            const Vec du = hn::Load(d, rays_.du[b] + i),
                      dv = hn::Load(d, rays_.dv[b] + i),
                      dw = hn::Load(d, rays_.dw[b] + i);
            wayLow = min(wayLow, {low(du), low(dv), low(dw)});
            wayHigh = max(wayHigh, {high(du), high(dv), high(dw)});
            first = hn::Min(first, low(hn::Load(d, rays_.begin[b] + i)));
            last = hn::Max(last, high(hn::Load(d, end_[b] + i)));
        }
        const Mask asked = maskOf(d, lanes);
        const auto low = [&](Vec v) { return hn::IfThenElse(asked, v, none); };
        const auto high = [&](Vec v) { return hn::IfThenElse(asked, v, hn::Neg(none)); };
        const Vec u = hn::Load(d, rays_.u + i), v = hn::Load(d, rays_.v + i),
                  w = hn::Load(d, rays_.w + i);
        startLow = min(startLow, {low(u), low(v), low(w)});
        startHigh = max(startHigh, {high(u), high(v), high(w)});
    }
    first_ = hn::GetLane(hn::MinOfLanes(d, first));
    last_ = hn::GetLane(hn::MaxOfLanes(d, last));
    start_ = boxOf(d, startLow, startHigh);
    way_ = boxOf(d, wayLow, wayHigh);
}

/// Where the rays' pieces are at most, piece by piece; pieces that no ray has are left
/// out. Larger than pieceOf() of any of them.
void Walk::setHull() {
    for (int piece = 0; piece < kPieces; ++piece) {
        const float from = std::max(first_, pieceBegin(piece));
        const float to = std::min(last_, pieceBegin(piece + 1));
        if (!(from <= to)) continue;
        Box& box = hull_[pieces_++];
        for (int axis = 0; axis < 3; ++axis) {
            const float low = way_.low[axis], high = way_.high[axis];
            const float margin =
                2.0f * kMargin *
                (std::max(std::abs(start_.low[axis]), std::abs(start_.high[axis])) +
                 std::max(std::abs(low), std::abs(high)));
            const auto [back, forth] =
                std::minmax({from * low, to * low, from * high, to * high});
            box.low[axis] = start_.low[axis] + back - margin;
            box.high[axis] = start_.high[axis] + forth + margin;
        }
    }
}

/// Of one ray; empty if it has no such piece.
Box Walk::pieceOf(int b, int lane, int piece) const {
    Box box;
    const float from = std::max(rays_.begin[b][lane], pieceBegin(piece));
    const float to = std::min(end_[b][lane], pieceBegin(piece + 1));
    if (!(from <= to)) return box;
    const float starts[3] = {rays_.u[lane], rays_.v[lane], rays_.w[lane]};
    const float deltas[3] = {rays_.du[b][lane], rays_.dv[b][lane], rays_.dw[b][lane]};
    for (int axis = 0; axis < 3; ++axis) {
        const float start = starts[axis], delta = deltas[axis];
        const float margin = (std::abs(start) + std::abs(delta)) * kMargin;
        const float p = start + from * delta, q = start + to * delta;
        box.low[axis] = std::min(p, q) - margin;
        box.high[axis] = std::max(p, q) + margin;
    }
    return box;
}

/// Of 16 boxes, those that overlap some piece of the hull.
std::uint32_t Walk::inHull(const float (&low)[3][kTriangles],
                           const float (&high)[3][kTriangles]) const {
    const Floats d;
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < kTriangles; i += hn::Lanes(d)) {
        Vec lows[3], highs[3];
        for (int axis = 0; axis < 3; ++axis) {
            lows[axis] = hn::LoadU(d, low[axis] + i);
            highs[axis] = hn::LoadU(d, high[axis] + i);
        }
        std::uint32_t bits = 0;
        for (int k = 0; k < pieces_; ++k) {
            const Box& piece = hull_[k];
            Mask overlap = hn::Le(lows[0], hn::Set(d, piece.high[0]));
            for (int axis = 0; axis < 3; ++axis) {
                overlap =
                    hn::And(overlap, hn::Le(lows[axis], hn::Set(d, piece.high[axis])));
                overlap =
                    hn::And(overlap, hn::Ge(highs[axis], hn::Set(d, piece.low[axis])));
            }
            bits |= bitsOf(d, overlap);
        }
        found |= bits << i;
    }
    return found;
}

void Walk::node(std::size_t level, std::size_t index) {
    const NearBoxes& boxes = field_.levels[level][index];
    for (std::uint32_t found = inHull(boxes.low, boxes.high); found && blocksLeft_;
         found &= found - 1) {
        const std::size_t child =
            NearBoxes::kChildren * index + std::size_t(std::countr_zero(found));
        if (level > 0)
            node(level - 1, child);
        else
            chunk(field_.chunks[child]);
    }
}

void Walk::chunk(const NearChunk& chunk) {
    const Triangles triangles(chunk);
    const std::uint32_t all = (1u << chunk.triangles()) - 1;
    for (std::uint32_t found = all & inHull(triangles.low, triangles.high);
         found && blocksLeft_; found &= found - 1)
        triangle(triangles, std::countr_zero(found));
}

void Walk::boundBlocks() {
    const Floats d;
    const Vec none = hn::Set(d, kInfinity);
    for (int axis = 0; axis < 3; ++axis) {
        std::fill_n(low_[axis], kMostBlocks, kInfinity);
        std::fill_n(high_[axis], kMostBlocks, -kInfinity);
    }
    const float* const starts[3] = {rays_.u, rays_.v, rays_.w};
    const float(*const deltas[3])[kLanes] = {rays_.du, rays_.dv, rays_.dw};
    for (std::uint64_t next = blocksLeft_; next; next &= next - 1) {
        const int b = std::countr_zero(next);
        for (int axis = 0; axis < 3; ++axis) {
            Vec low = none, high = hn::Neg(none);
            for (std::size_t i = 0; i < kLanes; i += hn::Lanes(d)) {
                const Mask asked = maskOf(d, std::uint32_t(left_[b]) >> i);
                const Vec start = hn::Load(d, starts[axis] + i);
                const Vec delta = hn::Load(d, deltas[axis][b] + i);
                const Vec margin =
                    hn::Mul(hn::Add(hn::Abs(start), hn::Abs(delta)), hn::Set(d, kMargin));
                const Vec p =
                    hn::Add(start, hn::Mul(hn::Load(d, rays_.begin[b] + i), delta));
                const Vec q = hn::Add(start, hn::Mul(hn::Load(d, end_[b] + i), delta));
                const Vec least = hn::Sub(hn::Min(p, q), margin);
                const Vec most = hn::Add(hn::Max(p, q), margin);
                low = hn::Min(low, hn::IfThenElse(asked, least, none));
                high = hn::Max(high, hn::IfThenElse(asked, most, hn::Neg(none)));
            }
            low_[axis][b] = hn::GetLane(hn::MinOfLanes(d, low));
            high_[axis][b] = hn::GetLane(hn::MaxOfLanes(d, high));
        }
    }
}

/// Blocks of which some ray may come near the box.
std::uint64_t Walk::blocksNear(const Box& box) {
    if (++triangles_ <= kFewTriangles) return blocksLeft_;
    if (triangles_ == kFewTriangles + 1) boundBlocks();
    const Floats d;
    std::uint64_t blocks = 0;
    for (int b = 0; b < rays_.blocks; b += int(hn::Lanes(d))) {
        Mask overlap = hn::Le(hn::Load(d, low_[0] + b), hn::Set(d, box.high[0]));
        for (int axis = 0; axis < 3; ++axis) {
            overlap = hn::And(
                overlap, hn::Le(hn::Load(d, low_[axis] + b), hn::Set(d, box.high[axis])));
            overlap = hn::And(
                overlap, hn::Ge(hn::Load(d, high_[axis] + b), hn::Set(d, box.low[axis])));
        }
        blocks |= std::uint64_t(bitsOf(d, overlap)) << b;
    }
    return blocksLeft_ & blocks;
}

/// Distances at which some ray may meet a plane with this normal, all others being met
/// before the rays begin or after they end. Wider than any rounding.
Distances Walk::distancesMet(const float (&normal)[3]) const {
    float slowest = 0.0f, fastest = 0.0f, terms = 0.0f;
    for (int axis = 0; axis < 3; ++axis) {
        const float a = normal[axis] * way_.low[axis], b = normal[axis] * way_.high[axis];
        slowest += std::min(a, b);
        fastest += std::max(a, b);
        terms += std::max(std::abs(a), std::abs(b));
    }
    slowest -= terms * kRounding;
    fastest += terms * kRounding;
    const auto [low, high] = std::minmax(
        {first_ * slowest, first_ * fastest, last_ * slowest, last_ * fastest});
    return {low, high};
}

/// Closes the rays that cross a triangle.
void Walk::triangle(const Triangles& triangles, int t) {
    const Floats d;
    float corner[3][3], edge[3][3];
    for (int c = 0; c < 3; ++c) {
        for (int axis = 0; axis < 3; ++axis)
            corner[c][axis] = triangles.corner[c][axis][t];
    }
    for (int c = 0; c < 3; ++c) {
        for (int axis = 0; axis < 3; ++axis)
            edge[c][axis] = corner[(c + 1) % 3][axis] - corner[c][axis];
    }
    const float normal[3] = {edge[0][1] * edge[1][2] - edge[0][2] * edge[1][1],
                             edge[0][2] * edge[1][0] - edge[0][0] * edge[1][2],
                             edge[0][0] * edge[1][1] - edge[0][1] * edge[1][0]};
    const Vec3 n = broadcast(d, normal);
    const Distances met = distancesMet(normal);
    const Box box = triangles.box(t);
    std::uint64_t blocks = 0;
    for (std::size_t i = 0; i < kLanes; i += hn::Lanes(d)) {
        // The corners, seen from where the rays start.
        const Vec3 start = {hn::Load(d, rays_.u + i), hn::Load(d, rays_.v + i),
                            hn::Load(d, rays_.w + i)};
        const Vec3 first = subtract(broadcast(d, corner[0]), start);
        const Vec distance = dot(n, first);
        if (hn::AllFalse(d, hn::And(hn::Ge(distance, hn::Set(d, met.low)),
                                    hn::Le(distance, hn::Set(d, met.high)))))
            continue;
        if (blocks == 0) blocks = blocksNear(box);
        if (blocks == 0) return;
        const Vec3 to[3] = {first, subtract(broadcast(d, corner[1]), start),
                            subtract(broadcast(d, corner[2]), start)};
        // An edge from A to B spans (A + B) x (B - A) with the start: twice A x B, but
        // without its cancellation.
        Vec3 side[3], furthest = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
        for (int c = 0; c < 3; ++c) {
            const Vec3 middle = add(to[c], to[(c + 1) % 3]);
            side[c] = cross(middle, broadcast(d, edge[c]));
            furthest = max(furthest, abs(middle));
        }
        float longest[3];
        for (int axis = 0; axis < 3; ++axis)
            longest[axis] = box.high[axis] - box.low[axis];
        const Vec3 terms = crossTerms(furthest, broadcast(d, longest));
        for (std::uint64_t next = blocks; next; next &= next - 1) {
            const int b = std::countr_zero(next);
            const std::uint32_t wanted = std::uint32_t(left_[b]) >> i;
            if (wanted == 0) continue;
            const Vec3 delta = {hn::Load(d, rays_.du[b] + i),
                                hn::Load(d, rays_.dv[b] + i),
                                hn::Load(d, rays_.dw[b] + i)};
            // The plane is met at s = distance / speed.
            const Vec speed = dot(delta, n);
            const Vec towards = hn::Xor(distance, hn::And(speed, hn::Set(d, -0.0f)));
            const Vec rate = hn::Abs(speed);
            const Mask inTime =
                hn::And(hn::Gt(towards, hn::Mul(rate, hn::Load(d, rays_.begin[b] + i))),
                        hn::Le(towards, hn::Mul(rate, hn::Load(d, end_[b] + i))));
            if (hn::AllFalse(d, inTime)) continue;
            const Vec e0 = dot(delta, side[0]), e1 = dot(delta, side[1]),
                      e2 = dot(delta, side[2]);
            const Vec zero = hn::Mul(dot(abs(delta), terms), hn::Set(d, kRounding));
            const Mask through =
                hn::Or(hn::Ge(hn::Min(hn::Min(e0, e1), e2), hn::Neg(zero)),
                       hn::Le(hn::Max(hn::Max(e0, e1), e2), zero));
            const std::uint32_t hits = wanted & bitsOf(d, hn::And(through, inTime));
            if (hits) close(b, hits << i, box);
        }
    }
}

/// Closes those of a block's rays of which a piece overlaps the box.
void Walk::close(int b, std::uint32_t hits, const Box& box) {
    for (; hits; hits &= hits - 1) {
        const int lane = std::countr_zero(hits);
        for (int piece = 0; piece < kPieces; ++piece) {
            if (!pieceOf(b, lane, piece).overlaps(box)) continue;
            const auto bit = std::uint16_t(1u << lane);
            rays_.open[b] = std::uint16_t(rays_.open[b] & ~bit);
            left_[b] = std::uint16_t(left_[b] & ~bit);
            if (left_[b] == 0) blocksLeft_ &= ~(std::uint64_t(1) << b);
            break;
        }
    }
}

void traceNearAt(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
                 const std::uint16_t* asked) {
    Walk(field, rays, end, asked).run();
}

}  // namespace HWY_NAMESPACE
}  // namespace mtsm::trace
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(traceNearAt);

void traceNear(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
               const std::uint16_t* asked) noexcept {
    HWY_DYNAMIC_DISPATCH(traceNearAt)(field, rays, end, asked);
}

}  // namespace mtsm::trace
#endif
