// sample.h - points on a light, as a shading point sees them.
#pragma once
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "mtsm/light.h"

namespace mtsm::light {

/// The unit disk from the unit square, areas and neighbourhoods kept [Shirley97].
[[nodiscard]] glm::dvec2 sampleDisk(glm::dvec2 u) noexcept;

/// A unit vector within the cap around +z that is `capHeight` high (0..2), uniform in
/// area.
[[nodiscard]] glm::dvec3 sampleCap(glm::dvec2 u, double capHeight) noexcept;

/// Unit vectors x and y that form a right-handed frame with the unit vector n.
struct Frame {
    glm::dvec3 x, y;
};
[[nodiscard]] Frame makeFrame(glm::dvec3 n) noexcept;
/// The frame that a rect light's size is measured in: y along `light.up`, as far as that
/// is across the light's direction.
[[nodiscard]] Frame rectFrame(const AreaLight& light) noexcept;

/// One ray's worth of light. From the shading point it goes along `delta`: to its end,
/// or, if `endless`, on for ever in that (unit) direction.
struct LightSample {
    glm::dvec3 delta{0.0};
    bool endless = false;
    /// Irradiance at a surface that faces the sample, up to a factor common to all
    /// samples of the light: cosine at the light over squared distance, times the
    /// density's inverse.
    double weight = 1.0;
};

/// A light as one point sees it, for many samples at once: sample(p, u).delta is
/// base + a * x + b * y + c * z, where (a, b) is 2 u - 1 (square) or sampleDisk(u)
/// (disk), or (a, b, c) is sampleCap(u, capHeight) (cap).
struct LightView {
    enum class Domain { square, disk, cap } domain = Domain::square;
    glm::dvec3 base{0.0}, x{0.0}, y{0.0}, z{0.0};
    double capHeight = 0.0;
    bool endless = false;
};

/// An AreaLight ready to be sampled.
class LightSampler {
  public:
    explicit LightSampler(const AreaLight& light) noexcept;

    /// Does nothing but one sample matter? True for points and for lights of no size.
    [[nodiscard]] bool isPoint() const noexcept { return isPoint_; }
    /// On or behind the plane of a light that shines to one side only.
    [[nodiscard]] bool isBehind(glm::dvec3 p) const noexcept;
    /// The unit vector out of a light that shines to one side only; zero: to all sides.
    [[nodiscard]] glm::dvec3 shines() const noexcept {
        return oneSided_ ? normal_ : glm::dvec3(0.0);
    }
    /// Uniform in area over the light (sphere: over the cap that p sees; sun: over the
    /// solid angle) for u uniform in the unit square.
    [[nodiscard]] LightSample sample(glm::dvec3 p, glm::dvec2 u) const noexcept;
    [[nodiscard]] LightView view(glm::dvec3 p) const noexcept;
    /// Not for a sun.
    [[nodiscard]] glm::dvec3 centre() const noexcept { return centre_; }
    /// Towards the light's centre; a sun's is a unit vector.
    [[nodiscard]] glm::dvec3 towards(glm::dvec3 p) const noexcept {
        return shape_ == LightShape::sun ? normal_ : centre_ - p;
    }
    [[nodiscard]] LightShape shape() const noexcept { return shape_; }

  private:
    /// Of a sphere, what a point sees.
    struct Cap {
        glm::dvec3 axis;  // unit, towards the point
        Frame frame;
        double height;
        bool outside;
    };
    [[nodiscard]] Cap capSeen(glm::dvec3 p) const noexcept;

    LightShape shape_;
    bool isPoint_ = false, oneSided_ = false;
    glm::dvec3 centre_, normal_;  // normal_: unit; a sun's points towards the sun
    glm::dvec3 axisX_, axisY_;    // scaled by radius or half size (disk, rect), else unit
    double radius_ = 0.0;
    double capHeight_ = 0.0;  // sun
};

}  // namespace mtsm::light
