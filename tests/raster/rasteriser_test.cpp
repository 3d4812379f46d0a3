// The parallel rasteriser: the same samples as triangle by triangle, on any thread count.
#include "raster/rasteriser.h"

#include <hwy/targets.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "bake/casters.h"
#include "raster/grid_content.h"
#include "raster/light_from_object.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Mesh;
using mtsm::test::Pixel;
using mtsm::test::Random;

namespace {

Projection viewFrom(glm::dvec3 eye, std::uint32_t side) {
    Projection p;
    p.eye = eye;
    p.forward = glm::normalize(-eye);
    p.right = glm::normalize(glm::cross(p.forward, glm::dvec3(0, 1, 0)));
    p.up = glm::cross(p.right, p.forward);
    p.scale = {1.2 * side, -1.2 * side};
    p.offset = {side / 2.0, side / 2.0};
    p.near = 0.1;
    return p;
}

void draw(Rasteriser& rasteriser, const std::vector<Mesh>& meshes) {
    for (const Mesh& mesh : meshes)
        REQUIRE(rasteriser.add(mesh.view()));
    REQUIRE(rasteriser.finish());
}

/// The k nearest samples of all pixels, from the k-buffer.
std::vector<Pixel> nearest(const Projection& p, std::uint32_t side, std::uint32_t k,
                           const std::vector<Mesh>& meshes, std::uint64_t* dropped) {
    MemoryBudget budget(1ull << 32);
    KBuffer buffer(side, side, k, budget);
    Rasteriser rasteriser(p, Facing::any, buffer);
    draw(rasteriser, meshes);
    std::vector<Pixel> pixels(std::size_t(side) * side);
    *dropped = 0;
    for (const KTile& tile : buffer.tiles())
        *dropped += tile.samples() - tile.copies();
    for (std::uint32_t y = 0; y < side; ++y) {
        for (std::uint32_t x = 0; x < side; ++x) {
            const KTile& tile = buffer.tile(x / 64, y / 64);
            if (tile.empty()) continue;
            const std::uint32_t at = tile.place(x % 64, y % 64);
            const std::uint32_t count = tile.count(x % 64, y % 64);
            *dropped -= count;
            for (std::uint32_t i = 0; i < count; ++i)
                pixels[y * side + x].samples.emplace_back(tile.plane(i)[at], 1.0f);
        }
    }
    return pixels;
}

/// All samples of the rows of pixels that a grid of these rows of tiles holds.
std::vector<Pixel> everything(const Projection& p, std::uint32_t side,
                              std::uint32_t firstRow, std::uint32_t endRow,
                              const std::vector<Mesh>& meshes) {
    SampleGrid grid({side, side, 1, 1, {}}, firstRow, endRow, 1ull << 32);
    Rasteriser rasteriser(p, Facing::any, grid);
    draw(rasteriser, meshes);
    return mtsm::test::content(grid);
}

/// One triangle after the other, every sample kept, then sorted.
std::vector<Pixel> bruteForce(const Projection& p, std::uint32_t side,
                              const std::vector<Mesh>& meshes) {
    const TriangleSetup setup(p, side, side, Facing::any);
    const PixelRect all{0, 0, std::int32_t(side) - 1, std::int32_t(side) - 1};
    std::vector<Pixel> pixels(std::size_t(side) * side);
    for (const Mesh& mesh : meshes) {
        const LightFromObject lightFromObject(p, mesh.worldFromObject);
        for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
            const auto corner = [&](std::size_t c) {
                return setup.vertex(lightFromObject(mesh.positions[mesh.indices[i + c]]));
            };
            TriangleCounts counts;
            std::vector<PreparedTriangle> prepared;
            setup.triangle(corner(0), corner(1), corner(2), false, 0.0, 0, counts,
                           prepared);
            for (const PreparedTriangle& t : prepared)
                drawTriangle<ProjectionKind::perspective>(
                    t, all, [&](std::int32_t x, std::int32_t y, float z) {
                        pixels[std::size_t(y) * side + std::size_t(x)]
                            .samples.emplace_back(z, mesh.opacity);
                    });
        }
    }
    for (Pixel& pixel : pixels)
        std::sort(pixel.samples.begin(), pixel.samples.end());
    return pixels;
}

/// Of opaque samples: each depth once, the first k.
std::vector<Pixel> cut(std::vector<Pixel> pixels, std::uint32_t k) {
    for (Pixel& pixel : pixels) {
        auto& s = pixel.samples;
        s.erase(std::unique(s.begin(), s.end()), s.end());
        if (s.size() > k) s.resize(k);
    }
    return pixels;
}

std::vector<Mesh> soup(std::uint64_t seed, float oddOpacity) {
    Random random(seed);
    std::vector<Mesh> meshes(4);
    for (std::size_t m = 0; m < meshes.size(); ++m) {
        meshes[m].opacity = m % 2 ? oddOpacity : 1.0f;
        meshes[m].worldFromObject = glm::rotate(
            glm::translate(glm::dmat4(1.0), {0.3 * random.unit(), 0, 0.2 * double(m)}),
            random.in(0, 6), glm::dvec3(1, 2, 3));
        const double largest = m == 3 ? 30.0 : 0.3;
        for (int i = 0; i < 400; ++i) {
            glm::vec3 p[3];
            const glm::dvec3 at(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1));
            const double size = largest * std::pow(random.unit(), 3.0);
            for (glm::vec3& c : p)
                c = at + size * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                           random.in(-1, 1));
            meshes[m].triangle(p[0], p[1], p[2]);
        }
    }
    meshes.push_back(meshes[0]);  // every opaque sample of it is a copy
    return meshes;
}

}  // namespace

TEST_CASE("the parallel rasteriser keeps what a sort of all samples keeps",
          "[raster][exact][threads]") {
    const std::uint32_t side = 150;
    const Projection p = viewFrom({1, 2, 3}, side);
    for (std::uint64_t seed = 0; seed < 2; ++seed) {
        std::vector<Mesh> meshes = soup(seed, 1.0f);
        const auto all = bruteForce(p, side, meshes);
        for (const std::uint32_t k : {1u, 4u, 64u}) {
            const auto expected = cut(all, k);
            std::uint64_t droppedFirst = 0;
            Random random(seed);
            for (const int threads : {1, 2, 8}) {
                const tbb::global_control most(
                    tbb::global_control::max_allowed_parallelism, std::size_t(threads));
                tbb::task_arena arena(threads);
                for (Mesh& mesh : meshes)
                    shuffleTriangles(mesh, random);
                random.shuffle(meshes);
                std::uint64_t dropped = 0;
                std::vector<Pixel> found;
                arena.execute([&] { found = nearest(p, side, k, meshes, &dropped); });
                INFO("seed " << seed << ", k " << k << ", threads " << threads);
                CHECK(found == expected);
                if (threads == 1) droppedFirst = dropped;
                CHECK(dropped == droppedFirst);
            }
        }
    }
}

TEST_CASE("every instruction set draws the same samples", "[raster][twin]") {
    // A side that is no multiple of anything.
    const std::uint32_t side = 131;
    const Projection p = viewFrom({1, 2, 3}, side);
    std::vector<Mesh> meshes = soup(7, 1.0f);
    for (const bool copies : {true, false}) {
        if (!copies) meshes.pop_back();
        const auto all = bruteForce(p, side, meshes);
        for (std::int64_t left = hwy::SupportedTargets(), target = 0; left;
             left ^= target) {
            target = left & -left;
            hwy::SetSupportedTargetsForTest(target);
            for (const std::uint32_t k : {1u, 3u, 16u}) {
                std::uint64_t dropped = 0;
                INFO(hwy::TargetName(target) << ", k " << k);
                CHECK(nearest(p, side, k, meshes, &dropped) == cut(all, k));
            }
        }
        hwy::SetSupportedTargetsForTest(0);
    }
}

TEST_CASE("a grid holds every sample, in whatever order they come and band by band",
          "[raster][exact]") {
    const std::uint32_t side = 150;
    const Projection p = viewFrom({1, 2, 3}, side);
    std::vector<Mesh> meshes = soup(5, 0.3f);
    const auto expected = bruteForce(p, side, meshes);
    Random random(3);
    for (const int threads : {1, 8}) {
        tbb::task_arena arena(threads);
        for (Mesh& mesh : meshes)
            shuffleTriangles(mesh, random);
        random.shuffle(meshes);
        std::vector<Pixel> found, bands;
        arena.execute([&] {
            found = everything(p, side, 0, 3, meshes);
            for (std::uint32_t row = 0; row < 3; ++row) {
                const auto band = everything(p, side, row, row + 1, meshes);
                bands.insert(bands.end(), band.begin(), band.end());
            }
        });
        CHECK(found == expected);
        CHECK(bands == expected);
    }
}

TEST_CASE("a mesh of more triangles than a batch comes out whole", "[raster]") {
    // 300 x 300 quads over 150 x 150 pixels, in one plane that faces the eye.
    const std::uint32_t side = 150, n = 300;
    Projection p;
    p.kind = ProjectionKind::orthographic;
    p.scale = {side, -double(side)};
    p.offset = {0.0, double(side)};
    Mesh mesh;
    for (std::uint32_t j = 0; j <= n; ++j) {
        for (std::uint32_t i = 0; i <= n; ++i)
            mesh.positions.emplace_back(float(i) / n, float(j) / n, -1.0f);
    }
    for (std::uint32_t j = 0; j < n; ++j) {
        for (std::uint32_t i = 0; i < n; ++i) {
            const std::uint32_t a = j * (n + 1) + i;
            for (std::uint32_t v : {a, a + 1, a + n + 2, a, a + n + 2, a + n + 1})
                mesh.indices.push_back(v);
        }
    }
    mesh.opacity = 0.5f;  // a pixel hit twice has two samples
    Random random(1);
    for (const bool shuffled : {false, true}) {
        if (shuffled) shuffleTriangles(mesh, random);
        const auto pixels = everything(p, side, 0, 3, {mesh});
        CHECK(std::all_of(pixels.begin(), pixels.end(), [](const Pixel& pixel) {
            return pixel.samples.size() == 1 && pixel.samples[0].first == 1.0f;
        }));
    }
}

TEST_CASE("triangles spread over a huge vertex array are found there", "[raster]") {
    const std::uint32_t side = 16;
    Projection p;
    p.kind = ProjectionKind::orthographic;
    p.scale = {side, -double(side)};
    p.offset = {0.0, double(side)};
    Mesh mesh;
    mesh.positions.assign(100'000, glm::vec3(NAN));
    mesh.positions[5] = {0, 0, -1};
    mesh.positions[50'000] = {2, 0, -1};
    mesh.positions[99'999] = {0, 2, -1};
    mesh.indices = {5, 50'000, 99'999};
    std::uint64_t dropped = 0;
    for (const Pixel& pixel : nearest(p, side, 1, {mesh}, &dropped))
        CHECK(pixel.samples.size() == 1);
}
