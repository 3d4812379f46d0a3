// Bundles of rays through patches: closed forms, the scalar trace, and the same answer
// whichever receivers stand beside.
#include "trace/patch_trace.h"

#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <glm/common.hpp>
#include <numeric>
#include <vector>

#include "map_fixture.h"
#include "trace/bundle_fixture.h"
#include "trace/each_target.h"
#include "trace/traverse.h"

using namespace mtsm;
using test::mapOf;
using test::onEachTarget;
using test::Random;
using test::Rays;
using test::TestLayer;
using trace::kLanes;
using trace::kMostReceivers;
using trace::kMostRows;
using trace::PatchTree;

namespace {

constexpr std::uint32_t kWidth = 150, kHeight = 130;

/// A wall in straight space, and which pixels of it are there.
struct Wall {
    double w = 0.25, perU = 0.0, perV = 0.0;
    std::function<bool(int, int)> covered = [](int, int) { return true; };

    [[nodiscard]] double at(double u, double v) const {
        return w + perU * (u - 0.5 * kWidth) + perV * (v - 0.5 * kHeight);
    }
    [[nodiscard]] bool isCovered(int x, int y) const {
        return x >= 0 && y >= 0 && x < int(kWidth) && y < int(kHeight) && covered(x, y);
    }
    [[nodiscard]] ShadowMap map() const {
        return mapOf(test::plainInfo(kWidth, kHeight, 64),
                     test::plainProjection(kWidth, kHeight),
                     [&](std::uint32_t x, std::uint32_t y) {
                         if (!covered(int(x), int(y))) return std::vector<TestLayer>{};
                         return std::vector<TestLayer>{
                             {float(1.0 / at(x + 0.5, y + 0.5)), 0.0f, 1}};
                     });
    }
};

/// What a pixel's side is in w at the walls' depth.
constexpr double kFootprint = 2.0 / kWidth * 0.25;

/// Walls that face the eye, and tilted ones.
std::vector<Wall> walls() {
    std::vector<Wall> all(3);
    all[1].perU = 0.5 * kFootprint;
    all[2].perU = -0.2 * kFootprint;
    all[2].perV = 0.4 * kFootprint;
    return all;
}

PatchTree treeOf(const ShadowMap& map) {
    return PatchTree::build(map, 0, {});
}

/// Rays from places below a wall to others above it; the finest patches answer.
Rays raysUp(Random& random, int receivers, int groups, double reach = 20.0) {
    Rays rays(receivers, groups);
    const double u = random.in(0, kWidth), v = random.in(0, kHeight);
    std::vector<glm::dvec3> parts;
    for (int group = 0; group < groups; ++group)
        parts.emplace_back(u + random.in(-reach, reach), v + random.in(-reach, reach),
                           0.7);
    for (int receiver = 0; receiver < receivers; ++receiver) {
        rays.setStart(receiver, {u + random.in(-9, 9), v + random.in(-9, 9),
                                 random.in(0.04, 0.06)});
        rays.bundle.spread[receiver] = 0.0f;
        rays.bundle.topLevel[receiver] = 0;
        for (int group = 0; group < groups; ++group) {
            const int row = rays.bundle.row(receiver, group);
            for (int lane = 0; lane < kLanes; ++lane) {
                const glm::dvec3 end =
                    parts[std::size_t(group)] +
                    glm::dvec3(random.in(-6, 6), random.in(-6, 6), random.in(0, 0.1));
                rays.setDelta(row, lane, end - rays.start(receiver));
                rays.bundle.begin[row][lane] = 0x1p-40f;
                rays.bundle.threshold[row][lane] = std::uint8_t(random.below(16));
            }
        }
    }
    rays.bound();
    return rays;
}

void setCoarseness(Rays& rays, double spread, int topLevel) {
    std::fill_n(rays.bundle.spread, kMostReceivers, float(spread));
    std::fill_n(rays.bundle.topLevel, kMostReceivers, std::uint8_t(topLevel));
}

/// Where a ray crosses a wall's plane, and at which s.
struct Crossing {
    double u, v, s;

    /// Are all pixels so near to it covered or all not?
    [[nodiscard]] bool isClear(const Wall& wall, double margin) const {
        const bool covered = wall.isCovered(int(std::floor(u)), int(std::floor(v)));
        for (int y = int(std::floor(v - margin)); y <= int(std::floor(v + margin)); ++y) {
            for (int x = int(std::floor(u - margin)); x <= int(std::floor(u + margin));
                 ++x) {
                if (wall.isCovered(x, y) != covered) return false;
            }
        }
        return true;
    }
    [[nodiscard]] bool isBlocked(const Wall& wall) const {
        return wall.isCovered(int(std::floor(u)), int(std::floor(v)));
    }
};

Crossing crossingOf(const Wall& wall, const Rays& rays, int row, int lane) {
    const glm::dvec3 start = rays.start(row / rays.bundle.groups);
    const glm::dvec3 d = rays.delta(row, lane);
    const double s =
        (wall.at(start.x, start.y) - start.z) / (d.z - wall.perU * d.x - wall.perV * d.y);
    return {start.x + s * d.x, start.y + s * d.y, s};
}

/// How many rays more are blocked than a wall blocks of those that cross it not within a
/// margin, pixels, of an edge; `near` takes the others.
struct Disagreement {
    int blocked = 0, passed = 0, wrong = 0, near = 0;
    double nearBlocked = 0, nearExpected = 0;

    void add(const Wall& wall, const Rays& after, double margin) {
        for (int row = 0; row < after.rows(); ++row) {
            for (int lane = 0; lane < kLanes; ++lane) {
                const Crossing at = crossingOf(wall, after, row, lane);
                const bool expected = at.isBlocked(wall),
                           found = !after.isOpen(row, lane);
                if (!at.isClear(wall, margin)) {
                    ++near;
                    nearBlocked += found;
                    nearExpected += expected;
                    continue;
                }
                wrong += found != expected;
                ++(expected ? blocked : passed);
            }
        }
    }
};

std::vector<std::uint16_t> openOf(const Rays& rays) {
    return {rays.bundle.open, rays.bundle.open + rays.rows()};
}

Rays traced(const PatchTree& tree, Rays rays) {
    trace::tracePatches(tree, rays.bundle);
    return rays;
}

int openRays(const Rays& rays) {
    int count = 0;
    for (int row = 0; row < rays.rows(); ++row)
        count += std::popcount(rays.bundle.open[row]);
    return count;
}

/// Smooth islands in several layers, one over the other.
struct Islands {
    Random random;
    double phase[3][4];

    explicit Islands(std::uint64_t seed) : random(seed) {
        for (auto& layer : phase) {
            for (double& p : layer)
                p = random.in(0, 6.28);
        }
    }
    [[nodiscard]] double height(int k, double u, double v) const {
        const double* p = phase[k];
        return 0.16 + 0.1 * k +
               kFootprint *
                   (6 * std::sin(0.06 * u + p[0]) + 5 * std::sin(0.08 * v + p[1]));
    }
    [[nodiscard]] bool isThere(int k, double u, double v) const {
        const double* p = phase[k];
        return std::sin(0.05 * u + p[2]) + std::sin(0.07 * v + p[3]) > 0.2;
    }
    [[nodiscard]] ShadowMap map(int layers) const {
        return mapOf(test::plainInfo(kWidth, kHeight, 64),
                     test::plainProjection(kWidth, kHeight),
                     [&](std::uint32_t x, std::uint32_t y) {
                         std::vector<TestLayer> pixel;
                         for (int k = layers - 1; k >= 0; --k) {  // from the eye
                             const double w = height(k, x + 0.5, y + 0.5);
                             if (isThere(k, x + 0.5, y + 0.5))
                                 pixel.push_back({float(1.0 / w), 0.0f, 1});
                         }
                         return pixel;
                     });
    }
};

/// Rays that are answered as coarsely as they happen to be, with planes or without, some
/// of them away from the eye.
Rays anyRays(Random& random, int receivers, int groups) {
    Rays rays = raysUp(random, receivers, groups, 40.0);
    rays.bundle.hasPlanes = random.below(2) == 0;
    rays.bundle.planeHeight = float(0.3 * kFootprint);
    for (int receiver = 0; receiver < receivers; ++receiver) {
        trace::RayBundle& b = rays.bundle;
        if (random.below(12) == 0)
            b.dw[b.row(receiver, 0)][3] = -0.02f;  // one ray leads away from the eye
        b.planeU[receiver] = float(random.in(-1, 1) * kFootprint);
        b.planeV[receiver] = float(random.in(-1, 1) * kFootprint);
        b.planeW[receiver] = 1.0f;
    }
    rays.bound();
    for (int receiver = 0; receiver < receivers; ++receiver) {
        rays.bundle.topLevel[receiver] = std::uint8_t(random.below(7));
        rays.bundle.spread[receiver] = float(std::exp2(random.in(-1, 6)));
        rays.bundle.rise[receiver] = random.below(2) ? 0.0f : 0.02f;
    }
    for (int i = receivers; i < kMostReceivers; ++i)
        rays.copyReceiver(rays, 0, i);
    return rays;
}

/// Of texels of level 2 (4 x 4 pixels) that lie in both of two walls, one well behind the
/// other: those for which not as many of 16 rays are blocked, one of each threshold, as
/// there are pixels in either. A fifteenth pixel is not told from a sixteenth.
int texelsOff(const std::function<bool(int, int)>& front,
              const std::function<bool(int, int)>& back) {
    const auto at = [&](const std::function<bool(int, int)>& covers, std::uint32_t x,
                        std::uint32_t y) { return covers(int(x), int(y)); };
    const ShadowMap map = mapOf(test::plainInfo(kWidth, kHeight, 64),
                                test::plainProjection(kWidth, kHeight),
                                [&](std::uint32_t x, std::uint32_t y) {
                                    std::vector<TestLayer> layers;
                                    if (at(front, x, y))
                                        layers.push_back({float(1.0 / 0.5), 0.0f, 1});
                                    if (at(back, x, y))
                                        layers.push_back({float(1.0 / 0.2), 0.0f, 1});
                                    return layers;
                                });
    const PatchTree tree = treeOf(map);
    int off = 0;
    for (int y = 0; y + 4 <= int(kHeight); y += 4) {
        for (int x = 0; x + 4 <= int(kWidth); x += 4) {
            int some[2] = {}, either = 0;
            for (int i = 0; i < 16; ++i) {
                const int u = x + i % 4, v = y + i / 4;
                some[0] += front(u, v), some[1] += back(u, v);
                either += front(u, v) || back(u, v);
            }
            if (some[0] == 15 || some[1] == 15) continue;
            Rays rays(1, 1);
            rays.setStart(0, {x + 2.0, y + 2.0, 0.05});
            setCoarseness(rays, 1000.0, 2);
            for (int lane = 0; lane < kLanes; ++lane) {
                rays.setDelta(0, lane, {0.0, 0.0, 0.6});
                rays.bundle.begin[0][lane] = 0x1p-40f;
                rays.bundle.threshold[0][lane] = std::uint8_t(lane);
            }
            rays.bound();
            off += 16 - std::popcount(traced(tree, rays).bundle.open[0]) != either;
        }
    }
    return off;
}

}  // namespace

TEST_CASE("surfaces that share a texel block what their pixels do together",
          "[trace][exact]") {
    const auto disk = [](int x, int y) {
        return std::hypot(x + 0.5 - 71.3, y + 0.5 - 63.8) < 50.2;
    };
    const auto beside = [&](int x, int y) { return !disk(x, y); };
    const auto none = [](int, int) { return false; };
    const auto left = [](int x, int y) { return x < 40.0 + 0.3 * y; };
    const auto further = [](int x, int y) { return x < 41.6 + 0.3 * y; };
    onEachTarget([&](const char* name) {
        INFO(name);
        CHECK(texelsOff(disk, none) == 0);
        CHECK(texelsOff(disk, disk) == 0);     // front and back of a body
        CHECK(texelsOff(disk, beside) == 0);   // halves of a surface
        CHECK(texelsOff(further, left) == 0);  // the back of it is a little smaller
    });
}

TEST_CASE("rays are blocked by the pixels of a wall that they cross", "[trace][exact]") {
    Random random(1);
    Disagreement found;
    for (Wall wall : walls()) {
        for (const bool hole : {false, true}) {
            wall.covered = [hole](int x, int y) {
                if (!hole) return x < 71;
                return !(x >= 40 && x < 95 && y >= 37 && y < 90);
            };
            const PatchTree tree = treeOf(wall.map());
            for (int i = 0; i < 100; ++i) {
                const int receivers = 1 + int(random.below(16));
                const Rays rays = raysUp(random, receivers, 1 + int(random.below(4)));
                found.add(wall, traced(tree, rays), 0.01);
            }
        }
    }
    CHECK(found.wrong == 0);
    CHECK(found.blocked > 10000);
    CHECK(found.passed > 10000);
    CHECK(found.near < found.passed / 50);
}

TEST_CASE(
    "far from its edges a wall is exact however coarsely it answers, and near them "
    "it is in the mean",
    "[trace][exact][statistical]") {
    Random random(2);
    for (Wall wall : walls()) {
        wall.covered = [](int x, int y) {
            return std::sin(0.03 * x) + std::cos(0.04 * y) > -0.3;
        };
        const PatchTree tree = treeOf(wall.map());
        for (const double dense : {2.0, 4.0, 8.0}) {
            Disagreement found;
            for (int i = 0; i < 50; ++i) {
                Rays rays = raysUp(random, 16, 2);
                // So far apart where they meet the wall's middle.
                setCoarseness(rays, dense / 0.2, 20);
                // Rays that lie lower, or meet the wall higher up, are less dense.
                found.add(wall, traced(tree, rays), 2.0 * dense);
            }
            INFO("dense " << dense << " tilt " << wall.perU << " " << wall.perV);
            CHECK(found.wrong == 0);
            CHECK(found.blocked + found.passed > 1000);
            CHECK(found.near > 1000);
            INFO(found.nearBlocked << " of " << found.nearExpected << " near "
                                   << found.near);
            // Rays of a receiver meet the same few texels: fewer independent ones.
            CHECK(std::abs(found.nearBlocked - found.nearExpected) < 0.01 * found.near);
        }
    }
}

TEST_CASE("rough surfaces block by their pixels, each on a plane of its own",
          "[trace][twin]") {
    Random random(12);
    const ShadowMap map = mapOf(
        test::plainInfo(kWidth, kHeight, 64), test::plainProjection(kWidth, kHeight),
        [&](std::uint32_t x, std::uint32_t y) {
            if ((x / 5 + y / 3) % 4 == 0) return std::vector<TestLayer>{};
            const double w = 0.25 + 1.4 * kFootprint * random.in(-1, 1);
            return std::vector<TestLayer>{{float(1.0 / w), 0.0f, 1}};
        });
    const PatchTree tree = treeOf(map);
    // All pixels of its leaves: their planes.
    struct Pixel {
        double u, v, w, perU, perV;
    };
    std::vector<Pixel> pixels;
    std::size_t bumpy = 0;
    const auto add = [&](const trace::Patch& g, double u, double v, double above) {
        pixels.push_back(
            {u, v,
             g.w + g.gradientU * (u + 0.5 - g.u) + g.gradientV * (v + 0.5 - g.v) + above,
             g.gradientU, g.gradientV});
    };
    const auto addLeaf = [&](const trace::Patch& g) {
        if (!g.bumpy) {
            const double u = std::floor(g.u / 16) * 16, v = std::floor(g.v / 16) * 16;
            for (int t = 0; t < 16 * g.rows(); ++t) {
                if (tree.covers()[g.cover + std::uint32_t(t / 16)] >> (t % 16) & 1)
                    add(g, u + t % 16, v + g.firstRow() + t / 16, 0.0);
            }
            return;
        }
        const trace::BumpPlane bumps = tree.bumps(g.cover);
        const double u = std::floor(g.u / 4) * 4, v = std::floor(g.v / 4) * 4;
        for (int t = 0; t < 16; ++t) {
            if (bumps.offset[t] == trace::BumpPlane::kNone) continue;
            add(g, u + t % 4, v + t / 4,
                double(g.residual) * bumps.offset[t] / trace::BumpPlane::kSteps);
            ++bumpy;
        }
    };
    std::vector<trace::PatchList> waiting = tree.levels().back().tiles;
    while (!waiting.empty()) {
        const trace::PatchList list = waiting.back();
        waiting.pop_back();
        for (std::uint32_t n = 0; n < 4 * list.groups; ++n) {
            if (!(list.slotsOf(n / 4) >> (n % 4) & 1)) continue;
            const trace::Patch g = tree.groups()[list.group + n / 4].patch(int(n % 4));
            if (g.isLeaf())
                addLeaf(g);
            else
                waiting.push_back(g.children);
        }
    }
    REQUIRE(pixels.size() == map.layerCount());
    CHECK(bumpy > pixels.size() / 2);
    onEachTarget([&](const char* target) {
        INFO(target);
        int blocked = 0, passed = 0, wrong = 0;
        for (int round = 0; round < 12; ++round) {
            const Rays rays = raysUp(random, 4, 2), after = traced(tree, rays);
            for (int row = 0; row < rays.rows(); ++row) {
                const glm::dvec3 start = rays.start(row / 2);
                for (int lane = 0; lane < kLanes; ++lane) {
                    const glm::dvec3 d = rays.delta(row, lane);
                    bool hit = false, close = false;
                    for (const Pixel& p : pixels) {
                        const double s = (p.w + p.perU * (start.x - p.u - 0.5) +
                                          p.perV * (start.y - p.v - 0.5) - start.z) /
                                         (d.z - p.perU * d.x - p.perV * d.y);
                        const double x = std::abs(start.x + s * d.x - p.u - 0.5),
                                     y = std::abs(start.y + s * d.y - p.v - 0.5);
                        const double out = std::max(x, y) - 0.5;
                        hit = hit || (s > 0 && s <= 1 && out < -1e-3);
                        close = close || std::abs(out) <= 1e-3;
                    }
                    if (close && !hit) continue;
                    wrong += after.isOpen(row, lane) == hit;
                    ++(hit ? blocked : passed);
                }
            }
        }
        CHECK(wrong == 0);
        CHECK(blocked > 300);
        CHECK(passed > 100);
    });
}

TEST_CASE("what a sheet closes early is what its pixels block", "[trace][exact]") {
    Random random(3);
    for (const Wall& wall : walls()) {
        const PatchTree tree = treeOf(wall.map());
        // The whole wall is one, but for the coarsest texels at its border.
        const PatchTree::Level& level = tree.levels()[1];
        CHECK(tree.groups()[level.tiles[0].group].patch(0).sheet);
        Disagreement found;
        int different = 0;
        for (int i = 0; i < 100; ++i) {
            Rays rays = raysUp(random, 16, 2);
            const Rays fine = traced(tree, rays);
            setCoarseness(rays, 0.0, 20);
            const Rays coarse = traced(tree, rays);
            found.add(wall, coarse, 0.01);
            for (int row = 0; row < rays.rows(); ++row) {
                for (int lane = 0; lane < kLanes; ++lane) {
                    if (crossingOf(wall, rays, row, lane).isClear(wall, 0.01))
                        different += fine.isOpen(row, lane) != coarse.isOpen(row, lane);
                }
            }
        }
        CHECK(different == 0);
        CHECK(found.wrong == 0);
        CHECK(found.blocked > 10000);
        CHECK(found.passed > 1000);
    }
}

TEST_CASE("few rays are answered otherwise than by the scalar trace", "[trace][twin]") {
    const Islands islands(4);
    Random random(5);
    for (const int layers : {1, 3}) {
        const ShadowMap map = islands.map(layers);
        const PatchTree tree = treeOf(map);
        const Projection& p = map.projection(0);
        int rays = 0, blocked = 0, only[2] = {};
        for (int i = 0; i < 100; ++i) {
            const Rays before = raysUp(random, 16, 1, 40.0);
            const Rays after = traced(tree, before);
            for (int row = 0; row < after.rows(); ++row) {
                for (int lane = 0; lane < kLanes; ++lane) {
                    const glm::dvec3 start = before.start(row);
                    const glm::dvec3 end = start + before.delta(row, lane);
                    trace::Ray ray;
                    ray.origin = p.worldFromLight(
                        p.lightFromRaster(glm::dvec2(start), 1.0 / start.z));
                    ray.delta = p.worldFromLight(
                                    p.lightFromRaster(glm::dvec2(end), 1.0 / end.z)) -
                                ray.origin;
                    trace::TraceOptions options;
                    options.bias.perDepth = 0.5 * p.pixelFootprint(1.0);
                    const bool scalar = trace::traceRay(map, ray, options)[0] == 0.0f;
                    const bool found = !after.isOpen(row, lane);
                    ++rays;
                    blocked += scalar;
                    if (scalar != found) ++only[found];
                }
            }
        }
        INFO(layers << " layers, " << rays << " rays, " << blocked << " blocked, only by "
                    << "the scalar trace " << only[0] << ", only by patches " << only[1]);
        CHECK(blocked > rays / 5);
        CHECK(blocked < rays * 9 / 10);
        CHECK(only[0] + only[1] < rays / 200);
    }
}

TEST_CASE("a receiver's answers do not depend on the others", "[trace][twin]") {
    const ShadowMap map = Islands(6).map(3);
    const PatchTree tree = treeOf(map);
    Random random(7);
    int blocked = 0, open = 0, different = 0, wide = 0;
    onEachTarget([&](const char*) {
        for (int i = 0; i < 60; ++i) {
            const Rays all = anyRays(random, 16,
                                     i % 4 == 0   ? 1
                                     : i % 4 == 1 ? 16
                                                  : 1 + int(random.below(4)));
            wide += all.bundle.wide != 0;
            const Rays together = traced(tree, all);
            const int left = openRays(together);
            open += left;
            blocked += kLanes * all.rows() - left;
            const auto compare = [&](const std::vector<int>& receivers) {
                const Rays some = traced(tree, all.only(receivers));
                for (int k = 0; k < some.bundle.receivers; ++k) {
                    for (int group = 0; group < all.bundle.groups; ++group) {
                        const int a = all.bundle.row(receivers[std::size_t(k)], group);
                        different += std::popcount(
                            std::uint16_t(together.bundle.open[a] ^
                                          some.bundle.open[some.bundle.row(k, group)]));
                    }
                }
            };
            std::vector<int> order(16);
            std::iota(order.begin(), order.end(), 0);
            for (int k = 0; k < 16; ++k)
                compare({k});
            for (std::size_t k = 15; k > 0; --k)
                std::swap(order[k], order[random.below(k + 1)]);
            compare(order);
            compare({order.begin(), order.begin() + 5});
        }
    });
    CHECK(different == 0);
    CHECK(blocked > 10000);
    CHECK(open > 10000);
    CHECK(wide > 0);
}

TEST_CASE("processors differ in no more than rounding", "[trace][twin]") {
    const ShadowMap map = Islands(8).map(3);
    const PatchTree tree = treeOf(map);
    std::vector<std::uint16_t> first;
    onEachTarget([&](const char* name) {
        Random random(9);
        std::vector<std::uint16_t> open;
        for (int i = 0; i < 200; ++i) {
            const std::vector<std::uint16_t> some =
                openOf(traced(tree, anyRays(random, 16, 1 + i % 4)));
            open.insert(open.end(), some.begin(), some.end());
        }
        if (first.empty()) first = open;
        int different = 0;
        for (std::size_t i = 0; i < open.size(); ++i)
            different += std::popcount(std::uint16_t(open[i] ^ first[i]));
        INFO(name << ": " << different << " of " << kLanes * open.size());
        // Where a ray passes within rounding (2^-20 or so) of a texel's edge.
        CHECK(different < int(kLanes * open.size() / 10000));
    });
}

TEST_CASE("a hull that meets nothing has no rays that are blocked", "[trace][twin]") {
    Islands islands(9);
    int free = 0, met = 0;
    for (int layers = 1; layers <= 3; ++layers) {
        const PatchTree tree = treeOf(islands.map(layers));
        for (int round = 0; round < 1500; ++round) {
            const double reach = std::exp2(islands.random.in(-3, 4));
            Rays rays = raysUp(islands.random, 6, 2, reach);
            // Coarse answers are not always those of the pixels.
            const double spread = round % 2 ? std::exp2(islands.random.in(2, 9)) : 0.0;
            const trace::RayBundle& b = rays.bundle;
            int level = 0;
            for (double side = 16;
                 round % 2 &&
                 side < (b.slopeHighU[0] - b.slopeLowU[0]) * (tree.highest() - b.w[0]);
                 side *= 2)
                ++level;
            setCoarseness(rays, spread, level);
            trace::RayHull hull{
                b.u[0],         b.u[0],          b.v[0],         b.v[0],
                b.w[0],         b.w[0],          b.slopeLowU[0], b.slopeHighU[0],
                b.slopeLowV[0], b.slopeHighV[0], 0.0f,           float(spread)};
            for (int i = 1; i < 6; ++i) {
                hull.uLow = std::min(hull.uLow, b.u[i]);
                hull.uHigh = std::max(hull.uHigh, b.u[i]);
                hull.vLow = std::min(hull.vLow, b.v[i]);
                hull.vHigh = std::max(hull.vHigh, b.v[i]);
                hull.wLow = std::min(hull.wLow, b.w[i]);
                hull.wHigh = std::max(hull.wHigh, b.w[i]);
                hull.slopeLowU = std::min(hull.slopeLowU, b.slopeLowU[i]);
                hull.slopeHighU = std::max(hull.slopeHighU, b.slopeHighU[i]);
                hull.slopeLowV = std::min(hull.slopeLowV, b.slopeLowV[i]);
                hull.slopeHighV = std::max(hull.slopeHighV, b.slopeHighV[i]);
            }
            hull.wFirst = hull.wLow;
            const bool blocked = openRays(traced(tree, rays)) < openRays(rays);
            const bool may = trace::mayMeet(tree, hull);
            if (blocked) CHECK(may);
            ++(may ? met : free);
        }
    }
    CHECK(free > 300);
    CHECK(met > 300);
}

TEST_CASE("what does not rise above a tangent plane does not block", "[trace][exact]") {
    const Wall wall = walls()[0];
    const PatchTree tree = treeOf(wall.map());
    Random random(10);
    Rays rays = raysUp(random, 16, 2);
    const Rays without = traced(tree, rays);
    rays.bundle.hasPlanes = true;
    for (int i = 0; i < kMostReceivers; ++i) {
        rays.bundle.planeU[i] = rays.bundle.planeV[i] = 0.0f;
        rays.bundle.planeW[i] = 1.0f;
    }
    rays.bundle.planeHeight = 0.18f;  // starts lie 0.19 to 0.21 below the wall
    CHECK(openOf(traced(tree, rays)) == openOf(without));
    rays.bundle.planeHeight = 0.22f;
    CHECK(openRays(traced(tree, rays)) == kLanes * rays.rows());
}

TEST_CASE("a wall counts behind begin and up to the ray's end", "[trace][exact]") {
    const Wall wall;
    const PatchTree tree = treeOf(wall.map());
    onEachTarget([&](const char* name) {
        INFO(name);
        Rays rays(1, 1);
        rays.setStart(0, {70.3, 60.6, 0.125});
        rays.bundle.spread[0] = 0.0f;
        rays.bundle.topLevel[0] = 0;
        for (int lane = 0; lane < kLanes; ++lane) {
            // Crossed at s = 16 / (16 + lane - 8): 8 ends at the wall, 0 to 7 below it.
            const double rise = 0.125 * (16 + lane - 8) / 16.0;
            rays.setDelta(0, lane, {1.3, -2.1, lane == 8 ? rise * (1 + 1e-6) : rise});
            rays.bundle.begin[0][lane] = lane == 15 ? 0.7f : lane == 14 ? 0.75f : 0.0f;
        }
        rays.bound();
        // Of lanes 14 and 15 the wall lies at 0.727 and 0.696.
        CHECK(traced(tree, rays).bundle.open[0] == 0xc0ff);
        rays.bundle.begin[0][15] = 0.69f;
        CHECK(traced(tree, rays).bundle.open[0] == 0x40ff);
    });
}

TEST_CASE("odd rays are answered: outside, beyond, within a layer, level, still",
          "[trace][bad-input]") {
    const Wall flat = walls()[0];
    const ShadowMap wallMap = flat.map(), islands = Islands(11).map(3);
    const ShadowMap empty =
        mapOf(test::plainInfo(40, 24, 8), test::plainProjection(40, 24),
              [](auto, auto) { return std::vector<TestLayer>{}; });
    const ShadowMap pixel =
        mapOf(test::plainInfo(1, 1, 8), test::plainProjection(1, 1), [](auto, auto) {
            return std::vector<TestLayer>{{4.0f, 0.0f, 1}};
        });
    const PatchTree trees[] = {treeOf(wallMap), treeOf(islands), treeOf(empty),
                               treeOf(pixel)};
    const glm::dvec3 starts[] = {{70, 60, 0.25},  // within the wall
                                 {70, 60, 0.05},  // below it
                                 {70, 60, 0.8},   // above all
                                 {70, 60, 0.0},   // infinitely far
                                 {70, 60, -1.0},  // behind the eye of a perspective view
                                 {-1e6, 60, 0.05},      // outside
                                 {150, 130, 0.05},      // at the corner
                                 {1e30, -1e30, 1e30}};  // where products overflow
    const glm::dvec3 ways[] = {{0, 0, 0},    {0, 0, 0.5},  {3, 0, 0},
                               {0, -3, 0},   {5, 5, -0.1}, {1e6, 0, 0.5},
                               {-9, 4, 0.3}, {0, 0, 1e30}, {1e30, 1e30, 1e-30}};
    onEachTarget([&](const char* name) {
        INFO(name);
        for (const PatchTree& tree : trees) {
            for (const glm::dvec3 start : starts) {
                for (const glm::dvec3 way : ways) {
                    Rays rays(1, 1);
                    rays.setStart(0, start);
                    setCoarseness(rays, 0.1, 20);
                    for (int lane = 0; lane < kLanes; ++lane) {
                        rays.setDelta(0, lane, way);
                        rays.bundle.begin[0][lane] = 0x1p-40f;
                        rays.bundle.threshold[0][lane] = std::uint8_t(lane);
                    }
                    rays.bound();
                    rays.bundle.open[0] = 0x5555;  // the others stay closed
                    const std::uint16_t left = traced(tree, rays).bundle.open[0];
                    CHECK((left & 0xaaaa) == 0);
                    if (&tree == &trees[2] || way == glm::dvec3(0.0) || start.z > 0.7)
                        CHECK(left == 0x5555);
                }
            }
        }
        // From the wall itself nothing of it is met, by level rays neither.
        Rays rays(1, 1);
        rays.setStart(0, {70, 60, 0.25});
        setCoarseness(rays, 0.0, 0);
        for (int lane = 0; lane < kLanes; ++lane) {
            rays.setDelta(0, lane, {lane - 7.5, 3.0, lane % 2 ? 0.0 : 0.1});
            rays.bundle.begin[0][lane] = 0x1p-40f;
        }
        rays.bound();
        CHECK(traced(trees[0], rays).bundle.open[0] == 0xffff);
    });
}
