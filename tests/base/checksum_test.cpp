#include "base/checksum.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cstdint>
#include <vector>

namespace {

/// The buffer that xxHash's own sanity check hashes.
std::vector<std::uint8_t> sanityBuffer(std::size_t size) {
    std::vector<std::uint8_t> bytes(size);
    std::uint64_t generator = 2654435761u;
    for (auto& b : bytes) {
        b = static_cast<std::uint8_t>(generator >> 56);
        generator *= 11400714785074694797ull;
    }
    return bytes;
}

struct Vector {
    std::size_t length;
    std::uint64_t sum;
};
// XXH3 64-bit, seed 0: xxHash 0.8, cli/xsum_sanity_check.c. One length per code path.
constexpr Vector kVectors[] = {{0, 0x2D06800538D394C2ull},   {1, 0xC44BDFF4074EECDBull},
                               {6, 0x27B56A84CD2D7325ull},   {12, 0xA713DAF0DFBB77E7ull},
                               {24, 0xA3FE70BF9D3510EBull},  {48, 0x397DA259ECBA1F11ull},
                               {80, 0xBCDEFBBB2C47C90Aull},  {195, 0xCD94217EE362EC3Aull},
                               {403, 0xCDEB804D65C6DEA4ull}, {512, 0x617E49599013CB6Bull},
                               {2048, 0xDD59E2C3A5F038E0ull}};

}  // namespace

TEST_CASE("the checksum is XXH3-64 as xxHash publishes it", "[base][exact]") {
    for (const Vector& v : kVectors) {
        INFO(v.length << " bytes");
        CHECK(mtsm::base::checksum(sanityBuffer(v.length)) == v.sum);
    }
}

TEST_CASE("a checksum in pieces is the checksum of the whole", "[base]") {
    const auto bytes = sanityBuffer(5000);
    for (std::size_t piece : {1u, 7u, 64u, 255u, 4096u}) {
        mtsm::base::ChecksumStream stream;
        for (std::size_t at = 0; at < bytes.size(); at += piece)
            stream.add({bytes.data() + at, std::min(piece, bytes.size() - at)});
        CHECK(stream.value() == mtsm::base::checksum(bytes));
    }
}
