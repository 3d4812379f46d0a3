#include <catch2/catch.hpp>
#include <set>
#include <vector>

#include "base/sampling.h"

using namespace mtsm::base;

TEST_CASE("every elementary interval holds exactly one of 2^m points", "[base][exact]") {
    for (std::uint64_t key : {0ull, 1ull, 0x123456789abcdefull, ~0ull}) {
        const SquareSequence sequence(mix(key));
        for (int m = 0; m <= 12; ++m) {
            const std::uint32_t count = 1u << m;
            for (int mx = 0; mx <= m; ++mx) {
                const std::uint32_t columns = 1u << mx, rows = count / columns;
                std::vector<int> hits(count, 0);
                for (std::uint32_t i = 0; i < count; ++i) {
                    const glm::dvec2 u = sequence(i);
                    REQUIRE((u.x >= 0 && u.x < 1 && u.y >= 0 && u.y < 1));
                    ++hits[std::uint32_t(u.y * rows) * columns +
                           std::uint32_t(u.x * columns)];
                }
                INFO("key " << key << ", " << columns << " x " << rows);
                REQUIRE(
                    std::all_of(hits.begin(), hits.end(), [](int h) { return h == 1; }));
            }
        }
    }
}

TEST_CASE("a point's key depends on every coordinate and the seed, not on a zero's sign",
          "[base]") {
    std::set<std::uint64_t> keys;
    for (int x = -5; x <= 5; ++x) {
        for (int y = -5; y <= 5; ++y) {
            for (int z = -5; z <= 5; ++z) {
                for (std::uint32_t seed : {0u, 1u, 0xffffffffu})
                    keys.insert(pointKey(glm::dvec3(x, y, z) * 0.1, seed));
            }
        }
    }
    CHECK(keys.size() == 11 * 11 * 11 * 3);
    CHECK(pointKey({0.0, -0.0, 1.0}, 7) == pointKey({-0.0, 0.0, 1.0}, 7));
}

TEST_CASE("neighbouring keys give unrelated points", "[base][statistical]") {
    // The mean of a product of centred coordinates of the first points of consecutive
    // keys: its standard deviation is 1 / (12 sqrt(n)); 5 sigma.
    const int n = 100000;
    double sum = 0.0;
    for (int i = 0; i < n; ++i) {
        const auto a = SquareSequence(pointKey({i * 1e-3, 0, 0}, 0))(0);
        const auto b = SquareSequence(pointKey({(i + 1) * 1e-3, 0, 0}, 0))(0);
        sum += (a.x - 0.5) * (b.x - 0.5);
    }
    CHECK(std::abs(sum / n) < 5.0 / (12.0 * std::sqrt(double(n))));
}

TEST_CASE("points in bulk are those one by one, rounded to float", "[base][twin]") {
    const mtsm::base::SquareSequence sequence(0x0123456789abcdefu);
    std::vector<std::uint32_t> index;
    for (std::uint32_t i = 0; i < 4096; i += 41)
        index.push_back(4095 - i);
    for (const std::size_t count : {std::size_t(0), std::size_t(1), index.size()}) {
        std::vector<float> x(index.size(), -1.0f), y(x);
        sequence.points(index.data(), count, x.data(), y.data());
        for (std::size_t k = 0; k < index.size(); ++k) {
            const glm::dvec2 expected = sequence(index[k]);
            CHECK(x[k] == (k < count ? Approx(expected.x).margin(1e-7) : Approx(-1.0)));
            CHECK(y[k] == (k < count ? Approx(expected.y).margin(1e-7) : Approx(-1.0)));
        }
    }
}
