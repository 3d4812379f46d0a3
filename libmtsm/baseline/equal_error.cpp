#include "baseline/equal_error.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace mtsm::baseline {
namespace {

/// Where the line from a to b, in logarithms, has this error: b is the better one.
double secondsBetween(const Measured& a, const Measured& b, double error) {
    const double share = std::log(a.error / error) / std::log(a.error / b.error);
    return std::exp(std::log(a.seconds) + share * std::log(b.seconds / a.seconds));
}

}  // namespace

std::optional<Reached> cheapest(const std::vector<Measured>& runs, double error) {
    std::optional<Reached> best;
    const auto offer = [&](double seconds, const std::string& label) {
        if (!best || seconds < best->seconds) best = {seconds, label};
    };
    for (const Measured& run : runs)
        if (run.error <= error) offer(run.build + run.seconds, run.label);
    for (const Measured& a : runs) {
        if (a.series.empty() || !(a.error > error)) continue;
        // Its neighbour: the next larger number of samples in the series.
        const Measured* next = nullptr;
        for (const Measured& b : runs) {
            if (b.series == a.series && b.samples > a.samples &&
                (!next || b.samples < next->samples))
                next = &b;
        }
        if (next && next->error < error && next->error > 0.0)
            offer(a.build + secondsBetween(a, *next, error),
                  "between " + a.label + " and " + next->label);
    }
    return best;
}

std::vector<std::size_t> paretoFront(const std::vector<Measured>& runs) {
    std::vector<std::size_t> order(runs.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    const auto cost = [&](std::size_t i) { return runs[i].build + runs[i].seconds; };
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return cost(a) != cost(b) ? cost(a) < cost(b) : runs[a].error < runs[b].error;
    });
    std::vector<std::size_t> front;
    for (const std::size_t i : order)
        if (front.empty() || runs[i].error < runs[front.back()].error) front.push_back(i);
    return front;
}

}  // namespace mtsm::baseline
