// Depth maps of one layer and of several, ray traced, and what they take casters for.
#include <glm/geometric.hpp>

#include "baseline/depth_map.h"
#include "depth_rows.h"
#include "mtsm/opacity_texture.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

BakeOptions pointLight(double height) {
    BakeOptions options = rectLight(height, 0, 0);
    options.light.shape = LightShape::point;
    return options;
}

/// The shadow at a point of the floor under a point light at height 4.
float hardShadow(const CasterView& caster, glm::dvec3 point) {
    Points points;
    points.add(point, {0, 1, 0});
    return run("slsm", {caster}, pointLight(4), {{"resolution", 128.0}}, points)[0];
}

}  // namespace

TEST_CASE("a ray-traced depth map gives the closed form of a square under a rectangle",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points points = floorLine(-2, 2, 40);
    for (const char* row : {"slsm", "mlsm"}) {
        const auto found = run(row, {mesh.view()}, light,
                               {{"resolution", 512.0}, {"samples", 4096.0}}, points);
        for (std::size_t i = 0; i < points.size(); ++i) {
            // Half a pixel at each edge, twice as large on the light.
            const double allowed = noise(4096) + 2 * (2 * 0.5 / 512) / 0.8;
            INFO(row << " at x = " << points.position[i].x);
            CHECK(found[i] ==
                  Approx(shadowOf(square, light, points.position[i])).margin(allowed));
        }
    }
}

TEST_CASE("of two squares one layer keeps the upper one, several keep both",
          "[baseline][exact]") {
    // The lower one lies in the shadow that the upper one casts from the centre.
    const Rect upper{-0.5, 0.5, -0.5, 0.5, 2}, lower{-0.55, 0.55, -0.55, 0.55, 1};
    const Mesh a = upper.mesh(), b = lower.mesh();
    const BakeOptions light = rectLight(4, 2, 2);
    const Points points = floorLine(-2.5, 2.5, 50);
    const Settings::Given given = {{"resolution", 512.0}, {"samples", 4096.0}};
    const auto one = run("slsm", {a.view(), b.view()}, light, given, points);
    const auto all = run("mlsm", {a.view(), b.view()}, light, given, points);
    const double allowed = noise(4096, 4) + 4 * (2 * 0.5 / 512);
    double leak = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 p = points.position[i];
        const double up = shadowOf(upper, light, p), low = shadowOf(lower, light, p);
        const Rect whole{-1, 1, -1, 1, 4};
        const Rect both =
            common(common(hiddenOfLight(upper, 4, p), hiddenOfLight(lower, 4, p)), whole);
        const double expected = up + low - area(both) / area(whole);
        INFO("x = " << p.x << ", expected " << expected << ", the upper one's " << up);
        CHECK(one[i] == Approx(up).margin(allowed));
        CHECK(all[i] == Approx(expected).margin(allowed));
        leak = std::max(leak, expected - up);
    }
    CHECK(leak > 0.1);  // there was something to lose
}

TEST_CASE("a depth map takes what lets some light through for opaque", "[baseline]") {
    Mesh square = Rect{-0.5, 0.5, -0.5, 0.5, 2}.mesh();
    MeshView view = square.view();
    view.opacity = 0.1f;
    CHECK(hardShadow(view, {0, 0, 0}) == 1.0f);
    CHECK(hardShadow(view, {1.2, 0, 0}) == 0.0f);

    // A strand as wide as 0.4 and bent, which reads as a ribbon across the view.
    const std::vector<glm::vec3> line = {{-1, 2, 0}, {0, 2, 0}, {1, 2, 0.5f}};
    const std::vector<std::uint32_t> begin = {0, 3};
    StrandsView strand;
    strand.points = line.data();
    strand.begin = begin.data();
    strand.strandCount = 1;
    strand.width = 0.4f;
    strand.opacity = 0.1f;
    CHECK(hardShadow(strand, {-1, 0, 0.36}) == 1.0f);
    CHECK(hardShadow(strand, {-1, 0, 0.44}) == 0.0f);
    CHECK(hardShadow(strand, {1, 0, 0.5}) == 1.0f);
    CHECK(hardShadow(strand, {0.02, 0, 0.02}) == 1.0f);
    strand.opacity = 0.0f;
    CHECK(run("slsm", {strand, square.view()}, pointLight(4), {{"resolution", 64.0}},
              floorLine(1.2, 1.3, 1))[0] == 0.0f);
}

TEST_CASE("a depth map leaves volumes out", "[baseline]") {
    const std::vector<glm::ivec3> blocks = {{0, 0, 0}};
    const std::vector<float> density(std::size_t(VolumeView::kBlockVoxels), 100.0f);
    VolumeView volume;
    volume.blocks = blocks.data();
    volume.blockCount = 1;
    volume.density = density.data();
    volume.worldFromIndex[3] = glm::dvec4(-4, 10, -4, 1);
    const Mesh far = Rect{5, 6, 5, 6, 2}.mesh();
    Points points;
    points.add({0, 0, 0}, {0, 1, 0});
    CHECK(run("mlsm", {far.view(), volume}, pointLight(40), {{"resolution", 64.0}},
              points)[0] == 0.0f);
}

TEST_CASE("a depth map tests a texture's alpha", "[baseline]") {
    // The left half stops 0.6, the right one 0.4 of the light.
    OpacityImage image;
    image.width = 2;
    image.height = 1;
    image.texels = {0.6f, 0.4f};
    image.wrapU = image.wrapV = TextureWrap::clamp;
    const auto texture = OpacityTexture::create(image);
    REQUIRE(texture);
    const Mesh square = Rect{-1, 1, -1, 1, 2}.mesh();
    const std::vector<glm::vec2> uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    MeshView view = square.view();
    view.uvs = uvs.data();
    view.texture = &*texture;
    CHECK(hardShadow(view, {-0.1, 0, 0}) == 1.0f);
    CHECK(hardShadow(view, {-1.5, 0, 0}) == 1.0f);
    CHECK(hardShadow(view, {0.1, 0, 0}) == 0.0f);
    CHECK(hardShadow(view, {1.5, 0, 0}) == 0.0f);
}

TEST_CASE("a depth map's light is aimed as the whole scene's map aims it", "[baseline]") {
    // At the casters' centre, of those too that depth maps leave out.
    const Mesh square = Rect{-0.5, 0.5, -0.5, 0.5, 0}.mesh();
    const std::vector<glm::ivec3> blocks = {{0, 0, 0}};
    const std::vector<float> density(std::size_t(VolumeView::kBlockVoxels), 1.0f);
    VolumeView volume;
    volume.blocks = blocks.data();
    volume.blockCount = 1;
    volume.density = density.data();
    volume.worldFromIndex = glm::dmat4(0.1);
    volume.worldFromIndex[3] = glm::dvec4(1, 0, 0, 1);
    CasterViews casters({square.view(), volume});
    BakeOptions options = rectLight(4, 1, 0.5);
    options.aimed = false;
    options.width = options.height = 64;
    for (const bool target : {false, true}) {
        if (target) options.target = glm::dvec3(0.3, 0, -0.2);
        const auto baked = bake(casters, options);
        const auto aimed = baseline::aimedOptions(casters, options);
        REQUIRE(baked);
        REQUIRE(aimed);
        CHECK(lightFits(baked->map.info().light, aimed->light));
        CHECK(glm::length(baked->map.info().light.direction - aimed->light.direction) <
              1e-12);
    }
}
