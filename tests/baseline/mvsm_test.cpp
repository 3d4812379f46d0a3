// Multi-view shadow maps, ray traced.
#include <glm/geometric.hpp>

#include "depth_rows.h"

using namespace mtsm;
using namespace mtsm::test;

TEST_CASE("multi-view maps give the closed form of a square under a rectangle",
          "[baseline][exact]") {
    const Rect square{-0.5, 0.5, -0.5, 0.5, 2};
    const Mesh mesh = square.mesh();
    const BakeOptions light = rectLight(4, 1.2, 0.8);
    const Points points = floorLine(-2, 2, 40);
    for (const char* views : {"1", "5", "9"}) {
        const auto found = run(
            "mvsm", {mesh.view()}, light,
            {{"resolution", 512.0}, {"samples", 4096.0}, {"views", std::string(views)}},
            points);
        for (std::size_t i = 0; i < points.size(); ++i) {
            // Each edge is off by half a pixel of some view.
            const double allowed = noise(4096) + 2 * (2 * 0.5 / 512) / 0.8;
            INFO(views << " views, x = " << points.position[i].x);
            CHECK(found[i] ==
                  Approx(shadowOf(square, light, points.position[i])).margin(allowed));
        }
    }
}

TEST_CASE("views from the corners see what is hidden from the centre",
          "[baseline][exact]") {
    const Rect upper{-0.5, 0.5, -0.5, 0.5, 2}, lower{-0.55, 0.55, -0.55, 0.55, 1};
    const Mesh a = upper.mesh(), b = lower.mesh();
    const BakeOptions light = rectLight(4, 2, 2);
    const Points points = floorLine(-2.5, 2.5, 50);
    const auto shadow = [&](const char* views) {
        return run(
            "mvsm", {a.view(), b.view()}, light,
            {{"resolution", 512.0}, {"samples", 4096.0}, {"views", std::string(views)}},
            points);
    };
    const auto one = shadow("1"), five = shadow("5");
    const Rect whole{-1, 1, -1, 1, 4};
    const double allowed = noise(4096, 4) + 4 * (2 * 0.5 / 512);
    double leak = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 p = points.position[i];
        const double up = shadowOf(upper, light, p);
        const double both = area(common(
            common(hiddenOfLight(upper, 4, p), hiddenOfLight(lower, 4, p)), whole));
        const double expected = up + shadowOf(lower, light, p) - both / area(whole);
        INFO("x = " << p.x);
        CHECK(one[i] == Approx(up).margin(allowed));
        // The middle of the lower one stays hidden from the corners, too; but each ray
        // to the light that crosses it there crosses the upper one.
        CHECK(five[i] == Approx(expected).margin(allowed));
        leak = std::max(leak, expected - up);
    }
    CHECK(leak > 0.1);
}

TEST_CASE("multi-view maps approach ray tracing with their resolution",
          "[baseline][statistical]") {
    const Mesh body = bumpyBody(20'000);
    BakeOptions options;
    options.light.position = {2, 5, 2.5};
    options.light.direction = glm::normalize(-options.light.position);
    options.light.radius = 0.5;
    options.aimed = true;
    const Points floor = floorGrid(3, 24, -1.3);
    for (const LightShape shape : {LightShape::disk, LightShape::sphere}) {
        options.light.shape = shape;
        const auto expected = truth({body.view()}, options.light, floor, 1024);
        const auto error = [&](double resolution) {
            return meanError(
                run("mvsm", {body.view()}, options, {{"resolution", resolution}}, floor),
                expected);
        };
        const double coarse = error(32), fine = error(512);
        INFO(name(shape) << ": 32: " << coarse << ", 512: " << fine);
        CHECK(fine < 0.005);
        CHECK(fine < coarse / 2);
    }
}

TEST_CASE("a sun's views give the shadow that ray tracing gives",
          "[baseline][statistical]") {
    const Mesh body = bumpyBody(20'000);
    BakeOptions options;
    options.light.shape = LightShape::sun;
    options.light.direction = glm::normalize(glm::dvec3(-0.3, -1, -0.2));
    options.light.angularDiameter = 0.2;
    const Points floor = floorGrid(3, 24, -1.3);
    const auto expected = truth({body.view()}, options.light, floor, 1024);
    for (const char* row : {"mvsm", "mlsm"})
        CHECK(meanError(run(row, {body.view()}, options, {{"resolution", 512.0}}, floor),
                        expected) < 0.005);
}

TEST_CASE("a light that the views are not of is refused", "[baseline][bad-input]") {
    using namespace baseline;
    const Mesh square = Rect{-0.5, 0.5, -0.5, 0.5, 2}.mesh();
    const BakeOptions bake = rectLight(4, 1, 1);
    AreaLight larger = bake.light;
    larger.size *= 1.1;
    for (const char* row : {"slsm", "mlsm", "mvsm", "pcf", "deep-pcf", "accumulated"}) {
        CasterViews casters({square.view()});
        const MethodInfo* info = *findMethod(row);
        const auto settings =
            Settings::complete(info->settings, {{"resolution", 16.0}}, row);
        const auto method = info->build({casters, bake, {}}, *settings);
        REQUIRE(method);
        const glm::dvec3 point(0), normal(0, 1, 0);
        const std::size_t first[] = {0, 1};
        float out = 0;
        const Receivers at{&point, &normal, &point, 1, first, 1};
        INFO(row);
        CHECK(!(*method)->shadowFactors(larger, at, *settings, &out));
    }
}
