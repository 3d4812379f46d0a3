// receiver_places.h - numbers by which receivers are put in order: close for points whose
// rays take much the same way.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>

#include "light/sample.h"
#include "mtsm/map.h"

namespace mtsm::shadow {

class ReceiverPlaces {
  public:
    /// Of points that bundles do not answer: not finite, behind a one-sided light, beside
    /// or behind the eye, or so far outside the view that rays in float are too coarse.
    static constexpr std::uint32_t kNone = ~std::uint32_t(0);

    /// `depths`: between which there is anything to meet.
    ReceiverPlaces(const ShadowMap& map, std::uint32_t face, ZRange depths,
                   const light::LightSampler& light);

    static constexpr int kAtOnce = 16;
    /// Of 1 to kAtOnce points numbers below 2^30, or kNone.
    void find(const glm::dvec3* points, int count, std::uint32_t* places) const noexcept;

    /// The face, and what is far outside it.
    struct View {
        bool perspective, oneSided;
        double turn[3][3], eye[3];    // world to light space
        double centre[3], shines[3];  // of a one-sided light
        double farthest, nearest;
        float scale[3], offset[3];  // light space over depth to windows from the middle
    };

  private:
    View view_;
};

}  // namespace mtsm::shadow
