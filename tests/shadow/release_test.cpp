// Maps that let go of their layers: what needs layers says so, nothing that is asked all
// the same does harm, and copies are maps of their own.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <thread>
#include <vector>

#include "mtsm/shadow.h"
#include "mtsm/writer.h"
#include "random.h"
#include "shadow/released.h"

using namespace mtsm;
using test::acrossTheEdge, test::halfDark, test::Random, test::released, test::sameBits;

namespace {

std::vector<float> answers(const ShadowMap& map, const std::vector<glm::dvec3>& points,
                           const ShadowOptions& options = {}) {
    std::vector<float> out(points.size());
    shadowFactors(map, map.info().light, points.data(), nullptr, points.size(),
                  out.data(), options);
    return out;
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
    const std::vector<glm::dvec3> points = acrossTheEdge(600);
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
