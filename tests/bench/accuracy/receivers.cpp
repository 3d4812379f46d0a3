#include "accuracy/receivers.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec4.hpp>
#include <numeric>

#include "accuracy/random.h"
#include "baseline/picture.h"

namespace mtsm::bench {
namespace {

constexpr double kOffStrand = 1e-4;  // of the stage's size

/// `count` numbers in [0, total), ascending.
std::vector<double> sortedNumbers(std::size_t count, double total, Random& random) {
    std::vector<double> numbers(count);
    for (double& number : numbers)
        number = random(0, total);
    std::sort(numbers.begin(), numbers.end());
    return numbers;
}

/// visit(a, b) for the segments of strands, in the world.
template <typename Visit>
void eachSegment(CasterSource& casters, const Visit& visit) {
    (void)casters.visit([&](const CasterView& caster) -> Status {
        const auto* strands = std::get_if<StrandsView>(&caster);
        for (std::size_t s = 0; strands && s < strands->strandCount; ++s) {
            for (std::uint32_t i = strands->begin[s]; i + 1 < strands->begin[s + 1]; ++i)
                visit(glm::dvec3(strands->worldFromObject *
                                 glm::dvec4(strands->points[i], 1.0)),
                      glm::dvec3(strands->worldFromObject *
                                 glm::dvec4(strands->points[i + 1], 1.0)));
        }
        return {};
    });
}

/// visit(volume, index of the voxel) for the voxels that hold something.
template <typename Visit>
void eachVoxel(CasterSource& casters, const Visit& visit) {
    (void)casters.visit([&](const CasterView& caster) -> Status {
        const auto* volume = std::get_if<VolumeView>(&caster);
        for (std::size_t b = 0; volume && b < volume->blockCount; ++b) {
            for (int i = 0; i < VolumeView::kBlockVoxels; ++i) {
                if (volume->density[b * VolumeView::kBlockVoxels + std::size_t(i)] > 0.0f)
                    visit(*volume,
                          volume->blocks[b] + glm::ivec3(i & 7, i >> 3 & 7, i >> 6));
            }
        }
        return {};
    });
}

}  // namespace

bool Receivers::hasNormals() const noexcept {
    return std::any_of(normal.begin(), normal.end(),
                       [](glm::dvec3 n) { return n != glm::dvec3(0.0); });
}

double Stage::size() const noexcept {
    return std::max({high.x - low.x, high.y - low.y, high.z - low.z});
}

Receivers onFloor(const Stage& stage, std::size_t side) {
    Receivers floor;
    floor.name = "floor";
    const auto along = [&](std::size_t i) {
        return 3.0 * stage.size() * ((double(i) + 0.5) / double(side) - 0.5);
    };
    for (std::size_t j = 0; j < side; ++j) {
        for (std::size_t i = 0; i < side; ++i)
            floor.add(
                {stage.centre().x + along(i), stage.low.y, stage.centre().z + along(j)},
                {0, 1, 0});
    }
    return floor;
}

Receivers onMeshes(CasterSource& casters, std::size_t count, glm::dvec3 towards) {
    struct Triangle {
        glm::dvec3 a, b, c;
    };
    std::vector<Triangle> triangles;
    std::vector<double> area{0.0};
    (void)casters.visit(meshesOnly([&](const MeshView& mesh) -> Status {
        for (std::size_t i = 0; i < mesh.triangleCount; ++i) {
            const auto corner = [&](std::size_t k) {
                return glm::dvec3(
                    mesh.worldFromObject *
                    glm::dvec4(mesh.positions[mesh.indices[3 * i + k]], 1.0));
            };
            const Triangle t{corner(0), corner(1), corner(2)};
            const glm::dvec3 n = glm::cross(t.b - t.a, t.c - t.a);
            if (!(glm::dot(n, towards) > 0.0))
                continue;  // turned away: dark by definition
            triangles.push_back(t);
            area.push_back(area.back() + 0.5 * glm::length(n));
        }
        return {};
    }));
    Receivers points;
    points.name = "surface";
    Random random(1);
    for (std::size_t i = 0; i < count && !triangles.empty(); ++i) {
        const auto at =
            std::upper_bound(area.begin(), area.end(), random(0, area.back()));
        const Triangle& t =
            triangles[std::min(triangles.size(), std::size_t(at - area.begin())) - 1];
        const double u = std::sqrt(random(0, 1)), v = random(0, 1);
        points.add((1 - u) * t.a + u * (1 - v) * t.b + u * v * t.c,
                   glm::normalize(glm::cross(t.b - t.a, t.c - t.a)));
    }
    return points;
}

Receivers onStrands(CasterSource& casters, std::size_t count, const Stage& stage) {
    double total = 0.0;
    eachSegment(casters, [&](glm::dvec3 a, glm::dvec3 b) {
        const double length = glm::distance(a, b);
        if (std::isfinite(length)) total += length;
    });
    Receivers points;
    points.name = "strands";
    if (!(total > 0.0)) return points;
    Random random(2);
    const std::vector<double> at = sortedNumbers(count, total, random);
    double before = 0.0;
    eachSegment(casters, [&](glm::dvec3 a, glm::dvec3 b) {
        const double length = glm::distance(a, b);
        if (!std::isfinite(length)) return;
        for (std::size_t i = points.size(); i < count && at[i] < before + length; ++i) {
            const glm::dvec3 p = glm::mix(a, b, (at[i] - before) / length);
            const glm::dvec3 outward = p - stage.centre();
            points.add(p, glm::dvec3(0.0),
                       p + kOffStrand * stage.size() * glm::normalize(outward));
        }
        before += length;
    });
    return points;
}

Receivers inVolumes(CasterSource& casters, std::size_t count) {
    std::size_t total = 0;
    eachVoxel(casters, [&](const VolumeView&, glm::ivec3) { ++total; });
    Receivers points;
    points.name = "volume";
    Random random(3);
    const std::vector<double> at = sortedNumbers(count, double(total), random);
    std::size_t before = 0;
    eachVoxel(casters, [&](const VolumeView& volume, glm::ivec3 voxel) {
        ++before;
        while (points.size() < count && at[points.size()] < double(before)) {
            const double x = random(-0.5, 0.5), y = random(-0.5, 0.5);
            const glm::dvec3 within(x, y, random(-0.5, 0.5));
            points.add(glm::dvec3(volume.worldFromIndex *
                                  glm::dvec4(glm::dvec3(voxel) + within, 1.0)),
                       glm::dvec3(0.0));
        }
    });
    return points;
}

Picture takePicture(const baseline::EmbreeReference& scene, const Stage& stage,
                    std::size_t pixels) {
    const glm::vec3 corners[] = {{-1, 0, -1}, {1, 0, -1}, {1, 0, 1}, {-1, 0, 1}};
    const std::uint32_t indices[] = {0, 2, 1, 0, 3, 2};
    MeshView square;
    square.positions = corners;
    square.vertexCount = 4;
    square.indices = indices;
    square.triangleCount = 2;
    const double half = 1.5 * stage.size();
    square.worldFromObject = glm::dmat4(
        glm::dvec4(half, 0, 0, 0), glm::dvec4(0, 1, 0, 0), glm::dvec4(0, 0, half, 0),
        glm::dvec4(stage.centre().x, stage.low.y, stage.centre().z, 1));
    CasterViews floor({square});
    const auto seenFloor = baseline::EmbreeReference::build(floor);
    auto camera = baseline::Camera::framing(stage.low, stage.high);
    camera.pointsPerSide = 4;
    const baseline::Picture all =
        baseline::takePicture(camera, scene, seenFloor ? &*seenFloor : nullptr);

    Picture picture;
    picture.object.name = "object px";
    picture.floor.name = "floor px";
    picture.object.first = picture.floor.first = {0};
    Random random(4);
    std::vector<std::size_t> order(all.pixels());
    std::iota(order.begin(), order.end(), std::size_t(0));
    for (std::size_t k = 0; k < order.size(); ++k) {
        std::swap(order[k], order[k + random.below(order.size() - k)]);
        const std::size_t p = order[k];
        Receivers& kind = all.object[p] ? picture.object : picture.floor;
        if (kind.first.size() > pixels) continue;
        for (std::size_t i = all.first[p]; i < all.first[p + 1]; ++i)
            kind.add(all.points[i], all.normals[i], all.starts[i]);
        kind.first.push_back(kind.size());
    }
    const auto objects = std::count(all.object.begin(), all.object.end(), 1);
    picture.objectShare = all.pixels() ? double(objects) / double(all.pixels()) : 0.0;
    return picture;
}

}  // namespace mtsm::bench
