// hilbertPlaces: as many cells at once as a vector holds.
#include "bake/hilbert.h"

// Vectors of a length that is not known in advance cannot be elements of an array.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "bake/hilbert.cpp"
#include <hwy/foreach_target.h>
// After foreach_target.h:
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::bake_detail::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

/// Bit i goes to bit 3 i; 21 bits.
template <typename D, typename V>
HWY_INLINE V everyThirdBit(D d, V x) {
    const auto step = [&]<int kShift>(std::uint64_t kept) {
        x = hn::And(hn::Or(x, hn::ShiftLeft<kShift>(x)), hn::Set(d, kept));
    };
    step.template operator()<32>(0x001f00000000ffff);
    step.template operator()<16>(0x001f0000ff0000ff);
    step.template operator()<8>(0x100f00f00f00f00f);
    step.template operator()<4>(0x10c30c30c30c30c3);
    step.template operator()<2>(0x1249249249249249);
    return x;
}

/// Turns coordinates into those whose bits, one of each axis in turn, are the place.
template <typename D>
HWY_INLINE void turn(D d, std::uint32_t* x, std::uint32_t* y, std::uint32_t* z,
                     int bits) {
    using V = hn::Vec<D>;
    V axis[3] = {hn::LoadU(d, x), hn::LoadU(d, y), hn::LoadU(d, z)};
    const auto isSet = [&](V of, int bit) {  // all bits or none
        return hn::Sub(hn::Zero(d), hn::And(hn::ShiftRightSame(of, bit), hn::Set(d, 1u)));
    };
    // From the coarsest cell to the finest, undo how the curve turns and mirrors in it.
    for (int bit = bits - 1; bit > 0; --bit) {
        const V below = hn::Set(d, (1u << bit) - 1);
        for (V& a : axis) {
            const V mirrored = isSet(a, bit);
            const V swapped = hn::AndNot(mirrored, hn::And(hn::Xor(axis[0], a), below));
            axis[0] = hn::Xor(axis[0], hn::Or(swapped, hn::And(below, mirrored)));
            a = hn::Xor(a, swapped);
        }
    }
    // What is left is a Gray code.
    axis[1] = hn::Xor(axis[1], axis[0]);
    axis[2] = hn::Xor(axis[2], axis[1]);
    V flip = hn::Zero(d);
    for (int bit = bits - 1; bit > 0; --bit)
        flip = hn::Xor(flip, hn::And(hn::Set(d, (1u << bit) - 1), isSet(axis[2], bit)));
    hn::StoreU(hn::Xor(axis[0], flip), d, x);
    hn::StoreU(hn::Xor(axis[1], flip), d, y);
    hn::StoreU(hn::Xor(axis[2], flip), d, z);
}

/// Of turned coordinates.
template <typename D>
HWY_INLINE void interleave(D d, const std::uint32_t* x, const std::uint32_t* y,
                           const std::uint32_t* z, std::uint64_t* places) {
    const hn::Rebind<std::uint32_t, D> half;
    const auto spread = [&](const std::uint32_t* of) {
        return everyThirdBit(d, hn::PromoteTo(d, hn::LoadU(half, of)));
    };
    const auto xy = hn::Or(hn::ShiftLeft<2>(spread(x)), hn::ShiftLeft<1>(spread(y)));
    hn::StoreU(hn::Or(xy, spread(z)), d, places);
}

void placesHere(std::uint32_t* x, std::uint32_t* y, std::uint32_t* z, std::size_t count,
                int bits, std::uint64_t* places) {
    const hn::ScalableTag<std::uint32_t> many;
    const hn::CappedTag<std::uint32_t, 1> one;
    std::size_t i = 0;
    for (; i + hn::Lanes(many) <= count; i += hn::Lanes(many))
        turn(many, x + i, y + i, z + i, bits);
    for (; i < count; ++i)
        turn(one, x + i, y + i, z + i, bits);
    const hn::ScalableTag<std::uint64_t> manyPlaces;
    const hn::CappedTag<std::uint64_t, 1> onePlace;
    for (i = 0; i + hn::Lanes(manyPlaces) <= count; i += hn::Lanes(manyPlaces))
        interleave(manyPlaces, x + i, y + i, z + i, places + i);
    for (; i < count; ++i)
        interleave(onePlace, x + i, y + i, z + i, places + i);
}

}  // namespace
}  // namespace mtsm::bake_detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::bake_detail {

HWY_EXPORT(placesHere);

void hilbertPlaces(std::uint32_t* x, std::uint32_t* y, std::uint32_t* z,
                   std::size_t count, int bits, std::uint64_t* places) noexcept {
    HWY_DYNAMIC_DISPATCH(placesHere)(x, y, z, count, bits, places);
}

}  // namespace mtsm::bake_detail
#endif
