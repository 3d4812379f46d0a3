// Batches of bakes whose rays go through near fields of several kinds.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <optional>
#include <vector>

#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"
#include "random.h"

using namespace mtsm;

namespace {

/// Sixty cards, each a disk that is cut out by a texture.
struct Cards {
    test::Mesh mesh;
    std::vector<glm::vec2> uvs;
    std::optional<OpacityTexture> texture;

    Cards() {
        for (int k = 0; k < 60; ++k) {
            const float x = -1.0f + 2.0f * float(k * 37 % 60) / 60.0f;
            const float z = -1.0f + 2.0f * float(k * 23 % 60) / 60.0f;
            const float y = 0.6f + 0.8f * float(k * 11 % 60) / 60.0f;
            const auto first = std::uint32_t(mesh.positions.size());
            mesh.positions.insert(mesh.positions.end(),
                                  {{x - 0.2f, y - 0.05f, z - 0.2f},
                                   {x + 0.2f, y + 0.1f, z - 0.2f},
                                   {x + 0.2f, y + 0.1f, z + 0.2f},
                                   {x - 0.2f, y - 0.05f, z + 0.2f}});
            uvs.insert(uvs.end(), {{0, 0}, {1, 0}, {1, 1}, {0, 1}});
            for (const std::uint32_t i : {0u, 1u, 2u, 0u, 2u, 3u})
                mesh.indices.push_back(first + i);
        }
        OpacityImage image;
        image.width = image.height = 16;
        image.cutoff = 0.5f;
        for (int y = -8; y < 8; ++y) {
            for (int x = -8; x < 8; ++x)
                image.texels.push_back(x * x + y * y < 30 ? 1.0f : 0.0f);
        }
        texture = *OpacityTexture::create(std::move(image));
    }
    [[nodiscard]] MeshView view() const {
        MeshView view = mesh.view();
        view.uvs = uvs.data();
        view.texture = &*texture;
        return view;
    }
};

}  // namespace

TEST_CASE("cards that are cut out are answered the same alone and in a batch",
          "[shadow][exact]") {
    const Cards cards;
    CasterViews casters({cards.view()});
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.radius = 0.5;
    options.light.position = {0, 4, 0};
    options.light.direction = {0, -1, 0};
    options.light.up = {0, 0, 1};
    options.width = options.height = 256;
    options.nearField = kAutomaticNearField;
    const auto baked = bake(casters, options);
    REQUIRE(baked);
    REQUIRE(baked->map.isOpaque());
    REQUIRE_FALSE(baked->map.nearSheets(0).empty());

    std::vector<glm::dvec3> points, normals(64, {0, 1, 0});
    for (int i = 0; i < 64; ++i)
        points.emplace_back(-0.3 + 0.01 * (i % 8), 0, -0.3 + 0.01 * double(i / 8));
    for (const int samples : {16, 64, 256, 1024}) {
        ShadowOptions query;
        query.samples = samples;
        std::vector<float> batch(points.size());
        shadowFactors(baked->map, options.light, points.data(), normals.data(),
                      points.size(), batch.data(), query);
        int different = 0;
        double mean = 0.0;
        for (std::size_t i = 0; i < points.size(); ++i) {
            float alone = -1.0f;
            shadowFactors(baked->map, options.light, &points[i], &normals[i], 1, &alone,
                          query);
            different += std::memcmp(&alone, &batch[i], sizeof alone) != 0;
            mean += batch[i] / double(points.size());
        }
        INFO(samples << " samples, mean " << mean);
        CHECK(different == 0);
        CHECK(mean > 0.02);
        CHECK(mean < 0.2);
    }
}

TEST_CASE("a crown that a large light stands right beside is no darker with few samples",
          "[shadow][statistical]") {
    // Two thousand small panes that let half of the light through, in clumps.
    test::Random random(11);
    test::Mesh mesh;
    for (int clump = 0; clump < 12; ++clump) {
        const glm::dvec3 middle(random.in(-1, 1), random.in(1, 3), random.in(-1, 1));
        for (int i = 0; i < 170; ++i) {
            const glm::dvec3 at = middle + 0.35 * random.in(0, 1) * random.direction();
            for (int corner = 0; corner < 3; ++corner) {
                mesh.indices.push_back(std::uint32_t(mesh.positions.size()));
                mesh.positions.push_back(glm::vec3(at + 0.12 * random.direction()));
            }
        }
    }
    MeshView panes = mesh.view();
    panes.opacity = 0.5f;
    CasterViews casters({panes});
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.radius = 1.5;
    options.light.position = {2.6, 3, 0};
    options.light.direction =
        glm::normalize(glm::dvec3(0, 2, 0) - options.light.position);
    options.width = options.height = 512;
    std::vector<glm::dvec3> points, normals(900, {0, 1, 0});
    for (int i = 0; i < 900; ++i)
        points.emplace_back(-3.0 + 0.1 * (i % 30), 0, -1.5 + 0.1 * double(i / 30));
    for (const auto nearField : {std::uint64_t(0), kAutomaticNearField}) {
        options.nearField = nearField;
        const auto baked = bake(casters, options);
        REQUIRE(baked);
        const auto meanOf = [&](int samples, ShadowMethod method) {
            ShadowOptions query;
            query.samples = samples;
            query.method = method;
            std::vector<float> found(points.size());
            shadowFactors(baked->map, options.light, points.data(), normals.data(),
                          points.size(), found.data(), query);
            double mean = 0.0;
            for (const float f : found)
                mean += f / double(found.size());
            return mean;
        };
        const double expected = meanOf(256, ShadowMethod::scalar);
        for (const int samples : {4, 16, 64}) {
            const double found = meanOf(samples, ShadowMethod::trace);
            INFO(samples << " samples, near field " << nearField << ": " << found
                         << " for " << expected);
            CHECK(std::abs(found - expected) < 0.015);
        }
    }
}
