// bench_objects - single sample soft shadows and distance fields: what a soft shadow ray
// costs over a hard one in the same tree (the claim of [Parker98, sec. 4]: about 20 %),
// what is built and how long that takes, and the error of both on a floor.
//
//     bench_objects                                 // a cloud of spheres
//     bench_objects dragon.ply --light 0.1,0.5
//
// One thread. Each repetition runs every variant once, in turn; medians are printed.
#include <tbb/global_control.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <random>

#include "baseline/distance_field.h"
#include "baseline/reference_embree.h"
#include "baseline/sdf_march.h"
#include "baseline/single_sample.h"
#include "mtsm/scene.h"

namespace {

using namespace mtsm;
using namespace mtsm::baseline;

struct Options {
    std::vector<std::string> files;
    std::vector<double> lights{0.05, 0.25, 0.67};  // radius over the casters' diagonal
    double grownUpTo = 0.1;  // lights with which boxes grown by D are timed, too
    int spheres = 10'000, repetitions = 9, side = 300, truth = 1024;
    std::vector<int> resolutions{64, 128, 256};
};

double seconds() {
    using namespace std::chrono;
    return duration<double>(steady_clock::now().time_since_epoch()).count();
}

double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
}

int complain(const Error& error) {
    std::fprintf(stderr, "bench_objects: %s\n", error.message.c_str());
    return exitCode(error.code);
}

struct Points {
    std::vector<glm::dvec3> at, normals;
    void add(glm::dvec3 p, glm::dvec3 n) {
        at.push_back(p);
        normals.push_back(n);
    }
};

Points floorUnder(glm::dvec3 low, glm::dvec3 high, int side) {
    Points points;
    const double width = 2.5 * std::max(high.x - low.x, high.z - low.z);
    for (int i = 0; i < side * side; ++i)
        points.add(
            {0.5 * (low.x + high.x) + ((i % side + 0.5) / side - 0.5) * width, low.y,
             0.5 * (low.z + high.z) + ((i / side + 0.5) / side - 0.5) * width},
            {0, 1, 0});
    return points;
}

AreaLight lightOver(glm::dvec3 low, glm::dvec3 high, double share) {
    const double diagonal = glm::distance(low, high);
    AreaLight light;
    light.shape = LightShape::sphere;
    light.position = 0.5 * (low + high) + diagonal * glm::dvec3(0.6, 1.6, 0.4);
    light.radius = share * diagonal;
    return light;
}

/// Medians of hard, of soft with either tree, by point, and their work.
void timeSingleSample(const SingleSampleScene& scene, const AreaLight& light,
                      const Points& points, const char* where, int repetitions,
                      bool withGrown) {
    struct Variant {
        const char* name;
        SingleSampleOptions options;
        std::vector<double> times, ratios;
    };
    SingleSampleOptions hard, soft, grown, all;
    hard.hard = true;
    grown.bounds = GrownBounds::largest;
    all.compose = Compose::multiply;
    std::vector<Variant> variants{{"hard", hard, {}, {}},
                                  {"soft, cone", soft, {}, {}},
                                  {"soft, cone, multiply", all, {}, {}}};
    if (withGrown) variants.push_back({"soft, boxes grown by D", grown, {}, {}});
    std::vector<float> out(points.at.size());
    for (int r = 0; r < repetitions; ++r) {
        for (Variant& v : variants) {
            const double start = seconds();
            scene.shadowFactors(light, points.at.data(), points.normals.data(),
                                out.size(), out.data(), v.options);
            v.times.push_back(seconds() - start);
            v.ratios.push_back(v.times.back() / variants[0].times.back());
        }
    }
    for (Variant& v : variants) {
        SingleSampleWork work;
        scene.shadowFactors(light, points.at.data(), points.normals.data(), out.size(),
                            out.data(), v.options, &work);
        double sum = 0.0;
        for (const float dark : out)
            sum += double(dark);
        const double rays = std::max(1.0, double(work.rays.load()));
        std::printf(
            "  %-7s %-23s %7.0f ns a point, %5.2f x hard, %6.1f nodes and %6.1f objects "
            "a ray, mean shadow %.4f\n",
            where, v.name, median(v.times) / double(out.size()) * 1e9, median(v.ratios),
            double(work.nodes) / rays, double(work.objects) / rays,
            sum / double(out.size()));
    }
}

void timeSpheres(const Options& options) {
    std::mt19937_64 random(1);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    std::vector<SoftSphere> spheres;
    for (int i = 0; i < options.spheres; ++i) {
        const double x = unit(), y = unit(), z = unit(), radius = 0.002 + 0.008 * unit();
        spheres.push_back({{x, 0.3 * y + 0.01, z}, radius});
    }
    CasterViews none({});
    const double start = seconds();
    auto scene = SingleSampleScene::build(none, spheres);
    std::printf("%d spheres, built in %.3f s, %.1f MB\n", options.spheres,
                seconds() - start, double(scene->memoryBytes()) / 1e6);
    const glm::dvec3 low(0, 0, 0), high(1, 0.31, 1);
    const Points floor = floorUnder(low, high, options.side);
    for (const double share : options.lights) {
        std::printf(" light's radius %.2f of the diagonal\n", share);
        timeSingleSample(*scene, lightOver(low, high, share), floor, "floor",
                         options.repetitions, share <= options.grownUpTo);
    }
}

/// Points of the mesh that a camera in front sees.
Points seen(const EmbreeReference& embree, int side) {
    const glm::dvec3 low = embree.boundsMin(), high = embree.boundsMax(),
                     middle = 0.5 * (low + high);
    const double diagonal = glm::distance(low, high);
    Points points;
    for (int i = 0; i < side * side; ++i) {
        const glm::dvec3 eye = middle + diagonal * glm::dvec3(0.2, 0.4, 2.0);
        const glm::dvec3 to =
            middle + diagonal * glm::dvec3((i % side + 0.5) / side - 0.5,
                                           0.5 - (i / side + 0.5) / side, 0.0);
        if (const auto hit = embree.firstHit(eye, to - eye))
            points.add(hit->position, hit->normal);
    }
    return points;
}

struct Errors {
    double mean = 0.0, bias = 0.0;
    Errors(const std::vector<float>& found, const std::vector<float>& truth) {
        for (std::size_t i = 0; i < found.size(); ++i) {
            mean += std::abs(double(found[i]) - double(truth[i])) / double(found.size());
            bias += (double(found[i]) - double(truth[i])) / double(found.size());
        }
    }
};

int measureMesh(const Options& options) {
    MeshFiles casters(options.files);
    const auto visited = casters.visit([](const CasterView&) -> Status { return {}; });
    if (!visited) return complain(visited.error());
    auto embree = EmbreeReference::build(casters);
    if (!embree) return complain(embree.error());
    double start = seconds();
    auto scene = SingleSampleScene::build(casters);
    if (!scene) return complain(scene.error());
    std::printf("single-sample: built in %.3f s, %.1f MB\n", seconds() - start,
                double(scene->memoryBytes()) / 1e6);
    const glm::dvec3 low = embree->boundsMin(), high = embree->boundsMax();
    const Points floor = floorUnder(low, high, options.side),
                 body = seen(*embree, options.side);
    for (const double share : options.lights) {
        std::printf(" light's radius %.2f of the diagonal\n", share);
        const AreaLight light = lightOver(low, high, share);
        timeSingleSample(*scene, light, floor, "floor", options.repetitions,
                         share <= options.grownUpTo);
        timeSingleSample(*scene, light, body, "object", options.repetitions,
                         share <= options.grownUpTo);
    }
    std::vector<std::pair<int, DistanceFieldPtr>> fields;
    for (const int resolution : options.resolutions) {
        start = seconds();
        auto field = meshField(casters, resolution);
        if (!field) return complain(field.error());
        std::printf("sdf %d: built in %.2f s, %.1f MB\n", resolution, seconds() - start,
                    double((*field)->memoryBytes()) / 1e6);
        fields.emplace_back(resolution, std::move(*field));
    }
    const Points few = floorUnder(low, high, 60), fewOn = seen(*embree, 60);
    for (const double share : options.lights) {
        const AreaLight light = lightOver(low, high, share);
        for (const Points* p : {&few, &fewOn}) {
            std::vector<float> truth(p->at.size()), out(truth);
            ReferenceOptions reference;
            reference.samples = options.truth;
            embree->shadowFactors(light, p->at.data(), p->normals.data(), truth.size(),
                                  truth.data(), reference);
            const auto report = [&](const std::string& name, double time) {
                const Errors errors(out, truth);
                std::printf(
                    "  light %.2f, %-6s %-22s mean error %.4f, bias %+.4f, %6.0f "
                    "ns a point\n",
                    share, p == &few ? "floor" : "object", name.c_str(), errors.mean,
                    errors.bias, time / double(out.size()) * 1e9);
            };
            for (const bool hard : {true, false}) {
                SingleSampleOptions single;
                single.hard = hard;
                start = seconds();
                scene->shadowFactors(light, p->at.data(), p->normals.data(), out.size(),
                                     out.data(), single);
                report(hard ? "hard" : "single-sample", seconds() - start);
            }
            for (const auto& [resolution, field] : fields) {
                start = seconds();
                marchShadowFactors(*field, light, p->at.data(), p->normals.data(),
                                   out.size(), out.data());
                report("sdf " + std::to_string(resolution), seconds() - start);
            }
        }
    }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    Options options;
    CLI::App app("Single sample soft shadows and distance fields: time and error");
    app.add_option("files", options.files, "meshes; without, a cloud of spheres");
    app.add_option("--light", options.lights, "radii, of the casters' diagonal")
        ->delimiter(',');
    app.add_option("--grown-up-to", options.grownUpTo,
                   "largest light for which boxes grown by its diameter are timed");
    app.add_option("--spheres", options.spheres, "their number");
    app.add_option("--repetitions", options.repetitions, "of each time");
    app.add_option("--side", options.side, "points along a side");
    app.add_option("--truth", options.truth, "samples of the truth");
    app.add_option("--resolutions", options.resolutions, "of distance fields")
        ->delimiter(',');
    CLI11_PARSE(app, argc, argv);
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    if (options.files.empty()) {
        timeSpheres(options);
        return 0;
    }
    return measureMesh(options);
}
