// near_points.h - the corners of a chunk's 16 triangles as different points, and which of
// them each is: how NearChunks and NearSheetChunks keep them.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mtsm/near_chunks.h"

namespace mtsm::map_detail {

inline constexpr std::size_t kTriangles = NearChunk::kTriangles;
inline constexpr std::size_t kCorners = NearChunks::kCorners;

/// Points in the order in which corners, triangle by triangle, first name them.
template <std::size_t kAxes>
struct NearPoints {
    using Point = std::array<std::uint16_t, kAxes>;

    Point points[kCorners];
    std::uint8_t numbers[kCorners];  ///< [triangle][corner]
    std::size_t count = 0;

    /// `corners`: [corner][axis][triangle].
    explicit NearPoints(const std::uint16_t (&corners)[3][kAxes][kTriangles]) {
        for (std::size_t corner = 0; corner < kCorners; ++corner) {
            Point p;
            for (std::size_t axis = 0; axis < kAxes; ++axis)
                p[axis] = corners[corner % 3][axis][corner / 3];
            std::size_t known = count;
            while (known > 0 && points[known - 1] != p)
                --known;
            if (known == 0) points[(known = ++count) - 1] = p;
            numbers[corner] = std::uint8_t(known - 1);
        }
    }
};

/// Points that are shared are kept as the numbers of each triangle's three and then
/// [axis][point]; others as [axis][corner][triangle], NearChunks' short ones in fewer
/// bits.
constexpr bool areShared(std::size_t points) {
    return points <= std::size_t(NearChunks::kMostShared);
}
constexpr std::size_t wordsOf(std::size_t axes, std::size_t points) {
    return areShared(points) ? kTriangles + axes * points : axes * kCorners;
}

/// Room for so many, and then for as many more as there was room for: much may be
/// appended, little at a time.
template <typename T>
void growTo(std::vector<T>& list, std::size_t size) {
    if (size > list.capacity()) list.reserve(std::max(size, 2 * list.capacity()));
}

template <std::size_t kAxes>
void writePoints(const std::array<std::uint16_t, kAxes>* points, std::size_t count,
                 const std::uint8_t* numbers, std::uint16_t* q) {
    if (!areShared(count)) {
        for (std::size_t axis = 0; axis < kAxes; ++axis) {
            for (std::size_t c = 0; c < 3; ++c) {
                for (std::size_t t = 0; t < kTriangles; ++t)
                    *q++ = points[numbers[3 * t + c]][axis];
            }
        }
        return;
    }
    constexpr int kBits = NearChunks::kBits;
    for (const std::uint8_t* n = numbers; n < numbers + kCorners; n += 3)
        *q++ = std::uint16_t(n[0] | n[1] << kBits | n[2] << 2 * kBits);
    for (std::size_t axis = 0; axis < kAxes; ++axis) {
        for (std::size_t i = 0; i < count; ++i)
            *q++ = points[i][axis];
    }
}

/// Points that are not shared and whose numbers are short, in 9 rows of 12 words: four
/// numbers in three words, lower bits first.
inline void writeShort(const NearChunks::Point* points, const std::uint8_t* numbers,
                       std::uint16_t* q) {
    for (std::size_t row = 0; row < 9; ++row) {
        const auto at = [&](std::size_t t) {
            return unsigned(points[numbers[3 * t + row % 3]][row / 3]);
        };
        for (std::size_t t = 0; t < kTriangles; t += 4, q += 3) {
            const unsigned a = at(t), b = at(t + 1), c = at(t + 2), d = at(t + 3);
            q[0] = std::uint16_t(a | b << 12);
            q[1] = std::uint16_t(b >> 4 | c << 8);
            q[2] = std::uint16_t(c >> 8 | d << 4);
        }
    }
}
/// The three rows of an axis.
inline void readShort(const std::uint16_t* q, std::uint16_t* numbers) {
    for (auto* n = numbers; n < numbers + kCorners; n += 4, q += 3) {
        const unsigned a = q[0], b = q[1], c = q[2];
        n[0] = std::uint16_t(a & 0xfff);
        n[1] = std::uint16_t(a >> 12 | (b & 0xff) << 4);
        n[2] = std::uint16_t(b >> 8 | (c & 0xf) << 8);
        n[3] = std::uint16_t(c >> 4);
    }
}

/// Points of an axis, in steps; in `room` where they are short.
inline const std::uint16_t* axisOf(const NearChunks& chunks, std::size_t i,
                                   std::size_t axis, std::uint16_t (&room)[kCorners]) {
    const NearChunks::Place& place = chunks.place(i);
    const std::uint16_t* const q = chunks.points(i) + axis * place.points;
    if (!place.areShort()) return q;
    readShort(q, room);
    return room;
}

}  // namespace mtsm::map_detail
