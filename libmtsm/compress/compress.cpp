// PixelCompressor: visibility, slope window, cap.
#include "mtsm/compress.h"

#include <algorithm>

#include "compress/error.h"
#include "compress/merge.h"
#include "compress/simplify.h"
#include "compress/visibility.h"

namespace mtsm {

using compress::Span;

void CompressReport::merge(const CompressReport& other) noexcept {
    samples += other.samples;
    copies += other.copies;
    droppedByLayers += other.droppedByLayers;
    droppedByResets += other.droppedByResets;
    layers += other.layers;
    pixelsOverTolerance += other.pixelsOverTolerance;
    toleranceReached = std::max(toleranceReached, other.toleranceReached);
}

void LayerList::clear() noexcept {
    z.clear();
    n.clear();
    for (auto& plane : v)
        plane.clear();
}

struct PixelCompressor::Workspace {
    Workspace(const CompressOptions& o, const compress::Bounds& bounds)
        : options(o), simplifier(o.tolerance, o.tolerance, bounds), merger(bounds) {}

    CompressOptions options;
    compress::Simplifier simplifier;
    compress::Merger merger;
    compress::Visibility samples;
    std::vector<Span> layers;
};

PixelCompressor::PixelCompressor(const CompressOptions& options)
    : workspace_(std::make_unique<Workspace>(
          options, compress::Bounds{options.opticalDepth, options.lengthBase,
                                    options.lengthPerDepth})) {
    std::uint32_t& cap = workspace_->options.layers;
    if (cap == 0 || cap > kMaxPixelLayers) cap = kMaxPixelLayers;
}

PixelCompressor::PixelCompressor(PixelCompressor&&) noexcept = default;
PixelCompressor& PixelCompressor::operator=(PixelCompressor&&) noexcept = default;
PixelCompressor::~PixelCompressor() = default;

void PixelCompressor::compress(const PixelSamples& samples, LayerList& layers,
                               CompressReport& report) {
    Workspace& w = *workspace_;
    const CompressOptions& options = w.options;
    compress::accumulate(samples, options.channels, options.resets, w.samples, report);
    double error = w.simplifier.simplify(w.samples, w.layers);
    if (w.layers.size() > options.layers) {
        report.droppedByLayers += w.merger.merge(w.samples, options.layers, w.layers);
        error = compress::errorOf(w.samples, w.layers, double(options.tolerance),
                                  double(report.toleranceReached));
        if (error > double(options.tolerance)) ++report.pixelsOverTolerance;
    }
    report.toleranceReached = std::max(report.toleranceReached, float(error));
    report.layers += w.layers.size();

    std::uint32_t begin = 0;
    for (const Span& layer : w.layers) {
        layers.z.push_back(w.samples.z[layer.end - 1]);
        layers.n.push_back(layer.end - begin);
        for (std::uint32_t c = 0; c < options.channels; ++c)
            layers.v[c].push_back(layer.v[c]);
        begin = layer.end;
    }
}

Tile makeTile(std::vector<std::uint32_t> begin, const LayerList& layers,
              std::uint32_t channels) {
    if (layers.size() == 0) return {};
    Tile tile;
    tile.begin = std::move(begin);
    tile.z = layers.z;
    bool opaque = true;
    for (std::uint32_t c = 0; c < channels; ++c)
        opaque = opaque && std::all_of(layers.v[c].begin(), layers.v[c].end(),
                                       [](float v) { return v == 0.0f; });
    for (std::uint32_t c = 0; c < channels && !opaque; ++c)
        tile.v.insert(tile.v.end(), layers.v[c].begin(), layers.v[c].end());
    if (std::any_of(layers.n.begin(), layers.n.end(),
                    [](std::uint32_t n) { return n != 1; }))
        tile.n = layers.n;
    return tile;
}

}  // namespace mtsm
