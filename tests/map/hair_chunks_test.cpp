// Chunks of segments, packed: they come out as they went in, and take what they should.
#include "mtsm/hair_chunks.h"

#include <catch2/catch.hpp>
#include <cstring>
#include <random>
#include <vector>

using namespace mtsm;

namespace {

bool same(const NearHairChunk& a, const NearHairChunk& b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

/// Ends of no more than `most` steps, one of them of so many; of one opacity, or of one
/// each.
NearHairChunk chunkOf(unsigned most, bool oneOpacity, std::mt19937_64& random) {
    NearHairChunk chunk;
    for (int axis = 0; axis < 3; ++axis) {
        chunk.low[axis] = float(random() % 1000) - 500.0f;
        chunk.step[axis] = 1.0f / float(1 + random() % 512);
    }
    chunk.halfStep = float(random() % 1000) * 0x1p-20f;
    for (int s = 0; s < NearHairChunk::kSegments; ++s) {
        for (int e = 0; e < 2; ++e) {
            for (auto& axis : chunk.end[e])
                axis[s] = std::uint16_t(random() % (most + 1));
            chunk.half[e][s] = std::uint8_t(random());
        }
        chunk.opacity[s] = std::uint16_t(oneOpacity ? 51882 : 1 + 4000 * s);
    }
    chunk.end[random() % 2][random() % 3][random() % 16] = std::uint16_t(most);
    return chunk;
}

constexpr unsigned kShort = 4095;

}  // namespace

TEST_CASE("a chunk of segments comes out as it went in, however far it reaches",
          "[map][roundtrip]") {
    std::mt19937_64 random(5);
    NearHairChunks chunks;
    std::vector<NearHairChunk> expected;
    for (const unsigned most : {0u, 1u, 255u, 256u, kShort, kShort + 1, 65535u}) {
        for (const bool oneOpacity : {false, true}) {
            for (int i = 0; i < 20; ++i)
                expected.push_back(chunkOf(most, oneOpacity, random));
        }
    }
    NearHairChunk one;  // and 15 that are not there
    one.opacity[0] = 65535;
    expected.push_back(one);
    expected.emplace_back();
    for (const NearHairChunk& chunk : expected)
        chunks.push_back(chunk);
    REQUIRE(chunks.size() == expected.size());
    std::size_t i = 0;
    for (const NearHairChunk chunk : chunks) {
        INFO("chunk " << i);
        CHECK(same(chunk, expected[i]));
        ++i;
    }
    CHECK(i == expected.size());
    CHECK(chunks[i - 2].segments() == 1);
    CHECK(chunks[i - 1].segments() == 0);
}

TEST_CASE("segments that lie close together, and have one opacity, take less memory",
          "[map]") {
    std::mt19937_64 random(7);
    for (const unsigned most : {255u, kShort, kShort + 1, 65535u}) {
        for (const bool oneOpacity : {false, true}) {
            NearHairChunks chunks;
            for (int i = 0; i < 100; ++i)
                chunks.push_back(chunkOf(most, oneOpacity, random));
            // Where it begins; grid and widths' steps, four bytes more; two half widths
            // each; six numbers of 12 or 16 bits each; opacities.
            const std::uint64_t expected = 8 + 7 * 4 + 4 + 16 * 2 +
                                           16 * 6 * (most > kShort ? 16 : 12) / 8 +
                                           (oneOpacity ? 0 : 16 * 2);
            CHECK(chunks.memoryBytes() == 100 * expected);
            CHECK(expected >= NearHairChunks::kLeastBytes);
            CHECK(expected <= NearHairChunks::kMostBytes);
        }
    }
    CHECK(NearHairChunks().memoryBytes() == 0);
}

TEST_CASE("chunks of segments that are set part by part are those in a row", "[map]") {
    std::mt19937_64 random(9);
    const std::size_t counts[] = {1, 0, 5, 16, 9};
    NearHairChunks all, one;
    all.resize(31);
    std::size_t first = 0;
    for (const std::size_t count : counts) {
        std::vector<NearHairChunks::Row> more;
        for (std::size_t i = first; i < first + count; ++i) {
            const NearHairChunk chunk =
                chunkOf(random() % 2 ? kShort : 65535, random() % 2, random);
            all.set(i, chunk, more);
            one.push_back(chunk);
        }
        all.addMore(first, count, more);
        first += count;
    }
    REQUIRE(all.size() == one.size());
    for (std::size_t i = 0; i < one.size(); ++i) {
        INFO("chunk " << i);
        CHECK(same(all[i], one[i]));
    }
    CHECK(all.memoryBytes() == one.memoryBytes());
}

TEST_CASE("chunks of segments that nobody has set hold none", "[map]") {
    NearHairChunks chunks;
    chunks.resize(3);
    for (const NearHairChunk chunk : chunks)
        CHECK(chunk.segments() == 0);
}
