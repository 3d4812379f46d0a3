#include "baseline/distance_field.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <limits>
#include <utility>

namespace mtsm::baseline {
namespace {

class SphereField final : public DistanceField {
  public:
    SphereField(glm::dvec3 centre, double radius) : centre_(centre), radius_(radius) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        return glm::distance(p, centre_) - radius_;
    }

  private:
    glm::dvec3 centre_;
    double radius_;
};

class BoxField final : public DistanceField {
  public:
    BoxField(glm::dvec3 low, glm::dvec3 high)
        : centre_(0.5 * (low + high)), half_(0.5 * (high - low)) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        const glm::dvec3 q = glm::abs(p - centre_) - half_;
        return glm::length(glm::max(q, glm::dvec3(0.0))) +
               std::min(0.0, std::max({q.x, q.y, q.z}));
    }

  private:
    glm::dvec3 centre_, half_;
};

class PlaneField final : public DistanceField {
  public:
    PlaneField(glm::dvec3 p, glm::dvec3 normal) : point_(p), normal_(normal) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        return glm::dot(p - point_, normal_);
    }

  private:
    glm::dvec3 point_, normal_;
};

class CapsuleField final : public DistanceField {
  public:
    CapsuleField(glm::dvec3 a, glm::dvec3 b, double radius)
        : a_(a), b_(b), radius_(radius) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        const glm::dvec3 ab = b_ - a_;
        const double length = glm::dot(ab, ab);
        const double u =
            length > 0.0 ? std::clamp(glm::dot(p - a_, ab) / length, 0.0, 1.0) : 0.0;
        return glm::distance(p, a_ + u * ab) - radius_;
    }

  private:
    glm::dvec3 a_, b_;
    double radius_;
};

class UnionField final : public DistanceField {
  public:
    explicit UnionField(std::vector<DistanceFieldPtr> parts) : parts_(std::move(parts)) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        double nearest = std::numeric_limits<double>::infinity();
        for (const auto& part : parts_)
            nearest = std::min(nearest, part->at(p));
        return nearest;
    }
    [[nodiscard]] double behind(glm::dvec3 from,
                                glm::dvec3 direction) const noexcept override {
        double furthest = 0.0;
        for (const auto& part : parts_)
            furthest = std::max(furthest, part->behind(from, direction));
        return furthest;
    }
    [[nodiscard]] double spacing() const noexcept override {
        double largest = 0.0;
        for (const auto& part : parts_)
            largest = std::max(largest, part->spacing());
        return largest;
    }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        std::uint64_t bytes = 0;
        for (const auto& part : parts_)
            bytes += part->memoryBytes();
        return bytes;
    }

  private:
    std::vector<DistanceFieldPtr> parts_;
};

}  // namespace

double DistanceField::behind(glm::dvec3, glm::dvec3) const noexcept {
    return std::numeric_limits<double>::infinity();
}

DistanceFieldPtr sphereField(glm::dvec3 centre, double radius) {
    return std::make_unique<SphereField>(centre, radius);
}
DistanceFieldPtr boxField(glm::dvec3 low, glm::dvec3 high) {
    return std::make_unique<BoxField>(low, high);
}
DistanceFieldPtr planeField(glm::dvec3 p, glm::dvec3 normal) {
    return std::make_unique<PlaneField>(p, normal);
}
DistanceFieldPtr capsuleField(glm::dvec3 a, glm::dvec3 b, double radius) {
    return std::make_unique<CapsuleField>(a, b, radius);
}
DistanceFieldPtr unionField(std::vector<DistanceFieldPtr> parts) {
    return std::make_unique<UnionField>(std::move(parts));
}

}  // namespace mtsm::baseline
