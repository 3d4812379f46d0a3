// near_chunks.h - the triangles of a near field (mtsm/near_field.h), sixteen by sixteen.
//
//     for (const mtsm::NearChunk& chunk : field.chunks) {
//         for (int t = 0; t < chunk.triangles(); ++t)
//             use(chunk.at(0, 0, t), chunk.at(0, 1, t), chunk.at(0, 2, t));   // u, v, w
//     }
//
// NearChunk is one chunk, written out; NearChunks are many, of meshes in half of that.
// Most corners of a chunk are corners of several of its triangles, and of 48 corners of a
// mesh about 15 differ: each of these is kept once, and with every triangle which three
// of them are its own. A chunk with more than 32 different ones, triangles that have
// little to do with each other, is kept as it is, in three quarters of that where 12 bits
// are enough for each number.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mtsm {

/// Up to 16 triangles that lie close together. Where there are fewer, the last one is
/// repeated to the end. Which way round the corners run means nothing.
struct NearChunk {
    static constexpr int kTriangles = 16;

    float low[3] = {};   ///< [u, v, w], finite
    float step[3] = {};  ///< [u, v, w], >= 0; low + 65535 * step is finite
    std::uint16_t corner[3][3][kTriangles] = {};  ///< [corner][u, v, w][triangle]

    [[nodiscard]] float at(int c, int axis, int triangle) const noexcept {
        return low[axis] + step[axis] * float(corner[c][axis][triangle]);
    }
    /// Those before the repeats of the last one.
    [[nodiscard]] int triangles() const noexcept;
};

/// Of chunks that are written out one by one.
template <typename Chunks>
struct ChunkIterator {
    const Chunks* all;
    std::size_t i;

    [[nodiscard]] auto operator*() const noexcept { return (*all)[i]; }
    ChunkIterator& operator++() noexcept { return ++i, *this; }
    [[nodiscard]] bool operator!=(const ChunkIterator& b) const noexcept {
        return i != b.i;
    }
};

/// Chunks in a row. A chunk comes out as it went in.
class NearChunks {
  public:
    static constexpr int kMostShared = 32;  ///< points of a chunk that are kept once
    static constexpr int kBits = 5;         ///< of the number of one
    static constexpr int kCorners = 3 * NearChunk::kTriangles;
    static constexpr int kShortBits = 12;  ///< of a number of what is kept so
    static constexpr int kShortWords = kCorners * kShortBits / 16;  ///< of an axis

    /// Of one chunk, all but its points.
    struct Place {
        float low[3], step[3];        ///< as NearChunk's
        std::uint64_t first : 53;     ///< of its words
        std::uint64_t triangles : 5;  ///< as NearChunk::triangles()
        /// Words of an axis. 1..kMostShared points; or every corner: kCorners, or
        /// kShortWords if they are short.
        std::uint64_t points : 6;

        [[nodiscard]] bool areShared() const noexcept { return points <= kMostShared; }
        [[nodiscard]] bool areShort() const noexcept { return points == kShortWords; }
    };
    static_assert(sizeof(Place) == 32);

    using Point = std::array<std::uint16_t, 3>;  ///< u, v, w, in steps

    void push_back(const NearChunk& chunk);
    /// A chunk of `count` points, 1..kCorners. Its corners, [triangle][corner], are those
    /// of these numbers, all below `count`. Points that are the same are not put
    /// together.
    void push_back(const float (&low)[3], const float (&step)[3], const Point* points,
                   std::size_t count, const std::uint8_t* numbers);
    /// So many with so many points in all will come.
    void reserve(std::size_t chunks, std::size_t points);
    /// Those of some others, which are empty from then on.
    void append(NearChunks* parts, std::size_t count);
    void shrink_to_fit();

    [[nodiscard]] std::size_t size() const noexcept { return places_.size(); }
    [[nodiscard]] bool empty() const noexcept { return places_.empty(); }
    [[nodiscard]] NearChunk operator[](std::size_t i) const noexcept;
    [[nodiscard]] ChunkIterator<NearChunks> begin() const noexcept { return {this, 0}; }
    [[nodiscard]] ChunkIterator<NearChunks> end() const noexcept {
        return {this, size()};
    }

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept {
        return places_.size() * sizeof(Place) + words_.size() * sizeof(std::uint16_t);
    }
    /// Of so many chunks with so many different points each, none of them short.
    [[nodiscard]] static std::uint64_t memoryBytes(std::uint64_t chunks,
                                                   int points) noexcept;

    // What queries read.

    [[nodiscard]] const Place& place(std::size_t i) const noexcept { return places_[i]; }
    /// Where points are shared, [triangle]: the numbers of its three.
    [[nodiscard]] const std::uint16_t* corners(std::size_t i) const noexcept {
        return words_.data() + places_[i].first;
    }
    [[nodiscard]] static int pointOf(std::uint16_t corners, int corner) noexcept {
        return corners >> (kBits * corner) & (kMostShared - 1);
    }
    /// [u, v, w][point], in steps. Where they are not shared, a point is
    /// [corner][triangle]; where they are short, an axis is one row of kShortBits each,
    /// lower bits and words first. Up to kMostShared words from any of its axes on may be
    /// read, whether they are points or not.
    [[nodiscard]] const std::uint16_t* points(std::size_t i) const noexcept {
        return corners(i) + (places_[i].areShared() ? NearChunk::kTriangles : 0);
    }

  private:
    static constexpr std::size_t kSpare = kMostShared;

    std::uint16_t* add(Place& place);

    std::vector<Place> places_;
    std::vector<std::uint16_t> words_;  ///< and kSpare of them behind the last chunk's
};

}  // namespace mtsm
