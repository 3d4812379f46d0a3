// ShadowMap: what it refuses, and that its hierarchy encloses its layers.
#include <catch2/catch.hpp>
#include <glm/geometric.hpp>

#include "map_fixture.h"
#include "mtsm/map.h"

using namespace mtsm;
using namespace mtsm::test;

TEST_CASE("a map is opaque if no layer lets anything through, planes or not", "[map]") {
    const auto mapWith = [](float v) {
        return mapOf(
            plainInfo(8, 8, 8), plainProjection(8, 8),
            [v](std::uint32_t x, std::uint32_t y) {
                return std::vector<TestLayer>{{2.0f, x == 7 && y == 7 ? v : 0.0f, 1}};
            });
    };
    CHECK(mapWith(0.0f).isOpaque());
    CHECK(mapWith(-0.0f).isOpaque());
    CHECK_FALSE(mapWith(0.125f).isOpaque());
}

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

TEST_CASE("a map keeps no memory that its layers do not take", "[map]") {
    Tile tile;
    for (auto* words : {&tile.begin, &tile.n})
        words->reserve(1000);
    for (auto* floats : {&tile.z, &tile.v})
        floats->reserve(1000);
    tile.begin.assign(65, 1);
    tile.begin[0] = 0;
    tile.z = {1.0f};
    tile.v = {0.5f};
    tile.n = {2};
    MapFace face;
    face.projection = test::plainProjection(8, 8);
    face.tiles.push_back(std::move(tile));
    std::vector<MapFace> faces;
    faces.push_back(std::move(face));
    const auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    const Tile& kept = map->tile(0, 0, 0);
    CHECK(kept.begin.capacity() == 65);
    CHECK(kept.z.capacity() == 1);
    CHECK(kept.v.capacity() == 1);
    CHECK(kept.n.capacity() == 1);
}

TEST_CASE("identical sees every bit of a layer and nothing else", "[map]") {
    const auto spec = test::NoisySpec{.width = 20, .height = 9, .tileSize = 8, .seed = 5};
    const ShadowMap a = noisyMap(spec), b = noisyMap(spec);
    CHECK(identical(a, b));
    auto other = spec;
    other.seed = 6;
    CHECK_FALSE(identical(a, noisyMap(other)));
}

TEST_CASE("boxes of a near field hold what is below them and no more", "[map]") {
    std::mt19937_64 random(3);
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    NearField& made = faces[0].nearField;
    made.levels.resize(7);  // what is there does not matter
    for (int i = 0; i < 16 * 16 + 1; ++i) {
        NearChunk chunk;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.low[axis] = float(random() % 1000);
            chunk.step[axis] = 0x1p-8f;
        }
        for (auto& corner : chunk.corner) {
            for (auto& axis : corner) {
                for (auto& q : axis)
                    q = std::uint16_t(random() % (i % 2 ? 9000 : 4096));
            }
        }
        made.chunks.push_back(chunk);
    }
    const auto map =
        ShadowMap::create(test::plainInfo(8, 8, 8), std::vector<MapFace>(faces));
    REQUIRE(map);
    const NearField& field = map->nearField(0);
    REQUIRE(field.levels.size() == 3);
    CHECK(field.levels[0].size() == 17);
    CHECK(field.levels[1].size() == 2);
    CHECK(field.levels[2].size() == 1);
    const auto low = [](const NearBoxes& b, int axis, std::size_t i) {
        return b.low[axis][i];
    };
    for (int axis = 0; axis < 3; ++axis) {
        float whole[2] = {INFINITY, -INFINITY};
        for (std::size_t i = 0; i < field.chunks.size(); ++i) {
            float least = INFINITY, most = -INFINITY;
            for (int c = 0; c < 3; ++c) {
                for (int t = 0; t < NearChunk::kTriangles; ++t) {
                    least = std::min(least, field.chunks[i].at(c, axis, t));
                    most = std::max(most, field.chunks[i].at(c, axis, t));
                }
            }
            CHECK(low(field.levels[0][i / 16], axis, i % 16) == least);
            CHECK(field.levels[0][i / 16].high[axis][i % 16] == most);
            whole[0] = std::min(whole[0], least);
            whole[1] = std::max(whole[1], most);
        }
        CHECK(std::min(low(field.levels[2][0], axis, 0),
                       low(field.levels[2][0], axis, 1)) == whole[0]);
        CHECK(std::max(field.levels[2][0].high[axis][0],
                       field.levels[2][0].high[axis][1]) == whole[1]);
        CHECK(low(field.levels[2][0], axis, 2) == INFINITY);  // no child
        CHECK(field.levels[2][0].high[axis][2] == -INFINITY);
    }
    // Its memory is that of chunks and boxes, and identical looks at the chunks.
    faces[0].nearField = {};
    const auto none =
        ShadowMap::create(test::plainInfo(8, 8, 8), std::vector<MapFace>(faces));
    REQUIRE(none);
    CHECK(map->memoryBytes() == none->memoryBytes() + memoryBytes(field));
    CHECK(memoryBytes(field) == field.chunks.memoryBytes() + 20 * 384);
    CHECK(nearFieldBytes(257, 15) == NearChunks::memoryBytes(257, 15) + 20 * 384);
    CHECK(nearFieldBytes(0, 15) == 0);
    CHECK_FALSE(identical(*map, *none));
}

TEST_CASE("a near field whose grids are not finite is refused", "[map][bad-input]") {
    const auto refused = [](float low, float step) {
        std::vector<MapFace> faces(1);
        faces[0].projection = test::plainProjection(8, 8);
        faces[0].tiles.resize(1);
        NearChunk chunk;
        faces[0].nearField.chunks.push_back(chunk);
        chunk.low[2] = low;
        chunk.step[2] = step;
        faces[0].nearField.chunks.push_back(chunk);
        const auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
        return !map && map.error().message.find("chunk 1, axis w") != std::string::npos;
    };
    CHECK_FALSE(refused(-3.0f, 0.0f));
    CHECK(refused(NAN, 1.0f));
    CHECK(refused(-INFINITY, 1.0f));
    CHECK(refused(0.0f, NAN));
    CHECK(refused(0.0f, -1e-30f));
    CHECK(refused(0.0f, 1e37f));  // 65535 of them
    CHECK(refused(3e38f, 1e33f));
}
