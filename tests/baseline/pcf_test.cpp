// Percentage-closer filtering: right where its one depth is the blocker's, wrong in known
// ways elsewhere.
#include "depth_rows.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

const Settings::Given kFine = {{"resolution", 1024.0}, {"samples", 4096.0}};

Settings::Given with(Settings::Given given, const std::string& name, SettingValue value) {
    given.emplace_back(name, std::move(value));
    return given;
}

}  // namespace

TEST_CASE("filtering is exact for one blocker parallel to the light",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    for (const char* row : {"pcf", "deep-pcf"}) {
        for (const char* filter : {"zmin", "blocker"}) {
            for (const bool normals : {true, false}) {
                const Points points = floorLine(-2, 2, 40, normals);
                const auto found =
                    run(row, {mesh.view()}, light,
                        with(kFine, "filter", std::string(filter)), points);
                for (std::size_t i = 0; i < points.size(); ++i) {
                    const double allowed = noise(4096) + 2 * (2 * 0.5 / 1024) / 0.8;
                    INFO(row << " " << filter << " x = " << points.position[i].x);
                    CHECK(found[i] == Approx(shadowOf(square, light, points.position[i]))
                                          .margin(allowed));
                }
            }
        }
    }
}

TEST_CASE(
    "filtering by the map's least depth widens penumbrae, a blocker search does not",
    "[baseline][exact]") {
    // A half-plane near the floor, x < 0 at height 1, and a small square close to the
    // light but aside. From x the half-plane hides the light's s < -x z / (4 - z), z its
    // depth below the light, which is 3; the filter takes z_min = 0.5 for it.
    const Rect half{-6, 0, -6, 6, 1}, small{0.45, 0.5, -0.02, 0.02, 3.5};
    const Mesh a = half.mesh(), b = small.mesh();
    const double side = 0.5;
    const BakeOptions light = rectLight(4, side, side);
    const Points points = floorLine(-0.4, 0.4, 40);
    // The small square's shadow is elsewhere.
    for (const glm::dvec3 p : points.position)
        REQUIRE(shadowOf(small, light, p) == 0.0);
    const auto linear = [&](double x, double z) {
        return std::clamp(0.5 - x * z / (4 - z) / side, 0.0, 1.0);
    };
    const auto zmin = run("pcf", {a.view(), b.view()}, light, kFine, points);
    const auto search = run("pcf", {a.view(), b.view()}, light,
                            with(kFine, "filter", std::string("blocker")), points);
    // Pixels of 12.5 / 3 / 1024 in raster tangents, half of one at the edge.
    const double pixel = 12.5 / 3 / 1024;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double x = points.position[i].x;
        INFO("x = " << x);
        CHECK(zmin[i] == Approx(linear(x, 0.5)).margin(noise(4096) + pixel));
        CHECK(search[i] == Approx(linear(x, 3)).margin(noise(4096) + 8 * pixel));
        CHECK(shadowOf(half, light, points.position[i]) == Approx(linear(x, 3)));
    }
}

TEST_CASE("filtering closes the gap between blockers that the light's centre sees as one",
          "[baseline][exact]") {
    // The wrong fusion of occluders [Xie07, sec. 3]. From the light's centre a half-plane
    // x < 0 and a lower one on the other side cover everything. From x < 0 on the floor
    // part of the light is seen between them.
    const Rect left{-1.5, 0, -1.5, 1.5, 2}, right{-0.02, 1.5, -1.5, 1.5, 1};
    const Mesh a = left.mesh(), b = right.mesh();
    const BakeOptions light = rectLight(4, 1, 1);
    const Points points = floorLine(-0.3, -0.1, 8);
    const auto traced = run("mlsm", {a.view(), b.view()}, light, kFine, points);
    for (const char* filter : {"zmin", "blocker"}) {
        const auto found =
            run("pcf", {a.view(), b.view()}, light,
                with(with(kFine, "filter", std::string(filter)), "layers", 5.0), points);
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec3 p = points.position[i];
            const double gap =
                hiddenOfLight(right, 4, p).x0 - hiddenOfLight(left, 4, p).x1;
            REQUIRE(gap > 0.1);
            const Rect between{hiddenOfLight(left, 4, p).x1,
                               hiddenOfLight(right, 4, p).x0, -0.5, 0.5, 4};
            const double lit = area(common(between, {-0.5, 0.5, -0.5, 0.5, 4}));
            // Half of a pixel of 1024 at each edge, four times as large on the light.
            CHECK(traced[i] == Approx(1 - lit).margin(noise(4096) + 0.01));
            CHECK(found[i] == Approx(1.0).margin(0.001));
        }
    }
}

TEST_CASE("a half-transparent sheet is half of its shadow, filtered",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2}, above{-3, 3, -3, 3, 2.5};
    const Mesh a = square.mesh(), b = above.mesh();
    MeshView half = a.view(), other = b.view();
    half.opacity = 0.5f;
    other.opacity = 0.25f;
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points points = floorLine(-1.8, 1.8, 36);
    for (const char* filter : {"zmin", "blocker"}) {
        const auto given = with(kFine, "filter", std::string(filter));
        const auto alone = run("deep-pcf", {half}, light, given, points);
        for (std::size_t i = 0; i < points.size(); ++i)
            CHECK(alone[i] == Approx(0.5 * shadowOf(square, light, points.position[i]))
                                  .margin(0.5 * noise(4096) + 0.003));
        // Below the middle of both: the products of what they leave.
        CHECK(run("deep-pcf", {half, other}, light, given, floorLine(0, 0, 1))[0] ==
              Approx(1 - 0.5 * 0.75).margin(1e-4));
    }
}

TEST_CASE("the blockers of a deep map count by what they take", "[baseline][exact]") {
    // A thin veil all over, close to the light, and an opaque half-plane near the floor:
    // the search's mean is .1 times the veil's depth and .9 times the half-plane's, where
    // that is behind it in every lookup.
    const Rect veil{-6, 6, -6, 6, 3}, half{-6, 0, -6, 6, 1};
    const Mesh a = veil.mesh(), b = half.mesh();
    MeshView thin = a.view();
    thin.opacity = 0.1f;
    const double side = 0.1;
    const BakeOptions light = rectLight(4, side, side);
    const Points points = floorLine(-0.008, -0.006, 8);
    const auto found = run("deep-pcf", {thin, b.view()}, light,
                           {{"resolution", 2048.0},
                            {"samples", 4096.0},
                            {"filter", std::string("blocker")},
                            {"search", 4096.0}},
                           points);
    for (std::size_t i = 0; i < points.size(); ++i) {
        // Of the search (z = 1) the half-plane has the share h, the veil all.
        const double x = points.position[i].x;
        const double h = std::clamp(0.5 - x * 1 / 3 / side, 0.0, 1.0);
        const double z = (0.1 * 1 + 0.9 * h * 3) / (0.1 + 0.9 * h);
        const double dark = std::clamp(0.5 - x * z / (4 - z) / side, 0.0, 1.0);
        INFO("x = " << x << ", mean depth " << z);
        // Pixels of 12.5 / 3 / 2048 (height 3 below the light) over the light's spread.
        CHECK(
            found[i] ==
            Approx(dark + (1 - dark) * 0.1).margin(noise(4096) + 12.5 / 3 / 2048 / side));
    }
}

TEST_CASE("for a tiny light filtering and tracing agree on the hard shadow",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    BakeOptions light = rectLight(4, 0, 0);
    light.light.shape = LightShape::disk;
    light.light.radius = 1e-4;
    const Points points = floorLine(-2, 2, 37);
    for (const std::string row : {"mtsm", "pcf", "deep-pcf", "mvsm", "accumulated"}) {
        Settings::Given given = {{"resolution", 128.0}, {"samples", 16.0}};
        if (row == "mtsm") given.emplace_back("lookup", std::string("pcf"));
        const auto found = run(row, {mesh.view()}, light, given, points);
        for (std::size_t i = 0; i < points.size(); ++i) {
            const double fromEdge = std::abs(std::abs(points.position[i].x) - 1.0);
            if (fromEdge < 2.0 / 128) continue;
            INFO(row << " x = " << points.position[i].x);
            CHECK(found[i] == (std::abs(points.position[i].x) < 1.0 ? 1.0f : 0.0f));
        }
    }
}

TEST_CASE("light below the horizon is blocked in every row", "[baseline][exact]") {
    // The receiver's plane goes through the light's middle; nothing is in between.
    const Mesh far = Rect{2, 3, 2, 3, 1}.mesh();
    const BakeOptions light = rectLight(4, 1, 1);
    Points points;
    points.add({0, 0, 0}, {1, 0, 0});
    points.add({0, 0, 0}, {0, -1, 0});
    points.add({0, 5, 0}, {0, 1, 0});  // behind the light: lit
    points.add({0, 0, 0}, {0, 0, 0});
    for (const char* row : {"slsm", "mlsm", "mvsm", "pcf", "deep-pcf", "accumulated"}) {
        const auto found = run(row, {far.view()}, light,
                               {{"resolution", 32.0}, {"samples", 256.0}}, points);
        INFO(row);
        CHECK(found[0] == Approx(0.5).margin(noise(256)));
        CHECK(found[1] == 1.0f);
        CHECK(found[2] == 0.0f);
        CHECK(found[3] == 0.0f);
    }
}

TEST_CASE("several layers keep more of the shadow at contact where there is no normal",
          "[baseline]") {
    // A thin plate, top and bottom, at a height of four of the map's biases: within the
    // slope bias of one layer.
    const BakeOptions light = rectLight(4, 0.1, 0.1);
    const double bias = 0.01, top = 4 * bias, bottom = 3 * bias;
    const Mesh a = Rect{-1, 1, -1, 1, top}.mesh(), b = Rect{-1, 1, -1, 1, bottom}.mesh();
    const Points under = floorLine(-0.5, 0.5, 4, /*normals=*/false);
    const auto shadow = [&](double layers) {
        return run("pcf", {a.view(), b.view()}, light,
                   {{"resolution", 64.0}, {"layers", layers}, {"bias", bias}}, under);
    };
    for (std::size_t i = 0; i < under.size(); ++i) {
        CHECK(shadow(1)[i] == 0.0f);
        CHECK(shadow(2)[i] == 1.0f);
    }
    // And the plate's own top stays lit.
    Points own;
    own.add({0.1, top, 0.1}, {0, 0, 0});
    for (const double layers : {1.0, 2.0})
        CHECK(run("pcf", {a.view(), b.view()}, light,
                  {{"resolution", 64.0}, {"layers", layers}, {"bias", bias}},
                  own)[0] == 0.0f);
}

TEST_CASE(
    "lights of every shape give nearly the shadow that ray tracing gives of a plate",
    "[baseline][statistical]") {
    // One blocker across the light's axis, so that its depth is the filter's: exact for a
    // flat light; a sphere's caps tilt with the receiver, and a sun's filter is a disk.
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    BakeOptions bake = rectLight(5, 1.0, 1.0);
    bake.light.radius = 0.5;
    bake.light.shape = GENERATE(LightShape::disk, LightShape::sphere, LightShape::sun);
    bake.light.angularDiameter = 0.3;
    const Points points = floorGrid(1.5, 24);
    const auto expected = truth({mesh.view()}, bake.light, points, 4096);
    int soft = 0;
    for (const float e : expected)
        soft += e > 0.05f && e < 0.95f;
    CHECK(soft > 80);
    for (const char* row : {"pcf", "deep-pcf"}) {
        const auto found = run(row, {mesh.view()}, bake,
                               with(kFine, "filter", std::string("blocker")), points);
        INFO(row << ", light " << int(bake.light.shape));
        CHECK(meanError(found, expected) < 0.005);
    }
}
