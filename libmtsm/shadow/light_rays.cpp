#include "shadow/light_rays.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "base/sampling.h"
#include "shadow/pixel_share.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadow/light_rays.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "trace/density_tree.h"
#include "trace/lanes-inl.h"

#ifndef MTSM_SHADOW_LIGHT_RAYS_INPUT
#define MTSM_SHADOW_LIGHT_RAYS_INPUT
namespace mtsm::shadow {

/// What one call of fill works on.
struct FillInput {
    const ReceiverLanes& at;
    const LightRays::View& view;
    const LightRays::Points& points;
    int samples, firstGroup, groups;
    float among;  // samples that these are neighbours of
    light::LightView::Domain domain;
    bool endless, normals, weights, media, sheets, ways;
    glm::vec3 shines;
};

}  // namespace mtsm::shadow
#endif

HWY_BEFORE_NAMESPACE();
namespace mtsm::shadow::HWY_NAMESPACE {
namespace lanes = trace::HWY_NAMESPACE;
namespace hn = hwy::HWY_NAMESPACE;

using lanes::bitsOf, lanes::fusedDot, lanes::maskOf, lanes::reciprocal;
using lanes::Floats, lanes::Vec, lanes::Vec3;
using trace::kLanes;
using Bits = hn::RebindToUnsigned<Floats>;
using MaskF = lanes::Mask;
constexpr Floats kF;
constexpr Bits kU;
constexpr int kN = int(hn::MaxLanes(kF));

/// a + s b
HWY_INLINE Vec3 along(Vec3 a, Vec s, Vec3 b) {
    return {hn::MulAdd(s, b.x, a.x), hn::MulAdd(s, b.y, a.y), hn::MulAdd(s, b.z, a.z)};
}
HWY_INLINE Vec constant(float x) {
    return hn::Set(kF, x);
}

struct Pair {
    Vec x, y;
};

/// Light space to straight space.
HWY_INLINE Vec3 project(const LightRays::View& view, Vec3 p) {
    const Vec su = constant(view.scaleU), sv = constant(view.scaleV);
    const Vec ou = constant(view.offsetU), ov = constant(view.offsetV);
    if (!view.perspective)
        return {hn::MulAdd(p.x, su, ou), hn::MulAdd(p.y, sv, ov), hn::Neg(p.z)};
    const Vec w = reciprocal(p.z);
    return {hn::MulAdd(hn::Mul(p.x, su), w, ou), hn::MulAdd(hn::Mul(p.y, sv), w, ov), w};
}

/// A place on the border of a joined face is moved inside, in either face: so what runs
/// along it is in both and not, by rounding, in none.
HWY_INLINE Vec offBorder(Vec x, float size, float border) {
    const Vec b = constant(border), end = constant(size);
    x = hn::IfThenElse(hn::Lt(hn::Abs(x), b), b, x);
    return hn::IfThenElse(hn::Lt(hn::Abs(hn::Sub(x, end)), b), hn::Sub(end, b), x);
}
HWY_INLINE Vec3 offBorder(const LightRays::View& view, Vec3 p) {
    if (view.border == 0.0f) return p;
    return {offBorder(p.x, view.width, view.border),
            offBorder(p.y, view.height, view.border), p.z};
}

/// What holds for all rays of a receiver; as many receivers as a vector holds.
class Starts {
  public:
    Starts(const FillInput& in, int first, trace::RayBundle& bundle)
        : in_(in), view_(in.view), first_(first), bundle_(bundle) {
        const ReceiverLanes& at = in.at;
        position_ = load(at.x, at.y, at.z);
        base_ = load(at.baseX, at.baseY, at.baseZ);
        axisX_ = load(at.axisXX, at.axisXY, at.axisXZ);
        axisY_ = load(at.axisYX, at.axisYY, at.axisYZ);
        axisZ_ = load(at.axisZX, at.axisZY, at.axisZZ);
        normal_ = load(at.normalX, at.normalY, at.normalZ);
        capHeight_ = hn::Load(kF, at.capHeight + first);
        start_ = offBorder(view_, project(view_, position_));
        hn::Store(start_.x, kF, bundle.u + first);
        hn::Store(start_.y, kF, bundle.v + first);
        hn::Store(start_.z, kF, bundle.w + first);
        if (in.normals) setPlanes();
        setSlopes();
    }

  private:
    Vec3 load(const float* x, const float* y, const float* z) const {
        return {hn::Load(kF, x + first_), hn::Load(kF, y + first_),
                hn::Load(kF, z + first_)};
    }

    /// [map.h]: a height above the tangent plane in world units, times w if perspective,
    /// is linear in straight space.
    void setPlanes() {
        const Vec size = hn::Div(constant(1.0f), hn::Sqrt(fusedDot(normal_, normal_)));
        normal_ = {hn::Mul(normal_.x, size), hn::Mul(normal_.y, size),
                   hn::Mul(normal_.z, size)};
        const Vec a = hn::Mul(normal_.x, constant(1.0f / view_.scaleU));
        const Vec b = hn::Mul(normal_.y, constant(1.0f / view_.scaleV));
        const Vec c = view_.perspective ? hn::Neg(fusedDot(normal_, position_))
                                        : hn::Neg(normal_.z);
        hn::Store(a, kF, bundle_.planeU + first_);
        hn::Store(b, kF, bundle_.planeV + first_);
        hn::Store(c, kF, bundle_.planeW + first_);
    }

    /// Pixels that a ray along d goes per w.
    Pair slope(Vec3 d) const {
        const Vec perDepth = reciprocal(d.z);
        const Vec x = hn::Mul(d.x, perDepth), y = hn::Mul(d.y, perDepth);
        if (view_.perspective)
            return {hn::Mul(constant(view_.scaleU),
                            hn::NegMulAdd(position_.z, x, position_.x)),
                    hn::Mul(constant(view_.scaleV),
                            hn::NegMulAdd(position_.z, y, position_.y))};
        return {hn::Mul(constant(-view_.scaleU), x), hn::Mul(constant(-view_.scaleV), y)};
    }

    /// The least and the most slopes.
    struct Slopes {
        Vec lowU, highU, lowV, highV;
        MaskF towardsEye;
    };

    /// Of the light's square, or of the square around its disk; of a cap
    /// (light::sampleCap) of the box around it, from its summit down: no wider than its
    /// rim or the sphere.
    Slopes ofLight() const {
        const Vec never = constant(HUGE_VALF);
        Slopes slopes{never, hn::Neg(never), never, hn::Neg(never), hn::Eq(never, never)};
        const bool cap = in_.domain == light::LightView::Domain::cap;
        Vec side = constant(1.0f);
        if (cap) {
            const Vec h = hn::Min(capHeight_, side);
            side = hn::Sqrt(hn::Mul(h, hn::Sub(constant(2.0f), h)));
        }
        for (int plane = 0; plane < (cap ? 2 : 1); ++plane) {
            const Vec below = plane == 0 ? hn::Zero(kF) : capHeight_;
            const Vec3 middle =
                cap ? along(base_, hn::Sub(constant(1.0f), below), axisZ_) : base_;
            for (const Vec x : {hn::Neg(side), side}) {
                for (const Vec y : {hn::Neg(side), side}) {
                    const Vec3 end = along(along(middle, x, axisX_), y, axisY_);
                    slopes.towardsEye =
                        hn::And(slopes.towardsEye, hn::Lt(end.z, hn::Zero(kF)));
                    const Pair at = slope(end);
                    slopes.lowU = hn::Min(slopes.lowU, at.x);
                    slopes.highU = hn::Max(slopes.highU, at.x);
                    slopes.lowV = hn::Min(slopes.lowV, at.y);
                    slopes.highV = hn::Max(slopes.highV, at.y);
                }
            }
        }
        // Rays themselves are rounded; and of a deep receiver a slope is the small
        // difference of its place and as large a way.
        const Vec more = constant(1.0f + 0x1p-18f), less = constant(1.0f - 0x1p-18f);
        const auto grow = [&](Vec& low, Vec& high, Vec place, float scale) {
            const Vec zero = hn::Zero(kF);
            const Vec margin = view_.perspective
                                   ? hn::Mul(hn::Abs(place), constant(scale * 0x1p-21f))
                                   : zero;
            low = hn::Mul(low, hn::IfThenElse(hn::Lt(low, zero), more, less));
            high = hn::Mul(high, hn::IfThenElse(hn::Lt(high, zero), less, more));
            low = hn::Sub(low, margin);
            high = hn::Add(high, margin);
        };
        grow(slopes.lowU, slopes.highU, position_.x, std::abs(view_.scaleU));
        grow(slopes.lowV, slopes.highV, position_.y, std::abs(view_.scaleV));
        return slopes;
    }

    /// Of the light, in slopes.
    Vec area() const {
        using Domain = light::LightView::Domain;
        Vec3 centre = base_;
        if (in_.domain == Domain::cap)
            centre = along(base_, hn::Sub(constant(1.0f), capHeight_), axisZ_);
        const Pair middle = slope(centre);
        const Pair x = slope(along(centre, constant(1.0f), axisX_));
        const Pair y = slope(along(centre, constant(1.0f), axisY_));
        const Vec product =
            hn::Sub(hn::Mul(hn::Sub(x.x, middle.x), hn::Sub(y.y, middle.y)),
                    hn::Mul(hn::Sub(x.y, middle.y), hn::Sub(y.x, middle.x)));
        const Vec size =
            hn::Mul(hn::Abs(product),
                    constant(in_.domain == Domain::square ? 4.0f : 3.14159265f));
        if (in_.domain != Domain::cap) return size;
        return hn::Mul(size, hn::Mul(capHeight_, hn::Sub(constant(2.0f), capHeight_)));
    }

    void setSlopes() {
        const Slopes slopes = ofLight();
        // Rays that lead along the map or away from the eye have no bounds.
        const MaskF bounded = slopes.towardsEye;
        const auto keep = [&](Vec value, float* to) {
            hn::Store(hn::IfThenElseZero(bounded, value), kF, to + first_);
        };
        keep(slopes.lowU, bundle_.slopeLowU), keep(slopes.highU, bundle_.slopeHighU);
        keep(slopes.lowV, bundle_.slopeLowV), keep(slopes.highV, bundle_.slopeHighV);
        bundle_.wide |= std::uint16_t((bitsOf(bounded) ^ ((1u << kN) - 1)) << first_);
        const auto steepest = [](Vec low, Vec high) {
            return hn::Max(hn::Abs(low), hn::Abs(high));
        };
        keep(hn::Max(steepest(slopes.lowU, slopes.highU),
                     steepest(slopes.lowV, slopes.highV)),
             bundle_.slant);
        const Vec extentU = hn::Sub(slopes.highU, slopes.lowU);
        const Vec extentV = hn::Sub(slopes.highV, slopes.lowV);
        const Vec lightArea = area();
        keep(hn::Sqrt(hn::Mul(lightArea, constant(1.0f / in_.among))), bundle_.spread);
        Vec depth = hn::MulAdd(constant(view_.nearPerW), hn::Abs(start_.z),
                               constant(view_.nearConstant));
        if (view_.nearWidth > 0.0f) {
            const Vec least = hn::Mul(depth, constant(view_.nearLeast));
            const Vec wide = hn::Div(constant(view_.nearWidth), hn::Sqrt(lightArea));
            const Vec otherwise = in_.media ? hn::Zero(kF) : least;
            depth =
                hn::IfThenElse(bounded, hn::Max(least, hn::Min(depth, wide)), otherwise);
        }
        hn::Store(depth, kF, bundle_.rise + first_);
        alignas(64) float widest[kN];
        const Vec away =
            hn::Max(hn::Zero(kF), hn::Sub(constant(view_.highest), start_.z));
        const Vec widths = hn::Mul(hn::Max(extentU, extentV), away);
        hn::Store(hn::IfThenElseZero(bounded, widths), kF, widest);
        for (int i = 0; i < kN; ++i)
            bundle_.topLevel[first_ + i] = levelOf(widest[i]);
    }

    /// The first level whose tiles are as wide.
    static std::uint8_t levelOf(float width) {
        int level = 0;
        for (float side = 16.0f; side < width && level < 20; side *= 2.0f)
            ++level;
        return std::uint8_t(level);
    }

    const FillInput& in_;
    const LightRays::View& view_;
    int first_;
    trace::RayBundle& bundle_;
    Vec3 position_, base_, axisX_, axisY_, axisZ_, normal_, start_;
    Vec capHeight_;
};

/// The receivers that the lanes of a vector belong to: all to one; or, if each has a few
/// rays, lane after lane, to as many as there is room for.
class Owners {
  public:
    explicit Owners(int receiver) : first_(receiver) {}
    Owners(int lane, int each)
        : first_(lane / each / kN * kN), single_(false), index_(indices(lane, each)) {}

    [[nodiscard]] Vec operator()(const float* p) const {
        if (single_) return constant(p[first_]);
        return hn::TableLookupLanes(hn::Load(kF, p + first_), index_);
    }

  private:
    using Index =
        decltype(hn::IndicesFromVec(kF, hn::Zero(trace::HWY_NAMESPACE::Ints())));
    [[nodiscard]] Index indices(int lane, int each) const {
        alignas(64) std::int32_t index[kN];
        for (int i = 0; i < kN; ++i)
            index[i] = (lane + i) / each - first_;
        return hn::IndicesFromVec(kF, hn::Load(lanes::Ints(), index));
    }

    int first_;
    bool single_ = true;
    Index index_;
};

/// Rays of some receivers.
class Rays {
  public:
    Rays(const FillInput& in, const Owners& owners, trace::RayBundle& bundle,
         RayFates& fates)
        : in_(in), view_(in.view), bundle_(bundle), fates_(fates) {
        const ReceiverLanes& at = in.at;
        const auto set = [&](const float* x, const float* y, const float* z) {
            return Vec3{owners(x), owners(y), owners(z)};
        };
        position_ = set(at.x, at.y, at.z);
        base_ = set(at.baseX, at.baseY, at.baseZ);
        axisX_ = set(at.axisXX, at.axisXY, at.axisXZ);
        axisY_ = set(at.axisYX, at.axisYY, at.axisYZ);
        axisZ_ = set(at.axisZX, at.axisZY, at.axisZZ);
        normal_ = set(at.normalX, at.normalY, at.normalZ);
        start_ = set(bundle.u, bundle.v, bundle.w);
        plane_ = set(bundle.planeU, bundle.planeV, bundle.planeW);
        capHeight_ = owners(at.capHeight);
        surfaceStart_ = owners(at.surfaceStart);
        mediaStart_ = owners(at.mediaStart);
        nearDepth_ = owners(bundle.rise);
    }

    /// Those to points number first and on, of Points, to a row of the bundle.
    void row(int row, std::size_t first) {
        bundle_.open[row] = fates_.clear[row] = 0;
        for (int i = 0; i < kLanes; i += kN) {
            part(row, i,
                 {hn::LoadU(kF, &in_.points.a[first + std::size_t(i)]),
                  hn::LoadU(kF, &in_.points.b[first + std::size_t(i)])});
        }
    }
    /// Those of a vector, from lane i of a row on.
    void part(int row, int i, const Pair& point) {
        Vec3 radial;
        const Vec3 delta = towards(point, radial);
        ray(row, i, delta);
        if (in_.weights) weigh(row, i, delta, radial);
    }

  private:
    /// LightSampler::sample; `radial`: from the centre of a cap's sphere.
    Vec3 towards(Pair u, Vec3& radial) const {
        using Domain = light::LightView::Domain;
        radial = {hn::Zero(kF), hn::Zero(kF), hn::Zero(kF)};
        if (in_.domain != Domain::cap)
            return along(along(base_, u.x, axisX_), u.y, axisY_);
        // light::sampleCap.
        const Vec r2 = hn::MulAdd(u.x, u.x, hn::Mul(u.y, u.y));
        const Vec height = hn::Mul(hn::Min(constant(1.0f), r2), capHeight_);
        const Vec scale = hn::Sqrt(
            hn::Max(hn::Zero(kF), hn::Mul(capHeight_, hn::Sub(constant(2.0f), height))));
        radial = along(radial, hn::Mul(u.x, scale), axisX_);
        radial = along(radial, hn::Mul(u.y, scale), axisY_);
        radial = along(radial, hn::Sub(constant(1.0f), height), axisZ_);
        return along(base_, constant(1.0f), radial);
    }

    void ray(int row, int i, Vec3 delta) {
        const Vec zero = hn::Zero(kF), one = constant(1.0f);
        // How far along delta: to the end, or to where there is nothing more to meet.
        Vec end = in_.endless ? constant(HUGE_VALF) : one;
        const auto until = [&](Vec inside, Vec change) {  // inside + t change >= 0
            const Vec t = hn::Neg(hn::Mul(inside, reciprocal(change)));
            end = hn::IfThenElse(hn::Lt(change, zero), hn::Min(end, t), end);
        };
        const Vec z = position_.z;
        until(hn::Sub(z, constant(view_.nearest)), delta.z);
        if (!hn::AllTrue(kF, hn::Le(delta.z, zero)))
            until(hn::Sub(constant(view_.farthest), z), hn::Neg(delta.z));
        Vec3 last = along(position_, end, delta);
        Vec3 to = project(view_, last);
        if (const MaskF inside = inWindow(to); !hn::AllTrue(kF, inside)) {
            const Vec whole = end;
            sides(delta, until);
            end = hn::IfThenElse(inside, whole, end);
            last = along(position_, end, delta);
            to = project(view_, last);
        }
        to = offBorder(view_, to);
        if (in_.ways) {
            hn::Store(delta.x, kF, fates_.delta[0][row] + i);
            hn::Store(delta.y, kF, fates_.delta[1][row] + i);
            hn::Store(delta.z, kF, fates_.delta[2][row] + i);
            hn::Store(end, kF, fates_.way[row] + i);
        }
        MaskF clear =
            hn::Not(hn::And(hn::Gt(end, zero), hn::Lt(end, constant(HUGE_VALF))));
        const Vec3 way{hn::Sub(to.x, start_.x), hn::Sub(to.y, start_.y),
                       hn::Sub(to.z, start_.z)};
        hn::Store(way.x, kF, bundle_.du[row] + i);
        hn::Store(way.y, kF, bundle_.dv[row] + i);
        hn::Store(way.z, kF, bundle_.dw[row] + i);
        MaskF above = hn::Gt(one, zero);
        Vec begin, nearBegin, surfaces;
        if (in_.normals) {
            above = hn::Gt(fusedDot(delta, normal_), zero);
            // How fast the ray rises above the tangent plane, in s.
            const Vec rise = fusedDot(plane_, way);
            const Vec per =
                hn::IfThenElse(hn::Gt(rise, zero), reciprocal(rise), constant(HUGE_VALF));
            begin = surfaces = hn::Mul(constant(view_.planeHeight), per);
            if (in_.media) {
                // What is met within the bias must be further than twice that from the
                // receiver's own surface, measured in depth. Beside a near field texels
                // are larger, and the bias with them.
                const auto texel =
                    float(view_.near ? 1u << trace::kFinestBesideNear : 1u);
                Vec depth = hn::Mul(constant(0.4f * texel), surfaceStart_);
                if (view_.perspective)
                    depth = hn::Mul(depth, hn::Mul(start_.z, start_.z));
                surfaces =
                    hn::Max(begin, hn::Mul(hn::Mul(depth, hn::Abs(plane_.z)), per));
                if (in_.sheets) begin = surfaces;
            }
            nearBegin = hn::Mul(constant(view_.nearHeight), per);
        } else {
            const Vec start = surfaceStart_;
            begin = surfaces = fromStart(delta, end, last.z, start);
            nearBegin =
                fromStart(delta, end, last.z, hn::Mul(start, constant(view_.nearStart)));
            if (in_.media) begin = fromStart(delta, end, last.z, mediaStart_);
        }
        const Vec least = constant(0x1p-40f);
        if (view_.near) {
            const Vec nearEnd = endOfNear(way.z);
            hn::Store(nearEnd, kF, fates_.nearEnd[row] + i);
            hn::Store(hn::Max(hn::Max(begin, least), nearEnd), kF,
                      fates_.layersBegin[row] + i);
            begin = nearBegin;
            surfaces = hn::Max(surfaces, nearEnd);
        }
        if (in_.media)
            hn::Store(hn::Max(surfaces, least), kF, bundle_.beginSurfaces[row] + i);
        hn::Store(hn::Max(begin, least), kF, bundle_.begin[row] + i);
        clear = hn::Or(clear, hn::Not(hn::Lt(begin, one)));
        const std::uint32_t counts = bitsOf(above), clears = bitsOf(clear) & counts;
        fates_.clear[row] |= std::uint16_t(clears << i);
        bundle_.open[row] |= std::uint16_t((counts & ~clears) << i);
    }

    /// Ends that need no cutting off.
    [[nodiscard]] MaskF inWindow(const Vec3& p) const {
        const Vec margin = constant(-view_.width);
        return hn::And(
            hn::And(hn::Ge(p.x, margin), hn::Le(p.x, constant(2.0f * view_.width))),
            hn::And(hn::Ge(p.y, margin), hn::Le(p.y, constant(2.0f * view_.width))));
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

    /// s at a distance from the receiver.
    Vec fromStart(Vec3 delta, Vec end, Vec lastZ, Vec distance) const {
        const Vec t = hn::Div(distance, hn::Sqrt(fusedDot(delta, delta)));
        const Vec share = hn::Div(t, end);
        if (!view_.perspective) return share;
        const Vec z = hn::MulAdd(t, delta.z, position_.z);
        const Vec s = hn::Mul(share, hn::Div(lastZ, z));
        return hn::IfThenElse(
            hn::And(hn::Gt(z, hn::Zero(kF)), hn::Lt(share, constant(1.0f))), s,
            constant(1.0f));
    }

    /// s at which the ray leaves the depths that the near field answers for.
    Vec endOfNear(Vec rise) const {
        const Vec depth = nearDepth_;
        const Vec dw = hn::Abs(rise);
        return hn::IfThenElse(hn::Gt(dw, depth), hn::Mul(depth, reciprocal(dw)),
                              constant(1.0f));
    }

    /// LightSample::weight times the cosine at the receiver.
    void weigh(int row, int i, Vec3 delta, Vec3 radial) {
        const Vec zero = hn::Zero(kF);
        const Vec d2 = fusedDot(delta, delta), length = hn::Sqrt(d2);
        const Vec facingLight =
            hn::Div(fusedDot(delta, normal_), hn::Sqrt(fusedDot(normal_, normal_)));
        Vec weight = hn::Div(hn::Max(zero, facingLight), length);
        if (!in_.endless) {
            weight = hn::Div(weight, d2);
            Vec3 normal{constant(in_.shines.x), constant(in_.shines.y),
                        constant(in_.shines.z)};
            MaskF cosine = hn::Gt(fusedDot(normal, normal), zero);
            if (in_.domain == light::LightView::Domain::cap) {
                const Vec size = hn::Sqrt(fusedDot(radial, radial));
                const Vec unit = hn::Div(constant(1.0f), size);
                normal = {hn::Mul(radial.x, unit), hn::Mul(radial.y, unit),
                          hn::Mul(radial.z, unit)};
                cosine = hn::Lt(capHeight_, constant(2.0f));  // seen from outside
            }
            const Vec facing =
                hn::Div(hn::Max(zero, hn::Neg(fusedDot(delta, normal))), length);
            weight = hn::IfThenElse(cosine, hn::Mul(weight, facing), weight);
        }
        // Of thousands the sum must be a number.
        weight = hn::Min(weight, constant(0x1p100f));
        weight = hn::IfThenElse(hn::Gt(weight, zero), weight, zero);
        hn::Store(weight, kF, fates_.weight[row] + i);
    }

    const FillInput& in_;
    const LightRays::View& view_;
    trace::RayBundle& bundle_;
    RayFates& fates_;
    Vec3 position_, base_, axisX_, axisY_, axisZ_, normal_, start_, plane_;
    Vec capHeight_, surfaceStart_, mediaStart_, nearDepth_;
};

/// Thresholds of a row. Points that follow each other lie close together: those that
/// differ most, which are the bits of 0 to 15 in reverse.
void setThresholds(std::uint32_t key, std::uint8_t* thresholds) {
    const std::uint64_t turn = (key >> 28) * 0x0101010101010101u;
    const std::uint64_t far[2] = {0x0e060a020c040800u ^ turn, 0x0f070b030d050901u ^ turn};
    std::memcpy(thresholds, far, sizeof far);
}

/// A few rays go sideways much less than all that the light may have.
void boundFew(int count, int each, trace::RayBundle& bundle) {
    constexpr int kFirst = trace::kMostReceivers;
    alignas(64) float u[trace::kMostReceivers * 4], v[trace::kMostReceivers * 4];
    for (int i = 0; i < count * each; i += kN) {
        const int row = kFirst + i / kLanes, lane = i % kLanes;
        const Vec per = hn::Div(constant(1.0f), hn::Load(kF, bundle.dw[row] + lane));
        hn::Store(hn::Mul(hn::Load(kF, bundle.du[row] + lane), per), kF, u + i);
        hn::Store(hn::Mul(hn::Load(kF, bundle.dv[row] + lane), per), kF, v + i);
    }
    for (int receiver = 0; receiver < count; ++receiver) {
        std::uint32_t open = bundle.open[receiver];
        if (open == 0 || (bundle.wide >> receiver & 1)) continue;
        float low[2] = {HUGE_VALF, HUGE_VALF}, high[2] = {-HUGE_VALF, -HUGE_VALF};
        for (; open; open &= open - 1) {
            const int i = receiver * each + std::countr_zero(open);
            low[0] = std::min(low[0], u[i]), high[0] = std::max(high[0], u[i]);
            low[1] = std::min(low[1], v[i]), high[1] = std::max(high[1], v[i]);
        }
        // What a slope is rounded by, many times.
        const auto grow = [](float& least, float& most) {
            const float margin = std::max(std::abs(least), std::abs(most)) * 0x1p-18f;
            least -= margin, most += margin;
        };
        grow(low[0], high[0]), grow(low[1], high[1]);
        if (!(high[0] - low[0] < HUGE_VALF && high[1] - low[1] < HUGE_VALF)) continue;
        bundle.slopeLowU[receiver] = low[0], bundle.slopeHighU[receiver] = high[0];
        bundle.slopeLowV[receiver] = low[1], bundle.slopeHighV[receiver] = high[1];
    }
}

/// To the first of a row's lanes; the others are zero.
template <int kEach>
HWY_INLINE void moveFew(const float* from, float* row) {
    for (int i = 0; i < kLanes; i += kN)
        hn::Store(hn::Zero(kF), kF, row + i);
    for (int i = 0; i < kEach; ++i)
        row[i] = from[i];
}

/// A few rays each: those of several receivers in a vector, in rows that are free, and
/// then to the rows that they belong to.
template <int kEach>
void fillFew(const FillInput& in, trace::RayBundle& bundle, RayFates& fates) {
    constexpr int kFirst = trace::kMostReceivers;
    const LightRays::Points& points = in.points;
    const auto firstOf = [&](int receiver) {
        return std::size_t(points.onlyOne ? 0u : in.at.pattern[receiver]) * points.each +
               std::size_t(in.firstGroup) * kLanes;
    };
    const int count = in.at.count * kEach;
    for (int row = kFirst; row < kFirst + kEach; ++row)
        bundle.open[row] = fates.clear[row] = 0;
    for (int lane = 0; lane < count; lane += kN) {
        alignas(64) float a[kN], b[kN];
        for (int i = 0; i < kN; ++i) {
            const int receiver = std::min((lane + i) / kEach, in.at.count - 1);
            const std::size_t at = firstOf(receiver) + std::size_t((lane + i) % kEach);
            a[i] = points.a[at], b[i] = points.b[at];
        }
        Rays(in, Owners(lane, kEach), bundle, fates)
            .part(kFirst + lane / kLanes, lane % kLanes,
                  {hn::Load(kF, a), hn::Load(kF, b)});
    }
    const std::uint32_t there = (1u << in.samples) - 1;
    for (int receiver = 0; receiver < in.at.count; ++receiver) {
        const int from = kFirst + receiver * kEach / kLanes;
        const int first = receiver * kEach % kLanes;
        const auto move = [&](float(*field)[kLanes]) {
            moveFew<kEach>(field[from] + first, field[receiver]);
        };
        move(bundle.du), move(bundle.dv), move(bundle.dw), move(bundle.begin);
        if (in.media) move(bundle.beginSurfaces);
        if (in.view.near) move(fates.nearEnd), move(fates.layersBegin);
        if (in.weights) move(fates.weight);
        for (int axis = 0; in.ways && axis < 3; ++axis)
            move(fates.delta[axis]);
        if (in.ways) move(fates.way);
        bundle.open[receiver] = std::uint16_t(bundle.open[from] >> first & there);
        fates.clear[receiver] = std::uint16_t(fates.clear[from] >> first & there);
    }
    boundFew(in.at.count, kEach, bundle);
}

/// The least of each of four vectors.
HWY_INLINE void leastOf(Vec a, Vec b, Vec c, Vec d, float (&least)[4]) {
#if HWY_TARGET == HWY_SCALAR
    const Vec all[] = {a, b, c, d};
    for (int i = 0; i < 4; ++i)
        least[i] = hn::GetLane(all[i]);
#else
    // Halves of each two in a vector, then quarters of all four.
    const auto halves = [](Vec x, Vec y) {
        return hn::Min(hn::InterleaveLower(kF, x, y), hn::InterleaveUpper(kF, x, y));
    };
    const hn::Repartition<std::uint64_t, Floats> pairs;
    const auto ab = hn::BitCast(pairs, halves(a, b));
    const auto cd = hn::BitCast(pairs, halves(c, d));
    const Vec quarters = hn::Min(hn::BitCast(kF, hn::InterleaveLower(pairs, ab, cd)),
                                 hn::BitCast(kF, hn::InterleaveUpper(pairs, ab, cd)));
    alignas(64) float parts[kN];
    hn::Store(quarters, kF, parts);
    for (int i = 0; i < 4; ++i)
        least[i] = parts[i];
    for (int k = 4; k < kN; ++k)
        least[k % 4] = std::min(least[k % 4], parts[k]);
#endif
}

/// What the open rays of a row go sideways. Of one that hardly rises no more is known
/// than of all the light.
trace::RayBundle::Slopes slopesOf(const trace::RayBundle& bundle, int receiver, int row) {
    const Vec never = constant(HUGE_VALF);
    Vec u = never, v = never, minusU = never, minusV = never;
    std::uint32_t level = 0;
    for (int i = 0; i < kLanes; i += kN) {
        const Vec dw = hn::Load(kF, bundle.dw[row] + i), per = reciprocal(dw);
        const Vec du = hn::Mul(hn::Load(kF, bundle.du[row] + i), per);
        const Vec dv = hn::Mul(hn::Load(kF, bundle.dv[row] + i), per);
        const MaskF asked = maskOf(std::uint32_t(bundle.open[row]) >> i);
        const MaskF open = hn::And(asked, hn::Gt(dw, constant(0x1p-124f)));
        level |= bitsOf(hn::AndNot(open, asked));
        u = hn::Min(u, hn::IfThenElse(open, du, never));
        v = hn::Min(v, hn::IfThenElse(open, dv, never));
        minusU = hn::Min(minusU, hn::IfThenElse(open, hn::Neg(du), never));
        minusV = hn::Min(minusV, hn::IfThenElse(open, hn::Neg(dv), never));
    }
    if (level != 0)
        return {bundle.slopeLowU[receiver], bundle.slopeHighU[receiver],
                bundle.slopeLowV[receiver], bundle.slopeHighV[receiver]};
    if (bundle.open[row] == 0) return {};
    float least[4];
    leastOf(u, minusU, v, minusV, least);
    // What a slope is rounded by, many times.
    for (float& x : least)
        x -= std::abs(x) * 0x1p-18f + 0x1p-80f;
    return {least[0], -least[1], least[2], -least[3]};
}

/// Half of what their part of the light may have.
void boundRows(trace::RayBundle& bundle) {
    for (int group = 0; group < bundle.groups; ++group)
        bundle.clearGroup(group);
    for (int receiver = 0; receiver < bundle.receivers; ++receiver) {
        for (int group = 0; group < bundle.groups; ++group)
            bundle.boundRow(receiver, group,
                            slopesOf(bundle, receiver, bundle.row(receiver, group)));
    }
}

/// The rays of one row go sideways somewhat less than all the light has, and of a
/// receiver whose horizon cuts the light much less.
void boundReceiver(int receiver, trace::RayBundle& bundle) {
    if (bundle.open[receiver] == 0 || (bundle.wide >> receiver & 1)) return;
    const trace::RayBundle::Slopes slopes = slopesOf(bundle, receiver, receiver);
    bundle.slopeLowU[receiver] = slopes.lowU, bundle.slopeHighU[receiver] = slopes.highU;
    bundle.slopeLowV[receiver] = slopes.lowV, bundle.slopeHighV[receiver] = slopes.highV;
}

/// All the rays of each receiver in turn.
void fillMany(const FillInput& in, trace::RayBundle& bundle, RayFates& fates) {
    for (int receiver = 0; receiver < in.at.count; ++receiver) {
        Rays rays(in, Owners(receiver), bundle, fates);
        const std::uint32_t pattern = in.points.onlyOne ? 0u : in.at.pattern[receiver];
        for (int group = 0; group < in.groups; ++group) {
            const int number = in.firstGroup + group, row = bundle.row(receiver, group);
            rays.row(row, std::size_t(pattern) * in.points.each +
                              std::size_t(number) * kLanes);
            const int left = in.samples - number * kLanes;
            if (left >= kLanes) continue;
            bundle.open[row] &= std::uint16_t((1u << left) - 1);
            fates.clear[row] &= std::uint16_t((1u << left) - 1);
        }
        // Of a light that is no wider than a tile of patches, and of media, there is
        // nothing to gain.
        if (in.groups == 1 && !in.media && bundle.topLevel[receiver] > 0)
            boundReceiver(receiver, bundle);
    }
    if (in.groups > 1) boundRows(bundle);
}

void fill(const FillInput& in, trace::RayBundle& bundle, RayFates& fates) {
    bundle.receivers = in.at.count;
    bundle.groups = in.groups;
    bundle.hasPlanes = in.normals;
    bundle.planeHeight = in.view.planeHeight;
    bundle.wide = 0;
    for (int first = 0; first < trace::kMostReceivers; first += kN)
        Starts(in, first, bundle);
    if (in.samples == 1)
        fillFew<1>(in, bundle, fates);
    else if (in.samples == 2)
        fillFew<2>(in, bundle, fates);
    else if (in.samples <= 4)
        fillFew<4>(in, bundle, fates);
    else
        fillMany(in, bundle, fates);
    for (int receiver = 0; receiver < in.at.count; ++receiver) {
        for (int group = 0; group < in.groups; ++group)
            setThresholds(in.at.key[receiver],
                          bundle.threshold[bundle.row(receiver, group)]);
    }
}

}  // namespace mtsm::shadow::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::shadow {

HWY_EXPORT(fill);

namespace {

/// Patterns that receivers choose from; and pixels, if that is more.
constexpr std::uint32_t kPatterns = 32, kPixelPatterns = 4;
/// Points of all patterns, if those of a pixel are no more.
constexpr std::uint32_t kMostPoints = 1u << 20;

/// Points of a sequence, in each step neighbours close to each other.
std::vector<glm::dvec2> pattern(std::uint32_t number, std::uint32_t seed,
                                const SampleSteps& steps) {
    const SequencePart part(number, steps.end[steps.count - 1]);
    const base::SquareSequence sequence(
        base::mix(std::uint64_t(seed) << 32 | part.sequence));
    std::vector<std::pair<std::uint32_t, glm::dvec2>> order;
    for (int step = 0; step < steps.count; ++step) {
        for (std::uint32_t i = steps.first(step); i < steps.end[step]; ++i) {
            const glm::dvec2 u = sequence(part.first + i);
            order.emplace_back(placeOfSample(u), u);
        }
        std::sort(order.begin() + steps.first(step), order.end(),
                  [](const auto& a, const auto& b) { return a.first < b.first; });
    }
    std::vector<glm::dvec2> points;
    for (const auto& [place, u] : order)
        points.push_back(u);
    return points;
}

LightRays::Points makePoints(const LightRays::Setting& setting,
                             light::LightView::Domain domain) {
    LightRays::Points points;
    points.onlyOne = setting.onlyPattern.has_value();
    const std::uint32_t patterns =
        points.onlyOne ? 1u
                       : LightRays::patterns(setting.samples, setting.pointsPerPixel);
    points.each = (setting.samples + trace::kLanes - 1) / trace::kLanes * trace::kLanes;
    for (std::uint32_t p = 0; p < patterns; ++p) {
        const std::uint32_t number = setting.onlyPattern.value_or(p);
        for (const glm::dvec2 sample : pattern(number, setting.seed, setting.steps)) {
            const glm::dvec2 u = setting.isPoint ? glm::dvec2(0.5) : sample;
            const glm::dvec2 at = domain == light::LightView::Domain::square
                                      ? 2.0 * u - 1.0
                                      : light::sampleDisk(u);
            points.a.push_back(float(at.x));
            points.b.push_back(float(at.y));
        }
        points.a.resize(std::size_t(p + 1) * points.each, points.a.back());
        points.b.resize(std::size_t(p + 1) * points.each, points.b.back());
    }
    return points;
}

/// Planes of patches reach so much beyond the layers themselves.
double footprintsAt(const Projection& p, double z) {
    return 4.0 * p.pixelFootprint(std::abs(z));
}

}  // namespace

LightRays::LightRays(const Projection& p, std::uint32_t width, std::uint32_t height,
                     ZRange depths, const light::LightSampler& light,
                     const Setting& setting, const LightRays* alike)
    : setting_(setting) {
    view_.perspective = p.kind == ProjectionKind::perspective;
    view_.scaleU = float(p.scale.x), view_.scaleV = float(p.scale.y);
    view_.offsetU = float(p.offset.x), view_.offsetV = float(p.offset.y);
    view_.nearest = float(nearestOf(p, depths));
    view_.farthest = float(depths.max + footprintsAt(p, depths.max));
    view_.width = float(width), view_.height = float(height);
    view_.border = setting.joined ? float(std::max(width, height)) * 0x1p-21f : 0.0f;
    view_.highest = view_.perspective ? 1.0f / view_.nearest : -view_.nearest;
    view_.planeHeight = float(setting.height * p.pixelFootprint(1.0));
    view_.near = setting.nearDepth > 0.0;
    view_.nearHeight = float(setting.nearHeight * p.pixelFootprint(1.0));
    view_.nearStart = float(setting.nearStart);
    view_.nearWidth = float(setting.nearWidth);
    view_.nearLeast = float(setting.nearLeast / std::max(setting.nearDepth, 1e-30));
    const auto nearDepth = float(setting.nearDepth * p.pixelFootprint(1.0));
    view_.nearPerW = view_.perspective ? nearDepth : 0.0f;
    view_.nearConstant = view_.perspective ? 0.0f : nearDepth;
    const light::LightView seen = light.view(p.eye + p.forward);
    domain_ = seen.domain;
    endless_ = seen.endless;
    shines_ = glm::vec3(p.lightFromWorldDirection(light.shines()));
    points_ = alike ? alike->points_
                    : std::make_shared<const Points>(makePoints(setting, domain_));
    groups_ = int(points_->each / trace::kLanes);
}

double LightRays::nearestOf(const Projection& p, ZRange depths) noexcept {
    const double nearest = depths.min - footprintsAt(p, depths.min);
    return p.kind == ProjectionKind::perspective ? std::max(nearest, 0.5 * depths.min)
                                                 : nearest;
}

std::uint32_t LightRays::patterns(std::uint32_t samples,
                                  std::uint32_t pointsPerPixel) noexcept {
    if (pointsPerPixel <= 1) return kPatterns;
    const std::uint32_t most = kMostPoints / (samples * pointsPerPixel);
    const std::uint32_t pixels = std::max(kPixelPatterns, kPatterns / pointsPerPixel);
    return std::clamp(most, 1u, pixels) * pointsPerPixel;
}

void LightRays::fill(const ReceiverLanes& receivers, int first, int groups,
                     trace::RayBundle& bundle, RayFates& fates) const noexcept {
    int step = 0;
    while (step + 1 < setting_.steps.count &&
           std::uint32_t(first) * trace::kLanes >= setting_.steps.end[step])
        ++step;
    const FillInput input{receivers,
                          view_,
                          *points_,
                          int(setting_.samples),
                          first,
                          groups,
                          neighbours(setting_.steps.end[step], setting_.pointsPerPixel,
                                     setting_.neighbours),
                          domain_,
                          endless_,
                          setting_.normals,
                          setting_.weights,
                          setting_.media,
                          setting_.sheets,
                          setting_.ways,
                          shines_};
    HWY_DYNAMIC_DISPATCH(fill)(input, bundle, fates);
}

}  // namespace mtsm::shadow
#endif
