// bench_radiance - what [Heckbert97] says of radiance textures, with our numbers: error
// against the grid of light samples, regular and jittered (sec. 3.7); time against
// samples; time and casters looked at against the number s of polygons when all of them
// receive, without and with culling: s^2 and s^1.3 (sec. 3.9). Prints Markdown tables;
// times are CPU seconds, of all threads together, the least of three runs.
//
//     bench_radiance
//     bench_radiance --threads 1 --polygons 500,1000,2000,4000,8000
#include <tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <glm/geometric.hpp>
#include <random>

#include "baseline/radiance_texture.h"
#include "bumpy_mesh.h"

namespace {

using namespace mtsm;
using namespace mtsm::baseline;
using test::Mesh;

constexpr int kTruthSide = 96;

ShadowCasters castersOf(const MeshView& mesh) {
    CasterViews source({mesh});
    auto casters = ShadowCasters::build(source);
    if (!casters) std::abort();
    return std::move(*casters);
}

std::vector<RadianceTexture> texturesOf(const ShadowCasters& casters,
                                        const std::vector<RadianceReceiver>& receivers,
                                        const AreaLight& light,
                                        const RadianceOptions& options) {
    auto textures =
        radianceTextures(casters, receivers, {{light, glm::dvec3(1.0)}}, options);
    if (!textures) std::abort();
    return std::move(*textures);
}

/// CPU seconds.
template <typename Work>
double bestSeconds(const Work& work) {
    double best = 1e300;
    for (int run = 0; run < 3; ++run) {
        const std::clock_t start = std::clock();
        work();
        best = std::min(best, double(std::clock() - start) / CLOCKS_PER_SEC);
    }
    return best;
}

AreaLight rectAbove(glm::dvec3 position, double side) {
    AreaLight light;
    light.shape = LightShape::rect;
    light.position = position;
    light.direction = {0, -1, 0};
    light.size = {side, side};
    return light;
}

RadianceReceiver floorOf(double half) {
    return parallelogramReceiver({{-half, 0, half}, {2 * half, 0, 0}, {0, 0, -2 * half}});
}

struct ErrorOf {
    double mean = 0.0, largest = 0.0, step = 0.0;
};

/// Of visibility against the truth; step: the largest between neighbours in a row.
ErrorOf errorOf(const RadianceTexture& found, const RadianceTexture& truth) {
    const std::vector<float>&v = found.visibility[0], &t = truth.visibility[0];
    ErrorOf error;
    for (std::size_t i = 0; i < v.size(); ++i) {
        const double off = std::abs(double(v[i]) - t[i]);
        error.mean += off / double(v.size());
        error.largest = std::max(error.largest, off);
        if (i % found.width > 0)
            error.step = std::max(error.step, std::abs(double(v[i]) - v[i - 1]));
    }
    return error;
}

void errorTable(const char* scene, const ShadowCasters& casters) {
    const AreaLight light = rectAbove({0, 5, 0}, 2.0);
    RadianceOptions options;
    options.resolution = 256;
    options.radiance = false;
    options.samplesPerSide = kTruthSide;
    options.seed = 77;
    const auto visibility = [&] {
        return std::move(texturesOf(casters, {floorOf(3)}, light, options).front());
    };
    const RadianceTexture truth = visibility();
    std::printf(
        "\n%s: error of visibility, 256 x 256 texels, truth %d x %d samples\n\n"
        "| grid | jittered: mean | largest | step | regular: mean | largest | step |\n"
        "|---|---|---|---|---|---|---|\n",
        scene, kTruthSide, kTruthSide);
    options.seed = 0;
    for (const int n : {2, 4, 8, 16}) {
        options.samplesPerSide = n;
        std::printf("| %d x %d |", n, n);
        for (const LightGrid grid : {LightGrid::jittered, LightGrid::regular}) {
            options.grid = grid;
            const ErrorOf e = errorOf(visibility(), truth);
            std::printf(" %.4f | %.3f | %.3f |", e.mean, e.largest, e.step);
        }
        std::printf("\n");
    }
}

void sampleTable(const ShadowCasters& casters) {
    RadianceOptions options;
    options.resolution = 512;
    std::printf(
        "\nTime against samples: %llu triangles onto one floor of 512 x 512 texels\n\n"
        "| samples | CPU seconds | ms per sample |\n|---|---|---|\n",
        static_cast<unsigned long long>(casters.triangles()));
    for (const int n : {1, 2, 4, 8, 16}) {
        options.samplesPerSide = n;
        const double seconds = bestSeconds([&] {
            (void)texturesOf(casters, {floorOf(3)}, rectAbove({0, 5, 0}, 2.0), options);
        });
        std::printf("| %d | %.3f | %.2f |\n", n * n, seconds, 1e3 * seconds / (n * n));
    }
}

/// `count` triangles in the unit cube at random, about as large as keeps the number that
/// a ray meets the same for any count.
Mesh triangleSoup(std::size_t count) {
    std::mt19937 random(4);
    std::uniform_real_distribution<float> unit(-0.5f, 0.5f);
    const float size = 1.5f / std::sqrt(float(count));
    Mesh soup;
    for (std::size_t i = 0; i < 3 * count; ++i) {
        static glm::vec3 at;
        if (i % 3 == 0) at = {unit(random), unit(random), unit(random)};
        soup.indices.push_back(std::uint32_t(i));
        soup.positions.push_back(
            at + size * glm::vec3(unit(random), unit(random), unit(random)));
    }
    return soup;
}

void polygonTable(const std::vector<std::size_t>& counts) {
    RadianceOptions options;
    options.resolution = 8;
    options.samplesPerSide = 2;
    std::printf(
        "\nTime against polygons: all of s triangles cast and receive, 8 texels on a "
        "side, 4 samples\n\n"
        "| s | all: CPU seconds | drawn per image | culled: CPU seconds | drawn per "
        "image |\n"
        "|---|---|---|---|---|\n");
    double first[2] = {}, last[2] = {}, drawnFirst[2] = {}, drawnLast[2] = {};
    for (const std::size_t s : counts) {
        const Mesh soup = triangleSoup(s);
        const ShadowCasters casters = castersOf(soup.view());
        std::vector<RadianceReceiver> receivers;
        for (std::size_t i = 0; i < soup.positions.size(); i += 3)
            receivers.push_back(triangleReceiver(soup.positions[i], soup.positions[i + 1],
                                                 soup.positions[i + 2]));
        std::printf("| %zu |", s);
        for (const bool cull : {false, true}) {
            options.cull = cull;
            std::uint64_t looked = 0, images = 0;
            last[cull] = bestSeconds([&] {
                looked = images = 0;
                for (const RadianceTexture& t :
                     texturesOf(casters, receivers, rectAbove({0, 3, 0}, 0.5), options)) {
                    looked += t.looked;
                    images += std::uint64_t(t.samples[0]);
                }
            });
            drawnLast[cull] = double(looked);
            if (s == counts.front()) {
                first[cull] = last[cull];
                drawnFirst[cull] = drawnLast[cull];
            }
            std::printf(" %.4f | %.0f |", last[cull], double(looked) / double(images));
        }
        std::printf("\n");
    }
    const double ratio = std::log(double(counts.back()) / double(counts.front()));
    const auto exponent = [&](const double* from, const double* to, bool cull) {
        return std::log(to[cull] / from[cull]) / ratio;
    };
    if (!(ratio > 0.0)) return;
    std::printf(
        "\nWithout culling time grows as s^%.2f and triangles drawn as s^%.2f, with "
        "it as s^%.2f and s^%.2f.\n",
        exponent(first, last, false), exponent(drawnFirst, drawnLast, false),
        exponent(first, last, true), exponent(drawnFirst, drawnLast, true));
}

void run(const std::vector<std::size_t>& polygons) {
    const Mesh coarse = test::bumpyBody(2'000), fine = test::bumpyBody(60'000);
    const auto standing = [](const Mesh& body) {
        MeshView view = body.view();
        view.worldFromObject[3] = glm::dvec4(0, 1.3, 0, 1.0);
        return view;
    };
    errorTable("A bumpy body", castersOf(standing(coarse)));
    Mesh square;
    square.positions = {{-1, 2, 1}, {1, 2, 1}, {1, 2, -1}, {-1, 2, -1}};
    square.indices = {0, 1, 2, 0, 2, 3};
    errorTable("A square with edges along the light's", castersOf(square.view()));
    sampleTable(castersOf(standing(fine)));
    polygonTable(polygons);
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app("The claims of radiance textures, measured.");
    int threads = tbb::task_arena::automatic;
    std::vector<std::size_t> polygons{250, 500, 1000, 2000, 4000};
    app.add_option("--threads", threads, "of the arena (default: the machine's)")
        ->check(CLI::Range(1, 1024));
    app.add_option("--polygons", polygons, "counts s, rising")
        ->delimiter(',')
        ->check(CLI::Range(1, 1000000));
    CLI11_PARSE(app, argc, argv);
    tbb::task_arena arena(threads);
    arena.execute([&] { run(polygons); });
    return 0;
}
