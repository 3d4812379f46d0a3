// mtsm-make-smoke - writes a sample volume: a puff of smoke.
//
//     mtsm-make-smoke --size 128 -o smoke.vdb
//
// The file is OpenVDB with one grid of floats, "density", a fog volume: 0 to 1, sparse, 2
// units across whatever the number of voxels, its lowest point near (0, 0, 0). The same
// arguments give the same densities.
#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "write_file.h"

namespace {

// --- the smoke: in a cube from -1 to 1
// ---------------------------------------------------

struct Blob {
    glm::dvec3 centre;
    double radius;
};

/// Blobs that rise in a spiral, wider and wider.
std::vector<Blob> makeBlobs() {
    constexpr int kBlobs = 14;
    std::vector<Blob> blobs;
    for (int i = 0; i < kBlobs; ++i) {
        const double up = double(i) / (kBlobs - 1);
        const double turn = 2.399963229728653 * i;  // the golden angle
        const double away = 0.08 + 0.34 * up;
        blobs.push_back({{away * std::cos(turn), -0.78 + 1.3 * up, away * std::sin(turn)},
                         0.16 + 0.2 * up});
    }
    return blobs;
}

/// A value in [-1, 1] for every point of a lattice, without any pattern to see.
double lattice(glm::ivec3 p) {
    std::uint32_t h = std::uint32_t(p.x) * 0x8da6b343u ^
                      std::uint32_t(p.y) * 0xd8163841u ^ std::uint32_t(p.z) * 0xcb1ab31fu;
    h = (h ^ h >> 16) * 0x7feb352du;
    h = (h ^ h >> 15) * 0x846ca68bu;
    return double((h ^ h >> 16) >> 8) / 8388607.5 - 1.0;
}

/// The lattice, smoothly interpolated.
double noise(glm::dvec3 p) {
    const glm::dvec3 cell = glm::floor(p), in = p - cell;
    const glm::dvec3 s = in * in * (3.0 - 2.0 * in);
    const glm::ivec3 corner(cell);
    double sum = 0.0;
    for (int i = 0; i < 8; ++i) {
        const glm::ivec3 at(i & 1, i >> 1 & 1, i >> 2);
        const glm::dvec3 w = glm::mix(1.0 - s, s, glm::dvec3(at));
        sum += w.x * w.y * w.z * lattice(corner + at);
    }
    return sum;
}

/// Octaves of noise, each half as strong and twice as fine as the one before.
double turbulence(glm::dvec3 p) {
    double sum = 0.0, strength = 0.5;
    for (int octave = 0; octave < 5; ++octave, strength *= 0.5, p = 2.03 * p + 17.3)
        sum += strength * noise(p);
    return sum;
}

double density(const std::vector<Blob>& blobs, glm::dvec3 p) {
    double inside = -1.0;  // how deep in the nearest blob, of its radius
    for (const Blob& blob : blobs)
        inside = std::max(inside, 1.0 - glm::length(p - blob.centre) / blob.radius);
    if (inside < -0.6) return 0.0;  // no turbulence reaches so far
    const double d = inside + 0.9 * turbulence(5.0 * p);
    return std::clamp(d, 0.0, 1.0);
}

// --- the grid
// ----------------------------------------------------------------------------

openvdb::FloatGrid::Ptr makeSmoke(int size) {
    const std::vector<Blob> blobs = makeBlobs();
    auto grid = openvdb::FloatGrid::create(0.0f);
    grid->setName("density");
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    const double voxel = 2.0 / size;
    auto transform = openvdb::math::Transform::createLinearTransform(voxel);
    transform->postTranslate({voxel / 2 - 1.0, voxel / 2, voxel / 2 - 1.0});
    grid->setTransform(transform);
    auto access = grid->getAccessor();
    for (int z = 0; z < size; ++z) {
        for (int y = 0; y < size; ++y) {
            for (int x = 0; x < size; ++x) {
                const glm::dvec3 p = (glm::dvec3(x, y, z) + 0.5) * voxel - 1.0;
                const double d = density(blobs, p);
                if (d > 0.0) access.setValue({x, y, z}, float(d));
            }
        }
    }
    return grid;
}

/// Writes to memory: OpenVDB's own files do not notice that a disk is full.
class MemoryArchive final : public openvdb::io::Archive {
  public:
    [[nodiscard]] static std::string bytesOf(const openvdb::FloatGrid::Ptr& grid) {
        std::ostringstream out;
        MemoryArchive().Archive::write(out, openvdb::GridPtrVec{grid}, true);
        return out.str();
    }
};

}  // namespace

int main(int argc, char** argv) {
    int size = 128;
    std::string output = "smoke.vdb";
    CLI::App app{
        "Writes a sample volume as OpenVDB: a puff of smoke, 2 units across, over the\n"
        "plane y = 0. Its grid is named \"density\" and holds values from 0 to 1:\n"
        "mtsm-bake makes of it thin smoke, and thick with --density-scale 20.",
        "mtsm-make-smoke"};
    app.add_option("-n,--size", size, "Voxels along each side of the cube it is made in")
        ->check(CLI::Range(8, 1024))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .vdb")
        ->check([](const std::string& path) { return checkEnding(path, {".vdb"}); })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-smoke\n  mtsm-make-smoke --size 32 -o small.vdb\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    openvdb::initialize();
    const openvdb::FloatGrid::Ptr smoke = makeSmoke(size);
    const std::string problem = writeFile(output, MemoryArchive::bytesOf(smoke));
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-smoke: %s: cannot be written: %s\n",
                     output.c_str(), problem.c_str());
        return 3;
    }
    const openvdb::CoordBBox box = smoke->evalActiveVoxelBoundingBox();
    const openvdb::Vec3d low = smoke->indexToWorld(box.min().asVec3d() - 0.5);
    const openvdb::Vec3d high = smoke->indexToWorld(box.max().asVec3d() + 0.5);
    std::fprintf(stderr,
                 "%s: grid \"density\" of %llu active voxels, from (%.2f, %.2f, %.2f) to "
                 "(%.2f, %.2f, %.2f)\n",
                 output.c_str(),
                 static_cast<unsigned long long>(smoke->activeVoxelCount()), low.x(),
                 low.y(), low.z(), high.x(), high.y(), high.z());
    return 0;
}
