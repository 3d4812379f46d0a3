// Shadow factors of transparent maps and of maps with six faces, against closed forms.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

#include "map_fixture.h"
#include "mtsm/shadow.h"

using namespace mtsm;
using test::cubeProjections;
using test::mapOf;
using test::TestLayer;

namespace {

constexpr double kPi = glm::pi<double>();

AreaLight pointLight() {
    return {};  // at the origin, which is the eye of all maps here
}

/// Area of the part of a unit disk with x < s.
double diskBelow(double s) {
    s = std::clamp(s, -1.0, 1.0);
    return kPi - std::acos(s) + s * std::sqrt(1 - s * s);
}

MapInfo infoOf(std::uint32_t width, Translucent rule) {
    MapInfo info = test::plainInfo(width, width, 16);
    info.translucent = rule;
    return info;
}

/// Every pixel has these layers.
ShadowMap mapWith(Translucent rule, const std::vector<TestLayer>& layers,
                  float biasPerDepth = 0.0f) {
    MapInfo info = infoOf(64, rule);
    info.biasPerDepth = biasPerDepth;
    return mapOf(info, test::plainProjection(64, 64), [&](auto, auto) { return layers; });
}

/// v = exp(-s (z - 1)) from depth 1 to 5, as many samples in as many layers.
std::vector<TestLayer> fog(double s, int samples, int layers) {
    std::vector<TestLayer> all = {{1.0f, 1.0f, 1}};
    for (int i = 1; i <= layers; ++i) {
        const double z = 4.0 * i / layers;
        all.push_back(
            {float(1 + z), float(std::exp(-s * z)), std::uint32_t(samples / layers)});
    }
    return all;
}

ShadowOptions filtered() {
    ShadowOptions options;
    options.method = ShadowMethod::pcf;
    return options;
}

/// The fast trace keeps an optical depth to one part in 1024; others are exact.
double marginOf(ShadowMethod method) {
    return method == ShadowMethod::trace ? 4e-4 : 0.0;
}

double largest(glm::dvec3 p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

}  // namespace

TEST_CASE("each channel has its own factor, and the scalar is their mean", "[shadow]") {
    MapInfo info = test::plainInfo(8, 8, 8);
    info.channels = 3;
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    Tile t;
    for (std::uint32_t p = 0; p <= 64; ++p)
        t.begin.push_back(p);
    t.z.assign(64, 3.0f);
    for (float v : {0.75f, 0.5f, 0.0f})
        t.v.insert(t.v.end(), 64, v);
    faces[0].tiles.push_back(t);
    const auto map = ShadowMap::create(info, faces);
    REQUIRE(map);
    const glm::dvec3 points[] = {{0.5, 0.5, -5}, {0.5, 0.5, -2}, {NAN, 0, 0}};
    const glm::vec3 expected[] = {{0.25f, 0.5f, 1.0f}, glm::vec3(0), glm::vec3(0)};
    for (const ShadowMethod method :
         {ShadowMethod::trace, ShadowMethod::scalar, ShadowMethod::pcf}) {
        ShadowOptions options;
        options.method = method;
        const double margin = marginOf(method);
        glm::vec3 color[3];
        float grey[3];
        QueryStats stats;
        shadowFactorsColor(*map, info.light, points, nullptr, 3, color, options, &stats);
        shadowFactors(*map, info.light, points, nullptr, 3, grey, options);
        CHECK(stats.points == 3);
        CHECK(stats.notFinite == 1);
        for (int i = 0; i < 3; ++i) {
            CHECK(largest(color[i] - expected[i]) <= margin);
            CHECK(color[i] ==
                  shadowFactorColor(*map, info.light, points[i], {}, options));
            CHECK(grey[i] == Approx((color[i].x + color[i].y + color[i].z) / 3));
            CHECK(grey[i] == shadowFactor(*map, info.light, points[i], {}, options));
        }
    }
    ShadowRay ray;
    ray.origin = points[0];
    ray.direction = {0, 0, 1};
    ray.length = 4;
    CHECK(largest(visibilityColor(*map, ray) - glm::vec3(0.75f, 0.5f, 0.0f)) < 4e-4f);
    RayOptions scalar;
    scalar.method = ShadowMethod::scalar;
    CHECK(visibilityColor(*map, ray, scalar) == glm::vec3(0.75f, 0.5f, 0.0f));
    CHECK(visibility(*map, ray) == Approx(1.25 / 3).margin(4e-4));
    glm::vec3 out[1];
    visibilitiesColor(*map, &ray, 1, out);
    CHECK(out[0] == visibilityColor(*map, ray));
    ray.length = 0;
    CHECK(visibilityColor(*map, ray) == glm::vec3(1.0f));
    // One channel is all three.
    const ShadowMap grey = mapWith(Translucent::sheets, {{3.0f, 0.25f, 1}});
    const glm::vec3 threeTimes = shadowFactorColor(grey, pointLight(), {0.5, 0.5, -5});
    CHECK(threeTimes.x == Approx(0.75).margin(marginOf(ShadowMethod::trace)));
    CHECK(threeTimes == glm::vec3(threeTimes.x));
}

TEST_CASE("a receiver among media is darkened by what is a footprint away, not by itself",
          "[shadow][exact]") {
    // Samples at depth 4, where a pixel is 1/8 wide, and as a surface's bias.
    const ShadowMap media = mapWith(Translucent::media, {{4.0f, 0.5f, 1}}, 1.0f / 32);
    const ShadowMap sheets = mapWith(Translucent::sheets, {{4.0f, 0.5f, 1}}, 1.0f / 32);
    const ShadowMap wall = mapWith(Translucent::media, {{4.0f, 0.0f, 1}}, 1.0f / 32);
    // On a pixel's centre ray, where a medium takes what its samples say.
    const auto onCentreRay = [](double depth) {
        return depth * glm::dvec3(1.0 / 64, 3.0 / 64, -1);
    };
    for (const ShadowMethod method :
         {ShadowMethod::trace, ShadowMethod::scalar, ShadowMethod::pcf}) {
        ShadowOptions options;
        options.method = method;
        const double margin = marginOf(method);
        const auto dark = [&](const ShadowMap& map, double footprints) {
            return shadowFactor(map, pointLight(), onCentreRay(4 + footprints / 8), {},
                                options);
        };
        INFO("method " << int(method));
        CHECK(dark(media, 0.0) == 0.0f);
        CHECK(dark(media, 0.8) == 0.0f);
        CHECK(dark(media, 1.3) == Approx(0.5).margin(margin));
        CHECK(dark(sheets, 1.3) == 0.0f);  // five biases away, but for one
        CHECK(dark(sheets, 7.0) == Approx(0.5).margin(margin));
        // Surfaces in it need their five biases as ever.
        CHECK(dark(wall, 1.3) == 0.0f);
        CHECK(dark(wall, 7.0) == 1.0f);
        // With a normal the tangent plane tells: media on it do not count, above it do.
        const auto behind = [&](double footprints) {
            return shadowFactor(media, pointLight(), onCentreRay(4 + footprints / 8),
                                {0, 0, 1}, options);
        };
        CHECK(behind(0.1) == 0.0f);
        CHECK(behind(1.3) == Approx(0.5).margin(margin));
    }
}

TEST_CASE("a map may say from where on its media count, up to a footprint away",
          "[shadow][exact]") {
    const auto dark = [](const Attribute& attribute, ShadowMethod method,
                         double footprints) {
        MapInfo info = infoOf(64, Translucent::media);
        info.attributes.push_back(attribute);
        const ShadowMap map = mapOf(info, test::plainProjection(64, 64), [](auto, auto) {
            return std::vector<TestLayer>{{4.0f, 0.5f, 1}};
        });
        ShadowOptions options;
        options.method = method;
        // A pixel is 1/8 wide at depth 4.
        const double depth = 4 + footprints / 8;
        return shadowFactor(map, pointLight(), depth * glm::dvec3(1.0 / 64, 3.0 / 64, -1),
                            {}, options);
    };
    using Numbers = std::vector<double>;
    for (const ShadowMethod method :
         {ShadowMethod::trace, ShadowMethod::scalar, ShadowMethod::pcf}) {
        INFO("method " << int(method));
        const auto half = Approx(0.5).margin(marginOf(method));
        CHECK(dark({"mediaStart", Numbers{0.0}}, method, 0.1) == half);
        CHECK(dark({"mediaStart", Numbers{0.0}}, method, -0.1) == 0.0f);
        CHECK(dark({"mediaStart", Numbers{0.5}}, method, 0.4) == 0.0f);
        CHECK(dark({"mediaStart", Numbers{0.5}}, method, 0.6) == half);
        // No further than one, and what is no such number says nothing.
        for (const Attribute& other :
             {Attribute{"mediaStart", Numbers{7.0}}, Attribute{"mediaStart", Numbers{}},
              Attribute{"mediaStart", Numbers{-1.0}},
              Attribute{"mediaStart", Numbers{0.0, 0.0}},
              Attribute{"mediaStart", Numbers{double(NAN)}},
              Attribute{"mediaStart", std::int64_t(0)}, Attribute{"start", Numbers{0}}}) {
            CHECK(dark(other, method, 0.8) == 0.0f);
            CHECK(dark(other, method, 1.3) == half);
        }
    }
}

TEST_CASE("deep filtered lookup gives exp(-s d) in a homogeneous slab, compressed or not",
          "[shadow][exact]") {
    const double s = 0.6;
    const int samples = 512;
    for (const Translucent rule : {Translucent::sheets, Translucent::media}) {
        for (const int layers : {samples, 128}) {
            const ShadowMap map = mapWith(rule, fog(s, samples, layers));
            for (double z = 0.5; z < 7; z += 0.31) {
                // Media are met from a footprint away on.
                const double start = rule == Translucent::media ? z / 32 : 0.0;
                const double depth = std::clamp(z - start - 1, 0.0, 4.0);
                INFO(int(rule) << " " << layers << " layers, depth " << z);
                CHECK(shadowFactor(map, pointLight(), {0.1, 0.2, -z}, {}, filtered()) ==
                      Approx(1 - std::exp(-s * depth)).margin(1.1 * s * 4 / samples));
            }
        }
    }
}

TEST_CASE("deep filtered lookup goes on behind resets", "[shadow][exact]") {
    // Glass, a wall, glass: the wall hides all behind it whatever the accumulation says.
    const std::vector<TestLayer> layers = {
        {2.0f, 0.5f, 2}, {4.0f, 0.0f, 1}, {6.0f, 0.5f, 1}};
    for (const Translucent rule : {Translucent::sheets, Translucent::media}) {
        const ShadowMap map = mapWith(rule, layers);
        const auto dark = [&](double z) {
            return shadowFactor(map, pointLight(), {0.1, 0.2, -z}, {}, filtered());
        };
        CHECK(dark(3) == 0.5f);
        CHECK(dark(5) == 1.0f);
        CHECK(dark(9) == 1.0f);
    }
}

TEST_CASE("a fog around the light is continuous over edges and corners, filtered too",
          "[shadow][exact]") {
    const double s = 0.5;
    const auto views = cubeProjections(16);
    for (const Translucent rule : {Translucent::sheets, Translucent::media}) {
        for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::pcf}) {
            // Fog by depth, but rays through media pay by length: there the fog is
            // homogeneous, found along each pixel's centre ray.
            const bool media = rule == Translucent::media;
            const bool traced = method == ShadowMethod::trace, byLength = media && traced;
            const ShadowMap map =
                mapOf(infoOf(16, rule), views, [&](auto f, auto x, auto y) {
                    const glm::dvec3 c =
                        views[f].lightFromRaster({x + 0.5, y + 0.5}, 1.0);
                    return fog(byLength ? s * glm::length(c) : s, 512, 32);
                });
            const double start = media ? 1.0 / 8 : 0.0;  // footprints
            ShadowOptions options;
            options.method = method;
            for (const glm::dvec3 d :
                 {glm::dvec3(1, 1, 0.2), glm::dvec3(-1, 0.3, 1), glm::dvec3(0, -1, -1),
                  glm::dvec3(1, 1, 1), glm::dvec3(-1, 1, -1), glm::dvec3(1, -1, -1)}) {
                for (int i = -20; i <= 20; ++i) {
                    const glm::dvec3 p = 4.0 * d + 0.004 * i * glm::dvec3(1, -0.7, 0.4);
                    // Rays start a footprint away along the ray, lookups in depth.
                    const double z = largest(p), slant = glm::length(p) / z;
                    const double depth = z - start * z / (traced ? slant : 1.0) - 1;
                    const double way = byLength ? slant : 1.0;
                    INFO(int(rule)
                         << " step " << i << " of " << d.x << " " << d.y << " " << d.z);
                    CHECK(
                        1 - shadowFactor(map, pointLight(), p, {}, options) ==
                        Approx(std::exp(-s * way * depth)).epsilon(1.5 * s * way / 128));
                }
            }
        }
    }
}

TEST_CASE("a filter that reaches over an edge between faces finds what is there",
          "[shadow][exact]") {
    // An opaque cube of half side 2 around a disk light of radius R, all of it with y <
    // 0: receivers on a cube of half side 4 see the part of the disk above it, whatever
    // face they are in. The disk faces the edge between +x and +z.
    const double R = 0.2;
    MapInfo info = infoOf(256, Translucent::sheets);
    info.light.shape = LightShape::disk;
    info.light.radius = R;
    info.light.direction = {1, 0, 1};
    const auto views = cubeProjections(256);
    const ShadowMap map = mapOf(info, views, [&](auto f, auto x, auto y) {
        const glm::dvec3 p =
            views[f].worldFromLight(views[f].lightFromRaster({x + 0.5, y + 0.5}, 1.0));
        return p.y < 0 ? std::vector<TestLayer>{{2.0f, 0.0f, 1}}
                       : std::vector<TestLayer>{};
    });
    for (const double y : {-0.25, -0.1, -0.03, 0.0, 0.07, 0.15, 0.21}) {
        for (int i = -8; i <= 8; ++i) {
            // Across the edge, closer and closer.
            const double step = std::copysign(std::pow(2.0, -std::abs(i)), i);
            const glm::dvec3 p =
                i < 0 ? glm::dvec3(4, y, 4 + step) : glm::dvec3(4 - step, y, 4);
            for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::pcf}) {
                ShadowOptions options;
                options.method = method;
                options.samples = 1024;
                INFO((method == ShadowMethod::pcf ? "pcf" : "trace")
                     << " y " << y << " step " << step);
                // Halfway between, light and receiver count alike. 4 standard deviations
                // of stratified samples, and what the disk's tilt takes to halfway.
                CHECK(shadowFactor(map, info.light, p, {}, options) ==
                      Approx(diskBelow(-y / R) / kPi).margin(0.025));
            }
        }
    }
}

TEST_CASE("receivers on a wall are lit in all six faces", "[shadow]") {
    MapInfo info = infoOf(32, Translucent::sheets);
    info.biasPerDepth = 1.0f / 16;
    const ShadowMap map = mapOf(info, cubeProjections(32), [](auto...) {
        return std::vector<TestLayer>{{4.0f, 0.0f, 1}};
    });
    for (int axis = 0; axis < 3; ++axis) {
        for (const double sign : {-1.0, 1.0}) {
            for (const double u : {-0.9, -0.2, 0.0, 0.7, 1.0}) {
                glm::dvec3 p(0.0), n(0.0);
                p[axis] = 4 * sign;
                p[(axis + 1) % 3] = 4 * u;
                p[(axis + 2) % 3] = 1.3;
                n[axis] = -sign;
                for (const ShadowMethod method :
                     {ShadowMethod::trace, ShadowMethod::pcf}) {
                    ShadowOptions options;
                    options.method = method;
                    INFO("axis " << axis << " sign " << sign << " u " << u);
                    CHECK(shadowFactor(map, pointLight(), p, {}, options) == 0.0f);
                    if (std::abs(u) < 1)
                        CHECK(shadowFactor(map, pointLight(), p, n, options) == 0.0f);
                    CHECK(shadowFactor(map, pointLight(), 2.0 * p, {}, options) == 1.0f);
                }
            }
        }
    }
}
