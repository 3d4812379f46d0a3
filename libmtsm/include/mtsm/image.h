// image.h - pictures into files.
//
//     mtsm::FloatImage image(600, 300);
//     image.channels.push_back({"shadow", std::move(values)});
//     mtsm::Status done = mtsm::writeImageExr("shadow.exr", image);
//     if (!done) return complain(done.error());
//
// Pixels are row-major, the first row is the top one. A file appears under its name
// complete or not at all: bytes go to a temporary file in the same folder that is renamed
// at the end and removed on any failure. Errors: io (names the path and the system's
// reason, a full disk included), badArgument.
#pragma once
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "mtsm/result.h"

namespace mtsm {

/// A rectangle of pixels, in the coordinates that OpenEXR uses for its windows.
struct PixelWindow {
    std::int32_t x = 0, y = 0;  ///< its first pixel
    std::uint32_t width = 0, height = 0;
};

/// Named float channels of one size.
struct FloatImage {
    FloatImage(std::uint32_t width, std::uint32_t height)
        : data{0, 0, width, height}, display(data) {}

    struct Channel {
        std::string name;           ///< "R", "shadow", "layer.Y": unique in the image
        std::vector<float> values;  ///< [height][width]
    };
    PixelWindow data;     ///< where the pixels lie; width and height are the image's
    PixelWindow display;  ///< the frame that they are part of
    std::vector<Channel> channels;
    std::vector<std::pair<std::string, std::string>>
        attributes;  ///< texts in the file's header
};

/// Scanlines of float32, ZIP compressed.
Status writeImageExr(const std::string& path, const FloatImage& image);

/// Bytes as PNG holds them, encoded for display.
struct ByteImage {
    std::uint32_t width = 0, height = 0;
    std::uint32_t channels = 1;        ///< 1 grey, 3 RGB, 4 RGB and alpha
    std::vector<std::uint8_t> values;  ///< [height][width][channels]
};

Status writeImagePng(const std::string& path, const ByteImage& image);

/// `values` as grey levels: `black` becomes 0 and `white` 255, in between linear, beyond
/// clamped; NaN becomes 0. If black equals white, values above become 255 and all others
/// 0.
[[nodiscard]] ByteImage greyImage(std::uint32_t width, std::uint32_t height,
                                  const std::vector<float>& values, float black,
                                  float white);

/// The same in colour.
[[nodiscard]] ByteImage colorImage(std::uint32_t width, std::uint32_t height,
                                   const std::vector<float>& red,
                                   const std::vector<float>& green,
                                   const std::vector<float>& blue, float black,
                                   float white);

}  // namespace mtsm
