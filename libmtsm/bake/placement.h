// placement.h - where the map's eye stands, where it looks and what its window holds.
//
// Finite lights. The eye looks from the light to what options ask for and is pushed back
// behind the light's centre by d = R / tan(fov / 2) [Xie07, eq. 4], so the light lies on
// the plane z = d (spheres: R / sin). With a given field of view the window is centred,
// its pixels are square, its larger side is that wide and its smaller one decides d.
// Without, tan(fov / 2) is the largest tangent under which the light's centre sees a
// caster, and the window is then fitted to the casters as the eye sees them. There, d is
// kept small enough for a float depth to resolve a quarter of a pixel's footprint (the
// fitted window holds every caster whatever d is).
//
// near. What lies between the eye and the light is no caster: near is the light's plane,
// for a sphere its far side, or options.near in front of the plane. Where that would be
// the eye itself (lights of no size) it is 1e-6 of the distance to the far end of the
// casters' bounds instead.
//
// Six faces (BakeOptions::cube). The eye is the light's centre, whatever its shape: there
// is no push-back. The faces look along +x, -x, +y, -y, +z, -z of the world, in this
// order; up is +y, in the second pair +z. Each is a square window of 90 degrees, a
// tangent of exactly 1, so that they share out all of space. Finite lights only.
//
// Here near keeps from casting what lies in a cube around the eye: of a sphere, the
// largest cube that fits inside; of all other lights 1e-6 of the distance to the casters'
// far end, as if they were points; or options.near. Of a light that has a size, what the
// eye sees is not what its rim sees, but rays to the rim are traced all the same: they
// end within the light, in pixels near the eye, which are narrow there and hold what is
// seen from the eye.
// Casters closer to the eye than the light's radius may so be missed where others hide
// them, and between a sphere and the cube inside it casters do cast. What lies behind a
// one-sided light is in the map, but never asked for.
//
// Suns. Orthographic, along the light's direction; the eye stands before the nearest
// caster by a hundredth of the casters' extent.
#pragma once
#include <vector>

#include "bake/measure.h"
#include "bake/visits.h"
#include "mtsm/bake.h"

namespace mtsm::bake_detail {

/// Pixels' sides differ by this factor at most when a window is fitted.
inline constexpr double kMaxPixelAspect = 4.0;
/// Largest half angle that a fitted window may have, radians: 85 degrees.
inline constexpr double kMaxHalfAngle = 1.4835298641951802;

struct Placement {
    AreaLight light;                      ///< as it is stored: aimed, with unit vectors
    std::vector<Projection> projections;  ///< one, or a cube's six
    std::uint64_t triangles = 0;          ///< that the casters have; 0: not known
    /// BakeReport's; 0: there are no strands, or it is not known.
    double strandWidth = 0.0, segmentLength = 0.0;
};

/// Refuses options that are out of range, whatever the casters are.
Status checkOptions(const BakeOptions& options);

/// Visits the casters up to three times: for their bounds, for the push-back and for the
/// window; not at all if the options say it all.
Result<Placement> place(Visits& visits, const BakeOptions& options);

/// No triangle is left that casts: why not (badFile).
Error nothingCasts(const BakeReport& report);

}  // namespace mtsm::bake_detail
