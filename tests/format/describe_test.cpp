#include "mtsm/describe.h"

#include <catch2/catch.hpp>
#include <filesystem>
#include <numeric>

#include "format/temp_folder.h"
#include "map_fixture.h"
#include "mtsm/writer.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

const Description::Block* block(const Description& d, const std::string& type) {
    for (const auto& b : d.blocks) {
        if (b.type == type) return &b;
    }
    return nullptr;
}

}  // namespace

TEST_CASE("describe counts what is in a map that was made by hand", "[format]") {
    // 20 x 10 pixels in tiles of 8: 3 x 2 tiles. Tile (0, 0): one opaque layer
    // everywhere; tile (1, 0): two layers with visibility in one pixel; the rest is
    // empty.
    MapInfo info = plainInfo(20, 10, 8);
    info.attributes = {{"a", std::int64_t(1)}};
    std::vector<MapFace> faces(1);
    faces[0].projection = plainProjection(20, 10);
    faces[0].tiles.resize(6);
    Tile& opaque = faces[0].tiles[0];
    opaque.begin.resize(65);
    std::iota(opaque.begin.begin(), opaque.begin.end(), 0u);
    opaque.z.assign(64, 3.0f);
    Tile& clear = faces[0].tiles[1];
    clear.begin.assign(65, 2);
    clear.begin[0] = 0;
    clear.z = {1.5f, 7.0f};
    clear.v = {0.5f, 0.25f};
    clear.n = {1, 9};
    const TempFolder folder;
    const std::string path = folder / "a.mtsm";
    WriteOptions options;
    options.codec = Codec::none;
    REQUIRE(writeMap(*ShadowMap::create(info, std::move(faces)), path, options));

    const auto d = describe(path);
    REQUIRE(d);
    CHECK(d->probe.width == 20);
    CHECK(d->probe.tileSize == 8);
    CHECK(d->fileBytes == std::filesystem::file_size(path));
    CHECK(d->tiles == 6);
    CHECK(d->emptyTiles == 4);
    CHECK(d->opaqueTiles == 1);
    CHECK(d->pixels == 200);
    CHECK(d->emptyPixels == 200 - 65);
    CHECK(d->layers == 66);
    CHECK(d->mostLayers == 2);
    CHECK(d->layerHistogram == std::vector<std::uint64_t>{135, 64, 1});
    CHECK(d->z == ZRange{1.5f, 7.0f});

    // Blocks in order of first appearance; with prefix and trailer they are the file.
    std::string order;
    std::uint64_t bytes = 64 + 32;
    for (const auto& b : d->blocks) {
        order += b.type + " ";
        bytes += b.bytes;
    }
    CHECK(order == "HEAD ATTR TILE HIER TOTL INDX ");
    CHECK(bytes == d->fileBytes);
    CHECK(block(*d, "TILE")->count == 2);
    CHECK(block(*d, "TILE")->critical);
    CHECK_FALSE(block(*d, "ATTR")->critical);
    CHECK(block(*d, "TOTL")->bytes == 32 + 40);

    REQUIRE(d->planes.size() == 4);
    CHECK(d->planes[0].name == "counts");
    CHECK(d->planes[0].planes == 2);
    CHECK(d->planes[0].constant == 1);
    CHECK(d->planes[0].raw == 1);
    CHECK(d->planes[0].storedBytes == 64);
    CHECK(d->planes[0].decodedBytes == 128);
    CHECK(d->planes[1].name == "z");
    CHECK(d->planes[1].constant == 1);
    CHECK(d->planes[1].raw == 1);
    CHECK(d->planes[1].storedBytes == 8);
    CHECK(d->planes[1].decodedBytes == 66 * 4);
    CHECK(d->planes[2].name == "v");
    CHECK(d->planes[2].storedBytes == 8);
    CHECK(d->planes[3].name == "n");
    CHECK(d->planes[3].storedBytes == 2);
    CHECK(d->samples == 64 + 1 + 9);

    // Left out: v and n of the opaque tile, and four tiles of counts: 4 x 8, 8 x 2 twice
    // and 4 x 2 pixels.
    CHECK(d->planes[0].leftOut == 4);
    CHECK(d->planes[0].leftOutBytes == 4 * 8 + 2 * 8 * 2 + 4 * 2);
    CHECK(d->planes[1].leftOut == 0);
    CHECK(d->planes[2].leftOut == 1);
    CHECK(d->planes[2].leftOutBytes == 64 * 4);
    CHECK(d->planes[3].leftOut == 1);
    CHECK(d->planes[3].leftOutBytes == 64);
}

TEST_CASE("describe reports a bad file as readMap does", "[format][bad-input]") {
    const auto d = describe("/dev/null");
    REQUIRE_FALSE(d);
    CHECK(d.error().code == ErrorCode::io);
    CHECK(d.error().message == readMap(std::string("/dev/null")).error().message);
}
