// The ray-traced reference with casters that let light through, against closed forms and
// brute force in double.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <random>

#include "baseline/floor_scene.h"
#include "baseline/reference_embree.h"
#include "bumpy_mesh.h"

using namespace mtsm;
using baseline::EmbreeReference;
using test::Mesh;
using test::quad;

namespace {

struct Strands {
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> begin{0};
    float width = 0.1f, opacity = 0.4f;

    Strands& add(const std::vector<glm::vec3>& strand) {
        points.insert(points.end(), strand.begin(), strand.end());
        begin.push_back(std::uint32_t(points.size()));
        return *this;
    }
    [[nodiscard]] StrandsView view() const {
        StrandsView v;
        v.points = points.data();
        v.begin = begin.data();
        v.strandCount = begin.size() - 1;
        v.width = width;
        v.opacity = opacity;
        return v;
    }
};

struct Random {
    std::mt19937_64 engine{11};
    double operator()(double low, double high) {
        return low + (high - low) * double(engine() >> 11) * 0x1p-53;
    }
    glm::dvec3 inCube(double side) {
        const double x = (*this)(-side, side), y = (*this)(-side, side);
        return {x, y, (*this)(-side, side)};
    }
};

EmbreeReference build(std::vector<CasterView> views) {
    CasterViews casters(std::move(views));
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    return std::move(*truth);
}

/// Share of the unit disk left of the line at x.
double diskShare(double x) {
    x = std::clamp(x, -1.0, 1.0);
    return (glm::pi<double>() - std::acos(x) + x * std::sqrt(1 - x * x)) /
           glm::pi<double>();
}

AreaLight lightAbove(double height, double radius) {
    AreaLight light;
    light.shape = radius > 0 ? LightShape::disk : LightShape::point;
    light.position = {0, height, 0};
    light.direction = {0, -1, 0};
    light.radius = radius;
    return light;
}

float shadow(const EmbreeReference& truth, const AreaLight& light, glm::dvec3 point) {
    const glm::dvec3 normal(0, 1, 0);
    float found = -1.0f;
    truth.shadowFactors(light, &point, &normal, 1, &found);
    return found;
}

/// How often a ray of unit direction crosses a polyline of this radius, seen along the
/// ray: runs of segments that it meets. The line's ends are flat, its joints round.
int crossings(const std::vector<glm::vec3>& line, double radius, glm::dvec3 origin,
              glm::dvec3 d) {
    int runs = 0;
    bool before = false;
    for (std::size_t i = 0; i + 1 < line.size(); ++i) {
        const glm::dvec3 a = glm::dvec3(line[i]) - origin,
                         b = glm::dvec3(line[i + 1]) - origin;
        const glm::dvec3 flatA = a - glm::dot(a, d) * d, flatB = b - glm::dot(b, d) * d;
        const glm::dvec3 v = flatB - flatA;
        const double u = -glm::dot(flatA, v) / glm::dot(v, v);
        const bool beyond = (u < 0 && i == 0) || (u > 1 && i + 2 == line.size());
        const bool met =
            !beyond && glm::length(flatA + std::clamp(u, 0.0, 1.0) * v) <= radius;
        runs += met && !before;
        before = met;
    }
    return runs;
}

/// A block of 8 x 8 x 8 voxels at every given corner.
struct Volume {
    std::vector<glm::ivec3> blocks;
    std::vector<float> density;

    Volume& add(glm::ivec3 corner, float value) {
        blocks.push_back(corner);
        density.insert(density.end(), std::size_t(VolumeView::kBlockVoxels), value);
        return *this;
    }
    [[nodiscard]] VolumeView view() const {
        VolumeView v;
        v.blocks = blocks.data();
        v.blockCount = blocks.size();
        v.density = density.data();
        return v;
    }
};

}  // namespace

TEST_CASE("the reference lets (1 - a)^n through n sheets of opacity a, at any slant",
          "[baseline][exact]") {
    const float a = 0.3f;
    for (const int n : {1, 2, 7}) {
        std::vector<Mesh> sheets;
        for (int i = 0; i < n; ++i)
            sheets.push_back(quad(-100, 100, -100, 100, 1.0f + 0.1f * float(i)));
        std::vector<CasterView> views;
        for (const Mesh& sheet : sheets) {
            MeshView view = sheet.view();
            view.opacity = a;
            views.emplace_back(view);
        }
        const EmbreeReference truth = build(views);
        for (const glm::dvec3 d :
             {glm::dvec3(0, 3, 0), {1, 3, 0.3}, {7, 3, -4}, {-30, 3, 20}}) {
            const glm::vec3 left = truth.visibility({0.1, 0, 0.2}, d);
            CHECK(left.x == Approx(std::pow(1.0 - a, n)).epsilon(1e-5));
        }
    }
}

TEST_CASE("a ray through an edge or a corner of triangles crosses their sheet once",
          "[baseline][exact]") {
    // Sheets of 4 x 4 squares around the origin, their diagonals through common corners;
    // `split`: each triangle has vertices of its own, as a seam of a texture makes them.
    const auto sheetAt = [](float height, bool split) {
        Mesh sheet;
        for (int i = 0; i < 16; ++i) {
            const auto x = float(i % 4) - 2, z = float(i / 4) - 2;
            for (const glm::vec2 c :
                 {glm::vec2(0, 0), {1, 0}, {1, 1}, {0, 0}, {1, 1}, {0, 1}}) {
                const glm::vec3 p(x + c.x, height, z + c.y);
                const auto known =
                    split ? sheet.positions.end()
                          : std::find(sheet.positions.begin(), sheet.positions.end(), p);
                sheet.indices.push_back(std::uint32_t(known - sheet.positions.begin()));
                if (known == sheet.positions.end()) sheet.positions.push_back(p);
            }
        }
        return sheet;
    };
    for (const bool split : {false, true}) {
        const Mesh low = sheetAt(1, split), high = sheetAt(1.125f, split);
        MeshView below = low.view(), above = high.view();
        below.opacity = above.opacity = 0.5f;
        const EmbreeReference one = build({below}), two = build({below, above});
        // Along diagonals, edges, through corners; straight up and slanted.
        for (const glm::dvec3 d : {glm::dvec3(0, 3, 0), {1, 4, 1}, {0.5, 2, 0.25}}) {
            for (int i = -6; i <= 6; ++i) {
                const double s = i / 4.0;
                for (const glm::dvec3 at :
                     {glm::dvec3(s, 1, s), {s, 1, 0}, {1, 1, s}, {s, 1, s - 0.125}}) {
                    const glm::dvec3 from = at - d / d.y;
                    INFO("through " << at.x << ", " << at.z);
                    CHECK(one.visibility(from, d).x == 0.5f);
                    CHECK(two.visibility(from, d).x == 0.25f);
                    AreaLight light = lightAbove(0, 0);
                    light.position = from + d;
                    CHECK(shadow(two, light, from) == 0.75f);
                }
            }
        }
    }
}

TEST_CASE("sheets of one mesh that a ray crosses through edges all count",
          "[baseline][exact]") {
    Mesh stack;
    for (int i = 0; i < 6; ++i) {
        const Mesh sheet = quad(-1, 1, -1, 1, 1.0f + 0.01f * float(i));
        for (const std::uint32_t k : sheet.indices)
            stack.indices.push_back(k + std::uint32_t(stack.positions.size()));
        stack.positions.insert(stack.positions.end(), sheet.positions.begin(),
                               sheet.positions.end());
    }
    MeshView view = stack.view();
    view.opacity = 0.5f;
    const EmbreeReference truth = build({view});
    for (const double s : {-0.5, 0.0, 0.25})
        CHECK(truth.visibility({s, 0, s}, {0, 3, 0}).x == std::pow(0.5f, 6.0f));
}

TEST_CASE("tinted sheets colour the light; without colour their opacity counts",
          "[baseline][exact]") {
    const Mesh sheet = quad(-100, 100, -100, 100, 1);
    MeshView view = sheet.view();
    view.opacity = 0.4f;
    view.tint = {1.0f, 0.5f, 0.0f};
    const EmbreeReference truth = build({view});
    // What passes, .6, loses (1 - tint) of the share .4 that the surface tints.
    const glm::vec3 expected = 1.0f - channelOpacity(0.4f, view.tint);
    CHECK(expected.y == Approx(0.6 * (1 - 0.4 * 0.5)));
    const glm::vec3 found = truth.visibility({0, 0, 0}, {0.5, 2, 0}, false, true);
    for (int c = 0; c < 3; ++c)
        CHECK(found[c] == Approx(expected[c]).epsilon(1e-5));
    CHECK(truth.visibility({0, 0, 0}, {0.5, 2, 0}).x == Approx(0.6).epsilon(1e-5));

    const glm::dvec3 point(0.0), normal(0, 1, 0);
    glm::vec3 factor(-1.0f);
    truth.shadowFactors(lightAbove(3, 0.5), &point, &normal, 1, &factor);
    for (int c = 0; c < 3; ++c)
        CHECK(factor[c] == Approx(1 - expected[c]).epsilon(1e-5));
}

TEST_CASE("a textured card shadows where its texels are opaque", "[baseline][exact]") {
    // u runs from 0 at x = -1 to 1 at x = 1; the interpolated alpha meets the cutoff at
    // u = .5, so the half at x > 0 is there.
    const Mesh card = quad(-1, 1, -50, 50, 2);
    const std::vector<glm::vec2> uvs{{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    OpacityImage image;
    image.width = 2;
    image.height = 1;
    image.texels = {0.0f, 1.0f};
    image.wrapU = image.wrapV = TextureWrap::clamp;
    image.cutoff = 0.5f;
    const auto mask = OpacityTexture::create(image);
    REQUIRE(mask);
    image = OpacityImage();
    image.width = image.height = 1;
    image.channels = 3;
    image.texels = {0.25f, 0.5f, 0.9f};
    const auto glass = OpacityTexture::create(image);
    REQUIRE(glass);
    MeshView view = card.view();
    view.uvs = uvs.data();

    SECTION("a mask is there or not, and its edge has the penumbra of an edge") {
        view.texture = &*mask;
        const EmbreeReference truth = build({view});
        CHECK(truth.visibility({0.4, 0, 0}, {0, 3, 0}).x == 0.0f);
        CHECK(truth.visibility({-0.4, 0, 0}, {0, 3, 0}).x == 1.0f);
        CHECK(truth.firstHit({0.4, 0, 0}, {0, 3, 0}));
        CHECK(!truth.firstHit({-0.4, 0, 0}, {0, 3, 0}));
        // Half way up to a light of radius .4: the edge appears at -x on its plane.
        for (double x = -0.35; x < 0.4; x += 0.1)
            CHECK(shadow(truth, lightAbove(4, 0.4), {x, 0, 0.1}) ==
                  Approx(1 - diskShare(-x / 0.4)).margin(4 * std::sqrt(64.0) / 4096));
    }
    SECTION("a coloured texture colours, and its mean counts without colour") {
        view.texture = &*glass;
        const EmbreeReference truth = build({view});
        const glm::vec3 found = truth.visibility({0.3, 0, 0.1}, {0, 3, 0}, false, true);
        CHECK(found.x == Approx(0.75));
        CHECK(found.y == Approx(0.5));
        CHECK(found.z == Approx(0.1));
        CHECK(truth.visibility({0.3, 0, 0.1}, {0, 3, 0}).x == Approx(1 - 0.55));
    }
}

TEST_CASE("a strand before a point light shadows its width, by its opacity",
          "[baseline][exact]") {
    Strands hair;
    hair.add({{0, 2, -5}, {0, 2, -1}, {0, 2, 0.05f}, {0, 2, 5}});
    const EmbreeReference truth = build({hair.view()});
    // Seen from the floor at x the ray to the light at (0, 4) passes the axis at (0, 2)
    // at the distance 2 |x| / |(x, 4)|; the ribbon faces it.
    for (double x = -0.3; x <= 0.3; x += 0.007) {
        const double apart = 2 * std::abs(x) / std::hypot(x, 4.0);
        const double expected = apart <= 0.05 ? 0.4 : 0.0;
        INFO(x);
        CHECK(shadow(truth, lightAbove(4, 0), {x, 0, 0.02}) ==
              Approx(expected).margin(1e-6));
    }
}

TEST_CASE("a strand before a disk light has the penumbra of a strip",
          "[baseline][exact]") {
    Strands hair;
    std::vector<glm::vec3> line;
    for (int i = -250; i <= 250; ++i)
        line.emplace_back(0.0f, 2.0f, 0.1f * float(i));
    hair.add(line);
    const EmbreeReference truth = build({hair.view()});
    const double R = 0.4, H = 4, h = 2, r = 0.05;
    for (double x = -0.6; x <= 0.6; x += 0.05) {
        // In the plane across the strand, the ray to the light's (x + u, H) passes the
        // axis at |u h + x H| / |(u, H)|. It is r at the roots of a quadratic in u.
        const double a = h * h - r * r, b = x * H * h, c = H * H * (x * x - r * r);
        const double root = std::sqrt(b * b - a * c);
        const double from = (x + (-b - root) / a) / R, to = (x + (-b + root) / a) / R;
        const double expected = 0.4 * (diskShare(to) - diskShare(from));
        INFO(x);
        CHECK(shadow(truth, lightAbove(H, R), {x, 0, 0.013}) ==
              Approx(expected).margin(0.4 * 8 * std::sqrt(64.0) / 4096));
    }
}

TEST_CASE("a bent strand is crossed once around its joint, as brute force says",
          "[baseline][exact]") {
    // Segments longer and shorter than the strand is wide, turning to all sides.
    const std::vector<std::vector<glm::vec3>> lines{
        {{-1, 0, 0}, {0, 0, 0}, {0.7f, 0.7f, 0.3f}},
        {{-1, 0, 0}, {0, 0, 0}, {0.05f, 0.03f, 0}, {0.08f, 0.09f, 0.02f}, {0.1f, 1, 0}},
        {{-1, 0, 0}, {0, 0, 0}, {-0.2f, 0.02f, 0.1f}}};
    Random random;
    for (const auto& line : lines) {
        Strands hair;
        hair.add(line);
        const EmbreeReference truth = build({hair.view()});
        int met = 0, wrong = 0;
        for (int i = 0; i < 20000; ++i) {
            const glm::dvec3 to = random.inCube(0.15);
            const glm::dvec3 d = glm::normalize(random.inCube(1.0));
            const int expected = crossings(line, 0.05, to - 4.0 * d, d);
            // At the rim the float of Embree decides otherwise than the double here.
            if (expected != crossings(line, 0.05 + 1e-5, to - 4.0 * d, d) ||
                expected != crossings(line, 0.05 - 1e-5, to - 4.0 * d, d))
                continue;
            const float left = truth.visibility(to - 4.0 * d, 8.0 * d).x;
            wrong += left != Approx(std::pow(0.6, expected)).epsilon(1e-5);
            met += expected > 0;
        }
        CHECK(wrong == 0);
        CHECK(met > 5000);
    }
}

TEST_CASE("a strand that comes back is crossed again, and so is every other strand",
          "[baseline][exact]") {
    Strands hair;
    hair.add({{-1, 1, 0}, {1, 1, 0}, {1, 2, 0}, {-1, 2, 0}});
    hair.add({{0, 3, -1}, {0, 3, 1}}).add({{0, 3.5f, -1}, {0, 3.5f, 1}});
    const EmbreeReference truth = build({hair.view()});
    CHECK(truth.visibility({0.5, 0, 0}, {0, 5, 0}).x == Approx(0.36).epsilon(1e-5));
    CHECK(truth.visibility({0, 0, 0.5}, {0, 5, 0}).x == Approx(0.36).epsilon(1e-5));
    CHECK(truth.visibility({0, 0, 0}, {0, 5, 0}).x == Approx(0.1296).epsilon(1e-5));
    CHECK(truth.visibility({0, 0, 0}, {0, 2.5, 0}).x == Approx(0.36).epsilon(1e-5));
}

TEST_CASE("width and opacity of a strand run evenly from point to point",
          "[baseline][exact]") {
    Strands hair;
    hair.add({{0, 1, 0}, {2, 1, 0}});
    const std::vector<float> widths{0.4f, 0.0f}, opacities{0.2f, 0.8f};
    StrandsView view = hair.view();
    view.widths = widths.data();
    view.opacities = opacities.data();
    const EmbreeReference truth = build({view});
    for (double u = 0.05; u < 1; u += 0.1) {
        const double radius = 0.2 * (1 - u);
        const glm::dvec3 up(0, 3, 0);
        CHECK(truth.visibility({2 * u, 0, 0.98 * radius}, up).x ==
              Approx(1 - (0.2 + 0.6 * u)).epsilon(1e-5));
        CHECK(truth.visibility({2 * u, 0, 1.02 * radius}, up).x == 1.0f);
    }
}

TEST_CASE("widths grow by the cube root of a transform's determinant",
          "[baseline][exact]") {
    Strands hair;
    hair.add({{-1, 0.25f, 0}, {1, 0.25f, 0}});
    StrandsView view = hair.view();
    view.worldFromObject = glm::scale(glm::dmat4(1.0), glm::dvec3(-2, 4, 1));
    const EmbreeReference truth = build({view});
    CHECK(truth.visibility({0.5, 0, 0.09}, {0, 3, 0}).x == Approx(0.6).epsilon(1e-5));
    CHECK(truth.visibility({0.5, 0, 0.11}, {0, 3, 0}).x == 1.0f);
}

TEST_CASE("a strand's ends are flat", "[baseline][exact]") {
    Strands hair;
    hair.add({{-1, 1, 0}, {1, 1, 0}});
    const EmbreeReference truth = build({hair.view()});
    CHECK(truth.visibility({0.99, 0, 0}, {0, 3, 0}).x == Approx(0.6).epsilon(1e-5));
    CHECK(truth.visibility({1.01, 0, 0}, {0, 3, 0}).x == 1.0f);
    CHECK(truth.visibility({-1.01, 0, 0}, {0, 3, 0}).x == 1.0f);
    CHECK(truth.firstHit({0.99, 0, 0}, {0, 3, 0}));
    CHECK(!truth.firstHit({1.01, 0, 0}, {0, 3, 0}));
    CHECK(!truth.firstHit({-1.01, 0, 0}, {0, 3, 0}));
}

TEST_CASE("a strand shadows all that lies before it, but not what lies within it",
          "[baseline]") {
    Strands hair;
    hair.add({{-1, 1, 0}, {1, 1, 0}});
    const EmbreeReference truth = build({hair.view()});
    // Up to its radius, .05.
    for (const double below : {-0.06, -0.04, 0.0, 0.03, 0.049})
        CHECK(truth.visibility({0, 1 - below, 0}, {0, 3, 0}).x == 1.0f);
    for (const double below : {0.053, 0.07, 0.09, 0.11, 1.0}) {
        CHECK(truth.visibility({0, 1 - below, 0}, {0, 3, 0}).x ==
              Approx(0.6).epsilon(1e-5));
        CHECK(shadow(truth, lightAbove(4, 0.001), {0, 1 - below, 0}) ==
              Approx(0.4).epsilon(1e-5));
    }
    // Nor a tenth of its width off it, as rays from strands start.
    for (double x = -0.05; x <= 0.05; x += 0.005) {
        for (const glm::dvec3 d :
             {glm::dvec3(0, 3, 0), {0, 3, 2}, {2, 1, -1}, {0, -3, 0}})
            CHECK(truth.visibility({0, 1 - 0.01, x}, d).x == 1.0f);
    }
}

TEST_CASE("a bend of segments shorter than its strand is wide does not shadow itself",
          "[baseline]") {
    // A quarter of a circle of radius 1 in steps of a fifth of the width.
    Strands hair;
    std::vector<glm::vec3> line;
    for (int i = 0; i <= 78; ++i)
        line.emplace_back(std::sin(0.02 * i), 1.0f, std::cos(0.02 * i));
    hair.add(line);
    const EmbreeReference truth = build({hair.view()});
    const glm::dvec3 middle(std::sin(0.77), 1, std::cos(0.77)),
        out(std::sin(0.77), 0, std::cos(0.77));
    for (double x = -0.048; x <= 0.048; x += 0.004) {
        for (double slant = 0.5; slant <= 2; slant += 0.25) {
            const glm::dvec3 d(2 * out.z, 2 / slant, -2 * out.x);
            CHECK(truth.visibility(middle + x * out, d).x == 1.0f);
        }
    }
}

TEST_CASE("sheets and bodies behind a ray's start do not count, however wide strands are",
          "[baseline]") {
    Strands hair;
    hair.width = 0.5f;
    hair.add({{-1, 2, 0}, {1, 2, 0}});
    const Mesh sheet = quad(-5, 5, -5, 5, 0), body = quad(-5, 5, -5, 5, -0.1f);
    MeshView thin = sheet.view();
    thin.opacity = 0.5f;
    const EmbreeReference truth = build({hair.view(), thin, body.view()});
    CHECK(truth.visibility({0, 0.05, 0}, {0, 5, 0}).x == Approx(0.6).epsilon(1e-5));
    CHECK(truth.visibility({0, -0.05, 0}, {0, 5, 0}).x == Approx(0.3).epsilon(1e-5));
    CHECK(truth.visibility({0, -0.15, 0}, {0, 5, 0}).x == 0.0f);
    CHECK(shadow(truth, lightAbove(4, 0.001), {0, 0, 0}) == Approx(0.4).epsilon(1e-5));
    const auto hit = truth.firstHit({3, 4, 3}, {0, -1, 0});
    REQUIRE(hit);
    CHECK(hit->position == glm::dvec3(3, 0, 3));
}

TEST_CASE(
    "strands of no length, of one point or not finite shadow nothing, and repeated "
    "points change nothing",
    "[baseline][extreme]") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    Strands hair;
    hair.add({{5, 1, 0}}).add({}).add({{6, 1, 0}, {6, 1, 0}});
    hair.add({{-1, 1, 0}, {0, 1, 0}, {0, 1, 0}, {1, 1, 0}});
    hair.add({{3, 1, 0}, {3, nan, 0}, {3.5f, 1, 0}, {4, 1, 0}});
    const EmbreeReference truth = build({hair.view()});
    for (const double x : {5.0, 6.0, 3.2})
        CHECK(truth.visibility({x, 0, 0}, {0, 3, 0}).x == 1.0f);
    for (const double x : {0.0, 0.01, -0.01, 3.7})
        CHECK(truth.visibility({x, 0, 0}, {0, 3, 0}).x == Approx(0.6).epsilon(1e-5));
    CHECK(truth.boundsMax().x == 6.0);
}

TEST_CASE("strands far from the origin shadow as near it", "[baseline][extreme]") {
    Strands hair;
    hair.width = 0.01f;
    hair.add({{-1, 1, 0}, {0, 1, 0}, {1, 1.5f, 0.5f}});
    StrandsView view = hair.view();
    const glm::dvec3 offset(1e7, -2e7, 3e7);
    view.worldFromObject[3] = glm::dvec4(offset, 1.0);
    const EmbreeReference truth = build({view});
    CHECK(truth.visibility(offset + glm::dvec3(-0.5, 0, 0.0048), {0, 3, 0}).x ==
          Approx(0.6).epsilon(1e-5));
    CHECK(truth.visibility(offset + glm::dvec3(-0.5, 0, 0.0052), {0, 3, 0}).x == 1.0f);
}

TEST_CASE("the first hit on a strand has a normal across it, towards the ray",
          "[baseline]") {
    Strands hair;
    hair.add({{-1, 1, 0}, {1, 1, 0}});
    const EmbreeReference truth = build({hair.view()});
    const auto hit = truth.firstHit({-0.5, 4, 0.02}, {1, -3, 0});
    REQUIRE(hit);
    CHECK(hit->strand);
    CHECK(hit->position.x == Approx(0.5));
    CHECK(hit->position.y == Approx(1.0));
    CHECK(hit->normal.y == Approx(1.0));
    CHECK(!truth.firstHit({-0.5, 4, 0.06}, {1, -3, 0}));
}

TEST_CASE("a homogeneous volume lets exp(-s d) through", "[baseline][exact]") {
    // Blocks side by side: 24 x 8 x 8 voxels from (-8, 0, 0) on.
    Volume volume;
    for (const int x : {-8, 0, 8})
        volume.add({x, 0, 0}, 0.5f);
    VolumeView view = volume.view();
    view.extinction = 3.0f;
    const double voxel = 0.05;
    view.worldFromIndex = glm::translate(glm::dmat4(1.0), glm::dvec3(1e6, 2, 3)) *
                          glm::rotate(glm::dmat4(1.0), 0.7, glm::dvec3(1, 2, 3)) *
                          glm::scale(glm::dmat4(1.0), glm::dvec3(voxel));
    const EmbreeReference truth = build({view});
    const auto world = [&](glm::dvec3 index) {
        return glm::dvec3(view.worldFromIndex * glm::dvec4(index - 0.5, 1.0));
    };
    const auto left = [&](glm::dvec3 a, glm::dvec3 b) {
        return truth.visibility(world(a), world(b) - world(a)).x;
    };
    // Across, all through, slanted through top and bottom, from inside, along a face of
    // voxels, past it. Lengths within, in voxels.
    const auto expected = [&](double voxels) {
        return Approx(std::exp(-3 * 0.5 * voxel * voxels)).epsilon(1e-5);
    };
    CHECK(left({3.3, -5, 4.4}, {3.3, 20, 4.4}) == expected(8));
    CHECK(left({-20, 4.1, 4.2}, {40, 4.1, 4.2}) == expected(24));
    CHECK(left({-2, -1, 4}, {8, 9, 4}) == expected(8 * std::sqrt(2.0)));
    CHECK(left({1.5, 2.5, 3.5}, {4.5, 6.5, 3.5}) == expected(5));
    CHECK(left({3.0, -5, 4.0}, {3.0, 20, 4.0}) == expected(8));
    CHECK(left({-20, 8.5, 4}, {40, 8.5, 4}) == 1.0f);
    CHECK(truth
              .visibility(world({3.5, 2.5, 4}),
                          glm::normalize(world({3, 3, 4}) - world({3, 2, 4})), true)
              .x == expected(5.5));
}

TEST_CASE("an uneven volume has the optical depth of brute force", "[baseline][exact]") {
    Random random;
    Volume volume;
    for (const glm::ivec3 corner :
         {glm::ivec3(-16, 0, 0), {0, 0, 0}, {8, 8, 0}, {0, 16, 8}})
        volume.add(corner, 0.0f);
    for (float& density : volume.density)
        density = random(0, 1) < 0.3 ? 0.0f : float(random(0, 0.2));
    const VolumeView view = volume.view();
    const EmbreeReference truth = build({view});
    const auto densityAt = [&](glm::dvec3 p) {
        const glm::ivec3 voxel(glm::floor(p + 0.5));
        for (std::size_t b = 0; b < volume.blocks.size(); ++b) {
            const glm::ivec3 i = voxel - volume.blocks[b];
            if (glm::min(i.x, std::min(i.y, i.z)) >= 0 &&
                glm::max(i.x, std::max(i.y, i.z)) < 8)
                return double(volume.density[b * std::size_t(VolumeView::kBlockVoxels) +
                                             std::size_t((i.z * 8 + i.y) * 8 + i.x)]);
        }
        return 0.0;
    };
    for (int i = 0; i < 40; ++i) {
        const glm::dvec3 from = glm::dvec3(0, 8, 4) + random.inCube(16),
                         to = glm::dvec3(0, 8, 4) + random.inCube(16);
        double depth = 0.0;
        const int steps = 20000;
        for (int s = 0; s < steps; ++s)
            depth += densityAt(glm::mix(from, to, (s + 0.5) / steps));
        depth *= glm::length(to - from) / steps;
        // A step off at each of some 60 borders.
        CHECK(-std::log(double(truth.visibility(from, to - from).x)) ==
              Approx(depth).margin(60 * 0.2 * 50.0 / steps));
    }
}

TEST_CASE("meshes, strands and volumes in a row multiply", "[baseline][exact]") {
    const Mesh sheet = quad(-10, 10, -10, 10, 1);
    MeshView mesh = sheet.view();
    mesh.opacity = 0.5f;
    Strands hair;
    hair.add({{-1, 2, 0}, {1, 2, 0}});
    Volume volume;
    volume.add({0, 0, 0}, 1.0f);
    VolumeView smoke = volume.view();
    smoke.extinction = 0.1f;
    smoke.worldFromIndex = glm::translate(glm::dmat4(1.0), glm::dvec3(-4, 3.5, -4));
    const EmbreeReference truth = build({mesh, hair.view(), smoke});
    CHECK(truth.visibility({0.1, 0, 0.01}, {0, 20, 0}).x ==
          Approx(0.5 * 0.6 * std::exp(-0.8)).epsilon(1e-5));
}
