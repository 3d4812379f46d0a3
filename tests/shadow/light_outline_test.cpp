// Glances: what they tell of horizons and of rays is what the light's own points say, in
// double.
#include "shadow/light_outline.h"

#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>
#include <vector>

#include "light/sample.h"
#include "random.h"

using namespace mtsm;
using shadow::Outlook;
using shadow::Receiver;
using test::Random;

namespace {

constexpr LightShape kShapes[] = {LightShape::point, LightShape::disk, LightShape::rect,
                                  LightShape::sphere, LightShape::sun};

AreaLight lightOf(LightShape shape, Random& random) {
    AreaLight light;
    light.shape = shape;
    light.position = {random.in(-3, 3), random.in(4, 8), random.in(-3, 3)};
    light.direction = glm::normalize(glm::dvec3(random.in(-1, 1), 0, random.in(-1, 1)) -
                                     light.position);
    light.up = random.direction();
    light.radius = random.in(0.01, 1);
    light.size = {random.in(0.01, 2), random.in(0.01, 2)};
    light.angularDiameter = random.in(0.01, 0.8);
    return light;
}

/// A view from about the light, turned a little away from its axis.
Projection viewFrom(const AreaLight& light, Random& random) {
    Projection p;
    p.kind = light.shape == LightShape::sun ? ProjectionKind::orthographic
                                            : ProjectionKind::perspective;
    p.eye = light.position;
    p.forward = glm::normalize(light.direction + 0.1 * random.direction());
    p.right = glm::normalize(glm::cross(p.forward, random.direction()));
    p.up = glm::cross(p.right, p.forward);
    p.scale = {random.in(300, 900), -random.in(300, 900)};
    p.offset = {random.in(200, 600), random.in(200, 600)};
    return p;
}

/// Neighbours below the light.
std::vector<Receiver> receiversNear(glm::dvec3 centre, double size, int count,
                                    Random& random) {
    std::vector<Receiver> receivers;
    for (int i = 0; i < count; ++i)
        receivers.push_back(
            {centre +
                 size * glm::dvec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1)),
             random.in(0.1, 10) * random.direction()});
    return receivers;
}

constexpr int kSamples = 400;

glm::dvec3 towards(const light::LightSampler& light, glm::dvec3 p, int i) {
    const int side = 20;
    return light.sample(p, {(i % side) / double(side - 1), (i / side) / double(side - 1)})
        .delta;
}

glm::dvec3 straight(const Projection& p, glm::dvec3 point) {
    const glm::dvec3 q = p.lightFromWorld(point);
    const glm::dvec2 raster = p.rasterFromLight(q);
    return {raster, p.kind == ProjectionKind::perspective ? 1.0 / q.z : -q.z};
}

}  // namespace

TEST_CASE("a glance at horizons never says more than the points of the light",
          "[shadow][exact]") {
    Random random(3);
    int above = 0, below = 0;
    for (int round = 0; round < 400; ++round) {
        const AreaLight light = lightOf(kShapes[round % 5], random);
        const light::LightSampler sampler(light);
        const shadow::LightOutline outline(viewFrom(light, random), sampler);
        const int count = 1 + round % 16;
        const std::vector<Receiver> receivers =
            receiversNear({random.in(-2, 2), 0, random.in(-2, 2)}, 1.0, count, random);
        const Outlook seen = outline.outlook(receivers.data(), count);
        CHECK((seen.above & seen.below) == 0);
        CHECK((seen.above | seen.below) >> count == 0);
        for (int i = 0; i < count; ++i) {
            const Receiver& receiver = receivers[std::size_t(i)];
            int upper = 0;
            for (int s = 0; s < kSamples; ++s)
                upper +=
                    glm::dot(towards(sampler, receiver.point, s), receiver.normal) > 0.0;
            if (seen.above >> i & 1) CHECK(upper == kSamples);
            if (seen.below >> i & 1) CHECK(upper == 0);
            above += seen.above >> i & 1, below += seen.below >> i & 1;
        }
    }
    // It says something of most.
    CHECK(above + below > 400 * 8 * 3 / 5);
    CHECK(above > 400);
    CHECK(below > 400);
}

TEST_CASE("the rays of receivers lie within their hull", "[shadow][exact]") {
    Random random(4);
    int known = 0;
    for (int round = 0; round < 300; ++round) {
        const AreaLight light = lightOf(kShapes[round % 5], random);
        const light::LightSampler sampler(light);
        const Projection p = viewFrom(light, random);
        const shadow::LightOutline outline(p, sampler);
        std::vector<Receiver> receivers = receiversNear(
            {random.in(-2, 2), 0, random.in(-2, 2)}, random.in(0.01, 1), 32, random);
        if (round % 2) {
            for (Receiver& r : receivers)
                r.normal = glm::dvec3(0.0);
        }
        const Outlook halves[2] = {outline.outlook(receivers.data(), 16),
                                   outline.outlook(receivers.data() + 16, 16)};
        Outlook all;
        all.include(halves[0]);
        all.include(halves[1]);
        if (round % 2) CHECK(all.above == 0xffff);
        if (all.above == 0) continue;
        const auto hull = outline.hull(all, 16);
        if (!hull) continue;
        ++known;
        bool inside = true;
        for (std::size_t i = 0; i < receivers.size(); ++i) {
            if (!(halves[i / 16].above >> (i % 16) & 1)) continue;
            const glm::dvec3 start = straight(p, receivers[i].point);
            inside = inside && start.x >= hull->uLow && start.x <= hull->uHigh;
            inside = inside && start.y >= hull->vLow && start.y <= hull->vHigh;
            inside = inside && start.z >= hull->wLow && start.z <= hull->wHigh;
            inside = inside && hull->wFirst == hull->wLow;
            for (int s = 0; s < kSamples; ++s) {
                const glm::dvec3 delta = towards(sampler, receivers[i].point, s);
                const glm::dvec3 on =
                    straight(p, receivers[i].point + 0.5 * delta) - start;
                const double tolerance = 1e-9 * (1.0 + std::abs(start.x));
                inside = inside && on.z > 0.0;
                inside = inside && on.x >= hull->slopeLowU * on.z - tolerance &&
                         on.x <= hull->slopeHighU * on.z + tolerance;
                inside = inside && on.y >= hull->slopeLowV * on.z - tolerance &&
                         on.y <= hull->slopeHighV * on.z + tolerance;
            }
        }
        CHECK(inside);
    }
    CHECK(known > 200);
}

TEST_CASE("the hull of one receiver is little wider than its light", "[shadow]") {
    Random random(5);
    AreaLight light = lightOf(LightShape::disk, random);
    light.radius = 0.25;
    Projection p = viewFrom(light, random);
    p.forward = light.direction;
    p.right = glm::normalize(glm::cross(p.forward, glm::dvec3(0.3, 0.2, 1)));
    p.up = glm::cross(p.right, p.forward);
    const shadow::LightOutline outline(p, light::LightSampler(light));
    const Receiver receiver{{0.1, 0, 0.2}, glm::dvec3(0.0)};
    const auto hull = outline.hull(outline.outlook(&receiver, 1), 4);
    REQUIRE(hull);
    // Seen from the receiver the light is a disk across the view's axis in its eye.
    CHECK(hull->slopeHighU - hull->slopeLowU ==
          Approx(2 * 0.25 * std::abs(p.scale.x)).epsilon(0.01));
    CHECK(hull->slopeHighV - hull->slopeLowV ==
          Approx(2 * 0.25 * std::abs(p.scale.y)).epsilon(0.01));
    // A disk's rays are as dense as its area says; its box is larger.
    const double area = 3.14159265 * 0.25 * 0.25 * std::abs(p.scale.x * p.scale.y);
    CHECK(hull->spread >= std::sqrt(area / 4));
    CHECK(hull->spread <= 1.2 * std::sqrt(area / 4));
}
