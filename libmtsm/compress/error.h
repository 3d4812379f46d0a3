// error.h - how far what a layer says is from the samples that it stands for.
#pragma once
#include <algorithm>
#include <cmath>

#include "compress/visibility.h"

namespace mtsm::compress {

/// The samples of a layer: [begin, end), the last at the layer's depth.
struct Group {
    std::uint32_t begin = 0, end = 0;
    [[nodiscard]] std::uint32_t size() const noexcept { return end - begin; }
};

/// Where a layer's count puts its samples: j = 1..n at from + j step. The first layer of
/// a pixel has all of them at its depth.
struct Spacing {
    double from = 0.0, step = 0.0;
    [[nodiscard]] double at(std::uint32_t j) const noexcept { return from + j * step; }
};

inline Spacing spacing(const Visibility& samples, Group g) noexcept {
    const double z = samples.z[g.end - 1];
    const double from = g.begin > 0 ? double(samples.z[g.begin - 1]) : z;
    return {from, (z - from) / g.size()};
}

/// Calls visit(j, k) for pairs such that wherever V' has passed j of the layer's samples
/// and V has passed k of the true ones, |V - V'| is at most that of some pair visited.
/// Stops and returns false when visit() does.
///
/// Readers round: they may meet a sample a little before or behind the place that the
/// formula gives it. So where one lies within kRounding of a true sample, the pairs for
/// both orders are visited. V and V' do not grow, hence of several at one place the first
/// and last states will do. j never falls from one visit to the next.
template <typename Visit>
bool walk(const Visibility& samples, Group g, const Visit& visit) {
    constexpr double kRounding = 0x1p-48;  // of the depth; readers need some 2^-51
    const float* const z = samples.z.data() + g.begin;
    const std::uint32_t n = g.size();
    const Spacing places = spacing(samples, g);
    if (!visit(0u, 0u)) return false;
    if (places.step == 0.0) {
        // All are met at the layer's depth, exactly.
        for (std::uint32_t k = 0; k < n && z[k] < z[n - 1]; ++k) {
            if (!visit(0u, k + 1)) return false;
        }
        return visit(n, n);
    }
    for (std::uint32_t j = 0, k = 0; k < n;) {
        const double depth = z[k], near = depth * kRounding;
        for (; j < n && places.at(j + 1) < depth - near; ++j) {
            if (!visit(j + 1, k)) return false;
        }
        const std::uint32_t jBefore = j, kBefore = k;
        while (j < n && places.at(j + 1) <= depth + near)
            ++j;
        while (k < n && z[k] == z[kBefore])
            ++k;
        if (j > jBefore && !(visit(jBefore, k) && visit(j, kBefore))) return false;
        if (!visit(j, k)) return false;
    }
    return true;
}

/// Largest |V - V'| over the depths of a layer that leaves v [channels] of the vBefore in
/// front of it; gives up beyond `most`.
double largestError(const Visibility& samples, Group g, const float* vBefore,
                    const float* v, double most);

/// Largest distance of a sample from where the layer puts it; gives up beyond `most`.
double largestMove(const Visibility& samples, Group g, double most);

/// The depth that a layer's samples cover, counted from the layer before, where no gap
/// counts for more than the mean one; less that mean. Of a few clusters it is about their
/// own extents; of even samples all but one gap; of one sample nothing.
double coveredDepth(const Visibility& samples, Group g);

/// The depth that a layer's samples are spread over when it is read.
inline double lengthOf(const Visibility& samples, Group g) noexcept {
    return double(samples.z[g.end - 1]) - samples.z[g.begin > 0 ? g.begin - 1 : 0];
}

/// The bounds on where a layer's samples may lie.
struct Bounds {
    double opticalDepth, lengthBase, lengthPerDepth;

    [[nodiscard]] double length(double z) const noexcept {
        // Not inf * 0 or 0 * inf.
        return lengthPerDepth > 0.0 ? lengthBase + lengthPerDepth * z : lengthBase;
    }
};

}  // namespace mtsm::compress
