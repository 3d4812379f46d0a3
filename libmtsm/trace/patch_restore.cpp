// PatchTree::restore: a tree that may have been made up is one that every ray comes to
// the end of, and that is all that is asked of it.
#include <bit>
#include <cmath>

#include "base/message.h"
#include "trace/patch_tree.h"

namespace mtsm::trace {
namespace {

template <typename... Parts>
Error bad(const Parts&... parts) {
    return base::makeError(ErrorCode::badFile, parts...);
}

/// The side of the smallest square of the tile, its quarters and their quarters that
/// holds the box of a patch of level 0.
std::uint32_t squareOf(const PatchGroup& g, int i) {
    std::uint32_t side = kTexels;
    while (side > BumpPlane::kSide &&
           g.u0[i] / (side / 2) == (g.u1[i] - 1u) / (side / 2) &&
           g.v0[i] / (side / 2) == (g.v1[i] - 1u) / (side / 2))
        side /= 2;
    return side;
}

/// Patches are in lists of tiles or of children, not in both. Children are of lower
/// levels; of level 0, of smaller squares. So no list leads back to itself, and a ray has
/// no more to look at than there are patches.
class Check {
  public:
    Check(const PatchTree::Content& content, std::uint32_t width, std::uint32_t height)
        : content_(content),
          width_(width),
          height_(height),
          listed_(4 * content.groups.size()) {}

    Status run() {
        if (content_.covers.size() < kTexels) return bad("no rows of texels");
        for (const float x : {content_.lowest, content_.highest, content_.pieceSize}) {
            if (!content_.groups.empty() && !std::isfinite(x))
                return bad("a range or a size of pieces is ", x);
        }
        if (auto s = checkTiles(); !s) return s;
        for (std::uint32_t group = 0; group < content_.groups.size(); ++group) {
            for (int slot = 0; slot < 4; ++slot) {
                if (auto s = checkPatch(content_.groups[group], slot); !s)
                    return bad("patch ", slot, " of group ", group, ": ",
                               s.error().message);
                const std::uint8_t where = listed_[4 * std::size_t(group) + slot];
                if (auto s = checkChildren(content_.groups[group], slot,
                                           where == kInTile ? kBelowTile : kBelowChild);
                    !s)
                    return bad("patch ", slot, " of group ", group, ": ",
                               s.error().message);
            }
        }
        return {};
    }

  private:
    enum : std::uint8_t { kInTile = 1, kBelowTile = 2, kBelowChild = 4 };

    Status checkTiles() {
        for (std::size_t level = 0; level < content_.levels.size(); ++level) {
            const std::vector<PatchList>& tiles = content_.levels[level].tiles;
            for (std::size_t tile = 0; tile < tiles.size(); ++tile) {
                if (auto s = list(tiles[tile], kInTile); !s)
                    return bad("tile ", tile, " of level ", level, ": ",
                               s.error().message);
            }
        }
        return {};
    }

    /// Marks the patches of a list.
    Status list(const PatchList& list, std::uint8_t where) {
        if (list.groups == 0) return {};
        if (list.group >= content_.groups.size() ||
            list.groups > content_.groups.size() - list.group)
            return bad("a list of ", std::uint32_t(list.groups), " groups from ",
                       list.group, " on, of ", content_.groups.size());
        for (std::uint32_t i = 0; i < list.groups; ++i) {
            for (std::uint32_t slots = list.slotsOf(i); slots; slots &= slots - 1) {
                const int slot = std::countr_zero(slots);
                std::uint8_t& known = listed_[4 * std::size_t(list.group + i) + slot];
                if ((known & where) || (known && (known == kInTile || where == kInTile)))
                    return bad("a list has patch ", slot, " of group ", list.group + i,
                               ", which is in another one");
                known |= where;
            }
        }
        return {};
    }

    static bool exists(const PatchGroup& g, int i) {
        return widen(g.above[i]) != -HUGE_VALF;
    }

    [[nodiscard]] Status checkPatch(const PatchGroup& g, int i) const {
        if (!exists(g, i)) return {};
        const float above = widen(g.above[i]), below = widen(g.below[i]);
        for (const float x : {g.w[i], above, below, g.gradientU[i], g.gradientV[i],
                              widen(g.residual[i])}) {
            if (!std::isfinite(x)) return bad("a depth, slope or bound is ", x);
        }
        const std::uint32_t level = g.kind[i] & 31u;
        if (level >= content_.levels.size())
            return bad("level ", level, " of ", content_.levels.size());
        const std::uint32_t side = content_.levels[level].side;
        if (g.u0[i] >= g.u1[i] || g.v0[i] >= g.v1[i] || g.u0[i] >= width_ ||
            g.v0[i] >= height_ || g.u0[i] / side != (g.u1[i] - 1u) / side ||
            g.v0[i] / side != (g.v1[i] - 1u) / side)
            return bad("a box of pixels ", g.u0[i], " to ", g.u1[i], " and ", g.v0[i],
                       " to ", g.v1[i], " is not within a tile of ", side);
        const bool bumpy = g.kind[i] & PatchGroup::kBumpy;
        if (bumpy && (level != 0 || squareOf(g, i) != BumpPlane::kSide))
            return bad("is bumpy, but larger than ", BumpPlane::kSide, " pixels");
        // Kernels read as many rows from the last one's first on.
        const std::uint64_t before =
            g.kind[i] & PatchGroup::kShared
                ? std::uint64_t(kSharePlanes - 1) * ((g.v1[i] - g.v0[i]) >> level)
                : 0;
        if (g.cover[i] + before > content_.covers.size() - kTexels)
            return bad("rows of texels from ", g.cover[i], " on, of ",
                       content_.covers.size());
        return {};
    }

    Status checkChildren(const PatchGroup& g, int i, std::uint8_t where) {
        const PatchList children = g.childrenOf(i);
        if (!exists(g, i) || children.groups == 0) return {};
        if (auto s = list(children, where); !s) return s;
        const std::uint32_t level = g.kind[i] & 31u;
        for (std::uint32_t k = 0; k < children.groups; ++k) {
            const PatchGroup& below = content_.groups[children.group + k];
            for (std::uint32_t slots = children.slotsOf(k); slots; slots &= slots - 1) {
                const int slot = std::countr_zero(slots);
                if (!exists(below, slot)) continue;
                const std::uint32_t itsLevel = below.kind[slot] & 31u;
                const bool isLower =
                    itsLevel < level ||
                    (level == 0 && itsLevel == 0 && below.u0[slot] < below.u1[slot] &&
                     below.v0[slot] < below.v1[slot] &&
                     squareOf(below, slot) < squareOf(g, i));
                if (!isLower)
                    return bad("its child, patch ", slot, " of group ",
                               children.group + k, ", is no smaller");
            }
        }
        return {};
    }

    const PatchTree::Content& content_;
    std::uint32_t width_, height_;
    std::vector<std::uint8_t> listed_;  // [group][slot]: in which lists
};

}  // namespace

Result<PatchTree> PatchTree::restore(Content content, std::uint32_t width,
                                     std::uint32_t height) {
    if (auto s = Check(content, width, height).run(); !s) return s.error();
    return PatchTree(std::move(content), width, height);
}

}  // namespace mtsm::trace
