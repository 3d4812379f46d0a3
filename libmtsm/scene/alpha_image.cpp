// OpenImageIO runs single-threaded here: threads of a pool that the host may have do not
// come along into a forked child.
#include "scene/alpha_image.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <new>

#include "base/message.h"
#include "mtsm/opacity_texture.h"

namespace mtsm::scene {
namespace {

using base::makeError;

/// Beyond this a file is no picture; reading them all at once could take any memory.
constexpr int kMostChannels = 16;

float proportion(float x) {
    return x >= 0.0f ? std::min(x, 1.0f) : 0.0f;  // NaN: 0
}

/// IEC 61966-2-1.
float linearOf(float srgb) {
    return srgb <= 0.04045f ? srgb / 12.92f : std::pow((srgb + 0.055f) / 1.055f, 2.4f);
}

/// Rec. 709 luma of what the channels say; a single one is itself.
float brightness(const float* pixel, int colours) {
    if (colours < 3) return pixel[0];
    return 0.2126f * pixel[0] + 0.7152f * pixel[1] + 0.0722f * pixel[2];
}

/// Where the numbers of a pixel are; `colours` of them come first, 1 or 3.
struct Layout {
    int colours = 1;
    int alpha = -1;       // channel, or none
    bool encoded = true;  // as sRGB has it; else linear
};

/// Reads channels [begin, end) of the image into [height][width][end - begin].
using ReadChannels = std::function<Result<std::vector<float>>(int begin, int end)>;

Result<AlphaImage> assemble(std::uint32_t width, std::uint32_t height,
                            const Layout& layout, const ReadChannels& read,
                            AlphaWanted wanted) {
    const std::size_t count = std::size_t(width) * height;
    AlphaImage image{width, height, layout.alpha >= 0, {}, {}};
    if (image.hasAlpha) {
        auto alpha = read(layout.alpha, layout.alpha + 1);
        if (!alpha) return alpha.error();
        image.alpha = std::move(*alpha);
        std::transform(image.alpha.begin(), image.alpha.end(), image.alpha.begin(),
                       proportion);
        const bool says = std::any_of(image.alpha.begin(), image.alpha.end(),
                                      [](float a) { return a < 1.0f; });
        if (!says && wanted.orBrightness) image.hasAlpha = false;
    }
    const bool bright = !image.hasAlpha && wanted.orBrightness;
    if (!image.hasAlpha) image.alpha.assign(count, 1.0f);
    if (!bright && !wanted.colours) return image;

    const auto pixels = read(0, layout.colours);
    if (!pixels) return pixels.error();
    const int c = layout.colours;
    if (wanted.colours) image.colours.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
        const float* pixel = pixels->data() + i * std::size_t(c);
        if (bright) image.alpha[i] = proportion(brightness(pixel, c));
        if (!wanted.colours) continue;
        for (int k = 0; k < 3; ++k) {
            const float x = proportion(pixel[c == 3 ? k : 0]);
            image.colours[i][k] = layout.encoded ? linearOf(x) : x;
        }
    }
    return image;
}

std::string reasonOf(const std::string& message) {
    return message.empty() ? "its reader does not say why" : message;
}

Result<AlphaImage> readOpened(OIIO::ImageInput& input, AlphaWanted wanted) {
    input.threads(1);
    const OIIO::ImageSpec spec = input.spec();
    constexpr int kMost = int(OpacityImage::kMostTexels);
    if (spec.width < 1 || spec.height < 1 || spec.depth > 1 || spec.deep ||
        spec.nchannels < 1 || spec.nchannels > kMostChannels)
        return makeError(ErrorCode::badFile, "it is no flat picture: ", spec.width, " x ",
                         spec.height, " x ", spec.depth, " pixels of ", spec.nchannels,
                         " channels");
    if (spec.width > kMost || spec.height > kMost)
        return makeError(ErrorCode::tooLarge, "it has ", spec.width, " x ", spec.height,
                         " pixels, at most ", kMost, " on a side can be used");
    Layout layout;
    layout.alpha = spec.alpha_channel < spec.nchannels ? spec.alpha_channel : -1;
    const int others = spec.nchannels - (layout.alpha >= 0);
    layout.colours = others >= 3 && (layout.alpha < 0 || layout.alpha >= 3) ? 3 : 1;
    layout.encoded = !spec.format.is_floating_point();
    const auto read = [&](int begin, int end) -> Result<std::vector<float>> {
        std::vector<float> numbers(std::size_t(spec.width) * std::size_t(spec.height) *
                                   std::size_t(end - begin));
        if (!input.read_image(0, 0, begin, end, OIIO::TypeDesc::FLOAT, numbers.data()))
            return makeError(ErrorCode::badFile, reasonOf(input.geterror()));
        return numbers;
    };
    return assemble(std::uint32_t(spec.width), std::uint32_t(spec.height), layout, read,
                    wanted);
}

Result<AlphaImage> readNamed(const std::string& name, OIIO::Filesystem::IOProxy* proxy,
                             AlphaWanted wanted) {
    try {
        OIIO::attribute("threads", 1);
        OIIO::attribute("exr_threads", -1);  // none beside the caller's
        OIIO::ImageSpec asStored;
        asStored.attribute("oiio:UnassociatedAlpha", 1);
        // Given this way too, or some readers look for a file of that name.
        if (proxy) asStored.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);
        const auto input = OIIO::ImageInput::open(name, &asStored, proxy);
        if (!input) return makeError(ErrorCode::badFile, reasonOf(OIIO::geterror()));
        return readOpened(*input, wanted);
    } catch (const std::bad_alloc&) {
        throw;  // the child's business
    } catch (const std::exception& e) {
        return makeError(ErrorCode::badFile, e.what());
    }
}

}  // namespace

Result<AlphaImage> readAlpha(const std::string& path, AlphaWanted wanted) {
    return readNamed(path, nullptr, wanted);
}

Result<AlphaImage> readAlpha(std::span<const std::uint8_t> bytes, const std::string& kind,
                             AlphaWanted wanted) {
    OIIO::Filesystem::IOMemReader reader(bytes.data(), bytes.size());
    return readNamed("embedded." + (kind.empty() ? "png" : kind), &reader, wanted);
}

Result<AlphaImage> alphaOfTexels(std::uint32_t width, std::uint32_t height,
                                 std::span<const std::uint8_t> rgba, AlphaWanted wanted) {
    constexpr std::uint32_t kMost = OpacityImage::kMostTexels;
    if (width < 1 || height < 1 || width > kMost || height > kMost ||
        rgba.size() / 4 / width < height)
        return makeError(ErrorCode::badFile, "it has ", width, " x ", height,
                         " pixels in ", rgba.size(), " bytes");
    const auto read = [&](int begin, int end) -> Result<std::vector<float>> {
        std::vector<float> numbers;
        for (std::size_t i = 0; i < std::size_t(width) * height; ++i)
            for (int c = begin; c < end; ++c)
                numbers.push_back(float(rgba[4 * i + std::size_t(c)]) / 255.0f);
        return numbers;
    };
    return assemble(width, height, {3, 3, true}, read, wanted);
}

}  // namespace mtsm::scene
