// light_outline.h - what receivers make of a light at first sight, before any ray: is all
// of it above their horizons, or nothing; and where all their rays go.
//
// Most points of a picture are lit or turn their backs to the light. A glance at a block
// of neighbours finds that out for much less than rays for each of them would cost. It
// never says more than the rays would.
#pragma once
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "light/sample.h"
#include "mtsm/map.h"
#include "trace/bundle.h"

namespace mtsm::shadow {

struct Receiver {
    glm::dvec3 point{0.0};
    /// Any length; zero: none, for all of a call or none.
    glm::dvec3 normal{0.0};
    std::uint32_t pattern = 0;  ///< of LightRays', for its rays
};

/// Up to 16 receivers. One bit each: all of the light is surely above its horizon, or
/// nothing of it; the starts of the former in straight space.
struct Outlook {
    std::uint16_t above = 0, below = 0;
    float low[3], high[3];  ///< [u, v, w]; if any is above

    void include(const Outlook& other) noexcept;
};

class LightOutline {
  public:
    LightOutline(const Projection& projection, const light::LightSampler& light);

    /// Of 1 to 16 receivers, finite ones. Without normals all of the light is above.
    [[nodiscard]] Outlook outlook(const Receiver* receivers, int count) const noexcept;
    /// All rays, as close together as `among` a receiver are, from starts that are above
    /// to the light; nothing if some might not lead towards the eye. Its wFirst is the
    /// lowest start.
    [[nodiscard]] std::optional<trace::RayHull> hull(const Outlook& starts,
                                                     float among) const noexcept;

    /// The light in light space: a box (centre and half sides, from there) that contains
    /// it, or, endless, the directions to it.
    struct Outline {
        bool perspective = true, endless = false;
        double turn[3][3] = {}, eye[3] = {};  // world to light space
        float scale[2] = {}, offset[2] = {};  // light to raster space
        float centre[3] = {};
        float axes[3][3] = {};  // it is centre + a axes[0] + b axes[1] + c axes[2]
        float radius = 0.0f;    // or a ball
    };

  private:
    Outline outline_;
    float half_[3];  // of a box around it
    float tilt_ = 1.0f;
    float slopeLow_[2], slopeHigh_[2];  // endless: all that matters
    bool known_ = false;
};

}  // namespace mtsm::shadow
