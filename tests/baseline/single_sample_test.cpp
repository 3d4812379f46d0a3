// Single sample soft shadows against the paper's formulas and against brute force.
#include "baseline/single_sample.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <random>

#include "baseline/methods.h"
#include "baseline/reference_embree.h"
#include "object_fixture.h"

using namespace mtsm;
using namespace mtsm::baseline;
using test::Floor;
using test::Mesh;
using test::sphereLight;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::vector<float> shadows(const SingleSampleScene& scene, const AreaLight& light,
                           const std::vector<glm::dvec3>& points,
                           const SingleSampleOptions& options = {},
                           const std::vector<glm::dvec3>& normals = {}) {
    std::vector<float> out(points.size());
    scene.shadowFactors(light, points.data(), normals.empty() ? nullptr : normals.data(),
                        points.size(), out.data(), options);
    return out;
}

SingleSampleScene sceneOf(const std::vector<CasterView>& casters,
                          const std::vector<SoftSphere>& spheres = {}) {
    CasterViews source(casters);
    auto scene = SingleSampleScene::build(source, spheres);
    REQUIRE(scene);
    return std::move(*scene);
}

double bernstein(double tau) {
    const double u = std::clamp(tau, 0.0, 1.0);
    return 3 * u * u - 2 * u * u * u;
}

CentreRay rayTo(glm::dvec3 origin, glm::dvec3 light, double diameter) {
    CentreRay ray;
    ray.origin = origin;
    ray.reach = glm::distance(light, origin);
    ray.direction = (light - origin) / ray.reach;
    ray.growth = diameter / ray.reach;
    return ray;
}

/// The smallest d / (k t) over points of the triangle on a fine grid.
double denseTau(const CentreRay& ray, const std::array<glm::dvec3, 3>& corners, int n) {
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i <= n; ++i) {
        for (int j = 0; i + j <= n; ++j) {
            const glm::dvec3 q = corners[0] + double(i) / n * (corners[1] - corners[0]) +
                                 double(j) / n * (corners[2] - corners[0]) - ray.origin;
            const double t = glm::dot(q, ray.direction);
            if (t <= 0.0 || t > ray.reach || glm::dot(q, ray.normal) < 0.0) continue;
            least =
                std::min(least, glm::length(q - t * ray.direction) / (t * ray.growth));
        }
    }
    return least;
}

struct Random {
    std::mt19937_64 bits{5};
    double unit() { return double(bits() >> 11) * 0x1p-53; }
    glm::dvec3 inCube(double half) {
        const double x = unit(), y = unit(), z = unit();
        return half * (2.0 * glm::dvec3(x, y, z) - 1.0);
    }
};

/// Triangles of about `size` in a cube.
Mesh confetti(std::size_t count, float size, Random& random) {
    Mesh mesh;
    mesh.positions.push_back({0, 0, 0});  // so that the scene's origin is the world's
    for (std::size_t t = 0; t < count; ++t) {
        const glm::vec3 centre(random.inCube(1.0));
        for (int c = 0; c < 3; ++c) {
            mesh.indices.push_back(std::uint32_t(mesh.positions.size()));
            mesh.positions.push_back(centre + size * glm::vec3(random.inCube(1.0)));
        }
    }
    mesh.indices[0] = 0;
    return mesh;
}

}  // namespace

TEST_CASE("across the penumbra a sphere's shadow is the paper's formula point by point",
          "[single-sample][exact]") {
    const glm::dvec3 c(0.3, 1.5, -0.2), l(0.5, 6.0, 0.4);
    const double R = 0.7, D = 0.8;
    const SingleSampleScene scene = sceneOf({}, {{c, R}});
    SingleSampleOptions options;
    options.offset = 0.0;
    int umbra = 0, half = 0, lit = 0;
    for (double x = -2.5; x <= 2.5; x += 0.01) {
        const glm::dvec3 o(x, 0.0, 0.1);
        const glm::dvec3 v = glm::normalize(l - o);
        const double t0 = glm::dot(c - o, v), b = D * t0 / glm::length(l - o);
        const double d = glm::length(t0 * v - c + o), tau = (d - R) / b;
        const double s = tau < 0 ? 0 : tau > 1 ? 1 : bernstein(tau);
        ++(s == 0 ? umbra : s == 1 ? lit : half);
        INFO("x " << x << " tau " << tau);
        CHECK(shadows(scene, sphereLight(l, 0.5 * D), {o}, options)[0] ==
              Approx(1.0 - s).margin(1e-6));
    }
    CHECK(umbra > 50);
    CHECK(half > 20);
    CHECK(lit > 50);
}

TEST_CASE("a sphere behind the receiver or behind the light casts nothing",
          "[single-sample][exact]") {
    const SingleSampleScene scene = sceneOf({}, {{{0, 2, 0}, 0.5}});
    const AreaLight light = sphereLight({0, 5, 0}, 0.5);
    CHECK(shadows(scene, light, {{0, 3, 0}})[0] == 0.0f);
    CHECK(shadows(scene, sphereLight({0, 1, 0}, 0.5), {{0, 0, 0}})[0] == 0.0f);
    CHECK(shadows(scene, light, {{0, 1, 0}})[0] == 1.0f);
    // On its own lit side it does not shadow itself; on the other it does.
    for (double a = 0.0; a < 3.1; a += 0.05) {
        const glm::dvec3 n(std::sin(a), std::cos(a), 0.0),
            p = glm::dvec3(0, 2, 0) + 0.5 * n;
        const bool facing = glm::dot(light.position - p, n) > 0.0;
        CHECK(shadows(scene, light, {p}, {}, {n})[0] == (facing ? 0.0f : 1.0f));
    }
}

TEST_CASE("a penumbra has no width at contact and grows in proportion to the distance",
          "[single-sample][exact]") {
    // A wall whose upper edge is a above the floor, seen along the edge: the light stands
    // over it, so that W = a D / (A - a) on the floor [Parker98, fig. 3].
    const double A = 5.0, D = 0.5;
    for (const double a : {1e-4, 1e-3, 0.01, 0.1, 0.5, 1.0, 2.0}) {
        Mesh wall;
        const auto h = float(a);
        wall.positions = {{0, -1, -50}, {0, -1, 50}, {0, h, 50}, {0, h, -50}};
        wall.indices = {0, 1, 2, 0, 2, 3};
        const SingleSampleScene scene = sceneOf({wall.view()});
        SingleSampleOptions options;
        options.offset = 0.0;
        const auto visible = [&](double x) {
            return 1.0 - shadows(scene, sphereLight({-0.2, A, 0}, 0.5 * D), {{x, 0, 0}},
                                 options, {{0, 1, 0}})[0];
        };
        // The hard shadow ends where the ray passes over the edge.
        const double edge = 0.2 * a / (A - a);
        double low = edge, high = edge + 3.0;
        CHECK(visible(edge - 1e-6) == 0.0);
        for (int i = 0; i < 60; ++i) {
            const double middle = 0.5 * (low + high);
            (visible(middle) < 1.0 - 1e-6 ? low : high) = middle;
        }
        const double width = a * D / (A - a);
        INFO("a " << a << " width " << low - edge);
        // Within the slant of the outermost ray, (W / a)^2, and where 1 - s is below
        // 1e-6.
        CHECK(low - edge == Approx(width).epsilon(0.03));
        CHECK(visible(edge + 0.5 * width) == Approx(0.5).margin(0.03));
    }
}

TEST_CASE("each side of a tilted triangle is offset by b over the cosine",
          "[single-sample][exact]") {
    // A small triangle far from the receiver: b is the same all over. Receiver and light
    // move together, so that the ray stays parallel to itself.
    const double D = 0.02, A = 2000.0;
    const glm::dvec3 v = glm::normalize(glm::dvec3(0.2, 1.0, 0.1));
    const std::array<glm::dvec3, 3> corners{glm::dvec3(0.02, 0.01, 0),
                                            glm::dvec3(-0.01, 0.005, 0.015),
                                            glm::dvec3(0, -0.012, -0.01)};
    const glm::dvec3 n =
        glm::normalize(glm::cross(corners[1] - corners[0], corners[2] - corners[0]));
    const double b = 0.5 * D;
    const auto tau = [&](glm::dvec3 through) {
        return tauOfTriangle(rayTo(through - 0.5 * A * v, through + 0.5 * A * v, D),
                             corners);
    };
    for (std::size_t i = 0; i < 3; ++i) {
        const glm::dvec3 p = corners[i], q = corners[(i + 1) % 3];
        const glm::dvec3 e = glm::normalize(q - p), out = glm::cross(e, n);
        const glm::dvec3 across = glm::normalize(v - glm::dot(v, e) * e);
        const double x = b / std::abs(glm::dot(n, across));
        CHECK(tau(0.5 * (p + q)) == Approx(0.0).margin(1e-6));
        for (const double share : {0.1, 0.5, 1.0, 1.4})
            CHECK(tau(0.5 * (p + q) + share * x * out) == Approx(share).epsilon(1e-4));
        // Corners are round as seen along the ray.
        const glm::dvec3 away = p - (corners[0] + corners[1] + corners[2]) / 3.0;
        const glm::dvec3 flat = glm::normalize(away - glm::dot(away, v) * v);
        CHECK(tau(p + 0.6 * b * flat) == Approx(0.6).epsilon(1e-3));
    }
    CHECK(tau((corners[0] + corners[1] + corners[2]) / 3.0) == 0.0);
}

TEST_CASE("a triangle's tau is the least d / b of its points", "[single-sample][twin]") {
    Random random;
    int inside = 0, beside = 0, nothing = 0;
    for (int i = 0; i < 400; ++i) {
        const double size = i % 2 ? 0.3 : 2.0;  // small ones, and such as reach behind us
        const glm::dvec3 centre = random.inCube(1.0);
        std::array<glm::dvec3, 3> corners;
        for (glm::dvec3& corner : corners)
            corner = centre + random.inCube(size);
        const glm::dvec3 light = random.inCube(1.0) + glm::dvec3(0, 3, 0);
        CentreRay ray = rayTo(random.inCube(1.0) - glm::dvec3(0, 2, 0), light, 2.0);
        if (i % 3 == 0) {
            ray.normal = glm::normalize(random.inCube(1.0));
            if (glm::dot(ray.normal, ray.direction) < 0.0) ray.normal = -ray.normal;
        }
        const double found = tauOfTriangle(ray, corners),
                     dense = denseTau(ray, corners, 300);
        INFO("case " << i << " found " << found << " dense " << dense);
        ++(found == 0 ? inside : found < 1 ? beside : nothing);
        if (std::min(found, dense) >= 2.0) continue;  // what is that far off is not used
        CHECK(found <= dense + 1e-9);
        // A step of the grid is 2 size / 300 * sqrt(3); b is at least 0.3 times the way.
        CHECK(found >= dense - 0.06);
    }
    CHECK(inside > 20);
    CHECK(beside > 40);
    CHECK(nothing > 40);
}

TEST_CASE("a triangle's penumbra has no jump as the triangle turns through edge-on",
          "[single-sample]") {
    const auto largestStep = [](int steps) {
        double before = -1.0, largest = 0.0;
        for (int i = 0; i <= steps; ++i) {
            const double a = -0.3 + 0.6 * i / steps;
            const glm::dvec3 u(std::cos(a) * 0.3, std::sin(a), 0), w(0, 0, 1);
            const glm::dvec3 c(0.5, 2.0, 0);
            const double tau = tauOfTriangle(rayTo({0, 0, 0}, {0, 5, 0}, 1.0),
                                             {c - u - w, c + u, c - u + w});
            const double s = penumbra(tau);
            if (i > 0) largest = std::max(largest, std::abs(s - before));
            before = s;
        }
        return largest;
    };
    CHECK(largestStep(1000) < 0.01);
    CHECK(largestStep(4000) < 0.3 * largestStep(1000));
}

TEST_CASE("a picture changes in proportion to the light's step, a hard shadow's does not",
          "[single-sample]") {
    Mesh body = test::ballMesh({0, 1.2, 0}, 0.6, 12);
    const SingleSampleScene scene = sceneOf({body.view()}, {{{0.8, 0.7, 0.3}, 0.3}});
    const Floor floor(60, 4.0);
    const auto largestChange = [&](double step, bool hard) {
        SingleSampleOptions options;
        options.hard = hard;
        float largest = 0.0f;
        std::vector<float> before;
        for (int frame = 0; frame < 8; ++frame) {
            const auto now =
                shadows(scene, sphereLight({0.5 + step * frame, 4, 0.2}, 0.6),
                        floor.points, options, floor.normals);
            for (std::size_t i = 0; i < before.size(); ++i)
                largest = std::max(largest, std::abs(now[i] - before[i]));
            before = now;
        }
        return largest;
    };
    const float coarse = largestChange(0.04, false), fine = largestChange(0.01, false);
    CHECK(coarse > 0.02f);
    CHECK(fine < 0.3f * coarse);
    CHECK(largestChange(0.01, true) == 1.0f);
}

TEST_CASE("two shadows come together as sum, product or minimum",
          "[single-sample][exact]") {
    const glm::dvec3 c1(-0.62, 2, 0), c2(0.66, 2.5, 0), l(0, 6, 0);
    const SingleSampleScene scene = sceneOf({}, {{c1, 0.5}, {c2, 0.5}});
    SingleSampleOptions options;
    options.offset = 0.0;
    int both = 0;
    for (double x = -0.3; x <= 0.3; x += 0.01) {
        const glm::dvec3 o(x, 0, 0.05);
        const CentreRay ray = rayTo(o, l, 0.8);
        const double s1 = bernstein(tauOfSphere(ray, c1, 0.5)),
                     s2 = bernstein(tauOfSphere(ray, c2, 0.5));
        both += s1 > 0 && s1 < 1 && s2 > 0 && s2 < 1;
        const auto found = [&](Compose compose) {
            options.compose = compose;
            return shadows(scene, sphereLight(l, 0.4), {o}, options)[0];
        };
        CHECK(found(Compose::minimum) == Approx(1 - std::min(s1, s2)).margin(1e-6));
        CHECK(found(Compose::multiply) == Approx(1 - s1 * s2).margin(1e-6));
        CHECK(found(Compose::add) == Approx(std::min(1.0, 2 - s1 - s2)).margin(1e-6));
    }
    CHECK(both > 10);
}

TEST_CASE("a large scene's tree is the same for any number of threads",
          "[single-sample][twin]") {
    Random random;
    const Mesh mesh = confetti(70'000, 0.02f, random);  // some tasks' worth
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 500; ++i)
        points.push_back(random.inCube(1.3));
    const AreaLight light = sphereLight({0.4, 1.3, -0.2}, 0.1);
    std::vector<float> found[2];
    const tbb::global_control most(tbb::global_control::max_allowed_parallelism, 4);
    for (int i = 0; i < 2; ++i) {
        tbb::task_arena arena(i == 0 ? 1 : 4);
        arena.execute([&] { found[i] = shadows(sceneOf({mesh.view()}), light, points); });
    }
    CHECK(found[0] == found[1]);
    // The first few against all triangles.
    for (std::size_t i = 0; i < 20; ++i) {
        const CentreRay ray = rayTo(points[i], light.position, 2 * light.radius);
        double tau = HUGE_VAL;
        for (std::size_t t = 0; t < mesh.indices.size(); t += 3)
            tau = std::min(
                tau,
                tauOfTriangle(ray, {glm::dvec3(mesh.positions[mesh.indices[t]]),
                                    glm::dvec3(mesh.positions[mesh.indices[t + 1]]),
                                    glm::dvec3(mesh.positions[mesh.indices[t + 2]])}));
        CHECK(found[0][i] == Approx(1 - bernstein(tau)).margin(1e-3));
    }
}

TEST_CASE("a mesh casts one shadow, however finely it is cut", "[single-sample][twin]") {
    const Compose compose = GENERATE(Compose::minimum, Compose::multiply, Compose::add);
    const auto square = [](std::uint32_t n) {
        Mesh mesh;
        for (std::uint32_t i = 0; i <= n; ++i)
            for (std::uint32_t j = 0; j <= n; ++j)
                mesh.positions.emplace_back(-0.5f + float(i) / float(n), 1.5f,
                                            -0.5f + float(j) / float(n));
        for (std::uint32_t i = 0; i < n; ++i)
            for (std::uint32_t j = 0; j < n; ++j) {
                const std::uint32_t a = i * (n + 1) + j, b = a + n + 1;
                mesh.indices.insert(mesh.indices.end(), {a, a + 1, b, a + 1, b + 1, b});
            }
        return mesh;
    };
    SingleSampleOptions options;
    options.compose = compose;
    const Floor floor(30, 4.0);
    const Mesh whole = square(1), fine = square(16);
    const AreaLight light = sphereLight({0, 4, 0}, 0.5);
    const auto expected = shadows(sceneOf({whole.view()}), light, floor.points, options,
                                  floor.normals),
               found = shadows(sceneOf({fine.view()}), light, floor.points, options,
                               floor.normals);
    int soft = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        CHECK(found[i] == Approx(expected[i]).margin(1e-5));
        soft += found[i] > 0.01f && found[i] < 0.99f;
    }
    CHECK(soft > 50);
}

TEST_CASE("a ground far larger than what stands on it does not lose its shadow",
          "[single-sample]") {
    const Mesh box = test::boxMesh({-0.5f, 0.2f, -0.5f}, {0.5f, 1.2f, 0.5f});
    const AreaLight light = sphereLight({0, 6, 0}, 0.2);
    for (const double half : {5.0, 5e3, 5e5}) {
        const Mesh ground =
            test::quadMesh({-half, 0, -half}, {0, 0, 2 * half}, {2 * half, 0, 0});
        const SingleSampleScene scene = sceneOf({ground.view(), box.view()});
        INFO("half side " << half);
        const std::vector<glm::dvec3> points{{0, 0, 0.1}, {2, 0, 0}}, up(2, {0, 1, 0});
        CHECK(shadows(scene, light, points, {}, up) == std::vector<float>{1.0f, 0.0f});
        CHECK(shadows(scene, light, points)[0] == 1.0f);
    }
}

TEST_CASE("single sample shadows are the same far from the world's origin",
          "[single-sample]") {
    const glm::dvec3 far(1e6, -2e6, 3e6);
    const Mesh ball = test::ballMesh({0.1, 1.5, 0}, 0.5, 24);
    const Floor floor(30, 4.0);
    MeshView view = ball.view();
    AreaLight light = sphereLight({0.5, 6, 0.3}, 0.4);
    const auto near = shadows(sceneOf({view}), light, floor.points, {}, floor.normals);
    view.worldFromObject[3] = glm::dvec4(far, 1.0);
    light.position += far;
    std::vector<glm::dvec3> points;
    for (const glm::dvec3 p : floor.points)
        points.push_back(p + far);
    const auto there = shadows(sceneOf({view}), light, points, {}, floor.normals);
    CHECK(test::mean(near) > 0.05);
    for (std::size_t i = 0; i < near.size(); ++i)
        CHECK(there[i] == Approx(near[i]).margin(1e-4));
}

TEST_CASE("what lies behind a light that shines to one side casts nothing",
          "[single-sample][exact]") {
    const Mesh ceiling = test::quadMesh({-5, 3.02, -5}, {10, 0, 0}, {0, 0, 10});
    const SingleSampleScene scene = sceneOf({ceiling.view()}, {{{1, 3.6, 0}, 0.5}});
    AreaLight light;
    light.shape = GENERATE(LightShape::disk, LightShape::rect);
    light.position = {0, 3, 0};
    light.direction = {0, -1, 0};
    light.radius = 0.3;
    light.size = {0.6, 0.6};
    const Floor floor(20, 8.0);
    for (const float dark : shadows(scene, light, floor.points, {}, floor.normals))
        CHECK(dark == 0.0f);
    // A wall that reaches up past the light casts with its part in front.
    const Mesh low = test::quadMesh({0.5, 0, -9}, {0, 3, 0}, {0, 0, 18}),
               high = test::quadMesh({0.5, 0, -9}, {0, 9, 0}, {0, 0, 18});
    const auto cut = shadows(sceneOf({high.view()}), light, floor.points, {},
                             floor.normals),
               whole =
                   shadows(sceneOf({low.view()}), light, floor.points, {}, floor.normals);
    for (std::size_t i = 0; i < cut.size(); ++i)
        CHECK(cut[i] == Approx(whole[i]).margin(1e-5));
}

TEST_CASE("the tree finds what a search through all objects finds",
          "[single-sample][twin]") {
    Random random;
    const Mesh mesh = confetti(3000, 0.05f, random);
    std::vector<SoftSphere> spheres;
    for (int i = 0; i < 300; ++i)
        spheres.push_back({random.inCube(1.0), 0.002 + 0.03 * random.unit()});
    const SingleSampleScene scene = sceneOf({mesh.view()}, spheres);
    const double radius = GENERATE(0.02, 0.7);
    const AreaLight light = sphereLight({0.4, 1.3, -0.2}, radius);
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 800; ++i)
        points.push_back(random.inCube(i % 5 ? 1.3 : 20.0));
    for (const bool hard : {false, true}) {
        std::vector<std::array<double, 3>> expected;  // minimum, product, sum
        for (const glm::dvec3& p : points) {
            CentreRay ray = rayTo(p, light.position, hard ? 0.0 : 2 * light.radius);
            double least = 1.0, product = 1.0, sum = 0.0, nearest = HUGE_VAL;
            const auto add = [&](double tau) {
                const double s = bernstein(tau);
                least = std::min(least, s);
                product *= s;
                sum += 1 - s;
            };
            for (std::size_t t = 0; t < mesh.indices.size(); t += 3)
                nearest = std::min(
                    nearest, tauOfTriangle(
                                 ray, {glm::dvec3(mesh.positions[mesh.indices[t]]),
                                       glm::dvec3(mesh.positions[mesh.indices[t + 1]]),
                                       glm::dvec3(mesh.positions[mesh.indices[t + 2]])}));
            add(nearest);
            for (const SoftSphere& s : spheres)
                add(tauOfSphere(ray, s.centre, s.radius));
            expected.push_back({1 - least, 1 - product, std::min(1.0, sum)});
        }
        for (const GrownBounds bounds : {GrownBounds::cone, GrownBounds::largest}) {
            SingleSampleOptions options;
            options.hard = hard;
            options.bounds = bounds;
            options.offset = 0.0;
            std::array<std::vector<float>, 3> found;
            for (std::size_t c = 0; c < 3; ++c) {
                options.compose =
                    std::array{Compose::minimum, Compose::multiply, Compose::add}[c];
                found[c] = shadows(scene, light, points, options);
            }
            int soft = 0;
            for (std::size_t i = 0; i < points.size(); ++i) {
                for (std::size_t c = 0; c < 3; ++c)
                    CHECK(found[c][i] == Approx(expected[i][c]).margin(1e-6));
                soft += found[0][i] > 0.0f && found[0][i] < 1.0f;
            }
            if (!hard) CHECK(soft > 100);
        }
    }
}

TEST_CASE("a tessellated ball casts nearly the shadow of a sphere", "[single-sample]") {
    const glm::dvec3 c(0.1, 1.5, 0);
    const Mesh ball = test::ballMesh(c, 0.5, 48);
    const SingleSampleScene mesh = sceneOf({ball.view()}),
                            sphere = sceneOf({}, {{c, 0.5}});
    const Floor floor(50, 4.0);
    const AreaLight light = sphereLight({0.5, 6, 0.3}, 0.3);
    const auto a = shadows(mesh, light, floor.points, {}, floor.normals),
               b = shadows(sphere, light, floor.points, {}, floor.normals);
    // The outline is nearer to the receiver or the light than the centre is, up to the
    // radius over the distance; and it lies within the sphere by 2e-3 of the radius.
    double largest = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i)
        largest = std::max(largest, double(std::abs(a[i] - b[i])));
    CHECK(largest < 0.08);
    CHECK(test::mean(a) == Approx(test::mean(b)).epsilon(0.02));
    CHECK(test::mean(a) > 0.05);
}

TEST_CASE("a closed mesh does not darken its own lit side", "[single-sample]") {
    const Mesh ball = test::ballMesh({0, 0, 0}, 1.0, 40);
    const SingleSampleScene scene = sceneOf({ball.view()});
    const AreaLight light = sphereLight({2, 6, 1}, 1.5);
    std::vector<glm::dvec3> points, flat, smooth;
    for (std::size_t t = 0; t < ball.indices.size(); t += 3) {
        const glm::dvec3 a = ball.positions[ball.indices[t]],
                         b = ball.positions[ball.indices[t + 1]],
                         c = ball.positions[ball.indices[t + 2]];
        // In the middle, near a side and near a corner.
        for (const glm::dvec3 w :
             {glm::dvec3(1, 1, 1) / 3.0, glm::dvec3(0.499, 0.499, 0.002),
              glm::dvec3(0.002, 0.003, 0.995)}) {
            const glm::dvec3 p = w.x * a + w.y * b + w.z * c;
            const glm::dvec3 n = glm::normalize(glm::cross(b - a, c - a));
            points.push_back(p);
            flat.push_back(n);
            smooth.push_back(glm::normalize(p));
        }
    }
    const auto byFace = shadows(scene, light, points, {}, flat),
               bySmooth = shadows(scene, light, points, {}, smooth);
    int lit = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 l = glm::normalize(light.position - points[i]);
        const double face = glm::dot(flat[i], l), soft = glm::dot(smooth[i], l);
        if (face != 0.0) CHECK(byFace[i] == (face > 0.0 ? 0.0f : 1.0f));
        // A smooth normal is off by up to a facet's angle, 0.08, and the light's k is
        // 0.5.
        if (soft > 0.6) CHECK(bySmooth[i] == 0.0f);
        lit += face > 0.0;
    }
    CHECK(lit > 2000);
}

TEST_CASE("casters that let light through take their share", "[single-sample]") {
    Mesh card;
    card.positions = {{-1, 1, -1}, {1, 1, -1}, {1, 1, 1}, {-1, 1, 1}};
    card.indices = {0, 1, 2, 0, 2, 3};
    const AreaLight light = sphereLight({0, 4, 0}, 0.3);
    const Floor floor(40, 4.0);
    const auto opaque =
        shadows(sceneOf({card.view()}), light, floor.points, {}, floor.normals);
    MeshView view = card.view();
    view.opacity = 0.25f;
    const auto thin = shadows(sceneOf({view}), light, floor.points, {}, floor.normals);
    for (std::size_t i = 0; i < thin.size(); ++i)
        CHECK(thin[i] == Approx(0.25 * double(opaque[i])).margin(1e-6));

    SECTION("a texture by what it is at the nearest point") {
        OpacityImage image;
        image.width = 2;
        image.height = 1;
        image.texels = {0.0f, 0.5f};
        image.wrapU = image.wrapV = TextureWrap::clamp;
        auto texture = OpacityTexture::create(image);
        REQUIRE(texture);
        const std::vector<glm::vec2> uvs{{0, 0}, {1, 0}, {1, 1}, {0, 1}};
        view = card.view();
        view.texture = &*texture;
        view.uvs = uvs.data();
        const SingleSampleScene scene = sceneOf({view});
        SingleSampleOptions hard;
        hard.hard = true;
        // Rays to the centre meet the card at 3 / 4 of x: its quarters end at 0.5.
        CHECK(shadows(scene, light, {{-1, 0, 0.1}}, hard)[0] == 0.0f);
        CHECK(shadows(scene, light, {{1, 0, 0.1}}, hard)[0] == 0.5f);
        CHECK(shadows(scene, light, {{-1, 0, 0.1}})[0] < 0.1f);
        CHECK(shadows(scene, light, {{1, 0, 0.1}})[0] > 0.4f);
    }
}

TEST_CASE("hard shadows are those of a ray to the light's centre",
          "[single-sample][twin]") {
    const Mesh body = test::bumpyBody(5000);
    CasterViews casters({body.view()});
    auto scene = SingleSampleScene::build(casters);
    auto embree = EmbreeReference::build(casters);
    REQUIRE(scene);
    REQUIRE(embree);
    Random random;
    AreaLight point;
    point.position = {2, 5, 1};
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 4000; ++i)
        points.push_back(random.inCube(2.5) - glm::dvec3(1, 3, 0.5));
    std::vector<float> truth(points.size());
    embree->shadowFactors(point, points.data(), nullptr, points.size(), truth.data());
    SingleSampleOptions hard;
    hard.hard = true;
    const auto found = shadows(*scene, sphereLight(point.position, 0.5), points, hard),
               bySize = shadows(*scene, point, points);
    int different = 0;
    for (std::size_t i = 0; i < points.size(); ++i)
        different += found[i] != truth[i] || bySize[i] != truth[i];
    // Embree's floats decide otherwise within 1e-6 of an outline.
    CHECK(different <= 2);
    CHECK(test::mean(truth) > 0.05);
}

TEST_CASE("single sample shadows are finite for whatever comes",
          "[single-sample][bad-input]") {
    Mesh mesh = test::ballMesh({0, 1, 0}, 0.5, 8);
    mesh.positions.push_back({NAN, 0, 0});
    mesh.positions.push_back({0, 1, 0});
    const auto bad = std::uint32_t(mesh.positions.size() - 2);
    mesh.indices.insert(mesh.indices.end(),
                        {bad, 0, 20, bad + 1, bad + 1, bad + 1, 20, 20, bad + 1});
    const SingleSampleScene scene = sceneOf(
        {mesh.view()}, {{{kNan, 0, 0}, 1.0}, {{2, 1, 0}, -1.0}, {{1, 1, 1}, 0.2}});
    const std::vector<glm::dvec3> points{
        {kNan, 0, 0}, {0, 1, 0},      {0, 1.5, 0},
        {0, 4, 0},    {1e9, -1e9, 3}, {0, 0, 0},
        {1, 1, 1},    {0, 9, 0},      glm::dvec3(mesh.positions[20])};
    AreaLight light;
    light.position = {0, 4, 0};
    for (const LightShape shape : {LightShape::point, LightShape::disk, LightShape::rect,
                                   LightShape::sphere, LightShape::sun}) {
        for (const double size : {0.0, 0.5, 100.0}) {
            light.shape = shape;
            light.radius = size;
            light.size = glm::dvec2(size, 0.5 * size);
            light.angularDiameter = std::min(size, 3.0);
            for (const float dark : shadows(scene, light, points)) {
                CHECK(dark >= 0.0f);
                CHECK(dark <= 1.0f);
            }
        }
    }
    CHECK(shadows(scene, light, points)[0] == 0.0f);
}

TEST_CASE("the row single-sample answers by its settings, alike on any number of threads",
          "[single-sample]") {
    const Mesh body = test::bumpyBody(3000), ball = test::ballMesh({0.5, 2, 0}, 0.4, 8);
    CasterViews casters({body.view(), ball.view()});
    BakeOptions bake;
    bake.light = sphereLight({2, 5, 1}, 0.5);
    const MethodScene scene{casters, bake, {}};
    auto info = findMethod("single-sample");
    REQUIRE(info);
    CHECK(!(*info)->perLight);
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 3000; ++i)
        points.push_back({-3 + i % 60 * 0.1, -1.3, -3 + i / 60 * 0.1});
    const std::vector<glm::dvec3> normals(points.size(), {0, 1, 0});
    Receivers at;
    at.points = at.starts = points.data();
    at.normals = normals.data();
    at.count = points.size();
    const auto run = [&](const Settings::Given& given, int threads) {
        auto settings = Settings::complete((*info)->settings, given, "single-sample");
        REQUIRE(settings);
        auto method = (*info)->build(scene, *settings);
        REQUIRE(method);
        CHECK((*method)->memoryBytes() > 3000 * 36);
        std::vector<float> out(points.size(), -1.0f);
        const tbb::global_control most(tbb::global_control::max_allowed_parallelism, 4);
        tbb::task_arena arena(threads);
        arena.execute([&] {
            CHECK((*method)->shadowFactors(bake.light, at, *settings, out.data()));
        });
        return out;
    };
    const auto one = run({}, 1);
    CHECK(one == run({}, 4));
    CHECK(one == run({{"bounds", std::string("largest")}}, 1));
    CHECK(test::mean(one) < test::mean(run({{"compose", std::string("multiply")}}, 1)));
    CHECK(test::mean(one) > test::mean(run({{"hard", true}}, 1)));

    StrandsView hair;
    CasterViews none({hair});
    auto refused =
        (*info)->build({none, bake, {}}, *Settings::complete((*info)->settings, {}, ""));
    REQUIRE(!refused);
    CHECK(refused.error().code == ErrorCode::unsupported);
}
