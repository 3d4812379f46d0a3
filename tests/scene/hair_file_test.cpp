// HairFile: .hair, .tfx and OBJ polylines, whole and broken.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <limits>

#include "mtsm/hair_files.h"
#include "scene_fixture.h"

using namespace mtsm;
using test::bytesOf;
using test::contains;
using test::TempFolder;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct SeenStrand {
    std::vector<glm::dvec3> points;  // world
    std::vector<double> widths;      // world
    std::vector<float> opacities;

    friend bool operator==(const SeenStrand& a, const SeenStrand& b) {
        return a.points == b.points && a.widths == b.widths && a.opacities == b.opacities;
    }
};

struct SeenHair {
    Status status;
    std::vector<SeenStrand> strands;
    std::vector<std::size_t> views;  // strands in each
    std::vector<std::string> warnings;

    [[nodiscard]] std::string error() const {
        return status ? std::string() : status.error().message;
    }
    [[nodiscard]] std::size_t points() const {
        std::size_t sum = 0;
        for (const SeenStrand& s : strands)
            sum += s.points.size();
        return sum;
    }
};

void visitInto(HairFile& file, SeenHair& seen) {
    seen.status = file.visit([&](const CasterView& caster) -> Status {
        const auto& view = std::get<StrandsView>(caster);
        seen.views.push_back(view.strandCount);
        const double scale = view.worldFromObject[0][0];
        for (std::size_t s = 0; s < view.strandCount; ++s) {
            SeenStrand& strand = seen.strands.emplace_back();
            for (std::uint32_t i = view.begin[s]; i < view.begin[s + 1]; ++i) {
                strand.points.emplace_back(view.worldFromObject *
                                           glm::dvec4(glm::dvec3(view.points[i]), 1.0));
                strand.widths.push_back(
                    scale * double(view.widths ? view.widths[i] : view.width));
                strand.opacities.push_back(view.opacities ? view.opacities[i]
                                                          : view.opacity);
            }
        }
        return {};
    });
}

SeenHair seeHair(const std::string& path, HairFileOptions options = {}) {
    SeenHair seen;
    options.warn = [&](const std::string& w) { seen.warnings.push_back(w); };
    HairFile file(path, std::move(options));
    visitInto(file, seen);
    return seen;
}

/// The parts of a .hair file; the header says what is told, not what is there.
struct HairBytes {
    std::uint32_t strands = 2, points = 5, flags = 3, segments = 0;
    float thickness = 0.5f, transparency = 0.25f;
    std::vector<std::uint16_t> counts{1, 2};
    std::vector<float> coordinates{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0};
    std::vector<float> rest;

    [[nodiscard]] std::string bytes() const {
        std::string out = "HAIR" +
                          bytesOf<std::uint32_t>({strands, points, flags, segments}) +
                          bytesOf<float>({thickness, transparency, 0, 0, 0});
        out.resize(128);
        for (const std::uint16_t c : counts)
            out += bytesOf<std::uint16_t>({c});
        for (const auto* floats : {&coordinates, &rest})
            for (const float f : *floats)
                out += bytesOf<float>({f});
        return out;
    }
};

std::string tfx4(std::uint32_t strands, std::uint32_t vertices,
                 const std::vector<float>& floats, std::uint32_t thicknessAt = 0) {
    std::string out = bytesOf<float>({4.0f}) +
                      bytesOf<std::uint32_t>({strands, vertices, 160, 0, 0, thicknessAt});
    out.resize(160);
    for (const float f : floats)
        out += bytesOf<float>({f});
    return out;
}

const std::vector<float> kTwoByTwo{0, 0, 0, 0, 1, 0, 0, 1, 0, 5, 0, 0, 0, 6, 0, 1};

}  // namespace

TEST_CASE("a .hair file comes in with its defaults", "[scene][hair]") {
    const TempFolder folder;
    const SeenHair seen = seeHair(folder.write("a.hair", HairBytes().bytes()));
    INFO(seen.error());
    REQUIRE(seen.status);
    REQUIRE(seen.strands.size() == 2);
    CHECK(seen.strands[0].points == std::vector<glm::dvec3>{{0, 0, 0}, {1, 0, 0}});
    CHECK(seen.strands[1].points ==
          std::vector<glm::dvec3>{{0, 1, 0}, {0, 2, 0}, {0, 3, 0}});
    CHECK(seen.strands[1].widths == std::vector<double>(3, 0.5));
    CHECK(seen.strands[1].opacities == std::vector<float>(3, 0.75f));
    CHECK(seen.warnings.empty());
}

TEST_CASE("a .hair file's own widths and transparencies count, scaled", "[scene][hair]") {
    const TempFolder folder;
    HairBytes hair;
    hair.flags = 2 + 4 + 8;  // no counts: two strands of one segment each
    hair.segments = 1;
    hair.counts.clear();
    hair.points = 4;
    hair.coordinates.resize(12);
    hair.rest = {1, 2, 3, 4, 0, 0.5f, 1, 0.25f};
    hair.thickness = kNan;  // not used
    const std::string path = folder.write("a.HAIR", hair.bytes());
    const SeenHair seen = seeHair(path);
    INFO(seen.error());
    REQUIRE(seen.status);
    REQUIRE(seen.strands.size() == 2);
    CHECK(seen.strands[0].widths == std::vector<double>{1, 2});
    CHECK(seen.strands[1].widths == std::vector<double>{3, 4});
    CHECK(seen.strands[1].opacities == std::vector<float>{0, 0.75f});

    HairFileOptions options;
    options.scale = 0.5f;
    CHECK(seeHair(path, options).strands[1].widths == std::vector<double>{1.5, 2});
    CHECK(seeHair(path, options).strands[0].points[1] == glm::dvec3(0.5, 0, 0));
    options.width = 0.25f;
    options.opacity = 0.125f;
    CHECK(seeHair(path, options).strands[1].widths == std::vector<double>{0.25, 0.25});
    CHECK(seeHair(path, options).strands[1].opacities == std::vector<float>(2, 0.125f));
}

TEST_CASE("a tip width tapers strands from point to point", "[scene][hair]") {
    const TempFolder folder;
    HairFileOptions options;
    options.width = 1.0f;
    options.tipWidth = 0.5f;
    const SeenHair seen = seeHair(folder.write("a.hair", HairBytes().bytes()), options);
    REQUIRE(seen.status);
    CHECK(seen.strands[0].widths == std::vector<double>{1, 0.5});
    CHECK(seen.strands[1].widths == std::vector<double>{1, 0.75, 0.5});
}

TEST_CASE("TressFX strands of versions 3 and 4 come in", "[scene][hair]") {
    const TempFolder folder;
    HairFileOptions options;
    options.width = 0.1f;
    const SeenHair four = seeHair(folder.write("a.tfx", tfx4(2, 2, kTwoByTwo)), options);
    INFO(four.error());
    REQUIRE(four.status);
    REQUIRE(four.strands.size() == 2);
    CHECK(four.strands[1].points == std::vector<glm::dvec3>{{0, 5, 0}, {0, 6, 0}});
    CHECK(four.strands[1].opacities == std::vector<float>{1, 1});

    std::string three = bytesOf<float>({3.0f}) + bytesOf<std::uint32_t>({2, 2, 0, 0});
    three.resize(144);
    three += bytesOf<std::uint32_t>({296});
    three.resize(296);
    three += bytesOf<float>({0, 0, 0, 1, 0, 0, 0, 5, 0, 0, 6, 0});
    CHECK(seeHair(folder.write("b.tfx", three), options).strands == four.strands);

    std::vector<float> withThickness = kTwoByTwo;
    withThickness.insert(withThickness.end(), {0.5f, 0.25f});
    const SeenHair thick =
        seeHair(folder.write("c.tfx", tfx4(2, 2, withThickness, 160 + 64)));
    REQUIRE(thick.status);
    CHECK(thick.strands[0].widths == std::vector<double>{0.5, 0.5});
    CHECK(thick.strands[1].widths == std::vector<double>{0.25, 0.25});
}

TEST_CASE("without any width a small part of the size is taken, and said",
          "[scene][hair]") {
    const TempFolder folder;
    const SeenHair seen = seeHair(folder.write("a.tfx", tfx4(2, 2, kTwoByTwo)));
    REQUIRE(seen.status);
    CHECK(seen.strands[0].widths[0] == Approx(std::sqrt(37.0) / 2000.0));
    REQUIRE(seen.warnings.size() == 1);
    CHECK(contains(seen.warnings[0], "--hair-width"));
    CHECK(contains(seen.warnings[0], "0.00304"));
}

TEST_CASE("OBJ polylines are strands, whatever way they count", "[scene][hair]") {
    const TempFolder folder;
    HairFileOptions options;
    options.width = 0.1f;
    const SeenHair seen = seeHair(
        folder.write("a.obj",
                     "# hair\no curve\nv 0 0 0\nv 1 0 0 1.0\r\nv +2 0 0\nvt 0 0\n"
                     "l 1 2/1 3\nv 0 5 0\nv 0 6e0 0\nl -2 \\\n-1\nf 1 2 3\n  l\t4 5 1"),
        options);
    INFO(seen.error());
    REQUIRE(seen.status);
    REQUIRE(seen.strands.size() == 3);
    CHECK(seen.strands[0].points ==
          std::vector<glm::dvec3>{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}});
    CHECK(seen.strands[1].points == std::vector<glm::dvec3>{{0, 5, 0}, {0, 6, 0}});
    CHECK(seen.strands[2].points ==
          std::vector<glm::dvec3>{{0, 5, 0}, {0, 6, 0}, {0, 0, 0}});
}

TEST_CASE("OBJ segments that share an end become one strand where only they meet",
          "[scene][hair]") {
    const TempFolder folder;
    HairFileOptions options;
    options.width = 0.1f;
    std::string vertices;
    for (int i = 1; i <= 9; ++i)
        vertices += "v " + std::to_string(i) + " 0 0\n";
    const auto strandsOf = [&](const std::string& lines) {
        const SeenHair seen = seeHair(folder.write("a.obj", vertices + lines), options);
        std::vector<std::vector<int>> strands;
        for (const SeenStrand& s : seen.strands) {
            auto& strand = strands.emplace_back();
            for (const glm::dvec3& p : s.points)
                strand.push_back(int(p.x));
        }
        return strands;
    };
    using Lists = std::vector<std::vector<int>>;
    CHECK(strandsOf("l 1 2\nl 2 3\nl 3 4\nl 5 6\nl 6 7\n") ==
          Lists{{1, 2, 3, 4}, {5, 6, 7}});
    CHECK(strandsOf("l 2 1\nl 3 2\nl 3 4\n") == Lists{{4, 3, 2, 1}});
    // Three lines meet in 2.
    CHECK(strandsOf("l 1 2\nl 2 3\nl 2 4\n") == Lists{{1, 2}, {2, 3}, {2, 4}});
    // Not one after another.
    CHECK(strandsOf("l 1 2\nl 5 6\nl 2 3\n") == Lists{{1, 2}, {5, 6}, {2, 3}});
    CHECK(strandsOf("l 1 2\nl 2 3 4\n") == Lists{{1, 2}, {2, 3, 4}});
}

TEST_CASE("an OBJ file says whether it has polylines and faces", "[scene][hair]") {
    const TempFolder folder;
    const auto content = [&](const std::string& text) {
        const auto found = objContent(folder.write("a.obj", text));
        REQUIRE(found);
        return std::pair(found->polylines, found->faces);
    };
    CHECK(content("v 0 0 0\nl 1 1\n") == std::pair(true, false));
    CHECK(content("v 0 0 0\nf 1 1 1\nlight x\nfo\n") == std::pair(false, true));
    CHECK(content("v 0 0 0\n  f 1 1 1\nl 1 1") == std::pair(true, true));
    CHECK(objContent(folder.path("none.obj")).error().code == ErrorCode::io);
    CHECK(isHairFile("a/b.Hair"));
    CHECK(isHairFile("b.tfx"));
    CHECK(!isHairFile("b.obj"));
    CHECK(!isHairFile("hair"));
}

TEST_CASE("many strands come in views of at most 65536, the same at every visit",
          "[scene][hair]") {
    const TempFolder folder;
    HairBytes hair;
    hair.strands = 150000;
    hair.points = 300000;
    hair.flags = 2;
    hair.segments = 1;
    hair.counts.clear();
    hair.coordinates.clear();
    for (std::uint32_t i = 0; i < 3 * hair.points; ++i)
        hair.coordinates.push_back(float(i));
    HairFile file(folder.write("a.hair", hair.bytes()));
    SeenHair first, second;
    visitInto(file, first);
    visitInto(file, second);
    REQUIRE(first.status);
    CHECK(first.views == std::vector<std::size_t>{65536, 65536, 150000 - 131072});
    CHECK(first.views == second.views);
    CHECK(first.strands == second.strands);
    CHECK(first.strands[149999].points[1] == glm::dvec3(899997, 899998, 899999));
}

TEST_CASE("strands that are not finite are left out with one warning", "[scene][hair]") {
    const TempFolder folder;
    HairBytes hair;
    hair.coordinates[4] = kNan;
    const SeenHair seen = seeHair(folder.write("a.hair", hair.bytes()));
    REQUIRE(seen.status);
    REQUIRE(seen.strands.size() == 1);
    CHECK(seen.strands[0].points[0] == glm::dvec3(0, 1, 0));
    REQUIRE(seen.warnings.size() == 1);
    CHECK(contains(seen.warnings[0], "1 of 2 strands"));
}

TEST_CASE("a hostile .hair file is refused in one clear line",
          "[scene][hair][bad-input]") {
    const TempFolder folder;
    const auto refused = [&](const HairBytes& hair, const std::string& part) {
        const SeenHair seen = seeHair(folder.write("bad.hair", hair.bytes()));
        INFO(seen.error());
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), "bad.hair: "));
        CHECK(contains(seen.error(), part));
        CHECK(!contains(seen.error(), "\n"));
    };
    HairBytes hair;
    hair.strands = 4000000000u;
    refused(hair, "declares 4000000000 strands");
    hair = {};
    hair.points = 4000000000u;
    refused(hair, "4000000000 points");
    hair = {};
    hair.points = 4;  // 2 + 3 there
    refused(hair, "have 5 points, but its header declares 4");
    hair = {};
    hair.counts[0] = 60000;
    refused(hair, "have 60004 points");
    hair = {};
    hair.counts[1] = 0;
    refused(hair, "strand 1 has no segment");
    hair = {};
    hair.flags = 2;
    refused(hair, "0 segments");
    hair.segments = 4294967295u;
    refused(hair, "4294967295 segments");
    hair = {};
    hair.flags = 1;
    refused(hair, "0 points");
    hair = {};
    hair.strands = 0;
    refused(hair, "declares 0 strands");
    hair = {};
    hair.thickness = -1.0f;
    refused(hair, "thickness -1");
    hair = {};
    hair.transparency = 2.0f;
    refused(hair, "transparency 2");
    hair = {};
    hair.flags = 3 + 4;
    hair.rest = {1, 1, 1, kNan, 1};
    refused(hair, "strand 1 has the thickness nan");
    hair.rest = {1, -3, 1, 1, 1};
    refused(hair, "strand 0 has the thickness -3");
    hair.flags = 3 + 8;
    hair.rest = {0, 0, 0, 1.5f, 0};
    refused(hair, "strand 1 has the transparency 1.5");
    CHECK(seeHair(folder.write("x.hair", "MAIR" + std::string(200, 'x')))
              .status.error()
              .code == ErrorCode::badFile);
}

TEST_CASE("every truncation of a hair file is refused", "[scene][hair][bad-input]") {
    const TempFolder folder;
    for (const auto& [name, whole] :
         {std::pair<std::string, std::string>("a.hair", HairBytes().bytes()),
          {"a.tfx", tfx4(2, 2, kTwoByTwo)}}) {
        REQUIRE(seeHair(folder.write(name, whole)).status);
        for (std::size_t n = 0; n < whole.size(); ++n) {
            INFO(name << ", first " << n << " of " << whole.size() << " bytes");
            const SeenHair seen = seeHair(folder.write(name, whole.substr(0, n)));
            REQUIRE(!seen.status);
            CHECK(seen.status.error().code == ErrorCode::badFile);
        }
    }
}

TEST_CASE("a hostile .tfx file is refused in one clear line",
          "[scene][hair][bad-input]") {
    const TempFolder folder;
    const auto refused = [&](const std::string& bytes, ErrorCode code,
                             const std::string& part) {
        const SeenHair seen = seeHair(folder.write("bad.tfx", bytes));
        INFO(seen.error());
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == code);
        CHECK(contains(seen.error(), part));
    };
    refused(tfx4(4294967295u, 65536, kTwoByTwo), ErrorCode::badFile,
            "4294967295 strands");
    refused(tfx4(2, 4294967295u, kTwoByTwo), ErrorCode::badFile, "4294967295 vertices");
    refused(tfx4(2, 1, kTwoByTwo), ErrorCode::badFile, "1 vertices per strand");
    refused(tfx4(0, 2, kTwoByTwo), ErrorCode::badFile, "no strands");
    refused(tfx4(2, 2, kTwoByTwo, 4294967295u), ErrorCode::badFile, "strand thickness");
    refused(tfx4(2, 2, kTwoByTwo, 8), ErrorCode::badFile, "strand thickness");
    std::string later = tfx4(2, 2, kTwoByTwo);
    later.replace(0, 4, bytesOf<float>({5.0f}));
    refused(later, ErrorCode::unsupported, "version 5");
    later.replace(0, 4, bytesOf<float>({kNan}));
    refused(later, ErrorCode::unsupported, "version nan");
}

TEST_CASE("a broken OBJ polyline is refused with its line", "[scene][hair][bad-input]") {
    const TempFolder folder;
    const auto refused = [&](const std::string& text, const std::string& part) {
        const SeenHair seen = seeHair(folder.write("bad.obj", text));
        INFO(seen.error());
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
        CHECK(contains(seen.error(), part));
    };
    const std::string two = "v 0 0 0\nv 1 0 0\n";
    refused(two + "l 1 3\n", "vertex 3 of 2");
    refused(two + "l 1 0\n", "line 3: found \"0\"");
    refused(two + "l 1 -3\n", "found \"-3\"");
    refused(two + "l 1 x\n", "found \"x\"");
    refused(two + "l 1 99999999999999999999\n", "found \"9999");
    refused(two + "l 1 4294967297\n", "found \"4294967297\"");
    refused(two + "l \\\n1\n", "line 3: a polyline has 1 point,");
    refused(two + "v 1 2\n", "line 3: found \"\" where a vertex has coordinate 3");
    refused(two + "f 1 2 2\n", "no polyline");
    std::string many = "l";
    for (int i = 0; i < 65537; ++i)
        many += " 1";
    refused(two + many, "line 3: a polyline has more than 65536 points");
    const SeenHair nan =
        seeHair(folder.write("nan.obj", "v nan 0 0\nv 1 0 0\nv 2 0 0\nl 1 2\nl 2 3 2"));
    CHECK(nan.strands.size() == 1);
}

TEST_CASE("options out of range, missing files and changed files are errors",
          "[scene][hair]") {
    const TempFolder folder;
    const std::string path = folder.write("a.hair", HairBytes().bytes());
    const auto code = [&](const HairFileOptions& options) {
        const SeenHair seen = seeHair(path, options);
        REQUIRE(!seen.status);
        return seen.status.error().code;
    };
    HairFileOptions bad;
    bad.width = -1.0f;
    CHECK(code(bad) == ErrorCode::badArgument);
    bad = {};
    bad.tipWidth = 1.0f;
    CHECK(code(bad) == ErrorCode::badArgument);
    bad = {};
    bad.opacity = kNan;
    CHECK(code(bad) == ErrorCode::badArgument);
    bad = {};
    bad.scale = 0.0f;
    CHECK(code(bad) == ErrorCode::badArgument);
    bad = {};
    bad.progress = [](const std::string&) { return false; };
    CHECK(code(bad) == ErrorCode::cancelled);
    CHECK(seeHair(folder.path("none.hair")).status.error().code == ErrorCode::io);

    HairFile file(path);
    SeenHair seen;
    visitInto(file, seen);
    REQUIRE(seen.status);
    folder.write("a.hair", HairBytes().bytes() + "more");
    visitInto(file, seen);
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::io);
}

#ifdef MTSM_MAKE_FUR
TEST_CASE("the sample fur is as large as asked, around its sphere, tapered",
          "[scene][sample]") {
    const TempFolder folder;
    const std::string path = folder.path("fur.hair");
    const std::string command =
        "\"" MTSM_MAKE_FUR "\" -n 64000 --opacity 0.25 -o " + path + " 2>/dev/null";
    REQUIRE(std::system(command.c_str()) == 0);
    const SeenHair seen = seeHair(path);
    INFO(seen.error());
    REQUIRE(seen.strands.size() == 2000);
    CHECK(2 * (seen.points() - seen.strands.size()) == 64000);
    double furthest = 0;
    for (const SeenStrand& s : seen.strands) {
        REQUIRE(glm::length(s.points.front()) == Approx(1.0));
        REQUIRE(s.widths.front() == Approx(0.003));
        REQUIRE(s.widths.back() == Approx(0.0006));
        REQUIRE(s.opacities.back() == Approx(0.25));
        for (const glm::dvec3& p : s.points)
            furthest = std::max(furthest, glm::length(p));
    }
    CHECK(furthest > 1.15);
    CHECK(furthest < 1.6);
}
#endif

TEST_CASE("real hair comes in with all its strands", "[scene][data]") {
    const char* data = std::getenv("MTSM_TEST_DATA");
    if (!data) {
        WARN("MTSM_TEST_DATA is not set: skipped");
        return;
    }
    const auto check = [&](const char* name, std::size_t strands, std::size_t points,
                           glm::dvec3 low, glm::dvec3 high) {
        const auto path = std::filesystem::path(data) / "hair" / name;
        if (!std::filesystem::exists(path)) {
            WARN(path.string() << " is not there: skipped");
            return;
        }
        const SeenHair seen = seeHair(path.string());
        INFO(seen.error());
        REQUIRE(seen.status);
        CHECK(seen.strands.size() == strands);
        CHECK(seen.points() == points);
        glm::dvec3 l(1e9), h(-1e9);
        for (const SeenStrand& s : seen.strands) {
            for (const glm::dvec3& p : s.points) {
                l = glm::min(l, p);
                h = glm::max(h, p);
            }
        }
        CHECK(glm::length(l - low) < 0.02);
        CHECK(glm::length(h - high) < 0.02);
    };
    check("TestHair1.tfx", 10027, 40108, {-69.88, -70.87, -87.27},
          {104.48, 127.58, 69.85});
    check("ratboy_mohawk.tfx", 2228, 71296, {-0.10, 0.21, -0.34}, {0.12, 1.11, 0.27});
    const auto straight = std::filesystem::path(data) / "hair" / "straight.hair";
    if (std::filesystem::exists(straight)) {
        const SeenHair seen = seeHair(straight.string());
        REQUIRE(seen.status);
        CHECK(seen.strands.size() == 10000);
        CHECK(seen.points() == 160000);
        CHECK(seen.strands[0].widths[0] == Approx(0.1));
        CHECK(seen.strands[0].opacities[0] == Approx(1 - 0.35577));
    }
}
