// density_tree.h - one face of a transparent map as optical depths that add up along a
// ray, at every resolution: what the fast trace of maps that are not opaque follows rays
// through.
//
// Level 0 has a texel per pixel, each level above one per 2 x 2 texels below. A texel is
// a list of slabs in straight space (bundle.h): between two w its optical depth is spread
// evenly, so that what a ray meets is an overlap times a density. Depths of media are
// those along the centre ray over that ray's way per unit of depth: times the way of any
// other ray per unit of depth they are what that ray loses [traverse.h, Media]. Sheets
// take the same at any slant.
//
// Merging. At level 0 every layer is a slab, one of several samples from half a step in
// front of the first to half a step behind the last. Above, slabs of a texel's four
// children that lie about one another become one while it is short and thin (see
// DensityOptions), or within a texel's footprint of where it begins. The children's areas
// are apart, so light adds: the mean of the transmittance is kept, not that of the depth,
// which would be too dark. So a strand that covers part of several pixels is summed up
// before the logarithm, and what lies in other slabs is taken for independent: there
// depths add. (Measured: tests/bench/NOTES.md.)
//
// Sheets are never cut, and those that lie within some footprints of one another become
// one at the mean of their depths.
//
// In a map of media the layers of one sample that are dark are sheets as well: they count
// from elsewhere along a ray, are met within a bias, and take the same at any slant. They
// have a pyramid of their own, and what media near them take is the mean over the light
// that they leave: at the edge of a strand that fills a pixel the next one is covered in
// part, and both are one thing. Not so where a near field says that strands are all that
// there is: there they are what fills a pixel, and one with what fills a part of the
// next.
//
// Built in parallel in the caller's oneTBB arena, the same for any number of threads.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"
#include "trace/bundle.h"

namespace mtsm::trace {

struct DensityOptions {
    /// Slabs are merged up to this optical depth, and to this length in footprints of the
    /// level's texels.
    double depth = 0.8;
    double length = 4.0;
    /// Levels below are left out, and level 0 is not even made: 1 takes a fifth of the
    /// memory of 0 for fur, for rays whose way near the receiver is answered from
    /// elsewhere.
    std::uint32_t finest = 0;
    /// Texels of which fewer go across the map answer no ray, unless they are the finest,
    /// however far apart rays are: what lies behind one another in a texel counts as
    /// independent, and in one that holds a good part of a crown that is far too dark. At
    /// least 1.
    std::uint32_t leastAcross = 64;
};

/// What is dark: rays that have met this much have no light left. Finite, so that parts
/// of it are numbers.
inline constexpr float kDarkDepth = 1000.0f;

/// A list of slabs, and between which w all of them lie.
struct DensityTexel {
    static constexpr std::uint32_t kEmpty = 0xffffu;

    /// Steps of the level, whole numbers: the lower 16 bits up to where they begin, the
    /// upper up to where they end; kEmpty without slabs.
    std::uint32_t range = kEmpty;
    std::uint32_t begin = 0;  ///< where the list is in DensityLevel::slabs
};

/// One resolution. Texels lie in tiles of 8 x 8, tiles and the texels of each row by row:
/// what a ray and its neighbours meet is close together. The list of n slabs that begins
/// at word b is in three parts, so that a vector holds one of many:
/// - b .. b + n: where slabs begin, floats, ascending;
/// - the next n: two numbers each. The bits kLengthBits, moved down by one, are those of
///   a float > 0, the length; the others, moved up by kDensityShift, those of one >= 0,
///   the optical depth of channel 0 per unit of w. What lies between low and low +
///   length, as floats add, is the slab;
/// - in maps of three channels another n and another: floats, the same of channels 1
///   and 2.
/// A vector's room of words lies behind the last list.
struct DensityLevel {
    static constexpr std::uint32_t kTileShift = 3;
    static constexpr std::uint32_t kLengthBits = 0xfffe0000u;
    static constexpr int kDensityShift = 14;

    std::uint32_t width = 0, height = 0;
    /// [tilesY][tilesX][8][8], and one more, whose list would be the next.
    std::vector<DensityTexel> texels;
    std::vector<std::uint32_t> slabs;
    float base = 0.0f, step = 1.0f;  ///< w of DensityTexel::range: base + step n

    [[nodiscard]] std::uint32_t tilesX() const noexcept {
        return (width + 7) >> kTileShift;
    }
    [[nodiscard]] std::uint32_t tilesY() const noexcept {
        return (height + 7) >> kTileShift;
    }
    [[nodiscard]] std::size_t texelCount() const noexcept {
        return std::size_t(tilesX()) * tilesY() * 64;
    }
    /// The number of a texel.
    [[nodiscard]] std::size_t at(std::uint32_t x, std::uint32_t y) const noexcept {
        const std::size_t tile =
            std::size_t(y >> kTileShift) * tilesX() + (x >> kTileShift);
        return tile * 64 + (y & 7) * 8 + (x & 7);
    }
    [[nodiscard]] std::uint32_t words(std::size_t texel) const noexcept {
        return texels[texel + 1].begin - texels[texel].begin;
    }
    [[nodiscard]] float low(std::size_t texel) const noexcept {
        return base + step * float(texels[texel].range & 0xffffu);
    }
    [[nodiscard]] float high(std::size_t texel) const noexcept {
        return base + step * float(texels[texel].range >> 16);
    }
};

/// From level `finest` to one of a single texel.
struct DensityPyramid {
    std::vector<DensityLevel> levels;  ///< those below `finest` are empty
    float low = 0.0f, high = 0.0f;     ///< the w between which everything lies
    [[nodiscard]] bool empty() const noexcept { return !(low < high); }
    /// The levels of a face of so many pixels, without texels and slabs.
    [[nodiscard]] static std::vector<DensityLevel> levelsOf(std::uint32_t width,
                                                            std::uint32_t height,
                                                            std::uint32_t finest);
};

class DensityTree {
  public:
    /// One error: tooLarge if the face has more than 16384 x 16384 pixels or a level's
    /// slabs take more than 16 GB. Time and memory are linear in the number of layers and
    /// pixels.
    [[nodiscard]] static Result<DensityTree> build(const ShadowMap& map,
                                                   std::uint32_t face,
                                                   const DensityOptions& options = {});

    /// The tree of a face that was stored, and may have been made up; of each pyramid
    /// that is not empty the levels are levelsOf() the face. Errors (badFile) say which
    /// lists of slabs are not there. Whether it is the tree of the map's layers is not
    /// asked.
    [[nodiscard]] static Result<DensityTree> restore(const ShadowMap& map,
                                                     std::uint32_t face,
                                                     const DensityOptions& options,
                                                     DensityPyramid media,
                                                     DensityPyramid sheets);

    [[nodiscard]] const Projection& projection() const noexcept { return projection_; }
    [[nodiscard]] std::uint32_t channels() const noexcept { return channels_; }
    [[nodiscard]] std::uint32_t width() const noexcept { return width_; }  ///< pixels
    [[nodiscard]] std::uint32_t height() const noexcept { return height_; }
    [[nodiscard]] std::uint32_t finest() const noexcept { return finest_; }
    /// No ray is answered by coarser texels.
    [[nodiscard]] std::uint32_t coarsest() const noexcept { return coarsest_; }
    [[nodiscard]] bool isOfSheets() const noexcept { return ofSheets_; }
    [[nodiscard]] const DensityPyramid& media() const noexcept { return media_; }
    [[nodiscard]] const DensityPyramid& sheets() const noexcept { return sheets_; }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    /// All but the pyramids.
    DensityTree(const ShadowMap& map, std::uint32_t face, const DensityOptions& options);

    Projection projection_;
    std::uint32_t channels_ = 1, width_ = 0, height_ = 0, finest_ = 0, coarsest_ = 0;
    bool ofSheets_ = false;
    DensityPyramid media_, sheets_;
};

/// The finest level that rays of receivers need beside a near field, which answers until
/// a pixel is a third to an eighth of the light.
inline constexpr std::uint32_t kFinestBesideNear = 1;

enum class DensityUse {
    receivers,  ///< rays from receivers to a light, with the near field that there is
    rays        ///< any rays, through layers alone
};

/// Have rays of receivers a near field of hair or sheets in front of the trees?
[[nodiscard]] bool hasNearMedia(const ShadowMap& map) noexcept;

/// The trees of the faces of a map that is not opaque, made when first asked for, one set
/// for both uses where there is no near field; null if they are too large or there is no
/// memory for them, for good.
[[nodiscard]] const std::vector<DensityTree>* densityTrees(const ShadowMap& map,
                                                           DensityUse use);

/// How those of receivers are made.
[[nodiscard]] DensityOptions receiverOptions(const ShadowMap& map) noexcept;

/// Those of receivers that were stored, for a map that has not been asked for any.
void holdDensityTrees(const ShadowMap& map, std::vector<DensityTree> trees);

/// That these trees take, as many sets of them as are made.
[[nodiscard]] std::uint64_t densityTreeBytes(const ShadowMap& map) noexcept;

/// What queries keep of a map whose layers are let go of: of trees the set that they then
/// go through, alone.
[[nodiscard]] std::shared_ptr<base::Lazy> densityTreesAlone(const ShadowMap& map);

}  // namespace mtsm::trace
