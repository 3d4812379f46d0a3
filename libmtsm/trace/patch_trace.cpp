// tracePatches: from the light's end down, breadth first, sixteen patches and then
// sixteen rays at a time.
#include "trace/patch_trace.h"

#include <hwy/cache_control.h>
#include <algorithm>
#include <bit>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/patch_trace.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "trace/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::HWY_NAMESPACE {

using VecI = hn::Vec<Ints>;
constexpr Floats kF;
constexpr Ints kI;
constexpr int kN = int(hn::MaxLanes(kF));

/// Part number i of the same field of four groups, one part being what a vector holds.
template <typename D, typename T>
HWY_INLINE hn::Vec<D> loadField(D d, const PatchGroup* const* groups,
                                const T (PatchGroup::*field)[4], int i) {
    constexpr int lanes = int(hn::MaxLanes(D()));
    if constexpr (lanes < 4) {
        return hn::LoadU(d, groups[i / 4]->*field + i % 4);
    } else if constexpr (lanes == 4) {
        return hn::LoadU(d, groups[i]->*field);
    } else {
#if HWY_TARGET != HWY_SCALAR
        const hn::Half<D> half;
        return hn::Combine(d, loadField(half, groups, field, 2 * i + 1),
                           loadField(half, groups, field, 2 * i));
#endif
    }
}

using Shorts = hn::Rebind<std::uint16_t, Floats>;
using Short = std::uint16_t;

/// The same of floats of which the upper half is stored.
HWY_INLINE Vec loadUpper(const PatchGroup* const* groups,
                         const Short (PatchGroup::*field)[4], int i) {
    const hn::RebindToUnsigned<Floats> bits;
    const auto halves = hn::PromoteTo(bits, loadField(Shorts(), groups, field, i));
    return hn::BitCast(kF, hn::ShiftLeft<16>(halves));
}

/// The same of pixels.
HWY_INLINE Vec loadPixels(const PatchGroup* const* groups,
                          const Short (PatchGroup::*field)[4], int i) {
    return hn::ConvertTo(kF, hn::PromoteTo(kI, loadField(Shorts(), groups, field, i)));
}

/// How large a texel may be beside the distance of neighbouring rays: twice that costs as
/// much and errs by a fifth more (tests/bench/NOTES.md).
constexpr float kTexel = 0.5f;
constexpr int kMostLevels = 24;

/// Groups that wait, with the receivers that they may still matter to.
struct Waiting {
    PatchList list;
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
    std::uint32_t pop(std::uint32_t& slots, std::uint16_t& lanes) {
        const bool full = last_ - first_ > kSize / 2;
        Waiting& w = waiting_[(full ? last_ - 1 : first_) % kSize];
        slots = w.list.slotsOf(0);
        lanes = w.lanes;
        const std::uint32_t group = w.list.group++;
        if (--w.list.groups == 0) full ? --last_ : ++first_;
        return group;
    }

  private:
    // 16 entries at most for every level of the tree and of quarters of patches: far less
    // than half of it.
    static constexpr std::uint32_t kSize = 2048;
    Waiting waiting_[kSize];
    std::uint32_t first_ = 0, last_ = 0;
};

/// Do rays that start between two places, and go sideways between two slopes, cross what
/// lies between two sides while they rise by `least` to `most`?
HWY_INLINE hn::Mask<Floats> crosses(Vec side0, Vec side1, Vec startLow, Vec startHigh,
                                    Vec slopeLow, Vec slopeHigh, Vec least, Vec most) {
    const Vec low = hn::Min(hn::Mul(slopeLow, least), hn::Mul(slopeLow, most));
    const Vec high = hn::Max(hn::Mul(slopeHigh, least), hn::Mul(slopeHigh, most));
    return hn::And(hn::Le(hn::Add(startLow, low), side1),
                   hn::Ge(hn::Add(startHigh, high), side0));
}

/// The same of rays that start in one place each: sides are so far away from it.
HWY_INLINE hn::Mask<Floats> crosses(Vec side0, Vec side1, Vec slopeLow, Vec slopeHigh,
                                    Vec least, Vec most) {
    const Vec low = hn::Min(hn::Mul(slopeLow, least), hn::Mul(slopeLow, most));
    const Vec high = hn::Max(hn::Mul(slopeHigh, least), hn::Mul(slopeHigh, most));
    return hn::And(hn::Le(low, side1), hn::Ge(high, side0));
}

/// Which patches of four groups, of a vector from number `first` on, a ray of the hull
/// can meet; `wide`: all that there are. `margin`: PatchTree's.
HWY_INLINE std::uint32_t meet(const RayHull& hull, bool wide, float margin,
                              const PatchGroup* const* groups, int first) {
    const int i = first / kN;
    const Vec w = loadField(kF, groups, &PatchGroup::w, i);
    const Vec high = hn::Add(w, loadUpper(groups, &PatchGroup::above, i));
    const auto exists = hn::Gt(high, hn::Set(kF, -HUGE_VALF));
    if (wide) return bitsOf(exists);
    const Vec low = hn::Sub(w, loadUpper(groups, &PatchGroup::below, i));
    const Vec more = hn::Set(kF, margin);
    const Vec u0 = hn::Sub(loadPixels(groups, &PatchGroup::u0, i), more);
    const Vec v0 = hn::Sub(loadPixels(groups, &PatchGroup::v0, i), more);
    const Vec u1 = hn::Add(loadPixels(groups, &PatchGroup::u1, i), more);
    const Vec v1 = hn::Add(loadPixels(groups, &PatchGroup::v1, i), more);
    const auto set = [](float x) { return hn::Set(kF, x); };
    const Vec least =
        hn::Max(hn::Zero(kF), hn::Sub(hn::Max(low, set(hull.wFirst)), set(hull.wHigh)));
    const Vec most = hn::Sub(high, set(hull.wLow));
    auto met = hn::And(exists, hn::Ge(high, set(hull.wFirst)));
    met = hn::And(met, crosses(u0, u1, set(hull.uLow), set(hull.uHigh),
                               set(hull.slopeLowU), set(hull.slopeHighU), least, most));
    met = hn::And(met, crosses(v0, v1, set(hull.vLow), set(hull.vHigh),
                               set(hull.slopeLowV), set(hull.slopeHighV), least, most));
    return bitsOf(met);
}

/// The tiles of a level no finer than `level` that the hull's rays go over, few of them:
/// hands them to take(tile).
template <typename Take>
void enterTiles(const PatchTree& tree, const RayHull& hull, bool wide, std::size_t level,
                const Take& take) {
    const std::vector<PatchTree::Level>& levels = tree.levels();
    const float most = std::max(0.0f, tree.highest() - hull.wLow);
    float u0 = hull.uLow + std::min(0.0f, hull.slopeLowU * most);
    float u1 = hull.uHigh + std::max(0.0f, hull.slopeHighU * most);
    float v0 = hull.vLow + std::min(0.0f, hull.slopeLowV * most);
    float v1 = hull.vHigh + std::max(0.0f, hull.slopeHighV * most);
    if (wide) u0 = v0 = -HUGE_VALF, u1 = v1 = HUGE_VALF;
    level = std::min(level, levels.size() - 1);
    while (level + 1 < levels.size() &&
           std::max(u1 - u0, v1 - v0) > 2.0f * float(levels[level].side))
        ++level;
    const PatchTree::Level& entry = levels[level];
    const auto place = [&](float x, std::uint32_t count) {
        const float tile = std::floor(x / float(entry.side));
        return std::uint32_t(std::clamp(tile, 0.0f, float(count - 1)));
    };
    for (std::uint32_t y = place(v0, entry.rows); y <= place(v1, entry.rows); ++y) {
        for (std::uint32_t x = place(u0, entry.columns); x <= place(u1, entry.columns);
             ++x) {
            const PatchList& tile = entry.tiles[std::size_t(y) * entry.columns + x];
            if (tile.groups > 0) take(tile);
        }
    }
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
        pack();
        enter();
        while (!queue_.empty() && lanes_ != 0)
            look();
        unpack();
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
                 HUGE_VALF, -HUGE_VALF, HUGE_VALF, -HUGE_VALF, HUGE_VALF, 0.0f};
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
        enterTiles(tree_, hull_, anyWide_, std::size_t(std::max(top_, 1)),
                   [&](const PatchList& tile) {
                       queue_.push({tile, lanes_});
                   });
    }

    // --- few rays each
    // ---------------------------------------------------------------------

    /// Receivers of up to four rays each share vectors: those of receiver r are lanes
    /// r * each and on.
    struct Packed {
        static constexpr int kMostEach = 4;
        int each = 0;  ///< 0: nothing is packed
        std::uint64_t open = 0;
        alignas(64) float u[kMostReceivers * kMostEach], v[kMostReceivers * kMostEach];
        alignas(64) float w[kMostReceivers * kMostEach];
        alignas(64) float du[kMostReceivers * kMostEach], dv[kMostReceivers * kMostEach];
        alignas(64) float dw[kMostReceivers * kMostEach];
        alignas(64) float begin[kMostReceivers * kMostEach];
        std::uint8_t threshold[kMostReceivers * kMostEach];

        /// Bits of all rays of some receivers.
        [[nodiscard]] std::uint64_t raysOf(std::uint32_t lanes) const {
            std::uint64_t x = lanes;
            if (each == 1) return x;
            if (each == 2) {
                x = (x | x << 8) & 0x00ff00ffu;
                x = (x | x << 4) & 0x0f0f0f0fu;
                x = (x | x << 2) & 0x33333333u;
                return ((x | x << 1) & 0x55555555u) * 3;
            }
            x = (x | x << 24) & 0x000000ff000000ffu;
            x = (x | x << 12) & 0x000f000f000f000fu;
            x = (x | x << 6) & 0x0303030303030303u;
            return ((x | x << 3) & 0x1111111111111111u) * 15;
        }
        [[nodiscard]] std::uint16_t openOf(int receiver) const {
            return std::uint16_t(open >> (receiver * each) & ((1u << each) - 1));
        }
    };

    void pack() {
        packed_.each = 0;
        if (bundle_.groups != 1 || std::has_single_bit(lanes_)) return;
        std::uint32_t any = 0;
        for (int i = 0; i < bundle_.receivers; ++i)
            any |= bundle_.open[i];
        if (any >> Packed::kMostEach) return;
        const int each = any >> 2 ? 4 : any >> 1 ? 2 : 1;
        packed_.each = each;
        packed_.open = 0;
        for (int i = 0; i < kMostReceivers; ++i) {
            const bool is = i < bundle_.receivers;
            const int row = is ? i : 0, first = i * each;
            if (is) packed_.open |= std::uint64_t(bundle_.open[row]) << first;
            for (int k = 0; k < each; ++k) {
                packed_.u[first + k] = bundle_.u[i];
                packed_.v[first + k] = bundle_.v[i];
                packed_.w[first + k] = bundle_.w[i];
                packed_.du[first + k] = bundle_.du[row][k];
                packed_.dv[first + k] = bundle_.dv[row][k];
                packed_.dw[first + k] = bundle_.dw[row][k];
                packed_.begin[first + k] = bundle_.begin[row][k];
                packed_.threshold[first + k] = bundle_.threshold[row][k];
            }
        }
    }

    void unpack() {
        for (int i = 0; packed_.each > 0 && i < bundle_.receivers; ++i)
            bundle_.open[i] = packed_.openOf(i);
    }

    // --- patches
    // ---------------------------------------------------------------------------

    /// Looks at up to four groups.
    void look() {
        const PatchGroup* groups[4];
        std::uint16_t lanes[4];
        std::uint32_t met = 0;
        for (int i = 0; i < 4; ++i) {
            groups[i] = tree_.groups();  // any one, if there is none to look at
            lanes[i] = 0;
            if (!queue_.empty()) {
                std::uint32_t slots = 0;
                groups[i] += queue_.pop(slots, lanes[i]);
                met |= slots << (4 * i);
            }
        }
        std::uint32_t reached = 0;
        for (int i = 0; i < 16; i += kN)
            reached |= meet(hull_, anyWide_, tree_.margin(), groups, i) << i;
        met &= reached;
        if (met == 0) return;
        std::uint32_t open[16] = {}, far[16] = {};
        for (int k = 0; k < kLanes; k += kN)
            findLanes(groups, met, k, open, far);
        std::uint32_t some = 0;
        for (std::uint32_t rest = met; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            open[i] &= lanes[i / 4];
            some |= std::uint32_t(open[i] != 0) << i;
            hwy::Prefetch(tree_.covers() + groups[i / 4]->cover[i % 4]);
        }
        for (; some; some &= some - 1) {
            const int i = std::countr_zero(some);
            visit(groups[i / 4]->patch(i % 4), open[i] & lanes_, far[i]);
            if (lanes_ == 0) return;
        }
    }

    /// Of as many receivers as a vector holds, from number k on, and patches of four
    /// groups: `open`, some of whose rays may meet the patch, above their tangent planes;
    /// `far`, so far away that the patch is as fine as their rays are dense. No branch
    /// depends on what is found.
    void findLanes(const PatchGroup* const* groups, std::uint32_t met, int k,
                   std::uint32_t* open, std::uint32_t* far) const {
        const auto load = [k](const float* p) { return hn::Load(kF, p + k); };
        const auto set = [](float x) { return hn::Set(kF, x); };
        const Vec u = load(bundle_.u), v = load(bundle_.v), w = load(bundle_.w);
        const Vec rise = load(bundle_.rise);
        const Vec lowU = load(bundle_.slopeLowU), highU = load(bundle_.slopeHighU);
        const Vec lowV = load(bundle_.slopeLowV), highV = load(bundle_.slopeHighV);
        const Vec slant = load(bundle_.slant);
        const Vec dense = hn::Mul(load(bundle_.spread), set(kTexel));
        const float margin = tree_.margin();
        const bool planes = bundle_.hasPlanes;
        const Vec a = planes ? load(bundle_.planeU) : hn::Zero(kF);
        const Vec b = planes ? load(bundle_.planeV) : hn::Zero(kF);
        const Vec c = planes ? load(bundle_.planeW) : hn::Zero(kF);
        const Vec height = set(planes ? bundle_.planeHeight : -HUGE_VALF);
        const std::uint32_t wide = (std::uint32_t(bundle_.wide) >> k) & kAll;
        for (; met; met &= met - 1) {
            const int number = std::countr_zero(met);
            const Patch p = groups[number / 4]->patch(number % 4);
            const Vec halfU = set(p.halfU + margin), halfV = set(p.halfV + margin);
            const Vec awayU = hn::Sub(set(p.u), u), awayV = hn::Sub(set(p.v), v);
            const Vec lowest = hn::Sub(set(p.low), w);
            const Vec least = hn::Max(lowest, rise), most = hn::Sub(set(p.high), w);
            auto met16 = hn::Ge(most, rise);
            met16 = hn::And(met16, crosses(hn::Sub(awayU, halfU), hn::Add(awayU, halfU),
                                           lowU, highU, least, most));
            met16 = hn::And(met16, crosses(hn::Sub(awayV, halfV), hn::Add(awayV, halfV),
                                           lowV, highV, least, most));
            // Height at the box's centre, and how it changes along the patch's plane.
            Vec above = hn::MulAdd(b, awayV, hn::Mul(a, awayU));
            above = hn::MulAdd(c, hn::Sub(set(p.w), w), above);
            const Vec perU = hn::MulAdd(c, set(p.gradientU), a);
            const Vec perV = hn::MulAdd(c, set(p.gradientV), b);
            above = hn::MulAdd(hn::Abs(perU), halfU, above);
            above = hn::MulAdd(hn::Abs(perV), halfV, above);
            above = hn::MulAdd(hn::Abs(c), set(p.residual), above);
            const auto higher = hn::Gt(above, height);
            open[number] |= ((bitsOf(met16) | wide) & bitsOf(higher)) << k;
            // Of a single ray straight to the light both are zero: then nothing is coarse
            // enough.
            const Vec coarse = hn::Max(hn::Mul(slant, set(p.residual)), set(p.texel));
            far[number] |= bitsOf(hn::Lt(coarse, hn::Mul(dense, lowest))) << k;
        }
    }

    /// Groups of rays that may meet the patch.
    [[nodiscard]] std::uint64_t groupsMet(const Patch& p) const {
        const std::uint64_t all = ~std::uint64_t(0) >> (64 - bundle_.groups);
        if (bundle_.groups == 1 || anyWide_) return all;
        const auto set = [](float x) { return hn::Set(kF, x); };
        const Vec least =
            set(std::max(0.0f, std::max(p.low, hull_.wFirst) - hull_.wHigh));
        const Vec most = set(p.high - hull_.wLow);
        const float halfU = p.halfU + tree_.margin(), halfV = p.halfV + tree_.margin();
        std::uint64_t groups = 0;
        for (int k = 0; k < bundle_.groups; k += kN) {
            const auto inU =
                crosses(set(p.u - halfU), set(p.u + halfU), set(hull_.uLow),
                        set(hull_.uHigh), hn::Load(kF, bundle_.groupLowU + k),
                        hn::Load(kF, bundle_.groupHighU + k), least, most);
            const auto inV =
                crosses(set(p.v - halfV), set(p.v + halfV), set(hull_.vLow),
                        set(hull_.vHigh), hn::Load(kF, bundle_.groupLowV + k),
                        hn::Load(kF, bundle_.groupHighV + k), least, most);
            groups |= std::uint64_t(bitsOf(hn::And(inU, inV))) << k;
        }
        return groups & all;
    }

    /// `lanes`, `far`: as findLanes finds them.
    void visit(const Patch& p, std::uint32_t lanes, std::uint32_t far) {
        if (lanes == 0) return;
        const std::uint64_t groups = groupsMet(p);
        if (groups == 0) return;
        std::uint32_t answered = lanes;
        if (!p.isLeaf()) {
            answered &= mayAnswer_[p.level];
            if (answered && p.sheet) test<Kind::sheet>(p, groups, answered);
            answered &= far & ~std::uint32_t(bundle_.wide);
        }
        if (answered && p.bumpy)
            test<Kind::bumpy>(p, groups, answered);
        else if (answered)
            test<Kind::whole>(p, groups, answered);
        const std::uint32_t rest = lanes & ~answered & lanes_;
        if (rest == 0) return;
        queue_.push({p.children, std::uint16_t(rest)});
        const auto* next =
            reinterpret_cast<const char*>(tree_.groups() + p.children.group);
        for (std::size_t at = 0; at < sizeof(PatchGroup); at += 64)
            hwy::Prefetch(next + at);
    }

    // --- rays
    // ------------------------------------------------------------------------------

    /// As many rays as fill a vector: of one receiver, or packed ones.
    struct Batch {
        Vec u, v;  ///< the start's place in the patch: texels from the tile's corner
        Vec rise;  ///< of the patch's plane above the start, there, w
        Vec du, dv, dw, begin;
        std::uint32_t open;
        const std::uint8_t* threshold;
    };

    /// The patch as rays see it.
    struct Seen {
        const Patch& patch;
        const std::uint16_t* cover;
        float cornerU, cornerV, perTexel;
        int column, columns, row, rows;  // texels of its box, in the tile
        std::uint32_t tile;  ///< if its texels are shared: a number of the tile

        /// Sets what a batch knows of the starts.
        void place(Vec u, Vec v, Vec w, Batch& batch) const {
            const auto set = [](float x) { return hn::Set(kF, x); };
            batch.rise = hn::Sub(set(patch.w), w);
            batch.rise =
                hn::MulAdd(set(patch.gradientU), hn::Sub(u, set(patch.u)), batch.rise);
            batch.rise =
                hn::MulAdd(set(patch.gradientV), hn::Sub(v, set(patch.v)), batch.rise);
            batch.u = hn::Mul(hn::Sub(u, set(cornerU)), set(perTexel));
            batch.v = hn::Mul(hn::Sub(v, set(cornerV)), set(perTexel));
        }
    };

    enum class Kind { whole, sheet, bumpy };
    /// Closes the rays of these receivers and groups that the patch blocks. Of a sheet:
    /// those that surely go through it; the patch's children still count for the others.
    template <Kind kKind>
    void test(const Patch& p, std::uint64_t groups, std::uint32_t lanes) {
        const Seen seen =
            seenBy(p, kKind == Kind::bumpy ? BumpPlane::kSide : kTexels << p.level);
        if (packed_.each > 0)
            testPacked<kKind>(seen, lanes);
        else
            testRows<kKind>(seen, groups, lanes);
    }

    template <Kind kKind>
    std::uint32_t hitsOf(const Seen& seen, const Batch& batch) const {
        if constexpr (kKind == Kind::sheet)
            return through(seen, batch);
        else if constexpr (kKind == Kind::bumpy)
            return metBumps(seen, batch);
        else
            return met(seen, batch);
    }

    template <Kind kKind>
    void testRows(const Seen& seen, std::uint64_t groups, std::uint32_t lanes) {
        alignas(64) float us[kMostReceivers], vs[kMostReceivers], rises[kMostReceivers];
        Batch batch;
        for (int k = 0; k < kMostReceivers; k += kN) {
            seen.place(hn::Load(kF, bundle_.u + k), hn::Load(kF, bundle_.v + k),
                       hn::Load(kF, bundle_.w + k), batch);
            hn::Store(batch.u, kF, us + k);
            hn::Store(batch.v, kF, vs + k);
            hn::Store(batch.rise, kF, rises + k);
        }
        std::uint32_t closed = 0;
        const auto testRow = [&](int receiver, int group) {
            const int row = bundle_.row(receiver, group);
            batch.u = hn::Set(kF, us[receiver]);
            batch.v = hn::Set(kF, vs[receiver]);
            batch.rise = hn::Set(kF, rises[receiver]);
            for (int k = 0; k < kLanes; k += kN) {
                batch.open = (std::uint32_t(bundle_.open[row]) >> k) & kAll;
                if (batch.open == 0) continue;
                batch.du = hn::Load(kF, bundle_.du[row] + k);
                batch.dv = hn::Load(kF, bundle_.dv[row] + k);
                batch.dw = hn::Load(kF, bundle_.dw[row] + k);
                batch.begin = hn::Load(kF, bundle_.begin[row] + k);
                batch.threshold = bundle_.threshold[row] + k;
                const std::uint32_t hits = hitsOf<kKind>(seen, batch);
                bundle_.open[row] &= std::uint16_t(~(hits << k));
                closed |= std::uint32_t(hits == batch.open) << receiver;
            }
        };
        lanes &= lanes_;
        if (std::popcount(lanes) < std::popcount(groups)) {
            for (std::uint32_t rest = lanes; rest; rest &= rest - 1) {
                const int receiver = std::countr_zero(rest);
                std::uint64_t some = groups;
                if (bundle_.groups > 1) some &= groupsMet(seen.patch, receiver);
                for (; some; some &= some - 1)
                    testRow(receiver, std::countr_zero(some));
            }
        } else {
            for (std::uint64_t left = groups; left; left &= left - 1) {
                const int group = std::countr_zero(left);
                std::uint32_t some = lanes;
                if (bundle_.groups > 1) some &= lanesMet(seen.patch, group);
                for (; some; some &= some - 1)
                    testRow(std::countr_zero(some), group);
            }
        }
        for (; closed; closed &= closed - 1) {
            const int receiver = std::countr_zero(closed);
            if (!anyOpen(receiver)) lanes_ &= std::uint16_t(~(1u << receiver));
        }
    }

    template <Kind kKind>
    void testPacked(const Seen& seen, std::uint32_t lanes) {
        const std::uint64_t rays = packed_.open & packed_.raysOf(lanes & lanes_);
        std::uint64_t closed = 0;
        Batch batch;
        for (int k = 0; k < kMostReceivers * packed_.each; k += kN) {
            batch.open = std::uint32_t(rays >> k) & kAll;
            if (batch.open == 0) continue;
            seen.place(hn::Load(kF, packed_.u + k), hn::Load(kF, packed_.v + k),
                       hn::Load(kF, packed_.w + k), batch);
            batch.du = hn::Load(kF, packed_.du + k);
            batch.dv = hn::Load(kF, packed_.dv + k);
            batch.dw = hn::Load(kF, packed_.dw + k);
            batch.begin = hn::Load(kF, packed_.begin + k);
            batch.threshold = packed_.threshold + k;
            closed |= std::uint64_t(hitsOf<kKind>(seen, batch)) << k;
        }
        if (closed == 0) return;
        packed_.open &= ~closed;
        for (std::uint32_t rest = lanes & lanes_; rest; rest &= rest - 1) {
            const int receiver = std::countr_zero(rest);
            if (packed_.openOf(receiver) == 0) lanes_ &= std::uint16_t(~(1u << receiver));
        }
    }

    /// `side`: of the square in which its texels are counted, pixels.
    Seen seenBy(const Patch& p, int side) const {
        const auto texel = float(1u << p.level), square = float(side);
        Seen seen{p,
                  tree_.covers() + p.cover,
                  std::floor(p.u / square) * square,
                  std::floor(p.v / square) * square,
                  1.0f / texel,
                  p.firstColumn(),
                  p.columns(),
                  p.firstRow(),
                  p.rows(),
                  0u};
        if (p.shared) {
            const auto x = std::uint32_t(seen.cornerU), y = std::uint32_t(seen.cornerV);
            seen.tile = (x * 0x85ebca6bu) ^ (y * 0xc2b2ae35u);
        }
        return seen;
    }

    /// Receivers some of whose rays of the group may meet the patch.
    std::uint32_t lanesMet(const Patch& p, int group) const {
        const auto set = [](float x) { return hn::Set(kF, x); };
        const Vec halfU = set(p.halfU + tree_.margin());
        const Vec halfV = set(p.halfV + tree_.margin());
        std::uint32_t met = bundle_.wide;
        for (int k = 0; k < kMostReceivers; k += kN) {
            const auto load = [k](const float* x) { return hn::Load(kF, x + k); };
            const Vec w = load(bundle_.w);
            const Vec least = hn::Max(hn::Sub(set(p.low), w), load(bundle_.rise));
            const Vec most = hn::Sub(set(p.high), w);
            const Vec awayU = hn::Sub(set(p.u), load(bundle_.u));
            const Vec awayV = hn::Sub(set(p.v), load(bundle_.v));
            const auto met16 =
                hn::And(crosses(hn::Sub(awayU, halfU), hn::Add(awayU, halfU),
                                load(bundle_.partLowU[group]),
                                load(bundle_.partHighU[group]), least, most),
                        crosses(hn::Sub(awayV, halfV), hn::Add(awayV, halfV),
                                load(bundle_.partLowV[group]),
                                load(bundle_.partHighV[group]), least, most));
            met |= bitsOf(met16) << k;
        }
        return met;
    }

    /// Groups of the receiver's rays that may meet the patch.
    std::uint64_t groupsMet(const Patch& p, int receiver) const {
        if (bundle_.wide >> receiver & 1) return ~std::uint64_t(0);
        const auto set = [](float x) { return hn::Set(kF, x); };
        const float w = bundle_.w[receiver];
        const Vec least = set(std::max(p.low - w, bundle_.rise[receiver]));
        const Vec most = set(p.high - w);
        const float halfU = p.halfU + tree_.margin(), halfV = p.halfV + tree_.margin();
        const float awayU = p.u - bundle_.u[receiver], awayV = p.v - bundle_.v[receiver];
        const Vec u0 = set(awayU - halfU), u1 = set(awayU + halfU);
        const Vec v0 = set(awayV - halfV), v1 = set(awayV + halfV);
        std::uint64_t met = 0;
        for (int k = 0; k < bundle_.groups; k += kN) {
            const auto load = [at = bundle_.row(receiver, k)](const float* x) {
                return hn::LoadU(kF, x + at);
            };
            const auto met16 = hn::And(crosses(u0, u1, load(bundle_.rowLowU),
                                               load(bundle_.rowHighU), least, most),
                                       crosses(v0, v1, load(bundle_.rowLowV),
                                               load(bundle_.rowHighV), least, most));
            met |= std::uint64_t(bitsOf(met16)) << k;
        }
        return met;
    }

    /// One over how fast the rays come nearer to the patch's plane.
    static Vec perApproach(const Seen& p, const Batch& r) {
        const Vec speed = hn::NegMulAdd(hn::Set(kF, p.patch.gradientU), r.du, r.dw);
        return reciprocal(hn::NegMulAdd(hn::Set(kF, p.patch.gradientV), r.dv, speed));
    }

    /// Rays that go from below a sheet to above it within its box.
    static std::uint32_t through(const Seen& p, const Batch& r) {
        const float residual = p.patch.residual, texel = 1.0f / p.perTexel;
        const Vec inverse = perApproach(p, r);
        const Vec s0 = hn::Mul(hn::Sub(r.rise, hn::Set(kF, residual)), inverse);
        const Vec s1 = hn::Mul(hn::Add(r.rise, hn::Set(kF, residual)), inverse);
        const Vec side = hn::Set(kF, texel);
        const Vec u0 = hn::Add(hn::Mul(r.u, side), hn::Set(kF, p.cornerU - p.patch.u));
        const Vec v0 = hn::Add(hn::Mul(r.v, side), hn::Set(kF, p.cornerV - p.patch.v));
        const Vec halfU = hn::Set(kF, p.patch.halfU), halfV = hn::Set(kF, p.patch.halfV);
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
        const Vec s = hn::Mul(r.rise, perApproach(p, r));
        const Vec step = hn::Mul(s, hn::Set(kF, p.perTexel));
        const Vec u = hn::MulAdd(r.du, step, r.u);
        const Vec v = hn::MulAdd(r.dv, step, r.v);
        const auto inside = [](Vec x, int first, int count) {
            return hn::And(hn::Ge(x, hn::Set(kF, float(first))),
                           hn::Lt(x, hn::Set(kF, float(first + count))));
        };
        auto hit = hn::And(hn::Gt(s, r.begin), hn::Le(s, hn::Set(kF, 1.0f)));
        hit = hn::And(hit, inside(u, p.column, p.columns));
        hit = hn::And(hit, inside(v, p.row, p.rows));
        const std::uint32_t hits = bitsOf(hit) & r.open;
        if (hits == 0) return 0;
        const VecI fifteen = hn::Set(kI, kTexels - 1);
        const VecI x = hn::And(hn::ConvertTo(kI, u), fifteen);
        const VecI row = hn::Sub(hn::ConvertTo(kI, v), hn::Set(kI, p.row));
        const VecI y = hn::And(row, fifteen);
        const VecI bit = hn::Shl(hn::Set(kI, 1), x);
        if (!p.patch.shared)
            return hits & bitsOf(hn::Ne(hn::And(rowsAt(p.cover, y), bit), hn::Zero(kI)));
        return hits & sharesAbove(p, r, x, y, bit);
    }

    /// Rays that meet the pixels of a bumpy patch, each of which lies on a plane of its
    /// own.
    std::uint32_t metBumps(const Seen& p, const Batch& r) const {
        const BumpPlane bumps = tree_.bumps(p.patch.cover);
        const Vec inverse = perApproach(p, r);
        const float perStep = p.patch.residual / BumpPlane::kSteps;
        const Vec none = hn::Zero(kF), one = hn::Set(kF, 1.0f);
        auto hit = hn::Gt(none, one);
        for (int t = 0; t < BumpPlane::kSide * BumpPlane::kSide; ++t) {
            if (bumps.offset[t] == BumpPlane::kNone) continue;
            const Vec above =
                hn::Add(r.rise, hn::Set(kF, perStep * float(bumps.offset[t])));
            const Vec s = hn::Mul(above, inverse);
            const Vec column = hn::Set(kF, float(t % BumpPlane::kSide));
            const Vec row = hn::Set(kF, float(t / BumpPlane::kSide));
            const Vec u = hn::MulAdd(r.du, s, hn::Sub(r.u, column));
            const Vec v = hn::MulAdd(r.dv, s, hn::Sub(r.v, row));
            auto inside = hn::And(hn::Gt(s, r.begin), hn::Le(s, one));
            inside = hn::And(inside, hn::And(hn::Ge(u, none), hn::Lt(u, one)));
            inside = hn::And(inside, hn::And(hn::Ge(v, none), hn::Lt(v, one)));
            hit = hn::Or(hit, inside);
        }
        return bitsOf(hit) & r.open;
    }

    /// Of 16 rows.
    static VecI rowsAt(const std::uint16_t* cover, VecI y) {
        if constexpr (kN == kLanes) {
            const hn::Rebind<std::uint16_t, Ints> halves;
            const VecI rows = hn::PromoteTo(kI, hn::LoadU(halves, cover));
            return hn::TableLookupLanes(rows, hn::IndicesFromVec(kI, y));
        } else {
            alignas(64) std::int32_t at[kN];
            hn::Store(y, kI, at);
            for (std::int32_t& row : at)
                row = cover[row];
            return hn::Load(kI, at);
        }
    }

    /// Rays whose threshold lies within the share of the texel that they cross. A ray has
    /// one threshold for all patches that share a texel, others for other texels.
    static std::uint32_t sharesAbove(const Seen& p, const Batch& r, VecI x, VecI y,
                                     VecI bit) {
        const auto covered = [&](int plane) {
            return hn::Ne(hn::And(rowsAt(p.cover + plane * p.rows, y), bit),
                          hn::Zero(kI));
        };
        VecI share = hn::Zero(kI);
        for (int plane = 0; plane < 4; ++plane)
            share = hn::Add(share,
                            hn::IfThenElseZero(covered(plane), hn::Set(kI, 1 << plane)));
        const VecI row = hn::Add(y, hn::Set(kI, p.row));
        const VecI texel = hn::Add(hn::ShiftLeft<4>(row), x);
        const VecI mixed = hn::Mul(hn::Add(texel, hn::Set(kI, std::int32_t(p.tile))),
                                   hn::Set(kI, std::int32_t(0x9e3779b1u)));
        const hn::Rebind<std::uint8_t, Ints> bytes;
        const VecI fifteen = hn::Set(kI, 15);
        VecI threshold = hn::Xor(hn::PromoteTo(kI, hn::LoadU(bytes, r.threshold)),
                                 hn::And(hn::ShiftRight<28>(mixed), fifteen));
        threshold = hn::Xor(threshold, hn::IfThenElseZero(covered(4), fifteen));
        const auto full = hn::Eq(share, fifteen);
        return bitsOf(hn::Or(full, hn::Lt(threshold, share)));
    }

    static constexpr std::uint32_t kAll = (1u << kN) - 1;

    const PatchTree& tree_;
    RayBundle& bundle_;
    std::uint16_t lanes_ = 0;  // receivers with open rays
    std::uint16_t mayAnswer_[kMostLevels];
    int top_ = 0;
    RayHull hull_;
    bool anyWide_ = false;
    Packed packed_;
    Queue queue_;
};

void tracePatches(const PatchTree& tree, RayBundle& bundle) {
    Traversal(tree, bundle).run();
}

/// mayMeet: depth first, until a patch is met that may be taken as it is.
class Glance {
  public:
    Glance(const PatchTree& tree, const RayHull& hull) : tree_(tree), hull_(hull) {}

    bool run() {
        enterTiles(tree_, hull_, false, firstLevel(),
                   [&](const PatchList& tile) { push(tile); });
        for (int looks = 0; waiting_ > 0; ++looks) {
            if (full_ || looks == kMostLooks || look()) return true;
        }
        return full_;
    }

  private:
    /// No finer than the first at which some ray may be answered (RayBundle::topLevel).
    [[nodiscard]] std::size_t firstLevel() const {
        const float width = std::max(hull_.slopeHighU - hull_.slopeLowU,
                                     hull_.slopeHighV - hull_.slopeLowV) *
                            (tree_.highest() - hull_.wLow);
        std::size_t level = 1;
        for (float side = kTexels; side < width && level < kMostLevels; side *= 2.0f)
            ++level;
        return level;
    }

    void push(const PatchList& list) {
        for (std::uint32_t i = 0; i < list.groups; ++i) {
            if (waiting_ == kSize) {
                full_ = true;
                return;
            }
            stack_[waiting_++] = {list.group + i, 1, list.slotsOf(i)};
        }
    }

    /// At up to four groups; true: what is met is as fine as it gets.
    bool look() {
        const PatchGroup* groups[4];
        std::uint32_t met = 0;
        for (int i = 0; i < 4; ++i) {
            groups[i] = tree_.groups();  // any one, if there is none to look at
            if (waiting_ > 0) {
                const PatchList& one = stack_[--waiting_];
                groups[i] += one.group;
                met |= std::uint32_t(one.slots) << (4 * i);
            }
        }
        std::uint32_t reached = 0;
        for (int i = 0; i < 16; i += kN)
            reached |= meet(hull_, false, tree_.margin(), groups, i) << i;
        for (met &= reached; met; met &= met - 1) {
            const int i = std::countr_zero(met);
            if (isFine(groups[i / 4]->patch(i % 4))) return true;
            push(groups[i / 4]->childrenOf(i % 4));
        }
        return false;
    }

    /// It is if rays may take it as it is, so that what its children say is not what they
    /// would find; and where its children would tell little more.
    [[nodiscard]] bool isFine(const Patch& p) const {
        const float most = p.high - hull_.wLow;
        const float u =
            hull_.uHigh - hull_.uLow + most * (hull_.slopeHighU - hull_.slopeLowU);
        const float v =
            hull_.vHigh - hull_.vLow + most * (hull_.slopeHighV - hull_.slopeLowV);
        return p.isLeaf() || p.texel <= hull_.spread * kTexel * (p.low - hull_.wLow) ||
               std::max(p.halfU, p.halfV) <= std::max(u, v);
    }

    static constexpr int kMostLooks = 16, kSize = 128;
    const PatchTree& tree_;
    const RayHull& hull_;
    PatchList stack_[kSize];  // of one group each
    int waiting_ = 0;
    bool full_ = false;
};

bool mayMeet(const PatchTree& tree, const RayHull& hull) {
    return Glance(tree, hull).run();
}

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace {

HWY_EXPORT(tracePatches);
HWY_EXPORT(mayMeet);

void tracePatches(const PatchTree& tree, RayBundle& bundle) noexcept {
    HWY_DYNAMIC_DISPATCH(tracePatches)(tree, bundle);
}

bool mayMeet(const PatchTree& tree, const RayHull& hull) noexcept {
    return HWY_DYNAMIC_DISPATCH(mayMeet)(tree, hull);
}

}  // namespace mtsm::trace
#endif
