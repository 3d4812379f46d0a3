// shadow_rays.h - shadow rays in bulk, in the form that Embree traces fastest.
//
// That is a stream of rays that lie close together [Embree's "coherent" streams: packets
// in a common frustum]. So the light samples of a point are taken in an order in which
// neighbours on the light follow each other, and are made in float, several at once:
// relative to the point, so that nothing is lost far from the origin.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "base/sampling.h"
#include "light/sample.h"

namespace mtsm::baseline {

inline constexpr std::size_t kStreamRays = 64;

/// Rays one behind the other, as RTCRayNp wants them. Origins are relative to the
/// scene's.
struct RayStream {
    alignas(64) float orgX[kStreamRays], orgY[kStreamRays], orgZ[kStreamRays];
    alignas(64) float dirX[kStreamRays], dirY[kStreamRays], dirZ[kStreamRays];
    alignas(64) float length[kStreamRays];  ///< infinite: endless
    std::uint32_t sample[kStreamRays];      ///< its index in the point's sequence
    std::uint32_t owner[kStreamRays];       ///< the point, as the caller counts them
    std::size_t count = 0;

    [[nodiscard]] std::size_t room() const noexcept { return kStreamRays - count; }
};

/// Samples [begin, end) of any sequence in an order that follows the light from place to
/// place: the first 4096 points of every base::SquareSequence share their cells.
std::vector<std::uint32_t> neighbourOrder(std::uint32_t begin, std::uint32_t end);

/// How far off `point`, along `axis`, rays start: `share` of how far the box reaches from
/// there in each coordinate, as far as that moves along the axis. Rounding of vertices,
/// of the ray and of a triangle's plane, which is as large as the triangle, stays below
/// 16 * 2^-24 of it.
[[nodiscard]] double rayOffset(glm::dvec3 point, glm::dvec3 axis, glm::dvec3 low,
                               glm::dvec3 high, double share) noexcept;

/// The rays from one point to a light.
class PointRays {
  public:
    /// `normal` is of unit length, or zero: none. Rays start `offset` along it, or along
    /// themselves.
    PointRays(const light::LightSampler& sampler, glm::dvec3 point, glm::dvec3 normal,
              glm::dvec3 sceneOrigin, double offset) noexcept;
    /// Appends the rays to samples index[0..count), count <= room(), but those below the
    /// horizon. A ray to a sample at its start has the length 0.
    void append(const base::SquareSequence& sequence, const std::uint32_t* index,
                std::size_t count, std::uint32_t owner, RayStream& stream) const noexcept;

  private:
    light::LightView::Domain domain_;
    glm::vec3 origin_, base_, x_, y_, z_, normal_;
    float capHeight_, offset_;
    float lift_;  ///< by which base_ is lower for the ray's start, along the normal
    bool hasNormal_, endless_;
};

}  // namespace mtsm::baseline
