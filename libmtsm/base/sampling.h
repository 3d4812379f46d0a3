// sampling.h - well-spread points in the unit square, a different set for every key.
//
// The points are the first N of the (0, 2)-sequence of van der Corput and Sobol', with
// its digits scrambled by a hash in the manner of Owen: every elementary interval of area
// 1 / 2^m holds exactly one of each 2^m consecutive points, so they are stratified in
// both axes at once for any power of two and nearly so between; the error of a mean over
// a smooth integrand falls faster than 1/sqrt(N), and over a step at least as fast.
// Integer arithmetic alone: the same on every machine [Owen95], [Laine11].
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

namespace mtsm::base {

/// A 64-bit hash; every input bit moves every output bit.
[[nodiscard]] std::uint64_t mix(std::uint64_t x) noexcept;

/// A key for a point in space: the same for the same coordinates (0 and -0 are one) and
/// seed.
[[nodiscard]] std::uint64_t pointKey(glm::dvec3 p, std::uint32_t seed) noexcept;

class SquareSequence {
  public:
    explicit SquareSequence(std::uint64_t key) noexcept
        : seedX_(std::uint32_t(key)), seedY_(std::uint32_t(key >> 32)) {}

    /// Point i in [0, 1) x [0, 1); i < 2^12 points are well spread (kMaxSamples in
    /// shadow.h).
    [[nodiscard]] glm::dvec2 operator()(std::uint32_t i) const noexcept;
    /// Points index[0..count), rounded to float: in [0, 1], 1 included.
    void points(const std::uint32_t* index, std::size_t count, float* x,
                float* y) const noexcept;

  private:
    std::uint32_t seedX_, seedY_;
};

}  // namespace mtsm::base
