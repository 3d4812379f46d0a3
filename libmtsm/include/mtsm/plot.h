// plot.h - pictures of what a map holds.
//
//     mtsm::FloatImage layers = mtsm::mapImage(map, 0, mtsm::MapChannel::layers);
//     mtsm::writeImageExr("layers.exr", layers);
//     mtsm::writeTextFile("pixel.svg", mtsm::visibilityPlot(map, 0, 512, 300));
#pragma once
#include <cstdint>
#include <string>

#include "mtsm/image.h"
#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm {

/// What to show of each pixel.
enum class MapChannel {
    layers,  ///< number of layers
    zmin,    ///< depth of the nearest layer, world units; infinite where there is none
    zmax,    ///< depth of the last layer; minus infinity where there is none
    visibility,  ///< left behind all layers, mean over the channels: 1 where there is
                 ///< none
    count        ///< number of original samples
};

/// The channel's name as tools spell it.
[[nodiscard]] const char* name(MapChannel channel) noexcept;

/// One face of a map as an image with one channel of that name, and R, G and B behind it
/// where visibility is coloured. `face` must be one of the map's.
[[nodiscard]] FloatImage mapImage(const ShadowMap& map, std::uint32_t face,
                                  MapChannel channel);

/// Visibility against depth in one pixel as a stand-alone SVG document: a step function
/// per channel, with axes, numbers, a dot per layer and a mark where the accumulation
/// starts again. The pixel must be one of the map's.
[[nodiscard]] std::string visibilityPlot(const ShadowMap& map, std::uint32_t face,
                                         std::uint32_t x, std::uint32_t y);

/// Writes `text` as it stands; the file appears complete or not at all. Errors: io.
Status writeTextFile(const std::string& path, const std::string& text);

}  // namespace mtsm
