// mtsm-make-character - writes a sample mesh: a stout figure with ears, arms akimbo, a
// belt and boots, closed and smooth, of about as many triangles as one asks for.
//
//     mtsm-make-character -n 316000 -o character.ply
//
// The figure is 2 units high and stands on y = 0, facing +z. It is where a distance
// function is zero: rounded parts that blend into each other, with folds and warts. The
// same arguments give the same file.
#include <openvdb/openvdb.h>
#include <openvdb/tools/VolumeToMesh.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "ply_text.h"
#include "write_file.h"

namespace {

// --- the figure: signed distances, at least roughly
// --------------------------------------------------------------------

double capsule(glm::dvec3 p, glm::dvec3 a, glm::dvec3 b, double ra, double rb) {
    const glm::dvec3 ab = b - a;
    const double t = std::clamp(glm::dot(p - a, ab) / glm::dot(ab, ab), 0.0, 1.0);
    return glm::length(p - a - t * ab) - glm::mix(ra, rb, t);
}

double ellipsoid(glm::dvec3 p, glm::dvec3 centre, glm::dvec3 radii) {
    const double k = glm::length((p - centre) / radii);
    return (k - 1.0) * std::min({radii.x, radii.y, radii.z});
}

/// A ring around y, of a flat cross-section.
double belt(glm::dvec3 p, double y, glm::dvec2 radii, double height) {
    const double around = glm::length(glm::dvec2(p.x, p.z) / radii) - 1.0;
    const double side = std::abs(around) * std::min(radii.x, radii.y) - 0.02;
    return std::max(side, std::abs(p.y - y) - height);
}

/// The union of two shapes, rounded where they meet within about k.
double blend(double a, double b, double k) {
    const double h = std::max(k - std::abs(a - b), 0.0) / k;
    return std::min(a, b) - 0.25 * h * h * k;
}

/// Half of the figure and its mirror image.
double limbs(glm::dvec3 p, double body) {
    const glm::dvec3 q(std::abs(p.x), p.y, p.z);
    double d = body;
    // Arms akimbo: shoulder, elbow, hand at the hip; fingers.
    d = blend(d, capsule(q, {0.27, 1.24, 0}, {0.62, 1.0, -0.05}, 0.105, 0.085), 0.08);
    d = blend(d, capsule(q, {0.62, 1.0, -0.05}, {0.43, 0.74, 0.12}, 0.085, 0.07), 0.04);
    for (int finger = 0; finger < 4; ++finger) {
        const double f = 0.035 * (finger - 1.5);
        d = blend(d,
                  capsule(q, {0.43, 0.74 + 0.3 * f, 0.12 + f},
                          {0.345, 0.66 + 0.5 * f, 0.2 + f}, 0.03, 0.022),
                  0.02);
    }
    // Legs and boots.
    d = blend(d, capsule(q, {0.17, 0.62, 0}, {0.2, 0.16, 0.0}, 0.15, 0.1), 0.08);
    d = std::min(d, capsule(q, {0.2, 0.2, 0.0}, {0.2, 0.12, 0.01}, 0.13, 0.12));
    d = blend(d, ellipsoid(q, {0.22, 0.075, 0.1}, {0.115, 0.075, 0.22}), 0.05);
    d = std::min(d, belt(q - glm::dvec3(0.2, 0, 0), 0.3, {0.135, 0.135}, 0.025));
    // Ears like trumpets.
    d = blend(d, capsule(q, {0.2, 1.72, 0}, {0.36, 1.84, -0.02}, 0.035, 0.03), 0.04);
    const double bell = ellipsoid(q, {0.385, 1.86, -0.02}, {0.05, 0.06, 0.05});
    const double hole = ellipsoid(q, {0.42, 1.88, -0.01}, {0.035, 0.045, 0.035});
    return std::max(blend(d, bell, 0.03), -hole);
}

double head(glm::dvec3 p) {
    double d = ellipsoid(p, {0, 1.62, 0.02}, {0.25, 0.29, 0.26});
    d = blend(d, ellipsoid(p, {0, 1.5, 0.1}, {0.22, 0.15, 0.2}), 0.1);      // chin
    d = blend(d, ellipsoid(p, {0, 1.6, 0.29}, {0.065, 0.06, 0.07}), 0.05);  // nose
    const glm::dvec3 q(std::abs(p.x), p.y, p.z);
    d = blend(d, capsule(q, {0.03, 1.735, 0.235}, {0.14, 1.745, 0.19}, 0.035, 0.03),
              0.03);  // brows
    d = std::max(d, -ellipsoid(q, {0.095, 1.68, 0.28}, {0.045, 0.035, 0.06}));
    d = std::min(d, ellipsoid(q, {0.095, 1.68, 0.225}, {0.035, 0.035, 0.035}));  // eyes
    return std::max(d, -capsule(q, {0, 1.47, 0.3}, {0.1, 1.485, 0.26}, 0.014, 0.008));
}

double figure(glm::dvec3 p) {
    double body = ellipsoid(p, {0, 0.92, 0.03}, {0.36, 0.42, 0.34});
    body = blend(body, ellipsoid(p, {0, 1.2, -0.02}, {0.33, 0.22, 0.22}), 0.15);
    // Folds of a shirt, and its hem.
    body += 0.008 * std::sin(38.0 * p.y + 6.0 * p.x) *
            std::max(0.0, 1.0 - 4.0 * std::abs(p.y - 1.05));
    body = std::min(body, belt(p, 0.74, {0.36, 0.345}, 0.045));
    body = std::min(body, ellipsoid(p, {0, 0.74, 0.375}, {0.07, 0.06, 0.03}));
    const double d = blend(limbs(p, body), head(p), 0.06);
    // Warts and pores.
    return d - 0.003 * std::sin(61.0 * p.x) * std::sin(53.0 * p.y) * std::sin(57.0 * p.z);
}

// --- the mesh
// --------------------------------------------------------------------------

struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;
};

/// Distances in voxels around the surface, block by block.
openvdb::FloatGrid::Ptr sampled(double voxel) {
    constexpr int kBlock = 8;
    const float outside = 3.0f;
    auto grid = openvdb::FloatGrid::create(outside);
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    grid->setTransform(openvdb::math::Transform::createLinearTransform(voxel));
    auto access = grid->getAccessor();
    const auto cells = [&](double length) { return int(std::ceil(length / voxel)); };
    const double reach = 1.5 * std::sqrt(3.0) * kBlock * voxel;  // distances are rough
    for (int z = cells(-0.6) - kBlock; z < cells(0.7); z += kBlock) {
        for (int y = cells(-0.1) - kBlock; y < cells(2.1); y += kBlock) {
            for (int x = cells(-0.9) - kBlock; x < cells(0.9); x += kBlock) {
                const glm::dvec3 middle =
                    voxel * (glm::dvec3(x, y, z) + 0.5 * (kBlock - 1));
                const double there = figure(middle);
                for (int i = 0; i < kBlock * kBlock * kBlock; ++i) {
                    const openvdb::Coord at(x + i % 8, y + i / 8 % 8, z + i / 64);
                    const double d =
                        std::abs(there) > reach
                            ? there
                            : figure(voxel * glm::dvec3(at.x(), at.y(), at.z()));
                    const auto value =
                        float(std::clamp(d / voxel, -double(outside), double(outside)));
                    if (value < outside) access.setValue(at, value);
                }
            }
        }
    }
    return grid;
}

Mesh meshOf(double voxel) {
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec4I> quads;
    openvdb::tools::volumeToMesh(*sampled(voxel), points, quads, 0.0);
    Mesh mesh;
    float lowest = 1e9f;
    for (const openvdb::Vec3s& p : points)
        lowest = std::min(lowest, p.y());
    for (const openvdb::Vec3s& p : points)
        mesh.positions.emplace_back(p.x(), p.y() - lowest, p.z());
    for (const openvdb::Vec4I& q : quads) {
        // OpenVDB turns its quads inwards.
        for (const int corner : {0, 2, 1, 0, 3, 2})
            mesh.indices.push_back(q[corner]);
    }
    return mesh;
}

/// The number of triangles goes with the square of the voxels' number.
Mesh makeCharacter(std::uint64_t triangles) {
    double voxel = 0.02;
    Mesh mesh = meshOf(voxel);
    for (int pass = 0; pass < 2; ++pass) {
        voxel *= std::sqrt(double(mesh.indices.size() / 3) / double(triangles));
        mesh = meshOf(voxel);
    }
    return mesh;
}

}  // namespace

int main(int argc, char** argv) {
    std::uint64_t triangles = 316000;
    std::string output = "character.ply";
    CLI::App app{
        "Writes a sample mesh as binary PLY: a stout figure, 2 units high, that stands "
        "on\n"
        "the plane y = 0 and looks along +z; one closed, smooth surface.",
        "mtsm-make-character"};
    app.add_option("-n,--triangles", triangles,
                   "Triangles; within a few percent of it are made")
        ->check(CLI::Range(std::uint64_t(10000), std::uint64_t(20'000'000)))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .ply")
        ->check([](const std::string& path) { return checkEnding(path, {".ply"}); })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-character\n  mtsm-make-character -n 20000 -o "
        "small.ply\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    openvdb::initialize();
    const Mesh mesh = makeCharacter(triangles);
    const std::string problem =
        writeFile(output, plyOf("mtsm-make-character", mesh.positions, mesh.indices));
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-character: %s: cannot be written: %s\n",
                     output.c_str(), problem.c_str());
        return 3;
    }
    std::fprintf(stderr, "%s: figure of %zu triangles\n", output.c_str(),
                 mesh.indices.size() / 3);
    return 0;
}
