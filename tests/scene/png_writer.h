// png_writer.h - PNG files of 8-bit pixels, uncompressed.
#pragma once
#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

namespace mtsm::test {

inline std::string bigEndian(std::uint32_t v) {
    return {char(v >> 24), char(v >> 16), char(v >> 8), char(v)};
}

inline std::string pngChunk(const std::string& typeAndData) {
    std::uint32_t crc = ~0u;
    for (const char c : typeAndData) {
        crc ^= std::uint8_t(c);
        for (int bit = 0; bit < 8; ++bit)
            crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0u);
    }
    return bigEndian(std::uint32_t(typeAndData.size() - 4)) + typeAndData +
           bigEndian(~crc);
}

/// The header of a PNG of any size, without its pixels. Channels: 1 grey, 2 with alpha,
/// 3 colours, 4 with alpha.
inline std::string pngHeader(std::uint32_t width, std::uint32_t height, int channels) {
    const int kind[] = {0, 0, 4, 2, 6};
    return "\x89PNG\r\n\x1a\n" +
           pngChunk("IHDR" + bigEndian(width) + bigEndian(height) + "\x08" +
                    char(kind[channels]) + std::string(3, '\0'));
}

/// `pixels` are [height][width][channels], upper row first.
inline std::string png(std::uint32_t width, std::uint32_t height, int channels,
                       const std::vector<std::uint8_t>& pixels) {
    const std::size_t row = std::size_t(width) * std::size_t(channels);
    std::string raw;
    for (std::uint32_t y = 0; y < height; ++y)
        raw += '\0' + std::string(pixels.begin() + std::ptrdiff_t(y * row),
                                  pixels.begin() + std::ptrdiff_t((y + 1) * row));
    std::string stream = "\x78\x01";  // zlib, stored blocks
    std::uint32_t a = 1, b = 0;
    for (const char c : raw) {
        a = (a + std::uint8_t(c)) % 65521;
        b = (b + a) % 65521;
    }
    for (std::size_t at = 0; at < raw.size(); at += 65535) {
        const std::size_t n = std::min<std::size_t>(65535, raw.size() - at);
        stream += char(at + n == raw.size());
        stream += {char(n), char(n >> 8), char(~n), char(~n >> 8)};
        stream += raw.substr(at, n);
    }
    return pngHeader(width, height, channels) +
           pngChunk("IDAT" + stream + bigEndian(b << 16 | a)) + pngChunk("IEND");
}

}  // namespace mtsm::test
