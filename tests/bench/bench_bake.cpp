// bench_bake: triangles per second, by layers and threads. Scene: a bumpy ball of 346,800
// triangles that fills a window of 1024 x 1024 pixels; argument 1 is k, argument 2 the
// number of threads.
#include <benchmark/benchmark.h>
#include <tbb/task_arena.h>

#include <string>
#include <thread>

#include "bake/casters.h"
#include "mtsm/bake.h"
#include "raster/rasteriser.h"

using namespace mtsm;

namespace {

const test::Mesh& ball() {
    static const test::Mesh mesh = test::bumpyBall(170);
    return mesh;
}

BakeOptions optionsFor(const benchmark::State& state) {
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.radius = 0.3;
    options.light.position = {2.0, 4.0, 3.0};
    options.layers = std::uint32_t(state.range(0));
    return options;
}

void report(benchmark::State& state) {
    const auto triangles = double(ball().view().triangleCount);
    state.counters["triangles/s"] =
        benchmark::Counter(triangles, benchmark::Counter::kIsIterationInvariantRate);
}

/// Transform, set up, bin and draw into a fresh k-buffer: what the paper's table 3 times.
void rasterise(benchmark::State& state) {
    const BakeOptions options = optionsFor(state);
    test::Casters casters({ball()});
    const auto baked = bake(casters, options);
    if (!baked) return state.SkipWithError(baked.error().message.c_str());
    const Projection& projection = baked->map.projection(0);
    tbb::task_arena arena(int(state.range(1)));
    for (auto _ : state) {
        raster::MemoryBudget budget(options.maxBytes);
        raster::KBuffer buffer(options.width, options.height, *options.layers, budget);
        arena.execute([&] {
            raster::Rasteriser rasteriser(projection, raster::Facing::any, buffer);
            if (!rasteriser.add(ball().view()) || !rasteriser.finish())
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
    test::Casters casters({ball()});
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
        for (const std::int64_t layers : {1, 5, 16})
            bench->Args({layers, threads});
        if (all == 1) break;
    }
    bench->ArgNames({"k", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
}

BENCHMARK(rasterise)->Apply(layersAndThreads);
BENCHMARK(wholeBake)->Apply(layersAndThreads);

}  // namespace
