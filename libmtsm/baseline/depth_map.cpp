#include "baseline/depth_map.h"

#include <algorithm>
#include <glm/geometric.hpp>
#include <utility>

#include "baseline/opaque_casters.h"

namespace mtsm::baseline {
namespace {

/// Alpha test: what stops this much of the light is there. Less what the division of two
/// floats may take.
constexpr float kThere = 0.5f - 0x1p-20f;

/// Pixels per side of the map that is baked to see where it looks.
constexpr std::uint32_t kAiming = 256;

/// Are there textures that let something through?
Result<bool> anyHoles(CasterSource& casters) {
    bool any = false;
    const Status read = casters.visit(meshesOnly([&](const MeshView& mesh) -> Status {
        any = any || (mesh.texture && mesh.texture->translucent());
        return {};
    }));
    if (!read) return read.error();
    return any;
}

/// Each layer one sample: those that are there, as opaque ones.
Tile alphaTested(const Tile& tile, std::uint32_t layers) {
    Tile tested;
    if (tile.empty()) return tested;
    tested.begin.push_back(0);
    for (std::size_t p = 0; p + 1 < tile.begin.size(); ++p) {
        float before = 1.0f;
        std::uint32_t kept = 0;
        for (std::uint32_t i = tile.begin[p]; i < tile.begin[p + 1] && kept < layers;
             ++i) {
            const float v = tile.v.empty() ? 0.0f : tile.v[i];
            if (1.0f - v / before >= kThere) {
                tested.z.push_back(tile.z[i]);
                ++kept;
            }
            before = v > 0.0f ? v : 1.0f;
        }
        tested.begin.push_back(std::uint32_t(tested.z.size()));
    }
    if (tested.z.empty()) tested.begin.clear();
    return tested;
}

Result<ShadowMap> alphaTested(const ShadowMap& map, std::uint32_t layers) {
    MapInfo info = map.info();
    info.maxLayers = layers;
    std::vector<MapFace> faces(map.faceCount());
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        faces[f].projection = map.projection(f);
        for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
            for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx)
                faces[f].tiles.push_back(alphaTested(map.tile(f, tx, ty), layers));
        }
    }
    return ShadowMap::create(std::move(info), std::move(faces));
}

}  // namespace

Result<BakeOptions> aimedOptions(CasterSource& casters, const BakeOptions& options) {
    BakeOptions aimed = options;
    aimed.aimed = true;
    if (options.aimed || options.light.shape == LightShape::sun) return aimed;
    if (options.target && *options.target != options.light.position) {
        aimed.light.direction = glm::normalize(*options.target - options.light.position);
        return aimed;
    }
    BakeOptions small = options;
    small.width = small.height = kAiming;
    auto baked = bake(casters, small);
    if (!baked) return baked.error();
    const AreaLight& light = baked->map.info().light;
    const bool hasFront =
        light.shape == LightShape::disk || light.shape == LightShape::rect;
    aimed.light.direction = hasFront ? light.direction : baked->map.projection(0).forward;
    return aimed;
}

void setResolutionAndBias(BakeOptions& options, const Settings& settings) {
    options.width = options.height = std::uint32_t(settings.whole("resolution"));
    if (const double bias = settings.number("bias"); bias >= 0.0)
        options.bias = float(bias);
}

Result<ShadowMap> bakeDepthMap(CasterSource& casters, BakeOptions options,
                               std::uint32_t layers) {
    auto holes = anyHoles(casters);
    if (!holes) return holes.error();
    options.tolerance = 0.0f;  // a layer for each sample
    options.resets = kAllResets;
    options.subsamples = 1;
    options.color = false;
    options.layers = layers;
    if (*holes) options.layers = kMaxPixelLayers;
    // Of one layer none is hidden by others.
    options.keepHidden = options.keepHidden || layers == 1;
    OpaqueCasters opaque(casters, eyeOf(options));
    auto baked = bake(opaque, options);
    if (!baked) return baked.error();
    if (!*holes) return std::move(baked->map);
    return alphaTested(baked->map, layers);
}

}  // namespace mtsm::baseline
