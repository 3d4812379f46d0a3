// Rays against the triangles of a near field: brute force in double, meshes without
// gaps, and the same answer whichever rays stand beside and whatever the processor.
#include "trace/near_trace.h"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <random>
#include <vector>

#include "hwy/highway.h"
#include "map_fixture.h"
#include "mtsm/map.h"

using namespace mtsm;
using trace::kLanes;
using trace::kMostBlocks;
using trace::RayBundle;

namespace {

using Triangle = std::array<glm::dvec3, 3>;

class Random {
  public:
    explicit Random(std::uint64_t seed) : engine_(seed) {}
    double in(double low, double high) {
        return low + (high - low) * double(engine_() >> 11) * 0x1p-53;
    }
    std::size_t below(std::size_t n) { return std::size_t(engine_() % n); }

  private:
    std::mt19937_64 engine_;
};

/// A map with these triangles, 16 by 16 in their order, on a grid of 2^-8 in u and v and
/// 2^-20 in w: they must lie on it.
ShadowMap mapOfTriangles(const std::vector<Triangle>& triangles) {
    const double step[3] = {0x1p-8, 0x1p-8, 0x1p-20};
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    for (std::size_t i = 0; i < triangles.size(); i += 16) {
        NearChunk& chunk = faces[0].nearField.chunks.emplace_back();
        const std::size_t last = std::min(i + 16, triangles.size()) - 1;
        for (int axis = 0; axis < 3; ++axis) {
            double low = HUGE_VAL;
            for (std::size_t t = i; t <= last; ++t) {
                for (const glm::dvec3& p : triangles[t])
                    low = std::min(low, p[axis]);
            }
            chunk.low[axis] = float(low);
            chunk.step[axis] = float(step[axis]);
            for (std::size_t t = 0; t < 16; ++t) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const double q =
                        (triangles[std::min(i + t, last)][c][axis] - low) / step[axis];
                    REQUIRE(q == std::floor(q));
                    REQUIRE(q <= 65535);
                    chunk.corner[c][axis][t] = std::uint16_t(q);
                }
            }
        }
    }
    auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

glm::dvec3 onGrid(glm::dvec3 p) {
    return {std::round(p.x * 0x1p8) * 0x1p-8, std::round(p.y * 0x1p8) * 0x1p-8,
            std::round(p.z * 0x1p20) * 0x1p-20};
}

/// A bundle, where its rays end, and which are asked for.
struct Rays {
    RayBundle bundle{};
    alignas(64) float end[kMostBlocks][kLanes]{};
    std::uint16_t asked[kMostBlocks]{};

    [[nodiscard]] glm::dvec3 start(int lane) const {
        return {bundle.u[lane], bundle.v[lane], bundle.w[lane]};
    }
    [[nodiscard]] glm::dvec3 delta(int b, int lane) const {
        return {bundle.du[b][lane], bundle.dv[b][lane], bundle.dw[b][lane]};
    }
    void setStart(int lane, glm::dvec3 p) {
        bundle.u[lane] = float(p.x);
        bundle.v[lane] = float(p.y);
        bundle.w[lane] = float(p.z);
    }
    void setDelta(int b, int lane, glm::dvec3 d) {
        bundle.du[b][lane] = float(d.x);
        bundle.dv[b][lane] = float(d.y);
        bundle.dw[b][lane] = float(d.z);
    }
    void trace(const ShadowMap& map) {
        trace::traceNear(map.nearField(0), bundle, end, asked);
    }
};

/// Rays from around a point to around others, all open and asked for.
std::unique_ptr<Rays> raysAround(Random& random, int blocks, glm::dvec3 from,
                                 double spread, glm::dvec3 reach) {
    auto rays = std::make_unique<Rays>();
    rays->bundle.blocks = blocks;
    const auto around = [&](glm::dvec3 p, double by) {
        return p + by * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                   random.in(-0x1p-12, 0x1p-12));
    };
    for (int lane = 0; lane < kLanes; ++lane)
        rays->setStart(lane, around(from, spread));
    for (int b = 0; b < blocks; ++b) {
        const glm::dvec3 cell = around(reach, 0.5 * glm::length(glm::dvec2(reach)));
        for (int lane = 0; lane < kLanes; ++lane) {
            rays->setDelta(b, lane, around(cell, spread));
            rays->bundle.begin[b][lane] = float(random.in(0, 0.2));
            rays->end[b][lane] = float(random.in(0.3, 1));
        }
        rays->bundle.open[b] = rays->asked[b] = 0xffff;
    }
    return rays;
}

enum class Met { no, yes, close };

/// Whether a ray crosses a triangle, in double; close if rounding may decide.
Met meets(const Triangle& t, glm::dvec3 start, glm::dvec3 delta, double begin,
          double end) {
    // w is brought to the size of u and v.
    const glm::dvec3 scale(1.0, 1.0, 0x1p12);
    start *= scale;
    delta *= scale;
    const glm::dvec3 a = t[0] * scale, b = t[1] * scale, c = t[2] * scale;
    const glm::dvec3 normal = glm::cross(b - a, c - a);
    const double speed = glm::dot(normal, delta);
    const double size = glm::length(normal) * glm::length(delta);
    const double s = glm::dot(normal, a - start) / speed;
    if (size == 0.0) return Met::close;
    double inside = HUGE_VAL;
    if (speed != 0.0) {
        const glm::dvec3 p = start + s * delta;
        const glm::dvec3 corners[3] = {a, b, c};
        for (int i = 0; i < 3; ++i) {
            const glm::dvec3 from = corners[i], edge = corners[(i + 1) % 3] - from;
            // Distance from the edge, inwards.
            inside = std::min(inside, glm::dot(glm::cross(normal, edge), p - from) /
                                          (glm::length(normal) * glm::length(edge)));
        }
    }
    const double grazing = std::abs(speed) / size;
    const double slack = std::min(s - begin, end - s) * glm::length(delta);
    const double error = 2e-3 / std::max(grazing, 1e-9);
    if (std::abs(speed) / size < 1e-4) return Met::close;
    if (inside < -error || slack < -error) return Met::no;
    return inside > error && slack > error ? Met::yes : Met::close;
}

/// Counts rays whose bit is not what brute force says.
struct Disagreement {
    int wrong = 0, hit = 0, missed = 0, close = 0;

    void add(const Rays& before, const Rays& after,
             const std::vector<Triangle>& triangles) {
        for (int b = 0; b < before.bundle.blocks; ++b) {
            for (int lane = 0; lane < kLanes; ++lane) {
                Met met = Met::no;
                for (const Triangle& t : triangles) {
                    const Met m =
                        meets(t, before.start(lane), before.delta(b, lane),
                              before.bundle.begin[b][lane], before.end[b][lane]);
                    if (m == Met::close && met == Met::no) met = Met::close;
                    if (m == Met::yes) met = Met::yes;
                }
                const bool open = after.bundle.open[b] >> lane & 1;
                hit += met == Met::yes;
                missed += met == Met::no;
                close += met == Met::close;
                wrong += met == Met::yes ? open : met == Met::no ? !open : 0;
            }
        }
    }
};

std::vector<Triangle> scattered(Random& random, int count, double size) {
    std::vector<Triangle> triangles;
    for (int i = 0; i < count; ++i) {
        const glm::dvec3 at(random.in(0, 64), random.in(0, 64), random.in(0.01, 0.02));
        const double s = size * std::exp2(random.in(-3, 1));
        Triangle t;
        for (glm::dvec3& p : t)
            p = onGrid(at + s * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                           random.in(-0x1p-12, 0x1p-12)));
        triangles.push_back(t);
    }
    // As the bake does, those that lie together into one chunk.
    std::sort(triangles.begin(), triangles.end(), [](const auto& a, const auto& b) {
        const auto key = [](const Triangle& t) {
            return std::make_tuple(int(t[0].x / 8), int(t[0].y / 8), t[0].z);
        };
        return key(a) < key(b);
    });
    return triangles;
}

/// Runs `body` once for each kind of processor that this one can be.
void onEachTarget(const std::function<void()>& body) {
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
        INFO(hwy::TargetName(target));
        hwy::GetChosenTarget().Update(target);
        body();
    }
    hwy::GetChosenTarget().DeInit();
}

}  // namespace

TEST_CASE("rays are blocked by the triangles that brute force finds", "[trace][twin]") {
    Random random(1);
    Disagreement found;
    for (const int count : {1, 16, 17, 900}) {
        const std::vector<Triangle> triangles = scattered(random, count, 6.0);
        const ShadowMap map = mapOfTriangles(triangles);
        for (int i = 0; i < 60; ++i) {
            const glm::dvec3 from(random.in(0, 64), random.in(0, 64),
                                  random.in(0.008, 0.022));
            const double length = std::exp2(random.in(0, 6));
            const glm::dvec3 reach(random.in(-1, 1) * length, random.in(-1, 1) * length,
                                   random.in(-0.01, 0.02));
            auto rays = raysAround(random, 1 + int(random.below(20)), from,
                                   std::exp2(random.in(-6, 2)), reach);
            Rays after = *rays;
            after.trace(map);
            found.add(*rays, after, triangles);
        }
    }
    CHECK(found.wrong == 0);
    CHECK(found.hit > 1000);
    CHECK(found.missed > 1000);
    CHECK(found.close < (found.hit + found.missed) / 5);
}

TEST_CASE("no ray slips through a mesh, along its edges and through its corners",
          "[trace][exact]") {
    // A bumpy sheet of 24 x 24 quads, and a fan of slivers around one corner.
    Random random(2);
    std::vector<Triangle> sheet, fan;
    glm::dvec3 point[25][25];
    for (int y = 0; y < 25; ++y) {
        for (int x = 0; x < 25; ++x)
            point[y][x] =
                onGrid({2.5 * x + random.in(-0.8, 0.8), 2.5 * y + random.in(-0.8, 0.8),
                        0.015 + random.in(-1e-4, 1e-4)});
    }
    for (int y = 0; y < 24; ++y) {
        for (int x = 0; x < 24; ++x) {
            sheet.push_back({point[y][x], point[y][x + 1], point[y + 1][x + 1]});
            sheet.push_back({point[y + 1][x], point[y][x], point[y + 1][x + 1]});
        }
    }
    constexpr int kFan = 200;
    const glm::dvec3 hub = onGrid({30.1, 29.7, 0.015});
    const auto rim = [&](int i) {
        const double angle = 6.283185307179586 * (i % kFan) / kFan;
        return onGrid(hub + glm::dvec3(20 * std::cos(angle), 20 * std::sin(angle),
                                       1e-4 * std::sin(3 * angle)));
    };
    for (int i = 0; i < kFan; ++i)
        fan.push_back({hub, rim(i), rim(i + 1)});

    const std::vector<Triangle>* const meshes[] = {&sheet, &fan};
    for (const std::vector<Triangle>* mesh : meshes) {
        const ShadowMap map = mapOfTriangles(*mesh);
        int through = 0;
        for (int i = 0; i < 300; ++i) {
            // From in front of the mesh to behind it, by way of an edge or a corner.
            auto rays = std::make_unique<Rays>();
            rays->bundle.blocks = 16;
            for (int lane = 0; lane < kLanes; ++lane)
                rays->setStart(lane, {random.in(20, 40), random.in(20, 40), 0.012});
            for (int b = 0; b < 16; ++b) {
                for (int lane = 0; lane < kLanes; ++lane) {
                    const Triangle& t = (*mesh)[random.below(mesh->size())];
                    const double share = b % 4 == 0 ? 0.0 : random.in(0, 1);
                    glm::dvec3 by = glm::mix(t[0], t[1], share);
                    by = glm::clamp(by, glm::dvec3(8), glm::dvec3(52, 52, 1));
                    by.z = glm::mix(t[0], t[1], share).z;
                    rays->setDelta(b, lane, (by - rays->start(lane)) * 2.0);
                    rays->end[b][lane] = 1.0f;
                }
                rays->bundle.open[b] = rays->asked[b] = 0xffff;
            }
            rays->trace(map);
            for (int b = 0; b < 16; ++b)
                through += std::popcount(rays->bundle.open[b]);
        }
        CHECK(through == 0);
    }
}

TEST_CASE("a ray's answer depends on that ray alone, on every processor",
          "[trace][twin]") {
    Random random(3);
    const std::vector<Triangle> triangles = scattered(random, 2000, 3.0);
    const ShadowMap map = mapOfTriangles(triangles);
    std::vector<std::unique_ptr<Rays>> bundles;
    for (int i = 0; i < 12; ++i)
        bundles.push_back(raysAround(
            random, i == 0 ? kMostBlocks : 1 + int(random.below(20)),
            {random.in(10, 54), random.in(10, 54), 0.012}, std::exp2(random.in(-6, 2)),
            {random.in(-20, 20), random.in(-20, 20), random.in(-0.002, 0.01)}));
    std::vector<std::vector<std::uint16_t>> first;
    onEachTarget([&] {
        for (std::size_t i = 0; i < bundles.size(); ++i) {
            Rays all = *bundles[i];
            all.trace(map);
            const std::vector<std::uint16_t> open(all.bundle.open,
                                                  all.bundle.open + all.bundle.blocks);
            if (first.size() <= i) first.push_back(open);
            CHECK(open == first[i]);
        }
    });
    int blocked = 0, different = 0;
    for (std::size_t i = 0; i < bundles.size(); ++i) {
        for (int b = 0; b < bundles[i]->bundle.blocks; ++b) {
            for (int lane = 0; lane < kLanes; ++lane) {
                Rays alone = *bundles[i];
                std::fill_n(alone.asked, kMostBlocks, std::uint16_t(0));
                alone.asked[b] = std::uint16_t(1u << lane);
                alone.trace(map);
                const bool open = first[i][std::size_t(b)] >> lane & 1;
                blocked += !open;
                const std::uint16_t others = std::uint16_t(~alone.asked[b]);
                different += (alone.bundle.open[b] >> lane & 1) != open ||
                             (alone.bundle.open[b] & others) != others;
            }
        }
    }
    CHECK(different == 0);
    CHECK(blocked > 300);
}

TEST_CASE("triangles count behind begin and up to end, for open rays that are asked for",
          "[trace][exact]") {
    // Crossed at s = 0.5 exactly; edge-on to the eye, which looks along w.
    const ShadowMap map = mapOfTriangles(
        {{glm::dvec3(4, 0, 0.0078125), {4, 8, 0.0078125}, {4, 4, 0.0625}}});
    Rays rays;
    rays.bundle.blocks = 1;
    for (int lane = 0; lane < kLanes; ++lane) {
        rays.setStart(lane, {2, 4, 0.015625});
        rays.setDelta(0, lane, {4, 0, 0});
        rays.end[0][lane] = 1.0f;
    }
    const auto blocked = [&](float begin, float end) {
        rays.bundle.begin[0][3] = begin;
        rays.end[0][3] = end;
        rays.bundle.open[0] = rays.asked[0] = 8;
        rays.trace(map);
        return rays.bundle.open[0] == 0;
    };
    onEachTarget([&] {
        CHECK(blocked(0.0f, 1.0f));
        CHECK(blocked(0.0f, 0.5f));
        CHECK(blocked(std::nextafter(0.5f, 0.0f), 1.0f));
        CHECK_FALSE(blocked(0.5f, 1.0f));
        CHECK_FALSE(blocked(0.0f, std::nextafter(0.5f, 0.0f)));
        CHECK_FALSE(blocked(0.75f, 0.25f));
        rays.bundle.begin[0][3] = 0.0f;
        rays.end[0][3] = 1.0f;
        rays.bundle.open[0] = 0x0ff0;
        rays.asked[0] = 0x00ff;
        rays.trace(map);
        CHECK(rays.bundle.open[0] == 0x0f00);
        rays.setDelta(0, 9, {0, 4, 0});  // beside it
        rays.setDelta(0, 10, {0, 0, 0});
        rays.bundle.open[0] = rays.asked[0] = 0xffff;
        rays.trace(map);
        CHECK(rays.bundle.open[0] == 0x0600);
    });
}

TEST_CASE("a near field without triangles blocks nothing", "[trace]") {
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    const auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    Random random(4);
    auto rays = raysAround(random, 5, {4, 4, 0.01}, 1.0, {3, 3, 0.01});
    rays->trace(*map);
    for (int b = 0; b < 5; ++b)
        CHECK(rays->bundle.open[b] == 0xffff);
}
