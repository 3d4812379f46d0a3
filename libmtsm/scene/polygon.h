// polygon.h - polygons into triangles.
//
// Ear clipping [Meisters75] in double precision, on the polygon's projection along the
// axis that it faces most. Assimp's own triangulation is not used: on a comb of 40 teeth,
// a simple polygon, version 5.2.5 loses an eighth of the area.
#pragma once
#include <assimp/mesh.h>

#include <cstdint>
#include <span>
#include <vector>

namespace mtsm::scene {

class PolygonCutter {
  public:
    /// Appends n - 2 triangles for a polygon of n >= 3 corners, turned as the polygon is.
    /// They cover a simple polygon exactly once, also a concave one and one that is
    /// joined to its holes by bridges. For a polygon that crosses itself, is far from
    /// flat or has corners that are not finite, there are n - 2 triangles between its
    /// corners, and that is all. Each index must be a valid one into `positions`.
    ///
    /// Time is linear for convex polygons; else it grows with the number of corners
    /// times that of concave ones, up to a bound after which quality yields.
    void cut(std::span<const unsigned> corners, const aiVector3D* positions,
             std::vector<std::uint32_t>& triangles);

  private:
    struct Point {
        double x, y;
    };
    /// How picky a search for ears is; the next one is tried when one finds none.
    enum class Rule { nothingTouches, nothingInside, convex };

    void project(std::span<const unsigned> corners, const aiVector3D* positions);
    [[nodiscard]] double turn(std::uint32_t a, std::uint32_t b, std::uint32_t c) const;
    [[nodiscard]] bool isEar(std::uint32_t corner, Rule rule);
    [[nodiscard]] std::uint32_t findEar(std::uint32_t from, std::uint32_t left);

    // Kept from call to call to save allocations.
    std::vector<Point> points_;                   // [corner]
    std::vector<std::uint32_t> before_, behind_;  // [corner]: neighbours; self: cut off
    std::vector<std::uint32_t> concave_;          // corners that were not convex at first
    std::uint64_t patience_ = 0;                  // point tests left
};

}  // namespace mtsm::scene
