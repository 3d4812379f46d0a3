// The kernel of density_trace.h, once for every kind of processor.
#include "trace/density_trace.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/density_trace.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// After highway.h.
#include "hwy/contrib/math/math-inl.h"
#include "trace/compress-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using Floats = hn::CappedTag<float, kLanes>;
using Ints = hn::RebindToSigned<Floats>;

/// Texels that rays cross, waiting to be answered.
struct Hits {
    static constexpr int kRoom = 128;
    int count = 0;
    alignas(64) std::int32_t texel[kRoom + kLanes], ray[kRoom + kLanes];
    /// w: of media the lower and the higher end of the way through the texel; of sheets
    /// where the ray enters and where it leaves.
    alignas(64) float low[kRoom + kLanes], high[kRoom + kLanes];
    /// Of sheets: the bias where the ray enters, where it leaves and there in the next
    /// texel, w; how many texels the ray has been in.
    alignas(64) float enterBias[kRoom + kLanes], exitBias[kRoom + kLanes],
        nextBias[kRoom + kLanes];
    alignas(64) std::int32_t step[kRoom + kLanes];
};

/// Up to sixteen rays on their way.
struct March {
    int count = 0;      // of rays
    int place[kLanes];  // [ray]: row times kLanes, and lane
    alignas(64) float u[kLanes], v[kLanes], w[kLanes];
    alignas(64) float du[kLanes], dv[kLanes], dw[kLanes];
    alignas(64) float inverseU[kLanes], inverseV[kLanes];
    alignas(64) float begin[kLanes], beginSurfaces[kLanes], end[kLanes];
    alignas(64) float spread[kLanes];    // RayBundle's
    alignas(64) float perTexel[kLanes];  // s at which a texel may be one pixel
    alignas(64) float stretch[kLanes];
    std::uint32_t open = 0;
    std::uint32_t met = 0;  // rays that have sums
    Hits media, sheets;
    /// [channel][ray][a vector's lanes]: sums over the slabs of the level.
    alignas(64) float sum[3][kLanes][kLanes];
    float sheetSum[3][kLanes];
    /// Sheets: how many texels a ray has been in, that number when it last had sheets
    /// near by, and how many it had paid for near where it left then.
    alignas(64) std::int32_t steps[kLanes];
    std::int32_t lastStep[kLanes];
    float paid[kLanes];
};

template <class M>
std::uint32_t bitsOf(Floats d, M mask) {
    std::uint8_t bytes[8] = {};
    hn::StoreMaskBits(d, mask, bytes);
    return bytes[0] | std::uint32_t(bytes[1]) << 8;
}

auto maskOf(Floats d, std::uint32_t bits) {
    const std::uint8_t bytes[8] = {std::uint8_t(bits), std::uint8_t(bits >> 8)};
    return hn::LoadMaskBits(d, bytes);
}

/// 1 / x, huge but finite for x = 0.
template <class V>
V inverse(Floats d, V x) {
    const V least = hn::Set(d, 1e-25f);
    const V size = hn::Max(hn::Abs(x), least);
    return hn::CopySign(hn::Div(hn::Set(d, 1.0f), size), x);
}

/// Keeps the part of [begin, end] in which a + s / inverse lies within [low, high].
template <class V>
void clip(V a, V inv, V low, V high, V& begin, V& end) {
    const V s0 = hn::Mul(hn::Sub(low, a), inv), s1 = hn::Mul(hn::Sub(high, a), inv);
    begin = hn::Max(begin, hn::Min(s0, s1));
    end = hn::Min(end, hn::Max(s0, s1));
}

class Kernel {
  public:
    Kernel(const DensityTree& tree, const DensityTraceOptions& options)
        : tree_(tree),
          options_(options),
          perspective_(tree.projection().kind == ProjectionKind::perspective),
          ofSheets_(tree.isOfSheets()) {}

    /// Takes the open rays of a row, which there must be room for.
    void take(const RayBundle& bundle, int row);
    [[nodiscard]] bool hasRoom(int rays) const { return march_.count + rays <= kLanes; }

    /// Traces the rays that were taken.
    void trace(RayBundle& bundle, RayDepths& depths) {
        setUp();
        const std::uint32_t coarsest = tree_.coarsest();
        for (std::uint32_t level = tree_.finest(); level <= coarsest && march_.open;
             ++level) {
            walk(int(level), level == coarsest);
            settle(depths);
        }
        // What reached the dark in this face or before is closed.
        for (std::uint32_t rest = dark_; rest != 0; rest &= rest - 1) {
            const int place = march_.place[std::countr_zero(rest)];
            bundle.open[place / kLanes] &= std::uint16_t(~(1u << place % kLanes));
        }
        march_.count = 0;
    }

  private:
    /// Cuts the rays to where something may be met.
    void setUp();
    /// Walks the rays through one level.
    void walk(int level, bool last);
    /// Answers what waits.
    void answerMedia(int level);
    void answerSheets(int level);
    /// Makes room for what a ray meets in a level.
    void beginSums(int ray);
    /// Adds the sums of a level to the depths.
    void settle(RayDepths& depths);

    // A texel that rays first .. first + lanes - 1 cross between two w; those of `alive`.
    template <class V, class VI, class M>
    void crossMedia(int level, V low, V high, VI texel, int first, M alive) {
        const DensityLevel& texels = tree_.media().levels[std::size_t(level)];
        Hits& hits = march_.media;
        push(hits, low, high, texel, first,
             hn::And(alive, meets(texels, texel, low, high)));
        if (hits.count > Hits::kRoom) answerMedia(level);
    }

    /// `isLast`: from here the ray goes on into texels of the next level.
    template <class V, class VI, class M>
    void crossSheets(int level, V enter, V exit, VI texel, int first, M alive, M isLast) {
        const Floats d;
        const Ints di;
        const DensityLevel& texels = tree_.sheets().levels[std::size_t(level)];
        Hits& hits = march_.sheets;
        const V low = hn::Min(enter, exit), high = hn::Max(enter, exit);
        const V side = hn::Set(d, std::ldexp(1.0f, level));
        const V enterBias = biasAt(enter, side), exitBias = biasAt(exit, side);
        const V reach = hn::Mul(hn::Set(d, 2.0f), hn::Max(enterBias, exitBias));
        const M met = hn::And(
            alive, meets(texels, texel, hn::Sub(low, reach), hn::Add(high, reach)));
        const V nextBias = hn::IfThenElse(isLast, hn::Add(exitBias, exitBias), exitBias);
        hn::StoreU(compress(d, enterBias, met), d, hits.enterBias + hits.count);
        hn::StoreU(compress(d, exitBias, met), d, hits.exitBias + hits.count);
        hn::StoreU(compress(d, nextBias, met), d, hits.nextBias + hits.count);
        const VI steps = hn::Load(di, march_.steps + first);
        const auto metI = hn::RebindMask(di, met), aliveI = hn::RebindMask(di, alive);
        hn::StoreU(compress(di, steps, metI), di, hits.step + hits.count);
        hn::Store(hn::Add(steps, hn::IfThenElseZero(aliveI, hn::Set(di, 1))), di,
                  march_.steps + first);
        push(hits, enter, exit, texel, first, met);
        if (hits.count > Hits::kRoom) answerSheets(level);
    }

    /// Where a level has texel (x, y).
    template <class VI>
    static VI texelAt(VI x, VI y, VI tilesX) {
        const Ints di;
        constexpr int kShift = DensityLevel::kTileShift;
        const VI inTile = hn::Set(di, (1 << kShift) - 1);
        const VI tile = hn::Add(hn::Mul(hn::ShiftRight<kShift>(y), tilesX),
                                hn::ShiftRight<kShift>(x));
        const VI row = hn::Add(hn::ShiftLeft<kShift>(tile), hn::And(y, inTile));
        return hn::Add(hn::ShiftLeft<kShift>(row), hn::And(x, inTile));
    }

    /// Do the texels' slabs reach into [low, high]? If in doubt, yes.
    template <class V, class VI>
    auto meets(const DensityLevel& texels, VI texel, V low, V high) const {
        const Floats d;
        const Ints di;
        static_assert(sizeof(DensityTexel) == 8);
        const auto* const first =
            reinterpret_cast<const std::int32_t*>(&texels.texels[0].range);
        const VI range = hn::GatherIndex(di, first, hn::ShiftLeft<1>(texel));
        const hn::RebindToUnsigned<Floats> du;
        const auto at = [&](auto steps) {
            return hn::MulAdd(hn::ConvertTo(d, hn::BitCast(di, steps)),
                              hn::Set(d, texels.step), hn::Set(d, texels.base));
        };
        const auto bits = hn::BitCast(du, range);
        return hn::And(hn::Lt(low, at(hn::ShiftRight<16>(bits))),
                       hn::Gt(high, at(hn::And(bits, hn::Set(du, 0xffffu)))));
    }

    template <class V, class VI, class M>
    void push(Hits& hits, V low, V high, VI texel, int first, M mask) {
        const Floats d;
        const Ints di;
        const auto maskI = hn::RebindMask(di, mask);
        const auto ray = hn::Iota(di, first);
        hn::StoreU(compress(d, low, mask), d, hits.low + hits.count);
        hn::StoreU(compress(d, high, mask), d, hits.high + hits.count);
        hn::StoreU(compress(di, texel, maskI), di, hits.texel + hits.count);
        hn::StoreU(compress(di, ray, maskI), di, hits.ray + hits.count);
        hits.count += int(hn::CountTrue(d, mask));
    }

    /// Between which w something may be met by a ray that may use texels of this size.
    template <class V>
    void findRange(V texel, V& low, V& high) const {
        const Floats d;
        const V one = hn::Set(d, 1.0f);
        low = hn::Set(d, HUGE_VALF);
        high = hn::Set(d, -HUGE_VALF);
        const auto include = [&](const DensityPyramid& pyramid, V biases) {
            V from = hn::Set(d, pyramid.low), to = hn::Set(d, pyramid.high);
            widen(from, to, biases);
            low = hn::Min(low, from);
            high = hn::Max(high, to);
        };
        const V reach = hn::Mul(hn::Set(d, 2.0f), hn::Max(texel, one));
        if (!tree_.media().empty()) include(tree_.media(), hn::Zero(d));
        if (!tree_.sheets().empty()) include(tree_.sheets(), reach);
    }

    /// Way per unit of depth, at most kMostStretch times the centre ray's at the start.
    template <class V>
    V stretchOf(V u, V v, V w, V du, V dv, V dw) const {
        const Floats d;
        const Projection& p = tree_.projection();
        const V perPixelX = hn::Set(d, float(1.0 / p.scale.x));
        const V perPixelY = hn::Set(d, float(1.0 / p.scale.y));
        const V one = hn::Set(d, 1.0f);
        // d(x, y, z) / ds; for a perspective view over z^2.
        V x = hn::Mul(du, perPixelX), y = hn::Mul(dv, perPixelY);
        V most = hn::Set(d, float(kMostStretch));
        if (perspective_) {
            const V cx = hn::Mul(hn::Sub(u, hn::Set(d, float(p.offset.x))), perPixelX);
            const V cy = hn::Mul(hn::Sub(v, hn::Set(d, float(p.offset.y))), perPixelY);
            x = hn::MulSub(x, w, hn::Mul(cx, dw));
            y = hn::MulSub(y, w, hn::Mul(cy, dw));
            const V centre = hn::Sqrt(hn::MulAdd(cx, cx, hn::MulAdd(cy, cy, one)));
            most = hn::Mul(most, hn::Min(centre, hn::Set(d, 1e6f)));
        }
        const V size = hn::Sqrt(hn::MulAdd(x, x, hn::MulAdd(y, y, hn::Mul(dw, dw))));
        const V way = hn::Div(size, hn::Abs(dw));
        return hn::IfThenElse(hn::Lt(way, most), way, most);  // in this order for NaN
    }

    /// [low, high] widened by a multiple of the bias.
    template <class V>
    void widen(V& low, V& high, V times) const {
        const Floats d;
        const V base = hn::Set(d, float(options_.bias.base));
        const V perDepth = hn::Set(d, float(options_.bias.perDepth));
        if (!perspective_) {
            const V bias = hn::Mul(times, hn::MulAdd(perDepth, hn::Abs(low), base));
            low = hn::Sub(low, bias);
            high = hn::Add(high, bias);
            return;
        }
        const V least = hn::Set(d, 1e-25f), one = hn::Set(d, 1.0f);
        const V far = hn::Div(one, hn::Max(low, least));
        const V near = hn::Div(one, hn::Max(high, least));
        const V bias = hn::Mul(times, hn::MulAdd(perDepth, far, base));
        low = hn::Div(one, hn::Add(far, bias));
        high = hn::Div(one, hn::Max(hn::Sub(near, bias), least));
    }

    /// The bias of sheets at w, for texels of `side` pixels, as w: what closes a tilted
    /// sheet grows with them.
    template <class V>
    V biasAt(V w, V side) const {
        const Floats d;
        const V base = hn::Set(d, float(options_.bias.base));
        const V perDepth = hn::Set(d, float(options_.bias.perDepth));
        if (!perspective_) return hn::Mul(side, hn::MulAdd(perDepth, hn::Abs(w), base));
        const V bias = hn::Mul(hn::Mul(side, w), hn::MulAdd(base, w, perDepth));
        return hn::Min(bias, hn::Set(d, 1e30f));
    }

    const DensityTree& tree_;
    const DensityTraceOptions& options_;
    bool perspective_, ofSheets_;
    std::uint32_t dark_ = 0;
    March march_;
};

void Kernel::take(const RayBundle& bundle, int row) {
    const int receiver = row / bundle.groups, first = march_.count;
    const std::uint32_t open = bundle.open[row];
    const std::pair<const float*, float*> ofRays[] = {
        {bundle.du[row], march_.du},
        {bundle.dv[row], march_.dv},
        {bundle.dw[row], march_.dw},
        {bundle.begin[row], march_.begin},
        {bundle.beginSurfaces[row], march_.beginSurfaces}};
    int lane[kLanes], count = 0;
    for (std::uint32_t rest = open; rest != 0; rest &= rest - 1)
        lane[count++] = std::countr_zero(rest);
    for (const auto& [from, to] : ofRays) {
        if (count == kLanes)
            std::copy_n(from, kLanes, to);
        else
            for (int i = 0; i < count; ++i)
                to[first + i] = from[lane[i]];
    }
    for (int i = 0; i < count; ++i)
        march_.place[first + i] = row * kLanes + lane[i];
    std::fill_n(march_.u + first, count, bundle.u[receiver]);
    std::fill_n(march_.v + first, count, bundle.v[receiver]);
    std::fill_n(march_.w + first, count, bundle.w[receiver]);
    std::fill_n(march_.spread + first, count, bundle.spread[receiver]);
    march_.count += count;
}

void Kernel::setUp() {
    const Floats d;
    const int lanes = int(hn::Lanes(d));
    march_.open = 0;
    dark_ = 0;
    for (float* all : {march_.u, march_.v, march_.w, march_.spread, march_.du, march_.dv,
                       march_.dw, march_.begin, march_.beginSurfaces})
        std::fill(all + march_.count, all + kLanes, 0.0f);
    for (int i = 0; i < kLanes; i += lanes) {
        const auto zero = hn::Zero(d), one = hn::Set(d, 1.0f), most = hn::Set(d, 1e30f);
        const auto u = hn::Load(d, march_.u + i), v = hn::Load(d, march_.v + i),
                   w = hn::Load(d, march_.w + i);
        const auto du = hn::Load(d, march_.du + i), dv = hn::Load(d, march_.dv + i),
                   dw = hn::Load(d, march_.dw + i);
        auto begin = hn::Load(d, march_.begin + i);
        auto beginSurfaces = hn::Load(d, march_.beginSurfaces + i);
        // At s = 1. What closes a tilted sheet darkens it the more the larger texels are.
        const float part = ofSheets_ ? 0.5f : 1.0f;
        const auto texel = hn::Mul(
            hn::Mul(hn::Set(d, part), hn::Load(d, march_.spread + i)), hn::Abs(dw));
        auto open = maskOf(d, ((1u << march_.count) - 1) >> i);
        const auto check = [&](auto x) {
            open = hn::And(open, hn::Lt(hn::Abs(x), most));  // false for NaN
        };
        check(u), check(v), check(w), check(du), check(dv), check(dw);
        open = hn::And(open, hn::And(hn::Ge(begin, hn::Neg(most)), hn::Ge(texel, zero)));
        open = hn::And(open, hn::Ge(beginSurfaces, hn::Neg(most)));
        begin = hn::Max(begin, zero);
        beginSurfaces = hn::Max(begin, beginSurfaces);
        if (tree_.media().empty()) begin = beginSurfaces;
        auto end = one;
        const auto inverseU = inverse(d, du), inverseV = inverse(d, dv);
        clip(u, inverseU, zero, hn::Set(d, float(tree_.width())), begin, end);
        clip(v, inverseV, zero, hn::Set(d, float(tree_.height())), begin, end);
        auto low = zero, high = zero;
        findRange(texel, low, high);
        clip(w, inverse(d, dw), low, high, begin, end);
        open = hn::And(open, hn::Lt(begin, end));

        hn::Store(inverseU, d, march_.inverseU + i);
        hn::Store(inverseV, d, march_.inverseV + i);
        hn::Store(begin, d, march_.begin + i);
        hn::Store(beginSurfaces, d, march_.beginSurfaces + i);
        hn::Store(end, d, march_.end + i);
        hn::Store(inverse(d, texel), d, march_.perTexel + i);
        hn::Store(tree_.media().empty() ? one : stretchOf(u, v, w, du, dv, dw), d,
                  march_.stretch + i);
        march_.open |= bitsOf(d, open) << i;
        hn::Store(hn::Zero(Ints()), Ints(), march_.steps + i);
        for (int r = i; r < i + lanes; ++r)
            march_.lastStep[r] = -2;  // paid[r] is not read then
    }
}

void Kernel::walk(int level, bool last) {
    const Floats d;
    const Ints di;
    const int lanes = int(hn::Lanes(d));
    const auto levelOf = [&](const DensityPyramid& p) -> const DensityLevel* {
        return p.empty() ? nullptr : &p.levels[std::size_t(level)];
    };
    const DensityLevel* media = levelOf(tree_.media());
    const DensityLevel* sheets = levelOf(tree_.sheets());
    const DensityLevel& texels = media ? *media : *sheets;
    const float side = std::ldexp(1.0f, level);
    const auto zero = hn::Zero(d);
    const auto width = hn::Set(di, std::int32_t(texels.width));
    const auto height = hn::Set(di, std::int32_t(texels.height));
    const auto tilesX = hn::Set(di, std::int32_t(texels.tilesX()));
    std::uint32_t ahead = 0;  // rays that go on behind this level

    for (int i = 0; i < kLanes; i += lanes) {
        auto alive = maskOf(d, march_.open >> i);
        const auto perTexel = hn::Load(d, march_.perTexel + i);
        auto s = hn::Load(d, march_.begin + i);
        const auto rayEnd = hn::Load(d, march_.end + i);
        auto end = rayEnd;
        if (std::uint32_t(level) > tree_.finest())
            s = hn::Max(s, hn::Mul(perTexel, hn::Set(d, side)));
        if (!last) end = hn::Min(end, hn::Mul(perTexel, hn::Set(d, 2 * side)));
        ahead |= bitsOf(d, hn::And(alive, hn::Lt(end, rayEnd))) << i;
        alive = hn::And(alive, hn::Lt(s, end));
        if (hn::AllFalse(d, alive)) continue;
        const auto u = hn::Load(d, march_.u + i), v = hn::Load(d, march_.v + i),
                   w = hn::Load(d, march_.w + i);
        const auto du = hn::Load(d, march_.du + i), dv = hn::Load(d, march_.dv + i),
                   dw = hn::Load(d, march_.dw + i);
        const auto inverseU = hn::Load(d, march_.inverseU + i),
                   inverseV = hn::Load(d, march_.inverseV + i);
        const auto beginSurfaces = hn::Load(d, march_.beginSurfaces + i);

        // The texel it starts in, and where the next ones begin.
        const auto scale = hn::Set(d, 1.0f / side);
        const auto start = [&](auto at, auto delta, auto count) {
            const auto f = hn::Floor(hn::Mul(hn::MulAdd(s, delta, at), scale));
            const auto top = hn::Sub(hn::ConvertTo(d, count), hn::Set(d, 1.0f));
            return hn::Min(hn::Max(f, zero), top);
        };
        const auto x0 = start(u, du, width), y0 = start(v, dv, height);
        auto x = hn::ConvertTo(di, x0), y = hn::ConvertTo(di, y0);
        const auto fullSide = hn::Set(d, side);
        const auto stepU = hn::CopySign(fullSide, du), stepV = hn::CopySign(fullSide, dv);
        const auto oneI = hn::Set(di, 1);
        const auto negU = hn::RebindMask(di, hn::Lt(stepU, zero));
        const auto negV = hn::RebindMask(di, hn::Lt(stepV, zero));
        const auto stepX = hn::IfThenElse(negU, hn::Neg(oneI), oneI);
        const auto stepY = hn::IfThenElse(negV, hn::Neg(oneI), oneI);
        const auto toNextU = hn::IfThenElse(hn::Lt(stepU, zero), zero, fullSide);
        const auto toNextV = hn::IfThenElse(hn::Lt(stepV, zero), zero, fullSide);
        auto borderU = hn::MulAdd(x0, fullSide, toNextU);
        auto borderV = hn::MulAdd(y0, fullSide, toNextV);
        // A ray along an axis never comes to a border of the other.
        const auto never = hn::Set(d, 1e30f), tiny = hn::Set(d, 1e-25f);
        const auto stillU = hn::Lt(hn::Abs(du), tiny), stillV = hn::Lt(hn::Abs(dv), tiny);
        auto nextU =
            hn::IfThenElse(stillU, never, hn::Mul(hn::Sub(borderU, u), inverseU));
        auto nextV =
            hn::IfThenElse(stillV, never, hn::Mul(hn::Sub(borderV, v), inverseV));

        for (;;) {
            const auto sNext = hn::Max(s, hn::Min(end, hn::Min(nextU, nextV)));
            const auto texel =
                hn::IfThenElseZero(hn::RebindMask(di, alive), texelAt(x, y, tilesX));
            const auto wa = hn::MulAdd(s, dw, w), wb = hn::MulAdd(sNext, dw, w);
            if (media)
                crossMedia(level, hn::Min(wa, wb), hn::Max(wa, wb), texel, i, alive);
            if (sheets) {
                const auto begin = hn::Max(s, beginSurfaces);
                crossSheets(level, hn::MulAdd(begin, dw, w), wb, texel, i,
                            hn::And(alive, hn::Lt(begin, sNext)), hn::Ge(sNext, end));
            }

            alive = hn::And(alive, hn::Lt(sNext, end));
            const auto alongU = hn::Le(nextU, nextV);
            const auto alongUI = hn::RebindMask(di, alongU);
            x = hn::Add(x, hn::IfThenElseZero(alongUI, stepX));
            y = hn::Add(y, hn::IfThenZeroElse(alongUI, stepY));
            borderU = hn::Add(borderU, hn::IfThenElseZero(alongU, stepU));
            borderV = hn::Add(borderV, hn::IfThenZeroElse(alongU, stepV));
            nextU = hn::IfThenElse(stillU, never, hn::Mul(hn::Sub(borderU, u), inverseU));
            nextV = hn::IfThenElse(stillV, never, hn::Mul(hn::Sub(borderV, v), inverseV));
            s = sNext;
            const auto before = hn::Set(di, -1);
            const auto inside = hn::And(hn::And(hn::Gt(x, before), hn::Lt(x, width)),
                                        hn::And(hn::Gt(y, before), hn::Lt(y, height)));
            alive = hn::And(alive, hn::RebindMask(d, inside));
            if (hn::AllFalse(d, alive)) break;
        }
    }
    answerMedia(level);
    answerSheets(level);
    march_.open &= ahead;
}

void Kernel::answerMedia(int level) {
    Hits& hits = march_.media;
    if (hits.count == 0) return;
    const Floats d;
    const std::uint32_t lanes = std::uint32_t(hn::Lanes(d));
    const DensityLevel& texels = tree_.media().levels[std::size_t(level)];
    const hn::RebindToUnsigned<Floats> du;
    const auto upper = hn::Set(du, DensityLevel::kLengthBits);
    const std::uint32_t channels = tree_.channels();
    const int wordShift = channels == 3 ? 2 : 1;  // of a slab
    for (int h = 0; h < hits.count; ++h) {
        const auto texel = std::size_t(hits.texel[h]);
        const std::uint32_t* list = texels.slabs.data() + texels.texels[texel].begin;
        const std::uint32_t count = texels.words(texel) >> wordShift;
        const auto low = hn::Set(d, hits.low[h]), high = hn::Set(d, hits.high[h]);
        const int ray = hits.ray[h];
        beginSums(ray);
        for (std::uint32_t k = 0; k < count; k += lanes) {
            const std::uint32_t* at = list + k;
            const auto valid = hn::FirstN(du, count - k);
            const auto slab =
                hn::BitCast(d, hn::IfThenElseZero(valid, hn::LoadU(du, at)));
            const auto bits = hn::IfThenElseZero(valid, hn::LoadU(du, at += count));
            const auto length = hn::BitCast(d, hn::ShiftRight<1>(hn::And(bits, upper)));
            const auto from = hn::Max(low, slab);
            const auto to = hn::Min(high, hn::Add(slab, length));
            const auto within = hn::Max(hn::Sub(to, from), hn::Zero(d));
            const auto add = [&](auto density, float* total) {
                hn::Store(hn::MulAdd(within, hn::BitCast(d, density), hn::Load(d, total)),
                          d, total);
            };
            add(hn::ShiftLeft<DensityLevel::kDensityShift>(hn::AndNot(upper, bits)),
                march_.sum[0][ray]);
            for (std::uint32_t c = 1; c < channels; ++c)
                add(hn::IfThenElseZero(valid, hn::LoadU(du, at += count)),
                    march_.sum[c][ray]);
        }
    }
    hits.count = 0;
}

/// As the definition's sheets (traverse_scalar.cpp), with slabs for samples: as many of
/// those that the ray has paid for near where it left the texel before are not paid for
/// again near where it entered this one.
void Kernel::answerSheets(int level) {
    Hits& hits = march_.sheets;
    if (hits.count == 0) return;
    const Floats d;
    const std::uint32_t lanes = std::uint32_t(hn::Lanes(d));
    const hn::RebindToUnsigned<Floats> du;
    const auto upper = hn::Set(du, DensityLevel::kLengthBits);
    const auto zero = hn::Zero(d);
    const auto total = [&](auto v) { return hn::GetLane(hn::SumOfLanes(d, v)); };
    const std::uint32_t channels = tree_.channels();
    // What is dark in a pixel blocks, whatever was paid for before. Above, where the bias
    // is wider, that would darken (tests/shadow/ray_test.cpp).
    const auto blocks = hn::Set(d, level == 0 ? 0.5f * kDarkDepth : HUGE_VALF);
    const DensityLevel& texels = tree_.sheets().levels[std::size_t(level)];
    const int wordShift = channels == 3 ? 2 : 1;  // of a slab
    for (int h = 0; h < hits.count; ++h) {
        const auto texel = std::size_t(hits.texel[h]);
        const std::uint32_t* list = texels.slabs.data() + texels.texels[texel].begin;
        const std::uint32_t count = texels.words(texel) >> wordShift;
        const int ray = hits.ray[h];
        beginSums(ray);
        const bool straightOn = hits.step[h] == march_.lastStep[ray] + 1;
        march_.lastStep[ray] = hits.step[h];
        const auto enter = hn::Set(d, hits.low[h]), exit = hn::Set(d, hits.high[h]);
        const bool rises = hits.low[h] < hits.high[h];
        const auto enterBias = hn::Set(d, hits.enterBias[h]);
        const auto exitBias = hn::Set(d, hits.exitBias[h]);
        const auto lowBias = rises ? enterBias : exitBias;
        const auto highBias = rises ? exitBias : enterBias;
        const auto step = hn::Add(enterBias, enterBias);
        const auto nextBias = hn::Set(d, hits.nextBias[h]);
        const auto nextStep = hn::Add(nextBias, nextBias);
        // Slabs near the way in; those that go on out, if the former are not known or
        // are.
        auto near = zero, goesOn = zero, goesOnIfKnown = zero;
        // [channel]: depths met, and of those near the way in.
        float depthMet[3] = {}, depthNear[3] = {};
        bool any = false;
        for (std::uint32_t k = 0; k < count; k += lanes) {
            const auto valid = hn::FirstN(du, count - k);
            const auto plane = [&](std::uint32_t n) {
                return hn::IfThenElseZero(valid, hn::LoadU(du, list + k + n * count));
            };
            const auto slab = hn::BitCast(d, plane(0));
            const auto bits = plane(1);
            const auto slabEnd =
                hn::Add(slab, hn::BitCast(d, hn::ShiftRight<1>(hn::And(bits, upper))));
            const auto length = hn::Sub(slabEnd, slab);
            const auto perLength =
                hn::Div(hn::Set(d, 1.0f), hn::Max(length, hn::Set(d, 1e-31f)));
            const auto part = [&](auto low, auto high) {
                const auto within = hn::Sub(hn::Min(high, slabEnd), hn::Max(low, slab));
                return hn::IfThenElseZero(hn::RebindMask(d, valid),
                                          hn::Mul(hn::Max(within, zero), perLength));
            };
            const auto met = part(hn::Sub(hn::Min(enter, exit), lowBias),
                                  hn::Add(hn::Max(enter, exit), highBias));
            const auto depthOf = [&](std::uint32_t c) {
                const auto density =
                    hn::BitCast(d, c == 0 ? hn::ShiftLeft<DensityLevel::kDensityShift>(
                                                hn::AndNot(upper, bits))
                                          : plane(c + 1));
                return hn::Mul(density, length);
            };
            auto dark = hn::Ge(depthOf(0), blocks);
            for (std::uint32_t c = 1; c < channels; ++c)
                dark = hn::And(dark, hn::Ge(depthOf(c), blocks));
            const auto entered = hn::IfThenZeroElse(
                dark, part(hn::Sub(enter, step), hn::Add(enter, step)));
            const auto left = part(hn::Sub(exit, nextStep), hn::Add(exit, nextStep));
            if (hn::AllFalse(d, hn::Gt(hn::Add(met, entered), zero))) continue;
            near = hn::Add(near, entered);
            any = true;
            goesOn = hn::Add(goesOn, hn::IfThenZeroElse(dark, hn::Min(met, left)));
            goesOnIfKnown =
                hn::Add(goesOnIfKnown,
                        hn::IfThenZeroElse(dark, hn::Min(hn::Max(met, entered), left)));
            for (std::uint32_t c = 0; c < channels; ++c) {
                const auto depth = depthOf(c);
                depthMet[c] += total(hn::Mul(depth, met));
                depthNear[c] += total(hn::Mul(depth, hn::Min(met, entered)));
            }
        }
        float& paid = march_.paid[ray];
        if (!any) {
            paid = 0.0f;
            continue;
        }
        const float nearby = total(near);
        const float known =
            straightOn && nearby > 0.0f ? std::min(paid / nearby, 1.0f) : 0.0f;
        for (std::uint32_t c = 0; c < channels; ++c)
            march_.sheetSum[c][ray] += depthMet[c] - known * depthNear[c];
        paid = known * total(goesOnIfKnown) + (1.0f - known) * total(goesOn);
    }
    hits.count = 0;
}

void Kernel::beginSums(int ray) {
    if (march_.met >> ray & 1u) return;
    const Floats d;
    march_.met |= 1u << ray;
    for (std::uint32_t c = 0; c < tree_.channels(); ++c) {
        hn::Store(hn::Zero(d), d, march_.sum[c][ray]);
        march_.sheetSum[c][ray] = 0.0f;
    }
}

void Kernel::settle(RayDepths& depths) {
    const Floats d;
    for (std::uint32_t left = march_.met; left != 0; left &= left - 1) {
        const int ray = std::countr_zero(left);
        bool dark = true;
        for (std::uint32_t c = 0; c < tree_.channels(); ++c) {
            const float media =
                hn::GetLane(hn::SumOfLanes(d, hn::Load(d, march_.sum[c][ray])));
            const int place = march_.place[ray];
            float& depth = depths.depth[c][place / kLanes][place % kLanes];
            depth += media * march_.stretch[ray] + march_.sheetSum[c][ray];
            dark = dark && depth >= options_.darkDepth;
        }
        if (dark) dark_ |= 1u << ray;
    }
    march_.open &= ~dark_;
    march_.met = 0;
}

void traceDensityAt(const DensityTree& tree, const DensityTraceOptions& options,
                    RayBundle& bundle, RayDepths& depths) {
    if (tree.media().empty() && tree.sheets().empty()) return;
    Kernel kernel(tree, options);
    // Rows of few rays share a way: as many as have room.
    for (int row = 0; row < bundle.receivers * bundle.groups; ++row) {
        if (!kernel.hasRoom(std::popcount(bundle.open[row])))
            kernel.trace(bundle, depths);
        kernel.take(bundle, row);
    }
    kernel.trace(bundle, depths);
}

void seeThroughAt(int rows, std::uint32_t channels, float threshold,
                  const std::uint16_t* followed, const std::uint16_t* clear,
                  RayDepths& depths) {
    const Floats d;
    const auto zero = hn::Zero(d), one = hn::Set(d, 1.0f);
    for (std::uint32_t c = 0; c < channels; ++c) {
        for (int row = 0; row < rows; ++row) {
            for (int i = 0; i < kLanes; i += int(hn::Lanes(d))) {
                float* const at = depths.depth[c][row] + i;
                const auto depth = hn::Load(d, at);
                const auto left =
                    hn::IfThenElse(hn::Le(depth, zero), one, hn::Exp(d, hn::Neg(depth)));
                const auto seen =
                    hn::IfThenElseZero(hn::Gt(left, hn::Set(d, threshold)), left);
                const auto others =
                    hn::IfThenElse(maskOf(d, std::uint32_t(clear[row]) >> i), one, zero);
                const auto met = maskOf(d, std::uint32_t(followed[row]) >> i);
                hn::Store(hn::IfThenElse(met, seen, others), d, at);
            }
        }
    }
}

}  // namespace HWY_NAMESPACE
}  // namespace mtsm::trace
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(traceDensityAt);
HWY_EXPORT(seeThroughAt);

void traceDensity(const DensityTree& tree, const DensityTraceOptions& options,
                  RayBundle& bundle, RayDepths& depths) noexcept {
    HWY_DYNAMIC_DISPATCH(traceDensityAt)(tree, options, bundle, depths);
}

void seeThrough(int rows, std::uint32_t channels, float threshold,
                const std::uint16_t* followed, const std::uint16_t* clear,
                RayDepths& depths) noexcept {
    HWY_DYNAMIC_DISPATCH(seeThroughAt)
    (rows, channels, threshold, followed, clear, depths);
}

namespace {

/// mayMeet: depth first, down to texels as large as rays may use.
class Glance {
  public:
    Glance(const DensityTree& tree, const DensityTraceOptions& options,
           const RayHull& hull)
        : tree_(tree), options_(options), hull_(hull) {}

    bool run() {
        for (const DensityPyramid* p : {&tree_.media(), &tree_.sheets()}) {
            if (!p->empty() && meets(*p)) return true;
        }
        return false;
    }

  private:
    struct Node {
        std::uint32_t level, x, y;
    };

    bool meets(const DensityPyramid& pyramid) {
        const bool sheets = &pyramid == &tree_.sheets();
        const float part = tree_.isOfSheets() ? 0.5f : 1.0f;
        Node stack[kSize] = {{std::uint32_t(pyramid.levels.size()) - 1, 0, 0}};
        for (int waiting = 1, looks = 0; waiting > 0; ++looks) {
            const Node node = stack[--waiting];
            const DensityLevel& level = pyramid.levels[node.level];
            const std::size_t texel = level.at(node.x, node.y);
            const float side = std::ldexp(1.0f, int(node.level));
            float most = 0.0f;
            // Of a sheet the bias is that where a ray leaves the texel or enters it:
            // somewhere in the map.
            const float reach =
                sheets ? side * (2.0f * std::max(biasAt(1.1f * pyramid.high),
                                                 biasAt(1.1f * pyramid.low)) +
                                 movedAt(level.high(texel)))
                       : biasAt(level.high(texel));
            if (!isMet(node, level, texel, 1.01f * reach, most)) continue;
            if (node.level <= tree_.finest() || looks == kMostLooks ||
                side <= 1.01f * part * hull_.spread * most)
                return true;
            const DensityLevel& finer = pyramid.levels[node.level - 1];
            for (std::uint32_t y = 2 * node.y; y < std::min(2 * node.y + 2, finer.height);
                 ++y) {
                for (std::uint32_t x = 2 * node.x;
                     x < std::min(2 * node.x + 2, finer.width); ++x)
                    stack[waiting++] = {node.level - 1, x, y};
            }
        }
        return false;
    }

    /// `reach`: what it is met within; `most`: how far above the lowest start; both w.
    bool isMet(Node node, const DensityLevel& level, std::size_t texel, float reach,
               float& most) const {
        if (level.texels[texel].range == DensityTexel::kEmpty) return false;
        const float low = level.low(texel), high = level.high(texel);
        most = high + reach - hull_.wLow;
        const float least =
            std::max(0.0f, std::max(low - reach, hull_.wFirst) - hull_.wHigh);
        if (!(high + reach >= hull_.wFirst)) return false;
        const float side = std::ldexp(1.0f, int(node.level));
        return crosses(float(node.x) * side, side, hull_.uLow, hull_.uHigh,
                       hull_.slopeLowU, hull_.slopeHighU, least, most) &&
               crosses(float(node.y) * side, side, hull_.vLow, hull_.vHigh,
                       hull_.slopeLowV, hull_.slopeHighV, least, most);
    }

    static bool crosses(float low, float side, float startLow, float startHigh,
                        float slopeLow, float slopeHigh, float least, float most) {
        return startLow + std::min(slopeLow * least, slopeLow * most) <= low + side &&
               startHigh + std::max(slopeHigh * least, slopeHigh * most) >= low;
    }

    /// How far from w, as w, the bias reaches that there is at w.
    [[nodiscard]] float biasAt(float w) const {
        const auto base = float(options_.bias.base);
        const auto perDepth = float(options_.bias.perDepth);
        if (tree_.projection().kind != ProjectionKind::perspective)
            return base + perDepth * std::abs(w);
        // Towards the eye it reaches further than the bias itself.
        const float depth = 1.0f / std::max(w, 1e-25f);
        const float bias = base + perDepth * depth;
        constexpr float kEverywhere = 1e25f;
        return bias < 0.5f * depth ? bias / (depth * (depth - bias)) : kEverywhere;
    }

    /// How far sheets may lie from where they are in a texel of one pixel's side, w: what
    /// is merged lies at its mean, level after level (density_tree.cpp).
    [[nodiscard]] float movedAt(float w) const {
        const auto footprint = float(tree_.projection().pixelFootprint(1.0));
        const bool perspective = tree_.projection().kind == ProjectionKind::perspective;
        return 4.0f * footprint * (perspective ? w : 1.0f);
    }

    // Three wait beside each of as many levels as there may be.
    static constexpr int kSize = 4 * 24, kMostLooks = 256;
    const DensityTree& tree_;
    const DensityTraceOptions& options_;
    const RayHull& hull_;
};

}  // namespace

bool mayMeet(const DensityTree& tree, const DensityTraceOptions& options,
             const RayHull& hull) noexcept {
    return Glance(tree, options, hull).run();
}

}  // namespace mtsm::trace
#endif
