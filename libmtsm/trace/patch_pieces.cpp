// TilePieces: samples of neighbouring pixels are joined, and pieces that are not flat are
// divided.
#include "trace/patch_pieces.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <iterator>

namespace mtsm::trace::patch_detail {

TilePieces::TilePieces(const ShadowMap& map, std::uint32_t face, Footprint footprint,
                       float flatness)
    : map_(map),
      face_(face),
      footprint_(footprint),
      flatness_(flatness),
      perspective_(map.projection(face).kind == ProjectionKind::perspective) {}

void TilePieces::run(std::uint32_t x, std::uint32_t y, Nodes& made, Parts& parts) {
    corner_ = {x * kTexels, y * kTexels};
    gather();
    if (w_.empty()) return;
    for (std::uint32_t i = 0; i < kTexels; ++i)
        u_[i] = corner_.x + i + 0.5, v_[i] = corner_.y + i + 0.5;
    connect();
    separate();
    for (std::size_t piece = 0; piece + 1 < pieceBegin_.size(); ++piece) {
        const std::span<const Sample> samples(&ordered_[pieceBegin_[piece]],
                                              &ordered_[pieceBegin_[piece + 1] - 1] + 1);
        made.nodes.push_back(emit(samples, {0, 0, kTexels}, {}, parts));
        made.nodes.back().masks = 1;
        PixelMask mask{
            std::uint16_t(x), std::uint16_t(y), std::uint16_t(samples.size()), {}};
        addBits(samples, mask.row);
        made.masks.push_back(mask);
    }
}

void TilePieces::gather() {
    w_.clear();
    const std::uint32_t width = map_.info().width, height = map_.info().height;
    for (std::uint32_t row = 0; row < kTexels; ++row) {
        const std::uint32_t y = corner_.y + row;
        std::uint32_t column = 0;
        while (y < height && column < kTexels && corner_.x + column < width)
            column += gatherRow(column, row);
        const auto end = std::uint32_t(w_.size());
        std::fill(&begin_[row * kTexels + column], &begin_[row * kTexels] + kTexels, end);
    }
    begin_[256] = std::uint32_t(w_.size());
    reach_.resize(w_.size());
    for (std::size_t i = 0; i < w_.size(); ++i)
        reach_[i] = kSteepest * footprint_.at(w_[i]);
}

std::uint32_t TilePieces::gatherRow(std::uint32_t column, std::uint32_t row) {
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

std::uint32_t TilePieces::root(std::uint32_t i) {
    while (parent_[i] != i)
        i = parent_[i] = parent_[parent_[i]];
    return i;
}

void TilePieces::join(std::uint32_t p, std::uint32_t q) {
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

void TilePieces::connect() {
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

void TilePieces::separate() {
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

Node TilePieces::emit(std::span<const Sample> samples, Square square, Slope likely,
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
            node.residual = std::max(node.residual, mismatch(node.plane, quarters[q]));
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

std::size_t TilePieces::divide(std::span<const Sample> samples, Square square,
                               Slope likely, std::array<Node, 4>& quarters,
                               Parts& parts) {
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
            quarters[count++] = emit({left, lefts}, {square.x, y, half}, likely, parts);
        if (rights > 0)
            quarters[count++] =
                emit({right, rights}, {square.x + half, y, half}, likely, parts);
    }
    return count;
}

void TilePieces::addBits(std::span<const Sample> samples, std::uint16_t* rows) {
    for (const Sample& s : samples)
        rows[s.y] |= std::uint16_t(1u << s.x);
}

void TilePieces::addCover(std::span<const Sample> samples, Node& node,
                          Parts& parts) const {
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

void TilePieces::addBumps(std::span<const Sample> samples, Square square, Node& node,
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

std::int16_t TilePieces::roundSteps(double steps) {
    steps = std::clamp(steps, -double(BumpPlane::kSteps), double(BumpPlane::kSteps));
    return std::int16_t(steps + (steps < 0 ? -0.5 : 0.5));
}

Moments TilePieces::momentsOf(std::span<const Sample> samples) const {
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

Node TilePieces::flatNode(std::span<const Sample> samples, Slope likely) const {
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
    const auto reach =
        float(0.5 * (std::abs(node.plane.gradientU) + std::abs(node.plane.gradientV)));
    node.low = low - reach;
    node.high = high + reach;
    return node;
}

}  // namespace mtsm::trace::patch_detail
