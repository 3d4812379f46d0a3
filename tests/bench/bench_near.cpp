// bench_near - short rays against the near field and against Embree's packets, side by
// side in one run.
//
//     bench_near [RESOLUTION]
//
// A body of 350,000 triangles under a disk light. Receivers are the 16 points of 4 x 4
// pixels of the map, where the light's centre sees the body; each sends a ray to a point
// of each cell of the light. What counts is met from 1 footprint of a pixel in front of
// the receiver to `reach` of them, as depth goes.
#include <embree3/rtcore.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "trace/near_trace.h"

namespace {

using namespace mtsm;
using trace::kLanes;
using trace::RayBundle;

constexpr int kGroups = 400;
constexpr int kRepeats = 7;

struct Group {
    RayBundle bundle{};
    alignas(64) float end[trace::kMostBlocks][kLanes]{};
    std::vector<RTCRay16> packets;  // by block: the same rays in the world
};

ShadowMap bakedMap(const test::Mesh& body, std::uint32_t resolution) {
    CasterViews casters({body.view()});
    BakeOptions options;
    options.light.shape = LightShape::disk;
    options.light.position = {2, 5, 2.5};
    options.light.radius = 1.0;
    options.width = options.height = resolution;
    options.nearField = kAutomaticNearField;
    auto baked = bake(casters, options);
    if (!baked) std::exit(1);
    std::printf("near field: %llu triangles, %.1f MB, %.0f ms\n",
                static_cast<unsigned long long>(baked->report.nearTriangles),
                double(baked->report.nearBytes) * 1e-6, 1e3 * baked->report.nearSeconds);
    return std::move(baked->map);
}

RTCScene sceneOf(RTCDevice device, const test::Mesh& body) {
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                        RTC_FORMAT_FLOAT3, 12, body.positions.size()),
                body.positions.data(), 12 * body.positions.size());
    std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                        RTC_FORMAT_UINT3, 12, body.indices.size() / 3),
                body.indices.data(), 4 * body.indices.size());
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    return scene;
}

/// Rays of 4 x 4 pixels to `cells` points of a light of this radius.
std::unique_ptr<Group> groupAt(const ShadowMap& map, std::uint32_t x, std::uint32_t y,
                               int cells, double radius, double reach,
                               std::mt19937_64& random) {
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    const Projection& p = map.projection(0);
    auto group = std::make_unique<Group>();
    group->bundle.blocks = cells;
    group->packets.resize(std::size_t(cells));
    glm::dvec3 receiver[kLanes];  // light space
    for (std::uint32_t i = 0; i < kLanes; ++i) {
        const std::uint32_t px = x + i % 4, py = y + i / 4;
        const PixelLayers layers = map.pixel(0, px, py);
        if (layers.count == 0) return nullptr;
        const glm::dvec2 centre(px + 0.5, py + 0.5);
        receiver[i] = p.lightFromRaster(centre, layers.z[0]);
        group->bundle.u[i] = float(centre.x);
        group->bundle.v[i] = float(centre.y);
        group->bundle.w[i] = float(1.0 / receiver[i].z);
    }
    const glm::dvec3 lamp = p.lightFromWorld(map.info().light.position);
    for (int b = 0; b < cells; ++b) {
        for (int i = 0; i < kLanes; ++i) {
            const double turn = 6.283185307179586 * (b + unit()) / cells;
            const double r = radius * std::sqrt(unit());
            const glm::dvec3 to =
                lamp + r * glm::dvec3(std::cos(turn), std::sin(turn), 0.0);
            const glm::dvec2 raster = p.rasterFromLight(to);
            RayBundle& rays = group->bundle;
            rays.du[b][i] = float(raster.x) - rays.u[i];
            rays.dv[b][i] = float(raster.y) - rays.v[i];
            rays.dw[b][i] = float(1.0 / to.z) - rays.w[i];
            // s of straight space and t of the world at so many footprints.
            const double z = receiver[i].z, step = p.pixelFootprint(z);
            const auto s = [&](double footprints) {
                return float((1.0 / (z - footprints * step) - 1.0 / z) / rays.dw[b][i]);
            };
            const auto t = [&](double footprints) {
                return float(footprints * step / (z - to.z));
            };
            rays.begin[b][i] = s(1.0);
            group->end[b][i] = std::min(1.0f, s(reach));
            RTCRay16& packet = group->packets[std::size_t(b)];
            const glm::dvec3 origin = p.worldFromLight(receiver[i]);
            const glm::dvec3 way = p.worldFromLight(to) - origin;
            packet.org_x[i] = float(origin.x);
            packet.org_y[i] = float(origin.y);
            packet.org_z[i] = float(origin.z);
            packet.dir_x[i] = float(way.x);
            packet.dir_y[i] = float(way.y);
            packet.dir_z[i] = float(way.z);
            packet.tnear[i] = t(1.0);
            packet.tfar[i] = std::min(1.0f, t(reach));
            packet.time[i] = 0.0f;
            packet.mask[i] = ~0u;
            packet.id[i] = packet.flags[i] = 0;
        }
    }
    return group;
}

struct Answer {
    double seconds = 0.0;
    std::uint64_t blocked = 0;
};

template <typename Trace>
Answer timed(const std::vector<std::unique_ptr<Group>>& groups, const Trace& trace) {
    const auto start = std::chrono::steady_clock::now();
    Answer answer;
    for (const auto& group : groups)
        answer.blocked += trace(*group);
    answer.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return answer;
}

std::uint64_t traceNearField(const NearField& field, Group& group) {
    std::uint16_t asked[trace::kMostBlocks];
    std::fill_n(asked, trace::kMostBlocks, std::uint16_t(0xffff));
    std::fill_n(group.bundle.open, trace::kMostBlocks, std::uint16_t(0xffff));
    trace::traceNear(field, group.bundle, group.end, asked);
    std::uint64_t blocked = 0;
    for (int b = 0; b < group.bundle.blocks; ++b)
        blocked += std::uint64_t(16 - std::popcount(group.bundle.open[b]));
    return blocked;
}

std::uint64_t traceEmbree(RTCScene scene, const Group& group) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    alignas(64) int valid[16];
    std::fill_n(valid, 16, -1);
    std::uint64_t blocked = 0;
    for (const RTCRay16& packet : group.packets) {
        alignas(64) RTCRay16 rays = packet;
        rtcOccluded16(valid, scene, &context, &rays);
        for (int i = 0; i < 16; ++i)
            blocked += rays.tfar[i] < 0.0f;
    }
    return blocked;
}

double median(std::vector<double> v) {
    std::nth_element(v.begin(), v.begin() + long(v.size() / 2), v.end());
    return v[v.size() / 2];
}

void measure(const ShadowMap& map, RTCScene scene, int cells, double radius,
             double reach) {
    std::mt19937_64 random(1);
    std::vector<std::unique_ptr<Group>> groups;
    while (groups.size() < kGroups) {
        const std::uint32_t width = map.info().width - 4, height = map.info().height - 4;
        auto group =
            groupAt(map, std::uint32_t(random() % width),
                    std::uint32_t(random() % height), cells, radius, reach, random);
        if (group) groups.push_back(std::move(group));
    }
    std::vector<double> near, embree;
    Answer a, b;
    for (int i = 0; i < kRepeats; ++i) {
        a = timed(groups, [&](Group& g) { return traceNearField(map.nearField(0), g); });
        b = timed(groups, [&](Group& g) { return traceEmbree(scene, g); });
        near.push_back(a.seconds);
        embree.push_back(b.seconds);
    }
    const double rays = double(kGroups) * cells * 16;
    std::printf("%5d %6.2f %6.0f %10.2f %10.2f %8.2f %10.4f %10.4f\n", cells, radius,
                reach, 1e9 * median(near) / rays, 1e9 * median(embree) / rays,
                median(embree) / median(near), double(a.blocked) / rays,
                double(b.blocked) / rays);
}

}  // namespace

int main(int argc, char** argv) {
    const test::Mesh body = test::bumpyBody(350'000);
    const ShadowMap map =
        bakedMap(body, argc > 1 ? std::uint32_t(std::atoi(argv[1])) : 1024);
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene scene = sceneOf(device, body);
    std::printf(
        "cells radius  reach near ns/ray  Embree ns/ray ratio    blocked   Embree\n");
    for (const int cells : {1, 16, 64}) {
        for (const double radius : {0.1, 0.33, 1.0}) {
            for (const double reach : {8.0, 32.0})
                measure(map, scene, cells, radius, reach);
        }
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    return 0;
}
