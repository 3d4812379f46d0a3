// The boxes are walked with the rays of all receivers together: each receiver's rays lie
// in a pyramid, and as many receivers as a vector has lanes are compared with a box at
// once; a receiver's pyramid is what its bundle says of its rays. Chunks
// that some may meet wait until sixteen are together: most of what is asked of them is
// answered with no, which is told of all without a branch. In each the receiver's pyramid
// is compared with sixteen boxes of triangles, then with the planes through their edges;
// each triangle that is left is tested against sixteen rays.
//
// What a ray meets must not depend on the rays beside it. So a crossing counts only if
// it lies in the triangle's box, to rounding, and pyramids are larger than that rounding:
// they pass over nothing that a ray could meet. A ray meets its triangles in the order of
// the chunks, whoever is with it.
//
// Fused multiply-adds are not used, for they would make one machine's answer another's
// rounding.
#include "trace/sheet_trace.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <new>
#include <utility>

// Vectors of a length that is not known in advance cannot be members of a struct.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/sheet_trace.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "trace/lanes-inl.h"
#include "trace/triangles-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace {
namespace HWY_NAMESPACE {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Of a crossing's coordinates: how far outside its triangle's box it may seem.
constexpr float kOwnMargin = 0x1p-20f;
/// Of a receiver's coordinates, and of all that its rays go: by how much its pyramid is
/// larger; more than that and the rounding of both.
constexpr float kMargin = 0x1p-18f;

/// Slopes of rays, pixels per w, from the least to the most; the same in every lane or of
/// another receiver in each.
struct Slopes {
    Vec lowU, highU, lowV, highV;
};

/// Where the rays of some starts are: more than that by what rounding may make of it.
struct Pyramid {
    Vec3 low, high;  // where they start
    Slopes slopes;
    Vec rise;  // how far they go

    /// May a ray be in a box?
    [[nodiscard]] HWY_INLINE Mask reaches(Floats d, const Vec3& boxLow,
                                          const Vec3& boxHigh) const {
        const Vec least = hn::Max(hn::Zero(d), hn::Sub(boxLow.z, high.z));
        const Vec most = hn::Min(rise, hn::Sub(boxHigh.z, low.z));
        const auto meets = [&](Vec from, Vec to, Vec lowSlope, Vec highSlope, Vec lowEnd,
                               Vec highEnd) {
            from =
                hn::Add(from, hn::Min(hn::Mul(lowSlope, most), hn::Mul(lowSlope, least)));
            to =
                hn::Add(to, hn::Max(hn::Mul(highSlope, most), hn::Mul(highSlope, least)));
            return hn::And(hn::Le(from, highEnd), hn::Ge(to, lowEnd));
        };
        return hn::And(
            hn::Le(least, most),
            hn::And(
                meets(low.x, high.x, slopes.lowU, slopes.highU, boxLow.x, boxHigh.x),
                meets(low.y, high.y, slopes.lowV, slopes.highV, boxLow.y, boxHigh.y)));
    }
};

/// Seen from a receiver: the planes through the edges of 16 triangles, what counts where
/// a ray lies in one, and how far away the triangles' planes are.
struct SeenTriangles {
    alignas(64) float side[3][3][kTriangles];  // [edge][axis][triangle]
    alignas(64) float tie[3][kTriangles];      // [edge][triangle]
    alignas(64) float normal[3][kTriangles];
    alignas(64) float distance[kTriangles];

    SeenTriangles(const Triangles& triangles, const float (&start)[3]) {
        const Floats d;
        const Vec3 origin = {hn::Set(d, start[0]), hn::Set(d, start[1]),
                             hn::Set(d, start[2])};
        for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
            Vec3 corners[3], edges[3];
            for (int c = 0; c < 3; ++c)
                corners[c] = Triangles::load(d, triangles.corner[c], t);
            for (int c = 0; c < 3; ++c)
                edges[c] = subtract(corners[(c + 1) % 3], corners[c]);
            for (int c = 0; c < 3; ++c) {
                // An edge from A to B spans (A + B) x (B - A) with the start: twice A x
                // B, but without its cancellation.
                const Vec3 middle = add(subtract(corners[c], origin),
                                        subtract(corners[(c + 1) % 3], origin));
                store(cross(middle, edges[c]), side[c], t);
                const Vec zero = hn::Zero(d);
                const Vec direction = hn::IfThenElse(
                    hn::Ne(edges[c].x, zero), edges[c].x,
                    hn::IfThenElse(hn::Ne(edges[c].y, zero), edges[c].y, edges[c].z));
                hn::Store(hn::CopySign(hn::Set(d, 1e-30f), direction), d, tie[c] + t);
            }
            const Vec3 n = cross(edges[0], edges[1]);
            store(n, normal, t);
            hn::Store(dot(n, subtract(corners[0], origin)), d, distance + t);
        }
    }

    /// Those that a ray with some of these slopes may cross: not those that all of them
    /// pass on one side of one edge and on the other side of another.
    [[nodiscard]] std::uint32_t between(const float (&slopes)[4]) const {
        const Floats d;
        const Vec lowU = hn::Set(d, slopes[0]), highU = hn::Set(d, slopes[1]);
        const Vec lowV = hn::Set(d, slopes[2]), highV = hn::Set(d, slopes[3]);
        const Vec farU = hn::Max(hn::Abs(lowU), hn::Abs(highU));
        const Vec farV = hn::Max(hn::Abs(lowV), hn::Abs(highV));
        std::uint32_t found = 0;
        for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
            Mask below = hn::FirstN(d, 0), above = below;
            for (const auto& s : side) {
                const Vec3 p = Triangles::load(d, s, t);
                const Vec a = hn::Mul(p.x, lowU), b = hn::Mul(p.x, highU);
                const Vec e = hn::Mul(p.y, lowV), f = hn::Mul(p.y, highV);
                const Vec rounding =
                    hn::Mul(hn::Set(d, kMargin),
                            hn::Add(hn::Abs(p.z), hn::Add(hn::Mul(hn::Abs(p.x), farU),
                                                          hn::Mul(hn::Abs(p.y), farV))));
                const Vec least = hn::Add(p.z, hn::Add(hn::Min(a, b), hn::Min(e, f)));
                const Vec most = hn::Add(p.z, hn::Add(hn::Max(a, b), hn::Max(e, f)));
                above = hn::Or(above, hn::Gt(least, rounding));
                below = hn::Or(below, hn::Lt(most, hn::Neg(rounding)));
            }
            found |= bitsOf(hn::Not(hn::And(above, below))) << t;
        }
        return found & 0xffff;
    }

  private:
    static void store(const Vec3& v, float (&to)[3][kTriangles], std::size_t t) {
        const Floats d;
        hn::Store(v.x, d, to[0] + t), hn::Store(v.y, d, to[1] + t);
        hn::Store(v.z, d, to[2] + t);
    }
};

HWY_INLINE Vec wrapped(Vec x, TextureWrap wrap) {
    const Floats d;
    const Vec one = hn::Set(d, 1.0f);
    switch (wrap) {
        case TextureWrap::clamp:
            return hn::Min(hn::Max(x, hn::Zero(d)), one);
        case TextureWrap::mirror: {
            const Vec two = hn::Set(d, 2.0f);
            const Vec turns = hn::Floor(hn::Mul(x, hn::Set(d, 0.5f)));
            const Vec period = hn::Sub(x, hn::Mul(two, turns));
            return hn::Min(period, hn::Sub(two, period));
        }
        case TextureWrap::repeat:
            break;
    }
    return hn::Sub(x, hn::Floor(x));
}

/// OpacityTexture::opacity() without a footprint, for some lanes; finite u and v.
HWY_INLINE Vec opacityAt(const NearTexture& texture, Vec u, Vec v, std::uint32_t lanes) {
    const Floats d;
    const hn::Rebind<std::int32_t, Floats> whole;
    const hn::Rebind<std::uint32_t, Floats> bits;
    const auto place = [&](Vec x, std::uint32_t n, TextureWrap wrap) {
        // From the middle of the texel before the first one.
        const Vec at =
            hn::Add(hn::Mul(wrapped(x, wrap), hn::Set(d, float(n))), hn::Set(d, 0.5f));
        return hn::IfThenElseZero(hn::Ge(at, hn::Zero(d)),
                                  hn::Min(at, hn::Set(d, float(n) + 0.5f)));
    };
    const Vec one = hn::Set(d, 1.0f);
    const Vec x = place(u, texture.width, texture.wrapU);
    const Vec y = place(hn::Sub(one, v), texture.height, texture.wrapV);
    const auto column = hn::ConvertTo(whole, x), row = hn::ConvertTo(whole, y);
    const Vec acrossX = hn::Sub(x, hn::ConvertTo(d, column));
    const Vec acrossY = hn::Sub(y, hn::ConvertTo(d, row));
    // Mostly few lanes have something to look up.
    const std::size_t stride = std::size_t(texture.width) + 2;
    alignas(64) std::int32_t columns[kLanes], rows[kLanes];
    alignas(64) std::uint32_t around[kLanes] = {};
    hn::Store(column, whole, columns);
    hn::Store(row, whole, rows);
    for (; lanes; lanes &= lanes - 1) {
        const int i = std::countr_zero(lanes);
        const std::uint8_t* const p = texture.bordered.data() +
                                      std::size_t(rows[i]) * stride +
                                      std::size_t(columns[i]);
        around[i] = std::uint32_t(p[0] | p[1] << 8) |
                    std::uint32_t(p[stride] | p[stride + 1] << 8) << 16;
    }
    const auto texels = hn::Load(bits, around);
    const auto byte = [&](auto shifted) {
        const auto low = hn::And(shifted, hn::Set(bits, 255u));
        return hn::ConvertTo(d, hn::BitCast(whole, low));
    };
    const Vec a = byte(texels), b = byte(hn::ShiftRight<8>(texels));
    const Vec e = byte(hn::ShiftRight<16>(texels)), f = byte(hn::ShiftRight<24>(texels));
    const Vec upper = hn::Add(a, hn::Mul(acrossX, hn::Sub(b, a)));
    const Vec lower = hn::Add(e, hn::Mul(acrossX, hn::Sub(f, e)));
    const Vec value = hn::Mul(hn::Add(upper, hn::Mul(acrossY, hn::Sub(lower, upper))),
                              hn::Set(d, 1.0f / 255.0f));
    const Vec opacity = hn::Set(d, texture.opacity);
    if (texture.cutoff < 0.0f) return hn::Mul(opacity, value);
    return hn::IfThenElseZero(hn::Ge(value, hn::Set(d, texture.cutoff)), opacity);
}

/// One call of traceSheets().
class Walk {
  public:
    Walk(const NearSheets& sheets, const SheetTraceOptions& options, RayBundle& rays,
         const float (*end)[kLanes], float (*visible)[kLanes])
        : sheets_(sheets), options_(options), rays_(rays), end_(end), visible_(visible) {}

    void run() {
        const auto& levels = sheets_.triangles.levels;
        if (levels.empty()) return;
        const NearBoxes& top = levels.back()[0];
        const float highest =
            *std::max_element(top.high[2], top.high[2] + NearBoxes::kChildren);
        for (int receiver = 0; receiver < rays_.receivers; ++receiver)
            bound(receiver, highest);
        if (lanesLeft_) node(levels.size() - 1, 0, lanesLeft_);
        meetWaiting();
    }

  private:
    using PerReceiver = float[kMostReceivers];

    void bound(int receiver, float highest);
    void boundWide(int receiver);
    [[nodiscard]] bool anyOpen(int receiver) const;
    void node(std::size_t level, std::size_t index, std::uint32_t lanes);
    [[nodiscard]] std::uint32_t childrenFor(const NearBoxes& boxes) const;
    [[nodiscard]] std::uint32_t lanesAt(const Vec3& low, const Vec3& high) const;
    void meetWaiting();
    [[nodiscard]] std::uint32_t trianglesFor(int lane, const Triangles& triangles) const;
    [[nodiscard]] std::uint32_t above(int lane, const Triangles& triangles) const;
    void cross16(int lane, std::size_t index, const Triangles& triangles,
                 std::uint32_t found);
    void cross(int row, const SeenTriangles& seen, const Triangles& triangles,
               std::size_t index, int t);
    [[nodiscard]] Vec opacity(std::size_t index, const Triangles& triangles, int t,
                              const Vec (&volumes)[3], Mask hits) const;

    const NearSheets& sheets_;
    const SheetTraceOptions options_;
    RayBundle& rays_;
    const float (*const end_)[kLanes];
    float (*const visible_)[kLanes];
    std::uint32_t lanesLeft_ = 0;  ///< receivers with a ray that is open

    // Pyramids around the rays of each receiver; wide ones have a box around their rays
    // for a start, and go nowhere from there.
    alignas(64) PerReceiver low_[3] = {}, high_[3] = {};  // [axis]
    alignas(64) PerReceiver lowU_ = {}, highU_ = {}, lowV_ = {}, highV_ = {};
    alignas(64) PerReceiver rise_ = {};
    // Around all of them.
    float hullLow_[3] = {kInfinity, kInfinity, kInfinity};
    float hullHigh_[3] = {-kInfinity, -kInfinity, -kInfinity};
    float hullSlopes_[4] = {kInfinity, -kInfinity, kInfinity, -kInfinity};
    float hullRise_ = 0.0f;

    // Chunks that receivers' rays may meet, as many as stay in the first level of the
    // cache when they are unpacked. What is told of them together costs no branches that
    // the processor cannot foresee.
    static constexpr int kAtOnce = 16;
    struct Waiting {
        std::size_t chunk;
        std::uint32_t lanes;      // not none
        std::uint32_t triangles;  // one bit each
    };
    Waiting waiting_[kAtOnce + 1] = {};
    int waitingCount_ = 0;
    /// Room for a chunk: an optional would be cleared, 17 KB for each call.
    union Room {
        Room() {}
        Triangles triangles;
    };
    Room unpacked_[kAtOnce];
};

bool Walk::anyOpen(int receiver) const {
    std::uint32_t open = 0;
    for (int group = 0; group < rays_.groups; ++group)
        open |= rays_.open[rays_.row(receiver, group)];
    return open != 0;
}

/// `highest`: the greatest w that triangles reach.
void Walk::bound(int receiver, float highest) {
    const int r = receiver;
    if (!anyOpen(r)) return;
    lanesLeft_ |= 1u << r;
    if (rays_.wide >> r & 1) {
        boundWide(r);
    } else {
        lowU_[r] = rays_.slopeLowU[r], highU_[r] = rays_.slopeHighU[r];
        lowV_[r] = rays_.slopeLowV[r], highV_[r] = rays_.slopeHighV[r];
        rise_[r] = std::max(0.0f, std::min(rays_.rise[r], highest - rays_.w[r]));
        rise_[r] += kMargin * rise_[r];
        const float start[3] = {rays_.u[r], rays_.v[r], rays_.w[r]};
        const float most[3] = {std::max(std::abs(lowU_[r]), std::abs(highU_[r])),
                               std::max(std::abs(lowV_[r]), std::abs(highV_[r])), 1.0f};
        for (int axis = 0; axis < 3; ++axis) {
            const float margin =
                kMargin * (std::abs(start[axis]) + rise_[r] * most[axis]);
            low_[axis][r] = start[axis] - margin;
            high_[axis][r] = start[axis] + margin;
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        hullLow_[axis] = std::min(hullLow_[axis], low_[axis][r]);
        hullHigh_[axis] = std::max(hullHigh_[axis], high_[axis][r]);
    }
    hullSlopes_[0] = std::min(hullSlopes_[0], lowU_[r]);
    hullSlopes_[1] = std::max(hullSlopes_[1], highU_[r]);
    hullSlopes_[2] = std::min(hullSlopes_[2], lowV_[r]);
    hullSlopes_[3] = std::max(hullSlopes_[3], highV_[r]);
    hullRise_ = std::max(hullRise_, rise_[r]);
}

void Walk::boundWide(int receiver) {
    for (int axis = 0; axis < 3; ++axis) {
        low_[axis][receiver] = kInfinity;
        high_[axis][receiver] = -kInfinity;
    }
    const float start[3] = {rays_.u[receiver], rays_.v[receiver], rays_.w[receiver]};
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(receiver, group);
        const float* const ways[3] = {rays_.du[row], rays_.dv[row], rays_.dw[row]};
        for (std::uint32_t open = rays_.open[row]; open; open &= open - 1) {
            const int i = std::countr_zero(open);
            for (int axis = 0; axis < 3; ++axis) {
                const float way = ways[axis][i] * end_[row][i];
                const float margin = (std::abs(start[axis]) + std::abs(way)) * kMargin;
                float &low = low_[axis][receiver], &high = high_[axis][receiver];
                low = std::min(low, start[axis] + std::min(0.0f, way) - margin);
                high = std::max(high, start[axis] + std::max(0.0f, way) + margin);
            }
        }
    }
}

void Walk::node(std::size_t level, std::size_t index, std::uint32_t lanes) {
    const Floats d;
    const NearBoxes& boxes = sheets_.triangles.levels[level][index];
    for (std::uint32_t found = childrenFor(boxes); found; found &= found - 1) {
        const int i = std::countr_zero(found);
        const auto at = [&](const float(&p)[3][NearBoxes::kChildren]) {
            return Vec3{hn::Set(d, p[0][i]), hn::Set(d, p[1][i]), hn::Set(d, p[2][i])};
        };
        const std::uint32_t here =
            lanes & lanesLeft_ & lanesAt(at(boxes.low), at(boxes.high));
        const std::size_t child = NearBoxes::kChildren * index + std::size_t(i);
        if (level > 0) {
            if (here) node(level - 1, child, here);
            continue;
        }
        waiting_[waitingCount_] = {child, here, 0};
        waitingCount_ += here != 0;
        if (waitingCount_ == kAtOnce) meetWaiting();
    }
}

/// Children that some receiver's rays may meet.
std::uint32_t Walk::childrenFor(const NearBoxes& boxes) const {
    const Floats d;
    std::uint32_t found = 0;
    const auto set = [&](float x) { return hn::Set(d, x); };
    const Pyramid hull = {broadcast(hullLow_),
                          broadcast(hullHigh_),
                          {set(hullSlopes_[0]), set(hullSlopes_[1]), set(hullSlopes_[2]),
                           set(hullSlopes_[3])},
                          set(hullRise_)};
    for (std::size_t i = 0; i < NearBoxes::kChildren; i += hn::Lanes(d)) {
        const auto load = [&](const float(&p)[3][NearBoxes::kChildren]) {
            return Vec3{hn::LoadU(d, p[0] + i), hn::LoadU(d, p[1] + i),
                        hn::LoadU(d, p[2] + i)};
        };
        const Vec3 low = load(boxes.low), high = load(boxes.high);
        const Mask there = hn::Le(low.x, high.x);
        found |= bitsOf(hn::And(there, hull.reaches(d, low, high))) << i;
    }
    return found;
}

/// Receivers whose rays may meet something in the box that lies high enough above their
/// planes.
std::uint32_t Walk::lanesAt(const Vec3& low, const Vec3& high) const {
    const Floats d;
    std::uint32_t lanes = 0;
    for (std::size_t k = 0; k < kLanes; k += hn::Lanes(d)) {
        const auto load = [&](const float* p) { return hn::Load(d, p + k); };
        const Pyramid pyramid = {{load(low_[0]), load(low_[1]), load(low_[2])},
                                 {load(high_[0]), load(high_[1]), load(high_[2])},
                                 {load(lowU_), load(highU_), load(lowV_), load(highV_)},
                                 load(rise_)};
        Mask may = pyramid.reaches(d, low, high);
        if (rays_.hasPlanes) {
            const auto higher = [&](const float* plane, const float* start, Vec from,
                                    Vec to) {
                const Vec n = load(plane), at = load(start);
                return hn::Max(hn::Mul(n, hn::Sub(from, at)),
                               hn::Mul(n, hn::Sub(to, at)));
            };
            const Vec height =
                hn::Add(hn::Add(higher(rays_.planeU, rays_.u, low.x, high.x),
                                higher(rays_.planeV, rays_.v, low.y, high.y)),
                        higher(rays_.planeW, rays_.w, low.z, high.z));
            may = hn::And(may, hn::Gt(height, hn::Set(d, options_.height)));
        }
        lanes |= bitsOf(may) << k;
    }
    return lanes;
}

void Walk::meetWaiting() {
    const int count = std::exchange(waitingCount_, 0);
    if (count == 0) return;
    for (int i = 0; i < count; ++i) {
        Waiting& w = waiting_[i];
        new (&unpacked_[i].triangles) Triangles(sheets_.triangles.chunks, w.chunk);
        w.triangles = (1u << sheets_.chunks.place(w.chunk).triangles) - 1;
    }
    struct Met {
        int waiting, lane;
        std::uint32_t triangles;
    };
    Met met[kAtOnce * kMostReceivers + 1];
    int size = 0;
    std::uint32_t lanes = waiting_[0].lanes;
    for (int i = 0; i < count;) {
        const int lane = std::countr_zero(lanes);
        const std::uint32_t found =
            waiting_[i].triangles & trianglesFor(lane, unpacked_[i].triangles);
        met[size] = {i, lane, found};
        size += found != 0;
        lanes &= lanes - 1;
        i += lanes == 0;
        lanes = lanes ? lanes : waiting_[i].lanes;
    }
    for (const Met* m = met; m < met + size; ++m) {
        if (!(lanesLeft_ >> m->lane & 1)) continue;
        const Triangles& triangles = unpacked_[m->waiting].triangles;
        const std::uint32_t found = m->triangles & above(m->lane, triangles);
        if (found) cross16(m->lane, waiting_[m->waiting].chunk, triangles, found);
    }
}

/// Triangles that the receiver's rays may meet, whatever its plane.
std::uint32_t Walk::trianglesFor(int lane, const Triangles& triangles) const {
    const Floats d;
    std::uint32_t found = 0;
    const auto set = [&](const float* p) { return hn::Set(d, p[lane]); };
    const Pyramid pyramid = {{set(low_[0]), set(low_[1]), set(low_[2])},
                             {set(high_[0]), set(high_[1]), set(high_[2])},
                             {set(lowU_), set(highU_), set(lowV_), set(highV_)},
                             set(rise_)};
    for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
        const Mask may = pyramid.reaches(d, Triangles::load(d, triangles.low, t),
                                         Triangles::load(d, triangles.high, t));
        found |= bitsOf(may) << t;
    }
    return found;
}

/// Triangles that rise above the receiver's plane.
std::uint32_t Walk::above(int lane, const Triangles& triangles) const {
    if (!rays_.hasPlanes) return (1u << kTriangles) - 1;
    const Floats d;
    std::uint32_t found = 0;
    const auto set = [&](const float* p) { return hn::Set(d, p[lane]); };
    const Vec3 start = {set(rays_.u), set(rays_.v), set(rays_.w)};
    const Vec3 normal = {set(rays_.planeU), set(rays_.planeV), set(rays_.planeW)};
    const float least = std::max(options_.height, triangles.roundingAbove(rays_, lane));
    for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
        Vec highest = hn::Set(d, -kInfinity);
        for (const auto& corner : triangles.corner) {
            const Vec3 p = Triangles::load(d, corner, t);
            highest = hn::Max(highest, dot(normal, subtract(p, start)));
        }
        found |= bitsOf(hn::Gt(highest, hn::Set(d, least))) << t;
    }
    return found;
}

/// Takes from a receiver's rays what the triangles of a chunk stop.
void Walk::cross16(int lane, std::size_t index, const Triangles& triangles,
                   std::uint32_t found) {
    const float start[3] = {rays_.u[lane], rays_.v[lane], rays_.w[lane]};
    const SeenTriangles seen(triangles, start);
    const bool wide = rays_.wide >> lane & 1;
    const float slopes[4] = {lowU_[lane], highU_[lane], lowV_[lane], highV_[lane]};
    if (!wide && rays_.groups == 1) found &= seen.between(slopes);
    bool left = false;
    for (int group = 0; group < rays_.groups; ++group) {
        const int row = rays_.row(lane, group);
        std::uint32_t crossed = rays_.open[row] ? found : 0;
        if (crossed && !wide && rays_.groups > 1) {
            const float part[4] = {std::max(slopes[0], rays_.groupLowU[group]),
                                   std::min(slopes[1], rays_.groupHighU[group]),
                                   std::max(slopes[2], rays_.groupLowV[group]),
                                   std::min(slopes[3], rays_.groupHighV[group])};
            crossed &= seen.between(part);
        }
        for (; crossed && rays_.open[row]; crossed &= crossed - 1)
            cross(row, seen, triangles, index, std::countr_zero(crossed));
        left = left || rays_.open[row];
    }
    if (!left) lanesLeft_ &= ~(1u << lane);
}

/// ... what one of them stops of the rays of a row.
void Walk::cross(int row, const SeenTriangles& seen, const Triangles& triangles,
                 std::size_t index, int t) {
    const Floats d;
    const auto at = [&](const float(&p)[3][kTriangles]) {
        return Vec3{hn::Set(d, p[0][t]), hn::Set(d, p[1][t]), hn::Set(d, p[2][t])};
    };
    const int receiver = row / rays_.groups;
    const Vec distance = hn::Set(d, seen.distance[t]);
    const Vec3 normal = at(seen.normal);
    for (int k = 0; k < kLanes; k += int(hn::Lanes(d))) {
        const Vec3 delta = {hn::Load(d, rays_.du[row] + k),
                            hn::Load(d, rays_.dv[row] + k),
                            hn::Load(d, rays_.dw[row] + k)};
        Vec e[3];
        for (int c = 0; c < 3; ++c) {
            const Vec volume = dot(delta, at(seen.side[c]));
            e[c] = hn::IfThenElse(hn::Eq(volume, hn::Zero(d)), hn::Set(d, seen.tie[c][t]),
                                  volume);
        }
        const Mask through =
            hn::Or(hn::Gt(hn::Min(hn::Min(e[0], e[1]), e[2]), hn::Zero(d)),
                   hn::Lt(hn::Max(hn::Max(e[0], e[1]), e[2]), hn::Zero(d)));
        if (hn::AllFalse(d, through)) continue;
        const Vec s = hn::Div(distance, dot(delta, normal));
        Mask hits = hn::And(through, maskOf(std::uint32_t(rays_.open[row]) >> k));
        hits = hn::And(hits, hn::Gt(s, hn::Load(d, rays_.begin[row] + k)));
        hits = hn::And(hits, hn::Le(s, hn::Load(d, end_[row] + k)));
        const auto inside = [&](float from, Vec way, const float(&low)[kTriangles],
                                const float(&high)[kTriangles]) {
            const Vec start = hn::Set(d, from), gone = hn::Mul(s, way);
            const Vec p = hn::Add(start, gone);
            const Vec margin =
                hn::Mul(hn::Set(d, kOwnMargin), hn::Add(hn::Abs(start), hn::Abs(gone)));
            return hn::And(hn::Ge(hn::Add(p, margin), hn::Set(d, low[t])),
                           hn::Le(hn::Sub(p, margin), hn::Set(d, high[t])));
        };
        hits = hn::And(hits, inside(rays_.u[receiver], delta.x, triangles.low[0],
                                    triangles.high[0]));
        hits = hn::And(hits, inside(rays_.v[receiver], delta.y, triangles.low[1],
                                    triangles.high[1]));
        hits = hn::And(hits, inside(rays_.w[receiver], delta.z, triangles.low[2],
                                    triangles.high[2]));
        if (hn::AllFalse(d, hits)) continue;
        const Vec passes =
            hn::Sub(hn::Set(d, 1.0f), opacity(index, triangles, t, e, hits));
        Vec visible = hn::Load(d, visible_[row] + k);
        visible = hn::IfThenElse(hits, hn::Mul(visible, passes), visible);
        hn::Store(visible, d, visible_[row] + k);
        const std::uint32_t dark =
            bitsOf(hn::And(hits, hn::Le(visible, hn::Set(d, options_.dark))));
        rays_.open[row] = std::uint16_t(rays_.open[row] & ~(dark << k));
    }
}

/// What a triangle stops of the rays that hit it. A crossing's weights for the corners
/// are as the volumes over the edges opposite to them.
Vec Walk::opacity(std::size_t index, const Triangles& triangles, int t,
                  const Vec (&volumes)[3], Mask hits) const {
    const Floats d;
    const NearSheetChunks::Place& chunk = sheets_.chunks.place(index);
    const NearTexture& texture = sheets_.textures[chunk.texture];
    if (texture.width == 1 && texture.height == 1) {
        const float value = float(texture.bordered[0]) * (1.0f / 255.0f);
        const bool there = texture.cutoff < 0.0f || value >= texture.cutoff;
        return hn::Set(d, !there                   ? 0.0f
                          : texture.cutoff >= 0.0f ? texture.opacity
                                                   : texture.opacity * value);
    }
    Vec sum = hn::Zero(d), u = sum, v = sum;
    for (int c = 0; c < 3; ++c) {
        Vec weight = volumes[(c + 1) % 3];
        if (options_.perspective)
            weight = hn::Mul(weight, hn::Set(d, triangles.corner[c][2][t]));
        sum = hn::Add(sum, weight);
        const std::array<std::uint16_t, 2> uv = sheets_.chunks.uv(index, c, t);
        const auto at = [&](std::size_t axis) {
            return hn::Set(d, chunk.low[axis] + chunk.step[axis] * float(uv[axis]));
        };
        u = hn::Add(u, hn::Mul(weight, at(0)));
        v = hn::Add(v, hn::Mul(weight, at(1)));
    }
    const Vec scale = hn::Div(hn::Set(d, 1.0f), sum);
    return opacityAt(texture, hn::IfThenElseZero(hits, hn::Mul(u, scale)),
                     hn::IfThenElseZero(hits, hn::Mul(v, scale)), bitsOf(hits));
}

}  // namespace

void traceSheetsAt(const NearSheets& sheets, const SheetTraceOptions& options,
                   RayBundle& rays, const float (*end)[kLanes],
                   float (*visible)[kLanes]) {
    Walk(sheets, options, rays, end, visible).run();
}

}  // namespace HWY_NAMESPACE
}  // namespace mtsm::trace
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(traceSheetsAt);

void traceSheets(const NearSheets& sheets, const SheetTraceOptions& options,
                 RayBundle& rays, const float (*end)[kLanes],
                 float (*visible)[kLanes]) noexcept {
    HWY_DYNAMIC_DISPATCH(traceSheetsAt)(sheets, options, rays, end, visible);
}

}  // namespace mtsm::trace
#endif
