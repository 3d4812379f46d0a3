// The scalar traversal [Xie07, sec. 4.3 and 5.2], to be read beside the paper.
//
// With homogeneous raster coordinates (X, Y, H), X = scale.x x + offset.x H and likewise
// Y, where H = z for a perspective map and H = 1 for an orthographic one, the raster
// position is (X / H, Y / H), and X, Y, H and z are all linear in the ray's parameter t.
// A column boundary u = i is the zero of X - i H, so the t of every crossing comes from
// one division, and the depth there is linear light-space depth: no z is ever taken from
// a projected coordinate (sec. 6.1 asks for that). Neighbouring pixels share the t of
// their boundary, so the depth intervals of a ray's pixels tile its whole range.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "trace/traverse.h"

namespace mtsm::trace {
namespace {

/// a + b t
struct Linear {
    double a = 0.0, b = 0.0;
    [[nodiscard]] double at(double t) const noexcept { return a + b * t; }
};

Linear operator-(Linear f, Linear g) {
    return {f.a - g.a, f.b - g.b};
}
Linear operator*(double s, Linear f) {
    return {s * f.a, s * f.b};
}

struct Interval {
    double begin, end;
    [[nodiscard]] bool empty() const noexcept { return !(begin < end); }
};

/// Keeps the part of the interval where f >= 0.
Interval clip(Interval i, Linear f) noexcept {
    if (f.b > 0.0) {
        i.begin = std::max(i.begin, -f.a / f.b);
    } else if (f.b < 0.0) {
        i.end = std::min(i.end, -f.a / f.b);
    } else if (f.a < 0.0) {
        i.end = i.begin;
    }
    return i;
}

/// Where a ray that starts on one side of a boundary (f < 0: low, f >= 0: high) changes
/// over.
struct Crossing {
    double t;  // clamped into the interval; its end if the ray stays on one side
    bool highFirst;
};

Crossing cross(Interval i, Linear f) noexcept {
    if (f.b == 0.0) return {i.end, f.a >= 0.0};
    const double t = -f.a / f.b;
    const bool rising = f.b > 0.0;
    if (t <= i.begin) return {i.end, rising};
    return {std::min(t, i.end), !rising};
}

class Traversal {
  public:
    Traversal(const ShadowMap& map, std::uint32_t face, const Ray& ray,
              const TraceOptions& options, RayState& state)
        : map_(map), face_(face), options_(options), state_(state) {
        const Projection& p = map.projection(face);
        const glm::dvec3 o = p.lightFromWorld(ray.origin);
        const glm::dvec3 d = p.lightFromWorldDirection(ray.delta);
        z_ = {o.z, d.z};
        h_ = p.kind == ProjectionKind::perspective ? z_ : Linear{1.0, 0.0};
        x_ = {p.scale.x * o.x + p.offset.x * h_.a, p.scale.x * d.x + p.offset.x * h_.b};
        y_ = {p.scale.y * o.y + p.offset.y * h_.a, p.scale.y * d.y + p.offset.y * h_.b};
    }

    /// True if the ray fell to the threshold.
    bool run(Interval t) {
        // Clip by the range of depths that the face holds, and by its window.
        const ZRange range = map_.zRange(face_);
        if (range.empty()) return false;
        // A little wider, so that a face whose layers share one depth leaves an interval;
        // and H stays positive even if the bias reaches behind the eye.
        const double widest = options_.bias.at(range.max);
        const double nearest =
            std::max(range.min * (1.0 - 0x1p-20) - widest, range.min * 0x1p-10);
        const double farthest = range.max * (1.0 + 0x1p-20) + widest;
        t = clip(t, z_ - Linear{nearest, 0.0});
        t = clip(t, Linear{farthest, 0.0} - z_);
        t = clip(t, x_);
        t = clip(t, double(map_.info().width) * h_ - x_);
        t = clip(t, y_);
        t = clip(t, double(map_.info().height) * h_ - y_);
        if (t.empty() || !std::isfinite(t.end)) return false;
        return visit(map_.levels() - 1, 0, 0, t);
    }

  private:
    /// trace(node, ray) of the paper: children are visited in the order in which the ray
    /// meets them, up to three of the four.
    bool visit(std::uint32_t level, std::uint32_t x, std::uint32_t y, Interval t) {
        const double zEnter = z_.at(t.begin), zExit = z_.at(t.end);
        const double zLow = std::min(zEnter, zExit), zHigh = std::max(zEnter, zExit);
        const double bias = options_.bias.at(zHigh);
        const ZRange range = map_.zRange(face_, level, x, y);
        // Sheets that let light through are followed a little beyond the bias: see
        // attenuate.
        const double reach = map_.isOpaque() ? bias : 2.0 * bias;
        // Also true for an empty node, whose range is (+inf, -inf).
        if (!(range.min <= zHigh + reach && range.max >= zLow - reach)) return false;
        if (level == 0) return meet(x, y, t, {zEnter, zExit, bias, {}});

        const std::uint32_t half = 1u << (level - 1);
        const double xMiddle = double((2 * x + 1) * half),
                     yMiddle = double((2 * y + 1) * half);
        const Crossing cx = cross(t, x_ - xMiddle * h_), cy = cross(t, y_ - yMiddle * h_);
        const double stops[4] = {t.begin, std::min(cx.t, cy.t), std::max(cx.t, cy.t),
                                 t.end};
        for (int i = 0; i < 3; ++i) {
            const Interval part{stops[i], stops[i + 1]};
            if (part.empty()) continue;
            const std::uint32_t childX = 2 * x + (cx.highFirst == (part.begin < cx.t));
            const std::uint32_t childY = 2 * y + (cy.highFirst == (part.begin < cy.t));
            // A child beyond the right or lower border does not exist.
            if (childX * half >= map_.info().width || childY * half >= map_.info().height)
                continue;
            if (visit(level - 1, childX, childY, part)) return true;
        }
        return false;
    }

    /// intersect(node, ray) of the paper, for one pixel.
    bool meet(std::uint32_t x, std::uint32_t y, Interval t, PixelCrossing crossing) {
        if (t.begin != tLeft_)
            state_.open = 0;  // not straight from a pixel with layers near by
        tLeft_ = t.end;
        if (options_.plane) {
            crossing.counted = clipToPlane(map_.projection(face_), *options_.plane, x, y);
            if (crossing.counted.empty()) {
                state_.open = 0;
                return false;
            }
        }
        return attenuate(map_.pixel(face_, x, y), map_.info().channels, crossing,
                         options_, state_);
    }

    const ShadowMap& map_;
    std::uint32_t face_;
    const TraceOptions& options_;
    RayState& state_;
    double tLeft_ = -HUGE_VAL;  // where the ray left the pixel that it met last
    Linear x_, y_, h_, z_;
};

/// How many of the n samples at a + j (b - a) / n, j = 1..n, lie in [low, high].
std::uint32_t samplesWithin(double a, double b, std::uint32_t n, Span span) {
    const auto [low, high] = span;
    if (low > b || high <= a) {
        // Samples that coincide with the layer in front (a = b) are met at that depth.
        return a == b && low <= b && high >= b ? n : 0;
    }
    if (n == 1) return high >= b ? 1 : 0;
    if (a == b) return n;
    const double perUnit = n / (b - a);
    const double first =
        low <= a ? 1.0 : std::clamp(std::ceil((low - a) * perUnit), 1.0, double(n));
    const double last = high >= b ? double(n) : std::floor((high - a) * perUnit);
    return last < first ? 0 : static_cast<std::uint32_t>(last - first) + 1;
}

}  // namespace

bool attenuate(const PixelLayers& pixel, std::uint32_t channels,
               const PixelCrossing& crossing, const TraceOptions& options,
               RayState& state) noexcept {
    const auto around = [&](double low, double high, double reach) {
        return Span{std::max(low - reach, crossing.counted.low),
                    std::min(high + reach, crossing.counted.high)};
    };
    const double zLow = std::min(crossing.zEnter, crossing.zExit);
    const double zHigh = std::max(crossing.zEnter, crossing.zExit);
    const Span met = around(zLow, zHigh, crossing.bias);
    // A sheet may step by the bias and more from pixel to pixel: the layers that may be
    // those of a sheet already paid for lie within twice the bias of where the ray
    // changes pixels.
    const double step = 2.0 * crossing.bias;
    const Span entered = around(crossing.zEnter, crossing.zEnter, step);
    const Span left = around(crossing.zExit, crossing.zExit, step);
    const Span near = around(zLow, zHigh, step);
    const auto visibility = [&](std::uint32_t layer, std::uint32_t c) -> double {
        return pixel.v ? pixel.v[c * pixel.vStride + layer] : 0.0f;
    };
    const auto isDark = [&](std::uint32_t layer) {
        for (std::uint32_t c = 0; c < channels; ++c) {
            if (visibility(layer, c) > 0.0) return false;
        }
        return true;
    };

    std::uint64_t paid = state.open;
    state.open = 0;
    // The first layer that is not wholly in front.
    const auto begin = std::uint32_t(
        std::lower_bound(pixel.z, pixel.z + pixel.count, near.low,
                         [](float z, double value) { return double(z) < value; }) -
        pixel.z);
    bool restart = begin == 0 || isDark(begin - 1);
    for (std::uint32_t i = begin; i < pixel.count; ++i) {
        const double z = pixel.z[i], zBefore = i > 0 ? pixel.z[i - 1] : z;
        if (zBefore > near.high) break;
        const std::uint32_t n = pixel.n ? pixel.n[i] : 1;
        std::uint32_t count = samplesWithin(zBefore, z, n, met);
        const bool last = count > 0 && z <= met.high;  // the sample at z itself is met
        const bool opaque = isDark(i);
        if (!opaque) {
            // Samples of sheets that were paid for in the pixel before, met here or not.
            const auto known =
                std::min<std::uint64_t>(paid, samplesWithin(zBefore, z, n, entered));
            paid -= known;
            state.open += std::min<std::uint64_t>(std::max<std::uint64_t>(known, count),
                                                  samplesWithin(zBefore, z, n, left));
            count -= std::min(count, std::uint32_t(known));
        }
        const double share = double(count) / n;
        bool dark = true;
        for (std::uint32_t c = 0; c < channels; ++c) {
            const double v = visibility(i, c),
                         before = restart ? 1.0 : visibility(i - 1, c);
            double& remaining = state.visible[c];
            // Of a layer that ends dark, the last sample is what blocks.
            if (v <= 0.0 && last && count > 0) {
                remaining = 0.0;
            } else if (options.attenuation == Attenuation::subtract) {
                remaining = std::max(0.0, remaining - (before - v) * share);  // eq. 3
            } else if (count > 0 && v > 0.0 && v < before) {
                remaining *= count == n ? v / before : std::pow(v / before, share);
            }
            dark = dark && remaining <= options.threshold;
        }
        if (dark) return true;
        restart = opaque;
    }
    return false;
}

Span clipToPlane(const Projection& projection, const ReceiverPlane& plane,
                 std::uint32_t x, std::uint32_t y) noexcept {
    // A point at depth z on the centre ray lies a z + b above what counts as the plane,
    // which rises with the footprint: with z for a perspective projection.
    const glm::dvec3 n = projection.lightFromWorldDirection(plane.normal);
    const glm::dvec3 p = projection.lightFromWorld(plane.point);
    const glm::dvec2 centre =
        (glm::dvec2(x + 0.5, y + 0.5) - projection.offset) / projection.scale;
    const double across = n.x * centre.x + n.y * centre.y;
    const double height = plane.height * projection.pixelFootprint(1.0);
    const bool perspective = projection.kind == ProjectionKind::perspective;
    const double a = perspective ? n.z + across - height : n.z;
    const double b = (perspective ? 0.0 : across - height) - glm::dot(n, p);
    // Just short of the plane itself: a layer on it does not count.
    if (a > 0.0) return {std::nextafter(-b / a, HUGE_VAL), HUGE_VAL};
    if (a < 0.0) return {-HUGE_VAL, std::nextafter(-b / a, -HUGE_VAL)};
    return b > 0.0 ? Span{} : Span{HUGE_VAL, -HUGE_VAL};
}

ChannelVisibility traceRay(const ShadowMap& map, const Ray& ray,
                           const TraceOptions& options) noexcept {
    if (ray.delta == glm::dvec3(0.0)) return {1.0f, 1.0f, 1.0f};
    RayState state;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        state.open = 0;
        if (Traversal(map, face, ray, options, state).run({ray.tBegin, ray.tEnd})) break;
    }
    ChannelVisibility result;
    for (std::uint32_t c = 0; c < 3; ++c) {
        const double v = state.visible[c < map.info().channels ? c : 0];
        result[c] = v <= options.threshold ? 0.0f : static_cast<float>(v);
    }
    return result;
}

}  // namespace mtsm::trace
