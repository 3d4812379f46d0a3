// bench_rays MAP.mtsm... - the fast trace beside the definition, on maps of any kind and
// of one face or six: shadow factors of points, and a caller's rays in runs of one origin
// or each from elsewhere. Processor time of one thread, both ways in turn.
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <glm/geometric.hpp>
#include <random>
#include <vector>

#include "light/sample.h"
#include "mtsm/reader.h"
#include "mtsm/shadow.h"

namespace {

using namespace mtsm;

double processorTime() {
    timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
}

/// Eight footprints behind layers, pixel by pixel as in a picture; or behind all of them.
std::vector<glm::dvec3> receivers(const ShadowMap& map, bool behind, std::size_t count) {
    std::mt19937_64 random(1);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    const std::uint32_t width = map.info().width, height = map.info().height;
    std::vector<glm::dvec3> points;
    const double every = std::max(
        1.0, std::sqrt(double(width) * height * map.faceCount() / double(count)));
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        const Projection& p = map.projection(f);
        for (double y = 0.5 * every; y < height; y += every) {
            for (double x = 0.5 * every; x < width; x += every) {
                const PixelLayers pixel =
                    map.pixel(f, std::uint32_t(x), std::uint32_t(y));
                if (pixel.count == 0) continue;
                double z = pixel.z[std::size_t(unit() * pixel.count)];
                if (behind) z = 1.3 * map.zRange(f).max;
                z += 8.0 * p.pixelFootprint(z);
                points.push_back(
                    p.worldFromLight(p.lightFromRaster({x + unit(), y + unit()}, z)));
            }
        }
    }
    return points;
}

/// To random points on the light, `each` from every origin.
std::vector<ShadowRay> raysTo(const AreaLight& light,
                              const std::vector<glm::dvec3>& points, int each) {
    std::mt19937_64 random(2);
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    const light::LightSampler sampler(light);
    std::vector<ShadowRay> rays;
    for (const glm::dvec3& p : points) {
        for (int i = 0; i < each; ++i) {
            const double u = unit(), v = unit();
            const light::LightSample sample = sampler.sample(p, {u, v});
            const double length = glm::length(sample.delta);
            rays.push_back(
                {p, sample.delta / length, sample.endless ? HUGE_VAL : length});
        }
    }
    return rays;
}

struct Compared {
    double nanoseconds = 0.0, ratio = 0.0, mean = 0.0, away = 0.0;
};

/// Median of five, in turn.
template <typename Run>
Compared compare(std::size_t count, const Run& run) {
    std::vector<float> out[2] = {std::vector<float>(count), std::vector<float>(count)};
    std::vector<double> times[2];
    for (int i = 0; i < 5; ++i) {
        for (const bool scalar : {false, true}) {
            const double start = processorTime();
            run(scalar ? ShadowMethod::scalar : ShadowMethod::trace, out[scalar].data());
            times[scalar].push_back(processorTime() - start);
        }
    }
    for (auto& t : times)
        std::sort(t.begin(), t.end());
    Compared c;
    c.nanoseconds = 1e9 * times[0][2] / double(count);
    c.ratio = times[1][2] / times[0][2];
    for (std::size_t i = 0; i < count; ++i) {
        c.mean += double(out[0][i] - out[1][i]) / double(count);
        c.away += std::abs(double(out[0][i] - out[1][i])) / double(count);
    }
    return c;
}

void print(const char* what, const Compared& c) {
    std::printf("  %-28s %9.0f ns, %5.1f times; differs by %.4f, mean %+.4f\n", what,
                c.nanoseconds, c.ratio, c.away, c.mean);
}

void measure(const ShadowMap& map) {
    const AreaLight& light = map.info().light;
    prepareQueries(map);
    for (const bool behind : {false, true}) {
        std::printf(" %s\n", behind ? "behind all layers" : "behind a layer");
        const std::vector<glm::dvec3> points = receivers(map, behind, 4000);
        for (const int samples : {16, 64}) {
            const Compared c =
                compare(points.size(), [&](ShadowMethod method, float* out) {
                    ShadowOptions options;
                    options.samples = samples;
                    options.method = method;
                    shadowFactors(map, light, points.data(), nullptr, points.size(), out,
                                  options);
                });
            char what[64];
            std::snprintf(what, sizeof what, "points, %d samples", samples);
            print(what, c);
        }
        for (const int each : {1, 4, 16, 64, -4, -16, -64}) {
            const std::vector<ShadowRay> rays = raysTo(light, points, std::abs(each));
            const Compared c = compare(rays.size(), [&](ShadowMethod method, float* out) {
                RayOptions options;
                options.method = method;
                // Of the light as seen from halfway on.
                const double distance =
                    glm::length(points[points.size() / 2] - light.position);
                if (each < 0)
                    options.spread =
                        float(lightRadius(light) / distance * std::sqrt(3.14 / -each));
                visibilities(map, rays.data(), rays.size(), out, options);
            });
            char what[64];
            std::snprintf(what, sizeof what, "rays, %d of an origin%s", std::abs(each),
                          each < 0 ? ", spread" : "");
            print(what, c);
        }
        const std::vector<ShadowRay> rays = raysTo(light, points, 1);
        print("rays, one a call",
              compare(rays.size(), [&](ShadowMethod method, float* out) {
                  RayOptions options;
                  options.method = method;
                  for (std::size_t i = 0; i < rays.size(); ++i)
                      out[i] = visibility(map, rays[i], options);
              }));
    }
}

}  // namespace

int main(int count, char** files) {
    tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    for (int i = 1; i < count; ++i) {
        const Result<ShadowMap> map = readMap(files[i]);
        if (!map) {
            std::fprintf(stderr, "%s\n", map.error().message.c_str());
            return 1;
        }
        std::printf("%s\n", files[i]);
        measure(*map);
    }
}
