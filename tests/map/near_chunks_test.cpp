// Chunks of triangles, packed: they come out as they went in, and take what they should.
#include "mtsm/near_chunks.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <random>
#include <vector>

#include "mtsm/near_sheets.h"

using namespace mtsm;

namespace {

bool same(const NearChunk& a, const NearChunk& b) {
    return std::equal(a.low, a.low + 3, b.low) &&
           std::equal(a.step, a.step + 3, b.step) &&
           std::equal(&a.corner[0][0][0], &a.corner[0][0][0] + 144, &b.corner[0][0][0]);
}

/// Corners that are the first `points` of different ones, all of them there if there are
/// corners enough; of the first `triangles` triangles, the last one repeated. Numbers up
/// to `most`.
NearChunk chunkOf(int points, int triangles, std::mt19937_64& random,
                  unsigned most = 0xffff) {
    NearChunk chunk;
    for (int axis = 0; axis < 3; ++axis) {
        chunk.low[axis] = float(random() % 1000) - 500.0f;
        chunk.step[axis] = 1.0f / float(1 + random() % 512);
    }
    std::vector<NearChunks::Point> all;
    while (int(all.size()) < points) {
        const NearChunks::Point p = {std::uint16_t(random() % (most + 1)),
                                     std::uint16_t(random() % (most + 1)),
                                     std::uint16_t(random() % 3 * most / 2)};
        if (std::find(all.begin(), all.end(), p) == all.end()) all.push_back(p);
    }
    for (int t = 0; t < NearChunk::kTriangles; ++t) {
        for (int c = 0; c < 3; ++c) {
            const int corner = 3 * std::min(t, triangles - 1) + c;
            for (std::size_t axis = 0; axis < 3; ++axis)
                chunk.corner[c][axis][t] = all[std::size_t(corner % points)][axis];
        }
    }
    return chunk;
}

}  // namespace

TEST_CASE("a chunk comes out as it went in, however many points it has",
          "[map][roundtrip]") {
    std::mt19937_64 random(5);
    NearChunks chunks;
    std::vector<NearChunk> expected;
    for (int points = 1; points <= 48; ++points) {
        for (const int triangles : {1, 2, 7, 15, 16}) {
            for (const unsigned most : {0xffu, 0xfffu, 0x1fffu, 0xffffu}) {
                expected.push_back(chunkOf(points, triangles, random, most));
                chunks.push_back(expected.back());
            }
        }
    }
    REQUIRE(chunks.size() == expected.size());
    std::size_t i = 0;
    for (const NearChunk& chunk : chunks) {
        INFO("chunk " << i);
        CHECK(same(chunk, expected[i]));
        CHECK(int(chunks.place(i).triangles) == expected[i].triangles());
        ++i;
    }
    CHECK(i == expected.size());
}

TEST_CASE("points that triangles share take memory once", "[map]") {
    std::mt19937_64 random(7);
    for (const int points : {1, 15, 32, 33, 48}) {
        NearChunks chunks;
        for (int i = 0; i < 100; ++i)
            chunks.push_back(chunkOf(points, 16, random));
        // A grid, where the rest begins, three numbers for each triangle, points; or 48
        // corners. And 64 bytes at the end.
        const int expected = 32 + (points <= 32 ? 32 + 6 * points : 288);
        CHECK(chunks.memoryBytes() == std::uint64_t(100 * expected) + 64);
        CHECK(NearChunks::memoryBytes(100, points) == std::uint64_t(100 * expected));
        CHECK(chunks.place(0).areShared() == (points <= 32));
    }
    CHECK(NearChunks().memoryBytes() == 0);
}

TEST_CASE("points that are not shared take less where 12 bits are enough", "[map]") {
    std::mt19937_64 random(17);
    // Every other number is the last one with 12 bits; then one has 13.
    const NearChunk before = chunkOf(48, 16, random, 0xffe);
    for (std::size_t which = 0; which < 144; ++which) {
        INFO("number " << which);
        NearChunk chunk = before;
        std::uint16_t* const q = &chunk.corner[0][0][0];
        for (std::size_t i = which % 2; i < 144; i += 2)
            q[i] = 0xfff;
        // Whatever that has made the same.
        for (int t = 0; t < NearChunk::kTriangles; ++t) {
            for (int c = 0; c < 3; ++c)
                chunk.corner[c][t % 2][t] = std::uint16_t(3 * t + c);
        }
        NearChunks chunks;
        chunks.push_back(chunk);
        CHECK(chunks.place(0).areShort());
        CHECK_FALSE(chunks.place(0).areShared());
        CHECK(chunks.memoryBytes() == 32 + 216 + 64);
        q[which] = 0x1000;
        chunks.push_back(chunk);
        CHECK_FALSE(chunks.place(1).areShort());
        CHECK_FALSE(chunks.place(1).areShared());
        CHECK(chunks.memoryBytes() == 32 + 216 + 32 + 288 + 64);
        CHECK(same(chunks[1], chunk));
        for (const unsigned low : {0u, 0xffeu}) {
            q[which] = std::uint16_t(low);
            chunks.push_back(chunk);
            CHECK(chunks.place(chunks.size() - 1).areShort());
            CHECK(same(chunks[chunks.size() - 1], chunk));
        }
        q[which] = 0xfff;
        chunks.push_back(chunk);
        CHECK(same(chunks[4], chunk));
    }
    // Few points are shared however small their numbers are.
    NearChunks few;
    few.push_back(chunkOf(32, 16, random, 0xfff));
    few.push_back(chunkOf(33, 16, random, 0xfff));
    CHECK(few.place(0).areShared());
    CHECK_FALSE(few.place(0).areShort());
    CHECK(few.place(1).areShort());
}

TEST_CASE("chunks of several parts come one behind the other", "[map]") {
    std::mt19937_64 random(9);
    std::vector<NearChunks> parts(5);
    std::vector<NearChunk> expected;
    for (std::size_t i = 0; i < parts.size(); ++i) {
        for (std::size_t k = 0; k < (i == 3 ? 0 : 4 * i + 1); ++k) {
            expected.push_back(
                chunkOf(int(1 + random() % 48), 16, random, k % 2 ? 0xffff : 0xfff));
            parts[i].push_back(expected.back());
        }
    }
    NearChunks all;
    all.append(parts.data(), 2);
    all.append(parts.data() + 2, 3);
    all.append(nullptr, 0);
    CHECK(parts[4].empty());
    REQUIRE(all.size() == expected.size());
    NearChunks one;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        CHECK(same(all[i], expected[i]));
        one.push_back(expected[i]);
    }
    CHECK(all.memoryBytes() == one.memoryBytes());
}

TEST_CASE("words behind the last point may be read", "[map]") {
    std::mt19937_64 random(11);
    NearChunks chunks;
    chunks.push_back(chunkOf(1, 1, random));
    const std::uint16_t* const lastAxis = chunks.points(0) + 2;
    CHECK(std::count(lastAxis + 1, lastAxis + NearChunks::kMostShared, 0) == 31);
    NearChunks brief;
    brief.push_back(chunkOf(48, 16, random, 0xfff));
    const std::uint16_t* const end = brief.points(0) + 3 * NearChunks::kShortWords;
    CHECK(std::count(end, end + NearChunks::kMostShared, 0) == NearChunks::kMostShared);
}

TEST_CASE("texture coordinates come out as they went in, and take memory once",
          "[map][roundtrip]") {
    std::mt19937_64 random(13);
    std::vector<NearSheetChunks> parts(3);
    std::vector<NearSheetChunk> expected;
    std::uint64_t bytes = 0;
    for (int pairs = 1; pairs <= 48; ++pairs) {
        NearSheetChunk chunk;
        chunk.texture = std::uint32_t(random());
        chunk.triangles = 1 + std::uint32_t(random() % 16);
        for (int axis = 0; axis < 2; ++axis) {
            chunk.low[axis] = float(random() % 1000) - 500.0f;
            chunk.step[axis] = 1.0f / float(1 + random() % 512);
        }
        for (int t = 0; t < NearChunk::kTriangles; ++t) {
            for (int c = 0; c < 3; ++c) {
                chunk.uv[c][0][t] = std::uint16_t((3 * t + c) % pairs * 1300);
                chunk.uv[c][1][t] = std::uint16_t((3 * t + c) % pairs % 5 + 60000);
            }
        }
        expected.push_back(chunk);
        parts[std::size_t(pairs) / 17].push_back(chunk);
        // Texture, grid and where the rest begins; one pair alone; three numbers for each
        // triangle and pairs; or 48 pairs.
        const int rest = pairs == 1 ? 4 : pairs <= 32 ? 32 + 4 * pairs : 192;
        CHECK(NearSheetChunks::memoryBytes(1, pairs) == std::uint64_t(32 + rest));
        bytes += std::uint64_t(32 + rest);
    }
    NearSheetChunks all;
    all.append(parts.data(), parts.size());
    CHECK(parts[1].empty());
    CHECK(all.memoryBytes() == bytes);
    REQUIRE(all.size() == expected.size());
    std::size_t i = 0;
    for (const NearSheetChunk& chunk : all) {
        INFO(i + 1 << " pairs");
        const NearSheetChunk& e = expected[i++];
        CHECK(chunk.texture == e.texture);
        CHECK(chunk.triangles == e.triangles);
        CHECK(std::equal(chunk.low, chunk.low + 2, e.low));
        CHECK(std::equal(chunk.step, chunk.step + 2, e.step));
        CHECK(std::equal(&chunk.uv[0][0][0], &chunk.uv[0][0][0] + 96, &e.uv[0][0][0]));
    }
}
