// near_segments.h - all segments of strands that may block a ray within a face, in
// straight space (mtsm/near_field.h), from the casters.
//
// Left out is what casts nothing in the map either: strands with a point or a width that
// is not usable, those of one point, without width or opacity, and what lies in front of
// near, behind far or beside the window. Segments that the eye sees end-on are no samples
// of any pixel, but block rays, and are kept. What crosses near or far is cut there. A
// segment that reaches over more than kMostPixels is cut around the window, and then into
// equal parts.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>

#include "bake/near_triangles.h"
#include "mtsm/map.h"
#include "mtsm/scene.h"

namespace mtsm::bake_detail {

struct NearSegment {
    float end[2][3];  ///< [end][u, v, w]
    float half[2];    ///< [end]: NearHairChunk
    std::uint16_t opacity;
    std::uint16_t unused = 0;  ///< so that segments compare as bytes
};

using NearSegments = NearItems<NearSegment>;

/// Appends those of a caster, while there are no more than `most`. `window`: pixels. In
/// the order of the strands, for any number of threads.
void collectStrands(const StrandsView& strands, const Projection& projection,
                    glm::dvec2 window, std::uint64_t most, NearSegments& all);

}  // namespace mtsm::bake_detail
