// The near sheets of a bake: triangles and textures as the casters have them.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/common.hpp>
#include <limits>
#include <vector>

#include "bake/baked.h"
#include "bake/casters.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"

using namespace mtsm;
using mtsm::test::mustBake;

namespace {

/// A tilted card over the origin: (x, 1 + 0.4 x, z) for x and z in [-1, 1], textured from
/// corner to corner.
struct Card {
    std::vector<glm::vec3> positions{
        {-1, 0.6f, -1}, {1, 1.4f, -1}, {1, 1.4f, 1}, {-1, 0.6f, 1}};
    std::vector<std::uint32_t> indices{0, 1, 2, 0, 2, 3};
    std::vector<glm::vec2> uvs{{0, 0}, {1, 0}, {1, 1}, {0, 1}};

    [[nodiscard]] MeshView view(const OpacityTexture& texture) const {
        MeshView v;
        v.positions = positions.data();
        v.vertexCount = positions.size();
        v.indices = indices.data();
        v.triangleCount = indices.size() / 3;
        v.uvs = uvs.data();
        v.texture = &texture;
        return v;
    }
};

OpacityTexture textureOf(std::uint32_t width, std::vector<float> texels, float cutoff) {
    OpacityImage image;
    image.width = width;
    image.height = std::uint32_t(texels.size()) / width;
    image.texels = std::move(texels);
    image.wrapU = image.wrapV = TextureWrap::clamp;
    image.cutoff = cutoff;
    auto texture = OpacityTexture::create(std::move(image));
    REQUIRE(texture);
    return *std::move(texture);
}

BakeOptions lamp(bool sun) {
    BakeOptions o;
    o.light.shape = sun ? LightShape::sun : LightShape::point;
    o.light.position = {0, 4, 0};
    o.light.direction = {0, -1, 0};
    o.width = o.height = 64;
    o.nearField = kAutomaticNearField;
    return o;
}

}  // namespace

TEST_CASE("a card's shadow is its texture, where the ray to the light crosses it",
          "[bake][exact]") {
    const Card card;
    // 0.2 on the left and 0.8 on the right, straight from one to the other between.
    const OpacityTexture texture = textureOf(2, {0.2f, 0.8f}, -1.0f);
    for (const bool sun : {false, true}) {
        INFO((sun ? "sun" : "point light"));
        const Baked b = mustBake({card.view(texture)}, lamp(sun));
        CHECK(b.report.noNearField.empty());
        CHECK(b.report.nearTriangles == 2);
        CHECK(b.report.nearBytes == memoryBytes(b.map.nearSheets(0)));
        for (double x = -0.9; x < 0.9; x += 0.097) {
            for (const double z : {-0.83, -0.1, 0.42}) {
                const double way = sun ? 0.0 : (1.0 + 0.4 * x) / (4.0 + 0.4 * x);
                const double u = 0.5 * x * (1.0 - way) + 0.5;
                const double expected = 0.2 + 0.6 * glm::clamp(2.0 * u - 0.5, 0.0, 1.0);
                CHECK(shadowFactor(b.map, b.map.info().light, {x, 0, z}, {0, 1, 0}) ==
                      Approx(expected).margin(2e-3));
                CHECK(shadowFactor(b.map, b.map.info().light, {x, 0, z}) ==
                      Approx(expected).margin(2e-3));
            }
        }
    }
}

TEST_CASE("equal textures are stored once, and opaque ones are a texel",
          "[bake][threads]") {
    const Card card;
    const OpacityTexture mask = textureOf(2, {0.2f, 0.8f}, 0.5f);
    const OpacityTexture again = textureOf(2, {0.2f, 0.8f}, 0.5f);
    const OpacityTexture solid = textureOf(2, {1.0f, 1.0f}, -1.0f);
    const Baked b =
        mustBake({card.view(mask), card.view(again), card.view(solid), card.view(mask)},
                 lamp(false));
    const NearSheets& sheets = b.map.nearSheets(0);
    REQUIRE(sheets.textures.size() == 2);
    CHECK(sheets.textures[0].texels == std::vector<std::uint8_t>{51, 204});
    CHECK(sheets.textures[0].cutoff == 0.5f);
    CHECK(sheets.textures[1].texels == std::vector<std::uint8_t>{255});
    CHECK(b.report.nearTriangles == 8);
    std::uint32_t triangles = 0;  // none is lost where three are in one place
    for (const NearSheetChunk& chunk : sheets.chunks)
        triangles += chunk.triangles;
    CHECK(triangles == 8);
}

TEST_CASE("texture coordinates that are not finite are opaque, as in the layers",
          "[bake]") {
    Card card;
    card.uvs[1].x = std::numeric_limits<float>::quiet_NaN();  // of the first triangle
    const OpacityTexture clear = textureOf(2, {0.0f, 0.0f}, -1.0f);
    const Baked b = mustBake({card.view(clear)}, lamp(true));
    const AreaLight& light = b.map.info().light;
    CHECK(shadowFactor(b.map, light, {0.5, 0, -0.5}, {0, 1, 0}) == 1.0f);
    CHECK(shadowFactor(b.map, light, {-0.5, 0, 0.5}, {0, 1, 0}) == 0.0f);
}

TEST_CASE("near sheets are kept within their budget, and not in colour", "[bake]") {
    const Card card;
    const OpacityTexture texture = textureOf(100, std::vector<float>(20000, 0.5f), -1.0f);
    BakeOptions options = lamp(false);
    options.nearField = 30000;
    const Baked little = mustBake({card.view(texture)}, options);
    CHECK(little.map.nearSheets(0).empty());
    CHECK_THAT(little.report.noNearField, Catch::Contains("--near-field 1M"));
    options.nearField = 1u << 20;
    CHECK_FALSE(mustBake({card.view(texture)}, options).map.nearSheets(0).empty());
    options.color = true;
    const Baked coloured = mustBake({card.view(texture)}, options);
    CHECK(coloured.map.nearSheets(0).empty());
    CHECK_THAT(coloured.report.noNearField, Catch::Contains("colour"));
}
