// Which planes pass near a place: on every kind of processor those that one by one do.
#include "trace/patch_planes.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <vector>

#include "random.h"
#include "trace/each_target.h"

using namespace mtsm;
using trace::patch_detail::findNear;
using trace::patch_detail::PlaneList;

TEST_CASE("planes near a place are found in order, and as near as their slack",
          "[trace][twin]") {
    test::Random random(5);
    test::onEachTarget([&](const char* target) {
        INFO(target);
        for (const std::size_t count : {0, 1, 3, 15, 16, 17, 100}) {
            PlaneList planes;
            planes.resize(count);
            for (std::size_t k = 0; k < count; ++k) {
                planes.w[k] = float(random.in(-1, 1));
                planes.perU[k] = float(random.in(-0.1, 0.1));
                planes.perV[k] = float(random.in(-0.1, 0.1));
                planes.slack[k] = float(random.in(0, 0.1));
            }
            if (count > 20) planes.w[20] = std::numeric_limits<float>::quiet_NaN();
            const auto u = float(random.in(0, 16)), v = float(random.in(0, 16));
            const auto w = float(random.in(-1, 1)), most = float(random.in(0, 0.5));
            std::vector<std::uint32_t> found(count + PlaneList::kSpare);
            found.resize(findNear(planes, count, u, v, w, most, found.data()));
            auto next = found.begin();
            for (std::size_t k = 0; k < count; ++k) {
                const double away =
                    std::abs(double(planes.w[k]) + double(planes.perU[k]) * u +
                             double(planes.perV[k]) * v - w) -
                    planes.slack[k] - most;
                const bool isFound = next != found.end() && *next == k;
                if (isFound) ++next;
                INFO("plane " << k << " of " << count << " away " << away);
                // Rounding in float.
                CHECK((std::abs(away) < 1e-5 || isFound == !(away > 0)));
            }
            CHECK(next == found.end());
        }
    });
}
