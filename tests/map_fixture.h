// map_fixture.h - small maps for the tests of every module.
#pragma once
#include <cmath>
#include <cstdint>
#include <functional>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <random>
#include <stdexcept>
#include <vector>

#include "mtsm/map.h"

namespace mtsm::test {

inline MapInfo plainInfo(std::uint32_t width, std::uint32_t height,
                         std::uint32_t tileSize) {
    MapInfo info;
    info.width = width;
    info.height = height;
    info.tileSize = tileSize;
    info.software = "mtsm tests";
    return info;
}

/// The eye at the origin looking along -z of the world, 90 degrees across the width.
inline Projection plainProjection(std::uint32_t width, std::uint32_t height) {
    Projection p;
    p.scale = {width / 2.0, width / -2.0};
    p.offset = {width / 2.0, height / 2.0};
    return p;
}

struct NoisySpec {
    std::uint32_t width = 16, height = 16, tileSize = 8, faces = 1, channels = 1;
    bool opaque = false;           ///< no v and n planes
    std::uint32_t mostLayers = 5;  ///< per pixel
    double emptyTiles = 0.2;       ///< share of tiles without a layer
    std::uint64_t seed = 1;
};

/// A map with every kind of layer in it, resets included; the same for the same spec.
inline ShadowMap noisyMap(const NoisySpec& spec) {
    std::mt19937_64 random(spec.seed);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    MapInfo info = plainInfo(spec.width, spec.height, spec.tileSize);
    info.channels = spec.channels;
    info.light.shape = LightShape::disk;
    info.light.radius = unit();
    info.light.position = {unit(), -unit(), 1e7 * unit()};
    info.bias = float(unit());
    info.maxLayers = spec.mostLayers;
    info.resets = kAllResets;
    info.settings = "noise \"quoted\"\n\xc3\xa9";
    info.attributes = {{"shot", std::string("sq010")},
                       {"frame", std::int64_t(-7)},
                       {"grade", std::vector<double>{0.5, -1e300, NAN}}};
    const std::uint32_t tilesX = (spec.width + spec.tileSize - 1) / spec.tileSize;
    const std::uint32_t tilesY = (spec.height + spec.tileSize - 1) / spec.tileSize;
    std::vector<MapFace> faces(spec.faces);
    for (std::uint32_t f = 0; f < spec.faces; ++f) {
        faces[f].projection = plainProjection(spec.width, spec.height);
        faces[f].projection.eye = {double(f), 2.5, -1e7};
        faces[f].projection.near = 0.125;
        for (std::uint32_t ty = 0; ty < tilesY; ++ty) {
            for (std::uint32_t tx = 0; tx < tilesX; ++tx) {
                Tile t;
                if (unit() >= spec.emptyTiles) {
                    const std::uint32_t w =
                        std::min(spec.tileSize, spec.width - tx * spec.tileSize);
                    const std::uint32_t h =
                        std::min(spec.tileSize, spec.height - ty * spec.tileSize);
                    std::vector<std::vector<float>> v(spec.channels);
                    t.begin.push_back(0);
                    for (std::uint32_t p = 0; p < w * h; ++p) {
                        const auto count = std::uint32_t(unit() * (spec.mostLayers + 1));
                        float z = float(0.5 + 10 * unit());
                        std::vector<float> vis(spec.channels, 1.0f);
                        for (std::uint32_t i = 0; i < count; ++i) {
                            z += unit() < 0.1 ? 0.0f : float(unit());
                            t.z.push_back(z);
                            if (spec.opaque) continue;
                            t.n.push_back(1 +
                                          std::uint32_t(unit() < 0.5 ? 0 : 1e5 * unit()));
                            const bool stop = unit() < 0.25;
                            bool dark = true;
                            for (std::uint32_t c = 0; c < spec.channels; ++c) {
                                vis[c] = stop ? 0.0f : vis[c] * float(unit());
                                v[c].push_back(vis[c]);
                                dark = dark && vis[c] == 0.0f;
                            }
                            if (dark) vis.assign(spec.channels, 1.0f);
                        }
                        t.begin.push_back(std::uint32_t(t.z.size()));
                    }
                    for (const auto& plane : v)
                        t.v.insert(t.v.end(), plane.begin(), plane.end());
                    if (t.z.empty()) t = Tile{};
                }
                faces[f].tiles.push_back(std::move(t));
            }
        }
    }
    auto map = ShadowMap::create(info, std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return *std::move(map);
}

/// One layer of a pixel as a test writes it down.
struct TestLayer {
    float z = 1.0f, v = 0.0f;
    std::uint32_t n = 1;
};

/// A one-channel map whose pixel (x, y) of a face has the layers that pixel(face, x, y)
/// returns.
inline ShadowMap mapOf(MapInfo info, const std::vector<Projection>& projections,
                       const std::function<std::vector<TestLayer>(
                           std::uint32_t, std::uint32_t, std::uint32_t)>& pixel) {
    const std::uint32_t tilesX = (info.width + info.tileSize - 1) / info.tileSize;
    const std::uint32_t tilesY = (info.height + info.tileSize - 1) / info.tileSize;
    std::vector<MapFace> faces(projections.size());
    for (std::uint32_t f = 0; f < faces.size(); ++f) {
        faces[f].projection = projections[f];
        for (std::uint32_t tile = 0; tile < tilesX * tilesY; ++tile) {
            Tile t;
            t.begin.push_back(0);
            const std::uint32_t x0 = tile % tilesX * info.tileSize;
            const std::uint32_t y0 = tile / tilesX * info.tileSize;
            for (std::uint32_t y = y0; y < std::min(info.height, y0 + info.tileSize);
                 ++y) {
                for (std::uint32_t x = x0; x < std::min(info.width, x0 + info.tileSize);
                     ++x) {
                    for (const TestLayer& layer : pixel(f, x, y)) {
                        t.z.push_back(layer.z);
                        t.v.push_back(layer.v);
                        t.n.push_back(layer.n);
                    }
                    t.begin.push_back(std::uint32_t(t.z.size()));
                }
            }
            faces[f].tiles.push_back(std::move(t));
        }
    }
    auto map = ShadowMap::create(std::move(info), std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return *std::move(map);
}

/// The same with one face.
inline ShadowMap mapOf(
    MapInfo info, const Projection& projection,
    const std::function<std::vector<TestLayer>(std::uint32_t, std::uint32_t)>& pixel) {
    return mapOf(
        std::move(info), std::vector<Projection>{projection},
        [&](std::uint32_t, std::uint32_t x, std::uint32_t y) { return pixel(x, y); });
}

/// The same map, all of whose layers are opaque, as a bake has it: without v and n.
inline ShadowMap opaqueOf(const ShadowMap& map) {
    std::vector<MapFace> faces(map.faceCount());
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        faces[f].projection = map.projection(f);
        for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
            for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx) {
                const Tile& t = map.tile(f, tx, ty);
                faces[f].tiles.push_back({t.begin, t.z, {}, {}});
            }
        }
    }
    auto opaque = ShadowMap::create(map.info(), std::move(faces));
    if (!opaque) throw std::runtime_error(opaque.error().message);
    return *std::move(opaque);
}

/// Views of 90 degrees to all sides of `eye`, along the axes of the world, or of the
/// world turned by `turn`.
inline std::vector<Projection> cubeProjections(std::uint32_t width, glm::dvec3 eye = {},
                                               const glm::dmat3& turn = glm::dmat3(1.0)) {
    std::vector<Projection> faces;
    for (int f = 0; f < 6; ++f) {
        glm::dvec3 forward(0.0), up(0.0);
        forward[f / 2] = f % 2 ? -1.0 : 1.0;
        up[(f / 2 + 1) % 3] = 1.0;
        Projection p = plainProjection(width, width);
        p.eye = eye;
        p.forward = turn * forward;
        p.up = turn * up;
        p.right = glm::cross(p.forward, p.up);
        faces.push_back(p);
    }
    return faces;
}

}  // namespace mtsm::test
