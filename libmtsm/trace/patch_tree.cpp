// PatchTree::build: samples to pieces of surface, then level by level to coarser ones.
#include "trace/patch_tree.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <new>
#include <span>
#include <utility>

#include "base/lazy.h"
#include "base/parallel.h"

namespace mtsm::trace {
namespace {

/// Neighbouring samples that differ by no more than this belong to one surface; no plane
/// is steeper either. In pixel footprints per pixel.
constexpr float kSteepest = 3.0f;
/// Pieces are put together where they lie within so many texel footprints of one plane:
/// the flattest first.
constexpr std::array kTolerances = {1.0f, 4.0f};

/// PatchTree::Options::flatness of the trees of queries: what is close to receivers must
/// be more exact if no near field answers for it (tests/bench/NOTES.md).
constexpr float kFlatAlone = 0.3f, kFlatBesideNearField = 3.0f;

/// Members of a coarser patch: its groups are counted in a byte.
constexpr std::size_t kMostMembers = 4 * 255;
/// What groups and rows of coverage of a tree are numbered up to.
constexpr std::size_t kMostGroups = std::size_t(1) << PatchGroup::kGroupBits;
constexpr std::size_t kMostRows = std::size_t(1) << 31;

/// Sums over samples, enough to fit a plane to them.
struct Moments {
    double n = 0, u = 0, v = 0, w = 0, uu = 0, uv = 0, vv = 0, uw = 0, vw = 0;

    void add(double x, double y, double z) {
        n += 1, u += x, v += y, w += z;
        uu += x * x, uv += x * y, vv += y * y, uw += x * z, vw += y * z;
    }
    void add(const Moments& m) {
        n += m.n, u += m.u, v += m.v, w += m.w;
        uu += m.uu, uv += m.uv, vv += m.vv, uw += m.uw, vw += m.vw;
    }
};

struct Box {
    float u0, v0, u1, v1;

    void include(const Box& b) {
        u0 = std::min(u0, b.u0), v0 = std::min(v0, b.v0);
        u1 = std::max(u1, b.u1), v1 = std::max(v1, b.v1);
    }
    [[nodiscard]] float area() const { return (u1 - u0) * (v1 - v0); }
};

struct Plane {
    double u = 0, v = 0;  // through this place
    double w = 0, gradientU = 0, gradientV = 0;

    [[nodiscard]] double at(double x, double y) const {
        return w + gradientU * (x - u) + gradientV * (y - v);
    }
};

/// x >= 0, rounded up.
UpperHalf halveUp(float x) {
    return UpperHalf((std::bit_cast<std::uint32_t>(x) + 0xffff) >> 16);
}

struct Slope {
    double u = 0, v = 0;
};

/// Least squares; what few samples leave open is as `likely`.
Plane fit(const Moments& m, Slope likely, double steepest) {
    const auto limit = [steepest](double slope) {
        return std::clamp(slope, -steepest, steepest);
    };
    if (m.n == 1) return {m.u, m.v, m.w, limit(likely.u), limit(likely.v)};
    const double u = m.u / m.n, v = m.v / m.n, w = m.w / m.n;
    const double xx = std::max(0.0, m.uu - m.n * u * u);
    const double yy = std::max(0.0, m.vv - m.n * v * v);
    const double xy = m.uv - m.n * u * v;
    // Of what is left above the likely plane.
    const double xw = m.uw - m.n * u * w - likely.u * xx - likely.v * xy;
    const double yw = m.vw - m.n * v * w - likely.u * xy - likely.v * yy;
    const double slack = 0.25;
    const double determinant = (xx + slack) * (yy + slack) - xy * xy;
    const double slopeU = likely.u + (xw * (yy + slack) - yw * xy) / determinant;
    const double slopeV = likely.v + (yw * (xx + slack) - xw * xy) / determinant;
    return {u, v, w, limit(slopeU), limit(slopeV)};
}

/// A patch while the tree is made.
struct Node {
    Plane plane;  // through the middle of the box once it is done
    float residual = 0, low = 0, high = 0;
    Box box{};
    Moments moments;
    PatchList children{};
    std::uint32_t cover = 0;
    std::uint32_t masks = 0;  // how many PixelMasks it has
    std::uint8_t level = 0;
    bool shared = false, sheet = false, bumpy = false;

    float above = 0, below = 0;  // of high and low, once it is done

    void centre() {
        const double u = 0.5 * (box.u0 + box.u1), v = 0.5 * (box.v0 + box.v1);
        plane.w = plane.at(u, v);
        plane.u = u, plane.v = v;
    }
};

/// How far the plane is from the node's surface, at most.
float mismatch(const Plane& plane, const Node& node) {
    double most = 0;
    for (const float u : {node.box.u0, node.box.u1}) {
        for (const float v : {node.box.v0, node.box.v1})
            most = std::max(most, std::abs(plane.at(u, v) - node.plane.at(u, v)));
    }
    return float(most) + node.residual;
}

/// The pixels that a node covers in one tile of level 0.
struct PixelMask {
    std::uint16_t x, y;     // tile
    std::uint16_t covered;  // pixels
    std::uint16_t row[kTexels];
};

struct Nodes {
    std::vector<Node> nodes;
    std::vector<PixelMask> masks;  // of each node in turn

    void clear() { nodes.clear(), masks.clear(); }
};

/// Where PatchTree::covers begins: for every range of columns as many equal rows as a
/// patch can have, for all those that fill their boxes.
constexpr std::uint32_t kFullRows = kTexels * (kTexels + 1) / 2 * kTexels;

/// Of texels [x0, x1) of each row.
std::uint32_t fullCover(std::uint32_t x0, std::uint32_t x1) {
    return ((x1 - 1) * x1 / 2 + x0) * kTexels;
}

std::vector<std::uint16_t> fullRows() {
    std::vector<std::uint16_t> rows;
    for (std::uint32_t x1 = 1; x1 <= kTexels; ++x1) {
        for (std::uint32_t x0 = 0; x0 < x1; ++x0)
            rows.insert(rows.end(), kTexels, std::uint16_t((1u << x1) - (1u << x0)));
    }
    return rows;
}

constexpr float kNever = -HUGE_VALF;

PatchGroup emptyGroup() {
    PatchGroup g{};
    std::fill_n(g.above, 4, UpperHalf(std::bit_cast<std::uint32_t>(kNever) >> 16));
    return g;
}

/// Texels that are covered in part reach out of the pixels' box.
Box wholeTexels(const Node& node) {
    if (!node.shared) return node.box;
    const std::uint32_t texel = 1u << node.level;
    const auto down = [texel](float x) { return float(std::uint32_t(x) & ~(texel - 1)); };
    const auto up = [&](float x) { return down(x + float(texel - 1)); };
    return {down(node.box.u0), down(node.box.v0), up(node.box.u1), up(node.box.v1)};
}

/// Depth of the plane at the middle of a group's box.
float middleOf(const Node& node, const Box& box) {
    return float(node.plane.at(0.5 * (box.u0 + box.u1), 0.5 * (box.v0 + box.v1)));
}

/// Rounds bounds as groups have them, outwards, and by what a ray's depth is rounded.
void roundBounds(Node& node) {
    node.residual = widen(halveUp(node.residual));
    const float w = middleOf(node, wholeTexels(node));
    const float margin =
        std::max({std::abs(node.low), std::abs(node.high), std::abs(w)}) * 0x1p-18f;
    node.above = widen(halveUp(std::max(0.0f, node.high - w + margin)));
    node.below = widen(halveUp(std::max(0.0f, w - node.low + margin)));
    node.high = w + node.above;
    node.low = w - node.below;
}

void store(const Node& node, PatchGroup& g, int i) {
    const Box box = wholeTexels(node);
    g.w[i] = middleOf(node, box);
    g.above[i] = halveUp(node.above);
    g.below[i] = halveUp(node.below);
    g.u0[i] = std::uint16_t(box.u0), g.u1[i] = std::uint16_t(box.u1);
    g.v0[i] = std::uint16_t(box.v0), g.v1[i] = std::uint16_t(box.v1);
    g.gradientU[i] = float(node.plane.gradientU);
    g.gradientV[i] = float(node.plane.gradientV);
    g.residual[i] = halveUp(node.residual);
    g.children[i] = node.children.group | std::uint32_t(node.children.slots)
                                              << PatchGroup::kGroupBits;
    g.childGroups[i] = std::uint8_t(node.children.groups);
    g.cover[i] = node.cover;
    const bool sheet = node.sheet && box.area() == node.box.area();
    g.kind[i] = std::uint8_t(node.level | (node.shared ? PatchGroup::kShared : 0) |
                             (sheet ? PatchGroup::kSheet : 0) |
                             (node.bumpy ? PatchGroup::kBumpy : 0));
}

/// Groups that lists of nodes are put into. What does not fill a group has it together
/// with other lists.
class Groups {
  public:
    template <typename NodeAt>
    PatchList append(std::size_t count, const NodeAt& nodeAt) {
        if (count == 0) return {};
        for (std::size_t left = count; left < 4; ++left) {
            if (open_[left].empty()) continue;
            const std::uint32_t group = open_[left].back();
            open_[left].pop_back();
            return {group, 1, fill(group, 4 - left, 0, count, nodeAt)};
        }
        PatchList list{std::uint32_t(all_.size()), std::uint32_t((count + 3) / 4), 0};
        for (std::size_t i = 0; i < count; i += 4) {
            all_.push_back(emptyGroup());
            list.slots = fill(std::uint32_t(all_.size() - 1), 0, i,
                              std::min(count, i + 4), nodeAt);
        }
        return list;
    }

    [[nodiscard]] std::vector<PatchGroup>& all() { return all_; }

  private:
    /// Puts nodes [begin, end) into a group's slots from `first` on; a bit for each.
    template <typename NodeAt>
    std::uint32_t fill(std::uint32_t group, std::size_t first, std::size_t begin,
                       std::size_t end, const NodeAt& nodeAt) {
        for (std::size_t i = begin; i < end; ++i)
            store(nodeAt(i), all_[group], int(first + i - begin));
        const std::size_t next = first + end - begin;
        if (next < 4) open_[4 - next].push_back(group);
        return (1u << next) - (1u << first);
    }

    std::vector<PatchGroup> all_;
    std::array<std::vector<std::uint32_t>, 4> open_;  // by how many slots are left
};

/// What a task adds to the tree: groups of children and of whole tiles, coverage.
struct Parts {
    Groups children, tiles;
    std::vector<std::uint16_t> covers;
};

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

struct Footprint {
    double perW = 0, constant = 0;  // of a pixel, in w
    [[nodiscard]] float at(double w) const {
        return float(perW * std::abs(w) + constant);
    }
};

// --- level 0
// -------------------------------------------------------------------------------

struct Sample {
    std::uint8_t x, y;  // within the tile
    float w;
};

/// Pieces of surface in one tile of 16 x 16 pixels.
class TilePieces {
  public:
    TilePieces(const ShadowMap& map, std::uint32_t face, Footprint footprint,
               float flatness)
        : map_(map), face_(face), footprint_(footprint), flatness_(flatness) {
        perspective_ = map.projection(face).kind == ProjectionKind::perspective;
    }

    /// Appends those of tile (x, y).
    void run(std::uint32_t x, std::uint32_t y, Nodes& made, Parts& parts) {
        corner_ = {x * kTexels, y * kTexels};
        gather();
        if (w_.empty()) return;
        for (std::uint32_t i = 0; i < kTexels; ++i)
            u_[i] = corner_.x + i + 0.5, v_[i] = corner_.y + i + 0.5;
        connect();
        separate();
        for (std::size_t piece = 0; piece + 1 < pieceBegin_.size(); ++piece) {
            const std::span<const Sample> samples(
                &ordered_[pieceBegin_[piece]], &ordered_[pieceBegin_[piece + 1] - 1] + 1);
            made.nodes.push_back(emit(samples, {0, 0, kTexels}, {}, parts));
            made.nodes.back().masks = 1;
            PixelMask mask{
                std::uint16_t(x), std::uint16_t(y), std::uint16_t(samples.size()), {}};
            addBits(samples, mask.row);
            made.masks.push_back(mask);
        }
    }

    [[nodiscard]] std::size_t samples() const { return w_.size(); }

  private:
    struct Square {
        int x, y, size;
    };
    static constexpr std::uint32_t kNone = 0xffffffffu;

    /// Samples by pixel, and how far from each its neighbours may be.
    void gather() {
        w_.clear();
        const std::uint32_t width = map_.info().width, height = map_.info().height;
        for (std::uint32_t row = 0; row < kTexels; ++row) {
            const std::uint32_t y = corner_.y + row;
            std::uint32_t column = 0;
            while (y < height && column < kTexels && corner_.x + column < width)
                column += gatherRow(column, row);
            const auto end = std::uint32_t(w_.size());
            std::fill(&begin_[row * kTexels + column], &begin_[row * kTexels] + kTexels,
                      end);
        }
        begin_[256] = std::uint32_t(w_.size());
        reach_.resize(w_.size());
        for (std::size_t i = 0; i < w_.size(); ++i)
            reach_[i] = kSteepest * footprint_.at(w_[i]);
    }

    /// From this pixel to the end of the row, or of the map's tile; how many pixels.
    std::uint32_t gatherRow(std::uint32_t column, std::uint32_t row) {
        const std::uint32_t size = map_.info().tileSize;
        const std::uint32_t x = corner_.x + column, y = corner_.y + row;
        const Tile& tile = map_.tile(face_, x / size, y / size);
        const std::uint32_t width = map_.tileWidth(x / size);
        const std::uint32_t pixels = std::min(kTexels - column, width - x % size);
        std::uint32_t* begin = &begin_[row * kTexels + column];
        if (tile.empty()) {
            std::fill_n(begin, pixels, std::uint32_t(w_.size()));
            return pixels;
        }
        const std::uint32_t* from = &tile.begin[std::size_t(y % size) * width + x % size];
        const auto first = std::uint32_t(w_.size());
        for (std::uint32_t i = 0; i < pixels; ++i)
            begin[i] = first + from[i] - from[0];
        const std::uint32_t count = from[pixels] - from[0];
        w_.resize(first + count);
        const float* z = tile.z.data() + from[0];
        float* w = w_.data() + first;
        for (std::uint32_t i = 0; i < count; ++i)
            w[i] = perspective_ ? std::min(1.0f / z[i], 1e30f) : -z[i];
        return pixels;
    }

    std::uint32_t root(std::uint32_t i) {
        while (parent_[i] != i)
            i = parent_[i] = parent_[parent_[i]];
        return i;
    }

    /// Joins the samples of two neighbouring pixels, each to the nearest one of the other
    /// pixel that is not yet taken. Both lists run from near to far: w falls.
    void join(std::uint32_t p, std::uint32_t q) {
        std::uint32_t j = begin_[q];
        const std::uint32_t end = begin_[q + 1];
        for (std::uint32_t i = begin_[p]; i < begin_[p + 1] && j < end; ++i) {
            const float w = w_[i];
            float away = std::abs(w_[j] - w);
            for (; j + 1 < end; ++j) {
                const float next = std::abs(w_[j + 1] - w);
                if (next > away) break;
                away = next;
            }
            if (away > reach_[i]) continue;
            if (label_[i] == kNone)
                label_[i] = label_[j];
            else if (label_[i] != label_[j])
                parent_[root(label_[i])] = root(label_[j]);
            ++j;
        }
    }

    /// Labels the samples; those whose labels have one root are connected.
    void connect() {
        label_.assign(w_.size(), kNone);
        parent_.clear();
        for (std::uint32_t p = 0; p < 256; ++p) {
            if (begin_[p] == begin_[p + 1]) continue;
            if (p % kTexels > 0) join(p, p - 1);
            if (p >= kTexels) join(p, p - kTexels);
            for (std::uint32_t i = begin_[p]; i < begin_[p + 1]; ++i) {
                if (label_[i] != kNone) continue;
                label_[i] = std::uint32_t(parent_.size());
                parent_.push_back(label_[i]);
            }
        }
    }

    /// Orders the samples by piece. A piece has one sample of a pixel: of those that are
    /// connected all the same, the second makes another piece, and so on.
    void separate() {
        for (std::uint32_t label = 0; label < parent_.size(); ++label)
            parent_[label] = root(label);
        last_.assign(parent_.size(), {});
        further_.clear();
        pieceBegin_.assign(1, 0);
        for (std::uint32_t p = 0; p < 256; ++p) {
            for (std::uint32_t i = begin_[p]; i < begin_[p + 1]; ++i) {
                Connected& c = last_[parent_[label_[i]]];
                std::uint32_t& piece = c.pixel == p ? further_[c.piece] : c.first;
                if (piece == kNone) {
                    piece = std::uint32_t(further_.size());
                    label_[i] = c.piece = piece;
                    further_.push_back(kNone);
                    pieceBegin_.push_back(0);
                } else {
                    label_[i] = c.piece = piece;
                }
                c.pixel = p;
                ++pieceBegin_[label_[i] + 1];
            }
        }
        for (std::size_t piece = 1; piece < pieceBegin_.size(); ++piece)
            pieceBegin_[piece] += pieceBegin_[piece - 1];
        ordered_.resize(w_.size());
        next_.assign(pieceBegin_.begin(), pieceBegin_.end() - 1);
        for (std::uint32_t p = 0; p < 256; ++p) {
            for (std::uint32_t i = begin_[p]; i < begin_[p + 1]; ++i)
                ordered_[next_[label_[i]]++] = {std::uint8_t(p % kTexels),
                                                std::uint8_t(p / kTexels), w_[i]};
        }
    }

    /// A patch of these samples; if it is not flat, its quarters, or its bumps.
    Node emit(std::span<const Sample> samples, Square square, Slope likely,
              Parts& parts) {
        Node node = flatNode(samples, likely);
        const bool flat = node.residual <= flatness_ * footprint_.at(node.plane.w);
        if (!flat && square.size == BumpPlane::kSide) {
            roundBounds(node);
            addBumps(samples, square, node, parts);
            return node;
        }
        if (!flat) {
            std::array<Node, 4> quarters;
            const std::size_t count =
                divide(samples, square, {node.plane.gradientU, node.plane.gradientV},
                       quarters, parts);
            if (count == 1) return quarters[0];
            for (std::size_t q = 0; q < count; ++q)
                node.residual =
                    std::max(node.residual, mismatch(node.plane, quarters[q]));
            for (std::size_t q = 0; q < count; ++q) {  // they may be steeper
                node.low = std::min(node.low, quarters[q].low);
                node.high = std::max(node.high, quarters[q].high);
            }
            node.children = parts.children.append(
                count, [&](std::size_t i) -> const Node& { return quarters[i]; });
        }
        roundBounds(node);
        addCover(samples, node, parts);
        return node;
    }

    /// Patches of the quarters of a square; how many.
    std::size_t divide(std::span<const Sample> samples, Square square, Slope likely,
                       std::array<Node, 4>& quarters, Parts& parts) {
        const int half = square.size / 2;
        Sample left[256], right[256];
        std::size_t count = 0;
        auto next = samples.begin();
        for (const int lower : {0, 1}) {  // samples are in the order of rows
            const int end = square.y + half + lower * half;
            std::size_t lefts = 0, rights = 0;
            for (; next != samples.end() && next->y < end; ++next) {
                const bool isRight = next->x >= square.x + half;
                left[lefts] = right[rights] = *next;
                lefts += !isRight, rights += isRight;
            }
            const int y = end - half;
            if (lefts > 0)
                quarters[count++] =
                    emit({left, lefts}, {square.x, y, half}, likely, parts);
            if (rights > 0)
                quarters[count++] =
                    emit({right, rights}, {square.x + half, y, half}, likely, parts);
        }
        return count;
    }

    static void addBits(std::span<const Sample> samples, std::uint16_t* rows) {
        for (const Sample& s : samples)
            rows[s.y] |= std::uint16_t(1u << s.x);
    }

    void addCover(std::span<const Sample> samples, Node& node, Parts& parts) const {
        const std::uint32_t u0 = std::uint32_t(node.box.u0) - corner_.x;
        const std::uint32_t u1 = std::uint32_t(node.box.u1) - corner_.x;
        if (node.sheet) {
            node.cover = fullCover(u0, u1);
            return;
        }
        std::array<std::uint16_t, kTexels> rows{};
        addBits(samples, rows.data());
        node.cover = kFullRows + std::uint32_t(parts.covers.size());
        parts.covers.insert(parts.covers.end(),
                            rows.begin() + (std::ptrdiff_t(node.box.v0) - corner_.y),
                            rows.begin() + (std::ptrdiff_t(node.box.v1) - corner_.y));
    }

    void addBumps(std::span<const Sample> samples, Square square, Node& node,
                  Parts& parts) const {
        node.bumpy = true;
        node.cover = kFullRows + std::uint32_t(parts.covers.size());
        BumpPlane bumps;
        std::fill(std::begin(bumps.offset), std::end(bumps.offset), BumpPlane::kNone);
        for (const Sample& s : samples) {
            const double away = s.w - node.plane.at(u_[s.x], v_[s.y]);
            const double steps = away / node.residual * BumpPlane::kSteps;
            bumps.offset[(s.y - square.y) * BumpPlane::kSide + s.x - square.x] =
                roundSteps(steps);
        }
        const auto rows = std::bit_cast<std::array<std::uint16_t, 16>>(bumps);
        parts.covers.insert(parts.covers.end(), rows.begin(), rows.end());
    }

    /// To the nearest, halves away from 0. (std::lround is a call.)
    static std::int16_t roundSteps(double steps) {
        steps = std::clamp(steps, -double(BumpPlane::kSteps), double(BumpPlane::kSteps));
        return std::int16_t(steps + (steps < 0 ? -0.5 : 0.5));
    }

    /// One per pixel, in one tile.
    [[nodiscard]] Moments momentsOf(std::span<const Sample> samples) const {
        std::uint32_t x = 0, y = 0, xx = 0, xy = 0, yy = 0;
        Moments m;
        for (const Sample& s : samples) {
            x += s.x, y += s.y, xx += s.x * s.x, xy += s.x * s.y, yy += s.y * s.y;
            m.w += s.w, m.uw += u_[s.x] * s.w, m.vw += v_[s.y] * s.w;
        }
        // Of places all sums are exact.
        const double n = double(samples.size()), u = u_[0], v = v_[0];
        m.n = n, m.u = n * u + x, m.v = n * v + y;
        m.uu = n * u * u + 2 * u * x + xx;
        m.uv = n * u * v + u * y + v * x + xy;
        m.vv = n * v * v + 2 * v * y + yy;
        return m;
    }

    [[nodiscard]] Node flatNode(std::span<const Sample> samples, Slope likely) const {
        Node node;
        std::uint32_t columns = 0;
        for (const Sample& s : samples)
            columns |= 1u << s.x;
        const auto x0 = std::uint32_t(std::countr_zero(columns));
        const auto x1 = std::uint32_t(std::bit_width(columns));
        const std::uint32_t y0 = samples.front().y, y1 = samples.back().y + 1u;
        node.box = {float(corner_.x + x0), float(corner_.y + y0), float(corner_.x + x1),
                    float(corner_.y + y1)};
        node.sheet = samples.size() == std::size_t(x1 - x0) * (y1 - y0);
        node.moments = momentsOf(samples);
        node.plane = fit(node.moments, likely,
                         kSteepest * footprint_.at(node.moments.w / node.moments.n));
        node.centre();
        float low = HUGE_VALF, high = -HUGE_VALF;
        for (const Sample& s : samples) {
            const double on = node.plane.at(u_[s.x], v_[s.y]);
            node.residual = std::max(node.residual, std::abs(float(s.w - on)));
            low = std::min(low, std::min(s.w, float(on)));
            high = std::max(high, std::max(s.w, float(on)));
        }
        const auto reach = float(
            0.5 * (std::abs(node.plane.gradientU) + std::abs(node.plane.gradientV)));
        node.low = low - reach;
        node.high = high + reach;
        return node;
    }

    /// Samples that are connected: the piece that one of a pixel is in, and of the last
    /// one that was seen the pixel and the piece.
    struct Connected {
        std::uint32_t first = kNone, pixel = kNone, piece = kNone;
    };
    struct Corner {
        std::uint32_t x = 0, y = 0;
    };

    const ShadowMap& map_;
    std::uint32_t face_;
    Footprint footprint_;
    float flatness_;
    bool perspective_ = true;
    Corner corner_;
    std::array<double, kTexels> u_{}, v_{};  // centres of pixels
    std::vector<float> w_, reach_;  // of samples, by pixel: how far neighbours may be
    std::array<std::uint32_t, 257> begin_{};  // of each pixel's
    std::vector<std::uint32_t> label_;        // then the piece
    std::vector<Sample> ordered_;             // by piece
    std::vector<std::uint32_t> parent_, pieceBegin_, next_;
    std::vector<std::uint32_t> further_;  // of a piece: the next one of its samples
    std::vector<Connected> last_;
};

// --- coarser levels
// ------------------------------------------------------------------------

/// Pieces of the four tiles below that become one. Members are linked
/// (Coarsening::next_).
struct Cluster {
    Plane plane;
    Moments moments;
    std::uint32_t first, last, members;
};

/// Of a texel of 16 x 16, what a share must exceed to count as the next sixteenth: the
/// bits of x ^ y and y, reversed and interleaved, so that neighbours differ most.
constexpr std::array<double, 256> kDither = [] {
    std::array<double, 256> thresholds{};
    for (std::uint32_t i = 0; i < 256; ++i) {
        const std::uint32_t x = i & 15, y = i >> 4;
        std::uint32_t rank = 0;
        for (int bit = 0; bit < 4; ++bit) {
            rank |= ((x ^ y) >> bit & 1) << (7 - 2 * bit);
            rank |= (y >> bit & 1) << (6 - 2 * bit);
        }
        thresholds[i] = (rank + 0.5) / 256.0;
    }
    return thresholds;
}();

/// Nodes of two neighbouring tiles, and their masks.
struct TilePair {
    const Node* nodes = nullptr;
    std::size_t count = 0;
    const PixelMask* masks = nullptr;
};

/// Makes tiles of a level of those of the level below.
class Coarsening {
  public:
    Coarsening(std::uint8_t level, std::uint32_t sideBelow, Footprint footprint)
        : level_(level), footprint_(footprint), side_(2 * sideBelow) {
        maskAt_.assign(std::size_t(side_ / kTexels) * (side_ / kTexels), kNone);
    }

    /// Appends the nodes of tile (x, y); `below`: the upper and the lower two tiles.
    void run(std::uint32_t x, std::uint32_t y, const std::array<TilePair, 2>& below,
             Nodes& made, Parts& parts) {
        corner_ = {x * side_, y * side_};
        nodes_.clear(), masks_.clear();
        for (const TilePair& pair : below) {
            const PixelMask* masks = pair.masks;
            for (std::size_t i = 0; i < pair.count; ++i) {
                nodes_.push_back(pair.nodes + i);
                masks_.push_back(masks);
                masks += pair.nodes[i].masks;
            }
        }
        startClusters();
        for (const float tolerance : kTolerances)
            gatherClusters(tolerance * float(side_ / kTexels));
        for (const Cluster& c : clusters_)
            finish(c, made, parts);
    }

  private:
    static constexpr std::uint32_t kNone = 0xffffffffu;

    /// One for each node. Large ones first: they say where the surfaces are.
    void startClusters() {
        order_.clear();
        const auto sizeOf = [&](std::uint32_t i) { return nodes_[i]->moments.n; };
        for (std::uint32_t i = 0; i < nodes_.size(); ++i) {
            if (sizeOf(i) > 1) order_.push_back(i);
        }
        std::sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
            return sizeOf(a) != sizeOf(b) ? sizeOf(a) > sizeOf(b) : a < b;
        });
        for (std::uint32_t i = 0; i < nodes_.size(); ++i) {
            if (sizeOf(i) == 1) order_.push_back(i);
        }
        next_.assign(nodes_.size(), kNone);
        clusters_.clear();
        for (std::vector<float>* v : {&planeW_, &planeU_, &planeV_, &slack_})
            v->resize(nodes_.size());
        near_.resize(nodes_.size() + 8);
        for (const std::uint32_t i : order_)
            clusters_.push_back({nodes_[i]->plane, nodes_[i]->moments, i, i, 1});
    }

    /// Adds the members of each to the one before it that it fits best, if within so many
    /// pixel footprints.
    void gatherClusters(float tolerance) {
        std::size_t made = 0;
        for (std::size_t i = 0; i < clusters_.size(); ++i) {
            const Cluster& c = clusters_[i];
            const double w = c.moments.w / c.moments.n;
            const std::size_t best = findBest(c, made, tolerance * footprint_.at(w));
            if (best == made)
                clusters_[made++] = c;
            else
                join(clusters_[best], c);
            setPlane(best);
        }
        clusters_.resize(made);
    }

    /// Of the first `made`; `made` if it fits none within `least`.
    [[nodiscard]] std::size_t findBest(const Cluster& c, std::size_t made, float least) {
        const double u = c.moments.u / c.moments.n, v = c.moments.v / c.moments.n;
        const double w = c.moments.w / c.moments.n;
        findNear(float(u - corner_.x), float(v - corner_.y), float(w), least, made);
        std::size_t best = made;
        for (const std::uint32_t k : candidates_) {
            const Cluster& other = clusters_[k];
            if (std::abs(other.plane.at(u, v) - w) > least) continue;
            if (other.members + c.members > kMostMembers) continue;
            float distance = 0;
            for (std::uint32_t i = c.first; i != kNone && distance <= least; i = next_[i])
                distance = std::max(distance, mismatch(other.plane, *nodes_[i]));
            if (distance <= least) {
                least = distance;
                best = k;
            }
        }
        return best;
    }

    /// Candidates: of the first `made` those whose planes may be so near to a place. A
    /// quick look, that takes too many rather than too few.
    void findNear(float u, float v, float w, float least, std::size_t made) {
        const float *at = planeW_.data(), *perU = planeU_.data(), *perV = planeV_.data();
        const float* slack = slack_.data();
        std::uint8_t* near = near_.data();
        const float most = least + 0x1p-20f * std::abs(w);
        for (std::size_t k = 0; k < made; ++k) {
            const float away = std::abs(at[k] + perU[k] * u + perV[k] * v - w);
            near[k] = !(away - slack[k] > most);
        }
        std::fill_n(near + made, 8, std::uint8_t(0));
        candidates_.resize(made + 8);
        std::size_t count = 0;
        for (std::size_t k = 0; k < made; k += 8) {
            std::uint64_t eight;
            std::memcpy(&eight, near + k, sizeof eight);
            if (eight == 0) continue;
            for (std::size_t i = k; i < k + 8; ++i) {
                candidates_[count] = std::uint32_t(i);
                count += near[i];
            }
        }
        candidates_.resize(count);
    }

    /// Its plane as findNear has it.
    void setPlane(std::size_t k) {
        const Plane& p = clusters_[k].plane;
        planeW_[k] = float(p.at(corner_.x, corner_.y));
        planeU_[k] = float(p.gradientU), planeV_[k] = float(p.gradientV);
        slack_[k] =
            0x1p-20f * (std::abs(planeW_[k]) +
                        float(side_) * (std::abs(planeU_[k]) + std::abs(planeV_[k])));
    }

    void join(Cluster& to, const Cluster& c) {
        to.moments.add(c.moments);
        next_[to.last] = c.first;
        to.last = c.last;
        to.members += c.members;
        to.plane =
            fit(to.moments, {}, kSteepest * footprint_.at(to.moments.w / to.moments.n));
    }

    void finish(const Cluster& c, Nodes& made, Parts& parts) {
        members_.clear();
        for (std::uint32_t i = c.first; i != kNone; i = next_[i])
            members_.push_back(i);
        std::sort(members_.begin(), members_.end());
        Node node;
        node.level = level_;
        node.moments = c.moments;
        node.plane = c.plane;
        node.box = nodes_[members_[0]]->box;
        node.low = HUGE_VALF, node.high = -HUGE_VALF;
        for (const std::uint32_t i : members_) {
            const Node& n = *nodes_[i];
            node.box.include(n.box);
            node.low = std::min(node.low, n.low);
            node.high = std::max(node.high, n.high);
            node.residual = std::max(node.residual, mismatch(c.plane, n));
        }
        node.centre();
        node.children = parts.children.append(
            members_.size(),
            [&](std::size_t i) -> const Node& { return *nodes_[members_[i]]; });
        node.sheet = isSheet(node);
        const std::size_t firstMask = made.masks.size();
        uniteMasks(made.masks);
        node.masks = std::uint32_t(made.masks.size() - firstMask);
        addCover(node, {&made.masks[firstMask], node.masks}, parts);
        roundBounds(node);
        made.nodes.push_back(node);
    }

    /// Appends the members' masks, those of one tile united.
    void uniteMasks(std::vector<PixelMask>& masks) {
        const std::size_t first = masks.size();
        for (const std::uint32_t member : members_) {
            for (std::uint32_t k = 0; k < nodes_[member]->masks; ++k) {
                const PixelMask& mask = masks_[member][k];
                std::uint32_t& at = maskAt_[placeOf(mask)];
                if (at == kNone) {
                    at = std::uint32_t(masks.size());
                    masks.push_back(mask);
                } else {
                    unite(masks[at], mask);
                }
            }
        }
        for (std::size_t i = first; i < masks.size(); ++i)
            maskAt_[placeOf(masks[i])] = kNone;
    }

    static void unite(PixelMask& to, const PixelMask& from) {
        to.covered = 0;
        for (int row = 0; row < kTexels; ++row) {
            to.row[row] |= from.row[row];
            to.covered = std::uint16_t(to.covered + ones(to.row[row]));
        }
    }

    [[nodiscard]] std::size_t placeOf(const PixelMask& mask) const {
        const std::size_t x = mask.x - corner_.x / kTexels;
        const std::size_t y = mask.y - corner_.y / kTexels;
        return y * (side_ / kTexels) + x;
    }

    /// Do sheets of all quarters that the box reaches into meet at their borders?
    [[nodiscard]] bool isSheet(const Node& node) const {
        if (members_.size() > 4) return false;
        float area = 0;
        for (const std::uint32_t i : members_) {
            const Node& n = *nodes_[i];
            if (!n.sheet) return false;
            area += n.box.area();
        }
        if (area != node.box.area()) return false;
        for (const std::uint32_t i : members_) {
            for (const std::uint32_t j : members_) {
                // One of each tile: areas alone do not say that none lies over another.
                if (i < j && (tileOf(*nodes_[i]) == tileOf(*nodes_[j]) ||
                              !meet(*nodes_[i], *nodes_[j])))
                    return false;
            }
        }
        return true;
    }

    [[nodiscard]] std::pair<std::uint32_t, std::uint32_t> tileOf(const Node& n) const {
        const std::uint32_t side = side_ / 2;
        return {std::uint32_t(n.box.u0) / side, std::uint32_t(n.box.v0) / side};
    }

    [[nodiscard]] bool meet(const Node& a, const Node& b) const {
        const float u0 = std::max(a.box.u0, b.box.u0), u1 = std::min(a.box.u1, b.box.u1);
        const float v0 = std::max(a.box.v0, b.box.v0), v1 = std::min(a.box.v1, b.box.v1);
        const float most =
            kSteepest * footprint_.at(a.plane.w) + 0.5f * (a.residual + b.residual);
        return std::abs(a.plane.at(u0, v0) - b.plane.at(u0, v0)) <= most &&
               std::abs(a.plane.at(u1, v1) - b.plane.at(u1, v1)) <= most;
    }

    void addCover(Node& node, std::span<const PixelMask> masks, Parts& parts) {
        const std::uint32_t texel = side_ / kTexels, full = texel * texel;
        const std::uint32_t u0 = (std::uint32_t(node.box.u0) - corner_.x) / texel;
        const std::uint32_t v0 = (std::uint32_t(node.box.v0) - corner_.y) / texel;
        const std::uint32_t u1 =
            (std::uint32_t(node.box.u1) - corner_.x + texel - 1) / texel;
        const std::uint32_t v1 =
            (std::uint32_t(node.box.v1) - corner_.y + texel - 1) / texel;
        std::array<std::uint32_t, 256> counts{};
        for (const PixelMask& mask : masks)
            count(mask, counts);
        std::uint16_t planes[4][kTexels];
        bool fills = true;
        for (std::uint32_t y = v0; y < v1; ++y) {
            std::uint32_t shares[4] = {}, covered = 0;
            for (std::uint32_t x = u0; x < u1; ++x) {
                const std::uint32_t i = y * kTexels + x;
                if (counts[i] != full) fills = false;
                if (counts[i] == 0) continue;
                if (counts[i] < full) node.shared = true;
                covered |= 1u << x;
                const std::uint32_t share = sixteenths(counts[i], full, i);
                for (int k = 0; k < 4; ++k)
                    shares[k] |= (share >> k & 1) << x;
            }
            for (int k = 0; k < 4; ++k)
                planes[k][y] = std::uint16_t(shares[k]);
            if (covered == 0) continue;
            // Of a plane's depths in a row the first and the last are the extremes.
            includeTexel(node, std::uint32_t(std::countr_zero(covered)), y);
            includeTexel(node, std::uint32_t(std::bit_width(covered)) - 1, y);
        }
        if (fills) {
            node.cover = fullCover(u0, u1);
            return;
        }
        node.cover = kFullRows + std::uint32_t(parts.covers.size());
        for (int k = 0; k < (node.shared ? 4 : 1); ++k)
            parts.covers.insert(parts.covers.end(), planes[k] + v0, planes[k] + v1);
    }

    /// Rays meet the plane there.
    void includeTexel(Node& node, std::uint32_t column, std::uint32_t row) const {
        const Plane& plane = node.plane;
        const std::uint32_t texel = side_ / kTexels;
        const double half = 0.5 * texel;
        const double reach =
            half * (std::abs(plane.gradientU) + std::abs(plane.gradientV));
        const double w =
            plane.at(corner_.x + column * texel + half, corner_.y + row * texel + half);
        node.low = std::min(node.low, float(w - reach));
        node.high = std::max(node.high, float(w + reach));
    }

    /// Bits of 16 that are set: std::popcount is a call where processors may lack it.
    static std::uint32_t ones(std::uint32_t bits) {
        bits -= bits >> 1 & 0x5555;
        bits = (bits & 0x3333) + (bits >> 2 & 0x3333);
        bits = (bits + (bits >> 4)) & 0x0f0f;
        return (bits + (bits >> 8)) & 31;
    }

    /// Adds the covered pixels of each texel.
    void count(const PixelMask& mask, std::array<std::uint32_t, 256>& counts) const {
        const std::uint32_t texel = side_ / kTexels;
        const std::uint32_t x = (mask.x * kTexels - corner_.x) / texel;
        const std::uint32_t y = (mask.y * kTexels - corner_.y) / texel;
        std::uint32_t* to = &counts[y * kTexels + x];
        if (texel >= kTexels) {
            *to += mask.covered;
            return;
        }
        for (std::uint32_t row = 0; row < kTexels; row += texel, to += kTexels)
            countRow(mask.row + row, texel, to);
    }

    /// Of a row of texels.
    static void countRow(const std::uint16_t* rows, std::uint32_t texel,
                         std::uint32_t* to) {
        // Sums of neighbouring texels are kept apart: one of a pair in each half.
        std::uint32_t even = 0, odd = 0;
        const std::uint32_t mask = texel == 2 ? 0x3333 : texel == 4 ? 0x0f0f : 0x00ff;
        for (std::uint32_t row = 0; row < texel; ++row) {
            std::uint32_t bits = rows[row];
            bits -= bits >> 1 & 0x5555;
            if (texel > 2) bits = (bits & 0x3333) + (bits >> 2 & 0x3333);
            if (texel > 4) bits = (bits + (bits >> 4)) & 0x0f0f;
            even += bits & mask;
            odd += bits >> texel & mask;
        }
        for (std::uint32_t i = 0; i < kTexels / texel; i += 2) {
            const std::uint32_t field = (1u << 2 * texel) - 1;
            to[i] += even >> (i * texel) & field;
            to[i + 1] += odd >> (i * texel) & field;
        }
    }

    /// The share in sixteenths by ordered dither; 15 stands for all of it.
    static std::uint32_t sixteenths(std::uint32_t covered, std::uint32_t full,
                                    std::uint32_t place) {
        if (covered == full) return 15;
        const double share = 16.0 * covered / full, threshold = kDither[place];
        if (share < 14.0) return std::uint32_t(share + threshold);
        return share - 14.0 > 2.0 * threshold ? 15 : 14;
    }

    struct Corner {
        std::uint32_t x = 0, y = 0;
    };

    std::uint8_t level_;
    Footprint footprint_;
    std::uint32_t side_;
    Corner corner_;
    // Of the tiles below, and of what is made of them.
    std::vector<const Node*> nodes_;
    std::vector<const PixelMask*> masks_;  // of each node
    std::vector<std::uint32_t> order_;
    std::vector<std::uint32_t> next_;  // member of the same cluster
    std::vector<Cluster> clusters_;
    std::vector<float> planeW_, planeU_, planeV_, slack_;  // of clusters: findNear
    std::vector<std::uint8_t> near_;
    std::vector<std::uint32_t> candidates_;
    std::vector<std::uint32_t> members_;  // of the cluster at hand
    std::vector<std::uint32_t> maskAt_;   // by tile of level 0
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
        const bool single = columns_ == 1 && rows_ == 1;
        if (!single) tree_.levels_.push_back({kTexels, columns_, rows_, {}});
        LevelRows level = single ? pieces() : coarsePieces();
        settle(level, true);
        while (level.columns > 1 || level.rows.size() > 1) {
            level = coarsen(level);
            settle(level, false);
        }
        tree_.lowest_ = HUGE_VALF, tree_.highest_ = -HUGE_VALF;
        for (const Node& n : level.rows[0].all.nodes) {
            tree_.lowest_ = std::min(tree_.lowest_, n.low);
            tree_.highest_ = std::max(tree_.highest_, n.high);
        }
        tree_.margin_ = float(std::max(map_.info().width, map_.info().height)) * 0x1p-19f;
        if (pieces_ > 0) tree_.pieceSize_ = float(double(samples_) / double(pieces_));
        putTogether();
        return std::move(tree_);
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

    /// Finds the places of a level's parts in the tree. `first`: it is the first level to
    /// have any, and groups of children have children and covers of the same row.
    void settle(LevelRows& level, bool first) {
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
        tree_.levels_.push_back(
            {level.side, level.columns, std::uint32_t(level.rows.size()), {}});
        for (TileRow& row : level.rows) {
            std::vector<PatchList>& tiles = tree_.levels_.back().tiles;
            tiles.insert(tiles.end(), row.tiles.begin(), row.tiles.end());
            placed_.push_back({std::move(row.parts), row.firstGroup, row.firstCover});
        }
    }

    void putTogether() {
        const std::vector<std::uint16_t> full = fullRows();
        tree_.groups_.resize(groups_);
        tree_.covers_.resize(full.size() + covers_ + kTexels);  // kernels read further
        std::copy(full.begin(), full.end(), tree_.covers_.begin());
        base::parallelFor(std::size_t(0), placed_.size(), [&](std::size_t i) {
            Placed& p = placed_[i];
            const auto copy = [](const auto& from, auto to) {
                return std::copy(from.begin(), from.end(), to);
            };
            const auto tiles = copy(p.parts.children.all(),
                                    tree_.groups_.begin() + std::ptrdiff_t(p.firstGroup));
            copy(p.parts.tiles.all(), tiles);
            copy(p.parts.covers,
                 tree_.covers_.begin() + std::ptrdiff_t(full.size() + p.firstCover));
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
    PatchTree tree_;
};

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

std::uint64_t PatchTree::memoryBytes() const noexcept {
    std::uint64_t bytes =
        groups_.capacity() * sizeof(PatchGroup) + covers_.capacity() * sizeof(covers_[0]);
    for (const Level& level : levels_)
        bytes += level.tiles.capacity() * sizeof(PatchList);
    return bytes;
}

}  // namespace mtsm::trace
