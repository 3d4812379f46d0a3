// hair_trace.h - the optical depth that the rays of a bundle meet in the strands of a
// near field.
//
// All coordinates are those of straight space (mtsm/near_field.h). Seen from a receiver a
// place is a slope: how many pixels it is away in u and v for each w that it lies above.
// A ray is one slope, and a segment a strip from slope to slope, whose two ends are as
// wide as half, over the height above the receiver, says: a metric length across a ray
// and the segment, so the ribbon faces that ray. What lies of a segment below where
// strands begin to count, and beyond where the near field ends, is cut away first; so a
// ray is answered by four half-planes, without its depth. Ribbons end flat.
//
// Of receivers without a plane segments within two widths (up to 16) are met as they are
// in light space, each ribbon facing each ray, with round joints, of which a ray pays for
// one.
#pragma once
#include "mtsm/map.h"
#include "trace/bundle.h"
#include "trace/density_trace.h"

namespace mtsm::trace {

struct HairTraceOptions {
    /// Receivers with a plane: what lies no higher than this above it does not count, in
    /// the bundle's measure.
    float height = 0.0f;
    /// Others: what lies less than this above them, in pixel footprints; and of the
    /// strand on which they lie, no further from its middle line than half a width, what
    /// a ray meets within a width. A strand is told by its segments having ends in
    /// common.
    float start = 0.0f;
    /// A ray that has met this much is not followed further.
    float darkDepth = kDarkDepth;
};

/// Adds to all `channels` of `depths` what the open rays meet up to RayBundle::rise above
/// their receivers, and closes rays that are dark afterwards: their depth is then at
/// least darkDepth. Of receivers in `wide` no ray meets anything. What becomes of a ray
/// depends on that ray alone; the same on every machine. Needs finite rays. Does not
/// allocate; time grows with the segments near the rays and the logarithm of the others.
void traceHair(const NearHair& hair, const Projection& projection,
               const HairTraceOptions& options, std::uint32_t channels, RayBundle& rays,
               RayDepths& depths) noexcept;

}  // namespace mtsm::trace
