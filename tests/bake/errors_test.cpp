// What bake() refuses, one by one, with the option's name and the way out.
#include <catch2/catch.hpp>
#include <limits>
#include <stdexcept>

#include "bake/baked.h"
#include "bake/casters.h"
#include "mtsm/bake.h"

using namespace mtsm;
using mtsm::test::Casters;
using mtsm::test::Mesh;

namespace {

Mesh square() {
    Mesh mesh;
    mesh.quad({-1, 0, -1}, {1, 0, -1}, {1, 0, 1}, {-1, 0, 1});
    return mesh;
}

BakeOptions lamp() {
    return test::diskAbove(32);
}

template <typename Change>
Error refused(Change&& change, std::vector<Mesh> meshes = {square()}) {
    BakeOptions o = lamp();
    change(o);
    Casters casters(std::move(meshes));
    const auto baked = bake(casters, o);
    if (baked) FAIL("it was baked");
    INFO(baked.error().message);
    CHECK(baked.error().message.find('\n') == std::string::npos);
    return baked.error();
}

void checkNames(const Error& error, ErrorCode code, const std::string& text) {
    INFO(error.message);
    CHECK(error.code == code);
    CHECK(error.message.find(text) != std::string::npos);
}

const double kNan = std::numeric_limits<double>::quiet_NaN();

}  // namespace

TEST_CASE("options out of range are named as the tools spell them", "[bake][bad-input]") {
    const auto bad = ErrorCode::badArgument;
    using O = BakeOptions;
    checkNames(refused([](O& o) { o.width = 0; }), bad, "--resolution 0x32");
    checkNames(refused([](O& o) { o.height = 32769; }), bad, "--resolution 32x32769");
    checkNames(refused([](O& o) { o.layers = 0; }), bad, "--layers 0");
    checkNames(refused([](O& o) { o.layers = (1u << 20) + 1; }), bad, "--layers 1048577");
    for (const std::uint32_t s : {0u, 3u, 16u})
        checkNames(refused([&](O& o) { o.subsamples = s; }), bad, "--subsamples");
    checkNames(refused([](O& o) {
                   o.subsamples = 8;
                   o.width = 8192;
               }),
               bad, "at most 4096");
    for (const float t : {-0.1f, 1.5f, float(kNan)})
        checkNames(refused([&](O& o) { o.tolerance = t; }), bad, "--tolerance");
    checkNames(refused([](O& o) { o.layerLength = float(kNan); }), bad, "layerLength");
    checkNames(refused([](O& o) { o.fov = 0.0; }), bad, "--fov 0");
    checkNames(refused([](O& o) { o.fov = 3.1415926535897932; }), bad, "--fov 180");
    checkNames(refused([](O& o) { o.fov = kNan; }), bad, "--fov nan");
    checkNames(refused([](O& o) { o.near = -0.5; }), bad, "--near -0.5");
    checkNames(refused([](O& o) { o.near = kNan; }), bad, "--near nan");
    checkNames(refused([](O& o) { o.near = 2.0, o.far = 2.0; }), bad, "--far 2");
    checkNames(refused([](O& o) { o.far = 0.0; }), bad, "--far 0");
    checkNames(refused([](O& o) { o.bias = -1.0f; }), bad, "--bias -1");
    checkNames(refused([](O& o) { o.bias = float(kNan); }), bad, "--bias nan");
    checkNames(refused([](O& o) { o.target = glm::dvec3(kNan); }), bad, "--light-target");
    checkNames(refused([](O& o) { o.up = glm::dvec3(kNan); }), bad, "--light-up");
    checkNames(refused([](O& o) { o.light.radius = -1; }), bad, "radius -1");
    checkNames(refused([](O& o) { o.light.position.x = kNan; }), bad, "position");
    checkNames(refused([](O& o) { o.light.direction = {}; }), bad, "direction");
    checkNames(refused([](O& o) { o.target = o.light.position; }), bad, "--light-target");
    checkNames(refused([](O& o) {
                   o.light.shape = LightShape::sun;
                   o.fov = 1.0;
               }),
               bad, "--fov");
}

TEST_CASE("a light inside the casters' bounds needs a field of view",
          "[bake][bad-input]") {
    Mesh box = square();
    box.quad({-1, 6, -1}, {1, 6, -1}, {1, 6, 1}, {-1, 6, 1});
    const Error e = refused([](BakeOptions&) {}, {box});
    checkNames(e, ErrorCode::badArgument, "(0, 4, 0)");
    checkNames(e, ErrorCode::badArgument, "(-1, 0, -1) to (1, 6, 1)");
    checkNames(e, ErrorCode::badArgument, "--fov");
    BakeOptions o = lamp();
    o.fov = 1.0;
    o.target = glm::dvec3(0.0);
    Casters casters({box});
    const auto baked = bake(casters, o);
    REQUIRE(baked);
    CHECK(baked->report.outside == 2);
}

TEST_CASE("a window wider than 170 degrees is refused", "[bake][bad-input]") {
    Mesh wall;  // beside the light, past its plane
    wall.quad({1, -5, -1}, {1, -5, 1}, {1, 5, 1}, {1, 5, -1});
    for (const double radius : {0.0, 0.3}) {
        const Error e = refused(
            [&](BakeOptions& o) {
                o.light.radius = radius;
                o.target = glm::dvec3(0, 0, 0);
            },
            {wall});
        checkNames(e, ErrorCode::badArgument, "--fov");
        checkNames(e, ErrorCode::badArgument, "85");
        checkNames(e, ErrorCode::badArgument, "--near");
    }
}

TEST_CASE("casters behind the light are an error that says so", "[bake][bad-input]") {
    const auto upwards = [](BakeOptions& o) {
        o.light.direction = {0, 1, 0};
        o.aimed = true;
    };
    checkNames(refused(upwards), ErrorCode::badArgument, "behind the light");
    checkNames(refused([&](BakeOptions& o) {
                   upwards(o);
                   o.fov = 1.0;
               }),
               ErrorCode::badArgument, "behind the light");
    checkNames(refused([&](BakeOptions& o) { o.near = 10.0; }), ErrorCode::badArgument,
               "--near");
}

TEST_CASE("casters without a usable triangle are a bad file that says why",
          "[bake][bad-input]") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    Mesh broken;
    broken.triangle({0, 0, 0}, {1, 0, 0}, {2, 0, 0});
    broken.triangle({nan, 0, 0}, {1, 0, 0}, {2, 0, 1});
    broken.triangle({nan, nan, nan}, {1, 0, 0}, {2, 0, 1});
    Mesh clear = square();
    clear.opacity = 0.0f;
    for (const bool given : {false, true}) {
        const Error e = refused(
            [&](BakeOptions& o) {
                if (given) o.fov = 1.0;
                if (given) o.target = glm::dvec3(0.0);
            },
            {broken, clear});
        checkNames(e, ErrorCode::badFile, "of 5 triangles in 2 meshes");
        checkNames(e, ErrorCode::badFile, "1 have no area");
        checkNames(e, ErrorCode::badFile, "2 have a corner that is not finite");
        checkNames(e, ErrorCode::badFile, "2 are wholly transparent");
    }
    checkNames(refused([](BakeOptions&) {}, {}), ErrorCode::badFile,
               "nothing casts a shadow: there are no meshes, and no strand");
    checkNames(refused([](BakeOptions& o) { o.light.shape = LightShape::sun; }, {broken}),
               ErrorCode::badFile, "nothing casts a shadow: of 3 triangles");
    Mesh facing = square();
    checkNames(refused(
                   [](BakeOptions& o) {
                       o.cull = Cull::back;
                       o.light.position = {0, 4, 0};
                   },
                   {facing}),
               ErrorCode::badFile, "2 are culled");
}

TEST_CASE("meshes that break their promises are refused", "[bake][bad-input]") {
    Mesh wild = square();
    wild.indices[4] = 6;
    checkNames(refused([](BakeOptions&) {}, {square(), wild}), ErrorCode::badArgument,
               "caster 1 has a triangle with vertex 6, but only 6 vertices");
    for (const float opacity : {-0.5f, 1.5f, float(kNan)}) {
        Mesh odd = square();
        odd.opacity = opacity;
        checkNames(refused([](BakeOptions&) {}, {odd}), ErrorCode::badArgument,
                   "opacity");
    }
}

TEST_CASE("memory is refused before it is taken", "[bake][bad-input]") {
    // The hierarchy alone, a single tile's layers, and a tile that turns translucent.
    checkNames(refused([](BakeOptions& o) {
                   o.width = o.height = 32768;
                   o.maxBytes = 1 << 30;
               }),
               ErrorCode::tooLarge, "--max-memory");
    const Error e = refused([](BakeOptions& o) { o.maxBytes = 16 << 10; });
    checkNames(e, ErrorCode::tooLarge, "--layers");
    checkNames(e, ErrorCode::tooLarge, "--resolution");
    checkNames(e, ErrorCode::tooLarge, "32 x 32 pixels");
}

TEST_CASE("a progress callback hears of every stage and can stop each", "[bake]") {
    std::vector<std::string> stages;
    BakeOptions o = lamp();
    o.progress = [&](const char* stage, double fraction) {
        CHECK(fraction <= 1.0);
        if (stages.empty() || stages.back() != stage) stages.emplace_back(stage);
        return true;
    };
    Casters casters({square()});
    REQUIRE(bake(casters, o));
    CHECK(stages == std::vector<std::string>{"reading casters", "rasterising",
                                             "building map",
                                             "dropping what no light sees"});
    for (const std::string& stop : stages) {
        o.progress = [&](const char* stage, double) { return stop != stage; };
        const auto baked = bake(casters, o);
        REQUIRE_FALSE(baked);
        checkNames(baked.error(), ErrorCode::cancelled, stop);
    }
}

TEST_CASE("what a source reports or throws comes back as an error", "[bake][bad-input]") {
    struct Failing final : CasterSource {
        bool throws = false;
        Status visit(const CasterVisitor&) override {
            if (throws) throw std::runtime_error("the importer fell over");
            return Error{ErrorCode::io, "no such file: hero.glb"};
        }
    } source;
    const auto reported = bake(source, lamp());
    REQUIRE_FALSE(reported);
    checkNames(reported.error(), ErrorCode::io, "hero.glb");
    source.throws = true;
    const auto thrown = bake(source, lamp());
    REQUIRE_FALSE(thrown);
    checkNames(thrown.error(), ErrorCode::io, "fell over");
}
