// lanes-inl.h - sixteen lanes of floats, in as many vectors as the processor needs for
// them: what the kernels of the fast trace have in common.
//
// Included by a kernel's .cpp after hwy/foreach_target.h, and so read once for every
// target; HWY_TARGET_TOGGLE lets it pass each time.
#if defined(MTSM_TRACE_LANES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef MTSM_TRACE_LANES_INL_H
#undef MTSM_TRACE_LANES_INL_H
#else
#define MTSM_TRACE_LANES_INL_H
#endif

#include <hwy/highway.h>
#include <bit>
#include <cstdint>
#include <cstring>

#include "trace/bundle.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Floats = hn::CappedTag<float, kLanes>;
using Ints = hn::RebindToSigned<Floats>;
using Vec = hn::Vec<Floats>;
using Mask = hn::Mask<Floats>;

/// Bit i is set if lane i is. Not for vectors whose length is known only when run.
HWY_INLINE std::uint32_t bitsOf(Mask mask) {
    static_assert(std::endian::native == std::endian::little);
    std::uint64_t bits = 0;
    hn::StoreMaskBits(Floats(), mask, reinterpret_cast<std::uint8_t*>(&bits));
    return std::uint32_t(bits);
}
HWY_INLINE std::uint32_t bitsOf(hn::Mask<Ints> mask) {
    return bitsOf(hn::RebindMask(Floats(), mask));
}

/// Lane i is set if bit i is.
HWY_INLINE Mask maskOf(std::uint32_t bits) {
    const std::uint8_t bytes[8] = {std::uint8_t(bits), std::uint8_t(bits >> 8)};
    return hn::LoadMaskBits(Floats(), bytes);
}

/// 1 / x but for the last bit or two.
HWY_INLINE Vec reciprocal(Vec x) {
    const Vec two = hn::Set(Floats(), 2.0f);
    Vec guess = hn::ApproximateReciprocal(x);
#if HWY_TARGET == HWY_NEON  // starts from 8 bits
    guess = hn::Mul(guess, hn::NegMulAdd(x, guess, two));
#endif
    return hn::Mul(guess, hn::NegMulAdd(x, guess, two));
}

/// A point or a direction for each lane.
struct Vec3 {
    Vec x, y, z;
};

HWY_INLINE Vec3 add(const Vec3& a, const Vec3& b) {
    return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}

HWY_INLINE Vec3 subtract(const Vec3& a, const Vec3& b) {
    return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}

HWY_INLINE Vec3 scaled(const Vec3& a, Vec by) {
    return {hn::Mul(a.x, by), hn::Mul(a.y, by), hn::Mul(a.z, by)};
}

/// Without fused multiply-adds: rounded the same on every machine.
HWY_INLINE Vec dot(const Vec3& a, const Vec3& b) {
    return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}

HWY_INLINE Vec fusedDot(const Vec3& a, const Vec3& b) {
    return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}

/// Without fused multiply-adds.
HWY_INLINE Vec3 cross(const Vec3& a, const Vec3& b) {
    return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)),
            hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
            hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}

HWY_INLINE Vec3 broadcast(const float (&p)[3]) {
    const Floats d;
    return {hn::Set(d, p[0]), hn::Set(d, p[1]), hn::Set(d, p[2])};
}

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
