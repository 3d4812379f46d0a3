// sheet_trace.h - what the triangles of a map of sheets leave of a bundle's rays.
//
// All coordinates are those of straight space (mtsm/near_field.h). As in near_trace.h a
// ray goes through a triangle if the volumes that its direction spans with the edges and
// its start have one sign [Segura01]. Here a ray pays for every triangle, so of two that
// share an edge it must cross one and no more: the volumes at a shared edge are each
// other's negatives to the last bit, and where they are zero the edge's direction
// decides. (Only at a corner, to a float's rounding, may a ray cross none or several.)
#pragma once
#include "mtsm/near_sheets.h"
#include "trace/bundle.h"

namespace mtsm::trace {

struct SheetTraceOptions {
    bool perspective = true;  ///< the face is
    /// Of receivers with a plane only triangles count that rise more than this above it,
    /// in the bundle's measure.
    float height = 0.0f;
    /// A ray of which no more than this is left is not followed further.
    float dark = 0.0f;
};

/// Multiplies `visible` [row][lane] by what each open ray is left by the triangles that
/// it crosses at some s with begin < s <= end [row][lane], and closes those that are dark
/// then. What becomes of a ray depends on that ray alone; the same on every machine.
/// Needs finite rays. Does not allocate; time grows with the triangles near the rays and
/// the logarithm of the others.
void traceSheets(const NearSheets& sheets, const SheetTraceOptions& options,
                 RayBundle& rays, const float (*end)[kLanes],
                 float (*visible)[kLanes]) noexcept;

}  // namespace mtsm::trace
