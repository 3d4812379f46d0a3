// scene_fixture.h - small mesh files, and what comes out of them.
#pragma once
#include <unistd.h>

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <glm/geometric.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::test {

/// A folder of this process's own, gone with the object.
class TempFolder {
  public:
    TempFolder() {
        static int number = 0;
        path_ =
            std::filesystem::temp_directory_path() /
            ("mtsm_scene_" + std::to_string(getpid()) + "_" + std::to_string(number++));
        std::filesystem::create_directories(path_);
    }
    ~TempFolder() {
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    TempFolder(const TempFolder&) = delete;
    TempFolder& operator=(const TempFolder&) = delete;

    [[nodiscard]] std::string path(const std::string& name) const {
        return (path_ / name).string();
    }
    std::string write(const std::string& name, std::string_view bytes) const {
        std::ofstream(path(name), std::ios::binary)
            .write(bytes.data(), std::streamsize(bytes.size()));
        return path(name);
    }

  private:
    std::filesystem::path path_;
};

/// A mesh as a visitor saw it, its positions taken to the world.
struct SeenMesh {
    std::vector<glm::dvec3> world;
    std::vector<std::uint32_t> indices;
    float opacity = 1;
    glm::vec3 tint{1};
    std::vector<glm::vec2> uvs;
    std::optional<OpacityTexture> texture;
    const OpacityTexture* shared = nullptr;  ///< where it was; to compare, not to look up

    /// Of the texture, at a point.
    [[nodiscard]] glm::vec3 at(glm::dvec2 uv) const {
        glm::vec3 out(-1);
        texture->opacity(uv, glm::dvec2(0), glm::dvec2(0), &out.x);
        return texture->channels() == 3 ? out : glm::vec3(out.x);
    }

    [[nodiscard]] double area() const {
        double sum = 0;
        for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
            const glm::dvec3 a = world[indices[i]];
            sum += 0.5 * glm::length(glm::cross(world[indices[i + 1]] - a,
                                                world[indices[i + 2]] - a));
        }
        return sum;
    }
    friend bool operator==(const SeenMesh& a, const SeenMesh& b) {
        return a.world == b.world && a.indices == b.indices && a.opacity == b.opacity;
    }
};

struct Seen {
    Status status;
    std::vector<SeenMesh> meshes;

    [[nodiscard]] std::size_t triangles() const {
        std::size_t sum = 0;
        for (const SeenMesh& m : meshes)
            sum += m.indices.size() / 3;
        return sum;
    }
    [[nodiscard]] double area() const {
        double sum = 0;
        for (const SeenMesh& m : meshes)
            sum += m.area();
        return sum;
    }
    [[nodiscard]] std::string error() const {
        return status ? std::string() : status.error().message;
    }
};

inline Seen see(CasterSource& source) {
    Seen seen;
    seen.status = source.visit(meshesOnly([&](const MeshView& view) -> Status {
        SeenMesh mesh;
        for (std::size_t i = 0; i < view.vertexCount; ++i)
            mesh.world.emplace_back(view.worldFromObject *
                                    glm::dvec4(glm::dvec3(view.positions[i]), 1.0));
        mesh.indices.assign(view.indices, view.indices + 3 * view.triangleCount);
        mesh.opacity = view.opacity;
        mesh.tint = view.tint;
        mesh.shared = view.texture;
        if (view.texture) mesh.texture = *view.texture;
        if (view.uvs) mesh.uvs.assign(view.uvs, view.uvs + view.vertexCount);
        seen.meshes.push_back(std::move(mesh));
        return {};
    }));
    return seen;
}

inline Seen seeFile(const std::string& path, MeshFileOptions options = {}) {
    MeshFiles files({path}, std::move(options));
    return see(files);
}

/// seeFile, and the warnings into `warnings`.
inline Seen seeFile(const std::string& path, std::vector<std::string>& warnings,
                    MeshFileOptions options = {}) {
    options.warn = [&](const std::string& w) { warnings.push_back(w); };
    return seeFile(path, std::move(options));
}

inline bool contains(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

template <typename T>
std::string bytesOf(std::initializer_list<T> values) {
    std::string bytes;
    for (const T v : values)
        bytes.append(reinterpret_cast<const char*>(&v), sizeof(T));
    return bytes;
}

/// Positions (0 0 0), (1 0 0), (0 1 0) and indices 0 1 2: 36 and 6 bytes.
inline std::string triangleNumbers() {
    return bytesOf<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}) +
           bytesOf<std::uint16_t>({0, 1, 2});
}

inline std::string base64(const std::string& bytes) {
    static const char* digits =
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

/// glTF around triangleNumbers(): accessor 0 holds positions, 1 indices. `parts` are
/// top-level members: nodes, meshes, materials, and so on, each followed by a comma.
inline std::string gltf(const std::string& parts, const std::string& roots = "0",
                        bool inChunk = false) {
    const std::string uri = inChunk ? ""
                                    : R"(,"uri":"data:application/octet-stream;base64,)" +
                                          base64(triangleNumbers()) + '"';
    return R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[)" + roots +
           "]}]," + parts + R"("buffers":[{"byteLength":42)" + uri +
           R"(}],"bufferViews":[{"buffer":0,"byteLength":36},
              {"buffer":0,"byteOffset":36,"byteLength":6}],
              "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3",
              "min":[0,0,0],"max":[1,1,0]},
              {"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}]})";
}

/// A glTF mesh of that triangle.
inline std::string gltfMesh(const std::string& name, const std::string& material = "") {
    return R"({"name":")" + name +
           R"(","primitives":[{"attributes":{"POSITION":0},"indices":1)" +
           (material.empty() ? "" : R"(,"material":)" + material) + "}]}";
}

/// The same file as a GLB.
inline std::string glb(const std::string& parts) {
    std::string json = gltf(parts, "0", true), numbers = triangleNumbers();
    json.resize((json.size() + 3) / 4 * 4, ' ');
    numbers.resize((numbers.size() + 3) / 4 * 4, '\0');
    const auto u32 = [](std::size_t v) {
        return bytesOf<std::uint32_t>({std::uint32_t(v)});
    };
    return "glTF" + u32(2) + u32(28 + json.size() + numbers.size()) + u32(json.size()) +
           "JSON" + json + u32(numbers.size()) + std::string("BIN\0", 4) + numbers;
}

/// COLLADA with that triangle as geometry `tri`; `effect` goes into its material's
/// <phong>, `scene` into the visual scene, `lights` into the light library.
inline std::string collada(const std::string& effect, const std::string& scene,
                           const std::string& lights = "",
                           const std::string& asset = "<up_axis>Y_UP</up_axis>") {
    return R"(<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>)" + asset +
           R"(</asset><library_lights>)" + lights +
           R"(</library_lights><library_effects><effect id="fx"><profile_COMMON>
<technique sid="c"><phong><diffuse><color>1 1 1 1</color></diffuse>)" +
           effect + R"(</phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="mat" name="paint"><instance_effect url="#fx"/></material>
</library_materials><library_geometries><geometry id="tri" name="tri"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor source="#pa" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1" material="s"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 2</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="S">)" +
           scene + R"(</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#S"/></scene></COLLADA>)";
}

inline const char* const kColladaTriangle =
    R"(<instance_geometry url="#tri"><bind_material><technique_common>
<instance_material symbol="s" target="#mat"/></technique_common></bind_material>
</instance_geometry>)";

inline constexpr bool kSanitized =
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    true;
#else
    false;
#endif

/// Takes memory until there is none. (A bare loop over `new` may compile to nothing.)
[[noreturn]] inline void takeAllMemory() {
    std::vector<std::string> taken;
    for (;;)
        taken.emplace_back(std::size_t(1) << 20, 'x');
}

}  // namespace mtsm::test
