#include "light/sample.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

namespace mtsm::light {

glm::dvec2 sampleDisk(glm::dvec2 u) noexcept {
    // Concentric squares go to concentric circles.
    const glm::dvec2 s = 2.0 * u - 1.0;
    if (s.x == 0.0 && s.y == 0.0) return glm::dvec2(0.0);
    double r, phi;
    if (std::abs(s.x) > std::abs(s.y)) {
        r = s.x;
        phi = glm::quarter_pi<double>() * (s.y / s.x);
    } else {
        r = s.y;
        phi = glm::half_pi<double>() - glm::quarter_pi<double>() * (s.x / s.y);
    }
    return r * glm::dvec2(std::cos(phi), std::sin(phi));
}

glm::dvec3 sampleCap(glm::dvec2 u, double capHeight) noexcept {
    // A cap's area is linear in its height: r^2 of the disk becomes the height h, and the
    // circle at height h has radius sqrt(h (2 - h)).
    const glm::dvec2 d = sampleDisk(u);
    const double height = std::min(1.0, glm::dot(d, d)) * capHeight;
    const glm::dvec2 circle = d * std::sqrt(std::max(0.0, capHeight * (2.0 - height)));
    return {circle, 1.0 - height};
}

Frame makeFrame(glm::dvec3 n) noexcept {
    const glm::dvec3 other =
        std::abs(n.x) < 0.6 ? glm::dvec3(1.0, 0.0, 0.0) : glm::dvec3(0.0, 1.0, 0.0);
    const glm::dvec3 x = glm::normalize(glm::cross(other, n));
    return {x, glm::cross(n, x)};
}

Frame rectFrame(const AreaLight& light) noexcept {
    const glm::dvec3 n = glm::normalize(light.direction);
    const glm::dvec3 up = light.up - glm::dot(light.up, n) * n;
    if (!(glm::length(up) > 1e-9 * glm::length(light.up))) return makeFrame(n);
    const glm::dvec3 y = glm::normalize(up);
    return {glm::cross(y, n), y};
}

LightSampler::LightSampler(const AreaLight& light) noexcept
    : shape_(light.shape),
      centre_(light.position),
      normal_(glm::normalize(light.direction)),
      radius_(light.radius) {
    Frame frame = makeFrame(normal_);
    switch (shape_) {
        case LightShape::point:
            isPoint_ = true;
            break;
        case LightShape::disk:
            oneSided_ = true;
            isPoint_ = radius_ == 0.0;
            axisX_ = radius_ * frame.x;
            axisY_ = radius_ * frame.y;
            break;
        case LightShape::rect:
            oneSided_ = true;
            isPoint_ = light.size.x == 0.0 && light.size.y == 0.0;
            frame = rectFrame(light);
            axisX_ = 0.5 * light.size.x * frame.x;
            axisY_ = 0.5 * light.size.y * frame.y;
            break;
        case LightShape::sphere:
            isPoint_ = radius_ == 0.0;
            break;
        case LightShape::sun:
            isPoint_ = light.angularDiameter == 0.0;
            normal_ = -normal_;
            frame = makeFrame(normal_);
            axisX_ = frame.x;
            axisY_ = frame.y;
            // 1 - cos(a / 2), without cancellation for small a.
            capHeight_ = 2.0 * std::pow(std::sin(0.25 * light.angularDiameter), 2);
            break;
    }
}

bool LightSampler::isBehind(glm::dvec3 p) const noexcept {
    return oneSided_ && !(glm::dot(p - centre_, normal_) > 0.0);
}

LightSampler::Cap LightSampler::capSeen(glm::dvec3 p) const noexcept {
    // p sees the cap where the sphere's normal n has n . axis > radius / distance; from
    // inside it sees everything.
    const glm::dvec3 toPoint = p - centre_;
    const double distance = glm::length(toPoint);
    Cap cap;
    cap.outside = distance > radius_;
    cap.axis = distance > 0.0 ? toPoint / distance : glm::dvec3(0, 0, 1);
    cap.frame = makeFrame(cap.axis);
    cap.height = cap.outside ? 1.0 - radius_ / distance : 2.0;
    return cap;
}

LightView LightSampler::view(glm::dvec3 p) const noexcept {
    using Domain = LightView::Domain;
    if (shape_ == LightShape::sun)
        return {Domain::cap, glm::dvec3(0.0), axisX_, axisY_, normal_, capHeight_, true};
    if (shape_ == LightShape::sphere && !isPoint_) {
        const Cap cap = capSeen(p);
        return {Domain::cap,
                centre_ - p,
                radius_ * cap.frame.x,
                radius_ * cap.frame.y,
                radius_ * cap.axis,
                cap.height,
                false};
    }
    LightView seen;
    seen.base = centre_ - p;
    if (isPoint_) return seen;
    seen.domain = shape_ == LightShape::disk ? Domain::disk : Domain::square;
    seen.x = axisX_;
    seen.y = axisY_;
    return seen;
}

LightSample LightSampler::sample(glm::dvec3 p, glm::dvec2 u) const noexcept {
    LightSample s;
    if (shape_ == LightShape::sun) {
        const glm::dvec3 d = sampleCap(u, capHeight_);
        s.delta = d.x * axisX_ + d.y * axisY_ + d.z * normal_;
        s.endless = true;
        return s;
    }
    glm::dvec3 onLight = centre_, normal = normal_;
    bool cosineAtLight = oneSided_;
    if (shape_ == LightShape::disk) {
        const glm::dvec2 d = sampleDisk(u);
        onLight += d.x * axisX_ + d.y * axisY_;
    } else if (shape_ == LightShape::rect) {
        onLight += (2.0 * u.x - 1.0) * axisX_ + (2.0 * u.y - 1.0) * axisY_;
    } else if (shape_ == LightShape::sphere && radius_ > 0.0) {
        const Cap cap = capSeen(p);
        const glm::dvec3 d = sampleCap(u, cap.height);
        normal = d.x * cap.frame.x + d.y * cap.frame.y + d.z * cap.axis;
        onLight += radius_ * normal;
        cosineAtLight = cap.outside;
    }
    s.delta = onLight - p;
    const double d2 = glm::dot(s.delta, s.delta);
    if (d2 > 0.0) {
        s.weight = 1.0 / d2;
        if (cosineAtLight)
            s.weight *= std::max(0.0, -glm::dot(s.delta, normal)) / std::sqrt(d2);
    }
    return s;
}

}  // namespace mtsm::light
