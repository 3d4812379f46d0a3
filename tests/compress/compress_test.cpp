// Samples to layers: the bounds that compress.h states, checked by brute force.
#include "mtsm/compress.h"

#include <catch2/catch.hpp>
#include <string>
#include <utility>

#include "compress/compress_tile.h"
#include "compress/pixels.h"
#include "map_fixture.h"
#include "trace/traverse.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

struct Case {
    std::string name;
    Pixel pixel;
};

/// Samples of all kinds, plain ones and ones made to break something.
std::vector<Case> allKinds() {
    std::vector<Case> cases;
    const auto add = [&](std::string name, Pixel pixel) {
        sortByDepth(pixel);
        cases.push_back({std::move(name), std::move(pixel)});
    };
    add("nothing", {});
    add("one", {{3.0f, 0.5f}});
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
        add("fur", randomPixel(seed, 400, 5.0, 6.0, 0.001, 0.05));
        add("coloured fur", randomPixel(seed, 400, 5.0, 6.0, 0.0, 0.05, true));
        add("foliage", randomPixel(seed, 60, 2.0, 9.0, 0.0, 1.0, true));
        add("few", randomPixel(seed, 3, 2.0, 9.0, 0.0, 0.3, true));
    }
    Pixel smoke, equal, gaps, wide, alternating, mixed, tail, clusters, walls;
    for (int i = 0; i < 1000; ++i)
        smoke.emplace_back(4.0f + i * 0x1p-8f, 0.004f + 0.003f * std::sin(0.03f * i));
    for (int i = 0; i < 300; ++i)
        equal.emplace_back(7.0f, 0.001f * float(i % 30));
    for (int i = 0; i < 120; ++i)
        gaps.emplace_back(float(std::pow(1.3, i / 10)) + 1e-4f * (i % 10), 0.01f);
    for (int i = 0; i < 600; ++i)
        wide.emplace_back(float(std::pow(10.0, -6.0 + i * (15.0 / 599))), 0.02f);
    for (int i = 0; i < 200; ++i)
        alternating.emplace_back(1.0f + 0.01f * i, i % 2 ? 1e-7f : 1.0f - 1e-7f);
    const float opacities[] = {0.0f, 1e-7f, 1.0f - 1e-7f, 1.0f, 0.5f, 1e-3f, 0.02f};
    Noise noise(5);
    for (int i = 0; i < 500; ++i)
        mixed.push_back({float(1 + noise.below(80)),
                         {opacities[noise.below(7)], opacities[noise.below(7)],
                          opacities[noise.below(7)]}});
    for (int i = 0; i < 2000; ++i)
        tail.emplace_back(float(noise.between(1.0, 3.0)), 0.06f);
    for (int i = 0; i < 20; ++i)
        clusters.emplace_back((i < 10 ? 1.0f : 100.0f) + 1e-3f * i, 0.002f);
    for (int i = 0; i < 200; ++i)
        walls.emplace_back(float(noise.between(1.0, 2.0)),
                           noise.unit() < 0.1 ? 1.0f : 0.01f);
    add("smoke", smoke);
    add("equal depths", equal);
    add("gaps", gaps);
    add("depths 1e-6 to 1e9", wide);
    add("alternating", alternating);
    add("mixed", mixed);
    add("long tail", tail);
    add("two clusters", clusters);
    add("walls among fur", walls);
    Pixel oneDark = randomPixel(9, 300, 1.0, 2.0, 0.001, 0.02, true);
    oneDark[20].opacity[0] = 1.0f;
    oneDark[200].opacity = {1.0f, 1.0f, 1.0f};
    add("one channel dark early", oneDark);
    return cases;
}

std::vector<CompressOptions> severalOptions() {
    std::vector<CompressOptions> all;
    for (const float tolerance : {1e-7f, 1e-5f, 0.001f, 0.01f, 0.05f, 0.5f, 1.0f}) {
        CompressOptions o;
        o.tolerance = tolerance;
        all.push_back(o);
        o.lengthPerDepth = 0.02;
        o.lengthBase = 0.01;
        all.push_back(o);
        o.opticalDepth = 1e9f;
        o.channels = 3;
        all.push_back(o);
    }
    return all;
}

/// Calls body(case, options, layers, report) for all of both.
template <typename Body>
void forAll(const Body& body) {
    for (const Case& c : allKinds()) {
        for (const CompressOptions& options : severalOptions()) {
            INFO(c.name << ", tolerance " << options.tolerance << ", length "
                        << options.lengthBase << ", channels " << options.channels);
            CompressReport report;
            const LayerList layers = compressed(c.pixel, options, report);
            body(c.pixel, options, layers, report);
        }
    }
}

bool isDark(const LayerList& layers, std::size_t i, std::uint32_t channels) {
    for (std::uint32_t c = 0; c < channels; ++c) {
        if (layers.v[c][i] != 0.0f) return false;
    }
    return true;
}

/// Opaque samples at the depth of the opaque one before: kept once.
Pixel withoutCopies(const Pixel& pixel, std::uint32_t channels) {
    Pixel kept;
    for (const Sample& s : pixel) {
        const auto opaque = [&](const Sample& t) {
            for (std::uint32_t c = 0; c < channels; ++c) {
                if (t.opacity[c] != 1.0f) return false;
            }
            return true;
        };
        if (kept.empty() || kept.back().z != s.z || !opaque(s) || !opaque(kept.back()))
            kept.push_back(s);
    }
    return kept;
}

/// Is this a pixel that a map may hold?
void checkMap(const LayerList& layers, std::uint32_t channels) {
    Tile t;
    t.begin.assign(65, std::uint32_t(layers.size()));
    t.begin[0] = 0;
    t.z = layers.z;
    t.n = layers.n;
    for (std::uint32_t c = 0; c < channels; ++c)
        t.v.insert(t.v.end(), layers.v[c].begin(), layers.v[c].end());
    MapInfo info = plainInfo(8, 8, 8);
    info.channels = channels;
    std::vector<MapFace> faces(1);
    faces[0].projection = plainProjection(8, 8);
    faces[0].tiles = {t};
    const auto map = ShadowMap::create(info, std::move(faces));
    if (!map) FAIL(map.error().message);
}

}  // namespace

TEST_CASE("tolerance 0 keeps every sample to the bit", "[compress][exact]") {
    for (const Case& c : allKinds()) {
        for (const std::uint32_t channels : {1u, 3u}) {
            INFO(c.name << ", channels " << channels);
            CompressOptions options;
            options.channels = channels;
            CompressReport report;
            const LayerList layers = compressed(c.pixel, options, report);
            const Pixel kept = withoutCopies(c.pixel, channels);
            const Steps v = visibility(kept, channels);
            REQUIRE(layers.size() == kept.size());
            for (std::size_t i = 0; i < kept.size(); ++i) {
                REQUIRE(layers.z[i] == kept[i].z);
                REQUIRE(layers.n[i] == 1);
                for (std::uint32_t k = 0; k < channels; ++k)
                    REQUIRE(layers.v[k][i] == float(v.behind(i)[k]));
            }
            CHECK(report.samples == c.pixel.size());
            CHECK(report.copies == c.pixel.size() - kept.size());
            CHECK(report.layers == layers.size());
            CHECK(report.toleranceReached == 0.0f);
            CHECK(report.droppedByLayers + report.droppedByResets == 0);
            checkMap(layers, channels);
        }
    }
}

TEST_CASE("the tolerance holds at every step of both functions", "[compress][exact]") {
    forAll([](const Pixel& pixel, const CompressOptions& options, const LayerList& layers,
              const CompressReport& report) {
        const Steps v =
            visibility(withoutCopies(pixel, options.channels), options.channels);
        const Steps reader = visibility(layers, options.channels);
        const double error = largestDifference(v, reader, options.channels);
        CHECK(error <= double(options.tolerance));
        // What is reported is what is there. A float's rounding is not counted as an
        // error, and samples that nearly coincide count in both orders.
        CHECK(report.toleranceReached <= options.tolerance);
        CHECK(double(report.toleranceReached) >= error - 0x1p-25);
        CHECK(report.pixelsOverTolerance == 0);
        checkMap(layers, options.channels);
    });
}

TEST_CASE("no sample is lost and counts add up", "[compress]") {
    forAll([](const Pixel& pixel, const CompressOptions& options, const LayerList& layers,
              const CompressReport& report) {
        std::uint64_t count = 0;
        for (const std::uint32_t n : layers.n)
            count += n;
        CHECK(count == withoutCopies(pixel, options.channels).size());
        CHECK(report.samples == count + report.copies);
    });
}

TEST_CASE("counts place no sample far from where it was", "[compress][exact]") {
    forAll([](const Pixel& pixel, const CompressOptions& options, const LayerList& layers,
              const CompressReport&) {
        const Pixel kept = withoutCopies(pixel, options.channels);
        const Steps reader = visibility(layers, options.channels);
        std::size_t first = 0;
        for (std::size_t i = 0; i < layers.size(); ++i) {
            const double z = layers.z[i];
            const double length =
                options.lengthBase +
                (options.lengthPerDepth > 0.0 ? options.lengthPerDepth * z : 0.0);
            const double front = i > 0 ? double(layers.z[i - 1]) : z;
            const double mean = (z - front) / layers.n[i];
            double covered = 0.0;
            for (std::size_t k = std::max<std::size_t>(first, 1); k < first + layers.n[i];
                 ++k)
                covered += std::min(mean, double(kept[k].z) - double(kept[k - 1].z));
            const double most = std::min(0.5 * length, std::max(0.0, covered - mean));
            const double rounding = 1e-15 * z;
            for (std::size_t k = first; k < first + layers.n[i]; ++k)
                REQUIRE(std::abs(reader.depth(k) - double(kept[k].z)) <= most + rounding);
            if (layers.n[i] > 1)
                REQUIRE(z - double(i > 0 ? layers.z[i - 1] : kept[first].z) <=
                        length + rounding);
            first += layers.n[i];
        }
    });
}

TEST_CASE("a gap without samples gains none", "[compress][exact]") {
    Pixel pixel;
    for (int i = 0; i < 20; ++i)
        pixel.emplace_back((i < 10 ? 1.0f : 100.0f) + 1e-3f * i, 1e-4f);
    CompressOptions options;
    options.tolerance = 0.05f;
    const LayerList layers = compressed(pixel, options);
    CHECK(layers.size() == 4);  // of each ten the first and the rest
    for (const double z : visibility(layers, 1).z)
        CHECK((z < 1.02 || z > 99.9));
}

TEST_CASE("optical depth of a layer of several is bounded, and right behind each layer",
          "[compress][exact]") {
    forAll([](const Pixel& pixel, const CompressOptions& options, const LayerList& layers,
              const CompressReport&) {
        const Steps v =
            visibility(withoutCopies(pixel, options.channels), options.channels);
        std::size_t end = 0;
        for (std::size_t i = 0; i < layers.size(); ++i) {
            const bool restart = i == 0 || isDark(layers, i - 1, options.channels);
            end += layers.n[i];
            for (std::uint32_t c = 0; c < options.channels; ++c) {
                const double after = layers.v[c][i], truth = v.behind(end - 1)[c];
                REQUIRE((after == 0.0) == (truth == 0.0));
                REQUIRE(std::abs(after - truth) <=
                        (double(options.tolerance) + 1e-7) * truth);
                const double before = restart ? 1.0 : double(layers.v[c][i - 1]);
                if (layers.n[i] > 1 && after > 0.0)
                    REQUIRE(std::log(before / after) <= options.opticalDepth + 1e-6);
            }
        }
    });
}

TEST_CASE("what darkens a channel stands alone", "[compress][exact]") {
    forAll([](const Pixel&, const CompressOptions& options, const LayerList& layers,
              const CompressReport&) {
        for (std::size_t i = 0; i < layers.size(); ++i) {
            const bool restart = i == 0 || isDark(layers, i - 1, options.channels);
            for (std::uint32_t c = 0; c < options.channels; ++c) {
                const bool darkens =
                    layers.v[c][i] == 0.0f && (restart || layers.v[c][i - 1] > 0.0f);
                if (darkens) REQUIRE(layers.n[i] == 1);
            }
        }
    });
    // Translucent samples at the very depth of a wall, too.
    CompressOptions options;
    options.tolerance = 0.5f;
    const LayerList layers =
        compressed({{2, 0.1f}, {2, 0.1f}, {2, 0.1f}, {2, 1.0f}}, options);
    REQUIRE(layers.size() == 2);
    CHECK(layers.n == std::vector<std::uint32_t>{3, 1});
    CHECK(layers.v[0][0] == Approx(0.729));
    CHECK(layers.v[0][1] == 0.0f);
}

TEST_CASE("V' is what a centre ray reads from the map", "[compress][twin]") {
    forAll([](const Pixel& pixel, const CompressOptions& options, const LayerList& layers,
              const CompressReport&) {
        if (options.channels != 1 || options.tolerance < 0.01f) return;
        const Steps reader = visibility(layers, 1);
        const MapInfo info;
        const PixelLayers read{std::uint32_t(layers.size()), layers.z.data(),
                               layers.v[0].data(), 0, layers.n.data()};
        for (const Sample& s : pixel) {
            trace::RayState state;
            trace::PixelCrossing crossing;
            // Behind the sample, and behind where rounding may put a count's sample.
            crossing.zExit = double(s.z) * (1.0 + 1e-12);
            const bool dark = attenuate(read, info, crossing, {}, state);
            if (dark) break;  // V' starts again, rays do not
            REQUIRE(state.visible[0] ==
                    Approx(reader.at(crossing.zExit)[0]).epsilon(1e-9));
        }
    });
}

TEST_CASE("an even medium becomes slabs of the optical depth allowed",
          "[compress][exact]") {
    // 1000 samples of optical depth 0.002 each, evenly spaced: as one would lay slabs.
    Pixel pixel;
    const auto opacity = float(1.0 - std::exp(-0.002));
    for (int i = 1; i <= 1000; ++i)
        pixel.emplace_back(8.0f + i * 0x1p-10f, opacity);
    CompressOptions options;
    options.tolerance = 0.005f;
    CHECK(compressed(pixel, options).size() == 6);  // the first, and 2.0 / 0.4
    options.opticalDepth = 0.1f;
    CHECK(compressed(pixel, options).size() == 21);
    options.opticalDepth = 10.0f;
    options.lengthBase = 0x1p-3;
    CHECK(compressed(pixel, options).size() == 9);
}

TEST_CASE("visibility that underflows is a reset that stands alone",
          "[compress][exact]") {
    // Optical depth 0.1 each: below FLT_MIN = e^-87.3 after 874.
    Pixel pixel;
    for (int i = 1; i <= 1000; ++i)
        pixel.emplace_back(float(i), float(1.0 - std::exp(-0.1)));
    CompressOptions options;
    options.tolerance = 0.01f;
    const LayerList layers = compressed(pixel, options);
    checkMap(layers, 1);
    int resets = 0;
    for (std::size_t i = 0; i < layers.size(); ++i) {
        if (layers.v[0][i] > 0.0f) continue;
        ++resets;
        CHECK(layers.z[i] == 874.0f);
        CHECK(layers.n[i] == 1);
        CHECK(layers.v[0][i + 1] > 0.9f);
    }
    CHECK(resets == 1);
}

TEST_CASE("behind the last reset nothing is kept", "[compress][exact]") {
    Pixel pixel;
    for (int wall = 1; wall <= 4; ++wall) {
        for (int i = 0; i < 3; ++i)
            pixel.emplace_back(float(wall) - 0.5f, 0.25f);
        pixel.emplace_back(float(wall), 1.0f);
        pixel.emplace_back(float(wall), 1.0f);  // a copy
    }
    for (const float tolerance : {0.0f, 0.1f}) {
        for (std::uint32_t resets = 0; resets < 6; ++resets) {
            CompressOptions options;
            options.tolerance = tolerance;
            options.resets = resets;
            CompressReport report;
            const LayerList layers = compressed(pixel, options, report);
            const std::uint32_t kept = std::min(resets + 1, 4u);
            CHECK(layers.z.back() == float(kept));
            CHECK(report.droppedByResets == (4 - kept) * 5);
            CHECK(report.copies == kept);
            std::uint64_t count = 0;
            for (const std::uint32_t n : layers.n)
                count += n;
            CHECK(count == kept * 4);
        }
    }
}

TEST_CASE("of opaque layers a cap keeps the nearest", "[compress][exact]") {
    CompressOptions options;
    options.layers = 3;
    CompressReport report;
    const LayerList opaque = compressed(
        {{1, 1.0f}, {2, 1.0f}, {3, 1.0f}, {4, 1.0f}, {5, 1.0f}}, options, report);
    CHECK(opaque.z == std::vector<float>{1, 2, 3});
    CHECK(report.droppedByLayers == 2);
    CHECK(report.pixelsOverTolerance == 0);
    CHECK(report.toleranceReached == 0.0f);
    // What lets light through in between becomes one layer each.
    const LayerList mixed =
        compressed({{1, 0.5f}, {2, 0.5f}, {3, 1.0f}, {4, 0.5f}, {5, 0.5f}, {6, 1.0f}},
                   options, report);
    CHECK(mixed.z == std::vector<float>{2, 3, 5});
    CHECK(mixed.n == std::vector<std::uint32_t>{2, 1, 2});
    CHECK(mixed.v[0] == std::vector<float>{0.25f, 0.0f, 0.25f});
    CHECK(report.droppedByLayers == 2 + 1);
    CHECK(report.pixelsOverTolerance == 1);
    // The first two were a pixel's first layer, met at 2: between 1 and 2, |1 - 0.5|.
    CHECK(report.toleranceReached == 0.5f);
}

TEST_CASE("a cap merges what harms least", "[compress][exact]") {
    // Even sheets of optical depths -ln(1 - a) = .69, .11, .22, .92, 1.6. Of two that
    // become one layer, half of the difference moves by the distance of 1; but the first
    // would move all the way.
    CompressOptions options;
    options.layers = 4;
    CHECK(
        compressed({{1, 0.5f}, {2, 0.1f}, {3, 0.2f}, {4, 0.6f}, {5, 0.8f}}, options).z ==
        std::vector<float>{1, 3, 4, 5});
    // Gaps are bridged last: 2 to 50 stays empty though it would harm least.
    const LayerList layers = compressed(
        {{1, 0.9f}, {1.5f, 0.9f}, {2, 0.5f}, {50, 1e-6f}, {50.5f, 1e-6f}}, options);
    CHECK(layers.z == std::vector<float>{1, 2, 50, 50.5f});
}

TEST_CASE("under a cap maps stay valid and what is reported is true",
          "[compress][exact]") {
    for (const Case& c : allKinds()) {
        for (const std::uint32_t cap : {1u, 2u, 5u, 16u}) {
            for (const float tolerance : {0.0f, 0.01f}) {
                for (const std::uint32_t channels : {1u, 3u}) {
                    INFO(c.name << ", cap " << cap << ", tolerance " << tolerance
                                << ", channels " << channels);
                    CompressOptions options;
                    options.layers = cap;
                    options.tolerance = tolerance;
                    options.channels = channels;
                    CompressReport report;
                    const LayerList layers = compressed(c.pixel, options, report);
                    CHECK(layers.size() <= cap);
                    checkMap(layers, channels);
                    Pixel kept = withoutCopies(c.pixel, channels);
                    std::uint64_t count = 0;
                    for (const std::uint32_t n : layers.n)
                        count += n;
                    CHECK(report.samples ==
                          count + report.copies + report.droppedByLayers);
                    kept.erase(kept.begin() + std::ptrdiff_t(count), kept.end());
                    const double error =
                        largestDifference(visibility(kept, channels),
                                          visibility(layers, channels), channels);
                    CHECK(double(report.toleranceReached) >= error - 0x1p-24);
                    CHECK(report.pixelsOverTolerance ==
                          (report.toleranceReached > tolerance ? 1 : 0));
                    if (report.pixelsOverTolerance == 0)
                        CHECK(error <= double(tolerance) + 0x1p-24);
                }
            }
        }
    }
}

TEST_CASE("the error that a cap leaves is measured, not bounded", "[compress][exact]") {
    // Five sheets at 1, 2, 4, 5, 6 become 1 and (6, n = 4): at 2.25, 3.5, 4.75, 6.
    CompressOptions options;
    options.layers = 2;
    CompressReport report;
    const Pixel pixel = {{1, 0.9f}, {2, 0.2f}, {4, 0.2f}, {5, 0.2f}, {6, 0.2f}};
    const LayerList layers = compressed(pixel, options, report);
    const double error =
        largestDifference(visibility(pixel, 1), visibility(layers, 1), 1);
    CHECK(double(report.toleranceReached) == Approx(error).margin(1e-6));
    CHECK(report.pixelsOverTolerance == 1);
}

TEST_CASE("a million samples in one pixel keep the bound", "[compress][exact]") {
    CompressOptions options;
    options.tolerance = 0.005f;
    for (const auto& [low, high] : {std::pair(0.0, 2e-7), {0.0, 2e-5}, {0.0, 2e-3}}) {
        INFO("opacities up to " << high);
        const Pixel pixel = randomPixel(3, 1'000'000, 10.0, 20.0, low, high);
        CompressReport report;
        const LayerList layers = compressed(pixel, options, report);
        checkMap(layers, 1);
        CHECK(layers.size() < 0.01 * double(pixel.size()));
        const double error =
            largestDifference(visibility(pixel, 1), visibility(layers, 1), 1);
        CHECK(error <= double(options.tolerance));
        CHECK(double(report.toleranceReached) >= error - 0x1p-24);
    }
}

TEST_CASE("no pixel has more layers than the format allows", "[compress]") {
    const Pixel pixel = randomPixel(4, kMaxPixelLayers + 1000, 1.0, 2.0, 0.0, 1e-6);
    CompressReport report;
    const LayerList layers = compressed(pixel, {}, report);
    CHECK(layers.size() == kMaxPixelLayers);
    CHECK(report.droppedByLayers == 0);
    checkMap(layers, 1);
}

TEST_CASE("a compressor remembers nothing", "[compress]") {
    CompressOptions options;
    options.tolerance = 0.01f;
    options.layers = 12;
    PixelCompressor compressor(options);
    LayerList together;
    CompressReport report;
    std::size_t first = 0;
    for (const Case& c : allKinds()) {
        compressor.compress(borrow(planes(c.pixel, 1)), together, report);
        const LayerList alone = compressed(c.pixel, options);
        REQUIRE(together.size() == first + alone.size());
        for (std::size_t i = 0; i < alone.size(); ++i) {
            REQUIRE(together.z[first + i] == alone.z[i]);
            REQUIRE(together.v[0][first + i] == alone.v[0][i]);
            REQUIRE(together.n[first + i] == alone.n[i]);
        }
        first += alone.size();
    }
}

TEST_CASE("a tile holds its pixels' layers and no plane that says nothing",
          "[compress][exact]") {
    const auto tileOf = [](const std::vector<Pixel>& pixels, CompressOptions options) {
        std::vector<std::uint32_t> begin{0};
        Pixel all;
        for (const Pixel& p : pixels) {
            all.insert(all.end(), p.begin(), p.end());
            begin.push_back(std::uint32_t(all.size()));
        }
        CompressReport report;
        return mtsm::test::compressTile(options, begin, planes(all, options.channels),
                                        report);
    };
    CompressOptions options;
    CHECK(tileOf({{}, {}}, options).begin.empty());
    const Tile opaque = tileOf({{}, {{1, 1.0f}, {2, 1.0f}}, {{3, 1.0f}}}, options);
    CHECK(opaque.begin == std::vector<std::uint32_t>{0, 0, 2, 3});
    CHECK(opaque.z == std::vector<float>{1, 2, 3});
    CHECK(opaque.v.empty());
    CHECK(opaque.n.empty());

    options.channels = 3;
    options.tolerance = 0.5f;
    const Tile coloured = tileOf(
        {{{1, std::array{0.5f, 0.25f, 0.0f}}}, {}, {{2, 0.125f}, {2, 0.0f}}}, options);
    CHECK(coloured.begin == std::vector<std::uint32_t>{0, 1, 1, 2});
    CHECK(coloured.v == std::vector<float>{0.5f, 0.875f, 0.75f, 0.875f, 1.0f, 0.875f});
    CHECK(coloured.n == std::vector<std::uint32_t>{1, 2});
}
