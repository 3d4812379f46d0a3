#include "mtsm/near_chunks.h"

#include <algorithm>
#include <array>
#include <utility>

namespace mtsm {
namespace {

constexpr std::size_t kTriangles = NearChunk::kTriangles;
constexpr std::size_t kCorners = NearChunks::kCorners;
constexpr int kBits = NearChunks::kBits;

using Key = std::uint64_t;  // u, v and w of a point

Key keyOf(const NearChunk& chunk, std::size_t corner) {
    const auto& c = chunk.corner[corner % 3];
    const std::size_t t = corner / 3;
    return Key(c[0][t]) | Key(c[1][t]) << 16 | Key(c[2][t]) << 32;
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
    std::array<Key, kCorners> points;
    std::array<std::uint8_t, kCorners> numbers;  // [triangle][corner]
    std::size_t count = 0;
    for (std::size_t corner = 0; corner < kCorners; ++corner) {
        const Key key = keyOf(chunk, corner);
        std::size_t known = count;
        while (known > 0 && points[known - 1] != key)
            --known;
        if (known == 0) points[(known = ++count) - 1] = key;
        numbers[corner] = std::uint8_t(known - 1);
    }
    Place place = {};
    std::copy_n(chunk.low, 3, place.low);
    std::copy_n(chunk.step, 3, place.step);
    place.triangles = std::uint64_t(chunk.triangles());
    if (count > kMostShared) {
        place.points = kCorners;
        std::uint16_t* q = add(place);
        for (int axis = 0; axis < 3; ++axis) {
            for (int c = 0; c < 3; ++c)
                q = std::copy_n(chunk.corner[c][axis], kTriangles, q);
        }
        return;
    }
    place.points = count;
    std::uint16_t* const words = add(place);
    for (std::size_t t = 0; t < kTriangles; ++t) {
        const std::uint8_t* const n = numbers.data() + 3 * t;
        words[t] = std::uint16_t(n[0] | n[1] << kBits | n[2] << 2 * kBits);
    }
    std::uint16_t* const q = words + kTriangles;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        for (std::size_t i = 0; i < count; ++i)
            q[axis * count + i] = std::uint16_t(points[i] >> (16 * axis));
    }
}

/// Where the words of a new chunk go.
std::uint16_t* NearChunks::add(Place& place) {
    const std::size_t used = words_.empty() ? 0 : words_.size() - kSpare;
    const std::size_t more =
        3 * std::size_t(place.points) + (place.areShared() ? kTriangles : 0);
    words_.resize(used + more + kSpare);
    place.first = used;
    places_.push_back(place);
    return words_.data() + used;
}

void NearChunks::append(NearChunks* parts, std::size_t count) {
    std::size_t chunks = places_.size(),
                used = words_.empty() ? 0 : words_.size() - kSpare;
    std::size_t words = used + kSpare;
    for (std::size_t i = 0; i < count; ++i) {
        chunks += parts[i].places_.size();
        words += parts[i].words_.size();
    }
    places_.reserve(chunks);
    words_.reserve(words);
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
    const int words = points > kMostShared ? 3 * kCorners : 3 * points + int(kTriangles);
    return chunks * (sizeof(Place) + std::uint64_t(words) * sizeof(std::uint16_t));
}

NearChunk NearChunks::operator[](std::size_t i) const noexcept {
    const Place& place = places_[i];
    NearChunk chunk;
    std::copy_n(place.low, 3, chunk.low);
    std::copy_n(place.step, 3, chunk.step);
    const std::uint16_t* const q = points(i);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t t = 0; t < kTriangles; ++t) {
                const std::size_t n = place.areShared() ? pointOf(corners(i)[t], int(c))
                                                        : kTriangles * c + t;
                chunk.corner[c][axis][t] = q[axis * place.points + n];
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
