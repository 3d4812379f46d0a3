// A grid out of an OpenVDB file: chosen, counted, cut into blocks.
#include <openvdb/openvdb.h>

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/message.h"
#include "base/printable.h"
#include "scene/send.h"
#include "scene/vdb_archive.h"

namespace mtsm::scene {
namespace {

using base::concat;
using Entry = VdbArchive::Entry;
using Block = std::array<float, VolumeView::kBlockVoxels>;

constexpr int kSide = VolumeView::kBlockSide;
constexpr std::size_t kNamesShown = 20;

std::string quoted(const std::string& name) {
    return concat('"', base::printable(name, 200), '"');
}

std::string gridsThere(const std::vector<Entry>& entries) {
    std::string list = "grids there are: ";
    for (std::size_t i = 0; i < std::min(entries.size(), kNamesShown); ++i) {
        const Entry& e = entries[i];
        list += concat(i > 0 ? ", " : "", quoted(e.shownName()), " (",
                       e.isLevelSet() ? "level set, " : "", e.grid->valueType(), ")");
    }
    if (entries.size() > kNamesShown)
        list += concat(" and ", entries.size() - kNamesShown, " more");
    return list;
}

[[noreturn]] void refuseLevelSet(const Entry& entry) {
    throw Refusal{ErrorCode::unsupported,
                  concat("grid ", quoted(entry.shownName()),
                         " is a level set: it holds distances, not densities; convert it "
                         "to fog or name another grid (--density-grid)")};
}

/// The grid that the user names.
Entry& named(std::vector<Entry>& entries, const std::string& name) {
    for (Entry& e : entries) {
        if (e.name() != name && e.shownName() != name) continue;
        if (!e.isFloat())
            throw Refusal{ErrorCode::badArgument,
                          concat("grid ", quoted(name), " holds values of type ",
                                 e.grid->valueType(),
                                 ", and densities must be float, double or half; ",
                                 gridsThere(entries))};
        if (e.isLevelSet()) refuseLevelSet(e);
        return e;
    }
    throw Refusal{ErrorCode::badArgument,
                  concat("there is no grid ", quoted(name), "; ", gridsThere(entries))};
}

/// "density", or the only grid that it can be.
Entry& onlyFog(std::vector<Entry>& entries) {
    Entry *fog = nullptr, *levelSet = nullptr;
    std::size_t fogs = 0;
    for (Entry& e : entries) {
        if (!e.isFloat()) continue;
        if (e.name() == "density") {
            if (e.isLevelSet()) refuseLevelSet(e);
            return e;
        }
        (e.isLevelSet() ? levelSet : fog) = &e;
        fogs += !e.isLevelSet();
    }
    if (fogs == 1) return *fog;
    if (fogs > 1)
        throw Refusal{ErrorCode::badArgument,
                      concat("no grid is named \"density\", and which other one is meant "
                             "is not clear; name it (--density-grid); ",
                             gridsThere(entries))};
    if (levelSet) refuseLevelSet(*levelSet);
    throw Refusal{
        ErrorCode::unsupported,
        concat("no grid holds floats, so none can be densities; ", gridsThere(entries))};
}

Entry& choose(std::vector<Entry>& entries, const std::string& name) {
    if (entries.empty())
        throw Refusal{ErrorCode::badFile, "there is no grid in the file"};
    return name.empty() ? onlyFog(entries) : named(entries, name);
}

glm::dmat4 worldFromIndexOf(const Entry& entry) {
    const openvdb::math::Transform& transform = entry.grid->transform();
    if (!transform.isLinear())
        throw Refusal{ErrorCode::unsupported,
                      concat("grid ", quoted(entry.shownName()), " has a transform (",
                             transform.mapType(),
                             ") that is not affine, as grids of a camera frustum have; "
                             "resample it to a linear transform")};
    // OpenVDB multiplies rows from the left: its rows are our columns.
    const openvdb::Mat4d from = transform.baseMap()->getAffineMap()->getMat4();
    glm::dmat4 m(1.0);
    for (int column = 0; column < 4; ++column)
        for (int row = 0; row < 3; ++row)
            m[column][row] = from(column, row);
    return m;
}

/// A grid's active voxels, block by block, in the tree's order.
template <typename Grid>
class Blocks {
  public:
    explicit Blocks(const Grid& grid) : tree_(grid.tree()) {}

    /// Counts blocks that hold something, without any memory.
    [[nodiscard]] std::uint64_t count() {
        std::uint64_t blocks = 0;
        forEachLeaf([&](const Leaf& leaf) { blocks += fill(leaf, &oddities_); });
        forEachTile([&](const openvdb::CoordBBox& box, double value) {
            std::uint64_t inTile = 1;
            for (int axis = 0; axis < 3; ++axis)
                inTile *=
                    std::uint64_t(box.max()[axis] - std::int64_t(box.min()[axis]) + 1) /
                    kSide;
            oddities_.note(value, inTile * VolumeView::kBlockVoxels);
            if (usable(value) > 0.0f) blocks += inTile;
        });
        return blocks;
    }
    void send(const glm::dmat4& worldFromIndex, std::uint64_t count, FrameWriter& out) {
        std::vector<glm::ivec3> origins;
        origins.reserve(count);
        forEachLeaf([&](const Leaf& leaf) {
            const openvdb::Coord o = leaf.origin();
            if (fill(leaf, nullptr)) origins.emplace_back(o.x(), o.y(), o.z());
        });
        forEachBlockOfTiles([&](glm::ivec3 origin, float) { origins.push_back(origin); });
        out.volume(worldFromIndex, origins);
        forEachLeaf([&](const Leaf& leaf) {
            if (fill(leaf, nullptr)) out.densities(block_);
        });
        forEachBlockOfTiles([&](glm::ivec3, float density) {
            block_.fill(density);
            out.densities(block_);
        });
    }
    /// What count() met; empty if all was in order.
    [[nodiscard]] std::string oddities() const {
        if (oddities_.negative + oddities_.notFinite == 0) return {};
        return concat(oddities_.negative, " densities are negative and ",
                      oddities_.notFinite, " are NaN or too large; they count as 0");
    }

  private:
    using Tree = typename Grid::TreeType;
    using Leaf = typename Tree::LeafNodeType;
    static_assert(Leaf::DIM == kSide);

    struct Oddities {
        std::uint64_t negative = 0, notFinite = 0;
        void note(double value, std::uint64_t voxels) {
            if (value < 0.0) negative += voxels;
            if (!(std::abs(value) <= kMost)) notFinite += voxels;
        }
    };
    static constexpr double kMost = std::numeric_limits<float>::max();

    static float usable(double value) {
        return value > 0.0 && value <= kMost ? float(value) : 0.0f;
    }
    template <typename Visit>
    void forEachLeaf(Visit&& visit) {
        for (auto leaf = tree_.cbeginLeaf(); leaf; ++leaf)
            visit(*leaf);
    }
    template <typename Visit>
    void forEachTile(Visit&& visit) {
        auto tile = tree_.cbeginValueOn();
        tile.setMaxDepth(Tree::ValueOnCIter::LEAF_DEPTH - 1);
        for (; tile; ++tile) {
            openvdb::CoordBBox box;
            tile.getBoundingBox(box);
            visit(box, double(*tile));
        }
    }
    template <typename Visit>
    void forEachBlockOfTiles(Visit&& visit) {
        forEachTile([&](const openvdb::CoordBBox& box, double value) {
            const float density = usable(value);
            if (!(density > 0.0f)) return;
            for (std::int64_t x = box.min().x(); x < box.max().x(); x += kSide)
                for (std::int64_t y = box.min().y(); y < box.max().y(); y += kSide)
                    for (std::int64_t z = box.min().z(); z < box.max().z(); z += kSide)
                        visit(glm::ivec3(x, y, z), density);
        });
    }
    /// Makes block_ the leaf's densities; true if there is any. OpenVDB has z run
    /// fastest.
    bool fill(const Leaf& leaf, Oddities* oddities) {
        block_.fill(0.0f);
        bool any = false;
        for (auto voxel = leaf.cbeginValueOn(); voxel; ++voxel) {
            if (oddities) oddities->note(double(*voxel), 1);
            const float density = usable(double(*voxel));
            any |= density > 0.0f;
            const auto at = int(voxel.pos());
            block_[std::size_t(((at & 7) * kSide + (at >> 3 & 7)) * kSide + (at >> 6))] =
                density;
        }
        return any;
    }

    const Tree& tree_;
    Oddities oddities_;
    Block block_;
};

template <typename Grid>
void sendGrid(const Entry& entry, const Grid& grid, std::uint64_t mostBytes,
              FrameWriter& out) {
    Blocks<Grid> blocks(grid);
    const std::uint64_t count = blocks.count();
    if (count > mostBytes / PlacedVolume::kBlockBytes)
        throw Refusal{
            ErrorCode::tooLarge,
            concat("grid ", quoted(entry.shownName()), " has ", count,
                   " blocks of 8 x 8 x 8 active voxels, at ", PlacedVolume::kBlockBytes,
                   " bytes each more than the limit of ", mostBytes,
                   " bytes (importerBytes); resample the grid, or use a machine of more "
                   "memory")};
    const glm::dmat4 worldFromIndex = worldFromIndexOf(entry);
    if (const std::string odd = blocks.oddities(); !odd.empty())
        out.warning(concat("grid ", quoted(entry.shownName()), ": ", odd));
    if (const double background = double(grid.background()); background != 0.0)
        out.warning(concat("grid ", quoted(entry.shownName()), " has a background of ",
                           background, "; only its active voxels are cast"));
    if (count == 0)
        out.warning(concat("grid ", quoted(entry.shownName()),
                           " has no active voxel of positive density; it casts nothing"));
    blocks.send(worldFromIndex, count, out);
}

void send(VdbArchive& archive, const VolumeFileOptions& options, FrameWriter& out) {
    Entry& entry = choose(archive.entries(), options.grid);
    archive.read(entry);
    if (const auto floats = openvdb::gridConstPtrCast<openvdb::FloatGrid>(entry.grid))
        return sendGrid(entry, *floats, options.importerBytes, out);
    const auto doubles = openvdb::gridConstPtrCast<openvdb::DoubleGrid>(entry.grid);
    sendGrid(entry, *doubles, options.importerBytes, out);
}

}  // namespace

void sendVolume(const std::string& path, const VolumeFileOptions& options,
                FrameWriter& out) {
    try {
        openvdb::initialize();
        // Never deleted: see vdb_archive.h.
        send(*new VdbArchive(path, out), options, out);
        out.end();
    } catch (const Refusal& refusal) {
        out.failure(refusal.code, concat(path, ": ", refusal.text));
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& e) {
        out.failure(ErrorCode::badFile,
                    concat(path, ": OpenVDB cannot read it: ", e.what()));
    }
}

}  // namespace mtsm::scene
