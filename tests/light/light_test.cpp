#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

#include "base/sampling.h"
#include "light/sample.h"
#include "mtsm/light.h"

using namespace mtsm;
using light::LightSampler;

namespace {

constexpr int kCount = 4096;

AreaLight diskLight(double radius) {
    AreaLight l;
    l.shape = LightShape::disk;
    l.position = {1, 2, 3};
    l.direction = glm::normalize(glm::dvec3(1, -2, 0.5));
    l.radius = radius;
    return l;
}

}  // namespace

TEST_CASE("disk samples fill the disk evenly", "[light][exact]") {
    // Equal areas: a share r^2 of the samples lies within radius r, to 1 / sqrt(N)-like
    // error.
    const base::SquareSequence sequence(42);
    for (double r : {0.25, 0.5, 0.9, 1.0}) {
        int within = 0;
        for (int i = 0; i < kCount; ++i) {
            const glm::dvec2 d = light::sampleDisk(sequence(i));
            REQUIRE(glm::length(d) <= 1.0 + 1e-12);
            within += glm::length(d) <= r + 1e-12;
        }
        CHECK(within / double(kCount) == Approx(r * r).margin(0.01));
    }
}

TEST_CASE("cap samples have the closed-form mean direction", "[light][exact]") {
    // The mean of z over a cap of height h is 1 - h / 2.
    const base::SquareSequence sequence(7);
    for (double h : {1e-12, 1e-6, 0.1, 1.0, 2.0}) {
        glm::dvec3 sum(0.0);
        double deepest = 0.0;
        for (int i = 0; i < kCount; ++i) {
            const glm::dvec3 d = light::sampleCap(sequence(i), h);
            REQUIRE(glm::length(d) == Approx(1.0).epsilon(1e-12));
            sum += d;
            deepest = std::max(deepest, 1.0 - d.z);
        }
        sum /= double(kCount);
        CHECK(sum.z == Approx(1.0 - h / 2).margin(0.002 * h + 1e-15));
        CHECK(std::abs(sum.x) < 0.01);
        CHECK(std::abs(sum.y) < 0.01);
        CHECK(deepest <= h * (1 + 1e-9) + 1e-15);
    }
}

TEST_CASE("the weights add up to the irradiance of a disk on its axis",
          "[light][exact]") {
    // A disk of radiance 1 and radius R at distance d gives pi R^2 / (R^2 + d^2) on its
    // axis; the mean of cos cos / d^2 times the area pi R^2 is the same.
    const double R = 0.7, d = 1.3;
    AreaLight l = diskLight(R);
    const glm::dvec3 p = l.position + d * l.direction;
    const LightSampler sampler(l);
    const base::SquareSequence sequence(3);
    double sum = 0.0;
    for (int i = 0; i < kCount; ++i) {
        const auto s = sampler.sample(p, sequence(i));
        sum += s.weight * glm::dot(s.delta, -l.direction) / glm::length(s.delta);
    }
    const double area = glm::pi<double>() * R * R;
    CHECK(area * sum / kCount == Approx(area / (R * R + d * d)).epsilon(1e-3));
}

TEST_CASE("the weights add up to the irradiance of a sphere and of a rect",
          "[light][exact]") {
    const base::SquareSequence sequence(11);
    // A sphere of radiance 1 gives pi (R / D)^2 to a surface that faces its centre,
    // however close; the density is uniform over the cap that is seen, of area 2 pi R^2
    // (1 - R / D).
    AreaLight sphere;
    sphere.shape = LightShape::sphere;
    sphere.position = {1, -2, 3};
    sphere.radius = 0.8;
    for (const double distance : {0.9, 1.5, 20.0}) {
        const glm::dvec3 facing = glm::normalize(glm::dvec3(1, 2, -2));
        const glm::dvec3 p = sphere.position - distance * facing;
        const LightSampler sampler(sphere);
        double sum = 0.0;
        for (int i = 0; i < kCount; ++i) {
            const auto s = sampler.sample(p, sequence(i));
            sum += s.weight * glm::dot(s.delta, facing) / glm::length(s.delta);
        }
        const double ratio = sphere.radius / distance;
        const double cap =
            2 * glm::pi<double>() * sphere.radius * sphere.radius * (1 - ratio);
        CHECK(cap * sum / kCount ==
              Approx(glm::pi<double>() * ratio * ratio).epsilon(0.01));
    }
    // A rect seen from aside, against a midpoint rule.
    AreaLight rect;
    rect.shape = LightShape::rect;
    rect.direction = {0, 0, 1};
    rect.up = {0, 1, 0};
    rect.size = {2, 1};
    const glm::dvec3 p(1.5, -0.7, 0.9), n = glm::normalize(glm::dvec3(-1, 0.3, -0.8));
    double expected = 0.0;
    const int steps = 400;
    for (int j = 0; j < steps; ++j) {
        for (int i = 0; i < steps; ++i) {
            const glm::dvec3 d =
                glm::dvec3((i + 0.5) / steps * 2 - 1, (j + 0.5) / steps - 0.5, 0) - p;
            expected +=
                std::max(0.0, glm::dot(d, n)) * -d.z / std::pow(glm::dot(d, d), 2);
        }
    }
    const LightSampler sampler(rect);
    double sum = 0.0;
    for (int i = 0; i < kCount; ++i) {
        const auto s = sampler.sample(p, sequence(i));
        sum += s.weight * std::max(0.0, glm::dot(s.delta, n)) / glm::length(s.delta);
    }
    CHECK(sum / kCount == Approx(expected / (steps * steps)).epsilon(0.002));
}

TEST_CASE("a rect's samples lie on it, its height along up", "[light]") {
    AreaLight l;
    l.shape = LightShape::rect;
    l.position = {0, 4, 0};
    l.direction = {0, -1, 0};
    l.up = {1, 1, 0};  // only its part across the direction counts: +x
    l.size = {0.5, 3.0};
    const LightSampler sampler(l);
    const base::SquareSequence sequence(1);
    double mostX = 0, mostZ = 0;
    for (int i = 0; i < 256; ++i) {
        const glm::dvec3 q = sampler.sample({0, 0, 0}, sequence(i)).delta;
        CHECK(q.y == Approx(4.0));
        mostX = std::max(mostX, std::abs(q.x));
        mostZ = std::max(mostZ, std::abs(q.z));
    }
    CHECK(mostX == Approx(1.5).margin(0.02));
    CHECK(mostZ == Approx(0.25).margin(0.004));
}

TEST_CASE("a sphere's samples lie on the cap that the point sees", "[light]") {
    AreaLight l;
    l.shape = LightShape::sphere;
    l.position = {0, 0, 5};
    l.radius = 2.0;
    const LightSampler sampler(l);
    const base::SquareSequence sequence(1);
    for (const glm::dvec3 p :
         {glm::dvec3(0, 0, 0), glm::dvec3(1e6, 0, 0), glm::dvec3(2.5, 0, 5)}) {
        for (int i = 0; i < 256; ++i) {
            const auto s = sampler.sample(p, sequence(i));
            const glm::dvec3 n = (p + s.delta - l.position) / l.radius;
            CHECK(glm::length(n) == Approx(1.0).epsilon(1e-6));
            CHECK(glm::dot(n, s.delta) <= 1e-6 * glm::length(s.delta));  // faces p
            CHECK(s.weight >= 0.0);
        }
    }
    // From inside, every direction: nothing breaks down.
    const auto s = sampler.sample(l.position, glm::dvec2(0.3, 0.6));
    CHECK(glm::length(s.delta) == Approx(2.0));
}

TEST_CASE("a sun's samples stay within half its diameter, however small", "[light]") {
    AreaLight l;
    l.shape = LightShape::sun;
    l.direction = glm::normalize(glm::dvec3(1, -3, 2));
    const base::SquareSequence sequence(9);
    for (double diameter : {0.0, 1e-9, 0.0093, 2.0}) {
        l.angularDiameter = diameter;
        const LightSampler sampler(l);
        double widest = 0.0;
        for (int i = 0; i < 256; ++i) {
            const auto s = sampler.sample({0, 0, 0}, sequence(i));
            CHECK(s.endless);
            widest = std::max(widest, glm::length(glm::cross(s.delta, l.direction)));
        }
        CHECK(widest <= std::sin(diameter / 2) * (1 + 1e-6) + 1e-15);
        CHECK(widest >= 0.95 * std::sin(diameter / 2));
    }
}

TEST_CASE("a light that is none is refused", "[light][bad-input]") {
    CHECK(checkLight(diskLight(0.0)));
    CHECK(checkLight(diskLight(1e9)));
    CHECK_FALSE(checkLight(diskLight(-1.0)));
    CHECK_FALSE(checkLight(diskLight(NAN)));
    AreaLight l = diskLight(1);
    l.direction = {0, 0, 0};
    CHECK_FALSE(checkLight(l));
    l = diskLight(1);
    l.position.y = INFINITY;
    CHECK_FALSE(checkLight(l));
    l = diskLight(1);
    l.angularDiameter = 3.2;
    CHECK_FALSE(checkLight(l));
    l = diskLight(1);
    l.size = {-1, 1};
    CHECK_FALSE(checkLight(l));
}

TEST_CASE("a light fits if all of it lies within the baked one", "[light][exact]") {
    const AreaLight baked = diskLight(1.0);
    CHECK(lightFits(baked, baked));
    CHECK(lightFits(diskLight(0.5), baked));
    CHECK(lightFits(diskLight(0.0), baked));
    CHECK_FALSE(lightFits(diskLight(1.01), baked));

    const light::Frame frame = light::makeFrame(baked.direction);
    AreaLight shifted = diskLight(0.5);
    shifted.position += 0.5 * frame.x;
    CHECK(lightFits(shifted, baked));
    shifted.position += 0.01 * frame.x;
    CHECK_FALSE(lightFits(shifted, baked));

    // The largest square in a disk has half its diagonal equal to the radius.
    AreaLight rect = baked;
    rect.shape = LightShape::rect;
    rect.size = glm::dvec2(std::sqrt(2.0));
    CHECK(lightFits(rect, baked));
    rect.size *= 1.001;
    CHECK_FALSE(lightFits(rect, baked));
    // And the largest disk in a rect touches the nearer sides.
    rect.size = {2.0, 5.0};
    CHECK(lightFits(baked, rect));
    CHECK_FALSE(lightFits(diskLight(1.001), rect));

    AreaLight tilted = diskLight(0.5);
    tilted.direction = glm::normalize(tilted.direction + 0.01 * frame.x);
    CHECK_FALSE(lightFits(tilted, baked));
    AreaLight turned = diskLight(0.5);
    turned.direction = -turned.direction;
    CHECK_FALSE(lightFits(turned, baked));

    AreaLight point = baked;
    point.shape = LightShape::point;
    CHECK(lightFits(point, baked));
    CHECK(lightFits(point, point));
    CHECK_FALSE(lightFits(baked, point));

    AreaLight sun = baked;
    sun.shape = LightShape::sun;
    sun.angularDiameter = 0.1;
    CHECK_FALSE(lightFits(sun, baked));
    CHECK_FALSE(lightFits(baked, sun));
    CHECK(lightFits(sun, sun));
    AreaLight smaller = sun;
    smaller.angularDiameter = 0.05;
    smaller.direction = glm::normalize(sun.direction + 0.024 * frame.x);
    CHECK(lightFits(smaller, sun));
    smaller.direction = glm::normalize(sun.direction + 0.03 * frame.x);
    CHECK_FALSE(lightFits(smaller, sun));
}
