// Rounding stays within its bounds and changes neither order nor what is dark.
#include "compress/rounding.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <random>

#include "map_fixture.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

/// A face of one tile whose layers are these, all in one pixel.
MapFace faceOf(std::vector<float> z, std::vector<float> v) {
    Tile t;
    t.begin = {0, std::uint32_t(z.size())};
    t.z = std::move(z);
    t.v = std::move(v);
    MapFace face;
    face.tiles.push_back(std::move(t));
    return face;
}

MapInfo infoWith(float bias, float biasPerDepth, float tolerance) {
    MapInfo info = plainInfo(1, 1, 8);
    info.bias = bias;
    info.biasPerDepth = biasPerDepth;
    info.toleranceAsked = tolerance;
    return info;
}

std::vector<float> sortedDepths(std::size_t count) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> exponent(-40.0, 40.0);
    std::vector<float> z;
    for (std::size_t i = 0; i < count; ++i)
        z.push_back(float(std::exp2(exponent(random))));
    std::sort(z.begin(), z.end());
    return z;
}

}  // namespace

TEST_CASE(
    "a depth is rounded by at most its share of the z threshold, and keeps its place",
    "[compress]") {
    const std::vector<float> z = sortedDepths(20'000);
    for (const auto& [bias, perDepth] :
         {std::pair(0.0f, 3e-4f), {0.02f, 0.0f}, {0.001f, 0.3f}, {1e-9f, 1e-6f}}) {
        for (const double share : {1.0 / 64, 1.0}) {
            MapFace face = faceOf(z, {});
            CHECK(compress::roundLayers(infoWith(bias, perDepth, 0.005f), share, face) ==
                  0.0f);
            const std::vector<float>& got = face.tiles[0].z;
            double worst = 0.0;
            std::size_t lostBits = 0;
            for (std::size_t i = 0; i < z.size(); ++i) {
                const double threshold = double(bias) + double(perDepth) * z[i];
                worst = std::max(worst,
                                 std::abs(double(got[i]) - z[i]) / (share * threshold));
                lostBits += got[i] != z[i];
            }
            INFO("bias " << bias << ", per depth " << perDepth << ", share " << share);
            CHECK(worst <= 1.0);
            CHECK(worst > 0.2);  // and what may be rounded is
            CHECK(lostBits > 0);
            CHECK(std::is_sorted(got.begin(), got.end()));
            CHECK(got.front() > 0.0f);
        }
    }
}

TEST_CASE("visibility is rounded by its share of the tolerance, relative to itself",
          "[compress]") {
    std::vector<float> v;
    for (float x = 1.0f; x > 1e-30f; x *= 0.9873f)
        v.push_back(x);
    v.push_back(1e-42f);  // what is not dark stays so
    v.push_back(0.0f);
    const std::vector<float> z(v.size(), 1.0f);
    MapFace face = faceOf(z, v);
    const float largest =
        compress::roundLayers(infoWith(0.0f, 0.0f, 0.005f), 1.0 / 64, face);
    const std::vector<float>& got = face.tiles[0].v;
    float change = 0.0f;
    double worst = 0.0;
    for (std::size_t i = 0; i + 1 < v.size(); ++i) {
        worst = std::max(worst, std::abs(double(got[i]) - v[i]) / v[i]);
        change = std::max(change, std::abs(got[i] - v[i]));
        CHECK(got[i] > 0.0f);
    }
    CHECK(largest == change);
    CHECK(worst <= 0.005 / 64);
    CHECK(worst > 0.2 * 0.005 / 64);
    CHECK(got.front() == 1.0f);
    CHECK(got.back() == 0.0f);
    CHECK(std::is_sorted(got.rbegin(), got.rend()));
}

TEST_CASE(
    "a share, a threshold or a tolerance of 0 keeps every bit, and nothing overflows",
    "[compress]") {
    const float most = std::numeric_limits<float>::max();
    const float least = std::numeric_limits<float>::denorm_min();
    const std::vector<float> z = {least, 1.0f / 3.0f, most};
    const std::vector<float> v = {2.0f / 3.0f, 1.0f / 3.0f, least};
    const auto same = [&](float bias, float tolerance, double share) {
        MapFace face = faceOf(z, v);
        const float change =
            compress::roundLayers(infoWith(bias, 0.0f, tolerance), share, face);
        return change == 0.0f && face.tiles[0].z == z && face.tiles[0].v == v;
    };
    CHECK(same(0.1f, 0.1f, 0.0));
    CHECK(same(0.0f, 0.0f, 1.0));
    CHECK_FALSE(same(0.0f, 0.1f, 1.0));

    MapFace face = faceOf(z, {});
    compress::roundLayers(infoWith(most, most, 0.0f), 1.0, face);
    CHECK(std::isfinite(face.tiles[0].z[2]));
    CHECK(face.tiles[0].z[0] > 0.0f);
}
