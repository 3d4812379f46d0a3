// bundle_fixture.h - bundles of rays for the tests of the kernels that trace them.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "random.h"
#include "trace/bundle.h"

namespace mtsm::test {

/// A bundle by its rays' starts and ways in straight space, all open; bound() says the
/// rest.
struct Rays {
    trace::RayBundle bundle{};
    /// [row][lane]: of what traceNear() answers for.
    alignas(64) float end[trace::kMostRows][trace::kLanes];

    Rays(int receivers, int groups) {
        bundle.receivers = receivers;
        bundle.groups = groups;
        std::fill_n(&end[0][0], trace::kMostRows * trace::kLanes, 1.0f);
        openAll();
    }
    [[nodiscard]] int rows() const { return bundle.receivers * bundle.groups; }
    void openAll() { std::fill_n(bundle.open, rows(), std::uint16_t(0xffff)); }
    void openOnly(int row, int lane) {
        std::fill_n(bundle.open, rows(), std::uint16_t(0));
        bundle.open[row] = std::uint16_t(1u << lane);
    }
    [[nodiscard]] bool isOpen(int row, int lane) const {
        return bundle.open[row] >> lane & 1;
    }

    [[nodiscard]] glm::dvec3 start(int receiver) const {
        return {bundle.u[receiver], bundle.v[receiver], bundle.w[receiver]};
    }
    [[nodiscard]] glm::dvec3 delta(int row, int lane) const {
        return {bundle.du[row][lane], bundle.dv[row][lane], bundle.dw[row][lane]};
    }
    void setStart(int receiver, glm::dvec3 p) {
        bundle.u[receiver] = float(p.x);
        bundle.v[receiver] = float(p.y);
        bundle.w[receiver] = float(p.z);
    }
    void setDelta(int row, int lane, glm::dvec3 d) {
        bundle.du[row][lane] = float(d.x);
        bundle.dv[row][lane] = float(d.y);
        bundle.dw[row][lane] = float(d.z);
    }

    /// Slopes from the rays themselves; layers count from the start on; the rest of the
    /// 16 receivers are copies of the first.
    void bound() {
        bundle.wide = 0;
        for (int receiver = 0; receiver < bundle.receivers; ++receiver)
            boundReceiver(receiver);
        for (int group = 0; group < bundle.groups; ++group)
            boundGroup(group);
        for (int i = bundle.receivers; i < trace::kMostReceivers; ++i)
            copyReceiver(*this, 0, i);
    }
    /// For traceNear(): how far the parts that it answers for rise.
    void boundEnds() {
        bound();
        for (int receiver = 0; receiver < bundle.receivers; ++receiver) {
            float& rise = bundle.rise[receiver];
            for (int group = 0; group < bundle.groups; ++group) {
                const int row = bundle.row(receiver, group);
                for (int lane = 0; lane < trace::kLanes; ++lane)
                    rise = std::max(rise, bundle.dw[row][lane] * end[row][lane]);
            }
        }
    }

    /// All but the rays of receiver `from` of other rays.
    void copyReceiver(const Rays& other, int from, int to) {
        const trace::RayBundle& b = other.bundle;
        bundle.hasPlanes = b.hasPlanes;
        bundle.planeHeight = b.planeHeight;
        const auto copy = [from, to](const float* a, float* out) { out[to] = a[from]; };
        copy(b.u, bundle.u), copy(b.v, bundle.v), copy(b.w, bundle.w);
        copy(b.slopeLowU, bundle.slopeLowU), copy(b.slopeHighU, bundle.slopeHighU);
        copy(b.slopeLowV, bundle.slopeLowV), copy(b.slopeHighV, bundle.slopeHighV);
        copy(b.rise, bundle.rise), copy(b.spread, bundle.spread);
        copy(b.slant, bundle.slant);
        copy(b.planeU, bundle.planeU), copy(b.planeV, bundle.planeV);
        copy(b.planeW, bundle.planeW);
        bundle.topLevel[to] = b.topLevel[from];
        const auto bit = std::uint16_t(1u << to);
        bundle.wide =
            std::uint16_t(b.wide >> from & 1 ? bundle.wide | bit : bundle.wide & ~bit);
    }
    /// Receivers of these rays, in this order.
    [[nodiscard]] Rays only(const std::vector<int>& receivers) const {
        Rays some(int(receivers.size()), bundle.groups);
        for (int i = 0; i < some.bundle.receivers; ++i) {
            const int from = receivers[std::size_t(i)];
            some.copyReceiver(*this, from, i);
            for (int group = 0; group < bundle.groups; ++group) {
                const int a = bundle.row(from, group), b = some.bundle.row(i, group);
                std::copy_n(bundle.du[a], trace::kLanes, some.bundle.du[b]);
                std::copy_n(bundle.dv[a], trace::kLanes, some.bundle.dv[b]);
                std::copy_n(bundle.dw[a], trace::kLanes, some.bundle.dw[b]);
                std::copy_n(bundle.begin[a], trace::kLanes, some.bundle.begin[b]);
                std::copy_n(bundle.threshold[a], trace::kLanes, some.bundle.threshold[b]);
                std::copy_n(end[a], trace::kLanes, some.end[b]);
                some.bundle.open[b] = bundle.open[a];
            }
        }
        for (int group = 0; group < bundle.groups; ++group)
            some.boundGroup(group);
        for (int i = some.bundle.receivers; i < trace::kMostReceivers; ++i)
            some.copyReceiver(some, 0, i);
        return some;
    }

  private:
    struct Bounds {
        double lowU = HUGE_VAL, highU = -HUGE_VAL, lowV = HUGE_VAL, highV = -HUGE_VAL;
        bool towardsEye = true;

        void include(glm::dvec3 d) {
            towardsEye = towardsEye && d.z > 0.0;
            if (!towardsEye) return;
            lowU = std::min(lowU, d.x / d.z), highU = std::max(highU, d.x / d.z);
            lowV = std::min(lowV, d.y / d.z), highV = std::max(highV, d.y / d.z);
        }
    };
    /// Away from zero or towards it, as far as rays are rounded.
    static float lower(double x) { return float(x - std::abs(x) * 0x1p-18); }
    static float higher(double x) { return float(x + std::abs(x) * 0x1p-18); }

    [[nodiscard]] Bounds boundsOf(int row, Bounds bounds) const {
        for (int lane = 0; lane < trace::kLanes; ++lane)
            bounds.include(delta(row, lane));
        return bounds;
    }
    void boundReceiver(int receiver) {
        Bounds bounds;
        for (int group = 0; group < bundle.groups; ++group)
            bounds = boundsOf(bundle.row(receiver, group), bounds);
        bundle.rise[receiver] = 0.0f;
        if (!bounds.towardsEye) {
            bounds = {0.0, 0.0, 0.0, 0.0};
            bundle.wide = std::uint16_t(bundle.wide | 1u << receiver);
        }
        bundle.slopeLowU[receiver] = lower(bounds.lowU);
        bundle.slopeHighU[receiver] = higher(bounds.highU);
        bundle.slopeLowV[receiver] = lower(bounds.lowV);
        bundle.slopeHighV[receiver] = higher(bounds.highV);
        bundle.slant[receiver] =
            std::max(std::max(std::abs(bundle.slopeLowU[receiver]),
                              std::abs(bundle.slopeHighU[receiver])),
                     std::max(std::abs(bundle.slopeLowV[receiver]),
                              std::abs(bundle.slopeHighV[receiver])));
    }
    void boundGroup(int group) {
        bundle.clearGroup(group);
        for (int receiver = 0; receiver < bundle.receivers; ++receiver) {
            if (bundle.wide >> receiver & 1) continue;
            const Bounds own = boundsOf(bundle.row(receiver, group), {});
            bundle.boundRow(
                receiver, group,
                {lower(own.lowU), higher(own.highU), lower(own.lowV), higher(own.highV)});
        }
    }
};

/// Rays from around a point to around others.
inline std::unique_ptr<Rays> raysAround(Random& random, int receivers, int groups,
                                        glm::dvec3 from, double spread,
                                        glm::dvec3 reach) {
    auto rays = std::make_unique<Rays>(receivers, groups);
    const auto around = [&](glm::dvec3 p, double by) {
        return p + by * glm::dvec3(random.in(-1, 1), random.in(-1, 1),
                                   random.in(-0x1p-12, 0x1p-12));
    };
    for (int receiver = 0; receiver < receivers; ++receiver)
        rays->setStart(receiver, around(from, spread));
    for (int group = 0; group < groups; ++group) {
        const glm::dvec3 part = around(reach, 0.5 * glm::length(glm::dvec2(reach)));
        for (int receiver = 0; receiver < receivers; ++receiver) {
            const int row = rays->bundle.row(receiver, group);
            for (int lane = 0; lane < trace::kLanes; ++lane) {
                rays->setDelta(row, lane, around(part, spread));
                rays->bundle.begin[row][lane] = float(random.in(0, 0.2));
                rays->end[row][lane] = float(random.in(0.3, 1));
            }
        }
    }
    rays->boundEnds();
    return rays;
}

}  // namespace mtsm::test
