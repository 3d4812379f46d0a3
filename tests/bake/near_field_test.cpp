// The near field of a bake: the casters' own triangles, to a fraction of a pixel, or
// none.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/common.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <map>
#include <optional>
#include <set>

#include "bake/baked.h"
#include "bake/casters.h"
#include "bake/near_chunks.h"
#include "bake/near_triangles.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"

using namespace mtsm;
using mtsm::test::Casters;
using mtsm::test::Mesh;
using mtsm::test::mustBake;
using mtsm::test::Random;

namespace {

using Triangle = std::array<glm::dvec3, 3>;

BakeOptions lamp() {
    BakeOptions o = test::diskAbove(64);
    o.nearField = kAutomaticNearField;
    return o;
}

/// A world point in straight space, by the definition.
glm::dvec3 straight(const Projection& p, glm::dvec3 world) {
    const glm::dvec3 light = p.lightFromWorld(world);
    const bool perspective = p.kind == ProjectionKind::perspective;
    return glm::dvec3(p.rasterFromLight(light), perspective ? 1.0 / light.z : -light.z);
}

/// How much w changes where z changes by a pixel's side.
double footprint(const Projection& p, double w) {
    return p.pixelFootprint(1.0) * (p.kind == ProjectionKind::perspective ? w : 1.0);
}

std::vector<Triangle> trianglesOf(const NearField& field) {
    std::vector<Triangle> all;
    for (const NearChunk& chunk : field.chunks) {
        for (int t = 0; t < chunk.triangles(); ++t) {
            Triangle& triangle = all.emplace_back();
            for (int c = 0; c < 3; ++c)
                triangle[std::size_t(c)] = {chunk.at(c, 0, t), chunk.at(c, 1, t),
                                            chunk.at(c, 2, t)};
        }
    }
    return all;
}

std::vector<Triangle> trianglesOf(const Mesh& mesh, const Projection& projection) {
    std::vector<Triangle> all;
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        Triangle& triangle = all.emplace_back();
        for (std::size_t c = 0; c < 3; ++c)
            triangle[c] =
                straight(projection,
                         glm::dvec3(mesh.worldFromObject *
                                    glm::dvec4(mesh.positions[mesh.indices[i + c]], 1)));
    }
    return all;
}

/// The largest distance of corresponding corners, w in footprints.
double distance(const Projection& p, const Triangle& a, const Triangle& b) {
    double most = 0.0;
    for (std::size_t c = 0; c < 3; ++c) {
        const glm::dvec3 d = glm::abs(a[c] - b[c]);
        most = std::max({most, d.x, d.y, d.z / footprint(p, b[c].z)});
    }
    return most;
}

/// The larger of the triangles' distances to what is left of the others, each taken once.
double largestDistance(const Projection& p, const std::vector<Triangle>& expected,
                       std::vector<Triangle> found) {
    REQUIRE(found.size() == expected.size());
    double most = 0.0;
    for (const Triangle& triangle : expected) {
        const auto nearest = std::min_element(
            found.begin(), found.end(), [&](const Triangle& a, const Triangle& b) {
                return distance(p, a, triangle) < distance(p, b, triangle);
            });
        most = std::max(most, distance(p, *nearest, triangle));
        found.erase(nearest);
    }
    return most;
}

NearField fieldOf(const std::vector<Mesh>& meshes, const Projection& projection,
                  const BakeOptions& options) {
    Casters casters(meshes);
    const bake_detail::Progress progress(options);
    bake_detail::Visits visits(casters, progress);
    bake_detail::NearTriangles found;
    REQUIRE(visits.each(meshesOnly([&](const MeshView& mesh) -> Status {
        bake_detail::collectMesh(mesh, projection, options, std::uint64_t(1) << 40,
                                 found);
        return {};
    })));
    CHECK(found.items.size() == found.count);
    return bake_detail::packNear(found.items, projection);
}

/// An eye at the origin that looks along -z, 90 degrees across.
Projection plainView(std::uint32_t size) {
    Projection p;
    p.scale = {size / 2.0, size / -2.0};
    p.offset = {size / 2.0, size / 2.0};
    p.near = 0.1;
    return p;
}

/// w at raster position `at` of each triangle that covers it, its border included.
std::vector<double> depthsAt(const std::vector<Triangle>& triangles, glm::dvec2 at) {
    std::vector<double> depths;
    for (const Triangle& t : triangles) {
        double weight[3], sum = 0.0;
        for (std::size_t i = 0; i < 3; ++i) {
            const glm::dvec2 a = glm::dvec2(t[(i + 1) % 3]) - at;
            const glm::dvec2 b = glm::dvec2(t[(i + 2) % 3]) - at;
            weight[i] = a.x * b.y - a.y * b.x;
            sum += weight[i];
        }
        if (sum == 0.0) continue;
        double w = 0.0;
        bool inside = true;
        for (std::size_t i = 0; i < 3; ++i) {
            inside = inside && weight[i] / sum >= -1e-9;
            w += weight[i] / sum * t[i].z;
        }
        if (inside) depths.push_back(w);
    }
    return depths;
}

}  // namespace

TEST_CASE("a near field is the mesh's triangles to a hundredth of a pixel",
          "[bake][exact]") {
    Mesh ball = test::bumpyBall(8);
    ball.worldFromObject = glm::translate(glm::dmat4(1.0), {0.25, -0.5, 0.125});
    for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
        for (const std::uint32_t size : {16u, 256u, 2000u}) {
            BakeOptions o = lamp();
            o.light.shape = shape;
            o.width = o.height = size;
            Casters casters({ball});
            const Baked b = mustBake(casters, o);
            CHECK(b.report.noNearField.empty());
            CHECK(b.report.nearTriangles == 6 * 8 * 8 * 2);
            const NearField& field = b.map.nearField(0);
            CHECK(b.report.nearBytes == memoryBytes(field));
            const Projection& p = b.map.projection(0);
            INFO("size " << size);
            // Half of the coarsest step that triangles of this size may get.
            const double bound = size < 2000 ? 0.004 : 0.017;
            CHECK(largestDistance(p, trianglesOf(ball, p), trianglesOf(field)) < bound);
        }
    }
}

TEST_CASE("a corner that triangles share is one point in all chunks of a step",
          "[bake][exact]") {
    Casters casters({test::bumpyBall(30)});
    BakeOptions o = lamp();
    o.light.position = {1.3, 4, 0.7};
    const Baked b = mustBake(casters, o);
    const NearField& field = b.map.nearField(0);
    CHECK(field.chunks.size() * 16 < 6 * 30 * 30 * 2 * 5 / 4);  // hardly any is padded
    std::map<std::pair<float, float>, std::set<std::pair<float, float>>> points;
    std::size_t coarse = 0;
    for (const NearChunk& chunk : field.chunks) {
        coarse += chunk.step[0] != 0x1p-8f || chunk.step[1] != 0x1p-8f;
        for (int axis = 0; axis < 3; ++axis) {
            int exponent = 0;
            CHECK(std::frexp(chunk.step[axis], &exponent) == 0.5f);
            CHECK(std::fmod(double(chunk.low[axis]), double(chunk.step[axis])) == 0.0);
        }
        for (int t = 0; t < NearChunk::kTriangles; ++t) {
            for (int c = 0; c < 3; ++c)
                points[{chunk.step[0], chunk.step[1]}].insert(
                    {chunk.at(c, 0, t), chunk.at(c, 1, t)});
        }
    }
    CHECK(coarse == 0);
    // A cube of n x n quads a side has 6 n n + 2 corners; two may lie on one line of
    // sight.
    CHECK(points.begin()->second.size() <= 6 * 30 * 30 + 2);
    CHECK(points.begin()->second.size() > 6 * 30 * 30 - 10);
}

TEST_CASE("a ground of two triangles stays exact however large it is", "[bake][exact]") {
    // A floor at y = -1 that reaches from behind the eye to far away, and a wall.
    for (const float reach : {5.0f, 1e3f, 1e6f}) {
        for (const std::uint32_t size : {256u, 8192u}) {
            const Projection p = plainView(size);
            BakeOptions o;
            o.width = o.height = size;
            Mesh floor;
            floor.quad({-reach, -1, reach}, {reach, -1, reach}, {reach, -1, -reach},
                       {-reach, -1, -reach});
            const NearField field = fieldOf({floor}, p, o);
            const std::vector<Triangle> triangles = trianglesOf(field);
            CHECK(triangles.size() < 200);
            for (const NearChunk& chunk : field.chunks) {
                CHECK(chunk.step[0] <= 0x1p-5f);
                CHECK(chunk.step[1] <= 0x1p-5f);
            }
            // On the floor y / z = -1 / z: w grows by 2 / size from row to row.
            Random random(7);
            double worst = 0.0;
            int missing = 0;
            for (int i = 0; i < 2000; ++i) {
                const glm::dvec2 at(random.in(1, size - 1.0),
                                    random.in(size / 2.0 + 2, size - 1.0));
                const double w = (at.y - size / 2.0) * 2.0 / size;
                if (w < 1.01 / reach ||
                    std::abs(at.x - size / 2.0) * 2.0 / size / w > 0.99 * reach)
                    continue;
                const std::vector<double> depths = depthsAt(triangles, at);
                missing += depths.empty();
                // Across the plane, in pixels and footprints.
                const double slope = 2.0 / size / footprint(p, w);
                for (const double found : depths)
                    worst = std::max(worst, std::abs(found - w) / footprint(p, w) /
                                                std::sqrt(1.0 + slope * slope));
            }
            INFO("reach " << reach << ", size " << size);
            CHECK(missing == 0);
            CHECK(worst < 0.03);
        }
    }
}

TEST_CASE("near and far cut the near field where they cut the map", "[bake][exact]") {
    Projection p = plainView(64);
    p.near = 2.0;
    p.far = 5.0;
    Mesh slope;  // from depth 1 to depth 9
    slope.triangle({-0.5f, 0, -1}, {0.5f, 0, -1}, {0, 1, -9});
    slope.triangle({-1, -1, -1.5f}, {1, -1, -1.5f}, {0, 1, -1.9f});  // in front
    slope.triangle({-1, -1, -6}, {1, -1, -6}, {0, 1, -7});           // behind
    BakeOptions o;
    o.width = o.height = 64;
    const std::vector<Triangle> found = trianglesOf(fieldOf({slope}, p, o));
    CHECK(found.size() == 2);
    double area = 0.0;
    for (const Triangle& t : found) {
        for (const glm::dvec3& corner : t) {
            CHECK(corner.z <= 0.5 * 1.0001);
            CHECK(corner.z >= 0.2 * 0.9999);
        }
        const glm::dvec2 a(t[1] - t[0]), b(t[2] - t[0]);
        area += 0.5 * std::abs(a.x * b.y - a.y * b.x);
    }
    // The trapezium between depths 2 and 5, where it is 7/8 and 4/8 wide.
    const auto row = [&](double z) { return 32.0 - 32.0 * (z - 1) / 8 / z; };
    const double near = 32 * 0.875 / 2, far = 32 * 0.5 / 5;
    CHECK(area == Approx(0.5 * (near + far) * (row(2) - row(5))).epsilon(0.002));
}

TEST_CASE("what casts nothing in the map is not in its near field", "[bake]") {
    const Projection p = plainView(64);
    BakeOptions o;
    o.width = o.height = 64;
    const auto count = [&](auto&& add) {
        Mesh mesh;
        add(mesh);
        return fieldOf({mesh}, p, o).triangles();
    };
    const auto front = [](Mesh& m) { m.triangle({0, 0, -2}, {1, 0, -2}, {0, 1, -2}); };
    const auto back = [](Mesh& m) { m.triangle({0, 0, -2}, {0, 1, -2}, {1, 0, -2}); };
    const auto edgeOn = [](Mesh& m) { m.triangle({0, 0, -2}, {0, 1, -2}, {0, 0, -3}); };
    for (const Cull cull : {Cull::none, Cull::back, Cull::front}) {
        o.cull = cull;
        CHECK(count(front) == (cull == Cull::front ? 0 : 1));
        CHECK(count(back) == (cull == Cull::back ? 0 : 1));
        CHECK(count(edgeOn) == 1);  // no pixel shows it, but rays meet it
    }
    o.cull = Cull::none;
    CHECK(count([](Mesh& m) { m.triangle({3, 0, -2}, {4, 0, -2}, {3, 1, -2}); }) == 0);
    CHECK(count([](Mesh& m) { m.triangle({1, 0, -2}, {4, 0, -2}, {3, 1, -2}); }) == 1);
    CHECK(count([](Mesh& m) { m.triangle({0, 0, -2}, {1, 1, -2}, {2, 2, -2}); }) == 0);
    CHECK(count([](Mesh& m) { m.triangle({0, 0, -2}, {NAN, 1, -2}, {2, 2, -2}); }) == 0);
    CHECK(count([](Mesh& m) { m.triangle({0, 0, 2}, {1, 0, 2}, {0, 1, 2}); }) == 0);
}

TEST_CASE("a near field is kept within its budget, and what it takes is told", "[bake]") {
    Casters casters({test::bumpyBall(20)});
    BakeOptions o = lamp();
    const std::uint64_t bytes = mustBake(casters, o).report.nearBytes;
    CHECK(bytes > 6 * 20 * 20 * 2 * 10);  // a mesh has points in common
    CHECK(bytes < 6 * 20 * 20 * 2 * 13);
    const auto bakeWith = [&](std::uint64_t budget) {
        o.nearField = budget;
        return mustBake(casters, o);
    };
    const Baked exact = bakeWith(bytes);
    CHECK(exact.report.noNearField.empty());
    CHECK_FALSE(exact.map.nearField(0).empty());
    for (const std::uint64_t less : {bytes - 1, bytes / 2, std::uint64_t(1)}) {
        const Baked b = bakeWith(less);
        CHECK(b.map.nearField(0).empty());
        CHECK(b.report.nearTriangles == exact.report.nearTriangles);
        CHECK(b.report.nearBytes >= bytes);
        CHECK(b.report.nearBytes < bytes * 5 / 4);
        CHECK_THAT(b.report.noNearField, Catch::Contains("--near-field 1M"));
        CHECK(identical(b.map, bakeWith(0).map));
    }
    const Baked none = bakeWith(0);
    CHECK(none.map.nearField(0).empty());
    CHECK(none.report.noNearField.empty());
    CHECK(none.report.nearTriangles == 0);
}

TEST_CASE("triangles that let light through are sheets of the near field", "[bake]") {
    Mesh glass = test::bumpyBall(3);
    glass.opacity = 0.5f;
    Casters casters({test::bumpyBall(4), glass});
    const Baked b = mustBake(casters, lamp());
    CHECK(b.map.nearField(0).empty());
    CHECK(b.report.noNearField.empty());
    CHECK(b.report.nearTriangles == 6 * (3 * 3 + 4 * 4) * 2);
    const NearSheets& sheets = b.map.nearSheets(0);
    std::uint64_t solid = 0, clearer = 0;
    for (const NearSheetChunk& chunk : sheets.chunks)
        (sheets.textures[chunk.texture].opacity < 1.0f ? clearer : solid) +=
            chunk.triangles;
    CHECK(solid == 6 * 4 * 4 * 2);
    CHECK(clearer == 6 * 3 * 3 * 2);
    casters.meshes[1].opacity = 0.0f;  // casts nothing
    const Baked clear = mustBake(casters, lamp());
    CHECK(clear.report.noNearField.empty());
    CHECK(clear.report.nearTriangles == 6 * 4 * 4 * 2);
}

TEST_CASE("each of six faces has the triangles that reach into it", "[bake]") {
    Casters casters({test::bumpyBall(10)});
    BakeOptions o = lamp();
    o.light.shape = LightShape::point;
    o.light.position = {0, 0, 0};
    o.cube = true;
    const Baked b = mustBake(casters, o);
    for (std::uint32_t f = 0; f < 6; ++f) {
        const std::uint64_t found = b.map.nearField(f).triangles();
        CHECK(found >= 10 * 10 * 2);
        CHECK(found < 14 * 14 * 2);  // its own and a rim of its neighbours'
    }
}

TEST_CASE("the near field is the same for any number of threads and order of triangles",
          "[bake][exact][threads]") {
    std::vector<Mesh> meshes{test::bumpyBall(60), test::bumpyBall(25)};
    meshes[1].worldFromObject = glm::scale(
        glm::rotate(glm::translate(glm::dmat4(1.0), {0.7, 0.2, 0.1}), 1.0, {1, 2, 3}),
        glm::dvec3(0.8));
    meshes.push_back(meshes[0]);  // copies
    BakeOptions o = lamp();
    o.width = 300;
    for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
        o.light.shape = shape;
        std::optional<Baked> first;
        Random random(3);
        for (const int threads : {1, 2, 8}) {
            const tbb::global_control most(tbb::global_control::max_allowed_parallelism,
                                           std::size_t(threads));
            tbb::task_arena arena(threads);
            Casters casters(meshes);
            arena.execute([&] {
                Baked b = mustBake(casters, o);
                if (!first)
                    first = std::move(b);
                else
                    CHECK(identical(first->map, b.map));
            });
            for (Mesh& mesh : meshes)
                shuffleTriangles(mesh, random);
            random.shuffle(meshes);
        }
        CHECK(first->map.nearField(0).chunks.size() > 5000);
    }
}

namespace {

/// Slivers that lie askew, most of them steep: each a pixel of the map or less wide.
Mesh leaves(int count) {
    Random random(3);
    Mesh mesh;
    for (int i = 0; i < count; ++i) {
        const glm::vec3 at(random.in(-0.6, 0.6), random.in(1.0, 2.0),
                           random.in(-0.6, 0.6));
        const double turn = random.in(0.0, 6.2831853), rise = random.in(-1.5, 1.5);
        const glm::vec3 along(std::cos(turn), rise, std::sin(turn));
        const auto first = std::uint32_t(mesh.positions.size());
        mesh.positions.push_back(at);
        mesh.positions.push_back(at + 0.25f * along);
        mesh.positions.push_back(
            at + glm::vec3(0.02 * std::sin(turn), 0.02, -0.02 * std::cos(turn)));
        for (std::uint32_t k = 0; k < 3; ++k)
            mesh.indices.push_back(first + k);
    }
    return mesh;
}

/// Part of a disk that looks down which the triangles hide from a point: a grid of points
/// on it, in double.
double hidden(const Mesh& mesh, const AreaLight& light, glm::dvec3 p) {
    constexpr int kSide = 80;
    int dark = 0, rays = 0;
    for (int i = 0; i < kSide * kSide; ++i) {
        const double x = (i % kSide + 0.5) / kSide * 2 - 1;
        const double y = (i / kSide + 0.5) / kSide * 2 - 1;
        if (x * x + y * y > 1.0) continue;
        const glm::dvec3 way = light.position + light.radius * glm::dvec3(x, 0, y) - p;
        bool meets = false;
        for (std::size_t t = 0; t < mesh.indices.size() && !meets; t += 3) {
            const glm::dvec3 a = glm::dvec3(mesh.positions[t]) - p;
            const glm::dvec3 b = glm::dvec3(mesh.positions[t + 1]) - p;
            const glm::dvec3 c = glm::dvec3(mesh.positions[t + 2]) - p;
            const bool sides[3] = {glm::dot(way, glm::cross(a, b)) > 0,
                                   glm::dot(way, glm::cross(b, c)) > 0,
                                   glm::dot(way, glm::cross(c, a)) > 0};
            meets = sides[0] == sides[1] && sides[1] == sides[2];
        }
        dark += meets;
        ++rays;
    }
    return double(dark) / rays;
}

}  // namespace

TEST_CASE("a small light's shadow of slender leaves is exact far below them",
          "[bake][statistical]") {
    const Mesh mesh = leaves(400);
    BakeOptions o = test::diskAbove(256);
    o.light.radius = 0.04;
    o.nearField = kAutomaticNearField;
    Casters casters({mesh});
    const Baked with = mustBake(casters, o);
    o.nearField = 0;
    const Baked without = mustBake(casters, o);
    // Leaves are 60 to 120 pixels of depth above the points.
    CHECK(with.map.projection(0).pixelFootprint(4.0) < 0.017);
    std::vector<glm::dvec3> points, normals;
    Random random(5);
    for (int i = 0; i < 60; ++i) {
        points.emplace_back(random.in(-0.6, 0.6), 0.0, random.in(-0.6, 0.6));
        normals.emplace_back(0, 1, 0);
    }
    ShadowOptions query;
    query.samples = 1024;
    const auto ask = [&](const ShadowMap& map) {
        std::vector<float> out(points.size());
        shadowFactors(map, o.light, points.data(), normals.data(), points.size(),
                      out.data(), query);
        return out;
    };
    const std::vector<float> a = ask(with.map), b = ask(without.map);
    double errorWith = 0.0, errorWithout = 0.0, shadow = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double expected = hidden(mesh, o.light, points[i]);
        errorWith += std::abs(a[i] - expected) / double(points.size());
        errorWithout += std::abs(b[i] - expected) / double(points.size());
        shadow += expected / double(points.size());
    }
    INFO("mean errors " << errorWith << " and " << errorWithout << " of " << shadow);
    CHECK(shadow > 0.1);
    // 1024 samples of the map and 5025 of this are that far apart.
    CHECK(errorWith < 0.01);
    CHECK(errorWithout > 0.03);
}

TEST_CASE("long triangles do not shadow what lies on them", "[bake][exact]") {
    // A steep beam across the whole of a fine map: a grid of 16 bits has steps of 1/16 of
    // a pixel there.
    for (const bool opaque : {true, false}) {
        BakeOptions o = lamp();
        o.width = 4096;
        o.height = 64;
        o.light.shape = LightShape::sun;
        o.light.direction = {0, -1, 0};
        o.light.angularDiameter = glm::radians(3.0);
        Mesh beam;
        const double slope = 2.0;
        const auto at = [&](double x, double z) {
            return glm::vec3(x, slope * x + 0.3 * z, z);
        };
        constexpr int kStrips = 12;
        for (int i = 0; i < kStrips; ++i) {
            const double low = 0.04 * i / kStrips, high = 0.04 * (i + 1) / kStrips;
            const double end = 1.0 - 0.013 * ((i * 7) % kStrips);
            beam.quad(at(-1, high), at(end, high), at(end, low), at(-1, low));
        }
        if (!opaque) beam.opacity = 0.5f;
        Casters casters(std::vector<Mesh>{beam});
        const Baked baked = test::mustBake(casters, o);
        REQUIRE((opaque ? !baked.map.nearField(0).empty()
                        : !baked.map.nearSheets(0).empty()));
        const glm::dvec3 normal = glm::normalize(glm::dvec3(-slope, 1, -0.3));
        Random random(4);
        int dark = 0;
        for (int i = 0; i < 400; ++i) {
            const glm::dvec3 point = at(random.in(-0.8, 0.8), random.in(0.004, 0.036));
            dark += shadowFactor(baked.map, baked.map.info().light, point, normal) > 0.0f;
        }
        INFO("opaque " << opaque);
        CHECK(dark == 0);
    }
}
