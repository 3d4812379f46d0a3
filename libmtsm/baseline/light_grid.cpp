#include "baseline/light_grid.h"

#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

#include "base/sampling.h"
#include "light/sample.h"

namespace mtsm::baseline {
namespace {

/// Every second bit of `x`, from bit 0 on, in reverse order over `bits` bits.
std::uint32_t reversedHalf(std::uint32_t x, int bits) {
    std::uint32_t reversed = 0;
    for (int b = 0; b < bits; ++b)
        reversed = reversed << 1 | (x >> (2 * b) & 1);
    return reversed;
}

/// [0, 1) from 32 of the bits.
double unit(std::uint32_t bits) {
    return double(bits) * 0x1p-32;
}

bool hasNoSize(const AreaLight& light) {
    return light::LightSampler(light).isPoint();
}

}  // namespace

std::vector<glm::dvec2> gridPoints(int n, LightGrid grid, std::uint32_t seed) {
    // Cells of the next power of two are counted so that neighbours in the list differ in
    // the highest bits of their place; those outside the n x n are left out. The
    // exclusive or brings the middle to the front and keeps the order's spread.
    const auto side = std::uint32_t(n);
    const int bits = std::bit_width(side - 1);
    const std::uint32_t all = 1u << (2 * bits);
    std::vector<glm::dvec2> points;
    points.reserve(std::size_t(side) * side);
    for (std::uint32_t i = 0; i < all; ++i) {
        const std::uint32_t x = reversedHalf(i, bits) ^ (side / 2);
        const std::uint32_t y = reversedHalf(i >> 1, bits) ^ (side / 2);
        if (x >= side || y >= side) continue;
        glm::dvec2 within(0.5);
        if (grid == LightGrid::jittered && n > 1) {
            const std::uint64_t bitsOf =
                base::mix(std::uint64_t(seed) << 32 | (y * side + x));
            within = {unit(std::uint32_t(bitsOf)), unit(std::uint32_t(bitsOf >> 32))};
        }
        points.push_back((glm::dvec2(x, y) + within) / double(n));
    }
    return points;
}

bool LightPoint::faces(glm::dvec3 p) const noexcept {
    return normal == glm::dvec3(0.0) || glm::dot(normal, p - position) > 0.0;
}

std::vector<LightPoint> lightPoints(const AreaLight& light, int n, LightGrid grid,
                                    std::uint32_t seed) {
    const light::LightSampler sampler(light);
    const bool sun = light.shape == LightShape::sun;
    const bool oneSided =
        light.shape == LightShape::disk || light.shape == LightShape::rect;
    std::vector<LightPoint> points;
    for (const glm::dvec2 u : gridPoints(sampler.isPoint() ? 1 : n, grid, seed)) {
        // From its own centre all of a sphere is sampled.
        const glm::dvec3 delta = sampler.sample(light.position, u).delta;
        LightPoint point;
        point.position = sun ? glm::normalize(delta) : light.position + delta;
        if (oneSided)
            point.normal = glm::normalize(light.direction);
        else if (light.shape == LightShape::sphere && !sampler.isPoint())
            point.normal = glm::normalize(delta);
        points.push_back(point);
    }
    return points;
}

double lightMeasure(const AreaLight& light) noexcept {
    if (hasNoSize(light)) return 1.0;
    switch (light.shape) {
        case LightShape::disk:
            return glm::pi<double>() * light.radius * light.radius;
        case LightShape::rect:
            if (light.size.x == 0.0 || light.size.y == 0.0)
                return light.size.x + light.size.y;
            return light.size.x * light.size.y;
        case LightShape::sphere:
            return 4.0 * glm::pi<double>() * light.radius * light.radius;
        case LightShape::sun:
            return 4.0 * glm::pi<double>() *
                   std::pow(std::sin(0.25 * light.angularDiameter), 2);
        case LightShape::point:
            break;
    }
    return 1.0;
}

namespace {

/// Of a triangle, its corners relative to the eye [VanOosterom83, eq. 8].
double triangleAngle(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c) {
    const double la = glm::length(a), lb = glm::length(b), lc = glm::length(c);
    const double volume = std::abs(glm::dot(a, glm::cross(b, c)));
    const double cosines =
        la * lb * lc + glm::dot(a, b) * lc + glm::dot(b, c) * la + glm::dot(c, a) * lb;
    return 2.0 * std::atan2(volume, cosines);
}

}  // namespace

double solidAngle(const AreaLight& light, glm::dvec3 p) {
    const light::LightSampler sampler(light);
    if (sampler.isPoint()) return 0.0;
    if (light.shape == LightShape::sun) return lightMeasure(light);
    if (light.shape == LightShape::sphere) {
        const double s = light.radius / glm::length(p - light.position);
        if (!(s < 1.0)) return 4.0 * glm::pi<double>();
        return 2.0 * glm::pi<double>() * s * s / (1.0 + std::sqrt(1.0 - s * s));
    }
    if (sampler.isBehind(p)) return 0.0;
    const light::LightView view = sampler.view(p);
    if (view.domain == light::LightView::Domain::square) {
        const glm::dvec3 low = view.base - view.x, high = view.base + view.x;
        return triangleAngle(low - view.y, high - view.y, high + view.y) +
               triangleAngle(low - view.y, high + view.y, low + view.y);
    }
    // A disk as a fan, its rim moved outwards so that the area is kept.
    constexpr int kSectors = 256;
    constexpr double kSector = 2.0 * glm::pi<double>() / kSectors;
    const double radius = std::sqrt(kSector / std::sin(kSector));
    const auto rim = [&](int i) {
        return view.base +
               radius * (std::cos(i * kSector) * view.x + std::sin(i * kSector) * view.y);
    };
    double sum = 0.0;
    for (int i = 0; i < kSectors; ++i)
        sum += triangleAngle(view.base, rim(i), rim(i + 1));
    return sum;
}

double densestAngle(const AreaLight& light, glm::dvec3 p) {
    if (light.shape == LightShape::sun || hasNoSize(light)) return solidAngle(light, p);
    if (light.shape == LightShape::rect && light.size.x * light.size.y == 0.0) return 0.0;
    constexpr int kSide = 16;
    double densest = 0.0;
    for (const LightPoint& point : lightPoints(light, kSide, LightGrid::regular, 0)) {
        const glm::dvec3 d = p - point.position;
        const double r = glm::length(d);
        if (r > 0.0) densest = std::max(densest, glm::dot(d, point.normal) / (r * r * r));
    }
    return densest * lightMeasure(light);
}

}  // namespace mtsm::baseline
