// Strand setup: points to light space, cut by near and far, offset on the raster.
#include "raster/strand_setup.h"

#include <algorithm>
#include <cmath>

#include "raster/triangle.h"

namespace mtsm::raster {
namespace {

/// Segments shorter than this, in pixels, have no direction: rounding would decide it.
constexpr double kShortest = 1e-8;
/// Half of a strand's width, pixels: it covers the window from anywhere in the guard
/// band.
constexpr double kWidest = 65536.0;
/// A mitre is at most twice as long as the strand is wide: cos(120 degrees).
constexpr double kMitreCosine = -0.5;
/// Most pieces that a segment is cut into because it runs along the view ray.
constexpr double kMostSteepPieces = 256.0;

bool usable(double x) {
    return std::abs(x) < kLargestCoordinate;  // false for NaN
}

glm::dvec2 mix(glm::dvec2 a, glm::dvec2 b, double t) {
    return a + t * (b - a);
}

}  // namespace

/// What has happened to the strand so far.
struct StrandSetup::Fate {
    bool cut = false;         // by near or far
    bool reachesOut = false;  // some of it lies outside the window
    bool inWindow = false;    // some of it lies inside
};

struct StrandSetup::Output {
    std::vector<PreparedSegment>& segments;
    std::uint32_t strand;
    std::uint32_t order = 0;
    Fate fate;
};

StrandSetup::StrandSetup(const Projection& projection, const SampleGrid& grid) noexcept
    : perspective_(projection.kind == ProjectionKind::perspective),
      scale_(projection.scale),
      offset_(projection.offset),
      near_(std::max(projection.near, kSmallestDepth)),
      far_(projection.far),
      finestScale_(std::max(std::abs(scale_.x), std::abs(scale_.y))),
      width_(grid.width()),
      height_(grid.height()),
      firstRow_(grid.firstPixelRow()),
      endRow_(grid.endPixelRow()) {
    // Distances from the guard band's sides, linear in light space: see triangle.cpp.
    const auto side = [&](glm::dvec2 axis, double constant) {
        return perspective_ ? ClipPlane{{axis.x, axis.y, constant}, 0.0}
                            : ClipPlane{{axis.x, axis.y, 0.0}, constant};
    };
    guard_[0] = side({scale_.x, 0}, offset_.x + kGuardPixels);
    guard_[1] = side({-scale_.x, 0}, kGuardPixels + width_ - offset_.x);
    guard_[2] = side({0, scale_.y}, offset_.y + kGuardPixels);
    guard_[3] = side({0, -scale_.y}, kGuardPixels + height_ - offset_.y);
}

StrandSetup::Vertex StrandSetup::project(const Scratch::Point& p) const noexcept {
    const double w = perspective_ ? 1.0 / p.light.z : 1.0;
    return {scale_ * glm::dvec2(p.light.x, p.light.y) * w + offset_,
            perspective_ ? w : p.light.z, p.halfWidth, p.opacity};
}

bool StrandSetup::farOff(glm::dvec2 r) const noexcept {
    return !(r.x >= -kGuardPixels && r.x <= width_ + kGuardPixels &&
             r.y >= -kGuardPixels && r.y <= height_ + kGuardPixels);
}

/// Cuts the segment by near and far, and by the guard band if it may leave that. False:
/// nothing is left.
bool StrandSetup::cut(Scratch::Point& a, Scratch::Point& b, Fate& fate) const {
    double t0 = 0.0, t1 = 1.0;
    const auto keepInside = [&](double da, double db) {
        if (da < 0.0 && db < 0.0) t1 = -1.0;
        if (da < 0.0 && db >= 0.0) t0 = std::max(t0, da / (da - db));
        if (da >= 0.0 && db < 0.0) t1 = std::min(t1, da / (da - db));
        return t0 < t1;
    };
    const Scratch::Point from = a, to = b;
    const auto at = [&](double t) {
        const double u = 1.0 - t;
        return Scratch::Point{u * from.light + t * to.light,
                              u * from.halfWidth + t * to.halfWidth,
                              float(u * from.opacity + t * to.opacity)};
    };
    const auto inDepth = [&](double z) { return z >= near_ && z <= far_; };
    if (!inDepth(a.light.z) || !inDepth(b.light.z)) {
        fate.cut = true;
        if (!keepInside(a.light.z - near_, b.light.z - near_)) return false;
        if (!keepInside(far_ - a.light.z, far_ - b.light.z)) return false;
    }
    for (const ClipPlane& plane : guard_) {
        const double da = plane.distance(at(t0).light), db = plane.distance(at(t1).light);
        if (da >= 0.0 && db >= 0.0) continue;
        fate.reachesOut = true;
        if (!keepInside(plane.distance(from.light), plane.distance(to.light)))
            return false;
    }
    a = at(t0);
    b = at(t1);
    for (Scratch::Point* p : {&a, &b})
        p->light.z = std::clamp(p->light.z, near_, far_);
    return true;
}

/// Half of the strand's width at a vertex, across a segment with this normal, in pixels.
/// The plane through the eye and the segment has a unit normal n; a point half a width
/// off it, along n, lies that far off the segment's line on the raster, to first order in
/// width over depth. With the line's distance d from where the axis meets the raster,
/// n is (scale.x normal.x, scale.y normal.y, -d) but for its length.
double StrandSetup::halfPixels(glm::dvec2 normal, const Vertex& v) const noexcept {
    const glm::dvec2 stretched = normal * scale_;
    const double across = glm::dot(stretched, stretched);
    if (!perspective_) return v.halfWidth * std::sqrt(across);
    const double d = glm::dot(normal, v.raster - offset_);
    return v.halfWidth * v.q * std::sqrt(across + d * d);
}

void StrandSetup::link(const Vertex& a, const Vertex& b,
                       std::vector<Segment>& chain) const {
    const glm::dvec2 along = b.raster - a.raster;
    const double length = std::sqrt(glm::dot(along, along));
    if (!(length >= kShortest)) return;
    const glm::dvec2 normal(-along.y / length, along.x / length);
    const auto half = [&](const Vertex& v) {
        return std::min(halfPixels(normal, v), kWidest);
    };
    chain.push_back({{a, b}, normal, {half(a), half(b)}, length});
}

void StrandSetup::strand(const StrandsView& view, std::size_t s,
                         const LightFromObject& toLight, double widthScale,
                         std::uint32_t serial, Scratch& scratch, StrandCounts& counts,
                         std::vector<PreparedSegment>& out) const {
    const std::size_t first = view.begin[s], end = view.begin[s + 1];
    ++counts.strands;
    if (end - first < 2) {
        ++counts.transparent;
        return;
    }
    counts.segments += end - first - 1;
    auto& points = scratch.points;
    points.clear();
    bool wide = false, dense = false;
    for (std::size_t i = first; i < end; ++i) {
        const double width = view.widths ? view.widths[i] : view.width;
        const float opacity = view.opacities ? view.opacities[i] : view.opacity;
        const glm::dvec3 p = toLight(view.points[i]);
        if (!(usable(p.x) && usable(p.y) && usable(p.z) && width >= 0.0 &&
              usable(width * widthScale) && opacity >= 0.0f && opacity <= 1.0f)) {
            ++counts.nonFinite;
            return;
        }
        wide = wide || width > 0.0;
        dense = dense || opacity > 0.0f;
        points.push_back({p, 0.5 * width * widthScale, opacity});
    }
    if (!wide || !dense) {
        ++counts.transparent;
        return;
    }

    Output output{out, serial, 0, {}};
    auto& chain = scratch.chain;
    chain.clear();
    const auto usableAsIs = [&](const Scratch::Point& p, Vertex& v) {
        if (!(p.light.z >= near_ && p.light.z <= far_)) return false;
        v = project(p);
        return !farOff(v.raster);
    };
    Vertex a{}, b{};
    bool aGood = usableAsIs(points[0], a);
    for (std::size_t i = 1; i < points.size(); ++i, a = b) {
        const bool bGood = usableAsIs(points[i], b);
        if (aGood && bGood) {
            link(a, b, chain);
            continue;
        }
        // The strand enters, leaves, or passes: the chain ends at the cut.
        Scratch::Point from = points[i - 1], to = points[i];
        const bool kept = cut(from, to, output.fate);
        if (!aGood) {
            emitChain(chain, output);
            chain.clear();
        }
        if (kept) link(project(from), project(to), chain);
        if (!bGood) {
            emitChain(chain, output);
            chain.clear();
        }
        aGood = bGood;
    }
    emitChain(chain, output);

    const Fate& fate = output.fate;
    if (!fate.inWindow)
        ++counts.outside;
    else if (fate.cut || fate.reachesOut)
        ++counts.clipped;
    counts.leavesWindow += fate.reachesOut;
}

/// Segments that join one another: sides meet in mitres.
void StrandSetup::emitChain(const std::vector<Segment>& chain, Output& out) const {
    glm::dvec2 side0{};
    bool joined = false;
    for (std::size_t i = 0; i < chain.size(); ++i) {
        const Segment& s = chain[i];
        if (!joined) side0 = s.half[0] * s.normal;
        glm::dvec2 side1 = s.half[1] * s.normal, next{};
        joined = false;
        if (i + 1 < chain.size()) {
            const Segment& n = chain[i + 1];
            const double cosine = glm::dot(s.normal, n.normal);
            joined = cosine > kMitreCosine;
            if (joined) {
                const double half = 0.5 * (s.half[1] + n.half[0]);
                side1 = next = (half / (1.0 + cosine)) * (s.normal + n.normal);
            }
        }
        emit(s, side0, side1, out);
        side0 = next;
    }
    out.order += 2;  // what comes next does not join
}

/// How many pieces a share of the segment is cut into.
double StrandSetup::pieces(const Segment& s, double share) const noexcept {
    const double length = s.length * share;
    const double q0 = s.end[0].q, q1 = s.end[1].q;
    const double footprints = share * finestScale_ * std::abs(q1 - q0) /
                              (perspective_ ? std::min(q0, q1) : 1.0);
    const double count = std::max(1.0, std::ceil(length / kPieceLength));
    if (footprints <= kRunFootprints * std::max(1.0, length)) return count;
    // Within a pixel it is deeper than a run may be.
    const double steep = std::ceil(footprints / (0.5 * kRunFootprints));
    return std::max(count, std::min(kMostSteepPieces, steep));
}

void StrandSetup::emit(const Segment& s, glm::dvec2 side0, glm::dvec2 side1,
                       Output& out) const {
    // Only what comes near the window; the middle line must pass it within this.
    const glm::dvec2 margin = glm::max(glm::abs(side0), glm::abs(side1)) + 1.0;
    const glm::dvec2 from = s.end[0].raster, to = s.end[1].raster;
    const glm::dvec2 low = -margin, high = glm::dvec2(width_, height_) + margin;
    double t0 = 0.0, t1 = 1.0;
    for (int axis = 0; axis < 2; ++axis) {
        const double d = to[axis] - from[axis];
        if (std::min(from[axis], to[axis]) >= low[axis] &&
            std::max(from[axis], to[axis]) <= high[axis])
            continue;
        const double ta = (low[axis] - from[axis]) / d,
                     tb = (high[axis] - from[axis]) / d;
        if (d == 0.0) {
            t1 = -1.0;
        } else {
            t0 = std::max(t0, std::min(ta, tb));
            t1 = std::min(t1, std::max(ta, tb));
        }
    }
    if (t0 > 0.0 || t1 < 1.0) out.fate.reachesOut = true;
    if (!(t0 < t1)) {
        ++out.order;
        return;
    }
    const double count = pieces(s, t1 - t0), step = (t1 - t0) / count;
    for (double i = 0.0; i < count; ++i)
        emitPiece(s, side0, side1, t0 + i * step,
                  i + 1.0 < count ? t0 + (i + 1.0) * step : t1, out);
}

void StrandSetup::emitPiece(const Segment& s, glm::dvec2 side0, glm::dvec2 side1,
                            double t0, double t1, Output& out) const {
    const glm::dvec2 r0 = s.end[0].raster, r1 = s.end[1].raster;
    const glm::dvec2 a = t0 == 0.0 ? r0 : mix(r0, r1, t0);
    const glm::dvec2 b = t1 == 1.0 ? r1 : mix(r0, r1, t1);
    const glm::dvec2 sideA = mix(side0, side1, t0), sideB = mix(side0, side1, t1);
    const glm::dvec2 low = glm::min(a - glm::abs(sideA), b - glm::abs(sideB));
    const glm::dvec2 high = glm::max(a + glm::abs(sideA), b + glm::abs(sideB));
    const std::uint32_t order = out.order++;
    if (low.x < 0.0 || low.y < 0.0 || high.x > width_ || high.y > height_)
        out.fate.reachesOut = true;
    if (!(low.x < width_ && low.y < height_ && high.x > 0.0 && high.y > 0.0)) return;
    out.fate.inWindow = true;

    // The corner must not depend on the rows held, or rounding would.
    const double x0 = std::floor(std::max(low.x, 0.0));
    const double y0 = std::floor(std::max(low.y, 0.0));
    const double x1 = std::min(std::floor(high.x), width_ - 1.0);
    const double y1 = std::min(std::floor(high.y), height_ - 1.0);
    if (y1 < firstRow_ || y0 >= endRow_) return;
    const auto between = [](double from, double to, double t) {
        return float((1.0 - t) * from + t * to);
    };
    const Vertex &v0 = s.end[0], &v1 = s.end[1];
    PreparedSegment& p = out.segments.emplace_back();
    p.x[0] = float(a.x - x0), p.x[1] = float(b.x - x0);
    p.y[0] = float(a.y - y0), p.y[1] = float(b.y - y0);
    p.sideX[0] = float(sideA.x), p.sideX[1] = float(sideB.x);
    p.sideY[0] = float(sideA.y), p.sideY[1] = float(sideB.y);
    p.q[0] = between(v0.q, v1.q, t0), p.q[1] = between(v0.q, v1.q, t1);
    // As a share of the raster's length: opacity is linear there, too.
    p.opacity[0] = between(v0.opacity, v1.opacity, t0);
    p.opacity[1] = between(v0.opacity, v1.opacity, t1);
    p.strand = out.strand;
    p.order = order;
    p.x0 = std::uint16_t(x0), p.x1 = std::uint16_t(x1);
    p.y0 = std::uint16_t(y0), p.y1 = std::uint16_t(y1);
}

}  // namespace mtsm::raster
