// Radiance textures against closed forms, against ray tracing, and against what the paper
// says of them.
#include "baseline/radiance_texture.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <random>
#include <set>

#include "baseline/methods.h"
#include "baseline/radiance_pack.h"
#include "baseline/reference_embree.h"
#include "bumpy_mesh.h"

using namespace mtsm;
using namespace mtsm::baseline;
using test::Mesh;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// A parallelogram as two triangles.
Mesh quad(glm::vec3 corner, glm::vec3 x, glm::vec3 y) {
    Mesh mesh;
    mesh.positions = {corner, corner + x, corner + x + y, corner + y};
    mesh.indices = {0, 1, 2, 0, 2, 3};
    return mesh;
}

/// The floor of a room: y = 0, lit from above.
PlanarReceiver floorOf(double half) {
    return {{-half, 0, half}, {2 * half, 0, 0}, {0, 0, -2 * half}};
}

AreaLight lightAt(LightShape shape, glm::dvec3 position, double size) {
    AreaLight light;
    light.shape = shape;
    light.position = position;
    light.direction = {0, -1, 0};
    light.radius = size;
    light.size = {size, size};
    light.angularDiameter = size;
    return light;
}

ShadowCasters castersOf(std::vector<CasterView> views) {
    CasterViews source(std::move(views));
    auto casters = ShadowCasters::build(source);
    REQUIRE(casters);
    return std::move(*casters);
}

RadianceTexture textureOf(const ShadowCasters& casters, const RadianceReceiver& receiver,
                          const AreaLight& light, const RadianceOptions& options) {
    auto textures =
        radianceTextures(casters, {receiver}, {{light, glm::dvec3(1.0)}}, options);
    REQUIRE(textures);
    return std::move(textures->front());
}

glm::dvec3 pointOn(const PlanarReceiver& plane, const RadianceTexture& t,
                   std::size_t texel) {
    return plane.corner + plane.edgeX * ((double(texel % t.width) + 0.5) / t.width) +
           plane.edgeY * ((double(texel / t.width) + 0.5) / t.height);
}

/// Visibility at every texel by the ray-traced reference.
std::vector<float> traced(std::vector<CasterView> views, const AreaLight& light,
                          const PlanarReceiver& plane, const RadianceTexture& t,
                          int samples) {
    CasterViews source(std::move(views));
    auto truth = EmbreeReference::build(source);
    REQUIRE(truth);
    std::vector<glm::dvec3> points, normals;
    for (std::size_t i = 0; i < std::size_t(t.width) * t.height; ++i) {
        points.push_back(pointOn(plane, t, i));
        normals.push_back(glm::normalize(glm::cross(plane.edgeX, plane.edgeY)));
    }
    std::vector<float> shadow(points.size());
    ReferenceOptions options;
    options.samples = samples;
    truth->shadowFactors(light, points.data(), normals.data(), points.size(),
                         shadow.data(), options);
    for (float& s : shadow)
        s = 1.0f - s;
    return shadow;
}

struct Difference {
    double mean = 0.0, absolute = 0.0, largest = 0.0;
    double penumbra = 0.0;  // absolute, where b lies between 0 and 1
};

Difference difference(const std::vector<float>& a, const std::vector<float>& b) {
    REQUIRE(a.size() == b.size());
    Difference d;
    std::size_t between = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const double off = double(a[i]) - b[i];
        if (b[i] > 0.0f && b[i] < 1.0f) {
            d.penumbra += std::abs(off);
            ++between;
        }
        d.mean += off / double(a.size());
        d.absolute += std::abs(off) / double(a.size());
        d.largest = std::max(d.largest, std::abs(off));
    }
    if (between > 0) d.penumbra /= double(between);
    return d;
}

/// Irradiance / (pi L) by a polygon as seen from p: Lambert's formula.
double polygonFactor(const std::vector<glm::dvec3>& corners, glm::dvec3 p,
                     glm::dvec3 normal) {
    double sum = 0.0;
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const glm::dvec3 a = glm::normalize(corners[i] - p),
                         b = glm::normalize(corners[(i + 1) % corners.size()] - p),
                         n = glm::cross(a, b);
        sum += std::acos(glm::dot(a, b)) * glm::dot(glm::normalize(n), normal);
    }
    return std::abs(sum) / (2 * kPi);
}

}  // namespace

// --- the projection
// ----------------------------------------------------------------------

TEST_CASE("the matrix maps the pyramid to the box of the paper", "[baseline][exact]") {
    const PlanarReceiver plane{{1, 2, 3}, {2, 0.5, 0}, {-0.5, 1.5, 1}};
    const glm::dvec3 apex(0.3, -1, 7);
    const glm::dmat4 m = pyramidMatrix(apex, plane);
    const auto unit = [&](glm::dvec3 p) {
        const glm::dvec4 h = m * glm::dvec4(p, 1.0);
        CHECK(h.z == 1.0);
        return glm::dvec3(h.x / h.w, h.y / h.w, 1.0 / h.w);
    };
    for (const double u : {0.0, 0.25, 1.0})
        for (const double v : {0.0, 0.7, 1.0}) {
            const glm::dvec3 onBase = plane.corner + u * plane.edgeX + v * plane.edgeY;
            CHECK(glm::length(unit(onBase) - glm::dvec3(u, v, 1.0)) < 1e-12);
            // A third of the way from the apex w is 1/3; x and y stay.
            const glm::dvec3 between = apex + (onBase - apex) / 3.0;
            CHECK(glm::length(unit(between) - glm::dvec3(u, v, 3.0)) < 1e-12);
        }
    CHECK(std::abs((m * glm::dvec4(apex, 1.0)).w) < 1e-12);

    // What casters are drawn with is the same, less the third row.
    const ShadowView view = shadowView({apex, glm::dvec3(0.0)}, plane, false);
    const glm::dvec3 p(0.1, 0.7, 2.2);
    const glm::dvec4 h = m * glm::dvec4(p, 1.0);
    CHECK(glm::length(view(p) - glm::dvec3(h.x, h.y, h.w)) < 1e-12);
}

// --- irradiance without casters
// ----------------------------------------------------------

TEST_CASE("lights give the irradiance of their closed forms", "[baseline][exact]") {
    // A black scene but for one receiver of reflectance 1: L = E / pi at each texel.
    const ShadowCasters none = castersOf({});
    const RadianceReceiver receiver = parallelogramReceiver(floorOf(2));
    RadianceOptions options;
    options.resolution = 33;  // the middle texel lies on the axis
    options.samplesPerSide = 48;
    const auto middle = [&](const AreaLight& light) {
        const RadianceTexture t = textureOf(none, receiver, light, options);
        return double(t.radiance[std::size_t(16) * 33 + 16].g);
    };
    SECTION("a disk on its axis: sin^2 of its angle") {
        const double R = 0.8, h = 1.5;
        CHECK(middle(lightAt(LightShape::disk, {0, h, 0}, R)) ==
              Approx(R * R / (R * R + h * h)).epsilon(1e-3));
    }
    SECTION("a sphere: (R / d)^2") {
        const double R = 0.5, d = 2;
        CHECK(middle(lightAt(LightShape::sphere, {0, d, 0}, R)) ==
              Approx(R * R / (d * d)).epsilon(2e-3));
    }
    SECTION("a sun overhead: sin^2 of half its angle") {
        const double angle = 0.4;
        CHECK(middle(lightAt(LightShape::sun, {}, angle)) ==
              Approx(std::pow(std::sin(angle / 2), 2)).epsilon(1e-3));
    }
    SECTION("a point: intensity over squared distance") {
        CHECK(middle(lightAt(LightShape::point, {0, 3, 0}, 0)) ==
              Approx(1 / (9 * kPi)).epsilon(1e-6));
    }
    SECTION("a sun of no size: its irradiance times the cosine") {
        AreaLight sun = lightAt(LightShape::sun, {}, 0);
        sun.direction = glm::normalize(glm::dvec3(1, -1, 0));
        CHECK(middle(sun) == Approx(std::sqrt(0.5) / kPi).epsilon(1e-6));
    }
}

TEST_CASE("a tilted rect lights a sheared receiver as Lambert's formula says",
          "[baseline][exact]") {
    AreaLight light = lightAt(LightShape::rect, {0.4, 1.2, 0.3}, 0);
    light.size = {1.0, 0.6};
    light.direction = glm::normalize(glm::dvec3(-0.3, -1, 0.2));
    light.up = {0, 0, 1};
    const glm::dvec3 n = light.direction,
                     y = glm::normalize(light.up - glm::dot(light.up, n) * n),
                     x = glm::cross(y, n);
    std::vector<glm::dvec3> corners;
    for (const glm::dvec2 s :
         {glm::dvec2(-1, -1), glm::dvec2(1, -1), glm::dvec2(1, 1), glm::dvec2(-1, 1)})
        corners.push_back(light.position + 0.5 * s.x * light.size.x * x +
                          0.5 * s.y * light.size.y * y);
    RadianceReceiver receiver =
        parallelogramReceiver({{-1, 0, 1}, {2, 0, 0.3}, {0.5, 0, -2}});
    receiver.reflectance = {0.5, 0.25, 1.0};
    RadianceOptions options;
    options.resolution = 9;
    options.samplesPerSide = 32;
    options.ambient = {0.1, 0.2, 0.3};
    const ShadowCasters none = castersOf({});
    auto textures = radianceTextures(none, {receiver},
                                     {{light, {2, 3, 4}}, {light, {1, 0, 0}}}, options);
    REQUIRE(textures);
    const RadianceTexture& t = textures->front();
    for (std::size_t i = 0; i < t.radiance.size(); ++i) {
        const double f = polygonFactor(corners, pointOn(receiver.plane, t, i), {0, 1, 0});
        CHECK(t.radiance[i].r == Approx(0.5 * (0.1 + 3 * f)).epsilon(2e-3));
        CHECK(t.radiance[i].g == Approx(0.25 * (0.2 + 3 * f)).epsilon(2e-3));
        CHECK(t.radiance[i].b == Approx(1.0 * (0.3 + 4 * f)).epsilon(2e-3));
        CHECK(t.visibility[0][i] == 1.0f);
    }
}

// --- visibility
// ----------------------------------------------------------------------------

TEST_CASE("a square between a square light and the floor casts its closed form",
          "[baseline][exact]") {
    // From x on the floor the occluder at half height covers, on the light's plane, twice
    // its size, moved by -x. Each axis is apart from the other.
    const double half = 0.5, light = 0.8;  // half sides
    const Mesh square = quad({-0.5f, 1, 0.5f}, {1, 0, 0}, {0, 0, -1});
    const ShadowCasters casters = castersOf({square.view()});
    const RadianceReceiver receiver = parallelogramReceiver(floorOf(2.5));
    RadianceOptions options;
    options.resolution = 51;
    options.samplesPerSide = 64;
    const RadianceTexture t = textureOf(
        casters, receiver, lightAt(LightShape::rect, {0, 2, 0}, 2 * light), options);
    const auto covered = [&](double x) {
        const double low = std::max(-light, -2 * half - x),
                     high = std::min(light, 2 * half - x);
        return std::max(0.0, high - low) / (2 * light);
    };
    // A row of cells that the edge runs through counts as a whole or not at all, twice a
    // jittered grid's 1 / (2 n) on average.
    for (std::size_t i = 0; i < t.visibility[0].size(); ++i) {
        const glm::dvec3 p = pointOn(receiver.plane, t, i);
        CHECK(t.visibility[0][i] == Approx(1 - covered(p.x) * covered(p.z)).margin(0.02));
    }
}

TEST_CASE("the visibility texture equals ray tracing on a planar receiver",
          "[baseline][statistical]") {
    const Mesh body = test::bumpyBody(4000);
    MeshView view = body.view();
    view.worldFromObject[3] = glm::dvec4(0.2, 1.3, -0.1, 1.0);
    const PlanarReceiver floor{{-3, 0, 3}, {6, 0, 1}, {-1, 0, -6}};
    RadianceOptions options;
    options.resolution = 48;
    options.samplesPerSide = 32;
    options.radiance = false;
    const auto check = [&](const AreaLight& light, double allowed) {
        const RadianceTexture t =
            textureOf(castersOf({view}), parallelogramReceiver(floor), light, options);
        const Difference d =
            difference(t.visibility[0], traced({view}, light, floor, t, 1024));
        INFO("absolute " << d.absolute << ", in penumbras " << d.penumbra << ", mean "
                         << d.mean << ", largest " << d.largest);
        CHECK(d.absolute < allowed);
        CHECK(std::abs(d.mean) < allowed / 2);
        CHECK(d.penumbra < 2 * allowed);
        CHECK(d.largest < 10 * allowed);
    };
    // Both sides' noise: about n^(-3/4) of n = 1024 stratified samples in penumbras.
    SECTION("disk") {
        check(lightAt(LightShape::disk, {1, 5, 1}, 1.0), 0.003);
    }
    SECTION("rect") {
        check(lightAt(LightShape::rect, {1, 5, 1}, 2.0), 0.003);
    }
    SECTION("sphere") {
        check(lightAt(LightShape::sphere, {1, 5, 1}, 1.0), 0.004);
    }
    SECTION("sun") {
        AreaLight sun = lightAt(LightShape::sun, {}, 0.3);
        sun.direction = glm::normalize(glm::dvec3(0.4, -1, 0.3));
        check(sun, 0.003);
    }
    SECTION("point") {
        check(lightAt(LightShape::point, {1, 5, 1}, 0), 0.0015);
    }
    SECTION("a rect that stands on the floor and reaches below it") {
        AreaLight light = lightAt(LightShape::rect, {-2, 0.5, 0}, 2.0);
        light.direction = {1, 0, 0};
        check(light, 0.004);
    }
    SECTION("a sphere that reaches below the floor") {
        // The points are the same for all texels, and so is their error: of the cells
        // that the horizon cuts, 64 of 512.
        check(lightAt(LightShape::sphere, {-4.6, 0.3, 0}, 0.8), 0.016);
    }
}

TEST_CASE("the error falls from 2 x 2 to 4 x 4 to 16 x 16 samples",
          "[baseline][statistical]") {
    const Mesh body = test::bumpyBody(800);
    MeshView view = body.view();
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    const ShadowCasters casters = castersOf({view});
    const RadianceReceiver floor = parallelogramReceiver(floorOf(3));
    const AreaLight light = lightAt(LightShape::rect, {1, 5, 1}, 2.0);
    RadianceOptions options;
    options.resolution = 40;
    const auto visibility = [&](int n) {
        options.samplesPerSide = n;
        return textureOf(casters, floor, light, options).visibility[0];
    };
    for (const LightGrid grid : {LightGrid::jittered, LightGrid::regular}) {
        options.grid = grid;
        const std::vector<float> truth = visibility(40);
        const double two = difference(visibility(2), truth).absolute,
                     four = difference(visibility(4), truth).absolute,
                     sixteen = difference(visibility(16), truth).absolute;
        INFO(two << " " << four << " " << sixteen);
        // The fraction of cells that an edge crosses falls as 1 / n at least.
        CHECK(four < two / 1.6);
        CHECK(sixteen < four / 3);
    }
}

TEST_CASE(
    "an edge along the light's edge makes n big steps with a regular grid and "
    "smaller ones with jitter",
    "[baseline]") {
    const Mesh blocker = quad({-4, 1, 4}, {4, 0, 0}, {0, 0, -8});  // x < 0
    const ShadowCasters casters = castersOf({blocker.view()});
    const AreaLight light = lightAt(LightShape::rect, {0, 2, 0}, 1.0);
    RadianceOptions options;
    options.resolution = 200;
    options.samplesPerSide = 4;
    const auto row = [&](LightGrid grid) {
        options.grid = grid;
        const RadianceTexture t =
            textureOf(casters, parallelogramReceiver(floorOf(1)), light, options);
        const auto first = t.visibility[0].begin() + 100 * 200;
        return std::vector<float>(first, first + 200);
    };
    const auto largestStep = [](const std::vector<float>& v) {
        float largest = 0.0f;
        for (std::size_t i = 1; i < v.size(); ++i)
            largest = std::max(largest, std::abs(v[i] - v[i - 1]));
        return largest;
    };
    const std::vector<float> regular = row(LightGrid::regular),
                             jittered = row(LightGrid::jittered);
    CHECK(largestStep(regular) == Approx(0.25f));
    CHECK(std::set<float>(regular.begin(), regular.end()).size() == 5);
    CHECK(largestStep(jittered) <= 0.126f);
    CHECK(std::set<float>(jittered.begin(), jittered.end()).size() > 10);
}

TEST_CASE("what lies behind the receiver or behind the light casts nothing",
          "[baseline]") {
    const Mesh below = quad({-1, -0.5f, 1}, {2, 0, 0}, {0, 0, -2});
    const Mesh above = quad({-1, 3, 1}, {2, 0, 0}, {0, 0, -2});
    const Mesh itself = quad({-2, 0, 2}, {4, 0, 0}, {0, 0, -4});
    const ShadowCasters casters = castersOf({below.view(), above.view(), itself.view()});
    for (const AreaLight& light : {lightAt(LightShape::disk, {0, 2, 0}, 0.5),
                                   lightAt(LightShape::point, {0, 2, 0}, 0)}) {
        const RadianceTexture t =
            textureOf(casters, parallelogramReceiver(floorOf(2)), light, {});
        for (const float v : t.visibility[0])
            REQUIRE(v == 1.0f);
    }
    // A sun is behind nothing.
    const RadianceTexture t = textureOf(casters, parallelogramReceiver(floorOf(2)),
                                        lightAt(LightShape::sun, {}, 0.1), {});
    CHECK(t.visibility[0][128 * 256 + 128] == 0.0f);
}

TEST_CASE("faces that are turned away from the light are black and cost no sample",
          "[baseline]") {
    const ShadowCasters none = castersOf({});
    const AreaLight above = lightAt(LightShape::disk, {0, 2, 0}, 0.5);
    AreaLight upwards = above;
    upwards.direction = {0, 1, 0};
    PlanarReceiver ceiling = floorOf(1);
    std::swap(ceiling.edgeX, ceiling.edgeY);
    const PlanarReceiver floor = floorOf(1);
    RadianceOptions options;
    options.resolution = 8;
    const auto check = [&](const PlanarReceiver& plane, const AreaLight& light,
                           float visibility) {
        const RadianceTexture t =
            textureOf(none, parallelogramReceiver(plane), light, options);
        CHECK(t.samples[0] == 0);
        CHECK(t.flatness == Flatness::constant);
        for (std::size_t i = 0; i < 64; ++i) {
            CHECK(t.radiance[i] == glm::vec3(0.0f));
            CHECK(t.visibility[0][i] == visibility);
        }
    };
    check(ceiling, above, 0.0f);  // below the horizon: blocked
    check(floor, upwards, 1.0f);  // behind the light: not shadowed
}

TEST_CASE("culling changes nothing but the work", "[baseline]") {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
    Mesh soup;
    for (int i = 0; i < 3000; ++i) {
        const glm::vec3 at(6 * unit(random), 1.5f + unit(random), 6 * unit(random));
        for (int c = 0; c < 3; ++c) {
            soup.indices.push_back(std::uint32_t(soup.positions.size()));
            soup.positions.push_back(
                at + 0.15f * glm::vec3(unit(random), unit(random), unit(random)));
        }
    }
    MeshView view = soup.view();
    view.opacity = 0.7f;
    const ShadowCasters casters = castersOf({view});
    RadianceOptions options;
    options.resolution = 40;
    options.samplesPerSide = 4;
    for (const AreaLight& light :
         {lightAt(LightShape::disk, {0, 4, 0}, 0.5), lightAt(LightShape::sun, {}, 0.2)}) {
        options.cull = true;
        const RadianceTexture culled =
            textureOf(casters, parallelogramReceiver(floorOf(1)), light, options);
        options.cull = false;
        const RadianceTexture all =
            textureOf(casters, parallelogramReceiver(floorOf(1)), light, options);
        CHECK(culled.visibility == all.visibility);
        CHECK(culled.radiance == all.radiance);
        CHECK(all.looked == 16 * 3000);
        CHECK(culled.looked < all.looked / 4);
    }
}

// --- what lets light through
// -----------------------------------------------------------------

TEST_CASE("transparent casters multiply and a shared edge is met once",
          "[baseline][exact]") {
    const Mesh upper = quad({-3, 1.5f, 3}, {6, 0, 0}, {0, 0, -6}),
               lower = quad({-3, 1, 3}, {6, 0, 0}, {0, 0, -6});
    MeshView a = upper.view(), b = lower.view();
    a.opacity = 0.5f;
    b.opacity = 0.25f;
    RadianceOptions options;
    options.resolution = 64;  // the quads' diagonals pass through texel centres
    const RadianceTexture t =
        textureOf(castersOf({a, b}), parallelogramReceiver(floorOf(1)),
                  lightAt(LightShape::point, {0, 2, 0}, 0), options);
    for (const float v : t.visibility[0])
        REQUIRE(v == 0.375f);
}

TEST_CASE("alpha textures and strands cast as they do when traced",
          "[baseline][statistical]") {
    const PlanarReceiver floor = floorOf(1.5);
    const AreaLight light = lightAt(LightShape::rect, {0.3, 4, 0.2}, 1.0);
    RadianceOptions options;
    options.resolution = 40;
    options.samplesPerSide = 24;
    options.radiance = false;
    const auto compare = [&](const CasterView& caster, double absolute, double mean) {
        const RadianceTexture t =
            textureOf(castersOf({caster}), parallelogramReceiver(floor), light, options);
        const std::vector<float> truth = traced({caster}, light, floor, t, 1024);
        const Difference d = difference(t.visibility[0], truth);
        INFO("absolute " << d.absolute << ", mean " << d.mean);
        CHECK(d.absolute < absolute);
        CHECK(std::abs(d.mean) < mean);
        CHECK(*std::min_element(truth.begin(), truth.end()) < 0.7f);
    };
    SECTION("a textured card") {
        Mesh card = quad({-1, 1, 1}, {2, 0.4f, 0}, {0, -0.2f, -2});
        const std::vector<glm::vec2> uvs{{0, 0}, {1, 0}, {1, 1}, {0, 1}};
        OpacityImage image;
        image.width = image.height = 8;
        for (int i = 0; i < 64; ++i)
            image.texels.push_back((i / 8 + i % 8) % 2 ? 1.0f : 0.2f);
        auto texture = OpacityTexture::create(image);
        REQUIRE(texture);
        MeshView view = card.view();
        view.uvs = uvs.data();
        view.texture = &*texture;
        compare(view, 0.006, 0.002);
    }
    SECTION("strands") {
        std::mt19937 random(8);
        std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
        std::vector<glm::vec3> points;
        std::vector<std::uint32_t> begin{0};
        for (int s = 0; s < 200; ++s) {
            glm::vec3 p(unit(random), 1.0f + 0.3f * unit(random), unit(random));
            glm::vec3 d(unit(random), 0.5f * unit(random), unit(random));
            for (int i = 0; i < 6; ++i) {
                points.push_back(p);
                d += 0.3f * glm::vec3(unit(random), unit(random), unit(random));
                p += 0.1f * glm::normalize(d);
            }
            begin.push_back(std::uint32_t(points.size()));
        }
        StrandsView view;
        view.points = points.data();
        view.begin = begin.data();
        view.strandCount = 200;
        view.width = 0.03f;
        view.opacity = 0.6f;
        compare(view, 0.015, 0.004);
    }
}

TEST_CASE("volumes do not cast and are warned of once", "[baseline]") {
    const glm::ivec3 block(0);
    const std::vector<float> density(VolumeView::kBlockVoxels, 1.0f);
    VolumeView volume;
    volume.blocks = &block;
    volume.blockCount = 1;
    volume.density = density.data();
    CasterViews source({volume, volume});
    std::vector<std::string> warnings;
    REQUIRE(ShadowCasters::build(
        source, [&](const std::string& text) { warnings.push_back(text); }));
    REQUIRE(warnings.size() == 1);
    CHECK(warnings[0].find("volumes") != std::string::npos);
}

// --- samples and textures
// ----------------------------------------------------------------------

TEST_CASE("a grid has one point in each cell and begins in the middle", "[baseline]") {
    for (const int n : {1, 2, 3, 4, 7, 16}) {
        for (const LightGrid grid : {LightGrid::regular, LightGrid::jittered}) {
            const auto points = gridPoints(n, grid, 9);
            REQUIRE(points.size() == std::size_t(n * n));
            std::set<std::pair<int, int>> cells;
            for (const glm::dvec2 p : points)
                cells.insert({int(p.x * n), int(p.y * n)});
            CHECK(cells.size() == points.size());
            CHECK(glm::length(points[0] - 0.5) <= 1.5 / n);
        }
    }
    std::set<std::pair<int, int>> quarters;
    const auto points = gridPoints(16, LightGrid::jittered, 9);
    for (int i = 0; i < 4; ++i)
        quarters.insert(
            {int(points[std::size_t(i)].x * 2), int(points[std::size_t(i)].y * 2)});
    CHECK(quarters.size() == 4);
}

TEST_CASE("a solid angle chooses the number of samples for each receiver", "[baseline]") {
    const ShadowCasters none = castersOf({});
    const AreaLight light = lightAt(LightShape::rect, {0, 2, 0}, 1.0);
    PlanarReceiver far = floorOf(0.5);
    far.corner.y = -6;  // four times as far: a sixteenth of the angle
    RadianceOptions options;
    options.resolution = 4;
    options.solidAngle = 0.25 / 64;  // the near one takes 0.25 sr minus a little
    auto textures = radianceTextures(
        none, {parallelogramReceiver(floorOf(0.5)), parallelogramReceiver(far)},
        {{light, glm::dvec3(1.0)}}, options);
    REQUIRE(textures);
    CHECK((*textures)[0].samples[0] == 64);
    CHECK((*textures)[1].samples[0] == 4);
}

TEST_CASE("a light's solid angle is right close to it, too", "[baseline][exact]") {
    AreaLight light = lightAt(LightShape::rect, {0, 2, 0}, 1.0);
    // Over the middle of an a x b rectangle at distance h:
    // 4 asin(a b / sqrt((a^2 + 4 h^2) (b^2 + 4 h^2))).
    light.size = {1.0, 0.5};
    for (const double h : {0.001, 0.01, 0.1, 1.0, 30.0}) {
        const double a = 1.0, b = 0.5,
                     exact =
                         4 *
                         std::asin(a * b /
                                   std::sqrt((a * a + 4 * h * h) * (b * b + 4 * h * h)));
        CHECK(solidAngle(light, {0, 2 - h, 0}) == Approx(exact).epsilon(1e-9));
    }
    CHECK(solidAngle(light, {0, 2.1, 0}) == 0.0);
    light = lightAt(LightShape::disk, {0, 2, 0}, 0.7);
    for (const double h : {0.001, 0.01, 0.1, 1.0, 30.0}) {
        const double exact = 2 * glm::pi<double>() * (1 - h / std::hypot(h, 0.7));
        CHECK(solidAngle(light, {0, 2 - h, 0}) == Approx(exact).epsilon(1e-3));
    }
    // Off the axis: the sum over many small pieces.
    const glm::dvec3 p(1.3, 1.6, 0.4);
    double sum = 0.0;
    for (const LightPoint& point : lightPoints(light, 256, LightGrid::regular, 0)) {
        const glm::dvec3 d = p - point.position;
        sum += glm::dot(d, point.normal) / std::pow(glm::length(d), 3);
    }
    CHECK(solidAngle(light, p) ==
          Approx(sum * lightMeasure(light) / (256 * 256)).epsilon(1e-3));
}

TEST_CASE("no cell of a grid takes more than the solid angle that chose it",
          "[baseline][exact]") {
    // A large light close to a small receiver: cells right above it take far more than
    // those at its rim.
    const ShadowCasters none = castersOf({});
    AreaLight light = lightAt(LightShape::rect, {0, 0.5, 0}, 1.0);
    light.size = {4.0, 4.0};
    RadianceOptions options;
    options.resolution = 2;
    options.solidAngle = 0.02;
    auto textures = radianceTextures(none, {parallelogramReceiver(floorOf(0.2))},
                                     {{light, glm::dvec3(1.0)}}, options);
    INFO((textures ? "" : textures.error().message));
    REQUIRE(textures);
    const int count = (*textures)[0].samples[0];
    const double side = 4.0 / std::sqrt(double(count));
    // The cell right above the middle, by its closed form.
    AreaLight cell = light;
    cell.size = {side, side};
    CHECK(solidAngle(cell, {0, 0, 0}) <= options.solidAngle);
    CHECK(solidAngle(cell, {0, 0, 0}) > 0.8 * options.solidAngle);
}

TEST_CASE("textures that would take too much memory together are refused before any work",
          "[baseline][bad-input]") {
    const ShadowCasters none = castersOf({});
    const AreaLight light = lightAt(LightShape::point, {0, 2, 0}, 0);
    const std::vector<RadianceReceiver> many(4096, parallelogramReceiver(floorOf(1)));
    RadianceOptions options;
    options.resolution = 16384;
    auto refused = radianceTextures(none, many, {{light, glm::dvec3(1.0)}}, options);
    REQUIRE(!refused);
    CHECK(refused.error().code == ErrorCode::tooLarge);
}

TEST_CASE("texels follow a world-space size, and supersampling is a box filter",
          "[baseline]") {
    RadianceOptions options;
    options.pixelSize = 0.1;
    RadianceReceiver receiver = parallelogramReceiver({{0, 0, 0}, {3, 0, 0}, {0, 0, -1}});
    CHECK(textureSize(receiver, options) == glm::uvec2(30, 10));
    options.pixelSize = 0.0;
    options.resolution = 60;
    CHECK(textureSize(receiver, options) == glm::uvec2(60, 20));

    const Mesh body = test::bumpyBody(500);
    MeshView view = body.view();
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    const ShadowCasters casters = castersOf({view});
    const AreaLight light = lightAt(LightShape::point, {0, 5, 0}, 0);
    const RadianceReceiver floor = parallelogramReceiver(floorOf(2));
    options.resolution = 120;
    const RadianceTexture fine = textureOf(casters, floor, light, options);
    options.resolution = 40;
    options.supersampling = 3;
    const RadianceTexture filtered = textureOf(casters, floor, light, options);
    for (std::size_t y = 0; y < 40; ++y)
        for (std::size_t x = 0; x < 40; ++x) {
            double sum = 0.0;
            for (std::size_t k = 0; k < 9; ++k)
                sum += fine.visibility[0][(3 * y + k / 3) * 120 + 3 * x + k % 3];
            REQUIRE(filtered.visibility[0][y * 40 + x] == Approx(sum / 9).margin(1e-6));
        }
}

TEST_CASE("refinement ends where the direct way does, and is usable on its way",
          "[baseline]") {
    const Mesh body = test::bumpyBody(1000);
    MeshView view = body.view();
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    const ShadowCasters casters = castersOf({view});
    const std::vector<RadianceReceiver> receivers{parallelogramReceiver(floorOf(3))};
    const std::vector<RadianceLight> lights{
        {lightAt(LightShape::disk, {1, 5, 1}, 1.0), glm::dvec3(1.0)},
        {lightAt(LightShape::point, {-1, 5, 1}, 0.0), glm::dvec3(0.5)}};
    RadianceOptions options;
    options.resolution = 32;
    options.samplesPerSide = 7;
    auto direct = radianceTextures(casters, receivers, lights, options);
    REQUIRE(direct);
    std::vector<double> errors;
    options.refined = [&](int, const std::vector<RadianceTexture>& textures) -> Status {
        errors.push_back(
            difference(textures[0].visibility[0], direct->front().visibility[0])
                .absolute);
        double ratio = 0.0;
        for (std::size_t i = 0; i < textures[0].radiance.size(); ++i)
            ratio += textures[0].radiance[i].g;
        double whole = 0.0;
        for (const glm::vec3& r : direct->front().radiance)
            whole += r.g;
        CHECK(ratio / whole == Approx(1.0).epsilon(0.05));
        return {};
    };
    auto refined = radianceTextures(casters, receivers, lights, options);
    REQUIRE(refined);
    CHECK(refined->front().radiance == direct->front().radiance);
    CHECK(refined->front().visibility == direct->front().visibility);
    REQUIRE(errors.size() == 4);  // after 1, 4, 16 and 49
    CHECK(errors[1] < errors[0]);
    CHECK(errors[2] < errors[1]);
    CHECK(errors[3] == 0.0);

    options.refined = [](int, const std::vector<RadianceTexture>&) -> Status {
        return Error{ErrorCode::cancelled, "enough"};
    };
    auto stopped = radianceTextures(casters, receivers, lights, options);
    REQUIRE(!stopped);
    CHECK(stopped.error().code == ErrorCode::cancelled);
}

TEST_CASE("textures that could be Gouraud shaded are reported", "[baseline]") {
    const Mesh roof = quad({-9, 1, 9}, {18, 0, 0}, {0, 0, -18});
    const Mesh half = quad({-9, 1, 9}, {9, 0, 0}, {0, 0, -18});
    const RadianceReceiver floor = parallelogramReceiver(floorOf(1));
    const AreaLight sun = lightAt(LightShape::sun, {}, 0.1);
    const AreaLight far = lightAt(LightShape::point, {30, 50, 0}, 0.0);
    RadianceOptions options;
    options.resolution = 32;
    CHECK(textureOf(castersOf({roof.view()}), floor, sun, options).flatness ==
          Flatness::constant);
    CHECK(textureOf(castersOf({}), floor, sun, options).flatness == Flatness::constant);
    options.flatTolerance = 1e-3;  // 1 / r^2 falls by 3 % over the floor
    CHECK(textureOf(castersOf({}), floor, far, options).flatness == Flatness::linear);
    CHECK(textureOf(castersOf({half.view()}), floor, sun, options).flatness ==
          Flatness::textured);
    // A triangle that the shadow's edge misses is flat whatever its other half holds.
    const RadianceReceiver triangle =
        triangleReceiver({1, 0, 1}, {1, 0, -1}, {0.2, 0, 1});
    CHECK(textureOf(castersOf({half.view()}), triangle, sun, options).flatness ==
          Flatness::constant);
}

TEST_CASE("triangles and polygons fit their parallelograms", "[baseline]") {
    const RadianceReceiver t = triangleReceiver({5, 0, 0}, {0, 0, 0}, {0, 3, 0});
    CHECK(t.plane.corner == glm::dvec3(0, 0, 0));  // the right angle
    CHECK(t.plane.edgeX == glm::dvec3(0, 3, 0));
    CHECK(t.plane.edgeY == glm::dvec3(5, 0, 0));
    CHECK(t.contains({0.4, 0.5}));
    CHECK(!t.contains({0.6, 0.5}));

    // An L, its longest edge along z.
    auto l = polygonReceiver(
        {{1, 2, 0}, {3, 2, 0}, {3, 2, -1}, {2, 2, -1}, {2, 2, -4}, {1, 2, -4}});
    REQUIRE(l);
    CHECK(glm::length(l->plane.edgeX) == Approx(4));
    CHECK(glm::length(l->plane.edgeY) == Approx(2));
    const glm::dvec3 n = glm::cross(l->plane.edgeX, l->plane.edgeY);
    CHECK(n.y == Approx(8));
    const auto inside = [&](glm::dvec3 p) {
        const glm::dvec3 d = p - l->plane.corner;
        return l->contains(
            {glm::dot(d, l->plane.edgeX) / 16, glm::dot(d, l->plane.edgeY) / 4});
    };
    CHECK(inside({1.5, 2, -3}));
    CHECK(inside({2.5, 2, -0.5}));
    CHECK(!inside({2.5, 2, -2}));
    CHECK(!inside({0.5, 2, -2}));
    CHECK(!polygonReceiver({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}));
    CHECK(!polygonReceiver({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0.1}}));
}

TEST_CASE("flat faces of a mesh are found as what they are", "[baseline]") {
    const auto shapes = [](const Mesh& mesh) {
        std::vector<ReceiverShape> found;
        for (const RadianceReceiver& r : meshReceivers(mesh.view()))
            found.push_back(r.shape);
        return found;
    };
    using Shapes = std::vector<ReceiverShape>;
    const auto parallelogram = ReceiverShape::parallelogram,
               triangle = ReceiverShape::triangle, polygon = ReceiverShape::polygon;
    // Two walls and a floor that share corners, each of two triangles.
    Mesh room = quad({0, 0, 0}, {1, 0, 0}, {0, 0, -2});
    for (const Mesh& wall : {quad({0, 0, 0}, {0, 0, -2}, {0, 1, 0}),
                             quad({0, 0, -2}, {1, 0, 0}, {0, 1, 0})}) {
        for (const std::uint32_t i : wall.indices)
            room.indices.push_back(std::uint32_t(room.positions.size()) + i);
        room.positions.insert(room.positions.end(), wall.positions.begin(),
                              wall.positions.end());
    }
    CHECK(shapes(room) == Shapes(3, parallelogram));
    const glm::dvec3 up = glm::cross(meshReceivers(room.view())[0].plane.edgeX,
                                     meshReceivers(room.view())[0].plane.edgeY);
    CHECK(up.y == Approx(2));

    // A fan of five around a corner in its middle, and without the last of it.
    Mesh fan;
    fan.positions.push_back({0, 0, 0});
    for (int i = 0; i < 5; ++i)
        fan.positions.emplace_back(std::cos(1.2566f * float(i)), 0,
                                   -std::sin(1.2566f * float(i)));
    for (std::uint32_t i = 0; i < 5; ++i)
        fan.indices.insert(fan.indices.end(), {0, 1 + i, 1 + (i + 1) % 5});
    CHECK(shapes(fan) == Shapes{polygon});
    fan.indices.resize(3);
    CHECK(shapes(fan) == Shapes{triangle});

    // A square frame has a hole: its triangles stay alone.
    Mesh frame;
    frame.positions = {{-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2},
                       {-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}};
    for (std::uint32_t i = 0; i < 4; ++i) {
        const std::uint32_t j = (i + 1) % 4;
        frame.indices.insert(frame.indices.end(), {i, j, 4 + j, i, 4 + j, 4 + i});
    }
    CHECK(shapes(frame) == Shapes(8, triangle));

    // A bent sheet is two faces; what has no area is none.
    Mesh bent = quad({0, 0, 0}, {1, 0, 0}, {0, 1, 0});
    bent.positions[3].z = 0.3f;
    CHECK(shapes(bent) == Shapes(2, triangle));
    bent.indices = {0, 1, 1, 0, 1, 2};
    bent.positions[2] = {2, 0, 0};
    CHECK(shapes(bent).empty());
}

TEST_CASE("two triangles in one texture do not bleed into each other", "[baseline]") {
    for (const glm::uvec2 size : {glm::uvec2(8, 8), glm::uvec2(5, 13), glm::uvec2(16, 3),
                                  glm::uvec2(1, 1), glm::uvec2(1, 7)}) {
        const std::size_t texels = std::size_t(size.x) * size.y;
        std::vector<float> first(texels), second(texels);
        for (std::size_t i = 0; i < texels; ++i) {
            first[i] = 1.0f + float(i);
            second[i] = -100.0f - float(i);
        }
        const std::vector<float> packed = packTriangles(first, second, size);
        const glm::uvec2 whole = packedSize(size);
        REQUIRE(packed.size() == std::size_t(whole.x) * whole.y);
        for (int j = 0; j <= 40; ++j)
            for (int i = 0; i + j <= 40; ++i) {
                const glm::dvec2 uv(i / 40.0, j / 40.0);
                INFO(size.x << " x " << size.y << " at " << uv.x << " " << uv.y);
                REQUIRE(lookUp(packed, whole, packedCoordinates(uv, size, false)) ==
                        Approx(lookUp(first, size, uv)).margin(1e-3));
                REQUIRE(lookUp(packed, whole, packedCoordinates(uv, size, true)) ==
                        Approx(lookUp(second, size, uv)).margin(1e-3));
            }
    }
    // Less than two textures of their own.
    CHECK(packedSize({64, 64}).x * 64 < 2 * 64 * 64);
}

TEST_CASE("triangles are paired with those of their size", "[baseline]") {
    std::vector<RadianceReceiver> receivers;
    for (const double side : {1.0, 4.0, 1.1, 3.9, 2.0})
        receivers.push_back(triangleReceiver({0, 0, 0}, {side, 0, 0}, {0, side, 0}));
    receivers.push_back(parallelogramReceiver(floorOf(1)));
    RadianceOptions options;
    options.pixelSize = 0.1;
    const auto pairs = pairTriangles(receivers, options);
    REQUIRE(pairs.size() == 3);
    CHECK(pairs[0].first == 1);
    CHECK(pairs[0].second == 3);
    CHECK(receivers[3].texels == glm::uvec2(40, 40));
    CHECK(pairs[2].first == 0);
    CHECK(pairs[2].second == TrianglePair::kNone);
    CHECK(receivers[5].texels == glm::uvec2(0));

    // A long one and a tall one would take more together than each alone.
    std::vector<RadianceReceiver> crossed{
        triangleReceiver({0, 0, 0}, {20, 0, 0}, {0, 1, 0}),
        triangleReceiver({0, 0, 0}, {1, 0, 0}, {0, 20, 0})};
    CHECK(pairTriangles(crossed, options).size() == 2);
    CHECK(crossed[0].texels.x * crossed[0].texels.y == 200 * 10);
    CHECK(crossed[1].texels.x * crossed[1].texels.y == 200 * 10);
}

TEST_CASE("textures do not depend on the number of threads", "[baseline]") {
    const Mesh body = test::bumpyBody(2000);
    MeshView view = body.view();
    view.opacity = 0.3f;
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    const ShadowCasters casters = castersOf({view});
    RadianceOptions options;
    options.resolution = 50;
    options.samplesPerSide = 6;
    RadianceTexture t[2];
    for (int i = 0; i < 2; ++i) {
        tbb::task_arena arena(i == 0 ? 1 : 4);
        arena.execute([&] {
            t[i] = textureOf(casters, parallelogramReceiver(floorOf(3)),
                             lightAt(LightShape::sphere, {1, 5, 1}, 1.0), options);
        });
    }
    CHECK(t[0].visibility == t[1].visibility);
    CHECK(t[0].radiance == t[1].radiance);
}

TEST_CASE("a scene far from the origin has the same textures", "[baseline][extreme]") {
    const Mesh body = test::bumpyBody(1000);
    MeshView view = body.view();
    AreaLight light = lightAt(LightShape::disk, {1, 5, 1}, 1.0);
    PlanarReceiver floor = floorOf(3);
    RadianceOptions options;
    options.resolution = 32;
    options.samplesPerSide = 4;
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    const RadianceTexture here =
        textureOf(castersOf({view}), parallelogramReceiver(floor), light, options);
    const glm::dvec3 offset(1e7, -2e7, 3e7);
    view.worldFromObject[3] += glm::dvec4(offset, 0.0);
    light.position += offset;
    floor.corner += offset;
    const RadianceTexture there =
        textureOf(castersOf({view}), parallelogramReceiver(floor), light, options);
    // Doubles resolve 4e-9 there; an edge may cross a texel's centre now and then.
    CHECK(difference(here.visibility[0], there.visibility[0]).absolute < 1e-4);
}

TEST_CASE("options, lights and receivers out of range are refused", "[baseline]") {
    const ShadowCasters none = castersOf({});
    const RadianceReceiver floor = parallelogramReceiver(floorOf(1));
    const RadianceLight light{lightAt(LightShape::point, {0, 1, 0}, 0), glm::dvec3(1)};
    const auto code = [&](const RadianceReceiver& r, const RadianceLight& l,
                          const RadianceOptions& o) {
        auto textures = radianceTextures(none, {r}, {l}, o);
        REQUIRE(!textures);
        return textures.error().code;
    };
    RadianceOptions options;
    options.samplesPerSide = 0;
    CHECK(code(floor, light, options) == ErrorCode::badArgument);
    options = {};
    options.resolution = 40000;
    CHECK(code(floor, light, options) == ErrorCode::badArgument);
    options = {};
    options.pixelSize = 1e-9;
    CHECK(code(floor, light, options) == ErrorCode::tooLarge);
    options = {};
    options.resolution = 20000;
    options.supersampling = 2;
    CHECK(code(floor, light, options) == ErrorCode::tooLarge);
    RadianceLight wrong = light;
    wrong.light.direction = glm::dvec3(0.0);
    CHECK(code(floor, wrong, {}) == ErrorCode::badArgument);
    RadianceReceiver line = floor;
    line.plane.edgeY = 2.0 * line.plane.edgeX;
    line.name = "wall";
    auto textures = radianceTextures(none, {line}, {light}, {});
    REQUIRE(!textures);
    CHECK(textures.error().message.find("receiver wall has no area") == 0);
}

// --- the row
// ---------------------------------------------------------------------------------

TEST_CASE("the row answers on its planes as ray tracing does, and nowhere else",
          "[baseline][statistical]") {
    const Mesh body = test::bumpyBody(1000);
    MeshView view = body.view();
    view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
    CasterViews casters({view});
    MethodScene scene{casters, {}, {floorOf(3), {{-3, 0, -3}, {6, 0, 0}, {0, 4, 0}}}};
    scene.bake.light = lightAt(LightShape::disk, {1, 5, 2}, 1.0);
    scene.bake.aimed = true;
    const auto info = findMethod("radiance");
    REQUIRE(info);
    auto settings = Settings::complete(
        (*info)->settings, {{"resolution", 240.0}, {"samples", 16.0}}, "radiance");
    REQUIRE(settings);
    auto method = (*info)->build(scene, *settings);
    REQUIRE(method);
    CHECK((*method)->memoryBytes() == 4 * (240 * 240 + 240 * 160));

    std::mt19937 random(2);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::vector<glm::dvec3> points, normals;
    for (int i = 0; i < 400; ++i) {
        points.push_back({6 * unit(random) - 3, 0, 6 * unit(random) - 3});
        normals.push_back({0, 1, 0});
        points.push_back({6 * unit(random) - 3, 4 * unit(random), -3});
        normals.push_back({0, 0, 1});
    }
    const std::size_t onPlanes = points.size();
    points.insert(points.end(), {{0, 1, 0}, {5, 0, 0}, {0, 0, 1}});
    normals.insert(normals.end(), {{0, 1, 0}, {0, 1, 0}, {0, -1, 0}});
    Receivers at;
    at.points = at.starts = points.data();
    at.normals = normals.data();
    at.count = points.size();
    std::vector<float> found(points.size()), expected(points.size());
    REQUIRE((*method)->shadowFactors(scene.bake.light, at, *settings, found.data()));
    auto truth = EmbreeReference::build(casters);
    REQUIRE(truth);
    ReferenceOptions reference;
    reference.samples = 1024;
    truth->shadowFactors(scene.bake.light, points.data(), normals.data(), points.size(),
                         expected.data(), reference);
    for (std::size_t i = onPlanes; i < points.size(); ++i)
        CHECK(std::isnan(found[i]));
    found.resize(onPlanes);
    expected.resize(onPlanes);
    const Difference d = difference(found, expected);
    INFO("absolute " << d.absolute << ", mean " << d.mean);
    CHECK(d.absolute < 0.004);
    CHECK(std::abs(d.mean) < 0.002);

    const MethodScene bare{casters, scene.bake, {}};
    CHECK(!(*info)->build(bare, *settings));

    // What has no normal is none of the receivers'; another light is refused.
    at.normals = nullptr;
    found.assign(points.size(), 0.0f);
    REQUIRE((*method)->shadowFactors(scene.bake.light, at, *settings, found.data()));
    CHECK(std::all_of(found.begin(), found.end(), [](float f) { return std::isnan(f); }));
    AreaLight other = scene.bake.light;
    other.position.x += 1.0;
    const Status refused = (*method)->shadowFactors(other, at, *settings, found.data());
    REQUIRE(!refused);
    CHECK(refused.error().code == ErrorCode::badArgument);
}
