// bench_bake: triangles per second, by layers and threads. Scene: a bumpy ball of 346,800
// triangles that fills a window of 1024 x 1024 pixels, or of 16 times as many of the same
// size in one of 4096 x 4096; arguments: k, number of threads, pixels a side.
#include <benchmark/benchmark.h>
#include <tbb/task_arena.h>

#include <map>
#include <string>
#include <thread>

#include "bake/casters.h"
#include "mtsm/bake.h"
#include "raster/rasteriser.h"

using namespace mtsm;

namespace {

const test::Mesh& ball(std::int64_t side) {
    static std::map<std::int64_t, test::Mesh> balls;
    const auto [at, isNew] = balls.try_emplace(side);
    if (isNew) at->second = test::bumpyBall(int(170 * side / 1024));
    return at->second;
}

BakeOptions optionsFor(const benchmark::State& state) {
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.radius = 0.3;
    options.light.position = {2.0, 4.0, 3.0};
    options.layers = std::uint32_t(state.range(0));
    options.width = options.height = std::uint32_t(state.range(2));
    return options;
}

void report(benchmark::State& state) {
    const auto triangles = double(ball(state.range(2)).view().triangleCount);
    state.counters["triangles/s"] =
        benchmark::Counter(triangles, benchmark::Counter::kIsIterationInvariantRate);
}

/// Transform, set up, bin and draw into a fresh k-buffer: what the paper's table 3 times.
void rasterise(benchmark::State& state) {
    const BakeOptions options = optionsFor(state);
    test::Casters casters({ball(state.range(2))});
    const auto baked = bake(casters, options);
    if (!baked) return state.SkipWithError(baked.error().message.c_str());
    const Projection& projection = baked->map.projection(0);
    tbb::task_arena arena(int(state.range(1)));
    for (auto _ : state) {
        raster::MemoryBudget budget(options.maxBytes);
        raster::KBuffer buffer(options.width, options.height, *options.layers, budget);
        arena.execute([&] {
            raster::Rasteriser rasteriser(projection, raster::Facing::any, buffer);
            if (!rasteriser.add(ball(state.range(2)).view()) || !rasteriser.finish())
                state.SkipWithError("the rasteriser was stopped");
        });
        benchmark::DoNotOptimize(buffer.tiles().data());
    }
    state.counters["samples"] = double(baked->map.info().samples);
    report(state);
}

/// All of bake(): bounds, push-back, window, rasterising, layers and hierarchy.
void wholeBake(benchmark::State& state) {
    const BakeOptions options = optionsFor(state);
    test::Casters casters({ball(state.range(2))});
    tbb::task_arena arena(int(state.range(1)));
    for (auto _ : state) {
        arena.execute([&] {
            const auto baked = bake(casters, options);
            if (!baked) state.SkipWithError(baked.error().message.c_str());
        });
    }
    report(state);
}

void layersAndThreads(benchmark::internal::Benchmark* bench) {
    const auto all = std::int64_t(std::max(1u, std::thread::hardware_concurrency()));
    for (const std::int64_t threads : {std::int64_t(1), all}) {
        for (const std::int64_t side : {1024, 4096}) {
            for (const std::int64_t layers : {1, 5, 16})
                bench->Args({layers, threads, side});
        }
        if (all == 1) break;
    }
    bench->ArgNames({"k", "threads", "side"})
        ->UseRealTime()
        ->Unit(benchmark::kMillisecond);
}

BENCHMARK(rasterise)->Apply(layersAndThreads);
BENCHMARK(wholeBake)->Apply(layersAndThreads);

}  // namespace
