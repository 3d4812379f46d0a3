// Where the eye stands and what its window holds, against closed forms.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "bake/casters.h"
#include "bake/placement.h"
#include "mtsm/bake.h"

using namespace mtsm;
using mtsm::test::Casters;
using mtsm::test::Mesh;
using mtsm::test::Random;

namespace {

BakeOptions lamp(LightShape shape, glm::dvec3 position, double radius) {
    BakeOptions o;
    o.light.shape = shape;
    o.light.position = position;
    o.light.radius = radius;
    o.width = o.height = 64;
    o.target = glm::dvec3(0.0);
    return o;
}

/// An octagon of radius `r` around the origin in the plane y = 0.
Mesh octagon(float r) {
    Mesh mesh;
    for (int i = 0; i < 8; ++i) {
        const auto at = [&](int k) {
            const float a = float(k) * glm::pi<float>() / 4;
            return glm::vec3(r * std::cos(a), 0, r * std::sin(a));
        };
        mesh.triangle({0, 0, 0}, at(i), at(i + 1));
    }
    return mesh;
}

Baked mustBake(CasterSource& casters, const BakeOptions& options) {
    auto baked = bake(casters, options);
    if (!baked) FAIL(baked.error().message);
    return *std::move(baked);
}

glm::dvec3 world(const Mesh& mesh, std::size_t i) {
    return glm::dvec3(mesh.worldFromObject * glm::dvec4(mesh.positions[i], 1.0));
}

Result<bake_detail::Placement> placed(CasterSource& casters, const BakeOptions& options) {
    if (auto s = bake_detail::checkOptions(options); !s) return s.error();
    const bake_detail::Progress progress(options);
    bake_detail::Visits visits(casters, progress);
    return bake_detail::place(visits, options);
}

BakeOptions bulb(LightShape shape, glm::dvec3 position, double radius) {
    BakeOptions o = lamp(shape, position, radius);
    o.cube = true;
    return o;
}

}  // namespace

TEST_CASE("the eye is pushed back by eq. 4 behind a disk light", "[bake][exact]") {
    // Seen from (0, 4, 0), an octagon of radius 2 reaches tan = 1/2 off the axis: a disk
    // of radius 0.3 is pushed back by 0.6.
    Casters casters({octagon(2)});
    BakeOptions o = lamp(LightShape::disk, {0, 4, 0}, 0.3);
    o.rounding = 0.0f;
    const Baked b = mustBake(casters, o);
    const Projection& p = b.map.projection(0);
    CHECK(glm::length(p.eye - glm::dvec3(0, 4.6, 0)) < 1e-6);
    CHECK(glm::length(p.forward - glm::dvec3(0, -1, 0)) < 1e-12);
    CHECK(p.near == Approx(0.6).epsilon(1e-6));
    CHECK(b.map.info().light.direction == p.forward);
    // The disk lies on the plane z = d.
    CHECK(p.lightFromWorld(b.map.info().light.position).z == Approx(0.6).epsilon(1e-6));
    CHECK_FALSE(b.map.info().castersClipped);
    // Nearest and furthest depth of the octagon are both 4.6.
    CHECK(b.map.zRange(0).min == Approx(4.6f));
    CHECK(b.map.zRange(0).max == Approx(4.6f));
}

TEST_CASE("with a given field of view every point of the light lies in the window",
          "[bake][exact]") {
    // Eq. 4 for all window shapes; a sphere touches the frustum's sides, so its
    // silhouette does.
    for (const LightShape shape : {LightShape::disk, LightShape::sphere}) {
        for (const glm::uvec2 size :
             {glm::uvec2(64, 64), glm::uvec2(64, 16), glm::uvec2(16, 64)}) {
            for (const double fov : {0.3, 1.2, 2.4}) {
                Casters casters({octagon(1)});
                BakeOptions o = lamp(shape, {0, 4, 0}, 0.3);
                o.fov = fov;
                o.width = size.x;
                o.height = size.y;
                const Baked b = mustBake(casters, o);
                const Projection& p = b.map.projection(0);
                const double z = p.lightFromWorld(b.map.info().light.position).z;
                // Largest tangent of the light as seen from the eye, per side.
                const double tangent =
                    shape == LightShape::disk ? 0.3 / z : std::tan(std::asin(0.3 / z));
                const double narrow = std::tan(0.5 * fov) * std::min(size.x, size.y) /
                                      std::max(size.x, size.y);
                INFO(name(shape) << " " << size.x << "x" << size.y << " fov " << fov);
                CHECK(tangent == Approx(narrow));
            }
        }
    }
}

TEST_CASE("a given field of view decides window and push-back", "[bake][exact]") {
    Casters casters({octagon(2)});
    BakeOptions o = lamp(LightShape::disk, {0, 4, 0}, 0.3);
    o.fov = 2 * std::atan(0.25);
    o.width = 64;
    o.height = 32;
    const Baked b = mustBake(casters, o);
    const Projection& p = b.map.projection(0);
    // The smaller side is half as wide: d = 0.3 / 0.125.
    CHECK(glm::length(p.eye - glm::dvec3(0, 6.4, 0)) < 1e-12);
    CHECK(p.scale.x == Approx(32 / 0.25));
    CHECK(p.scale.y == Approx(-32 / 0.25));
    CHECK(p.offset == glm::dvec2(32, 16));
    // From there the octagon reaches 2 / 6.4 > 1/4.
    CHECK(b.map.info().castersClipped);
    CHECK(b.report.clipped == 8);
    o.fov = 2 * std::atan(0.8);  // the shorter side reaches 0.4 at 4.375: less than 2
    o.height = 64;
    CHECK_FALSE(mustBake(casters, o).map.info().castersClipped);
}

TEST_CASE("a fitted window holds every vertex of every caster, tightly", "[bake]") {
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
        Random random(seed);
        std::vector<Mesh> meshes(3);
        for (Mesh& mesh : meshes) {
            mesh.worldFromObject =
                glm::rotate(glm::translate(glm::dmat4(1.0), {random.in(-1, 1), 0, 0}),
                            random.in(0, 6), glm::dvec3(1, 1, 0));
            for (int i = 0; i < 20; ++i) {
                glm::vec3 c[3];
                for (glm::vec3& v : c)
                    v = glm::dvec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1));
                mesh.triangle(c[0], c[1], c[2]);
            }
        }
        const LightShape shape =
            std::array{LightShape::point, LightShape::disk, LightShape::rect,
                       LightShape::sphere, LightShape::sun}[seed % 5];
        BakeOptions o = lamp(shape, {random.in(3, 9), random.in(4, 9), 5}, 0.5);
        o.light.size = {1.0, 0.4};
        o.light.direction = {-1, -2, -1};
        o.light.angularDiameter = 0.01;
        if (seed % 2) o.target.reset();
        o.width = 1 + std::uint32_t(random.below(200));
        o.height = 1 + std::uint32_t(random.below(200));
        Casters casters(meshes);
        const Baked b = mustBake(casters, o);
        const Projection& p = b.map.projection(0);
        glm::dvec2 low(1e9), high(-1e9);
        for (const Mesh& mesh : meshes) {
            for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
                const glm::dvec3 light = p.lightFromWorld(world(mesh, i));
                REQUIRE(light.z > p.near);
                const glm::dvec2 r = p.rasterFromLight(light);
                low = glm::min(low, r);
                high = glm::max(high, r);
            }
        }
        INFO("seed " << seed << ", " << o.width << " x " << o.height);
        const glm::dvec2 size(o.width, o.height);
        for (int axis = 0; axis < 2; ++axis) {
            CHECK(low[axis] > 0.0);
            CHECK(high[axis] < size[axis]);
            if (size[axis] >= 6) CHECK(low[axis] >= 0.5);
            if (size[axis] >= 6) CHECK(high[axis] <= size[axis] - 0.5);
            CHECK(low[axis] + high[axis] == Approx(size[axis]));
        }
        // Tight in one direction at least; the other only where pixels would get longer
        // than 4 : 1.
        const double aspect = p.scale.x / -p.scale.y;
        CHECK(aspect <= 4.0 * (1 + 1e-9));
        CHECK(aspect >= 0.25 * (1 - 1e-9));
        const glm::dvec2 spare = size - (high - low);
        CHECK(std::min(spare.x, spare.y) <= 1.5 + 1e-6);
        if (aspect < 3.99 && aspect > 0.2501)
            CHECK(std::max(spare.x, spare.y) <= 1.5 + 1e-6);
        CHECK(b.report.clipped == 0);
        CHECK(b.report.outside == 0);
        CHECK_FALSE(b.map.info().castersClipped);
    }
}

TEST_CASE("a sphere light lets in casters only beyond its far side", "[bake][exact]") {
    // Looking down from y = 10 with radius 1: what lies above y = 9 is no caster.
    Mesh mesh;
    mesh.triangle({-1, 9.5f, -1}, {1, 9.5f, -1}, {0, 9.5f, 1});
    mesh.triangle({-1, 8.5f, -1}, {1, 8.5f, -1}, {0, 8.5f, 1});
    Casters casters({mesh});
    BakeOptions o = lamp(LightShape::sphere, {0, 10, 0}, 1.0);
    o.light.direction = {1, 0, 0};  // not used by a sphere
    // Unasked, nothing is cut off.
    const auto refused = bake(casters, o);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().message.find(
              "1 triangles of the casters lie beside or behind") != std::string::npos);
    CHECK(refused.error().message.find("--near") != std::string::npos);
    o.near = 1.0;
    const Baked b = mustBake(casters, o);
    const Projection& p = b.map.projection(0);
    const double d = 10 - 0;
    CHECK(p.lightFromWorld({0, 9, 0}).z == Approx(p.near));
    CHECK(b.report.outside == 1);
    // tan = |(1, 1)| / 1.5 at the corners (+-1, 8.5, -1).
    const double pushBack = 1.0 / (std::sqrt(2.0) / 1.5);
    CHECK(p.eye.y - d == Approx(pushBack));
    CHECK(p.near == Approx(pushBack + 1.0));
    o.near = 0.25;
    CHECK(mustBake(casters, o).report.outside == 0);
}

TEST_CASE("an aimed light keeps its direction and is looked along", "[bake]") {
    Casters casters({octagon(1)});
    BakeOptions o = lamp(LightShape::disk, {0.5, 4, 0}, 0.2);
    o.light.direction = {0, -2, 0};
    o.aimed = true;
    const Baked b = mustBake(casters, o);
    CHECK(b.map.info().light.direction == glm::dvec3(0, -1, 0));
    CHECK(b.map.projection(0).forward == glm::dvec3(0, -1, 0));
    o.aimed = false;  // and else it turns to the target
    const glm::dvec3 to = glm::normalize(glm::dvec3(-0.5, -4, 0));
    CHECK(glm::length(mustBake(casters, o).map.info().light.direction - to) < 1e-12);
    o.target.reset();  // or to the casters' centre, which is the same here
    CHECK(glm::length(mustBake(casters, o).map.info().light.direction - to) < 1e-7);
}

TEST_CASE("a rect light's up is the map's up", "[bake]") {
    Casters casters({octagon(1)});
    BakeOptions o = lamp(LightShape::rect, {0, 4, 0}, 0);
    o.light.size = {0.6, 0.8};
    o.light.up = {1, 5, 0};
    const Baked b = mustBake(casters, o);
    CHECK(glm::length(b.map.projection(0).up - glm::dvec3(1, 0, 0)) < 1e-12);
    CHECK(b.map.info().light.up == b.map.projection(0).up);
    // Half of the diagonal counts as its radius: tan is 1/4, so d = 0.5 * 4.
    CHECK(b.map.projection(0).eye.y == Approx(4 + 2));
    // An up along the view is replaced, always by the same.
    o.light.up = {0, 3, 0};
    const Baked c = mustBake(casters, o), d = mustBake(casters, o);
    CHECK(identical(c.map, d.map));
    CHECK(std::abs(glm::dot(c.map.projection(0).up, c.map.projection(0).forward)) <
          1e-12);
}

TEST_CASE("a sun sees everything from before the nearest caster", "[bake][exact]") {
    Mesh low = octagon(2), high = octagon(1);
    high.worldFromObject = glm::translate(glm::dmat4(1.0), {0, 3, 0});
    Casters casters({low, high});
    BakeOptions o = lamp(LightShape::sun, {77, 77, 77}, 0);
    o.light.direction = {0, -3, 0};
    o.light.angularDiameter = 0.01;
    o.keepHidden = true;
    o.target.reset();
    o.up = {0, 0, 1};
    const Baked b = mustBake(casters, o);
    const Projection& p = b.map.projection(0);
    CHECK(p.kind == ProjectionKind::orthographic);
    CHECK(p.forward == glm::dvec3(0, -1, 0));
    CHECK(b.map.info().light.direction == p.forward);
    CHECK(b.map.zRange(0).min > 0.0f);
    CHECK(b.map.zRange(0).max - b.map.zRange(0).min == Approx(3.0));
    // 4 units across 62.5 pixels.
    CHECK(p.scale.x == Approx(62.5 / 4).epsilon(1e-6));
    const PixelLayers middle = b.map.pixel(0, 33, 33), edge = b.map.pixel(0, 5, 32);
    REQUIRE(middle.count == 2);
    CHECK(middle.z[1] - middle.z[0] == Approx(3.0));
    REQUIRE(edge.count == 1);
    CHECK(edge.z[0] == middle.z[1]);
    // near is measured from the nearest caster.
    o.near = 1.0;
    CHECK(mustBake(casters, o).report.outside == 8);
    o.near.reset();
    o.far = 1.0;
    CHECK(mustBake(casters, o).report.outside == 8);
}

TEST_CASE("lights of no size are points", "[bake]") {
    Casters casters({octagon(2)});
    const Baked point = mustBake(casters, lamp(LightShape::point, {0, 4, 0}, 0));
    const Baked disk = mustBake(casters, lamp(LightShape::disk, {0, 4, 0}, 0));
    const Baked sphere = mustBake(casters, lamp(LightShape::sphere, {0, 4, 0}, 0));
    for (const Baked* b : {&point, &disk, &sphere}) {
        CHECK(b->map.projection(0).eye == glm::dvec3(0, 4, 0));
        CHECK(b->map.projection(0).near > 0.0);
        CHECK(b->map.projection(0).near < 1e-4);
        CHECK(b->map.layerCount() == point.map.layerCount());
    }
}

TEST_CASE("a light much larger than the scene leaves depth its precision", "[bake]") {
    // Eq. 4 alone would stand the eye 4e6 behind a light 4 away, where floats are 0.25
    // apart.
    Mesh mesh = octagon(2);
    mesh.triangle({0, 0.01f, 0}, {1, 0.01f, 0}, {0, 0.01f, 1});
    Casters casters({mesh});
    BakeOptions o = lamp(LightShape::disk, {0, 4, 0}, 2e6);
    o.width = o.height = 1024;
    const Baked b = mustBake(casters, o);
    const Projection& p = b.map.projection(0);
    const double z = p.lightFromWorld({0, 0, 0}).z;
    const float step = std::nextafter(float(z), 1e30f) - float(z);
    CHECK(step <= 0.26 * p.pixelFootprint(z));
    CHECK(b.map.zRange(0).min < b.map.zRange(0).max);
}

TEST_CASE("casters are visited as often as the options leave open", "[bake]") {
    Casters casters({octagon(2)});
    BakeOptions o = lamp(LightShape::disk, {0, 4, 0}, 0.3);
    mustBake(casters, o);
    CHECK(casters.visits == 5);  // bounds, push-back, window, kinds, raster
    casters.visits = 0;
    o.fov = 1.0;
    mustBake(casters, o);
    CHECK(casters.visits == 2);
    casters.visits = 0;
    o.fov.reset();
    o.light.radius = 0;
    mustBake(casters, o);
    CHECK(casters.visits == 4);
}

TEST_CASE("a scene 1e7 from the world's origin bakes as at the origin", "[bake]") {
    const glm::dvec3 offset(1e7, -2e7, 3e7);
    Mesh ball = test::bumpyBall(12);
    for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
        BakeOptions o = lamp(shape, {2, 4, 3}, 0.3);
        o.light.direction = {-2, -4, -3};
        Casters here({ball});
        const Baked a = mustBake(here, o);
        Mesh moved = ball;
        moved.worldFromObject = glm::translate(glm::dmat4(1.0), offset);
        o.light.position += offset;
        o.target = offset;
        Casters there({moved});
        const Baked b = mustBake(there, o);
        REQUIRE(a.map.layerCount() == b.map.layerCount());
        for (std::uint32_t y = 0; y < o.height; ++y) {
            for (std::uint32_t x = 0; x < o.width; ++x) {
                const PixelLayers p = a.map.pixel(0, x, y), q = b.map.pixel(0, x, y);
                REQUIRE(p.count == q.count);
                for (std::uint32_t i = 0; i < p.count; ++i)
                    REQUIRE(std::abs(p.z[i] - q.z[i]) < 2e-6f);
            }
        }
    }
}

TEST_CASE("six views share out the space around the light's centre", "[bake][exact]") {
    Casters casters({octagon(2)});
    const glm::dvec3 axes[] = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                               {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
    for (const LightShape shape :
         {LightShape::point, LightShape::disk, LightShape::rect, LightShape::sphere}) {
        BakeOptions o = bulb(shape, {0.25, 4, -1}, 0.5);
        o.width = o.height = 48;
        const auto p = placed(casters, o);
        REQUIRE(p);
        REQUIRE(p->projections.size() == 6);
        std::vector<MapFace> faces(6);
        for (int f = 0; f < 6; ++f) {
            const Projection& q = p->projections[std::size_t(f)];
            CHECK(q.kind == ProjectionKind::perspective);
            CHECK(q.eye == o.light.position);  // no push-back
            CHECK(q.forward == axes[f]);
            CHECK(q.right == glm::cross(q.forward, q.up));
            // A tangent of exactly 1 to each side.
            CHECK(q.lightFromRaster({0, 0}, 1.0) == glm::dvec3(-1, 1, 1));
            CHECK(q.lightFromRaster({48, 48}, 1.0) == glm::dvec3(1, -1, 1));
            faces[std::size_t(f)].projection = q;
            faces[std::size_t(f)].tiles.resize(1);
        }
        // And a map may be made of them.
        MapInfo info;
        info.width = info.height = 48;
        info.light = p->light;
        CHECK(ShadowMap::create(info, faces));
    }
}

TEST_CASE("in six views what is inside the light casts nothing", "[bake][exact]") {
    Casters casters({octagon(2)});
    const auto near = [&](const BakeOptions& o) {
        const auto p = placed(casters, o);
        REQUIRE(p);
        for (const Projection& q : p->projections)
            CHECK(q.near == p->projections[0].near);
        return p->projections[0].near;
    };
    // The largest cube in a sphere touches it with its corners.
    const double side = near(bulb(LightShape::sphere, {0, 4, 0}, 0.5));
    CHECK(glm::length(glm::dvec3(side)) == Approx(0.5));
    // All others are as points: 1e-6 of the distance to the octagon's far end.
    const double far = 4 + 2 * std::sqrt(2.0);
    CHECK(near(bulb(LightShape::point, {0, 4, 0}, 0)) == Approx(1e-6 * far));
    CHECK(near(bulb(LightShape::disk, {0, 4, 0}, 0.5)) == Approx(1e-6 * far));
    BakeOptions o = bulb(LightShape::disk, {0, 4, 0}, 0.5);
    o.near = 0.125;
    o.far = 17.0;
    CHECK(near(o) == 0.125);
    CHECK(placed(casters, o)->projections[5].far == 17.0);
    // far may lie within the sphere's radius, but not within the cube.
    o = bulb(LightShape::sphere, {0, 4, 0}, 0.5);
    o.far = 0.4;
    CHECK(placed(casters, o));
    o.far = 0.2;
    CHECK_FALSE(placed(casters, o));
}

TEST_CASE("a one-sided light in a cube of views is aimed as without", "[bake]") {
    Casters casters({octagon(2)});
    BakeOptions o = bulb(LightShape::rect, {0, 4, 0}, 0);
    o.light.size = {0.5, 0.25};
    o.light.up = {1, 5, 0};
    o.target = glm::dvec3(0, 0, 4);
    const auto p = placed(casters, o);
    REQUIRE(p);
    CHECK(glm::length(p->light.direction - glm::normalize(glm::dvec3(0, -4, 4))) < 1e-12);
    CHECK(std::abs(glm::dot(p->light.up, p->light.direction)) < 1e-12);
    o.target.reset();  // the casters' centre
    CHECK(glm::length(placed(casters, o)->light.direction - glm::dvec3(0, -1, 0)) < 1e-6);
    o.target = o.light.position;
    CHECK_FALSE(placed(casters, o));
    // A light without a front needs no target and may stand anywhere.
    o = bulb(LightShape::sphere, {0, 0, 0}, 0.5);
    CHECK(placed(casters, o));
}

TEST_CASE("six views read the casters only where their extent is asked for", "[bake]") {
    Casters casters({octagon(2)});
    REQUIRE(placed(casters, bulb(LightShape::sphere, {0, 4, 0}, 0.5)));
    CHECK(casters.visits == 0);
    REQUIRE(placed(casters, bulb(LightShape::point, {0, 4, 0}, 0)));
    CHECK(casters.visits == 1);
}

TEST_CASE("six views are refused where they make no sense, and offered where they do",
          "[bake][bad-input]") {
    Casters casters({octagon(2)});
    const auto message = [&](const BakeOptions& o) {
        const auto p = placed(casters, o);
        REQUIRE_FALSE(p);
        CHECK(p.error().code == ErrorCode::badArgument);
        return p.error().message;
    };
    const auto has = [](const char* text) { return Catch::Contains(text); };
    BakeOptions o = bulb(LightShape::sun, {0, 4, 0}, 0);
    CHECK_THAT(message(o), has("--projection cube: a sun"));
    o = bulb(LightShape::point, {0, 4, 0}, 0);
    o.fov = 1.0;
    CHECK_THAT(message(o), has("--fov") && has("--projection cube"));
    o.fov.reset();
    o.height = 32;
    CHECK_THAT(message(o), has("--resolution 64x32") && has("square"));
    // Inside the casters, and beside them.
    Mesh floor = octagon(2), ceiling = octagon(2);
    ceiling.worldFromObject = glm::translate(glm::dmat4(1.0), {0, 3, 0});
    Casters room({floor, ceiling});
    for (const double height : {1.5, 3.2}) {
        o = lamp(LightShape::point, {0, height, 0}, 0);
        if (height > 3) o.target = glm::dvec3(5, 3.2, 0);
        const auto refused = placed(room, o);
        REQUIRE_FALSE(refused);
        CHECK_THAT(refused.error().message, has("--projection cube"));
        o.cube = true;
        CHECK(placed(room, o));
    }
}
