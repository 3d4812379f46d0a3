// findNear: as many planes at a time as a vector holds, without a branch.
#include "trace/patch_planes.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "trace/patch_planes.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "trace/compress-inl.h"
#include "trace/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::patch_detail::HWY_NAMESPACE {
using namespace trace::HWY_NAMESPACE;

std::size_t findNearAt(const PlaneList& planes, std::size_t count, float u, float v,
                       float w, float most, std::uint32_t* found) {
    constexpr Floats d;
    constexpr hn::RebindToUnsigned<Floats> indices;
    constexpr std::size_t lanes = hn::MaxLanes(d);
    static_assert(lanes <= PlaneList::kSpare);
    const auto set = [d](float x) { return hn::Set(d, x); };
    std::size_t number = 0;
    for (std::size_t k = 0; k < count; k += lanes) {
        const auto load = [d, k](const std::vector<float>& x) {
            return hn::LoadU(d, x.data() + k);
        };
        Vec away = hn::MulAdd(load(planes.perU), set(u), load(planes.w));
        away = hn::MulAdd(load(planes.perV), set(v), away);
        away = hn::Sub(hn::Abs(hn::Sub(away, set(w))), load(planes.slack));
        // What is not a number is near.
        const auto near = hn::AndNot(hn::Gt(away, set(most)), hn::FirstN(d, count - k));
        const auto mask = hn::RebindMask(indices, near);
        const auto numbers = hn::Iota(indices, std::uint32_t(k));
        hn::StoreU(compress(indices, numbers, mask), indices, found + number);
        number += hn::CountTrue(d, near);
    }
    return number;
}

}  // namespace mtsm::trace::patch_detail::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::trace::patch_detail {

HWY_EXPORT(findNearAt);

std::size_t findNear(const PlaneList& planes, std::size_t count, float u, float v,
                     float w, float most, std::uint32_t* found) noexcept {
    return HWY_DYNAMIC_DISPATCH(findNearAt)(planes, count, u, v, w, most, found);
}

}  // namespace mtsm::trace::patch_detail
#endif
