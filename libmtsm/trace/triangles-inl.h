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

    Triangles(const NearChunks& chunks, std::size_t i) : step(chunks.place(i).step) {
        const Floats d;
        const NearChunks::Place& place = chunks.place(i);
        const std::uint16_t* const q = chunks.points(i);
        if (place.points <= std::uint64_t(kLanes))
            unpack<kLanes>(place, q, chunks.corners(i));
        else if (place.areShared())
            unpack<NearChunks::kMostShared>(place, q, chunks.corners(i));
        else if (place.areShort())
            unpackCorners<true>(place, q);
        else
            unpackCorners<false>(place, q);
        for (int axis = 0; axis < 3; ++axis) {
            for (std::size_t t = 0; t < kTriangles; t += hn::Lanes(d)) {
                const Vec a = hn::Load(d, corner[0][axis] + t);
                const Vec b = hn::Load(d, corner[1][axis] + t);
                const Vec c = hn::Load(d, corner[2][axis] + t);
                hn::Store(hn::Min(hn::Min(a, b), c), d, low[axis] + t);
                hn::Store(hn::Max(hn::Max(a, b), c), d, high[axis] + t);
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

  private:
    using Stored = hn::Rebind<std::uint16_t, Floats>;

    static Vec coordinates(const NearChunks::Place& place, int axis,
                           hn::Vec<Stored> steps) {
        const Floats d;
        const Vec s = hn::ConvertTo(d, hn::PromoteTo(Ints(), steps));
        return hn::Add(hn::Set(d, place.low[axis]),
                       hn::Mul(hn::Set(d, place.step[axis]), s));
    }
    /// As many coordinates as there are lanes.
    static Vec coordinates(const NearChunks::Place& place, int axis,
                           const std::uint16_t* q) {
        return coordinates(place, axis, hn::LoadU(Stored(), q));
    }

    /// As many of a row's numbers of 12 bits as there are lanes, from number t on.
    static hn::Vec<Stored> shortNumbers(const std::uint16_t* row, int t) {
        static_assert(NearChunks::kShortBits == 12);
        const Stored d;
        const std::uint16_t* const q = row + 12 * t / 16;
#if HWY_TARGET == HWY_SCALAR
        const std::uint32_t words = q[0] | std::uint32_t(q[1]) << 16;
        return hn::Set(d, std::uint16_t(words >> (12 * t % 16) & 0xfff));
#else
        // Of each block of eight: the two bytes that hold each, and what moves it to the
        // upper bits of its lane.
        alignas(16) static constexpr std::uint8_t kBytes[16] = {
            0, 1, 1, 2, 3, 4, 4, 5, 6, 7, 7, 8, 9, 10, 10, 11};
        alignas(16) static constexpr std::uint16_t kUp[8] = {16, 1, 16, 1, 16, 1, 16, 1};
        const hn::Repartition<std::uint8_t, Stored> bytes;
        hn::Vec<Stored> words = hn::LoadU(d, q);
        if constexpr (hn::MaxLanes(Stored()) == 16) {
            const hn::Half<Stored> half;
            words = hn::Combine(d, hn::LoadU(half, q + 6), hn::LoadU(half, q));
        }
        const auto pairs = hn::TableLookupBytes(hn::BitCast(bytes, words),
                                                hn::LoadDup128(bytes, kBytes));
        return hn::ShiftRight<4>(hn::Mul(hn::BitCast(d, pairs), hn::LoadDup128(d, kUp)));
#endif
    }

    /// Of triangles that share no corners: rows of 16 numbers.
    template <bool kShort>
    void unpackCorners(const NearChunks::Place& place, const std::uint16_t* q) {
        constexpr int kRow = kTriangles * (kShort ? NearChunks::kShortBits : 16) / 16;
        constexpr int kWide = int(hn::MaxLanes(Floats()));
        for (int axis = 0; axis < 3; ++axis) {
            for (auto& c : corner) {
                for (int t = 0; t < kTriangles; t += kWide) {
                    const Vec at = kShort ? coordinates(place, axis, shortNumbers(q, t))
                                          : coordinates(place, axis, q + t);
                    hn::Store(at, Floats(), c[axis] + t);
                }
                q += kRow;
            }
        }
    }

    /// Of triangles that have up to kMost points.
    template <int kMost>
    void unpack(const NearChunks::Place& place, const std::uint16_t* q,
                const std::uint16_t* corners) {
        constexpr int kWide = int(hn::MaxLanes(Floats()));
        if constexpr (kWide >= 8) {
            lookUp<kMost>(place, q, corners);
            return;
        }
        alignas(64) float point[kMost];
        for (int axis = 0; axis < 3; ++axis, q += place.points) {
            for (int i = 0; i < kMost; i += kWide)
                hn::Store(coordinates(place, axis, q + i), Floats(), point + i);
            for (int t = 0; t < kTriangles; ++t) {
                for (int c = 0; c < 3; ++c)
                    corner[c][axis][t] = point[NearChunks::pointOf(corners[t], c)];
            }
        }
    }

    /// The same, with vectors as tables.
    template <int kMost>
    void lookUp(const NearChunks::Place& place, const std::uint16_t* q,
                const std::uint16_t* corners) {
        constexpr int kWide = int(hn::MaxLanes(Floats()));
        constexpr int kTables = kMost / kWide > 0 ? kMost / kWide : 1;
        const Floats d;
        const Ints whole;
        const hn::Rebind<std::uint16_t, Floats> stored;
        using Indices = decltype(hn::IndicesFromVec(d, hn::Zero(whole)));
        for (int t = 0; t < kTriangles; t += kWide) {
            const auto words = hn::PromoteTo(whole, hn::LoadU(stored, corners + t));
            Indices lane[3];
            hn::Vec<Ints> table[3];
            for (int c = 0; c < 3; ++c) {
                const auto number = hn::ShiftRightSame(words, NearChunks::kBits * c);
                const auto of = [&](int most) {
                    return hn::And(number, hn::Set(whole, most));
                };
                lane[c] = hn::IndicesFromVec(d, of(kWide - 1));
                table[c] = of(NearChunks::kMostShared - kWide);
            }
            const std::uint16_t* from = q;
            for (int axis = 0; axis < 3; ++axis, from += place.points) {
                Vec points[kTables];
                for (int i = 0; i < kTables; ++i)
                    points[i] = coordinates(place, axis, from + kWide * i);
                for (int c = 0; c < 3; ++c) {
                    Vec p = hn::TableLookupLanes(points[0], lane[c]);
                    for (int i = 1; i < kTables; ++i) {
                        const auto here = hn::Eq(table[c], hn::Set(whole, kWide * i));
                        p = hn::IfThenElse(hn::RebindMask(d, here),
                                           hn::TableLookupLanes(points[i], lane[c]), p);
                    }
                    hn::Store(p, d, corner[c][axis] + t);
                }
            }
        }
    }
};

}  // namespace mtsm::trace::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
