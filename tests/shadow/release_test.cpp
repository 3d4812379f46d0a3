// Maps that let go of their layers: what needs layers says so, nothing that is asked all
// the same does harm, and copies are maps of their own.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <thread>
#include <vector>

#include "map_fixture.h"
#include "mtsm/shadow.h"
#include "mtsm/writer.h"
#include "random.h"

using namespace mtsm;
using test::Random;

namespace {

/// A half-plane two units in front of the eye, in one face or in all six.
ShadowMap halfDark(float v, Translucent translucent, bool cube = false) {
    MapInfo info = test::plainInfo(32, 32, 16);
    info.light.shape = cube ? LightShape::sphere : LightShape::disk;
    info.light.radius = 0.2;
    info.light.direction = {0, 0, -1};
    info.bias = 0.05f;
    info.translucent = translucent;
    const auto views = cube ? test::cubeProjections(32)
                            : std::vector<Projection>{test::plainProjection(32, 32)};
    const ShadowMap map =
        test::mapOf(info, views, [v](std::uint32_t, std::uint32_t x, std::uint32_t) {
            return x < 16 ? std::vector<test::TestLayer>{{2.0f, v, 1}}
                          : std::vector<test::TestLayer>{};
        });
    return v > 0.0f ? map : test::opaqueOf(map);
}

ShadowMap released(const ShadowMap& map) {
    ShadowMap copy = map;
    const Status done = releaseLayers(copy);
    if (!done) FAIL(done.error().message);
    REQUIRE(!copy.hasLayers());
    return copy;
}

std::vector<float> answers(const ShadowMap& map, const std::vector<glm::dvec3>& points,
                           const ShadowOptions& options = {}) {
    std::vector<float> out(points.size());
    shadowFactors(map, map.info().light, points.data(), nullptr, points.size(),
                  out.data(), options);
    return out;
}

bool sameBits(const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), 4 * a.size()) == 0;
}

std::vector<glm::dvec3> acrossTheEdge() {
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 600; ++i)
        points.push_back({3.8 * (i / 600.0 - 0.5), 0.1, -4});
    return points;
}

}  // namespace

TEST_CASE("points of every sort have the same answer without layers, or close to it",
          "[shadow]") {
    for (const bool cube : {false, true}) {
        for (const float v : {0.0f, 0.5f}) {
            for (const Translucent kind : {Translucent::sheets, Translucent::media}) {
                INFO("cube " << cube << " v " << v << " media " << int(kind));
                const ShadowMap map = halfDark(v, kind, cube), bare = released(map);
                Random random(4);
                std::vector<glm::dvec3> points, odd;
                for (int i = 0; i < 300; ++i) {
                    const glm::dvec3 p = random.within(3.0);
                    points.push_back(cube ? p : glm::dvec3(p.x, p.y, -2.5 - 0.3 * p.z));
                    odd.push_back(1e-3 * random.within(1.0));  // in front of all layers
                    odd.push_back(1e6 * random.within(1.0));
                }
                odd.push_back({NAN, 0, 0});
                odd.push_back({0, 0, 0});
                odd.push_back({1e300, -1e300, 1e300});
                CHECK(sameBits(answers(map, points), answers(bare, points)));
                const std::vector<float> a = answers(map, odd), b = answers(bare, odd);
                for (std::size_t i = 0; i < odd.size(); ++i) {
                    INFO("point " << i);
                    CHECK((b[i] >= 0.0f && b[i] <= 1.0f));
                    CHECK(std::abs(a[i] - b[i]) < 0.1f);
                }
                std::vector<ShadowRay> rays;
                for (int i = 0; i < 300; ++i)
                    rays.push_back({random.within(4.0), random.direction(), 5.0});
                for (std::size_t i = 0; i < rays.size(); i += 10) {
                    rays[i].direction = {1, 0, 0};  // level
                    rays[i + 1].length = INFINITY;
                    rays[i + 2].origin *= 1e12;
                    rays[i + 3].direction.x = NAN;
                }
                std::vector<float> seen(rays.size());
                visibilities(bare, rays.data(), rays.size(), seen.data());
                for (const float visible : seen)
                    CHECK((visible >= 0.0f && visible <= 1.0f));
            }
        }
    }
}

TEST_CASE("what needs layers says that they are gone", "[shadow][bad-input]") {
    for (const bool opaque : {false, true}) {
        const ShadowMap map = halfDark(opaque ? 0.0f : 0.5f, Translucent::sheets);
        const ShadowMap bare = released(map);
        const AreaLight& light = map.info().light;
        ShadowOptions options;
        CHECK(checkQuery(bare, light, options));
        for (const ShadowMethod method : {ShadowMethod::scalar, ShadowMethod::pcf}) {
            options.method = method;
            CHECK(checkQuery(map, light, options));
            const Status refused = checkQuery(bare, light, options);
            REQUIRE(!refused);
            CHECK(refused.error().code == ErrorCode::badArgument);
            CHECK(refused.error().message.find("released") != std::string::npos);
        }
        options = {};
        options.attenuation = Attenuation::subtract;
        CHECK(bool(checkQuery(bare, light, options)) == opaque);

        const auto bytes = encodeMap(bare);
        REQUIRE(!bytes);
        CHECK(bytes.error().code == ErrorCode::badArgument);
        CHECK(bytes.error().message.find("no layers") != std::string::npos);
        CHECK(!writeMap(bare, "released.mtsm"));

        CHECK(!identical(map, bare));
        CHECK(!identical(bare, bare));
        CHECK(identical(map, ShadowMap(map)));
        for (std::uint32_t level = 0; level < bare.levels(); ++level)
            CHECK(bare.zRange(0, level, 0, 0) == map.zRange(0));
        CHECK(bare.zRange(0) == map.zRange(0));
        CHECK(bare.pixel(0, 3, 5).count == 0);
    }
}

TEST_CASE("a map whose queries need its layers keeps them", "[shadow][bad-input]") {
    test::NoisySpec spec;
    spec.faces = 6;  // that look the same way
    ShadowMap odd = test::noisyMap(spec);
    const Status refused = releaseLayers(odd);
    REQUIRE(!refused);
    CHECK(refused.error().code == ErrorCode::unsupported);
    CHECK(odd.hasLayers());
    CHECK(identical(odd, test::noisyMap(spec)));

    spec = {};
    spec.emptyTiles = 1.0;
    ShadowMap empty = test::noisyMap(spec);
    REQUIRE(empty.layerCount() == 0);
    CHECK(releaseLayers(empty));
    CHECK(identical(empty, test::noisyMap(spec)));
}

TEST_CASE("a map without layers is queried by many threads, copies beside the original",
          "[shadow][threads]") {
    ShadowMap map = halfDark(0.5f, Translucent::sheets);
    const ShadowMap whole = map;
    const std::vector<glm::dvec3> points = acrossTheEdge();
    // The copy is asked, by the definition as well, while the original lets go.
    std::vector<float> found[4];
    std::thread beside([&] {
        found[0] = answers(whole, points);
        ShadowOptions scalar;
        scalar.method = ShadowMethod::scalar;
        found[1] = answers(whole, points, scalar);
    });
    CHECK(releaseLayers(map));
    std::thread other([&] { found[2] = answers(map, points); });
    found[3] = answers(map, points);
    beside.join();
    other.join();
    CHECK(sameBits(found[0], found[2]));
    CHECK(sameBits(found[0], found[3]));
    for (std::size_t i = 0; i < points.size(); ++i)
        CHECK(std::abs(found[0][i] - found[1][i]) < 0.1f);
}
