// Pictures of what a map holds: images of its pixels, and one pixel as an SVG plot.
#include "mtsm/plot.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <limits>
#include <vector>

#include "base/file_output.h"
#include "base/message.h"

namespace mtsm {
namespace {

using base::concat;

float channelBehind(const PixelLayers& p, std::uint32_t channel) {
    if (p.count == 0) return 1.0f;
    if (!p.v) return 0.0f;
    // A reset means that a layer before it was opaque: nothing passes from there on.
    const float* v = p.v + channel * p.vStride;
    return *std::min_element(v, v + p.count);
}

float visibilityBehind(const PixelLayers& p, std::uint32_t channels) {
    float sum = 0.0f;
    for (std::uint32_t c = 0; c < channels; ++c)
        sum += channelBehind(p, c);
    return sum / float(channels);
}

float pixelValue(const PixelLayers& p, std::uint32_t channels, MapChannel channel) {
    constexpr float kNothing = std::numeric_limits<float>::infinity();
    switch (channel) {
        case MapChannel::layers:
            return float(p.count);
        case MapChannel::zmin:
            return p.count ? p.z[0] : kNothing;
        case MapChannel::zmax:
            return p.count ? p.z[p.count - 1] : -kNothing;
        case MapChannel::visibility:
            return visibilityBehind(p, channels);
        case MapChannel::count: {
            double sum = p.n ? 0.0 : double(p.count);
            for (std::uint32_t i = 0; p.n && i < p.count; ++i)
                sum += p.n[i];
            return float(sum);
        }
    }
    return 0.0f;
}

// --- the plot ------------------------------------------------------------------------

constexpr double kWidth = 960, kHeight = 480;  // of the document, pixels
constexpr double kLeft = 80, kRight = 930, kTop = 60, kBottom = 400;

/// Step between axis marks, 1, 2 or 5 times a power of ten, for at most `most` marks.
double niceStep(double range, int most) {
    const double raw = range / most;
    const double power = std::pow(10.0, std::floor(std::log10(raw)));
    for (double factor : {1.0, 2.0, 5.0}) {
        if (factor * power >= raw) return factor * power;
    }
    return 10.0 * power;
}

std::string number(double value, const char* format = "%.7g") {
    char text[40];
    std::snprintf(text, sizeof text, format, value);
    return text;
}

/// Depths to the width of the plot, with some air at both ends.
struct DepthAxis {
    double first = 0.0, last = 1.0;

    explicit DepthAxis(const PixelLayers& p) {
        if (p.count == 0) return;
        const double a = p.z[0], b = p.z[p.count - 1];
        const double air = b > a ? 0.05 * (b - a) : std::max(0.05 * std::abs(a), 1e-30);
        first = a - air;
        last = b + air;
    }
    [[nodiscard]] double x(double z) const {
        return kLeft + (kRight - kLeft) * (z - first) / (last - first);
    }
};

double yOf(double v) {
    return kBottom - (kBottom - kTop) * v;
}

std::string text(double x, double y, const char* attributes, const std::string& content) {
    return concat("<text x=\"", number(x), "\" y=\"", number(y), "\" ", attributes, ">",
                  content, "</text>\n");
}

std::string line(double x1, double y1, double x2, double y2, const char* stroke) {
    return concat("<line x1=\"", number(x1), "\" y1=\"", number(y1), "\" x2=\"",
                  number(x2), "\" y2=\"", number(y2), "\" ", stroke, "/>\n");
}

/// Grid, frame, numbers and names of both axes.
std::string axes(const DepthAxis& axis) {
    constexpr const char* kGrid = "stroke=\"#ddd\"";
    std::string svg;
    for (int i = 0; i <= 5; ++i) {
        const double v = i / 5.0;
        svg += line(kLeft, yOf(v), kRight, yOf(v), kGrid);
        svg += text(kLeft - 8, yOf(v) + 4, "text-anchor=\"end\"", number(v, "%.1f"));
    }
    const double step = niceStep(axis.last - axis.first, 8);
    for (int i = 0; i < 20; ++i) {
        const double z = (std::ceil(axis.first / step) + i) * step;
        if (z > axis.last) break;
        svg += line(axis.x(z), kTop, axis.x(z), kBottom, kGrid);
        svg += text(axis.x(z), kBottom + 18, "text-anchor=\"middle\"", number(z));
    }
    svg += concat("<rect x=\"", kLeft, "\" y=\"", kTop, "\" width=\"", kRight - kLeft,
                  "\" height=\"", kBottom - kTop, "\" fill=\"none\" stroke=\"#444\"/>\n");
    svg += text((kLeft + kRight) / 2, kBottom + 44, "text-anchor=\"middle\"",
                "depth z along the view axis, world units");
    svg += text(24, (kTop + kBottom) / 2,
                "text-anchor=\"middle\" transform=\"rotate(-90 24 230)\"", "visibility");
    return svg;
}

/// One channel: steps down at every layer, and up again to 1 behind a reset.
std::string stepLine(const PixelLayers& p, const float* v,
                     const std::vector<bool>& resets, const DepthAxis& axis,
                     const char* colour) {
    std::string path = concat("M", number(kLeft), " ", number(yOf(1)));
    std::string dots;
    for (std::uint32_t i = 0; i < p.count; ++i) {
        const double x = axis.x(p.z[i]), y = yOf(v ? v[i] : 0.0f);
        path += concat(" H", number(x), " V", number(y));
        if (resets[i] && i + 1 < p.count)
            path += concat(" M", number(x), " ", number(yOf(1)));
        dots += concat("<circle cx=\"", number(x), "\" cy=\"", number(y),
                       "\" r=\"3\" fill=\"", colour, "\"><title>z ",
                       number(p.z[i], "%.9g"), ", v ", number(v ? v[i] : 0.0f, "%.9g"),
                       ", n ", p.n ? p.n[i] : 1u, "</title></circle>\n");
    }
    path += concat(" H", number(kRight));
    return concat("<path d=\"", path, "\" fill=\"none\" stroke-width=\"2\" stroke=\"",
                  colour, "\"/>\n", dots);
}

}  // namespace

const char* name(MapChannel channel) noexcept {
    switch (channel) {
        case MapChannel::layers:
            return "layers";
        case MapChannel::zmin:
            return "zmin";
        case MapChannel::zmax:
            return "zmax";
        case MapChannel::visibility:
            return "visibility";
        case MapChannel::count:
            return "count";
    }
    return "unknown";
}

FloatImage mapImage(const ShadowMap& map, std::uint32_t face, MapChannel channel) {
    const MapInfo& info = map.info();
    FloatImage image(info.width, info.height);
    const auto add = [&](const char* channelName, auto&& valueOf) {
        image.channels.push_back({channelName, {}});
        std::vector<float>& values = image.channels.back().values;
        values.reserve(std::size_t(info.width) * info.height);
        for (std::uint32_t y = 0; y < info.height; ++y) {
            for (std::uint32_t x = 0; x < info.width; ++x)
                values.push_back(valueOf(map.pixel(face, x, y)));
        }
    };
    add(name(channel),
        [&](const PixelLayers& p) { return pixelValue(p, info.channels, channel); });
    if (channel != MapChannel::visibility || info.channels != 3) return image;
    std::uint32_t c = 0;
    for (const char* color : {"R", "G", "B"}) {
        add(color, [c](const PixelLayers& p) { return channelBehind(p, c); });
        ++c;
    }
    return image;
}

std::string visibilityPlot(const ShadowMap& map, std::uint32_t face, std::uint32_t x,
                           std::uint32_t y) {
    static constexpr const char* kColours[] = {"#1f5fbf", "#b3261e", "#2e7d32",
                                               "#1f5fbf"};
    const PixelLayers p = map.pixel(face, x, y);
    const std::uint32_t channels = map.info().channels;
    const DepthAxis axis(p);

    std::vector<bool> resets(p.count, true);
    for (std::uint32_t c = 0; p.v && c < channels; ++c) {
        for (std::uint32_t i = 0; i < p.count; ++i)
            resets[i] = resets[i] && p.v[c * p.vStride + i] == 0.0f;
    }
    const auto resetCount = std::count(resets.begin(), resets.end(), true);

    std::string svg = concat("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"", kWidth,
                             "\" height=\"", kHeight, "\" viewBox=\"0 0 ", kWidth, " ",
                             kHeight, "\" font-family=\"sans-serif\" font-size=\"13\">\n",
                             "<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n");
    svg += text(kLeft, 28, "font-size=\"16\"",
                concat("Pixel (", x, ", ", y, ")",
                       map.faceCount() > 1 ? concat(", face ", face) : "", ": ", p.count,
                       p.count == 1 ? " layer, " : " layers, ", resetCount,
                       resetCount == 1 ? " reset" : " resets"));
    svg += text(kLeft, 48, "fill=\"#666\"",
                "visibility just behind each depth, accumulated since the last reset; "
                "dashed: reset");
    svg += axes(axis);
    for (std::uint32_t i = 0; i < p.count; ++i) {
        if (resets[i])
            svg += line(axis.x(p.z[i]), kTop, axis.x(p.z[i]), kBottom,
                        "stroke=\"#888\" stroke-dasharray=\"5 4\"");
    }
    for (std::uint32_t c = 0; c < channels; ++c)
        svg += stepLine(p, p.v ? p.v + c * p.vStride : nullptr, resets, axis,
                        kColours[channels == 1 ? 2 : c]);
    return svg + "</svg>\n";
}

Status writeTextFile(const std::string& path, const std::string& content) {
    return base::writeFile(path, base::bytesOf(content));
}

}  // namespace mtsm
