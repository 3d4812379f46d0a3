// Bakes of every kind that let go of their layers: fast queries stay the same to the last
// bit, and all others have an answer.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <vector>

#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "mtsm/reader.h"
#include "mtsm/shadow.h"
#include "mtsm/writer.h"
#include "random.h"
#include "shadow/released.h"
#include "trace/density_tree.h"

using namespace mtsm;
using test::Random, test::released, test::sameBits;

namespace {

struct Kind {
    const char* name;
    bool body, glass, hair, fog;
    bool cube = false, color = false;
};

constexpr Kind kKinds[] = {
    {"opaque", true, false, false, false},
    {"opaque, six faces", true, false, false, false, true},
    {"sheets", true, true, false, false},
    {"sheets in colour", true, true, false, false, false, true},
    {"sheets, six faces", true, true, false, false, true},
    {"hair", false, false, true, false},
    {"hair and a body", true, false, true, false},
    {"fog and a body", true, false, false, true},
    {"hair and fog, six faces", false, false, true, true, true},
};

AreaLight lightOf(const Kind& kind, LightShape shape) {
    AreaLight light;
    light.shape = kind.cube ? LightShape::sphere : shape;
    light.position = kind.cube ? glm::dvec3(0.0) : glm::dvec3(1.5, 5, 2);
    light.direction = glm::normalize(-glm::dvec3(1.5, 5, 2));
    light.radius = 0.3;
    light.angularDiameter = 0.1;
    return light;
}

/// Around the origin, or in a cube map to one side of it.
ShadowMap bakeOf(const Kind& kind, LightShape shape, bool nearField) {
    const glm::vec3 at = kind.cube ? glm::vec3(2, 1, 1.8) : glm::vec3(0.0f);
    test::Mesh body = test::bumpyBody(4000), pane;
    for (glm::vec3& p : body.positions)
        p += at;
    pane.positions = {
        {-1.5f, 1.2f, -1}, {1.5f, 1.3f, -1}, {1.5f, 1.2f, 1}, {-1.5f, 1, 1}};
    for (glm::vec3& p : pane.positions)
        p += at;
    pane.indices = {0, 1, 2, 0, 2, 3};
    MeshView glass = pane.view();
    glass.opacity = 0.4f;
    if (kind.color) glass.tint = {1.0f, 0.5f, 0.2f};

    Random random(7);
    std::vector<glm::vec3> strands;
    std::vector<std::uint32_t> begin = {0};
    for (int i = 0; i < 1500; ++i) {
        const glm::dvec3 root = random.direction();
        for (int k = 0; k < 4; ++k)
            strands.push_back(glm::vec3(root * (1.0 + 0.12 * k)) + at);
        begin.push_back(std::uint32_t(strands.size()));
    }
    StrandsView hair;
    hair.points = strands.data();
    hair.begin = begin.data();
    hair.strandCount = begin.size() - 1;
    hair.width = 0.02f;
    hair.opacity = 0.6f;

    const glm::ivec3 block(0, 0, 0);
    const std::vector<float> density(VolumeView::kBlockVoxels, 1.0f);
    VolumeView fog;
    fog.blocks = &block;
    fog.blockCount = 1;
    fog.density = density.data();
    fog.worldFromIndex[0] *= 0.3;
    fog.worldFromIndex[1] *= 0.3;
    fog.worldFromIndex[2] *= 0.3;
    fog.worldFromIndex[3] = glm::dvec4(glm::dvec3(at) + glm::dvec3(-1.0, 1.0, -1.0), 1.0);
    fog.extinction = 0.5f;

    std::vector<CasterView> views;
    if (kind.body) views.push_back(body.view());
    if (kind.glass) views.push_back(glass);
    if (kind.hair) views.push_back(hair);
    if (kind.fog) views.push_back(fog);
    CasterViews casters(std::move(views));
    BakeOptions options;
    options.light = lightOf(kind, shape);
    options.cube = kind.cube;
    options.color = kind.color;
    options.width = options.height = kind.cube ? 64 : 128;
    options.nearField = nearField ? kAutomaticNearField : 0;
    auto baked = bake(casters, options);
    if (!baked) FAIL(baked.error().message);
    return std::move(baked->map);
}

/// Written with its trees and read again.
ShadowMap throughFile(const ShadowMap& map, bool layers) {
    WriteOptions options;
    options.trees = true;
    const auto bytes = encodeMap(map, options);
    if (!bytes) FAIL(bytes.error().message);
    ReadLimits limits;
    limits.layers = layers;
    auto read = readMap(bytes->data(), bytes->size(), "t.mtsm", limits);
    if (!read) FAIL(read.error().message);
    return *std::move(read);
}

struct Points {
    std::vector<glm::dvec3> at, normals;
};

/// In, on and below the casters; some points and normals are none.
Points around(Random& random, const Kind& kind, int count) {
    const glm::dvec3 centre = kind.cube ? glm::dvec3(2, 1, 1.8) : glm::dvec3(0.0);
    Points points;
    for (int i = 0; i < count; ++i) {
        const glm::dvec3 d = random.direction();
        const bool onFloor = i % 2 == 0 && !kind.cube;
        points.at.push_back(onFloor
                                ? glm::dvec3(random.in(-3, 3), -1.3, random.in(-3, 3))
                                : centre * random.in(1, 1.8) + d * random.in(0.9, 1.3));
        points.normals.push_back(i % 5 == 0 ? glm::dvec3(0.0)
                                 : onFloor  ? glm::dvec3(0, 1, 0)
                                            : d);
    }
    points.at[7].x = NAN;
    points.normals[11].y = INFINITY;
    return points;
}

struct Answers {
    std::vector<glm::vec3> factors;
    std::vector<float> errors;
    QueryStats stats;
};

Answers ask(const ShadowMap& map, const AreaLight& light, const Points& points,
            bool normals, const ShadowOptions& options) {
    Answers a;
    a.factors.resize(points.at.size());
    a.errors.resize(points.at.size());
    shadowFactorsColor(map, light, points.at.data(),
                       normals ? points.normals.data() : nullptr, points.at.size(),
                       a.factors.data(), options, &a.stats, a.errors.data());
    return a;
}

std::vector<float> follow(const ShadowMap& map, const std::vector<ShadowRay>& rays,
                          const RayOptions& options) {
    std::vector<float> out(rays.size(), -1.0f);
    visibilities(map, rays.data(), rays.size(), out.data(), options);
    return out;
}

/// Down to the casters and away from them, none of them level with a face.
std::vector<ShadowRay> steepRays(Random& random, const Kind& kind, int count) {
    const glm::dvec3 centre = kind.cube ? glm::dvec3(2, 1, 1.8) : glm::dvec3(0.0);
    std::vector<ShadowRay> rays;
    for (int i = 0; i < count; ++i) {
        const glm::dvec3 from = centre + random.within(0.5) - glm::dvec3(0, 2, 0);
        const glm::dvec3 to = centre + random.within(0.5) + glm::dvec3(0.3, 2, 0.4);
        rays.push_back({from, glm::normalize(to - from), glm::length(to - from)});
    }
    return rays;
}

}  // namespace

TEST_CASE(
    "without its layers, or with trees from a file, a map answers to the last bit what "
    "it did",
    "[shadow][exact]") {
    for (const Kind& kind : kKinds) {
        for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
            if (kind.cube && shape == LightShape::sun) continue;
            for (const bool nearField : {false, true}) {
                INFO(kind.name << " " << name(shape) << " near field " << nearField);
                const ShadowMap map = bakeOf(kind, shape, nearField);
                const ShadowMap bare = released(map);
                const ShadowMap fromFile = throughFile(map, false);
                CHECK_FALSE(fromFile.hasLayers());
                CHECK(queryMemoryBytes(fromFile) == queryMemoryBytes(bare));
                const ShadowMap whole = throughFile(map, true);
                CHECK(identical(map, whole));
                const AreaLight light = lightOf(kind, shape);
                Random random(3);
                const Points points = around(random, kind, 400);
                double dark = 0.0;
                for (int way = 0; way < 5; ++way) {
                    ShadowOptions options;
                    options.samples = way == 0 ? 16 : 64;
                    options.adaptive = way == 2;
                    options.targetError = way == 3 ? 0.02f : 0.0f;
                    options.weight = way == 4 ? Weight::cosine : Weight::uniform;
                    const Answers a = ask(map, light, points, way != 1, options);
                    for (const ShadowMap* const other : {&bare, &fromFile, &whole}) {
                        const Answers b = ask(*other, light, points, way != 1, options);
                        CHECK(sameBits(a.factors, b.factors));
                        CHECK(sameBits(a.errors, b.errors));
                        CHECK(a.stats.rays == b.stats.rays);
                        CHECK(a.stats.points == b.stats.points);
                    }
                    for (const glm::vec3 f : a.factors)
                        dark += double(f.x) / double(5 * a.factors.size());
                    const glm::vec3 alone = shadowFactorColor(
                        bare, light, points.at[21],
                        way != 1 ? points.normals[21] : glm::dvec3(0.0), options);
                    CHECK(alone == a.factors[21]);
                }
                CHECK(dark > 0.02);
                CHECK(dark < 0.98);
                RayOptions rays;
                rays.spread = 0.01f;
                const std::vector<ShadowRay> steep = steepRays(random, kind, 300);
                const std::vector<float> a = follow(map, steep, rays);
                const std::vector<float> b = follow(bare, steep, rays);
                CHECK(sameBits(follow(fromFile, steep, rays), b));
                CHECK(sameBits(follow(whole, steep, rays), a));
                if (!map.nearHair(0).empty() || !map.nearSheets(0).empty()) {
                    // Through the trees of receivers, whose finest texels are coarser.
                    double away = 0.0;
                    for (std::size_t i = 0; i < a.size(); ++i)
                        away += double(b[i] - a[i]) / double(a.size());
                    CHECK(std::abs(away) < 0.05);
                    continue;
                }
                if (!kind.cube) CHECK(sameBits(a, b));
                // Of a cube's faces a ray is level with some that it passes.
                int different = 0;
                for (std::size_t i = 0; i < a.size(); ++i) {
                    different += a[i] != b[i];
                    CHECK(std::abs(a[i] - b[i]) < 0.05f);
                }
                CHECK(different < 15);
            }
        }
    }
}

TEST_CASE("memory without layers is less by what they took, and copies are their own",
          "[shadow][threads]") {
    for (const Kind& kind : kKinds) {
        INFO(kind.name);
        const ShadowMap map = bakeOf(kind, LightShape::disk, true);
        const std::uint64_t before = queryMemoryBytes(map), layers = map.memoryBytes();
        ShadowMap bare = map;
        REQUIRE(releaseLayers(bare));
        std::uint64_t arrays = 0;
        for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
            for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
                for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx) {
                    const Tile& t = map.tile(f, tx, ty);
                    arrays += 4 * (t.begin.size() + t.z.size() + t.v.size() + t.n.size());
                    CHECK(bare.tile(f, tx, ty).begin.capacity() == 0);
                    CHECK(bare.tile(f, tx, ty).z.capacity() == 0);
                }
            }
        }
        CHECK(queryMemoryBytes(bare) <= before - arrays);
        CHECK(layers - bare.memoryBytes() == before - queryMemoryBytes(bare));
        CHECK(bare.layerCount() == map.layerCount());
        CHECK(bare.isOpaque() == map.isOpaque());
        CHECK(map.hasLayers());
        CHECK(queryMemoryBytes(map) == before);
        const ShadowMap copy = bare;
        CHECK(!copy.hasLayers());
        CHECK(releaseLayers(bare));  // again
        CHECK(queryMemoryBytes(bare) == queryMemoryBytes(copy));
    }
}

TEST_CASE("trees that rays beside near media made are counted, and go with the layers",
          "[shadow][threads]") {
    for (const Kind& kind : kKinds) {
        INFO(kind.name);
        const ShadowMap map = bakeOf(kind, LightShape::disk, true);
        if (map.isOpaque()) continue;
        ShadowMap other = map;  // shares what queries make
        ShadowMap bare = bakeOf(kind, LightShape::disk, true);
        REQUIRE(releaseLayers(bare));
        const std::uint64_t before = queryMemoryBytes(map);
        Random random(3);
        const auto rays = steepRays(random, kind, 20);
        follow(map, rays, {});
        const auto* const trees = trace::densityTrees(map, trace::DensityUse::rays);
        REQUIRE(trees);
        std::uint64_t made = 0;
        for (const trace::DensityTree& tree : *trees)
            made += trace::hasNearMedia(map) ? tree.memoryBytes() : 0;
        CHECK(queryMemoryBytes(map) == before + made);
        REQUIRE(releaseLayers(other));
        CHECK(queryMemoryBytes(other) == queryMemoryBytes(bare));
        CHECK(queryMemoryBytes(map) == before + made);
        CHECK(follow(other, rays, {}) == follow(bare, rays, {}));
    }
}

TEST_CASE("texels of near sheets go with the layers", "[shadow]") {
    constexpr Kind kind = {"glass", false, true, false, false};
    const ShadowMap map = bakeOf(kind, LightShape::disk, true);
    REQUIRE(map.nearSheets(0).textures.size() == 1);
    ShadowMap bare = map;
    REQUIRE(releaseLayers(bare));
    const std::size_t texels = map.nearSheets(0).textures[0].texels.size();
    CHECK(texels > 0);
    CHECK(bare.nearSheets(0).textures[0].texels.empty());
    CHECK(memoryBytes(bare.nearSheets(0)) == memoryBytes(map.nearSheets(0)) - texels);
}

TEST_CASE("unchecked, what needs layers is answered as by trace", "[shadow]") {
    for (const Kind& kind : kKinds) {
        INFO(kind.name);
        const ShadowMap bare = released(bakeOf(kind, LightShape::disk, true));
        const AreaLight light = lightOf(kind, LightShape::disk);
        Random random(5);
        const Points points = around(random, kind, 100);
        ShadowOptions options;
        const Answers traced = ask(bare, light, points, true, options);
        for (int way = 0; way < 3; ++way) {
            options = {};
            if (way == 0) options.method = ShadowMethod::scalar;
            if (way == 1) options.method = ShadowMethod::pcf;
            if (way == 2) options.attenuation = Attenuation::subtract;
            CHECK(sameBits(ask(bare, light, points, true, options).factors,
                           traced.factors));
        }
        const std::vector<ShadowRay> rays = steepRays(random, kind, 100);
        RayOptions scalar;
        scalar.method = ShadowMethod::scalar;
        scalar.attenuation = Attenuation::subtract;
        CHECK(sameBits(follow(bare, rays, scalar), follow(bare, rays, {})));
        // A sun where six faces have none: an answer, whatever it is worth.
        AreaLight sun = light;
        sun.shape = LightShape::sun;
        for (const glm::vec3 f : ask(bare, sun, points, true, {}).factors)
            CHECK((f.x >= 0.0f && f.x <= 1.0f));
    }
}

TEST_CASE("points and rays that went by the definition go through the trees alike",
          "[shadow][statistical]") {
    for (const Kind& kind : kKinds) {
        for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
            if (kind.cube && shape == LightShape::sun) continue;
            INFO(kind.name << " " << name(shape));
            const ShadowMap map = bakeOf(kind, shape, false), bare = released(map);
            const AreaLight light = lightOf(kind, shape);
            Random random(9);
            // In the casters' shadow, but further than 8 windows from the axis; and
            // where there is nothing between them and the light.
            Points far;
            const glm::dvec3 centre = kind.cube ? glm::dvec3(2, 1, 1.8) : glm::dvec3(0.0);
            for (int i = 0; i < 60; ++i) {
                const double angle = random.in(0, 6.28), r = random.in(150, 1e5);
                far.at.push_back({r * std::cos(angle), -1.3, r * std::sin(angle)});
                far.at.push_back(0.95 * light.position + 0.05 * centre +
                                 random.within(0.05));
                far.normals.resize(far.at.size(), glm::dvec3(0, 1, 0));
            }
            for (const bool normals : {true, false}) {
                ShadowOptions options;
                options.samples = 32;
                const Answers a = ask(map, light, far, normals, options);
                const Answers b = ask(bare, light, far, normals, options);
                for (std::size_t i = 0; i < far.at.size(); ++i) {
                    INFO(i);
                    CHECK(std::abs(a.factors[i].x - b.factors[i].x) < 0.05f);
                }
            }
            // Without a spread, level ones among them.
            std::vector<ShadowRay> rays = steepRays(random, kind, 500);
            const Projection& p = map.projection(0);
            for (int i = 0; i < 300; ++i) {
                const glm::dvec3 across =
                    glm::normalize(random.in(-1, 1) * p.right + random.in(-1, 1) * p.up);
                rays.push_back({centre + random.within(0.7) - 2.0 * across,
                                across + 1e-7 * random.within(1.0), 4.0});
            }
            double away = 0.0, dark = 0.0;
            const std::vector<float> a = follow(map, rays, {}),
                                     b = follow(bare, rays, {});
            for (std::size_t i = 0; i < rays.size(); ++i) {
                away += std::abs(a[i] - b[i]) / double(rays.size());
                dark += (1.0 - a[i]) / double(rays.size());
            }
            CHECK(dark > 0.1);
            CHECK(away < (map.isOpaque() ? 0.05 : 0.01));
        }
    }
}
