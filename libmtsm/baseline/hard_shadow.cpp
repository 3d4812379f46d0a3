#include "baseline/hard_shadow.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <new>
#include <optional>
#include <vector>

#include "base/finite.h"
#include "base/message.h"
#include "raster/surface.h"
#include "raster/triangle.h"

namespace mtsm::baseline {
namespace {

/// What lies nearer to the apex than this share of its height does not cast.
constexpr double kNear = 1e-9;

/// A row of the matrix: across `normal`, 1 from one side of the base to the other.
glm::dvec3 scaledRow(glm::dvec3 normal, glm::dvec3 edge) {
    return normal / glm::dot(normal, edge);
}

/// Rows x and y for rays along `ew` through the base.
void setAcross(std::array<glm::dvec3, 3>& rows, const PlanarReceiver& plane,
               glm::dvec3 ew) {
    rows[0] = scaledRow(glm::cross(ew, plane.edgeY), plane.edgeX);
    rows[1] = scaledRow(glm::cross(plane.edgeX, ew), plane.edgeY);
}

struct Triangle {
    std::array<std::uint32_t, 3> corner;
    std::uint32_t mesh;
};

struct Material {
    float opacity = 1.0f;
    std::optional<OpacityTexture> texture;
};

struct StrandPoint {
    glm::dvec3 position{0.0};
    float radius = 0.0f, opacity = 1.0f;
    bool joined = false;  // to the point before
};

}  // namespace

glm::dmat4 pyramidMatrix(glm::dvec3 apex, const PlanarReceiver& plane) noexcept {
    const glm::dvec3 b = plane.corner, ew = b - apex;
    std::array<glm::dvec3, 3> rows;
    setAcross(rows, plane, ew);
    rows[2] = scaledRow(glm::cross(plane.edgeY, plane.edgeX), ew);
    const glm::dvec4 x(rows[0], -glm::dot(rows[0], b));
    const glm::dvec4 y(rows[1], -glm::dot(rows[1], b));
    const glm::dvec4 w(rows[2], -glm::dot(rows[2], apex));
    return glm::transpose(glm::dmat4(x, y, glm::dvec4(0, 0, 0, 1), w));
}

glm::dvec3 ShadowView::operator()(glm::dvec3 p) const noexcept {
    const glm::dvec3 d = p - base;
    return {glm::dot(rows[0], d), glm::dot(rows[1], d),
            glm::dot(rows[2], d) + depthAtBase};
}

std::array<HalfSpace, 6> ShadowView::sides() const noexcept {
    // x / w and y / w from 0 to 1; w is 1 throughout a prism.
    const bool pyramid = kind == ProjectionKind::perspective;
    const glm::dvec3 w = pyramid ? rows[2] : glm::dvec3(0.0);
    const auto side = [&](glm::dvec3 normal, double atBase) {
        return HalfSpace{normal, atBase - glm::dot(normal, base)};
    };
    return {side(rows[0], 0.0),
            side(w - rows[0], 1.0),
            side(rows[1], 0.0),
            side(w - rows[1], 1.0),
            side(-rows[2], far - depthAtBase),
            pyramid ? side(rows[2], depthAtBase - near) : HalfSpace{}};
}

ShadowView shadowView(const LightPoint& point, const PlanarReceiver& plane,
                      bool sun) noexcept {
    ShadowView view;
    view.origin = point.position;
    view.base = plane.corner;
    if (sun) {
        setAcross(view.rows, plane, -point.position);
        const double size = std::max(glm::length(plane.edgeX), glm::length(plane.edgeY));
        const glm::dvec3 normal = glm::cross(plane.edgeX, plane.edgeY);
        view.rows[2] = -normal / (glm::length(normal) * size);
        view.kind = ProjectionKind::orthographic;
        view.depthAtBase = 0.0;
        view.near = -std::numeric_limits<double>::max();
        view.far = -kTouching;
    } else {
        const glm::dvec3 ew = plane.corner - point.position;
        setAcross(view.rows, plane, ew);
        view.rows[2] = scaledRow(glm::cross(plane.edgeY, plane.edgeX), ew);
        view.near = kNear;
        view.far = 1.0 - kTouching;
    }
    return view;
}

struct ShadowCasters::Content {
    std::vector<glm::dvec3> vertices;  // world, in the order in which triangles use them
    std::vector<glm::vec2> uvs;        // of the vertices, or none
    std::vector<Triangle> triangles;   // in the order of their tree
    std::vector<Material> materials;   // per mesh
    ChunkTree triangleTree;
    std::vector<StrandPoint> points;      // world
    std::vector<std::uint32_t> segments;  // their second points, in their tree's order
    ChunkTree segmentTree;
    bool volumes = false;

    Status add(const MeshView& mesh);
    Status add(const StrandsView& view);
    Status add(const VolumeView& volume);
    void plantTrees();
    void sortVertices();
};

namespace {

bool hasRoom(std::size_t held, std::size_t added) {
    return added <= std::numeric_limits<std::uint32_t>::max() - held;
}

Error tooMany(const char* what) {
    return base::makeError(ErrorCode::tooLarge, "the casters have more than 2^32 ", what,
                           "; leave some of them out");
}

}  // namespace

Status ShadowCasters::Content::add(const MeshView& mesh) {
    const bool textured = mesh.texture && mesh.uvs;
    if (!textured && mesh.opacity <= 0.0f) return {};
    if (!hasRoom(vertices.size(), mesh.vertexCount)) return tooMany("vertices");
    if (!hasRoom(triangles.size(), mesh.triangleCount)) return tooMany("triangles");
    Material material;
    material.opacity = mesh.opacity;
    const auto first = std::uint32_t(vertices.size());
    if (textured && mesh.texture->translucent()) {
        material.texture = *mesh.texture;
        uvs.resize(vertices.size());
        uvs.insert(uvs.end(), mesh.uvs, mesh.uvs + mesh.vertexCount);
    } else if (textured) {
        material.opacity = 1.0f;
    }
    for (std::size_t i = 0; i < mesh.vertexCount; ++i)
        vertices.emplace_back(mesh.worldFromObject * glm::dvec4(mesh.positions[i], 1.0));
    for (std::size_t i = 0; i < mesh.triangleCount; ++i) {
        Triangle t;
        bool finite = true;
        for (std::size_t c = 0; c < 3; ++c) {
            t.corner[c] = first + mesh.indices[3 * i + c];
            finite = finite && base::isFinite(vertices[t.corner[c]]);
        }
        t.mesh = std::uint32_t(materials.size());
        if (finite) triangles.push_back(t);
    }
    materials.push_back(std::move(material));
    return {};
}

Status ShadowCasters::Content::add(const StrandsView& view) {
    if (view.strandCount == 0 || (!view.opacities && view.opacity <= 0.0f)) return {};
    if (!hasRoom(points.size(), view.begin[view.strandCount])) return tooMany("points");
    const double scale =
        0.5 * std::cbrt(std::abs(glm::determinant(glm::dmat3(view.worldFromObject))));
    for (std::size_t s = 0; s < view.strandCount; ++s) {
        bool joined = false;
        for (std::uint32_t i = view.begin[s]; i < view.begin[s + 1]; ++i) {
            StrandPoint p;
            p.position = view.worldFromObject * glm::dvec4(view.points[i], 1.0);
            p.radius = float(scale * (view.widths ? view.widths[i] : view.width));
            p.opacity = view.opacities ? view.opacities[i] : view.opacity;
            const bool usable = base::isFinite(p.position) && std::isfinite(p.radius);
            if (usable && joined && points.back().position == p.position) continue;
            p.joined = joined;
            joined = usable;
            if (!usable) continue;
            if (p.joined) segments.push_back(std::uint32_t(points.size()));
            points.push_back(p);
        }
    }
    return {};
}

Status ShadowCasters::Content::add(const VolumeView&) {
    volumes = true;
    return {};
}

namespace {

template <typename T>
void reorder(std::vector<T>& values, ChunkTree& tree) {
    std::vector<T> ordered;
    ordered.reserve(values.size());
    for (const std::uint32_t i : tree.order())
        ordered.push_back(values[i]);
    values = std::move(ordered);
    tree.forgetOrder();
}

}  // namespace

void ShadowCasters::Content::plantTrees() {
    triangleTree = ChunkTree(triangles.size(), [&](std::size_t i) {
        Box box;
        for (const std::uint32_t corner : triangles[i].corner)
            box.include(vertices[corner]);
        return box;
    });
    reorder(triangles, triangleTree);
    sortVertices();
    segmentTree = ChunkTree(segments.size(), [&](std::size_t i) {
        Box box;
        for (const std::uint32_t at : {segments[i] - 1, segments[i]}) {
            const StrandPoint& p = points[at];
            box.include(p.position - double(p.radius));
            box.include(p.position + double(p.radius));
        }
        return box;
    });
    reorder(segments, segmentTree);
}

/// So that drawing reads them one after another; those of no triangle are left out.
void ShadowCasters::Content::sortVertices() {
    constexpr std::uint32_t kUnused = 0xffffffffu;
    std::vector<std::uint32_t> place(vertices.size(), kUnused);
    std::vector<glm::dvec3> sorted;
    std::vector<glm::vec2> sortedUvs;
    for (Triangle& t : triangles) {
        for (std::uint32_t& corner : t.corner) {
            if (place[corner] == kUnused) {
                place[corner] = std::uint32_t(sorted.size());
                sorted.push_back(vertices[corner]);
                if (!uvs.empty())
                    sortedUvs.push_back(corner < uvs.size() ? uvs[corner]
                                                            : glm::vec2(0.0f));
            }
            corner = place[corner];
        }
    }
    vertices = std::move(sorted);
    uvs = std::move(sortedUvs);
}

ShadowCasters::ShadowCasters(std::unique_ptr<Content> content)
    : content_(std::move(content)) {}
ShadowCasters::ShadowCasters(ShadowCasters&&) noexcept = default;
ShadowCasters& ShadowCasters::operator=(ShadowCasters&&) noexcept = default;
ShadowCasters::~ShadowCasters() = default;

Result<ShadowCasters> ShadowCasters::build(
    CasterSource& source, const std::function<void(const std::string&)>& warn) {
    try {
        auto content = std::make_unique<Content>();
        const Status read = source.visit([&](const CasterView& caster) {
            return std::visit([&](const auto& view) { return content->add(view); },
                              caster);
        });
        if (!read) return read.error();
        if (content->volumes && warn)
            warn("volumes do not cast: a projected shadow has no depth to march through");
        content->plantTrees();
        return ShadowCasters(std::move(content));
    } catch (const std::bad_alloc&) {
        return Error{ErrorCode::tooLarge,
                     "there is not enough memory for a copy of the "
                     "casters; leave some of them out"};
    }
}

namespace {

/// One hard shadow image in the making.
template <ProjectionKind kind>
class Canvas {
  public:
    Canvas(const ShadowView& view, std::uint32_t width, std::uint32_t height,
           float* reaches)
        : projection_(projectionOf(view, width, height)),
          setup_(projection_, width, height, raster::Facing::any),
          window_{0, 0, std::int32_t(width) - 1, std::int32_t(height) - 1},
          width_(width),
          reaches_(reaches) {
        // The largest number that went into x, y and depth: the rounding of p - base.
        double largest = 0.0;
        for (const glm::dvec3& row : view.rows)
            largest = std::max(largest, glm::dot(row, row));
        origin2_ = largest * glm::dot(view.base, view.base);
    }

    [[nodiscard]] raster::Vertex vertex(glm::dvec3 seen) const noexcept {
        return setup_.vertex(seen);
    }
    void draw(const raster::Vertex (&v)[3], float opacity) {
        prepare(v);
        for (const raster::PreparedTriangle& t : prepared_)
            raster::drawTriangle<kind>(t, window_,
                                       [&](std::int32_t x, std::int32_t y, float) {
                                           at(x, y) *= 1.0f - opacity;
                                       });
    }
    void draw(const raster::Vertex (&v)[3], const OpacityTexture& texture,
              const glm::vec2 (&uv)[3]) {
        prepare(v);
        if (prepared_.empty()) return;
        raster::Surface surface;
        surface.setCoordinates(
            projection_, {v[0].light, v[1].light, v[2].light},
            raster::TriangleNormal(v[0].light, v[1].light, v[2].light, origin2_).normal,
            uv);
        for (const raster::PreparedTriangle& t : prepared_)
            raster::drawTriangle<kind>(
                t, window_, [&](std::int32_t x, std::int32_t y, float z) {
                    const auto c = surface.coordinates(kind, x, y, z, {t.dx, t.dy});
                    float a[3];
                    texture.opacity(c.uv, c.dx, c.dy, a);
                    const float mean =
                        texture.channels() == 1 ? a[0] : (a[0] + a[1] + a[2]) / 3.0f;
                    at(x, y) *= 1.0f - mean;
                });
    }

  private:
    static Projection projectionOf(const ShadowView& view, std::uint32_t width,
                                   std::uint32_t height) {
        Projection projection;
        projection.kind = kind;
        projection.scale = {width, height};
        projection.near = view.near;
        projection.far = view.far;
        return projection;
    }
    void prepare(const raster::Vertex (&v)[3]) {
        prepared_.clear();
        setup_.triangle(v[0], v[1], v[2], false, origin2_, 0, counts_, prepared_);
    }
    float& at(std::int32_t x, std::int32_t y) const noexcept {
        return reaches_[std::size_t(y) * width_ + std::size_t(x)];
    }

    const Projection projection_;
    const raster::TriangleSetup setup_;
    const raster::PixelRect window_;
    const std::uint32_t width_;
    float* const reaches_;
    double origin2_ = 0.0;
    raster::TriangleCounts counts_;
    std::vector<raster::PreparedTriangle> prepared_;
};

/// Projected corners that were used lately: along the tree's curve triangles share them.
template <ProjectionKind kind>
class Corners {
  public:
    Corners(const ShadowView& view, const Canvas<kind>& canvas,
            const std::vector<glm::dvec3>& vertices)
        : view_(view), canvas_(canvas), vertices_(vertices) {
        held_.fill(kNone);
    }
    const raster::Vertex& operator()(std::uint32_t vertex) noexcept {
        const std::size_t place = vertex % kPlaces;
        if (held_[place] != vertex) {
            held_[place] = vertex;
            corners_[place] = canvas_.vertex(view_(vertices_[vertex]));
        }
        return corners_[place];
    }

  private:
    static constexpr std::size_t kPlaces = 256;
    static constexpr std::uint32_t kNone = 0xffffffffu;
    const ShadowView& view_;
    const Canvas<kind>& canvas_;
    const std::vector<glm::dvec3>& vertices_;
    std::array<std::uint32_t, kPlaces> held_;
    std::array<raster::Vertex, kPlaces> corners_;
};

/// Half of a strand's width at point i, across it and across the light's rays: the same
/// for both segments that meet there, so that their ribbons share an edge.
glm::dvec3 ribbonSide(const std::vector<StrandPoint>& points, std::size_t i,
                      const ShadowView& view) {
    const StrandPoint& p = points[i];
    glm::dvec3 along(0.0);
    if (p.joined) along += glm::normalize(p.position - points[i - 1].position);
    if (i + 1 < points.size() && points[i + 1].joined)
        along += glm::normalize(points[i + 1].position - p.position);
    const glm::dvec3 ray =
        view.kind == ProjectionKind::perspective ? p.position - view.origin : view.origin;
    const glm::dvec3 side = glm::cross(along, ray);
    const double length = glm::length(side);
    return length > 0.0 ? side * (double(p.radius) / length) : glm::dvec3(0.0);
}

}  // namespace

template <ProjectionKind kind>
static std::uint64_t drawAll(const ShadowView& view, Canvas<kind>& canvas,
                             std::span<const HalfSpace> region,
                             const std::vector<glm::dvec3>& vertices,
                             const std::vector<glm::vec2>& uvs,
                             const std::vector<Triangle>& triangles,
                             const std::vector<Material>& materials,
                             const ChunkTree& tree) {
    std::uint64_t looked = 0;
    Corners<kind> corners(view, canvas, vertices);
    tree.visit(region, [&](std::size_t begin, std::size_t end) {
        looked += end - begin;
        for (std::size_t i = begin; i < end; ++i) {
            const Triangle& t = triangles[i];
            const Material& material = materials[t.mesh];
            const raster::Vertex v[3] = {corners(t.corner[0]), corners(t.corner[1]),
                                         corners(t.corner[2])};
            if (!material.texture) {
                canvas.draw(v, material.opacity);
                continue;
            }
            canvas.draw(v, *material.texture,
                        {uvs[t.corner[0]], uvs[t.corner[1]], uvs[t.corner[2]]});
        }
    });
    return looked;
}

template <ProjectionKind kind>
static std::uint64_t drawAll(const ShadowView& view, Canvas<kind>& canvas,
                             std::span<const HalfSpace> region,
                             const std::vector<StrandPoint>& points,
                             const std::vector<std::uint32_t>& segments,
                             const ChunkTree& tree) {
    std::uint64_t looked = 0;
    tree.visit(region, [&](std::size_t begin, std::size_t end) {
        looked += end - begin;
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t k = segments[i];
            const glm::dvec3 p = points[k - 1].position, q = points[k].position,
                             atP = ribbonSide(points, k - 1, view),
                             atQ = ribbonSide(points, k, view);
            const raster::Vertex p0 = canvas.vertex(view(p - atP)),
                                 p1 = canvas.vertex(view(p + atP)),
                                 q0 = canvas.vertex(view(q - atQ)),
                                 q1 = canvas.vertex(view(q + atQ));
            const float opacity = 0.5f * (points[k - 1].opacity + points[k].opacity);
            canvas.draw({p0, p1, q1}, opacity);
            canvas.draw({p0, q1, q0}, opacity);
        }
    });
    return looked;
}

std::uint64_t ShadowCasters::draw(const ShadowView& view, std::uint32_t width,
                                  std::uint32_t height, bool cull, float* reaches) const {
    std::fill_n(reaches, std::size_t(width) * height, 1.0f);
    const auto sides = view.sides();
    const std::span<const HalfSpace> region(sides.data(), cull ? sides.size() : 0);
    const Content& c = *content_;
    const auto drawOn = [&](auto canvas) {
        return drawAll(view, canvas, region, c.vertices, c.uvs, c.triangles, c.materials,
                       c.triangleTree) +
               drawAll(view, canvas, region, c.points, c.segments, c.segmentTree);
    };
    if (view.kind == ProjectionKind::perspective)
        return drawOn(Canvas<ProjectionKind::perspective>(view, width, height, reaches));
    return drawOn(Canvas<ProjectionKind::orthographic>(view, width, height, reaches));
}

std::uint64_t ShadowCasters::triangles() const noexcept {
    return content_->triangles.size();
}
std::uint64_t ShadowCasters::segments() const noexcept {
    return content_->segments.size();
}
Box ShadowCasters::bounds() const noexcept {
    Box all;
    if (content_->triangleTree.count()) all.include(content_->triangleTree.bounds());
    if (content_->segmentTree.count()) all.include(content_->segmentTree.bounds());
    return all;
}
std::uint64_t ShadowCasters::memoryBytes() const noexcept {
    const Content& c = *content_;
    std::uint64_t bytes =
        c.vertices.size() * sizeof(glm::dvec3) + c.uvs.size() * sizeof(glm::vec2) +
        c.triangles.size() * sizeof(Triangle) + c.points.size() * sizeof(StrandPoint) +
        c.segments.size() * sizeof(std::uint32_t) + c.triangleTree.memoryBytes() +
        c.segmentTree.memoryBytes();
    for (const Material& material : c.materials)
        if (material.texture) bytes += material.texture->memoryBytes();
    return bytes;
}

}  // namespace mtsm::baseline
