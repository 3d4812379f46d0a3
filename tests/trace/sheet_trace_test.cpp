// Rays through the triangles of near sheets: brute force in double, edges that two
// triangles share, and the same answer whichever rays stand beside and whatever the
// processor.
#include "trace/sheet_trace.h"

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
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
using trace::kMostRows;

namespace {

/// w is brought to the size of u and v.
constexpr glm::dvec3 kScale(1.0, 1.0, 0x1p12);
constexpr double kSteps[3] = {0x1p-8, 0x1p-8, 0x1p-20};

struct Sheet {
    std::array<glm::dvec3, 3> corner;  // on the grid of kSteps
    std::array<glm::dvec2, 3> uv;      // multiples of 2^-10
    std::uint32_t texture = 0;
};

glm::dvec3 onGrid(glm::dvec3 p) {
    for (int axis = 0; axis < 3; ++axis)
        p[axis] = std::round(p[axis] / kSteps[axis]) * kSteps[axis];
    return p;
}

/// Sheets in their order, up to 16 with one texture in a chunk.
ShadowMap mapOf(const std::vector<Sheet>& sheets, std::vector<NearTexture> textures) {
    std::vector<MapFace> faces(1);
    faces[0].projection = test::plainProjection(8, 8);
    faces[0].tiles.resize(1);
    NearSheets& near = faces[0].nearSheets;
    near.textures = std::move(textures);
    for (std::size_t i = 0; i < sheets.size();) {
        std::size_t end = i;
        while (end < sheets.size() && end < i + 16 &&
               sheets[end].texture == sheets[i].texture)
            ++end;
        NearChunk chunk;
        NearSheetChunk coordinates;
        coordinates.texture = sheets[i].texture;
        coordinates.triangles = std::uint32_t(end - i);
        glm::dvec3 low(HUGE_VAL);
        glm::dvec2 lowUv(HUGE_VAL);
        for (std::size_t t = i; t < end; ++t) {
            for (std::size_t c = 0; c < 3; ++c) {
                low = glm::min(low, sheets[t].corner[c]);
                lowUv = glm::min(lowUv, sheets[t].uv[c]);
            }
        }
        for (int axis = 0; axis < 3; ++axis) {
            chunk.low[axis] = float(low[axis]);
            chunk.step[axis] = float(kSteps[axis]);
        }
        for (int axis = 0; axis < 2; ++axis) {
            coordinates.low[axis] = float(lowUv[axis]);
            coordinates.step[axis] = 0x1p-10f;
        }
        for (std::size_t t = 0; t < 16; ++t) {
            const Sheet& s = sheets[std::min(i + t, end - 1)];
            for (std::size_t c = 0; c < 3; ++c) {
                for (int axis = 0; axis < 3; ++axis)
                    chunk.corner[c][axis][t] =
                        std::uint16_t((s.corner[c][axis] - low[axis]) / kSteps[axis]);
                for (int axis = 0; axis < 2; ++axis)
                    coordinates.uv[c][axis][t] =
                        std::uint16_t((s.uv[c][axis] - lowUv[axis]) * 0x1p10);
            }
        }
        near.triangles.chunks.push_back(chunk);
        near.chunks.push_back(coordinates);
        i = end;
    }
    auto map = ShadowMap::create(test::plainInfo(8, 8, 8), std::move(faces));
    REQUIRE(map);
    return *std::move(map);
}

NearTexture textureOf(std::uint32_t width, std::uint32_t height, TextureWrap u,
                      TextureWrap v, float cutoff, float opacity, std::uint64_t seed) {
    Random random(seed);
    NearTexture texture;
    texture.width = width, texture.height = height;
    texture.wrapU = u, texture.wrapV = v;
    texture.cutoff = cutoff, texture.opacity = opacity;
    texture.texels.clear();
    for (std::uint32_t i = 0; i < width * height; ++i)
        texture.texels.push_back(std::uint8_t(random.below(256)));
    return texture;
}

std::vector<NearTexture> someTextures() {
    std::vector<NearTexture> textures(1);
    textures[0].opacity = 0.4f;
    textures.push_back(
        textureOf(5, 3, TextureWrap::repeat, TextureWrap::mirror, -1.0f, 0.9f, 1));
    textures.push_back(
        textureOf(4, 8, TextureWrap::clamp, TextureWrap::repeat, 0.5f, 0.7f, 2));
    return textures;
}

/// Texel (x, y), wherever they are.
double texelAt(const NearTexture& t, int x, int y) {
    const auto wrap = [](int i, int n, TextureWrap how) {
        if (how == TextureWrap::repeat) return (i % n + n) % n;
        if (how == TextureWrap::clamp) return std::clamp(i, 0, n - 1);
        const int period = (i % (2 * n) + 2 * n) % (2 * n);
        return period < n ? period : 2 * n - 1 - period;
    };
    return t.texels[std::size_t(wrap(y, int(t.height), t.wrapV)) * t.width +
                    std::size_t(wrap(x, int(t.width), t.wrapU))] /
           255.0;
}

/// Nothing if a cutoff decides within rounding.
std::optional<double> opacityAt(const NearTexture& t, glm::dvec2 uv) {
    const glm::dvec2 at(uv.x * t.width - 0.5, (1.0 - uv.y) * t.height - 0.5);
    const glm::dvec2 first = glm::floor(at), part = at - first;
    const int x = int(first.x), y = int(first.y);
    const double value = glm::mix(
        glm::mix(texelAt(t, x, y), texelAt(t, x + 1, y), part.x),
        glm::mix(texelAt(t, x, y + 1), texelAt(t, x + 1, y + 1), part.x), part.y);
    if (t.cutoff < 0.0f) return t.opacity * value;
    if (std::abs(value - double(t.cutoff)) < 1e-2) return std::nullopt;
    return value >= double(t.cutoff) ? t.opacity : 0.0;
}

/// What a ray is left by a sheet, in double; nothing if rounding may decide.
std::optional<double> left(const Sheet& sheet, const std::vector<NearTexture>& textures,
                           bool perspective, glm::dvec3 start, glm::dvec3 delta,
                           double begin, double end) {
    start *= kScale;
    delta *= kScale;
    const glm::dvec3 a = sheet.corner[0] * kScale, b = sheet.corner[1] * kScale,
                     c = sheet.corner[2] * kScale;
    const glm::dvec3 normal = glm::cross(b - a, c - a);
    const double size = glm::length(normal);
    if (size == 0.0) return std::nullopt;
    const double speed = glm::dot(normal, delta);
    const double grazing = std::abs(speed) / (size * glm::length(delta));
    if (grazing < 1e-3) return std::nullopt;
    const double s = glm::dot(normal, a - start) / speed;
    const glm::dvec3 p = start + s * delta;
    double share[3], inside = HUGE_VAL;
    const glm::dvec3 corners[3] = {a, b, c};
    for (int i = 0; i < 3; ++i) {
        const glm::dvec3 from = corners[(i + 1) % 3], edge = corners[(i + 2) % 3] - from;
        const double area = glm::dot(glm::cross(edge, p - from), normal) / size;
        share[i] = area / size;
        inside = std::min(inside, area / glm::length(edge));
    }
    const double slack = std::min(s - begin, end - s) * glm::length(delta);
    const double error = 2e-3 / grazing;
    if (inside < -error || slack < -error) return 1.0;
    if (!(inside > error && slack > error)) return std::nullopt;
    glm::dvec2 uv(0.0);
    double sum = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
        const double weight = share[i] * (perspective ? sheet.corner[i].z : 1.0);
        uv += weight * sheet.uv[i];
        sum += weight;
    }
    const auto opacity = opacityAt(textures[sheet.texture], uv / sum);
    if (!opacity) return std::nullopt;
    return 1.0 - *opacity;
}

std::vector<Sheet> scattered(Random& random, std::size_t count, double size) {
    std::vector<Sheet> sheets(count);
    for (Sheet& s : sheets) {
        const glm::dvec3 at(random.in(0, 64), random.in(0, 64), random.in(0.01, 0.02));
        const double side = size * std::exp2(random.in(-2, 1));
        for (std::size_t c = 0; c < 3; ++c) {
            s.corner[c] =
                onGrid(at + side * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                              random.in(-0x1p-12, 0x1p-12)));
            s.uv[c] =
                glm::round(glm::dvec2(random.in(-2, 2), random.in(-2, 2)) * 0x1p10) *
                0x1p-10;
        }
        s.texture = std::uint32_t(random.below(3));
    }
    std::sort(sheets.begin(), sheets.end(), [](const Sheet& a, const Sheet& b) {
        const auto key = [](const Sheet& s) {
            return std::make_tuple(s.texture, int(s.corner[0].x / 8),
                                   int(s.corner[0].y / 8), s.corner[0].z);
        };
        return key(a) < key(b);
    });
    return sheets;
}

struct Visible {
    alignas(64) float left[kMostRows][kLanes];

    Visible() { std::fill_n(&left[0][0], kMostRows * kLanes, 1.0f); }
};

std::unique_ptr<Visible> traced(const ShadowMap& map, test::Rays& rays,
                                const trace::SheetTraceOptions& options = {}) {
    auto visible = std::make_unique<Visible>();
    trace::traceSheets(map.nearSheets(0), options, rays.bundle, rays.end, visible->left);
    return visible;
}

}  // namespace

TEST_CASE("rays are left what brute force says that sheets leave", "[trace][twin]") {
    Random random(1);
    const std::vector<NearTexture> textures = someTextures();
    int wrong = 0, hit = 0, missed = 0, close = 0;
    for (const std::size_t count : {1u, 16u, 17u, 700u}) {
        const std::vector<Sheet> sheets = scattered(random, count, 6.0);
        const ShadowMap map = mapOf(sheets, textures);
        for (int i = 0; i < 40; ++i) {
            const bool perspective = i % 2 == 0;
            const glm::dvec3 from(random.in(0, 64), random.in(0, 64),
                                  random.in(0.008, 0.022));
            const double length = std::exp2(random.in(0, 6));
            const glm::dvec3 reach(random.in(-1, 1) * length, random.in(-1, 1) * length,
                                   random.in(-0.01, 0.02));
            const int receivers = 1 + int(random.below(8));
            auto rays = raysAround(random, receivers,
                                   1 + int(random.below(std::size_t(12 / receivers))),
                                   from, std::exp2(random.in(-6, 2)), reach);
            const auto visible = traced(map, *rays, {perspective, 0.0f, 0.0f});
            for (int row = 0; row < rays->rows(); ++row) {
                for (int lane = 0; lane < kLanes; ++lane) {
                    double truth = 1.0;
                    bool known = true;
                    for (const Sheet& s : sheets) {
                        const auto part =
                            left(s, textures, perspective,
                                 rays->start(row / rays->bundle.groups),
                                 rays->delta(row, lane), rays->bundle.begin[row][lane],
                                 rays->end[row][lane]);
                        known = known && part;
                        truth *= part.value_or(1.0);
                    }
                    close += !known;
                    if (!known) continue;
                    hit += truth < 1.0;
                    missed += truth == 1.0;
                    wrong += std::abs(visible->left[row][lane] - truth) > 0.02;
                }
            }
        }
    }
    CHECK(wrong == 0);
    CHECK(hit > 1000);
    CHECK(missed > 1000);
    CHECK(close < (hit + missed));
}

TEST_CASE("a ray through an edge crosses one of the two sheets that share it",
          "[trace][exact]") {
    // A bumpy sheet of 12 x 12 quads that lets half of the light through.
    Random random(2);
    std::vector<NearTexture> half(1);
    half[0].opacity = 0.5f;
    glm::dvec3 point[13][13];
    for (int y = 0; y < 13; ++y) {
        for (int x = 0; x < 13; ++x)
            point[y][x] =
                onGrid({5.0 * x + random.in(-1.6, 1.6), 5.0 * y + random.in(-1.6, 1.6),
                        0.015 + random.in(-1e-4, 1e-4)});
    }
    std::vector<Sheet> sheets;
    for (int y = 0; y < 12; ++y) {
        for (int x = 0; x < 12; ++x) {
            const auto& p = point;
            sheets.push_back({{p[y][x], p[y][x + 1], p[y + 1][x + 1]}, {}, 0});
            sheets.push_back({{p[y + 1][x], p[y][x], p[y + 1][x + 1]}, {}, 0});
        }
    }
    const ShadowMap map = mapOf(sheets, half);
    int wrong = 0;
    for (int i = 0; i < 200; ++i) {
        test::Rays rays(16, 1);
        for (int row = 0; row < 16; ++row) {
            rays.setStart(row, {random.in(20, 40), random.in(20, 40), 0.012});
            for (int lane = 0; lane < kLanes; ++lane) {
                // Of quads away from the border, a point of an edge.
                const std::size_t quad = 12 * (2 + random.below(8)) + 2 + random.below(8);
                const Sheet& s = sheets[2 * quad + random.below(2)];
                const std::size_t edge = random.below(3);
                const glm::dvec3 by = glm::mix(s.corner[edge], s.corner[(edge + 1) % 3],
                                               random.in(0.01, 0.99));
                rays.setDelta(row, lane, (by - rays.start(row)) * 1.25);
            }
        }
        rays.boundEnds();
        const auto visible = traced(map, rays);
        for (int row = 0; row < 16; ++row)
            wrong += int(kLanes - std::count(visible->left[row],
                                             visible->left[row] + kLanes, 0.5f));
    }
    CHECK(wrong == 0);
}

TEST_CASE("what sheets leave of a ray depends on that ray alone, on every processor",
          "[trace][twin]") {
    Random random(3);
    const ShadowMap map = mapOf(scattered(random, 1500, 3.0), someTextures());
    std::vector<std::unique_ptr<test::Rays>> bundles;
    for (int i = 0; i < 8; ++i) {
        const int receivers = i == 0 ? 1 : i == 1 ? 16 : 1 + int(random.below(16));
        const int groups = i < 2 ? std::min(kMostGroups, kMostRows / receivers)
                                 : 1 + int(random.below(4));
        bundles.push_back(raysAround(
            random, receivers, groups, {random.in(10, 54), random.in(10, 54), 0.012},
            std::exp2(random.in(-6, 2)),
            {random.in(-10, 10), random.in(-10, 10),
             i % 2 ? random.in(0.008, 0.01) : random.in(-0.002, 0.006)}));
    }
    const trace::SheetTraceOptions options = {true, 0.0f, 0.05f};
    std::vector<std::unique_ptr<Visible>> first;
    onEachTarget([&](const char* name) {
        INFO(name);
        for (std::size_t i = 0; i < bundles.size(); ++i) {
            test::Rays all = *bundles[i];
            auto visible = traced(map, all, options);
            if (first.size() <= i) first.push_back(std::move(visible));
            CHECK((!visible || std::memcmp(visible->left, first[i]->left,
                                           sizeof visible->left) == 0));
        }
    });
    int crossed = 0, different = 0;
    for (std::size_t i = 0; i < bundles.size(); ++i) {
        const test::Rays& all = *bundles[i];
        for (int row = 0; row < all.rows(); ++row) {
            for (int lane = 0; lane < kLanes; ++lane) {
                const float expected = first[i]->left[row][lane];
                crossed += expected < 1.0f;
                test::Rays alone = all;
                alone.openOnly(row, lane);
                different += traced(map, alone, options)->left[row][lane] != expected;
            }
        }
    }
    CHECK(different == 0);
    CHECK(crossed > 300);
}

TEST_CASE("sheets in one place count each, and end a ray that is dark",
          "[trace][exact]") {
    const Sheet sheet = {
        {glm::dvec3(4, 0, 0.0078125), {4, 8, 0.0078125}, {4, 4, 0.0625}}, {}, 0};
    std::vector<NearTexture> half(1);
    half[0].opacity = 0.5f;
    onEachTarget([&](const char* name) {
        INFO(name);
        for (const std::size_t count : {1u, 2u, 3u, 17u}) {
            const ShadowMap map = mapOf(std::vector<Sheet>(count, sheet), half);
            test::Rays rays(1, 1);
            rays.setStart(0, {2, 4, 0.015625});
            for (int lane = 0; lane < kLanes; ++lane)
                rays.setDelta(0, lane, {4, 0, 0});
            rays.setDelta(0, 1, {0, 4, 0});  // beside them
            rays.boundEnds();
            const auto visible = traced(map, rays, {true, 0.0f, 0.125f});
            CHECK(visible->left[0][0] ==
                  std::exp2(-float(std::min<std::size_t>(count, 3))));
            CHECK(visible->left[0][1] == 1.0f);
            CHECK(rays.isOpen(0, 0) == (count < 3));
            CHECK(rays.isOpen(0, 1));
        }
    });
}
