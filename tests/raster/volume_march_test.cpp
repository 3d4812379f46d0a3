// Fog volumes: exact transmittance along any ray, against closed forms and against all
// planes between voxels, sorted.
#include "raster/volume_march.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <map>
#include <random>
#include <tuple>

#include "raster/volume_walk.h"

using namespace mtsm;
using namespace mtsm::raster;

namespace {

constexpr std::uint32_t kSide = 96;  // pixels: more than one tile

/// A volume that owns its arrays.
struct Fog {
    std::vector<glm::ivec3> blocks;
    std::vector<float> density;
    glm::dmat4 worldFromIndex{1.0};
    float extinction = 1.0f;

    float& at(glm::ivec3 voxel) {
        const glm::ivec3 block = (voxel >> 3) * 8;
        const auto found = std::find(blocks.begin(), blocks.end(), block);
        const auto i = std::size_t(found - blocks.begin());
        if (found == blocks.end()) {
            blocks.push_back(block);
            density.resize(density.size() + VolumeView::kBlockVoxels);
        }
        const glm::ivec3 in = voxel - block;
        return density[i * VolumeView::kBlockVoxels +
                       std::size_t((in.z * 8 + in.y) * 8 + in.x)];
    }
    [[nodiscard]] VolumeView view() const {
        return {blocks.data(), blocks.size(), density.data(), worldFromIndex, extinction};
    }
};

Fog boxOf(glm::ivec3 low, glm::ivec3 size, float density) {
    Fog fog;
    for (int z = 0; z < size.z; ++z)
        for (int y = 0; y < size.y; ++y)
            for (int x = 0; x < size.x; ++x)
                fog.at(low + glm::ivec3(x, y, z)) = density;
    return fog;
}

/// Some blocks here and there, some voxels in them empty.
Fog chunky(unsigned seed) {
    std::mt19937 random(seed);
    Fog fog;
    for (int i = 0; i < 9; ++i) {
        const glm::ivec3 block(int(random() % 5) - 2, int(random() % 5) - 2,
                               int(random() % 5) - 2);
        for (int v = 0; v < VolumeView::kBlockVoxels; ++v)
            if (random() % 3)
                fog.at(block * 8 + glm::ivec3(v & 7, v >> 3 & 7, v >> 6)) =
                    float(random() % 1000) / 1000.0f;
    }
    return fog;
}

glm::dmat4 skewed() {
    glm::dmat4 m = glm::translate(glm::dmat4(1.0), {0.3, -0.2, 0.1});
    m = glm::rotate(m, 0.7, glm::normalize(glm::dvec3(1, 2, -1)));
    m = glm::scale(m, {-0.2, 0.11, 0.15});  // mirrored, not uniform
    m[1] += 0.4 * m[0];                     // sheared
    return m;
}

/// Optical depth of the segment [a, b] of the world, from all planes between voxels.
double depthByPlanes(Fog fog, glm::dvec3 a, glm::dvec3 b) {
    std::map<std::tuple<int, int, int>, float> voxels;
    glm::ivec3 low(1 << 30), high(-(1 << 30));
    for (std::size_t i = 0; i < fog.blocks.size(); ++i) {
        low = glm::min(low, fog.blocks[i]);
        high = glm::max(high, fog.blocks[i] + 8);
        for (int v = 0; v < VolumeView::kBlockVoxels; ++v) {
            const glm::ivec3 at = fog.blocks[i] + glm::ivec3(v & 7, v >> 3 & 7, v >> 6);
            voxels[{at.x, at.y, at.z}] =
                fog.density[i * VolumeView::kBlockVoxels + std::size_t(v)];
        }
    }
    const glm::dmat4 inverse = glm::inverse(fog.worldFromIndex);
    const glm::dvec3 from(inverse * glm::dvec4(a, 1)), to(inverse * glm::dvec4(b, 1));
    std::vector<double> t{0.0, 1.0};
    for (int axis = 0; axis < 3; ++axis)
        for (int plane = low[axis]; plane <= high[axis]; ++plane) {
            const double at = (plane - 0.5 - from[axis]) / (to[axis] - from[axis]);
            if (at > 0.0 && at < 1.0) t.push_back(at);
        }
    std::sort(t.begin(), t.end());
    double sum = 0.0;
    for (std::size_t i = 1; i < t.size(); ++i) {
        const glm::dvec3 p = glm::round(from + (to - from) * (0.5 * (t[i - 1] + t[i])));
        const auto found = voxels.find({int(p.x), int(p.y), int(p.z)});
        if (found != voxels.end()) sum += (t[i] - t[i - 1]) * double(found->second);
    }
    return sum * glm::length(b - a) * double(fog.extinction);
}

/// Length of the segment [a, b] inside the box.
double lengthInBox(glm::dvec3 a, glm::dvec3 b, glm::dvec3 low, glm::dvec3 high) {
    double t0 = 0.0, t1 = 1.0;
    for (int axis = 0; axis < 3; ++axis) {
        const double u = (low[axis] - a[axis]) / (b[axis] - a[axis]);
        const double v = (high[axis] - a[axis]) / (b[axis] - a[axis]);
        t0 = std::max(t0, std::min(u, v));
        t1 = std::min(t1, std::max(u, v));
    }
    return std::max(0.0, t1 - t0) * glm::length(b - a);
}

Projection lookingAt(glm::dvec3 target, glm::dvec3 eye, ProjectionKind kind) {
    Projection p;
    p.kind = kind;
    p.eye = eye;
    p.forward = glm::normalize(target - eye);
    p.right = glm::normalize(glm::cross(p.forward, glm::dvec3(0.1, 1, 0.2)));
    p.up = glm::cross(p.right, p.forward);
    const double scale = kind == ProjectionKind::perspective ? 1.3 : 9.0;
    p.scale = glm::dvec2(scale, -scale) *
              (kind == ProjectionKind::perspective ? double(kSide) : 1.0);
    p.offset = glm::dvec2(kSide / 2.0);
    return p;
}

/// World points at depths z0 and z1 on the ray through a raster position.
std::pair<glm::dvec3, glm::dvec3> segment(const Projection& p, glm::dvec2 raster,
                                          double z0, double z1) {
    return {p.worldFromLight(p.lightFromRaster(raster, z0)),
            p.worldFromLight(p.lightFromRaster(raster, z1))};
}

struct Marched {
    std::vector<std::vector<std::pair<float, float>>> pixels;  // z, opacity
    VolumeCounts counts;
    bool channelsAgree = true;

    [[nodiscard]] double depth(std::uint32_t x, std::uint32_t y) const {
        double sum = 0.0;
        for (const auto& [z, opacity] : pixels[y * kSide + x])
            sum -= std::log1p(-double(opacity));
        return sum;
    }
};

constexpr double kWholeVoxels = 1.0;  // a sample may take all there is

Marched march(const Projection& projection, const VolumeView& view,
              std::uint32_t subsamples = 1, std::uint32_t channels = 1,
              double step = kWholeVoxels) {
    SampleGrid grid({kSide, kSide, channels, subsamples, {}}, 0, 2, 1ull << 30);
    VolumeMarcher marcher(projection, grid, step);
    REQUIRE(marcher.add(view));
    Marched out;
    out.counts = marcher.counts();
    out.pixels.resize(std::size_t(kSide) * kSide);
    for (std::uint32_t ty = 0; ty < grid.tilesY(); ++ty)
        for (std::uint32_t tx = 0; tx < grid.tilesX(); ++tx) {
            const SampleTile& tile = grid.tile(tx, ty);
            tile.forEachPixel([&](std::uint32_t p, const PixelSamples& list) {
                const std::uint32_t x = tx * 64 + p % tile.width();
                const std::uint32_t y = ty * 64 + p / tile.width();
                for (std::size_t i = 0; i < list.count; ++i) {
                    out.pixels[y * kSide + x].emplace_back(list.z[i], list.opacity[0][i]);
                    for (std::uint32_t c = 1; c < channels; ++c)
                        out.channelsAgree &= list.opacity[c][i] == list.opacity[0][i];
                }
            });
        }
    return out;
}

double between(const VolumeView& view, glm::dvec3 a, glm::dvec3 b) {
    const VolumeIndex index(view);
    const auto cells = index.cellsFromWorld();
    REQUIRE(cells);
    return opticalDepth(index, *cells, a, b);
}

// A sample's opacity is a float: its optical depth is off by 2^-25 or so, times what
// 1 / (1 - opacity) makes of it; the fogs here have some dozens of samples per ray.
constexpr double kFloats = 1e-5;

}  // namespace

TEST_CASE("a slab of extinction s and thickness d lets exp(-s d) through",
          "[raster][exact]") {
    Fog fog = boxOf({-16, -16, 0}, {32, 32, 8}, 0.5f);
    fog.extinction = 0.6f;
    for (const auto kind : {ProjectionKind::perspective, ProjectionKind::orthographic}) {
        const Projection p = lookingAt({1, -2, 4}, {9, 5, 40}, kind);
        const Marched out = march(p, fog.view());
        std::size_t met = 0;
        for (std::uint32_t y = 0; y < kSide; ++y)
            for (std::uint32_t x = 0; x < kSide; ++x) {
                const auto [a, b] = segment(p, {x + 0.5, y + 0.5}, 0.0, 100.0);
                const double inside =
                    lengthInBox(a, b, {-16.5, -16.5, -0.5}, {15.5, 15.5, 7.5});
                const double expected = 0.5 * double(0.6f) * inside;
                met += inside > 0.0;
                CHECK(std::exp(-out.depth(x, y)) ==
                      Approx(std::exp(-expected)).margin(1e-6).epsilon(0));
            }
        CHECK(met > 1000);
        CHECK(out.counts.samples <= out.counts.voxels);
    }
}

TEST_CASE("a single voxel gives each ray that meets it one sample in its middle",
          "[raster][exact]") {
    Fog fog;
    fog.at({3, -5, 11}) = 0.25f;
    const Projection p =
        lookingAt({3.1, -5, 11}, {5, -2, 14}, ProjectionKind::perspective);
    const Marched out = march(p, fog.view(), 1, 3);
    CHECK(out.channelsAgree);
    std::size_t samples = 0;
    for (std::uint32_t y = 0; y < kSide; ++y)
        for (std::uint32_t x = 0; x < kSide; ++x) {
            const auto [a, b] = segment(p, {x + 0.5, y + 0.5}, 0.0, 20.0);
            const double length = lengthInBox(a, b, {2.5, -5.5, 10.5}, {3.5, -4.5, 11.5});
            const auto& pixel = out.pixels[y * kSide + x];
            if (length < 1e-5) continue;  // too short for a sample
            REQUIRE(pixel.size() == 1);
            ++samples;
            CHECK(double(pixel[0].second) == Approx(1.0 - std::exp(-0.25 * length)));
            const glm::dvec3 middle = p.worldFromLight(
                p.lightFromRaster({x + 0.5, y + 0.5}, double(pixel[0].first)));
            CHECK(lengthInBox(a, middle, {2.5, -5.5, 10.5}, {3.5, -4.5, 11.5}) ==
                  Approx(length / 2).margin(1e-6));
        }
    CHECK(samples > 100);
    CHECK(out.counts.samples == samples);
}

TEST_CASE("inside a thick slab exp(-s d) is left at any depth, to half a step",
          "[raster][exact]") {
    const double step = GENERATE(0.1, 0.01, 0.003);
    const std::uint32_t subsamples = GENERATE(1u, 4u);
    Fog fog = boxOf({-24, -24, -4}, {48, 48, 8}, 0.5f);
    fog.extinction = 3.0f;
    const Projection p = lookingAt({0, 0, 0}, {0, 0, 40}, ProjectionKind::orthographic);
    const Marched out = march(p, fog.view(), subsamples, 1, step);
    const auto& pixel = out.pixels[kSide / 2 * kSide + kSide / 2];
    const double s = 0.5 * 3.0, begin = 40.0 - 3.5;
    // Rays share parts of a voxel evenly by optical depth, not by light.
    const double most = (subsamples == 1 ? 0.51 : 1.0) * step;
    double left = 1.0;
    for (const auto& [z, opacity] : pixel) {
        const double exact = std::exp(-s * (double(z) - begin));
        CHECK(left >= exact - 1e-5);
        left *= 1.0 - double(opacity);
        CHECK(left <= exact + 1e-5);
        CHECK(exact - left <= most + 1e-5);
    }
    CHECK(left == Approx(std::exp(-s * 8.0)).epsilon(1e-4));
    CHECK(double(pixel.size()) <= 1.0 / step + 8.0 * subsamples * subsamples);
}

TEST_CASE("a volume as dense as floats go has no more samples than steps and voxels",
          "[raster][extreme]") {
    Fog fog = boxOf({0, 0, 0}, {8, 8, 8}, 1.0f);
    const Projection p =
        lookingAt({3.5, 3.5, 3.5}, {5, 9, 14}, ProjectionKind::perspective);
    const float extinction = GENERATE(0.01f, 1.0f, 100.0f, 1e30f);
    fog.extinction = extinction;
    const double step = 0.01;
    const Marched out = march(p, fog.view(), 1, 1, step);
    std::size_t met = 0;
    for (const auto& pixel : out.pixels) {
        met += !pixel.empty();
        CHECK(pixel.size() <= 24 + 100);
        for (const auto& [z, opacity] : pixel) {
            CHECK(z > 0.0f);
            CHECK((opacity > 0.0f && opacity <= 1.0f));
        }
    }
    CHECK(met > 100);
}

TEST_CASE("segments through sheared, mirrored and sparse fog sum up all their voxels",
          "[raster][twin]") {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> where(-4.0, 4.0);
    for (unsigned seed = 1; seed <= 4; ++seed) {
        Fog fog = chunky(seed);
        fog.extinction = 1.7f;
        fog.worldFromIndex = skewed();
        for (int i = 0; i < 200; ++i) {
            const glm::dvec3 a(where(random), where(random), where(random));
            const glm::dvec3 b(where(random), where(random), where(random));
            CHECK(between(fog.view(), a, b) ==
                  Approx(depthByPlanes(fog, a, b)).margin(1e-11).epsilon(1e-11));
        }
    }
}

TEST_CASE("centre rays see what their segment holds, also from inside the fog",
          "[raster][twin]") {
    Fog fog = chunky(7);
    fog.worldFromIndex = skewed();
    const glm::dvec3 eye = GENERATE(glm::dvec3(3, 2, 5), glm::dvec3(0.2, 0.1, 0.0));
    Projection p = lookingAt({0.3, -0.2, 0.1}, eye, ProjectionKind::perspective);
    const bool clipped = GENERATE(false, true);
    if (clipped) {
        p.near = 0.5;
        p.far = 5.8;
    }
    const Marched out = march(p, fog.view());
    CHECK(out.counts.samples > 1000);
    for (std::uint32_t y = 0; y < kSide; y += 5)
        for (std::uint32_t x = 0; x < kSide; x += 3) {
            const auto [a, b] =
                segment(p, {x + 0.5, y + 0.5}, p.near, std::min(p.far, 20.0));
            CHECK(out.depth(x, y) ==
                  Approx(depthByPlanes(fog, a, b)).margin(kFloats).epsilon(0));
            for (const auto& [z, opacity] : out.pixels[y * kSide + x]) {
                CHECK(double(z) > p.near);
                CHECK(double(z) < p.far);
            }
        }
}

TEST_CASE("rays along faces, edges and diagonals lose no length", "[raster][exact]") {
    Fog fog = boxOf({-8, -8, -8}, {16, 16, 16}, 1.0f);  // [-8.5, 7.5)
    const auto depth = [&](glm::dvec3 a, glm::dvec3 b) {
        return between(fog.view(), a, b);
    };
    const double edges[] = {-7.5, -0.5, 6.5};  // planes between voxels, and of blocks
    for (const double u : edges)
        for (const double v : edges) {
            CHECK(depth({u, v, -20}, {u, v, 20}) == Approx(16));  // edge
            CHECK(depth({u, 20, v}, {u, -20, v}) == Approx(16));  // the other way
            CHECK(depth({20, u, v + 0.3}, {-20, u, v + 0.3}) == Approx(16));  // face
        }
    // Along the border a volume holds its lower faces, not its upper ones.
    CHECK(depth({-8.5, 0, -20}, {-8.5, 0, 20}) == Approx(16));
    CHECK(depth({7.5, 0, -20}, {7.5, 0, 20}) == 0.0);
    const double diagonal = 16 * std::sqrt(3.0);
    CHECK(depth({-20.5, -20.5, -20.5}, {19.5, 19.5, 19.5}) == Approx(diagonal));
    CHECK(depth({19.5, -20.5, 19.5}, {-20.5, 19.5, -20.5}) == Approx(diagonal));
    CHECK(depth({-20.5, 3, -20.5}, {19.5, 3, 19.5}) == Approx(16 * std::sqrt(2.0)));
    CHECK(depth({1, 2, 3}, {1, 2, 3}) == 0.0);  // no length
    CHECK(depth({1, 2, 3}, {1, 2, 4.25}) == Approx(1.25));
    CHECK(depth({1e-300, 0, -20}, {-1e-300, 1e-200, 20}) == Approx(16));
}

TEST_CASE("blocks at the ends of the index space are found at once", "[raster][exact]") {
    Fog fog;
    const int far = (1 << 30) - 8;
    for (int v = 0; v < 8; ++v) {
        fog.at({-far + v, 3, 5}) = 1.0f;
        fog.at({far + v, 3, 5}) = 2.0f;
        fog.at({v, 3, 5}) = 4.0f;
    }
    CHECK(between(fog.view(), {-2.0 * far, 3, 5}, {2.0 * far, 3, 5}) ==
          Approx(8.0 * 7.0).epsilon(1e-6));  // planes 2^30 away are known to 2^-22
    CHECK(between(fog.view(), {-2.0 * far, 4, 5}, {2.0 * far, 4, 5}) == 0.0);
    const Projection p = lookingAt({4, 3, 5}, {4, 3, 25}, ProjectionKind::perspective);
    CHECK(march(p, fog.view()).counts.samples > 50);
}

TEST_CASE("the order of blocks changes nothing", "[raster][exact]") {
    Fog fog = chunky(5), shuffled;
    std::vector<std::size_t> order(fog.blocks.size());
    for (std::size_t i = 0; i < order.size(); ++i)
        order[i] = i;
    std::shuffle(order.begin(), order.end(), std::mt19937(1));
    for (const std::size_t i : order) {
        shuffled.blocks.push_back(fog.blocks[i]);
        const auto first = fog.density.begin() + std::ptrdiff_t(i * 512);
        shuffled.density.insert(shuffled.density.end(), first, first + 512);
    }
    fog.worldFromIndex = shuffled.worldFromIndex = skewed();
    const Projection p = lookingAt({0, 0, 0}, {3, 2, 5}, ProjectionKind::perspective);
    const Marched a = march(p, fog.view());
    CHECK(a.pixels == march(p, shuffled.view()).pixels);
    CHECK(a.counts.samples > 0);
}

TEST_CASE("any number of threads gives the same samples", "[raster][exact][threads]") {
    Fog fog = chunky(6);
    fog.worldFromIndex = skewed();
    const Projection p = lookingAt({0, 0, 0}, {3, 2, 5}, ProjectionKind::perspective);
    const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
    Marched one, many;
    tbb::task_arena(1).execute([&] { one = march(p, fog.view()); });
    tbb::task_arena(4).execute([&] { many = march(p, fog.view()); });
    CHECK(one.pixels == many.pixels);
    CHECK(one.counts.voxels == many.counts.voxels);
}

TEST_CASE("fog a long way from the origin is as exact as at it", "[raster][exact]") {
    Fog fog = chunky(9);
    const glm::dvec3 away(1e7, -1e7, 1e7);
    const auto seen = [&](glm::dvec3 offset) {
        Fog moved = fog;
        moved.worldFromIndex = glm::translate(glm::dmat4(1.0), offset) * skewed();
        Projection p = lookingAt({0, 0, 0}, {3, 2, 5}, ProjectionKind::perspective);
        p.eye += offset;
        return march(p, moved.view());
    };
    const Marched here = seen({0, 0, 0}), there = seen(away);
    for (std::uint32_t y = 0; y < kSide; y += 3)
        for (std::uint32_t x = 0; x < kSide; x += 3)
            CHECK(here.depth(x, y) == Approx(there.depth(x, y)).margin(2e-6).epsilon(0));
}

TEST_CASE("subsamples share the optical depth of their pixel", "[raster][exact]") {
    Fog fog = chunky(4);
    fog.worldFromIndex = skewed();
    const Projection p = lookingAt({0, 0, 0}, {3, 2, 5}, ProjectionKind::orthographic);
    const Marched out = march(p, fog.view(), 2);
    CHECK(out.counts.samples > 0);
    for (std::uint32_t y = 0; y < kSide; y += 7)
        for (std::uint32_t x = 0; x < kSide; x += 7) {
            double mean = 0.0;
            for (const glm::dvec2 in : {glm::dvec2(0.25, 0.25), glm::dvec2(0.75, 0.25),
                                        glm::dvec2(0.25, 0.75), glm::dvec2(0.75, 0.75)}) {
                const auto [a, b] = segment(p, glm::dvec2(x, y) + in, 0.0, 20.0);
                mean += depthByPlanes(fog, a, b) / 4.0;
            }
            CHECK(out.depth(x, y) == Approx(mean).margin(kFloats).epsilon(0));
        }
}

TEST_CASE("haze too thin for a float is gathered, not lost", "[raster][exact]") {
    Fog fog = boxOf({-8, -8, -40}, {16, 16, 80}, 1.0f);
    fog.extinction = 1e-8f;
    const Projection p = lookingAt({0, 0, 0}, {0, 0, 90}, ProjectionKind::orthographic);
    const Marched out = march(p, fog.view());
    const double whole = 80.0 * double(1e-8f);
    CHECK(std::abs(out.depth(48, 48) - whole) < 0x1p-24);
    CHECK(out.pixels[48 * kSide + 48].size() == 13);  // six voxels each, of 80
}

TEST_CASE("dense, flat, empty and clear volumes have their answers", "[raster]") {
    const Projection p = lookingAt({0, 0, 0}, {0, 0, 9}, ProjectionKind::perspective);
    Fog fog = boxOf({-4, -4, -4}, {8, 8, 8}, 3e38f);
    fog.extinction = 3e38f;
    const Marched dense = march(p, fog.view());
    CHECK(dense.counts.samples > 0);
    CHECK(dense.pixels[48 * kSide + 48][0].second == 1.0f);

    fog.worldFromIndex[2] = fog.worldFromIndex[1];
    const Marched flat = march(p, fog.view());
    CHECK(flat.counts.flat == 1);
    CHECK(flat.counts.samples == 0);
    fog.worldFromIndex = glm::dmat4(NAN);
    CHECK(march(p, fog.view()).counts.flat == 1);

    fog.worldFromIndex = glm::dmat4(1.0);
    fog.extinction = 0.0f;
    CHECK(march(p, fog.view()).counts.voxels == 0);
    CHECK(march(p, VolumeView{}).counts.flat == 0);
}

TEST_CASE("a march stops where its callback says so", "[raster]") {
    const Fog fog = boxOf({-4, -4, -4}, {8, 8, 8}, 1.0f);
    const Projection p = lookingAt({0, 0, 0}, {0, 0, 9}, ProjectionKind::perspective);
    SampleGrid grid({kSide, kSide, 1, 1, {}}, 0, 2, 1ull << 30);
    std::uint64_t told = 0;
    VolumeMarcher marcher(p, grid, kWholeVoxels, [&](std::uint64_t voxels) -> Status {
        told = voxels;
        return Error{ErrorCode::cancelled, "enough"};
    });
    const Status s = marcher.add(fog.view());
    REQUIRE(!s);
    CHECK(s.error().message == "enough");
    CHECK(told == marcher.counts().voxels);
}
