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

#include "bake/visits.h"
#include "mtsm/bake.h"
#include "mtsm/map.h"

namespace mtsm::bake_detail {

/// Pixels that a triangle may reach over: fewer than 65535 steps of 1/32.
inline constexpr double kMostPixels = 2000.0;
/// Pixels around the window.
inline constexpr double kMargin = 64.0;

struct NearTriangle {
    float corner[3][3];  ///< [corner][u, v, w]
};

/// A face's triangles, or, once they were more than was allowed, their number alone.
template <typename Item>
struct NearItems {
    std::vector<Item> items;
    std::uint64_t count = 0;

    void add(const std::vector<Item>& more, std::uint64_t most) {
        count += more.size();
        if (count > most)
            items = {};
        else
            items.insert(items.end(), more.begin(), more.end());
    }
};
using NearTriangles = NearItems<NearTriangle>;

/// Appends those of a caster, which is opaque, while there are no more than `most`. In
/// the order of the caster's, for any number of threads. `sources`, if not null, gets
/// which of the mesh's triangles each is (of).
void collectMesh(const MeshView& mesh, const Projection& projection,
                 const BakeOptions& options, std::uint64_t most, NearTriangles& all,
                 std::vector<std::uint32_t>* sources = nullptr);

}  // namespace mtsm::bake_detail
