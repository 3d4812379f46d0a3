// refused.h - asks readMap about bytes in memory.
#pragma once
#include <catch2/catch.hpp>
#include <cstring>
#include <memory>
#include <string>

#include "format/header.h"
#include "mtsm/reader.h"

namespace mtsm::test {

using format::Bytes;

/// What readMap says of these bytes; from a buffer of exactly their size, so that ASan
/// sees every read past the end.
inline Result<ShadowMap> readBytes(const Bytes& bytes, const ReadLimits& limits = {}) {
    const auto exact = std::make_unique<std::uint8_t[]>(bytes.size());
    if (!bytes.empty()) std::memcpy(exact.get(), bytes.data(), bytes.size());
    return readMap(exact.get(), bytes.size(), "t.mtsm", limits);
}

/// The bytes are refused with this code, and the message names the file and has `words`.
inline void checkRefused(const Bytes& bytes, ErrorCode code, const std::string& words,
                         const ReadLimits& limits = {}) {
    const auto map = readBytes(bytes, limits);
    INFO("expected: " << words);
    REQUIRE_FALSE(map);
    CHECK(map.error().code == code);
    CHECK_THAT(map.error().message, Catch::StartsWith("t.mtsm: "));
    CHECK_THAT(map.error().message, Catch::Contains(words));
}

}  // namespace mtsm::test
