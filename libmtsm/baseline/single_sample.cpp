#include "baseline/single_sample.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec4.hpp>
#include <new>
#include <unordered_map>

#include "base/finite.h"
#include "base/message.h"
#include "base/parallel.h"
#include "baseline/methods.h"

namespace mtsm::baseline {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNearest = 1e-9;  // on a ray, of the casters' diagonal

double cross(glm::dvec2 a, glm::dvec2 b) {
    return a.x * b.y - a.y * b.x;
}

/// A triangle as the ray sees it: x and y across the ray, t along it, h above the
/// receiver's tangent plane.
struct Seen {
    std::array<glm::dvec4, 3> corners;

    Seen(const CentreRay& ray, const light::Frame& frame,
         const std::array<glm::dvec3, 3>& world) {
        for (std::size_t i = 0; i < 3; ++i) {
            const glm::dvec3 q = world[i] - ray.origin;
            corners[i] = {glm::dot(q, frame.x), glm::dot(q, frame.y),
                          glm::dot(q, ray.direction), glm::dot(q, ray.normal)};
        }
    }

    /// Does the ray meet it? Sides count, so that no ray slips through between two
    /// triangles; a triangle seen edge-on is not met.
    [[nodiscard]] bool isHit(const CentreRay& ray) const {
        const double a = cross(corners[1], corners[2]), b = cross(corners[2], corners[0]),
                     c = cross(corners[0], corners[1]);
        const bool inside =
            (a >= 0.0 && b >= 0.0 && c >= 0.0) || (a <= 0.0 && b <= 0.0 && c <= 0.0);
        const double sum = a + b + c;
        if (!inside || sum == 0.0) return false;
        const double t = (a * corners[0].z + b * corners[1].z + c * corners[2].z) / sum;
        return t >= ray.nearest && t <= ray.reach;
    }
};

/// The part of a triangle that counts, as a polygon.
struct Polygon {
    // Each of four planes adds one corner, or, where rounding bends the polygon, makes
    // at most 3 of 2.
    static constexpr std::size_t kMost = 13;
    std::array<glm::dvec4, kMost> corners;
    std::size_t count = 0;

    explicit Polygon(const Seen& seen) : count(3) {
        std::copy(seen.corners.begin(), seen.corners.end(), corners.begin());
    }

    /// Keeps what has height(corner) >= 0, a linear function.
    template <typename Height>
    void clip(const Height& height) {
        std::array<double, kMost> heights;
        bool any = false, all = true;
        for (std::size_t i = 0; i < count; ++i) {
            heights[i] = height(corners[i]);
            any |= heights[i] > 0.0;
            all &= heights[i] >= 0.0;
        }
        if (all) return;
        const Polygon from = *this;
        count = 0;
        for (std::size_t i = 0; any && i < from.count; ++i) {
            const std::size_t j = i + 1 < from.count ? i + 1 : 0;
            if (heights[i] >= 0.0) corners[count++] = from.corners[i];
            if ((heights[i] < 0.0) != (heights[j] < 0.0) && heights[i] != 0.0 &&
                heights[j] != 0.0)
                corners[count++] =
                    from.corners[i] + heights[i] / (heights[i] - heights[j]) *
                                          (from.corners[j] - from.corners[i]);
        }
    }
};

/// How the ray passes a triangle.
struct Passing {
    double slope = kInfinity;  // tan phi; 0: it hits
    glm::dvec2 nearest{0.0};   // of the triangle's image at distance 1
};

/// How the ray passes a side. Of what begins close to the receiver one end is very far
/// off, so the distance of a line is not taken from a point on it.
Passing passSide(glm::dvec2 a, glm::dvec2 b) {
    const glm::dvec2 ab = b - a;
    const double squared = glm::dot(ab, ab);
    const double u = squared > 0.0 ? -glm::dot(a, ab) / squared : 0.0;
    if (u <= 0.0) return {glm::length(a), a};
    if (u >= 1.0) return {glm::length(b), b};
    return {std::abs(cross(a, b)) / std::sqrt(squared), a + u * ab};
}

Passing pass(const CentreRay& ray, const light::Frame& frame,
             const std::array<glm::dvec3, 3>& corners) {
    const Seen seen(ray, frame, corners);
    if (seen.isHit(ray)) return {0.0, glm::dvec2(0.0)};
    Passing passing;
    if (!(ray.growth > 0.0)) return passing;
    Polygon polygon(seen);
    polygon.clip([&](const glm::dvec4& q) { return q.z - ray.nearest; });
    if (ray.reach < kInfinity)
        polygon.clip([&](const glm::dvec4& q) { return ray.reach - q.z; });
    if (ray.normal != glm::dvec3(0.0))
        polygon.clip([&](const glm::dvec4& q) { return q.w; });
    if (ray.shines != glm::dvec3(0.0)) {
        const glm::dvec3 n(glm::dot(ray.shines, frame.x), glm::dot(ray.shines, frame.y),
                           glm::dot(ray.shines, ray.direction));
        polygon.clip([&](const glm::dvec4& q) {
            return n.x * q.x + n.y * q.y + n.z * (q.z - ray.lightAt);
        });
    }
    // The ray is outside of what is left, so one of the sides is nearest.
    glm::dvec2 before(0.0);
    for (std::size_t i = 0; i <= polygon.count && polygon.count > 0; ++i) {
        const glm::dvec4& q = polygon.corners[i < polygon.count ? i : 0];
        const glm::dvec2 image = glm::dvec2(q) / q.z;
        if (i > 0) {
            const Passing side = passSide(before, image);
            if (side.slope < passing.slope) passing = side;
        }
        before = image;
    }
    return passing;
}

double tauOf(double slope, double growth) {
    return slope > 0.0 ? slope / growth : 0.0;
}

/// D, or D / A for a sun.
double diameterOf(const AreaLight& light) {
    if (light.shape == LightShape::rect)
        return 2.0 * std::sqrt(light.size.x * light.size.y / glm::pi<double>());
    return 2.0 * lightRadius(light);
}

}  // namespace

double penumbra(double tau) noexcept {
    if (!(tau > 0.0)) return 0.0;
    return tau < 1.0 ? tau * tau * (3.0 - 2.0 * tau) : 1.0;
}

double tauOfSphere(const CentreRay& ray, glm::dvec3 centre, double radius) noexcept {
    const glm::dvec3 c = centre - ray.origin;
    const double t = glm::dot(c, ray.direction);
    if (t < 0.0 || t > ray.reach) return kInfinity;
    if (ray.shines != glm::dvec3(0.0) &&
        glm::dot(ray.shines, c - ray.lightAt * ray.direction) < 0.0)
        return kInfinity;
    const double d = glm::length(c - t * ray.direction);
    return d <= radius ? 0.0 : (d - radius) / (t * ray.growth);
}

double tauOfTriangle(const CentreRay& ray,
                     const std::array<glm::dvec3, 3>& corners) noexcept {
    return tauOf(pass(ray, light::makeFrame(ray.direction), corners).slope, ray.growth);
}

/// One ray's way through a scene, relative to its origin.
struct SingleSampleScene::Search {
    const SingleSampleScene& scene;
    const SingleSampleOptions& options;
    const CentreRay ray;
    const light::Frame frame = light::makeFrame(ray.direction);
    WideRay wide;
    double limit = 1.0;    // what has a larger tau does not matter
    double visible = 1.0;  // s
    std::unordered_map<std::uint32_t, double> meshes;  // s of each that was met
    std::uint64_t nodes = 0, objects = 0;

    Search(const SingleSampleScene& s, const SingleSampleOptions& o, const CentreRay& r,
           double margin, float size)
        : scene(s),
          options(o),
          ray(r),
          wide(ray.origin, ray.direction, ray.reach, margin > 0.0 ? 0.0 : ray.growth,
               margin, size) {}

    [[nodiscard]] double visibleAt(double tau, double opacity) const {
        return 1.0 - opacity * (1.0 - penumbra(tau));
    }

    /// Of an object that left `before` of the light and now leaves `s`.
    void compose(double before, double s) {
        if (options.compose == Compose::minimum)
            visible = std::min(visible, s);
        else if (options.compose == Compose::multiply)
            visible *= s / before;
        else
            visible -= before - s;
    }

    /// What has a larger tau than an opaque object does not matter any more.
    void narrow(double tau) {
        limit = tau;
        if (options.bounds == GrownBounds::cone) wide.narrow(limit * ray.growth);
    }

    /// A triangle of a mesh: only the darkest of each mesh counts. False: it is dark
    /// already.
    bool takeTriangle(std::uint32_t mesh, double tau, double opacity) {
        const double s = visibleAt(tau, opacity);
        if (options.compose == Compose::minimum) {
            visible = std::min(visible, s);
            if (opacity >= 1.0 && tau < limit) narrow(tau);
            return visible > 0.0;
        }
        double& before = meshes.try_emplace(mesh, 1.0).first->second;
        if (s < before) {
            compose(before, s);
            before = s;
        }
        return visible > 0.0;
    }
    bool takeSphere(double tau, double opacity) {
        compose(1.0, visibleAt(tau, opacity));
        if (options.compose == Compose::minimum && opacity >= 1.0 && tau < limit)
            narrow(tau);
        return visible > 0.0;
    }

    [[nodiscard]] double opacityAt(std::size_t index,
                                   const std::array<glm::dvec3, 3>& corners,
                                   glm::dvec2 image) const {
        const Triangle& triangle = scene.triangles_[index];
        const Material& material = scene.materials_[triangle.material];
        if (!material.texture) return material.opacity;
        // The point of the triangle that is seen at `image`, and how wide b is there.
        const glm::dvec3 ab = corners[1] - corners[0], ac = corners[2] - corners[0],
                         towards = ray.direction + image.x * frame.x + image.y * frame.y,
                         from = ray.origin - corners[0];
        const glm::dvec3 p = glm::cross(towards, ac), q = glm::cross(from, ab);
        const double det = glm::dot(ab, p);
        glm::dvec2 at(0.5, 0.0);
        double way = 0.0;
        if (det != 0.0) {
            at.x = std::clamp(glm::dot(from, p) / det, 0.0, 1.0);
            at.y = std::clamp(glm::dot(towards, q) / det, 0.0, 1.0 - at.x);
            way = std::max(0.0, glm::dot(ac, q) / det);
        }
        const auto& uv = scene.uvs_[index];
        const glm::dvec2 u = uv[0], uab = glm::dvec2(uv[1]) - u,
                         uac = glm::dvec2(uv[2]) - u;
        const double area = glm::length(glm::cross(ab, ac));
        const double scale =
            area > 0.0 ? std::sqrt(std::abs(cross(uab, uac)) / area) : 0.0;
        const double side = way * ray.growth * scale;
        float channels[3];
        material.texture->opacity(u + at.x * uab + at.y * uac, {side, 0.0}, {0.0, side},
                                  channels);
        if (material.texture->channels() == 1) return channels[0];
        return (double(channels[0]) + channels[1] + channels[2]) / 3.0;
    }

    bool visitTriangles(std::size_t begin, std::size_t end) {
        objects += end - begin;
        for (std::size_t i = begin; i < end; ++i) {
            const auto& c = scene.triangles_[i].corners;
            const std::array<glm::dvec3, 3> corners{glm::dvec3(c[0]), glm::dvec3(c[1]),
                                                    glm::dvec3(c[2])};
            const Passing passing = pass(ray, frame, corners);
            const double tau = tauOf(passing.slope, ray.growth);
            if (!(tau < limit)) continue;
            if (!takeTriangle(scene.triangles_[i].material, tau,
                              opacityAt(i, corners, passing.nearest)))
                return false;
        }
        return true;
    }

    bool visitSpheres(std::size_t begin, std::size_t end) {
        objects += end - begin;
        for (std::size_t i = begin; i < end; ++i) {
            const SoftSphere& sphere = scene.spheres_[i];
            const double tau = tauOfSphere(ray, sphere.centre, sphere.radius);
            if (tau < limit && !takeSphere(tau, sphere.opacity)) return false;
        }
        return true;
    }

    double run() {
        const bool narrows = options.compose == Compose::minimum && ray.growth > 0.0 &&
                             options.bounds == GrownBounds::cone;
        nodes = scene.sphereTree_.search(
            wide, narrows,
            [&](std::size_t begin, std::size_t end) { return visitSpheres(begin, end); });
        if (visible > 0.0)
            nodes += scene.triangleTree_.search(wide, narrows,
                                                [&](std::size_t begin, std::size_t end) {
                                                    return visitTriangles(begin, end);
                                                });
        return std::clamp(visible, 0.0, 1.0);
    }
};

void SingleSampleScene::place(glm::dvec3 world) {
    if (!hasOrigin_) origin_ = world;
    hasOrigin_ = true;
    low_ = glm::min(low_, world);
    high_ = glm::max(high_, world);
}

Status SingleSampleScene::add(const MeshView& mesh) {
    const bool textured = mesh.texture && mesh.uvs;
    if (!textured && !(mesh.opacity > 0.0f)) return {};
    constexpr std::size_t most = std::numeric_limits<std::uint32_t>::max();
    if (mesh.triangleCount > most - triangles_.size())
        return base::makeError(ErrorCode::tooLarge, "single-sample: found more than ",
                               most, " triangles, which is the most it holds");
    Material material;
    material.opacity = mesh.opacity;
    if (textured && mesh.texture->translucent())
        material.texture = *mesh.texture;
    else if (textured)
        material.opacity = 1.0f;
    if (material.texture) uvs_.resize(triangles_.size());
    for (std::size_t t = 0; t < mesh.triangleCount; ++t) {
        const std::uint32_t* index = mesh.indices + 3 * t;
        std::array<glm::dvec3, 3> world;
        bool finite = true;
        for (std::size_t c = 0; c < 3; ++c) {
            world[c] = mesh.worldFromObject * glm::dvec4(mesh.positions[index[c]], 1.0);
            finite &= base::isFinite(world[c]);
        }
        if (!finite) continue;
        Triangle triangle{{}, std::uint32_t(materials_.size())};
        for (std::size_t c = 0; c < 3; ++c) {
            place(world[c]);
            triangle.corners[c] = glm::vec3(world[c] - origin_);
        }
        triangles_.push_back(triangle);
        if (material.texture)
            uvs_.push_back({mesh.uvs[index[0]], mesh.uvs[index[1]], mesh.uvs[index[2]]});
    }
    materials_.push_back(std::move(material));
    return {};
}

void SingleSampleScene::add(const SoftSphere& sphere) {
    if (!base::isFinite(sphere.centre) || !(sphere.radius > 0.0) ||
        !std::isfinite(sphere.radius) || !(sphere.opacity > 0.0f))
        return;
    place(sphere.centre - sphere.radius);
    place(sphere.centre + sphere.radius);
    spheres_.push_back(sphere);
    spheres_.back().centre -= origin_;
}

namespace {

/// Brings each item to its place in the order without a copy of them all. The order
/// serves several lists.
template <typename Item>
void arrange(std::vector<Item>& items, std::vector<std::uint32_t> order) {
    for (std::uint32_t i = 0; i < order.size(); ++i) {
        // Along the cycle that i is in; its places are marked as done.
        Item first = std::move(items[i]);
        std::uint32_t to = i;
        for (std::uint32_t from = order[to]; from != i; from = order[to]) {
            items[to] = std::move(items[from]);
            order[to] = to;
            to = from;
        }
        items[to] = std::move(first);
        order[to] = to;
    }
}

}  // namespace

/// Builds the trees and brings all objects into their order.
void SingleSampleScene::plant() {
    if (!uvs_.empty()) uvs_.resize(triangles_.size());
    std::vector<GrownBox> boxes(triangles_.size());
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        for (const glm::vec3& corner : triangles_[i].corners)
            boxes[i].add(corner);
    }
    triangleTree_ = GrownTree(boxes);
    boxes = std::vector<GrownBox>(spheres_.size());
    std::vector<std::uint32_t> order = triangleTree_.takeOrder();
    if (!uvs_.empty()) arrange(uvs_, order);
    arrange(triangles_, std::move(order));

    for (std::size_t i = 0; i < boxes.size(); ++i) {
        // To float and outwards: 1e-7 is more than half of a float's last place.
        const glm::dvec3 c = spheres_[i].centre, r(spheres_[i].radius);
        const double more =
            1e-7 * (std::max({std::abs(c.x), std::abs(c.y), std::abs(c.z)}) + r.x);
        boxes[i].add(glm::vec3(c - r - more));
        boxes[i].add(glm::vec3(c + r + more));
    }
    sphereTree_ = GrownTree(boxes);
    arrange(spheres_, sphereTree_.takeOrder());
}

Result<SingleSampleScene> SingleSampleScene::build(
    CasterSource& casters, const std::vector<SoftSphere>& spheres) {
    try {
        SingleSampleScene scene;
        const Status read = casters.visit(
            meshesOnly([&](const MeshView& mesh) { return scene.add(mesh); }));
        if (!read) return read.error();
        for (const SoftSphere& sphere : spheres)
            scene.add(sphere);
        if (scene.triangles_.empty() && scene.spheres_.empty())
            return base::makeError(
                ErrorCode::unsupported,
                "single-sample casts shadows of meshes and spheres; found none among the "
                "casters (it casts neither strands nor volumes)");
        scene.plant();
        return scene;
    } catch (const std::bad_alloc&) {
        return Error{ErrorCode::tooLarge,
                     "single-sample: there is not enough memory for a copy of the "
                     "casters; leave some of them out"};
    }
}

std::uint64_t SingleSampleScene::memoryBytes() const noexcept {
    std::uint64_t bytes = triangles_.size() * sizeof(Triangle) +
                          uvs_.size() * sizeof(Corners) +
                          spheres_.size() * sizeof(SoftSphere) +
                          triangleTree_.memoryBytes() + sphereTree_.memoryBytes();
    for (const Material& material : materials_)
        bytes +=
            sizeof(Material) + (material.texture ? material.texture->memoryBytes() : 0);
    return bytes;
}

/// Nothing where no ray is needed: all casters are behind it.
std::optional<CentreRay> SingleSampleScene::centreRay(
    const light::LightSampler& sampler, double diameter, glm::dvec3 point,
    glm::dvec3 normal, const SingleSampleOptions& options) const noexcept {
    CentreRay ray;
    const glm::dvec3 towards = sampler.towards(point);
    const double way = glm::length(towards);
    if (!(way > 0.0)) return std::nullopt;
    ray.nearest = kNearest * glm::length(high_ - low_);
    // Along each axis floats resolve a share of the largest coordinate.
    const glm::dvec3 out = normal != glm::dvec3(0.0) ? normal : towards / way,
                     far = glm::max(glm::abs(low_ - origin_), glm::abs(high_ - origin_));
    const double offset =
        options.offset > 0.0 ? options.offset * glm::dot(glm::abs(out), far) + ray.nearest
                             : 0.0;
    ray.normal = normal;
    ray.origin = point + offset * out - origin_;
    // Where the casters end along the ray.
    const glm::dvec3 lit = sampler.shape() == LightShape::sun
                               ? towards
                               : sampler.towards(ray.origin + origin_);
    const double reach = glm::length(lit);
    if (!(reach > 0.0)) return std::nullopt;
    ray.direction = lit / reach;
    double end = -kInfinity;
    for (int corner = 0; corner < 8; ++corner) {
        const glm::dvec3 q(corner & 1 ? high_.x : low_.x, corner & 2 ? high_.y : low_.y,
                           corner & 4 ? high_.z : low_.z);
        end = std::max(end, glm::dot(q - origin_ - ray.origin, ray.direction));
    }
    if (!(end > 0.0)) return std::nullopt;
    const bool sun = sampler.shape() == LightShape::sun;
    ray.reach = std::min(sun ? kInfinity : reach, end * (1.0 + 1e-9));
    ray.shines = sampler.shines();
    ray.lightAt = reach;
    if (!options.hard) ray.growth = sun ? diameter : diameter / reach;
    return ray;
}

float SingleSampleScene::shadow(const light::LightSampler& sampler, double diameter,
                                glm::dvec3 point, glm::dvec3 normal,
                                const SingleSampleOptions& options,
                                SingleSampleWork* work) const noexcept {
    if (!base::isFinite(point) || sampler.isBehind(point)) return 0.0f;
    const double length = glm::length(normal);
    normal = length > 0.0 ? normal / length : glm::dvec3(0.0);
    if (length > 0.0 && !(glm::dot(sampler.towards(point), normal) > 0.0)) return 1.0f;
    const auto ray = centreRay(sampler, diameter, point, normal, options);
    if (!ray) return 0.0f;
    const double margin =
        options.bounds == GrownBounds::largest ? ray->growth * ray->reach : 0.0;
    const glm::dvec3 far = glm::max(glm::abs(low_ - origin_), glm::abs(high_ - origin_));
    Search search(*this, options, *ray, margin, float(std::max({far.x, far.y, far.z})));
    const double visible = search.run();
    if (work) {
        work->rays += 1;
        work->nodes += search.nodes;
        work->objects += search.objects;
    }
    return float(1.0 - visible);
}

void SingleSampleScene::shadowFactors(const AreaLight& light, const glm::dvec3* points,
                                      const glm::dvec3* normals, std::size_t count,
                                      float* out, const SingleSampleOptions& options,
                                      SingleSampleWork* work) const noexcept {
    const light::LightSampler sampler(light);
    const double diameter = diameterOf(light);
    base::parallelRanges(
        std::size_t(0), count, std::size_t(256), [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                out[i] = shadow(sampler, diameter, points[i],
                                normals ? normals[i] : glm::dvec3(0.0), options, work);
        });
}

namespace {

class SingleSampleMethod final : public Method {
  public:
    explicit SingleSampleMethod(SingleSampleScene scene) : scene_(std::move(scene)) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return scene_.memoryBytes();
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        SingleSampleOptions options;
        const std::string& compose = settings.word("compose");
        options.compose = compose == "add"        ? Compose::add
                          : compose == "multiply" ? Compose::multiply
                                                  : Compose::minimum;
        options.bounds = settings.word("bounds") == "largest" ? GrownBounds::largest
                                                              : GrownBounds::cone;
        options.hard = settings.flag("hard");
        scene_.shadowFactors(light, at.points, at.normals, at.count, out, options);
        return {};
    }

  private:
    SingleSampleScene scene_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene, const Settings&) {
    auto built = SingleSampleScene::build(scene.casters);
    if (!built) return built.error();
    return std::unique_ptr<Method>(new SingleSampleMethod(std::move(*built)));
}

}  // namespace

MethodInfo singleSampleMethod() {
    MethodInfo info;
    info.name = "single-sample";
    info.title = "single sample soft shadows of spheres and meshes";
    info.source = "[Parker98]";
    info.strands = info.volumes = false;
    info.perLight = false;
    info.settings = {
        wordSetting("compose", {"minimum", "multiply", "add"},
                    "how the shadows of several objects come together"),
        wordSetting("bounds", {"cone", "largest"},
                    "how the tree finds grown objects: by their distance, or all grown "
                    "by the light's diameter"),
        flagSetting("hard", false, "plain hard shadows from the light's centre"),
    };
    // Without a light's width nothing grows.
    info.settings[1].with = "hard=false";
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
