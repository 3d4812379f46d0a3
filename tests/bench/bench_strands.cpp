// bench_strands: segments of hair per second, by resolution and threads. Scene: a ball of
// 140,625 hairs of 16 segments, tapered, that fills the window; argument 1 is the width
// of the window in pixels, argument 2 the number of threads. At 1024 pixels a segment is
// some 6 pixels long and half a pixel wide.
#include <benchmark/benchmark.h>
#include <tbb/task_arena.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "bake/casters.h"
#include "raster/strand.h"

using namespace mtsm;
using namespace mtsm::raster;

namespace {

struct Fur {
    static constexpr std::uint32_t kHairs = 140625, kSegments = 16;
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> begin{0};
    std::vector<float> widths;

    Fur() {
        test::Random random(1);
        const auto direction = [&] {
            return glm::normalize(
                glm::dvec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1)));
        };
        for (std::uint32_t hair = 0; hair < kHairs; ++hair) {
            const glm::dvec3 root = direction(), lean = direction();
            for (std::uint32_t i = 0; i <= kSegments; ++i) {
                const double t = double(i) / kSegments;
                points.emplace_back(root + 0.25 * t * (root + 0.8 * t * lean));
                widths.push_back(float(0.003 - 0.0024 * t));
            }
            begin.push_back(std::uint32_t(points.size()));
        }
    }
    [[nodiscard]] StrandsView view() const {
        StrandsView view;
        view.points = points.data();
        view.begin = begin.data();
        view.strandCount = kHairs;
        view.widths = widths.data();
        view.opacity = 0.4f;
        return view;
    }
};

void rasterise(benchmark::State& state) {
    static const Fur fur;
    const auto side = std::uint32_t(state.range(0));
    Projection projection;
    projection.eye = {0.0, 0.0, 4.0};
    projection.scale = glm::dvec2(1.4, -1.4) * double(side);
    projection.offset = glm::dvec2(0.5 * side);
    projection.near = 0.1;
    tbb::task_arena arena(int(state.range(1)));
    std::uint64_t samples = 0;
    for (auto _ : state) {
        const std::uint32_t rows = (side + 63) / 64;
        SampleGrid grid({side, side, 1, 1, {}}, 0, rows, std::uint64_t(4) << 30);
        arena.execute([&] {
            StrandRasteriser rasteriser(projection, grid);
            if (!rasteriser.add(fur.view()) || !rasteriser.finish())
                state.SkipWithError("the rasteriser was stopped");
        });
        samples = 0;
        for (std::uint32_t tile = 0; tile < rows * rows; ++tile)
            samples += grid.tile(tile % rows, tile / rows).samples();
    }
    state.counters["samples"] = double(samples);
    state.counters["segments/s"] =
        benchmark::Counter(double(Fur::kHairs) * Fur::kSegments,
                           benchmark::Counter::kIsIterationInvariantRate);
}

BENCHMARK(rasterise)
    ->ArgsProduct({{128, 512, 1024, 2048}, {1, 2}})
    ->Unit(benchmark::kMillisecond)
    ->MeasureProcessCPUTime()
    ->UseRealTime();

}  // namespace
