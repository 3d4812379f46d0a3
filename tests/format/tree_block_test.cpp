// The trees of queries in files: TREE there and back, who passes it over, what bounds it,
// what may be wrong in it. That queries through them answer the same is tested on bakes
// (tests/shadow/release_bake_test.cpp).
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <random>

#include "format/near_files.h"
#include "format/reader_py.h"
#include "format/refused.h"
#include "format/temp_folder.h"
#include "format/trees_json.h"
#include "map_fixture.h"
#include "mtsm/describe.h"
#include "mtsm/shadow.h"
#include "mtsm/writer.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

using namespace mtsm;
using namespace mtsm::test;
using namespace mtsm::format;

namespace {

enum class Kind { opaque, sheets, media };

/// A rough surface under a light at the eye, with a bay of nothing and, if not opaque,
/// with thin layers in front.
ShadowMap roughMap(Kind kind, std::uint32_t size = 48, bool cube = false,
                   std::uint32_t channels = 1) {
    MapInfo info = plainInfo(size, size, 16);
    info.light.shape = cube ? LightShape::sphere : LightShape::disk;
    info.light.radius = 0.2;
    info.light.direction = {0, 0, -1};
    info.bias = 0.01f;
    if (kind == Kind::media) info.translucent = Translucent::media;
    const auto views = cube ? cubeProjections(size)
                            : std::vector<Projection>{plainProjection(size, size)};
    const ShadowMap map =
        mapOf(info, views, [&](std::uint32_t face, std::uint32_t x, std::uint32_t y) {
            std::vector<TestLayer> layers;
            if (x > size / 2 && y > size / 2 && x < 3 * size / 4) return layers;
            std::mt19937_64 random(face * 1000003 + y * 1009 + x);
            const float z = 2.0f + 0.3f * std::sin(0.3f * float(x)) +
                            (y % 7 == 0 ? 0.4f : 0.0f) +
                            0.05f * float(random() % 1000) / 1000.0f;
            if (kind != Kind::opaque && x % 3 != 0) layers.push_back({0.8f * z, 0.7f, 1});
            if (kind != Kind::opaque && x % 2 == 0) layers.push_back({0.9f * z, 0.4f, 3});
            layers.push_back({z, 0.0f, 1});
            return layers;
        });
    if (kind == Kind::opaque) return opaqueOf(map);
    if (channels == 1) return map;
    std::vector<MapFace> faces(map.faceCount());
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        faces[f].projection = map.projection(f);
        for (std::uint32_t i = 0; i < map.tilesX() * map.tilesY(); ++i) {
            Tile t = map.tile(f, i % map.tilesX(), i / map.tilesX());
            const std::vector<float> v = t.v;
            for (const float power : {0.5f, 2.0f}) {
                for (const float x : v)
                    t.v.push_back(std::pow(x, power));
            }
            faces[f].tiles.push_back(std::move(t));
        }
    }
    info.channels = 3;
    auto colored = ShadowMap::create(info, std::move(faces));
    REQUIRE(colored);
    return *std::move(colored);
}

Bytes withTrees(const ShadowMap& map, Codec codec = Codec::zstd) {
    WriteOptions options;
    options.codec = codec;
    options.trees = true;
    return *encodeMap(map, options);
}

ReadLimits treesAlone() {
    ReadLimits limits;
    limits.layers = false;
    return limits;
}

/// What a point and a bundle of rays behind the surface get, so that they go through the
/// trees of all faces.
std::vector<float> ask(const ShadowMap& map) {
    std::vector<glm::dvec3> points;
    std::mt19937_64 random(11);
    for (int i = 0; i < 150; ++i) {
        const auto across = [&] { return double(random() % 2001) / 250.0 - 4.0; };
        points.push_back({across(), across(), -4.0 - double(i % 3)});
        if (map.faceCount() > 1) points.back() = {points.back().z, across(), across()};
    }
    std::vector<float> out(points.size());
    ShadowOptions options;
    options.samples = 64;
    shadowFactors(map, map.info().light, points.data(), nullptr, points.size(),
                  out.data(), options);
    return out;
}

template <typename T>
bool same(const std::vector<T>& a, const std::vector<T>& b) {
    return a.size() == b.size() &&
           (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

void checkSame(const trace::PatchTree& a, const trace::PatchTree& b) {
    const auto &x = a.content(), &y = b.content();
    CHECK(same(x.groups, y.groups));
    CHECK(same(x.covers, y.covers));
    REQUIRE(x.levels.size() == y.levels.size());
    for (std::size_t i = 0; i < x.levels.size(); ++i)
        CHECK(same(x.levels[i].tiles, y.levels[i].tiles));
    CHECK(x.lowest == y.lowest);
    CHECK(x.highest == y.highest);
    CHECK(x.pieceSize == y.pieceSize);
    CHECK(a.margin() == b.margin());
}

void checkSame(const trace::DensityPyramid& a, const trace::DensityPyramid& b) {
    REQUIRE(a.empty() == b.empty());
    if (a.empty()) return;
    CHECK(a.low == b.low);
    CHECK(a.high == b.high);
    REQUIRE(a.levels.size() == b.levels.size());
    for (std::size_t i = 0; i < a.levels.size(); ++i) {
        CHECK(same(a.levels[i].texels, b.levels[i].texels));
        CHECK(same(a.levels[i].slabs, b.levels[i].slabs));
        CHECK(a.levels[i].base == b.levels[i].base);
        CHECK(a.levels[i].step == b.levels[i].step);
    }
}

void checkSameTrees(const ShadowMap& a, const ShadowMap& b) {
    for (std::uint32_t face = 0; face < a.faceCount(); ++face) {
        if (a.isOpaque()) {
            checkSame((*trace::patchTrees(a))[face], (*trace::patchTrees(b))[face]);
            continue;
        }
        constexpr auto use = trace::DensityUse::receivers;
        const trace::DensityTree& x = (*trace::densityTrees(a, use))[face];
        const trace::DensityTree& y = (*trace::densityTrees(b, use))[face];
        checkSame(x.media(), y.media());
        checkSame(x.sheets(), y.sheets());
        CHECK(x.finest() == y.finest());
        CHECK(x.coarsest() == y.coarsest());
    }
}

/// A file of the map whose TREE payload was changed.
Bytes changed(const ShadowMap& map, const std::function<void(Bytes&)>& change) {
    Surgery s(withTrees(map, Codec::none));
    change(s.payload(kTree));
    return s.close();
}

/// Where the parts' bytes begin in a payload that is stored as it is.
std::size_t contentAt(const Bytes& payload, std::size_t contentBytes) {
    return payload.size() - contentBytes;
}

}  // namespace

TEST_CASE("trees come back bit by bit, whatever the map and the codec",
          "[format][roundtrip][threads]") {
    for (const Kind kind : {Kind::opaque, Kind::sheets, Kind::media}) {
        for (const bool cube : {false, true}) {
            for (const std::uint32_t channels : {1u, 3u}) {
                if (channels == 3 && kind == Kind::opaque) continue;
                const ShadowMap map = roughMap(kind, 48, cube, channels);
                const std::vector<float> answers = ask(map);
                CHECK(*std::max_element(answers.begin(), answers.end()) > 0.5f);
                CHECK(*std::min_element(answers.begin(), answers.end()) < 0.1f);
                for (const Codec codec : {Codec::none, Codec::zstd}) {
                    const Bytes file = withTrees(map, codec);
                    const auto alone = readBytes(file, treesAlone());
                    INFO((alone ? "" : alone.error().message));
                    REQUIRE(alone);
                    CHECK_FALSE(alone->hasLayers());
                    CHECK(alone->layerCount() == map.layerCount());
                    CHECK(alone->isOpaque() == map.isOpaque());
                    CHECK(alone->zRange(0) == map.zRange(0));
                    checkSameTrees(map, *alone);
                    CHECK(same(ask(*alone), answers));
                    const auto whole = readBytes(file);
                    REQUIRE(whole);
                    CHECK(identical(map, *whole));
                    checkSameTrees(map, *whole);
                }
            }
        }
    }
}

TEST_CASE("trees of more than one part come back", "[format][roundtrip][threads]") {
    for (const Kind kind : {Kind::opaque, Kind::media}) {
        const ShadowMap map = roughMap(kind, 512);
        REQUIRE(queryMemoryBytes(map) - map.memoryBytes() > 4u * kTreePartBytes);
        const auto alone = readBytes(withTrees(map), treesAlone());
        REQUIRE(alone);
        checkSameTrees(map, *alone);
    }
}

TEST_CASE("the file of a map with trees is that of one without, and TREE",
          "[format][threads]") {
    const ShadowMap map = roughMap(Kind::sheets);
    Surgery s(withTrees(map));
    std::erase_if(s.parts, [](const auto& part) { return part.type == kTree; });
    CHECK(s.close() == encoded(map));
    const TempFolder folder;
    WriteOptions options;
    options.trees = true;
    REQUIRE(writeMap(map, folder / "a.mtsm", options));
    const auto d =
        describe(folder / "a.mtsm", treesAlone());  // reads layers all the same
    REQUIRE(d);
    CHECK(d->layers == map.layerCount());
    CHECK(std::count_if(d->blocks.begin(), d->blocks.end(), [](const auto& b) {
              return b.type == "TREE" && !b.critical && b.count == 1;
          }) == 1);
}

TEST_CASE("maps that queries know no trees of are written without", "[format]") {
    NoisySpec spec;
    spec.faces = 6;  // side by side: no cube
    const ShadowMap map = noisyMap(spec);
    CHECK(withTrees(map) == encoded(map));
    spec.faces = 1;
    spec.emptyTiles = 1.0;
    const ShadowMap empty = noisyMap(spec);
    CHECK(withTrees(empty) == encoded(empty));
    const auto read = readBytes(withTrees(empty), treesAlone());
    REQUIRE(read);
    CHECK(read->hasLayers());
}

TEST_CASE("layers are read where there are no trees that may stand for them",
          "[format]") {
    const ShadowMap map = roughMap(Kind::opaque);
    const auto plain = readBytes(encoded(map), treesAlone());
    REQUIRE(plain);
    CHECK(identical(map, *plain));
    ReadLimits limits = treesAlone();
    limits.trees = false;
    const auto unread = readBytes(withTrees(map), limits);
    REQUIRE(unread);
    CHECK(identical(map, *unread));
    // Another revision's are not looked at, whatever they are.
    const Bytes later = changed(map, [](Bytes& tree) {
        tree = Bytes(100, 7);
        poke(tree, 0, kTreeRevision + 1);
    });
    const auto other = readBytes(later, treesAlone());
    REQUIRE(other);
    CHECK(identical(map, *other));
    const Bytes shorter = changed(map, [](Bytes& tree) { tree = Bytes(4, 9); });
    CHECK(readBytes(shorter, treesAlone()));
    limits = treesAlone();
    limits.maxBytes = other->memoryBytes() - 1;
    checkRefused(later, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
    // Those beside a near field are not those of the layers alone.
    NearField field;
    field.chunks.push_back({});
    const auto near = [&](const ShadowMap& from, bool has) {
        std::vector<MapFace> faces(1);
        faces[0].projection = from.projection(0);
        for (std::uint32_t i = 0; i < from.tilesX() * from.tilesY(); ++i)
            faces[0].tiles.push_back(from.tile(0, i % from.tilesX(), i / from.tilesX()));
        if (has) faces[0].nearField = field;
        auto made = ShadowMap::create(from.info(), std::move(faces));
        REQUIRE(made);
        return *std::move(made);
    };
    limits = treesAlone();
    limits.nearField = false;
    const auto without = readBytes(withTrees(near(map, true)), limits);
    REQUIRE(without);
    CHECK(identical(near(map, false), *without));
    checkSameTrees(map, *without);
}

TEST_CASE("a map of which every v is -0 is opaque in its file as well", "[format]") {
    const ShadowMap map =
        mapOf(plainInfo(20, 20, 8), plainProjection(20, 20),
              [](std::uint32_t x, std::uint32_t y) {
                  return std::vector<TestLayer>{{2.0f + 0.01f * float(x + y), -0.0f, 1}};
              });
    REQUIRE(map.isOpaque());
    const Bytes file = withTrees(map);
    const auto whole = readBytes(file), alone = readBytes(file, treesAlone());
    REQUIRE(whole);
    CHECK(identical(map, *whole));
    REQUIRE(alone);
    CHECK_FALSE(alone->hasLayers());
    checkSameTrees(map, *alone);
    const TempFolder folder;
    WriteOptions options;
    options.trees = true;
    REQUIRE(writeMap(map, folder / "a.mtsm", options));
    CHECK(readerPy(folder / "a.mtsm", "--quiet").exitCode == 0);
}

TEST_CASE("damaged trees can be passed over", "[format][bad-input]") {
    const ShadowMap map = roughMap(Kind::media);
    Bytes file = withTrees(map);
    const char* const name = "TREE";
    const auto at = std::search(file.begin(), file.end(), name, name + 4);
    REQUIRE(at != file.end());
    at[sizeof(BlockHeader) + 30] ^= 1;
    checkRefused(file, ErrorCode::badFile, "block TREE at offset");
    ReadLimits limits;
    limits.trees = false;
    const auto read = readBytes(file, limits);
    REQUIRE(read);
    CHECK(identical(map, *read));
}

TEST_CASE("trees count against the memory that a reader is given", "[format]") {
    for (const Kind kind : {Kind::opaque, Kind::media}) {
        const ShadowMap map = roughMap(kind, 256);
        const Bytes file = withTrees(map);
        ReadLimits limits = treesAlone();
        const std::uint64_t trees = queryMemoryBytes(map) - map.memoryBytes();
        limits.maxBytes = trees;
        checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
        // Less than layers need.
        limits.maxBytes = 3 * trees + (8 << 20);
        CHECK(readBytes(file, limits));
    }
}

TEST_CASE("a TREE block that lies is refused and the message says where",
          "[format][bad-input]") {
    const ShadowMap map = roughMap(Kind::opaque);
    const trace::PatchTree& tree = (*trace::patchTrees(map))[0];
    const std::size_t groups = tree.content().groups.size();
    const std::size_t covers = tree.content().covers.size();
    std::size_t tiles = 0;
    for (const auto& level : tree.levels())
        tiles += level.tiles.size();
    REQUIRE(groups * sizeof(trace::PatchGroup) <= kTreePartBytes);  // one part each
    const std::size_t bytes = 8 * tiles + groups * sizeof(trace::PatchGroup) + 2 * covers;
    const auto check = [&](const std::function<void(Bytes&)>& change,
                           const std::string& words) {
        const Bytes file = changed(map, change);
        checkRefused(file, ErrorCode::badFile, words);
        checkRefused(file, ErrorCode::badFile, words, treesAlone());
    };
    const auto put = [](std::size_t at, auto value) {
        return [=](Bytes& payload) { poke(payload, at, value); };
    };
    check(put(4, 1u), "trees of kind 1, the map's are 0");
    check(put(8, 6u), "has 6 faces, not 1");
    check(put(12, 1u), "reserved bytes are not zero");
    check([](Bytes& t) { t.clear(); }, "ends within its first 16 bytes");
    check([](Bytes& t) { t.erase(t.begin() + 8, t.end()); },
          "ends within its first 16 bytes");
    check([](Bytes& t) { t.erase(t.begin() + 20, t.end()); }, "ends within what it says");
    check(put(16, std::uint64_t(1) << 28), "268435456 groups");
    check(put(24, std::uint64_t(1) << 32), "4294967296 rows");
    check(put(24, std::uint64_t(1) << 30), "parts, more than the block can hold");
    check(put(32, NAN), "a range or a size of pieces is nan");
    check(put(44, 1u), "reserved bytes are not zero");
    check(put(48, 0u), "part 0: stores 0 bytes");
    check(put(52, std::uint32_t(groups * 144 - 1)), "left over");
    check([](Bytes& t) { t.pop_back(); }, "reaches past the end");

    // Columns of the tiles: bytes 0 to 3 of all groups, then of groups and slots.
    const auto content = [&](std::size_t at, int value) {
        return [=, &map](Bytes& t) { t[contentAt(t, bytes) + at] = std::uint8_t(value); };
    };
    // In front of them are those of level 1: 2 x 2 of 32 pixels; then one of 64.
    REQUIRE(tiles == 5);
    check(content(2 * tiles, 255), "tile 0 of level 1: a list of");
    check(
        [&](Bytes& t) {  // tile 3 of level 1 is tile 0
            const std::size_t first = contentAt(t, bytes);
            for (std::size_t byte = 0; byte < 8; ++byte)
                t[first + byte * tiles + 3] = t[first + byte * tiles];
        },
        "which is in another one");
    // Columns of the groups: w, 4 bytes; above, below, u0, v0, u1, v1, 2 each; two
    // slopes, 4; residual, 2; children, cover, 4; childGroups, kind.
    const std::size_t n = 4 * groups, first = 8 * tiles;
    const auto columns = [&](std::size_t bytesBefore) { return first + bytesBefore * n; };
    const std::size_t slot = 4 * tree.levels().back().tiles[0].group;  // of the root's
    check(content(columns(3) + slot, 0x7f), "a depth, slope or bound is");
    check(content(columns(8) + slot, 0xff), "is not within a tile");  // u0
    check(content(columns(12) + slot, 0), "is not within a tile");    // u1
    check(content(columns(33) + slot, 0x7f), "rows of texels from");  // cover
    check(content(columns(29) + slot, 0x1f), "a list of");            // children
    check(content(columns(35) + slot, 31), "level 31 of");            // kind
    check(content(columns(35) + slot, 2 | 128), "is bumpy, but larger");
    // The root's children as the root's own: neither of lists of tiles nor smaller.
    check(
        [&](Bytes& t) {
            const std::size_t at = contentAt(t, bytes);
            const std::size_t root = slot / 4;
            for (std::size_t byte = 0; byte < 3; ++byte)
                t[at + columns(26 + byte) + slot] = std::uint8_t(root >> (8 * byte));
            t[at + columns(29) + slot] = std::uint8_t(
                root >> 24 | std::size_t(tree.levels().back().tiles[0].slots) << 4);
            t[at + columns(34) + slot] = 1;
        },
        "which is in another one");
}

TEST_CASE("a TREE block of densities that lies is refused", "[format][bad-input]") {
    const ShadowMap map = roughMap(Kind::sheets);
    const auto check = [&](std::size_t at, auto value, const std::string& words) {
        const Bytes file = changed(map, [&](Bytes& tree) { poke(tree, at, value); });
        checkRefused(file, ErrorCode::badFile, words, treesAlone());
    };
    // No media; sheets of 7 levels: 48 pixels, 24, 12, 6, 3, 2, 1.
    // Which of them the layers are must be read to be known.
    checkRefused(changed(map, [](Bytes& tree) { poke(tree, 4, 0u); }), ErrorCode::badFile,
                 "trees of kind 0, the map's are 1");
    check(16, 1u, "a pyramid of depths from 0 to 0");
    check(32, 2u, "is there 2 times");
    check(36, NAN, "a pyramid of depths from nan");
    check(40, INFINITY, "a pyramid of depths from");
    check(44, 1u, "is there 1 times");
    check(48, std::uint64_t(1) << 32, "a level of 4294967296 words");
    check(48, std::uint64_t(0), "stores");
    check(56, NAN, "level 0: ranges from nan");
    check(60, 0.0f, "in steps of 0");
    const std::size_t partsAt = 48 + 7 * 16;
    check(partsAt, 0u, "part 0: stores 0 bytes");
    // The first texel's list, whose length's highest byte is in the part's last column.
    const trace::DensityTree& tree =
        (*trace::densityTrees(map, trace::DensityUse::receivers))[0];
    std::size_t texels = 0, words = 0;
    for (const trace::DensityLevel& level : tree.sheets().levels) {
        texels += level.texelCount();
        words += level.texels.back().begin;
    }
    const Bytes file = changed(map, [&](Bytes& t) {
        t[contentAt(t, 8 * texels + 4 * words) + 7 * texels] = 0x40;
    });
    checkRefused(file, ErrorCode::badFile, "face 0: ", treesAlone());
}

TEST_CASE("both readers find the same trees, number by number", "[format][roundtrip]") {
    const TempFolder folder;
    WriteOptions options;
    options.trees = true;
    const auto read = [&](const ShadowMap& map) {
        REQUIRE(writeMap(map, folder / "a.mtsm", options));
        const Run run = readerPy(folder / "a.mtsm");
        INFO(run.err);
        REQUIRE(run.exitCode == 0);
        return nlohmann::json::parse(run.out)["trees"];
    };
    checkTrees(read(roughMap(Kind::opaque, 40, true)), roughMap(Kind::opaque, 40, true));
    for (const Kind kind : {Kind::sheets, Kind::media})
        checkTrees(read(roughMap(kind, 20, false, 3)), roughMap(kind, 20, false, 3));
}

TEST_CASE("both readers refuse trees that lie", "[format][bad-input]") {
    const TempFolder folder;
    std::mt19937_64 random(3);
    int refused = 0;
    const Bytes file = withTrees(roughMap(Kind::opaque, 20), Codec::none);
    for (int i = 0; i < 40; ++i) {
        Surgery s(file);
        Bytes& payload = s.payload(kTree);
        for (int change = 0; change < 5; ++change)
            payload[random() % payload.size()] = std::uint8_t(random());
        const Bytes bytes = s.close();
        std::ofstream(folder / "a.mtsm", std::ios::binary)
            .write(reinterpret_cast<const char*>(bytes.data()), long(bytes.size()));
        const bool good = bool(readBytes(bytes));
        refused += !good;
        const Run run = readerPy(folder / "a.mtsm", "--quiet");
        INFO(i << (good ? " taken, " : " refused, ") << run.err);
        CHECK(run.exitCode == (good ? 0 : 4));
    }
    CHECK(refused > 4);
    CHECK(refused < 36);
}

TEST_CASE("of random changes in a TREE block comes an error or a map that can be asked",
          "[format][bad-input]") {
    std::vector<Bytes> files;
    for (const Kind kind : {Kind::opaque, Kind::sheets, Kind::media}) {
        for (const Codec codec : {Codec::none, Codec::zstd})
            files.push_back(withTrees(roughMap(kind), codec));
    }
    std::mt19937_64 random(29);
    ReadLimits limits = treesAlone();
    limits.maxBytes = 64 << 20;
    int read = 0, refused = 0;
    for (int i = 0; i < 3000; ++i) {
        Surgery s(files[std::size_t(i) % files.size()]);
        damage(s.payload(kTree), random);
        const auto map = readBytes(s.close(), limits);
        (map ? read : refused) += 1;
        if (!map) continue;
        for (const float f : ask(*map))
            REQUIRE((f >= 0.0f && f <= 1.0f));
    }
    CHECK(refused > 500);
    CHECK(read > 500);
}
