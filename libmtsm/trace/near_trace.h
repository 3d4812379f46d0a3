// near_trace.h - which rays of a bundle the triangles of a near field block.
//
// All coordinates are those of straight space (mtsm/near_field.h). The edges of a
// triangle and the start of a ray span planes, and a ray goes through the triangle if it
// passes all three on the same side: if the volumes that its direction spans with them
// have one sign, or are zero [Segura01]. That needs no division and holds for triangles
// at any angle. What is zero but for rounding counts as zero: no ray slips through
// between triangles that share an edge or a corner.
#pragma once
#include <vector>

#include "mtsm/near_field.h"
#include "trace/bundle.h"

namespace mtsm::trace {

/// Closes every open ray that crosses a triangle at some s with begin < s <= end
/// [row][lane]. Of receivers with a plane only triangles count that rise more than
/// `height` above it, in the bundle's measure. What becomes of a ray depends on that ray
/// alone; the same on every machine. Needs finite rays. Does not allocate; time grows
/// with the triangles near the rays and the logarithm of the others.
void traceNear(const NearField& field, RayBundle& rays, const float (*end)[kLanes],
               float height) noexcept;

/// May any ray of the hull meet a chunk, of NearField::levels or NearHair::levels, of
/// which it comes no further than `rise` in w? Where that is not soon found out, it may.
/// Does not allocate.
[[nodiscard]] bool mayMeet(const std::vector<std::vector<NearBoxes>>& levels,
                           const RayHull& hull, float rise) noexcept;

}  // namespace mtsm::trace
