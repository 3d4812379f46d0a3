// ShadowMap: what it refuses, and that its hierarchy encloses its layers.
#include <catch2/catch.hpp>
#include <glm/geometric.hpp>

#include "map_fixture.h"
#include "mtsm/map.h"

using namespace mtsm;
using mtsm::test::noisyMap;

TEST_CASE("every node of the hierarchy is exactly the range of its pixels",
          "[map][exact]") {
    const ShadowMap map =
        noisyMap({.width = 77, .height = 41, .tileSize = 16, .seed = 3});
    for (std::uint32_t level = 0; level < map.levels(); ++level) {
        const std::uint32_t side = 1u << level;
        for (std::uint32_t y = 0; y * side < 41; ++y) {
            for (std::uint32_t x = 0; x * side < 77; ++x) {
                ZRange expected;
                for (std::uint32_t j = y * side; j < std::min(41u, (y + 1) * side); ++j) {
                    for (std::uint32_t i = x * side; i < std::min(77u, (x + 1) * side);
                         ++i) {
                        const PixelLayers p = map.pixel(0, i, j);
                        for (std::uint32_t k = 0; k < p.count; ++k)
                            expected.include({p.z[k], p.z[k]});
                    }
                }
                const ZRange found = map.zRange(0, level, x, y);
                REQUIRE(found == expected);
            }
        }
    }
}

TEST_CASE("light space and raster space round-trip at world offsets of 1e7",
          "[map][exact]") {
    Projection p;
    p.eye = {1e7, -2e7, 3e7};
    p.forward = glm::normalize(glm::dvec3(1, -2, 0.5));
    p.right = glm::normalize(glm::cross(p.forward, glm::dvec3(0, 1, 0)));
    p.up = glm::cross(p.right, p.forward);
    p.scale = {512, -512};
    p.offset = {256, 256};
    const glm::dvec3 world = p.eye + glm::dvec3(0.25, -1.5, 0.75);
    const glm::dvec3 light = p.lightFromWorld(world);
    CHECK(light.z > 0);
    CHECK(glm::length(p.worldFromLight(light) - world) < 1e-8);
    const glm::dvec3 back = p.lightFromRaster(p.rasterFromLight(light), light.z);
    CHECK(glm::length(back - light) < 1e-12);
    // x runs right and y up in light space; rows run down in the raster.
    CHECK(p.rasterFromLight({0.1, 0.1, 1}).x > p.rasterFromLight({0, 0, 1}).x);
    CHECK(p.rasterFromLight({0.1, 0.1, 1}).y < p.rasterFromLight({0, 0, 1}).y);
}

TEST_CASE("a map refuses what its header rules out and says where", "[map][bad-input]") {
    const auto broken = [](auto&& change) {
        MapInfo info = test::plainInfo(20, 20, 8);
        std::vector<MapFace> faces(1);
        faces[0].projection = test::plainProjection(20, 20);
        faces[0].tiles.resize(9);
        Tile& t = faces[0].tiles[0];
        t.begin.assign(65, 2);
        t.begin[0] = 0;
        t.z = {1.0f, 2.0f};
        t.v = {0.5f, 0.25f};
        t.n = {1, 3};
        change(info, faces);
        auto map = ShadowMap::create(info, std::move(faces));
        return map ? std::string() : map.error().message;
    };
    using F = std::vector<MapFace>;
    CHECK(broken([](MapInfo&, F&) {}).empty());
    CHECK(broken([](MapInfo& i, F&) { i.width = 0; }).find("0 x 20") !=
          std::string::npos);
    CHECK(broken([](MapInfo& i, F&) { i.tileSize = 12; }).find("12") !=
          std::string::npos);
    CHECK(broken([](MapInfo& i, F&) { i.channels = 2; }).find("channels") !=
          std::string::npos);
    CHECK(broken([](MapInfo& i, F&) { i.bias = NAN; }).find("bias") != std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f.resize(2); }).find("2 faces") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].tiles.pop_back(); }).find("8 tiles") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].projection.up *= 2.0; }).find("unit") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) {
              f[0].tiles[0].z[1] = 0.5f;
          }).find("pixel 0, layer 1") != std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].tiles[0].z[0] = NAN; }).find("finite") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].tiles[0].v[1] = 0.75f; }).find("visibility") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].tiles[0].n[0] = 0; }).find("no samples") !=
          std::string::npos);
    CHECK(broken([](MapInfo&, F& f) { f[0].tiles[0].begin[5] = 9; }).find("pixel 4") !=
          std::string::npos);
}

TEST_CASE("visibility may start again after it reached zero", "[map]") {
    MapInfo info = test::plainInfo(8, 8, 8);
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    Tile& t = faces[0].tiles[0];
    t.begin.assign(65, 3);
    t.begin[0] = 0;
    t.z = {1, 2, 3};
    t.v = {0.5f, 0.0f, 0.75f};
    CHECK(ShadowMap::create(info, faces));
    t.v = {0.5f, 0.25f, 0.75f};
    CHECK_FALSE(ShadowMap::create(info, faces));
}

TEST_CASE("identical sees every bit of a layer and nothing else", "[map]") {
    const auto spec = test::NoisySpec{.width = 20, .height = 9, .tileSize = 8, .seed = 5};
    const ShadowMap a = noisyMap(spec), b = noisyMap(spec);
    CHECK(identical(a, b));
    auto other = spec;
    other.seed = 6;
    CHECK_FALSE(identical(a, noisyMap(other)));
}
