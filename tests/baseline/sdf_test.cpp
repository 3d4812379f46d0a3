// Marching distance fields, against the article's formula and against ray tracing.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <random>

#include "baseline/distance_field.h"
#include "baseline/methods.h"
#include "baseline/reference_embree.h"
#include "baseline/sdf_march.h"
#include "object_fixture.h"

using namespace mtsm;
using namespace mtsm::baseline;
using test::Floor;
using test::Mesh;
using test::sphereLight;

namespace {

/// Counts how often it is asked, and remembers how near to a point.
class Watched final : public DistanceField {
  public:
    Watched(DistanceFieldPtr field, glm::dvec3 origin)
        : field_(std::move(field)), origin_(origin) {}
    [[nodiscard]] double at(glm::dvec3 p) const noexcept override {
        ++asked;
        nearest = std::min(nearest, glm::distance(p, origin_));
        return field_->at(p);
    }
    mutable int asked = 0;
    mutable double nearest = std::numeric_limits<double>::infinity();

  private:
    DistanceFieldPtr field_;
    glm::dvec3 origin_;
};

std::vector<float> shadows(const DistanceField& field, const AreaLight& light,
                           const Floor& floor, const MarchOptions& options = {}) {
    std::vector<float> out(floor.points.size());
    marchShadowFactors(field, light, floor.points.data(), floor.normals.data(),
                       out.size(), out.data(), options);
    return out;
}

DistanceFieldPtr fieldOf(const std::vector<CasterView>& casters, int resolution) {
    CasterViews source(casters);
    auto field = meshField(source, resolution);
    REQUIRE(field);
    return std::move(*field);
}

MarchOptions tinySteps() {
    MarchOptions options;
    options.steps = 100'000;
    options.epsilon = 1e-3;
    options.hit = 1e-6;
    options.stride = 0.01;
    return options;
}

}  // namespace

TEST_CASE("analytic fields are distances", "[sdf][exact]") {
    const auto sphere = sphereField({1, 2, 3}, 0.5);
    CHECK(sphere->at({1, 2, 5}) == Approx(1.5));
    CHECK(sphere->at({1, 2, 3}) == Approx(-0.5));
    const auto box = boxField({-1, -2, -3}, {1, 2, 3});
    CHECK(box->at({4, 6, 3}) == Approx(5.0));
    CHECK(box->at({0, 0, 3.5}) == Approx(0.5));
    CHECK(box->at({0.25, 0, 0}) == Approx(-0.75));
    CHECK(planeField({0, 1, 0}, {0, 1, 0})->at({7, 3, 9}) == Approx(2.0));
    CHECK(planeField({0, 1, 0}, {0, 1, 0})->at({7, 0, 9}) == Approx(-1.0));
    const auto capsule = capsuleField({0, 0, 0}, {4, 0, 0}, 0.5);
    CHECK(capsule->at({2, 3, 0}) == Approx(2.5));
    CHECK(capsule->at({7, 4, 0}) == Approx(4.5));
    std::vector<DistanceFieldPtr> parts;
    parts.push_back(sphereField({0, 0, 0}, 1));
    parts.push_back(sphereField({10, 0, 0}, 1));
    CHECK(unionField(std::move(parts))->at({7, 0, 0}) == Approx(2.0));
}

TEST_CASE("the march is the article's code, step by step", "[sdf][exact]") {
    std::mt19937_64 random(4);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    const glm::dvec3 c(0, 3, 0);
    const auto sphere = sphereField(c, 1);
    int dark = 0, half = 0;
    for (int i = 0; i < 500; ++i) {
        const glm::dvec3 worldPos(4 * unit() - 2, 0, 4 * unit() - 2);
        const glm::dvec3 sunDir = glm::normalize(glm::dvec3(0.1, 1, 0.2));
        const double sunSize = 0.2, epsilon = 0.01;
        double shadow = 1.0, shadowRayLength = epsilon;
        while (shadowRayLength < 150.0) {
            const double distFromObject =
                glm::length(worldPos + sunDir * shadowRayLength - c) - 1;
            shadowRayLength += distFromObject;
            shadow = std::min(shadow, distFromObject / (shadowRayLength * sunSize));
            if (distFromObject < 0.0001) {
                shadow = 0.0;
                break;
            }
        }
        const MarchOptions options{1000, epsilon, 0.0001, sunSize, 1.0};
        CHECK(march(*sphere, worldPos, sunDir, {150.0}, options) ==
              Approx(shadow).margin(1e-12));
        ++(shadow == 0 ? dark : half);
        half -= shadow == 1.0;
    }
    CHECK(dark > 50);
    CHECK(half > 20);
}

TEST_CASE("with small steps a sphere's shadow is the least d / (t size) of the ray",
          "[sdf][exact]") {
    const glm::dvec3 c(0, 2, 0), l(0, 8, 0);
    const double R = 0.6, r = 0.5;
    const auto sphere = sphereField(c, R);
    const AreaLight light = sphereLight(l, r);
    MarchOptions options = tinySteps();
    int between = 0;
    for (double x = 0.0; x <= 1.6; x += 0.02) {
        const glm::dvec3 o(x, 0, 0), n(0, 1, 0);
        const double A = glm::length(l - o), size = r / std::sqrt(r * r + A * A);
        double least = 1.0;
        for (double t = 1e-3; t < A; t += 1e-4) {
            const double d = glm::length(o + t * (l - o) / A - c) - R;
            least = d <= 0 ? 0.0 : std::min(least, d / (t * size));
            if (d <= 0) break;
        }
        float found = -1.0f;
        marchShadowFactors(*sphere, light, &o, &n, 1, &found, options);
        INFO("x " << x);
        // A stride of s takes the ratio at t + s d: 1 % of d / t, which is below 0.1.
        CHECK(found == Approx(1 - least).margin(0.003));
        between += least > 0.02 && least < 0.98;
        // With the full stride a ray may step over the nearest place, and be lighter.
        marchShadowFactors(*sphere, light, &o, &n, 1, &found, {});
        CHECK(found == Approx(1 - least).margin(0.12));
    }
    CHECK(between > 5);
}

TEST_CASE("the penumbra ends where it should, and its inner half is missing",
          "[sdf][exact]") {
    // A large box whose edge is a above the floor, at x = 0, under a light at the height
    // A: the truth's penumbra on the floor reaches from -W / 2 to W / 2.
    const double A = 6.0, a = 2.0, r = 0.5, half = r * a / (A - a);
    const auto box = boxField({-100, a, -100}, {0, a + 0.01, 100});
    const AreaLight light = sphereLight({0, A, 0}, r);
    for (const double stride : {1.0, 0.05}) {
        MarchOptions options;
        options.stride = stride;
        options.steps = 10'000;
        const auto visible = [&](double x) {
            const glm::dvec3 o(x, 0, 0), n(0, 1, 0);
            float dark = -1.0f;
            marchShadowFactors(*box, light, &o, &n, 1, &dark, options);
            return 1.0 - double(dark);
        };
        CHECK(visible(-0.02) == 0.0);
        CHECK(visible(-0.9 * half) == 0.0);  // the truth has light here
        CHECK(visible(1.06 * half) == Approx(1.0).margin(1e-3));
        CHECK(visible(0.8 * half) < 0.97);
        // Proportional between.
        if (stride < 1.0) {
            for (const double share : {0.2, 0.5, 0.8})
                CHECK(visible(share * half) == Approx(share).margin(0.04));
        }
    }
}

TEST_CASE("a distance field gives too much shadow, never too little of the umbra",
          "[sdf][statistical]") {
    const Mesh ball = test::ballMesh({0, 1.5, 0}, 0.5, 32);
    CasterViews casters({ball.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    const auto field = fieldOf({ball.view()}, 64);
    const Floor floor(40, 4.0);
    for (const double radius : {0.2, 0.6}) {
        const AreaLight light = sphereLight({0.3, 5, 0.2}, radius);
        std::vector<float> expected(floor.points.size()), hard(expected);
        ReferenceOptions options;
        options.samples = 256;
        truth->shadowFactors(light, floor.points.data(), floor.normals.data(),
                             expected.size(), expected.data(), options);
        AreaLight centre;
        centre.position = light.position;
        truth->shadowFactors(centre, floor.points.data(), floor.normals.data(),
                             hard.size(), hard.data(), options);
        const auto found = shadows(*field, light, floor);
        CHECK(test::mean(found) > 1.1 * test::mean(expected));
        int open = 0;
        for (std::size_t i = 0; i < found.size(); ++i)
            open += hard[i] == 1.0f && found[i] < 1.0f;
        // The field is off by less than a voxel (1 / 64): so are outlines.
        CHECK(open <= 4);
    }
}

TEST_CASE("step limit and first distance hold", "[sdf]") {
    const glm::dvec3 o(0.9, 0, 0), up(0, 1, 0);
    for (const int steps : {1, 3, 10}) {
        const Watched field(sphereField({0, 50, 0}, 0.8), o);
        MarchOptions options = tinySteps();
        options.size = 0.1;
        options.steps = steps;
        options.epsilon = 0.25;
        (void)march(field, o, up, {100.0}, options);
        CHECK(field.asked == steps);
        CHECK(field.nearest == Approx(0.25));
    }
    // Out of steps, a ray is as lit as it was up to there.
    MarchOptions options;
    options.steps = 1;
    const glm::dvec3 below(0, 0, 0);
    float dark = -1.0f;
    const auto sphere = sphereField({0, 2, 0}, 0.8);
    marchShadowFactors(*sphere, sphereLight({0, 5, 0}, 0.3), &below, &up, 1, &dark,
                       options);
    CHECK(dark == 0.0f);
    options.steps = 50;
    marchShadowFactors(*sphere, sphereLight({0, 5, 0}, 0.3), &below, &up, 1, &dark,
                       options);
    CHECK(dark == 1.0f);
}

TEST_CASE("a grid of a ball holds the sphere's distances within a voxel",
          "[sdf][statistical]") {
    const glm::dvec3 c(1000.5, -3, 7);
    const auto sphere = sphereField(c, 0.5);
    std::mt19937_64 random(9);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    // Tessellated finely, so that the mesh itself is within 1e-3.
    Mesh ball = test::ballMesh({0, 0, 0}, 0.5, 48);
    MeshView view = ball.view();
    for (int i = 0; i < 3; ++i)
        view.worldFromObject[3][i] = c[i];
    for (const int resolution : {24, 64, 100}) {
        const auto field = fieldOf({view}, resolution);
        const double voxel = 1.0 / resolution;
        CHECK(field->spacing() == Approx(voxel).epsilon(0.01));
        CHECK(field->memoryBytes() > 10'000);
        for (int i = 0; i < 3000; ++i) {
            const double reach = i % 3 ? 1.4 : 0.6;
            const glm::dvec3 p =
                c + reach * (2.0 * glm::dvec3(unit(), unit(), unit()) - 1.0);
            const double expected = sphere->at(p);
            INFO("resolution " << resolution << " distance " << expected);
            // Deep inside only the sign is of use, and there is the ball's middle.
            if (expected > -0.2)
                CHECK(field->at(p) == Approx(expected).margin(voxel));
            else
                CHECK(field->at(p) < 0.0);
        }
        // Far away: a lower bound, and not a poor one.
        for (int i = 0; i < 300; ++i) {
            const glm::dvec3 p =
                c + 40.0 * (2.0 * glm::dvec3(unit(), unit(), unit()) - 1.0);
            const double expected = sphere->at(p);
            CHECK(field->at(p) <= expected + voxel);
            CHECK(field->at(p) >= expected - 0.5);
        }
    }
}

TEST_CASE("an open mesh is a sheet one voxel thick", "[sdf]") {
    Mesh card;
    card.positions = {{-1, 1, -1}, {1, 1, -1}, {1, 1, 1}, {-1, 1, 1}};
    card.indices = {0, 1, 2, 0, 2, 3};
    const auto field = fieldOf({card.view()}, 40);
    const double voxel = field->spacing();
    for (const double side : {-1.0, 1.0}) {
        for (const double d : {0.2, 0.5, 0.9})
            CHECK(field->at({0.3, 1 + side * d, 0.2}) ==
                  Approx(d - 0.5 * voxel).margin(voxel));
    }
    CHECK(field->at({0.3, 1, 0.2}) <= 0.1 * voxel);
    // No ray gets through it, from wherever.
    const Floor floor(20, 1.0);
    for (const float dark : shadows(*field, sphereLight({0, 3, 0}, 0.2), floor))
        CHECK(dark == 1.0f);
}

TEST_CASE("a closed mesh in a grid does not darken its own lit side", "[sdf]") {
    const Mesh ball = test::ballMesh({0, 0, 0}, 1.0, 32);
    const auto field = fieldOf({ball.view()}, 64);
    const AreaLight light = sphereLight({1, 6, 0.5}, 0.3);
    int lit = 0;
    for (std::size_t t = 0; t < ball.indices.size(); t += 3) {
        const glm::dvec3 p = (glm::dvec3(ball.positions[ball.indices[t]]) +
                              glm::dvec3(ball.positions[ball.indices[t + 1]]) +
                              glm::dvec3(ball.positions[ball.indices[t + 2]])) /
                             3.0,
                         n = glm::normalize(p);
        const double cosine = glm::dot(n, glm::normalize(light.position - p));
        float dark = -1.0f;
        marchShadowFactors(*field, light, &p, &n, 1, &dark);
        if (cosine > 0.15) CHECK(dark == 0.0f);
        if (cosine < 0.0) CHECK(dark == 1.0f);
        lit += cosine > 0.15;
    }
    CHECK(lit > 1000);
}

TEST_CASE("marched shadows are finite for whatever comes", "[sdf][bad-input]") {
    Mesh mesh = test::ballMesh({0, 1, 0}, 0.5, 8);
    mesh.positions.push_back({NAN, 0, 0});
    const auto bad = std::uint32_t(mesh.positions.size() - 1);
    mesh.indices.insert(mesh.indices.end(), {bad, 0, 20, 20, 20, 20});
    const auto field = fieldOf({mesh.view()}, 16);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::vector<glm::dvec3> points{{nan, 0, 0},    {0, 1, 0},  {0, 1.5, 0},
                                         {0, 4, 0},      {0, 0, 0},  {0, 9, 0},
                                         {1e9, -1e9, 3}, {0, 3.9, 0}};
    AreaLight light;
    light.position = {0, 4, 0};
    for (const LightShape shape : {LightShape::point, LightShape::disk, LightShape::rect,
                                   LightShape::sphere, LightShape::sun}) {
        for (const double size : {0.0, 0.5, 100.0}) {
            light.shape = shape;
            light.radius = size;
            light.size = glm::dvec2(size, 0.5 * size);
            light.angularDiameter = std::min(size, 3.0);
            std::vector<float> out(points.size());
            marchShadowFactors(*field, light, points.data(), nullptr, points.size(),
                               out.data());
            for (const float dark : out) {
                CHECK(dark >= 0.0f);
                CHECK(dark <= 1.0f);
            }
            CHECK(out[0] == 0.0f);
        }
    }
}

TEST_CASE("the row sdf answers by its settings, alike on any number of threads",
          "[sdf]") {
    const Mesh body = test::bumpyBody(3000);
    CasterViews casters({body.view()});
    BakeOptions bake;
    bake.light = sphereLight({2, 5, 1}, 0.5);
    const MethodScene scene{casters, bake, {}};
    auto info = findMethod("sdf");
    REQUIRE(info);
    CHECK(!(*info)->perLight);
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 3000; ++i)
        points.push_back({-3 + i % 60 * 0.1, -1.3, -3 + i / 60 * 0.1});
    const std::vector<glm::dvec3> normals(points.size(), {0, 1, 0});
    Receivers at;
    at.points = at.starts = points.data();
    at.normals = normals.data();
    at.count = points.size();
    const auto run = [&](const Settings::Given& given, int threads) {
        auto settings = Settings::complete((*info)->settings, given, "sdf");
        REQUIRE(settings);
        std::vector<float> out(points.size(), -1.0f);
        const tbb::global_control most(tbb::global_control::max_allowed_parallelism, 4);
        tbb::task_arena arena(threads);
        arena.execute([&] {
            auto method = (*info)->build(scene, *settings);
            REQUIRE(method);
            CHECK((*method)->shadowFactors(bake.light, at, *settings, out.data()));
        });
        return out;
    };
    const auto one = run({{"resolution", 24.0}}, 1);
    CHECK(one == run({{"resolution", 24.0}}, 4));
    CHECK(test::mean(one) > test::mean(run({{"resolution", 24.0}, {"size", 0.01}}, 1)));
    CHECK(test::mean(one) > test::mean(run({{"resolution", 24.0}, {"steps", 4.0}}, 1)));

    StrandsView hair;
    CasterViews none({hair});
    auto refused =
        (*info)->build({none, bake, {}}, *Settings::complete((*info)->settings, {}, ""));
    REQUIRE(!refused);
    CHECK(refused.error().code == ErrorCode::unsupported);
}

TEST_CASE("a ceiling does not darken the floor under a lamp that hangs from it",
          "[sdf]") {
    const Mesh slab = test::boxMesh({-4, 3.02, -4}, {4, 3.4, 4});
    AreaLight light;
    light.shape = GENERATE(LightShape::disk, LightShape::rect);
    light.position = {0, 3, 0};
    light.direction = {0, -1, 0};
    light.radius = 0.3;
    light.size = {0.55, 0.5};
    const Floor floor(20, 7.0);
    for (const float dark : shadows(*fieldOf({slab.view()}, 64), light, floor))
        CHECK(dark == 0.0f);
    for (const float dark : shadows(*boxField({-4, 3.02, -4}, {4, 3.4, 4}), light, floor))
        CHECK(dark == 0.0f);
    // And what is in front of the lamp casts as without the ceiling.
    std::vector<DistanceFieldPtr> both;
    both.push_back(boxField({-0.5, 0.9, -0.5}, {0.5, 1.1, 0.5}));
    const auto alone = shadows(*both.front(), light, floor, tinySteps());
    both.push_back(boxField({-4, 3.02, -4}, {4, 3.4, 4}));
    const auto under = shadows(*unionField(std::move(both)), light, floor, tinySteps());
    CHECK(test::mean(alone) > 0.02);
    for (std::size_t i = 0; i < alone.size(); ++i)
        CHECK(under[i] == Approx(alone[i]).margin(1e-3));
}

TEST_CASE("marched shadows are the same far from the world's origin", "[sdf]") {
    const glm::dvec3 far(1e6, -2e6, 3e6);
    const Mesh ball = test::ballMesh({0.1, 1.5, 0}, 0.5, 24);
    Floor floor(20, 4.0);
    MeshView view = ball.view();
    AreaLight light = sphereLight({0.5, 6, 0.3}, 0.4);
    const auto near = shadows(*fieldOf({view}, 64), light, floor);
    view.worldFromObject[3] = glm::dvec4(far, 1.0);
    light.position += far;
    for (glm::dvec3& p : floor.points)
        p += far;
    const auto there = shadows(*fieldOf({view}, 64), light, floor);
    CHECK(test::mean(near) > 0.03);
    for (std::size_t i = 0; i < near.size(); ++i)
        CHECK(there[i] == Approx(near[i]).margin(1e-3));
}
