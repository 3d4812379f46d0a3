// Rays against the strands of a near field: flat ribbons in light space, in double; and
// the same answer whichever rays stand beside and whatever the processor.
#include "trace/hair_trace.h"

#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <memory>
#include <tuple>
#include <vector>

#include "map_fixture.h"
#include "mtsm/map.h"
#include "trace/bundle_fixture.h"
#include "trace/each_target.h"

using namespace mtsm;
using test::onEachTarget;
using test::Random;
using trace::kLanes;
using trace::kMostMediaRows;
using trace::kMostReceivers;

namespace {

constexpr float kHalfStep = 0x1p-13f;

struct Segment {
    glm::dvec3 end[2];  // straight space, on a grid of 2^-8 and depthStep()
    int half[2];        // steps
    int opacity;        // 65535ths
};

/// What is 1/1024 of a pixel's footprint or so, in w.
double depthStep(bool perspective) {
    return perspective ? 0x1p-20 : 0x1p-14;
}
/// Footprints of a pixel, about, to w.
double perFootprint(bool perspective) {
    return perspective ? 0x1p-11 : 0x1p-5;
}

glm::dvec3 onGrid(glm::dvec3 p, bool perspective) {
    const double step = depthStep(perspective);
    return {std::round(p.x * 0x1p8) * 0x1p-8, std::round(p.y * 0x1p8) * 0x1p-8,
            std::round(p.z / step) * step};
}

Projection viewOf(bool perspective) {
    Projection p = test::plainProjection(64, 64);
    p.scale = {32.0, -24.0};  // pixels need not be square
    if (!perspective) p.kind = ProjectionKind::orthographic;
    return p;
}

/// A map with these strands, 16 by 16 in their order.
ShadowMap mapOfSegments(const std::vector<Segment>& segments, bool perspective) {
    const double step[3] = {0x1p-8, 0x1p-8, depthStep(perspective)};
    std::vector<MapFace> faces(1);
    faces[0].projection = viewOf(perspective);
    faces[0].tiles.resize(1);
    for (std::size_t i = 0; i < segments.size(); i += 16) {
        NearHairChunk chunk;
        const std::size_t count = std::min<std::size_t>(16, segments.size() - i);
        for (int axis = 0; axis < 3; ++axis) {
            double low = HUGE_VAL;
            for (std::size_t k = 0; k < count; ++k) {
                for (const glm::dvec3& p : segments[i + k].end)
                    low = std::min(low, p[axis]);
            }
            chunk.low[axis] = float(low);
            chunk.step[axis] = float(step[axis]);
            for (std::size_t k = 0; k < count; ++k) {
                for (std::size_t e = 0; e < 2; ++e)
                    chunk.end[e][axis][k] =
                        std::uint16_t((segments[i + k].end[e][axis] - low) / step[axis]);
            }
        }
        chunk.halfStep = kHalfStep;
        for (std::size_t k = 0; k < count; ++k) {
            chunk.opacity[k] = std::uint16_t(segments[i + k].opacity);
            for (std::size_t e = 0; e < 2; ++e)
                chunk.half[e][k] = std::uint8_t(segments[i + k].half[e]);
        }
        faces[0].nearHair.chunks.push_back(chunk);
    }
    auto map = ShadowMap::create(test::plainInfo(64, 64, 64), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

/// Close: within 12 pixels, and of one opacity.
std::vector<Segment> scattered(Random& random, int count, bool perspective,
                               bool close = false) {
    const double unit = perFootprint(perspective);
    std::vector<Segment> segments;
    for (int i = 0; i < count; ++i) {
        const double side = close ? 3.0 : 32.0, reach = close ? 3.0 : 6.0;
        const glm::dvec3 at(random.in(32 - side, 32 + side),
                            random.in(32 - side, 32 + side),
                            random.in(32 - side / 4, 32 + side / 4) * unit);
        Segment s;
        for (glm::dvec3& p : s.end)
            p = onGrid(at + reach * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                               random.in(-1, 1) * unit),
                       perspective);
        for (int& half : s.half)
            half = int(random.below(100));
        s.opacity = close ? 26214 : 1 + int(random.below(60000));
        segments.push_back(s);
    }
    // As the bake does, those that lie together into one chunk.
    std::sort(segments.begin(), segments.end(), [](const auto& a, const auto& b) {
        const auto key = [](const Segment& s) {
            return std::make_tuple(int(s.end[0].x / 8), int(s.end[0].y / 8), s.end[0].z);
        };
        return key(a) < key(b);
    });
    return segments;
}

/// Rays towards the eye from around a point; all there is of near field for each
/// receiver.
std::unique_ptr<test::Rays> raysAround(Random& random, int receivers, int groups,
                                       bool planes, bool perspective) {
    const double unit = perFootprint(perspective);
    auto rays = std::make_unique<test::Rays>(receivers, groups);
    const glm::dvec3 from(random.in(8, 56), random.in(8, 56), random.in(22, 28) * unit);
    const glm::dvec2 lean(random.in(-6, 6), random.in(-6, 6));
    const double spread = std::exp2(random.in(-4, 2));
    for (int receiver = 0; receiver < receivers; ++receiver) {
        rays->setStart(receiver,
                       from + spread * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                                  random.in(-1, 1) * unit));
        for (int group = 0; group < groups; ++group) {
            const int row = rays->bundle.row(receiver, group);
            for (int lane = 0; lane < kLanes; ++lane)
                rays->setDelta(
                    row, lane,
                    {lean.x + 4 * spread * random.in(-1, 1),
                     lean.y + 4 * spread * random.in(-1, 1), random.in(12, 16) * unit});
        }
    }
    rays->bound();
    for (int receiver = 0; receiver < receivers; ++receiver)
        rays->bundle.rise[receiver] = float(random.in(2, 12) * unit);
    if (planes) {
        rays->bundle.hasPlanes = true;
        for (int receiver = 0; receiver < kMostReceivers; ++receiver) {
            const glm::dvec3 n =
                glm::normalize(glm::dvec3(random.in(-1, 1), random.in(-1, 1), 1));
            rays->bundle.planeU[receiver] = float(n.x);
            rays->bundle.planeV[receiver] = float(n.y);
            rays->bundle.planeW[receiver] = float(n.z / unit);
        }
    }
    return rays;
}

trace::HairTraceOptions someOptions(bool planes) {
    trace::HairTraceOptions options;
    if (planes)
        options.height = 0.25f;
    else
        options.start = 0.25f;
    return options;
}

enum class Met { no, yes, close };

/// Whether a ray goes through a segment's ribbon, which lies across the plane through the
/// receiver and the segment, in light space; close if being flat, and not as strips of
/// slopes have it, or rounding may decide.
Met meets(const Segment& segment, const Projection& view, const test::Rays& rays,
          int receiver, glm::dvec3 delta, const trace::HairTraceOptions& options) {
    const bool perspective = view.kind == ProjectionKind::perspective;
    const auto light = [&](glm::dvec3 p) {
        return view.lightFromRaster({p.x, p.y}, perspective ? 1.0 / p.z : -p.z);
    };
    // The part that counts.
    const glm::dvec3 start = rays.start(receiver);
    const double footprint = view.pixelFootprint(1.0) * (perspective ? start.z : 1.0);
    const double rise = rays.bundle.rise[receiver];
    double t0 = 0.0, t1 = 1.0;
    const auto keep = [&](double a, double b) {
        if (a < b) t0 = std::max(t0, a / (a - b));
        if (a > b) t1 = std::min(t1, a / (a - b));
        if (a == b && a < 0) t1 = -1.0;
    };
    const auto& [a, b] = segment.end;
    keep(start.z + rise - a.z, start.z + rise - b.z);
    if (rays.bundle.hasPlanes) {
        const glm::dvec3 n(rays.bundle.planeU[receiver], rays.bundle.planeV[receiver],
                           rays.bundle.planeW[receiver]);
        keep(glm::dot(n, a - start) - options.height,
             glm::dot(n, b - start) - options.height);
        keep(a.z - start.z, b.z - start.z);
    } else {
        const double least = start.z + options.start * footprint;
        keep(a.z - least, b.z - least);
    }
    if (t0 > t1 + 1e-4) return Met::no;
    const bool hardly = t1 - t0 < 1e-3;
    const glm::dvec3 from = light(glm::mix(a, b, t0)), to = light(glm::mix(a, b, t1));
    const auto worldHalf = [&](double t, glm::dvec3 p) {
        const double half =
            kHalfStep * glm::mix(double(segment.half[0]), double(segment.half[1]), t);
        return perspective ? half * p.z : half;
    };
    bool own = false, mayBeOwn = false;
    const double half0 = worldHalf(t0, from), half1 = worldHalf(t1, to);
    const glm::dvec3 p = light(start), way = light(start + delta) - p;
    if (!rays.bundle.hasPlanes) {
        const glm::dvec3 ends[2] = {light(a), light(b)}, whole = ends[1] - ends[0];
        const double t =
            std::clamp(glm::dot(p - ends[0], whole) / glm::dot(whole, whole), 0.0, 1.0);
        const glm::dvec3 nearest = ends[0] + t * whole;
        const double half = glm::mix(worldHalf(0.0, ends[0]), worldHalf(1.0, ends[1]), t);
        const double off = glm::distance(p, nearest) / half;
        own = off < 1.15;
        mayBeOwn = own != (off < 0.95);
    }
    const glm::dvec3 across = glm::cross(way, to - from);
    const double length = glm::length(to - from), size = glm::length(across);
    if (size < 1e-3 * length * glm::length(way)) return Met::close;  // end-on
    // p + s way = from + t (to - from) + off n
    const glm::dvec3 n = across / size;
    const glm::dmat3 system(way, from - to, -n);
    const glm::dvec3 found = glm::inverse(system) * (from - p);
    const double half = glm::mix(half0, half1, found.y), off = std::abs(found.z);
    const double widths = found.x * glm::length(way) / (2.0 * half);
    const double atEnds = 0.02 + (1.5 * off + 0.2 * std::max(half0, half1)) / length;
    const double inside = std::min(found.y, 1.0 - found.y);
    const double slack = 0.04 * std::max(half0, half1) + 1e-3;
    if (inside < -atEnds || off > half + slack) return Met::no;
    // Its own strand counts from a width on, as the receiver's middle ray rises.
    if (own && !mayBeOwn && widths < 0.3) return Met::no;
    if (own && widths < 4.0) return Met::close;
    if (hardly || inside < atEnds || off > half - slack) return Met::close;
    return Met::yes;
}

trace::RayDepths noDepths() {
    trace::RayDepths depths;
    for (auto& channel : depths.depth)
        std::fill_n(channel[0], kMostMediaRows * kLanes, 0.0f);
    return depths;
}

}  // namespace

TEST_CASE("rays meet the strands that flat ribbons in double say", "[trace][twin]") {
    Random random(1);
    int wrong = 0, hit = 0, missed = 0, close = 0;
    for (const int count : {1, 16, 17, 300, -320}) {
        for (const bool perspective : {true, false}) {
            const std::vector<Segment> segments =
                scattered(random, std::abs(count), perspective, count < 0);
            const ShadowMap map = mapOfSegments(segments, perspective);
            // Ends of 12 bits and of 16, opacities that are one and many.
            const auto& packed = map.nearHair(0).chunks.packed(0);
            if (std::abs(count) > 17) CHECK(packed.isShort == (count < 0));
            CHECK(packed.isOneOpacity == (count < 0));
            const Projection& view = map.projection(0);
            for (int i = 0; i < 40; ++i) {
                const bool planes = i % 2 == 1;
                const auto rays =
                    raysAround(random, 1 + i % 5, 1 + i % 3, planes, perspective);
                const trace::HairTraceOptions options = someOptions(planes);
                test::Rays after = *rays;
                trace::RayDepths depths = noDepths();
                trace::traceHair(map.nearHair(0), view, options, 1, after.bundle, depths);
                for (int row = 0; row < rays->rows(); ++row) {
                    for (int lane = 0; lane < kLanes; ++lane) {
                        double least = 0.0, most = 0.0;
                        for (const Segment& s : segments) {
                            const Met met =
                                meets(s, view, *rays, row / rays->bundle.groups,
                                      rays->delta(row, lane), options);
                            const double depth = -std::log1p(-s.opacity / 65535.0);
                            if (met == Met::yes) least += depth;
                            if (met != Met::no) most += depth;
                        }
                        const double depth = depths.depth[0][row][lane];
                        wrong += !(depth >= least - 1e-4 && depth <= most + 1e-4);
                        hit += least > 0.0;
                        missed += most == 0.0;
                        close += most > least;
                    }
                }
            }
        }
    }
    CHECK(wrong == 0);
    CHECK(hit > 500);
    CHECK(missed > 1000);
    CHECK(close < (hit + missed) / 3);
}

TEST_CASE("a strand of parallel light hides the part of the light that it covers",
          "[trace][exact]") {
    // 8 w above the receiver, along u, half of its width 0.75 pixels: half = .75 / 24.
    const int steps = 256;
    const Segment strand = {{{8, 24, 40}, {56, 24, 40}}, {steps, steps}, 32768};
    Segment stored = strand;
    stored.half[0] = stored.half[1] = 128;  // by twice the step
    ShadowMap map = mapOfSegments({stored}, false);
    NearHair hair = map.nearHair(0);
    NearHairChunk wider = hair.chunks[0];
    wider.halfStep = 2 * kHalfStep;
    hair.chunks = {};
    hair.chunks.push_back(wider);
    const double halfPixels = 24.0 * steps * double(kHalfStep);
    CHECK(halfPixels == 0.75);
    test::Rays rays(1, 16);
    rays.setStart(0, {32, 24, 32});
    for (int row = 0; row < 16; ++row) {
        for (int lane = 0; lane < kLanes; ++lane)
            rays.setDelta(row, lane, {lane * 0.25, (row - 7.5) * 0.2, 16.0});
    }
    rays.bound();
    rays.bundle.rise[0] = 12.0f;
    trace::RayDepths depths = noDepths();
    trace::traceHair(hair, map.projection(0), {}, 3, rays.bundle, depths);
    for (int row = 0; row < 16; ++row) {
        // Half of its way up.
        const bool covered = std::abs((row - 7.5) * 0.1) <= halfPixels;
        for (int lane = 0; lane < kLanes; ++lane) {
            for (const auto& channel : depths.depth)
                CHECK(channel[row][lane] ==
                      Approx(covered ? -std::log(1.0 - 32768.0 / 65535.0) : 0.0));
        }
    }
    // Where the near field ends below it, and where strands begin to count above it.
    for (const bool low : {true, false}) {
        test::Rays others = rays;
        others.bundle.rise[0] = low ? 7.5f : 12.0f;
        trace::HairTraceOptions options;
        options.start = low ? 0.0f : 8.5f * 32.0f;  // a footprint is 1/24, 1/32 in u
        depths = noDepths();
        options.start = low ? 0.0f : float(8.5 / map.projection(0).pixelFootprint(1.0));
        trace::traceHair(hair, map.projection(0), options, 1, others.bundle, depths);
        CHECK(std::all_of(depths.depth[0][0], depths.depth[0][0] + 16 * kLanes,
                          [](float depth) { return depth == 0.0f; }));
    }
}

TEST_CASE("the strand on which a receiver lies hides the light from a width on",
          "[trace]") {
    // It comes up beside the receiver, which lies on it, bends and goes across above.
    const int steps = 80;
    const double half = steps * double(kHalfStep);
    const auto closed = [&](double above, double gap) {
        const double v = 24 + std::round(0.9 * half * 24 * 256) / 256;
        const double w = 32 + above * half;
        const Segment up = {{{32, v, 31}, {32, v, w}}, {steps, steps}, 65535};
        const Segment over = {{{32 + gap, v, w}, {32, 20, w}}, {steps, steps}, 65535};
        const ShadowMap map = mapOfSegments({up, over}, false);
        test::Rays rays(1, 1);
        rays.setStart(0, {32, 24, 32});
        for (int lane = 0; lane < kLanes; ++lane)
            rays.setDelta(0, lane, {0, -0.125 * lane, 16.0});
        rays.bound();
        rays.bundle.rise[0] = 12.0f;
        trace::RayDepths depths = noDepths();
        trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, rays.bundle, depths);
        return 16 - std::popcount(rays.bundle.open[0]);
    };
    CHECK(closed(1.5, 0.0) == 0);
    CHECK(closed(1.5, 0.25) == 16);  // not its own: they are not joined
    CHECK(closed(2.125, 0.0) == 16);
    CHECK(closed(3.0, 0.0) == 16);
}

TEST_CASE("a strand of segments much shorter than wide is one strand", "[trace]") {
    const int steps = 80;
    const double half = steps * double(kHalfStep), step = half / 10;
    const auto round = [](double x, double grid) { return std::round(x / grid) * grid; };
    // It leads up to the eye at 45 degrees, the receiver on its lower side: rays go
    // through it within a width.
    std::vector<Segment> segments;
    for (int i = -60; i < 60; ++i) {
        const auto at = [&](int k) {
            const double way = k * step * std::sqrt(0.5);
            return glm::dvec3(round(32 + 32 * way, 0x1p-8), 24, round(32 + way, 0x1p-14));
        };
        segments.push_back({{at(i), at(i + 1)}, {steps, steps}, 26214});
    }
    const auto met = [&] {
        const ShadowMap map = mapOfSegments(segments, false);
        test::Rays rays(1, 1);
        const double aside = 0.4 * half * std::sqrt(0.5);
        rays.setStart(0, {32 + 32 * aside, 24, 32 - aside});
        for (int lane = 0; lane < kLanes; ++lane)
            rays.setDelta(0, lane, {0, -0.125 * lane - 0.031, 16.0});  // not at joints
        rays.bound();
        rays.bundle.rise[0] = 12.0f;
        trace::RayDepths depths = noDepths();
        trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, rays.bundle, depths);
        return std::vector<float>(depths.depth[0][0], depths.depth[0][0] + kLanes);
    };
    CHECK(met() == std::vector<float>(kLanes, 0.0f));
    // Another one goes across above, so far that there is no room for it among what is
    // close, or so near that there is: it is met once.
    const std::vector<Segment> own = segments;
    for (const double above : {3.3, 2.2}) {
        segments = own;
        for (int i = -30; i < 30; ++i) {
            const auto at = [&](int k) {
                return glm::dvec3(round(32 + 32 * 0.4 * half * std::sqrt(0.5), 0x1p-8),
                                  round(24 + 24 * k * step, 0x1p-8),
                                  round(32 + above * half, 0x1p-14));
            };
            segments.push_back({{at(i), at(i + 1)}, {steps, steps}, 26214});
        }
        for (const float depth : met())
            CHECK(depth == Approx(-std::log1p(-26214.0 / 65535.0)));
    }
}

TEST_CASE("close to the receiver joints are round, and are crossed once", "[trace]") {
    const int steps = 80;
    const double half = steps * double(kHalfStep);
    const double w = std::round((32 + 2.5 * half) * 0x1p14) * 0x1p-14;
    const glm::dvec3 joint(32.125, 24, w);
    const Segment to = {{{31.5, 23.5, w}, joint}, {steps, steps}, 26214};
    const Segment on = {{joint, {31.5, 24.5, w}}, {steps, steps}, 26214};
    const ShadowMap map = mapOfSegments({to, on}, false);
    Random random(3);
    int hit = 0, passed = 0;
    for (int i = 0; i < 20; ++i) {
        test::Rays rays(1, 1);
        rays.setStart(0, {32, 24, 32});
        for (int lane = 0; lane < kLanes; ++lane) {
            // To around the joint, and on.
            const glm::dvec2 aside(32 * random.in(-1, 1), 24 * random.in(-1, 1));
            const glm::dvec2 at = glm::dvec2(joint) + 1.3 * half * aside;
            rays.setDelta(0, lane,
                          glm::dvec3((at - glm::dvec2(32, 24)) / (w - 32), 1) * 16.0);
        }
        rays.bound();
        rays.bundle.rise[0] = 12.0f;
        test::Rays after = rays;
        trace::RayDepths depths = noDepths();
        trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, after.bundle, depths);
        for (int lane = 0; lane < kLanes; ++lane) {
            const auto light = [](glm::dvec3 p) {  // from the receiver
                return glm::dvec3((p.x - 32) / 32, (p.y - 24) / -24, 32 - p.z);
            };
            const glm::dvec3 ray =
                glm::normalize(light(rays.start(0) + rays.delta(0, lane)));
            const auto across = [&](glm::dvec3 p) { return p - glm::dot(p, ray) * ray; };
            double off = HUGE_VAL;
            for (const Segment& s : {to, on}) {
                const glm::dvec3 a = across(light(s.end[0])), b = across(light(s.end[1]));
                const double t = glm::dot(-a, b - a) / glm::dot(b - a, b - a);
                off = std::min(off, glm::length(glm::mix(a, b, std::clamp(t, 0.0, 1.0))));
            }
            if (std::abs(off / half - 1) < 1e-3) continue;
            (off < half ? hit : passed) += 1;
            CHECK(depths.depth[0][0][lane] ==
                  Approx(off < half ? -std::log1p(-26214.0 / 65535.0) : 0.0));
        }
    }
    CHECK(hit > 100);
    CHECK(passed > 20);
}

TEST_CASE("a strand level with the receiver hides nothing that it is beside", "[trace]") {
    // Four pixels away and hardly above it: its ribbon does not stand up like a wall.
    const Segment strand = {
        {{28, 28, 32 + 0x1p-12}, {36, 28, 32 + 0x1p-11}}, {80, 80}, 65535};
    const ShadowMap map = mapOfSegments({strand}, false);
    test::Rays rays(1, 1);
    rays.setStart(0, {32, 24, 32});
    for (int lane = 0; lane < kLanes; ++lane)
        rays.setDelta(0, lane, {0.5 * lane - 4, -2, 16.0});
    rays.bound();
    rays.bundle.rise[0] = 12.0f;
    trace::RayDepths depths = noDepths();
    trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, rays.bundle, depths);
    CHECK(std::popcount(rays.bundle.open[0]) == 16);
}

TEST_CASE("rays are closed where strands leave no light", "[trace]") {
    const auto strand = [](double w, int opacity) {
        return Segment{{{8, 24, w}, {56, 24, w}}, {99, 99}, opacity};
    };
    const ShadowMap map = mapOfSegments({strand(36, 65535), strand(37, 52428)}, false);
    const ShadowMap thin = mapOfSegments({strand(36, 52428), strand(37, 52428)}, false);
    test::Rays rays(1, 1);
    rays.setStart(0, {32, 24, 32});
    for (int lane = 0; lane < kLanes; ++lane)
        rays.setDelta(0, lane, {0, lane < 8 ? 0.0 : 40.0, 16.0});
    rays.bundle.open[0] = 0xff7f;
    rays.bound();
    rays.bundle.rise[0] = 12.0f;
    test::Rays after = rays;
    trace::RayDepths depths = noDepths();
    trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, after.bundle, depths);
    CHECK(after.bundle.open[0] == 0xff00);
    CHECK(depths.depth[0][0][0] >= trace::kDarkDepth);
    CHECK(depths.depth[0][0][7] == 0.0f);  // was closed before
    after = rays;
    trace::HairTraceOptions options;
    options.darkDepth = 3.0f;
    depths = noDepths();
    trace::traceHair(thin.nearHair(0), map.projection(0), options, 1, after.bundle,
                     depths);
    CHECK(after.bundle.open[0] == 0xff00);
    CHECK(depths.depth[0][0][0] == Approx(2 * std::log(5.0)).epsilon(1e-4));
    // Rays without bounds are the layers' alone.
    rays.bundle.wide = 1;
    depths = noDepths();
    trace::traceHair(map.nearHair(0), map.projection(0), {}, 1, rays.bundle, depths);
    CHECK(rays.bundle.open[0] == 0xff7f);
    CHECK(depths.depth[0][0][0] == 0.0f);
}

TEST_CASE("what a ray meets of strands depends on that ray alone, on every processor",
          "[trace][twin]") {
    Random random(3);
    const ShadowMap map = mapOfSegments(scattered(random, 2000, true), true);
    const auto traced = [&](test::Rays& rays) {
        const trace::HairTraceOptions options = someOptions(rays.bundle.hasPlanes);
        trace::RayDepths depths = noDepths();
        trace::traceHair(map.nearHair(0), map.projection(0), options, 1, rays.bundle,
                         depths);
        return std::vector<float>(depths.depth[0][0],
                                  depths.depth[0][0] + rays.rows() * kLanes);
    };
    std::vector<std::vector<float>> first;
    int met = 0;
    onEachTarget([&](const char* name) {
        INFO(name);
        Random same(4);
        for (std::size_t i = 0; i < 20; ++i) {
            const int receivers = i == 0 ? 16 : 1 + int(same.below(16));
            auto rays =
                raysAround(same, receivers, i == 0 ? 4 : 1 + int(i % 4), i % 3, true);
            test::Rays all = *rays;
            const std::vector<float> depths = traced(all);
            if (first.size() <= i) first.push_back(depths);
            CHECK(depths == first[i]);
            std::vector<int> some;  // every other one, backwards
            for (int receiver = receivers - 1; receiver >= 0; receiver -= 2)
                some.push_back(receiver);
            test::Rays few = rays->only(some);
            const std::vector<float> apart = traced(few);
            const std::size_t each = std::size_t(few.bundle.groups * kLanes);
            for (std::size_t k = 0; k < some.size(); ++k) {
                const auto from = depths.begin() + long(std::size_t(some[k]) * each);
                CHECK(
                    std::equal(from, from + long(each), apart.begin() + long(k * each)));
            }
            met += int(std::count_if(depths.begin(), depths.end(),
                                     [](float depth) { return depth > 0.0f; }));
        }
    });
    CHECK(met > 1000);
}

TEST_CASE("where more strands are close than there is room for, rays meet the same",
          "[trace][twin]") {
    Random random(99);
    for (int round = 0; round < 6; ++round) {
        INFO(round);
        const bool perspective = round & 1;
        const double unit = perFootprint(perspective);
        const double side = round % 3 ? 1.5 : 0.3, reach = round % 2 ? 0.02 : 0.6;
        std::vector<Segment> segments;
        for (int i = 0; i < 400 + 200 * round; ++i) {
            const glm::dvec3 at(random.in(32 - side, 32 + side),
                                random.in(32 - side, 32 + side),
                                random.in(25 - side, 25 + side) * unit);
            Segment s;
            for (glm::dvec3& p : s.end)
                p = onGrid(at + reach * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                                   random.in(-1, 1) * unit),
                           perspective);
            if (i % 9 != 0) s.end[0] = segments.back().end[1];  // joined
            for (int& half : s.half)
                half = int(random.below(256));
            s.opacity = 1 + int(random.below(30000));
            segments.push_back(s);
        }
        const ShadowMap map = mapOfSegments(segments, perspective);
        auto rays = std::make_unique<test::Rays>(16, 2);
        for (int receiver = 0; receiver < 16; ++receiver) {
            rays->setStart(receiver, {random.in(31, 33), random.in(31, 33),
                                      random.in(24, 26) * unit});
            for (int row = 2 * receiver; row < 2 * receiver + 2; ++row) {
                for (int lane = 0; lane < kLanes; ++lane)
                    rays->setDelta(
                        row, lane,
                        {random.in(-9, 9), random.in(-9, 9), random.in(12, 16) * unit});
            }
        }
        rays->bound();
        for (int receiver = 0; receiver < 16; ++receiver)
            rays->bundle.rise[receiver] = float(random.in(2, 12) * unit);
        const auto traced = [&](test::Rays& of) {
            trace::HairTraceOptions options;
            options.start = round % 3 ? 0.25f : 0.0f;
            trace::RayDepths depths = noDepths();
            trace::traceHair(map.nearHair(0), map.projection(0), options, 1, of.bundle,
                             depths);
            return std::vector<float>(depths.depth[0][0],
                                      depths.depth[0][0] + of.rows() * kLanes);
        };
        std::vector<float> first;
        onEachTarget([&](const char* name) {
            INFO(name);
            test::Rays all = *rays;
            const std::vector<float> depths = traced(all);
            if (first.empty()) first = depths;
            CHECK(depths == first);
            for (int receiver = 0; receiver < 16; ++receiver) {
                test::Rays one = rays->only({receiver});
                const std::vector<float> alone = traced(one);
                CHECK(std::equal(alone.begin(), alone.end(),
                                 depths.begin() + long(receiver) * long(alone.size())));
            }
        });
    }
}
