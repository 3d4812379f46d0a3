// measure.h - how far the casters reach, in any frame.
//
// One pass over all that can cast: triangles that are finite, have an area and are not
// transparent, strands with their widths, the blocks of volumes; of each the part between
// two depths. Costs about as much as transforming the corners.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <limits>

#include "bake/visits.h"
#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm::bake_detail {

struct Extent {
    static constexpr double kNone = std::numeric_limits<double>::infinity();

    glm::dvec3 min{kNone}, max{-kNone};  ///< light space of the frame
    /// On the plane z = 1 (perspective), or the same as x and y (orthographic).
    glm::dvec2 windowMin{kNone}, windowMax{-kNone};
    double radius2 = 0.0;  ///< largest square of the distance from the axis, there
    std::uint64_t meshes = 0, triangles = 0;
    std::uint64_t nonFinite = 0, degenerate = 0, transparent = 0;
    /// Triangles, segments and blocks wholly in front of near or behind far.
    std::uint64_t outside = 0;
    /// Of strands: segments, and their lengths and areas, world units.
    std::uint64_t segments = 0;
    double segmentLength = 0.0, segmentArea = 0.0;
    std::uint64_t cut = 0;  ///< of those that reach in front of near, wholly or in part

    /// True if nothing reaches between near and far.
    [[nodiscard]] bool empty() const noexcept { return !(min.x <= max.x); }
    /// True if something could cast, wherever it is.
    [[nodiscard]] bool usable() const noexcept { return !empty() || outside > 0; }
    void add(const Extent& other) noexcept;
    /// Adds what a caster reaches, if it can cast; see measure().
    void addCaster(const CasterView& caster, const Projection& frame, double near,
                   double far);
    void include(glm::dvec3 p, bool perspective) noexcept;
    /// All of a square that is level with the frame, so far to each side of p.
    void includeSquare(glm::dvec3 p, double half, bool perspective) noexcept;
};

/// Light space as large as the world, for measuring in world coordinates.
[[nodiscard]] Projection worldFrame() noexcept;

/// `frame`: kind, eye and axes are used, raster scale and window are not. For a
/// perspective frame near > 0.
Result<Extent> measure(Visits& visits, const Projection& frame, double near, double far);

}  // namespace mtsm::bake_detail
