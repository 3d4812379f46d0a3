// bench_media_trace - the density pyramid against the definition: time per ray and error.
//
//     bench_media_trace MAP.mtsm [RADIUS_FACTOR]
//
// Points are taken within the medium (at layers of the map) and behind it, 16 neighbours
// a group. Truth is the definition with 1024 rays a point; errors are those of points and
// of the means of groups (16 points of a pixel, say). Each row traces the same points by
// 4, 16 or 64 rays, one per cell of the light.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <glm/geometric.hpp>
#include <memory>
#include <random>
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
using Clock = std::chrono::steady_clock;

constexpr int kGroups = 64;
constexpr int kTruth = 1024;
constexpr double kThreshold = 1.0 / 1024;

double secondsSince(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
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

/// One ray per cell of the light, the same cell for all lanes of a block.
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

struct Row {
    double nanoseconds = 1e300, point = 0.0, mean = 0.0, bias = 0.0, perRay = 0.0;
};

void addErrors(const Group& group, const double (&visible)[kLanes], Row& row) {
    double sum = 0.0;
    for (int i = 0; i < kLanes; ++i) {
        const double error = visible[i] - group.truth[i];
        row.point += std::abs(error) / (kGroups * kLanes);
        sum += error / kLanes;
    }
    row.mean += std::abs(sum) / kGroups;
    row.bias += sum / kGroups;
}

void print(const char* name, int cells, const Row& row, double reference) {
    std::printf(
        "  %-28s %3d  %8.1f ns/ray %7.2f us/point %6.1fx  point %.4f  group %.4f"
        "  bias %+.4f  ray %.4f\n",
        name, cells, row.nanoseconds, row.nanoseconds * cells * 1e-3,
        reference / row.nanoseconds, row.point, row.mean, row.bias, row.perRay);
}

void run(const Scene& scene, std::vector<Group>& groups,
         const std::vector<std::pair<const char*, const DensityTree*>>& trees) {
    findTruth(scene, groups);
    const double zNear = test::nearestOf(scene.map, 0);
    const auto bundle = std::make_unique<RayBundle>();
    const auto depths = std::make_unique<RayDepths>();
    for (const int cells : {4, 16, 64}) {
        const int repeats = 5;
        std::vector<std::vector<Ray>> rays;
        for (std::size_t g = 0; g < groups.size(); ++g)
            rays.push_back(raysOf(scene, groups[g], cells, g));
        Row scalar;
        std::vector<std::vector<double>> exact(groups.size());
        for (int repeat = 0; repeat < 2; ++repeat) {
            Row row;
            double seconds = 0.0;
            for (std::size_t g = 0; g < groups.size(); ++g) {
                double visible[kLanes] = {};
                exact[g].clear();
                const auto start = Clock::now();
                for (std::size_t r = 0; r < rays[g].size(); ++r) {
                    exact[g].push_back(traceRay(scene.map, rays[g][r], scene.options)[0]);
                    visible[r % kLanes] += exact[g].back() / cells;
                }
                seconds += secondsSince(start);
                addErrors(groups[g], visible, row);
            }
            row.nanoseconds = seconds * 1e9 / (double(kGroups) * kLanes * cells);
            if (row.nanoseconds < scalar.nanoseconds) scalar = row;
        }
        print("definition", cells, scalar, scalar.nanoseconds);
        for (const auto& [name, tree] : trees) {
            for (const double part : {0.0, 1.0 / 16, 1.0 / 8, 1.0 / 4}) {
                Row best;
                for (int repeat = 0; repeat < repeats; ++repeat) {
                    Row row;
                    double seconds = 0.0;
                    for (std::size_t g = 0; g < groups.size(); ++g) {
                        bundle->blocks = cells;
                        std::memset(bundle->open, 0, sizeof bundle->open);
                        for (std::size_t r = 0; r < rays[g].size(); ++r)
                            test::put(
                                *bundle, int(r) / kLanes, int(r) % kLanes,
                                test::straighten(scene.map.projection(0), rays[g][r],
                                                 zNear, part * scene.diameter));
                        const auto start = Clock::now();
                        *depths = {};
                        traceDensity(*tree, {scene.options.bias}, *bundle, *depths);
                        seconds += secondsSince(start);
                        double visible[kLanes] = {};
                        for (int b = 0; b < cells; ++b) {
                            for (int i = 0; i < kLanes; ++i) {
                                double v = std::exp(-depths->depth[0][b][i]);
                                if (v <= kThreshold) v = 0.0;
                                visible[i] += v / cells;
                                row.perRay +=
                                    std::abs(v - exact[g][std::size_t(b * kLanes + i)]) /
                                    (double(kGroups) * kLanes * cells);
                            }
                        }
                        addErrors(groups[g], visible, row);
                    }
                    row.nanoseconds = seconds * 1e9 / (double(kGroups) * kLanes * cells);
                    if (row.nanoseconds < best.nanoseconds) best = row;
                }
                char label[64];
                std::snprintf(label, sizeof label, "%s, texel %.3f", name, part);
                print(label, cells, best, scalar.nanoseconds);
            }
        }
    }
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 2) {
        std::fprintf(stderr, "usage: bench_media_trace MAP.mtsm [RADIUS_FACTOR]\n");
        return 2;
    }
    auto map = readMap(argv[1]);
    if (!map) {
        std::fprintf(stderr, "%s\n", map.error().message.c_str());
        return exitCode(map.error().code);
    }
    std::vector<std::pair<const char*, DensityOptions>> kinds = {
        {"all", {}}, {"from level 1", {0.4, 4.0, 1}}};
    std::vector<DensityTree> trees;
    for (const auto& [name, options] : kinds) {
        const auto start = Clock::now();
        auto tree = DensityTree::build(*map, 0, options);
        const double seconds = secondsSince(start);
        if (!tree) {
            std::fprintf(stderr, "%s\n", tree.error().message.c_str());
            return exitCode(tree.error().code);
        }
        std::printf("%s: %.0f ms, %.1f MB, slabs of levels", name, seconds * 1e3,
                    double(tree->memoryBytes()) * 1e-6);
        for (const DensityLevel& level : tree->translucent().levels) {
            if (level.texels.empty()) continue;
            const double slabs = double(level.slabs.size()) / 2;
            std::printf(" %.0f (%.1f)", slabs,
                        slabs / (double(level.width) * level.height));
        }
        std::printf("\n");
        trees.push_back(*std::move(tree));
    }
    AreaLight light = map->info().light;
    light.radius *= argc > 2 ? std::atof(argv[2]) : 1.0;
    TraceOptions options;
    options.bias = {map->info().bias, map->info().biasPerDepth};
    options.threshold = kThreshold;
    const Scene scene{*map, light::LightSampler(light), 2.0 * light.radius, options};
    std::vector<std::pair<const char*, const DensityTree*>> named;
    for (std::size_t i = 0; i < trees.size(); ++i)
        named.emplace_back(kinds[i].first, &trees[i]);
    std::printf("points in the medium\n");
    std::vector<Group> inside = makeGroups(*map, 0.0);
    run(scene, inside, named);
    std::printf("points behind it\n");
    std::vector<Group> behind = makeGroups(*map, 1.05 * map->zRange(0).max);
    run(scene, behind, named);
}
