// patch_planes.h - which of many planes may pass near a place.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mtsm::trace::patch_detail {

/// Planes over a tile: depth at its corner, slope, and by how much those may be off
/// within it, in floats. There is room for kSpare more than are used.
struct PlaneList {
    static constexpr std::size_t kSpare = 16;
    std::vector<float> w, perU, perV, slack;

    void resize(std::size_t count) {
        for (std::vector<float>* v : {&w, &perU, &perV, &slack})
            v->resize(count + kSpare);
    }
};

/// Those of the first `count` planes that pass within `most` of depth w at (u, v) from
/// the corner, and such as do but for their slack, in order; how many. `found` has room
/// for kSpare more than all.
std::size_t findNear(const PlaneList& planes, std::size_t count, float u, float v,
                     float w, float most, std::uint32_t* found) noexcept;

}  // namespace mtsm::trace::patch_detail
