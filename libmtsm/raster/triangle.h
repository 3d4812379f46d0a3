// triangle.h - exact rasterisation of triangles: which pixel centres one covers, and at
// which depth.
//
//     const TriangleSetup setup(projection, width, height, Facing::any);
//     const Vertex a = setup.vertex(lightFromObject(p)), b = ..., c = ...;
//     setup.triangle(a, b, c, mirrored, origin2, surface, counts, prepared);
//     for (const PreparedTriangle& t : prepared)
//         drawTriangle<ProjectionKind::perspective>(t, pixels, sink);  // sink(x, y, z)
//
// A sample is a pixel centre. Vertices are projected in double and snapped to a grid of
// 2^-14 pixel; from there on coverage is integer arithmetic without rounding, so with the
// top-left rule an edge that two triangles share gives each pixel centre on it to exactly
// one of them, whatever the order of their vertices. (Exactly one in the sense of the
// snapped mesh: a sliver thinner than the grid may turn over when it is snapped.)
//
// Bit budget. The window is at most 2^15 pixels wide. Triangles that reach further than a
// guard band of 2^14 pixels beyond it are cut there first, so coordinates lie in
// [-2^14, 2^15 + 2^14] pixels, |x| < 2^30 grid steps (int32); differences are at most
// 2^30 (int32), their products 2^60, an edge function 2^61 (int64).
//
// The cut itself is done in double: corners within 1e12 times their depth of the axis
// come out exactly enough.
//
// Depth is that of the triangle's plane (the whole one's, also where it was cut) on the
// centre ray, in double, kept within the depths of the triangle's corners, and float from
// there on.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/map.h"
#include "raster/clip.h"

namespace mtsm::raster {

inline constexpr int kSubpixelBits = 14;
inline constexpr std::int32_t kSubpixels = 1 << kSubpixelBits;  ///< grid steps per pixel
inline constexpr double kGuardPixels = 16384.0;
/// Light-space coordinates beyond this count as infinite: their cubes still fit a double.
inline constexpr double kLargestCoordinate = 1e30;
/// What `near` is at least, so that a depth is always positive as a float, too.
inline constexpr double kSmallestDepth = 1e-30;

/// Which faces cast. The front is where the corners run counter-clockwise.
enum class Facing { any, front, back };

/// What became of the triangles. Each is counted in at most one of the first four; those
/// that are in none of them were drawn.
struct TriangleCounts {
    std::uint64_t nonFinite = 0;   ///< a corner is NaN, infinite or beyond 1e30
    std::uint64_t degenerate = 0;  ///< no area, or less than a double resolves
    std::uint64_t culled = 0;      ///< faces the wrong way
    std::uint64_t outside = 0;     ///< wholly outside window, near and far
    std::uint64_t behind = 0;      ///< of those outside: wholly in front of `near`
    std::uint64_t clipped = 0;     ///< cut by near or far, or reaching out of the window
    /// Of those clipped or outside: what lies between near and far leaves the window.
    std::uint64_t leavesWindow = 0;

    void add(const TriangleCounts& other) noexcept;
};

/// Double the area as a vector, and whether it is more than rounding: the triangle's
/// height must exceed a few steps of the doubles that its corners were computed in.
/// `origin2` is the square of the largest number that went into them besides.
struct TriangleNormal {
    glm::dvec3 normal;
    bool hasArea;

    TriangleNormal(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c, double origin2) noexcept
        : TriangleNormal(a, b, c,
                         std::max({glm::dot(a, a), glm::dot(b, b), glm::dot(c, c)}),
                         origin2) {}
    /// `corner2`: the square of the largest distance of a corner from the origin.
    TriangleNormal(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c, double corner2,
                   double origin2) noexcept {
        constexpr double kRounding = 4.0 * 0x1p-52;
        const glm::dvec3 ab = b - a, ac = c - a, bc = c - b;
        normal = glm::cross(ab, ac);
        const double edge2 = glm::dot(ab, ab) + glm::dot(ac, ac) + glm::dot(bc, bc);
        const double size2 = corner2 + origin2;
        hasArea = glm::dot(normal, normal) > kRounding * kRounding * size2 * edge2;
    }
};

/// A projected corner.
struct Vertex {
    glm::dvec3 light{0.0};
    double light2 = 0.0;  ///< its square
    glm::dvec2 raster{0.0};
    std::int32_t x = 0, y = 0;  ///< snapped, in grid steps
    std::uint32_t flags = 0;    ///< 0: finite, between near and far, within the window
};

/// Pixels x0..x1, y0..y1, both ends included; empty when x0 > x1 or y0 > y1.
struct PixelRect {
    std::int32_t x0, y0, x1, y1;

    [[nodiscard]] bool empty() const noexcept { return x0 > x1 || y0 > y1; }
};

[[nodiscard]] inline PixelRect intersect(PixelRect a, PixelRect b) noexcept {
    return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1),
            std::min(a.y1, b.y1)};
}

/// All that drawing needs. Corners run clockwise as seen on the raster (y down).
struct PreparedTriangle {
    std::int32_t x[3], y[3];
    /// Pixels whose centres lie in the corners' bounding box and in the window: not
    /// empty.
    std::uint16_t x0, y0, x1, y1;
    /// On the plane, q = at + dx * (x - x0) + dy * (y - y0) at the centre of pixel (x,
    /// y); q is 1/z for a perspective projection and z for an orthographic one.
    double at, dx, dy;
    float zMin, zMax;
    std::uint32_t surface;  ///< a number of the caller's
    bool small;  ///< reaches over 8 x 8 pixels at most, those outside the window counted

    [[nodiscard]] PixelRect pixels() const noexcept { return {x0, y0, x1, y1}; }
};

class TriangleSetup {
  public:
    /// Sides are 1..kMaxResolution.
    TriangleSetup(const Projection& projection, std::uint32_t width, std::uint32_t height,
                  Facing keep) noexcept;

    [[nodiscard]] Vertex vertex(glm::dvec3 light) const noexcept;

    /// Appends the triangle to `out` (in several pieces if it had to be cut, not at all
    /// if it covers no pixel centre) and counts what it was. `mirrored`: its winding is
    /// that of an object space that the world sees in a mirror. `origin2`: see
    /// TriangleNormal.
    void triangle(const Vertex& a, const Vertex& b, const Vertex& c, bool mirrored,
                  double origin2, std::uint32_t surface, TriangleCounts& counts,
                  std::vector<PreparedTriangle>& out) const;

  private:
    struct Plane;
    [[nodiscard]] Vertex projected(glm::dvec3 light) const noexcept;
    void cut(const Vertex (&corners)[3], const Plane& plane, std::uint32_t surface,
             TriangleCounts& counts, std::vector<PreparedTriangle>& out) const;
    void emit(const Vertex& a, const Vertex& b, const Vertex& c, const Plane& plane,
              std::uint32_t surface, std::vector<PreparedTriangle>& out) const;
    [[nodiscard]] bool missesWindow(const Vertex* corners,
                                    std::size_t count) const noexcept;

    bool perspective_;
    Facing keep_;
    glm::dvec2 scale_, offset_, worldPerPixel_;
    double near_, far_;
    glm::dvec2 guardMin_, guardMax_;  ///< vertices within need no guard band
    ClipPlane guard_[4];
    std::int32_t width_, height_;
};

/// Calls draw(tx, ty, part) for the parts of `pixels` that lie in one tile each, of
/// 2^shift pixels a side.
template <typename Draw>
void forEachTile(PixelRect pixels, std::uint32_t shift, const Draw& draw) {
    const std::int32_t side = 1 << shift;
    for (std::int32_t ty = pixels.y0 >> shift; ty <= pixels.y1 >> shift; ++ty) {
        for (std::int32_t tx = pixels.x0 >> shift; tx <= pixels.x1 >> shift; ++tx) {
            const std::int32_t left = tx * side, top = ty * side;
            draw(std::uint32_t(tx), std::uint32_t(ty),
                 intersect(pixels, {left, top, left + side - 1, top + side - 1}));
        }
    }
}

namespace detail {

/// The three edge functions at one pixel centre: all >= 0 where it is covered. Ties are
/// already decided: an edge that is neither top nor left is lowered by one. From one
/// pixel to the next a value changes by a multiple of the grid, so the grid's bits are
/// shifted out without changing any sign.
struct Edges {
    std::int64_t value[3];
    std::int32_t stepX[3], stepY[3];

    Edges(const PreparedTriangle& t, std::int32_t pixelX, std::int32_t pixelY) noexcept {
        const std::int32_t px = pixelX * kSubpixels + kSubpixels / 2;
        const std::int32_t py = pixelY * kSubpixels + kSubpixels / 2;
        for (int i = 0; i < 3; ++i) {
            const int j = i == 2 ? 0 : i + 1;
            const std::int32_t dx = t.x[j] - t.x[i], dy = t.y[j] - t.y[i];
            const bool topLeft = dy < 0 || (dy == 0 && dx > 0);
            const std::int64_t e =
                std::int64_t(dx) * (py - t.y[i]) - std::int64_t(dy) * (px - t.x[i]);
            value[i] = (e - (topLeft ? 0 : 1)) >> kSubpixelBits;
            stepX[i] = -dy;
            stepY[i] = dx;
        }
    }

    /// Of the w x h pixels, 8 x 8 at most, that end at this one: bit 8 y + x is set where
    /// pixel (x, y) is covered. Only for small triangles, whose values fit 32 bits.
    [[nodiscard]] std::uint64_t mask(std::int32_t w, std::int32_t h) const noexcept {
        std::int32_t rowA = std::int32_t(value[0]), rowB = std::int32_t(value[1]),
                     rowC = std::int32_t(value[2]);
        std::uint64_t covered = 0;
        for (std::int32_t y = h; y-- > 0;) {
            std::int32_t a = rowA, b = rowB, c = rowC;
            std::uint32_t outside = 0;
            for (std::int32_t x = w; x-- > 0;) {
                outside = 2 * outside + (std::uint32_t(a | b | c) >> 31);
                a -= stepX[0];
                b -= stepX[1];
                c -= stepX[2];
            }
            covered = covered << 8 | (~outside & ((1u << w) - 1));
            rowA -= stepY[0];
            rowB -= stepY[1];
            rowC -= stepY[2];
        }
        return covered;
    }

    /// True if one edge has all of a rectangle, w x h pixels from here, outside.
    [[nodiscard]] bool miss(std::int64_t w, std::int64_t h) const noexcept {
        for (int i = 0; i < 3; ++i) {
            const std::int64_t right = std::max<std::int64_t>(0, stepX[i] * (w - 1));
            const std::int64_t down = std::max<std::int64_t>(0, stepY[i] * (h - 1));
            if (value[i] + right + down < 0) return true;
        }
        return false;
    }

    /// Narrows [first, last] to the pixels of this row, numbered from here, that are
    /// covered.
    void span(std::int64_t& first, std::int64_t& last) const noexcept {
        for (int i = 0; i < 3; ++i) {
            const std::int64_t e = value[i], step = stepX[i];
            if (step > 0) {
                if (e < 0) first = std::max(first, (step - 1 - e) / step);
            } else if (e < 0) {
                last = -1;
            } else if (step < 0) {
                last = std::min(last, e / -step);
            }
        }
    }

    void down() noexcept {
        for (int i = 0; i < 3; ++i)
            value[i] += stepY[i];
    }
};

}  // namespace detail

/// Calls sink(x, y, z) for each pixel of `within` whose centre the triangle covers.
/// `kind` is that of the projection it was prepared for.
template <ProjectionKind kind, typename Sink>
inline void drawTriangle(const PreparedTriangle& t, PixelRect within, Sink&& sink) {
    const PixelRect r = intersect(t.pixels(), within);
    if (r.empty()) return;
    const double zMin = t.zMin, zMax = t.zMax;
    const auto sample = [&](std::int32_t x, std::int32_t y) {
        const double q = t.at + t.dx * (x - t.x0) + t.dy * (y - t.y0);
        double z = q;
        if constexpr (kind == ProjectionKind::perspective)
            z = q > 0.0 ? 1.0 / q : zMax;  // else the plane runs past the ray
        z = z < zMin ? zMin : z;
        sink(x, y, float(z > zMax ? zMax : z));
    };
    const std::int32_t w = r.x1 - r.x0 + 1, h = r.y1 - r.y0 + 1;
    if (t.small) {
        // All pixels are tested, without a branch each, and then the covered ones are
        // visited. Most triangles of a dense mesh end here.
        std::uint64_t covered = detail::Edges(t, r.x1, r.y1).mask(w, h);
        for (; covered; covered &= covered - 1) {
            const auto bit = std::int32_t(std::countr_zero(covered));
            sample(r.x0 + (bit & 7), r.y0 + (bit >> 3));
        }
        return;
    }
    detail::Edges edges(t, r.x0, r.y0);
    if (edges.miss(w, h)) return;
    for (std::int32_t y = r.y0; y <= r.y1; ++y, edges.down()) {
        std::int64_t first = 0, last = w - 1;
        edges.span(first, last);
        for (std::int64_t i = first; i <= last; ++i)
            sample(r.x0 + std::int32_t(i), y);
    }
}

}  // namespace mtsm::raster
