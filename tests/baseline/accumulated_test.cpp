// Accumulated hard shadow maps.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <glm/geometric.hpp>

#include "depth_rows.h"

using namespace mtsm;
using namespace mtsm::test;

TEST_CASE("accumulated maps approach the closed form of a square under a rectangle",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points points = floorGrid(2, 16);
    std::vector<float> expected;
    for (const glm::dvec3 p : points.position)
        expected.push_back(float(shadowOf(square, light, p)));
    const auto error = [&](double resolution, double samples) {
        return meanError(run("accumulated", {mesh.view()}, light,
                             {{"resolution", resolution}, {"samples", samples}}, points),
                         expected);
    };
    const double coarse = error(16, 16), fine = error(64, 256);
    INFO(coarse << " " << fine);
    CHECK(fine < 0.01);
    CHECK(fine < coarse / 3);
}

TEST_CASE("accumulated maps approach ray tracing on lights of every shape",
          "[baseline][statistical]") {
    const Mesh body = bumpyBody(2'000);
    BakeOptions options;
    options.light.position = {2, 5, 2.5};
    options.light.radius = 0.8;
    options.light.size = {1.2, 0.8};
    options.light.angularDiameter = 0.2;
    options.target = glm::dvec3(0.0);
    const Points floor = floorGrid(3, 16, -1.3);
    for (const LightShape shape :
         {LightShape::disk, LightShape::rect, LightShape::sphere, LightShape::sun}) {
        options.light.shape = shape;
        options.light.direction = glm::normalize(-options.light.position);
        // Where a sphere's views look is not its direction's to say.
        if (shape == LightShape::sphere) options.light.direction = {1, 0, 0};
        const auto expected = truth({body.view()}, options.light, floor, 1024);
        const auto found = run("accumulated", {body.view()}, options,
                               {{"resolution", 128.0}, {"samples", 128.0}}, floor);
        INFO(name(shape));
        // Half of a sphere's views are of its far side.
        CHECK(meanError(found, expected) < 0.01);
    }
}

TEST_CASE("accumulated maps take casters that let light through for what they are",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    MeshView half = mesh.view();
    half.opacity = 0.5f;
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points points = floorLine(-1.8, 1.8, 36);
    const auto found = run("accumulated", {half}, light,
                           {{"resolution", 128.0}, {"samples", 64.0}}, points);
    for (std::size_t i = 0; i < points.size(); ++i)
        CHECK(found[i] == Approx(0.5 * shadowOf(square, light, points.position[i]))
                              .margin(0.5 * noise(64)));
}

TEST_CASE("accumulated maps see strands and volumes as ray tracing does",
          "[baseline][statistical]") {
    std::vector<glm::vec3> line;
    for (int i = 0; i <= 40; ++i)
        line.emplace_back(-1 + 0.05f * float(i), 2 + 0.1f * std::sin(0.5f * float(i)), 0);
    const std::vector<std::uint32_t> begin = {0, std::uint32_t(line.size())};
    StrandsView strand;
    strand.points = line.data();
    strand.begin = begin.data();
    strand.strandCount = 1;
    strand.width = 0.3f;
    strand.opacity = 0.6f;
    const std::vector<glm::ivec3> blocks = {{0, 0, 0}};
    const std::vector<float> density(std::size_t(VolumeView::kBlockVoxels), 1.0f);
    VolumeView smoke;
    smoke.blocks = blocks.data();
    smoke.blockCount = 1;
    smoke.density = density.data();
    smoke.worldFromIndex = glm::dmat4(0.1);
    smoke.worldFromIndex[3] = glm::dvec4(-0.4, 1, 0.4, 1);
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points floor = floorGrid(1.5, 16);
    const auto expected = truth({strand, smoke}, light.light, floor, 1024);
    const auto found = run("accumulated", {strand, smoke}, light,
                           {{"resolution", 128.0}, {"samples", 64.0}}, floor);
    CHECK(meanError(found, expected) < 0.01);
}

TEST_CASE("rows of depth maps look around a light among its casters",
          "[baseline][statistical]") {
    // A square above the light and one beside it, seen by six views; receivers behind
    // both, all around the edges of the views.
    Mesh above = Rect{-0.5, 0.9, -0.5, 0.5, 1}.mesh(), beside = above;
    for (glm::vec3& p : beside.positions)
        p = {p.y, -p.x, p.z};
    BakeOptions options;
    options.light.shape = LightShape::sphere;
    options.light.radius = 0.2;
    options.cube = true;
    Points points;
    for (int i = 0; i < 100; ++i) {
        const double x = -3 + 0.06 * i;
        points.add({x, 3, 0.4}, {0, -1, 0});
        points.add({3, x, -0.3}, {-1, 0, 0});
    }
    const auto expected =
        truth({above.view(), beside.view()}, options.light, points, 1024);
    for (const char* row : {"mlsm", "mvsm", "pcf", "deep-pcf", "accumulated"}) {
        const auto found = run(row, {above.view(), beside.view()}, options,
                               {{"resolution", 128.0}, {"samples", 128.0}}, points);
        INFO(row);
        CHECK(meanError(found, expected) < 0.015);
    }
}

TEST_CASE("rows of depth maps answer the same for any number of threads",
          "[baseline][threads]") {
    const Mesh body = bumpyBody(2'000);
    MeshView view = body.view();
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.position = {2, 5, 2.5};
    options.light.direction = glm::normalize(-options.light.position);
    options.light.radius = 0.5;
    options.aimed = true;
    const Points floor = floorGrid(3, 40, -1.3);
    for (const std::string row : {"slsm", "mvsm", "pcf", "deep-pcf", "accumulated"}) {
        view.opacity = row == "deep-pcf" ? 0.5f : 1.0f;
        const auto answers = [&](int threads) {
            const tbb::global_control most(tbb::global_control::max_allowed_parallelism,
                                           std::size_t(threads));
            tbb::task_arena arena(threads);
            return arena.execute([&] {
                return run(row, {view}, options,
                           {{"resolution", 64.0}, {"samples", 16.0}}, floor);
            });
        };
        INFO(row);
        CHECK(answers(1) == answers(4));
    }
}
