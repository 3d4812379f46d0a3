// Casters that let light through, from the geometry to the visibility of a ray: closed
// forms, bands, subsamples, colour.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>

#include "bake/casters.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"

using namespace mtsm;
using mtsm::test::Casters;
using mtsm::test::Mesh;
using mtsm::test::Random;

namespace {

Mesh sheet(float y, float half, float opacity) {
    Mesh mesh;
    mesh.quad({-half, y, half}, {half, y, half}, {half, y, -half}, {-half, y, -half});
    mesh.opacity = opacity;
    return mesh;
}

/// A light above that looks straight down.
BakeOptions above(LightShape shape = LightShape::disk) {
    BakeOptions o;
    o.light.shape = shape;
    o.light.position = {0, 4, 0};
    o.light.direction = {0, -1, 0};
    o.light.radius = 0.5;
    o.light.size = {1.0, 1.0};
    o.light.angularDiameter = 0.1;
    o.aimed = true;
    o.up = {0, 0, -1};
    o.width = o.height = 128;
    return o;
}

ShadowMap mustBake(CasterSource& casters, const BakeOptions& options,
                   BakeReport* report = nullptr) {
    auto baked = bake(casters, options);
    if (!baked) FAIL(baked.error().message);
    if (report) *report = baked->report;
    return std::move(baked->map);
}

ShadowRay between(glm::dvec3 a, glm::dvec3 b) {
    return {a, glm::normalize(b - a), glm::length(b - a)};
}

/// A block of voxels of one density that owns its arrays.
struct Slab {
    std::vector<glm::ivec3> blocks;
    std::vector<float> density;
    VolumeView view;

    /// n x 1 x n blocks of voxels of this side: centred below the light, from y = 0 up.
    Slab(int n, double side, float extinction) {
        for (int z = 0; z < n; ++z) {
            for (int x = 0; x < n; ++x)
                blocks.push_back({8 * x, 0, 8 * z});
        }
        density.assign(blocks.size() * VolumeView::kBlockVoxels, 1.0f);
        view.blocks = blocks.data();
        view.blockCount = blocks.size();
        view.density = density.data();
        view.extinction = extinction;
        view.worldFromIndex = glm::dmat4(side);
        const double offset = -side * (4.0 * n - 0.5);
        view.worldFromIndex[3] = {offset, 0.5 * side, offset, 1.0};
    }
};

/// Ray by ray and layer by layer: the trees round depths (tests/trace/density_test.cpp).
RayOptions definition() {
    RayOptions options;
    options.method = ShadowMethod::scalar;
    return options;
}

}  // namespace

TEST_CASE("N sheets of opacity a leave (1 - a)^N of every ray, straight or slanted",
          "[bake][exact]") {
    for (const float tolerance : {0.0f, 0.005f}) {
        for (const int count : {1, 3, 8}) {
            const float a = 0.3f;
            std::vector<Mesh> sheets;
            for (int i = 0; i < count; ++i)
                sheets.push_back(sheet(0.25f * float(i), 2.0f, a));
            Casters casters(sheets);
            BakeOptions o = above();
            o.tolerance = tolerance;
            const ShadowMap map = mustBake(casters, o);
            Random random(std::uint64_t(count) + 1);
            const double expected = std::pow(1.0 - double(a), count);
            for (int i = 0; i < 500; ++i) {
                const glm::dvec3 from(random.in(-0.7, 0.7), -0.5, random.in(-0.7, 0.7));
                const glm::dvec3 to(random.in(-0.5, 0.5), 3.9, random.in(-0.5, 0.5));
                INFO("ray " << i << ", " << count << " sheets, tolerance " << tolerance);
                CHECK(visibility(map, between(from, to), definition()) ==
                      Approx(expected).margin(2.0 * tolerance + 1e-5));
            }
        }
    }
}

TEST_CASE("a homogeneous slab of extinction s leaves exp(-s d) of a ray through it",
          "[bake][exact]") {
    const double side = 0.05, extinction = 2.0, thickness = 8 * side;
    Slab slab(12, side, float(extinction));
    CasterViews casters({slab.view});
    for (const auto shape : {LightShape::disk, LightShape::sun}) {
        BakeOptions o = above(shape);
        o.tolerance = 0.0f;
        const ShadowMap map = mustBake(casters, o);
        CHECK(map.info().translucent == Translucent::media);
        CHECK_FALSE(map.info().castersClipped);  // the window was fitted
        // Along centre rays every voxel's chord is there: exact.
        const Projection& p = map.projection(0);
        for (const glm::dvec2 at : {glm::dvec2(40, 70), glm::dvec2(64, 64)}) {
            const double far = p.kind == ProjectionKind::perspective ? 30.0 : 10.0;
            const glm::dvec3 a = p.worldFromLight(p.lightFromRaster(at + 0.5, far));
            const glm::dvec3 b = p.worldFromLight(p.lightFromRaster(at + 0.5, 1e-3));
            const glm::dvec3 d = glm::normalize(b - a);
            CHECK(
                visibility(map, {a, d, 100.0}, definition()) ==
                Approx(std::exp(-extinction * thickness / std::abs(d.y))).epsilon(1e-4));
        }
        // Others meet samples of several pixels: exact on average.
        Random random(4);
        double sum = 0.0, expected = 0.0;
        const int rays = 2000;
        for (int i = 0; i < rays; ++i) {
            const glm::dvec3 from(random.in(-1, 1), -0.5, random.in(-1, 1));
            const glm::dvec3 to(random.in(-0.5, 0.5), 3.9, random.in(-0.5, 0.5));
            const glm::dvec3 d = glm::normalize(to - from);
            sum += visibility(map, between(from, to), definition());
            expected += std::exp(-extinction * thickness / std::abs(d.y));
        }
        CHECK(sum / rays == Approx(expected / rays).epsilon(0.01));
    }
}

TEST_CASE(
    "a point in a volume is darkened by all that is above it, whatever a pixel's size",
    "[bake][exact]") {
    const double side = 0.05, extinction = 2.0;
    Slab slab(12, side, float(extinction));
    CasterViews casters({slab.view});
    BakeOptions o = above();
    for (const std::uint32_t pixels : {32u, 256u}) {
        o.width = o.height = pixels;
        const ShadowMap map = mustBake(casters, o);
        for (const ShadowMethod method : {ShadowMethod::trace, ShadowMethod::scalar}) {
            ShadowOptions options;
            options.method = method;
            options.samples = 16;
            double sum = 0.0, expected = 0.0;
            Random random(5);
            const int points = 500;
            for (int i = 0; i < points; ++i) {
                const glm::dvec3 p(random.in(-0.5, 0.5), random.in(0.0, 8 * side),
                                   random.in(-0.5, 0.5));
                sum += shadowFactor(map, o.light, p, {}, options);
                const glm::dvec3 d = glm::normalize(o.light.position - p);
                expected += 1.0 - std::exp(-extinction * (8 * side - p.y) / d.y);
            }
            INFO(pixels << " pixels, method " << int(method));
            CHECK(sum / points == Approx(expected / points).margin(0.01));
        }
    }
    // Beside anything else a point may lie on what casts.
    const auto saysWhere = [](const ShadowMap& map) {
        for (const Attribute& a : map.info().attributes) {
            if (a.name == "mediaStart") return true;
        }
        return false;
    };
    CHECK(saysWhere(mustBake(casters, o)));
    const Mesh card = sheet(0.2f, 0.5f, 0.3f);
    CasterViews both({CasterView(slab.view), CasterView(card.view())});
    CHECK_FALSE(saysWhere(mustBake(both, o)));
}

TEST_CASE("a volume that the window cuts is said to be clipped", "[bake]") {
    Slab slab(12, 0.05, 1.0f);
    CasterViews casters({slab.view});
    BakeOptions o = above();
    o.fov = 0.2;
    CHECK(mustBake(casters, o).info().castersClipped);
}

TEST_CASE("rays far off the axis pay for their whole way through a medium",
          "[bake][exact]") {
    const double side = 0.05, extinction = 1.5, thickness = 8 * side;
    Slab slab(60, side, float(extinction));
    CasterViews casters({slab.view});
    BakeOptions o = above();
    o.width = o.height = 256;
    o.tolerance = 0.0f;
    const ShadowMap map = mustBake(casters, o);
    for (const double slope : {0.5, 1.0, 2.0}) {
        double sum = 0.0;
        const int rays = 2000;
        Random random(7);
        for (int i = 0; i < rays; ++i) {
            const glm::dvec3 from(random.in(-4, 4), -0.2, random.in(-4, 4));
            const double angle = random.in(0, 6.2831853);
            const glm::dvec3 d = glm::normalize(
                glm::dvec3(slope * std::cos(angle), 1.0, slope * std::sin(angle)));
            sum += visibility(map, {from, d, 1.0 / d.y});
        }
        const double expected =
            std::exp(-extinction * thickness * std::sqrt(1.0 + slope * slope));
        INFO("slope " << slope);
        CHECK(sum / rays == Approx(expected).epsilon(0.03));
    }
}

TEST_CASE("a half-transparent half-plane casts half of the opaque penumbra",
          "[bake][exact]") {
    // A square window and an edge along its side: the penumbra is linear.
    const auto half = [](float opacity) {
        Mesh mesh;
        mesh.quad({-3, 1, 3}, {0, 1, 3}, {0, 1, -3}, {-3, 1, -3});
        mesh.opacity = opacity;
        return Casters({mesh});
    };
    BakeOptions o = above(LightShape::rect);
    o.width = o.height = 512;
    Casters solid = half(1.0f), clear = half(0.5f);
    const ShadowMap opaque = mustBake(solid, o), translucent = mustBake(clear, o);
    ShadowOptions query;
    query.samples = 1024;
    for (double x = -0.3; x <= 0.3; x += 0.05) {
        const glm::dvec3 point(x, 0, 0.1), up(0, 1, 0);
        // The edge at height 1 of 4 is seen from x at the window's -x / 3.
        const double expected = std::min(1.0, std::max(0.0, 0.5 - 3.0 * x));
        const float a = shadowFactor(opaque, opaque.info().light, point, up, query);
        const float b =
            shadowFactor(translucent, translucent.info().light, point, up, query);
        CHECK(a == Approx(expected).margin(0.02));
        CHECK(b == Approx(0.5 * expected).margin(0.01));
        // Ray by ray the same light samples meet the same pixels.
        query.method = ShadowMethod::scalar;
        const float c = shadowFactor(opaque, opaque.info().light, point, up, query);
        const float d =
            shadowFactor(translucent, translucent.info().light, point, up, query);
        query.method = ShadowMethod::trace;
        CHECK(d == Approx(0.5 * c).margin(1e-4));
    }
}

TEST_CASE("a strand of width w stops a w / p of a pixel of width p", "[bake][exact]") {
    const glm::vec3 points[2] = {{0.013f, 1, -1}, {0.013f, 1, 1}};
    const std::uint32_t begin[2] = {0, 2};
    StrandsView strands;
    strands.points = points;
    strands.begin = begin;
    strands.strandCount = 1;
    strands.width = 0.004f;
    strands.opacity = 0.6f;
    Casters frame({sheet(0.0f, 1.0f, 1.0f)});  // makes the window as wide as itself
    const Mesh floor = sheet(0.0f, 1.0f, 1.0f);
    CasterViews casters({strands, floor.view()});
    BakeOptions o = above(LightShape::sun);
    o.tolerance = 0.0f;
    o.keepHidden = true;
    const ShadowMap map = mustBake(casters, o);
    const double pixel = 1.0 / map.projection(0).scale.x;
    const double expected = 1.0 - 0.6 * 0.004 / pixel;
    int found = 0;
    for (std::uint32_t y = 8; y < map.info().height - 8; ++y) {
        double through = 1.0;
        for (std::uint32_t x = 0; x < map.info().width; ++x) {
            const PixelLayers layers = map.pixel(0, x, y);
            if (layers.count < 2) continue;
            ++found;
            through *= layers.v[0];
        }
        // In one pixel, or shared by two.
        CHECK(through == Approx(expected).epsilon(1e-3));
    }
    CHECK(found >= int(map.info().height) - 16);
}

TEST_CASE("bands that memory makes do not change the map", "[bake][threads]") {
    Random random(5);
    std::vector<Mesh> meshes{test::bumpyBall(20)};
    meshes[0].opacity = 0.2f;
    for (int i = 0; i < 20; ++i) {
        meshes.push_back(sheet(float(random.in(-1, 1)), 1.5f, 0.05f));
    }
    Casters casters(meshes);
    BakeOptions o = above();
    o.width = o.height = 256;
    BakeReport whole, banded;
    const ShadowMap a = mustBake(casters, o, &whole);
    o.maxBytes = 28u << 20;
    const ShadowMap b = mustBake(casters, o, &banded);
    CHECK(whole.passes == 1);
    CHECK(banded.passes > 1);
    CHECK(whole.triangles == banded.triangles);
    CHECK(identical(a, b));
    o.maxBytes = 1u << 20;
    const auto refused = bake(casters, o);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == ErrorCode::tooLarge);
    CHECK(refused.error().message.find("--max-memory") != std::string::npos);
}

TEST_CASE("with subsamples a pixel at an edge stops the part that is covered",
          "[bake][exact]") {
    // An orthographic pixel is 1 / scale wide; the strip covers 2.25 of them.
    Mesh frame = sheet(0.0f, 1.0f, 1.0f);
    BakeOptions o = above(LightShape::sun);
    o.tolerance = 0.0f;
    Casters alone({frame});
    const double pixel = 1.0 / mustBake(alone, o).projection(0).scale.x;
    const Projection p = mustBake(alone, o).projection(0);
    const double left = p.worldFromLight(p.lightFromRaster({20.0, 0.0}, 1.0)).x;
    Mesh strip;
    const auto x0 = float(left), x1 = float(left + 2.25 * pixel);
    strip.quad({x0, 1, 0.9f}, {x1, 1, 0.9f}, {x1, 1, -0.9f}, {x0, 1, -0.9f});
    Casters casters({frame, strip});
    o.subsamples = 4;
    o.keepHidden = true;
    const ShadowMap map = mustBake(casters, o);
    // The frame moved the window up, not sideways.
    REQUIRE(map.projection(0).scale == p.scale);
    const auto front = [&](std::uint32_t x) {
        const PixelLayers layers = map.pixel(0, x, 64);
        return layers.count == 2 ? double(layers.v ? layers.v[0] : 0.0f) : 1.0;
    };
    CHECK(front(19) == 1.0);
    CHECK(front(20) == 0.0);
    CHECK(front(21) == 0.0);
    CHECK(front(22) == Approx(0.75));
    CHECK(front(23) == 1.0);
}

TEST_CASE("colour is kept when it is asked for", "[bake][exact][threads]") {
    Mesh pane = sheet(1.0f, 1.0f, 0.4f);
    MeshView view = pane.view();
    view.tint = {1.0f, 0.5f, 0.25f};
    CasterViews casters({view});
    BakeOptions o = above();
    o.tolerance = 0.0f;
    const ShadowMap grey = mustBake(casters, o);
    CHECK(grey.info().channels == 1);
    CHECK(grey.pixel(0, 64, 64).v[0] == Approx(0.6));
    o.color = true;
    const ShadowMap tinted = mustBake(casters, o);
    REQUIRE(tinted.info().channels == 3);
    const PixelLayers layers = tinted.pixel(0, 64, 64);
    REQUIRE(layers.count == 1);
    for (int c = 0; c < 3; ++c) {
        // What passes has taken the tint for as much as there was to pass through.
        const double expected = 0.6 * (1.0 - 0.4 * (1.0 - double(view.tint[c])));
        CHECK(layers.v[std::size_t(c) * layers.vStride] == Approx(expected));
    }
}

TEST_CASE("what no point of the light sees is dropped and counted, and no shadow changes",
          "[bake]") {
    Casters casters({sheet(0.0f, 1.5f, 1.0f), sheet(1.0f, 1.5f, 1.0f)});
    BakeOptions o = above();
    o.rounding = 0.0f;
    BakeReport dropped, kept;
    const ShadowMap without = mustBake(casters, o, &dropped);
    o.keepHidden = true;
    const ShadowMap with = mustBake(casters, o, &kept);
    CHECK(kept.droppedHidden == 0);
    CHECK(dropped.droppedHidden > 0);
    CHECK(with.layerCount() - without.layerCount() == dropped.droppedHidden);
    const auto& attributes = without.info().attributes;
    REQUIRE(attributes.size() == 1);
    CHECK(attributes[0].name == "hiddenLayers");
    CHECK(std::get<std::int64_t>(attributes[0].value) ==
          std::int64_t(dropped.droppedHidden));
    Random random(11);
    for (int i = 0; i < 300; ++i) {
        const glm::dvec3 point(random.in(-3, 3), random.in(-1, 0.9), random.in(-3, 3));
        CHECK(shadowFactor(without, without.info().light, point) ==
              shadowFactor(with, with.info().light, point));
    }
}

TEST_CASE("a light among its casters is baked into six faces", "[bake][exact][threads]") {
    // A room of walls at distance 2, with a window in the wall at x = 2.
    Mesh room;
    const auto wall = [&](glm::vec3 at, glm::vec3 u, glm::vec3 v) {
        room.quad(at - u - v, at + u - v, at + u + v, at - u + v);
    };
    wall({-2, 0, 0}, {0, 2, 0}, {0, 0, 2});
    wall({0, 2, 0}, {2, 0, 0}, {0, 0, 2});
    wall({0, -2, 0}, {2, 0, 0}, {0, 0, 2});
    wall({0, 0, 2}, {2, 0, 0}, {0, 2, 0});
    wall({0, 0, -2}, {2, 0, 0}, {0, 2, 0});
    wall({2, 0, -1.25f}, {0, 2, 0}, {0, 0, 0.75f});
    wall({2, 0, 1.25f}, {0, 2, 0}, {0, 0, 0.75f});
    Casters casters({room});
    BakeOptions o;
    o.light.shape = LightShape::point;
    o.light.position = {0.1, 0.2, -0.1};
    o.width = o.height = 256;
    CHECK_FALSE(bake(casters, o));
    o.cube = true;
    const ShadowMap map = mustBake(casters, o);
    REQUIRE(map.faceCount() == 6);
    CHECK_FALSE(map.info().castersClipped);
    Random random(13);
    for (int i = 0; i < 2000; ++i) {
        const glm::dvec3 d = glm::normalize(
            glm::dvec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1)));
        const glm::dvec3 point = o.light.position + 4.0 * d;
        // Where the ray meets the plane of the window.
        const double t = (2.0 - o.light.position.x) / d.x;
        const glm::dvec3 at = o.light.position + t * d;
        const double inside = std::min(0.5 - std::abs(at.z), 2.0 - std::abs(at.y));
        if (t > 0.0 && std::abs(inside) < 0.05)
            continue;  // within a few pixels of a jamb
        const bool lit = t > 0.0 && inside > 0.0;
        INFO("direction " << d.x << " " << d.y << " " << d.z);
        CHECK(shadowFactor(map, map.info().light, point) == (lit ? 0.0f : 1.0f));
    }
}
