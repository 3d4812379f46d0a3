// hair_chunks.h - the segments of a near field's strands (mtsm/near_field.h), sixteen by
// sixteen.
//
//     for (const mtsm::NearHairChunk& chunk : hair.chunks) {
//         for (int s = 0; s < NearHairChunk::kSegments; ++s) {
//             if (chunk.opacity[s] > 0)
//                 use(chunk.at(0, 0, s), chunk.at(0, 1, s));  // u and v of its beginning
//         }
//     }
//
// NearHairChunk is one chunk, written out; NearHairChunks are many, mostly in three
// quarters of that. Segments of a chunk lie close together, so that 12 bits are enough
// for most numbers of their ends, and commonly all of them have one opacity. Where that
// does not hold, more is kept.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mtsm/near_chunks.h"

namespace mtsm {

/// Up to 16 segments of strands that lie close together; all others have opacity 0.
struct NearHairChunk {
    static constexpr int kSegments = 16;
    static constexpr float kOpaque = 65535.0f;

    float low[3] = {};      ///< [u, v, w], finite
    float step[3] = {};     ///< [u, v, w], >= 0; low + 65535 * step is finite
    float halfStep = 0.0f;  ///< >= 0; 255 * halfStep is finite, if perspective <= 1/2
    std::uint16_t end[2][3][kSegments] = {};  ///< [end][u, v, w][segment]
    std::uint16_t opacity[kSegments] = {};    ///< of light that crosses it; in 65535ths
    std::uint8_t half[2][kSegments] = {};     ///< [end][segment], in steps

    [[nodiscard]] float at(int e, int axis, int segment) const noexcept {
        return low[axis] + step[axis] * float(end[e][axis][segment]);
    }
    [[nodiscard]] float halfAt(int e, int segment) const noexcept {
        return halfStep * float(half[e][segment]);
    }
    /// Those that are there.
    [[nodiscard]] int segments() const noexcept;
};
static_assert(sizeof(NearHairChunk) == 284);

/// Chunks in a row. A chunk comes out as it went in.
class NearHairChunks {
  public:
    /// A byte of each segment.
    using Row = std::array<std::uint8_t, NearHairChunk::kSegments>;

    /// One chunk. Its numbers of 16 bits are short if each end has no more than 12.
    struct Packed {
        float low[3] = {}, step[3] = {}, halfStep = 0.0f;  ///< as NearHairChunk's
        std::uint16_t opacity = 0;  ///< of all segments, if it is one
        bool isShort = true, isOneOpacity = true;
        std::uint64_t more = 0;  ///< where its rows of more() begin, if it has any
        Row end[2][3] = {};      ///< [end][u, v, w], the lower 8 bits
        /// [u, v, w]: the upper bits. If they are short, 4 for the first end and, above
        /// those, 4 for the second; else 8 for the first.
        Row high[3] = {};
        Row half[2] = {};  ///< [end]

        /// Rows of more(): unless ends are short, the upper bits of the second ones; and
        /// from opacityRow() on, unless opacity is one, its lower and its upper bits.
        [[nodiscard]] std::size_t opacityRow() const noexcept { return isShort ? 0 : 3; }
        [[nodiscard]] std::size_t moreRows() const noexcept {
            return opacityRow() + (isOneOpacity ? 0 : 2);
        }
    };
    static_assert(sizeof(Packed) == 216);

    void push_back(const NearHairChunk& chunk);
    void shrink_to_fit();

    // In parallel: resize(), set() of parts that lie behind each other, with a `more` for
    // each, and then one after another addMore() of each.

    void resize(std::size_t chunks) { chunks_.resize(chunks); }
    void set(std::size_t i, const NearHairChunk& chunk, std::vector<Row>& more);
    void addMore(std::size_t first, std::size_t count, const std::vector<Row>& more);
    void reserveMore(std::size_t rows) { more_.reserve(more_.size() + rows); }

    [[nodiscard]] std::size_t size() const noexcept { return chunks_.size(); }
    [[nodiscard]] bool empty() const noexcept { return chunks_.empty(); }
    [[nodiscard]] NearHairChunk operator[](std::size_t i) const noexcept;
    [[nodiscard]] ChunkIterator<NearHairChunks> begin() const noexcept {
        return {this, 0};
    }
    [[nodiscard]] ChunkIterator<NearHairChunks> end() const noexcept {
        return {this, size()};
    }

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return chunks_.size() * sizeof(Packed) + more_.size() * sizeof(Row);
    }
    /// Of one chunk: at least, if ends are not short, and at most.
    static constexpr std::uint64_t kLeastBytes = sizeof(Packed);
    static constexpr std::uint64_t kLongBytes = kLeastBytes + 3 * sizeof(Row);
    static constexpr std::uint64_t kMostBytes = kLongBytes + 2 * sizeof(Row);

    // What queries read.

    [[nodiscard]] const Packed& packed(std::size_t i) const noexcept {
        return chunks_[i];
    }
    [[nodiscard]] const Row* more(const Packed& chunk) const noexcept {
        return more_.data() + chunk.more;
    }

  private:
    std::vector<Packed> chunks_;
    std::vector<Row> more_;
};

}  // namespace mtsm
