// Exact areas of quads in pixels, by their edges: each edge accounts for what lies to its
// right, positive on the one side of a quad and negative on the other. That makes areas
// signed, so a quad that folds over, at the inside of a tight bend, takes away again what
// its neighbour has too much.
#include "raster/tile_runs.h"

#include <cmath>

namespace mtsm::raster {
namespace {

/// Areas and opacities below this, of a pixel, are rounding.
constexpr double kNoise = 1e-12;

}  // namespace

/// A segment in the tile's coordinates.
struct TileRuns::Piece {
    double x[2], y[2], sideX[2], sideY[2];

    Piece(const PreparedSegment& p, double fromLeft, double fromTop) noexcept {
        for (int i = 0; i < 2; ++i) {
            x[i] = double(p.x[i]) + fromLeft;
            y[i] = double(p.y[i]) + fromTop;
            sideX[i] = p.sideX[i];
            sideY[i] = p.sideY[i];
        }
    }
    /// All corners lie in this pixel.
    [[nodiscard]] bool within(double left, double top) const noexcept {
        bool in = true;
        for (int i = 0; i < 2; ++i) {
            const double dx = std::abs(sideX[i]), dy = std::abs(sideY[i]);
            in = in && x[i] - dx >= left && x[i] + dx <= left + 1.0 && y[i] - dy >= top &&
                 y[i] + dy <= top + 1.0;
        }
        return in;
    }
};

TileRuns::TileRuns(const Projection& projection)
    : perspective_(projection.kind == ProjectionKind::perspective),
      runs_(std::size_t(SampleGrid::kTileSize) * SampleGrid::kTileSize),
      cells_(SampleGrid::kTileSize) {
    // A footprint is z / scale, or 1 / scale: the larger one, as Projection has it.
    const double scale =
        std::min(std::abs(projection.scale.x), std::abs(projection.scale.y));
    runLength_ = float(kRunFootprints / scale);
}

void TileRuns::begin(SampleTile& tile, std::uint32_t tx, std::uint32_t ty) noexcept {
    tile_ = &tile;
    width_ = std::int32_t(tile.width());
    height_ = std::int32_t(tile.pixels() / tile.width());
    left_ = tx * SampleGrid::kTileSize;
    top_ = ty * SampleGrid::kTileSize;
    right_ = left_ + std::uint32_t(width_) - 1;
    bottom_ = top_ + std::uint32_t(height_) - 1;
}

void TileRuns::draw(const PreparedSegment& p) {
    const std::int32_t fromLeft = std::int32_t(p.x0) - std::int32_t(left_);
    const std::int32_t fromTop = std::int32_t(p.y0) - std::int32_t(top_);
    const Piece piece(p, fromLeft, fromTop);
    const double dx = piece.x[1] - piece.x[0], dy = piece.y[1] - piece.y[0];
    const double length2 = dx * dx + dy * dy;
    if (length2 == 0.0) return;
    segment_ = &p;
    way_.dx = dx / length2;
    way_.dy = dy / length2;
    way_.at = -(piece.x[0] * way_.dx + piece.y[0] * way_.dy);
    if (p.x0 == p.x1 && p.y0 == p.y1 && piece.within(fromLeft, fromTop)) {
        drawInPixel(piece, std::uint32_t(fromTop * width_ + fromLeft));
        return;
    }
    drawRows(piece, std::max(fromTop, 0),
             std::min(std::int32_t(p.y1) - std::int32_t(top_), height_ - 1));
}

/// All of the piece lies in one pixel: two triangles.
void TileRuns::drawInPixel(const Piece& p, std::uint32_t pixel) {
    const double dx = p.x[1] - p.x[0], dy = p.y[1] - p.y[0];
    const auto cross = [](double ax, double ay, double bx, double by) {
        return ax * by - ay * bx;
    };
    // Corners: left 0, left 1, right 1, right 0; how far the lefts are along the way.
    const double lead0 = p.sideX[0] * way_.dx + p.sideY[0] * way_.dy;
    const double lead1 = p.sideX[1] * way_.dx + p.sideY[1] * way_.dy;
    const double area = cross(dx, dy, p.sideX[0] + p.sideX[1], p.sideY[0] + p.sideY[1]);
    // The triangle left 0, left 1, right 1.
    const double ahead = cross(dx - p.sideX[0], dy - p.sideY[0], p.sideX[1], p.sideY[1]);
    add(pixel, area, (ahead * (lead0 + 2.0) + (area - ahead) * (1.0 - lead1)) / 3.0);
}

/// The area to the right of an edge in a pixel, and the integral of the way over it: that
/// along x first, which leaves a quadratic in y.
[[gnu::always_inline]] inline void TileRuns::addToCell(std::int32_t x, const Edge& e) {
    Cell& cell = cells_[std::size_t(x)];
    const double right = x + 1, dy = (e.y1 - e.y0) * e.sign;
    const double a0 = right - e.x0, a1 = right - e.x1, a = a0 + a1, y = e.y0 + e.y1;
    cell.area += dy * 0.5 * a;
    cell.moment +=
        dy * (0.5 * a * (way_.at + way_.dx * right) +
              ((a * y + a0 * e.y0 + a1 * e.y1) * way_.dy - (a * a - a0 * a1) * way_.dx) *
                  (1.0 / 6.0));
    cell.cover += dy;
    cell.coverY += dy * 0.5 * y;
    firstCell_ = std::min(firstCell_, x);
    lastCell_ = std::max(lastCell_, x);
}

/// An edge within a row and the tile (its right side included), pixel by pixel.
void TileRuns::addInside(const Edge& e) {
    const std::int32_t last = std::min(std::int32_t(e.x1), width_ - 1);
    std::int32_t x = std::min(std::int32_t(e.x0), width_ - 1);
    if (x == last) {
        addToCell(x, e);
        return;
    }
    const double rise = (e.y1 - e.y0) / (e.x1 - e.x0);
    const std::int32_t step = last > x ? 1 : -1;
    Edge part = e;
    for (; x != last; x += step) {
        part.x1 = step > 0 ? x + 1 : x;
        part.y1 = std::clamp(e.y0 + (part.x1 - e.x0) * rise, part.y0, e.y1);
        addToCell(x, part);
        part.x0 = part.x1;
        part.y0 = part.y1;
    }
    part.x1 = e.x1;
    part.y1 = e.y1;
    addToCell(last, part);
}

/// An edge within a row of pixels; what lies left or right of the tile is moved to its
/// left side or dropped.
void TileRuns::addToRow(const Edge& e) {
    const double right = width_;
    if (std::min(e.x0, e.x1) >= 0.0 && std::max(e.x0, e.x1) < right) {
        addInside(e);
        return;
    }
    const auto yAt = [&](double x) {
        return std::clamp(e.y0 + (x - e.x0) / e.slope, e.y0, e.y1);
    };
    // Split at the sides, from the upper end to the lower one.
    double cutX[2] = {0.0, right};
    if (e.x1 < e.x0) std::swap(cutX[0], cutX[1]);
    Edge rest = e;
    const auto addPart = [&](double x1, double y1) {
        const double middle = 0.5 * (rest.x0 + x1);
        if (middle >= right) {
            lastCell_ = width_ - 1;
            if (firstCell_ > lastCell_) firstCell_ = lastCell_;
        } else if (middle <= 0.0) {
            addToCell(0, {0.0, rest.y0, 0.0, y1, e.sign, 0.0});
        } else {
            addInside({rest.x0, rest.y0, x1, y1, e.sign, e.slope});
        }
        rest.x0 = x1;
        rest.y0 = y1;
    };
    for (const double x : cutX) {
        if ((x - rest.x0) * (x - e.x1) < 0.0) addPart(x, yAt(x));
    }
    addPart(e.x1, e.y1);
}

void TileRuns::drawRows(const Piece& p, std::int32_t firstRow, std::int32_t lastRow) {
    const double cx[4] = {p.x[0] + p.sideX[0], p.x[1] + p.sideX[1], p.x[1] - p.sideX[1],
                          p.x[0] - p.sideX[0]};
    const double cy[4] = {p.y[0] + p.sideY[0], p.y[1] + p.sideY[1], p.y[1] - p.sideY[1],
                          p.y[0] - p.sideY[0]};
    Edge edges[4];
    int count = 0;
    for (int i = 0; i < 4; ++i) {
        const int j = (i + 1) & 3;
        if (cy[i] == cy[j]) continue;
        const double slope = (cx[j] - cx[i]) / (cy[j] - cy[i]);
        edges[count++] = cy[i] < cy[j] ? Edge{cx[i], cy[i], cx[j], cy[j], 1.0, slope}
                                       : Edge{cx[j], cy[j], cx[i], cy[i], -1.0, slope};
    }
    const double start = way_.at;
    for (std::int32_t row = firstRow; row <= lastRow; ++row) {
        const double top = row, bottom = row + 1;
        way_.at = start + way_.dy * top;  // y counts from the row's top
        firstCell_ = width_;
        lastCell_ = -1;
        for (int i = 0; i < count; ++i) {
            const Edge& e = edges[i];
            if (e.y1 <= top || e.y0 >= bottom) continue;
            const bool starts = e.y0 >= top, ends = e.y1 <= bottom;
            addToRow({starts ? e.x0 : e.xAt(top), starts ? e.y0 - top : 0.0,
                      ends ? e.x1 : e.xAt(bottom), ends ? e.y1 - top : 1.0, e.sign,
                      e.slope});
        }
        sweepRow(std::uint32_t(row * width_));
    }
}

/// Hands over the row's pixels, from left to right, and clears its cells.
void TileRuns::sweepRow(std::uint32_t firstPixel) {
    double cover = 0.0, coverY = 0.0;
    for (std::int32_t x = firstCell_; x <= lastCell_; ++x) {
        Cell& cell = cells_[std::size_t(x)];
        const double area = cell.area + cover;
        const double moment =
            cell.moment + cover * (way_.at + way_.dx * (x + 0.5)) + coverY * way_.dy;
        cover += cell.cover;
        coverY += cell.coverY;
        cell = {};
        add(firstPixel + std::uint32_t(x), area, moment);
    }
}

void TileRuns::add(std::uint32_t pixel, double area, double moment) {
    if (!(std::abs(area) > kNoise)) return;
    // Where corners stick out in a mitre, what lies beyond the ends is taken for the end.
    const PreparedSegment& p = *segment_;
    const auto way = float(std::clamp(moment / area, 0.0, 1.0));
    // Depths may be many orders apart: no difference of them.
    const float q = (1.0f - way) * p.q[0] + way * p.q[1];
    Run& run = runs_[pixel];
    if (run.order == kClosed) {
        open_.push_back(pixel);
        run.firstQ = q;
    } else if (p.order - run.order > 1 ||
               std::abs(q - run.firstQ) > runLength_ * (perspective_ ? q : 1.0f)) {
        emit(pixel, run);
        run = {};
        run.firstQ = q;
    }
    run.order = p.order;
    run.area += float(area);
    if (area < 0.0) return;
    run.weight += area;
    run.q += area * q;
    run.opacity += float(area) * (p.opacity[0] + way * (p.opacity[1] - p.opacity[0]));
}

void TileRuns::emit(std::uint32_t pixel, const Run& run) {
    if (!(run.area > 0.0f)) return;  // folded over
    const float coverage = std::min(run.area, 1.0f);
    const float opacity = std::min(coverage * (run.opacity / float(run.weight)), 1.0f);
    if (!(opacity > float(kNoise))) return;
    const auto z = float(perspective_ ? run.weight / run.q : run.q / run.weight);
    const float channels[3] = {opacity, opacity, opacity};
    tile_->add(pixel, z, channels);
}

void TileRuns::endStrand() {
    for (const std::uint32_t pixel : open_) {
        emit(pixel, runs_[pixel]);
        runs_[pixel] = {};
    }
    open_.clear();
}

}  // namespace mtsm::raster
