// compress_tile.h - a tile of samples through the compressor.
#pragma once
#include <utility>
#include <vector>

#include "mtsm/compress.h"

namespace mtsm::test {

/// The layers of a tile whose pixel p has samples [begin[p], begin[p + 1]).
inline Tile compressTile(const CompressOptions& options,
                         const std::vector<std::uint32_t>& begin,
                         const SampleList& samples, CompressReport& report) {
    PixelCompressor compressor(options);
    LayerList layers;
    std::vector<std::uint32_t> first{0};
    for (std::size_t p = 0; p + 1 < begin.size(); ++p) {
        PixelSamples pixel;
        pixel.count = begin[p + 1] - begin[p];
        pixel.z = samples.z.data() + begin[p];
        for (std::uint32_t c = 0; c < options.channels; ++c)
            pixel.opacity[c] = samples.opacity[c].data() + begin[p];
        compressor.compress(pixel, layers, report);
        first.push_back(std::uint32_t(layers.size()));
    }
    return makeTile(std::move(first), layers, options.channels);
}

}  // namespace mtsm::test
