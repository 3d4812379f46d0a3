#include "format/unpredict.h"

#include <hwy/targets.h>

#include <bit>
#include <catch2/catch.hpp>
#include <random>
#include <vector>

#include "format/predict.h"

using namespace mtsm::format;

namespace {

struct Plane {
    std::uint32_t width = 1;
    std::vector<std::uint32_t> begin{0};
    std::vector<std::uint32_t> bits;
};

/// Pixels with runs of equal counts, as surfaces have, and lone ones.
Plane randomPlane(std::mt19937& random, std::uint32_t width, std::uint32_t height,
                  std::uint32_t most) {
    Plane plane;
    plane.width = width;
    std::uint32_t count = 0;
    for (std::uint32_t p = 0; p < width * height; ++p) {
        if (random() % 3 == 0) count = random() % (most + 1);
        if (random() % 64 == 0) count = 3 * most;
        plane.begin.push_back(plane.begin.back() + count);
    }
    plane.bits.resize(plane.begin.back());
    for (std::uint32_t& b : plane.bits)
        b = std::uint32_t(random());
    return plane;
}

std::vector<std::uint32_t> differences(const Plane& plane) {
    std::vector<std::uint32_t> d(plane.bits.size());
    forEachGuess<false>(plane.begin, plane.width, plane.bits.data(),
                        [&](std::uint32_t i, std::uint32_t guess) {
                            d[i] = plane.bits[i] - guess;
                            return plane.bits[i];
                        });
    return d;
}

}  // namespace

TEST_CASE("every instruction set undoes the gradient filter bit by bit",
          "[format][twin]") {
    std::mt19937 random(5);
    std::vector<Plane> planes;
    for (std::uint32_t width : {1u, 2u, 7u, 8u, 64u, 256u}) {
        for (std::uint32_t height : {1u, 2u, 19u}) {
            for (std::uint32_t most : {1u, 3u, 9u})
                planes.push_back(randomPlane(random, width, height, most));
        }
    }
    for (std::int64_t left = hwy::SupportedTargets(), target = 0; left; left ^= target) {
        target = left & -left;
        hwy::SetSupportedTargetsForTest(target);
        INFO(hwy::TargetName(target));
        for (const Plane& plane : planes) {
            if (plane.bits.empty()) continue;
            std::vector<float> got(plane.bits.size());
            addGradient(plane.begin, plane.width, differences(plane).data(), got.data());
            std::size_t different = 0;
            for (std::size_t i = 0; i < got.size(); ++i)
                different += std::bit_cast<std::uint32_t>(got[i]) != plane.bits[i];
            INFO(plane.width << " pixels wide, " << plane.bits.size() << " layers");
            CHECK(different == 0);
        }
    }
    hwy::SetSupportedTargetsForTest(0);
}
