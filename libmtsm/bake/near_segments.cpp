#include "bake/near_segments.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <vector>

#include "base/parallel.h"
#include "raster/light_from_object.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {
namespace {

constexpr std::size_t kStrands = 1024;  // of a task
constexpr std::size_t kBatch = 64;      // tasks side by side
/// Half a width is at most this much of the depth.
constexpr double kWidest = 0.5;

bool usable(double x) {
    return std::abs(x) < raster::kLargestCoordinate;  // false for NaN
}

/// A place on a strand's middle line: everything is linear between two, in light space
/// and, with `half` over depth, in straight space too.
struct Place {
    glm::dvec3 at;
    double half;

    [[nodiscard]] Place towards(const Place& to, double t) const {
        return {(1.0 - t) * at + t * to.at, (1.0 - t) * half + t * to.half};
    }
};

/// Cuts away what lies beyond a plane, of whose distances da and db the ends are.
bool keepInside(Place& a, Place& b, double da, double db) {
    if (da < 0.0 && db < 0.0) return false;
    if (da < 0.0) a = a.towards(b, da / (da - db));
    if (db < 0.0) b = b.towards(a, db / (db - da));
    return true;
}

/// One caster's strands to segments.
class Strands {
  public:
    Strands(const StrandsView& view, const Projection& projection, glm::dvec2 window)
        : view_(view),
          toLight_(projection, view.worldFromObject),
          halfScale_(0.5 * std::cbrt(std::abs(
                               glm::determinant(glm::dmat3(view.worldFromObject))))),
          perspective_(projection.kind == ProjectionKind::perspective),
          scale_(projection.scale),
          offset_(projection.offset),
          window_(window),
          near_(perspective_ ? std::max(projection.near, raster::kSmallestDepth)
                             : projection.near),
          far_(projection.far) {}

    void add(std::size_t strand, std::vector<NearSegment>& out) const;

  private:
    [[nodiscard]] double widthAt(std::size_t point) const {
        return view_.widths ? view_.widths[point] : view_.width;
    }
    [[nodiscard]] float opacityAt(std::size_t point) const {
        return view_.opacities ? view_.opacities[point] : view_.opacity;
    }
    [[nodiscard]] bool casts(std::size_t first, std::size_t end) const;
    [[nodiscard]] Place straight(const Place& light) const;
    [[nodiscard]] glm::dvec2 reach(const Place& p) const;
    void addSegment(Place a, Place b, std::uint16_t opacity,
                    std::vector<NearSegment>& out) const;
    [[nodiscard]] bool cutAtWindow(Place& a, Place& b, glm::dvec2 margin) const;

    const StrandsView& view_;
    raster::LightFromObject toLight_;
    double halfScale_;
    bool perspective_;
    glm::dvec2 scale_, offset_, window_;
    double near_, far_;
};

/// As the rasteriser has it.
bool Strands::casts(std::size_t first, std::size_t end) const {
    bool wide = false, dense = false;
    for (std::size_t i = first; i < end; ++i) {
        const glm::dvec3 p = toLight_(view_.points[i]);
        if (!(usable(p.x) && usable(p.y) && usable(p.z) &&
              usable(2.0 * widthAt(i) * halfScale_)))
            return false;
        wide = wide || widthAt(i) > 0.0;
        dense = dense || opacityAt(i) > 0.0f;
    }
    return wide && dense;
}

void Strands::add(std::size_t strand, std::vector<NearSegment>& out) const {
    const std::size_t first = view_.begin[strand], end = view_.begin[strand + 1];
    if (!casts(first, end)) return;
    const auto place = [&](std::size_t i) {
        return Place{toLight_(view_.points[i]), widthAt(i) * halfScale_};
    };
    Place b = place(first);
    for (std::size_t i = first + 1; i < end; ++i) {
        const Place a = b;
        b = place(i);
        const double opacity = 0.5 * (double(opacityAt(i - 1)) + opacityAt(i));
        const auto stored = std::uint16_t(opacity * double(NearHairChunk::kOpaque) + 0.5);
        if (stored > 0 && (a.half > 0.0 || b.half > 0.0) && a.at != b.at)
            addSegment(a, b, stored, out);
    }
}

Place Strands::straight(const Place& light) const {
    if (!perspective_)
        return {glm::dvec3(scale_ * glm::dvec2(light.at) + offset_, -light.at.z),
                light.half};
    const double w = 1.0 / light.at.z;
    return {glm::dvec3(scale_ * glm::dvec2(light.at) * w + offset_, w),
            std::min(light.half * w, kWidest)};
}

/// How far it may reach from its middle line, pixels (NearHair::levels).
glm::dvec2 Strands::reach(const Place& p) const {
    if (!perspective_) return p.half * glm::abs(scale_);
    return 2.0 * p.half * (glm::abs(scale_) + glm::abs(glm::dvec2(p.at) - offset_));
}

void Strands::addSegment(Place a, Place b, std::uint16_t opacity,
                         std::vector<NearSegment>& out) const {
    if (!keepInside(a, b, a.at.z - near_, b.at.z - near_) ||
        !keepInside(a, b, far_ - a.at.z, far_ - b.at.z))
        return;
    a.at.z = std::clamp(a.at.z, near_, far_);
    b.at.z = std::clamp(b.at.z, near_, far_);
    a = straight(a);
    b = straight(b);
    const glm::dvec2 margin = glm::max(reach(a), reach(b));
    const glm::dvec2 low = glm::min(glm::dvec2(a.at), glm::dvec2(b.at));
    const glm::dvec2 high = glm::max(glm::dvec2(a.at), glm::dvec2(b.at));
    if (high.x < -margin.x || high.y < -margin.y || low.x > window_.x + margin.x ||
        low.y > window_.y + margin.y)
        return;
    const auto longest = [&] {
        return std::max(std::abs(a.at.x - b.at.x), std::abs(a.at.y - b.at.y));
    };
    double parts = 1.0;
    if (longest() > kMostPixels) {
        if (!cutAtWindow(a, b, margin + kMargin)) return;
        parts = std::max(1.0, std::ceil(longest() / kMostPixels));
    }
    const Place from = a, to = b;
    for (double i = 0.0; i < parts; ++i) {
        NearSegment& segment = out.emplace_back();
        const Place ends[2] = {from.towards(to, i / parts),
                               from.towards(to, (i + 1.0) / parts)};
        for (int e = 0; e < 2; ++e) {
            for (int axis = 0; axis < 3; ++axis)
                segment.end[e][axis] = float(ends[e].at[axis]);
            segment.half[e] = float(ends[e].half);
        }
        segment.opacity = opacity;
    }
}

bool Strands::cutAtWindow(Place& a, Place& b, glm::dvec2 margin) const {
    for (int axis = 0; axis < 2; ++axis) {
        const double low = -margin[axis], high = window_[axis] + margin[axis];
        if (!keepInside(a, b, a.at[axis] - low, b.at[axis] - low) ||
            !keepInside(a, b, high - a.at[axis], high - b.at[axis]))
            return false;
    }
    return true;
}

}  // namespace

void collectStrands(const StrandsView& view, const Projection& projection,
                    glm::dvec2 window, std::uint64_t most, NearSegments& all) {
    const Strands strands(view, projection, window);
    const std::size_t chunks = (view.strandCount + kStrands - 1) / kStrands;
    std::vector<std::vector<NearSegment>> parts(std::min(chunks, kBatch));
    for (std::size_t batch = 0; batch < chunks; batch += kBatch) {
        const std::size_t tasks = std::min(kBatch, chunks - batch);
        base::parallelFor(std::size_t(0), tasks, [&](std::size_t i) {
            parts[i].clear();
            const std::size_t first = (batch + i) * kStrands;
            const std::size_t end = std::min(first + kStrands, view.strandCount);
            for (std::size_t strand = first; strand < end; ++strand)
                strands.add(strand, parts[i]);
        });
        for (std::size_t i = 0; i < tasks; ++i)
            all.add(parts[i], most);
    }
}

}  // namespace mtsm::bake_detail
