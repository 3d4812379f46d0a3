// bench_trace - scalar rays per second against light radius and resolution.
//
// [Xie07, sec. 4.3] expects the cost of a ray to grow as the logarithm of both: a ray's
// length in pixels is proportional to light radius times resolution, and the quadtree
// walks it in log time.
#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <map>
#include <memory>
#include <random>

#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "mtsm/shadow.h"

namespace {

using namespace mtsm;

constexpr double kLargestRadius = 1.0;  // the body has radius 1 and is 6 away

/// Maps of one body for a light of the largest radius, by resolution.
const ShadowMap& bakedMap(std::uint32_t resolution) {
    static std::map<std::uint32_t, std::unique_ptr<ShadowMap>> maps;
    auto& map = maps[resolution];
    if (!map) {
        const test::Mesh body = test::bumpyBody(350'000);
        CasterViews casters({body.view()});
        BakeOptions options;
        options.light.shape = LightShape::disk;
        options.light.position = {2, 5, 2.5};
        options.light.radius = kLargestRadius;
        options.width = options.height = resolution;
        auto baked = bake(casters, options);
        if (!baked) throw std::runtime_error(baked.error().message);
        map = std::make_unique<ShadowMap>(std::move(baked->map));
    }
    return *map;
}

/// Points on the floor around the body: lit, dark and between.
std::vector<glm::dvec3> floorPoints(std::size_t count) {
    std::mt19937_64 random(1);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    std::vector<glm::dvec3> points;
    for (std::size_t i = 0; i < count; ++i)
        points.push_back({4 * unit() - 2.6, -1.2, 4 * unit() - 2.8});
    return points;
}

void traceFloor(benchmark::State& state) {
    const ShadowMap& map = bakedMap(std::uint32_t(state.range(0)));
    AreaLight light = map.info().light;
    light.radius = kLargestRadius * double(state.range(1)) / 100.0;
    const auto points = floorPoints(4096);
    const std::vector<glm::dvec3> normals(points.size(), glm::dvec3(0, 1, 0));
    std::vector<float> out(points.size());
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                              std::size_t(state.range(2)));
    QueryStats stats;
    for (auto _ : state)
        shadowFactors(map, light, points.data(), normals.data(), points.size(),
                      out.data(), {}, &stats);
    state.counters["rays/s"] =
        benchmark::Counter(double(stats.rays), benchmark::Counter::kIsRate);
}

}  // namespace

BENCHMARK(traceFloor)
    ->ArgNames({"resolution", "radius%", "threads"})
    ->ArgsProduct({{512, 1024, 2048, 4096}, {10, 33, 100}, {1}})
    ->Args({1024, 33, 2})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
