// patch_tree.h - the surfaces of one face of an opaque map, from whole bodies down to
// pixels.
//
// A patch is a connected piece of surface within a square tile: which of the tile's 16 x
// 16 texels it covers, the plane that it lies on in straight space (bundle.h) and how far
// it strays from it. At level 0 a tile has 16 x 16 pixels, and with each level its sides
// double. The children of a patch share out its samples among them, so whatever a ray
// takes from a patch it must not take from the patch's children, and any cut through the
// tree is the whole scene. A level 0 patch that is not flat has quarters of itself as
// children, down to 4 x 4 pixels; if such a one is not flat, it holds for each of its
// pixels how far its sample is from the plane: it is bumpy.
//
// Coverage. Texels of level 0 are pixels, covered or not. A texel of a coarser level
// holds the share of its pixels that the patch covers, counted exactly and then in
// sixteenths by ordered dither, so that no mean is off: a ray is blocked by the share,
// against a threshold of its own. Of several patches that share a texel it matters which
// pixels they cover: the front and the back of a body the same, two halves of a surface
// none twice. So a ray has one threshold for all of them, and what covers more of one
// half of a texel takes thresholds from below, what covers more of the other one from
// above. Kept are the rows of texels that the patch's box has.
#pragma once
#include <bit>
#include <cstdint>
#include <cstring>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm::trace {

inline constexpr int kTexels = 16;  ///< per side of a patch
inline constexpr int kSharePlanes = 5;

/// The upper half of a float's bits.
using UpperHalf = std::uint16_t;
[[nodiscard]] inline float widen(UpperHalf bits) noexcept {
    return std::bit_cast<float>(std::uint32_t(bits) << 16);
}

/// Patches that are looked at together: those of these groups, of the last group some. In
/// the rest of that one are patches of other lists.
struct PatchList {
    std::uint32_t group;
    std::uint32_t groups : 28;
    std::uint32_t slots : 4;  ///< of the last group: which, a bit each

    /// Slots of group number i of the list.
    [[nodiscard]] std::uint32_t slotsOf(std::uint32_t i) const noexcept {
        return i + 1 == groups ? slots : 15;
    }
};

/// A piece of surface, in straight space: pixels and w.
struct Patch {
    float high,
        low;  ///< all of it lies between, corners included; none: high = -infinity
    float w, gradientU, gradientV;  ///< plane: depth at the box's centre, slope
    float residual;                 ///< largest distance from the plane, in w
    float u, v, halfU, halfV;       ///< box of its texels: centre, half sides
    float texel;          ///< side of a texel that is partly covered, pixels; 0: none is
    PatchList children;   ///< none: a leaf
    std::uint32_t cover;  ///< first row of its coverage
    std::uint8_t level;
    /// kSharePlanes planes of coverage: four bits of a number from 0 to 15, sixteenths,
    /// 15 is all; and does it take thresholds from above? Else one plane: all or nothing.
    /// A plane has a row for each row of texels of the box: bit x is column x of the
    /// tile, and outside the box none is set.
    bool shared;
    bool sheet;  ///< one connected surface that fills the box
    bool bumpy;  ///< a leaf; its coverage is a BumpPlane

    [[nodiscard]] bool isLeaf() const noexcept { return children.groups == 0; }
    /// Rows and columns of the tile's texels that the box takes up.
    [[nodiscard]] int firstRow() const noexcept {
        return texels(v - halfV - cornerOf(v));
    }
    [[nodiscard]] int rows() const noexcept { return texels(2.0f * halfV); }
    [[nodiscard]] int firstColumn() const noexcept {
        return texels(u - halfU - cornerOf(u));
    }
    [[nodiscard]] int columns() const noexcept { return texels(2.0f * halfU); }

  private:
    /// Upper or left edge of its tile.
    [[nodiscard]] float cornerOf(float centre) const noexcept {
        return float(std::uint32_t(centre) >> (level + 4) << (level + 4));
    }
    [[nodiscard]] int texels(float pixels) const noexcept { return int(pixels) >> level; }
};

/// Four patches that are looked at together: first of all what hulls of rays are tested
/// against. Each field as Patch has it, or what that is made of.
struct alignas(16) PatchGroup {
    static constexpr int kShared = 32, kSheet = 64, kBumpy = 128;
    static constexpr int kGroupBits = 28;

    float w[4];
    UpperHalf above[4], below[4];  ///< from w to high and to low; -infinity: no patch
    std::uint16_t u0[4], v0[4], u1[4], v1[4];  ///< box, pixels
    float gradientU[4], gradientV[4];
    UpperHalf residual[4];
    std::uint32_t children[4];  ///< first group, and above kGroupBits the last's slots
    std::uint32_t cover[4];
    std::uint8_t childGroups[4];
    std::uint8_t kind[4];  ///< level, and what it is

    [[nodiscard]] float high(int i) const noexcept { return w[i] + widen(above[i]); }
    [[nodiscard]] float low(int i) const noexcept { return w[i] - widen(below[i]); }
    [[nodiscard]] PatchList childrenOf(int i) const noexcept {
        return {children[i] & ((1u << kGroupBits) - 1), childGroups[i],
                children[i] >> kGroupBits};
    }
    [[nodiscard]] Patch patch(int i) const noexcept {
        Patch p;
        p.high = high(i), p.low = low(i), p.w = w[i];
        p.gradientU = gradientU[i], p.gradientV = gradientV[i];
        p.residual = widen(residual[i]);
        p.u = 0.5f * float(u0[i] + u1[i]), p.v = 0.5f * float(v0[i] + v1[i]);
        p.halfU = 0.5f * float(u1[i] - u0[i]), p.halfV = 0.5f * float(v1[i] - v0[i]);
        p.children = childrenOf(i), p.cover = cover[i];
        p.level = kind[i] & 31;
        p.shared = kind[i] & kShared, p.sheet = kind[i] & kSheet;
        p.bumpy = kind[i] & kBumpy;
        p.texel = p.shared ? float(1u << p.level) : 0.0f;
        return p;
    }
};
static_assert(sizeof(PatchGroup) == 144);

/// Of the pixels of a square of 4 x 4, row by row: the sample is
/// `residual` / kSteps times this above the patch's plane there, w.
struct BumpPlane {
    static constexpr int kSide = 4;
    static constexpr float kSteps = 32767.0f;
    static constexpr std::int16_t kNone = -32768;  ///< no sample
    std::int16_t offset[kSide * kSide];
};
static_assert(sizeof(BumpPlane) == kTexels * sizeof(std::uint16_t));

class PatchTree {
  public:
    struct Options {
        /// A level 0 patch is split where it strays further than this from its plane, in
        /// pixel footprints.
        float flatness = 0.3f;
    };
    /// The tree of an opaque map's face; the same for any number of threads. Throws
    /// std::bad_alloc, also where groups or rows of coverage are more than 28 and 31 bits
    /// count.
    [[nodiscard]] static PatchTree build(const ShadowMap& map, std::uint32_t face,
                                         const Options& options);

    struct Level {
        std::uint32_t side = 0;  ///< of a tile, pixels
        std::uint32_t columns = 0, rows = 0;
        /// Row-major; of level 0 none, if it is not the last.
        std::vector<PatchList> tiles;
    };
    /// What a tree is made of; what else it knows follows from the size of the face.
    struct Content {
        std::vector<Level> levels;
        std::vector<PatchGroup> groups;
        /// Rows of texels; after the last patch's there are kTexels more.
        std::vector<std::uint16_t> covers;
        float lowest = 0.0f, highest = 0.0f;  ///< w of all patches
        /// Samples of a connected piece of surface within 16 x 16 pixels, on average; 0
        /// if there are none. Of closed bodies dozens, of slender leaves a few.
        float pieceSize = 0.0f;
    };
    /// The levels of a face of so many pixels, with room for the lists of their tiles.
    [[nodiscard]] static std::vector<Level> levelsOf(std::uint32_t width,
                                                     std::uint32_t height);
    /// The tree of a face of so many pixels that was stored, and may have been made up.
    /// Its levels are levelsOf() those. Errors (badFile) say what of it rays could not
    /// follow to an end. Whether it is the tree of the map's layers is not asked.
    [[nodiscard]] static Result<PatchTree> restore(Content content, std::uint32_t width,
                                                   std::uint32_t height);

    [[nodiscard]] const Content& content() const noexcept { return content_; }
    [[nodiscard]] const std::vector<Level>& levels() const noexcept {
        return content_.levels;
    }
    [[nodiscard]] const PatchGroup* groups() const noexcept {
        return content_.groups.data();
    }
    [[nodiscard]] const std::uint16_t* covers() const noexcept {
        return content_.covers.data();
    }
    /// Of a bumpy patch.
    [[nodiscard]] BumpPlane bumps(std::uint32_t cover) const noexcept {
        BumpPlane bumps;
        std::memcpy(&bumps, covers() + cover, sizeof bumps);
        return bumps;
    }
    [[nodiscard]] float lowest() const noexcept { return content_.lowest; }
    [[nodiscard]] float highest() const noexcept { return content_.highest; }
    /// Boxes must be so much wider, pixels, for what a ray's place is rounded by: whether
    /// it meets a patch does not depend on which boxes it was tested against.
    [[nodiscard]] float margin() const noexcept { return margin_; }
    [[nodiscard]] float pieceSize() const noexcept { return content_.pieceSize; }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

  private:
    PatchTree(Content content, std::uint32_t width, std::uint32_t height) noexcept;

    friend class PatchBuilder;
    Content content_;
    float margin_;
};

/// The trees of an opaque map's faces, made when first asked for; null if there is no
/// memory for them, for good.
[[nodiscard]] const std::vector<PatchTree>* patchTrees(const ShadowMap& map);

/// Those of its faces that were stored, for a map that has not been asked for any.
void holdPatchTrees(const ShadowMap& map, std::vector<PatchTree> trees);

}  // namespace mtsm::trace
