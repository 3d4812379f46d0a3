// make_passes - position and normal passes of meshes on a floor, as a renderer would
// write them: input for mtsm-query where there is no renderer at hand.
//
//     make_passes dragon.ply -o dragon          # dragon.P.exr, dragon.N.exr
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <limits>

#include "baseline/reference_embree.h"
#include "mtsm/image.h"
#include "mtsm/scene.h"

namespace {

using namespace mtsm;

struct Options {
    std::vector<std::string> meshes;
    std::string prefix;
    std::uint32_t width = 600, height = 300;
};

FloatImage vectorImage(std::uint32_t width, std::uint32_t height,
                       const std::vector<glm::dvec3>& values) {
    FloatImage image(width, height);
    const char* names[] = {"X", "Y", "Z"};
    for (int c = 0; c < 3; ++c) {
        std::vector<float> plane;
        for (const glm::dvec3& v : values)
            plane.push_back(float(v[c]));
        image.channels.push_back({names[c], std::move(plane)});
    }
    return image;
}

Status run(const Options& options) {
    MeshFiles casters(options.meshes);
    auto scene = baseline::EmbreeReference::build(casters);
    if (!scene) return scene.error();
    const glm::dvec3 low = scene->boundsMin(), high = scene->boundsMax();
    const glm::dvec3 centre = 0.5 * (low + high);
    const double size = glm::length(high - low);

    // A camera that looks down at the object, the floor under its lowest point.
    const glm::dvec3 eye = centre + size * glm::dvec3(0.5, 0.8, 1.5);
    const glm::dvec3 forward =
        glm::normalize(centre - 0.1 * size * glm::dvec3(0, 1, 0) - eye);
    const glm::dvec3 right = glm::normalize(glm::cross(forward, glm::dvec3(0, 1, 0)));
    const glm::dvec3 up = glm::cross(right, forward);
    const double perPixel = 0.75 / options.height;
    std::vector<glm::dvec3> positions, normals;
    const double nothing = std::numeric_limits<double>::quiet_NaN();
    for (std::uint32_t y = 0; y < options.height; ++y) {
        for (std::uint32_t x = 0; x < options.width; ++x) {
            const glm::dvec3 ray = forward +
                                   (x + 0.5 - 0.5 * options.width) * perPixel * right -
                                   (y + 0.5 - 0.5 * options.height) * perPixel * up;
            glm::dvec3 position(nothing), normal(0.0);
            if (const auto hit = scene->firstHit(eye, ray)) {
                position = hit->position;
                normal = hit->normal;
            } else if (ray.y < 0.0) {
                position = eye + (low.y - eye.y) / ray.y * ray;
                normal = {0, 1, 0};
            }
            positions.push_back(position);
            normals.push_back(normal);
        }
    }
    if (auto s = writeImageExr(options.prefix + ".P.exr",
                               vectorImage(options.width, options.height, positions));
        !s)
        return s;
    return writeImageExr(options.prefix + ".N.exr",
                         vectorImage(options.width, options.height, normals));
}

}  // namespace

int main(int argc, char** argv) {
    Options options;
    CLI::App app{"Position and normal passes of meshes on a floor."};
    app.add_option("mesh", options.meshes, "Mesh files")->required();
    app.add_option("-o", options.prefix, "Writes PREFIX.P.exr and PREFIX.N.exr")
        ->required();
    app.add_option("--width", options.width, "Pixels");
    app.add_option("--height", options.height, "Pixels");
    CLI11_PARSE(app, argc, argv);
    const Status done = run(options);
    if (!done) {
        std::fprintf(stderr, "make_passes: %s\n", done.error().message.c_str());
        return exitCode(done.error().code);
    }
    return 0;
}
