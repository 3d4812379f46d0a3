// near_files.h - files with near fields, whole and damaged, for the tests of their
// blocks.
#pragma once
#include <catch2/catch.hpp>
#include <functional>
#include <random>
#include <vector>

#include "format/file_surgery.h"
#include "format/refused.h"
#include "map_fixture.h"
#include "mtsm/reader.h"
#include "mtsm/writer.h"

namespace mtsm::test {

/// A small noisy map whose faces `finish` gives their near fields.
inline ShadowMap mapWithFaces(
    std::uint32_t faceCount, bool opaque,
    const std::function<void(MapFace&, std::uint32_t face)>& finish) {
    NoisySpec spec;
    spec.width = spec.height = 9;
    spec.faces = faceCount;
    spec.opaque = opaque;
    const ShadowMap plain = noisyMap(spec);
    std::vector<MapFace> faces;
    for (std::uint32_t f = 0; f < plain.faceCount(); ++f) {
        MapFace& face = faces.emplace_back();
        face.projection = plain.projection(f);
        for (std::uint32_t i = 0; i < plain.tilesX() * plain.tilesY(); ++i)
            face.tiles.push_back(plain.tile(f, i % plain.tilesX(), i / plain.tilesX()));
        finish(face, f);
    }
    auto map = ShadowMap::create(plain.info(), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

inline format::Bytes encoded(const ShadowMap& map, Codec codec = Codec::zstd) {
    WriteOptions options;
    options.codec = codec;
    return *encodeMap(map, options);
}

/// Changes some bytes of a payload at random, or cuts or lengthens it.
inline void damage(format::Bytes& payload, std::mt19937_64& random) {
    for (std::uint64_t n = 1 + random() % 3; n > 0; --n) {
        const std::size_t at = random() % payload.size();
        if (random() % 8 == 0)
            payload.resize(random() % 2 ? at + 1 : payload.size() + at % 40);
        else
            payload[at] = std::uint8_t(random());
    }
}

/// Damages a block's payload and reads the file: a map or an error, each often enough to
/// mean something.
inline void checkDamaged(const std::vector<format::Bytes>& files,
                         const format::BlockType& type, int rounds) {
    std::mt19937_64 random(23);
    ReadLimits limits;
    limits.maxBytes = 16 << 20;
    int read = 0, refused = 0;
    for (int i = 0; i < rounds; ++i) {
        Surgery s(files[std::size_t(i) % files.size()]);
        damage(s.payload(type), random);
        (readBytes(s.close(), limits) ? read : refused) += 1;
    }
    CHECK(refused > rounds / 10);
    CHECK(read > 100);
}

}  // namespace mtsm::test
