// Batches of an opaque map, where neighbours share the way of their rays: the same
// answers as alone, in any order, and in the mean those of the scalar trace.
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <glm/geometric.hpp>
#include <numeric>
#include <random>
#include <vector>

#include "bumpy_mesh.h"
#include "map_fixture.h"
#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/shadow.h"
#include "random.h"
#include "shadow/released.h"

using namespace mtsm;
using test::Random;

namespace {

constexpr double kFloor = -1.3;

test::Mesh floorMesh() {
    test::Mesh mesh;
    const float y = float(kFloor);
    mesh.positions = {{-4, y, -4}, {4, y, -4}, {4, y, 4}, {-4, y, 4}};
    mesh.indices = {0, 2, 1, 0, 3, 2};
    return mesh;
}

const test::Mesh& body() {
    static const test::Mesh mesh = test::bumpyBody(20'000);
    return mesh;
}

AreaLight lightOf(LightShape shape) {
    AreaLight light;
    light.shape = shape;
    light.position = {1.5, 5, 2};
    light.direction = glm::normalize(-light.position);
    light.up = {0, 0, 1};
    light.radius = 0.4;
    light.size = {0.9, 0.5};
    light.angularDiameter = 0.12;
    return light;
}

/// As wide as what it shines on.
AreaLight largeLightOf(LightShape shape) {
    AreaLight light = lightOf(shape);
    light.radius = 1.6;
    return light;
}

constexpr LightShape kShapes[] = {LightShape::point, LightShape::disk, LightShape::rect,
                                  LightShape::sphere, LightShape::sun};

/// A bumpy body over a floor; a sun's map is orthographic.
ShadowMap mapOf(const AreaLight& light, bool nearField) {
    const test::Mesh floor = floorMesh();
    CasterViews casters({body().view(), floor.view()});
    BakeOptions options;
    options.light = light;
    options.width = options.height = 256;
    options.nearField = nearField ? kAutomaticNearField : 0;
    auto baked = bake(casters, options);
    REQUIRE(baked);
    REQUIRE(baked->map.isOpaque());
    REQUIRE(baked->map.nearField(0).empty() != nearField);
    const bool perspective = baked->map.projection(0).kind == ProjectionKind::perspective;
    REQUIRE(perspective == (light.shape != LightShape::sun));
    return std::move(baked->map);
}
ShadowMap mapOf(LightShape shape, bool nearField) {
    return mapOf(lightOf(shape), nearField);
}

struct Points {
    std::vector<glm::dvec3> at, normal;

    [[nodiscard]] std::size_t size() const { return at.size(); }
    void add(glm::dvec3 p, glm::dvec3 n) {
        at.push_back(p);
        normal.push_back(n);
    }
    [[nodiscard]] Points ordered(const std::vector<std::size_t>& order) const {
        Points some;
        for (const std::size_t i : order)
            some.add(at[i], normal[i]);
        return some;
    }
};

Points onFloor(Random& random, int count) {
    Points points;
    for (int i = 0; i < count; ++i)
        points.add({random.in(-3, 3), kFloor, random.in(-3, 3)}, {0, 1, 0});
    return points;
}

Points onBody(Random& random, int count) {
    Points points;
    for (int i = 0; i < count; ++i) {
        const std::size_t t = 3 * random.below(body().indices.size() / 3);
        const auto corner = [&](std::size_t k) {
            return glm::dvec3(body().positions[body().indices[t + k]]);
        };
        const glm::dvec3 a = corner(0), b = corner(1), c = corner(2);
        const glm::dvec3 n = glm::cross(b - a, c - a);
        points.add((a + b + c) / 3.0, n);  // of any length
    }
    return points;
}

/// All sorts in one batch: on the floor and the body, some without normals, some with
/// none that makes sense, some in clusters, some that no ray in float could answer.
Points mixed(Random& random, int count) {
    Points points = onFloor(random, count / 2);
    const Points more = onBody(random, count - count / 2);
    for (std::size_t i = 0; i < more.size(); ++i)
        points.add(more.at[i], more.normal[i]);
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (i % 7 == 0) points.normal[i] = glm::dvec3(0.0);
        if (i % 11 == 0) points.at[i].y += 0.3;
        if (i % 3 == 1) points.at[i] = points.at[i - 1] + 1e-3;
    }
    points.at[5].x = NAN;
    points.normal[6].x = INFINITY;
    points.at[8] = {2, 9, 2};           // behind a light that shines to one side
    points.at[9] = {400, kFloor, 300};  // far outside the view
    points.at[10] = {1.5, 5, 2};        // at the light's centre
    points.normal[12] *= 1e-200;
    return points;
}

ShadowOptions samplesOf(int n) {
    ShadowOptions options;
    options.samples = n;
    return options;
}

std::vector<float> answers(const ShadowMap& map, const AreaLight& light,
                           const Points& points, const ShadowOptions& options,
                           bool normals = true) {
    std::vector<float> out(points.size(), -1.0f);
    shadowFactors(map, light, points.at.data(), normals ? points.normal.data() : nullptr,
                  points.size(), out.data(), options);
    return out;
}
std::vector<float> answers(const ShadowMap& map, LightShape shape, const Points& points,
                           const ShadowOptions& options, bool normals = true) {
    return answers(map, lightOf(shape), points, options, normals);
}

bool same(const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), 4 * a.size()) == 0;
}

int different(const std::vector<float>& a, const std::vector<float>& b) {
    int count = 0;
    for (std::size_t i = 0; i < a.size(); ++i)
        count += std::memcmp(&a[i], &b[i], 4) != 0;
    return count;
}

double meanOf(const std::vector<float>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / double(values.size());
}

}  // namespace

TEST_CASE("a point is answered the same alone, in a batch and in any order",
          "[shadow][exact]") {
    for (const LightShape shape : kShapes) {
        for (const bool nearField : {false, true}) {
            const ShadowMap map = mapOf(shape, nearField);
            Random random(1);
            for (const int samples : {1, 3, 4, 20, 64, 300}) {
                for (const Weight weight : {Weight::uniform, Weight::cosine}) {
                    for (const bool normals : {true, false}) {
                        INFO(name(shape)
                             << " near " << nearField << " samples " << samples
                             << " weight " << int(weight) << " normals " << normals);
                        ShadowOptions options = samplesOf(samples);
                        options.weight = weight;
                        const Points points = mixed(random, 300);
                        const std::vector<float> batch =
                            answers(map, shape, points, options, normals);
                        for (const float f : batch)
                            CHECK((f >= 0.0f && f <= 1.0f));

                        std::vector<float> alone;
                        for (std::size_t i = 0; i < points.size(); ++i)
                            alone.push_back(shadowFactor(
                                map, lightOf(shape), points.at[i],
                                normals ? points.normal[i] : glm::dvec3(0.0), options));
                        CHECK(different(alone, batch) == 0);

                        std::vector<std::size_t> order(points.size());
                        std::iota(order.begin(), order.end(), 0);
                        for (std::size_t i = order.size() - 1; i > 0; --i)
                            std::swap(order[i], order[random.below(i + 1)]);
                        const std::vector<float> shuffled =
                            answers(map, shape, points.ordered(order), options, normals);
                        std::vector<float> back(points.size());
                        for (std::size_t i = 0; i < order.size(); ++i)
                            back[order[i]] = shuffled[i];
                        CHECK(different(back, batch) == 0);

                        const std::vector<std::size_t> third(order.begin(),
                                                             order.begin() + 100);
                        const std::vector<float> some =
                            answers(map, shape, points.ordered(third), options, normals);
                        CHECK(same(some, {shuffled.begin(), shuffled.begin() + 100}));
                    }
                }
            }
        }
    }
}

/// Rows of points level with the floor and far beyond it, some of them turned away from
/// the light.
Points rows(int count) {
    Points points;
    for (int y = 0; y < count; ++y) {
        for (int x = 0; x < count; ++x)
            points.add({30.0 * x / count - 15, kFloor, 6.0 * y / count - 3},
                       {0, y % 5 == 3 && x > count / 2 ? -1 : 1, 0});
    }
    return points;
}

TEST_CASE("rows of a picture are answered the same as its points in any order",
          "[shadow][exact]") {
    // Long rows are told at sight what others need rays for.
    const Points points = rows(72);
    for (const LightShape shape : {LightShape::disk, LightShape::sun}) {
        for (const bool nearField : {false, true}) {
            const ShadowMap map = mapOf(shape, nearField);
            for (const int samples : {1, 16, 40}) {
                for (const int perPixel : {1, 16}) {
                    INFO(name(shape) << " near " << nearField << " samples " << samples
                                     << " points a pixel " << perPixel);
                    ShadowOptions options = samplesOf(samples);
                    options.pointsPerPixel = perPixel;
                    std::vector<std::uint32_t> numbers(points.size());
                    std::iota(numbers.begin(), numbers.end(), 0u);
                    const auto ask = [&](const Points& at, QueryStats& stats) {
                        options.pixelPoints = numbers.data();
                        std::vector<float> out(at.size(), -1.0f);
                        shadowFactors(map, lightOf(shape), at.at.data(), at.normal.data(),
                                      at.size(), out.data(), options, &stats);
                        return out;
                    };
                    QueryStats inRows, inAny;
                    const std::vector<float> expected = ask(points, inRows);
                    CHECK(meanOf(expected) > 0.05);
                    CHECK(meanOf(expected) < 0.6);
                    // Every ray counts, whoever told of it: points turned away have none.
                    std::size_t turned = 0;
                    for (const glm::dvec3& n : points.normal)
                        turned += n.y < 0.0;
                    const std::size_t each = std::size_t(options.samples);
                    CHECK(inRows.rays == (points.size() - turned) * each);
                    // The size has no factor in common with the step.
                    std::vector<std::size_t> order(points.size());
                    for (std::size_t i = 0; i < order.size(); ++i)
                        numbers[i] = std::uint32_t(order[i] = i * 2741 % order.size());
                    const std::vector<float> found = ask(points.ordered(order), inAny);
                    int wrong = 0;
                    for (std::size_t i = 0; i < order.size(); ++i)
                        wrong += found[i] != expected[order[i]];
                    CHECK(wrong == 0);
                    CHECK(inRows.points == points.size());
                    CHECK(inAny.points == points.size());
                    CHECK(inRows.rays == inAny.rays);
                }
            }
        }
    }
}

TEST_CASE("a point far away changes nothing for its neighbours in a batch",
          "[shadow][exact][extreme]") {
    // So wide a view that a point 1e5 times as deep goes by bundles as well.
    constexpr int kSide = 64, kColumn = 19;
    constexpr double kTangent = 16.0;
    MapInfo info = test::plainInfo(kSide, kSide, 8);
    info.light.shape = LightShape::disk;
    info.light.radius = 0.01;
    info.light.direction = {0, 0, -1};
    info.bias = 0.05f;
    Projection p = test::plainProjection(kSide, kSide);
    p.scale = {kSide / 2.0 / kTangent, -kSide / 2.0 / kTangent};
    const ShadowMap map =
        test::opaqueOf(test::mapOf(info, p, [](std::uint32_t x, std::uint32_t y) {
            return std::abs(int(x) - kColumn) < 3 && std::abs(int(y) - kSide / 2) < 4
                       ? std::vector<test::TestLayer>{{2.0f, 0.0f, 1}}
                       : std::vector<test::TestLayer>{};
        }));
    const double across = (kColumn + 0.5 - kSide / 2.0) / p.scale.x * 4;
    std::vector<glm::dvec3> points;
    for (int i = 0; i < 2000; ++i)
        points.push_back(i % 100 == 7 ? glm::dvec3(0, 0, -6.5e5)
                                      : glm::dvec3(across + 0.0001 * i, 0.1, -4));
    std::vector<float> found(points.size());
    shadowFactors(map, info.light, points.data(), nullptr, points.size(), found.data(),
                  samplesOf(16));
    int wrong = 0;
    for (std::size_t i = 0; i < points.size(); ++i)
        wrong += found[i] != (i % 100 == 7 ? 0.0f : 1.0f);
    CHECK(wrong == 0);
}

TEST_CASE("a batch is answered the same for any number of threads",
          "[shadow][exact][threads]") {
    Random random(6);
    for (const LightShape shape : kShapes) {
        for (const bool nearField : {false, true}) {
            const ShadowMap map = mapOf(shape, nearField);
            const Points many = mixed(random, 3000);
            std::vector<float> first;
            for (const int threads : {1, 8}) {
                const tbb::global_control limit(
                    tbb::global_control::max_allowed_parallelism, std::size_t(threads));
                tbb::task_arena arena(threads);
                const std::vector<float> found = arena.execute(
                    [&] { return answers(map, shape, many, samplesOf(32)); });
                if (first.empty()) first = found;
                CHECK(same(found, first));
            }
        }
    }
}

TEST_CASE("rays that lead along the map are followed, however many there are",
          "[shadow][exact]") {
    // A ramp behind the plane of a light that shines along it: receivers in that plane,
    // whose rays hardly rise.
    MapInfo info = test::plainInfo(256, 256, 32);
    AreaLight& light = info.light;
    light.shape = LightShape::rect;
    light.position = {0, 0, -2};
    light.direction = {0, 0, -1};
    light.up = {0, 1, 0};
    light.size = {1, 1};
    info.bias = 0.01f;
    const auto layers = [](std::uint32_t x, std::uint32_t) {
        const double across = (x + 0.5 - 128) / 128;
        const double z = 1 / (1 / 1.8 + (1 / 2.4 - 1 / 1.8) * (across + 0.5));
        std::vector<test::TestLayer> ramp;
        if (std::abs(across) < 0.5 && z >= 2.0) ramp.push_back({float(z), 0.0f, 1});
        return ramp;
    };
    const ShadowMap map =
        test::opaqueOf(test::mapOf(info, test::plainProjection(256, 256), layers));
    for (const double beyond : {1e-6, 1e-7, 1e-9}) {
        Points points;
        for (int i = 0; i < 16; ++i)
            points.add({-0.9 - 0.0001 * i, 0.01 * i, -2.0 - beyond}, glm::dvec3(0.0));
        ShadowOptions exact = samplesOf(1024);
        exact.method = ShadowMethod::scalar;
        const double expected = meanOf(answers(map, light, points, exact, false));
        for (const int samples : {16, 17, 48, 64, 256, 272}) {
            const std::vector<float> batch =
                answers(map, light, points, samplesOf(samples), false);
            std::vector<float> alone;
            for (const glm::dvec3 p : points.at)
                alone.push_back(
                    shadowFactor(map, light, p, glm::dvec3(0.0), samplesOf(samples)));
            INFO(samples << " samples, " << beyond << ", expected " << expected);
            CHECK(different(alone, batch) == 0);
            CHECK(std::abs(meanOf(batch) - expected) < 0.06);
        }
    }
}

TEST_CASE("batches agree with the scalar trace in the mean", "[shadow][statistical]") {
    // Measured over all shapes: on the floor 0.001 (each point 0.002), on the body 0.010
    // (0.027). Without normals the scalar trace, which thickens layers by their bias, has
    // 0.018 more shadow on the body (each point 0.018); but where there is a near field
    // rays start ten times closer, and see of the body what those with normals see.
    struct Bound {
        double mean, each;
    };
    Random random(2);
    const Points floor = onFloor(random, 1500), onIt = onBody(random, 1500);
    for (const LightShape shape : kShapes) {
        for (const bool nearField : {false, true}) {
            const ShadowMap map = mapOf(shape, nearField);
            const auto compare = [&](const Points& points, bool normals, Bound bound) {
                ShadowOptions options = samplesOf(64);
                const std::vector<float> found =
                    answers(map, shape, points, options, normals);
                options.method = ShadowMethod::scalar;
                const std::vector<float> expected =
                    answers(map, shape, points, options, normals || nearField);
                double away = 0.0;
                for (std::size_t i = 0; i < found.size(); ++i)
                    away += std::abs(found[i] - expected[i]) / double(found.size());
                INFO(name(shape) << " near " << nearField << " normals " << normals
                                 << " found " << meanOf(found) << " expected "
                                 << meanOf(expected) << " each " << away);
                CHECK(std::abs(meanOf(found) - meanOf(expected)) < bound.mean);
                CHECK(away < bound.each);
                CHECK(meanOf(expected) > 0.1);
                CHECK(meanOf(expected) < 0.9);
            };
            compare(floor, true, {0.002, 0.004});
            compare(floor, false, {0.002, 0.004});
            compare(onIt, true, {0.015, 0.04});
            compare(onIt, false, nearField ? Bound{0.015, 0.05} : Bound{0.03, 0.04});
        }
    }
}

TEST_CASE(
    "a pixel's mean is as good as the scalar trace's where its points have a ray each",
    "[shadow][statistical]") {
    // A large light, so that the ray of a point is alone in texels as wide as the light.
    const AreaLight light = largeLightOf(LightShape::disk);
    const ShadowMap map = mapOf(light, false);
    constexpr int kPerPixel = 16;
    Random random(5);
    Points points;
    for (int pixel = 0; pixel < 3000; ++pixel) {
        const glm::dvec3 corner{random.in(-2, 2), kFloor, random.in(-2, 2)};
        for (int i = 0; i < kPerPixel; ++i)
            points.add(corner + glm::dvec3(0.005 * (i % 4), 0, 0.005 * (i / 4)),
                       {0, 1, 0});
    }
    const auto pixels = [&](ShadowMethod method, int samples) {
        ShadowOptions options = samplesOf(samples);
        options.method = method;
        options.pointsPerPixel = kPerPixel;
        const std::vector<float> each = answers(map, light, points, options);
        std::vector<double> means(each.size() / kPerPixel, 0.0);
        for (std::size_t i = 0; i < each.size(); ++i)
            means[i / kPerPixel] += each[i] / double(kPerPixel);
        return means;
    };
    const std::vector<double> truth = pixels(ShadowMethod::scalar, 64);
    const auto error = [&](ShadowMethod method, int samples) {
        const std::vector<double> means = pixels(method, samples);
        double sum = 0.0;
        for (std::size_t i = 0; i < means.size(); ++i)
            sum += std::abs(means[i] - truth[i]) / double(means.size());
        return sum;
    };
    // 1.08; with texels for a ray of its own 1.22.
    const double found = error(ShadowMethod::trace, 1);
    const double expected = error(ShadowMethod::scalar, 1);
    INFO(found << ", by definition " << expected);
    CHECK(expected > 0.01);
    CHECK(found < 1.15 * expected);
}

TEST_CASE("a sun without a size is answered as by the scalar trace",
          "[shadow][statistical]") {
    const ShadowMap map = mapOf(LightShape::sun, false);
    AreaLight sun = lightOf(LightShape::sun);
    sun.angularDiameter = 0.0;  // all rays go straight through the map
    Random random(5);
    const Points points = onBody(random, 1500);
    for (const bool normals : {true, false}) {
        ShadowOptions options = samplesOf(1);
        const std::vector<float> found = answers(map, sun, points, options, normals);
        options.method = ShadowMethod::scalar;
        const std::vector<float> expected = answers(map, sun, points, options, normals);
        INFO("found " << meanOf(found) << " expected " << meanOf(expected));
        CHECK(std::abs(meanOf(found) - meanOf(expected)) < 0.03);
        CHECK(different(found, expected) < 60);
    }
}

TEST_CASE(
    "a few rays to a large light are the same alone, in a batch and in a part of it",
    "[shadow][exact]") {
    const AreaLight light = largeLightOf(LightShape::sphere);
    const ShadowMap map = mapOf(light, false);
    Random random(6);
    const Points points = onBody(random, 1000);
    for (const int samples : {1, 2, 3, 4, 5}) {
        INFO("samples " << samples);
        const ShadowOptions options = samplesOf(samples);
        const std::vector<float> batch = answers(map, light, points, options);
        std::vector<float> alone;
        for (std::size_t i = 0; i < points.size(); ++i)
            alone.push_back(
                shadowFactor(map, light, points.at[i], points.normal[i], options));
        CHECK(different(alone, batch) == 0);
        Points fewer = points;
        fewer.at.resize(17), fewer.normal.resize(17);
        const std::vector<float> few = answers(map, light, fewer, options);
        CHECK(same(few, {batch.begin(), batch.begin() + 17}));
    }
}

TEST_CASE("a point far outside the view is answered as by the scalar trace",
          "[shadow][exact]") {
    for (const LightShape shape : kShapes) {
        for (const bool nearField : {false, true}) {
            const ShadowMap map = mapOf(shape, nearField);
            Random random(3);
            Points far;
            for (int i = 0; i < 40; ++i) {
                const double angle = random.in(0, 6.28), r = random.in(150, 1e6);
                far.add({r * std::cos(angle), kFloor, r * std::sin(angle)}, {0, 1, 0});
            }
            for (const bool normals : {true, false}) {
                ShadowOptions options = samplesOf(32);
                const std::vector<float> found =
                    answers(map, shape, far, options, normals);
                options.method = ShadowMethod::scalar;
                CHECK(same(found, answers(map, shape, far, options, normals)));
            }
        }
    }
}

TEST_CASE("a near field does not darken what a far light shines on", "[shadow][data]") {
    // Floats tell heights above a receiver apart to 1/50 of a pixel there, and these
    // triangles are smaller than a pixel: were they to count from as low as where the
    // light is close, every fifth of these points would be dark.
    const char* folder = std::getenv("MTSM_TEST_DATA");
    if (!folder) return;
    BakeOptions options;
    options.light = lightOf(LightShape::disk);
    options.light.position = {50, 300, 100};
    options.light.radius = 10;
    options.nearField = kAutomaticNearField;
    MeshFiles casters({std::string(folder) + "/meshes/dragon_348k.ply"});
    Points points;
    Random random(4);
    const Status read = casters.visit(meshesOnly([&](const MeshView& mesh) -> Status {
        for (int i = 0; i < 2000; ++i) {
            const std::size_t t = 3 * random.below(mesh.triangleCount);
            const auto corner = [&](std::size_t k) {
                return glm::dvec3(mesh.positions[mesh.indices[t + k]]);
            };
            const glm::dvec3 a = corner(0), b = corner(1), c = corner(2);
            points.add((a + b + c) / 3.0, glm::cross(b - a, c - a));
        }
        return {};
    }));
    REQUIRE(read);
    const auto baked = bake(casters, options);
    REQUIRE(baked);
    REQUIRE_FALSE(baked->map.nearField(0).empty());
    std::vector<float> found(points.size()), expected(points.size());
    ShadowOptions query = samplesOf(16);
    const auto ask = [&](std::vector<float>& out) {
        shadowFactors(baked->map, options.light, points.at.data(), points.normal.data(),
                      points.size(), out.data(), query);
    };
    ask(found);
    query.method = ShadowMethod::scalar;
    ask(expected);
    CHECK(meanOf(found) == Approx(meanOf(expected)).margin(0.02));
}

TEST_CASE("a light as wide as its distance from a ceiling is answered in six faces",
          "[shadow][statistical]") {
    // A room, the eye close below its ceiling, with a block on the floor.
    const glm::dvec3 low(-3, -2.35, -3), high(3, 0.25, 3);
    const glm::dvec3 blockLow(0.5, -2.35, 0.5), blockHigh(1.2, -1.35, 1.2);
    MapInfo info = test::plainInfo(96, 96, 32);
    info.light.shape = LightShape::disk;
    info.light.radius = 0.25;
    info.light.direction = {0, -1, 0};
    const auto views = test::cubeProjections(96);
    info.biasPerDepth = float(0.5 * views[0].pixelFootprint(1.0));
    const ShadowMap map = test::opaqueOf(test::mapOf(
        info, views, [&](std::uint32_t face, std::uint32_t x, std::uint32_t y) {
            const glm::dvec3 d = views[face].worldFromLight(
                views[face].lightFromRaster({x + 0.5, y + 0.5}, 1.0));
            // Where the ray leaves the room, and where it enters the block.
            double out = HUGE_VAL, in = 0.0, blockOut = HUGE_VAL;
            for (int a = 0; a < 3; ++a) {
                if (d[a] == 0.0) continue;
                out = std::min(out, std::max(low[a] / d[a], high[a] / d[a]));
                in = std::max(in, std::min(blockLow[a] / d[a], blockHigh[a] / d[a]));
                blockOut =
                    std::min(blockOut, std::max(blockLow[a] / d[a], blockHigh[a] / d[a]));
            }
            const double t = in > 0.0 && in < blockOut ? in : out;
            return std::vector<test::TestLayer>{{float(t), 0.0f, 1}};
        }));
    ShadowMap bare = map;
    REQUIRE(releaseLayers(bare));
    Random random(8);
    std::vector<glm::dvec3> points, normals;
    for (int i = 0; i < 300; ++i) {
        points.emplace_back(random.in(-2.8, 2.8), -2.349, random.in(-2.8, 2.8));
        normals.emplace_back(0, 1, 0);
    }
    const std::size_t floor = points.size();
    for (int i = 0; i < 50; ++i) {  // within the block, below its top
        points.emplace_back(random.in(0.7, 1.0), -1.35 - random.in(0.04, 0.1),
                            random.in(0.7, 1.0));
        normals.emplace_back(0, 1, 0);
    }
    ShadowOptions options;
    options.samples = 64;
    const auto ask = [&](const ShadowMap& asked, ShadowMethod method) {
        std::vector<float> out(points.size());
        options.method = method;
        shadowFactors(asked, info.light, points.data(), normals.data(), points.size(),
                      out.data(), options);
        return out;
    };
    const std::vector<float> expected = ask(map, ShadowMethod::scalar);
    CHECK(same(ask(map, ShadowMethod::trace), ask(bare, ShadowMethod::trace)));
    for (const ShadowMap* const asked : {&map, static_cast<const ShadowMap*>(&bare)}) {
        const std::vector<float> found = ask(*asked, ShadowMethod::trace);
        double away = 0.0, dark = 0.0;
        for (std::size_t i = 0; i < floor; ++i) {
            away += std::abs(found[i] - expected[i]) / double(floor);
            dark += expected[i] / double(floor);
        }
        CHECK(dark > 0.05);
        CHECK(dark < 0.6);
        CHECK(away < 0.01);
        for (std::size_t i = floor; i < points.size(); ++i)
            CHECK(found[i] > 0.95f);
    }
}
