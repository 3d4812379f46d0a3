// bake(): the same map for any order and any number of threads, and what it says of
// itself.
#include "mtsm/bake.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <optional>

#include "bake/baked.h"
#include "bake/casters.h"

using namespace mtsm;
using mtsm::test::Casters;
using mtsm::test::Mesh;
using mtsm::test::mustBake;
using mtsm::test::Random;

namespace {

BakeOptions lamp() {
    return test::diskAbove(64);
}

/// A square at height y that faces up, two triangles.
Mesh square(float y, float half, float opacity = 1.0f) {
    Mesh mesh;
    mesh.quad({-half, y, half}, {half, y, half}, {half, y, -half}, {-half, y, -half});
    mesh.opacity = opacity;
    return mesh;
}

}  // namespace

TEST_CASE("the map is the same for 1, 2 and 8 threads and any order of triangles",
          "[bake][exact][threads]") {
    std::vector<Mesh> meshes{test::bumpyBall(40), test::bumpyBall(25), square(-2, 3)};
    meshes[1].worldFromObject = glm::scale(
        glm::rotate(glm::translate(glm::dmat4(1.0), {0.7, 0.2, 0.1}), 1.0, {1, 2, 3}),
        glm::dvec3(0.8));
    meshes[1].opacity = 0.3f;
    meshes.push_back(meshes[0]);  // opaque copies
    BakeOptions o = lamp();
    o.width = 200;
    o.height = 150;
    o.layers = 3;
    for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
        o.light.shape = shape;
        std::optional<Baked> first;
        Random random(3);
        for (const int threads : {1, 2, 8}) {
            const tbb::global_control most(tbb::global_control::max_allowed_parallelism,
                                           std::size_t(threads));
            tbb::task_arena arena(threads);
            Casters casters(meshes);
            arena.execute([&] {
                Baked b = mustBake(casters, o);
                if (!first)
                    first = std::move(b);
                else
                    CHECK(identical(first->map, b.map));
            });
            for (Mesh& mesh : meshes)
                shuffleTriangles(mesh, random);
            random.shuffle(meshes);
        }
        CHECK(first->map.info().samplesDropped > 0);
        CHECK(first->map.layerCount() > 20000);
    }
}

TEST_CASE("a map says what it was made from", "[bake]") {
    Casters casters({square(0, 1), square(1, 0.5f, 0.25f), square(2, 0.5f, 0.0f)});
    BakeOptions o = lamp();
    o.layers = 7;
    o.settings = "--layers 7";
    const Baked b = mustBake(casters, o);
    const MapInfo& i = b.map.info();
    CHECK(i.width == 64);
    CHECK(i.tileSize == 64);
    CHECK(i.channels == 1);
    CHECK(i.maxLayers == 7);
    CHECK(i.resets == kAllResets);
    CHECK(i.software.rfind("libmtsm ", 0) == 0);
    CHECK(i.software.size() > 8);
    CHECK(i.settings == "--layers 7");
    CHECK(i.samples == b.map.layerCount());
    CHECK(i.samplesDropped == 0);
    CHECK(b.report.meshes == 3);
    CHECK(b.report.triangles == 6);
    CHECK(b.report.transparent == 2);
    CHECK(b.report.rasterSeconds >= 0.0);
    // The default bias: a pixel's footprint at a layer's depth.
    CHECK(i.bias == 0.0f);
    CHECK(i.biasPerDepth * 7.0f == Approx(b.map.projection(0).pixelFootprint(7.0)));
    o.bias = 0.125f;
    CHECK(mustBake(casters, o).map.info().bias == 0.125f);
}

TEST_CASE("stacked sheets become layers with the products of their opacities",
          "[bake][exact]") {
    Casters casters(
        {square(0, 1), square(1, 1, 0.25f), square(2, 1, 0.5f), square(3, 1)});
    BakeOptions o = lamp();
    o.light.position.y = 10;
    o.light.shape = LightShape::point;
    o.keepHidden = true;
    const Baked b = mustBake(casters, o);
    const PixelLayers p = b.map.pixel(0, 30, 33);
    REQUIRE(p.count == 4);
    const float z[] = {7, 8, 9, 10}, v[] = {0, 0.5f, 0.375f, 0};
    for (int i = 0; i < 4; ++i) {
        CHECK(p.z[i] == Approx(z[i]).epsilon(1e-6));
        CHECK(p.v[i] == v[i]);
    }
    CHECK(p.n == nullptr);
    o.layers = 2;
    const Baked nearest = mustBake(casters, o);
    CHECK(nearest.map.pixel(0, 30, 33).count == 2);
    CHECK(nearest.map.info().samples == b.map.info().samples);
    // Every sample is in a layer or counted as dropped.
    std::uint64_t held = 0;
    for (std::uint32_t y = 0; y < 64; ++y) {
        for (std::uint32_t x = 0; x < 64; ++x) {
            const PixelLayers layers = nearest.map.pixel(0, x, y);
            for (std::uint32_t k = 0; k < layers.count; ++k)
                held += layers.n ? layers.n[k] : 1;
        }
    }
    CHECK(nearest.map.info().samplesDropped > 0);
    CHECK(held + nearest.map.info().samplesDropped == b.map.info().samples);
}

TEST_CASE("depths are rounded far within the z threshold, unless every bit is asked for",
          "[bake]") {
    Casters casters({test::bumpyBall(40), square(-2, 3)});
    BakeOptions o = lamp();
    const Baked rounded = mustBake(casters, o);
    o.rounding = 0.0f;
    const Baked exact = mustBake(casters, o);
    REQUIRE(rounded.map.layerCount() == exact.map.layerCount());
    const MapInfo& info = rounded.map.info();
    double worst = 0.0;  // in z thresholds
    for (std::uint32_t y = 0; y < 64; ++y) {
        for (std::uint32_t x = 0; x < 64; ++x) {
            const PixelLayers a = rounded.map.pixel(0, x, y),
                              b = exact.map.pixel(0, x, y);
            REQUIRE(a.count == b.count);
            for (std::uint32_t k = 0; k < a.count; ++k) {
                const double threshold = double(info.biasPerDepth) * b.z[k];
                worst = std::max(worst, std::abs(double(a.z[k]) - b.z[k]) / threshold);
            }
        }
    }
    CHECK(worst > 0.0);
    CHECK(worst <= 1.0 / 64);
    REQUIRE(info.attributes.size() >= 1);
    CHECK(info.attributes.back().name == "rounding");
    CHECK(std::get<std::vector<double>>(info.attributes.back().value) ==
          std::vector<double>{1.0 / 64});
    for (const Attribute& attribute : exact.map.info().attributes)
        CHECK(attribute.name != "rounding");
    // Lossless is lossless.
    o.rounding.reset();
    o.tolerance = 0.0f;
    CHECK(mustBake(casters, o).map.pixel(0, 30, 33).z[0] ==
          exact.map.pixel(0, 30, 33).z[0]);
}

TEST_CASE("culling follows the face, mirrored objects included", "[bake]") {
    Mesh up = square(0, 1), down = square(1, 1);
    for (std::size_t i = 0; i < down.indices.size(); i += 3)
        std::swap(down.indices[i], down.indices[i + 1]);
    const auto depths = [](const Mesh& a, const Mesh& b, Cull cull) {
        BakeOptions o = lamp();
        o.light.shape = LightShape::point;
        o.keepHidden = true;
        o.cull = cull;
        Casters casters({a, b});
        const Baked baked = mustBake(casters, o);
        const PixelLayers p = baked.map.pixel(0, 30, 33);
        CHECK(baked.report.culled == (cull == Cull::none ? 0 : 2));
        return std::vector<float>(p.z, p.z + p.count);
    };
    using D = std::vector<float>;
    CHECK(depths(up, down, Cull::none) == D{3, 4});
    CHECK(depths(up, down, Cull::back) == D{4});
    CHECK(depths(up, down, Cull::front) == D{3});
    // A mirror turns the winding of the arrays, not the side that the object shows.
    for (Mesh* mesh : {&up, &down})
        mesh->worldFromObject = glm::scale(glm::dmat4(1.0), {-1, 1, 1});
    CHECK(depths(up, down, Cull::back) == D{4});
    CHECK(depths(up, down, Cull::front) == D{3});
}

TEST_CASE("the light's plane cuts casters and near moves it", "[bake]") {
    // A mast under the light reaches up past it.
    Mesh mast = square(0, 1);
    mast.triangle({0.01f, 0, 0}, {0.02f, 0, 0.01f}, {0.01f, 9, 0.01f});
    Casters casters({mast});
    BakeOptions o = lamp();
    o.fov = 1.0;
    o.target = glm::dvec3(0.0);
    const Baked b = mustBake(casters, o);
    const double plane = 0.3 / std::tan(0.5);
    CHECK(b.map.projection(0).near == Approx(plane));
    CHECK(b.map.zRange(0).min >= float(plane));
    CHECK(b.report.clipped >= 1);
    o.near = 2.5;
    const Baked later = mustBake(casters, o);
    CHECK(later.map.projection(0).near == Approx(plane + 2.5));
    CHECK(later.map.zRange(0).min >= float(plane + 2.5));
    o.near.reset();
    o.far = 3.0;
    CHECK(mustBake(casters, o).map.zRange(0).max <= float(plane + 3.0));
}

TEST_CASE("broken triangles among good ones are counted and change nothing", "[bake]") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    Mesh good = test::bumpyBall(6);
    good.worldFromObject = glm::translate(glm::dmat4(1.0), {0, -1, 0});
    Mesh bad = good;
    bad.triangle({nan, 0, 0}, {1, 0, 0}, {0, 0, 1});
    bad.triangle({0, 0, 0}, {1, inf, 0}, {0, 0, 1});
    bad.triangle({50, 0, 0}, {50, 0, 0}, {90, 0, 1});
    bad.triangle({0, -inf, 0}, {nan, nan, nan}, {90, 0, 1});
    Casters a({good}), b({bad});
    const Baked clean = mustBake(a, lamp()), dirty = mustBake(b, lamp());
    CHECK(identical(clean.map, dirty.map));
    CHECK(dirty.report.nonFinite == 3);
    CHECK(dirty.report.degenerate == 1);
    CHECK(clean.report.nonFinite == 0);
}

TEST_CASE("triangles smaller than every pixel give an empty map, not an error",
          "[bake]") {
    Mesh dust;
    for (int i = 0; i < 4; ++i) {
        const float x = i % 2 ? 1.0f : -1.0f, z = i / 2 ? 1.0f : -1.0f;
        dust.triangle({x, 0, z}, {x + 1e-4f, 0, z}, {x, 0, z + 1e-4f});
    }
    Casters casters({dust});
    const Baked b = mustBake(casters, lamp());
    CHECK(b.map.layerCount() == 0);
    CHECK(b.map.info().samples == 0);
    CHECK(b.map.info().bias == 0.0f);
    CHECK(b.report.degenerate == 0);
}

TEST_CASE("a map of one pixel has what its centre ray meets", "[bake]") {
    Casters casters({square(0, 1)});
    BakeOptions o = lamp();
    o.width = o.height = 1;
    const Baked b = mustBake(casters, o);
    REQUIRE(b.map.layerCount() == 1);
}
