// Fog volumes from OpenVDB files, written here with OpenVDB itself.
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vector_relational.hpp>
#include <map>
#include <random>
#include <sstream>
#include <tuple>

#include "mtsm/volume_files.h"
#include "scene_fixture.h"

using namespace mtsm;
using mtsm::test::contains;
using mtsm::test::TempFolder;

namespace {

using Voxel = std::tuple<int, int, int>;

/// What a visitor saw.
struct SeenVolume {
    Status status;
    int volumes = 0;
    std::map<Voxel, float> voxels;  // of density > 0; of small volumes only
    std::size_t positive = 0;       // voxels
    double total = 0.0;
    glm::ivec3 low{1 << 30}, high{-(1 << 30)};  // of them
    std::size_t blocks = 0;
    glm::dmat4 worldFromIndex{1.0};
    float extinction = 0.0f;
    std::vector<std::string> warnings;

    [[nodiscard]] std::string error() const {
        return status ? std::string() : status.error().message;
    }
};

void note(const VolumeView& view, SeenVolume& seen) {
    ++seen.volumes;
    seen.blocks = view.blockCount;
    seen.worldFromIndex = view.worldFromIndex;
    seen.extinction = view.extinction;
    bool valid = true;
    for (std::size_t i = 0; i < view.blockCount * VolumeView::kBlockVoxels; ++i) {
        const int v = int(i % VolumeView::kBlockVoxels);
        const glm::ivec3 at = view.blocks[i / VolumeView::kBlockVoxels] +
                              glm::ivec3(v & 7, v >> 3 & 7, v >> 6);
        const float density = view.density[i];
        valid &= density >= 0.0f && std::isfinite(density);
        if (!(density > 0.0f)) continue;
        ++seen.positive;
        seen.total += double(density);
        seen.low = glm::min(seen.low, at);
        seen.high = glm::max(seen.high, at);
        if (view.blockCount < 1000) seen.voxels[{at.x, at.y, at.z}] = density;
    }
    CHECK(valid);
}

SeenVolume see(VolumeFile& file) {
    SeenVolume seen;
    seen.status = file.visit([&](const CasterView& caster) -> Status {
        note(std::get<VolumeView>(caster), seen);
        return {};
    });
    return seen;
}

SeenVolume seeFile(const std::string& path, VolumeFileOptions options = {}) {
    std::vector<std::string> warnings;
    options.warn = [&](const std::string& w) { warnings.push_back(w); };
    VolumeFile file(path, options);
    SeenVolume seen = see(file);
    seen.warnings = warnings;
    return seen;
}

std::string write(const TempFolder& folder, const std::string& name,
                  const openvdb::GridPtrVec& grids,
                  std::uint32_t compression = openvdb::io::COMPRESS_ACTIVE_MASK) {
    openvdb::io::File file(folder.path(name));
    file.setCompression(compression);
    file.write(grids);
    file.close();
    return folder.path(name);
}

template <typename Grid = openvdb::FloatGrid>
typename Grid::Ptr gridNamed(const std::string& name, float background = 0.0f) {
    openvdb::initialize();
    auto grid = Grid::create(typename Grid::ValueType(background));
    grid->setName(name);
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    return grid;
}

/// Some hundred voxels in reach of 40 from the origin.
template <typename Grid = openvdb::FloatGrid>
typename Grid::Ptr scattered(const std::string& name, unsigned seed = 1) {
    auto grid = gridNamed<Grid>(name);
    auto access = grid->getAccessor();
    std::mt19937 random(seed);
    const auto index = [&] { return int(random() % 80) - 40; };
    for (int i = 0; i < 300; ++i) {
        const int x = index(), y = index(), z = index();
        access.setValue({x, y, z}, typename Grid::ValueType(1 + i % 7) / 8);
    }
    return grid;
}

template <typename Grid>
std::map<Voxel, float> voxelsOf(const Grid& grid) {
    std::map<Voxel, float> voxels;
    for (auto it = grid.cbeginValueOn(); it; ++it) {
        openvdb::CoordBBox box;
        it.getBoundingBox(box);
        for (auto c = box.begin(); c; ++c)
            if (*it > 0) voxels[{(*c).x(), (*c).y(), (*c).z()}] = float(*it);
    }
    return voxels;
}

std::string bytesOfFile(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << file.rdbuf();
    return bytes.str();
}

}  // namespace

TEST_CASE("every active voxel of a grid arrives, whatever its type and compression",
          "[scene][volume]") {
    const TempFolder folder;
    const auto floats = scattered("density");
    using namespace openvdb::io;
    constexpr std::uint32_t kCompressions[] = {COMPRESS_NONE, COMPRESS_ZIP,
                                               COMPRESS_ZIP | COMPRESS_ACTIVE_MASK,
                                               COMPRESS_BLOSC | COMPRESS_ACTIVE_MASK};
    for (const std::uint32_t compression : kCompressions) {
        const auto seen = seeFile(write(folder, "f.vdb", {floats}, compression));
        INFO(seen.error());
        REQUIRE(seen.status);
        CHECK(seen.volumes == 1);
        CHECK(seen.voxels == voxelsOf(*floats));
        CHECK(seen.warnings.empty());
    }
    const auto doubles = scattered<openvdb::DoubleGrid>("density", 2);
    CHECK(seeFile(write(folder, "d.vdb", {doubles})).voxels == voxelsOf(*doubles));
    const auto halves = scattered("density", 3);
    halves->setSaveFloatAsHalf(true);
    CHECK(seeFile(write(folder, "h.vdb", {halves})).voxels == voxelsOf(*halves));
}

TEST_CASE("active tiles become blocks and inactive values are not cast",
          "[scene][volume]") {
    const TempFolder folder;
    const auto grid = gridNamed("density", 0.25f);
    grid->tree().addTile(1, {-8, 16, 8}, 0.5f, true);
    grid->tree().addTile(2, {256, -128, 0}, 0.125f, true);  // 128 voxels wide
    grid->tree().addTile(1, {64, 64, 64}, 3.0f, false);
    grid->tree().setValueOff({0, 0, 0}, 7.0f);
    grid->tree().setValueOn({1, 0, 0}, 1.0f);
    const auto seen = seeFile(write(folder, "tiles.vdb", {grid}));
    INFO(seen.error());
    REQUIRE(seen.status);
    CHECK(seen.blocks == 1 + 16 * 16 * 16 + 1);
    // As many as there are room for between the lowest and the highest.
    CHECK(seen.positive == 512 + 128 * 128 * 128 + 1);
    CHECK(seen.total == 0.5 * 512 + 0.125 * 128 * 128 * 128 + 1.0);
    CHECK(seen.low == glm::ivec3(-8, -128, 0));
    CHECK(seen.high == glm::ivec3(383, 23, 127));
    REQUIRE(seen.warnings.size() == 1);
    CHECK(contains(seen.warnings[0], "background of 0.25"));
}

TEST_CASE("grids stand where their transform puts them", "[scene][volume]") {
    const TempFolder folder;
    const auto grid = scattered("density");
    const openvdb::Mat4d affine(0.2, 0.05, 0.0, 0.0,    //
                                -0.1, 0.3, 0.02, 0.0,   //
                                0.01, 0.0, -0.25, 0.0,  //
                                1e7, -3.0, 12.5, 1.0);
    const auto transform =
        GENERATE_COPY(openvdb::math::Transform::createLinearTransform(0.125),
                      openvdb::math::Transform::createLinearTransform(affine), [] {
                          auto t = openvdb::math::Transform::createLinearTransform(0.5);
                          t->preRotate(0.7, openvdb::math::X_AXIS);
                          t->postTranslate({1, 2, 3});
                          return t;
                      }());
    grid->setTransform(transform);
    VolumeFileOptions options;
    options.densityScale = 2.5f;
    const auto seen = seeFile(write(folder, "t.vdb", {grid}), options);
    REQUIRE(seen.status);
    CHECK(seen.extinction == 2.5f);
    for (const glm::dvec3 p : {glm::dvec3(0, 0, 0), glm::dvec3(3, -5, 7.5)}) {
        const openvdb::Vec3d w = transform->indexToWorld(openvdb::Vec3d(p.x, p.y, p.z));
        const glm::dvec3 got(seen.worldFromIndex * glm::dvec4(p, 1.0));
        CHECK(glm::length(got - glm::dvec3(w.x(), w.y(), w.z())) < 1e-8);
    }
}

TEST_CASE("negative densities, NaN and infinity count as 0, with a warning",
          "[scene][volume]") {
    const TempFolder folder;
    const auto grid = gridNamed("density");
    grid->tree().setValueOn({0, 0, 0}, -1.0f);
    grid->tree().setValueOn({1, 0, 0}, NAN);
    grid->tree().setValueOn({2, 0, 0}, INFINITY);
    grid->tree().setValueOn({3, 0, 0}, 0.5f);
    grid->tree().setValueOn({100, 0, 0}, -0.5f);
    const auto seen = seeFile(write(folder, "odd.vdb", {grid}));
    REQUIRE(seen.status);
    CHECK(seen.voxels == std::map<Voxel, float>{{{3, 0, 0}, 0.5f}});
    CHECK(seen.blocks == 1);
    REQUIRE(seen.warnings.size() == 1);
    CHECK(contains(seen.warnings[0], "2 densities are negative and 2 are NaN"));
}

TEST_CASE("the grid of densities is found, or the message says how to name it",
          "[scene][volume]") {
    const TempFolder folder;
    const auto density = scattered("density", 4), heat = scattered("heat", 5);
    const auto colour = openvdb::Vec3SGrid::create();
    colour->setName("Cd");
    colour->tree().setValueOn({0, 0, 0}, {1, 1, 1});
    const auto surface = scattered("surface", 6);
    surface->setGridClass(openvdb::GRID_LEVEL_SET);
    const auto named = [](std::string grid) {
        VolumeFileOptions options;
        options.grid = std::move(grid);
        return options;
    };

    const std::string all =
        write(folder, "all.vdb", {colour, heat, surface, density, heat});
    CHECK(seeFile(all).voxels == voxelsOf(*density));
    CHECK(seeFile(all, named("heat")).voxels == voxelsOf(*heat));
    CHECK(seeFile(all, named("heat[1]")).voxels == voxelsOf(*heat));
    const auto none = seeFile(all, named("smoke"));
    REQUIRE(!none.status);
    CHECK(none.status.error().code == ErrorCode::badArgument);
    CHECK(contains(none.error(), "\"Cd\" (vec3s)"));
    CHECK(contains(none.error(), "\"surface\" (level set, float)"));
    const auto vector = seeFile(all, named("Cd"));
    CHECK(contains(vector.error(), "holds values of type vec3s"));
    const auto level = seeFile(all, named("surface"));
    REQUIRE(!level.status);
    CHECK(level.status.error().code == ErrorCode::unsupported);
    CHECK(contains(level.error(), "is a level set"));
    CHECK(contains(level.error(), "--density-grid"));

    CHECK(seeFile(write(folder, "heat.vdb", {heat, surface, colour})).voxels ==
          voxelsOf(*heat));
    const auto two = scattered("fuel", 8);
    CHECK(contains(seeFile(write(folder, "two.vdb", {heat, two})).error(),
                   "which other one is meant is not clear"));
    CHECK(
        contains(seeFile(write(folder, "ls.vdb", {surface})).error(), "is a level set"));
    CHECK(contains(seeFile(write(folder, "cd.vdb", {colour})).error(),
                   "no grid holds floats"));
    CHECK(contains(seeFile(write(folder, "0.vdb", {})).error(), "there is no grid"));
}

TEST_CASE("a frustum transform is refused in words", "[scene][volume]") {
    const TempFolder folder;
    const auto grid = scattered("density");
    grid->setTransform(openvdb::math::Transform::createFrustumTransform(
        openvdb::BBoxd({0, 0, 0}, {10, 10, 10}), 0.5, 10.0));
    const auto seen = seeFile(write(folder, "frustum.vdb", {grid}));
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::unsupported);
    CHECK(contains(seen.error(), "not affine"));
}

TEST_CASE("instances and streamed files are read too", "[scene][volume]") {
    const TempFolder folder;
    const auto grid = scattered("smoke");
    const auto copy = openvdb::gridPtrCast<openvdb::FloatGrid>(grid->copyGrid());
    copy->setName("density");
    copy->setTransform(openvdb::math::Transform::createLinearTransform(0.25));
    const auto seen = seeFile(write(folder, "instance.vdb", {grid, copy}));
    INFO(seen.error());
    CHECK(seen.voxels == voxelsOf(*grid));
    CHECK(seen.worldFromIndex[0].x == 0.25);

    std::ostringstream stream;
    openvdb::io::Stream(stream).write(
        openvdb::GridCPtrVec{scattered("heat", 9), scattered("density", 10)});
    const auto streamed = seeFile(folder.write("stream.vdb", stream.str()));
    INFO(streamed.error());
    CHECK(streamed.voxels == voxelsOf(*scattered("density", 10)));
}

TEST_CASE("an empty grid is no caster and no error", "[scene][volume]") {
    const TempFolder folder;
    const auto seen = seeFile(write(folder, "empty.vdb", {gridNamed("density")}));
    INFO(seen.error());
    CHECK(seen.status);
    CHECK(seen.volumes == 0);
    REQUIRE(seen.warnings.size() == 1);
    CHECK(contains(seen.warnings[0], "casts nothing"));
}

TEST_CASE("a tile as wide as the root's is counted before it is expanded",
          "[scene][volume][bad-input]") {
    const TempFolder folder;
    const auto grid = gridNamed("density");
    grid->tree().addTile(3, {0, 0, 0}, 1.0f, true);  // 4096 voxels wide: 256 GiB
    const auto seen = seeFile(write(folder, "huge.vdb", {grid}));
    REQUIRE(!seen.status);
    CHECK(seen.status.error().code == ErrorCode::tooLarge);
    CHECK(contains(seen.error(), "134217728 blocks"));
}

TEST_CASE("what is visited again is the same, kept or not", "[scene][volume]") {
    const TempFolder folder;
    const auto grid = scattered("density");
    const std::string path = write(folder, "again.vdb", {grid});
    VolumeFileOptions options;
    int reads = 0;
    options.progress = [&](const std::string&) { return ++reads < 4; };
    VolumeFile kept(path, options);
    CHECK(see(kept).voxels == see(kept).voxels);
    CHECK(reads == 1);
    options.cacheBytes = 0;
    VolumeFile fresh(path, options);
    CHECK(see(fresh).voxels == voxelsOf(*grid));
    write(folder, "again.vdb", {scattered("density", 7)});
    const auto changed = see(fresh);
    CHECK(contains(changed.error(), "has changed"));
    const auto cancelled = see(fresh);
    REQUIRE(!cancelled.status);
    CHECK(cancelled.status.error().code == ErrorCode::cancelled);
}

TEST_CASE("no scale of density but finite ones is taken", "[scene][volume]") {
    VolumeFileOptions options;
    for (const float scale : {-1.0f, float(NAN), float(INFINITY)}) {
        options.densityScale = scale;
        VolumeFile file("any.vdb", options);
        const auto seen = see(file);
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badArgument);
    }
}

TEST_CASE("what is no OpenVDB file is an error", "[scene][volume][bad-input]") {
    const TempFolder folder;
    const auto codeOf = [](const SeenVolume& seen) {
        REQUIRE(!seen.status);
        return seen.status.error().code;
    };
    CHECK(codeOf(seeFile(folder.path("none.vdb"))) == ErrorCode::io);
    CHECK(codeOf(seeFile(folder.write("empty.vdb", ""))) == ErrorCode::badFile);
    const auto text = seeFile(folder.write("text.vdb", "this is not a volume at all"));
    CHECK(codeOf(text) == ErrorCode::badFile);
    INFO(text.error());
    CHECK(contains(text.error(), "not an OpenVDB file"));
    const auto nano =
        seeFile(folder.write("nano.nvdb", "NanoVDB0" + std::string(99, 'x')));
    CHECK(codeOf(nano) == ErrorCode::unsupported);
    CHECK(contains(nano.error(), "NanoVDB"));
}

TEST_CASE("every truncation of a volume is an error", "[scene][volume][bad-input]") {
    const TempFolder folder;
    const auto whole = bytesOfFile(write(folder, "whole.vdb", {scattered("density")}));
    const std::size_t step = whole.size() / (test::kSanitized ? 12 : 40);
    for (std::size_t n = 1; n < whole.size(); n += n < 8 ? 1 : step) {
        INFO("first " << n << " of " << whole.size() << " bytes");
        const auto seen = seeFile(folder.write("cut.vdb", whole.substr(0, n)));
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
    }
    // Without offsets nothing says how long the file should be.
    std::ostringstream stream;
    openvdb::io::Stream(stream).write(openvdb::GridCPtrVec{scattered("density")});
    const std::string streamed = stream.str();
    for (std::size_t n = 50; n < streamed.size(); n += step) {
        INFO("first " << n << " of " << streamed.size() << " bytes of a stream");
        const auto seen = seeFile(folder.write("cut.vdb", streamed.substr(0, n)));
        REQUIRE(!seen.status);
        CHECK(seen.status.error().code == ErrorCode::badFile);
    }
}

TEST_CASE("flipped bytes give a volume or an error, never more",
          "[scene][volume][bad-input]") {
    const TempFolder folder;
    const auto whole = bytesOfFile(write(folder, "whole.vdb", {scattered("density")}));
    std::mt19937 random(11);
    VolumeFileOptions options;
    options.importerBytes = std::uint64_t(256) << 20;
    int errors = 0;
    for (int i = 0; i < (test::kSanitized ? 10 : 100); ++i) {
        std::string bytes = whole;
        // Two of three in the head, where the counts and offsets are.
        const std::size_t reach = i % 3 ? 600 : whole.size();
        for (int k = 0; k < 2; ++k)
            bytes[random() % reach] = char(random());
        const auto seen = seeFile(folder.write("bad.vdb", bytes), options);
        errors += !seen.status;
        if (!seen.status) {
            CHECK(!seen.error().empty());
            CHECK(seen.error().find('\n') == std::string::npos);
        }
    }
    CHECK(errors > 0);
}

TEST_CASE("real volumes come in whole", "[scene][volume][data]") {
    const char* folder = std::getenv("MTSM_TEST_DATA");
    if (!folder) {
        WARN("MTSM_TEST_DATA is not set: skipped");
        return;
    }
    const std::string volumes = std::string(folder) + "/volumes/";
    if (!std::ifstream(volumes + "smoke.vdb")) {
        WARN(volumes << " is not there: skipped");
        return;
    }
    // Against OpenVDB's own counts.
    for (const char* name : {"smoke.vdb", "usd_smoke_000002.vdb"}) {
        openvdb::initialize();
        openvdb::io::File file(volumes + name);
        file.open();
        const auto grid =
            openvdb::gridPtrCast<openvdb::FloatGrid>(file.readGrid("density"));
        std::size_t positive = 0;
        double total = 0.0;
        for (auto it = grid->cbeginValueOn(); it; ++it) {
            REQUIRE(it.isVoxelValue());  // no tiles in these
            positive += *it > 0.0f;
            total += std::max(0.0, double(*it));
        }
        const openvdb::CoordBBox box = grid->evalActiveVoxelBoundingBox();
        const auto seen = seeFile(volumes + name);
        INFO(name << ": " << seen.error());
        REQUIRE(seen.status);
        CHECK(seen.positive == positive);
        CHECK(seen.total == Approx(total).epsilon(1e-12));
        CHECK(glm::all(glm::greaterThanEqual(
            seen.low, glm::ivec3(box.min().x(), box.min().y(), box.min().z()))));
        CHECK(glm::all(glm::lessThanEqual(
            seen.high, glm::ivec3(box.max().x(), box.max().y(), box.max().z()))));
    }
    CHECK(contains(seeFile(volumes + "sphereCd_vec3.vdb").error(), "\"Cd\" (vec3s)"));
    CHECK(contains(seeFile(volumes + "smoke.nvdb").error(), "NanoVDB"));
}

#ifdef MTSM_MAKE_SMOKE
TEST_CASE("the sample smoke is fog of up to 1, where its help says, and ever the same",
          "[scene][volume][sample]") {
    const TempFolder folder;
    const std::string path = folder.path("smoke.vdb");
    const auto make = [&](const std::string& arguments) {
        return std::system(
            ("\"" MTSM_MAKE_SMOKE "\" -o " + path + arguments + " 2>/dev/null").c_str());
    };
    REQUIRE(make(" --size 32") == 0);
    const auto seen = seeFile(path);
    INFO(seen.error());
    REQUIRE(seen.status);
    CHECK(seen.warnings.empty());
    CHECK(seen.positive > 32 * 32 * 32 / 50);
    CHECK(seen.positive < 32 * 32 * 32 / 2);
    for (const auto& [voxel, density] : seen.voxels)
        REQUIRE(density <= 1.0f);
    const glm::dvec3 low(seen.worldFromIndex * glm::dvec4(glm::dvec3(seen.low) - 0.5, 1));
    const glm::dvec3 high(seen.worldFromIndex *
                          glm::dvec4(glm::dvec3(seen.high) + 0.5, 1));
    CHECK(glm::all(glm::greaterThan(low, glm::dvec3(-1.001, -0.001, -1.001))));
    CHECK(glm::all(glm::lessThan(high, glm::dvec3(1.001, 2.001, 1.001))));
    REQUIRE(make(" --size 32") == 0);
    CHECK(seeFile(path).voxels == seen.voxels);
    CHECK(make(" --size 1") != 0);
}
#endif
