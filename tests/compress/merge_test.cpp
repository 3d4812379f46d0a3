// The cap: closed forms against brute force, coarsened pixels against the exact merge.
#include "compress/merge.h"

#include <catch2/catch.hpp>

#include "compress/pixels.h"

using namespace mtsm;
using namespace mtsm::test;

namespace {

const compress::Bounds kUnbounded{0.4, HUGE_VAL, 0.0}, kShort{0.4, 0.1, 0.0};

/// One layer per sample, merged down to the cap.
LayerList capped(const Pixel& pixel, std::uint32_t cap, const compress::Bounds& bounds,
                 bool coarsens) {
    const SampleList list = planes(pixel, 1);
    compress::Visibility samples;
    CompressReport report;
    compress::accumulate(borrow(list), 1, kAllResets, samples, report);
    std::vector<compress::Span> spans(samples.size());
    for (std::uint32_t i = 0; i < samples.size(); ++i) {
        spans[i].end = i + 1;
        spans[i].v[0] = float(samples.v[0][i]);
    }
    compress::Merger(bounds, coarsens).merge(samples, cap, spans);
    LayerList layers;
    std::uint32_t begin = 0;
    for (const compress::Span& span : spans) {
        layers.z.push_back(samples.z[span.end - 1]);
        layers.v[0].push_back(span.v[0]);
        layers.n.push_back(span.end - begin);
        begin = span.end;
    }
    return layers;
}

/// Optical depth times the distance it is moved: the integral of |ln V - ln V'|.
double transportCost(const Steps& a, const Steps& b) {
    std::vector<double> z = a.z;
    z.insert(z.end(), b.z.begin(), b.z.end());
    std::sort(z.begin(), z.end());
    double sum = 0.0;
    for (std::size_t i = 0; i + 1 < z.size(); ++i)
        sum += std::abs(std::log(a.at(z[i])[0] / b.at(z[i])[0])) * (z[i + 1] - z[i]);
    return sum;
}

/// A layer as the greedy merge by brute force knows it.
struct Naive {
    std::vector<double> places;  ///< of its samples, as readers have them
    double from = 0.0, depth = 0.0, moved = 0.0;

    /// Optical depth in front of z, spread evenly between the first place and the last;
    /// at a single place, not or all counted as `there` says.
    [[nodiscard]] double before(double z, bool there) const {
        const double first = places.front(), last = places.back();
        if (first == last) return z > last || (z == last && there) ? depth : 0.0;
        return depth * std::clamp((z - first) / (last - first), 0.0, 1.0);
    }
};

Naive merged(const Naive& a, const Naive& b, bool first) {
    Naive whole;
    const double z = b.places.back();
    const std::size_t n = a.places.size() + b.places.size();
    whole.from = first ? z : a.from;
    whole.depth = a.depth + b.depth;
    for (std::size_t j = 1; j <= n; ++j)
        whole.places.push_back(
            j == n ? z : whole.from + double(j) * (z - whole.from) / double(n));
    return whole;
}

double harmOf(const Naive& a, const Naive& b, const Naive& whole) {
    std::vector<double> z;
    for (const Naive* n : {&a, &b, &whole}) {
        z.push_back(n->places.front());
        z.push_back(n->places.back());
    }
    std::sort(z.begin(), z.end());
    double sum = 0.0;
    for (std::size_t i = 0; i + 1 < z.size(); ++i) {
        const auto excess = [&](double at, bool there) {
            return a.before(at, there) + b.before(at, there) - whole.before(at, there);
        };
        // Linear in between: cut where it changes sign.
        const double f0 = excess(z[i], true), f1 = excess(z[i + 1], false);
        const double length = z[i + 1] - z[i];
        const double cut = f0 * f1 < 0.0 ? f0 / (f0 - f1) : 1.0;
        sum += cut < 1.0
                   ? 0.5 * length * (std::abs(f0) * cut + std::abs(f1) * (1.0 - cut))
                   : 0.5 * length * std::abs(f0 + f1);
    }
    return sum;
}

/// Does merging move samples further than the bounds allow?
bool bridges(const Naive& a, const Naive& b, const compress::Bounds& bounds,
             Naive& whole) {
    std::vector<double> old = a.places;
    old.insert(old.end(), b.places.begin(), b.places.end());
    const double mean = (whole.places.back() - whole.from) / double(old.size());
    double furthest = 0.0, covered = -mean, before = a.from;
    for (std::size_t j = 0; j < old.size(); ++j) {
        furthest = std::max(furthest, std::abs(old[j] - whole.places[j]));
        covered += std::min(mean, old[j] - before);
        before = old[j];
    }
    whole.moved = furthest + std::max(a.moved, b.moved);
    return whole.moved > std::min(0.5 * bounds.length(whole.places.back()), covered);
}

/// What the merge of least harm, searched for by brute force, makes of a pixel.
std::vector<std::uint32_t> naiveCounts(const Pixel& pixel, std::size_t cap,
                                       const compress::Bounds& bounds) {
    std::vector<Naive> layers;
    for (const Sample& s : pixel) {
        Naive layer;
        layer.places = {double(s.z)};
        layer.from = layers.empty() ? double(s.z) : layers.back().places.back();
        layer.depth = -std::log1p(-double(s.opacity[0]));
        layers.push_back(layer);
    }
    while (layers.size() > cap) {
        std::size_t best = 0;
        double least = HUGE_VAL;
        bool bestBridges = true;
        Naive result;
        for (std::size_t i = 0; i + 1 < layers.size(); ++i) {
            Naive whole = merged(layers[i], layers[i + 1], i == 0);
            const bool far = bridges(layers[i], layers[i + 1], bounds, whole);
            const double harm = harmOf(layers[i], layers[i + 1], whole);
            if (far > bestBridges || (far == bestBridges && harm >= least)) continue;
            best = i;
            least = harm;
            bestBridges = far;
            result = whole;
        }
        layers[best + 1] = result;
        layers.erase(layers.begin() + std::ptrdiff_t(best));
    }
    std::vector<std::uint32_t> counts;
    for (const Naive& layer : layers)
        counts.push_back(std::uint32_t(layer.places.size()));
    return counts;
}

/// Strands in tufts of ten.
Pixel tufts(std::uint64_t seed, std::uint32_t count) {
    Noise noise(seed);
    Pixel pixel;
    double z = 0.0;
    for (std::uint32_t i = 0; i < count; ++i) {
        if (i % 10 == 0) z = noise.between(10.0, 11.0);
        pixel.emplace_back(float(z + 0.03 * noise.unit()),
                           float(3.0 / count * noise.unit()));
    }
    sortByDepth(pixel);
    return pixel;
}

}  // namespace

TEST_CASE("the exact merge is the greedy one", "[compress][twin]") {
    for (std::uint64_t seed = 1; seed <= 40; ++seed) {
        for (const compress::Bounds* bounds : {&kUnbounded, &kShort}) {
            const Pixel pixel =
                seed % 2 ? randomPixel(seed, 40, 10.0, 11.0, 0.01, 0.4) : tufts(seed, 40);
            INFO("seed " << seed << ", length " << bounds->lengthBase);
            REQUIRE(capped(pixel, 5, *bounds, false).n == naiveCounts(pixel, 5, *bounds));
        }
    }
}

TEST_CASE("coarsening a pixel of many layers costs little", "[compress][twin]") {
    constexpr int kPixels = 40;
    for (const bool inTufts : {false, true}) {
        for (const std::uint32_t count : {60u, 500u}) {
            for (const compress::Bounds* bounds : {&kUnbounded, &kShort}) {
                double exact = 0.0, coarse = 0.0;
                for (std::uint64_t seed = 1; seed <= kPixels; ++seed) {
                    const Pixel pixel =
                        inTufts ? tufts(seed, count)
                                : randomPixel(seed, count, 10.0, 11.0, 0.0, 3.0 / count);
                    const Steps v = visibility(pixel, 1);
                    const LayerList layers = capped(pixel, 5, *bounds, true);
                    REQUIRE(layers.size() == 5);
                    coarse += transportCost(v, visibility(layers, 1));
                    exact +=
                        transportCost(v, visibility(capped(pixel, 5, *bounds, false), 1));
                }
                INFO((inTufts ? "tufts" : "even")
                     << " of " << count << ", length " << bounds->lengthBase);
                CHECK(coarse <= 1.1 * exact);
            }
        }
    }
}

TEST_CASE("the error of many pixels is the largest of theirs", "[compress][exact]") {
    CompressOptions options;
    options.layers = 4;
    options.tolerance = 0.02f;
    PixelCompressor compressor(options);
    CompressReport together;
    float largest = 0.0f;
    std::uint64_t over = 0;
    for (std::uint64_t seed = 1; seed <= 60; ++seed) {
        const Pixel pixel =
            randomPixel(seed, 30, 1.0, 2.0, 0.0, seed % 3 ? 0.004 : 0.1, true);
        CompressReport alone;
        (void)compressed(pixel, options, alone);
        largest = std::max(largest, alone.toleranceReached);
        over += alone.pixelsOverTolerance;
        LayerList layers;
        compressor.compress(borrow(planes(pixel, 1)), layers, together);
    }
    CHECK(together.toleranceReached == largest);
    CHECK(together.pixelsOverTolerance == over);
    CHECK(over > 0);
    CHECK(over < 60);
}

TEST_CASE("coarsening keeps walls and counts", "[compress][exact]") {
    // Walls at 1.2, 1.4, ...: each stays, with one layer or more before it.
    Pixel pixel = randomPixel(7, 1000, 1.0, 2.0, 0.0, 0.01);
    for (int wall = 1; wall <= 4; ++wall)
        pixel.emplace_back(1.0f + 0.2f * float(wall), 1.0f);
    sortByDepth(pixel);
    const LayerList layers = capped(pixel, 12, kUnbounded, true);
    REQUIRE(layers.size() == 12);
    int walls = 0;
    std::uint64_t count = 0;
    for (std::size_t i = 0; i < layers.size(); ++i) {
        count += layers.n[i];
        if (layers.v[0][i] > 0.0f) continue;
        ++walls;
        CHECK(layers.z[i] == 1.0f + 0.2f * float(walls));
        CHECK(layers.n[i] == 1);
    }
    CHECK(walls == 4);
    CHECK(count == pixel.size());
}
