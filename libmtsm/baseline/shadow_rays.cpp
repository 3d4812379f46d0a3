#include "baseline/shadow_rays.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <numeric>

namespace mtsm::baseline {
namespace {

using Lanes = float[kStreamRays];

/// light::sampleDisk for many: sine and cosine of up to pi / 4 by their series, whose
/// first term left out is below half a unit in the last place of a float.
void toDisk(std::size_t count, Lanes& u, Lanes& v) noexcept {
    constexpr float kQuarterPi = 0.785398163397448f;
    for (std::size_t k = 0; k < count; ++k) {
        const float a = 2.0f * u[k] - 1.0f, b = 2.0f * v[k] - 1.0f;
        const bool wide = std::abs(a) > std::abs(b);
        const float r = wide ? a : b, other = wide ? b : a;
        const float t = kQuarterPi * other / (r == 0.0f ? 1.0f : r), t2 = t * t;
        const float sine =
            t * (1.0f + t2 * (-1.0f / 6 +
                              t2 * (1.0f / 120 + t2 * (-1.0f / 5040 + t2 / 362880))));
        const float cosine =
            1.0f + t2 * (-0.5f + t2 * (1.0f / 24 + t2 * (-1.0f / 720 + t2 / 40320)));
        u[k] = r * (wide ? cosine : sine);
        v[k] = r * (wide ? sine : cosine);
    }
}

/// light::sampleCap, from points of the unit disk.
void toCap(std::size_t count, float capHeight, Lanes& u, Lanes& v, Lanes& w) noexcept {
    for (std::size_t k = 0; k < count; ++k) {
        const float squared = u[k] * u[k] + v[k] * v[k];
        const float height = (squared < 1.0f ? squared : 1.0f) * capHeight;
        const float circle = std::sqrt(capHeight * (2.0f - height));
        u[k] *= circle;
        v[k] *= circle;
        w[k] = 1.0f - height;
    }
}

/// Bits of two coordinates of 12 bits each, in turn.
std::uint32_t interleaved(std::uint32_t x, std::uint32_t y) {
    std::uint32_t code = 0;
    for (int bit = 0; bit < 12; ++bit)
        code |= (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1);
    return code;
}

}  // namespace

std::vector<std::uint32_t> neighbourOrder(std::uint32_t begin, std::uint32_t end) {
    const base::SquareSequence sequence(0);
    std::vector<std::uint32_t> code(end - begin), order(end - begin);
    std::iota(order.begin(), order.end(), begin);
    for (const std::uint32_t i : order) {
        const glm::dvec2 p = 4096.0 * sequence(i);
        code[i - begin] = interleaved(std::uint32_t(p.x), std::uint32_t(p.y));
    }
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
        return code[a - begin] != code[b - begin] ? code[a - begin] < code[b - begin]
                                                  : a < b;
    });
    return order;
}

double rayOffset(glm::dvec3 point, glm::dvec3 axis, glm::dvec3 low, glm::dvec3 high,
                 double share) noexcept {
    const double length = glm::length(axis);
    if (!(length > 0.0) || !(low.x <= high.x)) return 0.0;  // no axis, no casters
    const glm::dvec3 reach = glm::max(glm::abs(point - low), glm::abs(high - point));
    // Where all casters lie in one plane nothing rounds, but a ray on it would meet it.
    constexpr double kLeast = 0x1p-6;
    const double most = std::max({reach.x, reach.y, reach.z});
    return share * std::max(glm::dot(glm::abs(axis) / length, reach), kLeast * most);
}

PointRays::PointRays(const light::LightSampler& sampler, glm::dvec3 point,
                     glm::dvec3 normal, glm::dvec3 sceneOrigin, double offset) noexcept
    : normal_(normal), offset_(float(offset)), hasNormal_(normal != glm::dvec3(0.0)) {
    const light::LightView view = sampler.view(point);
    const glm::dvec3 start = hasNormal_ ? offset * normal : glm::dvec3(0.0);
    domain_ = view.domain;
    endless_ = view.endless;
    origin_ = point + start - sceneOrigin;
    base_ = endless_ ? view.base : view.base - start;
    lift_ = endless_ ? 0.0f : offset_;
    x_ = view.x;
    y_ = view.y;
    z_ = view.z;
    capHeight_ = float(view.capHeight);
}

void PointRays::append(const base::SquareSequence& sequence, const std::uint32_t* index,
                       std::size_t count, std::uint32_t owner,
                       RayStream& s) const noexcept {
    using Domain = light::LightView::Domain;
    Lanes u, v, w, above;
    sequence.points(index, count, u, v);
    if (domain_ == Domain::square) {
        for (std::size_t k = 0; k < count; ++k) {
            u[k] = 2.0f * u[k] - 1.0f;
            v[k] = 2.0f * v[k] - 1.0f;
            w[k] = 0.0f;
        }
    } else {
        toDisk(count, u, v);
        if (domain_ == Domain::cap)
            toCap(count, capHeight_, u, v, w);
        else
            std::fill_n(w, count, 0.0f);
    }
    // In place behind those that are there; then those above the horizon close ranks.
    const std::size_t first = s.count;
    float *dx = s.dirX + first, *dy = s.dirY + first, *dz = s.dirZ + first,
          *length = s.length + first;
    for (std::size_t k = 0; k < count; ++k) {
        const float x = base_.x + u[k] * x_.x + v[k] * y_.x + w[k] * z_.x;
        const float y = base_.y + u[k] * x_.y + v[k] * y_.y + w[k] * z_.y;
        const float z = base_.z + u[k] * x_.z + v[k] * y_.z + w[k] * z_.z;
        const float far = std::sqrt(x * x + y * y + z * z);
        const float inverse = far > 0.0f ? 1.0f / far : 0.0f;
        above[k] = normal_.x * x + normal_.y * y + normal_.z * z + lift_;
        dx[k] = x * inverse;
        dy[k] = y * inverse;
        dz[k] = z * inverse;
        length[k] = far;
    }
    for (std::size_t k = 0; k < count; ++k) {
        if (hasNormal_ && !(above[k] > 0.0f)) continue;
        const std::size_t to = s.count++;
        // A sample where the ray starts has no direction: any will do, it is clear.
        s.dirX[to] = length[k] > 0.0f ? dx[k] : 1.0f;
        s.dirY[to] = dy[k];
        s.dirZ[to] = dz[k];
        s.length[to] = length[k];
        s.sample[to] = index[k];
        s.owner[to] = owner;
    }
    for (std::size_t i = first; i < s.count; ++i) {
        const float along = hasNormal_ ? 0.0f : offset_;
        s.orgX[i] = origin_.x + along * s.dirX[i];
        s.orgY[i] = origin_.y + along * s.dirY[i];
        s.orgZ[i] = origin_.z + along * s.dirZ[i];
        s.length[i] = endless_ ? std::numeric_limits<float>::infinity()
                               : std::max(0.0f, s.length[i] - along);
    }
}

}  // namespace mtsm::baseline
