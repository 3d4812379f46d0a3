// errors.h - how far shadow factors are from the truth.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mtsm::baseline {

/// Of |found - truth|, `bias` of found - truth; over `count` values.
struct Errors {
    double mean = 0.0, deviation = 0.0, p95 = 0.0, p99 = 0.0, largest = 0.0, bias = 0.0;
    std::size_t count = 0;
};

/// Of the values that are no NaN and whose `mask` is not 0 (empty: all), each difference
/// multiplied by its `scale` (empty: 1). Percentiles are values that occur.
[[nodiscard]] Errors measureErrors(const std::vector<float>& found,
                                   const std::vector<float>& truth,
                                   const std::vector<std::uint8_t>& mask = {},
                                   const std::vector<float>& scale = {});

/// How far the mean of |found - truth| may be off by chance (one standard error) where
/// the values are not all there are but runs of `run` neighbours, taken at random from
/// `of` values. Neighbours are alike: it is told from the means of runs. Infinite where a
/// single run has values.
[[nodiscard]] double standardError(const std::vector<float>& found,
                                   const std::vector<float>& truth, std::size_t run,
                                   std::size_t of);

}  // namespace mtsm::baseline
