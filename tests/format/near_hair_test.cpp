// The strands of near fields in files: HAIR there and back, what bounds it, what may be
// wrong in it.
#include <algorithm>
#include <catch2/catch.hpp>
#include <limits>
#include <random>

#include "format/bad_files.h"
#include "format/near_files.h"
#include "format/refused.h"
#include "format/temp_folder.h"
#include "map_fixture.h"
#include "mtsm/describe.h"
#include "mtsm/writer.h"

using namespace mtsm;
using namespace mtsm::test;
using namespace mtsm::format;

namespace {

NearHair noisyHair(std::size_t chunks, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    NearHair hair;
    for (std::size_t i = 0; i < chunks; ++i) {
        NearHairChunk chunk;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.low[axis] = float(random() % 10000) / 8.0f - 100.0f;
            chunk.step[axis] = random() % 5 ? 1.0f / float(1 + random() % 512) : 0.0f;
        }
        chunk.halfStep = float(random() % 1000) * 0x1p-20f;
        for (int t = 0; t < NearHairChunk::kSegments; ++t) {
            for (int e = 0; e < 2; ++e) {
                for (auto& axis : chunk.end[e])
                    axis[t] = std::uint16_t(random());
                chunk.half[e][t] = std::uint8_t(random());
            }
            chunk.opacity[t] = std::uint16_t(1 + random() % 65535);
        }
        hair.chunks.push_back(chunk);
    }
    return hair;
}

/// A small map with these strands, one list for each face.
ShadowMap mapWith(std::vector<NearHair> hair, NearField triangles = {}) {
    return mapWithFaces(std::uint32_t(hair.size()), false,
                        [&](MapFace& face, std::uint32_t f) {
                            face.nearHair = std::move(hair[f]);
                            if (f == 0) face.nearField = std::move(triangles);
                        });
}

/// A file whose HAIR payload is `hair`.
Bytes withHair(const Bytes& hair) {
    Surgery s(encoded(mapWith({NearHair()})));
    s.parts.insert(s.parts.begin() + 1, {kHair, 0, hair});
    return s.close();
}

}  // namespace

TEST_CASE("strands come back bit by bit, whatever their number and codec",
          "[format][roundtrip][threads]") {
    for (const std::size_t chunks : {1u, 2u, 1023u, 1024u, 1025u}) {
        const ShadowMap map = mapWith({noisyHair(chunks, chunks)});
        for (const Codec codec : {Codec::none, Codec::zstd}) {
            const auto back = readBytes(encoded(map, codec));
            INFO((back ? "" : back.error().message));
            REQUIRE(back);
            CHECK(identical(map, *back));
        }
    }
    NearField triangles;
    for (int i = 0; i < 3; ++i)
        triangles.chunks.push_back({});
    const ShadowMap six =
        mapWith({noisyHair(3, 1), {}, noisyHair(300, 2), {}, {}, {}}, triangles);
    const auto back = readBytes(encoded(six));
    REQUIRE(back);
    CHECK(identical(six, *back));
    CHECK(back->nearHair(2).levels.size() == 3);  // 19, 2 and 1 nodes
    CHECK_FALSE(
        identical(six, mapWith({noisyHair(3, 1), {}, {}, {}, {}, {}}, triangles)));
}

TEST_CASE("strands written by hand are the segment that they say", "[format]") {
    const auto map = readBytes(withHair(handmadeHair()));
    INFO((map ? "" : map.error().message));
    REQUIRE(map);
    REQUIRE(map->nearHair(0).chunks.size() == 1);
    const NearHairChunk chunk = map->nearHair(0).chunks[0];
    CHECK(chunk.segments() == 1);
    const float expected[2][3] = {{0, 0, 0.5f}, {8, 0, 0.5f}};
    for (int e = 0; e < 2; ++e) {
        for (int axis = 0; axis < 3; ++axis)
            CHECK(chunk.at(e, axis, 0) == expected[e][axis]);
    }
    CHECK(chunk.halfAt(0, 0) == 0x1p-9f);
    CHECK(chunk.halfAt(1, 0) == 0x1p-8f);
    CHECK(chunk.opacity[0] == 26214);
    // Its box holds the ribbon however it is turned, and what lies on the strand.
    const NearBoxes& box = map->nearHair(0).levels[0][0];
    const double widest = 0x1p-8 * 9 / 2;  // scale 4.5 pixels
    CHECK(box.low[1][0] <= -widest);
    CHECK(box.high[1][0] >= widest);
    CHECK(box.high[0][0] >= 8 + widest);
    CHECK(box.low[2][0] <= 0.5 - 0.5 * 0x1p-8);
    CHECK(box.high[2][0] >= 0.5 + 0.5 * 0x1p-8);
}

TEST_CASE("a reader that wants no near field passes strands over", "[format]") {
    const ShadowMap map = mapWith({noisyHair(40, 7)});
    const Bytes file = encoded(map);
    ReadLimits limits;
    limits.nearField = false;
    const auto without = readBytes(file, limits);
    REQUIRE(without);
    CHECK(identical(mapWith({NearHair()}), *without));
    limits.maxBytes = without->memoryBytes() + 40000;
    CHECK(readBytes(file, limits));
    limits.nearField = true;
    checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
}

TEST_CASE("describe counts strands", "[format][threads]") {
    NearHair hair = noisyHair(19, 13);
    NearHairChunk last;
    std::fill_n(last.opacity, 5, std::uint16_t(26214));
    hair.chunks.push_back(last);
    const TempFolder folder;
    REQUIRE(writeMap(mapWith({std::move(hair)}), folder / "a.mtsm"));
    const auto d = describe(folder / "a.mtsm");
    REQUIRE(d);
    CHECK(d->nearChunks == 20);
    CHECK(d->nearTriangles == 0);
    CHECK(d->nearSegments == 19 * 16 + 5);
    // Ends of 16 bits, but for the last chunk's; two nodes, and one above them.
    CHECK(d->nearBytes == 19 * 296 + (296 - 48) + 3 * 384);
}

TEST_CASE("a HAIR block that lies is refused and the message says where",
          "[format][bad-input]") {
    const auto check = [](const std::function<void(Bytes&)>& change,
                          const std::string& words) {
        Bytes hair = handmadeHair();
        change(hair);
        checkRefused(withHair(hair), ErrorCode::badFile, words);
    };
    const auto put = [](std::size_t at, auto value) {
        return [=](Bytes& hair) { poke(hair, at, value); };
    };
    check([](Bytes& hair) { hair.clear(); }, "ends within its first 8 bytes");
    check(put(4, 4097u), "parts of 4097 chunks");
    check(put(8, std::uint64_t(0)), "are left over");
    check(put(8, ~std::uint64_t(0)), "claims 18446744073709551615 chunks");
    check(put(16, 1u), "claims 1 points");
    check(put(20, 285u), "stores 285 bytes for 284");
    check(put(20, 283u), "1 bytes are left over");
    check([](Bytes& hair) { hair[24 + 21 + 6] = 0xbb; }, "steps of -0.00195312 in width");
    check([](Bytes& hair) { hair[24 + 21 + 6] = 0x7f; }, "in width");  // huge
    check([](Bytes& hair) { hair[24 + 21 + 4] = 0xbf; }, "axis v");
}

TEST_CASE("strands that a file only claims take no memory", "[format][bad-input]") {
    Bytes hair;
    base::ByteWriter out(hair);
    out.put(NearFixed{1, 4096});
    out.put(std::uint64_t(30000) * 4096);
    for (int i = 0; i < 30000; ++i)
        out.put(NearPart{0, 1});
    checkRefused(withHair(hair), ErrorCode::tooLarge, "ReadLimits::maxBytes");
    ReadLimits limits;
    limits.maxBytes = std::numeric_limits<std::uint64_t>::max();
    checkRefused(withHair(hair), ErrorCode::badFile, "reaches past the end", limits);
}

TEST_CASE("random changes in a HAIR block give an error or a map, never a crash",
          "[format][bad-input]") {
    checkDamaged({withHair(handmadeHair()), encoded(mapWith({noisyHair(5, 1)})),
                  encoded(mapWith({noisyHair(4, 2)}), Codec::none)},
                 kHair, 2000);
}
