// bench_accuracy - the error of a baked map against ray tracing of its casters, on a
// floor and on the object itself: the comparison of [Xie07, table 1] on casters of your
// own, beside ray tracing with fewer samples.
//
//     bench_accuracy dragon.ply
//     bench_accuracy dragon.ply --resolution 2048 --layers 5,8 --light 0.1,0.5
//     bench_accuracy --fur 2300000 --subsamples 1,2,4 --pixels 250
#include <tbb/global_control.h>
#include <tbb/info.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <glm/geometric.hpp>
#include <map>
#include <optional>

#include "accuracy/receivers.h"
#include "accuracy/sources.h"
#include "baseline/errors.h"
#include "baseline/reference_embree.h"
#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"
#include "mtsm/writer.h"

namespace {

using namespace mtsm;
using baseline::EmbreeReference;
using baseline::Errors;
using bench::Receivers;

struct Options {
    bench::SourceOptions casters;
    std::vector<double> lights{0.07, 0.25, 0.67};
    // Maps: every combination.
    std::vector<std::uint32_t> resolutions{1024}, layers, subsamples{1};
    std::vector<float> tolerances, roundings;
    std::optional<float> opticalDepth, layerLength;
    // Queries: every combination.
    std::vector<int> samples{256};
    std::vector<Attenuation> attenuations{Attenuation::multiply};
    std::vector<int> embreeSamples{1, 4, 16, 64, 256};
    int truthSamples = 4096;
    std::size_t floorSide = 128, objectPoints = 16384, pixels = 500;
    double footprints = -1.0;  // bias in pixel footprints at the object's centre
    bool cosine = false;
};

double seconds() {
    using namespace std::chrono;
    return duration<double>(steady_clock::now().time_since_epoch()).count();
}

int complain(const Error& error) {
    std::fprintf(stderr, "bench_accuracy: %s\n", error.message.c_str());
    return exitCode(error.code);
}

/// A set of points and what ray tracing says there.
struct Probe {
    const Receivers* at;
    std::vector<float> truth;
};

/// The means of values[first[i]] to values[first[i + 1]].
std::vector<float> means(const std::vector<float>& values,
                         const std::vector<std::size_t>& first) {
    std::vector<float> means;
    for (std::size_t i = 0; i + 1 < first.size(); ++i) {
        double sum = 0.0;
        for (std::size_t k = first[i]; k < first[i + 1]; ++k)
            sum += values[k];
        means.push_back(float(sum / double(first[i + 1] - first[i])));
    }
    return means;
}

/// The mean error where the truth is not 0.
double inShadow(const std::vector<float>& found, const std::vector<float>& truth) {
    std::vector<std::uint8_t> dark(truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i)
        dark[i] = truth[i] > 0.0f;
    return baseline::measureErrors(found, truth, dark).mean;
}

/// Errors by point and, where there are pixels, by pixel.
struct Row {
    std::string method;
    Errors point;
    double inShadow = 0.0;  // by point
    std::optional<Errors> pixel;
    double microseconds = 0.0;  // per point, all threads at work
};

/// Rows by set of points, so that methods stand below each other.
class Table {
  public:
    explicit Table(double objectShare) : objectShare_(objectShare) {}

    void add(const std::string& method, const Probe& probe, const std::string& set,
             const std::vector<float>& found, double time) {
        Row row{method, baseline::measureErrors(found, probe.truth),
                inShadow(found, probe.truth), std::nullopt,
                1e6 * time / double(found.size())};
        const auto& first = probe.at->first;
        if (!first.empty())
            row.pixel =
                baseline::measureErrors(means(found, first), means(probe.truth, first));
        if (!rows_.count(set)) sets_.push_back(set);
        rows_[set].push_back(row);
    }

    void print() const {
        std::printf("\n%-20s %-30s | %8s %8s %8s %8s %9s | %8s %8s %8s %8s | %8s\n",
                    "points", "method", "mean", "std", "bias", "p99", "in shadow",
                    "px mean", "std", "bias", "p99", "us/point");
        for (const std::string& set : sets_) {
            for (const Row& row : rows_.at(set))
                printRow(set, row);
        }
        printImage();
    }

  private:
    static void printRow(const std::string& set, const Row& row) {
        const Errors& e = row.point;
        std::printf("%-20s %-30s | %8.5f %8.5f %+8.5f %8.5f %9.5f | ", set.c_str(),
                    row.method.c_str(), e.mean, e.deviation, e.bias, e.p99, row.inShadow);
        if (row.pixel)
            std::printf("%8.5f %8.5f %+8.5f %8.5f", row.pixel->mean, row.pixel->deviation,
                        row.pixel->bias, row.pixel->p99);
        else
            std::printf("%35s", "");
        std::printf(" | %8.2f\n", row.microseconds);
    }
    /// Both kinds of pixels, by their shares.
    void printImage() const {
        const auto object = rows_.find("object px"), floor = rows_.find("floor px");
        if (object == rows_.end() || floor == rows_.end()) return;
        for (std::size_t i = 0; i < object->second.size(); ++i)
            std::printf("%-20s %-30s | %46s | %8.5f\n", "whole image",
                        object->second[i].method.c_str(), "",
                        objectShare_ * object->second[i].pixel->mean +
                            (1 - objectShare_) * floor->second[i].pixel->mean);
    }

    double objectShare_;
    std::vector<std::string> sets_;
    std::map<std::string, std::vector<Row>> rows_;
};

void printMachine() {
    std::string line, name = "unknown processor";
    std::ifstream info("/proc/cpuinfo");
    while (std::getline(info, line)) {
        if (line.rfind("model name", 0) == 0) {
            name = line.substr(line.find(": ") + 2);
            break;
        }
    }
    const auto threads =
        tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
    std::printf("%s, %zu of %d threads; compiler %s%s\n", name.c_str(),
                std::min(threads, std::size_t(tbb::info::default_concurrency())),
                tbb::info::default_concurrency(), __VERSION__,
#ifdef NDEBUG
                ""
#else
                ", with assertions: times mean nothing"
#endif
    );
}

/// The measurement of one set of casters.
class Bench {
  public:
    Bench(const Options& options, CasterSource& casters, EmbreeReference scene)
        : options_(options),
          casters_(casters),
          scene_(std::move(scene)),
          stage_{scene_.boundsMin(), scene_.boundsMax()} {
        reference_.samples = options.truthSamples;
        if (options.cosine) reference_.weight = Weight::cosine;
    }

    int run() {
        takePoints();
        int worst = 0;
        for (const double share : options_.lights)
            worst = std::max(worst, measure(lightOf(share), share));
        return worst;
    }

  private:
    [[nodiscard]] glm::dvec3 towards() const {
        return glm::normalize(glm::dvec3(0.45, 0.8, 0.4));
    }
    [[nodiscard]] AreaLight lightOf(double share) const {
        AreaLight light;
        light.shape = LightShape::disk;
        light.position = stage_.centre() + 3.1 * stage_.size() * towards();
        light.direction = -towards();
        light.radius = 0.5 * share * stage_.size();
        return light;
    }

    void takePoints() {
        const std::size_t count = options_.objectPoints;
        sets_.push_back(bench::onFloor(stage_, options_.floorSide));
        sets_.push_back(bench::onMeshes(casters_, count, towards()));
        sets_.push_back(bench::onStrands(casters_, count, stage_));
        sets_.push_back(bench::inVolumes(casters_, count));
        bench::Picture picture = bench::takePicture(scene_, stage_, options_.pixels);
        objectShare_ = picture.objectShare;
        sets_.push_back(std::move(picture.object));
        sets_.push_back(std::move(picture.floor));
        for (const Receivers& set : sets_) {
            if (set.size() == 0) continue;
            std::printf("%-10s %8zu points", set.name.c_str(), set.size());
            if (!set.first.empty()) std::printf(", %zu pixels", set.first.size() - 1);
            std::printf("\n");
        }
        std::printf("object px are %.0f %% of the picture\n", 100 * objectShare_);
    }

    /// Everything for one light.
    int measure(const AreaLight& light, double share) {
        std::printf("\nlight of %g of the object's size\n", share);
        const double start = seconds();
        std::vector<Probe> probes;
        for (const Receivers& set : sets_) {
            if (set.size() == 0) continue;
            probes.push_back({&set, std::vector<float>(set.size())});
            trace(light, set, reference_, probes.back().truth);
        }
        std::printf("truth: %.1f s\n", seconds() - start);
        Table table(objectShare_);
        const int worst = measureMaps(light, probes, table);
        measureEmbree(light, probes, table);
        table.print();
        return worst;
    }

    void trace(const AreaLight& light, const Receivers& set,
               const baseline::ReferenceOptions& options, std::vector<float>& out) const {
        scene_.shadowFactors(light, set.truth.data(), set.normal.data(), set.size(),
                             out.data(), options);
    }

    void measureEmbree(const AreaLight& light, const std::vector<Probe>& probes,
                       Table& table) const {
        for (const int samples : options_.embreeSamples) {
            baseline::ReferenceOptions options = reference_;
            options.samples = samples;
            options.seed = 1;
            for (const Probe& probe : probes) {
                std::vector<float> found(probe.truth.size());
                const double start = seconds();
                trace(light, *probe.at, options, found);
                table.add("Embree, " + std::to_string(samples) + " samples", probe,
                          probe.at->name, found, seconds() - start);
            }
        }
    }

    int measureMaps(const AreaLight& light, const std::vector<Probe>& probes,
                    Table& table) {
        int worst = 0;
        for (const std::uint32_t resolution : options_.resolutions) {
            for (const std::uint32_t subsamples : options_.subsamples) {
                for (const auto& layers : optionals(options_.layers)) {
                    for (const auto& tolerance : optionals(options_.tolerances)) {
                        for (const auto& rounding : optionals(options_.roundings)) {
                            BakeOptions bakeOptions;
                            bakeOptions.light = light;
                            bakeOptions.width = bakeOptions.height = resolution;
                            bakeOptions.subsamples = subsamples;
                            bakeOptions.layers = layers;
                            bakeOptions.rounding = rounding;
                            if (tolerance) bakeOptions.tolerance = *tolerance;
                            worst =
                                std::max(worst, measureMap(bakeOptions, probes, table));
                        }
                    }
                }
            }
        }
        return worst;
    }
    template <typename T>
    static std::vector<std::optional<T>> optionals(const std::vector<T>& values) {
        if (values.empty()) return {std::nullopt};
        return {values.begin(), values.end()};
    }

    int measureMap(BakeOptions bakeOptions, const std::vector<Probe>& probes,
                   Table& table) {
        if (options_.opticalDepth) bakeOptions.layerOpticalDepth = *options_.opticalDepth;
        if (options_.layerLength) bakeOptions.layerLength = *options_.layerLength;
        std::string name = std::to_string(bakeOptions.width);
        if (bakeOptions.layers) name += " l" + std::to_string(*bakeOptions.layers);
        if (bakeOptions.subsamples > 1)
            name += " s" + std::to_string(bakeOptions.subsamples);
        if (options_.tolerances.size() > 1) {
            char tolerance[32];
            std::snprintf(tolerance, sizeof tolerance, " t%g",
                          double(bakeOptions.tolerance));
            name += tolerance;
        }
        if (options_.roundings.size() > 1) {
            char rounding[32];
            std::snprintf(rounding, sizeof rounding, " r%g",
                          double(*bakeOptions.rounding));
            name += rounding;
        }
        const double start = seconds();
        auto baked = bake(casters_, bakeOptions);
        const double time = seconds() - start;
        if (!baked) return complain(baked.error());
        const BakeReport& report = baked->report;
        const auto file = encodeMap(baked->map);
        std::printf(
            "map %-16s bake %.2f s (read %.2f, raster %.2f, compress %.2f, %llu passes), "
            "%.2f M layers, %.1f MB in memory, %.1f MB file\n",
            name.c_str(), time, report.readSeconds, report.rasterSeconds,
            report.compressSeconds, static_cast<unsigned long long>(report.passes),
            1e-6 * double(baked->map.layerCount()),
            1e-6 * double(baked->map.memoryBytes()),
            file ? 1e-6 * double(file->size()) : 0.0);
        for (const Attenuation attenuation : options_.attenuations) {
            for (const int samples : options_.samples) {
                ShadowOptions query;
                query.samples = samples;
                query.attenuation = attenuation;
                if (options_.cosine) query.weight = Weight::cosine;
                if (options_.footprints >= 0.0) {
                    const Projection& p = baked->map.projection(0);
                    query.bias =
                        float(options_.footprints *
                              p.pixelFootprint(glm::length(stage_.centre() - p.eye)));
                }
                const std::string method =
                    "map " + name + ", " + std::to_string(samples) +
                    (attenuation == Attenuation::subtract ? " subtract" : "");
                for (const Probe& probe : probes)
                    queryMap(baked->map, query, method, probe, table);
            }
        }
        return 0;
    }

    /// Points with normals are asked for without, too.
    void queryMap(const ShadowMap& map, const ShadowOptions& query,
                  const std::string& method, const Probe& probe, Table& table) const {
        const Receivers& set = *probe.at;
        const bool both = set.hasNormals() && set.first.empty() && !options_.cosine;
        for (const bool normals : {true, false}) {
            if (!normals && !both) continue;
            std::vector<float> found(set.size());
            const double start = seconds();
            shadowFactors(map, map.info().light, set.position.data(),
                          normals ? set.normal.data() : nullptr, set.size(), found.data(),
                          query);
            table.add(method, probe, set.name + (normals ? "" : ", no normals"), found,
                      seconds() - start);
        }
    }

    const Options& options_;
    CasterSource& casters_;
    EmbreeReference scene_;
    bench::Stage stage_;
    baseline::ReferenceOptions reference_;
    std::vector<Receivers> sets_;
    double objectShare_ = 0.0;
};

int run(const Options& options) {
    printMachine();
    const auto casters = bench::openCasters(options.casters);
    const double start = seconds();
    auto scene = EmbreeReference::build(*casters);
    if (!scene) return complain(scene.error());
    std::printf("Embree: read and built in %.2f s, %.1f MB, %.1f MB at most\n",
                seconds() - start, 1e-6 * double(scene->memoryBytes()),
                1e-6 * double(scene->peakBytes()));
    std::printf("truth: %d samples; %s weights\n", options.truthSamples,
                options.cosine ? "cosine" : "uniform");
    return Bench(options, *casters, std::move(*scene)).run();
}

}  // namespace

int main(int argc, char** argv) {
    Options options;
    int threads = 0;
    CLI::App app{
        "The error of a baked map against ray tracing, on a floor and on the object, by "
        "point and by pixel of a picture; lists are tried in all combinations."};
    auto* files = app.add_option("file", options.casters.files,
                                 "The casters: meshes, .hair, .tfx, .vdb");
    app.add_option("--fur", options.casters.furSegments,
                   "Instead of files, a ball of fur with so many segments")
        ->excludes(files);
    app.add_option("--hair-width", options.casters.hairWidth, "Of strands in files");
    app.add_option("--hair-opacity", options.casters.hairOpacity, "Of strands in files");
    app.add_option("--density-scale", options.casters.densityScale, "Of volumes");
    app.add_option(
           "--light", options.lights,
           "Diameters of the disk light, as shares of the object's largest extent")
        ->delimiter(',');
    app.add_option("--resolution", options.resolutions, "Pixels per side of the map")
        ->delimiter(',');
    app.add_option("--layers", options.layers, "Layers per pixel (default: as the bake)")
        ->delimiter(',');
    app.add_option("--subsamples", options.subsamples, "Centre rays per side of a pixel")
        ->delimiter(',');
    app.add_option("--tolerance", options.tolerances, "Of the map (default: as the bake)")
        ->delimiter(',');
    app.add_option("--rounding", options.roundings, "Of the map (default: as the bake)")
        ->delimiter(',');
    app.add_option("--optical-depth", options.opticalDepth, "A layer's at most");
    app.add_option("--layer-length", options.layerLength,
                   "A layer's at most, in pixel footprints");
    app.add_option("--samples", options.samples, "Rays per point through the map")
        ->delimiter(',');
    app.add_option("--attenuation", options.attenuations, "multiply, subtract")
        ->delimiter(',')
        ->transform(CLI::CheckedTransformer(std::map<std::string, Attenuation>{
            {"multiply", Attenuation::multiply}, {"subtract", Attenuation::subtract}}));
    app.add_option("--embree", options.embreeSamples,
                   "Rays per point of ray tracing to compare with; 0: none")
        ->delimiter(',');
    app.add_option("--truth", options.truthSamples, "Rays per point of the truth");
    app.add_option("--floor", options.floorSide, "Points per side of the floor");
    app.add_option("--object", options.objectPoints, "Points on the object");
    app.add_option("--pixels", options.pixels,
                   "Pixels of the object and of the floor, 16 points each");
    app.add_option(
        "--footprints", options.footprints,
        "Bias in pixel footprints at the object's centre (default: the map's own)");
    app.add_flag("--cosine", options.cosine,
                 "Ratio of irradiances instead of the plain mean");
    app.add_option("--threads", threads, "Threads (default: all)");
    CLI11_PARSE(app, argc, argv);
    if (options.casters.files.empty() && options.casters.furSegments == 0) {
        std::fprintf(stderr, "bench_accuracy: give files or --fur\n");
        return 2;
    }
    if (options.embreeSamples == std::vector<int>{0}) options.embreeSamples.clear();
    std::unique_ptr<tbb::global_control> limit;
    if (threads > 0)
        limit = std::make_unique<tbb::global_control>(
            tbb::global_control::max_allowed_parallelism, std::size_t(threads));
    return run(options);
}
