// Maps of six faces, followed many rays at once: over borders and corners nothing is lost
// or counted twice, and a point's answer is its own.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <numeric>
#include <random>
#include <vector>

#include "bumpy_mesh.h"
#include "map_fixture.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"
#include "random.h"

using namespace mtsm;
using test::cubeProjections;
using test::mapOf;
using test::Random;
using test::TestLayer;

namespace {

double largest(glm::dvec3 p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

AreaLight pointAt(glm::dvec3 position) {
    AreaLight light;
    light.shape = LightShape::point;
    light.position = position;
    return light;
}

AreaLight lightOf(LightShape shape, double radius) {
    AreaLight light;
    light.shape = shape;
    light.radius = radius;
    light.size = glm::dvec2(1.6 * radius, 1.1 * radius);
    light.direction = glm::normalize(glm::dvec3(1, -2, 0.5));
    return light;
}

/// Much of it close to borders between faces, some right on them, some at corners.
std::vector<glm::dvec3> around(Random& random, int count, double low, double high) {
    std::vector<glm::dvec3> points;
    for (int i = 0; i < count; ++i) {
        glm::dvec3 d = random.within(1.0);
        d /= largest(d);
        const double off = i % 5 == 0 ? 0.0 : std::pow(10.0, random.in(-9, -1));
        const int axis = int(random.below(3)), next = (axis + 1) % 3;
        if (i % 2) d[axis] = std::copysign(1.0 - off, d[axis]);
        if (i % 4 == 1) d[next] = std::copysign(1.0 - (i % 8 == 1 ? off : 0.0), d[next]);
        if (i % 16 == 3) d = glm::sign(d);
        points.push_back(d * random.in(low, high));
    }
    return points;
}

std::vector<float> answers(const ShadowMap& map, const AreaLight& light,
                           const std::vector<glm::dvec3>& points,
                           const std::vector<glm::dvec3>& normals,
                           const ShadowOptions& options) {
    std::vector<float> out(points.size(), -1.0f);
    shadowFactors(map, light, points.data(), normals.empty() ? nullptr : normals.data(),
                  points.size(), out.data(), options);
    return out;
}

double meanOf(const std::vector<float>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / double(values.size());
}

/// Bodies to all sides of the light, some of them across borders and corners.
const std::vector<test::Mesh>& bodies() {
    static const std::vector<test::Mesh> all = [] {
        const test::Mesh body = test::bumpyBody(3000);
        std::vector<test::Mesh> meshes;
        for (const glm::vec3 at : {glm::vec3(2, 2, 0), glm::vec3(-2, -2, 2),
                                   glm::vec3(0, 2.5f, -2.5f), glm::vec3(2.5f, 0, 0.3f),
                                   glm::vec3(0.2f, -2.5f, 0), glm::vec3(-2, 0, -2)}) {
            meshes.push_back(body);
            for (glm::vec3& p : meshes.back().positions)
                p = 0.6f * p + at;
        }
        return meshes;
    }();
    return all;
}

ShadowMap bodiesMap(const AreaLight& light, bool nearField) {
    std::vector<CasterView> views;
    for (const test::Mesh& mesh : bodies())
        views.push_back(mesh.view());
    CasterViews casters(std::move(views));
    BakeOptions options;
    options.light = light;
    options.aimed = true;
    options.cube = true;
    options.width = options.height = 128;
    options.nearField = nearField ? kAutomaticNearField : 0;
    auto baked = bake(casters, options);
    REQUIRE(baked);
    REQUIRE(baked->map.isOpaque());
    REQUIRE(baked->map.faceCount() == 6);
    return std::move(baked->map);
}

/// On the walls of a room around the bodies.
struct Receivers {
    std::vector<glm::dvec3> points, normals;
};

Receivers onWalls(Random& random, int count) {
    Receivers r;
    for (int i = 0; i < count; ++i) {
        glm::dvec3 p = random.within(5.0), n(0.0);
        const int axis = int(random.below(3));
        p[axis] = std::copysign(5.0, p[axis]);
        n[axis] = p[axis] > 0 ? -1.0 : 1.0;
        r.points.push_back(p);
        r.normals.push_back(n);
    }
    return r;
}

Receivers onBodies(Random& random, int count) {
    Receivers r;
    for (int i = 0; i < count; ++i) {
        const test::Mesh& mesh = bodies()[random.below(bodies().size())];
        const std::size_t t = 3 * random.below(mesh.indices.size() / 3);
        const auto corner = [&](std::size_t k) {
            return glm::dvec3(mesh.positions[mesh.indices[t + k]]);
        };
        const glm::dvec3 a = corner(0), b = corner(1), c = corner(2);
        r.points.push_back((a + b + c) / 3.0);
        r.normals.push_back(glm::cross(b - a, c - a));
    }
    return r;
}

/// Homogeneous fog between the cubes of half sides 1 and 5.
ShadowMap fogMap(std::uint32_t width, double s) {
    MapInfo info = test::plainInfo(width, width, 16);
    info.translucent = Translucent::media;
    const auto views = cubeProjections(width);
    return mapOf(info, views, [&](std::uint32_t f, std::uint32_t x, std::uint32_t y) {
        const double way = glm::length(views[f].lightFromRaster({x + 0.5, y + 0.5}, 1.0));
        std::vector<TestLayer> layers = {{1.0f, 1.0f, 1}};
        for (int i = 1; i <= 32; ++i)
            layers.push_back(
                {1.0f + float(i) / 8, float(std::exp(-s * way * i / 8)), 16});
        return layers;
    });
}

/// How much of the way from a to b, t in [from, 1], lies in a cube of this half side.
double withinCube(glm::dvec3 a, glm::dvec3 b, double half, double from) {
    double begin = from, end = 1.0;
    for (int i = 0; i < 3; ++i) {
        const double d = b[i] - a[i];
        if (d == 0.0) {
            if (std::abs(a[i]) > half) return 0.0;
            continue;
        }
        const double t0 = (-half - a[i]) / d, t1 = (half - a[i]) / d;
        begin = std::max(begin, std::min(t0, t1));
        end = std::min(end, std::max(t0, t1));
    }
    return std::max(0.0, end - begin) * glm::length(b - a);
}

}  // namespace

TEST_CASE("fog around a light is paid for by length, once, over all borders and corners",
          "[shadow][exact]") {
    const double s = 0.4;
    Random random(1);
    const ShadowMap map = fogMap(32, s);
    for (const glm::dvec3 at : {glm::dvec3(0.0), glm::dvec3(0.3, 0.0, 0.0),
                                glm::dvec3(0.2, -0.3, 0.1), glm::dvec3(-0.7, 0.7, 0.7)}) {
        const std::vector<glm::dvec3> points = around(random, 1500, 1.5, 9.0);
        const std::vector<float> dark = answers(map, pointAt(at), points, {}, {});
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec3 p = points[i];
            // Media count from a footprint away on.
            const double start = largest(p) / 16 / glm::length(at - p);
            const double way =
                withinCube(p, at, 5.0, start) - withinCube(p, at, 1.0, start);
            INFO("light " << at.x << " point " << p.x << " " << p.y << " " << p.z);
            // Samples of a 128th of depth; a pixel's centre ray is off by half a pixel,
            // and rays across the view by more.
            CHECK(1 - dark[i] == Approx(std::exp(-s * way)).epsilon(0.02));
        }
    }
}

TEST_CASE("rays on the very border between faces meet a cube once, glass or wall",
          "[shadow][exact]") {
    for (const Translucent rule : {Translucent::media, Translucent::sheets}) {
        for (const float v : {0.5f, 0.0f}) {
            for (const std::uint32_t width : {16u, 13u, 1u}) {
                MapInfo info = test::plainInfo(width, width, 16);
                info.translucent = rule;
                info.bias = 0.1f;
                if (rule == Translucent::media && width == 1) continue;  // all is near
                const ShadowMap map = mapOf(info, cubeProjections(width), [&](auto...) {
                    return std::vector<TestLayer>{{4.0f, v, 1}};
                });
                std::vector<glm::dvec3> points;
                for (int axis = 0; axis < 3; ++axis) {
                    for (const double x : {-1.0, 1.0}) {
                        for (const double y : {-1.0, 1.0}) {
                            for (const double z : {-1.0, -0.625, 0.0, 0.3, 1.0}) {
                                glm::dvec3 d;
                                d[axis] = z, d[(axis + 1) % 3] = x;
                                d[(axis + 2) % 3] = y;
                                points.push_back(9.0 * d);
                                points.push_back(5000.0 / 3 * d);
                            }
                        }
                    }
                }
                const AreaLight light = pointAt(glm::dvec3(0.0));
                const std::vector<float> dark = answers(map, light, points, {}, {});
                // A medium takes by length, beside each pixel's centre ray; and what lies
                // at one depth is a slab of some ulps; at a border either pixel may do.
                ShadowOptions scalar;
                scalar.method = ShadowMethod::scalar;
                const std::vector<float> once = answers(map, light, points, {}, scalar);
                for (std::size_t i = 0; i < points.size(); ++i) {
                    INFO(int(rule)
                         << " v " << v << " width " << width << " point " << points[i].x
                         << " " << points[i].y << " " << points[i].z);
                    CHECK(dark[i] == Approx(once[i]).margin(0.03));
                    CHECK(once[i] == Approx(1 - v).margin(0.03));
                }
            }
        }
    }
}

TEST_CASE("six faces agree with the scalar trace in the mean", "[shadow][statistical]") {
    Random random(2);
    const Receivers walls = onWalls(random, 2000), on = onBodies(random, 2000);
    for (const LightShape shape :
         {LightShape::point, LightShape::sphere, LightShape::disk, LightShape::rect}) {
        const AreaLight light = lightOf(shape, 0.3);
        for (const bool nearField : {false, true}) {
            const ShadowMap map = bodiesMap(light, nearField);
            const auto compare = [&](const Receivers& at, bool normals, double mean,
                                     double each) {
                ShadowOptions options;
                const std::vector<glm::dvec3> none;
                const auto found =
                    answers(map, light, at.points, normals ? at.normals : none, options);
                options.method = ShadowMethod::scalar;
                const auto expected =
                    answers(map, light, at.points, normals ? at.normals : none, options);
                double away = 0.0;
                for (std::size_t i = 0; i < found.size(); ++i)
                    away += std::abs(found[i] - expected[i]) / double(found.size());
                INFO(name(shape) << " near " << nearField << " normals " << normals
                                 << " found " << meanOf(found) << " expected "
                                 << meanOf(expected) << " each " << away);
                CHECK(std::abs(meanOf(found) - meanOf(expected)) < mean);
                CHECK(away < each);
                CHECK(meanOf(expected) > 0.02);
                CHECK(meanOf(expected) < 0.9);
            };
            compare(walls, true, 0.004, 0.008);
            compare(walls, false, 0.004, 0.008);
            compare(on, true, 0.03, 0.06);
        }
    }
}

TEST_CASE("six faces of fog agree with the scalar trace for lights of any shape",
          "[shadow][statistical]") {
    const ShadowMap map = fogMap(32, 0.4);
    Random random(3);
    const std::vector<glm::dvec3> points = around(random, 300, 1.5, 9.0);
    std::vector<glm::dvec3> normals;
    for (const glm::dvec3& p : points)
        normals.push_back(-p + random.within(1.0));
    for (const LightShape shape :
         {LightShape::sphere, LightShape::disk, LightShape::rect}) {
        const AreaLight light = lightOf(shape, 0.8);
        for (const bool withNormals : {false, true}) {
            ShadowOptions options;
            options.samples = 256;
            const std::vector<glm::dvec3> none;
            const auto& n = withNormals ? normals : none;
            const auto found = answers(map, light, points, n, options);
            options.method = ShadowMethod::scalar;
            const auto expected = answers(map, light, points, n, options);
            for (std::size_t i = 0; i < points.size(); ++i) {
                INFO(name(shape) << " normals " << withNormals << " point " << points[i].x
                                 << " " << points[i].y << " " << points[i].z);
                CHECK(found[i] == Approx(expected[i]).margin(0.02));
            }
        }
    }
}

TEST_CASE("a point of six faces is answered the same alone, in a batch and in any order",
          "[shadow][exact][threads]") {
    Random random(4);
    const AreaLight light = lightOf(LightShape::sphere, 0.35);
    const ShadowMap maps[] = {bodiesMap(light, false), bodiesMap(light, true),
                              fogMap(16, 0.4)};
    for (const ShadowMap& map : maps) {
        Receivers at = onWalls(random, 200);
        for (const glm::dvec3& p : around(random, 200, 0.1, 9.0)) {
            at.points.push_back(p);
            at.normals.push_back(at.points.size() % 3 ? -p : glm::dvec3(0.0));
        }
        at.points[3] = glm::dvec3(0.0);
        at.points[4].y = NAN;
        at.points[5] *= 1e6;
        for (const int samples : {1, 16, 70, 300}) {
            for (const bool adaptive : {false, true}) {
                ShadowOptions options;
                options.samples = samples;
                options.adaptive = adaptive;
                const auto batch = answers(map, light, at.points, at.normals, options);
                std::vector<std::size_t> order(batch.size());
                std::iota(order.begin(), order.end(), 0);
                for (std::size_t i = order.size() - 1; i > 0; --i)
                    std::swap(order[i], order[random.below(i + 1)]);
                Receivers shuffled;
                for (const std::size_t i : order) {
                    shuffled.points.push_back(at.points[i]);
                    shuffled.normals.push_back(at.normals[i]);
                }
                const auto other =
                    answers(map, light, shuffled.points, shuffled.normals, options);
                int different = 0;
                for (std::size_t i = 0; i < order.size(); ++i) {
                    CHECK((batch[i] >= 0.0f && batch[i] <= 1.0f));
                    const float alone =
                        shadowFactor(map, light, at.points[i], at.normals[i], options);
                    different += std::memcmp(&alone, &batch[i], 4) != 0;
                    different += std::memcmp(&other[i], &batch[order[i]], 4) != 0;
                }
                CHECK(different == 0);
            }
        }
    }
}

TEST_CASE("six faces take trees, an empty face too", "[shadow]") {
    // A wall to one side only.
    MapInfo info = test::plainInfo(32, 32, 16);
    const ShadowMap map =
        mapOf(info, cubeProjections(32), [](std::uint32_t f, auto, auto) {
            return f == 0 ? std::vector<TestLayer>{{2.0f, 0.0f, 1}}
                          : std::vector<TestLayer>{};
        });
    prepareQueries(map);
    CHECK(queryMemoryBytes(map) > map.memoryBytes());
    const AreaLight light = lightOf(LightShape::sphere, 0.2);
    CHECK(shadowFactor(map, light, {4, 0, 0}) == 1.0f);
    CHECK(shadowFactor(map, light, {-4, 0, 0}) == 0.0f);
    CHECK(shadowFactor(map, light, {3, 4, 1}) == 0.0f);
    // Its rays come from an empty face and go on into the wall: as the scalar trace.
    ShadowOptions scalar;
    scalar.method = ShadowMethod::scalar;
    scalar.samples = 1024;
    ShadowOptions traced = scalar;
    traced.method = ShadowMethod::trace;
    const glm::dvec3 beside(6, 6.2, 0);
    const float expected = shadowFactor(map, light, beside, {}, scalar);
    CHECK(expected > 0.1f);
    CHECK(shadowFactor(map, light, beside, {}, traced) == Approx(expected).margin(0.01));
}
