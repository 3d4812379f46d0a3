// The strands of a bake's near field: the casters' own, to a fraction of a pixel, or
// none.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/common.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <vector>

#include "bake/baked.h"
#include "bake/casters.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"
#include "trace/density_tree.h"

using namespace mtsm;
using mtsm::test::mustBake;
using mtsm::test::Random;

namespace {

/// Strands that own their arrays.
struct Hair {
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> begin{0};
    std::vector<float> widths, opacities;
    glm::dmat4 worldFromObject{1.0};

    void strand(const std::vector<glm::vec3>& more, float width, float opacity) {
        points.insert(points.end(), more.begin(), more.end());
        begin.push_back(std::uint32_t(points.size()));
        widths.resize(points.size(), width);
        opacities.resize(points.size(), opacity);
    }
    [[nodiscard]] StrandsView view() const {
        StrandsView v;
        v.points = points.data();
        v.begin = begin.data();
        v.strandCount = begin.size() - 1;
        v.widths = widths.data();
        v.opacities = opacities.data();
        v.worldFromObject = worldFromObject;
        return v;
    }
};

Hair randomHair(int strands) {
    Random random(5);
    Hair hair;
    for (int i = 0; i < strands; ++i) {
        std::vector<glm::vec3> points;
        glm::vec3 p(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1));
        for (int k = 0; k < 6; ++k) {
            points.push_back(p);
            p += 0.2f * glm::vec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1));
        }
        hair.strand(points, 0.01f, 0.4f);
    }
    for (float& width : hair.widths)
        width *= float(random.in(0.2, 1));
    return hair;
}

BakeOptions lamp() {
    BakeOptions o = test::diskAbove(64);
    o.nearField = kAutomaticNearField;
    return o;
}

struct Segment {
    glm::dvec3 end[2];  // straight space
    double half[2];
    double opacity;
};

std::vector<Segment> segmentsOf(const NearHair& hair) {
    std::vector<Segment> all;
    for (const NearHairChunk chunk : hair.chunks) {
        for (int t = 0; t < NearHairChunk::kSegments; ++t) {
            if (chunk.opacity[t] == 0) continue;
            Segment& s = all.emplace_back();
            for (int e = 0; e < 2; ++e) {
                s.end[e] = {chunk.at(e, 0, t), chunk.at(e, 1, t), chunk.at(e, 2, t)};
                s.half[e] = chunk.halfAt(e, t);
            }
            s.opacity = chunk.opacity[t] / 65535.0;
        }
    }
    return all;
}

/// By the definition.
std::vector<Segment> segmentsOf(const Hair& hair, const Projection& p) {
    const bool perspective = p.kind == ProjectionKind::perspective;
    const double grown = std::cbrt(glm::determinant(glm::dmat3(hair.worldFromObject)));
    std::vector<Segment> all;
    for (std::size_t s = 0; s + 1 < hair.begin.size(); ++s) {
        for (std::size_t i = hair.begin[s]; i + 1 < hair.begin[s + 1]; ++i) {
            Segment& segment = all.emplace_back();
            for (std::size_t e = 0; e < 2; ++e) {
                const glm::dvec3 light = p.lightFromWorld(
                    glm::dvec3(hair.worldFromObject * glm::dvec4(hair.points[i + e], 1)));
                segment.end[e] = glm::dvec3(p.rasterFromLight(light),
                                            perspective ? 1.0 / light.z : -light.z);
                segment.half[e] =
                    0.5 * hair.widths[i + e] * grown / (perspective ? light.z : 1.0);
            }
            segment.opacity = 0.5 * (hair.opacities[i] + double(hair.opacities[i + 1]));
        }
    }
    return all;
}

/// w in footprints, widths in pixels.
double distance(const Projection& p, const Segment& a, const Segment& b) {
    const bool perspective = p.kind == ProjectionKind::perspective;
    double most = std::abs(a.opacity - b.opacity);
    for (int e = 0; e < 2; ++e) {
        const glm::dvec3 d = glm::abs(a.end[e] - b.end[e]);
        const double footprint = p.pixelFootprint(1.0) * (perspective ? b.end[e].z : 1.0);
        most = std::max({most, d.x, d.y, d.z / footprint,
                         std::abs(a.half[e] - b.half[e]) * p.scale.x});
    }
    return most;
}

}  // namespace

TEST_CASE("the near field of hair is its segments, to a fraction of a pixel", "[bake]") {
    Hair hair = randomHair(40);
    hair.worldFromObject = glm::scale(
        glm::rotate(glm::dmat4(1.0), 0.3, glm::dvec3(0, 0, 1)), glm::dvec3(0.7));
    for (const bool sun : {false, true}) {
        BakeOptions o = lamp();
        if (sun) {
            o.light.shape = LightShape::sun;
            o.light.direction = {0.2, -1, 0.1};
        }
        const Baked b = mustBake({hair.view()}, o);
        CHECK(b.report.noNearField.empty());
        CHECK(b.report.nearSegments == 40 * 5);
        CHECK(b.report.nearTriangles == 0);
        CHECK(b.report.nearBytes == memoryBytes(b.map.nearHair(0)));
        const Projection& p = b.map.projection(0);
        std::vector<Segment> found = segmentsOf(b.map.nearHair(0));
        const std::vector<Segment> expected = segmentsOf(hair, p);
        REQUIRE(found.size() == expected.size());
        for (const Segment& s : expected) {
            const auto nearest = std::min_element(
                found.begin(), found.end(), [&](const Segment& x, const Segment& y) {
                    return distance(p, x, s) < distance(p, y, s);
                });
            CHECK(distance(p, *nearest, s) < 1.0 / 256);
            found.erase(nearest);
        }
    }
}

TEST_CASE("hair and opaque triangles have a near field together, nothing else has",
          "[bake]") {
    const Hair hair = randomHair(10);
    test::Mesh ball = test::bumpyBall(4);
    const Baked both = mustBake({hair.view(), ball.view()}, lamp());
    CHECK(both.report.noNearField.empty());
    CHECK(both.report.nearSegments == 10 * 5);
    CHECK(both.report.nearTriangles == 6 * 4 * 4 * 2);
    CHECK(both.map.nearHair(0).segments() == 10 * 5);
    CHECK(both.map.nearField(0).triangles() == 6 * 4 * 4 * 2);

    test::Mesh glass = ball;
    glass.opacity = 0.5f;
    const glm::ivec3 block(0);
    const std::vector<float> density(VolumeView::kBlockVoxels, 0.1f);
    VolumeView fog;
    fog.blocks = &block;
    fog.blockCount = 1;
    fog.density = density.data();
    fog.worldFromIndex = glm::scale(glm::dmat4(1.0), glm::dvec3(0.1));
    for (const CasterView& other : {CasterView(glass.view()), CasterView(fog)}) {
        const Baked b = mustBake({hair.view(), ball.view(), other}, lamp());
        CHECK(b.map.nearHair(0).empty());
        CHECK(b.map.nearField(0).empty());
        CHECK(b.report.nearBytes == 0);
        CHECK_THAT(b.report.noNearField, Catch::Contains("all opaque triangles"));
    }
}

TEST_CASE("beside near hair rays to a light need no finest densities, others do",
          "[bake]") {
    const Hair hair = randomHair(200);
    BakeOptions o = lamp();
    for (const bool near : {true, false}) {
        o.nearField = near ? kAutomaticNearField : 0;
        const ShadowMap map = mustBake({hair.view()}, o).map;
        using trace::DensityUse;
        const auto* light = trace::densityTrees(map, DensityUse::receivers);
        const auto* rays = trace::densityTrees(map, DensityUse::rays);
        REQUIRE((light && rays));
        CHECK((*light)[0].finest() == (near ? trace::kFinestBesideNear : 0));
        CHECK((*rays)[0].finest() == 0);
        CHECK((light == rays) == !near);
        // What rays meet is the same with a near field.
        CHECK((*rays)[0].memoryBytes() >= (*light)[0].memoryBytes());
    }
}

TEST_CASE("a near field of hair is kept within its budget", "[bake]") {
    const Hair hair = randomHair(400);
    BakeOptions o = lamp();
    const Baked all = mustBake({hair.view()}, o);
    const std::uint64_t bytes = all.report.nearBytes;
    CHECK(bytes < 400 * 5 * 21);
    for (const std::uint64_t less : {bytes - 1, bytes / 3}) {
        o.nearField = less;
        const Baked b = mustBake({hair.view()}, o);
        CHECK(b.map.nearHair(0).empty());
        CHECK(b.report.nearSegments == 400 * 5);
        CHECK(b.report.nearBytes < bytes * 5 / 4);
        CHECK_THAT(b.report.noNearField, Catch::Contains("--near-field 1M"));
    }
}

TEST_CASE("strands that cast nothing have no place in a near field", "[bake]") {
    BakeOptions o = lamp();
    o.target = glm::dvec3(0, 0, 0);
    o.fov = 0.5;  // about one to each side
    o.near = 1.0;
    const auto count = [&](const std::vector<glm::vec3>& points, float width,
                           float opacity) {
        Hair hair = randomHair(0);
        hair.strand({{-0.5f, 0, 0}, {0.5f, 0, 0}}, 0.01f, 1.0f);
        hair.strand(points, width, opacity);
        return mustBake({hair.view()}, o).report.nearSegments - 1;
    };
    CHECK(count({{0, 0, 0.1f}, {0.2f, 0, 0.1f}}, 0.01f, 0.5f) == 1);
    CHECK(count({{0, 0, 0.1f}, {0.2f, 0, 0.1f}}, 0.01f, 0.0f) == 0);
    CHECK(count({{0, 0, 0.1f}, {0.2f, 0, 0.1f}}, 0.0f, 0.5f) == 0);
    CHECK(count({{0, 0, 0.1f}}, 0.01f, 0.5f) == 0);
    CHECK(count({{0, 0, 0.1f}, {NAN, 0, 0.1f}}, 0.01f, 0.5f) == 0);
    CHECK(count({{3, 0, 0.1f}, {4, 0, 0.1f}}, 0.01f, 0.5f) == 0);     // beside
    CHECK(count({{0.5f, 0, 0.1f}, {4, 0, 0.1f}}, 0.01f, 0.5f) == 1);  // reaches in
    CHECK(count({{0, 5, 0.1f}, {0.2f, 5, 0.1f}}, 0.01f, 0.5f) == 0);  // behind the light
    CHECK(count({{0, 3.5f, 0}, {0.1f, 3.5f, 0}}, 0.01f, 0.5f) == 0);  // before near
    CHECK(count({{0, 5, 0.1f}, {0, -5, 0.1f}}, 0.01f, 0.5f) == 1);    // cut at near
    CHECK(count({{-900, 0, 0.1f}, {900, 0, 0.1f}}, 0.01f, 0.5f) == 1);  // cut around it
}

TEST_CASE("strands are as wide as they are along their length", "[bake]") {
    // Three long and .02 to .04 wide, one long and .1 wide, and what is not a number, in
    // a box of 2 x 3 x 6; twice as large.
    Hair hair;
    hair.strand({{0, 0, 0}, {0, 3, 0}}, 0.02f, 0.4f);
    hair.widths[1] = 0.04f;
    hair.strand({{2, 0, 6}, {2, 1, 6}, {2, NAN, 6}}, 0.1f, 0.4f);
    hair.worldFromObject = glm::scale(glm::dmat4(1.0), glm::dvec3(-2.0, 2.0, 2.0));
    CasterViews casters({hair.view()});
    const auto found = measureCasters(casters);
    REQUIRE(found);
    CHECK(found->strands == 2);
    CHECK(found->strandWidth == Approx((3 * 0.03 + 1 * 0.1) / 4 / 6).epsilon(1e-6));
    // Beside a floor that is ten times as large a map's pixels are, too.
    test::Mesh floor;
    floor.quad({-10, 0, 0}, {-10, 0, 120}, {114, 0, 120}, {114, 0, 0});
    CasterViews both({hair.view(), floor.view()});
    const auto wider = measureCasters(both);
    REQUIRE(wider);
    CHECK(wider->strandWidth == Approx(0.19 / 4 * 2 / 124).epsilon(1e-6));
}

TEST_CASE("a near field of hair does not depend on threads or on the order of strands",
          "[bake][threads]") {
    const Hair hair = randomHair(3000);
    Hair backwards;
    for (std::size_t s = hair.begin.size() - 1; s-- > 0;) {
        const std::size_t first = hair.begin[s], end = hair.begin[s + 1];
        for (std::size_t i = first; i < end; ++i) {
            backwards.points.push_back(hair.points[i]);
            backwards.widths.push_back(hair.widths[i]);
            backwards.opacities.push_back(hair.opacities[i]);
        }
        backwards.begin.push_back(std::uint32_t(backwards.points.size()));
    }
    const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 8);
    const Baked one =
        tbb::task_arena(1).execute([&] { return mustBake({hair.view()}, lamp()); });
    const Baked many =
        tbb::task_arena(8).execute([&] { return mustBake({backwards.view()}, lamp()); });
    const auto& a = one.map.nearHair(0).chunks;
    const auto& b = many.map.nearHair(0).chunks;
    REQUIRE(a.size() == b.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const NearHairChunk x = a[i], y = b[i];
        different += std::memcmp(&x, &y, sizeof x) != 0;
    }
    CHECK(different == 0);
}

namespace {

/// Part of the disk light that strands hide from a point, with flat ribbons that face the
/// ray: a grid of points on the light in double.
double hidden(const Hair& hair, const AreaLight& light, glm::dvec3 p, int side = 200) {
    double sum = 0.0;
    int rays = 0;
    for (int i = 0; i < side * side; ++i) {
        const double x = (i % side + 0.5) / side * 2 - 1;
        const double y = (i / side + 0.5) / side * 2 - 1;
        if (x * x + y * y > 1.0) continue;
        // The light looks down.
        const glm::dvec3 way = light.position + light.radius * glm::dvec3(x, 0, y) - p;
        double left = 1.0;
        for (std::size_t k = 0; k + 1 < hair.points.size(); k += 2) {
            const glm::dvec3 a = hair.points[k], b = hair.points[k + 1];
            const glm::dvec3 n = glm::normalize(glm::cross(b - a, way));
            const glm::dvec3 across = glm::cross(n, b - a);
            const double s = glm::dot(across, a - p) / glm::dot(across, way);
            const glm::dvec3 at = p + s * way - a;
            const double t = glm::dot(at, b - a) / glm::dot(b - a, b - a);
            if (s > 0.0 && t >= 0.0 && t <= 1.0 &&
                std::abs(glm::dot(at, n)) <= 0.5 * hair.widths[k])
                left *= 1.0 - hair.opacities[k];
        }
        sum += 1.0 - left;
        ++rays;
    }
    return sum / rays;
}

}  // namespace

TEST_CASE("the shadow of hair is right beside the hair itself", "[bake][statistical]") {
    // Thinner than a pixel of the map, up to two pixels above the points.
    Hair hair;
    hair.strand({{-0.8f, 0.02f, 0.0f}, {0.8f, 0.05f, 0.3f}}, 0.006f, 0.6f);
    hair.strand({{-0.8f, 0.09f, 0.2f}, {0.8f, 0.01f, -0.1f}}, 0.009f, 0.4f);
    BakeOptions o = lamp();
    o.target = glm::dvec3(0, 0, 0);
    o.fov = 0.5;
    const Baked with = mustBake({hair.view()}, o);
    o.nearField = 0;
    const Baked without = mustBake({hair.view()}, o);
    CHECK(with.map.projection(0).pixelFootprint(4.0) > 0.03);
    std::vector<glm::dvec3> points, normals;
    Random random(9);
    for (int i = 0; i < 60; ++i) {
        points.emplace_back(random.in(-0.7, 0.7), 0.0, random.in(-0.2, 0.4));
        normals.emplace_back(0, 1, 0);
    }
    ShadowOptions query;
    query.samples = 1024;
    double errorWith = 0.0, errorWithout = 0.0, shadow = 0.0;
    for (const bool withNormals : {true, false}) {
        const auto ask = [&](const ShadowMap& map) {
            std::vector<float> out(points.size());
            shadowFactors(map, o.light, points.data(),
                          withNormals ? normals.data() : nullptr, points.size(),
                          out.data(), query);
            return out;
        };
        const std::vector<float> a = ask(with.map), b = ask(without.map);
        for (std::size_t i = 0; i < points.size(); ++i) {
            const double expected = hidden(hair, o.light, points[i]);
            // Without a normal strands count from 0.3 footprints on: 0.01.
            CHECK(std::abs(a[i] - expected) < 0.03);
            errorWith += std::abs(a[i] - expected) / double(2 * points.size());
            errorWithout += std::abs(b[i] - expected) / double(2 * points.size());
            shadow += expected / double(2 * points.size());
            // Each by itself.
            float alone = 0.0f;
            shadowFactors(with.map, o.light, &points[i],
                          withNormals ? &normals[i] : nullptr, 1, &alone, query);
            CHECK(alone == a[i]);
        }
    }
    INFO("mean errors " << errorWith << " and " << errorWithout << " of " << shadow);
    CHECK(shadow > 0.01);
    CHECK(errorWith < 0.001);
    CHECK(errorWithout > 0.01);
}

TEST_CASE("where layers are few the near field answers farther", "[bake][statistical]") {
    // In a box of strands, under a light as wide.
    Random random(21);
    Hair hair;
    for (int i = 0; i < 300; ++i) {
        const glm::vec3 from(random.in(-1, 1), random.in(0, 1.5), random.in(-1, 1));
        const glm::vec3 way = glm::vec3(random.direction());
        hair.strand({from, from + 0.5f * way}, 0.02f, 0.7f);
    }
    BakeOptions o = lamp();
    o.light.radius = 1.0;
    o.layers = 3;
    const Baked baked = mustBake({hair.view()}, o);
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 40; ++i)
        points.emplace_back(random.in(-0.6, 0.6), random.in(0.1, 0.7),
                            random.in(-0.6, 0.6));
    ShadowOptions query;
    query.samples = 1024;
    std::vector<float> found(points.size());
    shadowFactors(baked.map, o.light, points.data(), nullptr, points.size(), found.data(),
                  query);
    double error = 0.0, shadow = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double expected = hidden(hair, o.light, points[i], 64);
        error += std::abs(found[i] - expected) / double(points.size());
        shadow += expected / double(points.size());
    }
    INFO("mean error " << error << " of " << shadow);
    CHECK(shadow > 0.1);
    CHECK(error < 0.005);
}

TEST_CASE("strands wider than a pixel let through what is between them",
          "[bake][exact]") {
    Hair comb;  // half of it is gaps
    for (int i = -30; i < 30; ++i) {
        const auto x = float(0.02 * i);
        comb.strand({{x, 0, -0.6f}, {x, 0, 0.6f}}, 0.01f, 1.0f);
    }
    test::Mesh aside;  // below nothing that is asked for
    aside.positions = {{0.6f, 0, 0.6f}, {0.65f, 0, 0.6f}, {0.6f, 0, 0.65f}};
    aside.indices = {0, 1, 2};
    std::vector<glm::dvec3> points;
    Random random(3);
    for (int i = 0; i < 300; ++i)
        points.emplace_back(random.in(-0.3, 0.3), -1.0, random.in(-0.3, 0.3));
    // Where strands are not all that there is, or are not known to be, what fills a pixel
    // is apart from what fills a part of one, and met within a bias.
    const bool alone = GENERATE(true, false), near = GENERATE(true, false);
    const double most = alone && near ? 0.006 : 0.015;
    for (const double pixels : {2.5, 5.0}) {  // to a strand's width
        BakeOptions o = lamp();
        o.target = glm::dvec3(0, 0, 0);
        o.width = o.height = std::uint32_t(1.4 * pixels / 0.01);
        o.fov = 2.0 * std::atan(0.7 / o.light.position.y);
        if (!near) o.nearField = 0;
        std::vector<CasterView> casters = {comb.view()};
        if (!alone) casters.emplace_back(aside.view());
        const Baked baked = mustBake(casters, o);
        REQUIRE(baked.map.nearHair(0).empty() == !near);
        REQUIRE(baked.map.nearField(0).empty() == !(near && !alone));
        for (const int samples : {64, 256}) {
            ShadowOptions query;
            query.samples = samples;
            std::vector<float> dark(points.size());
            shadowFactors(baked.map, o.light, points.data(), nullptr, points.size(),
                          dark.data(), query);
            double mean = 0.0;
            for (const float d : dark)
                mean += d / double(points.size());
            INFO(pixels << " pixels a strand, " << samples << " samples, alone " << alone
                        << ", near field " << near);
            CHECK(std::abs(mean - 0.5) < most);
        }
    }
}

TEST_CASE("a strand that leads towards the light lets nothing through",
          "[bake][statistical]") {
    Hair blade;
    constexpr double kHalf = 0.005, kTop = 0.4;
    blade.strand({{0, 0, 0}, {0, float(kTop), 0}}, float(2 * kHalf), 1.0f);
    BakeOptions o;
    o.light.shape = LightShape::sphere;
    o.light.radius = 0.1;
    o.nearField = kAutomaticNearField;
    std::vector<glm::dvec3> points;  // along its shadow, 25 and 45 degrees from the light
    for (int i = 1; i <= 60; ++i)
        points.emplace_back(-0.001 * i, 0.0, -0.001 * i);
    const std::vector<glm::dvec3> up(points.size(), glm::dvec3(0, 1, 0));
    for (const glm::dvec3 position : {glm::dvec3(1, 3, 1), glm::dvec3(2, 3, 2)}) {
        o.light.position = position;
        // A ray is blocked if it passes the middle line by less than half a width: the
        // line is x = z = 0, so what counts is how it passes that from above.
        double expected = 0.0;
        Random random(4);
        constexpr int kRays = 20'000;
        for (int ray = 0; ray < kRays; ++ray) {
            const glm::dvec3 p = points[std::size_t(ray) % points.size()];
            glm::dvec3 d;
            do
                d = {random.in(-1, 1), random.in(-1, 1), random.in(-1, 1)};
            while (glm::length(d) > 1.0);
            d = position + 0.1 * glm::normalize(d) - p;
            const double t = -(p.x * d.x + p.z * d.z) / (d.x * d.x + d.z * d.z);
            const double away = std::hypot(p.x + t * d.x, p.z + t * d.z);
            expected += t > 0.0 && away < kHalf && p.y + t * d.y < kTop;
        }
        expected /= kRays;
        for (const std::uint32_t resolution : {64u, 256u, 512u}) {
            o.width = o.height = resolution;
            const Baked baked = mustBake({blade.view()}, o);
            REQUIRE(!baked.map.nearHair(0).empty());
            for (const int samples : {64, 1024}) {
                ShadowOptions query;
                query.samples = samples;
                std::vector<float> dark(points.size());
                shadowFactors(baked.map, o.light, points.data(), up.data(), points.size(),
                              dark.data(), query);
                double mean = 0.0;
                for (const float d : dark)
                    mean += d / double(points.size());
                INFO(position.x << " at " << resolution << ", " << samples << " samples");
                CHECK(mean == Approx(expected).margin(0.03));
            }
        }
    }
}
