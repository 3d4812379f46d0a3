// Visibility behind depth z: product of (1 - opacity) over the samples up to z
// [Lokovic00, sec. 3], since the last reset [Xie07, sec. 5.1].
#include "compress/visibility.h"

#include <algorithm>
#include <cfloat>

namespace mtsm::compress {
namespace {

/// What a sample leaves of the visibilities before it.
Wall attenuate(const PixelSamples& samples, std::size_t sample, std::uint32_t channels,
               double* visible) {
    bool darkens = false, dark = true;
    for (std::uint32_t c = 0; c < channels; ++c) {
        const double before = visible[c];
        double v = before * (1.0 - double(samples.opacity[c][sample]));
        if (v < double(FLT_MIN)) v = 0.0;
        darkens = darkens || (v == 0.0 && before > 0.0);
        dark = dark && v == 0.0;
        visible[c] = v;
    }
    return dark ? Wall::reset : darkens ? Wall::some : Wall::none;
}

}  // namespace

void accumulate(const PixelSamples& samples, std::uint32_t channels, std::uint32_t resets,
                Visibility& out, CompressReport& report) {
    out.channels = channels;
    out.z.clear();
    out.wall.clear();
    for (auto& plane : out.v)
        plane.clear();
    const auto isOpaque = [&](std::size_t i) {
        for (std::uint32_t c = 0; c < channels; ++c) {
            if (samples.opacity[c][i] < 1.0f) return false;
        }
        return true;
    };

    double visible[3] = {1.0, 1.0, 1.0};
    std::uint64_t started = 0;
    for (std::size_t i = 0; i < samples.count; ++i) {
        if (!out.z.empty() && samples.z[i] == out.z.back() && isOpaque(i) &&
            isOpaque(i - 1)) {
            ++report.copies;
            continue;
        }
        if (started > resets) {
            ++report.droppedByResets;
            continue;
        }
        const Wall wall = attenuate(samples, i, channels, visible);
        out.z.push_back(samples.z[i]);
        out.wall.push_back(wall);
        for (std::uint32_t c = 0; c < channels; ++c)
            out.v[c].push_back(visible[c]);
        if (wall == Wall::reset) {
            std::fill_n(visible, 3, 1.0);
            ++started;
        }
    }
    report.samples += samples.count;
}

}  // namespace mtsm::compress
