// OpacityTexture against closed forms, and against brute force in double.
#include "mtsm/opacity_texture.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <random>
#include <vector>

using namespace mtsm;

namespace {

OpacityImage imageOf(std::uint32_t width, std::uint32_t height,
                     const std::function<double(std::uint32_t, std::uint32_t)>& texel) {
    OpacityImage image;
    image.width = width;
    image.height = height;
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x)
            image.texels.push_back(float(texel(x, y)));
    return image;
}

OpacityImage noise(std::uint32_t width, std::uint32_t height) {
    std::mt19937 random(3);
    return imageOf(width, height,
                   [&](auto, auto) { return double(random() % 256) / 255; });
}

OpacityTexture made(const OpacityImage& image) {
    auto texture = OpacityTexture::create(image);
    REQUIRE(texture);
    return std::move(*texture);
}

float at(const OpacityTexture& texture, glm::dvec2 uv, glm::dvec2 du = {},
         glm::dvec2 dv = {}) {
    float out = -1;
    texture.opacity(uv, du, dv, &out);
    return out;
}

/// Mean of the texels, taken as squares, over a parallelogram: n x n midpoints.
double meanOver(const OpacityImage& image, glm::dvec2 uv, glm::dvec2 du, glm::dvec2 dv,
                int n) {
    double sum = 0;
    for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
            const glm::dvec2 p =
                uv + du * ((i + 0.5) / n - 0.5) + dv * ((j + 0.5) / n - 0.5);
            const auto index = [](double u, std::uint32_t size) {
                return std::min(std::size_t((u - std::floor(u)) * size),
                                std::size_t(size - 1));
            };
            const double t =
                double(image.texels[index(1 - p.y, image.height) * image.width +
                                    index(p.x, image.width)]);
            sum += image.cutoff < 0 ? t : double(t >= double(image.cutoff));
        }
    return sum / (double(n) * n);
}

/// A leaf-like blob: an ellipse with a soft edge, holes and a stem.
OpacityImage leaf(std::uint32_t size) {
    return imageOf(size, size, [&](std::uint32_t x, std::uint32_t y) {
        const double u = 2.0 * (x + 0.5) / size - 1, v = 2.0 * (y + 0.5) / size - 1;
        const double edge = 1 - u * u * 3 - v * v * (1.1 + 0.4 * std::sin(9 * u));
        const double vein = std::abs(std::sin(17 * v + 5 * std::abs(u)));
        return std::clamp(size * 0.1 * edge, 0.0, 1.0) * (vein < 0.15 ? 0.0 : 1.0);
    });
}

}  // namespace

TEST_CASE("the centre of a texel is the texel, the upper row first and v up",
          "[scene][texture][exact]") {
    const OpacityTexture texture =
        made(imageOf(3, 2, [](auto x, auto y) { return (x + 3 * y) / 8.0; }));
    for (std::uint32_t y = 0; y < 2; ++y)
        for (std::uint32_t x = 0; x < 3; ++x)
            CHECK(at(texture, {(x + 0.5) / 3, 1 - (y + 0.5) / 2}) ==
                  Approx((x + 3 * y) / 8.0).margin(1e-6));
    CHECK(texture.channels() == 1);
    CHECK(texture.translucent());
}

TEST_CASE("between four texels a magnified texture is bilinear",
          "[scene][texture][exact]") {
    OpacityImage image = imageOf(2, 2, [](auto x, auto y) { return x == 1 && y == 0; });
    image.wrapU = image.wrapV = TextureWrap::clamp;
    const OpacityTexture texture = made(image);
    for (const double s : {0.0, 0.25, 0.5, 0.9})
        for (const double t : {0.0, 0.3, 1.0})
            CHECK(at(texture, {0.25 + 0.5 * s, 0.25 + 0.5 * t}) ==
                  Approx(s * t).margin(1e-6));
}

TEST_CASE("a footprint as large as the texture sees its exact mean, odd sizes too",
          "[scene][texture][exact]") {
    for (const auto& [w, h] : std::vector<std::pair<std::uint32_t, std::uint32_t>>{
             {1, 1}, {2, 2}, {3, 3}, {5, 7}, {64, 64}, {100, 37}, {1, 19}, {255, 16}}) {
        OpacityImage image = noise(w, h);
        for (const float cutoff : {-1.0f, 0.5f}) {
            image.cutoff = cutoff;
            double sum = 0;
            for (const float t : image.texels)
                sum += cutoff < 0 ? double(t) : double(t >= cutoff);
            const double mean = sum / double(image.texels.size());
            const OpacityTexture texture = made(image);
            INFO(w << " x " << h << ", cutoff " << cutoff);
            for (const glm::dvec2 uv : {glm::dvec2(0.5), glm::dvec2(0.1, 0.83)}) {
                CHECK(at(texture, uv, {1, 0}, {0, 1}) == Approx(mean).epsilon(1e-6));
                CHECK(at(texture, uv, {3, 2}, {-2, 3}) == Approx(mean).epsilon(1e-6));
            }
        }
    }
}

TEST_CASE("footprints that tile a texture add up to its mean",
          "[scene][texture][statistical]") {
    OpacityImage image = leaf(128);
    for (const float cutoff : {-1.0f, 0.5f}) {
        image.cutoff = cutoff;
        const OpacityTexture texture = made(image);
        const double mean = meanOver(image, {0.5, 0.5}, {1, 0}, {0, 1}, 512);
        for (const int n : {5, 16, 40, 100, 300}) {
            double sum = 0;
            for (int j = 0; j < n; ++j)
                for (int i = 0; i < n; ++i)
                    sum += double(at(texture, {(i + 0.5) / n, (j + 0.5) / n},
                                     {1.0 / n, 0}, {0, 1.0 / n}));
            INFO(n << " lookups, cutoff " << cutoff);
            // Lookups weigh the texels of their level unevenly, which evens out over
            // many; and edges of a magnified mask run between texel centres, not along
            // texels.
            CHECK(sum / (double(n) * n) == Approx(mean).margin(n < 10    ? 0.03
                                                               : n < 128 ? 0.012
                                                                         : 0.003));
        }
    }
}

TEST_CASE("a lookup is close to the mean over its footprint, stretched ones too",
          "[scene][texture][twin]") {
    const OpacityImage image = leaf(256);
    const OpacityTexture texture = made(image);
    std::mt19937 random(11);
    std::uniform_real_distribution<double> unit(0, 1);
    for (const double stretch : {1.0, 3.0, 8.0}) {
        double squares = 0;
        constexpr int kLookups = 300;
        for (int i = 0; i < kLookups; ++i) {
            const double turn = 6.283185307 * unit(random), w = 4.0 / image.width;
            const glm::dvec2 along(std::cos(turn), std::sin(turn)),
                uv(unit(random), unit(random));
            const glm::dvec2 du = along * (w * stretch);
            const glm::dvec2 dv = glm::dvec2(-along.y, along.x) * w;
            const double error =
                double(at(texture, uv, du, dv)) - meanOver(image, uv, du, dv, 64);
            squares += error * error;
        }
        INFO("stretched " << stretch);
        // Veins are about as wide as a footprint, so a little blur counts for much.
        CHECK(std::sqrt(squares / kLookups) < 0.05);
    }
}

TEST_CASE("the sides of a footprint may be any that span it", "[scene][texture][exact]") {
    const OpacityTexture texture = made(leaf(64));
    const glm::dvec2 uv(0.4, 0.3), a(0.1, 0.02), b(-0.03, 0.05);
    const float once = at(texture, uv, a, b);
    CHECK(at(texture, uv, b, a) == Approx(once).margin(1e-6));
    CHECK(at(texture, uv, -a, b) == Approx(once).margin(1e-6));
}

TEST_CASE("outside of [0, 1] a texture repeats, ends or is mirrored",
          "[scene][texture][exact]") {
    OpacityImage image = imageOf(4, 4, [](auto x, auto y) { return (x + 4 * y) / 15.0; });
    const auto seen = [&](TextureWrap wrap, glm::dvec2 uv) {
        image.wrapU = image.wrapV = wrap;
        return at(made(image), uv);
    };
    const glm::dvec2 in(0.3, 0.8);
    for (const TextureWrap wrap :
         {TextureWrap::repeat, TextureWrap::clamp, TextureWrap::mirror}) {
        CHECK(seen(wrap, in) == Approx(seen(TextureWrap::repeat, in)));
        CHECK(seen(wrap, {0.5, 0.5}) == Approx(0.5));
    }
    CHECK(seen(TextureWrap::repeat, {7.3, -2.2}) ==
          Approx(seen(TextureWrap::repeat, in)).margin(1e-5));
    CHECK(seen(TextureWrap::mirror, {-0.3, 1.2}) ==
          Approx(seen(TextureWrap::mirror, in)).margin(1e-5));
    CHECK(seen(TextureWrap::clamp, {-3, 9}) == 0.0f);  // the upper left texel
    CHECK(seen(TextureWrap::clamp, {3, -9}) == 1.0f);
    CHECK(seen(TextureWrap::repeat, {0, 0.625}) ==
          Approx((4 + 7) / 2.0 / 15).margin(1e-6));  // between the row's two ends
    // Far away there is still an answer.
    for (const double far : {1e6, 1e12, 1e300, -1e300}) {
        const float x = seen(TextureWrap::repeat, {far, far});
        CHECK(x >= 0.0f);
        CHECK(x <= 1.0f);
    }
}

TEST_CASE("a magnified mask is yes or no by the interpolated alpha",
          "[scene][texture][exact]") {
    OpacityImage image = imageOf(2, 1, [](auto x, auto) { return double(x); });
    image.wrapU = image.wrapV = TextureWrap::clamp;
    image.cutoff = 0.25f;
    const OpacityTexture texture = made(image);
    // Alpha rises from 0 at u = 1/4 to 1 at u = 3/4, so the edge is at u = 3/8.
    const glm::dvec2 du(0.1, 0), dv(0, 0.1);
    CHECK(at(texture, {0.37, 0.5}, du, dv) == 0.0f);
    CHECK(at(texture, {0.38, 0.5}, du, dv) == 1.0f);
    for (double u = 0; u < 1; u += 0.01) {
        const float x = at(texture, {u, 0.5}, du, dv);
        CHECK((x == 0.0f || x == 1.0f));
    }
    CHECK(texture.translucent());
}

TEST_CASE("what equals the cutoff is there", "[scene][texture][exact]") {
    OpacityImage image = imageOf(2, 2, [](auto, auto) { return 0.5; });
    image.cutoff = 0.5f;
    CHECK(at(made(image), {0.3, 0.3}) == 1.0f);
    CHECK(!made(image).translucent());
    image.cutoff = 0.51f;
    CHECK(at(made(image), {0.3, 0.3}) == 0.0f);
    image.cutoff = 0.0f;
    image.texels = {0, 0, 0, 0};
    CHECK(at(made(image), {0.3, 0.3}) == 1.0f);
}

TEST_CASE("an image's opacity multiplies what its texels say",
          "[scene][texture][exact]") {
    OpacityImage image = imageOf(2, 1, [](auto x, auto) { return double(x); });
    image.opacity = 0.5f;
    CHECK(at(made(image), {0.75, 0.5}) == 0.5f);
    CHECK(at(made(image), {0.5, 0.5}, {1, 0}, {0, 1}) == 0.25f);
    image.cutoff = 0.5f;
    CHECK(at(made(image), {0.75, 0.5}) == 0.5f);
    CHECK(at(made(image), {0.25, 0.5}) == 0.0f);
    image.texels = {1, 1};
    CHECK(made(image).translucent());
}

TEST_CASE("three channels are looked up each for itself", "[scene][texture][exact]") {
    const OpacityImage grey[] = {noise(9, 6), leaf(9), noise(9, 9)};
    OpacityImage image;
    image.width = image.height = 9;
    image.channels = 3;
    std::vector<OpacityTexture> alone;
    OpacityImage parts[3];
    for (int c = 0; c < 3; ++c) {
        parts[c] = imageOf(9, 9, [&](auto x, auto y) {
            return double(grey[c].texels[(x + 9 * y) % grey[c].texels.size()]);
        });
        alone.push_back(made(parts[c]));
    }
    for (std::size_t i = 0; i < 81; ++i)
        for (const OpacityImage& part : parts)
            image.texels.push_back(part.texels[i]);
    const OpacityTexture texture = made(image);
    for (const double size : {0.01, 0.3, 0.6, 2.0}) {
        float out[3];
        texture.opacity({0.3, 0.6}, {size, 0.1}, {0, size}, out);
        for (std::size_t c = 0; c < 3; ++c)
            CHECK(out[c] == at(alone[c], {0.3, 0.6}, {size, 0.1}, {0, size}));
    }
}

TEST_CASE("a lookup that is not finite has an answer", "[scene][texture][bad-input]") {
    const OpacityImage image = leaf(32);
    const OpacityTexture texture = made(image);
    const double inf = std::numeric_limits<double>::infinity(), nan = std::nan("");
    const double mean = meanOver(image, {0.5, 0.5}, {1, 0}, {0, 1}, 32);
    for (const double bad : {inf, -inf, nan}) {
        CHECK(at(texture, {bad, 0}) == 1.0f);
        CHECK(at(texture, {0, bad}) == 1.0f);
        CHECK(at(texture, {0, 0}, {bad, 0}, {0, 1}) == Approx(mean).epsilon(1e-5));
        CHECK(at(texture, {0, 0}, {0, 1}, {1e-9, bad}) == Approx(mean).epsilon(1e-5));
    }
    CHECK(at(texture, {0, 0}, {1e200, 0}, {0, 1e200}) == Approx(mean).epsilon(1e-5));
    CHECK(at(texture, {0.5, 0.5}, {1e-300, 0}, {0, 0}) == at(texture, {0.5, 0.5}));
}

TEST_CASE("an image that cannot be is refused", "[scene][texture][bad-input]") {
    const auto refused = [](const std::function<void(OpacityImage&)>& spoil) {
        OpacityImage image = imageOf(2, 2, [](auto, auto) { return 0.5; });
        spoil(image);
        const auto texture = OpacityTexture::create(image);
        return !texture && texture.error().code == ErrorCode::badArgument;
    };
    const float nan = std::nanf("");
    CHECK(!refused([](OpacityImage&) {}));
    CHECK(refused([](OpacityImage& i) { i.width = 0; }));
    CHECK(refused([](OpacityImage& i) { i.width = 16385; }));
    CHECK(refused([](OpacityImage& i) { i.height = 0xffffffff; }));
    CHECK(refused([](OpacityImage& i) { i.channels = 2; }));
    CHECK(refused([](OpacityImage& i) { i.channels = 3; }));
    CHECK(refused([](OpacityImage& i) { i.texels.pop_back(); }));
    CHECK(refused([](OpacityImage& i) { i.texels[3] = 1.1f; }));
    CHECK(refused([](OpacityImage& i) { i.texels[0] = -0.1f; }));
    CHECK(refused([&](OpacityImage& i) { i.texels[2] = nan; }));
    CHECK(refused([&](OpacityImage& i) { i.cutoff = nan; }));
    CHECK(refused([&](OpacityImage& i) { i.opacity = nan; }));
    CHECK(refused([](OpacityImage& i) { i.opacity = 2; }));
}

TEST_CASE("the memory of a texture is that of its levels", "[scene][texture][exact]") {
    OpacityImage image = noise(8, 8);
    CHECK(made(image).memoryBytes() == 4 * (64 + 16 + 4 + 1));
    image.cutoff = 0.5f;  // and the alpha before the cutoff
    CHECK(made(image).memoryBytes() == 4 * (64 + 64 + 16 + 4 + 1));
}
