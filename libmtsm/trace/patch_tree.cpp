// PatchTree::build: rows of tiles, level by level, and then all in one.
#include "trace/patch_tree.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <new>
#include <utility>

#include "base/lazy.h"
#include "base/parallel.h"
#include "trace/patch_coarsening.h"
#include "trace/patch_nodes.h"
#include "trace/patch_pieces.h"

namespace mtsm::trace {
using namespace patch_detail;
namespace {

/// PatchTree::Options::flatness of the trees of queries: what is close to receivers must
/// be more exact if no near field answers for it (tests/bench/NOTES.md).
constexpr float kFlatAlone = 0.3f, kFlatBesideNearField = 3.0f;

/// What groups and rows of coverage of a tree are numbered up to.
constexpr std::size_t kMostGroups = std::size_t(1) << PatchGroup::kGroupBits;
constexpr std::size_t kMostRows = std::size_t(1) << 31;

std::vector<std::uint16_t> fullRows() {
    std::vector<std::uint16_t> rows;
    for (std::uint32_t x1 = 1; x1 <= kTexels; ++x1) {
        for (std::uint32_t x0 = 0; x0 < x1; ++x0)
            rows.insert(rows.end(), kTexels, std::uint16_t((1u << x1) - (1u << x0)));
    }
    return rows;
}

/// A row of a level's tiles. Its groups and covers are numbered from 0 and from kFullRows
/// until it is known where they are to lie in the tree.
struct TileRow {
    Nodes all;
    std::vector<std::uint32_t> begin{0};      // [tiles + 1] in all.nodes
    std::vector<std::uint32_t> maskBegin{0};  // [tiles + 1] in all.masks
    std::vector<PatchList> tiles;
    Parts parts;
    std::size_t firstGroup = 0, firstCover = 0;
    std::uint64_t samples = 0, pieces = 0;  // of level 0

    void endTile() {
        const Node* nodes = all.nodes.data() + begin.back();
        begin.push_back(std::uint32_t(all.nodes.size()));
        maskBegin.push_back(std::uint32_t(all.masks.size()));
        const std::size_t count = begin.back() - begin[begin.size() - 2];
        tiles.push_back(parts.tiles.append(
            count, [&](std::size_t i) -> const Node& { return nodes[i]; }));
    }
};

struct LevelRows {
    std::uint32_t side = 0, columns = 0;
    std::vector<TileRow> rows;
};

}  // namespace

/// Puts the tasks' pieces together, in order.
class PatchBuilder {
  public:
    PatchBuilder(const ShadowMap& map, std::uint32_t face,
                 const PatchTree::Options& options)
        : map_(map), face_(face), options_(options) {
        const Projection& p = map.projection(face);
        const bool perspective = p.kind == ProjectionKind::perspective;
        (perspective ? footprint_.perW : footprint_.constant) = p.pixelFootprint(1.0);
        columns_ = (map.info().width + kTexels - 1) / kTexels;
        rows_ = (map.info().height + kTexels - 1) / kTexels;
    }

    PatchTree run() {
        const std::uint32_t width = map_.info().width, height = map_.info().height;
        content_.levels = PatchTree::levelsOf(width, height);
        const bool single = columns_ == 1 && rows_ == 1;
        LevelRows level = single ? pieces() : coarsePieces();
        std::size_t number = single ? 0 : 1;
        settle(level, content_.levels[number].tiles, true);
        while (level.columns > 1 || level.rows.size() > 1) {
            level = coarsen(level);
            settle(level, content_.levels[++number].tiles, false);
        }
        content_.lowest = HUGE_VALF, content_.highest = -HUGE_VALF;
        for (const Node& n : level.rows[0].all.nodes) {
            content_.lowest = std::min(content_.lowest, n.low);
            content_.highest = std::max(content_.highest, n.high);
        }
        if (pieces_ > 0) content_.pieceSize = float(double(samples_) / double(pieces_));
        putTogether();
        return {std::move(content_), width, height};
    }

  private:
    /// Level 0 of a map that is one tile.
    LevelRows pieces() {
        LevelRows level{kTexels, 1, std::vector<TileRow>(1)};
        TileRow& row = level.rows[0];
        TilePieces tile(map_, face_, footprint_, options_.flatness);
        addPieces(tile, 0, 0, row, row.all);
        row.endTile();
        return level;
    }

    /// Level 1. Of level 0 only what its patches have as children is kept.
    LevelRows coarsePieces() {
        LevelRows level{2 * kTexels, (columns_ + 1) / 2,
                        std::vector<TileRow>((rows_ + 1) / 2)};
        base::parallelFor(std::size_t(0), level.rows.size(), [&](std::size_t y) {
            TilePieces tile(map_, face_, footprint_, options_.flatness);
            Coarsening coarsening(1, kTexels, footprint_);
            Nodes below;
            for (std::uint32_t x = 0; x < level.columns; ++x) {
                below.clear();
                for (std::uint32_t q = 0; q < 4; ++q)
                    addPieces(tile, 2 * x + (q & 1), 2 * std::uint32_t(y) + (q >> 1),
                              level.rows[y], below);
                const TilePair all{below.nodes.data(), below.nodes.size(),
                                   below.masks.data()};
                coarsening.run(x, std::uint32_t(y), {all, {}}, level.rows[y].all,
                               level.rows[y].parts);
                level.rows[y].endTile();
            }
        });
        return level;
    }

    /// Those of a tile, if there is such a one.
    void addPieces(TilePieces& tile, std::uint32_t x, std::uint32_t y, TileRow& row,
                   Nodes& nodes) const {
        if (x >= columns_ || y >= rows_) return;
        const std::size_t before = nodes.nodes.size();
        tile.run(x, y, nodes, row.parts);
        row.samples += tile.samples();
        row.pieces += nodes.nodes.size() - before;
    }

    LevelRows coarsen(const LevelRows& below) {
        LevelRows level{2 * below.side, (below.columns + 1) / 2,
                        std::vector<TileRow>((below.rows.size() + 1) / 2)};
        const auto number = std::uint8_t(std::countr_zero(level.side / kTexels));
        base::parallelFor(std::size_t(0), level.rows.size(), [&](std::size_t y) {
            Coarsening coarsening(number, below.side, footprint_);
            const auto pairOf = [&](std::size_t row, std::uint32_t x) -> TilePair {
                if (row >= below.rows.size()) return {};
                const TileRow& tiles = below.rows[row];
                const std::uint32_t last = std::min(2 * x + 2, below.columns);
                return {tiles.all.nodes.data() + tiles.begin[2 * x],
                        tiles.begin[last] - tiles.begin[2 * x],
                        tiles.all.masks.data() + tiles.maskBegin[2 * x]};
            };
            for (std::uint32_t x = 0; x < level.columns; ++x) {
                coarsening.run(x, std::uint32_t(y),
                               {pairOf(2 * y, x), pairOf(2 * y + 1, x)},
                               level.rows[y].all, level.rows[y].parts);
                level.rows[y].endTile();
            }
        });
        return level;
    }

    /// Finds the places of a level's parts in the tree, and fills its tiles. `first`: it
    /// is the first level to have any, and groups of children have children and covers of
    /// the same row.
    void settle(LevelRows& level, std::vector<PatchList>& tiles, bool first) {
        for (TileRow& row : level.rows) {
            row.firstGroup = groups_, row.firstCover = covers_;
            groups_ += row.parts.children.all().size() + row.parts.tiles.all().size();
            covers_ += row.parts.covers.size();
            if (groups_ > kMostGroups || covers_ > kMostRows) throw std::bad_alloc();
            samples_ += row.samples, pieces_ += row.pieces;
        }
        base::parallelFor(std::size_t(0), level.rows.size(), [&](std::size_t y) {
            TileRow& row = level.rows[y];
            const auto firstGroup = std::uint32_t(row.firstGroup);
            const auto firstCover = std::uint32_t(row.firstCover);
            for (Node& n : row.all.nodes) {
                n.children.group += firstGroup;
                if (n.cover >= kFullRows) n.cover += firstCover;
            }
            const auto move = [&](std::vector<PatchGroup>& groups) {
                for (PatchGroup& g : groups) {
                    for (int i = 0; i < 4; ++i) {
                        g.children[i] += g.childGroups[i] > 0 ? firstGroup : 0;
                        g.cover[i] += g.cover[i] >= kFullRows ? firstCover : 0;
                    }
                }
            };
            move(row.parts.tiles.all());
            if (first) move(row.parts.children.all());
            for (PatchList& tile : row.tiles)
                tile.group += std::uint32_t(firstGroup + row.parts.children.all().size());
        });
        auto tile = tiles.begin();
        for (TileRow& row : level.rows) {
            tile = std::copy(row.tiles.begin(), row.tiles.end(), tile);
            placed_.push_back({std::move(row.parts), row.firstGroup, row.firstCover});
        }
    }

    void putTogether() {
        const std::vector<std::uint16_t> full = fullRows();
        content_.groups.resize(groups_);
        content_.covers.resize(full.size() + covers_ + kTexels);  // kernels read further
        std::copy(full.begin(), full.end(), content_.covers.begin());
        base::parallelFor(std::size_t(0), placed_.size(), [&](std::size_t i) {
            Placed& p = placed_[i];
            const auto copy = [](const auto& from, auto to) {
                return std::copy(from.begin(), from.end(), to);
            };
            const auto tiles =
                copy(p.parts.children.all(),
                     content_.groups.begin() + std::ptrdiff_t(p.firstGroup));
            copy(p.parts.tiles.all(), tiles);
            copy(p.parts.covers,
                 content_.covers.begin() + std::ptrdiff_t(full.size() + p.firstCover));
            p = {};
        });
    }

    struct Placed {
        Parts parts;
        std::size_t firstGroup = 0, firstCover = 0;
    };

    const ShadowMap& map_;
    std::uint32_t face_;
    PatchTree::Options options_;
    Footprint footprint_;
    std::uint32_t columns_ = 0, rows_ = 0;  // of level 0
    std::vector<Placed> placed_;
    std::size_t groups_ = 0, covers_ = 0;     // so far
    std::uint64_t samples_ = 0, pieces_ = 0;  // of level 0
    PatchTree::Content content_;
};

PatchTree::PatchTree(Content content, std::uint32_t width, std::uint32_t height) noexcept
    : content_(std::move(content)), margin_(float(std::max(width, height)) * 0x1p-19f) {}

std::vector<PatchTree::Level> PatchTree::levelsOf(std::uint32_t width,
                                                  std::uint32_t height) {
    std::vector<Level> levels;
    for (std::uint32_t side = kTexels;; side *= 2) {
        Level& level = levels.emplace_back();
        level.side = side;
        level.columns = (width + side - 1) / side;
        level.rows = (height + side - 1) / side;
        const bool isLast = level.columns == 1 && level.rows == 1;
        if (isLast || levels.size() > 1)
            level.tiles.resize(std::size_t(level.columns) * level.rows);
        if (isLast) return levels;
    }
}

PatchTree PatchTree::build(const ShadowMap& map, std::uint32_t face,
                           const Options& options) {
    return PatchBuilder(map, face, options).run();
}

const std::vector<PatchTree>* patchTrees(const ShadowMap& map) {
    using Kept = std::vector<PatchTree>;
    const Kept& kept = map.queryData().get<Kept>([&] {
        Kept trees;
        try {
            for (std::uint32_t face = 0; face < map.faceCount(); ++face)
                trees.push_back(PatchTree::build(
                    map, face,
                    {map.nearField(face).empty() || !map.nearHair(face).empty()
                         ? kFlatAlone
                         : kFlatBesideNearField}));
        } catch (const std::bad_alloc&) {
            trees = {};
        }
        return trees;
    });
    return kept.empty() ? nullptr : &kept;
}

void holdPatchTrees(const ShadowMap& map, std::vector<PatchTree> trees) {
    map.queryData().get<std::vector<PatchTree>>([&] { return std::move(trees); });
}

std::uint64_t PatchTree::memoryBytes() const noexcept {
    const Content& c = content_;
    std::uint64_t bytes = c.groups.capacity() * sizeof(PatchGroup) +
                          c.covers.capacity() * sizeof(std::uint16_t);
    for (const Level& level : c.levels)
        bytes += level.tiles.capacity() * sizeof(PatchList);
    return bytes;
}

}  // namespace mtsm::trace
