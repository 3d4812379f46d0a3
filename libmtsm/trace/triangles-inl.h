// triangles-inl.h - the triangles of a chunk of a near field, as vectors of them.
//
// Included as lanes-inl.h is, after it.
#if defined(MTSM_TRACE_TRIANGLES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef MTSM_TRACE_TRIANGLES_INL_H
#undef MTSM_TRACE_TRIANGLES_INL_H
#else
#define MTSM_TRACE_TRIANGLES_INL_H
#endif

#include <hwy/highway.h>
#include <cmath>
#include <cstddef>

#include "mtsm/near_field.h"
#include "trace/bundle.h"
#include "trace/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace mtsm::trace::HWY_NAMESPACE {

constexpr int kTriangles = NearChunk::kTriangles;

/// A chunk's corners, and its triangles' boxes.
struct Triangles {
    using Axes = float[3][kTriangles];  // [axis][triangle]
    alignas(64) Axes corner[3];
    alignas(64) Axes low, high;
    const float (&step)[3];  ///< of the grid that the corners are rounded to

    explicit Triangles(const NearChunk& chunk) : step(chunk.step) {
        const Floats d;
        const hn::Rebind<std::int32_t, Floats> whole;
        const hn::Rebind<std::uint16_t, Floats> stored;
        for (int axis = 0; axis < 3; ++axis) {
            const Vec first = hn::Set(d, chunk.low[axis]);
            const Vec size = hn::Set(d, step[axis]);
            for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
                Vec p[3];
                for (int c = 0; c < 3; ++c) {
                    const auto q = hn::LoadU(stored, chunk.corner[c][axis] + t);
                    const Vec steps = hn::ConvertTo(d, hn::PromoteTo(whole, q));
                    p[c] = hn::Add(first, hn::Mul(size, steps));
                    hn::Store(p[c], d, corner[c][axis] + t);
                }
                hn::Store(hn::Min(hn::Min(p[0], p[1]), p[2]), d, low[axis] + t);
                hn::Store(hn::Max(hn::Max(p[0], p[1]), p[2]), d, high[axis] + t);
            }
        }
    }

    [[nodiscard]] static Vec3 load(Floats d, const Axes& p, std::size_t t) {
        return {hn::Load(d, p[0] + t), hn::Load(d, p[1] + t), hn::Load(d, p[2] + t)};
    }

    /// How far above the receiver's plane a corner may seem that lies on it, for the grid
    /// that it has been rounded to.
    [[nodiscard]] float roundingAbove(const RayBundle& rays, int receiver) const {
        return 0.5f * (std::abs(rays.planeU[receiver]) * step[0] +
                       std::abs(rays.planeV[receiver]) * step[1] +
                       std::abs(rays.planeW[receiver]) * step[2]);
    }
};

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
