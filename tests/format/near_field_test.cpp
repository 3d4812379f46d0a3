// The near field in files: NEAR there and back, what bounds it, what may be wrong in it.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

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

/// `shared`: corners are taken from a few points, as in a mesh; else every other chunk's
/// numbers have 12 bits.
NearField noisyField(std::size_t chunks, bool shared, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    NearField field;
    for (std::size_t i = 0; i < chunks; ++i) {
        NearChunk chunk;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.low[axis] = float(random() % 10000) / 8.0f - 100.0f;
            chunk.step[axis] = random() % 5 ? 1.0f / float(1 + random() % 512) : 0.0f;
        }
        std::uint16_t point[9][3];
        for (auto& p : point) {
            for (auto& q : p)
                q = std::uint16_t(random());
        }
        for (int t = 0; t < NearChunk::kTriangles; ++t) {
            for (int c = 0; c < 3; ++c) {
                const std::size_t from = random() % 9;
                for (int axis = 0; axis < 3; ++axis)
                    chunk.corner[c][axis][t] =
                        shared ? point[from][axis]
                               : std::uint16_t(random() % (i % 2 ? 0x10000 : 0x1000));
            }
        }
        field.chunks.push_back(chunk);
    }
    return field;
}

/// A small opaque map with these near fields, one for each face.
ShadowMap mapWith(std::vector<NearField> fields) {
    return mapWithFaces(
        std::uint32_t(fields.size()), true,
        [&](MapFace& face, std::uint32_t f) { face.nearField = std::move(fields[f]); });
}

/// A file whose NEAR payload is `near`.
Bytes withNear(const Bytes& near) {
    Surgery s(encoded(mapWith({NearField()})));
    s.parts.insert(s.parts.begin() + 1, {kNear, 0, near});
    return s.close();
}

Bytes withHandmade(const std::function<void(Bytes&)>& change) {
    Bytes near = handmadeNear();
    change(near);
    return withNear(near);
}

}  // namespace

TEST_CASE("a near field comes back bit by bit, whatever its size and codec",
          "[format][roundtrip]") {
    for (const std::size_t chunks : {1u, 2u, 1023u, 1024u, 1025u, 3000u}) {
        for (const bool shared : {true, false}) {
            const ShadowMap map = mapWith({noisyField(chunks, shared, chunks)});
            for (const Codec codec : {Codec::none, Codec::zstd}) {
                const auto back = readBytes(encoded(map, codec));
                INFO((back ? "" : back.error().message));
                REQUIRE(back);
                CHECK(identical(map, *back));
            }
        }
    }
    const ShadowMap six = mapWith({noisyField(3, true, 1),
                                   {},
                                   noisyField(2000, true, 2),
                                   {},
                                   {},
                                   noisyField(1, false, 3)});
    const auto back = readBytes(encoded(six));
    REQUIRE(back);
    CHECK(identical(six, *back));
    CHECK(back->nearField(1).empty());
    CHECK(back->nearField(2).levels.size() == 3);  // 125, 8 and 1 nodes
}

TEST_CASE("a near field written by hand is the triangle that it says", "[format]") {
    const auto map = readBytes(withNear(handmadeNear()));
    INFO((map ? "" : map.error().message));
    REQUIRE(map);
    REQUIRE(map->nearField(0).chunks.size() == 1);
    const NearChunk chunk = map->nearField(0).chunks[0];
    CHECK(chunk.triangles() == 1);
    const float expected[3][3] = {{0, 0, 0.5f}, {8, 0, 0.5f}, {0, 8, 1}};
    for (int t = 0; t < NearChunk::kTriangles; ++t) {
        for (int c = 0; c < 3; ++c) {
            for (int axis = 0; axis < 3; ++axis)
                CHECK(chunk.at(c, axis, t) == expected[c][axis]);
        }
    }
}

TEST_CASE("what a near field of few points needs to be read is about twice what it takes",
          "[format]") {
    NearField field;
    for (int i = 0; i < 2000; ++i)
        field.chunks.push_back(NearChunk{});  // one point
    const ShadowMap map = mapWith({field});
    const Bytes file = encoded(map);
    ReadLimits limits;
    // Besides, for each of two parts what it might take when it is unpacked.
    limits.maxBytes = map.memoryBytes() + memoryBytes(map.nearField(0)) + 900000;
    CHECK(readBytes(file, limits));
    limits.maxBytes = map.memoryBytes();
    checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
}

TEST_CASE("reading counts numbers of 12 bits as those of 16, for a file does not say",
          "[format]") {
    const auto mapOf = [](int bits) {
        std::mt19937_64 random(4);
        NearField field;
        for (int i = 0; i < 2000; ++i) {
            NearChunk chunk;
            for (auto& corner : chunk.corner) {
                for (auto& axis : corner) {
                    for (auto& q : axis)
                        q = std::uint16_t(random() % (1u << bits));
                }
            }
            field.chunks.push_back(chunk);
        }
        return mapWith({field});
    };
    const ShadowMap brief = mapOf(12), full = mapOf(16);
    const std::uint64_t bytes = memoryBytes(full.nearField(0));
    CHECK(memoryBytes(brief.nearField(0)) == bytes - 2000 * 72);
    ReadLimits limits;
    // Besides, what each of two parts is when it is unpacked, and the file's own bytes.
    limits.maxBytes = full.memoryBytes() + bytes + 800000 + encoded(full).size();
    for (const ShadowMap* map : {&full, &brief}) {
        const auto back = readBytes(encoded(*map), limits);
        INFO((back ? "" : back.error().message));
        CHECK(back);
    }
    limits.maxBytes =
        brief.memoryBytes() + memoryBytes(brief.nearField(0)) + encoded(brief).size();
    checkRefused(encoded(brief), ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
}

TEST_CASE("a reader that wants no near field passes it over, even where it is damaged",
          "[format][roundtrip]") {
    const ShadowMap map = mapWith({noisyField(40, true, 7)});
    Bytes file = encoded(map);
    ReadLimits limits;
    limits.nearField = false;
    const auto without = readBytes(file, limits);
    REQUIRE(without);
    CHECK(without->nearField(0).empty());
    CHECK_FALSE(identical(map, *without));
    CHECK(identical(mapWith({NearField()}), *without));
    // What was never looked into does not count, either.
    limits.maxBytes = without->memoryBytes() + 40000;
    CHECK(readBytes(file, limits));
    limits.nearField = true;
    checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);

    const Surgery s(file);
    std::size_t at = 64;
    for (const auto& part : s.parts) {
        if (part.type == kNear) break;
        at += blockSpan(part.payload.size());
    }
    file[at + 200] ^= 1;
    checkRefused(file, ErrorCode::badFile, "block NEAR at offset");
    checkRefused(file, ErrorCode::badFile, "; copy the file again or bake it again");
    limits = {};
    limits.nearField = false;
    const auto damaged = readBytes(file, limits);
    REQUIRE(damaged);
    CHECK(identical(*without, *damaged));
}

TEST_CASE("a map without near field has no block for it", "[format]") {
    const Surgery s(encoded(mapWith({NearField()})));
    for (const auto& part : s.parts)
        CHECK(part.type != kNear);
}

TEST_CASE("the bytes of a near field do not depend on the number of threads",
          "[format][threads]") {
    const ShadowMap map = mapWith({noisyField(9000, true, 11)});
    const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 8);
    const auto encodeWith = [&](int threads) {
        tbb::task_arena arena(threads);
        return arena.execute([&] { return encoded(map); });
    };
    const Bytes one = encodeWith(1);
    CHECK(encodeWith(8) == one);
    tbb::task_arena(8).execute([&] { CHECK(identical(map, *readBytes(one))); });
}

TEST_CASE("describe counts the triangles of a near field", "[format]") {
    NearField field = noisyField(19, false, 13);
    NearChunk few = noisyField(1, false, 14).chunks[0];
    for (int t = 5; t < NearChunk::kTriangles; ++t) {  // the last of 5 triangles repeated
        for (auto& corner : few.corner) {
            for (auto& axis : corner)
                axis[t] = axis[4];
        }
    }
    field.chunks.push_back(few);
    const TempFolder folder;
    REQUIRE(writeMap(mapWith({std::move(field)}), folder / "a.mtsm"));
    const auto d = describe(folder / "a.mtsm");
    REQUIRE(d);
    CHECK(d->nearChunks == 20);
    CHECK(d->nearTriangles == 19 * 16 + 5);
    // 10 chunks of 48 points in 12 bits, 9 in 16 and one of 15 points; two nodes, and one
    // above them.
    CHECK(d->nearBytes == 20 * 32 + 10 * 216 + 9 * 288 + 2 * (16 + 45) + 64 + 3 * 384);
}

TEST_CASE("a NEAR block that lies is refused and the message says where",
          "[format][bad-input]") {
    const auto check = [](const std::function<void(Bytes&)>& change,
                          const std::string& words) {
        checkRefused(withHandmade(change), ErrorCode::badFile, words);
        checkRefused(withHandmade(change), ErrorCode::badFile, "block NEAR at offset");
    };
    const auto put = [](std::size_t at, auto value) {
        return [=](Bytes& near) { poke(near, at, value); };
    };
    check([](Bytes& near) { near.clear(); }, "ends within its first 8 bytes");
    check([](Bytes& near) { near.resize(9); }, "numbers of chunks");
    check(put(0, 6u), "has 6 faces, not 1");
    check(put(4, 0u), "parts of 0 chunks");
    check(put(4, 4097u), "parts of 4097 chunks");
    check(put(8, std::uint64_t(0)), "are left over");
    check(put(8, std::uint64_t(90)), "whose records do not fit");
    check(put(8, ~std::uint64_t(0)), "claims 18446744073709551615 chunks");
    check(put(16, 0u), "claims 0 points");
    check(put(16, 49u), "claims 49 points");
    check(put(16, 4u), "no zstd frame");
    check(put(20, 0u), "stores 0 bytes");
    check(put(20, 91u), "stores 91 bytes for 90");
    check([](Bytes& near) { near.push_back(0); }, "1 bytes are left over");
    check([](Bytes& near) { near[24 + 24] = 1; }, "corner 0 is a point 1 before, of 0");
    check([](Bytes& near) { near[24 + 24 + 47] = 255; }, "corner 47 is a point 255");
    check([](Bytes& near) { near[24 + 24 + 47] = 0; }, "corner 47 is a point 0");
    const auto addPoint = [](Bytes& near) {
        poke(near, 16, NearPart{4, 96});
        near.resize(near.size() + 6);
    };
    check(addPoint, "1 points that no corner names");
    // What its numbers mean is checked with the map.
    const auto checkNumber = [](std::size_t at, std::uint8_t byte,
                                const std::string& words) {
        checkRefused(withHandmade([=](Bytes& near) { near[24 + at] = byte; }),
                     ErrorCode::badFile, words);
    };
    checkNumber(18 + 5, 0xbf, "axis w: starts at 0.5 with steps of -0.5");
    checkNumber(18 + 3, 0x7f, "axis u");  // infinite
    checkNumber(18 + 3, 0x7e, "axis u");  // 65535 steps are
}

TEST_CASE("a point that a NEAR block names twice is the same point", "[format]") {
    // The second triangle names the first one's points anew; and so do 14 more, which are
    // 48 points then.
    for (const std::uint32_t triangles : {2u, 16u}) {
        Bytes near = handmadeNear();
        near.resize(24 + 24 + 48);
        poke(near, 16, NearPart{3 * triangles, 72 + 18 * triangles});
        for (std::uint32_t corner = 0; corner < 48; ++corner)
            near[48 + corner] =
                corner < 3 * triangles ? std::uint8_t(0) : std::uint8_t(3 - corner % 3);
        const std::uint16_t points[3][3] = {{0, 0, 0}, {8, 0, 0}, {0, 8, 1}};
        const auto zigzag = [](int d) {
            return std::uint8_t(d < 0 ? -2 * d - 1 : 2 * d);
        };
        for (int axis = 0; axis < 3; ++axis) {
            int before = 0;
            for (std::uint32_t i = 0; i < 3 * triangles; ++i) {
                near.push_back(zigzag(points[i % 3][axis] - before));
                before = points[i % 3][axis];
            }
        }
        near.resize(near.size() + 9 * triangles);  // the high bytes
        const auto map = readBytes(withNear(near));
        INFO((map ? "" : map.error().message));
        REQUIRE(map);
        const auto once = readBytes(withNear(handmadeNear()));
        REQUIRE(once);
        CHECK(identical(*map, *once));
        CHECK(map->nearField(0).triangles() == 1);
        CHECK(encoded(*map) == encoded(*once));
    }
}

TEST_CASE("chunks that a file only claims take no memory", "[format][bad-input]") {
    // 30000 parts of 4096 chunks, 38 GB, in 240 kB.
    Bytes near;
    base::ByteWriter out(near);
    out.put(NearFixed{1, 4096});
    out.put(std::uint64_t(30000) * 4096);
    for (int i = 0; i < 30000; ++i)
        out.put(NearPart{4096, 1});
    checkRefused(withNear(near), ErrorCode::tooLarge, "ReadLimits::maxBytes");
    ReadLimits limits;
    limits.maxBytes = std::numeric_limits<std::uint64_t>::max();
    checkRefused(withNear(near), ErrorCode::badFile, "reaches past the end", limits);
}

TEST_CASE("random changes in a NEAR block give an error or a map, never a crash",
          "[format][bad-input]") {
    checkDamaged({withNear(handmadeNear()), encoded(mapWith({noisyField(5, true, 1)})),
                  encoded(mapWith({noisyField(4, false, 2)}), Codec::none)},
                 kNear, 3000);
}

TEST_CASE("a file with a near field that is cut or changed anywhere is refused",
          "[format][bad-input]") {
    const Bytes file = encoded(mapWith({noisyField(2, true, 5)}));
    Bytes changed = file;
    for (std::size_t at = 0; at < file.size(); ++at) {
        INFO("byte " << at << " of " << file.size());
        if (readBytes(Bytes(file.begin(), file.begin() + long(at))))
            FAIL("accepted a file that is cut off");
        changed[at] ^= 0x11;
        if (readBytes(changed)) FAIL("accepted a changed byte");
        changed[at] = file[at];
    }
}
