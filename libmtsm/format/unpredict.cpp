#include "format/unpredict.h"

#include <algorithm>
#include <bit>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "format/unpredict.cpp"
#include <hwy/foreach_target.h>
// After foreach_target.h:
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::format::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

/// A pixel's layers within the plane, and how many there are.
struct List {
    std::uint32_t first = 0, count = 0;
};

/// The layers of one pixel, one by one.
void addToPixel(List pixel, List left, List above, List corner,
                const std::uint32_t* differences, float* to) {
    const auto bits = [&](std::uint32_t i) {
        return std::bit_cast<std::uint32_t>(to[i]);
    };
    std::uint32_t before = 0;
    for (std::uint32_t k = 0; k < pixel.count; ++k) {
        std::uint32_t guess = before;
        if (k < left.count) {
            guess = bits(left.first + k);
            if (k < above.count && k < corner.count)
                guess += bits(above.first + k) - bits(corner.first + k);
        } else if (k < above.count) {
            guess = bits(above.first + k);
        }
        before = guess + differences[pixel.first + k];
        to[pixel.first + k] = std::bit_cast<float>(before);
    }
}

/// Of the row that begins with pixel `p`; `hasAbove`: there is a row above it.
template <bool hasAbove>
void addToRow(const std::uint32_t* begin, std::uint32_t width, std::uint32_t wholeEnd,
              const std::uint32_t* differences, float* to) {
    const hn::CappedTag<std::uint32_t, 8> d;
    const hn::RebindToFloat<decltype(d)> df;
    const auto load = [&](std::uint32_t i) {
        return hn::BitCast(d, hn::LoadU(df, to + i));
    };
    const auto lanes = std::uint32_t(hn::Lanes(d));
    const auto numbers = hn::Iota(d, 0);
    List left, corner;
    auto leftBits = hn::Zero(d), cornerBits = hn::Zero(d);
    std::uint32_t next = begin[0];
    std::uint32_t nextAbove = hasAbove ? *(begin - width) : 0;
    for (std::uint32_t x = 0; x < width; ++x) {
        List pixel{next, 0}, above{nextAbove, 0};
        next = begin[x + 1];
        pixel.count = next - pixel.first;
        if constexpr (hasAbove) {
            nextAbove = *(begin - width + x + 1);
            above.count = nextAbove - above.first;
        }
        if (pixel.first >= wholeEnd) {
            addToPixel(pixel, left, above, corner, differences, to);
        } else {
            const auto aboveBits = load(above.first);
            if (pixel.count <= std::min(lanes, std::max(left.count, above.count))) {
                const std::uint32_t onPlane =
                    std::min({left.count, above.count, corner.count});
                const auto slope = hn::IfThenElseZero(
                    hn::Lt(numbers, hn::Set(d, onPlane)), hn::Sub(aboveBits, cornerBits));
                const auto guess = hn::IfThenElse(hn::Lt(numbers, hn::Set(d, left.count)),
                                                  hn::Add(leftBits, slope), aboveBits);
                leftBits = hn::Add(guess, hn::LoadU(d, differences + pixel.first));
                hn::StoreU(hn::BitCast(df, leftBits), df, to + pixel.first);
            } else {
                addToPixel(pixel, left, above, corner, differences, to);
                leftBits = load(pixel.first);
            }
            cornerBits = aboveBits;
        }
        left = pixel;
        corner = above;
    }
}

void addGradientHere(std::span<const std::uint32_t> begin, std::uint32_t width,
                     const std::uint32_t* differences, float* to) {
    // Pixels whose layers begin before this may be read and written as a whole vector.
    // What it holds behind the pixel's last layer spoils only layers that come later.
    const auto lanes = std::uint32_t(hn::Lanes(hn::CappedTag<std::uint32_t, 8>()));
    const std::uint32_t layers = begin.back();
    const std::uint32_t wholeEnd = layers >= lanes ? layers - lanes + 1 : 0;
    addToRow<false>(begin.data(), width, wholeEnd, differences, to);
    for (std::size_t row = width; row + 1 < begin.size(); row += width)
        addToRow<true>(begin.data() + row, width, wholeEnd, differences, to);
}

}  // namespace
}  // namespace mtsm::format::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::format {

HWY_EXPORT(addGradientHere);

void addGradient(std::span<const std::uint32_t> begin, std::uint32_t width,
                 const std::uint32_t* differences, float* to) {
    HWY_DYNAMIC_DISPATCH(addGradientHere)(begin, width, differences, to);
}

}  // namespace mtsm::format
#endif
