#include "accuracy/errors.h"

#include <algorithm>
#include <cmath>

namespace mtsm::bench {

Errors compare(const std::vector<float>& found, const std::vector<float>& truth) {
    Errors e;
    if (found.empty()) return e;
    std::vector<double> all;
    double sum = 0.0, squares = 0.0, shadowSum = 0.0;
    std::size_t inShadow = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        const double error = std::abs(double(found[i]) - truth[i]);
        all.push_back(error);
        sum += error;
        squares += error * error;
        e.bias += double(found[i]) - truth[i];
        if (truth[i] > 0.0f) {
            shadowSum += error;
            ++inShadow;
        }
    }
    const double n = double(found.size());
    e.mean = sum / n;
    e.deviation = std::sqrt(std::max(0.0, squares / n - e.mean * e.mean));
    e.bias /= n;
    e.inShadow = inShadow ? shadowSum / double(inShadow) : 0.0;
    std::sort(all.begin(), all.end());
    e.p99 = all[std::size_t(0.99 * (n - 1))];
    return e;
}

std::vector<float> means(const std::vector<float>& values,
                         const std::vector<std::size_t>& first) {
    std::vector<float> means;
    for (std::size_t i = 0; i + 1 < first.size(); ++i) {
        double sum = 0.0;
        for (std::size_t k = first[i]; k < first[i + 1]; ++k)
            sum += values[k];
        means.push_back(float(sum / double(first[i + 1] - first[i])));
    }
    return means;
}

}  // namespace mtsm::bench
