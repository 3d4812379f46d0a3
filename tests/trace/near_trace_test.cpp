// Rays against the triangles of a near field: brute force in double, meshes without
// gaps, and the same answer whichever rays stand beside and whatever the processor.
#include "trace/near_trace.h"

#include <algorithm>
#include <array>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "map_fixture.h"
#include "mtsm/map.h"
#include "trace/bundle_fixture.h"
#include "trace/each_target.h"

using namespace mtsm;
using test::onEachTarget;
using test::Random;
using test::raysAround;
using trace::kLanes;
using trace::kMostGroups;
using trace::kMostReceivers;
using trace::kMostRows;

namespace {

using Triangle = std::array<glm::dvec3, 3>;

/// A map with these triangles, 16 by 16 in their order, on a grid of 2^-8 in u and v and
/// 2^-20 in w: they must lie on it.
ShadowMap mapOfTriangles(const std::vector<Triangle>& triangles) {
    const double step[3] = {0x1p-8, 0x1p-8, 0x1p-20};
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    for (std::size_t i = 0; i < triangles.size(); i += 16) {
        NearChunk chunk;
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
        faces[0].nearField.chunks.push_back(chunk);
    }
    auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

glm::dvec3 onGrid(glm::dvec3 p) {
    return {std::round(p.x * 0x1p8) * 0x1p-8, std::round(p.y * 0x1p8) * 0x1p-8,
            std::round(p.z * 0x1p20) * 0x1p-20};
}

/// Closes the rays that triangles block which rise this high above the planes.
void traceNear(const ShadowMap& map, test::Rays& rays, double height = 0.0) {
    trace::traceNear(map.nearField(0), rays.bundle, rays.end, float(height));
}

/// w is brought to the size of u and v.
constexpr glm::dvec3 kScale(1.0, 1.0, 0x1p12);

/// Gives receivers planes of any direction; heights in pixels.
void addPlanes(Random& random, test::Rays& rays) {
    rays.bundle.hasPlanes = true;
    for (int receiver = 0; receiver < kMostReceivers; ++receiver) {
        const glm::dvec3 n =
            glm::normalize(glm::dvec3(random.in(-1, 1), random.in(-1, 1), 1)) * kScale;
        rays.bundle.planeU[receiver] = float(n.x);
        rays.bundle.planeV[receiver] = float(n.y);
        rays.bundle.planeW[receiver] = float(n.z);
    }
}

/// How high a triangle rises above a receiver's plane.
double rises(const Triangle& t, const test::Rays& rays, int receiver) {
    if (!rays.bundle.hasPlanes) return HUGE_VAL;
    const glm::dvec3 n(rays.bundle.planeU[receiver], rays.bundle.planeV[receiver],
                       rays.bundle.planeW[receiver]);
    double most = -HUGE_VAL;
    for (const glm::dvec3& p : t)
        most = std::max(most, glm::dot(n, p - rays.start(receiver)));
    return most;
}

enum class Met { no, yes, close };

/// Whether a ray crosses a triangle, in double; close if rounding may decide.
Met meets(const Triangle& t, glm::dvec3 start, glm::dvec3 delta, double begin,
          double end) {
    start *= kScale;
    delta *= kScale;
    const glm::dvec3 a = t[0] * kScale, b = t[1] * kScale, c = t[2] * kScale;
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

    /// What traceNear() makes of the rays, above a height, of planes if asked for.
    void trace(Random& random, const ShadowMap& map,
               const std::vector<Triangle>& triangles, bool planes, test::Rays& rays) {
        const double height = random.in(0, 0.5);
        if (planes) addPlanes(random, rays);
        test::Rays after = rays;
        traceNear(map, after, height);
        add(rays, after, triangles, height);
    }
    void add(const test::Rays& before, const test::Rays& after,
             const std::vector<Triangle>& triangles, double height) {
        for (int row = 0; row < before.rows(); ++row) {
            const int receiver = row / before.bundle.groups;
            for (int lane = 0; lane < kLanes; ++lane) {
                if (!before.isOpen(row, lane)) continue;
                Met met = Met::no;
                for (const Triangle& t : triangles) {
                    const double above = rises(t, before, receiver) - height;
                    if (above < -1e-3) continue;
                    Met m = meets(t, before.start(receiver), before.delta(row, lane),
                                  before.bundle.begin[row][lane], before.end[row][lane]);
                    if (m == Met::yes && above < 1e-3) m = Met::close;
                    if (m == Met::close && met == Met::no) met = Met::close;
                    if (m == Met::yes) met = Met::yes;
                }
                const bool open = after.isOpen(row, lane);
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
            const int receivers = 1 + int(random.below(16));
            auto rays = raysAround(random, receivers,
                                   1 + int(random.below(std::size_t(20 / receivers))),
                                   from, std::exp2(random.in(-6, 2)), reach);
            found.trace(random, map, triangles, i % 2, *rays);
        }
    }
    CHECK(found.wrong == 0);
    CHECK(found.hit > 1000);
    CHECK(found.missed > 1000);
    CHECK(found.close < (found.hit + found.missed) / 5);
}

TEST_CASE("a few rays of each receiver are blocked by what brute force finds",
          "[trace][twin]") {
    Random random(8);
    Disagreement found;
    for (const int count : {16, 200, 2000}) {
        const std::vector<Triangle> triangles = scattered(random, count, 6.0);
        const ShadowMap map = mapOfTriangles(triangles);
        for (int i = 0; i < 80; ++i) {
            const glm::dvec3 from(random.in(0, 64), random.in(0, 64), 0.008);
            const double length = std::exp2(random.in(0, 4));
            const glm::dvec3 reach(random.in(-1, 1) * length, random.in(-1, 1) * length,
                                   0.014);
            // From close together, where they share triangles, to far apart.
            const auto rays = raysAround(random, 1 + int(random.below(16)), 1, from,
                                         std::exp2(random.in(-6, 4)), reach);
            for (int row = 0; row < rays->rows(); ++row)
                rays->bundle.open[row] = std::uint16_t(random.below(16));
            found.trace(random, map, triangles, i % 2, *rays);
        }
    }
    CHECK(found.wrong == 0);
    CHECK(found.hit > 500);
    CHECK(found.missed > 500);
    CHECK(found.close < (found.hit + found.missed) / 5);
}

TEST_CASE("a hull that meets no triangle lies beside all of them", "[trace][twin]") {
    Random random(8);
    int free = 0, met = 0;
    for (const int count : {1, 40, 900}) {
        const std::vector<Triangle> triangles = scattered(random, count, 2.0);
        const ShadowMap map = mapOfTriangles(triangles);
        for (int i = 0; i < 400; ++i) {
            const double size = std::exp2(random.in(-4, 3));
            const glm::dvec3 from(random.in(0, 64), random.in(0, 64),
                                  random.in(0.008, 0.02));
            const glm::dvec3 to = from + glm::dvec3(size, size, 0x1p-10);
            const double rise = std::exp2(random.in(-14, -7));
            const double slopes[4] = {random.in(-900, 0), random.in(0, 900),
                                      random.in(-900, -300), random.in(-300, 0)};
            const trace::RayHull hull{
                float(from.x),    float(to.x),      float(from.y),    float(to.y),
                float(from.z),    float(to.z),      float(slopes[0]), float(slopes[1]),
                float(slopes[2]), float(slopes[3]), float(from.z),    0.0f};
            // Corners of triangles that lie within reach of a ray.
            bool inside = false;
            for (const Triangle& t : triangles) {
                for (const glm::dvec3& p : t) {
                    const double dw = std::min(p.z - from.z, rise);
                    inside = inside || (p.z >= from.z && p.z <= to.z + rise &&
                                        p.x >= from.x + slopes[0] * dw &&
                                        p.x <= to.x + slopes[1] * dw &&
                                        p.y >= from.y + slopes[2] * dw && p.y <= to.y);
                }
            }
            const bool may = trace::mayMeet(map.nearField(0).levels, hull, float(rise));
            if (inside) CHECK(may);
            ++(may ? met : free);
        }
    }
    CHECK(free > 200);
    CHECK(met > 200);
    const trace::RayHull hull{0, 64, 0, 64, 0.01f, 0.02f, -9, 9, -9, 9, 0.01f, 0.0f};
    CHECK_FALSE(trace::mayMeet(mapOfTriangles({}).nearField(0).levels, hull, 1.0f));
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
            auto rays = std::make_unique<test::Rays>(16, 1);
            for (int row = 0; row < 16; ++row) {
                rays->setStart(row, {random.in(20, 40), random.in(20, 40), 0.012});
                for (int lane = 0; lane < kLanes; ++lane) {
                    const Triangle& t = (*mesh)[random.below(mesh->size())];
                    const double share = lane % 4 == 0 ? 0.0 : random.in(0, 1);
                    glm::dvec3 by = glm::mix(t[0], t[1], share);
                    by = glm::clamp(by, glm::dvec3(8), glm::dvec3(52, 52, 1));
                    by.z = glm::mix(t[0], t[1], share).z;
                    rays->setDelta(row, lane, (by - rays->start(row)) * 2.0);
                }
            }
            rays->boundEnds();
            traceNear(map, *rays);
            for (int row = 0; row < 16; ++row)
                through += std::popcount(rays->bundle.open[row]);
        }
        CHECK(through == 0);
    }
}

TEST_CASE("a ray's answer depends on that ray alone, on every processor",
          "[trace][twin]") {
    Random random(3);
    const std::vector<Triangle> triangles = scattered(random, 2000, 3.0);
    const ShadowMap map = mapOfTriangles(triangles);
    std::vector<std::unique_ptr<test::Rays>> bundles;
    for (int i = 0; i < 12; ++i) {
        const int receivers = i == 0 ? 1 : i == 1 ? 16 : 1 + int(random.below(16));
        const int groups = i < 2        ? std::min(kMostGroups, kMostRows / receivers)
                           : i % 4 == 1 ? 1
                                        : 1 + int(random.below(4));
        // Half of them lead towards the eye, all rays of each.
        bundles.push_back(raysAround(
            random, receivers, groups, {random.in(10, 54), random.in(10, 54), 0.012},
            std::exp2(random.in(-6, 2)),
            {random.in(-10, 10), random.in(-10, 10),
             i % 2 ? random.in(0.008, 0.01) : random.in(-0.002, 0.006)}));
        if (i % 3) addPlanes(random, *bundles.back());
        // Few rays go another way.
        for (int row = 0; i % 4 == 1 && groups == 1 && row < receivers; ++row)
            bundles.back()->bundle.open[row] = std::uint16_t(random.below(16));
    }
    std::vector<std::vector<std::uint16_t>> first;
    onEachTarget([&](const char* name) {
        INFO(name);
        for (std::size_t i = 0; i < bundles.size(); ++i) {
            test::Rays all = *bundles[i];
            traceNear(map, all);
            const std::vector<std::uint16_t> open(all.bundle.open,
                                                  all.bundle.open + all.rows());
            if (first.size() <= i) first.push_back(open);
            CHECK(open == first[i]);
        }
    });
    int blocked = 0, different = 0, wide = 0;
    for (std::size_t i = 0; i < bundles.size(); ++i) {
        const test::Rays& all = *bundles[i];
        wide += all.bundle.wide & 1;
        for (int row = 0; row < all.rows(); ++row) {
            for (int lane = 0; lane < kLanes; ++lane) {
                if (!all.isOpen(row, lane)) continue;
                const bool open = first[i][std::size_t(row)] >> lane & 1;
                blocked += !open;
                // The only one that is open, among the others and without them.
                test::Rays alone = all;
                alone.openOnly(row, lane);
                traceNear(map, alone);
                different += alone.isOpen(row, lane) != open;
                test::Rays single(1, 1);
                single.copyReceiver(all, row / all.bundle.groups, 0);
                single.setDelta(0, lane, all.delta(row, lane));
                single.bundle.begin[0][lane] = all.bundle.begin[row][lane];
                single.end[0][lane] = all.end[row][lane];
                single.openOnly(0, lane);
                traceNear(map, single);
                different += single.isOpen(0, lane) != open;
            }
        }
    }
    CHECK(different == 0);
    CHECK(blocked > 300);
    CHECK(wide > 0);
    CHECK(wide < int(bundles.size()));
}

TEST_CASE("numbers of 12 bits are the triangles that those of 16 are", "[trace][twin]") {
    Random random(5);
    // On a grid and on one that is 16 times as fine: no corner is rounded.
    std::vector<MapFace> brief(1), full(1);
    for (MapFace* face : {&brief[0], &full[0]}) {
        face->projection = test::plainProjection(8, 8);
        face->tiles.resize(1);
    }
    for (int i = 0; i < 100; ++i) {
        NearChunk a;
        for (int axis = 0; axis < 3; ++axis) {
            a.low[axis] = axis < 2 ? float(random.below(48)) : 0x1p-7f;
            a.step[axis] = axis < 2 ? 0x1p-8f : 0x1p-20f;
            for (int t = 0; t < NearChunk::kTriangles; ++t) {
                const std::size_t at = random.below(0xfff - 500);
                for (auto& corner : a.corner)
                    corner[axis][t] = std::uint16_t(at + random.below(501));
            }
        }
        NearChunk b = a;
        for (int axis = 0; axis < 3; ++axis) {
            b.step[axis] = a.step[axis] / 16;
            for (auto& corner : b.corner) {
                for (std::uint16_t& q : corner[axis])
                    q = std::uint16_t(16 * q);
            }
        }
        brief[0].nearField.chunks.push_back(a);
        full[0].nearField.chunks.push_back(b);
        REQUIRE(brief[0].nearField.chunks.place(std::size_t(i)).areShort());
        REQUIRE(full[0].nearField.chunks.place(std::size_t(i)).points == 48);
    }
    const auto a = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(brief));
    const auto b = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(full));
    REQUIRE(a);
    REQUIRE(b);
    int blocked = 0, left = 0;
    for (int i = 0; i < 100; ++i) {
        const auto rays = raysAround(random, 1 + int(random.below(16)), 1,
                                     {random.in(0, 64), random.in(0, 64), 0.0075},
                                     std::exp2(random.in(-6, 4)),
                                     {random.in(-4, 4), random.in(-4, 4), 0.008});
        onEachTarget([&](const char* name) {
            INFO(name);
            test::Rays one = *rays, other = *rays;
            traceNear(*a, one);
            traceNear(*b, other);
            for (int row = 0; row < rays->rows(); ++row) {
                CHECK(one.bundle.open[row] == other.bundle.open[row]);
                left += std::popcount(one.bundle.open[row]);
                blocked += kLanes - std::popcount(one.bundle.open[row]);
            }
        });
    }
    CHECK(blocked > 1000);
    CHECK(left > 1000);
}

TEST_CASE("triangles count behind begin and up to end, for open rays", "[trace][exact]") {
    // Crossed at s = 0.5 exactly; edge-on to the eye, which looks along w.
    const ShadowMap map = mapOfTriangles(
        {{glm::dvec3(4, 0, 0.0078125), {4, 8, 0.0078125}, {4, 4, 0.0625}}});
    test::Rays rays(1, 1);
    rays.setStart(0, {2, 4, 0.015625});
    for (int lane = 0; lane < kLanes; ++lane)
        rays.setDelta(0, lane, {4, 0, 0});
    const auto blocked = [&](float begin, float end) {
        rays.bundle.begin[0][3] = begin;
        rays.end[0][3] = end;
        rays.boundEnds();
        rays.openOnly(0, 3);
        traceNear(map, rays);
        return rays.bundle.open[0] == 0;
    };
    onEachTarget([&](const char* name) {
        INFO(name);
        CHECK(blocked(0.0f, 1.0f));
        CHECK(blocked(0.0f, 0.5f));
        CHECK(blocked(std::nextafter(0.5f, 0.0f), 1.0f));
        CHECK_FALSE(blocked(0.5f, 1.0f));
        CHECK_FALSE(blocked(0.0f, std::nextafter(0.5f, 0.0f)));
        CHECK_FALSE(blocked(0.75f, 0.25f));
        rays.bundle.begin[0][3] = 0.0f;
        rays.end[0][3] = 1.0f;
        rays.setDelta(0, 9, {0, 4, 0});  // beside it
        rays.setDelta(0, 10, {0, 0, 0});
        rays.boundEnds();
        rays.openAll();
        traceNear(map, rays);
        CHECK(rays.bundle.open[0] == 0x0600);
        rays.bundle.open[0] = 0x0230;
        traceNear(map, rays);
        CHECK(rays.bundle.open[0] == 0x0200);
        // As high above a plane as it reaches, and a little higher.
        rays.bundle.hasPlanes = true;
        std::fill_n(rays.bundle.planeW, kMostReceivers, 1.0f);
        rays.openOnly(0, 3);
        traceNear(map, rays, 0.046875);
        CHECK(rays.bundle.open[0] == 8);
        traceNear(map, rays, 0.0468);
        CHECK(rays.bundle.open[0] == 0);
        rays.bundle.hasPlanes = false;
    });
}

TEST_CASE("a near field without triangles blocks nothing", "[trace]") {
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    const auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    Random random(4);
    auto rays = raysAround(random, 5, 2, {4, 4, 0.01}, 1.0, {3, 3, 0.01});
    traceNear(*map, *rays);
    for (int row = 0; row < rays->rows(); ++row)
        CHECK(rays->bundle.open[row] == 0xffff);
}
