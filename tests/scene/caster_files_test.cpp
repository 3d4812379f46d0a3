// CasterFiles: the right reader for each file, its settings, and its place in the world.
#include "mtsm/caster_files.h"

#include <catch2/catch.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>

#include "scene_fixture.h"

using namespace mtsm;
using test::contains;
using test::TempFolder;

namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();

const char* const kTriangle = "o tri\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
const char* const kLines = "v 0 0 0\nv 0 0 1\nv 0 0 3\nl 1 2 3\n";

/// Yuksel's format: one strand of two points, (0 0 0) and (0 0 2), 0.25 wide.
std::string hairBytes() {
    constexpr std::uint32_t kPoints = 2;  // flag: the file has points
    std::string head = "HAIR" + test::bytesOf<std::uint32_t>({1, 2, kPoints, 1}) +
                       test::bytesOf<float>({0.25f, 0, 1, 1, 1});
    head.resize(128, '\0');
    return head + test::bytesOf<float>({0, 0, 0, 0, 0, 2});
}

/// What a visitor saw, points taken to the world.
struct Casters {
    Status status;
    std::size_t meshes = 0, strands = 0, volumes = 0;
    std::vector<glm::dvec3> points;
    float width = 0, opacity = 0;  // of the last caster
};

Casters see(CasterFiles& files) {
    Casters seen;
    const auto place = [&](const glm::dmat4& m, const glm::vec3* points, std::size_t n) {
        for (std::size_t i = 0; i < n; ++i)
            seen.points.emplace_back(m * glm::dvec4(glm::dvec3(points[i]), 1.0));
    };
    seen.status = files.visit([&](const CasterView& view) -> Status {
        if (const auto* mesh = std::get_if<MeshView>(&view)) {
            seen.meshes += 1;
            seen.opacity = mesh->opacity;
            place(mesh->worldFromObject, mesh->positions, mesh->vertexCount);
        }
        if (const auto* s = std::get_if<StrandsView>(&view)) {
            seen.strands += s->strandCount;
            seen.width = s->widths ? s->widths[0] : s->width;
            seen.opacity = s->opacities ? s->opacities[0] : s->opacity;
            place(s->worldFromObject, s->points, s->begin[s->strandCount]);
        }
        if (std::holds_alternative<VolumeView>(view)) seen.volumes += 1;
        return {};
    });
    return seen;
}

Casters see(std::vector<CasterFile> list) {
    CasterFiles files(std::move(list));
    return see(files);
}

CasterFile at(const std::string& path, glm::dvec3 offset = glm::dvec3(0.0)) {
    CasterFile file;
    file.path = path;
    file.transform = glm::translate(glm::dmat4(1.0), offset);
    return file;
}

}  // namespace

TEST_CASE("a file's extension says what it holds", "[scene]") {
    CHECK(casterKind("a.b/FUR.Hair") == CasterKind::hair);
    CHECK(casterKind("fur.tfx") == CasterKind::hair);
    CHECK(casterKind("smoke.VDB") == CasterKind::volume);
    for (const char* mesh : {"a.obj", "a.ply", "a", "hair", "a.hair.glb", ""})
        CHECK(casterKind(mesh) == CasterKind::mesh);
    CHECK(mayHold("a.OBJ", CasterKind::hair));
    CHECK(mayHold("a.obj", CasterKind::mesh));
    CHECK_FALSE(mayHold("a.ply", CasterKind::hair));
    CHECK_FALSE(mayHold("a.hair", CasterKind::mesh));
}

TEST_CASE("casters of every file stand where its transform puts them", "[scene]") {
    const TempFolder folder;
    const std::string mesh = folder.write("a.obj", kTriangle);
    const std::string hair = folder.write("b.hair", hairBytes());
    CasterFile turned = at(hair, {0, 10, 0});
    turned.transform *= glm::scale(glm::dmat4(1.0), glm::dvec3(1, 1, 3));
    CasterFiles files({at(mesh, {5, 0, 0}), turned, at(mesh)});
    for (int visit = 0; visit < 2; ++visit) {
        const Casters seen = see(files);
        INFO(seen.status.ok());
        REQUIRE(seen.status);
        CHECK(seen.meshes == 2);
        CHECK(seen.strands == 1);
        CHECK(seen.width == 0.25f);
        CHECK(seen.points == std::vector<glm::dvec3>{{5, 0, 0},
                                                     {6, 0, 0},
                                                     {5, 1, 0},
                                                     {0, 10, 0},
                                                     {0, 10, 6},
                                                     {0, 0, 0},
                                                     {1, 0, 0},
                                                     {0, 1, 0}});
    }
}

TEST_CASE("an OBJ gives its faces and its polylines", "[scene]") {
    const TempFolder folder;
    CasterFile both = at(folder.write("both.obj", std::string(kTriangle) + "l 1 2 3\n"));
    both.hairWidth = 0.5f;
    const Casters seen = see({both});
    REQUIRE(seen.status);
    CHECK(seen.meshes == 1);
    CHECK(seen.strands == 1);
    CHECK(seen.width == 0.5f);

    CasterFile lines = at(folder.write("lines.obj", kLines));
    lines.hairOpacity = 0.25f;
    lines.hairWidth = 0.5f;
    const Casters strands = see({lines});
    REQUIRE(strands.status);
    CHECK(strands.meshes == 0);
    CHECK(strands.strands == 1);
    CHECK(strands.opacity == 0.25f);
}

TEST_CASE("lines of an OBJ are strands, and so not ignored", "[scene]") {
    const TempFolder folder;
    CasterFile both = at(folder.write("both.obj", std::string(kTriangle) + "l 1 2 3\n"));
    both.hairWidth = 0.5f;
    std::vector<std::string> warnings;
    CasterFilesOptions options;
    options.warn = [&](const std::string& text) { warnings.push_back(text); };
    CasterFiles files({both}, options);
    REQUIRE(see(files).status);
    CHECK(warnings.empty());
}

TEST_CASE("a width of strands is in world units whatever the transform", "[scene]") {
    const TempFolder folder;
    CasterFile hair = at(folder.write("a.hair", hairBytes()));
    hair.transform = glm::scale(hair.transform, glm::dvec3(4, 4, -4));
    hair.hairWidth = 0.5f;
    CHECK(see({hair}).width == 0.125f);  // which the transform makes 0.5
    hair.hairTipWidth = 0.25f;
    CHECK(see({hair}).width == 0.125f);
    hair.hairWidth = hair.hairTipWidth = std::nullopt;
    CHECK(see({hair}).width == 0.25f);  // the file's
}

TEST_CASE("settings of an OBJ that it has no use for are warned of", "[scene]") {
    const TempFolder folder;
    CasterFile faces = at(folder.write("faces.obj", kTriangle));
    CasterFile lines = at(folder.write("lines.obj", kLines));
    const auto warnings = [](const std::vector<CasterFile>& list) {
        std::string all;
        CasterFilesOptions options;
        options.warn = [&](const std::string& text) { all += text + "\n"; };
        CasterFiles files(list, options);
        for (int visit = 0; visit < 2; ++visit)
            CHECK(see(files).status);
        return all;
    };
    faces.hairWidth = lines.hairWidth = 0.5f;
    CHECK(warnings({faces}) ==
          faces.path +
              ": hair-width has no effect: the file holds no strands "
              "(polylines)\n");
    lines.opacity = 0.5f;
    CHECK(warnings({lines}) ==
          lines.path + ": opacity has no effect: the file holds no faces\n");
    faces.opacity = 0.5f;
    CHECK(warnings({faces, lines}).empty());  // each is of use to one of them
}

TEST_CASE("files are kept between visits in their order, while they fit", "[scene]") {
    const TempFolder folder;
    // Two meshes that cannot stand together. A comment makes the second a long file.
    CasterFile small = at(folder.write("small.obj", kTriangle), {0, 0, 1});
    const CasterFile large = at(folder.write(
        "large.obj", kTriangle + std::string(std::size_t(1) << 20, '#') + "\n"));
    std::vector<std::string> read;
    CasterFilesOptions options;
    options.cacheBytes = 4096;  // enough for both, whatever the files' lengths
    options.progress = [&](const std::string& path) {
        read.push_back(path);
        return true;
    };
    CasterFiles files({small, large}, options);
    REQUIRE(see(files).status);
    REQUIRE(see(files).status);
    CHECK(read == std::vector<std::string>{small.path, large.path});
}

TEST_CASE("meshes with the same settings share include, others do not", "[scene]") {
    const TempFolder folder;
    CasterFile tri = at(folder.write("tri.obj", kTriangle));
    CasterFile quad =
        at(folder.write("quad.obj", "o other\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"));
    tri.include = quad.include = {"tri"};
    CHECK(see({tri, quad}).meshes == 1);
    quad.opacity = 0.5f;
    const Casters apart = see({tri, quad});
    REQUIRE_FALSE(apart.status);
    CHECK(apart.status.error().code == ErrorCode::badArgument);
    quad.include = {};
    const Casters own = see({tri, quad});
    CHECK(own.meshes == 2);
    CHECK(own.opacity == 0.5f);
}

TEST_CASE("settings of another kind of file are refused before anything is read",
          "[scene][bad-input]") {
    const auto refused = [](const std::string& path, const char* setting, auto&& set) {
        CasterFile file = at(path);
        set(file);
        const Status s = see({at("not_there.obj"), file}).status;
        REQUIRE_FALSE(s);
        INFO(s.error().message);
        CHECK(s.error().code == ErrorCode::badArgument);
        CHECK(contains(s.error().message, path));
        CHECK(contains(s.error().message, setting));
    };
    for (const char* path : {"a.hair", "a.vdb"}) {
        refused(path, "opacity", [](CasterFile& f) { f.opacity = 0.5f; });
        refused(path, "include", [](CasterFile& f) { f.include = {"x"}; });
        refused(path, "exclude", [](CasterFile& f) { f.exclude = {"x"}; });
        refused(path, "texture", [](CasterFile& f) { f.textures = {{"x", "x.png"}}; });
    }
    for (const char* path : {"a.ply", "a.vdb"}) {
        refused(path, "hair-width", [](CasterFile& f) { f.hairWidth = 1.0f; });
        refused(path, "hair-tip-width", [](CasterFile& f) { f.hairTipWidth = 1.0f; });
        refused(path, "hair-opacity", [](CasterFile& f) { f.hairOpacity = 1.0f; });
        refused(path, "hair-scale", [](CasterFile& f) { f.hairScale = 2.0f; });
    }
    for (const char* path : {"a.obj", "a.tfx"}) {
        refused(path, "density-grid", [](CasterFile& f) { f.densityGrid = "d"; });
        refused(path, "density-scale", [](CasterFile& f) { f.densityScale = 2.0f; });
    }
}

TEST_CASE("numbers out of range are refused by name", "[scene][bad-input]") {
    const auto refused = [](const std::string& path, const char* setting, auto&& set) {
        for (const float bad : {-1.0f, kInf, std::nanf("")}) {
            CasterFile file = at(path);
            set(file, bad);
            const Status s = checkCaster(file);
            REQUIRE_FALSE(s);
            CHECK(contains(s.error().message, setting));
        }
    };
    refused("a.obj", "opacity", [](CasterFile& f, float v) { f.opacity = v; });
    refused("a.hair", "hair-width", [](CasterFile& f, float v) { f.hairWidth = v; });
    refused("a.hair", "hair-tip-width", [](CasterFile& f, float v) {
        f.hairWidth = 1.0f;
        f.hairTipWidth = v;
    });
    refused("a.hair", "hair-opacity", [](CasterFile& f, float v) { f.hairOpacity = v; });
    refused("a.hair", "hair-scale", [](CasterFile& f, float v) { f.hairScale = v; });
    refused("a.vdb", "density-scale", [](CasterFile& f, float v) { f.densityScale = v; });
    refused("a.obj", "transform",
            [](CasterFile& f, float v) { f.transform[3][3] = double(v); });

    CasterFile tip = at("a.hair");
    tip.hairTipWidth = 1.0f;
    CHECK_FALSE(checkCaster(tip));
    CasterFile flat = at("a.obj");
    flat.transform[1] = glm::dvec4(0.0);
    CHECK_FALSE(checkCaster(flat));
    CHECK_FALSE(see(std::vector<CasterFile>{}).status);
}
