// Distances to meshes: OpenVDB's, in grids of several sizes of voxels (distance_field.h).
#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <limits>
#include <numeric>
#include <utility>

#include "base/finite.h"
#include "base/message.h"
#include "base/parallel.h"
#include "baseline/distance_field.h"

namespace mtsm::baseline {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Voxels that a narrow grid has on each side of the surface: OpenVDB's time goes with
// them. A cell whose corners are all there reaches sqrt(3) less; from there on, 2.1
// voxels of the next grid, that one is good enough: within an eighth of its voxel (h^2 /
// 4 d, twice the second difference of a distance d).
constexpr float kBand = 6.0f;
constexpr float kTrusted = kBand - 1.75f;
constexpr double kCoarser = 2.0;  // a voxel's side in the next grid
constexpr double kCoarsest = 16;  // most voxels of the last grid along the longest side

/// Triangles of one kind, relative to the field's origin.
struct Soup {
    std::vector<glm::vec3> positions;
    std::vector<std::uint32_t> indices;

    void append(const Soup& other) {
        const auto shift = std::uint32_t(positions.size());
        positions.insert(positions.end(), other.positions.begin(), other.positions.end());
        for (const std::uint32_t i : other.indices)
            indices.push_back(shift + i);
    }
};

/// For every corner the first one at the same place.
std::vector<std::uint32_t> welded(const std::vector<glm::vec3>& positions) {
    std::vector<std::uint32_t> order(positions.size()), first(positions.size());
    std::iota(order.begin(), order.end(), 0u);
    const auto before = [&](glm::vec3 a, glm::vec3 b) {
        return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.z < b.z;
    };
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
        return before(positions[a], positions[b]) ||
               (positions[a] == positions[b] && a < b);
    });
    for (std::size_t i = 0; i < order.size(); ++i)
        first[order[i]] = i > 0 && positions[order[i]] == positions[order[i - 1]]
                              ? first[order[i - 1]]
                              : order[i];
    return first;
}

bool isClosed(const Soup& soup) {
    const std::vector<std::uint32_t> corner = welded(soup.positions);
    std::vector<std::pair<std::uint64_t, int>> edges;  // lower and higher end; which way
    edges.reserve(soup.indices.size());
    for (std::size_t i = 0; i < soup.indices.size(); ++i) {
        const std::size_t next = i % 3 == 2 ? i - 2 : i + 1;
        const std::uint64_t a = corner[soup.indices[i]], b = corner[soup.indices[next]];
        if (a != b)
            edges.emplace_back(std::min(a, b) << 32 | std::max(a, b), a < b ? 1 : -1);
    }
    std::sort(edges.begin(), edges.end());
    for (std::size_t i = 0; i < edges.size();) {
        int balance = 0;
        const std::uint64_t edge = edges[i].first;
        for (; i < edges.size() && edges[i].first == edge; ++i)
            balance += edges[i].second;
        if (balance != 0) return false;
    }
    return !edges.empty();
}

/// A soup in a grid's index space, as OpenVDB's converter asks for it.
struct Adapter {
    const Soup& soup;
    glm::dvec3 low;
    double spacing;

    [[nodiscard]] std::size_t polygonCount() const { return soup.indices.size() / 3; }
    [[nodiscard]] std::size_t pointCount() const { return soup.positions.size(); }
    [[nodiscard]] std::size_t vertexCount(std::size_t) const { return 3; }
    void getIndexSpacePoint(std::size_t polygon, std::size_t corner,
                            openvdb::Vec3d& at) const {
        const glm::dvec3 p =
            (glm::dvec3(soup.positions[soup.indices[3 * polygon + corner]]) - low) /
            spacing;
        at = openvdb::Vec3d(p.x, p.y, p.z);
    }
};

/// Distances at voxels, index (0, 0, 0) at `low`.
openvdb::FloatGrid::Ptr distances(const Soup& soup, glm::dvec3 low, double spacing,
                                  float band, bool closed) {
    const auto transform = openvdb::math::Transform::createLinearTransform(spacing);
    const Adapter adapter{soup, low, spacing};
    return openvdb::tools::meshToVolume<openvdb::FloatGrid>(
        adapter, *transform, band, band,
        closed ? 0 : openvdb::tools::UNSIGNED_DISTANCE_FIELD);
}

/// The eight voxels around a place in index space, weighed.
template <typename Voxel>
double trilinear(glm::dvec3 p, const Voxel& voxel) {
    const glm::dvec3 cell = glm::floor(p), f = p - cell;
    const glm::ivec3 c(cell);
    double sum = 0.0;
    for (int corner = 0; corner < 8; ++corner) {
        const glm::ivec3 o(corner & 1, corner >> 1 & 1, corner >> 2);
        const double weight =
            (o.x ? f.x : 1.0 - f.x) * (o.y ? f.y : 1.0 - f.y) * (o.z ? f.z : 1.0 - f.z);
        sum += weight * double(voxel(c + o));
    }
    return sum;
}

class SoupField final : public DistanceField {
  public:
    SoupField(const Soup& soup, bool closed, glm::dvec3 origin, glm::dvec3 low,
              glm::dvec3 high, double spacing)
        : origin_(origin),
          low_(low),
          high_(high),
          spacing_(spacing),
          thickness_(closed ? 0.0 : 0.5 * spacing) {
        const glm::dvec3 extent = high - low;
        const double longest = std::max({extent.x, extent.y, extent.z});
        for (; longest > kCoarsest * spacing; spacing *= kCoarser)
            narrow_.push_back({distances(soup, low, spacing, kBand, closed), spacing});
        fillBox(soup, closed, longest, spacing);
    }

    [[nodiscard]] double at(glm::dvec3 world) const noexcept override {
        const glm::dvec3 p = world - origin_;
        if (!base::isFinite(p)) return kInfinity;
        const glm::dvec3 box = (p - boxLow_) / boxSpacing_;
        if (!glm::all(glm::greaterThanEqual(box, glm::dvec3(0.0))) ||
            !glm::all(glm::lessThan(box, glm::dvec3(size_ - 1))))
            return glm::length(p - glm::clamp(p, low_, high_)) - thickness_;
        double distance =
            trilinear(box, [&](glm::ivec3 v) { return box_[place(v.x, v.y, v.z)]; });
        for (auto grid = narrow_.rbegin(); grid != narrow_.rend(); ++grid) {
            const double trusted = double(kTrusted) * grid->spacing;
            if (std::abs(distance) > trusted) break;
            const openvdb::FloatGrid::ConstUnsafeAccessor voxels(grid->voxels->tree());
            const double finer = trilinear((p - low_) / grid->spacing, [&](glm::ivec3 v) {
                return voxels.getValue(openvdb::Coord(v.x, v.y, v.z));
            });
            if (std::abs(finer) > trusted) break;
            distance = finer;
        }
        return distance - thickness_;
    }
    [[nodiscard]] double behind(glm::dvec3 from,
                                glm::dvec3 direction) const noexcept override {
        double end = 0.0;
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 q(corner & 1 ? high_.x : low_.x,
                               corner & 2 ? high_.y : low_.y,
                               corner & 4 ? high_.z : low_.z);
            end = std::max(end, glm::dot(q + origin_ - from, direction));
        }
        return end;
    }
    [[nodiscard]] double spacing() const noexcept override { return spacing_; }
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        std::uint64_t bytes = box_.size() * sizeof(float);
        for (const Grid& grid : narrow_)
            bytes += grid.voxels->memUsage();
        return bytes;
    }

  private:
    struct Grid {
        openvdb::FloatGrid::Ptr voxels;  // index (0, 0, 0) is at low_
        double spacing;
    };

    [[nodiscard]] std::size_t place(int x, int y, int z) const noexcept {
        return (std::size_t(z) * std::size_t(size_.y) + std::size_t(y)) *
                   std::size_t(size_.x) +
               std::size_t(x);
    }

    void fillBox(const Soup& soup, bool closed, double margin, double spacing) {
        boxSpacing_ = spacing;
        boxLow_ = low_ - margin;
        size_ = glm::ivec3(glm::ceil((high_ - low_ + 2.0 * margin) / spacing)) + 2;
        // As far as the box's corners are from the bounds, and some more from the
        // surface.
        const auto band = float(std::ceil(2.0 * margin / spacing));
        const auto grid = distances(soup, boxLow_, spacing, band, closed);
        box_.resize(place(0, 0, size_.z));
        base::parallelFor(0, size_.z, [&](int z) {
            const openvdb::FloatGrid::ConstUnsafeAccessor voxels(grid->tree());
            for (int y = 0; y < size_.y; ++y) {
                for (int x = 0; x < size_.x; ++x)
                    box_[place(x, y, z)] = voxels.getValue(openvdb::Coord(x, y, z));
            }
        });
    }

    glm::dvec3 origin_, low_, high_;  // the latter two relative to the first
    double spacing_, thickness_;
    std::vector<Grid> narrow_;  // finest first
    glm::dvec3 boxLow_{0.0};
    double boxSpacing_ = 0.0;
    glm::ivec3 size_{0};      // voxels
    std::vector<float> box_;  // [z][y][x]
};

/// All meshes, sorted into closed ones and others.
struct Soups {
    Soup closed, open;
    glm::dvec3 origin{0.0};
    bool hasOrigin = false;
    glm::dvec3 low{kInfinity}, high{-kInfinity};  // relative to origin

    Status add(const MeshView& mesh) {
        if (!(mesh.texture && mesh.uvs) && !(mesh.opacity > 0.0f)) return {};
        constexpr std::size_t most = std::numeric_limits<std::uint32_t>::max();
        const std::size_t held = std::max(closed.positions.size(), open.positions.size());
        if (mesh.vertexCount > most - held)
            return base::makeError(ErrorCode::tooLarge,
                                   "a distance field: found more than ", most,
                                   " vertices, which is the most it takes; leave some of "
                                   "the casters out");
        Soup soup;
        soup.positions.resize(mesh.vertexCount);
        std::vector<bool> fine(mesh.vertexCount);
        for (std::size_t i = 0; i < mesh.vertexCount; ++i) {
            const glm::dvec3 world =
                mesh.worldFromObject * glm::dvec4(mesh.positions[i], 1.0);
            fine[i] = base::isFinite(world);
            if (!fine[i]) continue;
            if (!hasOrigin) origin = world;
            hasOrigin = true;
            soup.positions[i] = glm::vec3(world - origin);
        }
        for (std::size_t t = 0; t < mesh.triangleCount; ++t) {
            const std::uint32_t* corner = mesh.indices + 3 * t;
            if (!fine[corner[0]] || !fine[corner[1]] || !fine[corner[2]]) continue;
            for (int c = 0; c < 3; ++c) {
                soup.indices.push_back(corner[c]);
                low = glm::min(low, glm::dvec3(soup.positions[corner[c]]));
                high = glm::max(high, glm::dvec3(soup.positions[corner[c]]));
            }
        }
        if (!soup.indices.empty()) (isClosed(soup) ? closed : open).append(soup);
        return {};
    }
};

Result<DistanceFieldPtr> makeField(CasterSource& casters, int resolution) {
    Soups soups;
    const Status read =
        casters.visit(meshesOnly([&](const MeshView& mesh) { return soups.add(mesh); }));
    if (!read) return read.error();
    const glm::dvec3 extent = soups.high - soups.low;
    const double longest = std::max({extent.x, extent.y, extent.z});
    if (!(longest > 0.0))
        return base::makeError(
            ErrorCode::unsupported,
            "a distance field needs meshes; found none among the casters (strands and "
            "volumes have no place in it)");
    const double spacing = longest / std::clamp(resolution, 8, 1024);
    std::vector<DistanceFieldPtr> parts;
    openvdb::initialize();
    for (const bool closed : {true, false}) {
        const Soup& soup = closed ? soups.closed : soups.open;
        if (soup.indices.empty()) continue;
        parts.push_back(std::make_unique<SoupField>(soup, closed, soups.origin, soups.low,
                                                    soups.high, spacing));
    }
    if (parts.size() == 1) return std::move(parts.front());
    return unionField(std::move(parts));
}

}  // namespace

Result<DistanceFieldPtr> meshField(CasterSource& casters, int resolution) {
    try {
        return makeField(casters, resolution);
    } catch (const std::exception& problem) {
        return base::makeError(ErrorCode::tooLarge, "a distance field of ", resolution,
                               " voxels along a side cannot be made: ", problem.what());
    }
}

}  // namespace mtsm::baseline
