// Strands by area: closed forms, an independent polygon clipper, and rays in double.
#include "raster/strand.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <utility>

#include "bake/casters.h"
#include "raster/sample_grid.h"

using namespace mtsm;
using namespace mtsm::raster;
using mtsm::test::Random;

namespace {

/// Strands that own their arrays.
struct Strands {
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> begin{0};
    std::vector<float> widths, opacities;  // per point, or empty
    float width = 1.0f, opacity = 1.0f;
    glm::dmat4 worldFromObject{1.0};

    void strand(std::initializer_list<glm::vec3> p) {
        points.insert(points.end(), p);
        begin.push_back(std::uint32_t(points.size()));
    }
    [[nodiscard]] StrandsView view() const {
        StrandsView v;
        v.points = points.data();
        v.begin = begin.data();
        v.strandCount = begin.size() - 1;
        v.widths = widths.empty() ? nullptr : widths.data();
        v.opacities = opacities.empty() ? nullptr : opacities.data();
        v.width = width;
        v.opacity = opacity;
        v.worldFromObject = worldFromObject;
        return v;
    }
};

/// Light space is world space (z forward), and a pixel is one unit wide; with `scale`,
/// 1 / scale.
Projection flat(double scale = 1.0) {
    Projection p;
    p.kind = ProjectionKind::orthographic;
    p.right = {1, 0, 0};
    p.up = {0, 1, 0};
    p.forward = {0, 0, 1};
    p.scale = {scale, -scale};
    p.offset = {0.0, 0.0};
    return p;
}

/// From the origin along +z; `side` pixels, 90 degrees wide.
Projection camera(std::uint32_t side) {
    Projection p = flat(0.5 * side);
    p.kind = ProjectionKind::perspective;
    p.offset = {0.5 * side, 0.5 * side};
    p.near = 0.01;
    return p;
}

struct Sample {
    float z, opacity;
    friend bool operator==(const Sample& a, const Sample& b) {
        return a.z == b.z && a.opacity == b.opacity;
    }
};

struct Drawn {
    std::uint32_t side;
    std::vector<std::vector<Sample>> pixels;  // row-major, nearest first
    StrandCounts counts;

    [[nodiscard]] const std::vector<Sample>& at(std::uint32_t x, std::uint32_t y) const {
        return pixels[std::size_t(y) * side + x];
    }
    /// Of all samples: with opacity 1, the area of what was drawn.
    [[nodiscard]] double sum() const {
        double total = 0;
        for (const auto& pixel : pixels)
            for (const Sample& s : pixel)
                total += s.opacity;
        return total;
    }
    [[nodiscard]] std::size_t samples() const {
        std::size_t total = 0;
        for (const auto& pixel : pixels)
            total += pixel.size();
        return total;
    }
};

Drawn draw(const Projection& projection, std::uint32_t side,
           const std::vector<Strands>& all, std::uint32_t firstRow = 0,
           std::uint32_t endRow = 1000) {
    const std::uint32_t tiles = (side + 63) / 64;
    SampleGrid grid({side, side, 1, 1, {}}, firstRow, std::min(endRow, tiles), 1u << 30);
    StrandRasteriser raster(projection, grid, [&](std::uint64_t) {
        grid.settle();
        return Status{};
    });
    for (const Strands& strands : all)
        REQUIRE(raster.add(strands.view()));
    REQUIRE(raster.finish());
    Drawn drawn{side, {}, raster.counts()};
    drawn.pixels.resize(std::size_t(side) * side);
    for (std::uint32_t ty = firstRow; ty < grid.endRow(); ++ty) {
        for (std::uint32_t tx = 0; tx < tiles; ++tx) {
            const SampleTile& tile = grid.tile(tx, ty);
            tile.forEachPixel([&](std::uint32_t p, const PixelSamples& samples) {
                const std::uint32_t x = tx * 64 + p % tile.width(),
                                    y = ty * 64 + p / tile.width();
                for (std::size_t i = 0; i < samples.count; ++i)
                    drawn.pixels[std::size_t(y) * side + x].push_back(
                        {samples.z[i], samples.opacity[0][i]});
            });
        }
    }
    return drawn;
}

Drawn draw(const Projection& projection, std::uint32_t side, const Strands& strands) {
    return draw(projection, side, std::vector<Strands>{strands});
}

// --- a second opinion: clip polygons by pixels -----------------------------------------

using Outline = std::vector<glm::dvec2>;

Outline keepAbove(const Outline& in, int axis, double limit, double sign) {
    Outline out;
    for (std::size_t i = 0; i < in.size(); ++i) {
        const glm::dvec2 a = in[i], b = in[(i + 1) % in.size()];
        const double da = sign * (a[axis] - limit), db = sign * (b[axis] - limit);
        if (da >= 0) out.push_back(a);
        if ((da >= 0) != (db >= 0)) out.push_back(a + (b - a) * (da / (da - db)));
    }
    return out;
}

double areaIn(const Outline& outline, double x, double y) {
    Outline o = keepAbove(outline, 0, x, 1);
    o = keepAbove(o, 0, x + 1, -1);
    o = keepAbove(o, 1, y, 1);
    o = keepAbove(o, 1, y + 1, -1);
    double twice = 0;
    for (std::size_t i = 0; i < o.size(); ++i) {
        const glm::dvec2 a = o[i], b = o[(i + 1) % o.size()];
        twice += a.x * b.y - a.y * b.x;
    }
    return 0.5 * twice;
}

/// The quads of a strand on the raster: square ends, mitred joints.
std::vector<Outline> quadsOf(const std::vector<glm::dvec2>& line,
                             const std::vector<double>& width) {
    const auto normal = [&](std::size_t i) {
        const glm::dvec2 d = glm::normalize(line[i + 1] - line[i]);
        return glm::dvec2(d.y, -d.x);
    };
    std::vector<glm::dvec2> side(line.size());
    for (std::size_t i = 0; i < line.size(); ++i) {
        const glm::dvec2 before = normal(i > 0 ? i - 1 : 0);
        const glm::dvec2 after = normal(std::min(i, line.size() - 2));
        const glm::dvec2 middle = glm::normalize(before + after);
        side[i] = middle * (0.5 * width[i] / glm::dot(middle, after));
    }
    std::vector<Outline> quads;
    for (std::size_t i = 0; i + 1 < line.size(); ++i)
        quads.push_back({line[i] - side[i], line[i] + side[i], line[i + 1] + side[i + 1],
                         line[i + 1] - side[i + 1]});
    return quads;
}

}  // namespace

TEST_CASE("a strand of width w across a pixel of width p stops a w / p of its light",
          "[raster][exact]") {
    for (const double p : {1.0, 0.25, 3.0}) {
        for (const float w : {0.5f, 0.01f, 1e-5f}) {
            Strands s;
            s.width = float(w * p);
            s.opacity = 0.4f;
            s.strand({glm::vec3(4.5 * p, -2 * p, 3), glm::vec3(4.5 * p, -6 * p, 3)});
            const Drawn d = draw(flat(1 / p), 16, s);
            for (std::uint32_t y = 2; y < 6; ++y) {
                REQUIRE(d.at(4, y).size() == 1);
                CHECK(d.at(4, y)[0].opacity == Approx(0.4 * w).epsilon(1e-5));
                CHECK(d.at(4, y)[0].z == Approx(3));
            }
            CHECK(d.samples() == 4);
        }
    }
}

TEST_CASE("a slanted strand gives each pixel the area that it covers there",
          "[raster][exact]") {
    // At 45 degrees through the pixel's corners: length sqrt(2), less the two corners
    // that the sides cut off, each a triangle of base w and height w / 2.
    const double w = 0.2;
    Strands s;
    s.width = float(w);
    s.strand({{0, 0, 2}, {8, -8, 2}});
    const Drawn d = draw(flat(), 16, s);
    const double area = w * std::sqrt(2.0) - 0.5 * w * w;
    for (std::uint32_t i = 1; i < 7; ++i) {
        REQUIRE(d.at(i, i).size() == 1);
        CHECK(d.at(i, i)[0].opacity == Approx(area).epsilon(1e-6));
        // Its neighbours have one of those triangles, half from either end.
        REQUIRE(d.at(i, i - 1).size() == 1);
        CHECK(d.at(i, i - 1)[0].opacity == Approx(0.25 * w * w).epsilon(1e-6));
    }
}

TEST_CASE("the ends of a strand may lie inside a pixel", "[raster][exact]") {
    Strands s;
    s.width = 0.25f;
    s.strand({{3.5f, -2.25f, 1}, {3.5f, -2.75f, 3}});
    const Drawn d = draw(flat(), 8, s);
    REQUIRE(d.samples() == 1);
    CHECK(d.at(3, 2)[0].opacity == Approx(0.125));
    CHECK(d.at(3, 2)[0].z == Approx(2));
}

TEST_CASE("segments of one strand in one pixel are one sample, two strands are two",
          "[raster][exact]") {
    Strands s;
    s.width = 0.1f;
    s.opacity = 0.5f;
    s.strand({{2.5f, -1, 5}, {2.5f, -1.25f, 5}, {2.5f, -1.5f, 5}, {2.5f, -2, 5}});
    s.strand({{2, -1.5f, 7}, {3, -1.5f, 7}});
    const Drawn d = draw(flat(), 8, s);
    REQUIRE(d.at(2, 1).size() == 2);
    CHECK(d.at(2, 1)[0].opacity == Approx(0.05));
    CHECK(d.at(2, 1)[0].z == Approx(5));
    CHECK(d.at(2, 1)[1].opacity == Approx(0.05));
    CHECK(d.at(2, 1)[1].z == Approx(7));
}

TEST_CASE("a strand that leaves a pixel and comes back is two samples there",
          "[raster][exact]") {
    Strands s;
    s.width = 0.1f;
    s.strand({{2.2f, -1.9f, 1}, {2.2f, -2.5f, 1}, {2.8f, -2.5f, 1}, {2.8f, -1.9f, 1}});
    const Drawn d = draw(flat(), 8, s);
    REQUIRE(d.at(2, 1).size() == 2);
    for (const Sample& sample : d.at(2, 1))
        CHECK(sample.opacity == Approx(0.1 * 0.1).epsilon(1e-4));
    CHECK(d.at(2, 2).size() == 1);
}

TEST_CASE("inside a strand wider than pixels coverage is 1", "[raster][exact]") {
    Strands s;
    s.width = 100.5f;
    s.opacity = 0.7f;
    s.strand({{128, -10, 4}, {128, -200, 4}});
    const Drawn d = draw(flat(), 256, s);
    for (std::uint32_t y = 10; y < 200; ++y) {
        for (std::uint32_t x = 78; x < 178; ++x) {
            REQUIRE(d.at(x, y).size() == 1);
            REQUIRE(d.at(x, y)[0].opacity == Approx(0.7).epsilon(1e-5));
        }
        REQUIRE(d.at(77, y)[0].opacity == Approx(0.7 * 0.25));
        REQUIRE(d.at(178, y)[0].opacity == Approx(0.7 * 0.25));
    }
    CHECK(d.sum() == Approx(0.7 * 100.5 * 190).epsilon(1e-6));
}

TEST_CASE("pixels hold what clipping the ribbon's quads by them gives",
          "[raster][twin]") {
    Random random(11);
    for (int run = 0; run < 60; ++run) {
        // A curve without tight bends, tapered, across several tiles.
        const double size = std::pow(10.0, random.in(-1, 1.3));
        const double widest = std::pow(10.0, random.in(-3, 0.3)) * std::min(size, 2.0);
        glm::dvec2 at(random.in(20, 130), random.in(20, 130));
        double turn = random.in(0, 6.28);
        Strands s;
        s.opacity = 1.0f;
        std::vector<glm::dvec2> line;
        std::vector<double> width;
        for (int i = 0; i < 12; ++i) {
            const glm::vec3 p(float(at.x), float(-at.y), 1.0f);
            s.points.push_back(p);
            s.widths.push_back(float(widest * (1.0 - i / 12.0)));
            line.emplace_back(p.x, -p.y);
            width.push_back(s.widths.back());
            turn += random.in(-0.4, 0.4);
            at += size * glm::dvec2(std::cos(turn), std::sin(turn));
        }
        s.begin.push_back(12);
        const Drawn d = draw(flat(), 150, s);
        const auto quads = quadsOf(line, width);
        double worst = 0, total = 0;
        for (std::uint32_t y = 0; y < 150; ++y) {
            for (std::uint32_t x = 0; x < 150; ++x) {
                double expected = 0, found = 0;
                for (const Outline& q : quads)
                    expected += areaIn(q, x, y);
                for (const Sample& sample : d.at(x, y))
                    found += sample.opacity;
                worst = std::max(worst, std::abs(found - std::clamp(expected, 0.0, 1.0)));
                total += std::clamp(expected, 0.0, 1.0);
            }
        }
        INFO("run " << run << ", segments of " << size << ", width " << widest);
        CHECK(worst < 2e-5 * std::max(widest, 0.01));
        CHECK(d.sum() == Approx(total).epsilon(1e-5));
    }
}

TEST_CASE("the areas of all pixels add up to that of the ribbon", "[raster][exact]") {
    // In perspective a straight strand of constant width in a plane z = const seen
    // through the axis: width w / z, length l / z pixels.
    Random random(3);
    const std::uint32_t side = 200;
    for (int run = 0; run < 50; ++run) {
        const double z = random.in(2, 50), w = std::pow(10.0, random.in(-5, -1));
        const double turn = random.in(0, 6.28), reach = random.in(0.1, 0.9) * z;
        const glm::dvec3 e(std::cos(turn) * reach, std::sin(turn) * reach, 0);
        Strands s;
        s.width = float(w);
        const glm::dvec3 c(0, 0, z);
        s.strand({glm::vec3(c - e), glm::vec3(c - 0.3 * e), glm::vec3(c + e)});
        const double scale = 0.5 * side;
        CHECK(
            draw(camera(side), side, s).sum() ==
            Approx(double(s.width) * 2 * reach * scale * scale / (z * z)).epsilon(1e-5));
    }
}

TEST_CASE("in perspective a ribbon holds the rays that pass it within half its width",
          "[raster][twin]") {
    // Brute force: rays of a fine grid against the distance of two lines in space.
    Random random(5);
    const std::uint32_t side = 16;
    const int sub = 64;
    Projection p = camera(side);
    p.scale = {10.0, -6.0};
    for (int run = 0; run < 6; ++run) {
        const auto end = [&] {
            const double z = random.in(2, 6);
            return glm::dvec3(random.in(-0.6, 0.6) * z, random.in(-0.9, 0.9) * z, z);
        };
        const glm::dvec3 a = glm::vec3(end()), b = glm::vec3(end());
        Strands s;
        s.width = 0.1f;
        s.strand({glm::vec3(a), glm::vec3(b)});
        const Drawn d = draw(p, side, s);
        double inside = 0, error = 0;
        for (std::uint32_t y = 0; y < side; ++y) {
            for (std::uint32_t x = 0; x < side; ++x) {
                double met = 0;
                for (int k = 0; k < sub * sub; ++k) {
                    const glm::dvec2 r(x + (k % sub + 0.5) / sub,
                                       y + (k / sub + 0.5) / sub);
                    const glm::dvec3 ray = p.lightFromRaster(r, 1.0);
                    const glm::dvec3 n = glm::normalize(glm::cross(ray, b - a));
                    if (std::abs(glm::dot(n, a)) > 0.05) continue;
                    // Where along the strand the ray passes.
                    const glm::dvec3 m = glm::cross(ray, n);
                    const double t = glm::dot(m, -a) / glm::dot(m, b - a);
                    met += t >= 0 && t <= 1;
                }
                met /= sub * sub;
                const double found = d.at(x, y).empty() ? 0 : d.at(x, y)[0].opacity;
                error = std::max(error, std::abs(met - found));
                inside += met;
            }
        }
        INFO("run " << run);
        CHECK(error < 0.03);  // of the grid of rays, and the ends are not quite square
        CHECK(d.sum() == Approx(inside).epsilon(0.01));
    }
}

TEST_CASE("depth follows the strand, also in perspective", "[raster][exact]") {
    // Along x from z = 2 to z = 6 so that the middle of each pixel has its own depth.
    const std::uint32_t side = 64;
    const Projection p = camera(side);
    Strands s;
    s.width = 0.001f;
    const glm::dvec3 a = p.lightFromRaster({4.0, 30.5}, 2.0);
    const glm::dvec3 b = p.lightFromRaster({60.0, 30.5}, 6.0);
    s.strand({glm::vec3(a), glm::vec3(b)});
    const Drawn d = draw(p, side, s);
    for (std::uint32_t x = 5; x < 59; ++x) {
        const double t = (x + 0.5 - 4.0) / 56.0;
        REQUIRE(d.at(x, 30).size() == 1);
        // The ribbon narrows towards the far end: its centroid is a little off centre.
        CHECK(d.at(x, 30)[0].z == Approx(1.0 / ((1 - t) / 2 + t / 6)).epsilon(2e-4));
    }
}

TEST_CASE("opacity may vary along a strand", "[raster][exact]") {
    Strands s;
    s.width = 0.5f;
    s.opacities = {0.0f, 1.0f};
    s.strand({{0, -1.5f, 1}, {8, -1.5f, 1}});
    const Drawn d = draw(flat(), 8, s);
    for (std::uint32_t x = 0; x < 8; ++x)
        CHECK(d.at(x, 1)[0].opacity == Approx(0.5 * (x + 0.5) / 8));
}

TEST_CASE("widths grow by the cube root of the transform's determinant",
          "[raster][exact]") {
    Strands s;
    s.width = 0.01f;
    s.worldFromObject = glm::scale(glm::dmat4(1.0), glm::dvec3(1, 1, 27));
    s.strand({{4.5f, -2, 0.1f}, {4.5f, -6, 0.1f}});
    const Drawn d = draw(flat(), 16, s);
    CHECK(d.at(4, 3)[0].opacity == Approx(0.03));
    CHECK(d.at(4, 3)[0].z == Approx(2.7));
}

TEST_CASE("near and far cut strands", "[raster][exact]") {
    Projection p = camera(64);
    p.near = 1.0;
    p.far = 4.0;
    Strands s;
    s.width = 0.01f;
    // Along a line through (0, 0, 2) from before the eye to beyond far.
    s.strand({{-0.3f, 0.02f, -4}, {0.0f, 0.02f, 2}, {0.4f, 0.02f, 10}});
    s.strand({{0.1f, 0.1f, 0.5f}, {0.2f, 0.1f, 0.9f}});
    s.strand({{0.1f, 0.1f, 2}, {0.2f, 0.1f, 2}});
    const Drawn d = draw(p, 64, s);
    CHECK(d.counts.strands == 3);
    CHECK(d.counts.segments == 4);
    CHECK(d.counts.clipped == 1);
    CHECK(d.counts.outside == 1);
    CHECK(d.counts.leavesWindow == 0);
    float nearest = 1e9f, furthest = 0;
    for (const auto& pixel : d.pixels) {
        for (const Sample& sample : pixel) {
            nearest = std::min(nearest, sample.z);
            furthest = std::max(furthest, sample.z);
        }
    }
    CHECK(nearest >= 1.0f);
    CHECK(nearest < 1.2f);
    CHECK(furthest <= 4.0f);
    CHECK(furthest > 3.5f);  // a run is 4 footprints, .5 here
}

TEST_CASE("strands outside the window are counted, and cast in it what reaches in",
          "[raster]") {
    Strands s;
    s.width = 0.1f;
    s.strand({{-50, -4.5f, 1}, {500, -4.5f, 1}});
    s.strand({{-5, -4, 1}, {-5, 4, 1}});
    s.strand({{1, -1, 1}, {2, -1.5f, 1}});
    s.strand({{-1e9f, -2.5f, 1}, {1e9f, -2.5f, 1}});
    const Drawn d = draw(flat(), 16, s);
    CHECK(d.counts.clipped == 2);
    CHECK(d.counts.outside == 1);
    CHECK(d.counts.leavesWindow == 3);
    for (std::uint32_t x = 0; x < 16; ++x) {
        CHECK(d.at(x, 4)[0].opacity == Approx(0.1));
        CHECK(d.at(x, 2)[0].opacity == Approx(0.1).epsilon(1e-4));
    }
}

TEST_CASE("a strand along the view ray has no area and does no harm", "[raster]") {
    Strands s;
    s.width = 0.1f;
    s.strand({{0, 0, 2}, {0, 0, 3}, {0, 0, 9}});
    CHECK(draw(camera(63), 63, s).samples() == 0);
    // On its way to somewhere else it changes nothing but the depth.
    Strands bent;
    bent.width = 0.1f;
    bent.strand({{1, -1.5f, 2}, {3, -1.5f, 2}, {3, -1.5f, 9}, {5, -1.5f, 9}});
    const Drawn d = draw(flat(), 8, bent);
    CHECK(d.samples() == 4);
    CHECK(d.at(2, 1)[0].z == Approx(2));
    CHECK(d.at(3, 1)[0].z == Approx(9));
    CHECK(d.sum() == Approx(0.4));
}

TEST_CASE("a strand seen nearly end-on is several samples along its depth", "[raster]") {
    Strands s;
    s.width = 0.2f;
    s.strand({{1.2f, -1.5f, 10}, {1.8f, -1.5f, 110}});
    const Drawn d = draw(flat(), 8, s);
    const auto& samples = d.at(1, 1);
    float z = 10;
    for (const Sample& sample : samples) {
        CHECK(sample.z > z);
        CHECK(sample.z < z + 7);
        z = sample.z;
    }
    CHECK(z > 110 - 7);
    CHECK(z < 110);
    CHECK(samples.size() < 26);
    CHECK(d.sum() == Approx(0.2 * 0.6).epsilon(1e-5));
}

TEST_CASE("what is not finite is counted, what is transparent casts nothing",
          "[raster][bad-input]") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    Strands s;
    s.width = 0.1f;
    s.strand({{1, -1, 1}, {nan, -1, 1}, {3, -1, 1}});
    s.strand({{1, -1, 1}, {2, -inf, 1}});
    s.strand({{1, -1, 1}, {2, -1, 1}});
    Strands thin = s, clear = s, badWidth = s;
    thin.width = 0.0f;
    clear.opacity = 0.0f;
    badWidth.width = nan;
    const Drawn d = draw(flat(), 8, {s, thin, clear, badWidth});
    CHECK(d.counts.strands == 12);
    CHECK(d.counts.nonFinite == 9);
    CHECK(d.counts.transparent == 2);
    CHECK(d.sum() == Approx(0.1));
}

TEST_CASE("ten million units from the origin a strand is as exact as at home",
          "[raster][exact]") {
    Strands s;
    s.width = 0.001f;
    s.strand({{-0.5f, 0.25f, 3}, {0.1f, 0.3f, 2.5f}, {0.6f, -0.2f, 3.5f}});
    const Drawn home = draw(camera(128), 128, s);
    Projection away = camera(128);
    const glm::dvec3 offset(1e7, -1e7, 3e6);
    away.eye = offset;
    s.worldFromObject = glm::translate(glm::dmat4(1.0), offset);
    const Drawn far = draw(away, 128, s);
    CHECK(far.pixels == home.pixels);
}

TEST_CASE("hairpins, knots and points on top of each other stay within bounds",
          "[raster]") {
    Random random(9);
    Strands s;
    for (int i = 0; i < 300; ++i) {
        for (int k = 0; k < 8; ++k) {
            s.points.emplace_back(random.in(-3, 40), random.in(-40, 3), random.in(1, 2));
            if (k % 3 == 2) s.points.back() = s.points[s.points.size() - 2];
            if (k % 5 == 4) s.points.back() = s.points[s.points.size() - 3];
            s.widths.push_back(float(std::pow(random.unit(), 6.0) * 30));
        }
        s.begin.push_back(std::uint32_t(s.points.size()));
    }
    const Drawn d = draw(flat(), 32, s);
    for (const auto& pixel : d.pixels) {
        for (const Sample& sample : pixel) {
            REQUIRE(sample.opacity > 0);
            REQUIRE(sample.opacity <= 1);
            REQUIRE(sample.z >= 0.99999f);
            REQUIRE(sample.z <= 2.00001f);
        }
    }
}

TEST_CASE("sizes at the ends of what a float holds do no harm", "[raster][bad-input]") {
    Random random(17);
    Projection p = camera(96);
    p.near = 0.0;
    const auto any = [&] {
        return float(random.in(-1, 1) * std::pow(10.0, random.in(-37, 38)));
    };
    Strands s;
    for (int i = 0; i < 3000; ++i) {
        for (int k = 0; k < 5; ++k) {
            const bool tame = random.unit() < 0.3;
            s.points.emplace_back(tame ? random.in(-1, 1) : any(),
                                  tame ? random.in(-1, 1) : any(), std::abs(any()));
            s.widths.push_back(std::abs(any()) * float(random.unit() < 0.5));
        }
        s.begin.push_back(std::uint32_t(s.points.size()));
    }
    for (const Drawn& d : {draw(p, 96, s), draw(flat(30), 96, s)}) {
        CHECK(d.samples() > 0);
        std::size_t bad = 0;
        for (const auto& pixel : d.pixels) {
            for (const Sample& sample : pixel)
                bad += !(sample.opacity > 0 && sample.opacity <= 1 && sample.z > 0 &&
                         std::isfinite(sample.z));
        }
        CHECK(bad == 0);
    }
}

TEST_CASE("the samples depend neither on threads nor on the rows held nor on batches",
          "[raster][threads]") {
    Random random(21);
    const std::uint32_t side = 300;
    Strands s;
    s.opacity = 0.5f;
    for (int i = 0; i < 20000; ++i) {
        glm::dvec3 at(random.in(-3, 3), random.in(-3, 3), random.in(2, 6));
        const int count = 2 + int(random.unit() * 14);
        for (int k = 0; k < count; ++k) {
            s.points.emplace_back(at);
            s.widths.push_back(float(0.02 * random.unit()));
            at += 0.05 * glm::dvec3(random.in(-1, 1), random.in(-1, 1), random.in(-1, 1));
        }
        s.begin.push_back(std::uint32_t(s.points.size()));
    }
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 4);
    std::array<Drawn, 2> whole;
    for (int threads : {1, 4}) {
        tbb::task_arena arena(threads);
        arena.execute([&] { whole[threads > 1] = draw(camera(side), side, s); });
    }
    CHECK(whole[0].pixels == whole[1].pixels);
    CHECK(whole[0].counts.segments == s.points.size() - s.begin.size() + 1);
    const Drawn upper = draw(camera(side), side, {s}, 0, 2);
    const Drawn lower = draw(camera(side), side, {s}, 2, 5);
    const std::size_t split = std::size_t(128) * side;
    CHECK(std::equal(upper.pixels.begin(), upper.pixels.begin() + split,
                     whole[0].pixels.begin()));
    CHECK(std::equal(lower.pixels.begin() + split, lower.pixels.end(),
                     whole[0].pixels.begin() + split));
    CHECK(lower.counts.clipped == whole[0].counts.clipped);
    CHECK(lower.counts.outside == whole[0].counts.outside);

    // The same strands in views of a few each.
    std::vector<Strands> parts;
    for (std::size_t first = 0; first < 20000; first += 999) {
        Strands& part = parts.emplace_back();
        part.opacity = s.opacity;
        const std::size_t end = std::min<std::size_t>(20000, first + 999);
        for (std::size_t k = first; k < end; ++k)
            part.begin.push_back(s.begin[k + 1] - s.begin[first]);
        part.points.assign(s.points.begin() + s.begin[first],
                           s.points.begin() + s.begin[end]);
        part.widths.assign(s.widths.begin() + s.begin[first],
                           s.widths.begin() + s.begin[end]);
    }
    CHECK(draw(camera(side), side, parts).pixels == whole[0].pixels);
}
