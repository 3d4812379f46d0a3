// Receivers and the parallelograms around them.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "base/message.h"
#include "baseline/radiance_texture.h"

namespace mtsm::baseline {
namespace {

constexpr double kFlat = 1e-4;  // share of a polygon's extent

/// Even-odd rule.
bool insideOutline(const std::vector<glm::dvec2>& outline, glm::dvec2 p) {
    bool inside = false;
    for (std::size_t i = 0, j = outline.size() - 1; i < outline.size(); j = i++) {
        const glm::dvec2 a = outline[i], b = outline[j];
        if ((a.y > p.y) != (b.y > p.y) &&
            p.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x)
            inside = !inside;
    }
    return inside;
}

/// Twice the area as a vector; corners counted from the first, so that a large offset
/// costs nothing.
glm::dvec3 doubleArea(const std::vector<glm::dvec3>& corners) {
    glm::dvec3 sum(0.0);
    for (std::size_t i = 2; i < corners.size(); ++i)
        sum += glm::cross(corners[i - 1] - corners[0], corners[i] - corners[0]);
    return sum;
}

glm::dvec3 longestEdge(const std::vector<glm::dvec3>& corners) {
    glm::dvec3 longest(0.0);
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const glm::dvec3 edge = corners[(i + 1) % corners.size()] - corners[i];
        if (glm::length(edge) > glm::length(longest)) longest = edge;
    }
    return longest;
}

}  // namespace

bool RadianceReceiver::contains(glm::dvec2 uv) const noexcept {
    if (!(uv.x >= 0.0 && uv.y >= 0.0 && uv.x <= 1.0 && uv.y <= 1.0)) return false;
    if (shape == ReceiverShape::triangle) return uv.x + uv.y <= 1.0;
    return shape == ReceiverShape::parallelogram || insideOutline(outline, uv);
}

RadianceReceiver parallelogramReceiver(const PlanarReceiver& plane) {
    RadianceReceiver receiver;
    receiver.plane = plane;
    return receiver;
}

RadianceReceiver triangleReceiver(glm::dvec3 a, glm::dvec3 b, glm::dvec3 c) {
    const auto skew = [](glm::dvec3 corner, glm::dvec3 next, glm::dvec3 last) {
        return std::abs(
            glm::dot(glm::normalize(next - corner), glm::normalize(last - corner)));
    };
    const double atA = skew(a, b, c), atB = skew(b, c, a), atC = skew(c, a, b);
    RadianceReceiver receiver;
    receiver.shape = ReceiverShape::triangle;
    receiver.plane = {a, b - a, c - a};
    if (atB < atA && atB <= atC) receiver.plane = {b, c - b, a - b};
    if (atC < atA && atC < atB) receiver.plane = {c, a - c, b - c};
    return receiver;
}

Result<RadianceReceiver> polygonReceiver(const std::vector<glm::dvec3>& corners) {
    const glm::dvec3 area = doubleArea(corners);
    const glm::dvec3 longest = longestEdge(corners);
    if (corners.size() < 3 || !(glm::length(area) > 0.0) || !(glm::length(longest) > 0.0))
        return Error{ErrorCode::badArgument,
                     "a polygon has no area; it needs three corners or more that are not "
                     "in line"};
    const glm::dvec3 n = glm::normalize(area), x = glm::normalize(longest),
                     y = glm::cross(n, x);
    Box box;
    for (const glm::dvec3 corner : corners) {
        const glm::dvec3 d = corner - corners[0];
        box.include({glm::dot(d, x), glm::dot(d, y), glm::dot(d, n)});
    }
    const glm::dvec3 size = box.high - box.low;
    if (size.z > kFlat * std::max(size.x, size.y))
        return base::makeError(ErrorCode::badArgument, "a polygon of ", corners.size(),
                               " corners is not flat: they are up to ", size.z,
                               " apart across its plane; cut it into triangles");
    RadianceReceiver receiver;
    receiver.shape = ReceiverShape::polygon;
    receiver.plane.corner = corners[0] + box.low.x * x + box.low.y * y;
    receiver.plane.edgeX = size.x * x;
    receiver.plane.edgeY = size.y * y;
    for (const glm::dvec3 corner : corners) {
        const glm::dvec3 d = corner - receiver.plane.corner;
        receiver.outline.emplace_back(glm::dot(d, x) / size.x, glm::dot(d, y) / size.y);
    }
    return receiver;
}

glm::uvec2 textureSize(const RadianceReceiver& receiver,
                       const RadianceOptions& options) noexcept {
    if (receiver.texels.x > 0) return receiver.texels;
    const PlanarReceiver& plane = receiver.plane;
    const glm::dvec2 length(glm::length(plane.edgeX), glm::length(plane.edgeY));
    const double texel = options.pixelSize > 0.0
                             ? options.pixelSize
                             : std::max(length.x, length.y) / options.resolution;
    // A hair less, so that 256 of 1/256 are not 257.
    const auto texels = [&](double side) {
        const double count = std::max(1.0, std::ceil(side / texel - 1e-6));
        return std::uint32_t(std::min(count, kMaxResolution + 1.0));
    };
    return {texels(length.x), texels(length.y)};
}

std::vector<TrianglePair> pairTriangles(std::vector<RadianceReceiver>& receivers,
                                        const RadianceOptions& options) {
    std::vector<std::size_t> triangles;
    for (std::size_t i = 0; i < receivers.size(); ++i) {
        if (receivers[i].shape != ReceiverShape::triangle) continue;
        receivers[i].texels = textureSize(receivers[i], options);
        triangles.push_back(i);
    }
    std::stable_sort(
        triangles.begin(), triangles.end(), [&](std::size_t a, std::size_t b) {
            const glm::uvec2 s = receivers[a].texels, t = receivers[b].texels;
            return s.y != t.y ? s.y > t.y : s.x > t.x;
        });
    const auto texels = [](glm::uvec2 size) { return std::uint64_t(size.x) * size.y; };
    std::vector<TrianglePair> pairs;
    for (std::size_t i = 0; i < triangles.size(); ++i) {
        TrianglePair pair{triangles[i]};
        if (i + 1 < triangles.size()) {
            glm::uvec2 &first = receivers[pair.first].texels,
                       &second = receivers[triangles[i + 1]].texels;
            const glm::uvec2 both = glm::max(first, second);
            // A long one and a tall one would not save any.
            if (texels(both) < texels(first) + texels(second)) {
                pair.second = triangles[++i];
                first = second = both;
            }
        }
        pairs.push_back(pair);
    }
    return pairs;
}

}  // namespace mtsm::baseline
