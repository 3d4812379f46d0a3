// bench_media_trace - the density pyramid against the definition: time per ray and error.
//
//     bench_media_trace MAP.mtsm [DEPTH LENGTH]...
//
// Points are taken within what lets light through (at layers of the map) and behind it,
// 16 neighbours a group, groups anywhere; a bundle has the rays of a group. Truth is the
// definition with 1024 rays a point; errors are those of points and of the means of
// groups (16 points of a pixel, say), and of rays against the same ray by the definition.
// Rows: how much of the light's diameter a texel may be; whole trees, those without level
// 0, and those whose slabs are merged up to the DEPTH and LENGTH given (DensityOptions).
// Rays: one per cell of the light. Times are medians of 5 runs in turn with the others',
// of processor time; a bundle's making is not in them. A tree's is by the clock, with all
// threads.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <glm/geometric.hpp>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "base/sampling.h"
#include "light/sample.h"
#include "mtsm/reader.h"
#include "shadow/query.h"
#include "trace/density_trace.h"
#include "trace/straight_rays.h"

namespace {

using namespace mtsm;
using namespace mtsm::trace;

/// Processor time of this thread: other work on the machine takes turns with it.
struct Clock {
    using time_point = double;
    static double now() {
        timespec t{};
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
        return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
    }
};

constexpr int kGroups = 64;
constexpr int kTruth = 1024;
constexpr double kThreshold = 1.0 / 1024;

double secondsSince(Clock::time_point start) {
    return Clock::now() - start;
}

struct Group {
    glm::dvec3 point[kLanes];
    double truth[kLanes] = {};
};

/// Groups of points over 8 x 8 pixels: at layers near one depth, or all at depth `z`.
std::vector<Group> makeGroups(const ShadowMap& map, double z) {
    const Projection& p = map.projection(0);
    std::mt19937_64 random(5);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    std::vector<Group> groups;
    while (groups.size() < kGroups) {
        const auto x0 = std::uint32_t(unit() * (map.info().width - 8));
        const auto y0 = std::uint32_t(unit() * (map.info().height - 8));
        const PixelLayers first = map.pixel(0, x0, y0);
        if (first.count == 0) continue;
        const double depth = first.z[std::uint32_t(unit() * first.count)];
        Group group;
        for (int i = 0; i < kLanes; ++i) {
            const glm::dvec2 at(x0 + 2 * (i % 4) + 2 * unit(),
                                y0 + 2 * (i / 4) + 2 * unit());
            const PixelLayers here =
                map.pixel(0, std::uint32_t(at.x), std::uint32_t(at.y));
            double nearest = depth;
            for (std::uint32_t k = 0; k < here.count; ++k) {
                if (k == 0 || std::abs(here.z[k] - depth) < std::abs(nearest - depth))
                    nearest = here.z[k];
            }
            group.point[i] = p.worldFromLight(p.lightFromRaster(at, z > 0 ? z : nearest));
        }
        groups.push_back(group);
    }
    return groups;
}

struct Scene {
    const ShadowMap& map;
    light::LightSampler light;
    double diameter;
    TraceOptions options;
};

Ray rayOf(const Scene& scene, glm::dvec3 point, glm::dvec2 u) {
    Ray ray;
    ray.origin = point;
    ray.delta = scene.light.sample(point, u).delta;
    const double z = scene.map.projection(0).lightFromWorld(point).z;
    const double length = glm::length(ray.delta);
    ray.tBegin = shadow::kMediaStart * scene.map.projection(0).pixelFootprint(z) / length;
    ray.tSurfaces = shadow::kStartBiases * scene.options.bias.at(z) / length;
    if (scene.map.info().translucent == Translucent::sheets) ray.tBegin = ray.tSurfaces;
    return ray;
}

/// One ray per cell of the light: [cell * kLanes + point].
std::vector<Ray> raysOf(const Scene& scene, const Group& group, int cells,
                        std::uint64_t seed) {
    const int side = int(std::lround(std::sqrt(cells)));
    std::vector<Ray> rays;
    for (int b = 0; b < cells; ++b) {
        for (int i = 0; i < kLanes; ++i) {
            const std::uint64_t h =
                base::mix(seed + 0x9e3779b97f4a7c15u * std::uint64_t(b * kLanes + i));
            const glm::dvec2 jitter(double(h >> 40) * 0x1p-24,
                                    double(h & 0xffffff) * 0x1p-24);
            const glm::dvec2 u = (glm::dvec2(b % side, b / side) + jitter) / double(side);
            rays.push_back(rayOf(scene, group.point[i], u));
        }
    }
    return rays;
}

void findTruth(const Scene& scene, std::vector<Group>& groups) {
    for (Group& group : groups) {
        for (int i = 0; i < kLanes; ++i) {
            const base::SquareSequence sequence(base::pointKey(group.point[i], 9));
            for (int k = 0; k < kTruth; ++k)
                group.truth[i] +=
                    traceRay(scene.map, rayOf(scene, group.point[i], sequence(k)),
                             scene.options)[0] /
                    kTruth;
        }
    }
}

/// What one way of tracing gives for all groups, by the rays of one number of cells.
struct Row {
    std::string name;
    const DensityTree* tree = nullptr;  ///< null: the definition
    double texel = 0.0;                 ///< world units at the light
    std::vector<double> seconds;        ///< of every run
    double point = 0.0, group = 0.0, bias = 0.0, ray = 0.0;
};

/// [group][cell * kLanes + point]
using Rays = std::vector<std::vector<Ray>>;
using Visibilities = std::vector<std::vector<double>>;

double defined(const Scene& scene, const Rays& rays, Visibilities& out) {
    const auto start = Clock::now();
    for (std::size_t g = 0; g < rays.size(); ++g) {
        for (std::size_t r = 0; r < rays[g].size(); ++r)
            out[g][r] = traceRay(scene.map, rays[g][r], scene.options)[0];
    }
    return secondsSince(start);
}

/// Where a bundle has the rays of a group: a row's come from 4 x 4 cells of the light.
struct Place {
    int receiver, group, lane;
};

Place placeOf(std::size_t ray, int side) {
    const int cell = int(ray) / kLanes, x = cell % side, y = cell / side;
    return {int(ray) % kLanes, y / 4 * (side / 4) + x / 4, y % 4 * 4 + x % 4};
}

double traced(const Scene& scene, const Row& row, const Rays& rays, Visibilities& out) {
    const Projection& p = scene.map.projection(0);
    const double zNear = test::nearestOf(scene.map, 0);
    const auto bundle = std::make_unique<RayBundle>();
    const auto depths = std::make_unique<RayDepths>();
    double seconds = 0.0;
    for (std::size_t g = 0; g < rays.size(); ++g) {
        const int cells = int(rays[g].size()) / kLanes;
        const int side = int(std::lround(std::sqrt(cells)));
        *bundle = {};
        bundle->receivers = kLanes;
        bundle->groups = std::max(1, cells / kLanes);
        for (std::size_t r = 0; r < rays[g].size(); ++r) {
            const Place at = placeOf(r, side);
            test::put(*bundle, at.receiver, at.group, at.lane,
                      test::straighten(p, rays[g][r], zNear, row.texel));
        }
        const auto start = Clock::now();
        *depths = {};
        traceDensity(*row.tree, {scene.options.bias}, *bundle, *depths);
        seconds += secondsSince(start);
        for (std::size_t r = 0; r < rays[g].size(); ++r) {
            const Place at = placeOf(r, side);
            const int inRow = bundle->row(at.receiver, at.group);
            const double v = std::exp(-depths->depth[0][inRow][at.lane]);
            out[g][r] = v <= kThreshold ? 0.0 : v;
        }
    }
    return seconds;
}

void findErrors(const std::vector<Group>& groups, const Visibilities& exact,
                const Visibilities& found, Row& row) {
    row.point = row.group = row.bias = row.ray = 0.0;
    for (std::size_t g = 0; g < groups.size(); ++g) {
        const std::size_t count = found[g].size();
        double visible[kLanes] = {}, sum = 0.0;
        for (std::size_t r = 0; r < count; ++r) {
            visible[r % kLanes] += found[g][r] * kLanes / double(count);
            row.ray += std::abs(found[g][r] - exact[g][r]) / (double(count) * kGroups);
        }
        for (int i = 0; i < kLanes; ++i) {
            row.point += std::abs(visible[i] - groups[g].truth[i]) / (kGroups * kLanes);
            sum += (visible[i] - groups[g].truth[i]) / kLanes;
        }
        row.group += std::abs(sum) / kGroups;
        row.bias += sum / kGroups;
    }
}

double medianNanoseconds(Row& row, int cells) {
    std::sort(row.seconds.begin(), row.seconds.end());
    return row.seconds[row.seconds.size() / 2] * 1e9 / (double(kGroups) * kLanes * cells);
}

void run(const Scene& scene, std::vector<Group>& groups, const std::vector<Row>& kinds) {
    findTruth(scene, groups);
    for (const int cells : {4, 16, 64}) {
        Rays rays;
        for (std::size_t g = 0; g < groups.size(); ++g)
            rays.push_back(raysOf(scene, groups[g], cells, g));
        Visibilities exact(groups.size(), std::vector<double>(rays[0].size()));
        Visibilities found = exact;
        std::vector<Row> rows = kinds;
        for (int repeat = 0; repeat < 5; ++repeat) {
            for (Row& row : rows) {
                row.seconds.push_back(row.tree ? traced(scene, row, rays, found)
                                               : defined(scene, rays, exact));
                findErrors(groups, exact, row.tree ? found : exact, row);
            }
        }
        const double reference = medianNanoseconds(rows[0], cells);
        for (Row& row : rows) {
            const double ns = medianNanoseconds(row, cells);
            std::printf(
                "  %2d rays  %-26s %8.1f ns a ray, %6.1f times, %7.2f us a point; "
                "error point %.4f, group %.4f, bias %+.4f, ray %.4f\n",
                cells, row.name.c_str(), ns, reference / ns, ns * cells * 1e-3, row.point,
                row.group, row.bias, row.ray);
        }
    }
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 2 || argc % 2 != 0) {
        std::fprintf(stderr, "usage: bench_media_trace MAP.mtsm [DEPTH LENGTH]...\n");
        return 2;
    }
    auto map = readMap(argv[1]);
    if (!map) {
        std::fprintf(stderr, "%s\n", map.error().message.c_str());
        return exitCode(map.error().code);
    }
    const AreaLight& light = map->info().light;
    TraceOptions options;
    options.bias = {map->info().bias, map->info().biasPerDepth};
    options.threshold = kThreshold;
    const Scene scene{*map, light::LightSampler(light), 2.0 * light.radius, options};

    std::vector<std::pair<std::string, DensityOptions>> kinds = {{"", {}}};
    kinds.push_back({", no level 0", {}});
    kinds.back().second.finest = 1;
    for (int i = 2; i < argc; i += 2)
        kinds.push_back({std::string(", ") + argv[i] + " " + argv[i + 1],
                         {std::atof(argv[i]), std::atof(argv[i + 1])}});
    std::vector<DensityTree> trees;
    trees.reserve(kinds.size());
    std::vector<Row> rows(1);
    rows[0].name = "definition";
    for (const auto& [name, built] : kinds) {
        const auto start = std::chrono::steady_clock::now();
        auto tree = DensityTree::build(*map, 0, built);
        const double seconds =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
                .count();
        if (!tree) {
            std::fprintf(stderr, "%s\n", tree.error().message.c_str());
            return exitCode(tree.error().code);
        }
        trees.push_back(*std::move(tree));
        std::printf("tree%s: %.0f ms, %.1f MB of the map's %.1f\n", name.c_str(),
                    seconds * 1e3, double(trees.back().memoryBytes()) * 1e-6,
                    double(map->memoryBytes()) * 1e-6);
        for (const int part : {0, 16, 8, 4}) {
            Row row;
            row.name =
                (part ? "texel 1/" + std::to_string(part) : "single pixels") + name;
            row.tree = &trees.back();
            row.texel = part ? scene.diameter / part : 0.0;
            rows.push_back(row);
        }
    }
    std::printf("points within\n");
    std::vector<Group> within = makeGroups(*map, 0.0);
    run(scene, within, rows);
    std::printf("points behind\n");
    std::vector<Group> behind = makeGroups(*map, 1.05 * map->zRange(0).max);
    run(scene, behind, rows);
}
