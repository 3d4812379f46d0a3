// A caller's rays, many at once: as the definition has them, each for itself, whatever
// its way and whatever is asked beside it.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <numeric>
#include <random>
#include <vector>

#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "random.h"

using namespace mtsm;
using test::cubeProjections;
using test::mapOf;
using test::plainProjection;
using test::Random;
using test::TestLayer;

namespace {

ShadowRay rayFrom(glm::dvec3 from, glm::dvec3 to) {
    const double length = glm::length(to - from);
    return {from, length > 0.0 ? (to - from) / length : glm::dvec3(0, 1, 0), length};
}

/// Homogeneous fog of extinction s between depths 1 and 5, 512 samples.
std::vector<TestLayer> fogOf(double s) {
    std::vector<TestLayer> layers = {{1.0f, 1.0f, 1}};
    for (int i = 1; i <= 32; ++i)
        layers.push_back({1.0f + float(i) / 8, float(std::exp(-s * i / 8)), 16});
    return layers;
}

constexpr double kThick = 0.3;

ShadowMap fogMap(const std::vector<Projection>& views, std::uint32_t width) {
    MapInfo info = test::plainInfo(width, width, 16);
    info.translucent = Translucent::media;
    return mapOf(info, views, [&](std::uint32_t f, std::uint32_t x, std::uint32_t y) {
        const glm::dvec3 c = views[f].lightFromRaster({x + 0.5, y + 0.5}, 1.0);
        const bool perspective = views[f].kind == ProjectionKind::perspective;
        return fogOf(perspective ? kThick * glm::length(c) : kThick);
    });
}

/// 4 pixels to a unit, from -8 to 8.
Projection flatProjection() {
    Projection p = plainProjection(64, 64);
    p.kind = ProjectionKind::orthographic;
    p.scale = {4.0, -4.0};
    return p;
}

/// Balls of one colour in front of nothing, opaque: a ball of radius r at depth z has its
/// front side as layers.
ShadowMap ballsMap(std::uint32_t width) {
    MapInfo info = test::plainInfo(width, width, 16);
    info.biasPerDepth = 2.0f / float(width);
    const Projection p = plainProjection(width, width);
    return mapOf(info, p, [&](std::uint32_t x, std::uint32_t y) {
        const glm::dvec3 d = p.lightFromRaster({x + 0.5, y + 0.5}, 1.0);
        std::vector<TestLayer> layers;
        for (const glm::dvec3 c : {glm::dvec3(0.5, 0.3, 3), glm::dvec3(-0.9, -0.4, 4)}) {
            const double dd = glm::dot(d, d), dc = glm::dot(d, c);
            const double root = dc * dc - dd * (glm::dot(c, c) - 0.49);
            if (root < 0.0) continue;
            for (const double side : {-1.0, 1.0})
                layers.push_back({float((dc + side * std::sqrt(root)) / dd), 0.0f, 1});
        }
        std::sort(layers.begin(), layers.end(),
                  [](const TestLayer& a, const TestLayer& b) { return a.z < b.z; });
        return layers;
    });
}

std::vector<float> answers(const ShadowMap& map, const std::vector<ShadowRay>& rays,
                           const RayOptions& options = {}) {
    std::vector<float> out(rays.size(), -1.0f);
    visibilities(map, rays.data(), rays.size(), out.data(), options);
    return out;
}

RayOptions scalar() {
    RayOptions options;
    options.method = ShadowMethod::scalar;
    return options;
}

/// Of any way and length, in runs of one origin and not; some that are no rays at all.
std::vector<ShadowRay> anyRays(Random& random, int count) {
    std::vector<ShadowRay> rays;
    while (int(rays.size()) < count) {
        const glm::dvec3 origin = random.within(7.0);
        const std::size_t run = random.below(4) == 0 ? 1 + random.below(70) : 1;
        for (std::size_t i = 0; i < run; ++i)
            rays.push_back(rayFrom(origin, random.within(7.0)));
    }
    for (std::size_t i = 0; i < rays.size(); i += 7)
        rays[i].length = INFINITY;
    for (std::size_t i = 3; i < rays.size(); i += 50) {
        rays[i].direction = glm::dvec3(0.0);
        rays[i].direction[int(i % 3)] = i % 4 < 2 ? 1.0 : -1.0;  // along an axis
    }
    for (std::size_t i = 9; i < rays.size(); i += 40) {
        rays[i].direction.z = 1e-9 * rays[i].direction.z;  // level
        rays[i].direction = glm::normalize(rays[i].direction);
    }
    rays[11].origin.y = NAN;
    rays[12].length = NAN;
    rays[13].length = 0.0;
    rays[14].direction = glm::dvec3(0.0);
    rays[15].origin *= 1e12;
    rays[16].origin = glm::dvec3(0.0);
    return rays;
}

}  // namespace

TEST_CASE("rays of any way through fog are as the definition has them",
          "[shadow][twin]") {
    Random random(1);
    const ShadowMap maps[] = {fogMap({plainProjection(48, 48)}, 48),
                              fogMap({flatProjection()}, 64),
                              fogMap(cubeProjections(32), 32)};
    for (const ShadowMap& map : maps) {
        const std::vector<ShadowRay> rays = anyRays(random, 3000);
        const std::vector<float> found = answers(map, rays);
        const std::vector<float> expected = answers(map, rays, scalar());
        for (std::size_t i = 0; i < rays.size(); ++i) {
            INFO("faces " << map.faceCount() << " ray " << i << " from "
                          << rays[i].origin.x << " " << rays[i].origin.y << " "
                          << rays[i].origin.z << " along " << rays[i].direction.x << " "
                          << rays[i].direction.y << " " << rays[i].direction.z << " "
                          << rays[i].length);
            // Samples are spread over their layers, and count for more the less a ray
            // rises; from 16 times on they are capped, by different pixels' centre rays.
            const glm::dvec3 d = glm::abs(rays[i].direction);
            const bool cube = map.faceCount() > 1;
            const double least = cube ? std::min({d.x, d.y, d.z}) : d.z;
            if (least > 0.08) CHECK(found[i] == Approx(expected[i]).margin(0.03));
        }
        CHECK(*std::min_element(found.begin(), found.end()) < 0.2f);
        CHECK(*std::max_element(found.begin(), found.end()) == 1.0f);
    }
}

TEST_CASE("fog takes from a ray by its way, in a cube's faces too", "[shadow][exact]") {
    Random random(2);
    const ShadowMap map = fogMap(cubeProjections(64), 64);
    for (int i = 0; i < 3000; ++i) {
        // Within the fog: between points on two neighbouring sides of a cube.
        const int a = i % 3, b = (i + 1) % 3, c = (i + 2) % 3;
        glm::dvec3 from(0.0), to(0.0);
        from[a] = random.in(3, 4.9), from[b] = random.in(-1, 1);
        to[b] = random.in(3, 4.9), to[a] = random.in(-1, 1);
        from[c] = random.in(-1, 1), to[c] = random.in(-1, 1);
        if (i & 1) from[a] = -from[a], to[a] = -to[a];
        if (i & 2) from[b] = -from[b], to[b] = -to[b];
        INFO("ray " << i);
        CHECK(visibility(map, rayFrom(from, to)) ==
              Approx(std::exp(-kThick * glm::length(to - from))).epsilon(0.02));
    }
}

TEST_CASE("a ray is answered the same alone, in a batch and in any order",
          "[shadow][exact][threads]") {
    Random random(3);
    const ShadowMap maps[] = {fogMap({plainProjection(48, 48)}, 48),
                              fogMap(cubeProjections(16), 16), ballsMap(64)};
    for (const ShadowMap& map : maps) {
        const std::vector<ShadowRay> rays = anyRays(random, 1500);
        const std::vector<float> batch = answers(map, rays);
        std::vector<std::size_t> order(rays.size());
        std::iota(order.begin(), order.end(), 0);
        for (std::size_t i = order.size() - 1; i > 0; --i)
            std::swap(order[i], order[random.below(i + 1)]);
        std::vector<ShadowRay> shuffled;
        for (const std::size_t i : order)
            shuffled.push_back(rays[i]);
        const std::vector<float> other = answers(map, shuffled);
        int different = 0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            CHECK((batch[i] >= 0.0f && batch[i] <= 1.0f));
            const float alone = visibility(map, rays[i]);
            different += std::memcmp(&alone, &batch[i], 4) != 0;
            different += std::memcmp(&other[i], &batch[order[i]], 4) != 0;
        }
        CHECK(different == 0);
    }
}

TEST_CASE("runs that say how dense they are agree with the definition in the mean",
          "[shadow][statistical]") {
    Random random(4);
    const ShadowMap maps[] = {ballsMap(256), fogMap({plainProjection(48, 48)}, 48)};
    const double radius = 0.3;
    for (const ShadowMap& map : maps) {
        for (const int each : {1, 16, 64, 400}) {
            std::vector<ShadowRay> rays;
            for (int i = 0; i < 12000 / each; ++i) {
                const double z = random.in(5.5, 7.0);
                const glm::dvec3 p(random.in(-0.5, 0.5) * z, random.in(-0.5, 0.5) * z,
                                   -z);
                for (int k = 0; k < each; ++k)
                    rays.push_back(rayFrom(
                        p, {random.in(-radius, radius), random.in(-radius, radius), 0}));
            }
            RayOptions options;
            options.spread = float(2 * radius / 6.2 / std::sqrt(each));
            const std::vector<float> found = answers(map, rays, options);
            const std::vector<float> expected = answers(map, rays, scalar());
            const auto mean = [](const std::vector<float>& v) {
                return std::accumulate(v.begin(), v.end(), 0.0) / double(v.size());
            };
            INFO("opaque " << map.isOpaque() << " each " << each);
            // One ray to a light is answered by texels as wide as that.
            CHECK(mean(found) == Approx(mean(expected)).margin(each == 1 ? 0.02 : 0.01));
            CHECK(mean(expected) > 0.1);
            CHECK(mean(expected) < 0.9);

            // A run is answered the same wherever it stands.
            const std::vector<ShadowRay> last(rays.end() - each, rays.end());
            const std::vector<float> again = answers(map, last, options);
            CHECK(std::memcmp(again.data(), &found[found.size() - std::size_t(each)],
                              4 * std::size_t(each)) == 0);
        }
    }
}

TEST_CASE("rays that are no rays are clear", "[shadow][bad-input]") {
    const ShadowMap map = fogMap(cubeProjections(16), 16);
    const ShadowRay good = rayFrom({0, 0, -6}, {0, 0, 0});
    CHECK(visibility(map, good) < 0.5f);
    for (const double odd : {0.0, -1.0, double(NAN)}) {
        ShadowRay ray = good;
        ray.length = odd;
        CHECK(visibility(map, ray) == 1.0f);
    }
    for (const double odd : {double(NAN), double(INFINITY)}) {
        ShadowRay ray = good;
        ray.origin.y = odd;
        CHECK(visibility(map, ray) == 1.0f);
        ray = good;
        ray.direction.x = odd;
        CHECK(visibility(map, ray) == 1.0f);
    }
    RayOptions options;
    for (const float odd : {-1.0f, float(NAN), float(INFINITY)}) {
        options.spread = odd;
        CHECK(visibility(map, good, options) == Approx(visibility(map, good)));
    }
    visibilities(map, nullptr, 0, nullptr);
}
