// Triangle setup: corners to raster space, what is left out, the plane that gives depth.
#include "raster/triangle.h"

namespace mtsm::raster {
namespace {

enum VertexFlag : std::uint32_t {
    kBeforeNear = 1,
    kBehindFar = 2,
    kOffLeft = 4,
    kOffRight = 8,
    kOffTop = 16,
    kOffBottom = 32,
    kFarOff = 64,  ///< may lie beyond the guard band
    kNotFinite = 128
};
constexpr std::uint32_t kOffWindow = kOffLeft | kOffRight | kOffTop | kOffBottom;

bool usable(double x) {
    return std::abs(x) < kLargestCoordinate;  // false for NaN
}

/// Rounds half up, like floor(v + 0.5), for |v| < 2^31.
std::int32_t snap(double pixels) {
    constexpr double kOffset = 0x1p31;
    const double steps = pixels * kSubpixels;
    return std::int32_t(std::int64_t(steps + (kOffset + 0.5)) - std::int64_t(kOffset));
}

/// The first pixel centre at or behind a coordinate, and the last one at or before it.
std::int32_t firstCentre(std::int32_t v) {
    return (v + (kSubpixels / 2 - 1)) >> kSubpixelBits;
}
std::int32_t lastCentre(std::int32_t v) {
    return (v - kSubpixels / 2) >> kSubpixelBits;
}

/// In grid steps; positive where the corners run clockwise (y down).
std::int64_t doubleArea(const Vertex& a, const Vertex& b, const Vertex& c) {
    return std::int64_t(b.x - a.x) * (c.y - a.y) - std::int64_t(b.y - a.y) * (c.x - a.x);
}

}  // namespace

void TriangleCounts::add(const TriangleCounts& other) noexcept {
    nonFinite += other.nonFinite;
    degenerate += other.degenerate;
    culled += other.culled;
    outside += other.outside;
    behind += other.behind;
    clipped += other.clipped;
    leavesWindow += other.leavesWindow;
}

/// How depth changes across the raster; edgeOn: the plane holds the centre rays.
struct TriangleSetup::Plane {
    double dx, dy;
    bool edgeOn;
};

TriangleSetup::TriangleSetup(const Projection& projection, std::uint32_t width,
                             std::uint32_t height, Facing keep) noexcept
    : perspective_(projection.kind == ProjectionKind::perspective),
      keep_(keep),
      scale_(projection.scale),
      offset_(projection.offset),
      worldPerPixel_(1.0 / projection.scale),
      near_(perspective_ ? std::max(projection.near, kSmallestDepth) : projection.near),
      far_(projection.far),
      width_(std::int32_t(width)),
      height_(std::int32_t(height)) {
    // Distances from the guard band's sides are linear in light space:
    // scale * x / z + offset >= g becomes scale * x + (offset - g) * z >= 0.
    const glm::dvec2 low(-kGuardPixels),
        high(kGuardPixels + width, kGuardPixels + height);
    const auto side = [&](glm::dvec2 axis, double scale, double constant) {
        const glm::dvec2 xy = axis * scale;
        return perspective_ ? ClipPlane{{xy.x, xy.y, constant}, 0.0}
                            : ClipPlane{{xy.x, xy.y, 0.0}, constant};
    };
    guard_[0] = side({1, 0}, scale_.x, offset_.x - low.x);
    guard_[1] = side({1, 0}, -scale_.x, high.x - offset_.x);
    guard_[2] = side({0, 1}, scale_.y, offset_.y - low.y);
    guard_[3] = side({0, 1}, -scale_.y, high.y - offset_.y);
    // Half of the band, so that rounding cannot make a vertex within it need the cut.
    guardMin_ = 0.5 * low;
    guardMax_ = high - 0.5 * glm::dvec2(kGuardPixels);
}

Vertex TriangleSetup::vertex(glm::dvec3 light) const noexcept {
    Vertex v;
    v.light = light;
    v.light2 = glm::dot(light, light);
    if (!(usable(light.x) && usable(light.y) && usable(light.z))) {
        v.flags = kNotFinite;
        return v;
    }
    if (light.z < near_ || light.z > far_) {
        v.flags = light.z < near_ ? kBeforeNear : kBehindFar;
        return v;
    }
    v = projected(light);
    v.light2 = glm::dot(light, light);
    return v;
}

/// A corner that is known to be usable: one between near and far, or made by a cut.
Vertex TriangleSetup::projected(glm::dvec3 light) const noexcept {
    Vertex v;
    v.light = light;
    const double w = perspective_ ? 1.0 / light.z : 1.0;
    v.raster = scale_ * glm::dvec2(light.x, light.y) * w + offset_;
    if (v.raster.x < 0.0) v.flags |= kOffLeft;
    if (v.raster.x > width_) v.flags |= kOffRight;
    if (v.raster.y < 0.0) v.flags |= kOffTop;
    if (v.raster.y > height_) v.flags |= kOffBottom;
    // Clamped only where a corner made by the cut is off by a rounding.
    const glm::dvec2 r =
        glm::dvec2(std::clamp(v.raster.x, -kGuardPixels, kGuardPixels + width_),
                   std::clamp(v.raster.y, -kGuardPixels, kGuardPixels + height_));
    v.x = snap(r.x);
    v.y = snap(r.y);
    if (v.flags && !(r.x >= guardMin_.x && r.x <= guardMax_.x && r.y >= guardMin_.y &&
                     r.y <= guardMax_.y))
        v.flags |= kFarOff;
    return v;
}

void TriangleSetup::triangle(const Vertex& a, const Vertex& b, const Vertex& c,
                             bool mirrored, double origin2, std::uint32_t surface,
                             TriangleCounts& counts,
                             std::vector<PreparedTriangle>& out) const {
    const std::uint32_t flags = a.flags | b.flags | c.flags;
    if (flags & kNotFinite) {
        ++counts.nonFinite;
        return;
    }
    const TriangleNormal area(a.light, b.light, c.light,
                              std::max({a.light2, b.light2, c.light2}), origin2);
    if (!area.hasArea) {
        ++counts.degenerate;
        return;
    }
    // Light space is left-handed: a normal computed there points away from the side where
    // the corners run counter-clockwise. That side is seen if the eye lies before it.
    const glm::dvec3 n = area.normal;
    const double toPlane = perspective_ ? glm::dot(n, a.light) : n.z;
    if (keep_ != Facing::any && toPlane != 0.0) {
        const bool front = (toPlane > 0.0) != mirrored;
        if (front != (keep_ == Facing::front)) {
            ++counts.culled;
            return;
        }
    }
    // On the plane, dot(n, p) = toPlane; with p = z * (x / z, y / z, 1) that makes 1/z
    // linear in the raster, and without the division by z, z itself.
    const double unit = (perspective_ ? 1.0 : -1.0) / toPlane;
    Plane plane{n.x * unit * worldPerPixel_.x, n.y * unit * worldPerPixel_.y, false};
    plane.edgeOn = !(std::abs(plane.dx) + std::abs(plane.dy) < 1e100);
    if (flags == 0) {
        emit(a, b, c, plane, surface, out);
    } else {
        const Vertex corners[3] = {a, b, c};
        cut(corners, plane, surface, counts, out);
    }
}

/// A triangle that is not wholly between near and far and inside the window.
void TriangleSetup::cut(const Vertex (&corners)[3], const Plane& plane,
                        std::uint32_t surface, TriangleCounts& counts,
                        std::vector<PreparedTriangle>& out) const {
    const std::uint32_t any = corners[0].flags | corners[1].flags | corners[2].flags;
    const std::uint32_t all = corners[0].flags & corners[1].flags & corners[2].flags;
    if (all & (kBeforeNear | kBehindFar)) {
        ++counts.outside;
        counts.behind += (all & kBeforeNear) != 0;
        return;
    }
    const bool cutDepth = any & (kBeforeNear | kBehindFar);
    Vertex v[Polygon::kMaxCorners];
    std::size_t size = 3;
    std::copy(corners, corners + 3, v);
    std::uint32_t flags = any;
    if (cutDepth || (any & kFarOff)) {
        Polygon polygon;
        for (const Vertex& corner : corners)
            polygon.add(corner.light);
        if (cutDepth) polygon = clipDepth(polygon, near_, far_);
        flags = 0;
        for (std::size_t i = 0; i < polygon.size; ++i)
            flags |= projected(polygon.corner[i]).flags;
        for (const ClipPlane& side : guard_) {
            if (flags & kFarOff) polygon = clip(polygon, side);
        }
        size = polygon.size;
        for (std::size_t i = 0; i < size; ++i)
            v[i] = projected(polygon.corner[i]);
    }
    const bool leaves = flags & kOffWindow;
    counts.leavesWindow += leaves;
    if (size < 3 || (leaves && missesWindow(v, size))) {
        ++counts.outside;
        return;
    }
    ++counts.clipped;
    for (std::size_t i = 2; i < size; ++i)
        emit(v[0], v[i - 1], v[i], plane, surface, out);
}

/// True if no point of the convex polygon lies in the window: a side of the window, or an
/// edge of the polygon, has all of the other on its far side.
bool TriangleSetup::missesWindow(const Vertex* corners,
                                 std::size_t count) const noexcept {
    std::uint32_t all = kOffWindow;
    std::int64_t area = 0;
    for (std::size_t i = 0; i < count; ++i) {
        all &= corners[i].flags;
        if (i >= 2) area += doubleArea(corners[0], corners[i - 1], corners[i]);
    }
    if (all) return true;
    const std::int64_t right = std::int64_t(width_) * kSubpixels;
    const std::int64_t bottom = std::int64_t(height_) * kSubpixels;
    for (std::size_t i = 0; i < count; ++i) {
        const Vertex &a = corners[i], &b = corners[i + 1 == count ? 0 : i + 1];
        const std::int64_t dx = (area < 0 ? -1 : 1) * (std::int64_t(b.x) - a.x);
        const std::int64_t dy = (area < 0 ? -1 : 1) * (std::int64_t(b.y) - a.y);
        const auto side = [&](std::int64_t x, std::int64_t y) {
            return dx * (y - a.y) - dy * (x - a.x);
        };
        if (std::max({side(0, 0), side(right, 0), side(0, bottom), side(right, bottom)}) <
            0)
            return true;
    }
    return false;
}

void TriangleSetup::emit(const Vertex& a, const Vertex& b, const Vertex& c,
                         const Plane& plane, std::uint32_t surface,
                         std::vector<PreparedTriangle>& out) const {
    const auto least = [](auto x, auto y, auto z) { return std::min(std::min(x, y), z); };
    const auto most = [](auto x, auto y, auto z) { return std::max(std::max(x, y), z); };
    const std::int32_t left = least(a.x, b.x, c.x), right = most(a.x, b.x, c.x);
    const std::int32_t top = least(a.y, b.y, c.y), bottom = most(a.y, b.y, c.y);
    const PixelRect pixels{std::max(firstCentre(left), 0), std::max(firstCentre(top), 0),
                           std::min(lastCentre(right), width_ - 1),
                           std::min(lastCentre(bottom), height_ - 1)};
    const std::int64_t area = doubleArea(a, b, c);
    if (pixels.empty() || area == 0 || plane.edgeOn) return;

    // The plane is exact at corner a.
    const double toX = pixels.x0 + 0.5 - a.raster.x, toY = pixels.y0 + 0.5 - a.raster.y;
    const Vertex &second = area > 0 ? b : c, &third = area > 0 ? c : b;
    PreparedTriangle& t = out.emplace_back();
    t.x[0] = a.x, t.x[1] = second.x, t.x[2] = third.x;
    t.y[0] = a.y, t.y[1] = second.y, t.y[2] = third.y;
    t.x0 = std::uint16_t(pixels.x0), t.x1 = std::uint16_t(pixels.x1);
    t.y0 = std::uint16_t(pixels.y0), t.y1 = std::uint16_t(pixels.y1);
    t.at = (perspective_ ? 1.0 / a.light.z : a.light.z) + plane.dx * toX + plane.dy * toY;
    t.dx = plane.dx;
    t.dy = plane.dy;
    t.zMin = float(least(a.light.z, b.light.z, c.light.z));
    t.zMax = float(most(a.light.z, b.light.z, c.light.z));
    t.surface = surface;
    t.small = right - left <= 7 * kSubpixels && bottom - top <= 7 * kSubpixels;
}

}  // namespace mtsm::raster
