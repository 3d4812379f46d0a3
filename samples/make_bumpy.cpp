// mtsm-make-bumpy - writes a sample scene: a bumpy body with limbs over a floor.
//
//     mtsm-make-bumpy -n 300000 -o bumpy.glb
//
// The file is binary glTF with two named objects, "body" and "floor", so that the floor
// can be left out of a bake (`mtsm-bake --exclude floor`). The body is closed: every edge
// belongs to two triangles. y is up and lengths are in metres, as in all glTF files. The
// same arguments give the same bytes.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <string>
#include <vector>

#include "write_file.h"

namespace {

struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;  // three per triangle, counter-clockwise outside
};

struct Box {
    glm::vec3 low{std::numeric_limits<float>::infinity()};
    glm::vec3 high{-std::numeric_limits<float>::infinity()};
};

Box boundsOf(const Mesh& mesh) {
    Box box;
    for (const glm::vec3& p : mesh.positions) {
        box.low = glm::min(box.low, p);
        box.high = glm::max(box.high, p);
    }
    return box;
}

// --- the body ------------------------------------------------------------------------

/// A limb: where it points, how far it reaches, and how slim it is.
struct Limb {
    glm::dvec3 direction;
    double reach, slimness;
};

constexpr std::array<Limb, 9> kLimbs{{{{0.1, 1.0, 0.15}, 0.50, 9},
                                      {{0.95, 0.45, 0.2}, 0.75, 40},
                                      {{-0.9, 0.5, 0.35}, 0.70, 35},
                                      {{0.5, -0.85, 0.4}, 0.70, 25},
                                      {{-0.55, -0.8, 0.3}, 0.75, 25},
                                      {{0.05, -0.6, -0.95}, 0.60, 30},
                                      {{0.4, 0.75, -0.7}, 0.55, 60},
                                      {{-0.35, 0.8, -0.6}, 0.50, 60},
                                      {{0.15, 0.1, 1.0}, 0.45, 20}}};

/// Smooth bumps in [-1, 1], about `frequency` of them around the sphere: plane waves in
/// directions spread by the golden angle.
double bumps(glm::dvec3 d, double frequency, int octave) {
    constexpr int kWaves = 6;
    double sum = 0;
    for (int i = 0; i < kWaves; ++i) {
        const double y = 1.0 - 2.0 * (i + 0.5) / kWaves;
        const double turn = 2.399963229728653 * (i + 1) + 1.3 * octave;
        const double flat = std::sqrt(1.0 - y * y);
        const glm::dvec3 wave(flat * std::cos(turn), y, flat * std::sin(turn));
        sum += std::sin(frequency * glm::dot(wave, d) + 1.7 * i + 0.9 * octave);
    }
    return sum / kWaves;
}

/// How far the surface is from the centre in direction d (unit).
double radius(glm::dvec3 d) {
    double r = 0.6;
    for (const Limb& limb : kLimbs) {
        const double off = 1.0 - glm::dot(d, glm::normalize(limb.direction));
        r += limb.reach * std::exp(-limb.slimness * off);
    }
    double height = 0.16, frequency = 5.0;
    for (int octave = 0; octave < 5; ++octave, height *= 0.5, frequency *= 2.1)
        r += r * height * bumps(d, frequency, octave);
    return r;
}

/// A sphere of 8 rings^2 triangles: 2 rings rings of points from pole to pole, 4 i of
/// them in the i-th from either pole, so that all triangles are of about one size. Its
/// triangles join up like those of a subdivided octahedron.
class Sphere {
  public:
    explicit Sphere(std::uint32_t rings) : rings_(rings) {
        const double step = glm::half_pi<double>() / rings;
        for (std::uint32_t i = 0; i <= 2 * rings; ++i) {
            first_.push_back(std::uint32_t(directions_.size()));
            const double polar = step * i;
            for (std::uint32_t k = 0; k < pointsIn(i); ++k) {
                const double turn = glm::two_pi<double>() * k / pointsIn(i);
                directions_.emplace_back(std::sin(polar) * std::cos(turn),
                                         std::cos(polar),
                                         -std::sin(polar) * std::sin(turn));
            }
        }
        for (std::uint32_t i = 0; i < rings; ++i) {
            joinRings(i, i + 1, false);
            joinRings(2 * rings - i, 2 * rings - i - 1, true);
        }
    }
    [[nodiscard]] const std::vector<glm::dvec3>& directions() const {
        return directions_;
    }
    [[nodiscard]] const std::vector<std::uint32_t>& indices() const { return indices_; }

  private:
    /// Ring i's distance from the nearer pole; a quarter of the ring has so many edges.
    [[nodiscard]] std::uint32_t edges(std::uint32_t i) const {
        return std::min(i, 2 * rings_ - i);
    }
    [[nodiscard]] std::uint32_t pointsIn(std::uint32_t i) const {
        return std::max(1u, 4 * edges(i));
    }
    [[nodiscard]] std::uint32_t point(std::uint32_t ring, std::uint32_t k) const {
        return first_[ring] + k % pointsIn(ring);
    }
    void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c, bool turned) {
        indices_.insert(indices_.end(), {a, turned ? c : b, turned ? b : c});
    }
    /// `inner` is the ring nearer to its pole.
    void joinRings(std::uint32_t inner, std::uint32_t outer, bool turned) {
        const std::uint32_t n = edges(inner);
        for (std::uint32_t quarter = 0; quarter < 4; ++quarter) {
            const std::uint32_t in = quarter * n, out = quarter * (n + 1);
            for (std::uint32_t k = 0; k <= n; ++k) {
                triangle(point(inner, in + k), point(outer, out + k),
                         point(outer, out + k + 1), turned);
                if (k < n)
                    triangle(point(inner, in + k), point(outer, out + k + 1),
                             point(inner, in + k + 1), turned);
            }
        }
    }

    std::uint32_t rings_;
    std::vector<std::uint32_t> first_;  // [ring]: its first point
    std::vector<glm::dvec3> directions_;
    std::vector<std::uint32_t> indices_;
};

/// The body, 2 units across its longest side, its middle over the origin, its lowest
/// point just above the floor.
Mesh makeBody(std::uint64_t triangles) {
    const double rings = std::round(std::sqrt(double(triangles) / 8.0));
    const Sphere sphere(std::uint32_t(std::max(1.0, rings)));
    std::vector<glm::dvec3> points;
    glm::dvec3 low(1e9), high(-1e9);
    for (const glm::dvec3& d : sphere.directions()) {
        points.push_back(radius(d) * d);
        low = glm::min(low, points.back());
        high = glm::max(high, points.back());
    }
    const glm::dvec3 size = high - low;
    const double scale = 2.0 / std::max({size.x, size.y, size.z});
    const glm::dvec3 foot(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
    Mesh body;
    for (const glm::dvec3& p : points)
        body.positions.emplace_back(scale * (p - foot) + glm::dvec3(0, 0.01, 0));
    body.indices = sphere.indices();
    return body;
}

Mesh makeFloor() {
    return {{{-3, 0, 3}, {3, 0, 3}, {3, 0, -3}, {-3, 0, -3}}, {0, 1, 2, 0, 2, 3}};
}

// --- the file: binary glTF 2.0 ---------------------------------------------------------

struct NamedMesh {
    const char* name;
    const Mesh& mesh;
};

void append(std::vector<std::uint8_t>& out, const void* bytes, std::size_t count) {
    const auto* first = static_cast<const std::uint8_t*>(bytes);
    out.insert(out.end(), first, first + count);
}

void append(std::vector<std::uint8_t>& out, std::uint32_t value) {
    const std::uint8_t bytes[] = {std::uint8_t(value), std::uint8_t(value >> 8),
                                  std::uint8_t(value >> 16), std::uint8_t(value >> 24)};
    append(out, bytes, sizeof(bytes));
}

std::string text(glm::vec3 v) {
    char buffer[64];
    std::snprintf(buffer, sizeof(buffer), "[%.9g,%.9g,%.9g]", double(v.x), double(v.y),
                  double(v.z));
    return buffer;
}

void appendChunk(std::vector<std::uint8_t>& file, const char* type,
                 const std::vector<std::uint8_t>& content, std::uint8_t filler) {
    const std::size_t padding = (4 - content.size() % 4) % 4;
    append(file, std::uint32_t(content.size() + padding));
    append(file, type, 4);
    append(file, content.data(), content.size());
    file.insert(file.end(), padding, filler);
}

/// One node, one mesh and two accessors per named mesh; numbers lie in one buffer.
std::vector<std::uint8_t> encodeGlb(const std::vector<NamedMesh>& meshes) {
    std::vector<std::uint8_t> numbers;
    std::string nodes, meshList, accessors, views, roots;
    for (std::size_t i = 0; i < meshes.size(); ++i) {
        const auto& [name, mesh] = meshes[i];
        const std::string comma = i > 0 ? "," : "";
        const std::string index = std::to_string(i), quoted = std::string(name);
        const std::string positions = std::to_string(2 * i);
        const std::string triangles = std::to_string(2 * i + 1);
        const auto view = [&](std::size_t bytes, int target) {
            return "{\"buffer\":0,\"byteOffset\":" + std::to_string(numbers.size()) +
                   ",\"byteLength\":" + std::to_string(bytes) +
                   ",\"target\":" + std::to_string(target) + "}";
        };
        roots += comma + index;
        nodes += comma + "{\"name\":\"" + quoted + "\",\"mesh\":" + index + "}";
        meshList += comma + "{\"name\":\"" + quoted +
                    "\",\"primitives\":[{\"attributes\":{\"POSITION\":" + positions +
                    "},\"indices\":" + triangles + "}]}";
        const std::size_t positionBytes = mesh.positions.size() * sizeof(glm::vec3);
        const std::size_t indexBytes = mesh.indices.size() * sizeof(std::uint32_t);
        views += comma + view(positionBytes, 34962);
        append(numbers, mesh.positions.data(), positionBytes);
        views += "," + view(indexBytes, 34963);
        append(numbers, mesh.indices.data(), indexBytes);
        const Box box = boundsOf(mesh);
        accessors += comma + "{\"bufferView\":" + positions +
                     ",\"componentType\":5126,\"type\":\"VEC3\",\"count\":" +
                     std::to_string(mesh.positions.size()) + ",\"min\":" + text(box.low) +
                     ",\"max\":" + text(box.high) + "},{\"bufferView\":" + triangles +
                     ",\"componentType\":5125,\"type\":\"SCALAR\",\"count\":" +
                     std::to_string(mesh.indices.size()) + "}";
    }
    const std::string json =
        "{\"asset\":{\"version\":\"2.0\",\"generator\":\"mtsm-make-bumpy\"},\"scene\":0,"
        "\"scenes\":[{\"nodes\":[" +
        roots + "]}],\"nodes\":[" + nodes + "],\"meshes\":[" + meshList +
        "],\"accessors\":[" + accessors + "],\"bufferViews\":[" + views +
        "],\"buffers\":[{\"byteLength\":" + std::to_string(numbers.size()) + "}]}";

    std::vector<std::uint8_t> chunks, file;
    appendChunk(chunks, "JSON", {json.begin(), json.end()}, ' ');
    appendChunk(chunks, "BIN\0", numbers, 0);
    append(file, "glTF", 4);
    append(file, std::uint32_t(2));
    append(file, std::uint32_t(12 + chunks.size()));
    append(file, chunks.data(), chunks.size());
    return file;
}

}  // namespace

int main(int argc, char** argv) {
    std::uint64_t triangles = 300000;
    std::string output = "bumpy.glb";
    CLI::App app{
        "Writes a sample scene as binary glTF: a closed, bumpy body with limbs, about 2\n"
        "units across and centred near (0, 1, 0), over a floor of 6 x 6 units at y = 0.\n"
        "The two objects are named \"body\" and \"floor\".",
        "mtsm-make-bumpy"};
    app.add_option(
           "-n,--triangles", triangles,
           "Triangles of the body; the nearest number of the form 8 k^2 is made;\n"
           "the floor has 2 more")
        ->check(CLI::Range(std::uint64_t(8), std::uint64_t(100'000'000)))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .glb")
        ->check([](const std::string& path) { return checkEnding(path, {".glb"}); })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-bumpy\n  mtsm-make-bumpy -n 2000 -o small.glb\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    const Mesh body = makeBody(triangles), floor = makeFloor();
    const auto glb = encodeGlb({{"body", body}, {"floor", floor}});
    const std::string problem =
        writeFile(output, {reinterpret_cast<const char*>(glb.data()), glb.size()});
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-bumpy: %s: cannot be written: %s\n",
                     output.c_str(), problem.c_str());
        return 3;
    }
    const Box box = boundsOf(body);
    std::fprintf(stderr,
                 "%s: body of %zu triangles, from (%.2f, %.2f, %.2f) to (%.2f, %.2f, "
                 "%.2f); floor at y = 0, 6 x 6\n",
                 output.c_str(), body.indices.size() / 3, double(box.low.x),
                 double(box.low.y), double(box.low.z), double(box.high.x),
                 double(box.high.y), double(box.high.z));
    return 0;
}
