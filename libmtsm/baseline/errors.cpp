#include "baseline/errors.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace mtsm::baseline {

Errors measureErrors(const std::vector<float>& found, const std::vector<float>& truth,
                     const std::vector<std::uint8_t>& mask,
                     const std::vector<float>& scale) {
    Errors e;
    std::vector<double> all;
    double sum = 0.0, squares = 0.0, signedSum = 0.0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        if (std::isnan(found[i]) || (!mask.empty() && !mask[i])) continue;
        const double difference =
            (double(found[i]) - truth[i]) * (scale.empty() ? 1.0 : double(scale[i]));
        all.push_back(std::abs(difference));
        sum += all.back();
        squares += difference * difference;
        signedSum += difference;
    }
    e.count = all.size();
    if (all.empty()) return e;
    const double n = double(all.size());
    e.mean = sum / n;
    e.deviation = std::sqrt(std::max(0.0, squares / n - e.mean * e.mean));
    e.bias = signedSum / n;
    const auto percentile = [&](double share) {
        const auto at = all.begin() + std::ptrdiff_t(share * (n - 1.0));
        std::nth_element(all.begin(), at, all.end());
        return *at;
    };
    e.p95 = percentile(0.95);
    e.p99 = percentile(0.99);
    e.largest = percentile(1.0);
    return e;
}

double standardError(const std::vector<float>& found, const std::vector<float>& truth,
                     std::size_t run, std::size_t of) {
    std::vector<double> means;
    for (std::size_t begin = 0; begin < found.size(); begin += run) {
        double sum = 0.0, count = 0.0;
        for (std::size_t i = begin; i < std::min(begin + run, found.size()); ++i) {
            if (std::isnan(found[i])) continue;
            sum += std::abs(double(found[i]) - truth[i]);
            ++count;
        }
        if (count > 0.0) means.push_back(sum / count);
    }
    if (found.size() >= of) return 0.0;
    if (means.size() < 2) return HUGE_VAL;
    const double n = double(means.size());
    const double mean = std::accumulate(means.begin(), means.end(), 0.0) / n;
    double squares = 0.0;
    for (const double m : means)
        squares += (m - mean) * (m - mean);
    const double left = 1.0 - double(found.size()) / double(of);
    return std::sqrt(left * squares / (n - 1.0) / n);
}

}  // namespace mtsm::baseline
