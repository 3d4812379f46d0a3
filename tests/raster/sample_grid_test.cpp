// The sample grid: what subsamples become, and what happens when memory runs out.
#include "raster/sample_grid.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "bake/casters.h"
#include "raster/grid_content.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::content;
using mtsm::test::Random;
using Samples = std::vector<std::pair<float, float>>;

namespace {

constexpr std::uint64_t kEnough = 1ull << 30;

/// One pixel with 2 x 2 subsamples; surfaces up to 0.5 apart in depth are one.
struct OnePixel {
    SampleGrid grid = make();

    static SampleGrid make() {
        SampleGrid::Shape shape;
        shape.width = shape.height = 1;
        shape.subsamples = 2;
        shape.merge.base = 0.5;
        return {shape, 0, 1, kEnough};
    }

    void add(float z, float opacity, std::uint8_t subsample) {
        grid.tile(0, 0).add(0, z, &opacity, subsample);
    }
    Samples samples() { return content(grid)[0].samples; }
};

}  // namespace

TEST_CASE("a surface that all subsamples meet is one sample of its opacity",
          "[raster][exact]") {
    OnePixel pixel;
    for (const int i : {2, 0, 3, 1})
        pixel.add(1.0f + 0.1f * float(i), 1.0f, std::uint8_t(i));
    const Samples s = pixel.samples();
    REQUIRE(s.size() == 1);
    CHECK(s[0].first == Approx(1.15f));
    CHECK(s[0].second == 1.0f);
}

TEST_CASE("a surface that some subsamples meet stops their share", "[raster][exact]") {
    OnePixel pixel;
    pixel.add(1.0f, 0.5f, 0);
    pixel.add(1.1f, 1.0f, 3);
    const Samples s = pixel.samples();
    REQUIRE(s.size() == 1);
    CHECK(s[0].first == Approx((0.5 * 1.0 + 1.0 * 1.1) / 1.5));
    CHECK(s[0].second == 0.375f);
}

TEST_CASE("surfaces apart in depth, or hit twice by one subsample, stay two",
          "[raster][exact]") {
    OnePixel apart;
    for (std::uint8_t i = 0; i < 4; ++i)
        apart.add(i < 2 ? 1.0f : 1.6f, 1.0f, i);
    // The second stops all that the first has left.
    CHECK(apart.samples() == Samples{{1.0f, 0.5f}, {1.6f, 1.0f}});

    OnePixel twice;  // two parallel sheets, tilted, that interleave in depth
    for (std::uint8_t i = 0; i < 4; ++i) {
        twice.add(1.0f + 0.1f * float(i), 1.0f, i);
        twice.add(1.05f + 0.1f * float(i), 0.25f, i);
    }
    const Samples s = twice.samples();
    REQUIRE(s.size() == 2);
    CHECK(s[0].second == 1.0f);
    CHECK(s[0].first == Approx(1.15));
    CHECK(s[1].second == 0.25f);
    CHECK(s[1].first == Approx(1.2));
}

TEST_CASE("samples of the whole pixel pass by the merge", "[raster]") {
    OnePixel pixel;
    pixel.add(1.1f, 0.125f, SampleTile::kWholePixel);
    for (std::uint8_t i = 0; i < 4; ++i)
        pixel.add(1.0f, 1.0f, i);
    pixel.add(1.1f, 0.125f, SampleTile::kWholePixel);
    CHECK(pixel.samples() == Samples{{1.0f, 1.0f}, {1.1f, 0.125f}, {1.1f, 0.125f}});
}

TEST_CASE("the product over a pixel's samples is the mean over its subsamples",
          "[raster][exact]") {
    for (std::uint64_t seed = 0; seed < 200; ++seed) {
        Random random(seed);
        OnePixel pixel;
        double left[4] = {1, 1, 1, 1};
        const std::size_t count = 1 + random.below(30);
        for (std::size_t i = 0; i < count; ++i) {
            // Not opaque: a subsample that is dark starts again with the pixel.
            const auto opacity = float(random.in(0.01, 0.9));
            const std::size_t ray = random.below(4);
            pixel.add(float(random.in(1.0, 4.0)), opacity, std::uint8_t(ray));
            left[ray] *= 1.0 - double(opacity);
        }
        double product = 1.0;
        float before = 0.0f;
        for (const auto& [z, opacity] : pixel.samples()) {
            product *= 1.0 - double(opacity);
            CHECK(z >= before);
            before = z;
        }
        CHECK(product ==
              Approx((left[0] + left[1] + left[2] + left[3]) / 4).epsilon(1e-5));
    }
}

TEST_CASE("a wall too steep to be one surface still lets nothing through",
          "[raster][exact]") {
    OnePixel pixel;
    for (std::uint8_t i = 0; i < 4; ++i)
        pixel.add(1.0f + 2.0f * float(i), 1.0f, i);
    double product = 1.0;
    for (const auto& [z, opacity] : pixel.samples())
        product *= 1.0 - double(opacity);
    CHECK(product == 0.0);
}

TEST_CASE("a hundred thousand sheets within reach are merged in good time", "[raster]") {
    OnePixel pixel;
    for (int k = 0; k < 100'000; ++k)
        pixel.add(1.0f, 1e-6f, std::uint8_t(k % 4));
    CHECK(pixel.samples().size() == 25'000);
}

TEST_CASE("when memory runs short the lower rows are given up, the upper ones whole",
          "[raster]") {
    const std::uint32_t side = 512;
    SampleGrid grid({side, side, 1, 1, {}}, 0, 8, 2u << 20);
    const float opacity = 0.5f;
    std::uint32_t layer = 0;
    for (; grid.endRow() == 8; ++layer) {
        for (std::uint32_t ty = 0; ty < 8; ++ty) {
            for (std::uint32_t p = 0; p < 64 * 64; ++p)
                grid.tile(0, ty).add(p, 1.0f + float(layer), &opacity);
        }
        grid.settle();
        REQUIRE(layer < 100);
    }
    CHECK(grid.endRow() == 4);
    CHECK_FALSE(grid.overrun());
    CHECK_FALSE(grid.wants(4));
    const auto pixels = content(grid);
    REQUIRE(pixels.size() == side * 256);
    for (std::uint32_t y = 0; y < 256; ++y)
        REQUIRE(pixels[y * side].samples.size() == layer);

    // One row that does not fit has no way out but the error.
    while (!grid.overrun()) {
        for (std::uint32_t p = 0; p < 64 * 64; ++p)
            grid.tile(0, 0).add(p, 1.0f, &opacity);
    }
    CHECK(grid.endRow() >= 1);
}
