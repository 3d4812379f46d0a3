// Batches of bakes whose rays go through near fields of several kinds.
#include <catch2/catch.hpp>
#include <cstring>
#include <optional>
#include <vector>

#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"

using namespace mtsm;

namespace {

/// Sixty cards, each a disk that is cut out by a texture.
struct Cards {
    std::vector<glm::vec3> positions;
    std::vector<glm::vec2> uvs;
    std::vector<std::uint32_t> indices;
    std::optional<OpacityTexture> texture;

    Cards() {
        for (int k = 0; k < 60; ++k) {
            const float x = -1.0f + 2.0f * float(k * 37 % 60) / 60.0f;
            const float z = -1.0f + 2.0f * float(k * 23 % 60) / 60.0f;
            const float y = 0.6f + 0.8f * float(k * 11 % 60) / 60.0f;
            const auto first = std::uint32_t(positions.size());
            positions.insert(positions.end(), {{x - 0.2f, y - 0.05f, z - 0.2f},
                                               {x + 0.2f, y + 0.1f, z - 0.2f},
                                               {x + 0.2f, y + 0.1f, z + 0.2f},
                                               {x - 0.2f, y - 0.05f, z + 0.2f}});
            uvs.insert(uvs.end(), {{0, 0}, {1, 0}, {1, 1}, {0, 1}});
            for (const std::uint32_t i : {0u, 1u, 2u, 0u, 2u, 3u})
                indices.push_back(first + i);
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
        MeshView view;
        view.positions = positions.data();
        view.vertexCount = positions.size();
        view.indices = indices.data();
        view.triangleCount = indices.size() / 3;
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
