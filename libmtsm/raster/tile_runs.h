// tile_runs.h - draws the strands of one tile: areas per pixel, added up into runs.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "mtsm/map.h"
#include "raster/sample_grid.h"
#include "raster/strand.h"

namespace mtsm::raster {

/// One thread's; between tiles it holds nothing.
class TileRuns {
  public:
    explicit TileRuns(const Projection& projection);

    /// What follows goes to `tile`.
    void begin(SampleTile& tile, std::uint32_t tx, std::uint32_t ty) noexcept;
    [[nodiscard]] bool touches(const PreparedSegment& p) const noexcept {
        return p.x0 <= right_ && p.x1 >= left_ && p.y0 <= bottom_ && p.y1 >= top_;
    }
    /// Adds the areas of a piece that touches the tile. Pieces of one strand come one
    /// after another, in order.
    void draw(const PreparedSegment& p);
    /// Makes the runs that are open samples.
    void endStrand();

  private:
    /// Sums over a run.
    struct Run {
        double weight = 0.0, q = 0.0;  ///< by area, where that is positive
        float opacity = 0.0f;          ///< the same
        float area = 0.0f;             ///< signed
        float firstQ = 0.0f;
        std::uint32_t order = kClosed;  ///< of the piece that came last
    };
    static constexpr std::uint32_t kClosed = 0xffffffff;

    /// A pixel of the row at work, for its edges: what lies to their right in the pixel,
    /// and how much of the row's height they take.
    struct Cell {
        double area = 0.0, moment = 0.0;   ///< moment: integral of the way over the area
        double cover = 0.0, coverY = 0.0;  ///< sums of heights, and of height times y
    };
    /// How far along the piece a point of the raster is: 0 at its start, 1 at its end.
    struct Way {
        double at = 0.0, dx = 0.0, dy = 0.0;

        [[nodiscard]] double operator()(double x, double y) const noexcept {
            return at + dx * x + dy * y;
        }
    };
    struct Edge {
        double x0, y0, x1, y1;  ///< y0 <= y1
        double sign;            ///< 1 where the inside is to the right, else -1
        double slope;           ///< of x over y

        [[nodiscard]] double xAt(double y) const noexcept {
            const double x = x0 + (y - y0) * slope;
            return std::max(std::min(x0, x1), std::min(std::max(x0, x1), x));
        }
    };
    struct Piece;

    void drawInPixel(const Piece& piece, std::uint32_t pixel);
    void drawRows(const Piece& piece, std::int32_t firstRow, std::int32_t lastRow);
    void addToRow(const Edge& edge);
    void addInside(const Edge& edge);
    void addToCell(std::int32_t x, const Edge& edge);
    void sweepRow(std::uint32_t firstPixel);
    void add(std::uint32_t pixel, double area, double moment);
    void emit(std::uint32_t pixel, const Run& run);

    bool perspective_;
    float runLength_;  ///< kRunFootprints: relative in 1/z, or absolute in z

    SampleTile* tile_ = nullptr;
    std::uint32_t left_ = 0, top_ = 0, right_ = 0, bottom_ = 0;  ///< both ends included
    std::int32_t width_ = 0, height_ = 0;
    std::vector<Run> runs_;            ///< [height][width], all closed between strands
    std::vector<std::uint32_t> open_;  ///< pixels that the strand has touched

    const PreparedSegment* segment_ = nullptr;  ///< the one at work
    Way way_;
    std::vector<Cell> cells_;                     ///< [width], of the row at work
    std::int32_t firstCell_ = 0, lastCell_ = -1;  ///< those in use
};

}  // namespace mtsm::raster
