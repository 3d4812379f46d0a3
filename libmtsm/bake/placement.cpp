#include "bake/placement.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <limits>

#include "base/finite.h"
#include "base/message.h"
#include "light/sample.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {
namespace {

using base::concat;
using base::makeError;

/// Below, push-back takes the light so far away that float depths no longer tell layers
/// apart.
constexpr double kLeastFov = 0.01 / 180.0 * glm::pi<double>();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

template <typename... Parts>
Error invalid(const Parts&... parts) {
    return makeError(ErrorCode::badArgument, parts...);
}

std::string text(glm::dvec3 p) {
    return concat("(", p.x, ", ", p.y, ", ", p.z, ")");
}

double degrees(double radians) {
    return radians * (180.0 / glm::pi<double>());
}

/// Depth up to which nothing casts because it is inside the light.
double lightEnds(const BakeOptions& options) {
    if (options.light.shape != LightShape::sphere) return 0.0;
    return options.light.radius / (options.cube ? std::sqrt(3.0) : 1.0);
}

Status checkDepths(const BakeOptions& options) {
    const double near = options.near.value_or(lightEnds(options));
    const double far = options.far.value_or(kInfinity);
    if (!(near >= 0.0 && std::isfinite(near)))
        return invalid("--near ", near,
                       " must be finite and not negative: it is measured "
                       "from the light's plane (a sun: from the nearest caster)");
    if (!(far > near))
        return invalid("--far ", far, " must be larger than --near, which is ", near,
                       options.near ? "" : " when not given");
    return {};
}

// --- axes
// ----------------------------------------------------------------------------------

/// Unit vector; v has a length.
glm::dvec3 unit(glm::dvec3 v) {
    return glm::normalize(v / std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}));
}

/// Makes `p` look along `forward` with `up` up; if that is no direction across the view,
/// with the world axis up that is furthest from it.
void orient(Projection& p, glm::dvec3 forward, glm::dvec3 up) {
    const double size = std::max({std::abs(up.x), std::abs(up.y), std::abs(up.z)});
    glm::dvec3 right = size > 0.0 ? glm::cross(forward, unit(up)) : glm::dvec3(0.0);
    if (glm::length(right) < 1e-6) {
        const glm::dvec3 along(std::abs(forward.x), std::abs(forward.y),
                               std::abs(forward.z));
        const bool y = along.y <= along.x && along.y <= along.z;
        const bool z = !y && along.z <= along.x;
        right = glm::cross(forward, glm::dvec3(!y && !z, y, z));
    }
    p.forward = forward;
    p.right = glm::normalize(right);
    p.up = glm::cross(p.right, forward);
}

// --- windows
// -------------------------------------------------------------------------------

/// Fits the raster to a rectangle of Extent::window, with three quarters of a pixel to
/// spare on each side.
void fitWindow(Projection& p, const Extent& casters, glm::dvec2 pixels) {
    const glm::dvec2 margin = glm::min(glm::dvec2(0.75), 0.125 * pixels);
    glm::dvec2 pixel = (casters.windowMax - casters.windowMin) / (pixels - 2.0 * margin);
    const double largest = std::max({pixel.x, pixel.y, 1e-100});
    pixel = glm::max(pixel, glm::dvec2(largest / kMaxPixelAspect));
    p.scale = glm::dvec2(1.0, -1.0) / pixel;
    p.offset = 0.5 * pixels - p.scale * (0.5 * (casters.windowMin + casters.windowMax));
}

/// A square window of `fov` across the larger side, the axis in its centre.
void centreWindow(Projection& p, double fov, glm::dvec2 pixels) {
    const double scale = 0.5 * std::max(pixels.x, pixels.y) / std::tan(0.5 * fov);
    p.scale = {scale, -scale};
    p.offset = 0.5 * pixels;
}

/// [Xie07, eq. 4]: the frustum of the light's centre, moved back until it holds the
/// light. Its narrower side decides, and a sphere has to fit between its sides, not just
/// at its middle.
double pushBackFor(const AreaLight& light, double fov, glm::dvec2 pixels) {
    const double tangent =
        std::tan(0.5 * fov) * std::min(pixels.x, pixels.y) / std::max(pixels.x, pixels.y);
    const bool sphere = light.shape == LightShape::sphere;
    return lightRadius(light) / (sphere ? std::sin(std::atan(tangent)) : tangent);
}

/// [Xie07, eq. 4], kept where a float depth resolves a quarter of the footprint that a
/// pixel has at the furthest caster, or no further than that caster is from the light.
double fittedPushBack(double radius, double tangent, double furthest, double pixels) {
    const double footprint = 2.0 * tangent * furthest / pixels;
    const double resolved = 0.25 * footprint * 0x1p23 - furthest;
    return std::min(radius / tangent, std::max(resolved, furthest));
}

// --- what cannot be
// ------------------------------------------------------------------------

BakeReport report(const Extent& e) {
    BakeReport r;
    r.meshes = e.meshes;
    r.triangles = e.triangles;
    r.nonFinite = e.nonFinite;
    r.degenerate = e.degenerate;
    r.transparent = e.transparent;
    r.outside = e.outside;
    return r;
}

void setSizes(const Extent& casters, Placement& placed) {
    placed.triangles = casters.triangles;
    if (!(casters.segmentLength > 0.0)) return;
    placed.segmentLength = casters.segmentLength / double(casters.segments);
    placed.strandWidth = casters.segmentArea / casters.segmentLength;
}

Error allBehind(const BakeOptions& options) {
    if (options.near || options.far)
        return invalid("no caster lies between --near and --far, ",
                       options.near.value_or(0.0), " to ",
                       options.far.value_or(kInfinity), " in front of the light");
    return invalid("every caster lies behind the light at ", text(options.light.position),
                   " as it is aimed: move it, or turn it with --light-target or "
                   "--light-direction");
}

Status checkAngle(double tangent) {
    if (std::atan(tangent) <= kMaxHalfAngle) return {};
    return invalid(
        "the casters reach ", degrees(std::atan(tangent)),
        " degrees off the light's axis, and a fitted window can hold ",
        degrees(kMaxHalfAngle),
        ": give a field of view with --fov, bake six views with --projection cube, cut "
        "them off with --near, move the light, or --exclude the casters beside it");
}

Status checkOutside(glm::dvec3 p, const Extent& bounds) {
    for (int i = 0; i < 3; ++i) {
        if (!(p[i] >= bounds.min[i] && p[i] <= bounds.max[i])) return {};
    }
    return invalid("the light at ", text(p), " is inside the casters' bounds, ",
                   text(bounds.min), " to ", text(bounds.max),
                   ": bake six views with --projection cube, move it, --exclude the "
                   "casters around it, or give a field of view with --fov");
}

/// A light that shines to all sides must see all casters ahead of it, or they would be
/// cut off unasked. (What lies behind a one-sided light casts nothing.)
Status checkAround(const Extent& seen, const BakeOptions& options) {
    const LightShape shape = options.light.shape;
    if (options.near || seen.cut == 0 ||
        (shape != LightShape::point && shape != LightShape::sphere))
        return {};
    return invalid(seen.cut, " triangles of the casters lie beside or behind the ",
                   name(shape), " light at ", text(options.light.position),
                   ": bake six views with --projection cube, move it away from them, "
                   "--exclude them, "
                   "cut them off with --near, or give a field of view with --fov");
}

// --- finite lights and suns
// ----------------------------------------------------------------

glm::dvec2 pixelsOf(const BakeOptions& options) {
    return {options.width, options.height};
}

Result<glm::dvec3> viewDirection(const BakeOptions& options, const Extent& bounds) {
    const AreaLight& light = options.light;
    if (options.aimed || light.shape == LightShape::sun) return unit(light.direction);
    const glm::dvec3 at =
        options.target ? *options.target : 0.5 * (bounds.min + bounds.max);
    const glm::dvec3 to = at - light.position;
    if (!(glm::dot(to, to) > 0.0))
        return invalid("the light at ", text(light.position), " stands where it should ",
                       "look at (",
                       options.target ? "--light-target" : "the casters' centre",
                       "): give another --light-target or a --light-direction");
    return unit(to);
}

/// Distance from p to the far end of a box, or a little more.
double farEnd(glm::dvec3 p, const Extent& bounds) {
    return glm::length(0.5 * (bounds.min + bounds.max) - p) +
           0.5 * glm::length(bounds.max - bounds.min);
}

/// Depths in front of this count as at the light.
double nearest(glm::dvec3 light, const Extent& bounds) {
    if (bounds.empty()) return raster::kSmallestDepth;
    return std::max(1e-6 * farEnd(light, bounds), raster::kSmallestDepth);
}

/// Turns a light that has a front.
void aim(AreaLight& light, glm::dvec3 forward) {
    if (light.shape != LightShape::disk && light.shape != LightShape::rect) return;
    light.direction = forward;
    if (light.shape != LightShape::rect) return;
    Projection p;
    orient(p, forward, light.up);
    light.up = p.up;
}

Result<Placement> placeFinite(Visits& visits, const BakeOptions& options) {
    Placement placed;
    AreaLight& light = placed.light = options.light;
    Projection& p = placed.projections.emplace_back();
    const double radius = lightRadius(light);
    const double ahead = options.near.value_or(lightEnds(options));
    const double reach = options.far.value_or(kInfinity);

    Extent bounds;
    const bool aimed = options.aimed || options.target;
    if (!options.fov || !aimed || radius + ahead == 0.0) {
        auto measured = measure(visits, worldFrame(), -kInfinity, kInfinity);
        if (!measured) return measured.error();
        bounds = *measured;
        setSizes(bounds, placed);
        if (bounds.empty()) return nothingCasts(report(bounds));
        if (!options.fov) {
            if (auto s = checkOutside(light.position, bounds); !s) return s.error();
        }
    }
    auto forward = viewDirection(options, bounds);
    if (!forward) return forward.error();
    aim(light, *forward);
    orient(p, *forward, light.shape == LightShape::rect ? light.up : options.up);

    const double atLight = nearest(light.position, bounds);
    double pushBack = 0.0;
    p.eye = light.position;
    if (options.fov) {
        pushBack = pushBackFor(light, *options.fov, pixelsOf(options));
    } else if (radius > 0.0) {
        auto seen = measure(visits, p, std::max(ahead, atLight), reach);
        if (!seen) return seen.error();
        if (seen->empty()) return allBehind(options);
        pushBack = fittedPushBack(radius, std::sqrt(seen->radius2), seen->max.z,
                                  std::max(options.width, options.height));
    }
    p.eye = light.position - pushBack * p.forward;
    p.near = pushBack + ahead > 0.0 ? pushBack + ahead : atLight;
    p.far = pushBack + reach;
    if (options.fov) {
        centreWindow(p, *options.fov, pixelsOf(options));
        return placed;
    }
    auto seen = measure(visits, p, p.near, p.far);
    if (!seen) return seen.error();
    if (seen->empty()) return allBehind(options);
    if (auto s = checkAngle(std::sqrt(seen->radius2)); !s) return s.error();
    if (auto s = checkAround(*seen, options); !s) return s.error();
    fitWindow(p, *seen, pixelsOf(options));
    return placed;
}

Result<Placement> placeCube(Visits& visits, const BakeOptions& options) {
    Placement placed;
    AreaLight& light = placed.light = options.light;
    const bool hasFront =
        light.shape == LightShape::disk || light.shape == LightShape::rect;
    const bool aimed = options.aimed || options.target || !hasFront;
    const double ahead = options.near.value_or(lightEnds(options));
    Extent bounds;
    if (!aimed || ahead == 0.0) {
        auto measured = measure(visits, worldFrame(), -kInfinity, kInfinity);
        if (!measured) return measured.error();
        bounds = *measured;
        setSizes(bounds, placed);
        if (bounds.empty()) return nothingCasts(report(bounds));
    }
    if (hasFront) {
        const auto forward = viewDirection(options, bounds);
        if (!forward) return forward.error();
        aim(light, *forward);
    }
    for (int face = 0; face < 6; ++face) {
        glm::dvec3 forward(0.0), up(0.0);
        forward[face / 2] = face % 2 ? -1.0 : 1.0;
        up[face / 2 == 1 ? 2 : 1] = 1.0;
        Projection& p = placed.projections.emplace_back();
        p.eye = light.position;
        p.forward = forward;
        p.up = up;
        p.right = glm::cross(forward, up) + 0.0;  // no -0
        p.scale = 0.5 * pixelsOf(options) * glm::dvec2(1.0, -1.0);
        p.offset = 0.5 * pixelsOf(options);
        p.near = ahead > 0.0 ? ahead : nearest(light.position, bounds);
        p.far = options.far.value_or(kInfinity);
    }
    return placed;
}

Result<Placement> placeSun(Visits& visits, const BakeOptions& options) {
    Placement placed;
    placed.light = options.light;
    Projection& p = placed.projections.emplace_back();
    p.kind = ProjectionKind::orthographic;
    auto bounds = measure(visits, worldFrame(), -kInfinity, kInfinity);
    if (!bounds) return bounds.error();
    if (bounds->empty()) return nothingCasts(report(*bounds));
    setSizes(*bounds, placed);
    orient(p, unit(options.light.direction), options.up);
    placed.light.direction = p.forward;

    p.eye = 0.5 * (bounds->min + bounds->max);
    auto seen = measure(visits, p, -kInfinity, kInfinity);
    if (!seen) return seen.error();
    if (seen->empty()) return nothingCasts(report(*seen));
    const double margin =
        std::max(0.01 * glm::length(bounds->max - bounds->min), raster::kSmallestDepth);
    p.eye += (seen->min.z - margin) * p.forward;
    p.near = options.near ? margin + *options.near : 0.0;
    p.far = margin + options.far.value_or(kInfinity);
    fitWindow(p, *seen, pixelsOf(options));
    return placed;
}

Status checkSampling(const BakeOptions& o) {
    if (o.subsamples != 1 && o.subsamples != 2 && o.subsamples != 4 && o.subsamples != 8)
        return invalid("--subsamples ", o.subsamples, " must be 1, 2, 4 or 8");
    const std::uint32_t most = kMaxResolution / o.subsamples;
    if (o.width > most || o.height > most)
        return invalid("--resolution ", o.width, "x", o.height, " with --subsamples ",
                       o.subsamples, ": each side must be at most ", most);
    if (!(o.tolerance >= 0.0f && o.tolerance <= 1.0f))
        return invalid("--tolerance ", o.tolerance, " must be in [0, 1]");
    if (!(o.layerOpticalDepth >= 0.0f && o.layerLength >= 0.0f))
        return invalid("layerOpticalDepth ", o.layerOpticalDepth, " and layerLength ",
                       o.layerLength, " must not be negative");
    return {};
}

}  // namespace

Error nothingCasts(const BakeReport& r) {
    if (r.meshes == 0)
        return makeError(ErrorCode::badFile,
                         "nothing casts a shadow: there are no meshes, and no strand or "
                         "volume with finite points, a width, an opacity or a density, "
                         "inside the window, near and far");
    return makeError(
        ErrorCode::badFile, "nothing casts a shadow: of ", r.triangles, " triangles in ",
        r.meshes, " meshes, ", r.degenerate, " have no area, ", r.nonFinite,
        " have a corner that is not finite, ", r.transparent, " are wholly transparent, ",
        r.culled, " are culled, ", r.outside, " lie outside the window, near and far");
}

Status checkOptions(const BakeOptions& o) {
    if (auto s = checkLight(o.light); !s) return s;
    if (o.target && !base::isFinite(*o.target))
        return invalid("--light-target is not finite");
    if (!base::isFinite(o.up)) return invalid("--light-up is not finite");
    if (o.width < 1 || o.height < 1 || o.width > kMaxResolution ||
        o.height > kMaxResolution)
        return invalid("--resolution ", o.width, "x", o.height,
                       ": each side must be 1 to ", kMaxResolution);
    if (o.layers && (*o.layers < 1 || *o.layers > kMaxPixelLayers))
        return invalid("--layers ", *o.layers, " must be 1 to ", kMaxPixelLayers);
    if (auto s = checkSampling(o); !s) return s;
    if (o.fov && o.light.shape == LightShape::sun)
        return invalid("--fov: a sun's rays are parallel and have no field of view");
    if (o.fov && !(*o.fov >= kLeastFov && *o.fov < glm::pi<double>()))
        return invalid("--fov ", degrees(*o.fov), " degrees must be at least ",
                       degrees(kLeastFov), " and less than 180");
    if (o.cube && o.light.shape == LightShape::sun)
        return invalid(
            "--projection cube: a sun shines from one side only and has no place to "
            "look around from; leave --projection away");
    if (o.cube && o.fov)
        return invalid(
            "--fov: each of the six views of --projection cube is 90 degrees "
            "wide; leave one of the two away");
    if (o.cube && o.width != o.height)
        return invalid(
            "--resolution ", o.width, "x", o.height,
            ": the six views of --projection cube are square; give one number");
    if (o.bias && !(*o.bias >= 0.0f && std::isfinite(*o.bias)))
        return invalid("--bias ", *o.bias, " must be finite and not negative");
    if (o.rounding && !(*o.rounding >= 0.0f && *o.rounding <= 1.0f))
        return invalid("--rounding ", *o.rounding, " must be 0 to 1");
    return checkDepths(o);
}

Result<Placement> place(Visits& visits, const BakeOptions& options) {
    if (options.light.shape == LightShape::sun) return placeSun(visits, options);
    return options.cube ? placeCube(visits, options) : placeFinite(visits, options);
}

}  // namespace mtsm::bake_detail
