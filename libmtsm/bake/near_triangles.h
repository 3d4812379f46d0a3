// near_triangles.h - all triangles that may block a ray within a face, in straight space
// (mtsm/near_field.h), from the casters.
//
// Left out is what casts nothing in the map either: triangles that are not finite, have
// no area or are culled, and what lies in front of near, behind far or beside the window.
// Triangles that see the eye edge-on are no samples of any pixel, but block rays, and are
// kept. What crosses near or far is cut there. A triangle that is wider than kMostPixels
// is cut at the window, kMargin around it, and then into squares of a fixed raster, so
// that its corners stay exact on a grid of 16 bits; two that share an edge are cut at the
// same points of it.
#pragma once
#include <cstdint>
#include <vector>

#include "bake/straight_space.h"
#include "bake/visits.h"
#include "mtsm/bake.h"
#include "mtsm/map.h"

namespace mtsm::bake_detail {

/// A face's triangles, or, once they were more than `most`, their number alone.
struct NearTriangles {
    std::vector<NearTriangle> triangles;
    /// [triangles]: of which of the mesh each is; only where it was asked for.
    std::vector<std::uint32_t> sources = {};
    std::uint64_t count = 0;
};

/// Adds those of one mesh, with `sources` if asked for.
void collectNearMesh(const MeshView& mesh, const Projection& projection,
                     const StraightSpace& space, std::uint64_t most, bool sources,
                     NearTriangles& all);

/// The casters are opaque triangles. The same for any number of threads; in the order of
/// the casters.
Result<NearTriangles> collectNear(Visits& visits, const Projection& projection,
                                  const BakeOptions& options, std::uint64_t most);

}  // namespace mtsm::bake_detail
