// random.h - the same numbers on every machine.
#pragma once
#include <cstddef>
#include <cstdint>
#include <random>

namespace mtsm::bench {

class Random {
  public:
    explicit Random(std::uint64_t seed) : engine_(seed) {}
    /// In [low, high).
    double operator()(double low, double high) {
        return low + (high - low) * double(engine_() >> 11) * 0x1p-53;
    }
    /// In [0, n).
    std::size_t below(std::size_t n) { return std::size_t((*this)(0.0, double(n))); }

  private:
    std::mt19937_64 engine_;
};

}  // namespace mtsm::bench
