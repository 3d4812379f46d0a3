// mtsm-make-glass - writes a sample scene: a pane of tinted glass in an opaque frame.
//
//     mtsm-make-glass --tint 1 0.4 0.1 --opacity 0.5 -o glass.gltf
//
// glTF with its numbers embedded, two objects: "frame", opaque, and "pane", alpha mode
// BLEND with the tint as base colour. The pane stands upright in the plane z = 0. Both
// are in metres, y up. The same arguments give the same bytes.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "write_file.h"

namespace {

constexpr float kFrameWidth = 0.08f, kFrameDepth = 0.06f;

struct Mesh {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;
};

void addBox(Mesh& mesh, glm::vec3 low, glm::vec3 high) {
    const auto first = std::uint32_t(mesh.positions.size());
    for (unsigned i = 0; i < 8; ++i)
        mesh.positions.emplace_back(i & 1 ? high.x : low.x, i & 2 ? high.y : low.y,
                                    i & 4 ? high.z : low.z);
    for (const std::uint32_t corner :
         {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4,
          2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5})
        mesh.indices.push_back(first + corner);
}

/// Four bars around the pane; they meet without overlap.
Mesh makeFrame(float width, float height) {
    const float x = 0.5f * width, d = 0.5f * kFrameDepth, w = kFrameWidth;
    Mesh mesh;
    addBox(mesh, {-x - w, 0, -d}, {-x, height + 2 * w, d});
    addBox(mesh, {x, 0, -d}, {x + w, height + 2 * w, d});
    addBox(mesh, {-x, 0, -d}, {x, w, d});
    addBox(mesh, {-x, height + w, -d}, {x, height + 2 * w, d});
    return mesh;
}

/// n x n squares of two triangles each, one sheet.
Mesh makePane(float width, float height, std::uint32_t n) {
    Mesh mesh;
    for (std::uint32_t j = 0; j <= n; ++j)
        for (std::uint32_t i = 0; i <= n; ++i)
            mesh.positions.emplace_back(width * (float(i) / float(n) - 0.5f),
                                        kFrameWidth + height * (float(j) / float(n)), 0);
    for (std::uint32_t j = 0; j < n; ++j)
        for (std::uint32_t i = 0; i < n; ++i) {
            const std::uint32_t a = j * (n + 1) + i, b = a + n + 1;
            mesh.indices.insert(mesh.indices.end(), {a, a + 1, b + 1, a, b + 1, b});
        }
    return mesh;
}

// --- the file: glTF 2.0 --------------------------------------------------------------

std::string base64(const std::string& bytes) {
    static const char* const digits =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        std::uint32_t word = 0;
        for (std::size_t k = 0; k < 3; ++k)
            word = word << 8 | (i + k < bytes.size() ? std::uint8_t(bytes[i + k]) : 0u);
        for (std::size_t k = 0; k < 4; ++k)
            out += i + k <= bytes.size() ? digits[word >> (18 - 6 * k) & 63] : '=';
    }
    return out;
}

std::string number(double x) {
    char buffer[32];
    std::snprintf(buffer, sizeof(buffer), "%.9g", x);
    return buffer;
}

std::string boundsOf(const Mesh& mesh) {
    std::string text;
    for (const bool low : {true, false}) {
        text += low ? "\"min\":[" : ",\"max\":[";
        for (int c = 0; c < 3; ++c) {
            float extreme = mesh.positions[0][c];
            for (const glm::vec3& p : mesh.positions)
                extreme = low ? std::min(extreme, p[c]) : std::max(extreme, p[c]);
            text += (c ? "," : "") + number(double(extreme));
        }
        text += "]";
    }
    return text;
}

struct Part {
    const char* name;
    const Mesh& mesh;
};

/// The material of a part has its number.
std::string encode(const std::array<Part, 2>& parts, const std::string& materials) {
    std::string numbers, nodes, meshes, accessors, views;
    const auto view = [&](const void* bytes, std::size_t count) {
        views += (views.empty() ? "" : ",") +
                 std::string("{\"buffer\":0,\"byteOffset\":") +
                 std::to_string(numbers.size()) +
                 ",\"byteLength\":" + std::to_string(count) + "}";
        numbers.append(static_cast<const char*>(bytes), count);
    };
    for (std::size_t i = 0; i < parts.size(); ++i) {
        const auto& [name, mesh] = parts[i];
        const std::string comma = i ? "," : "", index = std::to_string(i);
        const std::string positions = std::to_string(2 * i);
        const std::string corners = std::to_string(2 * i + 1);
        nodes += comma + "{\"name\":\"" + name + "\",\"mesh\":" + index + "}";
        meshes += comma + "{\"name\":\"" + name +
                  "\",\"primitives\":[{\"attributes\":{\"POSITION\":" + positions +
                  "},\"indices\":" + corners + ",\"material\":" + index + "}]}";
        accessors += comma + "{\"bufferView\":" + positions +
                     ",\"componentType\":5126,\"type\":\"VEC3\",\"count\":" +
                     std::to_string(mesh.positions.size()) + "," + boundsOf(mesh) +
                     "},{\"bufferView\":" + corners +
                     ",\"componentType\":5125,\"type\":\"SCALAR\",\"count\":" +
                     std::to_string(mesh.indices.size()) + "}";
        view(mesh.positions.data(), mesh.positions.size() * sizeof(glm::vec3));
        view(mesh.indices.data(), mesh.indices.size() * sizeof(std::uint32_t));
    }
    return "{\"asset\":{\"version\":\"2.0\",\"generator\":\"mtsm-make-glass\"},"
           "\"scene\":0,\"scenes\":[{\"nodes\":[0,1]}],\n\"nodes\":[" +
           nodes + "],\n\"meshes\":[" + meshes + "],\n\"materials\":[" + materials +
           "],\n\"accessors\":[" + accessors + "],\n\"bufferViews\":[" + views +
           "],\n\"buffers\":[{\"byteLength\":" + std::to_string(numbers.size()) +
           ",\"uri\":\"data:application/octet-stream;base64," + base64(numbers) +
           "\"}]}\n";
}

}  // namespace

int main(int argc, char** argv) {
    std::array<double, 2> size{1.0, 1.5};
    std::array<double, 3> tint{0.9, 0.35, 0.1};
    double opacity = 0.4;
    std::uint32_t squares = 1;
    std::string output = "glass.gltf";
    CLI::App app{
        "Writes a sample scene as glTF: a pane of tinted glass, \"pane\", in an opaque\n"
        "frame, \"frame\", standing on y = 0 in the plane z = 0. Lengths are in metres.",
        "mtsm-make-glass"};
    const CLI::Range proportion(0.0, 1.0);
    app.add_option("--size", size, "Width and height of the pane, in metres")
        ->check(CLI::Range(0.01, 1000.0))
        ->capture_default_str();
    app.add_option("--tint", tint, "Base colour of the glass: red, green, blue, linear")
        ->check(proportion)
        ->capture_default_str();
    app.add_option("--opacity", opacity, "Alpha of the glass, 0 clear to 1 opaque")
        ->check(proportion)
        ->capture_default_str();
    app.add_option("-n,--squares", squares,
                   "Squares along each side of the pane, two triangles each")
        ->check(CLI::Range(1, 2000))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .gltf")
        ->check([](const std::string& path) { return checkEnding(path, {".gltf"}); })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-glass\n"
        "  mtsm-make-glass --tint 0.1 0.8 0.3 --opacity 0.7 -o green.gltf\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    const float width = float(size[0]), height = float(size[1]);
    const Mesh frame = makeFrame(width, height), pane = makePane(width, height, squares);
    const std::string materials =
        "{\"name\":\"frame\",\"pbrMetallicRoughness\":{\"baseColorFactor\":"
        "[0.2,0.2,0.2,1],\"metallicFactor\":0}},\n{\"name\":\"glass\",\"alphaMode\":"
        "\"BLEND\",\"doubleSided\":true,\"pbrMetallicRoughness\":{\"baseColorFactor\":[" +
        number(tint[0]) + "," + number(tint[1]) + "," + number(tint[2]) + "," +
        number(opacity) + "],\"metallicFactor\":0,\"roughnessFactor\":0}}";
    const std::string problem =
        writeFile(output, encode({{{"frame", frame}, {"pane", pane}}}, materials));
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-glass: %s: cannot be written: %s\n",
                     output.c_str(), problem.c_str());
        return 3;
    }
    std::fprintf(stderr, "%s: pane of %zu triangles, %.2f x %.2f, and its frame\n",
                 output.c_str(), pane.indices.size() / 3, size[0], size[1]);
    return 0;
}
