// bench_compress - layers and bytes per sample, and samples per second, against the
// tolerance; and what it buys that the visibility behind a layer may be off.
#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <stdexcept>
#include <string>

#include "bumpy_mesh.h"
#include "compress/compress_tile.h"
#include "compress/hidden.h"
#include "compress/pixels.h"
#include "compress/simplify.h"
#include "mtsm/bake.h"
#include "mtsm/compress.h"

namespace {

using namespace mtsm;
using test::Noise;
using test::Pixel;

constexpr double kNear = 10.0;         // depth of what casts
constexpr double kLength = 8 * 0.002;  // of a layer: 8 footprints, 1024 over 2 units
constexpr std::uint64_t kSamples = 60'000;

/// Hair in tufts: 300 strands of opacities up to 0.06 within one unit.
Pixel fur(Noise& noise) {
    Pixel pixel;
    for (int tuft = 0; tuft < 30; ++tuft) {
        const double z = noise.between(kNear, kNear + 1.0);
        for (int i = 0; i < 10; ++i)
            pixel.emplace_back(float(z + 0.03 * noise.unit()),
                               float(0.06 * noise.unit()));
    }
    return pixel;
}

/// Leaves whose edges let light through, within two units.
Pixel foliage(Noise& noise) {
    Pixel pixel;
    for (int i = 0; i < 12; ++i)
        pixel.emplace_back(float(noise.between(kNear, kNear + 2.0)),
                           noise.unit() < 0.5 ? 1.0f : float(noise.unit()));
    return pixel;
}

/// One sample per voxel of a cloud that fades out to both sides.
Pixel smoke(Noise& noise) {
    Pixel pixel;
    const double thick = noise.between(0.2, 2.0);
    for (int i = 0; i < 128; ++i) {
        const double x = (i + 0.5) / 128;
        pixel.emplace_back(float(kNear + x), float(thick / 128 * 6 * x * (1 - x) *
                                                   noise.between(0.7, 1.3)));
    }
    return pixel;
}

/// Tiles' worth of pixels, one behind the other.
struct Pixels {
    SampleList samples;
    std::vector<std::uint32_t> begin{0};
};

const Pixels& pixelsOf(std::int64_t kind) {
    static Pixels all[3];
    Pixels& p = all[kind];
    Noise noise(1);
    while (p.samples.size() < kSamples) {
        Pixel pixel = kind == 0 ? fur(noise) : kind == 1 ? foliage(noise) : smoke(noise);
        test::sortByDepth(pixel);
        for (const test::Sample& s : pixel) {
            p.samples.z.push_back(s.z);
            p.samples.opacity[0].push_back(s.opacity[0]);
        }
        p.begin.push_back(std::uint32_t(p.samples.size()));
    }
    return p;
}

void label(benchmark::State& state) {
    constexpr const char* kNames[] = {"fur", "foliage", "smoke"};
    state.SetLabel(kNames[state.range(0)] +
                   (" tolerance 1e-4 * " + std::to_string(state.range(1))));
}

/// Arguments: kind, tolerance / 1e-4, bounds (0: none, 1: depth 0.4 and length).
void compressTile(benchmark::State& state) {
    const Pixels& pixels = pixelsOf(state.range(0));
    CompressOptions options;
    options.tolerance = 1e-4f * float(state.range(1));
    if (state.range(2) == 0)
        options.opticalDepth = HUGE_VALF;
    else
        options.lengthBase = kLength;
    Tile tile;
    CompressReport report;
    for (auto _ : state) {
        report = {};
        tile = test::compressTile(options, pixels.begin, pixels.samples, report);
        benchmark::DoNotOptimize(tile);
    }
    const double samples = double(pixels.samples.size());
    state.counters["samples/s"] =
        benchmark::Counter(samples, benchmark::Counter::kIsIterationInvariantRate);
    state.counters["layers/sample"] = double(tile.z.size()) / samples;
    state.counters["bytes/sample"] =
        4.0 * double(tile.z.size() + tile.v.size() + tile.n.size()) / samples;
    state.counters["reached"] = report.toleranceReached;
    label(state);
}

/// Arguments: kind, tolerance / 1e-4, most drift / 1e-4, bound on optical depth.
void simplify(benchmark::State& state) {
    const Pixels& pixels = pixelsOf(state.range(0));
    const compress::Bounds bounds{state.range(3) ? 0.4 : HUGE_VAL, HUGE_VAL, 0.0};
    compress::Simplifier simplifier(1e-4 * double(state.range(1)),
                                    1e-4 * double(state.range(2)), bounds);
    compress::Visibility visibility;
    std::vector<compress::Span> spans;
    std::size_t layers = 0;
    for (auto _ : state) {
        layers = 0;
        for (std::size_t p = 0; p + 1 < pixels.begin.size(); ++p) {
            PixelSamples pixel;
            pixel.count = pixels.begin[p + 1] - pixels.begin[p];
            pixel.z = pixels.samples.z.data() + pixels.begin[p];
            pixel.opacity[0] = pixels.samples.opacity[0].data() + pixels.begin[p];
            CompressReport report;
            compress::accumulate(pixel, 1, kAllResets, visibility, report);
            simplifier.simplify(visibility, spans);
            layers += spans.size();
        }
    }
    state.counters["layers/sample"] = double(layers) / double(pixels.samples.size());
    label(state);
}

/// Arguments: samples, tolerance / 1e-4, cap on layers.
void onePixel(benchmark::State& state) {
    const Pixel pixel =
        test::randomPixel(1, std::uint32_t(state.range(0)), 10, 20, 0, 1e-5);
    const SampleList samples = test::planes(pixel, 1);
    CompressOptions options;
    options.tolerance = 1e-4f * float(state.range(1));
    options.layers = std::uint32_t(state.range(2));
    PixelCompressor compressor(options);
    LayerList layers;
    for (auto _ : state) {
        CompressReport report;
        layers.clear();
        compressor.compress(test::borrow(samples), layers, report);
    }
    state.counters["layers"] = double(layers.size());
}

/// Hairs that stop up to 0.4 of the light, at random depths, down to a cap; 0 for none.
/// Arguments: samples per pixel, cap on layers.
void capped(benchmark::State& state) {
    Pixels pixels;
    const auto perPixel = std::uint32_t(state.range(0));
    for (std::uint64_t seed = 1; pixels.samples.size() < 10 * kSamples; ++seed) {
        for (const test::Sample& s :
             test::randomPixel(seed, perPixel, kNear, kNear + 1.0, 0.0, 0.4)) {
            pixels.samples.z.push_back(s.z);
            pixels.samples.opacity[0].push_back(s.opacity[0]);
        }
        pixels.begin.push_back(std::uint32_t(pixels.samples.size()));
    }
    CompressOptions options;
    options.tolerance = 0.005f;
    options.layers = std::uint32_t(state.range(1));
    for (auto _ : state) {
        CompressReport report;
        Tile tile = test::compressTile(options, pixels.begin, pixels.samples, report);
        benchmark::DoNotOptimize(tile);
    }
    state.counters["samples/s"] = benchmark::Counter(
        double(pixels.samples.size()), benchmark::Counter::kIsIterationInvariantRate);
}

/// Argument: radius of the light, in percent of the body's; 1024 x 1024, one thread.
void dropHidden(benchmark::State& state) {
    const test::Mesh body = test::bumpyBody(350'000);
    CasterViews casters({body.view()});
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.position = {2, 5, 2.5};
    options.light.radius = 0.01 * double(state.range(0));
    options.layers = 16;
    const auto baked = bake(casters, options);
    if (!baked) throw std::runtime_error(baked.error().message);
    const ShadowMap& map = baked->map;
    MapFace whole;
    whole.projection = map.projection(0);
    for (std::uint32_t ty = 0; ty < map.tilesY(); ++ty) {
        for (std::uint32_t tx = 0; tx < map.tilesX(); ++tx)
            whole.tiles.push_back(map.tile(0, tx, ty));
    }
    tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    compress::Hidden hidden;
    for (auto _ : state) {
        state.PauseTiming();
        MapFace face = whole;
        state.ResumeTiming();
        hidden = compress::dropHidden(map.info(), face);
    }
    state.counters["layers"] = double(map.layerCount());
    state.counters["dropped"] = double(hidden.layers) / double(map.layerCount());
}

}  // namespace

BENCHMARK(dropHidden)->Arg(1)->Arg(10)->Arg(33)->Arg(100)->Unit(benchmark::kMillisecond);
BENCHMARK(compressTile)
    ->ArgNames({"kind", "tolerance", "bounds"})
    ->ArgsProduct({{0, 1, 2}, {0, 10, 100, 500}, {0, 1}})
    ->Unit(benchmark::kMillisecond);
BENCHMARK(simplify)
    ->ArgNames({"kind", "tolerance", "drift", "bounded"})
    ->ArgsProduct({{0, 2}, {10, 100, 500}, {0, 10, 100, 500, 10000}, {1}})
    ->Unit(benchmark::kMillisecond);
BENCHMARK(capped)
    ->ArgNames({"samples", "cap"})
    ->ArgsProduct({{20, 100, 440}, {0, 5}})
    ->Unit(benchmark::kMillisecond);
BENCHMARK(onePixel)
    ->ArgNames({"samples", "tolerance", "cap"})
    ->Args({1'000'000, 0, 0})
    ->Args({1'000'000, 1, 0})
    ->Args({1'000'000, 10, 0})
    ->Args({1'000'000, 100, 0})
    ->Args({1'000'000, 0, 5})
    ->Unit(benchmark::kMillisecond);
