// Layers that no point of the light can see: with them and without, every ray to the
// light finds the same.
#include "compress/hidden.h"

#include <tbb/global_control.h>

#include <catch2/catch.hpp>
#include <functional>
#include <glm/geometric.hpp>
#include <vector>

#include "compress/pixels.h"
#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "trace/traverse.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

constexpr std::uint32_t kSide = 128;

using PixelOf = std::function<std::vector<TestLayer>(std::uint32_t, std::uint32_t)>;

struct Scene {
    MapInfo info;
    Projection projection;
    PixelOf pixel;

    [[nodiscard]] ShadowMap map() const { return mapOf(info, projection, pixel); }
};

/// Looks along +z of the world from the origin; a light of radius R on the plane z = d.
Scene scene(LightShape shape, double radius, double d, const PixelOf& pixel) {
    Scene s;
    s.info = plainInfo(kSide, kSide, 64);
    s.info.light.shape = shape;
    s.info.light.position = {0, 0, d};
    s.info.light.direction = {0, 0, 1};
    s.info.light.radius = radius;
    s.info.light.size = {1.6 * radius, 1.2 * radius};
    s.info.light.angularDiameter = 2.0 * std::atan(radius);
    s.projection.kind = shape == LightShape::sun ? ProjectionKind::orthographic
                                                 : ProjectionKind::perspective;
    s.projection.right = {-1, 0, 0};
    s.projection.forward = {0, 0, 1};
    const double scale = shape == LightShape::sun ? kSide / 10.0 : kSide / 2.0;
    s.projection.scale = {scale, -scale};
    s.projection.offset = {kSide / 2.0, kSide / 2.0};
    s.info.bias = float(12.0 / (kSide / 2.0));
    s.pixel = pixel;
    return s;
}

struct Dropped {
    ShadowMap map;
    compress::Hidden hidden;
};

Dropped withoutHidden(const ShadowMap& map) {
    MapFace face;
    face.projection = map.projection(0);
    for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
        for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx)
            face.tiles.push_back(map.tile(0, tx, ty));
    }
    const compress::Hidden hidden = compress::dropHidden(map.info(), face);
    std::vector<MapFace> faces;
    faces.push_back(std::move(face));
    auto made = ShadowMap::create(map.info(), std::move(faces));
    if (!made) throw std::runtime_error(made.error().message);
    return {*std::move(made), hidden};
}

/// A random point of the light, and the ray to it.
trace::Ray toLight(const AreaLight& light, glm::dvec3 from, Noise& noise) {
    const double angle = 2.0 * 3.14159265358979 * noise.unit();
    // The rim is what sees most.
    const double r = noise.unit() < 0.5 ? 1.0 : std::sqrt(noise.unit());
    const glm::dvec3 round(r * std::cos(angle), r * std::sin(angle), 0.0);
    trace::Ray ray;
    ray.origin = from;
    switch (light.shape) {
        case LightShape::point:
            ray.delta = light.position - from;
            break;
        case LightShape::disk:
            ray.delta = light.position + light.radius * round - from;
            break;
        case LightShape::rect:
            ray.delta = light.position +
                        glm::dvec3(light.size.x * (noise.unit() - 0.5),
                                   light.size.y * (noise.unit() - 0.5), 0.0) -
                        from;
            break;
        case LightShape::sphere: {
            const double z = 2.0 * noise.unit() - 1.0;
            const double flat = std::sqrt(1.0 - z * z);
            ray.delta = light.position +
                        light.radius * glm::dvec3(flat * std::cos(angle),
                                                  flat * std::sin(angle), z) -
                        from;
            break;
        }
        case LightShape::sun:
            ray.delta = glm::normalize(std::tan(0.5 * light.angularDiameter) * round -
                                       glm::dvec3(0, 0, 1));
            ray.tEnd = HUGE_VAL;
            break;
    }
    return ray;
}

/// Compares rays to the light from points everywhere, many of them at layers that were
/// dropped.
void checkSame(const ShadowMap& whole, const ShadowMap& cut, int rays) {
    Noise noise(17);
    trace::TraceOptions options;
    options.bias = {whole.info().bias, whole.info().biasPerDepth};
    int blocked = 0;
    for (int i = 0; i < rays; ++i) {
        const auto x = noise.below(kSide), y = noise.below(kSide);
        const PixelLayers layers = whole.pixel(0, x, y);
        double z = noise.between(7.5, 25.0);
        if (layers.count > 0 && noise.unit() < 0.8) {
            const std::uint32_t kept = cut.pixel(0, x, y).count;
            const bool hidden = kept < layers.count && noise.unit() < 0.8;
            const double at = layers.z[hidden ? kept + noise.below(layers.count - kept)
                                              : noise.below(layers.count)];
            z = at + options.bias.at(at) * noise.between(-3.0, 3.0);
        }
        if (z <= 7.0) continue;
        const glm::dvec3 p = whole.projection(0).worldFromLight(
            whole.projection(0).lightFromRaster({x + noise.unit(), y + noise.unit()}, z));
        const trace::Ray ray = toLight(whole.info().light, p, noise);
        const float a = traceRay(whole, ray, options)[0],
                    b = traceRay(cut, ray, options)[0];
        INFO("pixel " << x << ", " << y << ", z " << z << ": " << a << " and " << b);
        REQUIRE(a == b);
        blocked += a == 0.0f;
    }
    CHECK(blocked > rays / 10);
    CHECK(blocked < rays - rays / 10);
}

/// Opaque sheets, tilted and not, with a hole here and there, translucent ones and boxes
/// behind and between.
PixelOf randomSheets(std::uint64_t seed) {
    struct Sheet {
        double z, dx, dy, step, x0, x1, y0, y1;
        bool opaque;
    };
    Noise noise(seed);
    std::vector<Sheet> sheets;
    for (int i = 0; i < 7; ++i) {
        Sheet s{};
        s.z = noise.between(8.0, 18.0);
        s.dx = noise.between(-1.5, 1.5) / kSide;
        s.dy = noise.between(-1.5, 1.5) / kSide;
        // Terraces of which some let rays slip through, at twice the bias of 0.1875.
        s.step = noise.unit() < 0.5 ? 0.0 : noise.between(0.1, 0.8);
        const bool large = i < 3;
        s.x0 = noise.between(0.0, large ? 40.0 : 100.0);
        s.y0 = noise.between(0.0, large ? 40.0 : 100.0);
        s.x1 = s.x0 + noise.between(large ? 60.0 : 10.0, 90.0);
        s.y1 = s.y0 + noise.between(large ? 60.0 : 10.0, 90.0);
        s.opaque = large || noise.unit() < 0.6;
        sheets.push_back(s);
    }
    const std::uint32_t holeX = 30 + noise.below(60), holeY = 30 + noise.below(60);
    return [=](std::uint32_t x, std::uint32_t y) {
        std::vector<std::pair<float, bool>> hits;
        for (const Sheet& s : sheets) {
            if (!(x >= s.x0 && x < s.x1 && y >= s.y0 && y < s.y1)) continue;
            if (s.opaque && x / 2 == holeX / 2 && y / 2 == holeY / 2) continue;
            hits.emplace_back(float(s.z + s.dx * x + s.dy * y + s.step * (x / 9 % 2)),
                              s.opaque);
        }
        std::sort(hits.begin(), hits.end());
        std::vector<TestLayer> layers;
        float v = 1.0f;
        for (const auto& [z, opaque] : hits) {
            v = opaque ? 0.0f : 0.5f * v;
            layers.push_back({z, v, 1});
            if (opaque) v = 1.0f;
        }
        return layers;
    };
}

/// A large sheet at 8 and another one at 16.
std::vector<TestLayer> twoSheets(std::uint32_t, std::uint32_t) {
    return {{8.0f, 0.0f, 1}, {16.0f, 0.0f, 1}};
}

constexpr LightShape kShapes[] = {LightShape::point, LightShape::disk, LightShape::rect,
                                  LightShape::sphere, LightShape::sun};

}  // namespace

TEST_CASE("rays to the light find the same without hidden layers", "[compress][hidden]") {
    std::uint64_t dropped = 0;
    for (const LightShape shape : kShapes) {
        for (std::uint64_t seed = 1; seed <= 6; ++seed) {
            INFO(name(shape) << ", seed " << seed);
            // Rays stray by up to some 20 pixels.
            const double radius = (shape == LightShape::sun ? 0.04 : 0.5) * double(seed);
            Scene s = scene(shape, radius, 0.5 * double(seed), randomSheets(seed));
            if (seed % 2 == 0) {
                s.info.bias = 0.02f;
                s.info.biasPerDepth = 1.0f / 64;
            }
            const ShadowMap whole = s.map();
            const Dropped cut = withoutHidden(whole);
            CHECK(cut.hidden.layers == whole.layerCount() - cut.map.layerCount());
            CHECK(cut.hidden.samples == cut.hidden.layers);
            checkSame(whole, cut.map, 4000);
            dropped += cut.hidden.layers;
        }
    }
    CHECK(dropped > 10'000);
}

TEST_CASE("a sheet behind a sheet is hidden where the light cannot look around",
          "[compress][hidden][exact]") {
    // From a point of the second sheet, 16 deep, to a light point l = +-3 from the axis
    // at depth 1, a ray is at depth 8 64 (l - c) (16 - 8) / (8 (16 - 1)) pixels aside.
    const Scene s = scene(LightShape::disk, 3.0, 1.0, twoSheets);
    const ShadowMap whole = s.map();
    const Dropped cut = withoutHidden(whole);
    int seen = 0, hidden = 0;
    for (std::uint32_t x = 0; x < kSide; ++x) {
        const std::uint32_t y = kSide / 2;
        // Bias 0.1875 and all, the furthest ray starts at 16.375 or so.
        const auto reach = [&](double l, double depth) {
            const double c = (x + 0.5 - kSide / 2.0) / (kSide / 2.0);
            return 64.0 * (l - c) * (depth - 8.0) / (8.0 * (depth - 1.0));
        };
        const bool surelySeen =
            x + 1.0 + reach(3.0, 16.0) > kSide || x + reach(-3.0, 16.0) < 0;
        const bool surelyHidden = x + 3.0 + std::max(0.0, reach(3.0, 16.5)) < kSide &&
                                  x - 2.0 + std::min(0.0, reach(-3.0, 16.5)) > 0;
        INFO("pixel " << x);
        seen += surelySeen;
        hidden += surelyHidden;
        if (surelySeen) CHECK(cut.map.pixel(0, x, y).count == 2);
        if (surelyHidden) CHECK(cut.map.pixel(0, x, y).count == 1);
    }
    CHECK(seen > 15);
    CHECK(seen + hidden > int(kSide) - 10);
}

TEST_CASE("what can be seen past an edge, through a hole or a step stays",
          "[compress][hidden]") {
    const auto with = [](const std::function<float(std::uint32_t, std::uint32_t)>& front,
                         std::uint32_t x, std::uint32_t y) {
        const Scene s =
            scene(LightShape::disk, 0.5, 1.0, [&](std::uint32_t i, std::uint32_t j) {
                std::vector<TestLayer> layers;
                const float z = front(i, j);
                if (z > 0.0f) layers.push_back({z, 0.0f, 1});
                layers.push_back({16.0f, 0.0f, 1});
                return layers;
            });
        return withoutHidden(s.map()).map.pixel(0, x, y);
    };
    CHECK(with([](auto, auto) { return 8.0f; }, 64, 64).count == 1);
    // One pixel is open, two beside it.
    CHECK(with([](auto x, auto y) { return x == 66 && y == 64 ? 0.0f : 8.0f; }, 64, 64)
              .count == 2);
    // A step that a ray slips through, and one that it does not.
    CHECK(with([](auto x, auto) { return x < 66 ? 8.0f : 9.0f; }, 64, 64).count == 2);
    CHECK(with([](auto x, auto) { return x < 66 ? 8.0f : 8.1f; }, 64, 64).count == 1);
    // Too close behind the wall to tell.
    CHECK(with([](auto, auto) { return 15.9f; }, 64, 64).count == 2);
}

TEST_CASE("rays along a wall that comes nearer are followed to its end",
          "[compress][hidden][exact]") {
    // From (65.5, 20 deep) to the light's rim a ray is 10 pixels aside at the depth of
    // the wall in its own pixel, but that is nearer there, by 0.15 a pixel: it meets the
    // ray 17 pixels aside, unless it ends before.
    const auto layersIfWallEndsAt = [](std::uint32_t end) {
        const Scene s =
            scene(LightShape::disk, 3.0, 1.0, [&](std::uint32_t x, std::uint32_t) {
                std::vector<TestLayer> layers;
                const double front = 10.0 - 0.15 * (x > 65 ? x - 65.0 : 0.0);
                if (x < end) layers.push_back({float(std::max(front, 7.0)), 0.0f, 1});
                layers.push_back({20.0f, 0.0f, 1});
                return layers;
            });
        return withoutHidden(s.map()).map.pixel(0, 65, 64).count;
    };
    CHECK(layersIfWallEndsAt(81) == 2);
    CHECK(layersIfWallEndsAt(100) == 1);
}

TEST_CASE("translucent layers hide nothing and are hidden like others",
          "[compress][hidden][exact]") {
    const auto pixelWith = [](const std::vector<TestLayer>& layers) {
        const Scene s = scene(LightShape::disk, 0.5, 1.0,
                              [&](std::uint32_t, std::uint32_t) { return layers; });
        Dropped cut = withoutHidden(s.map());
        const PixelLayers pixel = cut.map.pixel(0, 64, 64);
        return std::pair(std::vector<float>(pixel.z, pixel.z + pixel.count),
                         cut.hidden.samples);
    };
    CHECK(pixelWith({{8, 0.5f}, {16, 0.25f}}).first == std::vector<float>{8, 16});
    const auto [z, samples] = pixelWith({{8, 0.5f}, {9, 0}, {16, 0.5f}, {17, 0.25f, 7}});
    CHECK(z == std::vector<float>{8, 9});
    CHECK(samples % 8 == 0);
    // The samples of a layer reach forward to the layer before it.
    CHECK(pixelWith({{9, 0}, {16, 0.5f, 100}}).first == std::vector<float>{9, 16});
    CHECK(pixelWith({{9, 0}, {16, 0.5f, 2}}).first == std::vector<float>{9});
}

TEST_CASE("hidden layers are the same for one thread and many",
          "[compress][hidden][threads]") {
    const ShadowMap whole = scene(LightShape::disk, 0.3, 0.6, randomSheets(3)).map();
    const Dropped many = withoutHidden(whole);
    tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    CHECK(identical(many.map, withoutHidden(whole).map));
}
