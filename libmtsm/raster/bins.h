// bins.h - squares of a raster that are drawn by one thread each.
//
//     const Bins bins(width, height, tileShift, mostBins);
//     bins.sort(prepared, begin, order);
//     for (i in [begin[bin], begin[bin + 1])) draw(prepared[order[i]]);
#pragma once
#include <cstdint>
#include <vector>

namespace mtsm::raster {

struct Bins {
    std::uint32_t shift = 0;     ///< a bin is 2^shift pixels wide and high
    std::uint32_t x = 0, y = 0;  ///< bins in a row, and rows

    Bins() = default;
    /// The smallest bins of at least 2^leastShift pixels a side of which there are no
    /// more than `most`.
    Bins(std::uint32_t width, std::uint32_t height, std::uint32_t leastShift,
         std::uint32_t most) noexcept
        : shift(leastShift) {
        do {
            x = ((width - 1) >> shift) + 1;
            y = ((height - 1) >> shift) + 1;
        } while (count() > most && ++shift);
    }
    [[nodiscard]] std::uint32_t count() const noexcept { return x * y; }

    /// A counting sort: bin b has the items order[begin[b]] to order[begin[b + 1] - 1],
    /// in their order. An item covers pixels x0..x1, y0..y1, both ends included, and
    /// comes in every bin that it touches. `begin` becomes [count() + 1].
    template <typename Item>
    void sort(const std::vector<Item>& items, std::vector<std::uint32_t>& begin,
              std::vector<std::uint32_t>& order) const {
        const auto forEachBin = [&](const Item& item, auto&& visit) {
            const std::uint32_t lastX = std::uint32_t(item.x1) >> shift;
            const std::uint32_t lastY = std::uint32_t(item.y1) >> shift;
            for (std::uint32_t j = std::uint32_t(item.y0) >> shift; j <= lastY; ++j) {
                for (std::uint32_t i = std::uint32_t(item.x0) >> shift; i <= lastX; ++i)
                    visit(j * x + i);
            }
        };
        const auto size = std::uint32_t(items.size());
        begin.assign(std::size_t(count()) + 1, 0);
        for (const Item& item : items)
            forEachBin(item, [&](std::uint32_t bin) { ++begin[bin]; });
        std::uint32_t total = 0;
        for (std::uint32_t& b : begin) {  // to where each bin ends
            total += b;
            b = total;
        }
        order.resize(total);
        for (std::uint32_t i = size; i-- > 0;)
            forEachBin(items[i], [&](std::uint32_t bin) { order[--begin[bin]] = i; });
    }
};

}  // namespace mtsm::raster
