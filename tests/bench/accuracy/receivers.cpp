#include "accuracy/receivers.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <numeric>
#include <optional>

#include "accuracy/random.h"

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

/// What a camera's ray meets first.
struct Seen {
    glm::dvec3 position, normal, truth;
    bool object = false;
};

class Camera {
  public:
    static constexpr int kWidth = 600, kHeight = 300;

    Camera(const baseline::EmbreeReference& scene, const Stage& stage);
    /// (x, y) in pixels.
    [[nodiscard]] std::optional<Seen> look(double x, double y, Random& random) const;

  private:
    [[nodiscard]] std::optional<Seen> surface(glm::dvec3 ray) const;

    const baseline::EmbreeReference& scene_;
    Stage stage_;
    glm::dvec3 eye_, forward_, right_, up_;
    glm::dvec2 middle_{0.0};  // of the object, in units of tangents
    double perPixel_ = 0.0;
};

Camera::Camera(const baseline::EmbreeReference& scene, const Stage& stage)
    : scene_(scene), stage_(stage) {
    const glm::dvec3 back = glm::normalize(glm::dvec3(0.55, 0.45, 1.0));
    eye_ = stage.centre() + 2.5 * glm::length(stage.high - stage.low) * back;
    forward_ = -back;
    right_ = glm::normalize(glm::cross(forward_, glm::dvec3(0, 1, 0)));
    up_ = glm::cross(right_, forward_);
    // The bounds' corners fill nine tenths of the picture.
    glm::dvec2 low(std::numeric_limits<double>::infinity()), high(-low);
    for (int corner = 0; corner < 8; ++corner) {
        const glm::dvec3 p =
            glm::mix(stage.low, stage.high,
                     glm::dvec3(corner & 1, corner >> 1 & 1, corner >> 2)) -
            eye_;
        const glm::dvec2 at =
            glm::dvec2(glm::dot(p, right_), glm::dot(p, up_)) / glm::dot(p, forward_);
        low = glm::min(low, at);
        high = glm::max(high, at);
    }
    middle_ = 0.5 * (low + high);
    perPixel_ =
        std::max((high.x - low.x) / (0.9 * kWidth), (high.y - low.y) / (0.9 * kHeight));
}

std::optional<Seen> Camera::surface(glm::dvec3 ray) const {
    if (const auto hit = scene_.firstHit(eye_, ray)) {
        if (!hit->strand) return Seen{hit->position, hit->normal, hit->position, true};
        return Seen{hit->position, glm::dvec3(0.0),
                    hit->position + kOffStrand * stage_.size() * hit->normal, true};
    }
    if (!(ray.y < 0.0)) return std::nullopt;
    const glm::dvec3 floor = eye_ + (stage_.low.y - eye_.y) / ray.y * ray;
    const glm::dvec3 aside = glm::abs(floor - stage_.centre());
    if (std::max(aside.x, aside.z) > 1.5 * stage_.size()) return std::nullopt;
    return Seen{floor, {0, 1, 0}, floor, false};
}

std::optional<Seen> Camera::look(double x, double y, Random& random) const {
    const glm::dvec2 at =
        middle_ + perPixel_ * glm::dvec2(x - 0.5 * kWidth, 0.5 * kHeight - y);
    const glm::dvec3 ray = glm::normalize(forward_ + at.x * right_ + at.y * up_);
    const auto seen = surface(ray);
    // Up to the surface there is nothing but volumes.
    const double reach = seen ? (1 - 1e-7) * glm::distance(eye_, seen->position)
                              : 10 * glm::distance(eye_, stage_.centre());
    const auto passes = [&](double t) { return scene_.visibility(eye_, t * ray).x; };
    const double left = random(0, 1);
    if (passes(reach) > left) return seen;
    double near = 0.0, far = reach;
    for (int i = 0; i < 50; ++i) {
        const double middle = 0.5 * (near + far);
        (passes(middle) > left ? near : far) = middle;
    }
    return Seen{eye_ + far * ray, glm::dvec3(0.0), eye_ + far * ray, true};
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
    constexpr int kSide = 4;  // rays per side of a pixel
    const Camera camera(scene, stage);
    Random random(4);
    std::vector<int> order(std::size_t(Camera::kWidth) * Camera::kHeight);
    std::iota(order.begin(), order.end(), 0);
    Picture picture;
    picture.object.name = "object px";
    picture.floor.name = "floor px";
    picture.object.first = picture.floor.first = {0};
    std::size_t onObject = 0, visited = 0;
    for (std::size_t k = 0; k < order.size(); ++k) {
        const auto full = [&](const Receivers& r) { return r.first.size() > pixels; };
        if (full(picture.object) && full(picture.floor)) break;
        std::swap(order[k], order[k + random.below(order.size() - k)]);
        std::vector<Seen> seen;
        for (int ray = 0; ray < kSide * kSide; ++ray) {
            const double x = (ray % kSide + random(0, 1)) / kSide,
                         y = (ray / kSide + random(0, 1)) / kSide;
            if (const auto met = camera.look(order[k] % Camera::kWidth + x,
                                             order[k] / Camera::kWidth + y, random))
                seen.push_back(*met);
        }
        if (seen.empty()) continue;
        const auto objects = std::size_t(std::count_if(
            seen.begin(), seen.end(), [](const Seen& s) { return s.object; }));
        const bool isObject = 2 * objects >= seen.size();
        ++visited;
        onObject += isObject;
        Receivers& kind = isObject ? picture.object : picture.floor;
        if (full(kind)) continue;
        for (const Seen& s : seen)
            kind.add(s.position, s.normal, s.truth);
        kind.first.push_back(kind.size());
    }
    picture.objectShare = visited ? double(onObject) / double(visited) : 0.0;
    return picture;
}

}  // namespace mtsm::bench
