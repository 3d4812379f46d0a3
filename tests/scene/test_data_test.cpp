// Real files, where there are some: MTSM_TEST_DATA names the folder.
#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;

namespace {

/// The file's path; nothing, and a word about it, if there is none.
std::optional<std::string> dataFile(const std::string& name) {
    const char* folder = std::getenv("MTSM_TEST_DATA");
    if (!folder) {
        WARN("MTSM_TEST_DATA is not set: skipped");
        return std::nullopt;
    }
    const auto path = std::filesystem::path(folder) / name;
    if (std::filesystem::exists(path)) return path.string();
    WARN(path.string() << " is not there: skipped");
    return std::nullopt;
}

/// Triangles as counted by other tools, and opacity of the least opaque mesh.
void checkFile(const std::string& name, std::size_t triangles, float leastOpacity = 1) {
    const auto path = dataFile(name);
    if (!path) return;
    const auto seen = test::seeFile(*path);
    INFO(seen.error());
    REQUIRE(seen.status);
    CHECK(seen.triangles() == triangles);
    float least = 1;
    for (const auto& mesh : seen.meshes)
        least = std::min(least, mesh.opacity);
    CHECK(least == leastOpacity);
}

}  // namespace

TEST_CASE("real meshes come in with all their triangles", "[scene][data]") {
    checkFile("meshes/dragon_348k.ply", 348503);
    checkFile("meshes/stanford_bunny.ply", 69451);
    checkFile("meshes/armadillo_86k.ply", 86482);
    checkFile("meshes/nefertiti_70k.ply", 70000);
    checkFile("meshes/spot/spot_triangulated.obj", 5856);
    checkFile("scenes/medieval_building/Medieval_building.obj", 16715);
    checkFile("scenes/cornell_box/cornell_box.obj", 36);
    checkFile("foliage/scatter_tree/scatter_tree.obj", 4538);
    checkFile("thin/dutch_ship_medium/dutch_ship_medium_1k.gltf", 69162);
    checkFile("gltf/TransmissionTest.glb", 128775);
    checkFile("gltf/AlphaBlendModeTest.glb", 61);
}

TEST_CASE("real instances are all there and glass is not opaque", "[scene][data]") {
    checkFile("gltf/GlassVaseFlowers.glb", 14036, 0.3f);
}

TEST_CASE("real COLLADA materials are opaque", "[scene][data]") {
    checkFile("thin/tower_crane/tower_crane.dae", 8735);
    checkFile("foliage/oak_tree/meshes/oak_tree.dae", 948);
}

TEST_CASE("real foliage has the holes that its images have", "[scene][texture][data]") {
    // Means of the alpha channels, as other tools give them.
    const auto textureMeans = [](const std::string& name, MeshFileOptions options = {}) {
        std::vector<float> means;
        const auto path = dataFile(name);
        if (!path) return means;
        for (const auto& mesh : test::seeFile(*path, std::move(options)).meshes) {
            if (!mesh.texture) continue;
            float mean = -1;
            mesh.texture->opacity({0.5, 0.5}, {1, 0}, {0, 1}, &mean);
            means.push_back(mean);
        }
        return means;
    };
    const auto check = [](const std::vector<float>& means,
                          const std::vector<double>& expected) {
        if (means.empty()) return;  // skipped
        REQUIRE(means.size() == expected.size());
        for (std::size_t i = 0; i < means.size(); ++i)
            CHECK(double(means[i]) == Approx(expected[i]).margin(1e-5));
    };
    check(textureMeans("foliage/scatter_tree/scatter_tree.obj"), {0.338354});
    check(textureMeans("foliage/tree1b/tree1b_lod0_1.obj"), {0.41112});
    check(textureMeans("foliage/tree1b/tree1b_lod0_2.obj"), {});
    // The oak's COLLADA file names no image: an Ogre script beside it does.
    const auto branch =
        dataFile("foliage/oak_tree/materials/textures/branch_diffuse.png");
    MeshFileOptions options;
    if (branch) options.textures = {{"Branch*", *branch}};
    check(textureMeans("foliage/oak_tree/meshes/oak_tree.dae", options), {0.26218});
}

TEST_CASE("a real ship that declares a mask but has no alpha is whole",
          "[scene][texture][data]") {
    const auto path = dataFile("thin/dutch_ship_medium/dutch_ship_medium_1k.gltf");
    if (!path) return;
    std::vector<std::string> warnings;
    for (const auto& mesh : test::seeFile(*path, warnings).meshes) {
        CHECK(!mesh.texture);
        CHECK(mesh.opacity == 1.0f);
    }
    REQUIRE(warnings.size() == 1);
    CHECK(test::contains(warnings[0], "dutch_ship_medium_sails"));
}

TEST_CASE("real lights of glTF files are read", "[scene][data]") {
    if (const auto path = dataFile("gltf/khr_lights_example/lights.gltf")) {
        const auto lights = readLights(*path);
        REQUIRE(lights);
        REQUIRE(lights->size() == 2);
        CHECK((*lights)[0].name == "point_light");
        CHECK((*lights)[0].light.shape == LightShape::point);
        CHECK((*lights)[0].light.position == glm::dvec3(0, 22, 0));
        CHECK((*lights)[1].light.shape == LightShape::sun);
    }
    if (const auto path = dataFile("gltf/LightsPunctualLamp/LightsPunctualLamp.gltf")) {
        const auto lights = readLights(*path);
        REQUIRE(lights);
        CHECK(lights->size() == 5);
    }
}

TEST_CASE("a real file that kills its importer is an error", "[scene][data]") {
    const auto path = dataFile(
        "malformed/assimp/invalid/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply");
    if (!path) return;
    const auto seen = test::seeFile(*path);
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::badFile);
}
