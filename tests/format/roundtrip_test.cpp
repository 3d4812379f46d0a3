// What goes in comes out, to the last bit.
#include <bit>
#include <catch2/catch.hpp>
#include <limits>

#include "format/refused.h"
#include "map_fixture.h"
#include "mtsm/reader.h"
#include "mtsm/writer.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

ShadowMap thereAndBack(const ShadowMap& map, const WriteOptions& options = {}) {
    const auto bytes = encodeMap(map, options);
    REQUIRE(bytes);
    auto back = readBytes(*bytes);
    INFO((back ? "" : back.error().message));
    REQUIRE(back);
    return *std::move(back);
}

WriteOptions withCodec(Codec codec, int level = 3) {
    WriteOptions options;
    options.codec = codec;
    options.level = level;
    return options;
}

/// One tile of w x h pixels whose layers `fill` gives.
template <typename Fill>
ShadowMap oneTile(std::uint32_t side, std::uint32_t channels, Fill fill) {
    MapInfo info = plainInfo(side, side, 64);
    info.channels = channels;
    Tile t;
    fill(t);
    MapFace face;
    face.projection = plainProjection(side, side);
    face.tiles.push_back(std::move(t));
    std::vector<MapFace> faces;
    faces.push_back(std::move(face));
    auto map = ShadowMap::create(info, std::move(faces));
    INFO((map ? "" : map.error().message));
    REQUIRE(map);
    return *std::move(map);
}

}  // namespace

TEST_CASE("a map of any size, tile size, faces and channels comes back bit by bit",
          "[format][roundtrip]") {
    struct Size {
        std::uint32_t width, height;
    };
    for (const Size size : {Size{1, 1}, {1, 70}, {37, 19}, {64, 64}, {65, 129}}) {
        for (std::uint32_t tileSize : {8u, 16u, 32u, 64u, 128u, 256u}) {
            for (std::uint32_t faces : {1u, 6u}) {
                for (std::uint32_t channels : {1u, 3u}) {
                    if (faces == 6 && size.width > 64) continue;
                    NoisySpec spec;
                    spec.width = size.width;
                    spec.height = size.height;
                    spec.tileSize = tileSize;
                    spec.faces = faces;
                    spec.channels = channels;
                    spec.opaque = (size.width + tileSize) % 3 == 0;
                    const ShadowMap map = noisyMap(spec);
                    INFO(size.width << " x " << size.height << ", tile " << tileSize
                                    << ", faces " << faces << ", channels " << channels);
                    CHECK(identical(map, thereAndBack(map)));
                }
            }
        }
    }
}

TEST_CASE("every codec and level gives the same map back", "[format][roundtrip]") {
    NoisySpec spec;
    spec.width = 90;
    spec.height = 50;
    spec.tileSize = 32;
    spec.channels = 3;
    const ShadowMap map = noisyMap(spec);
    CHECK(identical(map, thereAndBack(map, withCodec(Codec::none))));
    for (int level : {1, 3, 9, 19})
        CHECK(identical(map, thereAndBack(map, withCodec(Codec::zstd, level))));
    CHECK_FALSE(encodeMap(map, withCodec(Codec::zstd, 0)));
    CHECK_FALSE(encodeMap(map, withCodec(Codec::zstd, 20)));
    CHECK_FALSE(encodeMap(map, withCodec(Codec(2))));
}

TEST_CASE("an empty map comes back empty", "[format][roundtrip]") {
    NoisySpec spec;
    spec.emptyTiles = 1.0;
    spec.width = 300;
    const ShadowMap map = noisyMap(spec);
    REQUIRE(map.layerCount() == 0);
    const ShadowMap back = thereAndBack(map);
    CHECK(identical(map, back));
    CHECK(back.zRange(0).empty());
}

TEST_CASE("planes that say what their absence means take no bytes",
          "[format][roundtrip]") {
    const auto fill = [](bool planes, Tile& t) {
        t.begin = {0, 1, 3, 3, 4};
        t.z = {1.0f, 2.0f, 2.5f, 4.0f};
        if (!planes) return;
        t.v.assign(4, 0.0f);
        t.n.assign(4, 1);
    };
    const auto bare = oneTile(2, 1, [&](Tile& t) { fill(false, t); });
    const auto full = oneTile(2, 1, [&](Tile& t) { fill(true, t); });
    CHECK(*encodeMap(bare) == *encodeMap(full));
    CHECK(thereAndBack(full).tile(0, 0, 0).v.empty());
    CHECK(thereAndBack(full).tile(0, 0, 0).n.empty());
}

TEST_CASE("every combination of planes and element sizes comes back",
          "[format][roundtrip]") {
    std::mt19937 random(3);
    for (std::uint32_t mostN : {1u, 2u, 255u, 256u, 65535u, 65536u, 0xffffffffu}) {
        for (int opacity = 0; opacity < 3; ++opacity) {  // none, constant, noisy
            for (std::uint32_t channels : {1u, 3u}) {
                const auto map = oneTile(16, channels, [&](Tile& t) {
                    t.begin = {0};
                    for (int p = 0; p < 256; ++p) {
                        const std::uint32_t count = p == 17 ? 300 : random() % 4;
                        for (std::uint32_t i = 0; i < count; ++i)
                            t.z.push_back(1.0f + float(i) + float(p) / 64.0f);
                        t.begin.push_back(std::uint32_t(t.z.size()));
                    }
                    const std::size_t layers = t.z.size();
                    if (opacity == 1) t.v.assign(layers * channels, 0.5f);
                    if (opacity == 2) {
                        t.v.resize(layers * channels);
                        for (std::uint32_t c = 0; c < channels; ++c) {
                            for (std::size_t p = 0; p < 256; ++p) {
                                float v = 1.0f;
                                for (std::size_t i = t.begin[p]; i < t.begin[p + 1]; ++i)
                                    t.v[c * layers + i] = v *=
                                        float(1 + random() % 64) / 64;
                            }
                        }
                    }
                    t.n.resize(layers);
                    for (auto& n : t.n)
                        n = 1 + random() % mostN;
                    t.n.back() = mostN;
                });
                INFO("n to " << mostN << ", opacity " << opacity << ", channels "
                             << channels);
                CHECK(identical(map, thereAndBack(map)));
                CHECK(identical(map, thereAndBack(map, withCodec(Codec::none))));
            }
        }
    }
}

TEST_CASE("minus zero, the smallest and the largest numbers keep their bits",
          "[format][roundtrip]") {
    using Limits = std::numeric_limits<float>;
    const auto map = oneTile(2, 1, [](Tile& t) {
        t.begin = {0, 1, 2, 4, 4};
        t.z = {Limits::denorm_min(), Limits::max(), Limits::min(), 1e9f};
        t.v = {-0.0f, 1.0f, Limits::denorm_min(), -0.0f};
        t.n = {1, 0xffffffffu, 1, 1};
    });
    CHECK(identical(map, thereAndBack(map)));
}

TEST_CASE("header numbers and attributes keep every bit, NaN payloads included",
          "[format][roundtrip]") {
    MapInfo info = plainInfo(9, 9, 8);
    info.light.shape = LightShape::rect;
    info.light.position = {-0.0, 1e300, 5e-324};
    info.light.direction = {0.6, -0.0, -0.8};
    info.light.up = {1e-300, 2.0, -3.0};
    info.light.radius = 0.1;
    info.light.size = {0.25, 1e-12};
    info.light.angularDiameter = 0.00925;
    info.bias = 1e-45f;
    info.biasPerDepth = 3.25e-3f;
    info.maxLayers = 0xfffffffeu;
    info.resets = 17;
    info.toleranceAsked = 0.02f;
    info.toleranceReached = 0.0199f;
    info.metresPerUnit = 0.01;
    info.castersClipped = true;
    info.samples = 0xfedcba9876543210ull;
    info.samplesDropped = 0x0123456789abcdefull;
    info.software = std::string("nul \0 within", 12);
    info.settings = "\xf0\x9f\x8c\x92";
    const auto nan = std::bit_cast<double>(0x7ff800000000beefull);
    const auto negativeNan = std::bit_cast<double>(0xfff0000000000001ull);
    info.attributes = {{"a", std::string()},
                       {std::string(255, 'n'), std::vector<double>{}},
                       {"lowest", std::numeric_limits<std::int64_t>::min()},
                       {"d", std::vector<double>{nan, negativeNan, -0.0, INFINITY}}};
    std::vector<MapFace> faces(6);
    for (int f = 0; f < 6; ++f) {
        Projection& p = faces[std::size_t(f)].projection;
        p = plainProjection(9, 9);
        p.kind = f % 2 ? ProjectionKind::orthographic : ProjectionKind::perspective;
        p.eye = {1e7 + f, -0.0, 1.0 / 3.0};
        p.near = f * 0.1;
        p.far = f == 3 ? 1e9 : INFINITY;
        faces[std::size_t(f)].tiles.resize(4);
    }
    const auto map = ShadowMap::create(info, std::move(faces));
    REQUIRE(map);
    const ShadowMap back = thereAndBack(*map);
    CHECK(identical(*map, back));
    const auto& d = std::get<std::vector<double>>(back.info().attributes[3].value);
    CHECK(std::bit_cast<std::uint64_t>(d[0]) == 0x7ff800000000beefull);
}

TEST_CASE("a text that is not UTF-8 is refused before a byte is written",
          "[format][bad-input]") {
    const auto encode = [](const MapInfo& info) {
        std::vector<MapFace> faces(1);
        faces[0].projection = plainProjection(1, 1);
        faces[0].tiles.resize(1);
        return encodeMap(*ShadowMap::create(info, std::move(faces)));
    };
    const MapInfo plain = plainInfo(1, 1, 8);
    // Latin-1, overlong, a surrogate, above U+10FFFF, cut, a lone continuation byte.
    for (const char* text : {"caf\xe9", "\xc0\xaf", "\xe0\x80\x80", "\xed\xa0\x80",
                             "\xf4\x90\x80\x80", "\xff", "cut \xe2\x82", "\x80"}) {
        MapInfo software = plain, settings = plain, name = plain, value = plain;
        software.software = text;
        settings.settings = text;
        name.attributes = {{text, std::int64_t(1)}};
        value.attributes = {{"name", std::string(text)}};
        for (const MapInfo* info : {&software, &settings, &name, &value}) {
            const auto bytes = encode(*info);
            REQUIRE_FALSE(bytes);
            CHECK(bytes.error().code == ErrorCode::badArgument);
            CHECK_THAT(bytes.error().message, Catch::Contains("not UTF-8"));
        }
    }
    MapInfo good = plain;
    good.settings =
        "\x7f \xc2\x80 \xe0\xa0\x80 \xed\x9f\xbf \xef\xbf\xbf \xf4\x8f\xbf\xbf";
    CHECK(encode(good));
}
