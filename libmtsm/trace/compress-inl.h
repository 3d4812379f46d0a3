// compress-inl.h - some lanes of a vector, side by side.
//
// Included by a kernel's .cpp after hwy/foreach_target.h, and so read once for every
// target; HWY_TARGET_TOGGLE lets it pass each time.
#ifndef MTSM_TRACE_SET_LANES
#define MTSM_TRACE_SET_LANES
#include <array>
#include <cstddef>
#include <cstdint>

namespace mtsm::trace {

/// [bits]: the numbers of the bits that are set, from the lowest on, and then zeros.
inline constexpr auto kSetLanes = [] {
    std::array<std::array<std::uint8_t, 8>, 256> lanes = {};
    for (std::size_t bits = 0; bits < lanes.size(); ++bits) {
        std::size_t count = 0;
        for (std::size_t lane = 0; lane < 8; ++lane) {
            if (bits >> lane & 1) lanes[bits][count++] = std::uint8_t(lane);
        }
    }
    return lanes;
}();

}  // namespace mtsm::trace
#endif

#if defined(MTSM_TRACE_COMPRESS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef MTSM_TRACE_COMPRESS_INL_H
#undef MTSM_TRACE_COMPRESS_INL_H
#else
#define MTSM_TRACE_COMPRESS_INL_H
#endif

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::HWY_NAMESPACE {

/// The lanes that are set, from the first one on; what comes behind them is anything.
/// Of lanes of 32 bits.
template <class D, class V, class M>
HWY_INLINE V compress(D d, V x, M mask) {
    namespace hn = hwy::HWY_NAMESPACE;
#if HWY_TARGET == HWY_AVX2
    // Highway's (1.0), built by GCC, copies a table of a kilobyte each time.
    std::uint8_t bits[8] = {};
    hn::StoreMaskBits(d, mask, bits);
    const hn::Rebind<std::uint8_t, D> bytes;
    const auto lanes = hn::PromoteTo(hn::RebindToSigned<D>(),
                                     hn::LoadU(bytes, kSetLanes[bits[0]].data()));
    return hn::TableLookupLanes(x, hn::IndicesFromVec(d, lanes));
#else
    (void)d;
    return hn::Compress(x, mask);
#endif
}

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
