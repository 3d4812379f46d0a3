// A sample is put in its place by moving it through the planes from the front: each keeps
// the nearer one of what it has and what comes, and hands on the other. Pixels that are
// not covered take part with kNoSample, which changes nothing.
#include "raster/draw_nearest.h"

#include <bit>

// Vectors of a length that is not known in advance cannot be members of a class.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/draw_nearest.cpp"
#include <hwy/foreach_target.h>
// After foreach_target.h:
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::raster::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

// A block is some neighbouring pixels of a row that begin at a multiple of their number.
using Doubles = hn::CappedTag<double, 4>;
using Floats = hn::Rebind<float, Doubles>;
using Ints = hn::Rebind<std::int32_t, Doubles>;
using FloatMask = hn::Mask<Floats>;
using FloatVec = hn::Vec<Floats>;

static_assert(KTile::kRowAlignment % hn::MaxLanes(Doubles()) == 0);

/// Samples of a block one by one, where copies have to be moved along.
void insertOneByOne(KTile& tile, std::uint32_t place, FloatVec z, FloatMask covered) {
    const Floats d;
    float depths[hn::MaxLanes(Floats())];
    hn::StoreU(hn::IfThenElse(covered, z, hn::Set(d, KTile::kNoSample)), d, depths);
    for (std::uint32_t i = 0; i < hn::Lanes(d); ++i) {
        if (depths[i] < KTile::kNoSample) tile.insert(place + i, depths[i]);
    }
}

/// Samples at the depths of those that planes hold are their copies.
void countCopies(KTile& tile, std::uint32_t layer, std::uint32_t place,
                 FloatMask copies) {
    const Floats d;
    float which[hn::MaxLanes(Floats())];
    hn::StoreU(hn::IfThenElseZero(copies, hn::Set(d, 1.0f)), d, which);
    for (std::uint32_t i = 0; i < hn::Lanes(d); ++i) {
        if (which[i] != 0.0f) tile.addCopy(layer, place + i);
    }
}

/// The block that begins at this place of the tile's planes.
HWY_INLINE void insert(KTile& tile, std::uint32_t place, FloatVec z, FloatMask covered) {
    const Floats d;
    if (HWY_UNLIKELY(tile.hasCopies())) return insertOneByOne(tile, place, z, covered);
    tile.countSamples(hn::CountTrue(d, covered));
    const auto none = hn::Set(d, KTile::kNoSample);
    z = hn::IfThenElse(covered, z, none);
    const std::uint32_t layers = tile.layers();
    if (layers > 1 && tile.planes() == layers) {
        const auto last = hn::LoadU(d, tile.plane(layers - 1) + place);
        z = hn::IfThenElse(hn::Le(z, last), z, none);
    }
    auto live = hn::Lt(z, none);
    for (std::uint32_t k = 0; k < layers && !hn::AllFalse(d, live); ++k) {
        if (HWY_UNLIKELY(k == tile.planes()) && !tile.addPlane()) return;
        float* const plane = tile.plane(k) + place;
        const auto kept = hn::LoadU(d, plane);
        const auto copies = hn::And(hn::Eq(kept, z), live);
        if (HWY_UNLIKELY(!hn::AllFalse(d, copies))) {
            countCopies(tile, k, place, copies);
            z = hn::IfThenElse(copies, none, z);
        }
        hn::StoreU(hn::Min(kept, z), d, plane);
        z = hn::Max(kept, z);
        live = hn::Lt(z, none);
    }
}

/// The depth where a triangle's plane has the value q.
template <ProjectionKind kind>
HWY_INLINE FloatVec clampedDepth(hn::Vec<Doubles> q, hn::Vec<Doubles> zMin,
                                 hn::Vec<Doubles> zMax) {
    const Doubles d;
    auto z = q;
    if constexpr (kind == ProjectionKind::perspective)
        z = hn::IfThenElse(hn::Gt(q, hn::Zero(d)), hn::Div(hn::Set(d, 1.0), q),
                           zMax);  // else the plane runs past the ray
    return hn::DemoteTo(Floats(), hn::Min(hn::Max(z, zMin), zMax));
}

/// Depths of a large triangle's plane, at pixel centres.
template <ProjectionKind kind>
class Depths {
  public:
    explicit Depths(const PreparedTriangle& t)
        : at_(hn::Set(d_, t.at)),
          dx_(hn::Set(d_, t.dx)),
          dy_(hn::Set(d_, t.dy)),
          zMin_(hn::Set(d_, double(t.zMin))),
          zMax_(hn::Set(d_, double(t.zMax))) {}

    /// dx, dy pixels from the triangle's first one.
    [[nodiscard]] HWY_INLINE FloatVec at(hn::Vec<Ints> dx, hn::Vec<Ints> dy) const {
        const auto x = hn::PromoteTo(d_, dx), y = hn::PromoteTo(d_, dy);
        const auto q = hn::Add(hn::Add(at_, hn::Mul(dx_, x)), hn::Mul(dy_, y));
        return clampedDepth<kind>(q, zMin_, zMax_);
    }

  private:
    Doubles d_;
    hn::Vec<Doubles> at_, dx_, dy_, zMin_, zMax_;
};

/// Which of the pixels from where the edges stand a small triangle covers, 8 in each of
/// so many rows: bit 8 y + x.
HWY_INLINE std::uint64_t coverage(const detail::Edges& edges, std::int32_t rows) {
    const hn::CappedTag<std::int32_t, 8> d;
    constexpr std::int32_t kSide = 8;
    const auto lanes = std::int32_t(hn::Lanes(d));
    std::uint64_t covered = 0;
    for (std::int32_t x = 0; x < kSide; x += lanes) {
        const auto numbers = hn::Iota(d, x);
        const auto first = [&](int i) {
            return hn::Add(hn::Set(d, std::int32_t(edges.value[i])),
                           hn::Mul(hn::Set(d, edges.stepX[i]), numbers));
        };
        auto a = first(0), b = first(1), c = first(2);
        const auto stepA = hn::Set(d, edges.stepY[0]), stepB = hn::Set(d, edges.stepY[1]),
                   stepC = hn::Set(d, edges.stepY[2]);
        for (std::int32_t y = 0; y < rows; ++y) {
            const auto within = hn::Gt(hn::Or(a, hn::Or(b, c)), hn::Set(d, -1));
            std::uint8_t bits[8] = {};
            hn::StoreMaskBits(d, within, bits);
            covered |= std::uint64_t(bits[0]) << (kSide * y + x);
            a = hn::Add(a, stepA);
            b = hn::Add(b, stepB);
            c = hn::Add(c, stepC);
        }
    }
    return covered;
}

/// Samples of small triangles on their way into a tile. Each is a division and a place
/// somewhere in memory; together they wait for neither.
template <ProjectionKind kind>
class Samples {
  public:
    explicit Samples(KTile& tile) : tile_(tile) {}
    ~Samples() { flush(); }
    Samples(const Samples&) = delete;
    Samples& operator=(const Samples&) = delete;

    /// A small triangle's, within the tile whose first pixel is (left, top).
    HWY_INLINE void add(const PreparedTriangle& t, PixelRect r, std::int32_t left,
                        std::int32_t top) {
        const std::int32_t w = r.x1 - r.x0 + 1, h = r.y1 - r.y0 + 1;
        const std::uint64_t row = (std::uint64_t(1) << w) - 1;
        std::uint64_t covered =
            coverage(detail::Edges(t, r.x0, r.y0), h) & (row * 0x0101010101010101u);
        if (covered == 0) return;
        // What the plane gives is computed in the order in which drawTriangle() does.
        double alongX[8], alongY[8];
        const hn::CappedTag<double, 8> d;
        const auto lanes = std::int32_t(hn::Lanes(d));
        for (std::int32_t i = 0; i < 8; i += lanes) {
            const auto x = hn::Iota(d, double(r.x0 - t.x0 + i));
            const auto y = hn::Iota(d, double(r.y0 - t.y0 + i));
            hn::StoreU(hn::Add(hn::Set(d, t.at), hn::Mul(hn::Set(d, t.dx), x)), d,
                       alongX + i);
            hn::StoreU(hn::Mul(hn::Set(d, t.dy), y), d, alongY + i);
        }
        const std::uint32_t stride = tile_.stride();
        const std::uint32_t first =
            std::uint32_t(r.y0 - top) * stride + std::uint32_t(r.x0 - left);
        do {
            const auto bit = std::uint32_t(std::countr_zero(covered));
            q_[count_] = alongX[bit & 7] + alongY[bit >> 3];
            zMin_[count_] = t.zMin;
            zMax_[count_] = t.zMax;
            place_[count_] = first + (bit >> 3) * stride + (bit & 7);
            ++count_;
            covered &= covered - 1;
        } while (covered != 0);
        if (count_ > kRoom) flush();
    }

    void flush() {
        computeDepths();
        insert();
        count_ = 0;
    }

  private:
    static constexpr std::uint32_t kRoom = 192, kMost = 64;  // of one triangle

    void computeDepths() {
        const Doubles d;
        const Floats df;
        for (std::uint32_t i = 0; i < count_; i += std::uint32_t(hn::Lanes(d))) {
            const auto zMin = hn::PromoteTo(d, hn::LoadU(df, zMin_ + i));
            const auto zMax = hn::PromoteTo(d, hn::LoadU(df, zMax_ + i));
            hn::StoreU(clampedDepth<kind>(hn::LoadU(d, q_ + i), zMin, zMax), df, z_ + i);
        }
    }

    void insert() {
        const std::uint32_t layers = tile_.layers();
        for (std::uint32_t i = 0; i < count_; ++i) {
            if (HWY_UNLIKELY(tile_.hasCopies())) {
                tile_.insert(place_[i], z_[i]);
                continue;
            }
            tile_.countSamples(1);
            float z = z_[i];
            const std::uint32_t place = place_[i];
            if (layers > 1 && planes_ == layers && z > plane_[layers - 1][place])
                continue;
            for (std::uint32_t k = 0; k < layers; ++k) {
                if (HWY_UNLIKELY(k >= planes_) && !takePlane(k)) break;
                float* const kept = plane_[k] + place;
                const float before = *kept;
                if (HWY_UNLIKELY(before == z)) {
                    tile_.addCopy(k, place);
                    break;
                }
                // The nearer one stays, the other moves along.
                *kept = z < before ? z : before;
                z = z < before ? before : z;
                if (z == KTile::kNoSample) break;
            }
        }
    }

    bool takePlane(std::uint32_t k) {
        if (k == tile_.planes() && !tile_.addPlane()) return false;
        plane_[planes_++] = tile_.plane(k);
        return true;
    }

    KTile& tile_;
    std::uint32_t count_ = 0, planes_ = 0;
    float* plane_[KBuffer::kMostLayers];
    double q_[kRoom + kMost + 8];
    float zMin_[kRoom + kMost + 8], zMax_[kRoom + kMost + 8], z_[kRoom + kMost + 8];
    std::uint32_t place_[kRoom + kMost];
};

/// Any other triangle, block by block of the rows that it covers.
template <ProjectionKind kind>
void drawLarge(const PreparedTriangle& t, PixelRect r, std::int32_t left,
               std::int32_t top, KTile& tile) {
    const Ints di;
    const auto lanes = std::int32_t(hn::Lanes(di));
    const Depths<kind> depths(t);
    detail::Edges edges(t, r.x0, r.y0);
    const std::int32_t w = r.x1 - r.x0 + 1, h = r.y1 - r.y0 + 1;
    if (edges.miss(w, h)) return;
    for (std::int32_t y = r.y0; y <= r.y1; ++y, edges.down()) {
        std::int64_t from = 0, to = w - 1;
        edges.span(from, to);
        if (from > to) continue;
        const std::int32_t first = r.x0 + std::int32_t(from);
        const std::int32_t last = r.x0 + std::int32_t(to);
        const auto dy = hn::Set(di, y - t.y0);
        for (std::int32_t x = first & -lanes; x <= last; x += lanes) {
            const auto at = hn::Iota(di, x);
            const auto outside =
                hn::Or(hn::Sub(at, hn::Set(di, first)), hn::Sub(hn::Set(di, last), at));
            insert(tile, std::uint32_t(y - top) * tile.stride() + std::uint32_t(x - left),
                   depths.at(hn::Sub(at, hn::Set(di, t.x0)), dy),
                   hn::RebindMask(Floats(), hn::Gt(outside, hn::Set(di, -1))));
        }
    }
}

template <ProjectionKind kind>
void drawAll(std::span<const TriangleList> lists, PixelRect within, KBuffer& buffer) {
    forEachTile(within, KBuffer::kTileShift,
                [&](std::uint32_t tx, std::uint32_t ty, PixelRect pixels) {
                    KTile& tile = buffer.tile(tx, ty);
                    const auto left = std::int32_t(tx << KBuffer::kTileShift);
                    const auto top = std::int32_t(ty << KBuffer::kTileShift);
                    Samples<kind> samples(tile);
                    for (const TriangleList& list : lists) {
                        for (const std::uint32_t i : list.order) {
                            const PreparedTriangle& t = list.triangles[i];
                            const PixelRect r = intersect(t.pixels(), pixels);
                            if (r.empty()) continue;
                            if (t.small)
                                samples.add(t, r, left, top);
                            else
                                drawLarge<kind>(t, r, left, top, tile);
                        }
                    }
                });
}

void drawNearestHere(ProjectionKind kind, std::span<const TriangleList> lists,
                     PixelRect within, KBuffer& buffer) {
    if (kind == ProjectionKind::perspective)
        drawAll<ProjectionKind::perspective>(lists, within, buffer);
    else
        drawAll<ProjectionKind::orthographic>(lists, within, buffer);
}

}  // namespace
}  // namespace mtsm::raster::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::raster {

HWY_EXPORT(drawNearestHere);

void drawNearest(ProjectionKind kind, std::span<const TriangleList> lists,
                 PixelRect within, KBuffer& buffer) {
    HWY_DYNAMIC_DISPATCH(drawNearestHere)(kind, lists, within, buffer);
}

}  // namespace mtsm::raster
#endif
