// bench_near - short rays against the near field and against Embree's packets, side by
// side in one run.
//
//     bench_near [RESOLUTION]
//
// A body of 350,000 triangles under a disk light. Receivers are the 16 points of 4 x 4
// pixels of the map, where the light's centre sees the body; each sends 16 rays to each
// of `parts` sectors of the light. What counts is met from 1 footprint of a pixel in
// front of the receiver to `reach` of them, as depth goes. With planes, only what rises
// above the receiver's tangent plane (of its neighbours' depths) counts, as in queries
// with normals; Embree knows no such thing.
#include <embree3/rtcore.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>
#include <random>
#include <vector>

#include "bumpy_mesh.h"
#include "mtsm/bake.h"
#include "trace/bundle_fixture.h"
#include "trace/near_trace.h"

namespace {

using namespace mtsm;
using trace::kLanes;

constexpr int kGroups = 400;
constexpr int kRepeats = 7;

/// Most parts that a bundle of 16 receivers holds.
constexpr int kParts = trace::kMostRows / kLanes;
/// As in queries, pixel footprints.
constexpr double kPlaneHeight = 0.02;

struct Group {
    std::vector<test::Rays> bundles;  // kParts parts each
    std::vector<RTCRay16> packets;    // the same rays in the world
    float planeHeight = 0.0f;
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

/// Where the centre ray of a pixel meets the body, in straight space.
glm::dvec3 straightAt(const ShadowMap& map, std::uint32_t x, std::uint32_t y) {
    return {x + 0.5, y + 0.5, 1.0 / map.pixel(0, x, y).z[0]};
}

/// The receiver of a pixel, and the plane through its neighbours.
void setReceiver(const ShadowMap& map, std::uint32_t x, std::uint32_t y, int receiver,
                 test::Rays& rays) {
    const glm::dvec3 at = straightAt(map, x, y);
    rays.setStart(receiver, at);
    const double perU = straightAt(map, x + 1, y).z - at.z;
    const double perV = straightAt(map, x, y + 1).z - at.z;
    rays.bundle.planeU[receiver] = float(-perU);
    rays.bundle.planeV[receiver] = float(-perV);
    rays.bundle.planeW[receiver] = 1.0f;
}

/// A ray to a point of light space, what of it counts, and the same for Embree.
void setRay(const Projection& p, glm::dvec3 from, glm::dvec3 to, double reach, int row,
            int lane, test::Rays& rays, RTCRay16& packet) {
    const int receiver = row / rays.bundle.groups;
    rays.setDelta(row, lane,
                  glm::dvec3(p.rasterFromLight(to), 1.0 / to.z) - rays.start(receiver));
    // s of straight space and t of the world at so many footprints.
    const double step = p.pixelFootprint(from.z);
    const auto s = [&](double footprints) {
        const double w = 1.0 / (from.z - footprints * step) - 1.0 / from.z;
        return float(w / rays.bundle.dw[row][lane]);
    };
    const auto t = [&](double footprints) {
        return float(footprints * step / (from.z - to.z));
    };
    rays.bundle.begin[row][lane] = s(1.0);
    rays.end[row][lane] = std::min(1.0f, s(reach));
    const glm::dvec3 origin = p.worldFromLight(from);
    const glm::dvec3 way = p.worldFromLight(to) - origin;
    packet.org_x[lane] = float(origin.x);
    packet.org_y[lane] = float(origin.y);
    packet.org_z[lane] = float(origin.z);
    packet.dir_x[lane] = float(way.x);
    packet.dir_y[lane] = float(way.y);
    packet.dir_z[lane] = float(way.z);
    packet.tnear[lane] = t(1.0);
    packet.tfar[lane] = std::min(1.0f, t(reach));
    packet.time[lane] = 0.0f;
    packet.mask[lane] = ~0u;
    packet.id[lane] = packet.flags[lane] = 0;
}

/// Rays of 4 x 4 pixels to a light of this radius.
std::unique_ptr<Group> groupAt(const ShadowMap& map, std::uint32_t x, std::uint32_t y,
                               int parts, double radius, double reach,
                               std::mt19937_64& random) {
    const auto unit = [&] { return double(random() >> 11) * 0x1p-53; };
    for (std::uint32_t i = 0; i < 25; ++i) {
        if (map.pixel(0, x + i % 5, y + i / 5).count == 0) return nullptr;
    }
    const Projection& p = map.projection(0);
    const glm::dvec3 lamp = p.lightFromWorld(map.info().light.position);
    auto group = std::make_unique<Group>();
    const double w = straightAt(map, x, y).z;
    group->planeHeight = float(kPlaneHeight * p.pixelFootprint(1.0) * w);
    for (int first = 0; first < parts; first += kParts) {
        test::Rays& rays =
            group->bundles.emplace_back(kLanes, std::min(kParts, parts - first));
        for (int row = 0; row < rays.rows(); ++row) {
            const int receiver = row / rays.bundle.groups;
            const int part = first + row % rays.bundle.groups;
            const std::uint32_t px = x + std::uint32_t(receiver % 4);
            const std::uint32_t py = y + std::uint32_t(receiver / 4);
            setReceiver(map, px, py, receiver, rays);
            const glm::dvec3 from =
                p.lightFromRaster({px + 0.5, py + 0.5}, map.pixel(0, px, py).z[0]);
            RTCRay16& packet = group->packets.emplace_back();
            for (int lane = 0; lane < kLanes; ++lane) {
                const double turn = 6.283185307179586 * (part + unit()) / parts;
                const double r = radius * std::sqrt(unit());
                const glm::dvec3 to =
                    lamp + r * glm::dvec3(std::cos(turn), std::sin(turn), 0.0);
                setRay(p, from, to, reach, row, lane, rays, packet);
            }
        }
        rays.boundEnds();
    }
    return group;
}

struct Answer {
    double seconds = 0.0;
    std::uint64_t blocked = 0;
};

template <typename Trace>
Answer timed(const std::vector<std::unique_ptr<Group>>& groups, const Trace& trace) {
    const std::clock_t start = std::clock();  // of the processor: machines are shared
    Answer answer;
    for (const auto& group : groups)
        answer.blocked += trace(*group);
    answer.seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
    return answer;
}

std::uint64_t traceNearField(const NearField& field, Group& group, bool planes) {
    std::uint64_t blocked = 0;
    for (test::Rays& rays : group.bundles) {
        rays.openAll();
        rays.bundle.hasPlanes = planes;
        trace::traceNear(field, rays.bundle, rays.end, group.planeHeight);
        for (int row = 0; row < rays.rows(); ++row)
            blocked += std::uint64_t(kLanes - std::popcount(rays.bundle.open[row]));
    }
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

void measure(const ShadowMap& map, RTCScene scene, int parts, double radius,
             double reach) {
    std::mt19937_64 random(1);
    std::vector<std::unique_ptr<Group>> groups;
    while (groups.size() < kGroups) {
        const std::uint32_t width = map.info().width - 5, height = map.info().height - 5;
        auto group =
            groupAt(map, std::uint32_t(random() % width),
                    std::uint32_t(random() % height), parts, radius, reach, random);
        if (group) groups.push_back(std::move(group));
    }
    std::vector<double> times[3];
    Answer answers[3];
    for (int i = 0; i < kRepeats; ++i) {
        for (const bool planes : {false, true})
            answers[planes] = timed(groups, [&](Group& g) {
                return traceNearField(map.nearField(0), g, planes);
            });
        answers[2] = timed(groups, [&](Group& g) { return traceEmbree(scene, g); });
        for (int k = 0; k < 3; ++k)
            times[k].push_back(answers[k].seconds);
    }
    const double rays = double(kGroups) * parts * kLanes * kLanes;
    std::printf("%5d %6.2f %6.0f", parts, radius, reach);
    for (const std::vector<double>& time : times)
        std::printf(" %8.2f", 1e9 * median(time) / rays);
    for (int k = 0; k < 2; ++k)
        std::printf(" %8.2f", median(times[2]) / median(times[k]));
    for (const Answer& answer : answers)
        std::printf(" %8.4f", double(answer.blocked) / rays);
    std::printf("\n");
}

}  // namespace

int main(int argc, char** argv) {
    const test::Mesh body = test::bumpyBody(350'000);
    const ShadowMap map =
        bakedMap(body, argc > 1 ? std::uint32_t(std::atoi(argv[1])) : 1024);
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene scene = sceneOf(device, body);
    std::printf(
        "                     ns/ray                     Embree's time /   blocked\n"
        "parts radius  reach     near   planes   Embree     near   planes     near   "
        "planes   Embree\n");
    for (const int parts : {1, 4, 16}) {
        for (const double radius : {0.1, 0.33, 1.0}) {
            for (const double reach : {8.0, 32.0})
                measure(map, scene, parts, radius, reach);
        }
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    return 0;
}
