// The whole way, meshes to shadow factor, against closed forms and against ray tracing.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <random>

#include "baseline/floor_scene.h"
#include "baseline/reference_embree.h"
#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"

using namespace mtsm;
using baseline::EmbreeReference;
using test::diskAbove;
using test::Mesh;
using test::quad;

namespace {

struct Points {
    std::vector<glm::dvec3> position, normal;
};

double meanError(const std::vector<float>& a, const std::vector<float>& b) {
    double sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i)
        sum += std::abs(double(a[i]) - b[i]);
    return sum / double(a.size());
}

/// Points on the floor under the body, and on the body where it faces the light.
Points receivers(const Mesh& body, bool onBody, glm::dvec3 towards, std::size_t count) {
    std::mt19937_64 random(3);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    Points points;
    while (points.position.size() < count) {
        if (!onBody) {
            points.position.push_back({5 * unit() - 3, -1.3, 5 * unit() - 3});
            points.normal.push_back({0, 1, 0});
            continue;
        }
        const std::size_t t = 3 * std::size_t(unit() * double(body.indices.size() / 3));
        const glm::dvec3 a = body.positions[body.indices[t]],
                         b = body.positions[body.indices[t + 1]],
                         c = body.positions[body.indices[t + 2]];
        const glm::dvec3 n = glm::cross(b - a, c - a);
        if (!(glm::dot(n, towards) > 0.0)) continue;
        points.position.push_back((a + b + c) / 3.0);
        points.normal.push_back(glm::normalize(n));
    }
    return points;
}

struct Scene {
    Mesh body = test::bumpyBody(60'000);
    CasterViews casters{std::vector<CasterView>{body.view()}};
    BakeOptions options;

    Scene() {
        options.light.shape = LightShape::disk;
        options.light.position = {2, 5, 2.5};
        options.light.radius = 0.5;
    }
    [[nodiscard]] double error(std::uint32_t resolution, bool onBody) {
        options.width = options.height = resolution;
        auto baked = bake(casters, options);
        REQUIRE(baked);
        auto truth = EmbreeReference::build(casters);
        REQUIRE(truth);
        const AreaLight light = baked->map.info().light;
        const Points p = receivers(body, onBody, light.position, 1000);
        std::vector<float> expected(p.position.size()), found(p.position.size());
        baseline::ReferenceOptions reference;
        reference.samples = 1024;
        truth->shadowFactors(light, p.position.data(), p.normal.data(), p.position.size(),
                             expected.data(), reference);
        ShadowOptions query;
        query.samples = 256;
        shadowFactors(baked->map, light, p.position.data(), p.normal.data(),
                      p.position.size(), found.data(), query);
        return meanError(found, expected);
    }
};

}  // namespace

TEST_CASE("the ray-traced reference gives the closed form of a half-plane over a disk",
          "[baseline][exact]") {
    // The quad reaches from x = -50 to 0, half way up to the light: from x on the floor
    // its edge appears at -x on the light's plane.
    const Mesh blocker = quad(-50, 0, -50, 50, 2);
    CasterViews casters({blocker.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    const double R = 0.4;
    for (double x = -0.6; x <= 0.6; x += 0.05) {
        const double s = std::clamp(-x / R, -1.0, 1.0);
        const double expected =
            (glm::pi<double>() - std::acos(s) + s * std::sqrt(1 - s * s)) /
            glm::pi<double>();
        const glm::dvec3 point(x, 0, 0.1), normal(0, 1, 0);
        float found = -1.0f;
        truth->shadowFactors(diskAbove(4, R), &point, &normal, 1, &found);
        // 4096 stratified samples; about sqrt(4096) of them lie on the edge.
        CHECK(found == Approx(expected).margin(4 * std::sqrt(64.0) / 4096));
    }
}

TEST_CASE("a baked quad gives the closed form of a half-plane over a disk",
          "[baseline][exact]") {
    // As above, but through bake and map; the quad's edge is off by half a pixel at most,
    // which appears twice as large on the light.
    const Mesh blocker = quad(-3, 0, -3, 3, 2);
    const double R = 0.4;
    for (const float opacity : {1.0f, 0.5f}) {
        MeshView view = blocker.view();
        view.opacity = opacity;
        CasterViews casters({view});
        BakeOptions options;
        options.light = diskAbove(4, R);
        options.aimed = true;
        auto baked = bake(casters, options);
        REQUIRE(baked);
        const Projection& p = baked->map.projection(0);
        const double pixel =
            p.pixelFootprint(glm::dot(glm::dvec3(0, 2, 0) - p.eye, p.forward));
        for (double x = -0.6; x <= 0.6; x += 0.05) {
            const double s = std::clamp(-x / R, -1.0, 1.0);
            const double expected =
                opacity * (glm::pi<double>() - std::acos(s) + s * std::sqrt(1 - s * s)) /
                glm::pi<double>();
            ShadowOptions query;
            query.samples = 4096;
            const double allowed = 4 * std::sqrt(64.0) / 4096 +
                                   2 * (0.5 * pixel) * 2 / (glm::pi<double>() * R);
            INFO("x " << x << " opacity " << opacity);
            CHECK(shadowFactor(baked->map, baked->map.info().light, {x, 0, 0.1},
                               {0, 1, 0}, query) == Approx(expected).margin(allowed));
        }
    }
}

TEST_CASE("a tilted card loses no shadow", "[baseline][statistical]") {
    // A card 2 x 2 at height 1.5, tilted by up to 75 degrees: depths step by almost four
    // footprints from pixel to pixel. The mean shadow on the floor against ray tracing;
    // sampling noise of the means is below 0.2 %.
    AreaLight light = diskAbove(4, 1.0);
    Points floor;
    for (int i = 0; i < 1600; ++i) {
        floor.position.push_back(
            {(i % 40 + 0.5) * 0.15 - 3, 0, (i / 40 + 0.5) * 0.15 - 3});
        floor.normal.push_back({0, 1, 0});
    }
    for (const double tilt : {0.0, 45.0, 60.0, 75.0}) {
        for (const float opacity : {1.0f, 0.5f}) {
            const double a = tilt * glm::pi<double>() / 180;
            const auto x = float(std::cos(a)), y = float(std::sin(a));
            Mesh card;
            card.positions = {{-x, 1.5f - y, -1},
                              {x, 1.5f + y, -1},
                              {x, 1.5f + y, 1},
                              {-x, 1.5f - y, 1}};
            card.indices = {0, 1, 2, 0, 2, 3};
            MeshView view = card.view();
            view.opacity = opacity;
            CasterViews casters({view});
            BakeOptions options;
            options.light = light;
            options.aimed = true;
            auto baked = bake(casters, options);
            auto truth = EmbreeReference::build(casters);
            REQUIRE(baked);
            REQUIRE(truth);
            std::vector<float> expected(floor.position.size()), found(expected);
            baseline::ReferenceOptions reference;
            reference.samples = 256;
            truth->shadowFactors(light, floor.position.data(), floor.normal.data(),
                                 expected.size(), expected.data(), reference);
            for (const bool normals : {true, false}) {
                ShadowOptions query;
                query.samples = 256;
                shadowFactors(baked->map, light, floor.position.data(),
                              normals ? floor.normal.data() : nullptr, found.size(),
                              found.data(), query);
                double sum = 0.0, all = 0.0;
                for (std::size_t k = 0; k < found.size(); ++k) {
                    sum += double(found[k]) - expected[k];
                    all += expected[k];
                }
                INFO("tilt " << tilt << " opacity " << opacity
                             << (normals ? " with" : " without")
                             << " normals: " << 100 * sum / all << " %");
                CHECK(std::abs(sum / all) < 0.02);
            }
        }
    }
}

TEST_CASE("on the floor a baked body's shadow is as ray traced",
          "[baseline][statistical]") {
    // Better than the paper's mean difference of .0044 at its settings [Xie07, table 1].
    CHECK(Scene().error(1024, false) < 0.004);
}

TEST_CASE("on the body the error falls with the pixels' size",
          "[baseline][statistical]") {
    // It is made within some pixels of the receiver: proportional to their size. Sampling
    // noise of 256 rays keeps the ratio below the 4 of the sizes.
    Scene scene;
    const double coarse = scene.error(256, true), fine = scene.error(1024, true);
    INFO("256: " << coarse << ", 1024: " << fine);
    CHECK(fine < coarse / 2);
}

TEST_CASE("a body far from the origin casts the same shadow", "[baseline][extreme]") {
    // The body's own coordinates are small; its transform carries the offset of 1e7.
    Scene here;
    MeshView view = here.body.view();
    const glm::dvec3 offset(1e7, -2e7, 3e7);
    view.worldFromObject[3] = glm::dvec4(offset, 1.0);
    CasterViews there({view});
    BakeOptions options = here.options;
    options.width = options.height = 256;
    auto near = bake(here.casters, options);
    options.light.position += offset;
    auto far = bake(there, options);
    REQUIRE(near);
    REQUIRE(far);
    const Points p = receivers(here.body, false, {0, 1, 0}, 300);
    double sum = 0.0;
    for (std::size_t i = 0; i < p.position.size(); ++i) {
        // The points' keys differ, so the samples do: compare means, noise 1 / sqrt(64)
        // each.
        sum +=
            shadowFactor(near->map, near->map.info().light, p.position[i], p.normal[i]) -
            shadowFactor(far->map, far->map.info().light, p.position[i] + offset,
                         p.normal[i]);
    }
    CHECK(std::abs(sum / double(p.position.size())) < 0.003);
    CHECK(near->map.layerCount() == far->map.layerCount());
}

namespace {

/// A ground of this half size through the origin, its edges in y raised by `slant` per
/// unit of x, and a box of side 1 that hovers .2 above it.
struct HoveringBox {
    Mesh ground, box;

    explicit HoveringBox(float half, float slant = 0.0f) {
        ground = quad(-half, half, -half, half, 0);
        for (glm::vec3& p : ground.positions)
            p.y = slant * p.x;
        for (const float y : {0.2f, 1.2f}) {
            const Mesh side = quad(-0.5f, 0.5f, -0.5f, 0.5f, y);
            const auto first = std::uint32_t(box.positions.size());
            box.positions.insert(box.positions.end(), side.positions.begin(),
                                 side.positions.end());
            for (const std::uint32_t i : side.indices)
                box.indices.push_back(first + i);
        }
    }
    [[nodiscard]] float shadow(glm::dvec3 point, glm::dvec3 normal) const {
        CasterViews casters({ground.view(), box.view()});
        auto truth = EmbreeReference::build(casters);
        REQUIRE(truth);
        baseline::ReferenceOptions options;
        options.samples = 64;
        float found = -1.0f;
        truth->shadowFactors(diskAbove(6, 0.3), &point, &normal, 1, &found, options);
        return found;
    }
};

}  // namespace

TEST_CASE("a ground of any size lets a box be dark below and lit beside itself",
          "[baseline][extreme]") {
    for (const float half : {5.0f, 5e3f, 5e4f, 5e5f, 5e6f}) {
        const HoveringBox scene(half);
        INFO("half size " << half);
        for (const glm::dvec3 normal : {glm::dvec3(0, 1, 0), glm::dvec3(0.0)}) {
            CHECK(scene.shadow({0, 0, 0}, normal) == 1.0f);
            CHECK(scene.shadow({0.1, 0, 0.2}, normal) == 1.0f);
            CHECK(scene.shadow({1.5, 0, 0.3}, normal) == 0.0f);
        }
    }
}

TEST_CASE("a slanted ground does not shadow itself", "[baseline][extreme]") {
    for (const float half : {5.0f, 500.0f, 5e4f}) {
        const HoveringBox scene(half, 0.4f);
        const glm::dvec3 normal = glm::normalize(glm::dvec3(-0.4, 1, 0));
        for (double x = -3; x <= -1.2; x += 0.013) {
            INFO("half size " << half << " x " << x);
            CHECK(scene.shadow({x, double(0.4f) * x, 0.3}, normal) == 0.0f);
        }
    }
}

TEST_CASE("beside a near field a point light's shadows are those of the triangles",
          "[baseline][statistical]") {
    // Blades thinner than a pixel of the map, far above the floor.
    Mesh blades;
    std::mt19937_64 random(4);
    const auto in = [&](double low, double high) {
        return float(low + (high - low) * double(random() >> 11) * 0x1p-53);
    };
    for (std::uint32_t i = 0; i < 400; ++i) {
        const glm::vec3 a(in(-1, 1), in(1, 2), in(-1, 1));
        const glm::vec3 along(in(-0.6, 0.6), in(-0.2, 0.2), in(-0.6, 0.6));
        blades.positions.insert(blades.positions.end(),
                                {a, a + along, a + glm::vec3(0.012f, 0.0f, 0.012f)});
        blades.indices.insert(blades.indices.end(), {3 * i, 3 * i + 1, 3 * i + 2});
    }
    CasterViews casters({blades.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    BakeOptions options;
    options.light.position = {0.5, 6, 0.3};
    options.width = options.height = 128;
    options.nearField = kAutomaticNearField;
    CasterViews again({blades.view()});
    auto baked = bake(again, options);
    REQUIRE(baked);
    std::vector<glm::dvec3> points, normals;
    for (int i = 0; i < 4000; ++i) {
        points.emplace_back(in(-1, 1), 0.0, in(-1, 1));
        normals.emplace_back(0, 1, 0);
    }
    std::vector<float> found(points.size()), expected(points.size());
    shadowFactors(baked->map, options.light, points.data(), normals.data(), points.size(),
                  found.data());
    truth->shadowFactors(options.light, points.data(), normals.data(), points.size(),
                         expected.data());
    double dark = 0.0;
    for (const float f : expected)
        dark += double(f) / double(points.size());
    CHECK(dark > 0.1);
    CHECK(meanError(found, expected) < 0.004);
}

TEST_CASE("casters in one plane do not shadow themselves", "[baseline][extreme]") {
    for (const float height : {0.0f, 1.0f, -3.7f}) {
        const Mesh plate = quad(-1, 1, -1, 1, height);
        CasterViews casters({plate.view()});
        auto truth = EmbreeReference::build(casters);
        REQUIRE(truth);
        for (const double x : {-0.9, 0.0, 0.31}) {
            const glm::dvec3 at(x, height, 0.2), below(x, height - 0.5, 0.2), up(0, 1, 0);
            float found[2] = {-1.0f, -1.0f};
            truth->shadowFactors(diskAbove(height + 5.0, 0.3), &at, &up, 1, &found[0]);
            truth->shadowFactors(diskAbove(height + 5.0, 0.3), &below, &up, 1, &found[1]);
            CHECK(found[0] == 0.0f);
            CHECK(found[1] == 1.0f);
        }
    }
}

TEST_CASE("vertices that no triangle uses change nothing", "[baseline][extreme]") {
    HoveringBox scene(3);
    Mesh& ground = scene.ground;
    const glm::vec3 stray(1e8f, -1e8f, 1e8f);
    for (const bool front : {false, true}) {
        ground.positions.insert(front ? ground.positions.begin() : ground.positions.end(),
                                stray);
        if (front) {
            for (std::uint32_t& i : ground.indices)
                ++i;
        }
        CHECK(scene.shadow({0.1, 0, 0.2}, {0, 1, 0}) == 1.0f);
        CHECK(scene.shadow({1.5, 0, 0.3}, {0, 1, 0}) == 0.0f);
    }
    CasterViews casters({scene.ground.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    CHECK(truth->boundsMin() == glm::dvec3(-3, 0, -3));
    CHECK(truth->boundsMax() == glm::dvec3(3, 0, 3));
}

TEST_CASE("what a camera sees from far away does not shadow itself",
          "[baseline][extreme]") {
    // A floor of 10 units, slanted, seen from 1e4 away: there a float of the distance is
    // 1e-3.
    Mesh floor = quad(-5, 5, -5, 5, 0);
    for (glm::vec3& p : floor.positions)
        p.y = 0.3f * p.x;
    CasterViews casters({floor.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    const glm::dvec3 camera(1200, 1e4, 900), up = glm::normalize(glm::dvec3(-0.3f, 1, 0));
    for (int i = 0; i < 200; ++i) {
        const glm::dvec3 aim(0.04 * i - 4, 0, 3.9 - 0.037 * i);
        const auto hit = truth->firstHit(camera, aim - camera);
        REQUIRE(hit);
        CHECK(std::abs(glm::dot(hit->position, up)) < 1e-6);
        float found = -1.0f;
        baseline::ReferenceOptions options;
        options.samples = 16;
        truth->shadowFactors(diskAbove(6, 0.3), &hit->position, &hit->normal, 1, &found,
                             options);
        CHECK(found == 0.0f);
    }
}
