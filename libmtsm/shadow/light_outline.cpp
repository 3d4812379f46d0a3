#include "shadow/light_outline.h"

#include <algorithm>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadow/light_outline.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "trace/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::shadow::HWY_NAMESPACE {
namespace lanes = trace::HWY_NAMESPACE;
namespace hn = hwy::HWY_NAMESPACE;

using lanes::bitsOf, lanes::broadcast, lanes::fusedDot, lanes::maskOf, lanes::subtract;
using lanes::Floats, lanes::Vec, lanes::Vec3;
using trace::kLanes;
constexpr Floats kF;
constexpr int kN = int(hn::MaxLanes(kF));

HWY_INLINE Vec sizeOf(Vec3 a) {
    return hn::Add(hn::Abs(a.x), hn::Add(hn::Abs(a.y), hn::Abs(a.z)));
}

/// [axis][receiver], in light space.
struct Seen {
    alignas(64) float position[3][kLanes], normal[3][kLanes];
    [[nodiscard]] static Vec3 load(const float (&p)[3][kLanes], int i) {
        return {hn::Load(kF, p[0] + i), hn::Load(kF, p[1] + i), hn::Load(kF, p[2] + i)};
    }
};

void toLightSpace(const LightOutline::Outline& light, const Receiver* receivers,
                  int count, Seen& seen) {
    alignas(64) double p[3][kLanes], n[3][kLanes];
    for (int i = 0; i < kLanes; ++i) {
        const Receiver& receiver = receivers[std::min(i, count - 1)];
        for (int axis = 0; axis < 3; ++axis) {
            p[axis][i] = receiver.point[axis] - light.eye[axis];
            n[axis][i] = receiver.normal[axis];
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        const double x = light.turn[axis][0], y = light.turn[axis][1],
                     z = light.turn[axis][2];
        for (int i = 0; i < kLanes; ++i) {
            seen.position[axis][i] = float(x * p[0][i] + y * p[1][i] + z * p[2][i]);
            seen.normal[axis][i] = float(x * n[0][i] + y * n[1][i] + z * n[2][i]);
        }
    }
}

/// Which receivers have all of the light above their horizon, and which nothing of it.
void horizon(const LightOutline::Outline& light, const Seen& seen, int i,
             std::uint32_t& above, std::uint32_t& below) {
    const Vec3 p = Seen::load(seen.position, i), n = Seen::load(seen.normal, i);
    const Vec3 centre = broadcast(light.centre);
    Vec3 base = centre;
    Vec rounding = sizeOf(centre);
    if (!light.endless) {
        base = subtract(centre, p);
        rounding = hn::Add(rounding, sizeOf(p));
    }
    const Vec size = sizeOf(n);
    const Vec middle = fusedDot(base, n);
    Vec reach = hn::Mul(hn::Set(kF, light.radius), size);
    for (const auto& axis : light.axes) {
        const Vec3 a = broadcast(axis);
        reach = hn::Add(reach, hn::Abs(fusedDot(a, n)));
        rounding = hn::Add(rounding, sizeOf(a));
    }
    reach = hn::MulAdd(hn::Mul(rounding, size), hn::Set(kF, 0x1p-18f), reach);
    // Of tiny or huge normals a float is not enough.
    const auto usual =
        hn::And(hn::Gt(size, hn::Set(kF, 0x1p-60f)), hn::Lt(size, hn::Set(kF, 0x1p60f)));
    above |= bitsOf(hn::And(usual, hn::Gt(middle, reach))) << i;
    below |= bitsOf(hn::And(usual, hn::Lt(middle, hn::Neg(reach)))) << i;
}

/// The boxes around where those above start.
void starts(const LightOutline::Outline& light, const Seen& seen, Outlook& outlook) {
    Vec low[3], high[3];
    for (int axis = 0; axis < 3; ++axis) {
        low[axis] = hn::Set(kF, HUGE_VALF);
        high[axis] = hn::Set(kF, -HUGE_VALF);
    }
    for (int i = 0; i < kLanes; i += kN) {
        const Vec3 p = Seen::load(seen.position, i);
        const Vec one = hn::Set(kF, 1.0f);
        const Vec w = light.perspective ? hn::Div(one, p.z) : hn::Neg(p.z);
        const Vec perDepth = light.perspective ? w : one;
        const auto raster = [&](Vec x, int axis) {
            return hn::MulAdd(hn::Mul(x, hn::Set(kF, light.scale[axis])), perDepth,
                              hn::Set(kF, light.offset[axis]));
        };
        const Vec at[3] = {raster(p.x, 0), raster(p.y, 1), w};
        const auto above = maskOf(std::uint32_t(outlook.above) >> i);
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = hn::IfThenElse(above, hn::Min(low[axis], at[axis]), low[axis]);
            high[axis] = hn::IfThenElse(above, hn::Max(high[axis], at[axis]), high[axis]);
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        outlook.low[axis] = hn::GetLane(hn::MinOfLanes(kF, low[axis]));
        outlook.high[axis] = hn::GetLane(hn::MaxOfLanes(kF, high[axis]));
    }
}

void see(const LightOutline::Outline& light, const Receiver* receivers, int count,
         bool normals, Outlook& outlook) {
    Seen seen;
    toLightSpace(light, receivers, count, seen);
    const std::uint32_t all = (1u << count) - 1;
    std::uint32_t above = normals ? 0 : all, below = 0;
    for (int i = 0; normals && i < kLanes; i += kN)
        horizon(light, seen, i, above, below);
    outlook.above = std::uint16_t(above & all);
    outlook.below = std::uint16_t(below & all);
    if (outlook.above) starts(light, seen, outlook);
}

}  // namespace mtsm::shadow::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::shadow {

HWY_EXPORT(see);

namespace {

struct Interval {
    float low, high;
};
Interval operator-(Interval a, Interval b) {
    return {a.low - b.high, a.high - b.low};
}
/// f takes all four pairs of ends.
template <typename F>
Interval ofEnds(Interval a, Interval b, const F& f) {
    const float ends[4] = {f(a.low, b.low), f(a.low, b.high), f(a.high, b.low),
                           f(a.high, b.high)};
    const auto [low, high] = std::minmax_element(ends, ends + 4);
    return {*low, *high};
}
Interval operator*(Interval a, Interval b) {
    return ofEnds(a, b, [](float x, float y) { return x * y; });
}
/// b > 0
Interval operator/(Interval a, Interval b) {
    return ofEnds(a, b, [](float x, float y) { return x / y; });
}

/// Floats of rays are not those of hulls.
constexpr float kRounding = 0x1p-17f;

}  // namespace

void Outlook::include(const Outlook& other) noexcept {
    if (other.above == 0) return;
    for (int axis = 0; axis < 3; ++axis) {
        low[axis] = above ? std::min(low[axis], other.low[axis]) : other.low[axis];
        high[axis] = above ? std::max(high[axis], other.high[axis]) : other.high[axis];
    }
    above |= other.above;
}

LightOutline::LightOutline(const Projection& p, const light::LightSampler& light) {
    const glm::dmat3 turn = glm::transpose(glm::dmat3(p.right, p.up, p.forward));
    const auto store = [](float(&to)[3], glm::dvec3 from) {
        for (int axis = 0; axis < 3; ++axis)
            to[axis] = float(from[axis]);
    };
    Outline& o = outline_;
    o.perspective = p.kind == ProjectionKind::perspective;
    for (int axis = 0; axis < 3; ++axis) {
        for (int k = 0; k < 3; ++k)
            o.turn[axis][k] = turn[k][axis];
        o.eye[axis] = p.eye[axis];
    }
    for (int axis = 0; axis < 2; ++axis) {
        o.scale[axis] = float(p.scale[axis]);
        o.offset[axis] = float(p.offset[axis]);
    }
    const light::LightView seen = light.view(p.eye + p.forward);
    const bool cap = seen.domain == light::LightView::Domain::cap;
    o.endless = seen.endless;
    std::fill_n(half_, 3, 0.0f);
    if (o.endless) {
        // Of a cap: as far from its axis, and from its base to its summit.
        const double h = cap ? seen.capHeight : 0.0;
        const double aside = h < 1.0 ? std::sqrt(h * (2.0 - h)) : 1.0;
        store(o.centre, turn * ((1.0 - 0.5 * h) * seen.z));
        store(o.axes[0], turn * (aside * seen.x));
        store(o.axes[1], turn * (aside * seen.y));
        store(o.axes[2], turn * (0.5 * h * seen.z));
    } else {
        store(o.centre, p.lightFromWorld(light.centre()));
        if (cap) {
            o.radius = float(glm::length(seen.x));
            std::fill_n(half_, 3, o.radius);
        } else {
            store(o.axes[0], turn * seen.x);
            store(o.axes[1], turn * seen.y);
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        const float a = std::abs(o.axes[0][axis]), b = std::abs(o.axes[1][axis]);
        const bool round = seen.domain == light::LightView::Domain::disk;
        half_[axis] += (round ? std::hypot(a, b) * (1.0f + 0x1p-20f) : a + b) +
                       std::abs(o.axes[2][axis]);
    }
    known_ = o.perspective != o.endless;
    if (!o.endless) return;
    // Of directions the box of slopes.
    const Interval depth = {o.centre[2] - half_[2], o.centre[2] + half_[2]};
    known_ = known_ && depth.high < -0x1p-10f;
    tilt_ = depth.low / depth.high;
    for (int axis = 0; known_ && axis < 2; ++axis) {
        const Interval aside = {o.centre[axis] - half_[axis],
                                o.centre[axis] + half_[axis]};
        // -scale x / z, for z < 0
        const Interval slope = aside / Interval{-depth.high, -depth.low} *
                               Interval{o.scale[axis], o.scale[axis]};
        slopeLow_[axis] = slope.low, slopeHigh_[axis] = slope.high;
    }
}

Outlook LightOutline::outlook(const Receiver* receivers, int count) const noexcept {
    Outlook outlook;
    HWY_DYNAMIC_DISPATCH(see)
    (outline_, receivers, count, receivers[0].normal != glm::dvec3(0.0), outlook);
    return outlook;
}

std::optional<trace::RayHull> LightOutline::hull(const Outlook& starts,
                                                 float among) const noexcept {
    if (!known_) return std::nullopt;
    const Outline& o = outline_;
    Interval at[3], slope[2];
    for (int axis = 0; axis < 3; ++axis) {
        const float low = starts.low[axis], high = starts.high[axis];
        const float offset = axis < 2 ? std::abs(o.offset[axis]) : 0.0f;
        const float margin =
            (std::max(std::abs(low), std::abs(high)) + offset) * kRounding;
        at[axis] = {low - margin, high + margin};
    }
    const Interval w = at[2];
    // So far apart that rounding takes the farther ones behind what is there.
    if (o.perspective && !(w.low > 0.0f)) return std::nullopt;
    // How much larger than another a part of the light may seem.
    float tilt = tilt_;
    for (int axis = 0; axis < 2; ++axis) {
        if (o.endless) {
            slope[axis] = {slopeLow_[axis], slopeHigh_[axis]};
        } else {
            // A ray from (x, z) to (lx, lz) is at (lx - (x / z) lz) / (1 - lz / z) where
            // its depth is 0; that times the scale is what u changes per w.
            const Interval scale = {o.scale[axis], o.scale[axis]};
            const Interval offset = {o.offset[axis], o.offset[axis]};
            const Interval perScale = {1.0f / o.scale[axis], 1.0f / o.scale[axis]};
            const Interval x = {o.centre[axis] - half_[axis],
                                o.centre[axis] + half_[axis]};
            const Interval z = {o.centre[2] - half_[2], o.centre[2] + half_[2]};
            const Interval before = Interval{1.0f, 1.0f} - z * w;
            if (!(before.low > 0x1p-6f)) return std::nullopt;
            tilt = before.high / before.low;
            slope[axis] = (x - (at[axis] - offset) * perScale * z) / before * scale;
        }
        float margin =
            std::max(std::abs(slope[axis].low), std::abs(slope[axis].high)) * kRounding;
        // What LightRays adds for receivers far behind what there is to meet.
        if (o.perspective)
            margin += std::max(std::abs(at[axis].low - o.offset[axis]),
                               std::abs(at[axis].high - o.offset[axis])) /
                      at[2].low * 0x1p-20f;
        slope[axis].low -= margin, slope[axis].high += margin;
    }
    // The light is smaller than the box around it.
    const float area = (slope[0].high - slope[0].low) * (slope[1].high - slope[1].low);
    return trace::RayHull{at[0].low,     at[0].high,    at[1].low,
                          at[1].high,    at[2].low,     at[2].high,
                          slope[0].low,  slope[0].high, slope[1].low,
                          slope[1].high, at[2].low,     tilt * std::sqrt(area / among)};
}

}  // namespace mtsm::shadow
#endif
