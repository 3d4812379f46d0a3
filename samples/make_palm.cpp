// mtsm-make-palm - writes a sample scene: a palm of thin blades.
//
//     mtsm-make-palm -n 310000 -o palm.ply
//
// Fronds arch out from the top of a leaning trunk; each has two rows of blades, long and
// a few millimetres wide, bent down by their weight. There is nothing between the blades:
// what a light sees of the palm is mostly gaps thinner than a pixel. y is up, lengths are
// in metres. The same arguments give the same bytes. The file is binary PLY, or OBJ with
// the groups "trunk" and "blades" if its name says so.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "ply_text.h"
#include "write_file.h"

namespace {

constexpr int kFronds = 32;
constexpr int kBladeSegments = 6;
constexpr int kTrianglesPerBlade = 2 * kBladeSegments - 1;  // the last is a tip
constexpr int kTrunkSides = 24, kTrunkRings = 60;
constexpr double kTrunkHeight = 5.0, kFrondLength = 2.6;

struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;
    std::size_t trunkIndices = 0;  // the first so many are the trunk's

    std::uint32_t add(glm::dvec3 p) {
        positions.emplace_back(p);
        return std::uint32_t(positions.size() - 1);
    }
    void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
        indices.insert(indices.end(), {a, b, c});
    }
};

/// A number in [0, 1) from two: the low bits of a hash, so that the order of generation
/// does not matter.
double random(std::uint32_t a, std::uint32_t b) {
    std::uint32_t h = a * 0x9e3779b9u + b * 0x85ebca6bu + 0x27d4eb2fu;
    for (int i = 0; i < 2; ++i) {
        h = (h ^ h >> 15) * 0x2c1b3c6du;
        h = (h ^ h >> 12) * 0x297a2d39u;
    }
    return double(h ^ h >> 15) / 4294967296.0;
}

/// The middle of the trunk at a height of t, 0 to 1.
glm::dvec3 trunkAt(double t) {
    return {0.5 * t * t, kTrunkHeight * t, 0.15 * std::sin(2.5 * t)};
}

void addTrunk(Mesh& mesh) {
    std::vector<std::uint32_t> below;
    for (int r = 0; r <= kTrunkRings; ++r) {
        const double t = double(r) / kTrunkRings;
        // Old leaf scars: the trunk is stepped.
        const double radius = (0.17 - 0.07 * t) * (r % 2 ? 1.0 : 1.08);
        std::vector<std::uint32_t> ring;
        for (int k = 0; k < kTrunkSides; ++k) {
            const double turn = glm::two_pi<double>() * k / kTrunkSides;
            ring.push_back(mesh.add(
                trunkAt(t) + radius * glm::dvec3(std::cos(turn), 0, -std::sin(turn))));
        }
        for (std::size_t k = 0; r > 0 && k < ring.size(); ++k) {
            const std::size_t next = (k + 1) % ring.size();
            mesh.triangle(below[k], below[next], ring[next]);
            mesh.triangle(below[k], ring[next], ring[k]);
        }
        below = ring;
    }
    mesh.trunkIndices = mesh.indices.size();
}

/// A frond's midrib: where it is, and its frame there.
struct Frond {
    glm::dvec3 root, out;  // out: away from the trunk, level
    double rise, droop;

    /// s from 0 at the trunk to 1 at the tip.
    [[nodiscard]] glm::dvec3 at(double s) const {
        const double x = kFrondLength * s;
        const double y = rise * x - droop * x * x;
        return root + x * (1.0 - 0.12 * s) * out + y * glm::dvec3(0, 1, 0);
    }
    [[nodiscard]] glm::dvec3 along(double s) const {
        return glm::normalize(at(s + 1e-4) - at(s - 1e-4));
    }
};

Frond frondOf(std::uint32_t f) {
    // Spread by the golden angle; the inner ones stand up, the outer ones hang.
    const double turn = 2.399963229728653 * f, age = (f + 0.5) / kFronds;
    return {trunkAt(1.0),
            {std::cos(turn), 0, -std::sin(turn)},
            1.5 - 1.6 * age + 0.2 * random(f, 1),
            0.28 + 0.12 * random(f, 2)};
}

/// One blade: a strip that narrows to a tip, hanging more and more towards it.
void addBlade(Mesh& mesh, const Frond& frond, double s, double side, std::uint32_t seed) {
    const glm::dvec3 along = frond.along(s);
    const glm::dvec3 across =
        glm::normalize(glm::cross(along, glm::dvec3(0, 1, 0))) * side;
    const double lean = 0.5 + 0.4 * s + 0.1 * random(seed, 3);
    const double length = 0.7 * std::sin(glm::pi<double>() * (0.12 + 0.83 * s)) *
                          (0.9 + 0.2 * random(seed, 4));
    const double width = 0.012 + 0.004 * random(seed, 5);
    const double sag = 0.35 + 0.25 * random(seed, 6);
    const glm::dvec3 heading = glm::normalize(across + lean * along);
    const glm::dvec3 flat = glm::normalize(along - glm::dot(along, heading) * heading);
    const auto middle = [&](double q) {
        return frond.at(s) + length * (q * heading - sag * q * q * glm::dvec3(0, 1, 0));
    };
    std::uint32_t left = 0, right = 0;
    for (int i = 0; i < kBladeSegments; ++i) {
        const double q = double(i) / kBladeSegments;
        const glm::dvec3 half =
            0.5 * width * (1.0 - q * q) * std::min(1.0, 0.4 + 3 * q) * flat;
        const std::uint32_t a = mesh.add(middle(q) - half),
                            b = mesh.add(middle(q) + half);
        if (i > 0) {
            mesh.triangle(left, right, b);
            mesh.triangle(left, b, a);
        }
        left = a;
        right = b;
    }
    mesh.triangle(left, right, mesh.add(middle(1.0)));
}

Mesh makePalm(std::uint64_t triangles) {
    Mesh mesh;
    addTrunk(mesh);
    const std::uint64_t forBlades =
        triangles - std::min<std::uint64_t>(triangles, mesh.indices.size() / 3);
    const auto blades = std::max<std::uint32_t>(
        1, std::uint32_t((forBlades + kFronds * kTrianglesPerBlade) /
                         (2 * kFronds * kTrianglesPerBlade)));  // on a side of a frond
    for (std::uint32_t f = 0; f < kFronds; ++f) {
        const Frond frond = frondOf(f);
        for (std::uint32_t i = 0; i < blades; ++i) {
            const std::uint32_t seed = (f * blades + i) * 2;
            for (const std::uint32_t side : {0u, 1u}) {
                const double jitter = random(seed + side, 7) - 0.5;
                const double s = 0.08 + 0.9 * (i + 0.5 + 0.8 * jitter) / blades;
                addBlade(mesh, frond, s, side ? 1.0 : -1.0, seed + side);
            }
        }
    }
    return mesh;
}

// --- the file ------------------------------------------------------------------------

std::string objOf(const Mesh& mesh) {
    std::string text = "# mtsm-make-palm\n";
    char line[96];
    for (const glm::vec3& p : mesh.positions) {
        std::snprintf(line, sizeof(line), "v %.7g %.7g %.7g\n", double(p.x), double(p.y),
                      double(p.z));
        text += line;
    }
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        if (i == 0) text += "o trunk\n";
        if (i == mesh.trunkIndices) text += "o blades\n";
        std::snprintf(line, sizeof(line), "f %u %u %u\n", mesh.indices[i] + 1,
                      mesh.indices[i + 1] + 1, mesh.indices[i + 2] + 1);
        text += line;
    }
    return text;
}

}  // namespace

int main(int argc, char** argv) {
    std::uint64_t triangles = 310000;
    std::string output = "palm.ply";
    CLI::App app{
        "Writes a sample scene: a palm of thin blades, about 6 metres high, its foot at\n"
        "the origin. As binary PLY, or as OBJ with the objects \"trunk\" and \"blades\".",
        "mtsm-make-palm"};
    app.add_option("-n,--triangles", triangles,
                   "Triangles of the palm; the nearest number with as many blades on\n"
                   "all sides of all fronds is made")
        ->check(CLI::Range(std::uint64_t(4000), std::uint64_t(100'000'000)))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .ply or .obj")
        ->check([](const std::string& path) {
            return checkEnding(path, {".ply", ".obj"});
        })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-palm\n  mtsm-make-palm -n 20000 -o small.obj\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    const Mesh mesh = makePalm(triangles);
    const bool obj = std::filesystem::path(output).extension() == ".obj";
    const std::string problem =
        writeFile(output, obj ? objOf(mesh)
                              : plyOf("mtsm-make-palm", mesh.positions, mesh.indices));
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-palm: %s: cannot be written: %s\n",
                     output.c_str(), problem.c_str());
        return 3;
    }
    std::fprintf(stderr, "%s: palm of %zu triangles, %d fronds\n", output.c_str(),
                 mesh.indices.size() / 3, kFronds);
    return 0;
}
