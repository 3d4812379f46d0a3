// The patch tree: its patches share out the samples of a map, and say where they are.
#include "trace/patch_tree.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "map_fixture.h"
#include "trace/bundle_fixture.h"

using namespace mtsm;
using test::mapOf;
using test::Random;
using test::TestLayer;
using trace::kTexels;
using trace::Patch;
using trace::PatchList;
using trace::PatchTree;

namespace {

/// One layer of a map, in straight space.
struct Sample {
    std::uint32_t x = 0, y = 0;
    double w = 0.0;

    friend bool operator<(const Sample& a, const Sample& b) {
        return std::tie(a.y, a.x, a.w) < std::tie(b.y, b.x, b.w);
    }
};

/// A patch is named by its group and its place in it.
using PatchName = std::pair<std::uint32_t, int>;

double planeAt(const Patch& g, double u, double v) {
    return g.w + g.gradientU * (u - g.u) + g.gradientV * (v - g.v);
}

/// Rounding of planes in float.
double slack(const Patch& g) {
    return 4e-7 *
           (std::abs(g.w) + kTexels * (std::abs(g.gradientU) + std::abs(g.gradientV)));
}

/// Left edge of the tile that a box lies in.
std::uint32_t cornerOf(float centre, std::uint8_t level) {
    const std::uint32_t side = std::uint32_t(kTexels) << level;
    return std::uint32_t(centre) / side * side;
}

class Checker {
  public:
    explicit Checker(const ShadowMap& map)
        : map_(map), tree_(PatchTree::build(map, 0, {})) {
        perspective_ = map.projection(0).kind == ProjectionKind::perspective;
    }

    /// Every level by itself is the whole map.
    void run() {
        for (const PatchTree::Level& level : tree_.levels()) {
            if (&level == &tree_.levels()[0] && tree_.levels().size() > 1) {
                CHECK(level.tiles.empty());
                continue;
            }
            CHECK(level.tiles.size() == std::size_t(level.columns) * level.rows);
            CHECK(level.columns * level.side >= map_.info().width);
            CHECK(level.rows * level.side >= map_.info().height);
            leaves_.clear();
            for (const PatchList& tile : level.tiles)
                eachPatch(tile, [&](PatchName patch) { findLeaves(patch); });
            shareOut();
            for (const PatchList& tile : level.tiles)
                eachPatch(tile, [&](PatchName patch) {
                    const std::vector<Sample> samples = samplesOf(patch);
                    addShares(patch, pixelsOf(samples));
                });
        }
        CHECK(tree_.levels().back().tiles.size() == 1);
        std::string failures;
        for (const auto& [what, count] : failures_)
            failures += std::to_string(count) + " times not: " + what + "; ";
        CHECK(failures == "");
    }

    double coveredTexels = 0.0, covered = 0.0;  // coarse: as stored, and truly
    double variance = 0.0;                      // of their difference, if rounded by lot

  private:
    template <typename Visit>
    void eachPatch(const PatchList& list, const Visit& visit) const {
        for (std::uint32_t n = 0; n < 4 * list.groups; ++n) {
            if (list.slotsOf(n / 4) >> (n % 4) & 1)
                visit(PatchName(list.group + n / 4, int(n % 4)));
        }
    }
    [[nodiscard]] Patch patchOf(PatchName patch) const {
        return tree_.groups()[patch.first].patch(patch.second);
    }
    /// Of plane k of a patch's coverage.
    [[nodiscard]] bool bitOf(const Patch& g, int k, std::uint32_t x,
                             std::uint32_t y) const {
        const int row = int(y) - g.firstRow();
        if (row < 0 || row >= g.rows()) return false;
        return tree_.covers()[g.cover + std::uint32_t(k * g.rows() + row)] >> x & 1;
    }
    void expect(bool holds, const char* what) {
        if (!holds) ++failures_[what];
    }

    void findLeaves(PatchName patch) {
        const Patch g = patchOf(patch);
        if (!g.isLeaf()) {
            eachPatch(g.children, [&](PatchName child) { findLeaves(child); });
            return;
        }
        expect(g.level == 0 && !g.shared, "leaves are of pixels");
        for (std::uint32_t p = 0; p < 256; ++p) {
            if (isCovered(patch, p))
                leaves_[{cornerOf(g.u, 0) + p % 16, cornerOf(g.v, 0) + p / 16}].push_back(
                    patch);
        }
    }

    /// What a bumpy leaf says of pixel p of its tile.
    [[nodiscard]] std::int16_t bumpOf(PatchName leaf, std::uint32_t p) const {
        const Patch g = patchOf(leaf);
        const std::uint32_t x = cornerOf(g.u, 0) + p % 16, y = cornerOf(g.v, 0) + p / 16;
        if (x / 4 != std::uint32_t(g.u) / 4 || y / 4 != std::uint32_t(g.v) / 4)
            return trace::BumpPlane::kNone;
        return tree_.bumps(g.cover).offset[y % 4 * 4 + x % 4];
    }
    [[nodiscard]] bool isCovered(PatchName patch, std::uint32_t p) const {
        if (patchOf(patch).bumpy) return bumpOf(patch, p) != trace::BumpPlane::kNone;
        return bitOf(patchOf(patch), 0, p % 16, p / 16);
    }

    [[nodiscard]] bool holds(PatchName leaf, const Sample& s) const {
        const Patch g = patchOf(leaf);
        if (g.bumpy) {
            const double bump = bumpOf(leaf, s.y % 16 * 16 + s.x % 16) *
                                double(g.residual) / trace::BumpPlane::kSteps;
            return std::abs(planeAt(g, s.x + 0.5, s.y + 0.5) + bump - s.w) <=
                   slack(g) + 3e-5 * g.residual;
        }
        const double away = std::abs(planeAt(g, s.x + 0.5, s.y + 0.5) - s.w);
        return away <= g.residual + slack(g) && s.w >= g.low && s.w <= g.high;
    }

    /// Finds for each sample the leaf that it is in: some order of the pixel's leaves
    /// must hold its samples, one each.
    void shareOut() {
        sampleOf_.clear();
        std::size_t pixels = 0;
        for (std::uint32_t y = 0; y < map_.info().height; ++y) {
            for (std::uint32_t x = 0; x < map_.info().width; ++x) {
                const PixelLayers layers = map_.pixel(0, x, y);
                if (layers.count == 0) continue;
                ++pixels;
                std::vector<PatchName> leaves = leaves_[{x, y}];
                expect(leaves.size() == layers.count, "a leaf for each sample");
                if (leaves.size() != layers.count) continue;
                std::vector<Sample> samples;
                for (std::uint32_t k = 0; k < layers.count; ++k)
                    samples.push_back({x, y, depthOf(layers.z[k])});
                std::sort(leaves.begin(), leaves.end());
                bool fits = false;
                do {
                    fits = true;
                    for (std::size_t k = 0; k < leaves.size() && fits; ++k)
                        fits = holds(leaves[k], samples[k]);
                } while (!fits && std::next_permutation(leaves.begin(), leaves.end()));
                expect(fits, "leaves hold their samples");
                for (std::size_t k = 0; k < leaves.size(); ++k)
                    sampleOf_[leaves[k]].push_back(samples[k]);
            }
        }
        expect(leaves_.size() == pixels, "no leaf where there is no sample");
    }
    [[nodiscard]] double depthOf(float z) const { return perspective_ ? 1.0f / z : -z; }

    /// Checks a patch against all samples in it.
    std::vector<Sample> samplesOf(PatchName patch) {
        const Patch g = patchOf(patch);
        std::vector<Sample> samples;
        if (g.isLeaf()) samples = sampleOf_[patch];
        eachPatch(g.children, [&](PatchName child) {
            const std::vector<Sample> more = samplesOf(child);
            samples.insert(samples.end(), more.begin(), more.end());
            const Patch c = patchOf(child);
            expect(c.level == g.level || c.level + 1 == g.level, "a level at a time");
            expect(c.low >= g.low && c.high <= g.high, "depths of children");
            expect(std::abs(c.u - g.u) + c.halfU <= g.halfU + 1e-4f &&
                       std::abs(c.v - g.v) + c.halfV <= g.halfV + 1e-4f,
                   "boxes of children");
        });
        expect(!samples.empty(), "no patch without samples");
        const Pixels pixels = pixelsOf(samples);
        float u0 = HUGE_VALF, v0 = HUGE_VALF, u1 = -HUGE_VALF, v1 = -HUGE_VALF;
        for (const Sample& s : samples) {
            u0 = std::min(u0, float(s.x)), u1 = std::max(u1, float(s.x + 1));
            v0 = std::min(v0, float(s.y)), v1 = std::max(v1, float(s.y + 1));
            expect(s.w >= g.low && s.w <= g.high, "depths of samples");
            const double away = std::abs(planeAt(g, s.x + 0.5, s.y + 0.5) - s.w);
            expect(away <= g.residual + slack(g), "distances from the plane");
        }
        const float texel = g.texel > 0.0f ? g.texel : 1.0f;
        const auto isEdge = [texel](float at, float box, bool high) {
            const float edge =
                texel * (high ? std::ceil(at / texel) : std::floor(at / texel));
            return std::abs(edge - box) < 1.0f / 256;  // bounds are a little larger
        };
        expect(isEdge(u0, g.u - g.halfU, false) && isEdge(u1, g.u + g.halfU, true) &&
                   isEdge(v0, g.v - g.halfV, false) && isEdge(v1, g.v + g.halfV, true),
               "the box is that of the texels");
        if (g.sheet)
            expect(pixels.size() == std::size_t((u1 - u0) * (v1 - v0)),
                   "a sheet fills its box");
        checkCover(patch, pixels);
        return samples;
    }

    using Pixels = std::set<std::pair<std::uint32_t, std::uint32_t>>;
    static Pixels pixelsOf(const std::vector<Sample>& samples) {
        Pixels pixels;
        for (const Sample& s : samples)
            pixels.insert({s.x, s.y});
        return pixels;
    }

    using Counts = std::array<int, 256>;
    /// How many pixels of each texel.
    [[nodiscard]] Counts countsOf(PatchName patch, const Pixels& pixels) const {
        const Patch g = patchOf(patch);
        Counts counts{};
        for (const auto& [x, y] : pixels)
            ++counts[((y - cornerOf(g.v, g.level)) >> g.level) * 16 +
                     ((x - cornerOf(g.u, g.level)) >> g.level)];
        return counts;
    }
    /// In sixteenths.
    [[nodiscard]] double shareOf(PatchName patch, std::uint32_t p) const {
        int share = 0;
        for (int k = 0; k < 4; ++k)
            share |= int(bitOf(patchOf(patch), k, p % 16, p / 16)) << k;
        return share == 15 ? 16.0 : share;
    }

    void addShares(PatchName patch, const Pixels& pixels) {
        const Patch g = patchOf(patch);
        if (!g.shared) return;
        const double full = std::exp2(2.0 * g.level);
        const Counts counts = countsOf(patch, pixels);
        for (std::uint32_t p = 0; p < 256; ++p) {
            const double exact = 16.0 * counts[p] / full, step = exact > 14.0 ? 2.0 : 1.0;
            const double above = exact - (exact > 14.0 ? 14.0 : std::floor(exact));
            variance += above * (step - above) * full * full / 256;
            coveredTexels += shareOf(patch, p) / 16.0 * full;
            covered += counts[p];
        }
    }

    /// Texels against the pixels of all samples in the patch.
    void checkCover(PatchName patch, const Pixels& pixels) {
        const Patch g = patchOf(patch);
        const std::uint32_t texel = 1u << g.level;
        const Counts counts = countsOf(patch, pixels);
        bool anyPart = false;
        for (std::uint32_t p = 0; p < 256; ++p) {
            const int count = counts[p], full = int(texel * texel);
            anyPart = anyPart || (count > 0 && count < full);
            const double half = 0.5 * texel;
            const double over = planeAt(g, cornerOf(g.u, g.level) + p % 16 * texel + half,
                                        cornerOf(g.v, g.level) + p / 16 * texel + half);
            const double reach = half * (std::abs(g.gradientU) + std::abs(g.gradientV));
            expect(count == 0 || (over - reach >= g.low && over + reach <= g.high),
                   "depths of the plane");
            if (!g.shared) {
                expect(isCovered(patch, p) == (count == full), "covered texels");
                continue;
            }
            const double stored = shareOf(patch, p), exact = 16.0 * count / full;
            // Sixteenths, but that all but one of them is not told from all or from two.
            const double step = exact > 14.0 ? 2.0 : 1.0;
            expect(std::abs(stored - exact) < step || stored == exact, "shares");
        }
        expect(g.shared == anyPart, "shared where texels are covered in part");
        expect(g.texel == (anyPart ? float(texel) : 0.0f), "the size of texels");
    }

    const ShadowMap& map_;
    PatchTree tree_;
    bool perspective_;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<PatchName>> leaves_;
    std::map<PatchName, std::vector<Sample>> sampleOf_;
    std::map<std::string, int> failures_;  // what, and how often
};

Projection orthographic(std::uint32_t width, std::uint32_t height) {
    Projection p = test::plainProjection(width, height);
    p.kind = ProjectionKind::orthographic;
    p.scale = {width / 8.0, height / -8.0};
    return p;
}

/// Up to `most` layers a pixel; noise, or smooth sheets with holes, or some of each.
ShadowMap randomMap(Random& random, std::uint32_t width, std::uint32_t height, int most,
                    bool perspective, double noise) {
    const Projection p =
        perspective ? test::plainProjection(width, height) : orthographic(width, height);
    const double a = random.in(0.05, 0.3), b = random.in(0.05, 0.3);
    // A tile of 16 x 16 pixels here and there has none.
    std::set<std::uint32_t> empty;
    for (int i = 0; i < 5; ++i)
        empty.insert(std::uint32_t(random.below(64)));
    return mapOf(
        test::plainInfo(width, height, 8), p, [&](std::uint32_t x, std::uint32_t y) {
            std::vector<TestLayer> layers;
            if (empty.count(y / 16 * 8 + x / 16)) return layers;
            for (int k = 0; k < most; ++k) {
                const double hole = std::sin(a * x + 2 * k) * std::cos(b * y);
                if (hole + random.in(-noise, noise) > 0.4) continue;
                const double z =
                    2 + k + 0.2 * std::sin(b * x + a * y + k) + noise * random.in(-1, 1);
                layers.push_back({float(z), 0.0f, 1});
            }
            std::sort(layers.begin(), layers.end(),
                      [](const auto& c, const auto& d) { return c.z < d.z; });
            return layers;
        });
}

}  // namespace

TEST_CASE("the patches of a tree share out the samples of its map", "[trace][exact]") {
    Random random(1);
    const std::pair<std::uint32_t, std::uint32_t> sizes[] = {
        {1, 1}, {16, 16}, {17, 15}, {37, 53}, {130, 33}, {1, 90}};
    for (const auto& [width, height] : sizes) {
        for (const int most : {1, 2, 5}) {
            for (const double noise : {0.0, 0.01, 1.0}) {
                const bool perspective = random.below(2) == 0;
                INFO(width << " x " << height << " layers " << most << " noise " << noise
                           << " perspective " << perspective);
                const ShadowMap map =
                    randomMap(random, width, height, most, perspective, noise);
                Checker(map).run();
            }
        }
    }
}

TEST_CASE("the tree of a map without layers has no patches", "[trace]") {
    const ShadowMap map = mapOf(test::plainInfo(40, 24, 8), test::plainProjection(40, 24),
                                [](auto, auto) { return std::vector<TestLayer>{}; });
    const PatchTree tree = PatchTree::build(map, 0, {});
    CHECK(tree.pieceSize() == 0.0f);
    for (const PatchTree::Level& level : tree.levels()) {
        for (const PatchList& tile : level.tiles)
            CHECK(tile.groups == 0);
    }
    Checker(map).run();
}

TEST_CASE("the shares of coarse texels are right in the mean", "[trace][statistical]") {
    // One flat sheet, with holes that are larger or smaller than texels, or with one
    // pixel in eight or in 64 missing.
    Random random(2);
    for (const double scale : {0.02, 0.3, 2.0, 0.125, 0.015625}) {
        const bool sparse = scale == 0.125 || scale == 0.015625;
        const ShadowMap map =
            mapOf(test::plainInfo(256, 200, 64), test::plainProjection(256, 200),
                  [&](std::uint32_t x, std::uint32_t y) {
                      const bool hole =
                          sparse ? random.in(0, 1) < scale
                                 : std::sin(scale * x + 1) + std::sin(scale * y) + 1 < 0;
                      return hole ? std::vector<TestLayer>{}
                                  : std::vector<TestLayer>{{4.0f, 0.0f, 1}};
                  });
        Checker checker(map);
        checker.run();
        INFO("scale " << scale << ": " << checker.coveredTexels << " of "
                      << checker.covered);
        CHECK(checker.variance > 0.0);
        CHECK(std::abs(checker.coveredTexels - checker.covered) <
              4.0 * std::sqrt(checker.variance));
    }
}

namespace {

ShadowMap wavyMap(std::uint64_t seed) {
    Random random(seed);
    return randomMap(random, 150, 110, 4, true, 0.05);
}

}  // namespace

TEST_CASE("a tree is the same for any number of threads", "[trace][threads]") {
    const ShadowMap map = wavyMap(3);
    const tbb::global_control more(tbb::global_control::max_allowed_parallelism, 8);
    const auto build = [&](int threads) {
        tbb::task_arena arena(threads);
        return arena.execute([&] { return PatchTree::build(map, 0, {}); });
    };
    const PatchTree one = build(1), many = build(8);
    REQUIRE(one.memoryBytes() == many.memoryBytes());
    REQUIRE(one.levels().size() == many.levels().size());
    std::uint32_t groups = 0;
    for (std::size_t level = 0; level < one.levels().size(); ++level) {
        const std::vector<PatchList>& a = one.levels()[level].tiles;
        const std::vector<PatchList>& b = many.levels()[level].tiles;
        REQUIRE(a.size() == b.size());
        for (std::size_t i = 0; i < a.size(); ++i) {
            CHECK(std::tuple(a[i].group, std::uint32_t(a[i].groups),
                             std::uint32_t(a[i].slots)) ==
                  std::tuple(b[i].group, std::uint32_t(b[i].groups),
                             std::uint32_t(b[i].slots)));
            groups = std::max(groups, a[i].group + a[i].groups);  // the last come last
        }
    }
    REQUIRE(groups > 100);
    CHECK(std::memcmp(one.groups(), many.groups(), groups * sizeof(trace::PatchGroup)) ==
          0);
    for (std::uint32_t n = 0; n < groups; ++n) {
        for (int i = 0; i < 4; ++i) {
            const Patch patch = one.groups()[n].patch(i);
            if (!(patch.high > -HUGE_VALF)) continue;
            const int rows =
                patch.bumpy ? kTexels
                            : (patch.shared ? trace::kSharePlanes : 1) * patch.rows();
            const std::uint16_t* a = one.covers() + patch.cover;
            CHECK(std::equal(a, a + rows, many.covers() + patch.cover));
        }
    }
}

TEST_CASE("every place in the groups of a tree is in one list, or empty", "[trace]") {
    const ShadowMap map = wavyMap(4);
    const PatchTree tree = PatchTree::build(map, 0, {});
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> lists;  // by group and slot
    std::uint32_t groups = 0;
    const std::function<void(const PatchList&, bool)> add = [&](const PatchList& list,
                                                                bool follow) {
        groups = std::max(groups, list.group + list.groups);
        for (std::uint32_t n = 0; n < 4 * list.groups; ++n) {
            if (!(list.slotsOf(n / 4) >> (n % 4) & 1)) continue;
            ++lists[{list.group + n / 4, n % 4}];
            if (follow)
                add(tree.groups()[list.group + n / 4].patch(int(n % 4)).children, true);
        }
    };
    for (const PatchTree::Level& level : tree.levels()) {
        for (const PatchList& tile : level.tiles)
            add(tile, &level == &tree.levels().back());
    }
    std::size_t empty = 0;
    for (std::uint32_t n = 0; n < groups; ++n) {
        for (std::uint32_t i = 0; i < 4; ++i) {
            const bool exists = tree.groups()[n].high(int(i)) > -HUGE_VALF;
            const auto found = lists.find({n, i});
            CHECK((found == lists.end() ? 0 : found->second) == (exists ? 1 : 0));
            empty += !exists;
        }
    }
    INFO(empty << " empty of " << 4 * groups);
    CHECK(empty < groups / 4);
}

TEST_CASE("patches that fill their boxes share their rows of coverage", "[trace]") {
    // A wall: a sheet at every level, all of it covered.
    const ShadowMap map = mapOf(test::plainInfo(128, 128, 64),
                                test::plainProjection(128, 128), [](auto, auto) {
                                    return std::vector<TestLayer>{{4.0f, 0.0f, 1}};
                                });
    const PatchTree tree = PatchTree::build(map, 0, {});
    std::set<std::uint32_t> covers;
    for (const PatchTree::Level& level : tree.levels()) {
        for (const PatchList& tile : level.tiles) {
            const Patch patch = tree.groups()[tile.group].patch(
                std::countr_zero(std::uint32_t(tile.slots)));
            CHECK(patch.sheet);
            CHECK(!patch.shared);
            CHECK(patch.rows() == kTexels);
            for (int row = 0; row < kTexels; ++row)
                CHECK(tree.covers()[patch.cover + std::uint32_t(row)] == 0xffff);
            covers.insert(patch.cover);
        }
    }
    CHECK(covers.size() == 1);
}
