// bench_texture - lookups per second in an opacity texture, against the footprint.
//
// A bake looks up once per sample of a textured surface. Expected: two bilinear lookups
// where a footprint is square, up to sixteen where it is long.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mtsm/opacity_texture.h"

namespace {

using namespace mtsm;

constexpr std::uint32_t kSize = 1024;

/// Blobs of a few dozen texels with soft edges.
OpacityTexture blobs(float cutoff) {
    OpacityImage image;
    image.width = image.height = kSize;
    image.cutoff = cutoff;
    for (std::uint32_t y = 0; y < kSize; ++y)
        for (std::uint32_t x = 0; x < kSize; ++x)
            image.texels.push_back(float(std::clamp(
                0.5 + 4 * std::sin(0.1 * x) * std::cos(0.13 * y + 0.02 * x), 0.0, 1.0)));
    auto texture = OpacityTexture::create(std::move(image));
    if (!texture) throw std::runtime_error(texture.error().message);
    return std::move(*texture);
}

/// range(0): texels along the short side, in tenths; range(1): how many times as long the
/// long side is; range(2): a mask.
void lookUp(benchmark::State& state) {
    const OpacityTexture texture = blobs(state.range(2) ? 0.5f : -1.0f);
    const double minor = 0.1 * double(state.range(0)) / kSize;
    const glm::dvec2 du(minor * double(state.range(1)), 0.1 * minor), dv(0, minor);
    double u = 0, v = 0;
    for (auto unused : state) {
        float opacity = 0;
        texture.opacity({u, v}, du, dv, &opacity);
        benchmark::DoNotOptimize(opacity);
        u += 0.00137;
        v += 0.00000047;
    }
}

BENCHMARK(lookUp)
    ->ArgNames({"tenths", "stretch", "mask"})
    ->ArgsProduct({{3, 20, 200}, {1, 8}, {0, 1}});

}  // namespace
