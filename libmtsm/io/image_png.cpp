// ByteImage -> PNG.
#include <png.h>

#include <algorithm>
#include <cmath>

#include "base/message.h"
#include "io/atomic_output.h"
#include "mtsm/image.h"

namespace mtsm {
namespace {

using base::makeError;

constexpr std::uint32_t kLargestSide = 1000000;  // libpng's own default limit

/// What libpng calls back with.
struct PngOutput {
    io::AtomicOutput& file;
    std::string problem;  // libpng's words
};

void onWrite(png_structp png, png_bytep bytes, std::size_t size) {
    auto* out = static_cast<PngOutput*>(png_get_io_ptr(png));
    if (!out->file.write(bytes, size)) png_error(png, "the system could not write");
}

void onFlush(png_structp) {}

void onError(png_structp png, png_const_charp text) {
    static_cast<PngOutput*>(png_get_error_ptr(png))->problem = text;
    png_longjmp(png, 1);
}

void onWarning(png_structp, png_const_charp) {}

int colourType(std::uint32_t channels) {
    return channels == 1   ? PNG_COLOR_TYPE_GRAY
           : channels == 3 ? PNG_COLOR_TYPE_RGB
                           : PNG_COLOR_TYPE_RGB_ALPHA;
}

/// The part that libpng may leave by longjmp: nothing in it has a destructor.
bool encode(png_structp png, png_infop info, const ByteImage& image) {
    if (setjmp(png_jmpbuf(png))) return false;
    png_set_IHDR(png, info, image.width, image.height, 8, colourType(image.channels),
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_write_info(png, info);
    const std::size_t stride = std::size_t(image.width) * image.channels;
    for (std::uint32_t y = 0; y < image.height; ++y)
        png_write_row(png, image.values.data() + y * stride);
    png_write_end(png, info);
    return true;
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

    auto file = io::AtomicOutput::create(path);
    if (!file) return file.error();
    PngOutput out{*file, {}};
    png_structp png =
        png_create_write_struct(PNG_LIBPNG_VER_STRING, &out, onError, onWarning);
    png_infop info = png ? png_create_info_struct(png) : nullptr;
    bool done = false;
    if (info) {
        png_set_write_fn(png, &out, onWrite, onFlush);
        done = encode(png, info, image);
    }
    png_destroy_write_struct(&png, &info);
    if (!done && !file->failed())
        return makeError(ErrorCode::io, path, ": libpng gave up: ",
                         out.problem.empty() ? "no memory" : out.problem);
    return file->commit();
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

}  // namespace mtsm
