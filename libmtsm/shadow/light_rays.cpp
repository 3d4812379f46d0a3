#include "shadow/light_rays.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadow/light_rays.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef MTSM_SHADOW_LIGHT_RAYS_INPUT
#define MTSM_SHADOW_LIGHT_RAYS_INPUT
namespace mtsm::shadow {

/// What one call of fill works on.
struct FillInput {
    const ReceiverLanes& at;
    const LightRays::View& view;
    const LightRays::Cells& cells;
    std::uint32_t firstCell;
    int blocks;
    bool cellsAcross;  // a lane is a cell, not a receiver
    light::LightView::Domain domain;
    bool endless, normals, weights;
    glm::vec3 shines;
    float samples;
};

}  // namespace mtsm::shadow
#endif

HWY_BEFORE_NAMESPACE();
namespace mtsm::shadow::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using trace::kLanes;
using Floats = hn::CappedTag<float, kLanes>;
using Ints = hn::RebindToSigned<Floats>;
using Bits = hn::RebindToUnsigned<Floats>;
using Vec = hn::Vec<Floats>;
using MaskF = hn::Mask<Floats>;
constexpr Floats kF;
constexpr Bits kU;
constexpr int kN = int(hn::MaxLanes(kF));

HWY_INLINE std::uint32_t bitsOf(MaskF mask) {
    std::uint8_t bytes[8] = {};
    hn::StoreMaskBits(kF, mask, bytes);
    std::uint16_t bits;
    std::memcpy(&bits, bytes, sizeof bits);
    return bits & ((1u << kN) - 1);
}

struct Vec3 {
    Vec x, y, z;
};
HWY_INLINE Vec dot(Vec3 a, Vec3 b) {
    return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
/// a + s b
HWY_INLINE Vec3 along(Vec3 a, Vec s, Vec3 b) {
    return {hn::MulAdd(s, b.x, a.x), hn::MulAdd(s, b.y, a.y), hn::MulAdd(s, b.z, a.z)};
}
HWY_INLINE Vec constant(float x) {
    return hn::Set(kF, x);
}

/// Two numbers in [0, 1) from a receiver's key and the number of a cell.
struct Jitter {
    Vec x, y;
};
HWY_INLINE Jitter jitter(hn::Vec<Bits> keys, hn::Vec<Bits> cells) {
    auto h = hn::Xor(keys, hn::Mul(cells, hn::Set(kU, 0x9e3779b1u)));
    h = hn::Mul(hn::Xor(h, hn::ShiftRight<16>(h)), hn::Set(kU, 0x6a09e667u));
    h = hn::Mul(hn::Xor(h, hn::ShiftRight<15>(h)), hn::Set(kU, 0xbb67ae85u));
    h = hn::Xor(h, hn::ShiftRight<16>(h));
    const auto fraction = [](hn::Vec<Bits> bits) {
        return hn::Mul(hn::ConvertTo(kF, hn::BitCast(Ints(), bits)), constant(0x1p-16f));
    };
    return {fraction(hn::ShiftRight<16>(h)), fraction(hn::And(h, hn::Set(kU, 0xffffu)))};
}

/// light::sampleDisk.
HWY_INLINE Jitter onDisk(Jitter u) {
    const Vec a = hn::MulSub(constant(2.0f), u.x, constant(1.0f));
    const Vec b = hn::MulSub(constant(2.0f), u.y, constant(1.0f));
    const MaskF flat = hn::Gt(hn::Abs(a), hn::Abs(b));
    const Vec r = hn::IfThenElse(flat, a, b), other = hn::IfThenElse(flat, b, a);
    const Vec safe = hn::IfThenElse(hn::Eq(r, hn::Zero(kF)), constant(1.0f), r);
    // sin and cos of at most an eighth of a turn, by their series.
    const Vec phi = hn::Mul(constant(0.785398163f), hn::Div(other, safe));
    const Vec p2 = hn::Mul(phi, phi);
    Vec sine = hn::MulAdd(p2, constant(-1.0f / 5040.0f), constant(1.0f / 120.0f));
    sine = hn::MulAdd(p2, sine, constant(-1.0f / 6.0f));
    sine = hn::Mul(phi, hn::MulAdd(p2, sine, constant(1.0f)));
    Vec cosine = hn::MulAdd(p2, constant(1.0f / 40320.0f), constant(-1.0f / 720.0f));
    cosine = hn::MulAdd(p2, cosine, constant(1.0f / 24.0f));
    cosine = hn::MulAdd(p2, cosine, constant(-0.5f));
    cosine = hn::MulAdd(p2, cosine, constant(1.0f));
    return {hn::Mul(r, hn::IfThenElse(flat, cosine, sine)),
            hn::Mul(r, hn::IfThenElse(flat, sine, cosine))};
}

/// The rays of as many receivers as a vector holds.
class LanesFill {
  public:
    LanesFill(const FillInput& in, int lane, trace::RayBundle& bundle, RayFates& fates)
        : in_(in), view_(in.view), lane_(lane), bundle_(bundle), fates_(fates) {
        const ReceiverLanes& at = in.at;
        position_ = load(at.x, at.y, at.z);
        base_ = load(at.baseX, at.baseY, at.baseZ);
        axisX_ = load(at.axisXX, at.axisXY, at.axisXZ);
        axisY_ = load(at.axisYX, at.axisYY, at.axisYZ);
        axisZ_ = load(at.axisZX, at.axisZY, at.axisZZ);
        normal_ = load(at.normalX, at.normalY, at.normalZ);
        capHeight_ = hn::Load(kF, at.capHeight + lane);
        start_ = project(position_);
        hn::Store(start_.x, kF, bundle.u + lane);
        hn::Store(start_.y, kF, bundle.v + lane);
        hn::Store(start_.z, kF, bundle.w + lane);
        if (in.normals) setPlanes();
        setSpread();
    }

    void block(int b) {
        const LightRays::Cells& cells = in_.cells;
        const std::size_t first =
            in_.cellsAcross ? in_.firstCell + std::size_t(b) * kLanes + std::size_t(lane_)
                            : in_.firstCell + std::size_t(b);
        const auto of = [&](const std::vector<float>& values) {
            return in_.cellsAcross ? hn::LoadU(kF, &values[first])
                                   : constant(values[first]);
        };
        const auto numbers = in_.cellsAcross ? hn::LoadU(kU, &cells.number[first])
                                             : hn::Set(kU, cells.number[first]);
        Jitter u = jitter(hn::LoadU(kU, in_.at.key + lane_), numbers);
        u.x = hn::MulAdd(u.x, of(cells.width), of(cells.u));
        u.y = hn::MulAdd(u.y, of(cells.height), of(cells.v));
        Vec3 radial;
        const Vec3 delta = towards(u, radial);
        ray(b, delta);
        if (in_.weights) weigh(b, delta, radial);
    }

  private:
    Vec3 load(const float* x, const float* y, const float* z) const {
        return {hn::Load(kF, x + lane_), hn::Load(kF, y + lane_),
                hn::Load(kF, z + lane_)};
    }

    /// Light space to straight space.
    Vec3 project(Vec3 p) const {
        const Vec su = constant(view_.scaleU), sv = constant(view_.scaleV);
        const Vec ou = constant(view_.offsetU), ov = constant(view_.offsetV);
        if (!view_.perspective)
            return {hn::MulAdd(p.x, su, ou), hn::MulAdd(p.y, sv, ov), hn::Neg(p.z)};
        const Vec w = hn::Div(constant(1.0f), p.z);
        return {hn::MulAdd(hn::Mul(p.x, su), w, ou), hn::MulAdd(hn::Mul(p.y, sv), w, ov),
                w};
    }

    /// [map.h]: a height above the tangent plane in world units, times w if perspective,
    /// is linear in straight space.
    void setPlanes() {
        const Vec a = hn::Mul(normal_.x, constant(1.0f / view_.scaleU));
        const Vec b = hn::Mul(normal_.y, constant(1.0f / view_.scaleV));
        const Vec c =
            view_.perspective ? hn::Neg(dot(normal_, position_)) : hn::Neg(normal_.z);
        hn::Store(a, kF, bundle_.planeU + lane_);
        hn::Store(b, kF, bundle_.planeV + lane_);
        hn::Store(c, kF, bundle_.planeW + lane_);
    }

    /// Pixels that a ray along d goes per w.
    Jitter slope(Vec3 d) const {
        const Vec perDepth = hn::Div(constant(1.0f), d.z);
        const Vec x = hn::Mul(d.x, perDepth), y = hn::Mul(d.y, perDepth);
        if (view_.perspective)
            return {hn::Mul(constant(view_.scaleU),
                            hn::NegMulAdd(position_.z, x, position_.x)),
                    hn::Mul(constant(view_.scaleV),
                            hn::NegMulAdd(position_.z, y, position_.y))};
        return {hn::Mul(constant(-view_.scaleU), x), hn::Mul(constant(-view_.scaleV), y)};
    }

    /// How far apart the rays are, from the light's middle and its four ends.
    void setSpread() {
        Vec3 middle = base_;
        Vec reach = constant(1.0f);
        if (in_.domain == light::LightView::Domain::cap) {
            middle = along(base_, hn::Sub(constant(1.0f), capHeight_), axisZ_);
            reach = hn::Sqrt(hn::Max(
                hn::Zero(kF), hn::Mul(capHeight_, hn::Sub(constant(2.0f), capHeight_))));
        }
        Vec lowU = constant(HUGE_VALF), lowV = lowU, highU = hn::Neg(lowU), highV = highU;
        MaskF towardsEye = hn::Lt(middle.z, hn::Zero(kF));
        for (const float side : {-1.0f, 1.0f}) {
            const Vec way = hn::Mul(constant(side), reach);
            for (const Vec3& axis : {axisX_, axisY_}) {
                const Vec3 end = along(middle, way, axis);
                towardsEye = hn::And(towardsEye, hn::Lt(end.z, hn::Zero(kF)));
                const Jitter at = slope(end);
                lowU = hn::Min(lowU, at.x), highU = hn::Max(highU, at.x);
                lowV = hn::Min(lowV, at.y), highV = hn::Max(highV, at.y);
            }
        }
        const Vec extentU = hn::Sub(highU, lowU), extentV = hn::Sub(highV, lowV);
        const Vec spread =
            hn::Sqrt(hn::Mul(hn::Mul(extentU, extentV), constant(1.0f / in_.samples)));
        const Vec slant = hn::Max(hn::Max(hn::Abs(lowU), hn::Abs(highU)),
                                  hn::Max(hn::Abs(lowV), hn::Abs(highV)));
        // Rays that lead along the map or away from the eye know no coarser level.
        hn::Store(hn::IfThenElseZero(towardsEye, spread), kF, bundle_.spread + lane_);
        hn::Store(hn::IfThenElse(towardsEye, slant, constant(HUGE_VALF)), kF,
                  bundle_.slant + lane_);
        alignas(64) float widest[kN];
        const Vec away =
            hn::Max(hn::Zero(kF), hn::Sub(constant(view_.highest), start_.z));
        const Vec widths = hn::Mul(hn::Max(extentU, extentV), away);
        hn::Store(hn::IfThenElseZero(towardsEye, widths), kF, widest);
        for (int i = 0; i < kN; ++i)
            bundle_.topLevel[lane_ + i] = levelOf(widest[i]);
    }

    /// The first level whose tiles are as wide.
    static std::uint8_t levelOf(float width) {
        int level = 0;
        for (float side = 16.0f; side < width && level < 20; side *= 2.0f)
            ++level;
        return std::uint8_t(level);
    }

    /// LightSampler::sample; `radial`: from the centre of a cap's sphere.
    Vec3 towards(Jitter u, Vec3& radial) const {
        using Domain = light::LightView::Domain;
        radial = {hn::Zero(kF), hn::Zero(kF), hn::Zero(kF)};
        if (in_.domain == Domain::square) {
            const Vec a = hn::MulSub(constant(2.0f), u.x, constant(1.0f));
            const Vec b = hn::MulSub(constant(2.0f), u.y, constant(1.0f));
            return along(along(base_, a, axisX_), b, axisY_);
        }
        const Jitter disk = onDisk(u);
        if (in_.domain == Domain::disk)
            return along(along(base_, disk.x, axisX_), disk.y, axisY_);
        // light::sampleCap.
        const Vec r2 = hn::MulAdd(disk.x, disk.x, hn::Mul(disk.y, disk.y));
        const Vec height = hn::Mul(hn::Min(constant(1.0f), r2), capHeight_);
        const Vec scale = hn::Sqrt(
            hn::Max(hn::Zero(kF), hn::Mul(capHeight_, hn::Sub(constant(2.0f), height))));
        radial = along(radial, hn::Mul(disk.x, scale), axisX_);
        radial = along(radial, hn::Mul(disk.y, scale), axisY_);
        radial = along(radial, hn::Sub(constant(1.0f), height), axisZ_);
        return along(base_, constant(1.0f), radial);
    }

    void ray(int b, Vec3 delta) {
        const Vec zero = hn::Zero(kF), one = constant(1.0f);
        // How far along delta: to the end, or to where there is nothing more to meet.
        Vec end = in_.endless ? constant(HUGE_VALF) : one;
        const auto until = [&](Vec inside, Vec change) {  // inside + t change >= 0
            const Vec t = hn::Div(inside, hn::Neg(change));
            end = hn::IfThenElse(hn::Lt(change, zero), hn::Min(end, t), end);
        };
        const Vec z = position_.z;
        until(hn::Sub(z, constant(view_.nearest)), delta.z);
        until(hn::Sub(constant(view_.farthest), z), hn::Neg(delta.z));
        sides(delta, until);
        MaskF clear =
            hn::Not(hn::And(hn::Gt(end, zero), hn::Lt(end, constant(HUGE_VALF))));
        const Vec3 last = along(position_, end, delta);
        const Vec3 to = project(last);
        hn::Store(hn::Sub(to.x, start_.x), kF, bundle_.du[b] + lane_);
        hn::Store(hn::Sub(to.y, start_.y), kF, bundle_.dv[b] + lane_);
        hn::Store(hn::Sub(to.z, start_.z), kF, bundle_.dw[b] + lane_);
        MaskF above = hn::Gt(one, zero);
        Vec begin, nearBegin;
        if (in_.normals) {
            above = hn::Gt(dot(delta, normal_), zero);
            const Vec rise = planeRise(b);
            begin = fromPlane(rise, view_.planeHeight);
            nearBegin = fromPlane(rise, view_.nearHeight);
        } else {
            const Vec start = hn::Load(kF, in_.at.start + lane_);
            begin = fromStart(delta, end, last.z, start);
            nearBegin =
                fromStart(delta, end, last.z, hn::Mul(start, constant(view_.nearStart)));
        }
        const Vec least = constant(0x1p-40f);
        if (view_.near) {
            const Vec nearEnd = endOfNear(b);
            hn::Store(nearEnd, kF, fates_.nearEnd[b] + lane_);
            hn::Store(hn::Max(hn::Max(begin, least), nearEnd), kF,
                      fates_.layersBegin[b] + lane_);
            begin = nearBegin;
        }
        hn::Store(hn::Max(begin, least), kF, bundle_.begin[b] + lane_);
        clear = hn::Or(clear, hn::Not(hn::Lt(begin, one)));
        const std::uint32_t counts = bitsOf(above), clears = bitsOf(clear) & counts;
        fates_.clear[b] |= std::uint16_t(clears << lane_);
        bundle_.open[b] |= std::uint16_t((counts & ~clears) << lane_);
    }

    /// Where the ray leaves the window for good, a pixel beyond it.
    template <typename Until>
    void sides(Vec3 delta, const Until& until) const {
        const auto inside = [&](float scale, float offset, float size, Vec x, Vec dx) {
            const Vec z = view_.perspective ? position_.z : constant(1.0f);
            const Vec dz = view_.perspective ? delta.z : hn::Zero(kF);
            const Vec s = constant(scale);
            const Vec low = constant(offset + 1.0f),
                      high = constant(size + 1.0f - offset);
            until(hn::MulAdd(s, x, hn::Mul(low, z)), hn::MulAdd(s, dx, hn::Mul(low, dz)));
            until(hn::NegMulAdd(s, x, hn::Mul(high, z)),
                  hn::NegMulAdd(s, dx, hn::Mul(high, dz)));
        };
        inside(view_.scaleU, view_.offsetU, view_.width, position_.x, delta.x);
        inside(view_.scaleV, view_.offsetV, view_.height, position_.y, delta.y);
    }

    /// How fast a ray rises above the tangent plane, in s.
    Vec planeRise(int b) const {
        const auto at = [&](const float* p) { return hn::Load(kF, p + lane_); };
        Vec rise = hn::Mul(at(bundle_.planeU), at(bundle_.du[b]));
        rise = hn::MulAdd(at(bundle_.planeV), at(bundle_.dv[b]), rise);
        return hn::MulAdd(at(bundle_.planeW), at(bundle_.dw[b]), rise);
    }
    /// s from which on the ray is high enough above it.
    static Vec fromPlane(Vec rise, float height) {
        const MaskF rises = hn::Gt(rise, hn::Zero(kF));
        return hn::IfThenElse(rises, hn::Div(constant(height), rise), constant(1.0f));
    }

    /// s at a distance from the receiver.
    Vec fromStart(Vec3 delta, Vec end, Vec lastZ, Vec distance) const {
        const Vec t = hn::Div(distance, hn::Sqrt(dot(delta, delta)));
        const Vec share = hn::Div(t, end);
        if (!view_.perspective) return share;
        const Vec z = hn::MulAdd(t, delta.z, position_.z);
        const Vec s = hn::Mul(share, hn::Div(lastZ, z));
        return hn::IfThenElse(
            hn::And(hn::Gt(z, hn::Zero(kF)), hn::Lt(share, constant(1.0f))), s,
            constant(1.0f));
    }

    /// s at which the ray leaves the depths that the near field answers for.
    Vec endOfNear(int b) const {
        const Vec depth = hn::MulAdd(constant(view_.nearPerW), hn::Abs(start_.z),
                                     constant(view_.nearConstant));
        const Vec dw = hn::Abs(hn::Load(kF, bundle_.dw[b] + lane_));
        return hn::IfThenElse(hn::Gt(dw, depth), hn::Div(depth, dw), constant(1.0f));
    }

    /// LightSample::weight times the cosine at the receiver.
    void weigh(int b, Vec3 delta, Vec3 radial) {
        const Vec zero = hn::Zero(kF);
        const Vec d2 = dot(delta, delta), length = hn::Sqrt(d2);
        Vec weight = hn::Div(hn::Max(zero, dot(delta, normal_)), length);
        if (!in_.endless) {
            weight = hn::Div(weight, d2);
            Vec3 normal{constant(in_.shines.x), constant(in_.shines.y),
                        constant(in_.shines.z)};
            MaskF cosine = hn::Gt(dot(normal, normal), zero);
            if (in_.domain == light::LightView::Domain::cap) {
                const Vec size = hn::Sqrt(dot(radial, radial));
                const Vec unit = hn::Div(constant(1.0f), size);
                normal = {hn::Mul(radial.x, unit), hn::Mul(radial.y, unit),
                          hn::Mul(radial.z, unit)};
                cosine = hn::Lt(capHeight_, constant(2.0f));  // seen from outside
            }
            const Vec facing =
                hn::Div(hn::Max(zero, hn::Neg(dot(delta, normal))), length);
            weight = hn::IfThenElse(cosine, hn::Mul(weight, facing), weight);
        }
        weight = hn::IfThenElse(hn::Gt(weight, zero), weight, zero);
        hn::Store(weight, kF, fates_.weight[b] + lane_);
    }

    const FillInput& in_;
    const LightRays::View& view_;
    int lane_;
    trace::RayBundle& bundle_;
    RayFates& fates_;
    Vec3 position_, base_, axisX_, axisY_, axisZ_, normal_, start_;
    Vec capHeight_;
};

void fill(const FillInput& in, trace::RayBundle& bundle, RayFates& fates) {
    bundle.blocks = in.blocks;
    bundle.hasPlanes = in.normals;
    bundle.planeHeight = in.view.planeHeight;
    for (int b = 0; b < in.blocks; ++b) {
        bundle.open[b] = fates.clear[b] = 0;
        for (int i = 0; i < kLanes; ++i) {
            const std::size_t cell = in.firstCell + (in.cellsAcross ? b * kLanes + i : b);
            bundle.threshold[b][i] =
                in.cells.threshold[cell] ^ std::uint8_t(in.at.key[i] >> 28);
        }
    }
    for (int lane = 0; lane < kLanes; lane += kN) {
        LanesFill lanes(in, lane, bundle, fates);
        for (int b = 0; b < in.blocks; ++b)
            lanes.block(b);
    }
    for (int b = 0; b < in.blocks; ++b) {
        const std::uint32_t left =
            in.cells.count - in.firstCell - std::uint32_t(b * kLanes);
        const int used =
            in.cellsAcross ? int(std::min(left, std::uint32_t(kLanes))) : in.at.count;
        bundle.open[b] &= std::uint16_t((1u << used) - 1);
        fates.clear[b] &= std::uint16_t((1u << used) - 1);
    }
}

}  // namespace mtsm::shadow::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::shadow {

HWY_EXPORT(fill);

namespace {

struct Cell {
    std::uint32_t row, column, columns;
    std::uint32_t before;  // cells of the rows above
};

/// Rows of cells of equal area, as square as may be, neighbours close to each other.
LightRays::Cells makeCells(std::uint32_t samples) {
    const auto rows = std::uint32_t(std::sqrt(double(samples)));
    std::vector<Cell> order;
    for (std::uint32_t row = 0; row < rows; ++row) {
        const std::uint32_t before = samples * row / rows;
        const std::uint32_t columns = samples * (row + 1) / rows - before;
        for (std::uint32_t column = 0; column < columns; ++column)
            order.push_back({row, column, columns, before});
    }
    const auto square = [](const Cell& c) { return std::pair(c.row / 4, c.column / 4); };
    std::stable_sort(order.begin(), order.end(),
                     [&](const Cell& a, const Cell& b) { return square(a) < square(b); });
    LightRays::Cells cells;
    cells.count = samples;
    for (const Cell& c : order) {
        // A 4 x 4 ordered dither matrix.
        const std::uint32_t x = c.column & 3, y = c.row & 3;
        cells.threshold.push_back(
            std::uint8_t(((x ^ y) & 1) << 3 | (y & 1) << 2 | ((x ^ y) & 2) | y >> 1));
        cells.number.push_back(c.before + c.column);
        cells.u.push_back(float(c.column) / float(c.columns));
        cells.v.push_back(float(c.before) / float(samples));
        cells.width.push_back(1.0f / float(c.columns));
        cells.height.push_back(float(c.columns) / float(samples));
    }
    const std::size_t padded = (samples + 15) / 16 * 16;
    const auto pad = [&](auto& values) { values.resize(padded, values.back()); };
    pad(cells.u), pad(cells.v), pad(cells.width), pad(cells.height);
    pad(cells.number), pad(cells.threshold);
    return cells;
}

}  // namespace

LightRays::LightRays(const Projection& p, std::uint32_t width, std::uint32_t height,
                     ZRange depths, const light::LightSampler& light,
                     const Setting& setting)
    : cells_(makeCells(setting.samples)), setting_(setting) {
    view_.perspective = p.kind == ProjectionKind::perspective;
    view_.scaleU = float(p.scale.x), view_.scaleV = float(p.scale.y);
    view_.offsetU = float(p.offset.x), view_.offsetV = float(p.offset.y);
    // Planes of patches reach a little beyond the layers themselves.
    const double margin = 4.0;
    const auto footprint = [&](double z) { return p.pixelFootprint(std::abs(z)); };
    const double nearest = depths.min - margin * footprint(depths.min);
    view_.nearest =
        float(view_.perspective ? std::max(nearest, 0.5 * depths.min) : nearest);
    view_.farthest = float(depths.max + margin * footprint(depths.max));
    view_.width = float(width), view_.height = float(height);
    view_.highest = view_.perspective ? 1.0f / view_.nearest : -view_.nearest;
    view_.planeHeight = float(setting.height * p.pixelFootprint(1.0));
    view_.near = setting.nearDepth > 0.0;
    view_.nearHeight = float(setting.nearHeight * p.pixelFootprint(1.0));
    view_.nearStart = float(setting.nearStart);
    const auto nearDepth = float(setting.nearDepth * p.pixelFootprint(1.0));
    view_.nearPerW = view_.perspective ? nearDepth : 0.0f;
    view_.nearConstant = view_.perspective ? 0.0f : nearDepth;
    const light::LightView seen = light.view(p.eye + p.forward);
    domain_ = seen.domain;
    endless_ = seen.endless;
    shines_ = glm::vec3(p.lightFromWorldDirection(light.shines()));
}

std::uint32_t LightRays::bundles(Layout layout) const noexcept {
    const std::uint32_t each =
        trace::kMostBlocks * (layout == Layout::cells ? trace::kLanes : 1);
    return (cells_.count + each - 1) / each;
}

void LightRays::fill(const ReceiverLanes& receivers, Layout layout, std::uint32_t index,
                     trace::RayBundle& bundle, RayFates& fates) const noexcept {
    const bool across = layout == Layout::cells;
    const std::uint32_t perBlock = across ? trace::kLanes : 1;
    const std::uint32_t first = index * trace::kMostBlocks * perBlock;
    const std::uint32_t blocks = (cells_.count - first + perBlock - 1) / perBlock;
    const FillInput input{receivers,
                          view_,
                          cells_,
                          first,
                          int(std::min(blocks, std::uint32_t(trace::kMostBlocks))),
                          across,
                          domain_,
                          endless_,
                          setting_.normals,
                          setting_.weights,
                          shines_,
                          float(cells_.count)};
    HWY_DYNAMIC_DISPATCH(fill)(input, bundle, fates);
}

}  // namespace mtsm::shadow
#endif
