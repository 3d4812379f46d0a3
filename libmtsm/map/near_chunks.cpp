#include "mtsm/near_chunks.h"

#include <algorithm>
#include <utility>

#include "map/near_points.h"

namespace mtsm {
namespace {

using map_detail::kCorners, map_detail::kTriangles;
using Point = NearChunks::Point;

/// Those before the repeats of the last one.
int trianglesOf(const Point* points, const std::uint8_t* numbers) {
    const std::uint8_t* const last = numbers + kCorners - 3;
    const auto isLast = [&](const std::uint8_t* n) {
        return points[n[0]] == points[last[0]] && points[n[1]] == points[last[1]] &&
               points[n[2]] == points[last[2]];
    };
    std::size_t count = kTriangles;
    while (count > 1 && isLast(numbers + 3 * (count - 2)))
        --count;
    return int(count);
}

bool areShort(const Point* points, std::size_t count) {
    unsigned all = 0;
    for (std::size_t i = 0; i < count; ++i)
        all |= unsigned(points[i][0] | points[i][1] | points[i][2]);
    return all >> NearChunks::kShortBits == 0;
}

}  // namespace

int NearChunk::triangles() const noexcept {
    const auto last = [this](std::size_t t) {
        const auto isSame = [&](const auto& axis) { return axis[t] == axis[15]; };
        return std::all_of(std::begin(corner), std::end(corner), [&](const auto& c) {
            return isSame(c[0]) && isSame(c[1]) && isSame(c[2]);
        });
    };
    int count = kTriangles;
    while (count > 1 && last(std::size_t(count) - 2))
        --count;
    return count;
}

void NearChunks::push_back(const NearChunk& chunk) {
    const map_detail::NearPoints<3> p(chunk.corner);
    push_back(chunk.low, chunk.step, p.points, p.count, p.numbers);
}

void NearChunks::push_back(const float (&low)[3], const float (&step)[3],
                           const Point* points, std::size_t count,
                           const std::uint8_t* numbers) {
    Place place = {};
    std::copy_n(low, 3, place.low);
    std::copy_n(step, 3, place.step);
    place.triangles = std::uint64_t(trianglesOf(points, numbers));
    place.points = map_detail::areShared(count) ? count
                   : areShort(points, count)    ? std::size_t(kShortWords)
                                                : kCorners;
    std::uint16_t* const q = add(place);
    if (place.areShort())
        map_detail::writeShort(points, numbers, q);
    else
        map_detail::writePoints(points, count, numbers, q);
}

/// Where the words of a new chunk go.
std::uint16_t* NearChunks::add(Place& place) {
    const std::size_t used = words_.empty() ? 0 : words_.size() - kSpare;
    const std::size_t more = (place.areShared() ? kTriangles : 0) + 3 * place.points;
    words_.resize(used + more + kSpare);
    place.first = used;
    places_.push_back(place);
    return words_.data() + used;
}

void NearChunks::reserve(std::size_t chunks, std::size_t points) {
    places_.reserve(chunks);
    words_.reserve(chunks * kTriangles + 3 * points + kSpare);
}

void NearChunks::append(NearChunks* parts, std::size_t count) {
    if (empty() && count == 1) {
        *this = std::exchange(parts[0], {});
        return;
    }
    std::size_t chunks = places_.size(),
                used = words_.empty() ? 0 : words_.size() - kSpare;
    std::size_t words = used + kSpare;
    for (std::size_t i = 0; i < count; ++i) {
        chunks += parts[i].places_.size();
        words += parts[i].words_.size();
    }
    map_detail::growTo(places_, chunks);
    map_detail::growTo(words_, words);
    for (std::size_t i = 0; i < count; ++i) {
        const NearChunks part = std::move(parts[i]);
        parts[i] = {};
        if (part.empty()) continue;
        words_.resize(used);
        words_.insert(words_.end(), part.words_.begin(), part.words_.end());
        for (Place place : part.places_) {
            place.first += used;
            places_.push_back(place);
        }
        used = words_.size() - kSpare;
    }
}

std::uint64_t NearChunks::memoryBytes(std::uint64_t chunks, int points) noexcept {
    const std::size_t words = map_detail::wordsOf(3, std::size_t(points));
    return chunks * (sizeof(Place) + words * sizeof(std::uint16_t));
}

NearChunk NearChunks::operator[](std::size_t i) const noexcept {
    const Place& place = places_[i];
    NearChunk chunk;
    std::copy_n(place.low, 3, chunk.low);
    std::copy_n(place.step, 3, chunk.step);
    std::uint16_t room[kCorners];
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::uint16_t* const q = map_detail::axisOf(*this, i, axis, room);
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t t = 0; t < kTriangles; ++t) {
                const std::size_t n = place.areShared() ? pointOf(corners(i)[t], int(c))
                                                        : kTriangles * c + t;
                chunk.corner[c][axis][t] = q[n];
            }
        }
    }
    return chunk;
}

void NearChunks::shrink_to_fit() {
    places_.shrink_to_fit();
    words_.shrink_to_fit();
}

}  // namespace mtsm
