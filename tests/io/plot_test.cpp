// Pictures of a map: every pixel against its layers, and the plot's marks counted.
#include <catch2/catch.hpp>
#include <cmath>

#include "io/temp_folder.h"
#include "map_fixture.h"
#include "mtsm/plot.h"

using namespace mtsm;

namespace {

std::size_t countOf(const std::string& text, const std::string& what) {
    std::size_t count = 0;
    for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; ++at)
        ++count;
    return count;
}

ShadowMap onePixelMap(std::vector<float> z, std::vector<float> v) {
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    Tile& t = faces[0].tiles[0];
    t.begin.assign(65, std::uint32_t(z.size()));
    t.begin[0] = 0;
    t.z = std::move(z);
    t.v = std::move(v);
    auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

}  // namespace

TEST_CASE("an image of a map shows each pixel's layers", "[io][plot]") {
    const bool opaque = GENERATE(false, true);
    const std::uint32_t channels = GENERATE(1u, 3u);
    const ShadowMap map = test::noisyMap({.width = 37,
                                          .height = 21,
                                          .tileSize = 8,
                                          .faces = 6,
                                          .channels = channels,
                                          .opaque = opaque,
                                          .seed = 11});
    for (std::uint32_t face : {0u, 5u}) {
        const auto values = [&](MapChannel c) {
            FloatImage image = mapImage(map, face, c);
            const bool colored = channels == 3 && c == MapChannel::visibility;
            REQUIRE(image.channels.size() == (colored ? 4 : 1));
            CHECK(image.channels[0].name == name(c));
            REQUIRE(image.channels[0].values.size() == 37 * 21);
            return image.channels[0].values;
        };
        const auto layers = values(MapChannel::layers), zmin = values(MapChannel::zmin),
                   zmax = values(MapChannel::zmax), left = values(MapChannel::visibility),
                   count = values(MapChannel::count);
        const FloatImage colors = mapImage(map, face, MapChannel::visibility);
        std::size_t i = 0;
        for (std::uint32_t y = 0; y < 21; ++y) {
            for (std::uint32_t x = 0; x < 37; ++x, ++i) {
                const PixelLayers p = map.pixel(face, x, y);
                REQUIRE(layers[i] == float(p.count));
                // What is left: each channel on its own, dark for good once it reached
                // zero.
                std::vector<double> v(channels, 1.0);
                double samples = 0, near = INFINITY, far = -INFINITY;
                for (std::uint32_t k = 0; k < p.count; ++k) {
                    for (std::uint32_t c = 0; c < channels; ++c)
                        v[c] = v[c] == 0 || !p.v ? 0.0 : double(p.v[c * p.vStride + k]);
                    samples += p.n ? p.n[k] : 1;
                    near = std::min(near, double(p.z[k]));
                    far = std::max(far, double(p.z[k]));
                }
                double mean = 0;
                for (double value : v)
                    mean += value / channels;
                REQUIRE(left[i] == Approx(mean).margin(1e-6));
                for (std::size_t c = 0; channels == 3 && c < 3; ++c)
                    REQUIRE(double(colors.channels[1 + c].values[i]) == v[c]);
                REQUIRE(count[i] == Approx(samples));
                REQUIRE(double(zmin[i]) == near);
                REQUIRE(double(zmax[i]) == far);
            }
        }
    }
}

TEST_CASE("a plot has a dot per layer, a dash per reset and a step where a layer is",
          "[io][plot]") {
    const ShadowMap map = onePixelMap({1, 2, 3}, {0.5f, 0.0f, 0.75f});
    const std::string svg = visibilityPlot(map, 0, 0, 0);
    CHECK(svg.find("<svg xmlns=") == 0);
    CHECK(countOf(svg, "<circle") == 3);
    CHECK(countOf(svg, "stroke-dasharray") == 1);
    CHECK(svg.find("3 layers, 1 reset<") != std::string::npos);
    CHECK(svg.find("z 2, v 0, n 1<") != std::string::npos);
    // The axis runs from 0.9 to 3.1 over x = 80..930, visibility from y = 400 up to 60.
    const std::string steps =
        "M80 60 H118.6364 V230 H505 V400 M505 60 H891.3636 V145 H930";
    CHECK(svg.find(steps) != std::string::npos);
}

TEST_CASE("a plot of an empty pixel, of one depth and of three channels is sound",
          "[io][plot]") {
    const ShadowMap flat = onePixelMap({5, 5}, {0.5f, 0.25f});
    const std::string empty = visibilityPlot(flat, 0, 7, 7);
    CHECK(empty.find("0 layers") != std::string::npos);
    CHECK(countOf(empty, "<circle") == 0);
    const std::string same = visibilityPlot(flat, 0, 0, 0);
    CHECK(countOf(same, "<circle") == 2);
    const ShadowMap colour =
        test::noisyMap({.width = 8, .height = 8, .channels = 3, .emptyTiles = 0});
    const std::string three = visibilityPlot(colour, 0, 3, 4);
    CHECK(countOf(three, "<path") == 3);
    CHECK(countOf(three, "<circle") == 3 * colour.pixel(0, 3, 4).count);
    for (const std::string& svg : {empty, same, three}) {
        CHECK(svg.find("nan") == std::string::npos);
        CHECK(svg.find("inf") == std::string::npos);
        CHECK(svg.substr(svg.size() - 7) == "</svg>\n");
    }
}

TEST_CASE("text files come out as they went in", "[io][plot]") {
    test::TempFolder folder;
    REQUIRE(writeTextFile(folder / "a.svg", "<svg>\n"));
    CHECK(test::contents(folder / "a.svg") == "<svg>\n");
    CHECK_FALSE(writeTextFile(folder / "none/a.svg", ""));
}
