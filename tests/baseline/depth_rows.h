// depth_rows.h - rows of the comparison run on small scenes, and the closed form of
// rectangles over a floor.
#pragma once
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "baseline/methods.h"
#include "baseline/reference_embree.h"
#include "bumpy_mesh.h"

namespace mtsm::test {

using baseline::Settings;
using baseline::SettingValue;

struct Points {
    std::vector<glm::dvec3> position, normal;

    void add(glm::dvec3 p, glm::dvec3 n) {
        position.push_back(p);
        normal.push_back(n);
    }
    [[nodiscard]] std::size_t size() const { return position.size(); }
};

/// A line of points on the floor y = 0 along x, a little aside of z = 0.
inline Points floorLine(double from, double to, std::size_t count, bool normals = true) {
    Points points;
    for (std::size_t i = 0; i < count; ++i)
        points.add({from + (to - from) * (double(i) + 0.5) / double(count), 0, 0.07},
                   {0, normals ? 1 : 0, 0});
    return points;
}

/// side * side points of the floor, |x| and |z| < reach.
inline Points floorGrid(double reach, std::size_t side, double y = 0.0) {
    Points points;
    for (std::size_t i = 0; i < side * side; ++i) {
        const auto at = [&](std::size_t k) {
            return reach * (2 * (double(k) + 0.5) / double(side) - 1);
        };
        points.add({at(i % side), y, at(i / side)}, {0, 1, 0});
    }
    return points;
}

/// What a row answers; its query is given the light that it was built for.
inline std::vector<float> run(const std::string& row, std::vector<CasterView> views,
                              const BakeOptions& bake, const Settings::Given& given,
                              const Points& points) {
    using namespace baseline;
    const auto info = findMethod(row);
    REQUIRE(info);
    const auto settings = Settings::complete((*info)->settings, given, row);
    if (!settings) FAIL(settings.error().message);
    CasterViews casters(std::move(views));
    const auto method = (*info)->build({casters, bake, {}}, *settings);
    if (!method) FAIL(method.error().message);
    CHECK((*method)->memoryBytes() > 0);
    std::vector<std::size_t> first(points.size() + 1);
    for (std::size_t i = 0; i < first.size(); ++i)
        first[i] = i;
    const Receivers at{points.position.data(), points.normal.data(),
                       points.position.data(), points.size(),
                       first.data(),           points.size()};
    std::vector<float> out(points.size(), -1.0f);
    const Status answered =
        (*method)->shadowFactors(bake.light, at, *settings, out.data());
    if (!answered) FAIL(answered.error().message);
    return out;
}

/// As ray tracing answers.
inline std::vector<float> truth(std::vector<CasterView> views, const AreaLight& light,
                                const Points& points, int samples) {
    CasterViews casters(std::move(views));
    auto embree = baseline::EmbreeReference::build(casters);
    REQUIRE(embree);
    std::vector<float> out(points.size());
    baseline::ReferenceOptions options;
    options.samples = samples;
    embree->shadowFactors(light, points.position.data(), points.normal.data(),
                          points.size(), out.data(), options);
    return out;
}

inline double meanError(const std::vector<float>& a, const std::vector<float>& b) {
    double sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i)
        sum += std::abs(double(a[i]) - double(b[i]));
    return sum / double(a.size());
}

/// A rectangle at a height, parallel to the floor.
struct Rect {
    double x0, x1, z0, z1, y;

    [[nodiscard]] Mesh mesh() const {
        const auto at = [&](double x, double z) { return glm::vec3(x, y, z); };
        Mesh mesh;
        mesh.positions = {at(x0, z0), at(x1, z0), at(x1, z1), at(x0, z1)};
        mesh.indices = {0, 1, 2, 0, 2, 3};
        return mesh;
    }
};

/// A rectangular light of this size at (0, height, 0), shining down.
inline BakeOptions rectLight(double height, double sizeX, double sizeZ) {
    BakeOptions options;
    options.light.shape = LightShape::rect;
    options.light.position = {0, height, 0};
    options.light.direction = {0, -1, 0};
    options.light.up = {0, 0, 1};
    options.light.size = {sizeX, sizeZ};
    options.aimed = true;
    return options;
}

/// What of the plane of rectLight(height, ...) a rectangle hides from p.
inline Rect hiddenOfLight(const Rect& r, double height, glm::dvec3 p) {
    const double k = (height - p.y) / (r.y - p.y);
    return {p.x + k * (r.x0 - p.x), p.x + k * (r.x1 - p.x), p.z + k * (r.z0 - p.z),
            p.z + k * (r.z1 - p.z), height};
}
inline Rect common(const Rect& a, const Rect& b) {
    return {std::max(a.x0, b.x0), std::min(a.x1, b.x1), std::max(a.z0, b.z0),
            std::min(a.z1, b.z1), a.y};
}
inline double area(const Rect& r) {
    return std::max(0.0, r.x1 - r.x0) * std::max(0.0, r.z1 - r.z0);
}

/// The shadow factor under one rectangle.
inline double shadowOf(const Rect& r, const BakeOptions& options, glm::dvec3 p) {
    const AreaLight& light = options.light;
    const Rect whole{-light.size.x / 2, light.size.x / 2, -light.size.y / 2,
                     light.size.y / 2, light.position.y};
    return area(common(hiddenOfLight(r, light.position.y, p), whole)) / area(whole);
}

/// Noise of n stratified samples: about sqrt(n) of them lie on each of `edges` edges,
/// four deviations.
inline double noise(double n, double edges = 2.0) {
    return 4 * std::sqrt(edges * std::sqrt(n)) / n;
}

}  // namespace mtsm::test
