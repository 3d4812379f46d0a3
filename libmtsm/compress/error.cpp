#include "compress/error.h"

namespace mtsm::compress {
namespace {

/// V' of one channel while the layer's samples are passed one by one; like a reader, but
/// multiplying once a sample (which loses 2^-53 each time, 2^-33 for a million).
class Steps {
  public:
    Steps(double before, double after, std::uint32_t n)
        : v_(before),
          after_(after),
          n_(n),
          // Of a layer that ends dark, the last sample is what blocks.
          factor_(after > 0.0 ? std::pow(after / before, 1.0 / n) : 1.0) {}

    /// j must not fall.
    double at(std::uint32_t j) {
        if (j >= n_) return after_;
        for (; j_ < j; ++j_)
            v_ *= factor_;
        return v_;
    }

  private:
    double v_, after_;
    std::uint32_t n_, j_ = 0;
    double factor_;
};

}  // namespace

double largestError(const Visibility& samples, Group g, const float* vBefore,
                    const float* v, double most) {
    double largest = 0.0;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        Steps steps(vBefore[c], v[c], g.size());
        const double before = samples.before(g.begin, c);
        const double* const behind = samples.v[c].data() + g.begin;
        walk(samples, g, [&](std::uint32_t j, std::uint32_t k) {
            const double error = std::abs((k > 0 ? behind[k - 1] : before) - steps.at(j));
            largest = std::max(largest, error);
            return largest <= most;
        });
    }
    return largest;
}

double largestMove(const Visibility& samples, Group g, double most) {
    const Spacing places = spacing(samples, g);
    double largest = 0.0;
    for (std::uint32_t j = 1; j <= g.size() && largest <= most; ++j)
        largest = std::max(largest, std::abs(places.at(j) - samples.z[g.begin + j - 1]));
    return largest;
}

double coveredDepth(const Visibility& samples, Group g) {
    const double mean = spacing(samples, g).step;
    double covered = 0.0;
    for (std::uint32_t i = std::max(g.begin, 1u); i < g.end; ++i)
        covered += std::min(mean, double(samples.z[i]) - samples.z[i - 1]);
    return std::max(0.0, covered - mean);
}

}  // namespace mtsm::compress
