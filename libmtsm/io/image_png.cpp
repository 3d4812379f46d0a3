// ByteImage -> PNG.
#include <png.h>

#include <algorithm>
#include <cmath>

#include "base/file_output.h"
#include "base/message.h"

#include "mtsm/image.h"

namespace mtsm {
namespace {

using base::makeError;

constexpr std::uint32_t kLargestSide = 1000000;  // libpng's own default limit

std::uint32_t pixelFormat(std::uint32_t channels) {
    return channels == 1   ? PNG_FORMAT_GRAY
           : channels == 3 ? PNG_FORMAT_RGB
                           : PNG_FORMAT_RGBA;
}

}  // namespace

Status writeImagePng(const std::string& path, const ByteImage& image) {
    if (image.width < 1 || image.height < 1 || image.width > kLargestSide ||
        image.height > kLargestSide)
        return makeError(ErrorCode::badArgument, path, ": a PNG of ", image.width, " x ",
                         image.height, " pixels: each side must be 1 to ", kLargestSide);
    if (image.channels != 1 && image.channels != 3 && image.channels != 4)
        return makeError(ErrorCode::badArgument, path, ": a PNG of ", image.channels,
                         " channels: must be 1, 3 or 4");
    const std::size_t bytes = std::size_t(image.width) * image.height * image.channels;
    if (image.values.size() != bytes)
        return makeError(ErrorCode::badArgument, path, ": ", image.values.size(),
                         " values for a PNG that needs ", bytes);

    png_image png{};
    png.version = PNG_IMAGE_VERSION;
    png.width = image.width;
    png.height = image.height;
    png.format = pixelFormat(image.channels);
    std::vector<std::uint8_t> encoded(PNG_IMAGE_PNG_SIZE_MAX(png));
    png_alloc_size_t size = encoded.size();
    if (!png_image_write_to_memory(&png, encoded.data(), &size, 0, image.values.data(), 0,
                                   nullptr))
        return makeError(ErrorCode::io, path, ": libpng gave up: ", png.message);
    encoded.resize(size);
    return base::writeFile(path, encoded);
}

ByteImage greyImage(std::uint32_t width, std::uint32_t height,
                    const std::vector<float>& values, float black, float white) {
    ByteImage image{width, height, 1, {}};
    image.values.reserve(values.size());
    const double range = double(white) - black;
    for (float value : values) {
        double t = (double(value) - black) / range;
        if (range == 0.0) t = value > black ? 1.0 : 0.0;
        if (!(t > 0.0)) t = 0.0;  // NaN too
        image.values.push_back(
            static_cast<std::uint8_t>(std::lround(255.0 * std::min(t, 1.0))));
    }
    return image;
}

ByteImage colorImage(std::uint32_t width, std::uint32_t height,
                     const std::vector<float>& red, const std::vector<float>& green,
                     const std::vector<float>& blue, float black, float white) {
    ByteImage image{width, height, 3, {}};
    image.values.resize(3 * red.size());
    std::size_t channel = 0;
    for (const auto* plane : {&red, &green, &blue}) {
        const ByteImage grey = greyImage(width, height, *plane, black, white);
        for (std::size_t i = 0; i < grey.values.size(); ++i)
            image.values[3 * i + channel] = grey.values[i];
        ++channel;
    }
    return image;
}

}  // namespace mtsm
