// Ray tracing as a row of the comparison: streams against single rays, every mode against
// closed forms.
#include <tbb/global_control.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <new>
#include <numeric>
#include <random>

#include "base/sampling.h"
#include "baseline/embree_method.h"
#include "baseline/floor_scene.h"
#include "baseline/methods.h"
#include "baseline/reference_embree.h"
#include "baseline/shadow_rays.h"
#include "bumpy_mesh.h"
#include "light/sample.h"

using namespace mtsm;
using namespace mtsm::baseline;
using test::diskAbove;
using test::Mesh;
using test::quad;

namespace {

/// Share of a disk of radius .4 at height 4 that a half-plane at height 2, x < 0, hides
/// from x on the floor.
double halfPlaneShadow(double x) {
    const double s = std::clamp(-x / 0.4, -1.0, 1.0);
    return (glm::pi<double>() - std::acos(s) + s * std::sqrt(1 - s * s)) /
           glm::pi<double>();
}

/// Points by pixel, normals up.
struct Points {
    std::vector<glm::dvec3> position, normal;
    std::vector<std::size_t> first{0};

    void add(glm::dvec3 p) {
        position.push_back(p);
        normal.push_back({0, 1, 0});
    }
    void endPixel() { first.push_back(position.size()); }
    [[nodiscard]] Receivers view() const {
        Receivers r;
        r.points = position.data();
        r.normals = normal.data();
        r.count = position.size();
        r.first = first.data();
        r.pixels = first.size() - 1;
        return r;
    }
};

/// Pixels of some points each at x on the floor, further and further along the edge.
Points alongEdge(double x, std::size_t pixels, std::size_t pointsPerPixel) {
    Points points;
    for (std::size_t p = 0; p < pixels; ++p) {
        for (std::size_t i = 0; i < pointsPerPixel; ++i)
            points.add({x, 0, 1e-3 * double(p * pointsPerPixel + i)});
        points.endPixel();
    }
    return points;
}

class Row {
  public:
    explicit Row(std::vector<CasterView> views) {
        CasterViews casters(std::move(views));
        const MethodScene scene{casters, {}, {}};
        auto method = info_.build(scene, settings({}));
        REQUIRE(method);
        method_ = std::move(*method);
    }
    [[nodiscard]] std::vector<float> operator()(const AreaLight& light,
                                                const Receivers& at,
                                                const Settings::Given& given) const {
        std::vector<float> out(at.count, -1.0f);
        REQUIRE(method_->shadowFactors(light, at, settings(given), out.data()));
        return out;
    }
    [[nodiscard]] std::uint64_t bytes() const { return method_->memoryBytes(); }

  private:
    [[nodiscard]] Settings settings(const Settings::Given& given) const {
        auto all = Settings::complete(info_.settings, given, info_.name);
        REQUIRE(all);
        return std::move(*all);
    }
    MethodInfo info_ = embreeMethod();
    std::unique_ptr<Method> method_;
};

Settings::Given mode(const char* name, int samples, int most = 64) {
    return {{"mode", std::string(name)},
            {"samples", double(samples)},
            {"most", double(most)}};
}

double mean(const std::vector<float>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / double(values.size());
}

/// Mean squared error of the means of `group` values each.
double varianceOfMeans(const std::vector<float>& values, std::size_t group,
                       double expected) {
    double sum = 0.0;
    for (std::size_t i = 0; i < values.size(); i += group) {
        const double m = mean({values.begin() + std::ptrdiff_t(i),
                               values.begin() + std::ptrdiff_t(i + group)});
        sum += (m - expected) * (m - expected);
    }
    return sum * double(group) / double(values.size());
}

/// Everything at once: an opaque body, a textured card, bent strands, smoke.
struct Mixture {
    Mesh body = test::bumpyBody(2000), card = quad(-3, 3, -3, 3, 2);
    std::vector<glm::vec2> uvs{{0, 0}, {3, 0}, {3, 3}, {0, 3}};
    std::optional<OpacityTexture> texture;
    std::vector<glm::vec3> strandPoints;
    std::vector<std::uint32_t> strandBegin{0};
    std::vector<glm::ivec3> blocks{{0, 0, 0}};
    std::vector<float> density = std::vector<float>(VolumeView::kBlockVoxels, 0.3f);

    Mixture() {
        OpacityImage image;
        image.width = image.height = 4;
        image.texels = {0, .3f, 1, .5f, .2f, .9f, 0, 1, 0, 0, .6f, .7f, 1, .1f, .4f, 0};
        auto made = OpacityTexture::create(image);
        REQUIRE(made);
        texture = std::move(*made);
        std::mt19937 random(5);
        const auto unit = [&] { return float(random()) * 0x1p-32f; };
        for (int s = 0; s < 60; ++s) {
            glm::vec3 p(6 * unit() - 3, 1.5f + unit(), 6 * unit() - 3);
            for (int i = 0; i < 6; ++i) {
                strandPoints.push_back(p);
                p += 0.4f * glm::vec3(unit() - 0.5f, unit() - 0.5f, unit() - 0.5f);
            }
            strandBegin.push_back(std::uint32_t(strandPoints.size()));
        }
    }
    [[nodiscard]] std::vector<CasterView> views() const {
        MeshView textured = card.view();
        textured.uvs = uvs.data();
        textured.texture = &*texture;
        StrandsView strands;
        strands.points = strandPoints.data();
        strands.begin = strandBegin.data();
        strands.strandCount = strandBegin.size() - 1;
        strands.width = 0.15f;
        strands.opacity = 0.4f;
        VolumeView smoke;
        smoke.blocks = blocks.data();
        smoke.blockCount = blocks.size();
        smoke.density = density.data();
        smoke.worldFromIndex = glm::scale(
            glm::translate(glm::dmat4(1.0), glm::dvec3(-2, 2.5, -2)), glm::dvec3(0.4));
        return {body.view(), textured, strands, smoke};
    }
};

Points around(std::size_t count) {
    std::mt19937 random(9);
    const auto unit = [&] { return double(random()) * 0x1p-32; };
    Points points;
    for (std::size_t i = 0; i < count; ++i) {
        const double x = 6 * unit() - 3, y = -1.5 - unit();
        points.add({x, y, 6 * unit() - 3});
        if (i % 3 == 2 || i + 1 == count) points.endPixel();
    }
    return points;
}

std::vector<AreaLight> lights() {
    AreaLight disk = diskAbove(6, 1.0), rect = disk, sphere = disk, sun = disk,
              point = disk;
    rect.shape = LightShape::rect;
    rect.size = {1.5, 0.7};
    sphere.shape = LightShape::sphere;
    sun.shape = LightShape::sun;
    sun.angularDiameter = 0.2;
    point.shape = LightShape::point;
    return {disk, rect, sphere, sun, point};
}

}  // namespace

TEST_CASE("streams of rays see what single rays see", "[baseline][twin]") {
    const Mixture mixture;
    CasterViews casters(mixture.views());
    auto scene = EmbreeReference::build(casters);
    REQUIRE(scene);
    const double offset = 1e-5 * glm::length(scene->boundsMax() - scene->boundsMin());
    const Points points = around(40);
    for (const AreaLight& light : lights()) {
        const light::LightSampler sampler(light);
        for (const std::uint32_t samples : {1u, 5u, 16u, 100u}) {
            const auto order = neighbourOrder(0, samples);
            std::vector<LightLook> looks;
            for (std::size_t i = 0; i < points.position.size(); ++i)
                looks.push_back({points.position[i],
                                 i % 4 ? points.normal[i] : glm::dvec3(0.0), i, 0});
            std::vector<LightSeen> seen(looks.size());
            scene->look(sampler, looks.data(), looks.size(), order.data(), order.size(),
                        seen.data(), false, {});
            int differ = 0;
            for (std::size_t i = 0; i < looks.size(); ++i) {
                double visible = 0.0;
                for (std::uint32_t s = 0; s < samples; ++s) {
                    const auto to = sampler.sample(looks[i].point,
                                                   base::SquareSequence(looks[i].key)(s));
                    const double length = glm::length(to.delta);
                    const bool level = looks[i].normal == glm::dvec3(0.0);
                    if (!level && !(glm::dot(to.delta, looks[i].normal) > 0)) continue;
                    const glm::dvec3 start =
                        offset * (level ? to.delta / length : looks[i].normal);
                    visible += scene
                                   ->visibility(looks[i].point + start,
                                                to.endless ? to.delta : to.delta - start,
                                                to.endless)
                                   .x;
                }
                CHECK(seen[i].total == samples);
                differ += std::abs(seen[i].visible.x - visible) > 1e-4 * samples;
            }
            // A ray at a rim, within a float's rounding, may go the other way.
            INFO("light " << int(light.shape) << ", " << samples << " samples");
            CHECK(differ <= 1);
        }
    }
}

TEST_CASE("an order of neighbours takes every sample once, those of a cell together",
          "[baseline]") {
    for (const auto& [begin, end] : {std::pair(0u, 4096u), {16u, 64u}, {0u, 7u}}) {
        auto order = neighbourOrder(begin, end);
        std::sort(order.begin(), order.end());
        REQUIRE(order.size() == end - begin);
        for (std::uint32_t i = 0; i < order.size(); ++i)
            CHECK(order[i] == begin + i);
    }
    const auto order = neighbourOrder(0, 1024);
    const base::SquareSequence other(0x123456789abcdefu);
    for (std::size_t i = 0; i < 1024; i += 16) {
        const glm::ivec2 cell(8.0 * other(order[i]));
        for (std::size_t k = i; k < i + 16; ++k)
            CHECK(glm::ivec2(8.0 * other(order[k])) == cell);
    }
}

TEST_CASE("every mode gives the closed form of a half-plane over a disk",
          "[baseline][statistical]") {
    const Mesh blocker = quad(-50, 0, -50, 50, 2);
    const Row row({blocker.view()});
    for (double x = -0.6; x <= 0.6; x += 0.2) {
        const double expected = halfPlaneShadow(x);
        const Points points = alongEdge(x, 100, 4);
        const auto agrees = [&](const Settings::Given& given, double samples) {
            // Four sigma of 400 points of so many samples, as if these were independent;
            // stratified they are better.
            const double sigma = std::sqrt(expected * (1 - expected) / samples / 400);
            CHECK(mean(row(diskAbove(4, 0.4), points.view(), given)) ==
                  Approx(expected).margin(4 * sigma + 1e-6));
        };
        INFO(x);
        agrees(mode("fixed", 1), 1);
        agrees(mode("fixed", 64), 64);
        agrees(mode("pixel", 1), 1);
        agrees(mode("pixel", 16), 16);
        agrees(mode("pixel", 3000), 3000);
    }
}

TEST_CASE(
    "mode adaptive is exact where all agree, and in a penumbra no worse than its "
    "first samples",
    "[baseline][statistical]") {
    const Mesh blocker = quad(-50, 0, -50, 50, 2);
    const Row row({blocker.view()});
    const AreaLight light = diskAbove(4, 0.4);
    for (const double x : {-0.6, 0.6}) {
        for (const float v : row(light, alongEdge(x, 10, 4).view(), mode("adaptive", 4)))
            CHECK(v == (x < 0 ? 1.0f : 0.0f));
    }
    for (const double x : {-0.17, 0.05, 0.13}) {
        const Points points = alongEdge(x, 400, 1);
        const double expected = halfPlaneShadow(x);
        const auto few = row(light, points.view(), mode("fixed", 16));
        const auto some = row(light, points.view(), mode("adaptive", 16, 256));
        const auto all = row(light, points.view(), mode("fixed", 256));
        // Deep in the penumbra 16 stratified samples never agree: it takes all 256.
        CHECK(some == all);
        CHECK(varianceOfMeans(some, 1, expected) <
              0.3 * varianceOfMeans(few, 1, expected));
    }
}

TEST_CASE("a half-transparent sheet shadows its opacity in every mode",
          "[baseline][exact]") {
    const Mesh sheet = quad(-50, 50, -50, 50, 2);
    MeshView view = sheet.view();
    view.opacity = 0.3f;
    const Row row({view});
    const Points points = alongEdge(0, 4, 5);
    for (const char* name : {"fixed", "adaptive", "pixel"}) {
        for (const float v : row(diskAbove(4, 0.4), points.view(), mode(name, 5)))
            CHECK(v == Approx(0.3).epsilon(1e-5));
    }
}

TEST_CASE("a light sample where a ray starts makes a ray of no length, which is clear",
          "[baseline][extreme]") {
    AreaLight light;
    light.shape = LightShape::point;
    light.position = {1, 0.5, 2};
    const light::LightSampler sampler(light);
    const std::uint32_t index = 0;
    for (const glm::dvec3 normal : {glm::dvec3(0, 1, 0), glm::dvec3(0.0)}) {
        const glm::dvec3 point = normal.y > 0 ? glm::dvec3(1, 0, 2) : light.position;
        RayStream stream;
        PointRays(sampler, point, normal, glm::dvec3(0.0), 0.5)
            .append(base::SquareSequence(1), &index, 1, 0, stream);
        REQUIRE(stream.count == 1);
        CHECK(stream.length[0] == 0.0f);
        CHECK(std::hypot(stream.dirX[0], stream.dirY[0], stream.dirZ[0]) == 1.0f);
    }
    const Mesh blocker = quad(-50, 50, -50, 50, 2);
    CasterViews casters({blocker.view()});
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    float found = -1.0f;
    truth->shadowFactors(light, &light.position, nullptr, 1, &found);
    CHECK(found == 0.0f);
}

TEST_CASE("casters for which there is no memory are refused", "[baseline][bad-input]") {
    struct Endless final : CasterSource {
        Status visit(const CasterVisitor&) override { throw std::bad_alloc(); }
    } casters;
    const auto truth = EmbreeReference::build(casters);
    REQUIRE(!truth);
    CHECK(truth.error().code == ErrorCode::tooLarge);
}

TEST_CASE("adaptive with as many samples first as at most is fixed", "[baseline]") {
    const Mixture mixture;
    const Row row(mixture.views());
    const Points points = around(100);
    for (const AreaLight& light : lights())
        CHECK(row(light, points.view(), mode("adaptive", 32, 32)) ==
              row(light, points.view(), mode("fixed", 32)));
}

TEST_CASE("points of a pixel that share a pattern have a better mean",
          "[baseline][statistical]") {
    const Mesh blocker = quad(-50, 0, -50, 50, 2);
    const Row row({blocker.view()});
    for (const double x : {-0.25, 0.05, 0.2}) {
        const double expected = halfPlaneShadow(x);
        for (const int samples : {1, 4}) {
            // 16 points of a pixel; as many pixels of a point.
            for (const std::size_t perPixel : {16u, 1u}) {
                const Points points = alongEdge(x, 6400 / perPixel, perPixel);
                const auto apart =
                    row(diskAbove(4, 0.4), points.view(), mode("fixed", samples));
                const auto shared =
                    row(diskAbove(4, 0.4), points.view(), mode("pixel", samples));
                INFO(x << ": " << samples << " samples, " << perPixel << " a pixel");
                // Of 16 n strata only those on the edge vary: about 4 sqrt(n) of them.
                CHECK(varianceOfMeans(shared, 16, expected) <
                      0.7 * varianceOfMeans(apart, 16, expected));
            }
        }
    }
}

TEST_CASE("shared patterns never repeat a sample, however many points a pixel has",
          "[baseline]") {
    Points points;
    for (const std::size_t count : {3u, 1u, 1u, 1u, 300u, 1u}) {
        for (std::size_t i = 0; i < count; ++i)
            points.add({double(points.position.size()), 0, 0});
        points.endPixel();
    }
    const auto patterns = sharedPatterns(points.view(), 100, 1);
    std::vector<std::pair<std::uint64_t, std::uint32_t>> seen;
    for (const SamplePattern& p : patterns) {
        CHECK(p.first + 100 <= 4096);
        seen.emplace_back(p.key, p.first);
    }
    std::sort(seen.begin(), seen.end());
    CHECK(std::unique(seen.begin(), seen.end()) == seen.end());
    CHECK(patterns[2].key == patterns[0].key);
    CHECK(patterns[3].key != patterns[2].key);
    CHECK(patterns[5].key == patterns[3].key);
    CHECK(patterns[6].key != patterns[5].key);
}

TEST_CASE("any number of threads gives the same answer", "[baseline]") {
    const Mixture mixture;
    const Row row(mixture.views());
    const Points points = around(1000);
    for (const char* name : {"fixed", "adaptive", "pixel"}) {
        const auto given = mode(name, 3);
        const auto many = row(lights()[0], points.view(), given);
        const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
        CHECK(row(lights()[0], points.view(), given) == many);
    }
}

TEST_CASE("rays begin where the receivers say", "[baseline]") {
    const Mesh blocker = quad(-50, 50, -50, 50, 2);
    const Row row({blocker.view()});
    Points points;
    points.add({0, 0, 0});
    points.endPixel();
    Receivers at = points.view();
    CHECK(row(diskAbove(4, 0.4), at, mode("fixed", 4))[0] == 1.0f);
    const glm::dvec3 start(0, 2.5, 0);
    at.starts = &start;
    CHECK(row(diskAbove(4, 0.4), at, mode("fixed", 4))[0] == 0.0f);
}

TEST_CASE("behind a one-sided light nothing is dark; light below the horizon is",
          "[baseline]") {
    const Mesh blocker = quad(-50, 50, -50, 50, 4.5f);
    const Row row({blocker.view()});
    Points points;
    points.add({0, 5, 0});
    points.add({1, 4, 0});
    points.add({0, 0, 0});
    points.endPixel();
    points.normal[2] = {0, -1, 0};
    for (const char* name : {"fixed", "adaptive", "pixel"}) {
        const auto found = row(diskAbove(4, 0.4), points.view(), mode(name, 4));
        CHECK(found == std::vector<float>{0.0f, 0.0f, 1.0f});
    }
}

TEST_CASE("what ray tracing holds is its tree and its casters", "[baseline]") {
    const Mesh body = test::bumpyBody(20'000);
    const Row row({body.view()});
    // 36 bytes of vertices and indices per two triangles at least.
    CHECK(row.bytes() > 20'000 * 18);
    CHECK(row.bytes() < 20'000 * 200);
}
