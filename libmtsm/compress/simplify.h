// simplify.h - few layers within the tolerance: the slope window of deep shadow maps
// [Lokovic00, sec. 3.1], for steps whose places a count decides.
#pragma once
#include <vector>

#include "compress/error.h"
#include "compress/visibility.h"

namespace mtsm::compress {

/// Turns samples into layers, front to back, each as long as bounds and tolerance let it
/// be.
class Simplifier {
  public:
    /// Behind each layer V' is off by a factor of 1 +- drift at most.
    Simplifier(double tolerance, double drift, const Bounds& bounds);

    /// Replaces what `layers` holds. Returns the largest |V - V'|; that a float v is
    /// rounded is no error.
    double simplify(const Visibility& samples, std::vector<Span>& layers);

  private:
    enum class Fit { good, bad, hopeless };  ///< hopeless: nor will more samples fit

    void takeLogarithms(const Visibility& samples);
    /// Makes `span`, one sample's, hold as many of [begin, limit) as fit.
    void extend(const Visibility& samples, std::uint32_t begin, std::uint32_t limit,
                const float* vBefore, Span& span);
    Fit fit(const Visibility& samples, Group g, const float* vBefore, Span& span);
    bool window(const Visibility& samples, Group g, std::uint32_t channel, double start,
                double& low, double& high) const;

    double tolerance_, drift_;
    Bounds bounds_;
    double error_ = 0.0;  ///< of the span that fit() filled last
    /// [channels][samples + 1], the first for the visibility 1: logarithms of V, and of
    /// what V' may lie between.
    std::vector<double> log_[3], logLow_[3], logHigh_[3];
};

}  // namespace mtsm::compress
