// golden_maps.h - the maps that the files in this folder hold, for ever.
//
// Every number comes from integer arithmetic and from float operations that round to the
// same bits on every machine.
#pragma once
#include <bit>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/writer.h"

namespace mtsm::test {

struct Golden {
    std::string name;  ///< of the file, without .mtsm
    ShadowMap map;
    Codec codec = Codec::zstd;
    bool trees = false;
};

/// The same numbers in the same order on every machine.
class Numbers {
  public:
    explicit Numbers(std::uint64_t seed) : state_(seed) {}
    std::uint32_t below(std::uint32_t n) {
        state_ = state_ * 6364136223846793005u + 1442695040888963407u;
        return static_cast<std::uint32_t>((state_ >> 33) % n);
    }

  private:
    std::uint64_t state_;
};

struct Layer {
    float z = 1.0f;
    std::vector<float> v;  ///< by channel; none: opaque
    std::uint32_t n = 1;
};
using Pixel = std::vector<Layer>;

/// The layers of pixel (x, y) of a face.
using PixelMaker =
    std::function<Pixel(std::uint32_t face, std::uint32_t x, std::uint32_t y)>;

inline MapInfo goldenInfo(std::uint32_t width, std::uint32_t height,
                          std::uint32_t tileSize) {
    MapInfo info;
    info.width = width;
    info.height = height;
    info.tileSize = tileSize;
    info.light.position = {0.0, 4.0, 0.0};
    info.software = "make_golden 1";
    return info;
}

/// An eye that looks along -z of the world, a pixel one unit wide at depth 1.
inline Projection goldenProjection(const MapInfo& info) {
    Projection p;
    p.scale = {1.0, -1.0};
    p.offset = {0.5 * info.width, 0.5 * info.height};
    return p;
}

/// One tile with v and n planes if any layer of it needs them.
inline Tile goldenTile(const MapInfo& info, std::uint32_t face, std::uint32_t tx,
                       std::uint32_t ty, const PixelMaker& pixel) {
    Tile t;
    std::vector<std::vector<float>> v(info.channels);
    t.begin.push_back(0);
    const std::uint32_t s = info.tileSize;
    for (std::uint32_t y = ty * s; y < info.height && y < (ty + 1) * s; ++y) {
        for (std::uint32_t x = tx * s; x < info.width && x < (tx + 1) * s; ++x) {
            for (const Layer& layer : pixel(face, x, y)) {
                t.z.push_back(layer.z);
                t.n.push_back(layer.n);
                for (std::uint32_t c = 0; c < info.channels; ++c)
                    v[c].push_back(layer.v.empty() ? 0.0f : layer.v[c]);
            }
            t.begin.push_back(static_cast<std::uint32_t>(t.z.size()));
        }
    }
    if (t.z.empty()) return {};
    for (const auto& plane : v)
        t.v.insert(t.v.end(), plane.begin(), plane.end());
    return t;
}

inline ShadowMap goldenMap(const MapInfo& info,
                           const std::vector<Projection>& projections,
                           const PixelMaker& pixel) {
    std::vector<MapFace> faces;
    for (const Projection& projection : projections) {
        MapFace face;
        face.projection = projection;
        const auto index = static_cast<std::uint32_t>(faces.size());
        for (std::uint32_t ty = 0; ty * info.tileSize < info.height; ++ty) {
            for (std::uint32_t tx = 0; tx * info.tileSize < info.width; ++tx)
                face.tiles.push_back(goldenTile(info, index, tx, ty, pixel));
        }
        faces.push_back(std::move(face));
    }
    auto map = ShadowMap::create(info, std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return *std::move(map);
}

// --- the maps, one per feature
// -------------------------------------------------------------

/// The worked example of the specification: one opaque layer.
inline Golden onePixel() {
    MapInfo info = goldenInfo(1, 1, 8);
    info.light.radius = 0.5;
    info.light.shape = LightShape::disk;
    info.software = "hand";
    info.samples = 1;
    return {"one_pixel", goldenMap(info, {goldenProjection(info)}, [](auto, auto, auto) {
                return Pixel{{2.5f, {}, 1}};
            })};
}

/// As a bake without a bias of its own writes it: the z threshold grows with depth.
inline Golden biasPerDepth() {
    MapInfo info = goldenInfo(8, 8, 8);
    info.biasPerDepth = 0.001953125f;
    return {"bias_per_depth",
            goldenMap(info, {goldenProjection(info)}, [](auto, auto x, auto y) {
                return Pixel{{2.0f + float(x + y) / 16.0f, {}, 1}};
            })};
}

inline Golden emptyMap() {
    const MapInfo info = goldenInfo(20, 12, 8);
    return {"empty", goldenMap(info, {goldenProjection(info)},
                               [](auto, auto, auto) { return Pixel(); })};
}

/// Two smooth sheets that overlap, one of them torn; one tile is empty.
inline Pixel sheets(std::uint32_t x, std::uint32_t y) {
    Pixel layers;
    if (x >= 16 && y >= 8) return layers;
    if ((x + y) % 7 != 0) layers.push_back({4.0f + float(x * x + 3 * y) / 64.0f, {}, 1});
    if (x > 4) layers.push_back({20.0f + float(x) / 4.0f - float(y * y) / 128.0f, {}, 1});
    return layers;
}

inline Golden opaque() {
    MapInfo info = goldenInfo(24, 16, 8);
    info.maxLayers = 2;
    info.bias = 0.125f;
    info.samples = 700;
    info.samplesDropped = 3;
    return {"opaque", goldenMap(info, {goldenProjection(info)},
                                [](auto, auto x, auto y) { return sheets(x, y); })};
}

/// Glass, smoke and walls behind each other: visibility that falls to zero and starts
/// again.
inline ShadowMap transparentMap() {
    MapInfo info = goldenInfo(16, 16, 16);
    info.resets = 2;
    info.toleranceAsked = 0.02f;
    info.toleranceReached = 0.015625f;
    info.settings = "--resets 2 --tolerance 0.02";
    Numbers numbers(7);
    return goldenMap(info, {goldenProjection(info)}, [&](auto, auto x, auto y) {
        Pixel p;
        if (x == 0) return p;
        p.push_back({1.0f + float(x + y) / 32.0f, {1.0f - float(x) / 32.0f}, 1 + x % 3});
        p.push_back({3.0f, {float(numbers.below(16)) / 32.0f}, 1});
        p.push_back({3.0f, {y == 9 ? -0.0f : 0.0f}, 200});  // a wall, then a reset
        if (y % 2) p.push_back({8.5f, {0.75f}, 2});
        if (y % 4 == 3) p.push_back({9.5f, {0.0f}, 1});
        return p;
    });
}
inline Golden transparentResets() {
    return {"transparent_resets", transparentMap()};
}
inline Golden codecNone() {
    return {"codec_none", transparentMap(), Codec::none};
}

/// Hair and smoke in front of a wall: the visibility rule of media. With a wall behind
/// what lets light through, runs of several samples, one that ends dark, layers that take
/// nothing.
inline Golden media() {
    MapInfo info = goldenInfo(12, 10, 8);
    info.translucent = Translucent::media;
    info.biasPerDepth = 0.00390625f;
    Numbers numbers(17);
    return {"media", goldenMap(info, {goldenProjection(info)}, [&](auto, auto x, auto y) {
                Pixel p;
                float z = 2.0f, v = 1.0f;
                for (std::uint32_t i = numbers.below(5); i > 0; --i) {
                    z += float(1 + numbers.below(256)) / 128.0f;
                    v *= float(48 + numbers.below(17)) / 64.0f;
                    p.push_back({z, {v}, 1 + numbers.below(9)});
                }
                if ((x + y) % 3 == 0) p.push_back({z + 0.5f, {0.0f}, 7});
                if (y > 4) p.push_back({20.0f + float(x) / 8.0f, {0.0f}, 1});
                return p;
            })};
}

/// A cube of views around a light that lies within the casters.
inline Golden sixFaces() {
    MapInfo info = goldenInfo(8, 8, 8);
    info.light.shape = LightShape::sphere;
    info.light.radius = 0.25;
    const glm::dvec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    std::vector<Projection> faces;
    for (int f = 0; f < 6; ++f) {
        Projection p = goldenProjection(info);
        p.eye = info.light.position;
        p.scale = {4.0, -4.0};  // 90 degrees
        p.forward = axes[f / 2] * (f % 2 ? -1.0 : 1.0);
        p.up = axes[(f / 2 + 1) % 3];
        p.right = glm::dvec3(p.forward.y * p.up.z - p.forward.z * p.up.y,
                             p.forward.z * p.up.x - p.forward.x * p.up.z,
                             p.forward.x * p.up.y - p.forward.y * p.up.x);
        faces.push_back(p);
    }
    return {"six_faces", goldenMap(info, faces, [](auto face, auto x, auto y) {
                Pixel p;
                if (face == 4 || x < face) return p;
                p.push_back({2.0f + float(face), {}, 1});
                if (y == 3) p.push_back({1e9f, {}, 1});
                return p;
            })};
}

/// Coloured glass, each channel filtered as suits it: constant, smooth, noisy.
inline Golden threeChannels() {
    MapInfo info = goldenInfo(20, 17, 32);
    info.channels = 3;
    info.light.shape = LightShape::rect;
    info.light.size = {2.0, 0.5};
    Numbers numbers(11);
    return {"three_channels",
            goldenMap(info, {goldenProjection(info)}, [&](auto, auto x, auto y) {
                const float smooth = 1.0f - float(x * 5 + y * 3) / 256.0f;
                const float noisy = float(1 + numbers.below(1u << 20)) / float(1u << 20);
                Pixel p = {{5.0f, {0.5f, smooth, noisy}, 1}};
                if (x % 2) p.push_back({6.0f + float(y), {0.5f, smooth / 2, 0.0f}, 3});
                return p;
            })};
}

/// Sides that are no multiple of anything, a parallel light, large counts of samples.
inline Golden oddSize() {
    MapInfo info = goldenInfo(37, 19, 16);
    info.light.shape = LightShape::sun;
    info.light.direction = {0.0, -0.8, -0.6};
    info.light.angularDiameter = 0.00925;
    info.resets = kAllResets;
    info.maxLayers = 5;
    info.metresPerUnit = 0.01;
    info.castersClipped = true;
    info.samples = 0xfedcba9876543210u;
    info.bias = std::numeric_limits<float>::denorm_min();
    Projection p = goldenProjection(info);
    p.kind = ProjectionKind::orthographic;
    p.eye = {1e7, -1.0 / 3.0, -0.0};
    p.near = 0.1;
    p.far = 1e9;
    Numbers numbers(13);
    return {"odd_size", goldenMap(info, {p}, [&](auto, auto x, auto y) {
                Pixel layers;
                float z = 0x1p-20f * float(1 + numbers.below(64));
                for (std::uint32_t i = numbers.below(4); i > 0; --i) {
                    z += float(numbers.below(1000)) / 8.0f;
                    // Tiles with n of one, two and four bytes.
                    const std::uint32_t most = x < 16 ? 4 : x < 32 ? 300 : 0xffffffffu;
                    layers.push_back({z, {}, 1 + numbers.below(most)});
                    if (x >= 32 && y == 0) layers.back().n = 0xffffffffu;
                }
                return layers;
            })};
}

/// A pixel of 300 layers beside one of none: counts of two bytes.
inline Golden deepPixel() {
    const MapInfo info = goldenInfo(3, 2, 8);
    return {"deep_pixel",
            goldenMap(info, {goldenProjection(info)}, [](auto, auto x, auto y) {
                Pixel p;
                if (x == 1 && y == 1) {
                    for (int i = 0; i < 300; ++i)
                        p.push_back({1.0f + float(i / 2), {float(300 - i) / 300.0f}, 1});
                }
                if (x == 2) p.push_back({2.0f, {}, 1});
                return p;
            })};
}

/// Triangles beside the layers: more than one part of chunks in one face, few triangles
/// in another, none in the rest; corners shared and not, steps of zero.
inline Golden nearField() {
    const Golden six = sixFaces();
    std::vector<MapFace> faces;
    for (std::uint32_t f = 0; f < six.map.faceCount(); ++f)
        faces.push_back({six.map.projection(f), {six.map.tile(f, 0, 0)}, {}, {}});
    Numbers numbers(19);
    for (int i = 0; i < 1030; ++i) {
        NearChunk chunk;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.step[axis] = axis == 2 ? 0x1p-16f : i % 7 == 3 ? 0.0f : 0x1p-8f;
            chunk.low[axis] = float(int(numbers.below(4096)) - 512) * 0x1p-8f;
        }
        for (std::uint32_t t = 0; t < NearChunk::kTriangles; ++t) {
            // A strip; in every third chunk triangles by themselves.
            for (std::uint32_t c = 0; c < 3; ++c) {
                const std::uint32_t n = i % 3 == 2 ? 3 * t + c : t + c;
                chunk.corner[c][0][t] = std::uint16_t(300 * n + std::uint32_t(i));
                chunk.corner[c][1][t] = std::uint16_t(n % 2 ? 65535 - 9 * n : 200 * n);
                chunk.corner[c][2][t] = std::uint16_t(n * n * 7 + std::uint32_t(i) % 5);
            }
        }
        faces[1].nearField.chunks.push_back(chunk);
    }
    NearChunk one;  // a single triangle, repeated
    one.low[2] = 0.25f;
    one.step[0] = one.step[1] = 0x1p-5f;
    for (int t = 0; t < NearChunk::kTriangles; ++t) {
        one.corner[1][0][t] = 65535;
        one.corner[2][1][t] = 65535;
    }
    faces[4].nearField.chunks.push_back(one);
    auto map = ShadowMap::create(six.map.info(), std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return {"near_field", *std::move(map)};
}

/// Strands: parts of 1024 chunks, and one by itself in another face.
inline Golden nearHair() {
    const Golden six = sixFaces();
    std::vector<MapFace> faces;
    for (std::uint32_t f = 0; f < six.map.faceCount(); ++f)
        faces.push_back({six.map.projection(f), {six.map.tile(f, 0, 0)}, {}, {}});
    Numbers numbers(23);
    for (int i = 0; i < 1026; ++i) {
        NearHairChunk chunk;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.step[axis] = axis == 2 ? 0x1p-16f : i % 7 == 3 ? 0.0f : 0x1p-8f;
            chunk.low[axis] = float(int(numbers.below(4096)) - 512) * 0x1p-8f;
        }
        chunk.halfStep = i % 5 == 4 ? 0.0f : float(1 + i) * 0x1p-20f;
        for (std::uint32_t t = 0; t < NearHairChunk::kSegments; ++t) {
            for (std::uint32_t axis = 0; axis < 3; ++axis) {
                // A strand; in every third chunk segments by themselves.
                const std::uint32_t n = i % 3 == 2 ? 5 * t : t;
                chunk.end[0][axis][t] = std::uint16_t(900 * n * (axis + 1));
                chunk.end[1][axis][t] = std::uint16_t(900 * (n + 1) * (axis + 1));
            }
            chunk.half[0][t] = std::uint8_t(255 - t);
            chunk.half[1][t] = std::uint8_t(250 - 3 * t);
            chunk.opacity[t] = std::uint16_t(i % 2 ? 26214 : numbers.below(65536));
        }
        faces[2].nearHair.chunks.push_back(chunk);
    }
    NearHairChunk one;  // a single segment
    one.low[2] = 0.25f;
    one.step[0] = one.step[1] = 0x1p-5f;
    one.halfStep = 0x1p-9f;
    one.end[1][0][0] = one.opacity[0] = 65535;
    one.half[0][0] = one.half[1][0] = 255;
    faces[5].nearHair.chunks.push_back(one);
    auto map = ShadowMap::create(six.map.info(), std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return {"near_hair", *std::move(map)};
}

/// Near sheets: more than one part, three textures, chunks of fewer than 16.
inline Golden nearSheets() {
    const Golden six = opaque();
    std::vector<MapFace> faces;
    faces.push_back({six.map.projection(0), {}, {}, {}, {}});
    for (std::uint32_t y = 0; y < six.map.tilesY(); ++y) {
        for (std::uint32_t x = 0; x < six.map.tilesX(); ++x)
            faces[0].tiles.push_back(six.map.tile(0, x, y));
    }
    Numbers numbers(29);
    NearSheets& near = faces[0].nearSheets;
    near.textures.resize(3);
    near.textures[0].opacity = 0.4f;
    for (std::uint32_t i = 1; i < 3; ++i) {
        NearTexture& texture = near.textures[i];
        texture.width = 3 + 29 * (i - 1), texture.height = 2 + 15 * (i - 1);
        texture.wrapU = TextureWrap::mirror, texture.wrapV = TextureWrap::clamp;
        texture.cutoff = i == 1 ? 0.5f : -1.0f;
        texture.texels.clear();
        for (std::uint32_t k = 0; k < texture.width * texture.height; ++k)
            texture.texels.push_back(std::uint8_t(i == 1 ? numbers.below(256) : k / 8));
    }
    for (std::uint32_t i = 0; i < 1026; ++i) {
        NearChunk chunk;
        NearSheetChunk coordinates;
        coordinates.texture = i % 3;
        coordinates.triangles = i % 5 == 4 ? 1 + i % 16 : 16;
        for (int axis = 0; axis < 3; ++axis) {
            chunk.step[axis] = axis == 2 ? 0x1p-16f : 0x1p-8f;
            chunk.low[axis] = float(int(numbers.below(4096)) - 512) * 0x1p-8f;
        }
        for (int axis = 0; axis < 2; ++axis) {
            coordinates.step[axis] = i % 3 ? 0x1p-15f : 0.0f;
            coordinates.low[axis] = float(int(numbers.below(64)) - 32) * 0x1p-3f;
        }
        for (std::uint32_t t = 0; t < 16; ++t) {
            for (std::uint32_t c = 0; c < 3; ++c) {
                for (std::uint32_t axis = 0; axis < 3; ++axis)
                    chunk.corner[c][axis][t] =
                        std::uint16_t(600 * (t / 2 + c) * (axis + 1));
                for (std::uint32_t axis = 0; axis < 2; ++axis)
                    coordinates.uv[c][axis][t] =
                        std::uint16_t(c == axis ? 32768 : i % 7 * t);
            }
        }
        near.triangles.chunks.push_back(chunk);
        near.chunks.push_back(coordinates);
    }
    auto map = ShadowMap::create(six.map.info(), std::move(faces));
    if (!map) throw std::runtime_error(map.error().message);
    return {"near_sheets", *std::move(map)};
}

/// Smoke of which neighbouring pixels say nothing and neighbouring layers much, with
/// depths and visibilities of few bits, as a bake rounds them.
inline Golden rounded() {
    MapInfo info = goldenInfo(16, 16, 16);
    info.translucent = Translucent::media;
    info.attributes = {{"rounding", std::vector<double>{0.015625}}};
    Numbers numbers(19);
    return {"rounded", goldenMap(info, {goldenProjection(info)}, [&](auto, auto, auto) {
                Pixel p;
                float z = 4.0f + float(numbers.below(4096)) / 2048.0f, v = 1.0f;
                for (std::uint32_t i = 3 + numbers.below(6); i > 0; --i) {
                    z += float(1 + numbers.below(16)) / 2048.0f;
                    v -= float(1 + numbers.below(16)) / 1024.0f;
                    p.push_back({z, {v}, 1});
                }
                return p;
            })};
}

inline Golden attributes() {
    MapInfo info = goldenInfo(2, 2, 8);
    info.settings = "quote \" backslash \\ newline \n moon \xf0\x9f\x8c\x92";
    const auto nan = std::bit_cast<double>(0x7ff800000000beefu);
    info.attributes = {
        {"shot", std::string("sq010_sh0040")},
        {"empty text", std::string()},
        {"zero byte", std::string("a\0b", 3)},
        {"\xc3\xa9t\xc3\xa9", std::string("\xe2\x98\x80")},
        {"frame", std::int64_t(-7)},
        {"lowest", std::numeric_limits<std::int64_t>::min()},
        {"no numbers", std::vector<double>{}},
        {"numbers", std::vector<double>{0.1, -0.0, 5e-324, 1.7976931348623157e308,
                                        std::numeric_limits<double>::infinity(), nan}},
        {std::string(255, 'x'), std::int64_t(1)}};
    return {"attributes",
            goldenMap(info, {goldenProjection(info)}, [](auto, auto x, auto y) {
                return Pixel{{1.0f + float(x), {}, 1 + y}};
            })};
}

inline std::vector<Golden> goldenMaps() {
    std::vector<Golden> all;
    all.push_back(onePixel());
    all.push_back(biasPerDepth());
    all.push_back(emptyMap());
    all.push_back(opaque());
    all.push_back(transparentResets());
    all.push_back(codecNone());
    all.push_back(media());
    all.push_back(sixFaces());
    all.push_back(threeChannels());
    all.push_back(oddSize());
    all.push_back(deepPixel());
    all.push_back(attributes());
    all.push_back(nearField());
    all.push_back(nearHair());
    all.push_back(nearSheets());
    all.push_back(rounded());
    all.push_back({"tree_patches", opaque().map, Codec::zstd, true});
    all.push_back({"tree_densities", media().map, Codec::zstd, true});
    return all;
}

}  // namespace mtsm::test
