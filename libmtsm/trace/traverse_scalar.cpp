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

Linear operator+(Linear f, Linear g) {
    return {f.a + g.a, f.b + g.b};
}
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

/// Where a ray goes over from one face to the next, and the depth that both have there;
/// NaN if it does not.
struct Joint {
    double t = NAN, z = NAN;
};

/// One face; kJoined: of several.
template <bool kJoined>
class Traversal {
  public:
    Traversal(const ShadowMap& map, std::uint32_t face, const Ray& ray, bool surfaces,
              const TraceOptions& options, RayState& state)
        : map_(map),
          face_(face),
          options_(options),
          state_(state),
          surfaces_(surfaces),
          sheets_(!map.isOpaque() && map.info().translucent == Translucent::sheets),
          media_(map.info().translucent == Translucent::media),
          length_(media_ ? std::hypot(ray.delta.x, ray.delta.y, ray.delta.z) : 1.0) {
        const Projection& p = map.projection(face);
        const glm::dvec3 o = p.lightFromWorld(ray.origin);
        const glm::dvec3 d = p.lightFromWorldDirection(ray.delta);
        z_ = {o.z, d.z};
        h_ = p.kind == ProjectionKind::perspective ? z_ : Linear{1.0, 0.0};
        x_ = {p.scale.x * o.x + p.offset.x * h_.a, p.scale.x * d.x + p.offset.x * h_.b};
        y_ = {p.scale.y * o.y + p.offset.y * h_.a, p.scale.y * d.y + p.offset.y * h_.b};
    }

    /// The ray comes from another face and goes on into one.
    void join(Joint from, Joint to) {
        from_ = from;
        to_ = to;
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
        // Where faces meet, rounding must not cut: the pixel at the border goes on for a
        // little.
        const double margin = kJoined ? kFaceMargin : 0.0;
        t = clip(t, x_ + margin * h_);
        t = clip(t, (map_.info().width + margin) * h_ - x_);
        t = clip(t, y_ + margin * h_);
        t = clip(t, (map_.info().height + margin) * h_ - y_);
        if (t.empty() || !std::isfinite(t.end)) return false;
        return visit(map_.levels() - 1, 0, 0, t);
    }

  private:
    /// Depths never go back, and at the joints are what the other face takes them for:
    /// so no sample there is met by both faces or by none.
    [[nodiscard]] double depthAt(double t) const {
        if constexpr (!kJoined) return z_.at(t);
        if (t == from_.t) return from_.z;
        if (t == to_.t) return to_.z;
        const Joint low = z_.b < 0.0 ? to_ : from_, high = z_.b < 0.0 ? from_ : to_;
        return std::min(std::max(z_.at(t), low.z), high.z);  // in this order for NaN
    }

    /// trace(node, ray) of the paper: children are visited in the order in which the ray
    /// meets them, up to three of the four.
    bool visit(std::uint32_t level, std::uint32_t x, std::uint32_t y, Interval t) {
        const double zEnter = depthAt(t.begin), zExit = depthAt(t.end);
        const double zLow = std::min(zEnter, zExit), zHigh = std::max(zEnter, zExit);
        const double bias = options_.bias.at(zHigh);
        const ZRange range = map_.zRange(face_, level, x, y);
        const double reach = sheets_ ? 2.0 * bias : bias;
        // Also true for an empty node, whose range is (+inf, -inf).
        if (!(range.min <= zHigh + reach && range.max >= zLow - reach)) return false;
        if (level == 0) return meet(x, y, t, {zEnter, zExit, bias, {}, surfaces_});

        const std::uint32_t half = 1u << (level - 1);
        const double xMiddle = double((2 * x + 1) * half),
                     yMiddle = double((2 * y + 1) * half);
        const Crossing cx = cross(t, x_ - xMiddle * h_), cy = cross(t, y_ - yMiddle * h_);
        const double stops[4] = {t.begin, std::min(cx.t, cy.t), std::max(cx.t, cy.t),
                                 t.end};
        for (int i = 0; i < 3; ++i) {
            const Interval part{stops[i], stops[i + 1]};
            if (part.empty()) continue;
            std::uint32_t childX = 2 * x + (cx.highFirst == (part.begin < cx.t));
            std::uint32_t childY = 2 * y + (cy.highFirst == (part.begin < cy.t));
            // Beyond the right or lower border there is no child, and nothing of the ray
            // but what rounding took there.
            if (childX * half >= map_.info().width) childX = 2 * x;
            if (childY * half >= map_.info().height) childY = 2 * y;
            if (visit(level - 1, childX, childY, part)) return true;
        }
        return false;
    }

    /// intersect(node, ray) of the paper, for one pixel.
    bool meet(std::uint32_t x, std::uint32_t y, Interval t, PixelCrossing crossing) {
        if (t.begin != state_.tLeft)
            state_.open = 0;  // not straight from a pixel with layers near by
        state_.tLeft = t.end;
        if (options_.plane) {
            crossing.counted = clipToPlane(map_.projection(face_), *options_.plane, x, y);
            if (crossing.counted.empty()) {
                state_.open = 0;
                return false;
            }
        }
        if (media_) crossing.stretch = stretch(x, y);
        return attenuate(map_.pixel(face_, x, y), map_.info(), crossing, options_,
                         state_);
    }

    /// A medium takes from a ray by the length of its way, and what a sample says of that
    /// was found along the centre ray.
    [[nodiscard]] double stretch(std::uint32_t x, std::uint32_t y) const {
        const Projection& p = map_.projection(face_);
        double centre = 1.0;
        if (p.kind == ProjectionKind::perspective) {
            const glm::dvec2 c = (glm::dvec2(x + 0.5, y + 0.5) - p.offset) / p.scale;
            centre = std::sqrt(1.0 + c.x * c.x + c.y * c.y);
        }
        return std::min(length_ / (std::abs(z_.b) * centre), kMostStretch);
    }

    const ShadowMap& map_;
    std::uint32_t face_;
    const TraceOptions& options_;
    RayState& state_;
    bool surfaces_;  // do they count?
    bool sheets_;    // that let light through: followed a little beyond the bias
    bool media_;
    double length_;  // per unit of t, of media
    Linear x_, y_, h_, z_;
    Joint from_, to_;
};

/// Where a ray is to be traced, and what is to count there.
struct Stretch {
    Interval t;
    bool surfaces = true;
};

/// Each face in turn that the ray is in; true if it fell to the threshold.
bool traceFaces(const ShadowMap& map, const Ray& ray, Stretch stretch,
                const TraceOptions& options, RayState& state) {
    std::array<Linear, 6> depth;
    Interval t = stretch.t;
    std::uint32_t face = 0;
    for (std::uint32_t f = 0; f < 6; ++f) {
        const Projection& p = map.projection(f);
        depth[f] = {glm::dot(p.forward, ray.origin - p.eye),
                    glm::dot(p.forward, ray.delta)};
        if (depth[f].at(t.begin) > depth[face].at(t.begin)) face = f;
    }
    // The depth in the ray's face is overtaken by one that grows faster, five times at
    // most.
    for (Joint from;;) {
        t.end = stretch.t.end;
        std::uint32_t next = face;
        for (std::uint32_t f = 0; f < 6; ++f) {
            const Linear lead = depth[face] - depth[f];
            if (!(lead.b < 0.0)) continue;
            const double overtakes = std::max(t.begin, -lead.a / lead.b);
            if (overtakes < t.end ||
                (overtakes == t.end && next != face && depth[f].b > depth[next].b)) {
                t.end = overtakes;
                next = f;
            }
        }
        Joint to;
        if (next != face) {
            const double z = depth[face].at(t.end);
            to = {t.end, depth[face].b < 0.0 ? std::min(z, from.z) : std::max(z, from.z)};
        }
        Traversal<true> traversal(map, face, ray, stretch.surfaces, options, state);
        traversal.join(from, to);
        if (traversal.run(t)) return true;
        if (next == face) return false;
        t.begin = t.end;
        face = next;
        from = to;
    }
}

bool trace(const ShadowMap& map, const Ray& ray, Stretch stretch,
           const TraceOptions& options, RayState& state) {
    if (map.faceCount() > 1) return traceFaces(map, ray, stretch, options, state);
    return Traversal<false>(map, 0, ray, stretch.surfaces, options, state).run(stretch.t);
}

/// How many of the n samples at a + j (b - a) / n, j = 1..n, lie in front of depth z; or
/// at it, if that is to count.
std::uint32_t samplesTo(double a, double b, std::uint32_t n, double z, bool including) {
    if (z > b || (including && z == b)) return n;
    if (n == 1 || !(z > a)) return 0;  // samples that coincide with the layer in front: b
    const double steps = (z - a) * (n / (b - a));
    const double before = including ? std::floor(steps) : std::ceil(steps) - 1.0;
    return static_cast<std::uint32_t>(std::clamp(before, 0.0, n - 1.0));
}

std::uint32_t samplesWithin(double a, double b, std::uint32_t n, Span span) {
    if (span.empty()) return 0;
    return samplesTo(a, b, n, span.high, true) - samplesTo(a, b, n, span.low, false);
}

/// A place between depths: just in front of z, or just behind it.
struct Cut {
    double z;
    bool behind;
};
bool operator<(Cut a, Cut b) {
    return a.z < b.z || (a.z == b.z && a.behind < b.behind);
}

/// The depths that a crossing goes through, without the one at which it ends.
struct Crossed {
    Cut low, high;
    explicit Crossed(const PixelCrossing& c) {
        const bool away = c.zEnter < c.zExit;
        low = {std::min(c.zEnter, c.zExit), !away};
        high = {std::max(c.zEnter, c.zExit), !away};
        low = std::max(low, Cut{c.counted.low, false});
        high = std::min(high, Cut{c.counted.high, true});
    }
    [[nodiscard]] std::uint32_t samples(double a, double b, std::uint32_t n) const {
        if (!(low < high)) return 0;
        return samplesTo(a, b, n, high.z, high.behind) -
               samplesTo(a, b, n, low.z, low.behind);
    }
};

/// A pixel's layers with what their absent planes stand for.
struct Layers {
    const PixelLayers& pixel;
    std::uint32_t channels;

    [[nodiscard]] double v(std::uint32_t i, std::uint32_t c) const {
        return pixel.v ? pixel.v[c * pixel.vStride + i] : 0.0f;
    }
    [[nodiscard]] std::uint32_t n(std::uint32_t i) const {
        return pixel.n ? pixel.n[i] : 1;
    }
    [[nodiscard]] bool isDark(std::uint32_t i) const {
        for (std::uint32_t c = 0; c < channels; ++c) {
            if (v(i, c) > 0.0) return false;
        }
        return true;
    }
    /// The first one that does not lie in front of depth z.
    [[nodiscard]] std::uint32_t from(double z) const {
        const float* end = pixel.z + pixel.count;
        return std::uint32_t(std::lower_bound(pixel.z, end, z,
                                              [](float layer, double value) {
                                                  return double(layer) < value;
                                              }) -
                             pixel.z);
    }
    /// Does accumulation start at 1 in front of layer i?
    [[nodiscard]] bool startsAt(std::uint32_t i) const { return i == 0 || isDark(i - 1); }
};

/// Takes `count` of the samples of layer i, the last one of them if `last`; true if the
/// ray is now at or below the threshold.
bool take(const Layers& layers, std::uint32_t i, bool restart, std::uint32_t count,
          bool last, double stretch, const TraceOptions& options, RayState& state) {
    const double share = double(count) / layers.n(i), power = stretch * share;
    const bool ends = last && count > 0;
    const bool blocks = ends && layers.isDark(i);
    bool dark = true;
    for (std::uint32_t c = 0; c < layers.channels; ++c) {
        const double v = layers.v(i, c), before = restart ? 1.0 : layers.v(i - 1, c);
        double& remaining = state.visible[c];
        // Of what ends dark, the last sample is what blocks.
        if (blocks || (ends && v <= 0.0 && before > 0.0)) {
            remaining = 0.0;
        } else if (count == 0 || v >= before) {
            // Nothing is taken.
        } else if (options.attenuation == Attenuation::subtract) {
            remaining = std::max(0.0, remaining - (before - v) * share);  // eq. 3
        } else if (v > 0.0) {
            remaining *= power == 1.0 ? v / before : std::pow(v / before, power);
        }
        dark = dark && remaining <= options.threshold;
    }
    return dark;
}

Span within(const PixelCrossing& crossing, double low, double high, double reach) {
    return {std::max(low - reach, crossing.counted.low),
            std::min(high + reach, crossing.counted.high)};
}

/// Depths at which the crossing meets a surface.
Span nearSurfaces(const PixelCrossing& c) {
    if (!c.surfaces) return {HUGE_VAL, -HUGE_VAL};
    return within(c, std::min(c.zEnter, c.zExit), std::max(c.zEnter, c.zExit), c.bias);
}

/// A pixel of nothing but opaque surfaces.
bool meetSurfaces(const Layers& layers, const PixelCrossing& crossing, RayState& state) {
    const Span met = nearSurfaces(crossing);
    state.open = 0;
    const std::uint32_t i = layers.from(met.low);
    if (i == layers.pixel.count || layers.pixel.z[i] > met.high) return false;
    state.visible = {0.0, 0.0, 0.0};
    return true;
}

bool meetSheets(const Layers& layers, const PixelCrossing& crossing,
                const TraceOptions& options, RayState& state) {
    const double zLow = std::min(crossing.zEnter, crossing.zExit);
    const double zHigh = std::max(crossing.zEnter, crossing.zExit);
    const Span met = within(crossing, zLow, zHigh, crossing.bias);
    // A sheet may step by the bias and more from pixel to pixel: the layers that may be
    // those of a sheet already paid for lie within twice the bias of where the ray
    // changes pixels.
    const double step = 2.0 * crossing.bias;
    const Span entered = within(crossing, crossing.zEnter, crossing.zEnter, step);
    const Span left = within(crossing, crossing.zExit, crossing.zExit, step);
    const Span near = within(crossing, zLow, zHigh, step);

    std::uint64_t paid = state.open;
    state.open = 0;
    const std::uint32_t begin = layers.from(near.low);
    bool restart = layers.startsAt(begin);
    for (std::uint32_t i = begin; i < layers.pixel.count; ++i) {
        const double z = layers.pixel.z[i], zBefore = i > 0 ? layers.pixel.z[i - 1] : z;
        if (zBefore > near.high) break;
        const std::uint32_t n = layers.n(i);
        std::uint32_t count = samplesWithin(zBefore, z, n, met);
        const bool last = count > 0 && z <= met.high;  // the sample at z itself is met
        const bool opaque = layers.isDark(i);
        if (!opaque) {
            // Samples of sheets that were paid for in the pixel before, met here or not.
            const auto known =
                std::min<std::uint64_t>(paid, samplesWithin(zBefore, z, n, entered));
            paid -= known;
            state.open += std::min<std::uint64_t>(std::max<std::uint64_t>(known, count),
                                                  samplesWithin(zBefore, z, n, left));
            count -= std::min(count, std::uint32_t(known));
        }
        if (take(layers, i, restart, count, last, 1.0, options, state)) return true;
        restart = opaque;
    }
    return false;
}

bool meetMedia(const Layers& layers, const PixelCrossing& crossing,
               const TraceOptions& options, RayState& state) {
    const Crossed crossed(crossing);
    const Span surfaces = nearSurfaces(crossing);
    const double nearest = std::min(crossed.low.z, surfaces.low);
    const double farthest = std::max(crossed.high.z, surfaces.high);
    for (std::uint32_t i = layers.from(nearest); i < layers.pixel.count; ++i) {
        const double z = layers.pixel.z[i], zBefore = i > 0 ? layers.pixel.z[i - 1] : z;
        if (zBefore > farthest) break;
        const std::uint32_t n = layers.n(i);
        const bool surface = n == 1 && layers.isDark(i);
        const std::uint32_t count = surface ? z >= surfaces.low && z <= surfaces.high
                                            : crossed.samples(zBefore, z, n);
        if (count == 0) continue;
        const bool last = surface || !(crossed.high < Cut{z, true});
        if (take(layers, i, layers.startsAt(i), count, last, crossing.stretch, options,
                 state))
            return true;
    }
    return false;
}

}  // namespace

bool attenuate(const PixelLayers& pixel, const MapInfo& info,
               const PixelCrossing& crossing, const TraceOptions& options,
               RayState& state) noexcept {
    const Layers layers{pixel, info.channels};
    if (!pixel.v && !pixel.n) return meetSurfaces(layers, crossing, state);
    if (info.translucent == Translucent::media)
        return meetMedia(layers, crossing, options, state);
    return meetSheets(layers, crossing, options, state);
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

std::uint32_t faceOf(const ShadowMap& map, glm::dvec3 point) noexcept {
    std::uint32_t face = 0;
    double deepest = -HUGE_VAL;
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        const Projection& p = map.projection(f);
        const double z = glm::dot(p.forward, point - p.eye);
        if (z > deepest) {
            deepest = z;
            face = f;
        }
    }
    return face;
}

ChannelVisibility traceRay(const ShadowMap& map, const Ray& ray,
                           const TraceOptions& options) noexcept {
    if (ray.delta == glm::dvec3(0.0)) return {1.0f, 1.0f, 1.0f};
    RayState state;
    Interval t{ray.tBegin, ray.tEnd};
    if (map.info().translucent == Translucent::media && ray.tSurfaces > t.begin) {
        const Interval start{t.begin, std::min(ray.tSurfaces, t.end)};
        trace(map, ray, {start, false}, options, state);
        t.begin = start.end;
    }
    trace(map, ray, {t, true}, options, state);
    return channelsOf(state, map.info().channels, options.threshold);
}

ChannelVisibility channelsOf(const RayState& state, std::uint32_t channels,
                             double threshold) noexcept {
    ChannelVisibility result;
    for (std::uint32_t c = 0; c < 3; ++c) {
        const double v = state.visible[c < channels ? c : 0];
        result[c] = v <= threshold ? 0.0f : static_cast<float>(v);
    }
    return result;
}

}  // namespace mtsm::trace
