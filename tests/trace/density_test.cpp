// The fast trace of media against the definition, closed forms and brute force.
#include "trace/density_trace.h"

#include <tbb/task_arena.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <memory>
#include <random>
#include <tuple>

#include "map_fixture.h"
#include "trace/brute_force.h"
#include "trace/bundle_fixture.h"
#include "trace/each_target.h"
#include "trace/straight_rays.h"

using namespace mtsm;
using namespace mtsm::trace;
using test::mapOf;
using test::onEachTarget;
using test::Random;
using test::TestLayer;

namespace {

MapInfo mediaInfo(std::uint32_t side) {
    MapInfo info = test::plainInfo(side, side, 8);
    info.translucent = Translucent::media;
    return info;
}

Projection parallel(std::uint32_t width) {
    Projection p = test::plainProjection(width, width);
    p.kind = ProjectionKind::orthographic;
    p.scale = {width / 20.0, width / -20.0};
    return p;
}

/// One whose rays are answered by texels as coarse as they allow.
DensityTree treeOf(const ShadowMap& map, DensityOptions options = {}) {
    options.leastAcross = 1;
    auto tree = DensityTree::build(map, 0, options);
    REQUIRE(tree);
    return *std::move(tree);
}

/// What the definition's rays are given to the kernel with.
struct Asked {
    double apart =
        0.0;  ///< world units between the ends of neighbouring rays, times part
    ZBias bias;
    float darkDepth = 1e30f;
};

/// Rays of one start that follow one another are those of one receiver.
class Bundles {
  public:
    Bundles(const ShadowMap& map, const DensityTree& tree, const Asked& asked)
        : map_(map), tree_(tree), asked_(asked) {
        clear();
    }

    void add(const Ray& ray) {
        const test::StraightRay r = test::straighten(
            map_.projection(0), ray, test::nearestOf(map_, 0), asked_.apart);
        const bool fits = count_ > 0 && count_ < kLanes && r.start == last_.start &&
                          r.spread == last_.spread;
        if (!fits) {
            if (bundle_->receivers == kMostReceivers) trace();
            ++bundle_->receivers;
            count_ = 0;
        }
        last_ = r;
        // Receivers of few rays have them in different lanes.
        const int receiver = bundle_->receivers - 1;
        const int lane = (5 * receiver + count_++) % kLanes;
        test::put(*bundle_, receiver, 0, lane, r);
        places_.emplace_back(receiver, lane);
    }
    /// Of all rays that were added, in order.
    std::vector<std::array<double, 3>> visible() {
        trace();
        return visible_;
    }

  private:
    void clear() {
        *bundle_ = {};
        bundle_->groups = 1;
        places_.clear();
        count_ = 0;
    }
    void trace() {
        *depths_ = {};
        traceDensity(tree_, {asked_.bias, asked_.darkDepth}, *bundle_, *depths_);
        for (const auto& [receiver, lane] : places_) {
            std::array<double, 3> v;
            for (int c = 0; c < 3; ++c)
                v[c] = std::exp(-double(depths_->depth[c][receiver][lane]));
            visible_.push_back(v);
        }
        clear();
    }

    const ShadowMap& map_;
    const DensityTree& tree_;
    const Asked& asked_;
    std::unique_ptr<RayBundle> bundle_ = std::make_unique<RayBundle>();
    std::unique_ptr<RayDepths> depths_ = std::make_unique<RayDepths>();
    int count_ = 0;  // rays of the last receiver
    test::StraightRay last_;
    std::vector<std::pair<int, int>> places_;  // receiver, lane
    std::vector<std::array<double, 3>> visible_;
};

/// Visibility of each ray.
std::vector<std::array<double, 3>> traceAll(const ShadowMap& map, const DensityTree& tree,
                                            const std::vector<Ray>& rays,
                                            const Asked& asked = {}) {
    Bundles bundles(map, tree, asked);
    for (const Ray& ray : rays)
        bundles.add(ray);
    return bundles.visible();
}

/// Layers of everything that a map of media may hold: fine runs, single samples, walls,
/// runs that end dark.
std::vector<TestLayer> anyLayers(Random& random, bool single) {
    std::vector<TestLayer> layers;
    float z = float(random.in(2, 4)), v = 1.0f;
    while (z < 8.0f) {
        z += float(random.in(0.01, 1.5));
        const double kind = random.in(0, 1);
        const bool restart = kind < 0.1;
        v = restart ? 0.0f : v * float(random.in(0.3, 1.0));
        const bool alone = layers.empty() || kind < 0.06 || (single && kind < 0.6);
        layers.push_back({z, v, alone ? 1u : 5000u});
        if (restart) v = 1.0f;
    }
    return layers;
}

ShadowMap anyMap(const Projection& p, std::uint32_t side, bool single,
                 std::uint64_t seed) {
    Random random(seed);
    return mapOf(mediaInfo(side), p,
                 [&](auto, auto) { return anyLayers(random, single); });
}

/// From among the layers towards the eye, at slopes at which no stretch is capped; about
/// four from each start.
std::vector<Ray> anyRays(std::size_t count, std::uint64_t seed) {
    Random random(seed);
    std::vector<Ray> rays;
    glm::dvec3 origin(0.0);
    while (rays.size() < count) {
        Ray ray;
        if (rays.empty() || random.in(0, 1) < 0.25) {
            const double z = random.in(2.5, 9);
            origin = {random.in(-0.8, 0.8) * z, random.in(-0.8, 0.8) * z, -z};
        }
        ray.origin = origin;
        ray.delta = glm::dvec3(random.in(-1, 1), random.in(-1, 1), -1) - ray.origin;
        if (std::abs(ray.delta.z) < 0.2 * glm::length(ray.delta)) continue;
        ray.tBegin = random.in(0, 1) < 0.5 ? 0.0 : random.in(0.0, 0.2);
        ray.tSurfaces = random.in(0, 1) < 0.5 ? 0.0 : random.in(0.0, 0.3);
        rays.push_back(ray);
    }
    return rays;
}

/// In layers of `samples` samples: v = exp(-s (z - 2)) from depth 2 to 6.
std::vector<TestLayer> slabOf(double s, int samples, int layers) {
    std::vector<TestLayer> slab = {{2.0f, 1.0f, 1}};
    for (int i = 1; i <= layers; ++i) {
        const double z = 4.0 * i / layers;
        slab.push_back(
            {float(2 + z), float(std::exp(-s * z)), std::uint32_t(samples / layers)});
    }
    return slab;
}

/// Hairs of one pixel's width and a few pixels' length, each sample a quarter of the
/// light, at depths from 4 to 6.
ShadowMap hairMap(std::uint32_t side, int hairs) {
    Random random(11);
    std::vector<std::vector<std::pair<float, float>>> samples(side * side);
    for (int h = 0; h < hairs; ++h) {
        double x = random.in(0, side), y = random.in(0, side), z = random.in(4, 6);
        const double angle = random.in(0, 6.2831853), rise = random.in(-0.03, 0.03);
        for (int step = 0; step < 24; ++step) {
            if (x >= 0 && y >= 0 && x < side && y < side)
                samples[std::size_t(y) * side + std::size_t(x)].push_back(
                    {float(z), float(random.in(0.05, 0.4))});
            x += std::cos(angle);
            y += std::sin(angle);
            z += rise;
        }
    }
    return mapOf(mediaInfo(side), parallel(side), [&](std::uint32_t x, std::uint32_t y) {
        auto& here = samples[std::size_t(y) * side + x];
        std::sort(here.begin(), here.end());
        std::vector<TestLayer> layers;
        float v = 1.0f;
        for (const auto& [z, opacity] : here) {
            v *= 1.0f - opacity;
            layers.push_back({z, v, 1});
        }
        return layers;
    });
}

double worst(const std::vector<double>& errors, double share) {
    std::vector<double> sorted = errors;
    std::sort(sorted.begin(), sorted.end());
    return sorted[std::size_t(share * double(sorted.size() - 1))];
}

}  // namespace

TEST_CASE("single pixels answer as the definition does, ray by ray, on every processor",
          "[trace][twin]") {
    // What is rounded: a density by 1/256 of itself, depths of a run by a sample, the
    // ends of a way through a pixel by floats. So that a sample right at a pixel's border
    // may be met on the other side: hence not all rays.
    for (const bool perspective : {true, false}) {
        const Projection p = perspective ? test::plainProjection(40, 40) : parallel(40);
        const ShadowMap map = anyMap(p, 40, perspective, 3);
        const DensityTree tree = treeOf(map);
        const std::vector<Ray> rays = anyRays(1500, 4);
        for (const double bias : {0.0, 0.05}) {
            Asked asked;
            asked.bias = {bias, bias / 10};
            TraceOptions options;
            options.bias = asked.bias;
            onEachTarget([&](const char* target) {
                INFO(target);
                const auto visible = traceAll(map, tree, rays, asked);
                std::vector<double> errors;
                double mean = 0.0, lit = 0.0;
                for (std::size_t i = 0; i < rays.size(); ++i) {
                    const double exact = traceRay(map, rays[i], options)[0];
                    errors.push_back(std::abs(visible[i][0] - exact));
                    mean += (visible[i][0] - exact) / double(rays.size());
                    lit += exact / double(rays.size());
                }
                CHECK(worst(errors, 0.99) < 0.004);
                CHECK(std::abs(mean) < 0.0005);
                CHECK(lit > 0.05);
            });
        }
    }
}

TEST_CASE("hair met pixel by pixel is what brute force in long double finds",
          "[trace][twin]") {
    const ShadowMap map = hairMap(24, 60);
    const DensityTree tree = treeOf(map);
    Random random(5);
    std::vector<Ray> rays(160);
    for (Ray& ray : rays) {
        ray.origin = {random.in(-9, 9), random.in(-9, 9), random.in(-6, -5)};
        ray.delta = {random.in(-3, 3), random.in(-3, 3), 4};
    }
    const auto visible = traceAll(map, tree, rays);
    std::vector<double> errors;
    for (std::size_t i = 0; i < rays.size(); ++i)
        errors.push_back(std::abs(visible[i][0] - test::bruteForce(map, rays[i], {})));
    CHECK(worst(errors, 0.99) < 0.004);
}

TEST_CASE("a homogeneous slab gives exp(-s way) at any slant from texels of any size",
          "[trace][exact]") {
    const double s = 0.7;
    Projection parallelView = parallel(64);
    parallelView.scale = {8, -8};
    for (const Projection& p : {parallelView, test::plainProjection(64, 64)}) {
        const bool perspective = p.kind == ProjectionKind::perspective;
        for (const int layers : {256, 1}) {
            const ShadowMap map =
                mapOf(mediaInfo(64), p, [&](std::uint32_t x, std::uint32_t y) {
                    const glm::dvec3 c = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
                    return slabOf(s * (perspective ? glm::length(c) : 1.0), 4096, layers);
                });
            const DensityTree tree = treeOf(map);
            Random random(3);
            std::vector<Ray> rays;
            for (int i = 0; i < 320; ++i) {
                Ray ray;
                ray.origin = {random.in(-1, 1), random.in(-1, 1), -random.in(1.2, 7)};
                ray.delta =
                    glm::dvec3(random.in(-1, 1), random.in(-1, 1), -1) - ray.origin;
                rays.push_back(ray);
            }
            for (const double apart : {0.0, 0.1, 0.5, 4.0}) {
                Asked asked;
                asked.apart = apart;
                const auto visible = traceAll(map, tree, rays, asked);
                for (std::size_t i = 0; i < rays.size(); ++i) {
                    const double z = -rays[i].origin.z;
                    const double slant = glm::length(rays[i].delta) / (z - 1);
                    const double way = std::clamp(z - 2, 0.0, 4.0) * slant;
                    INFO("texels of " << apart << ", depth " << z << ", slant " << slant);
                    // A start within a slab, and one within those of coarser texels.
                    CHECK(std::abs(visible[i][0] - std::exp(-s * way)) <
                          0.006 * slant + 0.01 * std::min(apart, 1.0));
                }
            }
        }
    }
}

TEST_CASE("layers of few samples take at the mean depth what their samples take",
          "[trace][exact]") {
    // Samples at 10/3, 14/3, 6, and at 7.5, 9, each .3 deep.
    const ShadowMap map = mapOf(mediaInfo(8), parallel(8), [](auto, auto) {
        return std::vector<TestLayer>{
            {2.0f, 1.0f, 1}, {6.0f, std::exp(-0.9f), 3}, {9.0f, std::exp(-1.5f), 2}};
    });
    std::vector<Ray> rays;
    constexpr int kStarts = 1000;
    for (int i = 0; i < kStarts; ++i) {
        const double z = 1.0 + 10.0 * (i + 0.5) / kStarts;
        rays.push_back({{0.5, 0.5, -z}, {0, 0, z - 0.5}});
    }
    double mean = 0.0, expected = 0.0;
    for (const auto& visible : traceAll(map, treeOf(map), rays))
        mean -= std::log(visible[0]) / kStarts;
    for (const double z : {10.0 / 3, 14.0 / 3, 6.0, 7.5, 9.0})
        expected += 0.3 * (11.0 - z) / 10.0;
    CHECK(mean == Approx(expected).margin(0.004));  // densities are rounded by 1/256
}

TEST_CASE("a layer as far away as floats go leaves the others as they are",
          "[trace][exact]") {
    Projection view = parallel(64);
    view.scale = {8, -8};
    for (const float z : {1e30f, 2e38f, std::numeric_limits<float>::max()}) {
        const ShadowMap map =
            mapOf(mediaInfo(64), view, [&](std::uint32_t x, std::uint32_t y) {
                std::vector<TestLayer> layers = slabOf(0.7, 4096, 1);
                if (x == 20 && y == 30) layers.push_back({z, 0.0f, 1});
                return layers;
            });
        const Ray up{{0.5, -0.5, -7}, {0, 0, 6}};
        const auto visible = traceAll(map, treeOf(map), {up}, {});
        CHECK(std::abs(visible[0][0] - std::exp(-0.7 * 4.0)) < 0.006);
    }
}

TEST_CASE("coarse texels keep the mean over a light, and few texels are read",
          "[trace][statistical]") {
    // Fur in a box, a light of a fifth of its distance. The definition with the same rays
    // is the truth; so errors are those of texels alone.
    const std::uint32_t side = 256;
    const ShadowMap map = hairMap(side, 12000);
    const DensityTree tree = treeOf(map);
    Random random(8);
    double mean = 0.0, bias = 0.0, apartFromOne = 0.0;
    const int points = 60, lights = 64;
    for (int k = 0; k < points; ++k) {
        const glm::dvec3 point(random.in(-7, 7), random.in(-7, 7), -random.in(5, 8));
        std::vector<Ray> rays;
        for (int i = 0; i < lights; ++i) {
            Ray ray;
            ray.origin = point;
            const glm::dvec2 at((i % 8 + random.in(0, 1)) / 8 - 0.5,
                                (i / 8 + random.in(0, 1)) / 8 - 0.5);
            ray.delta = glm::dvec3(4.0 * at, 0.0) - glm::dvec3(0, 0, point.z);
            ray.tBegin = 0.02;
            rays.push_back(ray);
        }
        Asked asked;
        asked.apart = 4.0 / 8;
        const auto visible = traceAll(map, tree, rays, asked);
        double found = 0.0, exact = 0.0;
        for (int i = 0; i < lights; ++i) {
            found += visible[std::size_t(i)][0] / lights;
            exact += double(traceRay(map, rays[std::size_t(i)], {})[0]) / lights;
        }
        mean += std::abs(found - exact) / points;
        bias += (found - exact) / points;
        apartFromOne += (1 - exact) / points;
    }
    CHECK(apartFromOne > 0.3);
    CHECK(mean < 0.01);
    CHECK(std::abs(bias) < 0.004);
}

TEST_CASE("surfaces in a map of media block within the bias and from their own begin on",
          "[trace][exact]") {
    const ShadowMap map = mapOf(mediaInfo(16), parallel(16), [](auto, auto) {
        return std::vector<TestLayer>{{3.0f, 0.5f, 1}, {5.0f, 0.0f, 1}, {6.0f, 0.5f, 1}};
    });
    const DensityTree tree = treeOf(map);
    Asked asked;
    asked.bias = {0.1, 0.0};
    const auto from = [&](double z, double distance, double apart) {
        Ray ray;
        ray.origin = {0.1, 0.1, -z};
        ray.delta = {0, 0, z - 1};
        ray.tSurfaces = distance / (z - 1);
        asked.apart = apart;
        return traceAll(map, tree, {ray}, asked)[0][0];
    };
    for (const double apart : {0.0, 3.0}) {
        INFO(apart);
        CHECK(from(5.4, 0.0, apart) == Approx(0.0).margin(1e-6));
        CHECK(from(5.4, 0.7, apart) == Approx(0.5).epsilon(0.003));
        CHECK(from(6.5, 0.7, apart) == Approx(0.0).margin(1e-6));
        CHECK(from(6.5, 1.7, apart) == Approx(0.25).epsilon(0.003));
        CHECK(from(4.85, 0.0, apart) == Approx(0.5).epsilon(0.003));
    }
    // Parallel to the wall, within the bias of it and not.
    for (const double z : {4.85, 4.95, 5.05, 5.15}) {
        Ray ray;
        ray.origin = {-5, 0.1, -z};
        ray.delta = {9, 0.3, 0};
        asked.apart = 0;
        CHECK(traceAll(map, tree, {ray}, asked)[0][0] ==
              Approx(std::abs(z - 5) < 0.1 ? 0.0 : 1.0).margin(1e-6));
    }
}

TEST_CASE("a texel that is half covered by surfaces lets half of the light through",
          "[trace][exact]") {
    const ShadowMap map =
        mapOf(mediaInfo(32), parallel(32), [](std::uint32_t x, std::uint32_t y) {
            return (x + y) % 2 ? std::vector<TestLayer>{{5.0f, 0.0f, 1}}
                               : std::vector<TestLayer>{};
        });
    const DensityTree tree = treeOf(map);
    for (std::size_t level = 1; level < tree.sheets().levels.size(); ++level) {
        Ray ray;
        ray.origin = {0.1, 0.1, -6};
        ray.delta = {0, 0, 5};
        Asked asked;
        asked.apart = std::ldexp(parallel(32).pixelFootprint(1), int(level) + 5);
        CHECK(traceAll(map, tree, {ray}, asked)[0][0] == Approx(0.5).epsilon(0.003));
    }
}

TEST_CASE("what is dark takes nothing from what lets light through beside it",
          "[trace][exact]") {
    // A quarter is dark, a quarter clear, half lets half through: beside what is dark, as
    // at the edge of a strand, or far from it.
    const float z = GENERATE(5.0f, 5.05f, 2.0f);
    const ShadowMap map =
        mapOf(mediaInfo(32), parallel(32), [&](std::uint32_t x, std::uint32_t y) {
            if (x % 2 && y % 2) return std::vector<TestLayer>{{5.0f, 0.0f, 1}};
            if (x % 2 || y % 2) return std::vector<TestLayer>{{z, 0.5f, 1}};
            return std::vector<TestLayer>{};
        });
    const bool close = z > 4.0f;
    for (const std::uint32_t finest : {0u, 1u, 2u}) {
        DensityOptions options;
        options.finest = finest;
        const DensityTree tree = treeOf(map, options);
        for (std::size_t level = std::max(finest, 1u); level < tree.media().levels.size();
             ++level) {
            Ray ray;
            ray.origin = {0.1, 0.1, -6};
            ray.delta = {0, 0, 5.5};
            Asked asked;
            asked.apart = std::ldexp(parallel(32).pixelFootprint(1), int(level) + 5);
            // Where they are far apart each is taken to be independent of the other.
            const double lit = close ? 0.5 : 0.75 * 0.75;
            CHECK(traceAll(map, tree, {ray}, asked)[0][0] == Approx(lit).epsilon(0.006));
        }
    }
}

TEST_CASE("what a ray meets does not depend on which rays share its bundle",
          "[trace][exact]") {
    const ShadowMap map = anyMap(test::plainProjection(40, 40), 40, true, 3);
    const DensityTree tree = treeOf(map);
    const std::vector<Ray> rays = anyRays(64, 9);
    for (const double apart : {0.0, 0.6}) {
        Asked asked;
        asked.apart = apart;
        asked.darkDepth = 3.0f;
        const auto together = traceAll(map, tree, rays, asked);
        for (std::size_t i = 0; i < rays.size(); ++i)
            CHECK(traceAll(map, tree, {rays[i]}, asked)[0] == together[i]);
    }
}

TEST_CASE("a hull that meets nothing has no rays that lose light", "[trace][twin]") {
    int free = 0, met = 0;
    for (const bool sheets : {false, true}) {
        for (const bool perspective : {false, true}) {
            const std::uint32_t side = 64;
            const Projection p =
                perspective ? test::plainProjection(side, side) : parallel(side);
            MapInfo info = mediaInfo(side);
            if (sheets) info.translucent = Translucent::sheets;
            Random random(41);
            // Clumps with much room between them, walls among them.
            const ShadowMap map = mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
                std::vector<TestLayer> layers;
                const std::uint32_t clump = (x / 8 + 3 * (y / 8)) % 7;
                if (clump > 2) return layers;
                const auto z = float(3.0 + clump + random.in(0, 0.3));
                layers.push_back({z, clump == 2 ? 0.0f : 0.6f, 1});
                if (clump == 1) layers.push_back({z + 0.2f, 0.3f, 60});
                return layers;
            });
            const DensityTree tree = treeOf(map);
            Asked asked;
            asked.bias = {0.01, 2e-3};
            for (int round = 0; round < 600; ++round) {
                asked.apart = round % 3 ? std::exp2(random.in(-6, 0)) : 0.0;
                const double z = random.in(4, 9), size = std::exp2(random.in(-5, -1));
                const glm::dvec3 at(random.in(-0.9, 0.9) * z, random.in(-0.9, 0.9) * z,
                                    -z);
                const glm::dvec3 light(random.in(-0.4, 0.4), random.in(-0.4, 0.4), 0.0);
                std::vector<Ray> rays;
                trace::RayHull hull{};
                for (int i = 0; i < 24; ++i) {
                    Ray ray;
                    ray.origin =
                        at + size * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                               random.in(-1, 1));
                    const glm::dvec3 end =
                        light + 0.2 * glm::dvec3(random.in(-1, 1), random.in(-1, 1), 0.0);
                    // Parallel rays end above the window, not in one point.
                    ray.delta = perspective ? end - ray.origin
                                            : z * glm::dvec3(end.x / 4, end.y / 4, 1.0);
                    rays.push_back(ray);
                    const test::StraightRay r =
                        test::straighten(p, ray, test::nearestOf(map, 0), asked.apart);
                    const auto include = [i](float& low, float& high, double x) {
                        low = i ? std::min(low, float(x)) : float(x);
                        high = i ? std::max(high, float(x)) : float(x);
                    };
                    include(hull.uLow, hull.uHigh, r.start.x);
                    include(hull.vLow, hull.vHigh, r.start.y);
                    include(hull.wLow, hull.wHigh, r.start.z);
                    include(hull.slopeLowU, hull.slopeHighU, r.delta.x / r.delta.z);
                    include(hull.slopeLowV, hull.slopeHighV, r.delta.y / r.delta.z);
                    hull.spread = std::max(hull.spread, float(r.spread));
                }
                hull.uLow -= 1e-3f, hull.uHigh += 1e-3f;
                hull.vLow -= 1e-3f, hull.vHigh += 1e-3f;
                hull.wFirst = hull.wLow;
                const bool may =
                    trace::mayMeet(tree, {asked.bias, asked.darkDepth}, hull);
                ++(may ? met : free);
                if (may) continue;
                for (const auto& v : traceAll(map, tree, rays, asked))
                    CHECK(v[0] == 1.0);
            }
        }
    }
    CHECK(free > 300);
    CHECK(met > 300);
}

TEST_CASE(
    "rows add to their depths; rays that are closed meet nothing and dark ones "
    "are closed",
    "[trace]") {
    const ShadowMap map = mapOf(mediaInfo(16), parallel(16), [](std::uint32_t x, auto) {
        return std::vector<TestLayer>{{3.0f, x < 8 ? 0.5f : 1e-4f, 1}};
    });
    const DensityTree tree = treeOf(map);
    const auto bundle = std::make_unique<RayBundle>();
    const auto depths = std::make_unique<RayDepths>();
    *bundle = {};
    *depths = {};
    bundle->receivers = kMostReceivers;
    bundle->groups = 3;
    const auto thin = [](int receiver) { return -9.0 + receiver * 1.2 < 0; };
    for (int receiver = 0; receiver < kMostReceivers; ++receiver) {
        Ray ray;
        ray.origin = {-9.0 + receiver * 1.2, 0.1, -4};
        ray.delta = {0, 0, 2};
        const test::StraightRay r =
            test::straighten(map.projection(0), ray, test::nearestOf(map, 0));
        for (int group = 0; group < 3; ++group) {
            for (int lane = 0; lane < kLanes; ++lane) {
                test::put(*bundle, receiver, group, lane, r);
                depths->depth[0][bundle->row(receiver, group)][lane] = float(group);
            }
        }
        bundle->open[bundle->row(receiver, 1)] = 0x0f0f;
    }
    traceDensity(tree, {{}, 6.0f}, *bundle, *depths);
    for (int row = 0; row < kMostReceivers * 3; ++row) {
        const int receiver = row / 3, group = row % 3;
        for (int lane = 0; lane < kLanes; ++lane) {
            const bool open = group != 1 || (0x0f0f >> lane & 1);
            const double met = -std::log(thin(receiver) ? 0.5 : 1e-4);
            INFO("receiver " << receiver << ", group " << group << ", lane " << lane);
            CHECK(depths->depth[0][row][lane] ==
                  Approx(group + (open ? met : 0)).epsilon(0.0005));
            CHECK((bundle->open[row] >> lane & 1) == (open && thin(receiver) ? 1 : 0));
        }
    }
}

TEST_CASE("three channels are met as three maps of one channel are", "[trace][twin]") {
    Random random(21);
    const std::uint32_t side = 16;
    MapInfo info = mediaInfo(side);
    std::vector<std::vector<TestLayer>> layers[3];
    for (std::uint32_t i = 0; i < side * side; ++i) {
        const std::vector<TestLayer> red = anyLayers(random, false);
        for (auto& channel : layers) {
            channel.push_back(red);
            for (TestLayer& layer : channel.back())
                layer.v = std::pow(layer.v, float(random.in(0.5, 2)));
            // Visibility falls.
            float before = 1.0f;
            for (TestLayer& layer : channel.back()) {
                layer.v = std::min(layer.v, before);
                before = layer.v > 0.0f ? layer.v : 1.0f;
            }
        }
    }
    const Projection p = test::plainProjection(side, side);
    std::vector<MapFace> faces(1);
    faces[0].projection = p;
    for (std::uint32_t tile = 0; tile < 4; ++tile) {
        Tile t;
        t.begin.push_back(0);
        std::vector<float> v[3];
        for (std::uint32_t i = 0; i < 64; ++i) {
            const std::uint32_t pixel =
                (tile / 2 * 8 + i / 8) * side + tile % 2 * 8 + i % 8;
            for (std::size_t k = 0; k < layers[0][pixel].size(); ++k) {
                t.z.push_back(layers[0][pixel][k].z);
                t.n.push_back(layers[0][pixel][k].n);
                for (int c = 0; c < 3; ++c)
                    v[c].push_back(layers[c][pixel][k].v);
            }
            t.begin.push_back(std::uint32_t(t.z.size()));
        }
        for (const auto& plane : v)
            t.v.insert(t.v.end(), plane.begin(), plane.end());
        faces[0].tiles.push_back(std::move(t));
    }
    info.channels = 3;
    auto coloured = ShadowMap::create(info, std::move(faces));
    REQUIRE(coloured);
    const DensityTree tree = treeOf(*coloured);
    const std::vector<Ray> rays = anyRays(160, 22);
    onEachTarget([&](const char* target) {
        INFO(target);
        const auto visible = traceAll(*coloured, tree, rays);
        for (std::size_t c = 0; c < 3; ++c) {
            const ShadowMap one = mapOf(mediaInfo(side), p, [&](auto x, auto y) {
                return layers[c][y * side + x];
            });
            const auto alone = traceAll(one, treeOf(one), rays);
            for (std::size_t i = 0; i < rays.size(); ++i)
                CHECK(visible[i][c] == Approx(alone[i][0]).margin(0.004));
        }
    });
}

TEST_CASE("no bundle makes the kernel hang or answer with what is no number",
          "[trace][extreme]") {
    Random random(31);
    std::vector<ShadowMap> maps;
    maps.push_back(anyMap(test::plainProjection(33, 33), 33, true, 3));
    maps.push_back(anyMap(parallel(33), 33, false, 3));
    // Depths from 1e-6 to 1e9 in one pixel.
    maps.push_back(mapOf(mediaInfo(16), test::plainProjection(16, 16), [](auto, auto) {
        std::vector<TestLayer> layers;
        for (double z = 1e-6; z < 2e9; z *= 10)
            layers.push_back(
                {float(z), float(1e-3 / (z + 1e-3)), layers.empty() ? 1u : 7u});
        return layers;
    }));
    maps.push_back(mapOf(mediaInfo(16), test::plainProjection(16, 16), [](auto, auto) {
        return std::vector<TestLayer>{{3e38f, 0.5f, 1}, {3.3e38f, 0.0f, 9}};
    }));
    std::mt19937_64 bits(77);
    const float odd[] = {0.0f,   -0.0f,  1.0f,  -1.0f,  0.5f,     16.0f,     1e-30f,
                         1e30f,  -1e30f, 1e38f, -1e38f, INFINITY, -INFINITY, NAN,
                         1e-45f, 33.0f,  8.0f,  -0.25f, 1e-6f,    1e9f};
    const auto number = [&] {
        if (bits() % 3 == 0) return float(random.in(-1, 40));
        return odd[bits() % std::size(odd)];
    };
    const auto bundle = std::make_unique<RayBundle>();
    const auto depths = std::make_unique<RayDepths>();
    bundle->receivers = kMostReceivers;
    bundle->groups = 2;
    constexpr int kRows = 2 * kMostReceivers;
    for (const ShadowMap& map : maps) {
        const DensityTree tree = treeOf(map);
        onEachTarget([&](const char* target) {
            INFO(target);
            for (int round = 0; round < 40; ++round) {
                *depths = {};
                for (int receiver = 0; receiver < bundle->receivers; ++receiver) {
                    bundle->u[receiver] = number();
                    bundle->v[receiver] = number();
                    bundle->w[receiver] = number();
                    bundle->spread[receiver] = number();
                }
                for (int row = 0; row < kRows; ++row) {
                    for (int i = 0; i < kLanes; ++i) {
                        bundle->du[row][i] = number();
                        bundle->dv[row][i] = number();
                        bundle->dw[row][i] = number();
                        bundle->begin[row][i] = bits() % 2 ? 0.0f : number();
                        bundle->beginSurfaces[row][i] = bits() % 2 ? 0.0f : number();
                    }
                    bundle->open[row] = std::uint16_t(bits() % 4 ? 0xffff : bits());
                }
                traceDensity(tree, {{0.01, 1e-3}, 6.9f}, *bundle, *depths);
                for (int row = 0; row < kRows; ++row) {
                    for (int i = 0; i < kLanes; ++i)
                        REQUIRE((std::isfinite(depths->depth[0][row][i]) &&
                                 depths->depth[0][row][i] >= 0.0f));
                }
            }
        });
    }
}

TEST_CASE("a density tree is the same for any number of threads", "[trace]") {
    const ShadowMap map = anyMap(test::plainProjection(100, 100), 100, true, 3);
    const DensityTree many = treeOf(map);
    tbb::task_arena(1).execute([&] {
        const DensityTree one = treeOf(map);
        for (const auto pyramid : {&DensityTree::media, &DensityTree::sheets}) {
            const auto& a = (many.*pyramid)().levels;
            const auto& b = (one.*pyramid)().levels;
            REQUIRE(a.size() == b.size());
            for (std::size_t i = 0; i < a.size(); ++i) {
                CHECK(a[i].slabs == b[i].slabs);
                REQUIRE(a[i].texels.size() == b[i].texels.size());
                bool same = true;
                for (std::size_t t = 0; t < a[i].texels.size(); ++t) {
                    const DensityTexel &x = a[i].texels[t], &y = b[i].texels[t];
                    same = same && x.range == y.range && x.begin == y.begin;
                }
                CHECK(same);
            }
        }
    });
}

TEST_CASE("levels above those left out are the same as with them", "[trace]") {
    Random random(21);
    for (const Translucent rule : {Translucent::media, Translucent::sheets}) {
        MapInfo info = mediaInfo(37);  // odd: some texels have fewer children
        info.translucent = rule;
        const ShadowMap map = mapOf(info, test::plainProjection(37, 37),
                                    [&](auto, auto) { return anyLayers(random, true); });
        const DensityTree whole = treeOf(map);
        for (const std::uint32_t finest : {1u, 2u}) {
            DensityOptions options;
            options.finest = finest;
            const DensityTree tree = treeOf(map, options);
            for (const auto pyramid : {&DensityTree::media, &DensityTree::sheets}) {
                const auto& a = (tree.*pyramid)().levels;
                const auto& b = (whole.*pyramid)().levels;
                REQUIRE(a.size() == b.size());
                for (std::size_t i = 0; i < a.size(); ++i) {
                    if (i >= finest)
                        CHECK(a[i].slabs == b[i].slabs);
                    else
                        CHECK((a[i].slabs.empty() && a[i].texels.empty()));
                }
            }
        }
    }
}

TEST_CASE("levels below the finest asked for are left out", "[trace]") {
    const ShadowMap map = hairMap(64, 2000);
    DensityOptions options;
    options.finest = 2;
    const DensityTree tree = treeOf(map, options), whole = treeOf(map);
    CHECK(tree.memoryBytes() < whole.memoryBytes() / 4);
    // Rays that would read level 2 at the least find the same.
    Random random(2);
    std::vector<Ray> rays(64);
    for (Ray& ray : rays) {
        ray.origin = {random.in(-9, 9), random.in(-9, 9), -30};
        ray.delta = {random.in(-1, 1), random.in(-1, 1), 29};
    }
    Asked asked;
    asked.apart = 8.0 * map.projection(0).pixelFootprint(1);
    CHECK(traceAll(map, tree, rays, asked) == traceAll(map, whole, rays, asked));
    // However few levels there are.
    options.finest = 100;
    CHECK(treeOf(map, options).media().levels.size() == whole.media().levels.size());
}

TEST_CASE("sheets without a bias are met as the definition meets them", "[trace][twin]") {
    for (const bool perspective : {true, false}) {
        const Projection p = perspective ? test::plainProjection(40, 40) : parallel(40);
        MapInfo info = mediaInfo(40);
        info.translucent = Translucent::sheets;
        Random random(13);
        const ShadowMap map =
            mapOf(info, p, [&](auto, auto) { return anyLayers(random, true); });
        const DensityTree tree = treeOf(map);
        std::vector<Ray> rays = anyRays(800, 14);
        for (Ray& ray : rays)
            ray.tSurfaces = ray.tBegin;
        onEachTarget([&](const char* target) {
            INFO(target);
            const auto visible = traceAll(map, tree, rays);
            std::vector<double> errors;
            for (std::size_t i = 0; i < rays.size(); ++i)
                errors.push_back(std::abs(visible[i][0] - traceRay(map, rays[i], {})[0]));
            CHECK(worst(errors, 0.99) < 0.004);
        });
    }
}

TEST_CASE("a tilted sheet is paid for once, from texels of any size", "[trace][exact]") {
    // Three of opacity 1/2, then 1, at slopes up to about one, met within a pixel's
    // footprint.
    const std::uint32_t side = 128;
    bool perspective;
    float through;
    std::tie(perspective, through) = GENERATE(
        table<bool, float>({{false, 0.5f}, {true, 0.5f}, {false, 0.0f}, {true, 0.0f}}));
    const double left = through * through * through;
    Projection p = perspective ? test::plainProjection(side, side) : parallel(side);
    if (perspective) p.scale *= 4.0;
    MapInfo info = mediaInfo(side);
    info.translucent = Translucent::sheets;
    const auto depthOf = [&](double tilt, double z, std::uint32_t x, std::uint32_t y) {
        const glm::dvec3 c = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
        // z = depth + tilt (x + y / 2) of light space.
        const double across = tilt * (c.x + c.y / 2);
        return float(perspective ? z / (1 - across) : z + across);
    };
    const ShadowMap map = mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
        float z[] = {depthOf(0.2, 20, x, y), depthOf(-0.7, 40, x, y),
                     depthOf(0.9, 60, x, y)};
        std::sort(std::begin(z), std::end(z));
        return std::vector<TestLayer>{
            {z[0], through, 1}, {z[1], through * through, 1}, {z[2], float(left), 1}};
    });
    const DensityTree tree = treeOf(map);
    const double footprint = p.pixelFootprint(1.0);
    Asked asked;
    asked.bias = perspective ? ZBias{0.0, footprint} : ZBias{footprint, 0.0};
    Random random(6);
    std::vector<Ray> rays(400);
    for (Ray& ray : rays) {
        const double reach = perspective ? 5 : 4;
        ray.origin = {random.in(-reach, reach), random.in(-reach, reach), -100};
        ray.delta = glm::dvec3(random.in(-1, 1), random.in(-1, 1), -1) *
                        glm::dvec3(reach / 5, reach / 5, 1) -
                    ray.origin;
    }
    for (const double apart : {0.0, 0.5, 2.0}) {
        asked.apart = apart;
        const auto visible = traceAll(map, tree, rays, asked);
        std::size_t once = 0;
        double mean = 0.0;
        for (const auto& v : visible) {
            once += std::abs(v[0] - left) < 0.002;
            mean += v[0] / double(visible.size());
        }
        INFO((perspective ? "perspective" : "parallel")
             << ", each lets through " << through << ", texels of " << apart);
        CHECK(double(once) >= 0.97 * double(visible.size()));
        // Where texels grow a ray may pass between the depths of two levels.
        CHECK(std::abs(mean - left) < 0.002);
    }
}

TEST_CASE("steep dark cards stop rays at any slant, from texels of any size", "[trace]") {
    const std::uint32_t side = 128;
    const Projection p = parallel(side);
    MapInfo info = mediaInfo(side);
    info.translucent = Translucent::sheets;
    for (const double slope : {-3.0, -2.0, -1.5, 1.5, 2.0, 3.0}) {
        const ShadowMap map = mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
            const glm::dvec3 c = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
            return std::vector<TestLayer>{{float(50 + slope * c.x), 0.0f, 1}};
        });
        const DensityTree tree = treeOf(map);
        Asked asked;
        asked.bias = {p.pixelFootprint(1.0), 0.0};
        Random random(6);
        std::vector<Ray> rays(400);
        for (Ray& ray : rays) {
            ray.origin = {random.in(-4, 4), random.in(-4, 4), -100};
            ray.delta = glm::dvec3(random.in(-4, 4), random.in(-4, 4), -1) - ray.origin;
        }
        for (const double apart : {0.5, 2.0, 8.0}) {
            asked.apart = apart;
            double mean = 0.0;
            for (const auto& v : traceAll(map, tree, rays, asked))
                mean += v[0] / double(rays.size());
            INFO("slope " << slope << ", texels of " << apart);
            CHECK(mean <= 0.01);  // rays that pass between two steps of slope 3
        }
    }
}

TEST_CASE("what is dark blocks a ray that has just paid for a neighbour",
          "[trace][exact]") {
    // Half a pixel of a card, then its inside: at one depth, or nearly.
    MapInfo info = mediaInfo(32);
    for (const Translucent kind : {Translucent::sheets, Translucent::media}) {
        info.translucent = kind;
        const ShadowMap map = mapOf(info, parallel(32), [](std::uint32_t x, auto) {
            return x < 16 ? std::vector<TestLayer>{{5.0f, 0.5f, 1}}
                          : std::vector<TestLayer>{{4.9f, 0.0f, 1}};
        });
        const DensityTree tree = treeOf(map);
        Asked asked;
        asked.bias = {0.3, 0.0};
        Ray ray;  // meets the left half at its border
        ray.origin = {-0.4, 0.1, -5.4};
        ray.delta = {4.0, 0.0, 4.0};
        CHECK(traceAll(map, tree, {ray}, asked)[0][0] == Approx(0.0).margin(1e-6));
    }
}

TEST_CASE("an empty map has an empty density tree", "[trace]") {
    const ShadowMap map = mapOf(mediaInfo(8), parallel(8),
                                [](auto, auto) { return std::vector<TestLayer>{}; });
    const DensityTree tree = treeOf(map);
    CHECK(tree.media().empty());
    CHECK(tree.sheets().empty());
    Ray ray;
    ray.origin = {0, 0, -5};
    ray.delta = {0, 0, 4};
    CHECK(traceAll(map, tree, {ray})[0][0] == 1.0);
}

TEST_CASE("what a ray leaves of the light is exp(-depth) or nothing, on every processor",
          "[trace][exact]") {
    const float threshold = 1.0f / 1024;
    const float some[] = {0.0f, 1e-30f, 1e-3f, 0.5f, 3.0f, 6.9f, 7.0f, kDarkDepth};
    std::uint16_t followed[2] = {0x00ff, 0}, clear[2] = {0x0300, 0x8001};
    onEachTarget([&](const char* target) {
        INFO(target);
        const auto depths = std::make_unique<RayDepths>();
        for (int row = 0; row < 2; ++row) {
            for (int i = 0; i < kLanes; ++i)
                depths->depth[0][row][i] = some[i % 8];
        }
        seeThrough(2, 1, threshold, followed, clear, *depths);
        for (int i = 0; i < kLanes; ++i) {
            const double left = std::exp(-double(some[i % 8]));
            const double expected = i >= 8             ? double(i < 10)
                                    : left > threshold ? left
                                                       : 0.0;
            CHECK(std::abs(depths->depth[0][0][i] - expected) <= 0x1p-22 * expected);
            CHECK(depths->depth[0][1][i] == float(i == 0 || i == 15));
        }
        CHECK(depths->depth[0][0][0] == 1.0f);  // what meets nothing is lit
    });
}
