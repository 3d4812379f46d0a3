// PatchTree::build: samples to pieces of surface, then level by level to coarser ones.
#include "trace/patch_tree.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <new>

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
/// Groups and covers of a tree have numbers of 32 bits; entries of levels still join.
constexpr std::size_t kMostIds = std::size_t(1) << 31;

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
    return {u, v, w, std::clamp(slopeU, -steepest, steepest),
            std::clamp(slopeV, -steepest, steepest)};
}

/// A patch while the tree is made.
struct Node {
    Plane plane;  // through the middle of the box once it is done
    float residual = 0, low = 0, high = 0;
    Box box{};
    Moments moments;
    std::uint32_t children = 0, childGroups = 0, cover = 0;
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

/// Full-resolution coverage of a tile of `side` pixels: rows of side / 16 words.
using Mask = std::vector<std::uint16_t>;

/// What one task makes. Indices of groups and covers count from the task's own first one.
struct Made {
    std::vector<Node> nodes;
    std::vector<std::uint16_t> masks;    // [node][side][side / 16]
    std::vector<std::uint32_t> perTile;  // nodes of each tile
    std::vector<PatchGroup> groups;
    std::vector<CoverPlane> covers;
};

/// All nodes of a level.
struct LevelNodes {
    std::uint32_t side = 0, columns = 0, rows = 0;
    std::vector<Node> nodes;
    std::vector<std::uint16_t> masks;
    std::vector<std::uint32_t> begin;  // [tiles + 1]

    [[nodiscard]] std::size_t maskWords() const {
        return std::size_t(side) * (side / kTexels);
    }
};

constexpr float kNever = -HUGE_VALF;

PatchGroup emptyGroup() {
    PatchGroup g{};
    std::fill_n(g.above, 4, UpperHalf(std::bit_cast<std::uint32_t>(kNever) >> 16));
    return g;
}

/// Texels that are covered in part reach out of the pixels' box.
Box wholeTexels(const Node& node) {
    if (!node.shared) return node.box;
    const auto texel = float(1u << node.level);
    const auto down = [texel](float x) { return std::floor(x / texel) * texel; };
    const auto up = [texel](float x) { return std::ceil(x / texel) * texel; };
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
    g.children[i] = node.children;
    g.childGroups[i] = std::uint8_t(node.childGroups);
    g.cover[i] = node.cover;
    const bool sheet = node.sheet && box.area() == node.box.area();
    g.kind[i] = std::uint8_t(node.level | (node.shared ? PatchGroup::kShared : 0) |
                             (sheet ? PatchGroup::kSheet : 0) |
                             (node.bumpy ? PatchGroup::kBumpy : 0));
}

/// Appends nodes in groups of four; the first group's index.
template <typename NodeAt>
PatchTree::Entry append(std::vector<PatchGroup>& groups, std::size_t count,
                        const NodeAt& nodeAt) {
    const PatchTree::Entry entry{std::uint32_t(groups.size()),
                                 std::uint32_t((count + 3) / 4)};
    for (std::size_t i = 0; i < count; ++i) {
        if (i % 4 == 0) groups.push_back(emptyGroup());
        store(nodeAt(i), groups.back(), int(i % 4));
    }
    return entry;
}

struct Footprint {
    double perW = 0, constant = 0;  // of a pixel, in w
    [[nodiscard]] float at(double w) const {
        return float(perW * std::abs(w) + constant);
    }
};

// --- level 0
// -------------------------------------------------------------------------------

struct Sample {
    std::uint8_t pixel = 0;  // within the tile, row-major
    float w = 0;
};

/// Pieces of surface in one tile of 16 x 16 pixels.
class TilePieces {
  public:
    TilePieces(const ShadowMap& map, std::uint32_t face, Footprint footprint,
               float flatness)
        : map_(map), face_(face), footprint_(footprint), flatness_(flatness) {
        perspective_ = map.projection(face).kind == ProjectionKind::perspective;
    }

    void run(std::uint32_t x, std::uint32_t y, Made& made) {
        u_ = float(x), v_ = float(y);
        gather(x, y);
        const std::size_t before = made.nodes.size();
        if (!samples_.empty()) {
            connect();
            separate();
            for (std::size_t piece = 0; piece + 1 < pieceBegin_.size(); ++piece) {
                const auto first = ordered_.begin() + pieceBegin_[piece];
                const auto last = ordered_.begin() + pieceBegin_[piece + 1];
                const std::vector<Sample> samples(first, last);
                made.nodes.push_back(emit(samples, {0, 0, kTexels}, {}, made));
                std::array<std::uint16_t, kTexels> rows{};
                for (const Sample& s : samples)
                    rows[s.pixel >> 4] |= std::uint16_t(1u << (s.pixel & 15));
                made.masks.insert(made.masks.end(), rows.begin(), rows.end());
            }
        }
        made.perTile.push_back(std::uint32_t(made.nodes.size() - before));
    }

  private:
    struct Square {
        int x, y, size;
    };

    void gather(std::uint32_t x0, std::uint32_t y0) {
        samples_.clear();
        const std::uint32_t width = map_.info().width, height = map_.info().height;
        for (std::uint32_t p = 0; p < 256; ++p) {
            begin_[p] = std::uint32_t(samples_.size());
            const std::uint32_t x = x0 + p % kTexels, y = y0 + p / kTexels;
            if (x >= width || y >= height) continue;
            const PixelLayers pixel = map_.pixel(face_, x, y);
            for (std::uint32_t i = 0; i < pixel.count; ++i)
                samples_.push_back(
                    {std::uint8_t(p),
                     perspective_ ? std::min(1.0f / pixel.z[i], 1e30f) : -pixel.z[i]});
        }
        begin_[256] = std::uint32_t(samples_.size());
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
            const float w = samples_[i].w;
            while (j + 1 < end &&
                   std::abs(samples_[j + 1].w - w) <= std::abs(samples_[j].w - w))
                ++j;
            if (std::abs(samples_[j].w - w) > kSteepest * footprint_.at(w)) continue;
            parent_[root(i)] = root(j);
            ++j;
        }
    }

    void connect() {
        parent_.resize(samples_.size());
        for (std::uint32_t i = 0; i < parent_.size(); ++i)
            parent_[i] = i;
        for (std::uint32_t p = 0; p < 256; ++p) {
            if (begin_[p] == begin_[p + 1]) continue;
            if (p % kTexels > 0) join(p, p - 1);
            if (p >= kTexels) join(p, p - kTexels);
        }
    }

    /// Orders the samples by piece. A piece has one sample of a pixel: of those that are
    /// connected all the same, the second makes another piece, and so on.
    void separate() {
        first_.assign(samples_.size(), kNone);
        seen_.assign(samples_.size(), {kNone, 0});
        std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> further;
        std::vector<std::uint32_t>& pieceOf = pieceOf_;
        pieceOf.resize(samples_.size());
        std::uint32_t pieces = 0;
        for (std::uint32_t i = 0; i < samples_.size(); ++i) {
            const std::uint32_t r = root(i), pixel = samples_[i].pixel;
            auto& [last, rank] = seen_[r];
            rank = last == pixel ? rank + 1 : 0;
            last = pixel;
            if (rank == 0) {
                if (first_[r] == kNone) first_[r] = pieces++;
                pieceOf[i] = first_[r];
            } else {
                const auto [it, isNew] = further.try_emplace({r, rank}, pieces);
                if (isNew) ++pieces;
                pieceOf[i] = it->second;
            }
        }
        pieceBegin_.assign(pieces + 1, 0);
        for (const std::uint32_t piece : pieceOf)
            ++pieceBegin_[piece + 1];
        for (std::uint32_t piece = 0; piece < pieces; ++piece)
            pieceBegin_[piece + 1] += pieceBegin_[piece];
        ordered_.resize(samples_.size());
        std::vector<std::uint32_t> next(pieceBegin_.begin(), pieceBegin_.end() - 1);
        for (std::uint32_t i = 0; i < samples_.size(); ++i)
            ordered_[next[pieceOf[i]]++] = samples_[i];
    }

    /// A patch of these samples; if it is not flat, its quarters, or its bumps.
    Node emit(const std::vector<Sample>& samples, Square square, Slope likely,
              Made& made) {
        Node node = flatNode(samples, likely);
        likely = {node.plane.gradientU, node.plane.gradientV};
        const bool flat = node.residual <= flatness_ * footprint_.at(node.plane.w);
        if (!flat && square.size == BumpPlane::kSide) {
            roundBounds(node);
            addBumps(samples, square, node, made);
            return node;
        }
        if (!flat) {
            std::vector<Node> quarters;
            const int half = square.size / 2;
            std::array<std::vector<Sample>, 4> inside;
            for (const Sample& s : samples) {
                const bool right = (s.pixel & 15) >= square.x + half;
                const bool lower = (s.pixel >> 4) >= square.y + half;
                inside[right + 2 * lower].push_back(s);
            }
            for (int q = 0; q < 4; ++q) {
                const Square part{square.x + (q & 1) * half, square.y + (q >> 1) * half,
                                  half};
                if (!inside[q].empty())
                    quarters.push_back(emit(inside[q], part, likely, made));
            }
            if (quarters.size() == 1) return quarters[0];
            for (const Node& quarter : quarters)
                node.residual = std::max(node.residual, mismatch(node.plane, quarter));
            for (const Node& quarter : quarters) {  // they may be steeper
                node.low = std::min(node.low, quarter.low);
                node.high = std::max(node.high, quarter.high);
            }
            const PatchTree::Entry children =
                append(made.groups, quarters.size(),
                       [&](std::size_t i) -> const Node& { return quarters[i]; });
            node.children = children.group;
            node.childGroups = children.groups;
        }
        roundBounds(node);
        node.cover = std::uint32_t(made.covers.size());
        CoverPlane plane{};
        for (const Sample& s : samples)
            plane.row[s.pixel >> 4] |= std::uint16_t(1u << (s.pixel & 15));
        made.covers.push_back(plane);
        return node;
    }

    void addBumps(const std::vector<Sample>& samples, Square square, Node& node,
                  Made& made) const {
        node.bumpy = true;
        node.cover = std::uint32_t(made.covers.size());
        BumpPlane bumps;
        std::fill(std::begin(bumps.offset), std::end(bumps.offset), BumpPlane::kNone);
        for (const Sample& s : samples) {
            const int x = s.pixel & 15, y = s.pixel >> 4;
            const double away = s.w - node.plane.at(u_ + x + 0.5, v_ + y + 0.5);
            const double steps = away / node.residual * BumpPlane::kSteps;
            bumps.offset[(y - square.y) * BumpPlane::kSide + x - square.x] =
                std::int16_t(std::lround(std::clamp(steps, -double(BumpPlane::kSteps),
                                                    double(BumpPlane::kSteps))));
        }
        made.covers.push_back(std::bit_cast<CoverPlane>(bumps));
    }

    [[nodiscard]] Node flatNode(const std::vector<Sample>& samples, Slope likely) const {
        Node node;
        int x0 = 16, y0 = 16, x1 = 0, y1 = 0;
        float low = HUGE_VALF, high = -HUGE_VALF;
        for (const Sample& s : samples) {
            const int x = s.pixel & 15, y = s.pixel >> 4;
            node.moments.add(u_ + x + 0.5, v_ + y + 0.5, s.w);
            x0 = std::min(x0, x), y0 = std::min(y0, y);
            x1 = std::max(x1, x + 1), y1 = std::max(y1, y + 1);
        }
        node.box = {u_ + x0, v_ + y0, u_ + x1, v_ + y1};
        node.plane = fit(node.moments, likely,
                         kSteepest * footprint_.at(node.moments.w / node.moments.n));
        node.centre();
        for (const Sample& s : samples) {
            const double on =
                node.plane.at(u_ + (s.pixel & 15) + 0.5, v_ + (s.pixel >> 4) + 0.5);
            node.residual = std::max(node.residual, std::abs(float(s.w - on)));
            low = std::min({low, s.w, float(on)}),
            high = std::max({high, s.w, float(on)});
        }
        const auto reach = float(
            0.5 * (std::abs(node.plane.gradientU) + std::abs(node.plane.gradientV)));
        node.low = low - reach;
        node.high = high + reach;
        node.sheet = samples.size() == std::size_t(x1 - x0) * std::size_t(y1 - y0);
        return node;
    }

    static constexpr std::uint32_t kNone = 0xffffffffu;
    const ShadowMap& map_;
    std::uint32_t face_;
    Footprint footprint_;
    float flatness_;
    bool perspective_ = true;
    float u_ = 0, v_ = 0;
    std::vector<Sample> samples_, ordered_;
    std::array<std::uint32_t, 257> begin_{};
    std::vector<std::uint32_t> parent_, first_, pieceOf_, pieceBegin_;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> seen_;
};

// --- coarser levels
// ------------------------------------------------------------------------

/// Pieces of the four tiles below that become one.
struct Cluster {
    Plane plane;
    Moments moments;
    float residual = 0;  // a bound, while it grows
    std::vector<std::uint32_t> members;
};

/// Adds the members of each of `from` to the one that it fits best, if within tolerance.
void gatherClusters(const LevelNodes& below, std::vector<Cluster>& from, float texel,
                    float tolerance, Footprint footprint) {
    std::vector<Cluster> made;
    for (Cluster& c : from) {
        const double w = c.moments.w / c.moments.n;
        const float most = tolerance * texel * footprint.at(w);
        Cluster* best = nullptr;
        float least = most;
        for (Cluster& other : made) {
            // A quick look at the middle first.
            const double u = c.moments.u / c.moments.n, v = c.moments.v / c.moments.n;
            if (std::abs(other.plane.at(u, v) - w) > least) continue;
            if (other.members.size() + c.members.size() > kMostMembers) continue;
            float distance = 0;
            for (const std::uint32_t member : c.members)
                distance = std::max(distance, mismatch(other.plane, below.nodes[member]));
            if (distance <= least) {
                least = distance;
                best = &other;
            }
        }
        if (!best) {
            made.push_back(std::move(c));
            continue;
        }
        best->moments.add(c.moments);
        best->members.insert(best->members.end(), c.members.begin(), c.members.end());
        best->plane = fit(best->moments, {},
                          kSteepest * footprint.at(best->moments.w / best->moments.n));
    }
    from = std::move(made);
}

class Coarsening {
  public:
    Coarsening(const LevelNodes& below, std::uint8_t level, Footprint footprint)
        : below_(below), level_(level), footprint_(footprint), side_(2 * below.side) {}

    /// Tile (x, y) of the coarser level.
    void run(std::uint32_t x, std::uint32_t y, Made& made) {
        const std::size_t before = made.nodes.size();
        std::vector<std::uint32_t> order;
        for (std::uint32_t q = 0; q < 4; ++q) {
            const std::uint32_t tx = 2 * x + (q & 1), ty = 2 * y + (q >> 1);
            if (tx >= below_.columns || ty >= below_.rows) continue;
            const std::size_t tile = std::size_t(ty) * below_.columns + tx;
            for (std::uint32_t i = below_.begin[tile]; i < below_.begin[tile + 1]; ++i)
                order.push_back(i);
        }
        // Large ones first: they say where the surfaces are.
        std::stable_sort(order.begin(), order.end(),
                         [&](std::uint32_t a, std::uint32_t b) {
                             return below_.nodes[a].moments.n > below_.nodes[b].moments.n;
                         });
        std::vector<Cluster> clusters;
        clusters.reserve(order.size());
        for (const std::uint32_t i : order) {
            const Node& n = below_.nodes[i];
            clusters.push_back({n.plane, n.moments, n.residual, {i}});
        }
        for (const float tolerance : kTolerances)
            gatherClusters(below_, clusters, float(side_ / kTexels), tolerance,
                           footprint_);
        for (Cluster& c : clusters)
            finish(c, x * side_, y * side_, made);
        made.perTile.push_back(std::uint32_t(made.nodes.size() - before));
    }

  private:
    void finish(Cluster& c, std::uint32_t x, std::uint32_t y, Made& made) {
        std::sort(c.members.begin(), c.members.end());
        Node node;
        node.level = level_;
        node.moments = c.moments;
        node.plane = c.plane;
        node.box = below_.nodes[c.members[0]].box;
        node.low = HUGE_VALF, node.high = -HUGE_VALF;
        for (const std::uint32_t i : c.members) {
            const Node& n = below_.nodes[i];
            node.box.include(n.box);
            node.low = std::min(node.low, n.low);
            node.high = std::max(node.high, n.high);
            node.residual = std::max(node.residual, mismatch(c.plane, n));
        }
        node.centre();
        const PatchTree::Entry children = append(
            made.groups, c.members.size(),
            [&](std::size_t i) -> const Node& { return below_.nodes[c.members[i]]; });
        node.children = children.group;
        node.childGroups = children.groups;
        const std::size_t mask = uniteMasks(c, x, y, made);
        node.sheet = isSheet(c, node);
        addCover(node, mask, x, y, made);
        roundBounds(node);
        made.nodes.push_back(node);
    }

    /// Where the union of the members' masks begins.
    std::size_t uniteMasks(const Cluster& c, std::uint32_t x, std::uint32_t y,
                           Made& made) const {
        const std::size_t words = side_ / kTexels, wordsBelow = words / 2;
        const std::size_t mask = made.masks.size();
        made.masks.resize(mask + words * side_, 0);
        for (const std::uint32_t i : c.members) {
            const Box& box = below_.nodes[i].box;
            const bool right = box.u0 >= float(x + below_.side);
            const bool lower = box.v0 >= float(y + below_.side);
            const std::uint16_t* from = &below_.masks[i * below_.maskWords()];
            std::uint16_t* to = &made.masks[mask + (right ? wordsBelow : 0) +
                                            (lower ? below_.side * words : 0)];
            for (std::uint32_t row = 0; row < below_.side; ++row) {
                for (std::size_t k = 0; k < wordsBelow; ++k)
                    to[k] |= from[k];
                from += wordsBelow;
                to += words;
            }
        }
        return mask;
    }

    /// Do sheets of all quarters that the box reaches into meet at their borders?
    [[nodiscard]] bool isSheet(const Cluster& c, const Node& node) const {
        float area = 0;
        for (const std::uint32_t i : c.members) {
            const Node& n = below_.nodes[i];
            if (!n.sheet) return false;
            area += n.box.area();
        }
        // One of each tile: areas alone do not say that none lies over another.
        const auto tileOf = [&](const Node& n) {
            const auto side = float(below_.side);
            return std::pair(std::floor(n.box.u0 / side), std::floor(n.box.v0 / side));
        };
        for (const std::uint32_t i : c.members) {
            for (const std::uint32_t j : c.members) {
                if (i < j && tileOf(below_.nodes[i]) == tileOf(below_.nodes[j]))
                    return false;
            }
        }
        if (c.members.size() > 4 || area != node.box.area()) return false;
        for (const std::uint32_t i : c.members) {
            for (const std::uint32_t j : c.members) {
                if (i < j && !meet(below_.nodes[i], below_.nodes[j])) return false;
            }
        }
        return true;
    }

    [[nodiscard]] bool meet(const Node& a, const Node& b) const {
        const float u0 = std::max(a.box.u0, b.box.u0), u1 = std::min(a.box.u1, b.box.u1);
        const float v0 = std::max(a.box.v0, b.box.v0), v1 = std::min(a.box.v1, b.box.v1);
        const float most =
            kSteepest * footprint_.at(a.plane.w) + 0.5f * (a.residual + b.residual);
        return std::abs(a.plane.at(u0, v0) - b.plane.at(u0, v0)) <= most &&
               std::abs(a.plane.at(u1, v1) - b.plane.at(u1, v1)) <= most;
    }

    void addCover(Node& node, std::size_t mask, std::uint32_t x, std::uint32_t y,
                  Made& made) const {
        const std::uint32_t texel = side_ / kTexels;
        const std::uint16_t* bits = &made.masks[mask];
        std::array<std::uint32_t, 256> counts{};
        const auto column0 = std::uint32_t(node.box.u0 - float(x)) / texel;
        const auto row0 = std::uint32_t(node.box.v0 - float(y)) / texel;
        const auto column1 = (std::uint32_t(node.box.u1 - float(x)) + texel - 1) / texel;
        const auto row1 = (std::uint32_t(node.box.v1 - float(y)) + texel - 1) / texel;
        for (std::uint32_t row = row0; row < row1; ++row) {
            for (std::uint32_t column = column0; column < column1; ++column)
                counts[row * kTexels + column] =
                    count(bits, texel, column * texel, row * texel);
        }
        const std::uint32_t full = texel * texel;
        node.cover = std::uint32_t(made.covers.size());
        CoverPlane planes[4]{};
        for (std::uint32_t i = 0; i < 256; ++i) {
            if (counts[i] == 0) continue;
            if (counts[i] < full) node.shared = true;
            includeTexel(node, x + i % kTexels * texel, y + i / kTexels * texel, texel);
            const std::uint32_t share = sixteenths(counts[i], full, i, x + y);
            for (int k = 0; k < 4; ++k) {
                if (share >> k & 1)
                    planes[k].row[i >> 4] |= std::uint16_t(1u << (i & 15));
            }
        }
        made.covers.insert(made.covers.end(), planes, planes + (node.shared ? 4 : 1));
    }

    /// Rays meet the plane there.
    static void includeTexel(Node& node, std::uint32_t x, std::uint32_t y,
                             std::uint32_t texel) {
        const Plane& plane = node.plane;
        const double half = 0.5 * texel;
        const double reach =
            half * (std::abs(plane.gradientU) + std::abs(plane.gradientV));
        const double w = plane.at(x + half, y + half);
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

    /// Covered pixels of a texel.
    [[nodiscard]] std::uint32_t count(const std::uint16_t* bits, std::uint32_t texel,
                                      std::uint32_t x, std::uint32_t y) const {
        const std::size_t words = side_ / kTexels;
        const std::uint16_t* at = bits + y * words + x / kTexels;
        std::uint32_t n = 0;
        for (std::uint32_t row = 0; row < texel; ++row, at += words) {
            if (texel < kTexels) {
                const std::uint32_t inside = (1u << texel) - 1;
                n += ones((*at >> (x % kTexels)) & inside);
            } else {
                for (std::uint32_t k = 0; k < texel / kTexels; ++k)
                    n += ones(at[k]);
            }
        }
        return n;
    }

    /// The share in sixteenths by ordered dither; 15 stands for all of it.
    static std::uint32_t sixteenths(std::uint32_t covered, std::uint32_t full,
                                    std::uint32_t texel, std::uint32_t turn) {
        if (covered == full) return 15;
        // The bits of x ^ y and y, reversed and interleaved: neighbours differ most.
        const std::uint32_t x = (texel ^ turn) & 15, y = texel >> 4;
        std::uint32_t rank = 0;
        for (int bit = 0; bit < 4; ++bit) {
            rank |= ((x ^ y) >> bit & 1) << (7 - 2 * bit);
            rank |= (y >> bit & 1) << (6 - 2 * bit);
        }
        const double share = 16.0 * covered / full, threshold = (rank + 0.5) / 256.0;
        if (share < 14.0) return std::uint32_t(share + threshold);
        return share - 14.0 > 2.0 * threshold ? 15 : 14;
    }

    const LevelNodes& below_;
    std::uint8_t level_;
    Footprint footprint_;
    std::uint32_t side_;
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
    }

    PatchTree run() {
        LevelNodes nodes = pieces();
        for (std::uint8_t level = 1; nodes.columns > 1 || nodes.rows > 1; ++level) {
            // Of tiles of level 0 there are too many to begin with.
            tree_.levels_.push_back({nodes.side, nodes.columns, nodes.rows, {}});
            if (level > 1) addEntries(nodes);
            nodes = coarsen(nodes, level);
        }
        tree_.levels_.push_back({nodes.side, nodes.columns, nodes.rows, {}});
        addEntries(nodes);
        tree_.lowest_ = HUGE_VALF, tree_.highest_ = -HUGE_VALF;
        for (const Node& n : nodes.nodes) {
            tree_.lowest_ = std::min(tree_.lowest_, n.low);
            tree_.highest_ = std::max(tree_.highest_, n.high);
        }
        tree_.margin_ = float(std::max(map_.info().width, map_.info().height)) * 0x1p-19f;
        tree_.covers_.emplace_back();  // kernels read a little further
        tree_.groups_.shrink_to_fit();
        tree_.covers_.shrink_to_fit();
        return std::move(tree_);
    }

  private:
    LevelNodes pieces() {
        LevelNodes level;
        level.side = kTexels;
        level.columns = (map_.info().width + kTexels - 1) / kTexels;
        level.rows = (map_.info().height + kTexels - 1) / kTexels;
        std::vector<Made> made(level.rows);
        base::parallelFor(0u, level.rows, [&](std::uint32_t row) {
            TilePieces tile(map_, face_, footprint_, options_.flatness);
            for (std::uint32_t column = 0; column < level.columns; ++column)
                tile.run(column * kTexels, row * kTexels, made[row]);
        });
        collect(made, level, true);
        double samples = 0;
        for (const Node& n : level.nodes)
            samples += n.moments.n;
        if (samples > 0) tree_.pieceSize_ = float(samples / double(level.nodes.size()));
        return level;
    }

    LevelNodes coarsen(const LevelNodes& below, std::uint8_t number) {
        LevelNodes level;
        level.side = 2 * below.side;
        level.columns = (below.columns + 1) / 2;
        level.rows = (below.rows + 1) / 2;
        std::vector<Made> made(level.rows);
        base::parallelFor(0u, level.rows, [&](std::uint32_t row) {
            Coarsening coarsening(below, number, footprint_);
            for (std::uint32_t column = 0; column < level.columns; ++column)
                coarsening.run(column, row, made[row]);
        });
        collect(made, level, false);
        return level;
    }

    /// `ownGroups`: the tasks' groups have children among themselves.
    void collect(std::vector<Made>& made, LevelNodes& level, bool ownGroups) {
        level.begin.assign(1, 0);
        std::size_t nodes = 0, masks = 0, groups = tree_.groups_.size(),
                    covers = tree_.covers_.size();
        for (const Made& m : made) {
            nodes += m.nodes.size(), masks += m.masks.size();
            groups += m.groups.size(), covers += m.covers.size();
        }
        level.nodes.reserve(nodes), level.masks.reserve(masks);
        if (ownGroups) tree_.groups_.reserve(groups), tree_.covers_.reserve(covers);
        for (Made& m : made) {
            const auto group = std::uint32_t(tree_.groups_.size());
            const auto cover = std::uint32_t(tree_.covers_.size());
            if (tree_.groups_.size() + m.groups.size() > kMostIds ||
                tree_.covers_.size() + m.covers.size() > kMostIds)
                throw std::bad_alloc();
            for (Node& n : m.nodes) {
                n.cover += cover;
                if (n.childGroups > 0) n.children += group;
            }
            if (ownGroups) {
                for (PatchGroup& g : m.groups) {
                    for (int i = 0; i < 4; ++i) {
                        g.cover[i] += cover;
                        if (g.childGroups[i] > 0) g.children[i] += group;
                    }
                }
            }
            for (const std::uint32_t n : m.perTile)
                level.begin.push_back(level.begin.back() + n);
            const auto append = [](auto& to, const auto& from) {
                to.insert(to.end(), from.begin(), from.end());
            };
            append(level.nodes, m.nodes);
            append(level.masks, m.masks);
            append(tree_.groups_, m.groups);
            append(tree_.covers_, m.covers);
            m = {};
        }
    }

    /// To the last level.
    void addEntries(const LevelNodes& nodes) {
        std::vector<PatchTree::Entry>& tiles = tree_.levels_.back().tiles;
        for (std::size_t tile = 0; tile + 1 < nodes.begin.size(); ++tile) {
            const std::uint32_t first = nodes.begin[tile];
            tiles.push_back(append(
                tree_.groups_, nodes.begin[tile + 1] - first,
                [&](std::size_t i) -> const Node& { return nodes.nodes[first + i]; }));
        }
    }

    const ShadowMap& map_;
    std::uint32_t face_;
    PatchTree::Options options_;
    Footprint footprint_;
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
        groups_.capacity() * sizeof(PatchGroup) + covers_.capacity() * sizeof(CoverPlane);
    for (const Level& level : levels_)
        bytes += level.tiles.capacity() * sizeof(Entry);
    return bytes;
}

}  // namespace mtsm::trace
