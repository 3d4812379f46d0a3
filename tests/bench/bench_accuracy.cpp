// bench_accuracy - the error of a baked map against ray tracing of its casters, on a
// floor and on the object itself: the comparison of [Xie07, table 1] on a mesh of your
// own.
//
//     bench_accuracy dragon.ply
//     bench_accuracy dragon.ply --resolution 2048 --layers 8 --light 0.1,0.5
#include <tbb/global_control.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec4.hpp>
#include <random>

#include "baseline/reference_embree.h"
#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"

namespace {

using namespace mtsm;

struct Points {
    std::vector<glm::dvec3> position, normal;
};

struct Options {
    std::vector<std::string> meshes;
    std::vector<double> lights{0.07, 0.25, 0.67};
    std::uint32_t resolution = 1024, layers = 5;
    int samples = 256, truthSamples = 4096;
    std::size_t floorSide = 128, objectPoints = 16384;
    double footprints = -1.0;  // bias in pixel footprints at the object's centre
    bool cosine = false;
};

double seconds() {
    using namespace std::chrono;
    return duration<double>(steady_clock::now().time_since_epoch()).count();
}

/// Points spread evenly by area over the triangles, with the triangles' normals.
Points onObject(CasterSource& casters, std::size_t count, glm::dvec3 towards) {
    struct Triangle {
        glm::dvec3 a, b, c;
    };
    std::vector<Triangle> triangles;
    std::vector<double> area{0.0};
    (void)casters.visit(meshesOnly([&](const MeshView& mesh) -> Status {
        for (std::size_t i = 0; i < mesh.triangleCount; ++i) {
            const auto corner = [&](std::size_t k) {
                return glm::dvec3(
                    mesh.worldFromObject *
                    glm::dvec4(mesh.positions[mesh.indices[3 * i + k]], 1.0));
            };
            const Triangle t{corner(0), corner(1), corner(2)};
            const glm::dvec3 n = glm::cross(t.b - t.a, t.c - t.a);
            if (!(glm::dot(n, towards) > 0.0))
                continue;  // turned away: dark by definition
            triangles.push_back(t);
            area.push_back(area.back() + 0.5 * glm::length(n));
        }
        return {};
    }));
    Points points;
    std::mt19937_64 random(1);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    for (std::size_t i = 0; i < count && !triangles.empty(); ++i) {
        const auto at = std::upper_bound(area.begin(), area.end(), unit() * area.back());
        const Triangle& t =
            triangles[std::min(triangles.size(), std::size_t(at - area.begin())) - 1];
        const double u = std::sqrt(unit()), v = unit();
        points.position.push_back((1 - u) * t.a + u * (1 - v) * t.b + u * v * t.c);
        points.normal.push_back(glm::normalize(glm::cross(t.b - t.a, t.c - t.a)));
    }
    return points;
}

Points onFloor(glm::dvec3 low, glm::dvec3 high, std::size_t side) {
    Points points;
    const double size = std::max({high.x - low.x, high.y - low.y, high.z - low.z});
    const glm::dvec3 centre = 0.5 * (low + high);
    for (std::size_t j = 0; j < side; ++j) {
        for (std::size_t i = 0; i < side; ++i) {
            points.position.push_back(
                {centre.x + 3.0 * size * ((double(i) + 0.5) / double(side) - 0.5), low.y,
                 centre.z + 3.0 * size * ((double(j) + 0.5) / double(side) - 0.5)});
            points.normal.push_back({0, 1, 0});
        }
    }
    return points;
}

struct Errors {
    double mean = 0.0, deviation = 0.0, bias = 0.0, p99 = 0.0, penumbraMean = 0.0;
};

Errors compare(const std::vector<float>& found, const std::vector<float>& truth) {
    Errors e;
    std::vector<double> all;
    double sum = 0.0, squares = 0.0, shadowSum = 0.0;
    std::size_t inShadow = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        const double error = std::abs(double(found[i]) - truth[i]);
        all.push_back(error);
        sum += error;
        squares += error * error;
        e.bias += double(found[i]) - truth[i];
        if (truth[i] > 0.0f) {
            shadowSum += error;
            ++inShadow;
        }
    }
    const double n = double(found.size());
    e.mean = sum / n;
    e.deviation = std::sqrt(std::max(0.0, squares / n - e.mean * e.mean));
    e.bias /= n;
    e.penumbraMean = inShadow ? shadowSum / double(inShadow) : 0.0;
    std::sort(all.begin(), all.end());
    e.p99 = all[std::size_t(0.99 * (n - 1))];
    return e;
}

int run(const Options& options) {
    MeshFiles casters(options.meshes);
    auto truth = baseline::EmbreeReference::build(casters);
    if (!truth) {
        std::fprintf(stderr, "bench_accuracy: %s\n", truth.error().message.c_str());
        return exitCode(truth.error().code);
    }
    const glm::dvec3 low = truth->boundsMin(), high = truth->boundsMax();
    const glm::dvec3 extent = high - low;
    const double size = std::max({extent.x, extent.y, extent.z});
    const glm::dvec3 towards = glm::normalize(glm::dvec3(0.45, 0.8, 0.4));

    BakeOptions bakeOptions;
    bakeOptions.light.shape = LightShape::disk;
    bakeOptions.light.position = 0.5 * (low + high) + 3.1 * size * towards;
    bakeOptions.width = bakeOptions.height = options.resolution;
    bakeOptions.layers = options.layers;
    const Points floor = onFloor(low, high, options.floorSide);
    const Points object = onObject(casters, options.objectPoints, towards);

    std::printf("%u x %u pixels, %u layers, %d samples; truth: Embree, %d samples; %s\n",
                options.resolution, options.resolution, options.layers, options.samples,
                options.truthSamples,
                options.cosine ? "cosine weights" : "uniform weights");
    std::printf("%-9s %-7s %-8s %9s %9s %9s %9s %9s %10s\n", "light", "points", "normals",
                "mean", "std", "bias", "p99", "in shadow", "us/point");
    for (double share : options.lights) {
        bakeOptions.light.radius = 0.5 * share * size;
        auto baked = bake(casters, bakeOptions);
        if (!baked) {
            std::fprintf(stderr, "bench_accuracy: %s\n", baked.error().message.c_str());
            return exitCode(baked.error().code);
        }
        const AreaLight light = baked->map.info().light;
        for (const Points* points : {&floor, &object}) {
            const std::size_t count = points->position.size();
            std::vector<float> expected(count), found(count);
            baseline::ReferenceOptions reference;
            reference.samples = options.truthSamples;
            if (options.cosine) reference.weight = Weight::cosine;
            truth->shadowFactors(light, points->position.data(), points->normal.data(),
                                 count, expected.data(), reference);
            for (const bool normals : {true, false}) {
                if (options.cosine && !normals) continue;
                ShadowOptions query;
                query.samples = options.samples;
                if (options.cosine) query.weight = Weight::cosine;
                if (options.footprints >= 0.0) {
                    const Projection& p = baked->map.projection(0);
                    query.bias =
                        float(options.footprints *
                              p.pixelFootprint(glm::length(0.5 * (low + high) - p.eye)));
                }
                const double start = seconds();
                shadowFactors(baked->map, light, points->position.data(),
                              normals ? points->normal.data() : nullptr, count,
                              found.data(), query);
                const double time = seconds() - start;
                const Errors e = compare(found, expected);
                std::printf("%-9.3g %-7s %-8s %9.5f %9.5f %+9.5f %9.5f %9.5f %10.2f\n",
                            share, points == &floor ? "floor" : "object",
                            normals ? "with" : "without", e.mean, e.deviation, e.bias,
                            e.p99, e.penumbraMean, 1e6 * time / double(count));
            }
        }
    }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    Options options;
    int threads = 0;
    CLI::App app{
        "The error of a baked map against ray tracing, on a floor and on the object."};
    app.add_option("mesh", options.meshes, "Mesh files: the casters")->required();
    app.add_option(
           "--light", options.lights,
           "Diameters of the disk light, as shares of the object's largest extent")
        ->delimiter(',');
    app.add_option("--resolution", options.resolution, "Pixels per side of the map");
    app.add_option("--layers", options.layers, "Layers per pixel");
    app.add_option("--samples", options.samples, "Rays per point through the map");
    app.add_option("--truth", options.truthSamples, "Rays per point of the truth");
    app.add_option("--floor", options.floorSide, "Points per side of the floor");
    app.add_option("--object", options.objectPoints, "Points on the object");
    app.add_option(
        "--footprints", options.footprints,
        "Bias in pixel footprints at the object's centre (default: the map's own)");
    app.add_flag("--cosine", options.cosine,
                 "Ratio of irradiances instead of the plain mean");
    app.add_option("--threads", threads, "Threads (default: all)");
    CLI11_PARSE(app, argc, argv);
    std::unique_ptr<tbb::global_control> limit;
    if (threads > 0)
        limit = std::make_unique<tbb::global_control>(
            tbb::global_control::max_allowed_parallelism, std::size_t(threads));
    return run(options);
}
