// errors.h - how far shadow factors are from the truth.
#pragma once
#include <cstddef>
#include <vector>

namespace mtsm::bench {

/// Of |found - truth|; `bias` of found - truth.
struct Errors {
    double mean = 0.0, deviation = 0.0, bias = 0.0, p99 = 0.0;
    double inShadow = 0.0;  ///< mean where the truth is not 0
};

Errors compare(const std::vector<float>& found, const std::vector<float>& truth);

/// The means of values[first[i]] to values[first[i + 1]].
std::vector<float> means(const std::vector<float>& values,
                         const std::vector<std::size_t>& first);

}  // namespace mtsm::bench
