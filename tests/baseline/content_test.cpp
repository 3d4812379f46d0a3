// The number of a scene's content, and the files of values kept under such numbers.
#include "baseline/content.h"

#include <catch2/catch.hpp>
#include <cstring>
#include <functional>
#include <map>
#include <set>

#include "io/temp_folder.h"

using namespace mtsm;
using namespace mtsm::baseline;

namespace {

OpacityImage leaf(std::uint32_t side) {
    OpacityImage image;
    image.width = image.height = side;
    for (std::uint32_t i = 0; i < side * side; ++i)
        image.texels.push_back(float(i * 7 % 11) / 16.0f);
    return image;
}

/// One caster of each kind, every field of which may be changed.
struct Scene {
    std::vector<glm::vec3> positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
    std::vector<std::uint32_t> indices = {0, 1, 2, 2, 1, 3};
    std::vector<glm::vec2> uvs = {{0, 0}, {1, 0}, {0, 1}, {1, 1}};
    OpacityImage image = leaf(8);
    MeshView mesh;
    std::vector<glm::vec3> points = {
        {0, 0, 0}, {0, 1, 0}, {0, 2, 0}, {1, 0, 0}, {1, 1, 0}};
    std::vector<std::uint32_t> begin = {0, 3, 5};
    std::vector<float> widths = std::vector<float>(5, 0.1f);
    std::vector<float> opacities = std::vector<float>(5, 0.5f);
    StrandsView strands;
    std::vector<glm::ivec3> blocks = {{0, 0, 0}, {8, 0, 0}};
    std::vector<float> density = std::vector<float>(2 * VolumeView::kBlockVoxels, 0.25f);
    VolumeView volume;
    bool textured = true, swapped = false, twice = false;

    [[nodiscard]] std::uint64_t content() {
        const auto texture = OpacityTexture::create(image);
        REQUIRE(texture);
        mesh.positions = positions.data();
        mesh.vertexCount = positions.size();
        mesh.indices = indices.data();
        mesh.triangleCount = indices.size() / 3;
        mesh.uvs = uvs.empty() ? nullptr : uvs.data();
        mesh.texture = textured ? &*texture : nullptr;
        strands.points = points.data();
        strands.begin = begin.data();
        strands.strandCount = begin.size() - 1;
        strands.widths = widths.empty() ? nullptr : widths.data();
        strands.opacities = opacities.empty() ? nullptr : opacities.data();
        volume.blocks = blocks.data();
        volume.blockCount = blocks.size();
        volume.density = density.data();
        std::vector<CasterView> all = {mesh, strands, volume};
        if (swapped) std::swap(all[0], all[1]);
        if (twice) all.push_back(mesh);
        CasterViews casters(all);
        const auto content = contentOf(casters);
        REQUIRE(content);
        return *content;
    }
};

using Change = std::function<void(Scene&)>;

const std::map<std::string, Change> kChanges = {
    {"a position, by one bit", [](Scene& s) { s.positions[3].z = 1e-45f; }},
    {"a vertex that no triangle uses",
     [](Scene& s) {
         s.positions.emplace_back(5);
         s.uvs.emplace_back(0);
     }},
    {"an index", [](Scene& s) { s.indices[5] = 0; }},
    {"a triangle less", [](Scene& s) { s.indices.resize(3); }},
    {"the mesh's place", [](Scene& s) { s.mesh.worldFromObject[3].x = 1e-9; }},
    {"the mesh's opacity", [](Scene& s) { s.mesh.opacity = 0.5f; }},
    {"the mesh's tint", [](Scene& s) { s.mesh.tint.y = 0.5f; }},
    {"a texture coordinate", [](Scene& s) { s.uvs[2].y = 0.5f; }},
    {"no texture coordinates", [](Scene& s) { s.uvs.clear(); }},
    {"no texture", [](Scene& s) { s.textured = false; }},
    {"a texel", [](Scene& s) { s.image.texels[63] = 1.0f; }},
    {"the texture's opacity", [](Scene& s) { s.image.opacity = 0.5f; }},
    {"the texture's cutoff", [](Scene& s) { s.image.cutoff = 0.3f; }},
    {"another cutoff", [](Scene& s) { s.image.cutoff = 0.31f; }},
    {"clamped from left to right", [](Scene& s) { s.image.wrapU = TextureWrap::clamp; }},
    {"clamped from top to bottom", [](Scene& s) { s.image.wrapV = TextureWrap::clamp; }},
    {"mirrored", [](Scene& s) { s.image.wrapU = TextureWrap::mirror; }},
    {"a strand's point", [](Scene& s) { s.points[4].x = 1.5f; }},
    {"where strands begin", [](Scene& s) { s.begin[1] = 2; }},
    {"a strand less", [](Scene& s) { s.begin.pop_back(); }},
    {"a width", [](Scene& s) { s.widths[0] = 0.2f; }},
    {"no widths", [](Scene& s) { s.widths.clear(); }},
    {"the width of all", [](Scene& s) { s.strands.width = 0.1f; }},
    {"a strand's opacity", [](Scene& s) { s.opacities[4] = 0.25f; }},
    {"no opacities of strands", [](Scene& s) { s.opacities.clear(); }},
    {"the strands' opacity", [](Scene& s) { s.strands.opacity = 0.5f; }},
    {"the strands' place", [](Scene& s) { s.strands.worldFromObject[3].y = 2; }},
    {"a block's place", [](Scene& s) { s.blocks[1].z = 8; }},
    {"a voxel", [](Scene& s) { s.density[777] = 0.5f; }},
    {"the volume's place", [](Scene& s) { s.volume.worldFromIndex[0].x = 2; }},
    {"the extinction", [](Scene& s) { s.volume.extinction = 2; }},
    {"the order of casters", [](Scene& s) { s.swapped = true; }},
    {"a caster more", [](Scene& s) { s.twice = true; }},
};

AreaLight someLight() {
    AreaLight light;
    light.shape = LightShape::rect;
    light.position = {1, 2, 3};
    light.size = {0.5, 0.25};
    light.radius = 0.25;
    return light;
}

/// Receivers over arrays.
struct Points {
    std::vector<glm::dvec3> points = std::vector<glm::dvec3>(4, glm::dvec3(1.0)),
                            normals = points, starts = points;
    std::vector<std::size_t> first = {0, 1, 2, 3, 4};

    [[nodiscard]] std::uint64_t content() const {
        Receivers r;
        r.points = points.data();
        r.normals = normals.data();
        r.starts = starts.data();
        r.count = points.size();
        r.first = first.data();
        r.pixels = first.size() - 1;
        return contentOf(r);
    }
};

std::string refusal(const std::string& path, std::uint64_t key, std::size_t count) {
    const auto read = readValues(path, key, count);
    REQUIRE_FALSE(read);
    CHECK(read.error().code == ErrorCode::badFile);
    CHECK_THAT(read.error().message, Catch::Contains(path));
    CHECK_THAT(read.error().message, Catch::Contains("delete it"));
    return read.error().message;
}

}  // namespace

TEST_CASE("the same casters have the same number wherever they lie in memory",
          "[baseline]") {
    Scene a, b;
    b.textured = a.textured = true;
    CHECK(a.content() == b.content());
    CHECK(a.content() == a.content());
}

TEST_CASE("whatever changes in a caster changes the number", "[baseline]") {
    std::map<std::uint64_t, std::string> known = {{Scene().content(), "nothing"}};
    for (const auto& [what, change] : kChanges) {
        Scene scene;
        change(scene);
        const auto [at, fresh] = known.emplace(scene.content(), what);
        INFO(what << " is like " << at->second);
        CHECK(fresh);
    }
}

TEST_CASE("any single texel of a large texture changes the number", "[baseline]") {
    // More texels than lookups: 1 by 1 would miss most of them.
    Scene scene;
    scene.image = leaf(512);
    std::set<std::uint64_t> all = {scene.content()};
    for (const std::size_t texel : {0u, 1u, 513u, 100'003u, 200'000u, 512u * 512u - 1u}) {
        Scene changed = scene;
        changed.image.texels[texel] = 1.0f;
        CHECK(all.insert(changed.content()).second);
    }
}

TEST_CASE("no casters have a number, and what a visit fails with is passed on",
          "[baseline]") {
    CasterViews none({});
    REQUIRE(contentOf(none));
    struct Broken final : CasterSource {
        Status visit(const CasterVisitor&) override {
            return Error{ErrorCode::badFile, "no mesh"};
        }
    } broken;
    const auto content = contentOf(broken);
    REQUIRE_FALSE(content);
    CHECK(content.error().message == "no mesh");
}

TEST_CASE("every member of a light changes its number", "[baseline]") {
    // Those that the shape ignores as well.
    std::set<std::uint64_t> all = {contentOf(someLight())};
    const std::function<void(AreaLight&)> changes[] = {
        [](AreaLight& l) { l.shape = LightShape::disk; },
        [](AreaLight& l) { l.position.x = 1.0000001; },
        [](AreaLight& l) {
            l.direction = {1, 0, 0};
        },
        [](AreaLight& l) {
            l.up = {1, 0, 0};
        },
        [](AreaLight& l) { l.radius = 0.5; },
        [](AreaLight& l) { l.size.y = 0.5; },
        [](AreaLight& l) { l.angularDiameter = 0.01; }};
    for (const auto& change : changes) {
        AreaLight light = someLight();
        change(light);
        CHECK(all.insert(contentOf(light)).second);
    }
    CHECK(contentOf(someLight()) == contentOf(someLight()));
}

TEST_CASE("receivers' points, normals, starts and pixels change their number",
          "[baseline]") {
    std::set<std::uint64_t> all = {Points().content()};
    const std::function<void(Points&)> changes[] = {[](Points& p) { p.points[3].x = 2; },
                                                    [](Points& p) { p.normals[3].x = 2; },
                                                    [](Points& p) { p.starts[3].x = 2; },
                                                    [](Points& p) {
                                                        p.first = {0, 4};
                                                    },
                                                    [](Points& p) {
                                                        p.first = {0, 2, 4};
                                                    }};
    for (const auto& change : changes) {
        Points points;
        change(points);
        CHECK(all.insert(points.content()).second);
    }
}

TEST_CASE("numbers combine in their order, and are told in 16 digits", "[baseline]") {
    CHECK(combined(1, 2) != combined(2, 1));
    CHECK(combined(1, 2) != combined(1, 3));
    CHECK(contentText(0) == "0000000000000000");
    CHECK(contentText(0x0123456789abcdefu) == "0123456789abcdef");
    CHECK(contentText(~std::uint64_t(0)) == "ffffffffffffffff");
    CHECK(contentOf(std::string("a")) != contentOf(std::string("b")));
    CHECK(contentOf(std::string()) == contentOf(std::string()));
}

TEST_CASE("values come back as they were written", "[baseline][roundtrip]") {
    const test::TempFolder folder;
    std::vector<float> values = {0.0f, -0.0f, 1.0f, 1e-45f, 3.4e38f};
    values.push_back(std::nanf(""));
    for (const std::size_t count : {values.size(), std::size_t(1), std::size_t(0)}) {
        values.resize(count);
        REQUIRE(writeValues(folder / "a.values", 7, values));
        const auto read = readValues(folder / "a.values", 7, count);
        REQUIRE(read);
        REQUIRE(*read);
        REQUIRE((*read)->size() == count);
        if (count > 0)
            CHECK(std::memcmp((*read)->data(), values.data(), count * sizeof(float)) ==
                  0);
        CHECK(folder.files() == 1);  // no temporary stays
    }
}

TEST_CASE("a file that is not there is no error", "[baseline]") {
    const test::TempFolder folder;
    const auto read = readValues(folder / "none.values", 7, 3);
    REQUIRE(read);
    CHECK_FALSE(*read);
}

TEST_CASE("values of another key or another number of them are refused",
          "[baseline][bad-input]") {
    const test::TempFolder folder;
    REQUIRE(writeValues(folder / "a.values", 7, {1, 2, 3}));
    CHECK_THAT(refusal(folder / "a.values", 8, 3), Catch::Contains("another scene"));
    CHECK_THAT(refusal(folder / "a.values", 7, 2), Catch::Contains("another scene"));
    // Nothing is allocated for a number that the file does not have.
    CHECK_THAT(refusal(folder / "a.values", 7, std::size_t(1) << 60),
               Catch::Contains("another scene"));
}

TEST_CASE("every cut, every flipped bit and bytes behind the end are refused",
          "[baseline][bad-input]") {
    const test::TempFolder folder;
    const std::string path = folder / "a.values";
    REQUIRE(writeValues(path, 7, {0.25f, 0.5f, 1.0f}));
    const std::string whole = test::contents(path);
    for (std::size_t n = 0; n < whole.size(); ++n) {
        INFO("first " << n << " of " << whole.size() << " bytes");
        test::write(path, whole.substr(0, n));
        refusal(path, 7, 3);
    }
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
        INFO("bit " << bit);
        std::string flipped = whole;
        flipped[bit / 8] = char(flipped[bit / 8] ^ (1 << bit % 8));
        test::write(path, flipped);
        refusal(path, 7, 3);
    }
    test::write(path, whole + "x");
    refusal(path, 7, 3);
    test::write(path, whole);
    CHECK(readValues(path, 7, 3));
}

TEST_CASE("a file that lies about its length in its own head is refused",
          "[baseline][bad-input]") {
    const test::TempFolder folder;
    const std::string path = folder / "a.values";
    REQUIRE(writeValues(path, 7, {1, 2, 3}));
    std::string bytes = test::contents(path);
    const std::uint64_t claimed = std::uint64_t(1) << 40;
    std::memcpy(&bytes[bytes.size() - 3 * sizeof(float) - 16], &claimed, 8);
    test::write(path, bytes);
    refusal(path, 7, claimed);
}

TEST_CASE("a folder in place of the file, and a folder that is not there, are errors",
          "[baseline][bad-input]") {
    const test::TempFolder folder;
    std::filesystem::create_directories(folder / "a.values");
    CHECK_FALSE(readValues(folder / "a.values", 7, 3));
    CHECK_FALSE(writeValues(folder / "a.values", 7, {1}));
    const Status lost = writeValues(folder / "none/b.values", 7, {1});
    REQUIRE_FALSE(lost);
    CHECK(lost.error().code == ErrorCode::io);
    CHECK_THAT(lost.error().message, Catch::Contains("b.values"));
}
