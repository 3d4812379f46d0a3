// Textures of mesh files: what each format says, where images are found, and what becomes
// of those that are missing or broken. Images are small; expected numbers are texels.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "png_writer.h"
#include "scene/import_file.h"
#include "scene_fixture.h"

using namespace mtsm;
using test::contains;
using test::png;
using test::seeFile;
using test::Seen;

namespace {

/// A triangle in the unit square, its texture coordinates its positions.
const char* const kObj =
    "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    "usemtl m\nf 1/1 2/2 3/3\n";

/// Two by two grey texels: 0 51 above 102 255.
std::string grey() {
    return png(2, 2, 1, {0, 51, 102, 255});
}

/// The same as alpha, over red, green, blue and white.
std::string coloured() {
    return png(2, 2, 4,
               {255, 0, 0, 0, 0, 255, 0, 51,  //
                0, 0, 255, 102, 255, 255, 255, 255});
}

std::string opaqueColours() {
    return png(2, 2, 3, std::vector<std::uint8_t>(12, 128));
}

void checkTexels(const test::SeenMesh& mesh, float factor = 1) {
    REQUIRE(mesh.texture);
    const std::pair<glm::dvec2, float> texels[] = {{{0.25, 0.75}, 0.0f},
                                                   {{0.75, 0.75}, 51 / 255.0f},
                                                   {{0.25, 0.25}, 102 / 255.0f},
                                                   {{0.75, 0.25}, 1.0f}};
    CHECK(mesh.texture->channels() == 1);
    for (const auto& [uv, value] : texels)
        CHECK(mesh.at(uv).x == Approx(factor * value).margin(1e-6));
}

struct Loaded {
    Seen seen;
    std::vector<std::string> warnings;

    [[nodiscard]] const test::SeenMesh& mesh(std::size_t i = 0) const {
        INFO(seen.error());
        REQUIRE(seen.meshes.size() > i);
        return seen.meshes[i];
    }
    [[nodiscard]] std::string allWarnings() const {
        std::string all;
        for (const std::string& w : warnings)
            all += w + "\n";
        return all;
    }
};

Loaded load(const std::string& path, MeshFileOptions options = {}) {
    Loaded loaded;
    loaded.seen = seeFile(path, loaded.warnings, std::move(options));
    return loaded;
}

/// kObj with a material of these lines and an image "a.png".
Loaded loadObj(const std::string& material, const std::string& image,
               const MeshFileOptions& options = {}) {
    const test::TempFolder folder;
    folder.write("a.png", image);
    folder.write("a.mtl", "newmtl m\n" + material);
    return load(folder.write("a.obj", kObj), options);
}

/// glTF of a triangle with those texture coordinates (v down), one node per material.
/// `image` is embedded as a data URI; `materials` and `more` are JSON members.
std::string gltfText(const std::vector<std::string>& materials, const std::string& image,
                     const std::string& more = "") {
    const std::string numbers = test::bytesOf<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}) +
                                test::bytesOf<float>({0, 1, 1, 1, 0, 0});
    std::string meshes, nodes, roots, list;
    for (std::size_t i = 0; i < materials.size(); ++i) {
        const std::string comma = i ? "," : "", index = std::to_string(i);
        meshes += comma +
                  R"({"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1},)" +
                  R"("material":)" + index + "}]}";
        nodes += comma + R"({"mesh":)" + index + "}";
        roots += comma + index;
        list += comma + R"({"name":"m)" + index + R"(",)" + materials[i] + "}";
    }
    return R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[)" + roots +
           R"(]}],"nodes":[)" + nodes + R"(],"meshes":[)" + meshes +
           R"(],"materials":[)" + list + "]," + more +
           (contains(more, "\"textures\"") ? "" : R"("textures":[{"source":0}],)") +
           R"("images":[{"uri":"data:image/png;base64,)" + test::base64(image) +
           R"("}],"buffers":[{"byteLength":60,"uri":"data:application/octet-stream;base64,)" +
           test::base64(numbers) +
           R"("}],"bufferViews":[{"buffer":0,"byteLength":36},)"
           R"({"buffer":0,"byteOffset":36,"byteLength":24}],)"
           R"("accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3",)"
           R"("min":[0,0,0],"max":[1,1,0]},)"
           R"({"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}]})";
}

Loaded loadGltf(const std::vector<std::string>& materials, const std::string& image,
                const MeshFileOptions& options = {}, const std::string& more = "") {
    const test::TempFolder folder;
    return load(folder.write("a.gltf", gltfText(materials, image, more)), options);
}

std::string textured(const std::string& mode, const std::string& factor = "1,1,1,1",
                     const std::string& extension = "") {
    return R"("alphaMode":")" + mode +
           R"(","pbrMetallicRoughness":{"baseColorFactor":[)" + factor +
           R"(],"baseColorTexture":{"index":0)" + extension + "}}";
}

MeshFileOptions inColor() {
    MeshFileOptions options;
    options.color = true;
    return options;
}

float linear(int srgb) {
    const double x = srgb / 255.0;
    return float(x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4));
}

}  // namespace

// --- OBJ -----------------------------------------------------------------------------

TEST_CASE("OBJ map_d is opacity, (0, 0) its lower left corner",
          "[scene][texture][exact]") {
    const Loaded loaded = loadObj("map_d a.png\n", grey());
    CHECK(loaded.allWarnings().empty());
    checkTexels(loaded.mesh());
    const test::SeenMesh& mesh = loaded.mesh();
    REQUIRE(mesh.uvs.size() == mesh.world.size());
    for (std::size_t i = 0; i < mesh.uvs.size(); ++i)
        CHECK(glm::dvec2(mesh.uvs[i]) == glm::dvec2(mesh.world[i]));
}

TEST_CASE("OBJ d and an override multiply map_d", "[scene][texture][exact]") {
    checkTexels(loadObj("d 0.5\nmap_d a.png\n", grey()).mesh(), 0.5f);
    MeshFileOptions options;
    options.opacity = 0.25f;
    checkTexels(loadObj("d 0.5\nmap_d a.png\n", grey(), options).mesh(), 0.25f);
    // Some exporters write d 0 where the texture alone counts.
    checkTexels(loadObj("d 0\nmap_d a.png\n", grey()).mesh());
    options.opacity = 0.0f;
    checkTexels(loadObj("map_d a.png\n", grey(), options).mesh(), 0.0f);
}

TEST_CASE("the alpha of map_d counts, or without any its brightness",
          "[scene][texture][exact]") {
    checkTexels(loadObj("map_d a.png\n", coloured()).mesh());
    const auto full = std::uint8_t(255);
    checkTexels(
        loadObj("map_d a.png\n", png(2, 2, 2, {0, full, 51, full, 102, full, full, full}))
            .mesh());
    checkTexels(loadObj("map_d a.png\n",
                        png(2, 2, 3, {0, 0, 0, 51, 51, 51, 102, 102, 102, 255, 255, 255}))
                    .mesh());
}

TEST_CASE("the alpha of map_Kd counts if it has some, with a warning",
          "[scene][texture]") {
    const Loaded leaves = loadObj("map_Kd a.png\n", coloured());
    checkTexels(leaves.mesh());
    REQUIRE(leaves.warnings.size() == 1);
    CHECK(contains(leaves.warnings[0],
                   "material \"m\": the alpha of its colour texture counts as opacity"));

    std::vector<std::uint8_t> solid(16, 255);
    for (const std::string& bark : {opaqueColours(), png(2, 2, 4, solid), grey()}) {
        const Loaded loaded = loadObj("map_Kd a.png\n", bark);
        CHECK(!loaded.mesh().texture);
        CHECK(loaded.mesh().uvs.empty());
        CHECK(loaded.mesh().opacity == 1.0f);
        CHECK(loaded.allWarnings().empty());
    }
    // With a texture for opacity, the colour one says nothing.
    const test::TempFolder folder;
    folder.write("colour.png", coloured());
    folder.write("a.png", opaqueColours());
    folder.write("a.mtl", "newmtl m\nmap_Kd colour.png\nmap_d a.png\n");
    const Loaded both = load(folder.write("a.obj", kObj));
    CHECK(both.mesh().at({0.3, 0.3}).x == Approx(128 / 255.0));
    CHECK(both.allWarnings().empty());
}

// --- glTF ----------------------------------------------------------------------------

TEST_CASE("glTF BLEND is factor times texture, (0, 0) its upper left corner",
          "[scene][texture][exact]") {
    const Loaded loaded = loadGltf({textured("BLEND", "1,1,1,0.5")}, coloured());
    CHECK(loaded.allWarnings().empty());
    checkTexels(loaded.mesh(), 0.5f);
    const test::SeenMesh& mesh = loaded.mesh();
    for (std::size_t i = 0; i < mesh.uvs.size(); ++i)
        CHECK(glm::dvec2(mesh.uvs[i]) == glm::dvec2(mesh.world[i]));
}

TEST_CASE("glTF OPAQUE ignores alpha", "[scene][texture][exact]") {
    const Loaded loaded = loadGltf({textured("OPAQUE", "1,1,1,0.5")}, coloured());
    CHECK(loaded.allWarnings().empty());
    CHECK(!loaded.mesh().texture);
    CHECK(loaded.mesh().opacity == 1.0f);
}

TEST_CASE("glTF MASK is a yes or no at its cutoff, whatever the override",
          "[scene][texture][exact]") {
    const auto holes = [&](const std::string& factor, const std::string& cutoff,
                           std::optional<float> opacity) {
        MeshFileOptions options;
        options.opacity = opacity;
        const Loaded loaded = loadGltf(
            {R"("alphaCutoff":)" + cutoff + "," + textured("MASK", "1,1,1," + factor)},
            coloured(), options);
        CHECK(loaded.allWarnings().empty());
        const test::SeenMesh& mesh = loaded.mesh();
        std::vector<float> seen;
        for (const glm::dvec2 uv : {glm::dvec2(0.25, 0.75), glm::dvec2(0.75, 0.75),
                                    glm::dvec2(0.25, 0.25), glm::dvec2(0.75, 0.25)})
            seen.push_back(mesh.texture ? mesh.at(uv).x : mesh.opacity);
        return seen;
    };
    using Texels = std::vector<float>;
    CHECK(holes("1", "0.5", {}) == Texels{0, 0, 0, 1});
    CHECK(holes("1", "0.3", {}) == Texels{0, 0, 1, 1});
    CHECK(holes("0.5", "0.3", {}) == Texels{0, 0, 0, 1});
    CHECK(holes("0.5", "0.15", {}) == Texels{0, 0, 1, 1});
    CHECK(holes("0.5", "0.6", {}) == Texels{0, 0, 0, 0});
    CHECK(holes("1", "0", {}) == Texels{1, 1, 1, 1});
    CHECK(holes("0", "0.5", {}) == Texels{0, 0, 0, 0});
    CHECK(holes("1", "0.3", 0.25f) == Texels{0, 0, 0.25f, 0.25f});
    CHECK(holes("1", "0", 0.25f) == Texels{0.25f, 0.25f, 0.25f, 0.25f});
}

TEST_CASE("a texture without alpha is opaque, and that is said once",
          "[scene][texture]") {
    for (const std::string mode : {"MASK", "BLEND"}) {
        const Loaded loaded = loadGltf({textured(mode), textured(mode)}, opaqueColours());
        CHECK(!loaded.mesh(1).texture);
        CHECK(loaded.mesh(0).opacity == 1.0f);
        REQUIRE(loaded.warnings.size() == 1);
        CHECK(contains(loaded.warnings[0],
                       "a.gltf: material \"m0\" and 1 more: its texture has no alpha"));
    }
    const Loaded glass = loadGltf({textured("BLEND", "1,1,1,0.5")}, opaqueColours());
    REQUIRE(glass.mesh().texture);
    CHECK(glass.mesh().at({0.3, 0.3}).x == 0.5f);
    CHECK(glass.allWarnings().empty());
}

TEST_CASE("materials that use an image in the same way share its texture",
          "[scene][texture]") {
    const Loaded loaded = loadGltf({textured("BLEND"), textured("BLEND", "1,0,0,1"),
                                    textured("MASK"), textured("BLEND", "1,1,1,0.5")},
                                   coloured());
    CHECK(loaded.mesh(0).shared == loaded.mesh(1).shared);
    CHECK(loaded.mesh(2).shared != loaded.mesh(1).shared);
    CHECK(loaded.mesh(3).shared != loaded.mesh(0).shared);
    CHECK(loaded.mesh(3).at({0.75, 0.25}).x == 0.5f);
}

TEST_CASE("glTF samplers say how textures repeat", "[scene][texture][exact]") {
    const Loaded loaded = loadGltf(
        {textured("BLEND")}, coloured(), {},
        R"("samplers":[{"wrapS":33071,"wrapT":33648}],"textures":[{"source":0,"sampler":0}],)");
    const test::SeenMesh& mesh = loaded.mesh();
    CHECK(mesh.at({5, 0.25}).x == Approx(1.0));     // clamped
    CHECK(mesh.at({0.25, 1.75}).x == Approx(0.4));  // mirrored: as at 0.25
    CHECK(mesh.at({-5.25, 1.25}).x == Approx(0.0).margin(1e-6));
}

TEST_CASE("KHR_texture_transform moves, turns and scales", "[scene][texture][exact]") {
    const double x = 0.25, y = 0.125, turn = 0.3, sx = 2, sy = 3;
    const Loaded loaded = loadGltf(
        {textured("BLEND", "1,1,1,1",
                  R"(,"extensions":{"KHR_texture_transform":{"offset":[0.25,0.125],)"
                  R"("rotation":0.3,"scale":[2,3]}})")},
        coloured(), {}, R"("extensionsUsed":["KHR_texture_transform"],)");
    const test::SeenMesh& mesh = loaded.mesh();
    REQUIRE(mesh.uvs.size() == 3);
    for (std::size_t i = 0; i < 3; ++i) {
        // Scaled, turned counter-clockwise as the image is seen, v down, and moved.
        const double u = sx * mesh.world[i].x, v = sy * (1 - mesh.world[i].y);
        const double u2 = std::cos(turn) * u + std::sin(turn) * v + x;
        const double v2 = -std::sin(turn) * u + std::cos(turn) * v + y;
        CHECK(mesh.uvs[i].x == Approx(u2).margin(1e-5));
        CHECK(mesh.uvs[i].y == Approx(1 - v2).margin(1e-5));
    }
}

TEST_CASE("glass by transmission casts as opaque, and that is said once", "[scene]") {
    const std::string glass =
        R"("extensions":{"KHR_materials_transmission":{"transmissionFactor":0.9}})";
    const Loaded loaded = loadGltf({glass, glass}, grey(), {},
                                   R"("extensionsUsed":["KHR_materials_transmission"],)");
    CHECK(loaded.mesh(1).opacity == 1.0f);
    REQUIRE(loaded.warnings.size() == 1);
    CHECK(contains(loaded.warnings[0], "material \"m0\" and 1 more: it is glass by"));
}

// --- COLLADA -------------------------------------------------------------------------

namespace {

/// A triangle with texture coordinates; `transparent` may use the sampler of a.png.
std::string texturedCollada(const std::string& transparent) {
    std::string text = test::collada(
        R"(<transparent opaque="A_ONE">)" + transparent +
            R"(</transparent><transparency><float>1</float></transparency>)",
        "<node id=\"n\" name=\"n\">" + std::string(test::kColladaTriangle) + "</node>");
    const auto replace = [&](const std::string& what, const std::string& with) {
        REQUIRE(contains(text, what));
        text.replace(text.find(what), what.size(), with);
    };
    replace("<library_effects>",
            "<library_images><image id=\"i\"><init_from>a.png</init_from></image>"
            "</library_images><library_effects>");
    replace("<technique sid=\"c\">",
            "<newparam sid=\"surface\"><surface type=\"2D\"><init_from>i</init_from>"
            "</surface></newparam><newparam sid=\"sampler\"><sampler2D><source>surface"
            "</source></sampler2D></newparam><technique sid=\"c\">");
    replace(
        "<vertices id=\"v\">",
        "<source id=\"t\"><float_array id=\"ta\" count=\"6\">0 0 1 0 0 1</float_array>"
        "<technique_common><accessor source=\"#ta\" count=\"3\" stride=\"2\">"
        "<param name=\"S\" type=\"float\"/><param name=\"T\" type=\"float\"/></accessor>"
        "</technique_common></source><vertices id=\"v\">");
    replace("offset=\"0\"/>\n<p>",
            "offset=\"0\"/>\n<input semantic=\"TEXCOORD\" source=\"#t\" offset=\"0\" "
            "set=\"0\"/><p>");
    return text;
}

}  // namespace

TEST_CASE("a COLLADA texture of transparent is opacity", "[scene][texture][exact]") {
    const test::TempFolder folder;
    folder.write("a.png", coloured());
    const Loaded loaded = load(folder.write(
        "a.dae", texturedCollada("<texture texture=\"sampler\" texcoord=\"UV\"/>")));
    CHECK(loaded.allWarnings().empty());
    checkTexels(loaded.mesh());
    CHECK(glm::dvec2(loaded.mesh().uvs[2]) == glm::dvec2(0, 1));
}

TEST_CASE("texture coordinates for which a file names no image are told of, once",
          "[scene][texture]") {
    const test::TempFolder folder;
    const std::string path =
        folder.write("a.dae", texturedCollada("<color>1 1 1 1</color>"));
    const Loaded solid = load(path);
    CHECK(solid.mesh().opacity == 1.0f);
    REQUIRE(solid.warnings.size() == 1);
    CHECK(contains(solid.warnings[0], "but the file names none: it casts as a whole"));
    CHECK(contains(solid.warnings[0], "--texture NAME=IMAGE"));
    // Who gives textures has seen to it.
    MeshFileOptions options;
    options.textures = {{"*", ""}};
    CHECK(load(path, options).allWarnings().empty());

    const Loaded mask = loadGltf({R"("alphaMode":"MASK")", R"("alphaMode":"MASK")",
                                  R"("alphaMode":"BLEND")", R"("alphaMode":"OPAQUE")"},
                                 grey());
    REQUIRE(mask.warnings.size() == 1);
    CHECK(contains(mask.warnings[0], "a.gltf: material \"m0\", \"m1\": "));
}

// --- colours -------------------------------------------------------------------------

TEST_CASE("coloured glass has three channels if asked for", "[scene][texture][exact]") {
    const std::string image = png(1, 1, 4, {255, 128, 0, 102});
    const std::string material = textured("BLEND", "1,0.5,1,0.5");
    const test::SeenMesh plain = loadGltf({material}, image).mesh();
    CHECK(plain.texture->channels() == 1);
    CHECK(plain.at({0.5, 0.5}).x == Approx(0.2));
    const test::SeenMesh mesh = loadGltf({material}, image, inColor()).mesh();
    REQUIRE(mesh.texture);
    REQUIRE(mesh.texture->channels() == 3);
    const glm::vec3 seen = mesh.at({0.5, 0.5});
    const glm::vec3 expected =
        channelOpacity(0.5f * 102 / 255, {1.0f, 0.5f * linear(128), 0.0f});
    for (int c = 0; c < 3; ++c)
        CHECK(seen[c] == Approx(expected[c]).margin(1e-5));
}

TEST_CASE("masks and grey glass need one channel, also in colour",
          "[scene][texture][exact]") {
    CHECK(loadGltf({textured("MASK", "1,0,0,1")}, coloured(), inColor())
              .mesh()
              .texture->channels() == 1);
    const std::string image = png(1, 1, 4, {200, 200, 200, 102});
    const test::SeenMesh grey = loadGltf({textured("BLEND")}, image, inColor()).mesh();
    CHECK(grey.texture->channels() == 1);
    CHECK(grey.at({0.5, 0.5}).x ==
          Approx(channelOpacity(0.4f, glm::vec3(linear(200))).x).margin(1e-5));
}

TEST_CASE("stained glass: alpha by number, colour by texture",
          "[scene][texture][exact]") {
    const std::string image = png(1, 1, 3, {255, 0, 0});
    const test::SeenMesh mesh =
        loadGltf({textured("BLEND", "1,1,1,0.5")}, image, inColor()).mesh();
    REQUIRE(mesh.texture);
    CHECK(mesh.at({0.5, 0.5}) == channelOpacity(0.5f, {1, 0, 0}));
}

TEST_CASE("without a texture the tint is a number", "[scene][exact]") {
    const std::string glass =
        R"("alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0.25,0.5]})";
    CHECK(loadGltf({glass}, grey()).mesh().tint == glm::vec3(1));
    CHECK(loadGltf({glass}, grey(), inColor()).mesh().tint == glm::vec3(1, 0.5f, 0.25f));
    CHECK(loadObj("Kd 1 0.5 0.25\nd 0.5\n", grey(), inColor()).mesh().tint ==
          glm::vec3(1, 0.5f, 0.25f));
    CHECK(loadObj("Kd 1 0.5 0.25\nTf 0.25 0.5 0.75\nd 0.5\n", grey(), inColor())
              .mesh()
              .tint == glm::vec3(0.25f, 0.5f, 0.75f));
    const test::SeenMesh mesh =
        loadObj("Kd 1 0.5 0\nmap_d a.png\n", grey(), inColor()).mesh();
    REQUIRE(mesh.texture->channels() == 3);
    const glm::vec3 seen = mesh.at({0.25, 0.25});
    for (int c = 0; c < 3; ++c)
        CHECK(seen[c] == Approx(channelOpacity(0.4f, {1, 0.5f, 0})[c]).margin(1e-6));
}

// --- where images are ------------------------------------------------------------------

TEST_CASE("images are found where exporters put them", "[scene][texture]") {
    const std::pair<std::string, std::string> cases[] = {
        {"my leaf.png", "my leaf.png"},
        {"my%20leaf.png", "my leaf.png"},
        {"maps\\leaf.png", "maps/leaf.png"},
        {"C:\\art\\leaf.png", "leaf.png"},
        {"/no/such/place/leaf.png", "textures/leaf.png"},
        {"leaf.png", "../textures/leaf.png"},
        {"file://leaf.png", "../materials/textures/leaf.png"},
        {"../art/leaf.png", "../art/leaf.png"},
    };
    for (const auto& [name, place] : cases) {
        const test::TempFolder folder;
        const std::filesystem::path root = folder.path("x");
        const auto image = std::filesystem::path("x/model") / place;
        std::filesystem::create_directories(root / "model");
        std::filesystem::create_directories(
            std::filesystem::path(folder.path(image.string())).parent_path());
        folder.write(image.string(), grey());
        folder.write("x/model/a.mtl", "newmtl m\nmap_d " + name + "\n");
        const Loaded loaded = load(folder.write("x/model/a.obj", kObj));
        INFO(name << " at " << place << ": " << loaded.allWarnings());
        CHECK(loaded.warnings.empty());
        checkTexels(loaded.mesh());
    }
}

TEST_CASE("a missing image is a warning that names it, and the number counts",
          "[scene][texture][bad-input]") {
    const Loaded loaded = loadObj("d 0.5\nmap_d other.png\n", grey());
    CHECK(loaded.seen.status);
    CHECK(!loaded.mesh().texture);
    CHECK(loaded.mesh().opacity == 0.5f);
    REQUIRE(loaded.warnings.size() == 1);
    CHECK(contains(loaded.warnings[0],
                   "a.obj: material \"m\": its texture other.png is not used: "
                   "there is no such file"));
    CHECK(contains(loaded.warnings[0], "--texture 'm=IMAGE'"));
}

TEST_CASE("a mesh without texture coordinates casts without", "[scene][texture]") {
    const test::TempFolder folder;
    folder.write("a.png", grey());
    folder.write("a.mtl", "newmtl m\nd 0.5\nmap_d a.png\n");
    const Loaded loaded = load(folder.write(
        "a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n"));
    CHECK(loaded.mesh().opacity == 0.5f);
    REQUIRE(loaded.warnings.size() == 1);
    CHECK(contains(loaded.warnings[0], "no texture coordinates"));
}

TEST_CASE("a caller may give materials their textures, or take them away",
          "[scene][texture]") {
    const test::TempFolder folder;
    folder.write("a.png", coloured());
    folder.write("a.mtl", "newmtl m\nmap_Kd b.jpg\n");
    const std::string path = folder.write("a.obj", kObj);
    MeshFileOptions options;
    options.textures = {{"m*", "no.png"}, {"m", folder.path("a.png")}};
    const Loaded given = load(path, options);
    CHECK(given.allWarnings().empty());
    checkTexels(given.mesh());

    folder.write("a.mtl", "newmtl m\nd 0.5\nmap_d a.png\n");
    options.textures = {{"?", ""}, {"leaf", "a.png"}};
    const Loaded taken = load(path, options);
    CHECK(!taken.mesh().texture);
    CHECK(taken.mesh().opacity == 0.5f);
    REQUIRE(taken.warnings.size() == 1);
    CHECK(contains(taken.warnings[0], "no material's name matches the pattern \"leaf\""));
    CHECK(contains(taken.warnings[0], "materials there are: \"m\""));

    options.textures = {{"m", folder.path("no.png")}};
    const Loaded missing = load(path, options);
    REQUIRE(!missing.seen.status);
    CHECK(missing.seen.status.error().code == ErrorCode::io);
    CHECK(contains(missing.seen.error(), "no.png: cannot be used as a texture"));
}

// --- broken images
// -----------------------------------------------------------------------

TEST_CASE("a broken image is a warning", "[scene][texture][bad-input]") {
    const std::string whole = png(64, 64, 1, std::vector<std::uint8_t>(64 * 64, 7));
    std::string flipped = whole;
    flipped[20] = '\x7f';
    const std::string cases[] = {"",
                                 "this is no picture\n",
                                 whole.substr(0, 4),
                                 whole.substr(0, 20),
                                 whole.substr(0, 40),
                                 whole.substr(0, whole.size() / 2),
                                 flipped,
                                 test::pngHeader(65000, 65000, 4),
                                 test::pngHeader(65000, 2, 1),
                                 test::pngHeader(0, 0, 4)};
    for (const std::string& image : cases) {
        const Loaded loaded = loadObj("d 0.5\nmap_d a.png\n", image);
        INFO(image.size() << " bytes: " << loaded.seen.error());
        REQUIRE(loaded.seen.status);
        CHECK(!loaded.mesh().texture);
        CHECK(loaded.mesh().opacity == 0.5f);
        REQUIRE(loaded.warnings.size() == 1);
        CHECK(contains(loaded.warnings[0], "its texture a.png is not used"));
        CHECK(!contains(loaded.warnings[0], "\n"));
    }
    const Loaded embedded = loadGltf({textured("BLEND")}, whole.substr(0, 99));
    REQUIRE(embedded.seen.status);
    CHECK(embedded.warnings.size() == 1);
}

TEST_CASE("an image that takes more memory than there may be is an error",
          "[scene][texture][bad-input]") {
    if (test::kSanitized) {
        WARN("no memory limit under a sanitizer: skipped");
        return;
    }
    MeshFileOptions options;
    options.importerBytes = std::uint64_t(64) << 20;
    const Loaded loaded = loadObj(
        "map_d a.png\n",
        test::pngHeader(16384, 16384, 1) + test::pngChunk("IDAT\x78\x01"), options);
    REQUIRE(!loaded.seen.status);
    CHECK(loaded.seen.status.error().code == ErrorCode::tooLarge);
}

TEST_CASE("many missing images are not a line each", "[scene][texture][bad-input]") {
    const test::TempFolder folder;
    std::string mtl, obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n";
    for (int i = 0; i < 30; ++i) {
        const std::string name = "m" + std::to_string(i);
        mtl += "newmtl " + name + "\nmap_d " + name + ".png\n";
        obj += "usemtl " + name + "\nf 1/1 2/1 3/1\n";
    }
    folder.write("a.mtl", mtl);
    const Loaded loaded = load(folder.write("a.obj", obj));
    CHECK(loaded.warnings.size() == 11);
    CHECK(contains(loaded.warnings.back(), "20 more textures are not used"));
}

// --- between child and parent
// ------------------------------------------------------------

TEST_CASE("textures count as cached geometry", "[scene][texture]") {
    const test::TempFolder folder;
    folder.write("a.png", png(64, 64, 1, std::vector<std::uint8_t>(64 * 64, 7)));
    folder.write("a.mtl", "newmtl m\nmap_d a.png\n");
    const std::string path = folder.write("a.obj", kObj);
    const auto readsInTwoVisits = [&](std::uint64_t cacheBytes) {
        int reads = 0;
        MeshFileOptions options;
        options.cacheBytes = cacheBytes;
        options.progress = [&](const std::string&) { return ++reads > 0; };
        MeshFiles files({path}, options);
        const Seen first = test::see(files), second = test::see(files);
        CHECK(first.status);
        CHECK(first.meshes == second.meshes);
        CHECK(second.meshes.at(0).texture);
        return reads;
    };
    CHECK(readsInTwoVisits(1 << 20) == 1);
    CHECK(readsInTwoVisits(4 * 64 * 64) == 2);  // the mesh alone would fit
}

TEST_CASE("a texture frame that breaks a rule is refused", "[scene][bad-input]") {
    using namespace mtsm::scene;
    const auto sent = [](const TextureHead& head, const std::vector<float>& texels,
                         std::uint32_t meshTexture = kNoTexture) {
        ImportSink sink;
        sink.texture = [](OpacityImage&&) { return Status{}; };
        sink.mesh = [](PlacedMesh&&) { return Status{}; };
        const test::TempFolder folder;
        return importFile(
                   folder.write("a.obj", "x"), std::uint64_t(1) << 20,
                   [&](FrameWriter& out) {
                       OpacityImage image{head.width,  head.height, head.channels,
                                          texels,      head.wrapU,  head.wrapV,
                                          head.cutoff, head.opacity};
                       out.texture(image);
                       out.mesh({}, {}, {}, {}, meshTexture, glm::vec3(1));
                       out.end();
                   },
                   sink)
            .ok();
    };
    const TextureHead good{2, 1, 1};
    CHECK(sent(good, {0, 1}));
    CHECK(sent(good, {0, 1}, 0));
    CHECK(!sent(good, {0, 1}, 1));  // there is one, number 0
    CHECK(!sent(good, {0}));
    CHECK(!sent(good, {0, 1.5f}));
    CHECK(!sent(good, {NAN, 0}));
    CHECK(!sent({0, 1, 1}, {}));
    CHECK(!sent({16385, 1, 1}, std::vector<float>(16385)));
    CHECK(!sent({2, 1, 2}, std::vector<float>(4)));
    CHECK(!sent({1024, 1024, 1}, std::vector<float>(1024 * 1024)));  // more than 1 MiB
    TextureHead bad = good;
    bad.wrapU = TextureWrap(7);
    CHECK(!sent(bad, {0, 1}));
    bad = good;
    bad.cutoff = NAN;
    CHECK(!sent(bad, {0, 1}));
    bad = good;
    bad.opacity = 2;
    CHECK(!sent(bad, {0, 1}));
}

TEST_CASE("all textures of a file count against the importer's limit",
          "[scene][bad-input]") {
    using namespace mtsm::scene;
    const auto sent = [](int images) {
        ImportSink sink;
        sink.texture = [](OpacityImage&&) { return Status{}; };
        const test::TempFolder folder;
        return importFile(
            folder.write("a.obj", "x"), std::uint64_t(1) << 20,
            [&](FrameWriter& out) {
                OpacityImage image;
                image.width = 384;
                image.height = 256;
                image.texels.assign(std::size_t(384) * 256, 1.0f);  // 384 KiB
                for (int i = 0; i < images; ++i)
                    out.texture(image);
                out.end();
            },
            sink);
    };
    CHECK(sent(2));
    const Status three = sent(3);
    REQUIRE_FALSE(three);
    CHECK(three.error().code == ErrorCode::tooLarge);
    CHECK(contains(three.error().message, "a.obj"));
}
