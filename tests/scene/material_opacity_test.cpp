// Opacity: what each format says and what becomes of it.
#include <catch2/catch.hpp>
#include <string>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;
using test::contains;
using test::seeFile;

namespace {

/// Opacity of a triangle with this glTF material.
float gltfOpacity(const std::string& material, std::vector<std::string>& warnings) {
    const test::TempFolder folder;
    const auto seen = seeFile(
        folder.write(
            "a.gltf",
            test::gltf(R"("nodes":[{"mesh":0}],"meshes":[)" + test::gltfMesh("m", "0") +
                       R"(],"materials":[{"name":"x",)" + material +
                       R"(}],"textures":[{"source":0}],"images":[{"uri":"a.png"}],)")),
        warnings);
    INFO(seen.error());
    REQUIRE(seen.meshes.size() == 1);
    return seen.meshes[0].opacity;
}

float gltfOpacity(const std::string& material) {
    std::vector<std::string> warnings;
    const float opacity = gltfOpacity(material, warnings);
    CHECK(warnings.empty());
    return opacity;
}

std::string factor(const std::string& alpha, const std::string& more = "") {
    return R"("pbrMetallicRoughness":{"baseColorFactor":[1,1,1,)" + alpha + "]" + more +
           "}";
}

float colladaOpacity(const std::string& effect, std::vector<std::string>& warnings) {
    const test::TempFolder folder;
    const auto seen = seeFile(
        folder.write(
            "a.dae",
            test::collada(effect, "<node id=\"n\" name=\"n\">" +
                                      std::string(test::kColladaTriangle) + "</node>")),
        warnings);
    INFO(seen.error());
    REQUIRE(seen.meshes.size() == 1);
    return seen.meshes[0].opacity;
}

}  // namespace

TEST_CASE("glTF opacity follows the alpha mode", "[scene][exact]") {
    CHECK(gltfOpacity(factor("0.25")) == 1.0f);
    CHECK(gltfOpacity(factor("0.25") + R"(,"alphaMode":"OPAQUE")") == 1.0f);
    CHECK(gltfOpacity(factor("0.25") + R"(,"alphaMode":"BLEND")") == 0.25f);
    CHECK(gltfOpacity(factor("0") + R"(,"alphaMode":"BLEND")") == 0.0f);
    CHECK(gltfOpacity(R"("alphaMode":"BLEND")") == 1.0f);
    CHECK(gltfOpacity(factor("0.4") + R"(,"alphaMode":"MASK")") == 0.0f);
    CHECK(gltfOpacity(factor("0.5") + R"(,"alphaMode":"MASK")") == 1.0f);
    CHECK(gltfOpacity(factor("0.4") + R"(,"alphaMode":"MASK","alphaCutoff":0.3)") ==
          1.0f);
    CHECK(gltfOpacity(factor("0.6") + R"(,"alphaMode":"MASK","alphaCutoff":0.7)") ==
          0.0f);
}

TEST_CASE("OBJ opacity is d, or one minus Tr", "[scene][exact]") {
    const test::TempFolder folder;
    folder.write("a.mtl",
                 "newmtl a\nd 0.25\nnewmtl b\nTr 0.25\nnewmtl c\nKd 1 1 1\n"
                 "newmtl d\nd 0\nnewmtl e\nd nan\nnewmtl f\nd 7\n"
                 "newmtl g\nd 0.5\nmap_Kd bark.jpg\n");
    std::string text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (const char m : std::string("abcdefg"))
        text += std::string("o ") + m + "\nusemtl " + m + "\nf 1 2 3\n";
    const std::string path = folder.write("a.obj", text);
    std::vector<std::string> warnings;
    const auto seen = seeFile(path, warnings);
    REQUIRE(seen.status);
    std::vector<float> opacities;
    for (const auto& mesh : seen.meshes)
        opacities.push_back(mesh.opacity);
    CHECK(opacities == std::vector<float>{0.25f, 0.75f, 1, 0, 1, 1, 0.5f});
    CHECK(warnings.empty());

    MeshFileOptions half;
    half.opacity = 0.5f;
    warnings.clear();
    for (const auto& mesh : seeFile(path, warnings, half).meshes)
        CHECK(mesh.opacity == 0.5f);
    CHECK(warnings.empty());
}

TEST_CASE("an opacity outside [0, 1] is an argument that cannot be",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    for (const float bad : {-0.1f, 1.1f, NAN}) {
        MeshFileOptions options;
        options.opacity = bad;
        const auto seen = seeFile(folder.write("a.obj", "v 0 0 0\n"), options);
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badArgument);
    }
}

TEST_CASE("COLLADA opacity is as its specification says, but never 0", "[scene][exact]") {
    std::vector<std::string> warnings;
    const auto opacity = [&](const std::string& transparent,
                             const std::string& transparency) {
        return colladaOpacity(
            (transparent.empty() ? ""
                                 : "<transparent " + transparent + "</transparent>") +
                "<transparency><float>" + transparency + "</float></transparency>",
            warnings);
    };
    CHECK(opacity(R"(opaque="A_ONE"><color>1 1 1 1</color>)", "1") == 1.0f);
    CHECK(opacity(R"(opaque="A_ONE"><color>0 0 0 1</color>)", "0.25") == 0.25f);
    CHECK(opacity(R"(opaque="RGB_ZERO"><color>0 0 0 1</color>)", "1") == 1.0f);
    CHECK(opacity(R"(opaque="RGB_ZERO"><color>1 1 1 1</color>)", "0.25") == 0.75f);
    CHECK(warnings.empty());
    CHECK(opacity("", "0") == 1.0f);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "material \"paint\": its opacity of 0 is taken for 1"));
}
