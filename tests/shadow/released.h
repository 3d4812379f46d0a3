// released.h - maps that let go of their layers, and what they are held against.
#pragma once
#include <catch2/catch.hpp>
#include <cstring>
#include <utility>
#include <vector>

#include "map_fixture.h"
#include "mtsm/shadow.h"

namespace mtsm::test {

/// A half-plane two units in front of the eye, in one face or in all six.
inline ShadowMap halfDark(float v, Translucent translucent, bool cube = false) {
    MapInfo info = plainInfo(32, 32, 16);
    info.light.shape = cube ? LightShape::sphere : LightShape::disk;
    info.light.radius = 0.2;
    info.light.direction = {0, 0, -1};
    info.bias = 0.05f;
    info.translucent = translucent;
    const auto views =
        cube ? cubeProjections(32) : std::vector<Projection>{plainProjection(32, 32)};
    const ShadowMap map =
        mapOf(info, views, [v](std::uint32_t, std::uint32_t x, std::uint32_t) {
            return x < 16 ? std::vector<TestLayer>{{2.0f, v, 1}}
                          : std::vector<TestLayer>{};
        });
    return v > 0.0f ? map : opaqueOf(map);
}

/// Behind it, from one side to the other.
inline std::vector<glm::dvec3> acrossTheEdge(int count) {
    std::vector<glm::dvec3> points;
    for (int i = 0; i < count; ++i)
        points.push_back({3.8 * (double(i) / count - 0.5), 0.1, -4});
    return points;
}

inline ShadowMap released(const ShadowMap& map) {
    ShadowMap copy = map;
    const Status done = releaseLayers(copy);
    if (!done) FAIL(done.error().message);
    REQUIRE(!copy.hasLayers());
    return copy;
}

template <typename T>
bool sameBits(const std::vector<T>& a, const std::vector<T>& b) {
    return a.size() == b.size() &&
           std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0;
}

}  // namespace mtsm::test
