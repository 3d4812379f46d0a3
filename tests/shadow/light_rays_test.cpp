// The rays of receivers to a light, as a bundle: what it says of all of them holds.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "map_fixture.h"
#include "shadow/light_rays.h"

using namespace mtsm;

TEST_CASE("rays go sideways within their bundle's bounds, however deep they start",
          "[shadow][exact]") {
    std::mt19937_64 random(1);
    const auto in = [&](double low, double high) {
        return low + (high - low) * double(random() >> 11) * 0x1p-53;
    };
    const std::uint32_t width = 512;
    const Projection view = test::plainProjection(width, width);
    for (const LightShape shape :
         {LightShape::point, LightShape::disk, LightShape::rect, LightShape::sphere}) {
        // Up to 16 samples have bounds of their own.
        const std::uint32_t samples = GENERATE(1u, 4u, 11u, 16u, 64u, 256u);
        AreaLight light;
        light.shape = shape;
        light.direction = glm::normalize(glm::dvec3(0.3, -0.2, -1));
        light.radius = 0.2;
        light.size = {0.3, 0.5};
        const light::LightSampler sampler(light);
        shadow::LightRays::Setting setting;
        setting.samples = samples;
        setting.steps = {1, {samples}};
        setting.isPoint = sampler.isPoint();
        const shadow::LightRays rays(view, width, width, {4.0f, 4.1f}, sampler, setting);
        for (int trial = 0; trial < 2000; ++trial) {
            // To a million footprints deep.
            const double z = 5.0 * std::exp(in(0.0, std::log(3000.0)));
            const glm::dvec3 p(in(-1, 1) * z, in(-1, 1) * z, z);
            shadow::ReceiverLanes lanes{};
            lanes.count = 1;
            const light::LightView seen = sampler.view(view.worldFromLight(p));
            const auto set = [](float* x, float* y, float* z_, glm::dvec3 v) {
                for (int i = 0; i < trace::kMostReceivers; ++i)
                    x[i] = float(v.x), y[i] = float(v.y), z_[i] = float(v.z);
            };
            const auto turned = [&](glm::dvec3 d) {
                return view.lightFromWorldDirection(d);
            };
            set(lanes.x, lanes.y, lanes.z, p);
            set(lanes.baseX, lanes.baseY, lanes.baseZ, turned(seen.base));
            set(lanes.axisXX, lanes.axisXY, lanes.axisXZ, turned(seen.x));
            set(lanes.axisYX, lanes.axisYY, lanes.axisYZ, turned(seen.y));
            set(lanes.axisZX, lanes.axisZY, lanes.axisZZ, turned(seen.z));
            for (float& h : lanes.capHeight)
                h = float(seen.capHeight);
            trace::RayBundle bundle;
            shadow::RayFates fates;
            rays.fill(lanes, 0, rays.groups(), bundle, fates);
            REQUIRE(bundle.wide == 0);
            // Places are rounded, which trees allow for.
            const float slack = float(width) * 0x1p-20f;
            int outside = 0;
            for (int row = 0; row < bundle.groups; ++row) {
                for (int i = 0; i < trace::kLanes; ++i) {
                    if (!(bundle.open[row] >> i & 1)) continue;
                    const float du = bundle.du[row][i], dv = bundle.dv[row][i],
                                dw = bundle.dw[row][i];
                    const auto check = [&](float d, float low, float high) {
                        outside += !(d >= low * dw - slack && d <= high * dw + slack);
                    };
                    check(du, bundle.slopeLowU[0], bundle.slopeHighU[0]);
                    check(dv, bundle.slopeLowV[0], bundle.slopeHighV[0]);
                    if (bundle.groups == 1) continue;
                    check(du, bundle.groupLowU[row], bundle.groupHighU[row]);
                    check(dv, bundle.groupLowV[row], bundle.groupHighV[row]);
                    check(du, bundle.partLowU[row][0], bundle.partHighU[row][0]);
                    check(dv, bundle.partLowV[row][0], bundle.partHighV[row][0]);
                    check(du, bundle.rowLowU[row], bundle.rowHighU[row]);
                    check(dv, bundle.rowLowV[row], bundle.rowHighV[row]);
                }
            }
            INFO(samples << " of " << name(shape) << " from " << p.x << " " << p.y << " "
                         << p.z);
            CHECK(outside == 0);
        }
    }
}
