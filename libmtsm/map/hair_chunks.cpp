#include "mtsm/hair_chunks.h"

#include <algorithm>
#include <cstring>

namespace mtsm {
namespace {

constexpr std::size_t kSegments = NearHairChunk::kSegments;
constexpr unsigned kShortMost = 0xfff;

using Row = NearHairChunks::Row;

/// Bits of numbers of 16 bits from `shift` on.
void bitsOf(const std::uint16_t (&q)[kSegments], int shift, Row& to) {
    for (std::size_t s = 0; s < kSegments; ++s)
        to[s] = std::uint8_t(q[s] >> shift);
}

void join(const Row& low, const Row& high, std::uint16_t (&q)[kSegments]) {
    for (std::size_t s = 0; s < kSegments; ++s)
        q[s] = std::uint16_t(low[s] | high[s] << 8);
}

bool isShort(const NearHairChunk& chunk) {
    unsigned all = 0;
    for (const auto& end : chunk.end) {
        for (const auto& axis : end) {
            for (const std::uint16_t q : axis)
                all |= q;
        }
    }
    return all <= kShortMost;
}

bool isOneOpacity(const NearHairChunk& chunk) {
    return std::count(chunk.opacity, chunk.opacity + kSegments, chunk.opacity[0]) ==
           kSegments;
}

}  // namespace

int NearHairChunk::segments() const noexcept {
    return int(kSegments - std::count(opacity, opacity + kSegments, 0));
}

void NearHairChunks::push_back(const NearHairChunk& chunk) {
    chunks_.emplace_back();
    set(size() - 1, chunk, more_);
}

void NearHairChunks::set(std::size_t i, const NearHairChunk& chunk,
                         std::vector<Row>& rows) {
    Packed& to = chunks_[i];
    std::copy_n(chunk.low, 3, to.low);
    std::copy_n(chunk.step, 3, to.step);
    to.halfStep = chunk.halfStep;
    to.isShort = isShort(chunk);
    to.isOneOpacity = isOneOpacity(chunk);
    to.opacity = to.isOneOpacity ? chunk.opacity[0] : 0;
    to.more = rows.size();
    rows.resize(rows.size() + to.moreRows());
    Row* const more = rows.data() + to.more;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        for (std::size_t e = 0; e < 2; ++e)
            bitsOf(chunk.end[e][axis], 0, to.end[e][axis]);
        Row last;
        bitsOf(chunk.end[0][axis], 8, to.high[axis]);
        bitsOf(chunk.end[1][axis], 8, last);
        if (!to.isShort) more[axis] = last;
        for (std::size_t s = 0; to.isShort && s < kSegments; ++s)
            to.high[axis][s] = std::uint8_t(to.high[axis][s] | last[s] << 4);
    }
    std::memcpy(to.half, chunk.half, sizeof to.half);
    if (to.isOneOpacity) return;
    bitsOf(chunk.opacity, 0, more[to.opacityRow()]);
    bitsOf(chunk.opacity, 8, more[to.opacityRow() + 1]);
}

NearHairChunk NearHairChunks::operator[](std::size_t i) const noexcept {
    const Packed& from = chunks_[i];
    const Row* const more = this->more(from);
    NearHairChunk chunk;
    std::copy_n(from.low, 3, chunk.low);
    std::copy_n(from.step, 3, chunk.step);
    chunk.halfStep = from.halfStep;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        Row first = from.high[axis], last = {};
        if (!from.isShort) last = more[axis];
        for (std::size_t s = 0; from.isShort && s < kSegments; ++s) {
            last[s] = std::uint8_t(first[s] >> 4);
            first[s] &= 15;
        }
        join(from.end[0][axis], first, chunk.end[0][axis]);
        join(from.end[1][axis], last, chunk.end[1][axis]);
    }
    std::memcpy(chunk.half, from.half, sizeof chunk.half);
    if (from.isOneOpacity) {
        std::fill_n(chunk.opacity, kSegments, from.opacity);
    } else {
        const Row* const opacity = more + from.opacityRow();
        join(opacity[0], opacity[1], chunk.opacity);
    }
    return chunk;
}

void NearHairChunks::addMore(std::size_t first, std::size_t count,
                             const std::vector<Row>& more) {
    for (std::size_t i = first; i < first + count; ++i)
        chunks_[i].more += more_.size();
    more_.insert(more_.end(), more.begin(), more.end());
}

void NearHairChunks::shrink_to_fit() {
    chunks_.shrink_to_fit();
    more_.shrink_to_fit();
}

}  // namespace mtsm
