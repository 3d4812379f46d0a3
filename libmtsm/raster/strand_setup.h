// strand_setup.h - a strand's points to the pieces of its ribbon on the raster.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/scene.h"
#include "raster/clip.h"
#include "raster/light_from_object.h"
#include "raster/strand.h"

namespace mtsm::raster {

/// Longest piece of a segment, pixels: about a tile, so that a long slanted segment goes
/// to the bins along its way only.
inline constexpr double kPieceLength = 64.0;

class StrandSetup {
  public:
    /// For the rows that `grid` holds now.
    StrandSetup(const Projection& projection, const SampleGrid& grid) noexcept;

    /// Room that strand() works in.
    struct Scratch {
        struct Point {
            glm::dvec3 light;
            double halfWidth;  // world
            float opacity;
        };
        struct Vertex {
            glm::dvec2 raster;
            double q, halfWidth;
            float opacity;
        };
        /// One that has a length on the raster.
        struct Segment {
            Vertex end[2];
            glm::dvec2 normal;  // unit; across the segment on the raster
            double half[2];     // width at either end, pixels
            double length;      // pixels
        };
        std::vector<Point> points;
        std::vector<Segment> chain;  // segments that join one another
    };

    /// Appends the pieces of strand `s` to `out`, numbered `serial`, and counts it.
    /// `widthScale` is how much widths grow from object to world.
    void strand(const StrandsView& view, std::size_t s, const LightFromObject& toLight,
                double widthScale, std::uint32_t serial, Scratch& scratch,
                StrandCounts& counts, std::vector<PreparedSegment>& out) const;

  private:
    using Vertex = Scratch::Vertex;
    using Segment = Scratch::Segment;
    struct Fate;
    struct Output;

    [[nodiscard]] bool read(const StrandsView& view, std::size_t s,
                            const LightFromObject& toLight, double widthScale,
                            std::vector<Scratch::Point>& points,
                            StrandCounts& counts) const;
    [[nodiscard]] Vertex project(const Scratch::Point& p) const noexcept;
    [[nodiscard]] bool farOff(glm::dvec2 raster) const noexcept;
    [[nodiscard]] bool cut(Scratch::Point& a, Scratch::Point& b, Fate& fate) const;
    [[nodiscard]] double halfPixels(glm::dvec2 normal, const Vertex& v) const noexcept;
    void link(const Vertex& a, const Vertex& b, std::vector<Segment>& chain) const;
    void emitChain(const std::vector<Segment>& chain, Output& out) const;
    void emit(const Segment& s, glm::dvec2 side0, glm::dvec2 side1, Output& out) const;
    void emitPiece(const Segment& s, glm::dvec2 side0, glm::dvec2 side1, double t0,
                   double t1, Output& out) const;
    [[nodiscard]] double pieces(const Segment& s, double share) const noexcept;

    bool perspective_;
    glm::dvec2 scale_, offset_;
    double near_, far_, finestScale_;
    ClipPlane guard_[4];
    double width_, height_;     // of the window, pixels
    double firstRow_, endRow_;  // of pixels, those that are held
};

}  // namespace mtsm::raster
