// compress.h - a pixel's samples become its layers [Xie07, sec. 5.1; Lokovic00].
//
//     mtsm::CompressOptions options;
//     options.tolerance = 0.005f;
//     mtsm::PixelCompressor compressor(options);      // one per thread
//     mtsm::CompressReport report;
//     mtsm::LayerList layers;
//     for (pixel : samples) compressor.compress(pixel, layers, report);
//     mtsm::Tile tile = mtsm::makeTile(begin, layers, options.channels);
//
// V(z) is the visibility behind depth z: the product of (1 - opacity) over the samples up
// to z since the last reset, per channel, in double. V'(z) is what a reader of the layers
// makes of them: the n samples of a layer sit at z_before + j (z - z_before) / n, and
// each multiplies what is left by (v / v_before)^(1 / n) (map.h). Compression merges
// samples into layers of several; what it keeps to, in this order:
//
// - What darkens stands alone. A sample behind which some channel has nothing left is a
//   layer of its own, n = 1, so that a slanted ray which meets only the translucent
//   samples in front of it is not blocked. If no channel has anything left the layer is
//   a reset.
// - |V - V'| <= tolerance at every depth, on both sides of every step of both, in every
//   channel, whatever way a reader rounds. The bound is checked, not estimated.
// - Behind each layer V' is right to a factor of 1 +- tolerance, so that the optical
//   depth of what lies between two layers is, too, for a ray that meets nothing else.
// - A layer of several samples has at most `opticalDepth`, and the depth it is spread
//   over is at most the length allowed.
// - A gap without samples gains none: where a layer's count puts its j-th sample is no
//   further from where the j-th sample was than half of the length allowed, and than the
//   depth that the layer's samples cover if no gap between them (and the layer before)
//   counts for more than the mean gap, less that mean. So the first sample of a cluster
//   is a layer of its own, unless it follows at about the distance that is between the
//   others.
//
// Underflow. A product that falls below FLT_MIN is zero: where that is so in all channels
// it is a reset, though no single sample there is opaque. To slanted rays that sample is
// a wall. It takes an optical depth of 87 in front of it, so the error is that light
// which passes beside all that cannot pass the one sample.
//
// The same samples and options give the same layers, whatever was compressed before.
#pragma once
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/samples.h"

namespace mtsm {

struct CompressOptions {
    /// Bound on |V - V'|, in [0, 1]. Up to 2^-24, the step of a float below 1, nothing is
    /// merged: one layer per sample, z to the bit, v the product as a float.
    float tolerance = 0.0f;
    /// Most optical depth, -ln(v / v_before), of a layer of several samples; >= 0.
    float opticalDepth = 0.4f;
    /// Most depth that the samples of such a layer are spread over, world units, at depth
    /// z: lengthBase + lengthPerDepth * z; each >= 0.
    double lengthBase = std::numeric_limits<double>::infinity();
    double lengthPerDepth = 0.0;
    /// Times that accumulation may start again; what lies behind the reset after the last
    /// is dropped. 0 keeps the first accumulation only.
    std::uint32_t resets = kAllResets;
    /// Cap on a pixel's layers; 0, and any more than kMaxPixelLayers: kMaxPixelLayers.
    /// See PixelCompressor.
    std::uint32_t layers = 0;
    std::uint32_t channels = 1;  ///< 1 or 3
};

/// What compression met; a fresh one is of no samples.
struct CompressReport {
    std::uint64_t samples = 0;  ///< that came in
    /// Opaque samples at the very depth of an opaque one: one layer stands for them.
    std::uint64_t copies = 0;
    std::uint64_t droppedByLayers = 0;      ///< samples behind what the cap left
    std::uint64_t droppedByResets = 0;      ///< samples behind the last reset
    std::uint64_t layers = 0;               ///< that came out
    std::uint64_t pixelsOverTolerance = 0;  ///< in which the cap took more
    /// Largest |V - V'| of merged samples, measured, those that the cap merged included.
    /// V is taken as it was without what was dropped.
    float toleranceReached = 0.0f;

    void merge(const CompressReport& other) noexcept;
};

/// Layers, plane by plane, of pixels one behind the other.
struct LayerList {
    std::vector<float> z;          ///< [layers]
    std::vector<float> v[3];       ///< [channels][layers]
    std::vector<std::uint32_t> n;  ///< [layers]

    [[nodiscard]] std::size_t size() const noexcept { return z.size(); }
    void clear() noexcept;
};

/// Compresses pixel after pixel and keeps its working memory: some 60 bytes for each
/// sample of the largest pixel, 160 if it is over the cap (three channels: twice that).
/// One for each thread.
///
/// Where more layers than the cap are left, neighbours are merged, the pair that harms
/// rays across the centre ray least first (optical depth times the distance it is moved),
/// beyond the tolerance if it must be. Merges that keep the bound on how far samples move
/// come before those that do not. Pixels of more than four times the cap are brought down
/// to that first, by merging pairs that harm less than the pairs beside them. Resets are
/// never merged away. If there is no room for each of them and for one layer between each
/// two, the nearest are kept and the rest is dropped.
class PixelCompressor {
  public:
    explicit PixelCompressor(const CompressOptions& options);
    PixelCompressor(PixelCompressor&&) noexcept;
    PixelCompressor& operator=(PixelCompressor&&) noexcept;
    ~PixelCompressor();

    /// Appends the layers of one pixel, fewer than 2^32 samples. Linear in them but for a
    /// logarithm.
    void compress(const PixelSamples& samples, LayerList& layers, CompressReport& report);

  private:
    struct Workspace;
    std::unique_ptr<Workspace> workspace_;
};

/// The tile whose pixel p has layers [begin[p], begin[p + 1]); `begin` is [pixels + 1].
/// Planes that say nothing are left out. Empty if there is no layer.
[[nodiscard]] Tile makeTile(std::vector<std::uint32_t> begin, const LayerList& layers,
                            std::uint32_t channels);

}  // namespace mtsm
