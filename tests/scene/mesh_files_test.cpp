// MeshFiles: every format, every node, every name; once read, always the same.
#include <atomic>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;
using test::bytesOf;
using test::contains;
using test::gltfMesh;
using test::seeFile;

namespace {

const char* const kTriangleObj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// A hero under a group, a floor, and a hero's twin: three instances of two meshes.
std::string scene() {
    return test::gltf(
        R"("nodes":[{"name":"group","translation":[0,0,5],"children":[1,2]},
           {"name":"hero","mesh":0,"translation":[1,0,0]},
           {"name":"twin","mesh":0,"scale":[2,2,2]},
           {"name":"ground","mesh":1}],
           "meshes":[)" +
            gltfMesh("body", "0") + "," + gltfMesh("floor", "1") +
            R"(],"materials":[{"name":"skin"},{"name":"stone"}],)",
        "0,3");
}

std::size_t meshesWith(const std::string& path, std::vector<std::string> include,
                       std::vector<std::string> exclude) {
    MeshFileOptions options;
    options.include = std::move(include);
    options.exclude = std::move(exclude);
    return seeFile(path, options).meshes.size();
}

std::string binaryStl(std::uint32_t declared, std::uint32_t triangles) {
    std::string file(80, ' ');
    file += bytesOf<std::uint32_t>({declared});
    for (std::uint32_t i = 0; i < triangles; ++i)
        file +=
            bytesOf<float>({0, 0, 1, 0, 0, float(i), 1, 0, float(i), 0, 1, float(i)}) +
            std::string(2, '\0');
    return file;
}

}  // namespace

TEST_CASE("one triangle comes out of every format the same", "[scene][exact]") {
    const test::TempFolder folder;
    const std::string parts = R"("nodes":[{"mesh":0}],"meshes":[)" + gltfMesh("m") + "],";
    const std::string node =
        "<node id=\"n\" name=\"n\">" + std::string(test::kColladaTriangle) + "</node>";
    for (const std::string& path :
         {folder.write("a.obj", kTriangleObj), folder.write("a.gltf", test::gltf(parts)),
          folder.write("a.glb", test::glb(parts)),
          folder.write("a.dae", test::collada("", node)),
          folder.write("a.stl", binaryStl(1, 1)),
          folder.write("b.stl",
                       "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
                       "vertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n"),
          folder.write("a.ply",
                       "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
                       "property float y\nproperty float z\nelement face 1\n"
                       "property list uchar int vertex_indices\nend_header\n"
                       "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")}) {
        INFO(path);
        std::vector<std::string> warnings;
        const auto seen = seeFile(path, warnings);
        INFO(seen.error());
        REQUIRE(seen.status);
        REQUIRE(seen.meshes.size() == 1);
        const test::SeenMesh& mesh = seen.meshes[0];
        REQUIRE(mesh.indices.size() == 3);
        CHECK(mesh.world[mesh.indices[0]] == glm::dvec3(0, 0, 0));
        CHECK(mesh.world[mesh.indices[1]] == glm::dvec3(1, 0, 0));
        CHECK(mesh.world[mesh.indices[2]] == glm::dvec3(0, 1, 0));
        CHECK(mesh.opacity == 1.0f);
        CHECK(warnings.empty());
    }
}

TEST_CASE("a mesh is visited once per node, under all its ancestors' transforms",
          "[scene][exact]") {
    const test::TempFolder folder;
    const auto seen = seeFile(folder.write("a.gltf", scene()));
    REQUIRE(seen.meshes.size() == 3);
    CHECK(seen.meshes[0].world[1] == glm::dvec3(2, 0, 5));
    CHECK(seen.meshes[1].world[1] == glm::dvec3(2, 0, 5));
    CHECK(seen.meshes[1].world[0] == glm::dvec3(0, 0, 5));
    CHECK(seen.meshes[2].world[1] == glm::dvec3(1, 0, 0));
    CHECK(seen.area() == 0.5 + 2.0 + 0.5);
}

TEST_CASE("transforms add up in double precision", "[scene][exact]") {
    const test::TempFolder folder;
    // In floats 16777216 + 1 = 16777216; the two nodes must not be summed there.
    const auto seen = seeFile(folder.write(
        "a.gltf", test::gltf(R"("nodes":[{"translation":[16777216,0,0],"children":[1]},
                      {"translation":[1,0,0],"mesh":0}],"meshes":[)" +
                             gltfMesh("m") + "],")));
    REQUIRE(seen.meshes.size() == 1);
    CHECK(seen.meshes[0].world[0].x == 16777217.0);
}

TEST_CASE("glTF strips and fans become triangles", "[scene][exact]") {
    const test::TempFolder folder;
    for (const std::string mode : {"5", "6"}) {
        const auto seen = seeFile(folder.write(
            "a.gltf", test::gltf(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[
                      {"attributes":{"POSITION":0},"indices":1,"mode":)" +
                                 mode + "}]}],")));
        CHECK(seen.triangles() == 1);
        CHECK(seen.area() == 0.5);
    }
}

TEST_CASE("points and lines are left out, with one warning", "[scene]") {
    const test::TempFolder folder;
    std::vector<std::string> warnings;
    const auto seen =
        seeFile(folder.write("a.obj", std::string(kTriangleObj) + "p 1\np 2\nl 1 2 3\n"),
                warnings);
    REQUIRE(seen.status);
    CHECK(seen.triangles() == 1);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "a.obj: ignored 2 points and 2 lines"));

    const auto none =
        seeFile(folder.write("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\n"));
    REQUIRE(!none.status);
    CHECK(none.status.error().code == ErrorCode::badFile);
    CHECK(
        contains(none.error(), "b.obj: no triangles: 0 points and 2 lines were ignored"));
}

TEST_CASE("animations and morph targets are left out, with one warning", "[scene]") {
    const test::TempFolder folder;
    std::vector<std::string> warnings;
    const auto seen =
        seeFile(folder.write("a.gltf",
                             test::gltf(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[
            {"attributes":{"POSITION":0},"indices":1,"targets":[{"POSITION":0}]}]}],
            "animations":[{"channels":[],"samplers":[]}],)")),
                warnings);
    INFO(seen.error());
    REQUIRE(seen.status);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "ignored 1 morph target and 1 animation"));
}

TEST_CASE("include and exclude match nodes, their ancestors, meshes and materials",
          "[scene][exact]") {
    const test::TempFolder folder;
    const std::string path = folder.write("a.gltf", scene());
    CHECK(meshesWith(path, {}, {}) == 3);
    CHECK(meshesWith(path, {"hero"}, {}) == 1);   // node
    CHECK(meshesWith(path, {"body"}, {}) == 2);   // mesh
    CHECK(meshesWith(path, {"stone"}, {}) == 1);  // material
    CHECK(meshesWith(path, {"group"}, {}) == 2);  // ancestor
    CHECK(meshesWith(path, {}, {"floor"}) == 2);
    CHECK(meshesWith(path, {}, {"gr*"}) == 0);  // the group and the ground
    CHECK(meshesWith(path, {"h?r[a-f]", "fl*"}, {}) == 1);
    CHECK(meshesWith(path, {"h?r[m-p]", "fl*"}, {}) == 2);
    CHECK(meshesWith(path, {"body"}, {"twin"}) == 1);
    CHECK(meshesWith(path, {"ero"}, {}) == 0);  // whole names
}

TEST_CASE("if no mesh passes, the error lists the names there are",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    MeshFileOptions options;
    options.include = {"nobody"};
    const auto seen = seeFile(folder.write("a.gltf", scene()), options);
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::badArgument);
    for (const char* name : {"group", "hero", "body", "skin", "twin", "ground", "stone"})
        CHECK(contains(seen.error(), "\"" + std::string(name) + "\""));

    std::string many = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (int i = 0; i < 50; ++i)
        many += "o part" + std::to_string(i) + "\nf 1 2 3\n";
    const auto crowd = seeFile(folder.write("b.obj", many), options);
    REQUIRE(!crowd.status);
    CHECK(contains(crowd.error(), "more"));
    CHECK(crowd.error().size() < 500);
}

TEST_CASE("it is enough if one file of several has a mesh that passes", "[scene]") {
    const test::TempFolder folder;
    MeshFileOptions options;
    options.include = {"hero"};
    MeshFiles files(
        {folder.write("a.obj", kTriangleObj), folder.write("b.gltf", scene())}, options);
    const auto seen = test::see(files);
    REQUIRE(seen.status);
    CHECK(seen.meshes.size() == 1);
}

TEST_CASE("vertices that are not finite pass through", "[scene]") {
    const test::TempFolder folder;
    const auto seen = seeFile(folder.write(
        "a.obj", "v nan 0 0\nv 1 inf 0\nv 0 1 0\nv 0 0 0\nf 1 2 3\nf 2 3 4\n"));
    REQUIRE(seen.status);
    REQUIRE(seen.triangles() == 2);
    const test::SeenMesh& mesh = seen.meshes[0];
    CHECK(std::isnan(mesh.world[mesh.indices[0]].x));
    CHECK(!std::isfinite(mesh.world[mesh.indices[1]].y));
}

TEST_CASE("degenerate triangles pass through: the bake counts them", "[scene]") {
    const test::TempFolder folder;
    const auto seen = seeFile(folder.write(
        "a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 2\nf 1 2 4\n"));
    REQUIRE(seen.status);
    CHECK(seen.triangles() == 3);
    CHECK(seen.area() == 0.5);
}

TEST_CASE("indices out of range are an error in every format", "[scene][bad-input]") {
    const test::TempFolder folder;
    std::string outOfRange = test::gltf(
        R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0},
           "indices":1},{"attributes":{"POSITION":0},"indices":1}]}],)");
    const std::string good = test::base64(test::triangleNumbers());
    outOfRange.replace(outOfRange.find(good), good.size(),
                       test::base64(bytesOf<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}) +
                                    bytesOf<std::uint16_t>({0, 1, 900})));
    for (const std::string& path :
         {folder.write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n"),
          folder.write("b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 -7\n"),
          folder.write("a.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 7\n"),
          folder.write("a.gltf", outOfRange)}) {
        INFO(path);
        const auto seen = seeFile(path);
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), path));
        CHECK(seen.meshes.empty());
    }
}

TEST_CASE("an OFF file that states more than its bytes can hold is refused at once",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    const std::string triangle = " 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    for (const std::string head :
         {"OFF\n400000000 1", "OFF 3 400000000",
          "OFF # lies\n# below\n3 99999999999999999999", "STCN4nOFF 3 3 400000000",
          "# a comment first\nOFF\n400000000 1", "400000000 1"}) {
        INFO(head);
        const auto seen = seeFile(folder.write("a.off", head + triangle));
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), "bytes can hold"));
    }
    const auto whole = seeFile(folder.write("a.off", "OFF\n# honest\n3 1" + triangle));
    CHECK(whole.status);
    CHECK(whole.meshes.size() == 1);
    for (const std::string head :
         {"# 90000000 triangles\nOFF 3 1", "OFF\n3#v 90000000\n1"}) {
        INFO(head);
        const auto seen = seeFile(folder.write("a.off", head + triangle));
        if (!seen.status) CHECK(!contains(seen.error(), "bytes can hold"));
    }
    const auto other = seeFile(folder.write(
        "a.obj", "#KICKOFF 20260101 scene\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"));
    CHECK(other.status);
}

TEST_CASE("a pattern that matches no name is told", "[scene]") {
    const test::TempFolder folder;
    const std::string path = folder.write("s.gltf", scene());
    std::vector<std::string> warnings;
    MeshFileOptions options;
    options.include = {"hero", "twin"};
    options.exclude = {"Floor", "ground"};  // the mesh is called "floor"
    const auto seen = seeFile(path, warnings, options);
    CHECK(seen.meshes.size() == 2);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], path));
    CHECK(contains(warnings[0], "\"Floor\""));
}

TEST_CASE("files that are cut off, empty or something else are errors that name them",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    const std::string parts = R"("nodes":[{"mesh":0}],"meshes":[)" + gltfMesh("m") + "],";
    const std::string whole = test::glb(parts);
    for (const std::string& path :
         {folder.write("cut.glb", whole.substr(0, whole.size() - 20)),
          folder.write("cut.gltf", test::gltf(parts).substr(0, 300)),
          folder.write("cut.stl", binaryStl(10, 3)),
          folder.write("cut.dae", test::collada("", "").substr(0, 900)),
          folder.write("empty.obj", ""), folder.write("blank.obj", "# nothing\n\n\n\n\n"),
          folder.write("text.ply", "this is not a mesh")}) {
        INFO(path);
        const auto seen = seeFile(path);
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), path));
        CHECK(!contains(seen.error(), "\n"));
    }
    const auto unknown = seeFile(folder.write("a.unknown", "this is not a mesh either"));
    REQUIRE(!unknown.status);
    CHECK(unknown.status.error().code == ErrorCode::unsupported);
    CHECK(contains(unknown.error(), "PLY, OBJ"));
    for (const std::string& path : {folder.path("missing.obj"), folder.path("")}) {
        const auto seen = seeFile(path);
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::io);
    }
    MeshFiles none({});
    const auto seen = test::see(none);
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::badArgument);
}

TEST_CASE("a material library that is missing is told", "[scene]") {
    const test::TempFolder folder;
    std::vector<std::string> warnings;
    REQUIRE(
        seeFile(folder.write("a.obj", std::string("mtllib gone.mtl\n") + kTriangleObj),
                warnings)
            .status);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "gone.mtl"));
}

TEST_CASE("every visit shows the same meshes, from the cache or not", "[scene][exact]") {
    const test::TempFolder folder;
    const std::string first = folder.write("a.gltf", scene());
    const std::string second = folder.write("b.obj", kTriangleObj);
    for (const std::uint64_t cache :
         {std::uint64_t(0), std::uint64_t(200), std::uint64_t(1) << 30}) {
        INFO("cache of " << cache << " bytes");
        MeshFileOptions options;
        options.cacheBytes = cache;
        int reads = 0, warnings = 0;
        options.progress = [&](const std::string&) { return ++reads > 0; };
        options.warn = [&](const std::string&) { ++warnings; };
        const std::string third =
            folder.write("c.obj", std::string(kTriangleObj) + "p 1\n");
        MeshFiles files({first, second, third}, options);
        const auto one = test::see(files);
        REQUIRE(one.status);
        CHECK(one.meshes.size() == 5);
        CHECK(reads == 3);
        const auto two = test::see(files);
        REQUIRE(two.status);
        CHECK(two.meshes == one.meshes);
        // 200 bytes hold one of the small files, and none of the other two besides it.
        CHECK(reads == (cache == 0 ? 6 : cache == 200 ? 5 : 3));
        CHECK(warnings == 1);
    }
}

TEST_CASE("what is cached needs its file no more, and a changed file is noticed",
          "[scene]") {
    const test::TempFolder folder;
    for (const bool cached : {true, false}) {
        const std::string path = folder.write("a.obj", kTriangleObj);
        MeshFileOptions options;
        options.cacheBytes = cached ? 1 << 20 : 0;
        MeshFiles files({path}, options);
        REQUIRE(test::see(files).status);
        folder.write("a.obj", std::string(kTriangleObj) + "f 1 3 2\n");
        const auto again = test::see(files);
        CHECK(again.status.ok() == cached);
        if (!cached) CHECK(contains(again.error(), "changed while it was in use"));
    }
}

TEST_CASE("a visitor can stop, and the next visit starts afresh", "[scene]") {
    const test::TempFolder folder;
    MeshFiles files({folder.write("a.gltf", scene())});
    int calls = 0;
    const Status stopped = files.visit([&](const CasterView&) -> Status {
        ++calls;
        return Error{ErrorCode::cancelled, "enough"};
    });
    REQUIRE(!stopped);
    CHECK(stopped.error().message == "enough");
    CHECK(calls == 1);
    CHECK(test::see(files).meshes.size() == 3);
}

TEST_CASE("reading can be cancelled before each file", "[scene]") {
    const test::TempFolder folder;
    MeshFileOptions options;
    std::vector<std::string> asked;
    options.progress = [&](const std::string& path) {
        asked.push_back(path);
        return asked.size() < 2;
    };
    const std::string a = folder.write("a.obj", kTriangleObj);
    const std::string b = folder.write("b.obj", kTriangleObj);
    MeshFiles files({a, b}, options);
    const auto seen = test::see(files);
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::cancelled);
    CHECK(seen.meshes.size() == 1);
    CHECK(asked == std::vector<std::string>{a, b});
}

TEST_CASE("several threads may read files at once", "[scene]") {
    if (test::kSanitized) {
        WARN("the sanitizers' allocators do not survive such a fork: skipped");
        return;
    }
    const test::TempFolder folder;
    const std::string path = folder.write("a.gltf", scene());
    std::atomic<int> good = 0;
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
        threads.emplace_back([&] {
            for (int i = 0; i < 10; ++i)
                good += seeFile(path).meshes.size() == 3;
        });
    for (std::thread& thread : threads)
        thread.join();
    CHECK(good == 40);
}

TEST_CASE("meshes in memory are visited in their order until the visitor stops",
          "[scene]") {
    const glm::vec3 positions[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    const std::uint32_t indices[] = {0, 1, 2};
    MeshView view{positions, 3, indices, 1, glm::dmat4(1.0), 0.5f};
    MeshView other = view;
    other.opacity = 0.25f;
    CasterViews views({view, other});
    const auto seen = test::see(views);
    REQUIRE(seen.meshes.size() == 2);
    CHECK(seen.meshes[0].opacity == 0.5f);
    CHECK(seen.meshes[1].opacity == 0.25f);
    const Status stopped = views.visit([](const CasterView&) -> Status {
        return Error{ErrorCode::cancelled, "enough"};
    });
    CHECK(!stopped);
}
