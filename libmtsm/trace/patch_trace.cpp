// tracePatches: from the light's end down, breadth first, sixteen patches and then
// sixteen rays at a time.
#include "trace/patch_trace.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/patch_trace.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sixteen lanes, in as many vectors as the target needs for them.
using Floats = hn::CappedTag<float, kLanes>;
using Ints = hn::RebindToSigned<Floats>;
using Vec = hn::Vec<Floats>;
using VecI = hn::Vec<Ints>;
constexpr Floats kF;
constexpr Ints kI;
constexpr int kN = int(hn::MaxLanes(kF));

HWY_INLINE std::uint32_t bitsOf(hn::Mask<Floats> mask) {
    std::uint8_t bytes[8] = {};
    hn::StoreMaskBits(kF, mask, bytes);
    std::uint16_t bits;
    std::memcpy(&bits, bytes, sizeof bits);
    return bits & ((1u << kN) - 1);
}
HWY_INLINE std::uint32_t bitsOf(hn::Mask<Ints> mask) {
    return bitsOf(hn::RebindMask(kF, mask));
}

/// Part number i of the same field of four groups, one part being what a vector holds.
template <typename D>
HWY_INLINE hn::Vec<D> loadField(D d, const float* const* groups, int field, int i) {
    constexpr int lanes = int(hn::MaxLanes(D()));
    if constexpr (lanes < 4) {
        return hn::LoadU(d, groups[i / 4] + field + i % 4);
    } else if constexpr (lanes == 4) {
        return hn::Load(d, groups[i] + field);
    } else {
#if HWY_TARGET != HWY_SCALAR
        const hn::Half<D> half;
        return hn::Combine(d, loadField(half, groups, field, 2 * i + 1),
                           loadField(half, groups, field, 2 * i));
#endif
    }
}

/// Groups that wait, with the receivers that they may still matter to.
struct Waiting {
    std::uint32_t group, groups;
    std::uint16_t lanes;
};

/// First in, first out, so that coarse patches in front are met first; above half full
/// last in, first out, which goes no deeper than the tree. Order decides nothing but
/// time.
class Queue {
  public:
    [[nodiscard]] bool empty() const { return first_ == last_; }
    void push(Waiting w) { waiting_[last_++ % kSize] = w; }
    /// Takes one group.
    std::uint32_t pop(std::uint16_t& lanes) {
        const bool full = last_ - first_ > kSize / 2;
        Waiting& w = waiting_[(full ? last_ - 1 : first_) % kSize];
        const std::uint32_t group = w.group++;
        lanes = w.lanes;
        if (--w.groups == 0) full ? --last_ : ++first_;
        return group;
    }

  private:
    // 16 entries at most for every level of the tree and of quarters of patches: far less
    // than half of it.
    static constexpr std::uint32_t kSize = 2048;
    Waiting waiting_[kSize];
    std::uint32_t first_ = 0, last_ = 0;
};

/// 1 / x but for the last bit or two.
HWY_INLINE Vec reciprocal(Vec x) {
    Vec guess = hn::ApproximateReciprocal(x);
#if HWY_TARGET == HWY_NEON  // starts from 8 bits
    guess = hn::Mul(guess, hn::NegMulAdd(x, guess, hn::Set(kF, 2.0f)));
#endif
    return hn::Mul(guess, hn::NegMulAdd(x, guess, hn::Set(kF, 2.0f)));
}

class Traversal {
  public:
    Traversal(const PatchTree& tree, RayBundle& bundle) : tree_(tree), bundle_(bundle) {}

    void run() {
        for (int receiver = 0; receiver < bundle_.receivers; ++receiver) {
            if (anyOpen(receiver)) lanes_ |= std::uint16_t(1u << receiver);
        }
        if (lanes_ == 0) return;
        findHull();
        findLevels();
        enter();
        while (!queue_.empty() && lanes_ != 0)
            look();
    }

  private:
    [[nodiscard]] bool anyOpen(int receiver) const {
        std::uint32_t open = 0;
        for (int group = 0; group < bundle_.groups; ++group)
            open |= bundle_.open[bundle_.row(receiver, group)];
        return open != 0;
    }

    // --- what holds for all rays
    // -----------------------------------------------------------

    void findHull() {
        hull_ = {HUGE_VALF, -HUGE_VALF, HUGE_VALF, -HUGE_VALF, HUGE_VALF, -HUGE_VALF,
                 HUGE_VALF, -HUGE_VALF, HUGE_VALF, -HUGE_VALF, HUGE_VALF};
        for (std::uint32_t rest = lanes_; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            const auto include = [](float& low, float& high, float a, float b) {
                low = std::min(low, a), high = std::max(high, b);
            };
            include(hull_.uLow, hull_.uHigh, bundle_.u[i], bundle_.u[i]);
            include(hull_.vLow, hull_.vHigh, bundle_.v[i], bundle_.v[i]);
            include(hull_.wLow, hull_.wHigh, bundle_.w[i], bundle_.w[i]);
            include(hull_.slopeLowU, hull_.slopeHighU, bundle_.slopeLowU[i],
                    bundle_.slopeHighU[i]);
            include(hull_.slopeLowV, hull_.slopeHighV, bundle_.slopeLowV[i],
                    bundle_.slopeHighV[i]);
            hull_.wFirst = std::min(hull_.wFirst, bundle_.w[i] + bundle_.rise[i]);
        }
        anyWide_ = (bundle_.wide & lanes_) != 0;
    }

    void findLevels() {
        std::fill_n(mayAnswer_, kMostLevels, std::uint16_t(0));
        for (std::uint32_t rest = lanes_; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            mayAnswer_[bundle_.topLevel[i]] |= std::uint16_t(1u << i);
        }
        for (int level = kMostLevels - 1; level > 0; --level) {
            if (mayAnswer_[level] && top_ == 0) top_ = level;
            mayAnswer_[level - 1] |= mayAnswer_[level];
        }
    }

    /// The tiles of the first level at which some receiver may be answered, or, if those
    /// were many, of a coarser one.
    void enter() {
        const std::vector<PatchTree::Level>& levels = tree_.levels();
        const float most = std::max(0.0f, tree_.highest() - hull_.wLow);
        float u0 = hull_.uLow + std::min(0.0f, hull_.slopeLowU * most);
        float u1 = hull_.uHigh + std::max(0.0f, hull_.slopeHighU * most);
        float v0 = hull_.vLow + std::min(0.0f, hull_.slopeLowV * most);
        float v1 = hull_.vHigh + std::max(0.0f, hull_.slopeHighV * most);
        if (anyWide_) u0 = v0 = -HUGE_VALF, u1 = v1 = HUGE_VALF;
        std::size_t level = std::min(std::size_t(std::max(top_, 1)), levels.size() - 1);
        while (level + 1 < levels.size() &&
               std::max(u1 - u0, v1 - v0) > 2.0f * float(levels[level].side))
            ++level;
        const PatchTree::Level& entry = levels[level];
        const auto place = [&](float x, std::uint32_t count) {
            const float tile = std::floor(x / float(entry.side));
            return std::uint32_t(std::clamp(tile, 0.0f, float(count - 1)));
        };
        for (std::uint32_t y = place(v0, entry.rows); y <= place(v1, entry.rows); ++y) {
            for (std::uint32_t x = place(u0, entry.columns);
                 x <= place(u1, entry.columns); ++x) {
                const PatchTree::Entry& tile =
                    entry.tiles[std::size_t(y) * entry.columns + x];
                if (tile.groups > 0) queue_.push({tile.group, tile.groups, lanes_});
            }
        }
    }

    // --- patches
    // ---------------------------------------------------------------------------

    /// Looks at up to four groups.
    void look() {
        const float* fields[4];
        const PatchGroup* groups[4];
        std::uint16_t lanes[4];
        std::uint32_t met = 0;
        for (int i = 0; i < 4; ++i) {
            groups[i] = tree_.groups();  // any one, if there is none to look at
            lanes[i] = 0;
            if (!queue_.empty()) {
                groups[i] += queue_.pop(lanes[i]);
                met |= 15u << (4 * i);
            }
            fields[i] = groups[i]->high;
        }
        std::uint32_t reached = 0;
        for (int i = 0; i < 16; i += kN)
            reached |= meet(fields, i) << i;
        for (met &= reached; met; met &= met - 1) {
            const int i = std::countr_zero(met);
            visit(*groups[i / 4], i % 4, lanes[i / 4] & lanes_);
            if (lanes_ == 0) return;
        }
    }

    static constexpr int field(int i) { return 4 * i; }  // of PatchGroup, in its order

    /// Do rays that start between two places, and go sideways between two slopes, cross
    /// what lies between two sides while they rise by `least` to `most`?
    static hn::Mask<Floats> crosses(Vec side0, Vec side1, Vec startLow, Vec startHigh,
                                    Vec slopeLow, Vec slopeHigh, Vec least, Vec most) {
        const Vec low = hn::Min(hn::Mul(slopeLow, least), hn::Mul(slopeLow, most));
        const Vec high = hn::Max(hn::Mul(slopeHigh, least), hn::Mul(slopeHigh, most));
        return hn::And(hn::Le(hn::Add(startLow, low), side1),
                       hn::Ge(hn::Add(startHigh, high), side0));
    }

    /// Which patches, of a vector from number `first` on, any ray can meet.
    std::uint32_t meet(const float* const* groups, int first) const {
        const auto load = [&](int number) {
            return loadField(kF, groups, field(number), first / kN);
        };
        const Vec high = load(0);
        const auto exists = hn::Gt(high, hn::Set(kF, -HUGE_VALF));
        if (anyWide_) return bitsOf(exists);
        const Vec low = load(1), u = load(6), v = load(7), halfU = load(8),
                  halfV = load(9);
        const auto set = [](float x) { return hn::Set(kF, x); };
        const Vec least = hn::Max(
            hn::Zero(kF), hn::Sub(hn::Max(low, set(hull_.wFirst)), set(hull_.wHigh)));
        const Vec most = hn::Sub(high, set(hull_.wLow));
        auto met = hn::And(exists, hn::Ge(high, set(hull_.wFirst)));
        met = hn::And(met, crosses(hn::Sub(u, halfU), hn::Add(u, halfU), set(hull_.uLow),
                                   set(hull_.uHigh), set(hull_.slopeLowU),
                                   set(hull_.slopeHighU), least, most));
        met = hn::And(met, crosses(hn::Sub(v, halfV), hn::Add(v, halfV), set(hull_.vLow),
                                   set(hull_.vHigh), set(hull_.slopeLowV),
                                   set(hull_.slopeHighV), least, most));
        return bitsOf(met);
    }

    /// Groups of rays that may meet the patch.
    [[nodiscard]] std::uint64_t groupsMet(const PatchGroup& g, int i) const {
        const std::uint64_t all = ~std::uint64_t(0) >> (64 - bundle_.groups);
        if (bundle_.groups == 1 || anyWide_) return all;
        const auto set = [](float x) { return hn::Set(kF, x); };
        const Vec least =
            set(std::max(0.0f, std::max(g.low[i], hull_.wFirst) - hull_.wHigh));
        const Vec most = set(g.high[i] - hull_.wLow);
        std::uint64_t groups = 0;
        for (int k = 0; k < bundle_.groups; k += kN) {
            const auto inU = crosses(set(g.u[i] - g.halfU[i]), set(g.u[i] + g.halfU[i]),
                                     set(hull_.uLow), set(hull_.uHigh),
                                     hn::Load(kF, bundle_.groupLowU + k),
                                     hn::Load(kF, bundle_.groupHighU + k), least, most);
            const auto inV = crosses(set(g.v[i] - g.halfV[i]), set(g.v[i] + g.halfV[i]),
                                     set(hull_.vLow), set(hull_.vHigh),
                                     hn::Load(kF, bundle_.groupLowV + k),
                                     hn::Load(kF, bundle_.groupHighV + k), least, most);
            groups |= std::uint64_t(bitsOf(hn::And(inU, inV))) << k;
        }
        return groups & all;
    }

    /// Receivers some of whose rays may meet the patch.
    [[nodiscard]] std::uint32_t lanesMet(const PatchGroup& g, int i) const {
        std::uint32_t lanes = bundle_.wide;
        const auto set = [](float x) { return hn::Set(kF, x); };
        for (int k = 0; k < kLanes; k += kN) {
            const auto load = [k](const float* p) { return hn::Load(kF, p + k); };
            const Vec u = load(bundle_.u), v = load(bundle_.v), w = load(bundle_.w);
            const Vec rise = load(bundle_.rise);
            const Vec least = hn::Max(hn::Sub(set(g.low[i]), w), rise);
            const Vec most = hn::Sub(set(g.high[i]), w);
            auto met = hn::Ge(most, rise);
            met = hn::And(met, crosses(set(g.u[i] - g.halfU[i]), set(g.u[i] + g.halfU[i]),
                                       u, u, load(bundle_.slopeLowU),
                                       load(bundle_.slopeHighU), least, most));
            met = hn::And(met, crosses(set(g.v[i] - g.halfV[i]), set(g.v[i] + g.halfV[i]),
                                       v, v, load(bundle_.slopeLowV),
                                       load(bundle_.slopeHighV), least, most));
            lanes |= bitsOf(met) << k;
        }
        return lanes;
    }

    void visit(const PatchGroup& g, int i, std::uint32_t lanes) {
        if (lanes && bundle_.hasPlanes) lanes &= lanesBelow(g, i);
        if (lanes) lanes &= lanesMet(g, i);
        if (lanes == 0) return;
        const std::uint64_t groups = groupsMet(g, i);
        if (groups == 0) return;
        std::uint32_t answered = lanes;
        if (g.childGroups[i] > 0) {
            answered &= mayAnswer_[g.level[i]];
            if (answered && g.sheet[i]) test<true>(g, i, groups, answered);
            answered &= lanesFarFrom(g, i) & ~std::uint32_t(bundle_.wide);
        }
        if (answered) test<false>(g, i, groups, answered);
        const std::uint32_t rest = lanes & ~answered & lanes_;
        if (rest) queue_.push({g.children[i], g.childGroups[i], std::uint16_t(rest)});
    }

    /// Receivers whose tangent plane some of the patch lies above.
    [[nodiscard]] std::uint32_t lanesBelow(const PatchGroup& g, int i) const {
        std::uint32_t lanes = 0;
        for (int k = 0; k < kLanes; k += kN) {
            const Vec a = hn::Load(kF, bundle_.planeU + k);
            const Vec b = hn::Load(kF, bundle_.planeV + k);
            const Vec c = hn::Load(kF, bundle_.planeW + k);
            // Height at the box's centre, and how it changes along the patch's plane.
            Vec height =
                hn::Mul(a, hn::Sub(hn::Set(kF, g.u[i]), hn::Load(kF, bundle_.u + k)));
            height = hn::MulAdd(
                b, hn::Sub(hn::Set(kF, g.v[i]), hn::Load(kF, bundle_.v + k)), height);
            height = hn::MulAdd(
                c, hn::Sub(hn::Set(kF, g.w[i]), hn::Load(kF, bundle_.w + k)), height);
            const Vec perU = hn::MulAdd(c, hn::Set(kF, g.gradientU[i]), a);
            const Vec perV = hn::MulAdd(c, hn::Set(kF, g.gradientV[i]), b);
            height = hn::MulAdd(hn::Abs(perU), hn::Set(kF, g.halfU[i]), height);
            height = hn::MulAdd(hn::Abs(perV), hn::Set(kF, g.halfV[i]), height);
            height = hn::MulAdd(hn::Abs(c), hn::Set(kF, g.residual[i]), height);
            lanes |= bitsOf(hn::Gt(height, hn::Set(kF, bundle_.planeHeight))) << k;
        }
        return lanes;
    }

    /// Receivers so far away that the patch is as fine as their rays are dense.
    [[nodiscard]] std::uint32_t lanesFarFrom(const PatchGroup& g, int i) const {
        std::uint32_t lanes = 0;
        for (int k = 0; k < kLanes; k += kN) {
            const Vec away = hn::Sub(hn::Set(kF, g.low[i]), hn::Load(kF, bundle_.w + k));
            const Vec dense = hn::Mul(hn::Load(kF, bundle_.spread + k),
                                      hn::Mul(hn::Set(kF, kTexel), away));
            const auto steepest = [k](const float* low, const float* high) {
                return hn::Max(hn::Abs(hn::Load(kF, low + k)),
                               hn::Abs(hn::Load(kF, high + k)));
            };
            const Vec slant = hn::Max(steepest(bundle_.slopeLowU, bundle_.slopeHighU),
                                      steepest(bundle_.slopeLowV, bundle_.slopeHighV));
            const Vec aside = hn::Mul(slant, hn::Set(kF, g.residual[i]));
            const Vec coarse = hn::Max(aside, hn::Set(kF, g.texel[i]));
            lanes |= bitsOf(hn::Le(coarse, dense)) << k;
        }
        return lanes;
    }

    // --- rays
    // ------------------------------------------------------------------------------

    static hn::Mask<Floats> maskOf(std::uint32_t bits, int i) {
        std::uint8_t bytes[8] = {};
        const auto part = std::uint16_t(bits >> i);
        std::memcpy(bytes, &part, sizeof part);
        return hn::LoadMaskBits(kF, bytes);
    }

    /// As many rays of one receiver as fill a vector.
    struct Batch {
        float startU, startV, startW;
        Vec du, dv, dw, begin;
        std::uint32_t open;
        const std::uint8_t* threshold;
    };

    /// The patch of a group as rays see it.
    struct Seen {
        const PatchGroup& g;
        int i;
        const CoverPlane* cover;
        float cornerU, cornerV, perTexel;
        std::uint32_t number;
    };

    /// Closes the rays of these receivers and groups that the patch blocks. kSheet: those
    /// that surely go through it; the patch's children still count for the others.
    template <bool kSheet>
    void test(const PatchGroup& g, int i, std::uint64_t groups, std::uint32_t lanes) {
        const auto texel = float(1u << g.level[i]);
        const float side = kTexels * texel;
        const Seen seen{g,
                        i,
                        tree_.covers() + g.cover[i],
                        std::floor(g.u[i] / side) * side,
                        std::floor(g.v[i] / side) * side,
                        1.0f / texel,
                        (g.cover[i] * 0x9e3779b1u) >> 28};
        for (lanes &= lanes_; lanes; lanes &= lanes - 1) {
            const int receiver = std::countr_zero(lanes);
            Batch batch;
            batch.startU = bundle_.u[receiver], batch.startV = bundle_.v[receiver];
            batch.startW = bundle_.w[receiver];
            bool closed = false;
            for (std::uint64_t left = groups; left; left &= left - 1) {
                const int row = bundle_.row(receiver, std::countr_zero(left));
                for (int k = 0; k < kLanes; k += kN) {
                    batch.open = (std::uint32_t(bundle_.open[row]) >> k) & kAll;
                    if (batch.open == 0) continue;
                    batch.du = hn::Load(kF, bundle_.du[row] + k);
                    batch.dv = hn::Load(kF, bundle_.dv[row] + k);
                    batch.dw = hn::Load(kF, bundle_.dw[row] + k);
                    batch.begin = hn::Load(kF, bundle_.begin[row] + k);
                    batch.threshold = bundle_.threshold[row] + k;
                    const std::uint32_t hits =
                        kSheet ? through(seen, batch) : met(seen, batch);
                    bundle_.open[row] &= std::uint16_t(~(hits << k));
                    closed = closed || hits == batch.open;
                }
            }
            if (closed && !anyOpen(receiver)) lanes_ &= std::uint16_t(~(1u << receiver));
        }
    }

    /// The depth of the patch's plane over the start, above it.
    static float riseAt(const Seen& p, const Batch& r) {
        const PatchGroup& g = p.g;
        return g.w[p.i] - r.startW + g.gradientU[p.i] * (r.startU - g.u[p.i]) +
               g.gradientV[p.i] * (r.startV - g.v[p.i]);
    }
    /// One over how fast the rays come nearer to the patch's plane.
    static Vec perApproach(const Seen& p, const Batch& r) {
        const Vec speed = hn::NegMulAdd(hn::Set(kF, p.g.gradientU[p.i]), r.du, r.dw);
        return reciprocal(hn::NegMulAdd(hn::Set(kF, p.g.gradientV[p.i]), r.dv, speed));
    }

    /// Rays that go from below a sheet to above it within its box.
    static std::uint32_t through(const Seen& p, const Batch& r) {
        const float rise = riseAt(p, r), residual = p.g.residual[p.i];
        const Vec inverse = perApproach(p, r);
        const Vec s0 = hn::Mul(hn::Set(kF, rise - residual), inverse);
        const Vec s1 = hn::Mul(hn::Set(kF, rise + residual), inverse);
        const Vec u0 = hn::Set(kF, r.startU - p.g.u[p.i]);
        const Vec v0 = hn::Set(kF, r.startV - p.g.v[p.i]);
        const Vec halfU = hn::Set(kF, p.g.halfU[p.i]),
                  halfV = hn::Set(kF, p.g.halfV[p.i]);
        auto hit = hn::And(hn::Gt(s0, r.begin), hn::Le(s1, hn::Set(kF, 1.0f)));
        hit = hn::And(hit, hn::Gt(inverse, hn::Zero(kF)));
        for (const Vec s : {s0, s1}) {
            hit = hn::And(hit, hn::Le(hn::Abs(hn::MulAdd(r.du, s, u0)), halfU));
            hit = hn::And(hit, hn::Le(hn::Abs(hn::MulAdd(r.dv, s, v0)), halfV));
        }
        return bitsOf(hit) & r.open;
    }

    /// Rays that meet the patch's plane where it is covered.
    std::uint32_t met(const Seen& p, const Batch& r) const {
        const Vec s = hn::Mul(hn::Set(kF, riseAt(p, r)), perApproach(p, r));
        const Vec scale = hn::Set(kF, p.perTexel), step = hn::Mul(s, scale);
        const Vec u0 = hn::Set(kF, (r.startU - p.cornerU) * p.perTexel);
        const Vec v0 = hn::Set(kF, (r.startV - p.cornerV) * p.perTexel);
        const Vec u = hn::MulAdd(r.du, step, u0), v = hn::MulAdd(r.dv, step, v0);
        const Vec none = hn::Zero(kF), all = hn::Set(kF, float(kTexels));
        auto hit = hn::And(hn::Gt(s, r.begin), hn::Le(s, hn::Set(kF, 1.0f)));
        hit = hn::And(hit, hn::And(hn::Ge(u, none), hn::Lt(u, all)));
        hit = hn::And(hit, hn::And(hn::Ge(v, none), hn::Lt(v, all)));
        const std::uint32_t hits = bitsOf(hit) & r.open;
        if (hits == 0) return 0;
        const VecI fifteen = hn::Set(kI, kTexels - 1);
        const VecI x = hn::And(hn::ConvertTo(kI, u), fifteen);
        const VecI y = hn::And(hn::ConvertTo(kI, v), fifteen);
        const VecI bit = hn::Shl(hn::Set(kI, 1), x);
        if (!p.g.shared[p.i])
            return hits & bitsOf(hn::Ne(hn::And(rowsAt(*p.cover, y), bit), hn::Zero(kI)));
        return hits & sharesAbove(p, r, y, bit);
    }

    static VecI rowsAt(const CoverPlane& cover, VecI y) {
        if constexpr (kN == kLanes) {
            const hn::Rebind<std::uint16_t, Ints> halves;
            const VecI rows = hn::PromoteTo(kI, hn::LoadU(halves, cover.row));
            return hn::TableLookupLanes(rows, hn::IndicesFromVec(kI, y));
        } else {
            alignas(64) std::int32_t at[kN];
            hn::Store(y, kI, at);
            for (std::int32_t& row : at)
                row = cover.row[row];
            return hn::Load(kI, at);
        }
    }

    /// Rays whose threshold lies below the share of the texel that they cross.
    static std::uint32_t sharesAbove(const Seen& p, const Batch& r, VecI y, VecI bit) {
        VecI share = hn::Zero(kI);
        for (int plane = 0; plane < 4; ++plane) {
            const auto covered =
                hn::Ne(hn::And(rowsAt(p.cover[plane], y), bit), hn::Zero(kI));
            share = hn::Add(share, hn::IfThenElseZero(covered, hn::Set(kI, 1 << plane)));
        }
        const hn::Rebind<std::uint8_t, Ints> bytes;
        const VecI threshold = hn::Xor(hn::PromoteTo(kI, hn::LoadU(bytes, r.threshold)),
                                       hn::Set(kI, std::int32_t(p.number)));
        const auto full = hn::Eq(share, hn::Set(kI, 15));
        return bitsOf(hn::Or(full, hn::Lt(threshold, share)));
    }

    static constexpr int kMostLevels = 24;
    /// How large a texel may be beside the distance of neighbouring rays: twice that
    /// costs as much and errs by a fifth more (tests/bench/NOTES.md).
    static constexpr float kTexel = 0.5f;

    static constexpr std::uint32_t kAll = (1u << kN) - 1;

    const PatchTree& tree_;
    RayBundle& bundle_;
    std::uint16_t lanes_ = 0;  // receivers with open rays
    std::uint16_t mayAnswer_[kMostLevels];
    int top_ = 0;
    struct Hull {
        float uLow, uHigh, vLow, vHigh, wLow, wHigh;
        float slopeLowU, slopeHighU, slopeLowV, slopeHighV;
        float wFirst;  // below this nothing counts
    } hull_;
    bool anyWide_ = false;
    Queue queue_;
};

void tracePatches(const PatchTree& tree, RayBundle& bundle) {
    Traversal(tree, bundle).run();
}

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(tracePatches);

void tracePatches(const PatchTree& tree, RayBundle& bundle) noexcept {
    HWY_DYNAMIC_DISPATCH(tracePatches)(tree, bundle);
}

}  // namespace mtsm::trace
#endif
