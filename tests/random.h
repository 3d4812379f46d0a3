// random.h - the same random numbers on every machine.
#pragma once
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <random>
#include <utility>
#include <vector>

namespace mtsm::test {

class Random {
  public:
    explicit Random(std::uint64_t seed) : engine_(seed) {}
    double unit() { return double(engine_() >> 11) * 0x1p-53; }
    double in(double low, double high) { return low + (high - low) * unit(); }
    std::size_t below(std::size_t n) { return std::size_t(engine_() % n); }
    /// In a cube around the origin.
    glm::dvec3 within(double half) {
        const double x = in(-half, half), y = in(-half, half), z = in(-half, half);
        return {x, y, z};
    }
    /// A unit vector, any direction.
    glm::dvec3 direction() {
        for (;;) {
            const glm::dvec3 d = within(1.0);
            const double length = glm::length(d);
            if (length > 0.1 && length < 1.0) return d / length;
        }
    }
    template <typename T>
    void shuffle(std::vector<T>& v) {
        for (std::size_t i = v.size(); i > 1; --i)
            std::swap(v[i - 1], v[below(i)]);
    }

  private:
    std::mt19937_64 engine_;
};

}  // namespace mtsm::test
