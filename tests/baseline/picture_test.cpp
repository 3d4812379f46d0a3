// What a camera sees, against rays that are met with planes and boxes here.
#include "baseline/picture.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <numeric>
#include <optional>
#include <set>

#include "baseline/reference_embree.h"
#include "bumpy_mesh.h"

using namespace mtsm;
using namespace mtsm::baseline;
using test::Mesh;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Twelve triangles, every second one of them the wrong way round.
Mesh box(glm::vec3 low, glm::vec3 high) {
    Mesh mesh;
    for (unsigned corner = 0; corner < 8; ++corner)
        mesh.positions.push_back({corner & 1 ? high.x : low.x,
                                  corner & 2 ? high.y : low.y,
                                  corner & 4 ? high.z : low.z});
    const std::uint32_t faces[6][4] = {{0, 2, 6, 4}, {1, 5, 7, 3}, {0, 4, 5, 1},
                                       {2, 3, 7, 6}, {0, 1, 3, 2}, {4, 6, 7, 5}};
    for (const auto& f : faces)
        mesh.indices.insert(mesh.indices.end(), {f[0], f[1], f[2], f[0], f[3], f[2]});
    return mesh;
}

/// A square of side 2 * `half` in the plane y = height.
Mesh floorAt(float height, float half) {
    Mesh mesh;
    mesh.positions = {{-half, height, -half},
                      {half, height, -half},
                      {half, height, half},
                      {-half, height, half}};
    mesh.indices = {0, 1, 2, 0, 2, 3};
    return mesh;
}

EmbreeReference referenceOf(const CasterView& caster) {
    CasterViews casters({caster});
    auto built = EmbreeReference::build(casters);
    REQUIRE(built);
    return std::move(*built);
}

/// The camera's axes and its rays, from their definition.
struct Eye {
    glm::dvec3 position, forward, right, up;
    double perPixel, halfWidth, halfHeight;

    explicit Eye(const Camera& c)
        : position(c.position),
          forward(glm::normalize(c.target - c.position)),
          right(glm::normalize(glm::cross(forward, c.up))),
          up(glm::cross(right, forward)),
          perPixel(std::tan(c.fov / 2) / (0.5 * std::max(c.width, c.height))),
          halfWidth(0.5 * c.width),
          halfHeight(0.5 * c.height) {}
    [[nodiscard]] glm::dvec3 ray(double x, double y) const {
        return glm::normalize(
            forward + perPixel * ((x - halfWidth) * right + (halfHeight - y) * up));
    }
    /// Pixels, y down.
    [[nodiscard]] glm::dvec2 project(glm::dvec3 p) const {
        const glm::dvec3 d = p - position;
        const double z = glm::dot(d, forward);
        return {halfWidth + glm::dot(d, right) / z / perPixel,
                halfHeight - glm::dot(d, up) / z / perPixel};
    }
};

/// Where a ray enters a box, through which face, and how long it stays in it.
struct Entry {
    double t, inside;
    glm::dvec3 normal;
};

std::optional<Entry> enter(glm::dvec3 origin, glm::dvec3 ray, glm::dvec3 low,
                           glm::dvec3 high) {
    double near = -HUGE_VAL, far = HUGE_VAL;
    glm::dvec3 normal(0.0);
    for (int a = 0; a < 3; ++a) {
        const double t0 = (low[a] - origin[a]) / ray[a],
                     t1 = (high[a] - origin[a]) / ray[a];
        if (std::min(t0, t1) > near) {
            near = std::min(t0, t1);
            normal = glm::dvec3(0.0);
            normal[a] = ray[a] > 0 ? -1 : 1;
        }
        far = std::min(far, std::max(t0, t1));
    }
    if (!(near < far) || near < 0) return std::nullopt;
    return Entry{near, far - near, normal};
}

Camera someCamera() {
    Camera camera;
    camera.position = {2, 3, 5};
    camera.target = {0.1, 0.4, 0};
    camera.fov = 0.6;
    camera.width = 64;
    camera.height = 40;
    return camera;
}

bool same(const Picture& a, const Picture& b) {
    return a.points == b.points && a.normals == b.normals && a.starts == b.starts &&
           a.first == b.first && a.pixel == b.pixel && a.object == b.object;
}

/// A picture of so many pixels side by side, a point each.
Picture row(std::size_t pixels) {
    Picture p;
    p.width = std::uint32_t(pixels);
    p.height = 1;
    for (std::size_t i = 0; i < pixels; ++i) {
        p.points.push_back(glm::dvec3(double(i), 0, 0));
        p.normals.push_back({0, 1, 0});
        p.starts.push_back(glm::dvec3(double(i), 1, 0));
        p.first.push_back(i + 1);
        p.pixel.push_back(std::uint32_t(i));
        p.object.push_back(i % 2);
    }
    return p;
}

}  // namespace

TEST_CASE("a camera sees the points of a box and a floor where they are",
          "[baseline][exact]") {
    const glm::dvec3 low(-0.5, 0, -0.5), high(0.5, 1, 0.5);
    const Mesh solid = box(low, high), ground = floorAt(0, 3);
    const auto casters = referenceOf(solid.view()),
               receivers = referenceOf(ground.view());
    const Camera camera = someCamera();
    const Eye eye(camera);
    const Picture picture = takePicture(camera, casters, &receivers);
    std::vector<int> seen(std::size_t(camera.width) * camera.height, -1);
    for (std::size_t p = 0; p < picture.pixels(); ++p) {
        REQUIRE(picture.first[p + 1] == picture.first[p] + 1);
        seen[picture.pixel[p]] = int(p);
    }
    std::size_t edges = 0, onBox = 0, onFloor = 0, nothing = 0;
    for (std::uint32_t pixel = 0; pixel < seen.size(); ++pixel) {
        const glm::dvec3 ray =
            eye.ray(pixel % camera.width + 0.5, pixel / camera.width + 0.5);
        const auto entry = enter(camera.position, ray, low, high);
        const double t = ray.y < 0 ? -camera.position.y / ray.y : HUGE_VAL;
        const glm::dvec3 below = camera.position + t * ray;
        const double out = std::max(std::abs(below.x), std::abs(below.z)) - 3;
        // Where rounding decides what is met nothing is asked.
        if ((entry && entry->inside < 1e-3) || (!entry && std::abs(out) < 1e-3)) {
            ++edges;
            continue;
        }
        INFO("pixel " << pixel % camera.width << ", " << pixel / camera.width);
        if (!entry && !(out < 0)) {
            ++nothing;
            CHECK(seen[pixel] == -1);
            continue;
        }
        ++(entry ? onBox : onFloor);
        REQUIRE(seen[pixel] >= 0);
        const auto p = std::size_t(seen[pixel]);
        const double away = entry ? entry->t : t;
        const glm::dvec3 expected = camera.position + away * ray;
        CHECK(glm::distance(picture.points[p], expected) < 1e-5 * away);
        CHECK(picture.starts[p] == picture.points[p]);
        CHECK(picture.object[p] == (entry ? 1 : 0));
        const glm::dvec3 normal = entry ? entry->normal : glm::dvec3(0, 1, 0);
        if (!entry || entry->inside > 0.05)
            CHECK(glm::distance(picture.normals[p], normal) < 1e-5);
        CHECK(glm::dot(picture.normals[p], ray) < 0.0);
    }
    CHECK(edges < 20);
    CHECK(onBox > 100);
    CHECK(onFloor > 100);
    CHECK(nothing > 100);
}

TEST_CASE("a framed box fills nine tenths of the picture and is in its middle",
          "[baseline][exact]") {
    const std::pair<glm::dvec3, glm::dvec3> boxes[] = {{{-1, -1, -1}, {1, 1, 1}},
                                                       {{100, 5, -3}, {101, 45, 0}},
                                                       {{-50, 0, -1}, {50, 0, 1}},
                                                       {{0, 0, 0}, {1e-3, 2e-3, 9e-3}}};
    for (const auto& [low, high] : boxes) {
        for (const glm::uvec2 size :
             {glm::uvec2(600, 300), {300, 600}, {64, 64}, {1, 50}}) {
            const Camera camera = Camera::framing(low, high, size.x, size.y);
            REQUIRE(checkCamera(camera));
            const Eye eye(camera);
            glm::dvec2 least(HUGE_VAL), most(-HUGE_VAL);
            for (int corner = 0; corner < 8; ++corner) {
                const glm::dvec3 p(corner & 1 ? high.x : low.x,
                                   corner & 2 ? high.y : low.y,
                                   corner & 4 ? high.z : low.z);
                CHECK(glm::dot(p - camera.position, eye.forward) > 0.0);
                least = glm::min(least, eye.project(p));
                most = glm::max(most, eye.project(p));
            }
            const glm::dvec2 fills = (most - least) / glm::dvec2(size);
            INFO("picture " << size.x << " x " << size.y << " fills " << fills.x << ", "
                            << fills.y);
            CHECK(std::max(fills.x, fills.y) == Approx(0.9).epsilon(1e-3));
            const glm::dvec2 off = 0.5 * (least + most) / glm::dvec2(size) - 0.5;
            CHECK(std::max(std::abs(off.x), std::abs(off.y)) < 1e-3);
        }
    }
}

TEST_CASE("the points of a pixel lie inside of it, one in each of its cells",
          "[baseline][exact]") {
    const Mesh ground = floorAt(0, 1000);
    const auto casters = referenceOf(ground.view());
    Camera camera = someCamera();
    camera.width = 12;
    camera.height = 9;
    camera.pointsPerSide = 4;
    const Eye eye(camera);
    const Picture picture = takePicture(camera, casters, nullptr);
    REQUIRE(picture.pixels() == 12 * 9);
    std::set<double> offsets;
    for (std::size_t p = 0; p < picture.pixels(); ++p) {
        REQUIRE(picture.first[p + 1] - picture.first[p] == 16);
        const glm::dvec2 corner(picture.pixel[p] % 12, picture.pixel[p] / 12);
        std::set<int> cells;
        for (std::size_t i = picture.first[p]; i < picture.first[p + 1]; ++i) {
            const glm::dvec2 at = 4.0 * (eye.project(picture.points[i]) - corner);
            CHECK(std::min(at.x, at.y) > -1e-3);
            CHECK(std::max(at.x, at.y) < 4 + 1e-3);
            cells.insert(int(at.y) * 4 + int(at.x));
            offsets.insert(at.x - std::floor(at.x));
        }
        CHECK(cells.size() >= 15);  // one may lie on a border, by rounding
    }
    CHECK(offsets.size() > 1500);  // jittered, and differently in each pixel
}

TEST_CASE("one point a pixel is the middle of it", "[baseline][exact]") {
    const Mesh ground = floorAt(0, 1000);
    const auto casters = referenceOf(ground.view());
    const Camera camera = someCamera();
    const Eye eye(camera);
    const Picture picture = takePicture(camera, casters, nullptr);
    for (std::size_t p = 0; p < picture.pixels(); ++p) {
        const glm::dvec2 at = eye.project(picture.points[p]);
        CHECK(at.x == Approx(picture.pixel[p] % camera.width + 0.5).margin(1e-3));
        CHECK(at.y == Approx(picture.pixel[p] / camera.width + 0.5).margin(1e-3));
    }
}

TEST_CASE("pixels that follow each other are neighbours, and each comes once",
          "[baseline]") {
    const std::uint32_t width = 48, height = 33;
    const std::vector<glm::vec3> positions(width * height, glm::vec3(0.0f));
    const Picture picture = pictureOfPass(
        width, height, positions, std::vector<std::uint8_t>(width * height, 1), {});
    REQUIRE(picture.pixels() == width * height);
    CHECK(std::set<std::uint32_t>(picture.pixel.begin(), picture.pixel.end()).size() ==
          width * height);
    // Whole squares of 16 x 16 inside of the picture come as runs of 256.
    for (std::size_t begin = 0; begin < 512; begin += 256) {
        std::uint32_t left = width, right = 0, top = height, bottom = 0;
        for (std::size_t p = begin; p < begin + 256; ++p) {
            left = std::min(left, picture.pixel[p] % width);
            right = std::max(right, picture.pixel[p] % width);
            top = std::min(top, picture.pixel[p] / width);
            bottom = std::max(bottom, picture.pixel[p] / width);
        }
        CHECK(right - left == 15);
        CHECK(bottom - top == 15);
    }
}

TEST_CASE("a spread of pixels is runs from all over the picture", "[baseline]") {
    for (const std::size_t pixels : {64u, 65u, 1000u, 4096u, 100'000u}) {
        const Picture picture = row(pixels);
        for (const std::size_t count : {64u, 100u, 640u, 4096u}) {
            const auto chosen = picture.spread(count, 64);
            INFO(count << " of " << pixels);
            if (count >= pixels) {
                CHECK(chosen.size() == pixels);
                CHECK(chosen.front() == 0);
                CHECK(chosen.back() == pixels - 1);
                continue;
            }
            // Whole runs, no more than there are.
            const std::size_t runs = std::min(count / 64, pixels / 64);
            REQUIRE(chosen.size() == 64 * runs);
            for (std::size_t i = 0; i < chosen.size(); ++i) {
                CHECK(chosen[i] < pixels);
                if (i > 0) CHECK(chosen[i] > chosen[i - 1]);
                if (i % 64 > 0) CHECK(chosen[i] == chosen[i - 1] + 1);
            }
            // One in each of as many stretches: gaps stay below two of them.
            const double stretch = double(pixels) / double(runs);
            for (std::size_t i = 64; i < chosen.size(); i += 64)
                CHECK(double(chosen[i] - chosen[i - 64]) < 2 * stretch + 64);
        }
    }
    CHECK(row(10).spread(5, 64).size() == 10);
    CHECK(Picture().spread(64, 64).empty());
}

TEST_CASE("means over pixels, images and parts keep what belongs together",
          "[baseline][roundtrip]") {
    Picture picture = row(3);
    picture.width = 2;
    picture.height = 3;
    picture.first = {0, 2, 3, 6};
    picture.pixel = {5, 0, 2};
    for (int i = 0; i < 3; ++i) {
        picture.points.emplace_back(i);
        picture.normals.emplace_back(0);
        picture.starts.emplace_back(i);
    }
    const float nan = std::nanf("");
    const auto means = picture.pixelMeans({0, 1, 0.25f, 1, 0.5f, 0});
    CHECK(means == std::vector<float>{0.5f, 0.25f, 0.5f});
    const auto broken = picture.pixelMeans({0, nan, 0.25f, 1, 1, 1});
    CHECK(std::isnan(broken[0]));
    CHECK(broken[1] == 0.25f);
    CHECK(broken[2] == 1.0f);
    CHECK(picture.image(means, -1) == std::vector<float>{0.25f, -1, 0.5f, -1, -1, 0.5f});

    const Picture part = picture.part({2, 0});
    CHECK(part.first == std::vector<std::size_t>{0, 3, 5});
    CHECK(part.pixel == std::vector<std::uint32_t>{2, 5});
    CHECK(part.object == std::vector<std::uint8_t>{0, 0});
    REQUIRE(part.points.size() == 5);
    CHECK(part.points[0] == picture.points[3]);
    CHECK(part.starts[4] == picture.starts[1]);
    const Receivers r = part.receivers();
    CHECK(r.count == 5);
    CHECK(r.pixels == 2);
    CHECK(r.points == part.points.data());
    CHECK(r.normals == part.normals.data());
    CHECK(r.starts == part.starts.data());
    CHECK(picture.part({}).pixels() == 0);
}

TEST_CASE("cosines to the light are those of the way to its centre",
          "[baseline][exact]") {
    Picture picture = row(4);
    picture.normals = {{0, 1, 0}, {0, -1, 0}, {0, 0, 0}, {1, 0, 0}};
    AreaLight light;
    light.shape = LightShape::disk;
    light.position = {0, 2, 0};
    light.radius = 0.5;
    auto found = picture.cosines(light);
    CHECK(found[0] == 1.0f);
    CHECK(found[1] == 0.0f);
    CHECK(found[2] == 1.0f);  // no normal
    CHECK(found[3] == 0.0f);  // (3, 0, 0): the light is behind
    picture.normals.assign(4, {0, 1, 0});
    found = picture.cosines(light);
    for (int i = 0; i < 4; ++i)
        CHECK(found[std::size_t(i)] == Approx(2 / std::sqrt(4.0 + i * i)));
    light.shape = LightShape::sun;
    light.direction = glm::normalize(glm::dvec3(1, -1, 0));
    for (const float c : picture.cosines(light))
        CHECK(c == Approx(std::sqrt(0.5)));
    // Of several points of a pixel the mean.
    picture.first = {0, 4};
    picture.pixel = {0};
    picture.object = {1};
    picture.normals = {{0, 1, 0}, {0, 0, 0}, {-1, 0, 0}, {1, 0, 0}};
    const double slant = std::sqrt(0.5);
    CHECK(picture.cosines(light)[0] == Approx((slant + 1 + slant + 0) / 4));
}

TEST_CASE("on a strand there is no normal, and rays start off it towards the camera",
          "[baseline]") {
    const std::vector<glm::vec3> points = {{0, -1, 0}, {0, 1, 0}};
    const std::vector<std::uint32_t> begin = {0, 2};
    StrandsView strands;
    strands.points = points.data();
    strands.begin = begin.data();
    strands.strandCount = 1;
    strands.width = 0.4f;
    const auto casters = referenceOf(strands);
    Camera camera;
    camera.position = {0, 0.5, 4};
    camera.target = {0, 0, 0};
    camera.fov = 0.3;
    camera.width = camera.height = 31;
    const Picture picture = takePicture(camera, casters, nullptr);
    // Of a picture 1.2 wide.
    CHECK(double(picture.pixels()) == Approx(31 * 31 * 0.4 / 1.2).epsilon(0.15));
    for (std::size_t p = 0; p < picture.pixels(); ++p) {
        CHECK(picture.normals[p] == glm::dvec3(0.0));
        CHECK(picture.object[p] == 1);
        const glm::dvec3 off = picture.starts[p] - picture.points[p];
        CHECK(glm::length(off) == Approx(0.1 * 0.4).epsilon(1e-6));
        CHECK(std::abs(off.y) < 1e-6);  // across it
        CHECK(off.z > 0);
    }
}

TEST_CASE("in a medium points lie where light scatters: by the exponential law",
          "[baseline][statistical]") {
    // One block of density 1 over [0, 8] x [0, 8] x [0, 1], a floor behind it at z = -1,
    // seen almost in parallel. Of all rays exp(-k L) pass; the others scatter at a mean
    // depth of 1 / k - L / (exp(k L) - 1).
    const glm::ivec3 block(0);
    const std::vector<float> density(VolumeView::kBlockVoxels, 1.0f);
    VolumeView volume;
    volume.blocks = &block;
    volume.blockCount = 1;
    volume.density = density.data();
    const double k = 1.7, L = 1.0;
    volume.extinction = float(k);
    volume.worldFromIndex = glm::translate(
        glm::scale(glm::dmat4(1.0), glm::dvec3(1, 1, L / 8)), glm::dvec3(0.5));
    const auto casters = referenceOf(volume);
    Mesh wall;
    wall.positions = {{-9, -9, -1}, {20, -9, -1}, {20, 20, -1}, {-9, 20, -1}};
    wall.indices = {0, 1, 2, 0, 2, 3};
    const auto receivers = referenceOf(wall.view());
    Camera camera;
    camera.position = {4, 4, 200};
    camera.target = {4, 4, 0};
    camera.fov = 0.03;  // 6 wide
    camera.width = camera.height = 64;
    const Picture picture = takePicture(camera, casters, &receivers);
    const double n = 64.0 * 64.0;
    REQUIRE(double(picture.pixels()) == n);
    double passed = 0, sum = 0, squares = 0;
    for (std::size_t p = 0; p < picture.pixels(); ++p) {
        const double depth = L - picture.points[p].z;
        if (picture.object[p] == 0) {
            ++passed;
            CHECK(picture.points[p].z == Approx(-1).margin(1e-3));
            CHECK(picture.normals[p].z == Approx(1));
            continue;
        }
        CHECK(picture.normals[p] == glm::dvec3(0.0));
        CHECK(picture.starts[p] == picture.points[p]);
        CHECK(depth > -1e-6);
        CHECK(depth < L + 1e-6);
        sum += depth;
        squares += depth * depth;
    }
    const double share = std::exp(-k * L), scattered = n - passed;
    CHECK(passed / n == Approx(share).margin(4 * std::sqrt(share * (1 - share) / n)));
    const double mean = sum / scattered,
                 deviation = std::sqrt(squares / scattered - mean * mean);
    CHECK(mean == Approx(1 / k - L / (std::exp(k * L) - 1))
                      .margin(4 * deviation / std::sqrt(scattered)));
}

TEST_CASE("any number of threads takes the same picture", "[baseline]") {
    const Mesh body = test::bumpyBody(2000), ground = floorAt(-1.2f, 4);
    const auto casters = referenceOf(body.view()), receivers = referenceOf(ground.view());
    Camera camera = someCamera();
    camera.width = 160;  // more than one batch
    camera.height = 120;
    camera.pointsPerSide = 2;
    std::vector<Picture> pictures;
    for (const int threads : {1, 2, 7}) {
        tbb::task_arena arena(threads);
        double done = 0.0;
        pictures.push_back(arena.execute([&] {
            return takePicture(camera, casters, &receivers, [&](double share) {
                CHECK(share > done);
                done = share;
            });
        }));
        CHECK(done == 1.0);
        CHECK(same(pictures.front(), pictures.back()));
    }
    CHECK(pictures.front().pixels() > 1000);
}

TEST_CASE("what is in front counts, caster or receiver", "[baseline]") {
    const Mesh high = floorAt(1, 5), low = floorAt(0, 5);
    const auto above = referenceOf(high.view()), below = referenceOf(low.view());
    Camera camera = someCamera();
    camera.width = camera.height = 4;
    camera.fov = 0.1;
    const Picture hidden = takePicture(camera, above, &below),
                  shown = takePicture(camera, below, &above);
    CHECK(hidden.object == std::vector<std::uint8_t>(16, 1));
    CHECK(shown.object == std::vector<std::uint8_t>(16, 0));
    for (const glm::dvec3& p : shown.points)
        CHECK(p.y == Approx(1));
}

TEST_CASE("a camera that cannot see is refused, and says why", "[baseline][bad-input]") {
    const auto refusal = [](auto change) {
        Camera camera = someCamera();
        change(camera);
        const Status good = checkCamera(camera);
        REQUIRE_FALSE(good);
        CHECK(good.error().code == ErrorCode::badArgument);
        return good.error().message;
    };
    using Catch::Contains;
    CHECK(checkCamera(someCamera()));
    CHECK_THAT(refusal([](Camera& c) { c.width = 0; }), Contains("no pixels"));
    CHECK_THAT(refusal([](Camera& c) { c.height = 0; }), Contains("no pixels"));
    for (const double fov : {0.0, -1.0, 3.15, kNan, HUGE_VAL})
        CHECK_THAT(refusal([&](Camera& c) { c.fov = fov; }), Contains("field of view"));
    CHECK_THAT(refusal([](Camera& c) { c.target = c.position; }),
               Contains("where the camera is"));
    CHECK_THAT(refusal([](Camera& c) { c.up = c.target - c.position; }),
               Contains("along its up"));
    CHECK_THAT(refusal([](Camera& c) { c.up = glm::dvec3(0.0); }), Contains("up"));
    for (glm::dvec3 Camera::*part : {&Camera::position, &Camera::target, &Camera::up}) {
        CHECK_THAT(refusal([&](Camera& c) { (c.*part).y = kNan; }),
                   Contains("not finite"));
        CHECK_THAT(refusal([&](Camera& c) { (c.*part).z = HUGE_VAL; }),
                   Contains("not finite"));
    }
}

TEST_CASE("points of a position pass far from the origin are not behind their surface",
          "[baseline][extreme]") {
    for (const float away : {0.0f, 500.0f, 5000.0f}) {
        test::Mesh body = test::bumpyBody(4000);
        std::vector<glm::vec3> positions, normals;
        for (glm::vec3& p : body.positions)
            p += away;
        for (std::size_t t = 0; t + 2 < body.indices.size(); t += 3) {
            const glm::dvec3 a = body.positions[body.indices[t]],
                             b = body.positions[body.indices[t + 1]],
                             c = body.positions[body.indices[t + 2]];
            positions.push_back(glm::vec3((a + b + c) / 3.0));
            normals.push_back(glm::vec3(glm::normalize(glm::cross(b - a, c - a))));
        }
        const auto count = std::uint32_t(positions.size());
        const Picture picture = baseline::pictureOfPass(
            count, 1, positions, std::vector<std::uint8_t>(count, 1), normals);
        REQUIRE(picture.points.size() == count);
        CasterViews casters({body.view()});
        auto truth = EmbreeReference::build(casters);
        REQUIRE(truth);
        // A light a little above each point, which nothing else is in front of.
        int dark = 0;
        for (std::size_t i = 0; i < count; ++i) {
            AreaLight light;
            light.position = picture.points[i] + 0.01 * picture.normals[i];
            float found = -1.0f;
            truth->shadowFactors(light, &picture.points[i], &picture.normals[i], 1,
                                 &found);
            dark += found != 0.0f;
        }
        INFO(away);
        CHECK(dark == 0);
    }
}

TEST_CASE("a position pass gives its points, without those that are none",
          "[baseline][bad-input]") {
    const float nan = std::nanf("");
    const std::vector<glm::vec3> positions = {{1, 2, 3}, {nan, 0, 0},       {4, 5, 6},
                                              {0, 0, 0}, {7, 8, HUGE_VALF}, {9, 9, 9}};
    const std::vector<glm::vec3> normals = {{0, 3, 0}, {0, 1, 0}, {nan, 0, 0},
                                            {1, 0, 0}, {1, 0, 0}, {0, 0, 0}};
    const std::vector<std::uint8_t> surface = {1, 1, 1, 0, 1, 1};
    const Picture picture = pictureOfPass(3, 2, positions, surface, normals);
    REQUIRE(picture.pixels() == 3);
    std::set<std::uint32_t> pixels(picture.pixel.begin(), picture.pixel.end());
    CHECK(pixels == std::set<std::uint32_t>{0, 2, 5});
    for (std::size_t p = 0; p < 3; ++p) {
        CHECK(picture.first[p + 1] == p + 1);
        CHECK(picture.object[p] == 1);
        CHECK(glm::length(picture.points[p] - glm::dvec3(positions[picture.pixel[p]])) <
              1e-6);
        CHECK(picture.starts[p] == picture.points[p]);
        const glm::dvec3 normal =
            picture.pixel[p] == 0 ? glm::dvec3(0, 1, 0) : glm::dvec3(0);
        CHECK(picture.normals[p] == normal);
    }
    const Picture bare = pictureOfPass(3, 2, positions, surface, {});
    CHECK(bare.normals == std::vector<glm::dvec3>(3, glm::dvec3(0.0)));
    CHECK(pictureOfPass(3, 2, positions, std::vector<std::uint8_t>(6, 0), {}).pixels() ==
          0);
}
