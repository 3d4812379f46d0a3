// Triangles of a mesh to flat faces.
#include <algorithm>
#include <array>
#include <glm/geometric.hpp>
#include <map>
#include <numeric>
#include <optional>
#include <tuple>
#include <utility>

#include "base/finite.h"
#include "baseline/radiance_texture.h"

namespace mtsm::baseline {
namespace {

constexpr double kFlat = 1e-5;  // share of an edge's length

using Corners = std::array<std::size_t, 3>;
using Edge = std::pair<std::size_t, std::size_t>;

/// Triangles over points that are where they are once only.
struct Welded {
    std::vector<glm::dvec3> points;
    std::vector<Corners> triangles;

    explicit Welded(const MeshView& mesh) {
        std::map<std::tuple<double, double, double>, std::size_t> known;
        const auto weld = [&](std::uint32_t vertex) {
            const glm::dvec3 p =
                mesh.worldFromObject * glm::dvec4(mesh.positions[vertex], 1.0);
            const auto [at, isNew] = known.try_emplace({p.x, p.y, p.z}, points.size());
            if (isNew) points.push_back(p);
            return at->second;
        };
        for (std::size_t i = 0; i < mesh.triangleCount; ++i) {
            const std::uint32_t* const v = mesh.indices + 3 * i;
            const glm::dvec3 a(mesh.positions[v[0]]), b(mesh.positions[v[1]]),
                c(mesh.positions[v[2]]);
            if (!base::isFinite(a) || !base::isFinite(b) || !base::isFinite(c)) continue;
            const Corners t{weld(v[0]), weld(v[1]), weld(v[2])};
            const glm::dvec3 n = normal(t);
            if (glm::dot(n, n) > 0.0) triangles.push_back(t);
        }
    }
    [[nodiscard]] glm::dvec3 normal(const Corners& t) const {
        return glm::cross(points[t[1]] - points[t[0]], points[t[2]] - points[t[0]]);
    }
    /// Whether all of `other` lies in the plane of `t` and faces the same side.
    [[nodiscard]] bool coplanar(const Corners& t, const Corners& other) const {
        const glm::dvec3 n = glm::normalize(normal(t));
        if (!(glm::dot(n, normal(other)) > 0.0)) return false;
        return std::all_of(other.begin(), other.end(), [&](std::size_t i) {
            const glm::dvec3 d = points[i] - points[t[0]];
            return std::abs(glm::dot(n, d)) <= kFlat * glm::length(d);
        });
    }
};

/// Groups that grow together.
struct Groups {
    std::vector<std::size_t> parent;

    explicit Groups(std::size_t count) : parent(count) {
        std::iota(parent.begin(), parent.end(), std::size_t(0));
    }
    std::size_t find(std::size_t i) {
        while (parent[i] != i)
            i = parent[i] = parent[parent[i]];
        return i;
    }
    /// The first member names the group.
    void join(std::size_t a, std::size_t b) {
        const std::size_t x = find(a), y = find(b);
        parent[std::max(x, y)] = std::min(x, y);
    }
};

/// Which triangle has an edge in this direction; none where several do.
std::map<Edge, std::optional<std::size_t>> edgesOf(const Welded& mesh) {
    std::map<Edge, std::optional<std::size_t>> edges;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (std::size_t c = 0; c < 3; ++c) {
            const Edge edge{mesh.triangles[t][c], mesh.triangles[t][(c + 1) % 3]};
            const auto [at, isNew] = edges.try_emplace(edge, t);
            if (!isNew) at->second = std::nullopt;
        }
    return edges;
}

/// The corners around a group of triangles, without those in line; empty if it has a
/// hole or touches itself.
std::vector<glm::dvec3> outlineOf(const Welded& mesh,
                                  const std::vector<std::size_t>& group) {
    std::map<Edge, int> inside;
    for (const std::size_t t : group)
        for (std::size_t c = 0; c < 3; ++c)
            ++inside[{mesh.triangles[t][c], mesh.triangles[t][(c + 1) % 3]}];
    std::map<std::size_t, std::size_t> next;
    for (const auto& [edge, count] : inside) {
        if (inside.count({edge.second, edge.first})) continue;
        if (count > 1 || !next.emplace(edge.first, edge.second).second) return {};
    }
    if (next.empty()) return {};
    std::vector<std::size_t> loop;
    std::size_t at = next.begin()->first;
    do {
        loop.push_back(at);
        const auto found = next.find(at);
        if (found == next.end() || loop.size() > next.size()) return {};
        at = found->second;
    } while (at != loop.front());
    if (loop.size() != next.size()) return {};

    std::vector<glm::dvec3> corners;
    for (std::size_t i = 0; i < loop.size(); ++i) {
        const glm::dvec3 before = mesh.points[loop[(i + loop.size() - 1) % loop.size()]],
                         here = mesh.points[loop[i]],
                         after = mesh.points[loop[(i + 1) % loop.size()]];
        const glm::dvec3 in = here - before, out = after - here;
        if (glm::length(glm::cross(in, out)) > kFlat * glm::length(in) * glm::length(out))
            corners.push_back(here);
    }
    return corners;
}

/// Nothing if the corners are not one flat face.
std::optional<RadianceReceiver> faceOf(const std::vector<glm::dvec3>& corners) {
    if (corners.size() == 3) return triangleReceiver(corners[0], corners[1], corners[2]);
    if (corners.size() == 4) {
        const glm::dvec3 x = corners[1] - corners[0], y = corners[3] - corners[0];
        if (glm::length(corners[0] + x + y - corners[2]) <=
            kFlat * (glm::length(x) + glm::length(y)))
            return parallelogramReceiver({corners[0], x, y});
    }
    auto polygon = polygonReceiver(corners);
    if (!polygon) return std::nullopt;
    return std::move(*polygon);
}

}  // namespace

std::vector<RadianceReceiver> meshReceivers(const MeshView& view) {
    const Welded mesh(view);
    const auto edges = edgesOf(mesh);
    Groups groups(mesh.triangles.size());
    for (const auto& [edge, triangle] : edges) {
        const auto back = edges.find({edge.second, edge.first});
        if (!triangle || back == edges.end() || !back->second) continue;
        if (mesh.coplanar(mesh.triangles[*triangle], mesh.triangles[*back->second]))
            groups.join(*triangle, *back->second);
    }
    std::map<std::size_t, std::vector<std::size_t>> members;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        members[groups.find(t)].push_back(t);
    std::vector<RadianceReceiver> receivers;
    for (const auto& [first, group] : members) {
        if (auto face = faceOf(outlineOf(mesh, group))) {
            receivers.push_back(std::move(*face));
            continue;
        }
        for (const std::size_t t : group) {
            const auto& [a, b, c] = mesh.triangles[t];
            receivers.push_back(
                triangleReceiver(mesh.points[a], mesh.points[b], mesh.points[c]));
        }
    }
    return receivers;
}

}  // namespace mtsm::baseline
