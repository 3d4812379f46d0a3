// Coarsening: pieces that lie on one plane become one, and their pixels are counted.
#include "trace/patch_coarsening.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/bits.h"

namespace mtsm::trace::patch_detail {
namespace {

/// Pieces are put together where they lie within so many texel footprints of one plane:
/// the flattest first.
constexpr std::array kTolerances = {1.0f, 4.0f};

/// Members of a coarser patch: its groups are counted in a byte.
constexpr std::size_t kMostMembers = 4 * 255;
/// What places on planes in floats may be off by, for their terms: a few roundings.
constexpr float kRounding = 0x1p-20f;

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
/// What covers more of the half of a texel that is right of a steep line through its
/// middle takes thresholds from above; the line is so steep that seldom a half is met.
constexpr std::uint32_t kRight = 6, kLower = 4;

}  // namespace

Coarsening::Coarsening(std::uint8_t level, std::uint32_t sideBelow, Footprint footprint)
    : level_(level), footprint_(footprint), side_(2 * sideBelow) {
    maskAt_.assign(std::size_t(side_ / kTexels) * (side_ / kTexels), kNone);
}

void Coarsening::run(std::uint32_t x, std::uint32_t y,
                     const std::array<TilePair, 2>& below, Nodes& made, Parts& parts) {
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

void Coarsening::startClusters() {
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
    planes_.resize(nodes_.size());
    candidates_.resize(nodes_.size() + PlaneList::kSpare);
    for (const std::uint32_t i : order_)
        clusters_.push_back({nodes_[i]->plane, nodes_[i]->moments, i, i, 1});
}

void Coarsening::gatherClusters(float tolerance) {
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

std::size_t Coarsening::findBest(const Cluster& c, std::size_t made, float least) {
    const double u = c.moments.u / c.moments.n, v = c.moments.v / c.moments.n;
    const double w = c.moments.w / c.moments.n;
    const std::size_t near =
        findNear(planes_, made, float(u - corner_.x), float(v - corner_.y), float(w),
                 least + kRounding * std::abs(float(w)), candidates_.data());
    std::size_t best = made;
    for (std::size_t i = 0; i < near; ++i) {
        const std::uint32_t k = candidates_[i];
        const Cluster& other = clusters_[k];
        if (std::abs(other.plane.at(u, v) - w) > least) continue;
        if (other.members + c.members > kMostMembers) continue;
        float distance = 0;
        for (std::uint32_t m = c.first; m != kNone && distance <= least; m = next_[m])
            distance = std::max(distance, mismatch(other.plane, *nodes_[m]));
        if (distance <= least) {
            least = distance;
            best = k;
        }
    }
    return best;
}

void Coarsening::setPlane(std::size_t k) {
    const Plane& p = clusters_[k].plane;
    const auto w = float(p.at(corner_.x, corner_.y));
    const auto perU = float(p.gradientU), perV = float(p.gradientV);
    planes_.w[k] = w, planes_.perU[k] = perU, planes_.perV[k] = perV;
    planes_.slack[k] =
        kRounding * (std::abs(w) + float(side_) * (std::abs(perU) + std::abs(perV)));
}

void Coarsening::join(Cluster& to, const Cluster& c) {
    to.moments.add(c.moments);
    next_[to.last] = c.first;
    to.last = c.last;
    to.members += c.members;
    to.plane =
        fit(to.moments, {}, kSteepest * footprint_.at(to.moments.w / to.moments.n));
}

void Coarsening::finish(const Cluster& c, Nodes& made, Parts& parts) {
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

void Coarsening::uniteMasks(std::vector<PixelMask>& masks) {
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

void Coarsening::unite(PixelMask& to, const PixelMask& from) {
    to.covered = 0;
    for (int row = 0; row < kTexels; ++row) {
        to.row[row] |= from.row[row];
        to.covered = std::uint16_t(to.covered + base::countBits(to.row[row]));
    }
}

std::size_t Coarsening::placeOf(const PixelMask& mask) const {
    const std::size_t x = mask.x - corner_.x / kTexels;
    const std::size_t y = mask.y - corner_.y / kTexels;
    return y * (side_ / kTexels) + x;
}

bool Coarsening::isSheet(const Node& node) const {
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

std::pair<std::uint32_t, std::uint32_t> Coarsening::tileOf(const Node& n) const {
    const std::uint32_t side = side_ / 2;
    return {std::uint32_t(n.box.u0) / side, std::uint32_t(n.box.v0) / side};
}

bool Coarsening::meet(const Node& a, const Node& b) const {
    const float u0 = std::max(a.box.u0, b.box.u0), u1 = std::min(a.box.u1, b.box.u1);
    const float v0 = std::max(a.box.v0, b.box.v0), v1 = std::min(a.box.v1, b.box.v1);
    const float most =
        kSteepest * footprint_.at(a.plane.w) + 0.5f * (a.residual + b.residual);
    return std::abs(a.plane.at(u0, v0) - b.plane.at(u0, v0)) <= most &&
           std::abs(a.plane.at(u1, v1) - b.plane.at(u1, v1)) <= most;
}

void Coarsening::addCover(Node& node, std::span<const PixelMask> masks, Parts& parts) {
    const std::uint32_t texel = side_ / kTexels, full = texel * texel;
    const std::uint32_t u0 = (std::uint32_t(node.box.u0) - corner_.x) / texel;
    const std::uint32_t v0 = (std::uint32_t(node.box.v0) - corner_.y) / texel;
    const std::uint32_t u1 = (std::uint32_t(node.box.u1) - corner_.x + texel - 1) / texel;
    const std::uint32_t v1 = (std::uint32_t(node.box.v1) - corner_.y + texel - 1) / texel;
    std::array<std::uint32_t, 256> counts{}, leans{};
    for (const PixelMask& mask : masks)
        count(mask, counts);
    const auto isPart = [full](std::uint32_t n) { return n > 0 && n < full; };
    node.shared = std::any_of(counts.begin(), counts.end(), isPart);
    if (node.shared) {
        for (const PixelMask& mask : masks)
            lean(mask, leans);
    }
    std::uint16_t planes[kSharePlanes][kTexels];
    bool fills = true;
    for (std::uint32_t y = v0; y < v1; ++y) {
        std::uint32_t shares[kSharePlanes] = {}, covered = 0;
        for (std::uint32_t x = u0; x < u1; ++x) {
            const std::uint32_t i = y * kTexels + x;
            if (counts[i] != full) fills = false;
            if (counts[i] == 0) continue;
            covered |= 1u << x;
            const bool above = 2 * leans[i] > (kRight + kLower) * counts[i];
            const std::uint32_t share =
                sixteenths(counts[i], full, i, above) | std::uint32_t(above) << 4;
            for (int k = 0; k < kSharePlanes; ++k)
                shares[k] |= (share >> k & 1) << x;
        }
        for (int k = 0; k < kSharePlanes; ++k)
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
    for (int k = 0; k < (node.shared ? kSharePlanes : 1); ++k)
        parts.covers.insert(parts.covers.end(), planes[k] + v0, planes[k] + v1);
}

void Coarsening::includeTexel(Node& node, std::uint32_t column, std::uint32_t row) const {
    const Plane& plane = node.plane;
    const std::uint32_t texel = side_ / kTexels;
    const double half = 0.5 * texel;
    const double reach = half * (std::abs(plane.gradientU) + std::abs(plane.gradientV));
    const double w =
        plane.at(corner_.x + column * texel + half, corner_.y + row * texel + half);
    node.low = std::min(node.low, float(w - reach));
    node.high = std::max(node.high, float(w + reach));
}

void Coarsening::count(const PixelMask& mask,
                       std::array<std::uint32_t, 256>& counts) const {
    const std::uint32_t texel = side_ / kTexels;
    const std::uint32_t x = (mask.x * kTexels - corner_.x) / texel;
    const std::uint32_t y = (mask.y * kTexels - corner_.y) / texel;
    std::uint32_t* to = &counts[y * kTexels + x];
    if (texel >= kTexels) {
        *to += mask.covered;
        return;
    }
    for (std::uint32_t row = 0; row < kTexels; row += texel, to += kTexels)
        countRow(mask.row + row, texel, texel, 1, to);
}

void Coarsening::lean(const PixelMask& mask,
                      std::array<std::uint32_t, 256>& leans) const {
    const std::uint32_t texel = side_ / kTexels, half = texel / 2;
    const std::uint32_t x = mask.x * kTexels - corner_.x;
    const std::uint32_t y = mask.y * kTexels - corner_.y;
    std::uint32_t* to = &leans[y / texel * kTexels + x / texel];
    if (texel > kTexels) {
        *to += mask.covered *
               ((x % texel >= half ? kRight : 0) + (y % texel >= half ? kLower : 0));
        return;
    }
    const std::uint32_t right = texel == 2   ? 0xaaaa
                                : texel == 4 ? 0xcccc
                                : texel == 8 ? 0xf0f0
                                             : 0xff00;
    std::array<std::uint16_t, kTexels> rights;
    for (int row = 0; row < kTexels; ++row)
        rights[row] = std::uint16_t(mask.row[row] & right);
    for (std::uint32_t row = 0; row < kTexels; row += texel, to += kTexels) {
        countRow(&rights[row], texel, texel, kRight, to);
        countRow(mask.row + row + half, half, texel, kLower, to);
    }
}

void Coarsening::countRow(const std::uint16_t* rows, std::uint32_t count,
                          std::uint32_t texel, std::uint32_t weight, std::uint32_t* to) {
    if (texel == kTexels) {
        for (std::uint32_t row = 0; row < count; ++row)
            *to += weight * std::uint32_t(base::countBits(rows[row]));
        return;
    }
    // Sums of neighbouring texels are kept apart: one of a pair in each half.
    std::uint32_t even = 0, odd = 0;
    const std::uint32_t mask = texel == 2 ? 0x3333 : texel == 4 ? 0x0f0f : 0x00ff;
    for (std::uint32_t row = 0; row < count; ++row) {
        std::uint32_t bits = rows[row];
        bits -= bits >> 1 & 0x5555;
        if (texel > 2) bits = (bits & 0x3333) + (bits >> 2 & 0x3333);
        if (texel > 4) bits = (bits + (bits >> 4)) & 0x0f0f;
        even += bits & mask;
        odd += bits >> texel & mask;
    }
    for (std::uint32_t i = 0; i < kTexels / texel; i += 2) {
        const std::uint32_t field = (1u << 2 * texel) - 1;
        to[i] += weight * (even >> (i * texel) & field);
        to[i + 1] += weight * (odd >> (i * texel) & field);
    }
}

std::uint32_t Coarsening::sixteenths(std::uint32_t covered, std::uint32_t full,
                                     std::uint32_t place, bool above) {
    if (covered == full) return 15;
    // What two halves are rounded by makes up for each other.
    const double threshold = above ? 1.0 - kDither[place] : kDither[place];
    const double share = 16.0 * covered / full;
    if (share < 14.0) return std::uint32_t(share + threshold);
    return share - 14.0 > 2.0 * threshold ? 15 : 14;
}

}  // namespace mtsm::trace::patch_detail
