#include "shadow/bundle_query.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "base/bits.h"
#include "base/sampling.h"
#include "shadow/map_faces.h"
#include "shadow/pixel_share.h"
#include "trace/density_trace.h"
#include "trace/hair_trace.h"
#include "trace/near_trace.h"
#include "trace/patch_trace.h"
#include "trace/sheet_trace.h"

namespace mtsm::shadow {
namespace {

// Measured (tests/bench/NOTES.md): lower planes leave acne, higher ones lose contact.
/// Triangles of the near field are the receiver's own no higher than this above its
/// tangent plane, in pixel footprints: they lie on a grid of 1/256 of one, mostly.
constexpr double kNearHeight = 0.01;
/// Without normals: rays start this much nearer to the receiver.
constexpr double kNearStart = 0.1;
/// The near field answers further where layers are in small pieces, as slender leaves
/// are: until the light, from where the ray is, is so many pixels wide through the
/// receiver, for at most so many footprints of depth.
constexpr double kNearWidth = 8.0;
constexpr double kNearMost = 256.0;
constexpr float kSmallPiece = 20.0f;  // samples
/// Beside hair it answers until the light, from where the ray is, is so many pixels wide
/// through the receiver, or neighbouring rays are so many pixels apart: few rays are
/// better off with what texels filter. For at most and at least so many footprints of
/// depth.
constexpr double kHairWidth = 8.0, kHairLeastWidth = 3.0, kHairApart = 0.5;
constexpr double kHairMost = 256.0, kHairLeast = 2.0;
/// Strands begin to count so many footprints above a receiver without a normal.
constexpr double kHairStart = 0.02;
/// For those in hair texels may then be so much coarser; others see it from afar.
constexpr float kHairSpread = 1.5f;

/// The same beside sheets, which are few.
constexpr double kSheetWidth = 8.0, kSheetLeastWidth = 3.0, kSheetApart = 1.0;
constexpr double kSheetMost = 1e6, kSheetLeast = 8.0;
/// Texels may then be so much coarser: what one blurs is far from the receiver.
constexpr float kSheetSpread = 2.0f;

/// Where layers are capped at so few they say little of what lies behind the nearest
/// strands or sheets, and the near field answers so much farther.
constexpr std::uint32_t kFewLayers = 8;
constexpr double kCappedFarther = 4.0;

/// Triangles answer at least until the light is a pixel wide, to one of no size all the
/// way: there shadows have edges, and pixels steps.
constexpr double kNarrowMost = 1e6;

/// Triangles cannot be all of what is not opaque, and where strands are, not all.
bool hasNear(const ShadowMap& map, std::uint32_t face) {
    if (!map.nearSheets(face).empty()) return true;
    return map.isOpaque() ? !map.nearField(face).empty() && map.nearHair(face).empty()
                          : trace::hasNearMedia(map);
}

/// More where the light is so far away that floats tell no such heights apart: a receiver
/// is rounded to one of them, and its own triangles' corners as well.
double nearHeightOf(const ShadowMap& map) noexcept {
    constexpr double kRoundings = 8.0;
    double height = kNearHeight;
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        if (map.zRange(f).empty()) continue;
        const double z = std::abs(map.zRange(f).max);
        height = std::max(height,
                          kRoundings * 0x1p-24 * z / map.projection(f).pixelFootprint(z));
    }
    return height;
}

bool isCapped(const ShadowMap& map) noexcept {
    return map.info().maxLayers >= 1 && map.info().maxLayers <= kFewLayers;
}

/// For how many footprints of depth the light, seen through a receiver at the far end of
/// what there is, is no wider than one of them.
double narrowOf(const light::LightSampler& light, const Projection& p, double farthest) {
    const light::LightView seen = light.view(p.eye + farthest * p.forward);
    const double width =
        2.0 * std::max({glm::length(seen.x), glm::length(seen.y), glm::length(seen.z)});
    const double away = seen.endless ? 1.0 : farthest;
    return width * kNarrowMost > away ? away / width : kNarrowMost;
}

/// Pixels that the light is wide where a near field of hair or sheets ends.
double widthOf(const ShadowMap& map, std::uint32_t samples, double apart, double least,
               double most) noexcept {
    const double farther = isCapped(map) ? kCappedFarther : 1.0;
    return std::clamp(farther * apart * std::sqrt(double(samples)), least,
                      farther * most);
}

double hairWidth(const ShadowMap& map, std::uint32_t samples) noexcept {
    return widthOf(map, samples, kHairApart, kHairLeastWidth, kHairWidth);
}

double sheetWidth(const ShadowMap& map, std::uint32_t samples) noexcept {
    return widthOf(map, samples, kSheetApart, kSheetLeastWidth, kSheetWidth);
}

LightRays::Setting settingOf(const ShadowMap& map, const light::LightSampler& light,
                             const ShadowOptions& options, bool near, double nearMost,
                             Neighbours neighbours, bool normals,
                             std::optional<std::uint32_t> onlyPattern) {
    LightRays::Setting setting;
    setting.seed = options.seed;
    setting.onlyPattern = onlyPattern;
    setting.pointsPerPixel = std::uint32_t(options.pointsPerPixel);
    setting.isPoint = light.isPoint();
    setting.neighbours = neighbours;
    setting.samples =
        light.isPoint() ? 1u : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples));
    setting.normals = normals;
    setting.weights = normals && options.weight == Weight::cosine;
    setting.height = kPlaneHeight;
    if (near) {
        const bool sheets = !map.nearSheets(0).empty(), hair = !map.isOpaque();
        setting.nearDepth = sheets ? kSheetMost : nearMost;
        setting.nearWidth = sheets ? sheetWidth(map, setting.samples)
                            : hair ? hairWidth(map, setting.samples)
                                   : kNearWidth;
        setting.nearLeast = sheets ? kSheetLeast : hair ? kHairLeast : kNearDepth;
        setting.nearHeight = nearHeightOf(map);
        setting.nearStart = kNearStart;
    }
    setting.media = !map.isOpaque();
    setting.sheets = map.info().translucent == Translucent::sheets;
    setting.steps = SampleSteps::of(options, setting.samples);
    setting.joined = map.faceCount() > 1;
    setting.ways = setting.joined;
    return setting;
}

/// Of rays in the order of their samples: which of those that there are see light.
float spreadOf(std::uint32_t lit, std::uint32_t rays) {
    constexpr std::uint32_t kFirst = (1u << kQuad) - 1;
    float spread = 0.0f;
    for (; rays; rays >>= kQuad, lit >>= kQuad)
        spread += quadSpread(std::popcount(lit & kFirst), std::popcount(rays & kFirst));
    return spread;
}

float sum(std::uint32_t rays, const float* weights) {
    float total = 0.0f;
    for (; rays; rays &= rays - 1)
        total += weights[std::countr_zero(rays)];
    return total;
}

/// Of the first `count`, in an order that vectors can follow.
float sumOf(const float* values, const float* weights, int count) {
    const int size = int(std::bit_ceil(std::uint32_t(count)));
    alignas(64) float lanes[trace::kLanes];
    for (int i = 0; i < count; ++i)
        lanes[i] = weights ? weights[i] * values[i] : values[i];
    std::fill(lanes + count, lanes + size, 0.0f);
    for (int n = size / 2; n > 0; n /= 2) {
        for (int i = 0; i < n; ++i)
            lanes[i] += lanes[i + n];
    }
    return lanes[0];
}

}  // namespace

bool BundleQuery::serves(const ShadowMap& map, const AreaLight& light,
                         const ShadowOptions& options) {
    if (options.method != ShadowMethod::trace) return false;
    if (map.faceCount() > 1 && light.shape == LightShape::sun) return false;
    return hasTrees(map, options.attenuation, trace::DensityUse::receivers);
}

BundleQuery::Face::Face(const ShadowMap& map, std::uint32_t number, ZRange reach,
                        const light::LightSampler& light)
    : projection(map.projection(number)),
      turn(glm::transpose(
          glm::dmat3(projection.right, projection.up, projection.forward))),
      depths(reach),
      places(map, number, reach, light),
      outline(projection, light),
      nearHeight(float(nearHeightOf(map) * projection.pixelFootprint(1.0))),
      nearField(map.nearField(number)),
      nearHair(map.nearHair(number)),
      nearSheets(map.nearSheets(number)),
      near(hasNear(map, number)),
      empty(map.zRange(number).empty()),
      nearest(LightRays::nearestOf(projection, reach)) {
    if (map.isOpaque()) {
        patches = &(*trace::patchTrees(map))[number];
        const float piece = patches->pieceSize();
        const bool small = piece > 0.0f && piece < kSmallPiece;
        nearMost = std::max(small ? kNearMost : kNearDepth,
                            narrowOf(light, projection, double(reach.max)));
        neighbours = small ? Neighbours::own : Neighbours::pixel;
    } else {
        nearMost = kHairMost;
        const bool sheets = map.info().translucent == Translucent::sheets;
        neighbours = sheets ? Neighbours::pixel : Neighbours::root;
        density = &(*trace::densityTrees(map, trace::DensityUse::receivers))[number];
    }
    const light::LightView seen = light.view(projection.eye + projection.forward);
    axisX = turn * seen.x, axisY = turn * seen.y, axisZ = turn * seen.z;
    base = turn * seen.base;
    if (seen.endless) return;
    centre = projection.lightFromWorld(light.centre());
    // Of a cap all of the sphere.
    const double size = std::abs(axisX.z) + std::abs(axisY.z) + std::abs(axisZ.z);
    const bool cap = seen.domain == light::LightView::Domain::cap;
    const double half = cap ? glm::length(axisZ) : size;
    lightLow = centre.z - half, lightHigh = centre.z + half;
}

BundleQuery::BundleQuery(const ShadowMap& map, const AreaLight& light,
                         const ShadowOptions& options, bool errors, const Receiver* only,
                         std::size_t onlyNumber)
    : map_(map),
      light_(light),
      options_(options),
      bias_(biasOf(map, options.bias)),
      opaque_(map.isOpaque()),
      media_(map.info().translucent == Translucent::media),
      mediaStart_(mediaStartOf(map)),
      samples_(light_.isPoint()
                   ? 1u
                   : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples))),
      steps_(SampleSteps::of(options, samples_)),
      patterns_(LightRays::patterns(samples_, std::uint32_t(options.pointsPerPixel))),
      errors_(errors || options.targetError > 0.0f),
      isPlain_(map.info().channels == 1 && options.weight == Weight::uniform &&
               !errors_) {
    const light::LightView seen =
        light_.view(map.projection(0).eye + map.projection(0).forward);
    fixedAxes_ = seen.endless || seen.domain != light::LightView::Domain::cap;
    capHeight_ = seen.capHeight;
    faces_.reserve(map.faceCount());
    for (std::uint32_t f = 0; f < map.faceCount(); ++f)
        faces_.emplace_back(map, f, depthsOf(map, f, options.bias), light_);
    const bool wide = std::any_of(faces_.begin(), faces_.end(), [](const Face& face) {
        return face.lightHigh >= face.nearest * (1.0 - 1e-6);
    });
    if (faces_.size() > 1 && wide) {
        RayOptions single;
        single.bias = options.bias;
        single.threshold = options.threshold;
        singly_.emplace(map, single, true);
    }
    std::optional<std::uint32_t> pattern;
    std::uint32_t met = (1u << map.faceCount()) - 1;
    if (only) {
        Receiver receiver = *only;
        constexpr std::size_t kItself = 0;
        setPatterns(onlyNumber, &kItself, 1, &receiver);
        pattern = receiver.pattern;
        if (faces_.size() > 1) met = facesMet(faceOf(only->point), only->point);
    }
    for (std::uint32_t f = 0; f < faces_.size(); ++f) {
        if (!(met >> f & 1)) continue;
        if (!only || only->normal != glm::dvec3(0.0)) addRays(faces_[f], true, pattern);
        if (!only || only->normal == glm::dvec3(0.0)) addRays(faces_[f], false, pattern);
    }
}

void BundleQuery::addRays(Face& face, bool normals,
                          std::optional<std::uint32_t> onlyPattern) {
    const LightRays* alike = nullptr;
    for (const Face& other : faces_) {
        for (const std::optional<LightRays>* rays :
             {&other.withNormals, &other.without}) {
            if (*rays) alike = &**rays;
        }
    }
    (normals ? face.withNormals : face.without)
        .emplace(face.projection, map_.info().width, map_.info().height, face.depths,
                 light_,
                 settingOf(map_, light_, options_, face.near, face.nearMost,
                           face.neighbours, normals, onlyPattern),
                 alike);
}

/// What a way is along the views of six faces.
void BundleQuery::alongFaces(glm::dvec3 way, double (&depths)[6]) const noexcept {
    for (std::uint32_t f = 0; f < 6; ++f)
        depths[f] = glm::dot(faces_[f].projection.forward, way);
}

/// One bit for each face: may rays from the point to the light meet something there?
/// Always its own.
std::uint32_t BundleQuery::facesMet(std::uint32_t home, glm::dvec3 point) const noexcept {
    const glm::dvec3 p = point - faces_[0].projection.eye;
    double z[6];
    alongFaces(p, z);
    const double slack = 1e-6 * z[home];
    std::uint32_t met = 1u << home;
    for (std::uint32_t f = 0; f < 6; ++f) {
        const Face& face = faces_[f];
        const double nearest = face.nearest * (1.0 - 1e-6);
        if (f == home || face.empty) continue;
        if (face.lightHigh >= nearest) {
            met |= 1u << f;
            continue;
        }
        if (z[f] < nearest) continue;
        // All that rays have in front of the nearest depth lies between the point and
        // where they come to that, t of their way. The point there at which face g is
        // furthest behind this one must be in it.
        const double t0 = (z[f] - nearest) / (z[f] - face.lightLow);
        const double t1 = (z[f] - nearest) / (z[f] - face.lightHigh);
        bool may = true;
        for (std::uint32_t g = 0; g < 6; ++g) {
            if (g == f ||
                glm::dot(face.projection.forward, faces_[g].projection.forward) < -0.5)
                continue;
            const double low = z[g] + std::min(t0 * (faces_[g].lightLow - z[g]),
                                               t1 * (faces_[g].lightLow - z[g]));
            may = may && std::max(nearest - low, z[f] - z[g]) >= -slack;
        }
        if (may) met |= 1u << f;
    }
    return met;
}

void BundleQuery::findPlaces(const glm::dvec3* points, int count,
                             std::uint32_t* places) const noexcept {
    if (faces_.size() == 1) return faces_[0].places.find(points, count, places);
    constexpr int kAtOnce = ReceiverPlaces::kAtOnce;
    std::uint32_t home[kAtOnce], met[kAtOnce];
    for (int i = 0; i < count; ++i) {
        home[i] = faceOf(points[i]);
        met[i] = 1u << home[i];
    }
    // In its own face first, then in each that it meets besides.
    const auto ask = [&](std::uint32_t face, const auto& concerns, const auto& take) {
        glm::dvec3 some[kAtOnce];
        int from[kAtOnce], size = 0;
        for (int i = 0; i < count; ++i) {
            if (!concerns(i)) continue;
            some[size] = points[i];
            from[size++] = i;
        }
        std::uint32_t found[kAtOnce];
        if (size > 0) faces_[face].places.find(some, size, found);
        for (int k = 0; k < size; ++k)
            take(from[k], found[k]);
    };
    for (std::uint32_t f = 0; f < 6; ++f) {
        ask(
            f, [&](int i) { return home[i] == f; },
            [&](int i, std::uint32_t found) { places[i] = found; });
    }
    std::uint32_t any = 0;
    for (int i = 0; i < count; ++i) {
        if (places[i] == ReceiverPlaces::kNone) continue;
        met[i] = facesMet(home[i], points[i]);
        const bool several = met[i] != 1u << home[i];
        if (several) any |= met[i];
        places[i] = places[i] >> 4 | std::uint32_t(several) << 26 | home[i] << 27;
    }
    for (std::uint32_t f = 0; f < 6; ++f) {
        if (!(any >> f & 1)) continue;
        ask(
            f,
            [&](int i) {
                return home[i] != f && (met[i] >> f & 1) &&
                       leadsToEye(faces_[f], points[i]);
            },
            [&](int i, std::uint32_t found) {
                if (found == ReceiverPlaces::kNone) places[i] = found;
            });
    }
}

/// Do all rays from the point to the light come nearer to the eye of the face?
bool BundleQuery::leadsToEye(const Face& face, glm::dvec3 point) const noexcept {
    return glm::dot(face.projection.forward, point - face.projection.eye) >
           face.lightHigh;
}

std::uint32_t BundleQuery::keyOf(glm::dvec3 point) const noexcept {
    std::uint64_t key = options_.seed + 1;
    for (int i = 0; i < 3; ++i)
        key = (key ^ std::bit_cast<std::uint64_t>(point[i] + 0.0)) * 0x9e3779b97f4a7c15u;
    return std::uint32_t(base::mix(key) >> 16);
}

void BundleQuery::setPatterns(std::size_t first, const std::size_t* points,
                              std::size_t count, Receiver* receivers) const noexcept {
    const auto perPixel = std::uint32_t(options_.pointsPerPixel);
    if (perPixel <= 1) {
        for (std::size_t k = 0; k < count; ++k)
            receivers[k].pattern = keyOf(receivers[k].point) % patterns_;
        return;
    }
    std::uint64_t pixel = 0, key = 0;
    std::uint32_t base = 0;
    constexpr std::uint32_t kFew = 16;
    std::uint32_t parts[kFew];  // of a pixel's points
    for (std::size_t k = 0; k < count; ++k) {
        const PixelPoint point(options_, first + points[k]);
        if (k == 0 || point.pixel != pixel) {
            pixel = point.pixel;
            key = PixelShare::keyOf(options_, point);
            base = std::uint32_t(key % (patterns_ / perPixel)) * perPixel;
            if (perPixel <= kFew) shuffledAll(perPixel, base::mix(key), parts);
        }
        receivers[k].pattern =
            base + (perPixel <= kFew ? parts[point.number]
                                     : PixelShare(options_, point, key).part);
    }
}

ReceiverLanes BundleQuery::lanesOf(const Face& face, const Receiver* receivers,
                                   int count) const noexcept {
    constexpr int kMost = trace::kMostReceivers;
    ReceiverLanes lanes;
    lanes.count = count;
    const auto fill = [](ReceiverLanes::Lanes& x, ReceiverLanes::Lanes& y,
                         ReceiverLanes::Lanes& z, glm::dvec3 v) {
        std::fill_n(x, kMost, float(v.x));
        std::fill_n(y, kMost, float(v.y));
        std::fill_n(z, kMost, float(v.z));
    };
    if (fixedAxes_) {
        fill(lanes.axisXX, lanes.axisXY, lanes.axisXZ, face.axisX);
        fill(lanes.axisYX, lanes.axisYY, lanes.axisYZ, face.axisY);
        fill(lanes.axisZX, lanes.axisZY, lanes.axisZZ, face.axisZ);
        std::fill_n(lanes.capHeight, kMost, float(capHeight_));
    }
    const bool sun = light_.shape() == LightShape::sun;
    const bool normals = receivers[0].normal != glm::dvec3(0.0);
    for (int i = 0; i < kMost; ++i) {
        const Receiver& receiver = receivers[i < count ? i : 0];
        const auto set = [i](ReceiverLanes::Lanes& x, ReceiverLanes::Lanes& y,
                             ReceiverLanes::Lanes& z, glm::dvec3 v) {
            x[i] = float(v.x), y[i] = float(v.y), z[i] = float(v.z);
        };
        const glm::dvec3 p = face.turn * (receiver.point - face.projection.eye);
        set(lanes.x, lanes.y, lanes.z, p);
        glm::dvec3 base = sun ? face.base : face.centre - p;
        if (!fixedAxes_) {
            const light::LightView seen = light_.view(receiver.point);
            base = face.turn * seen.base;
            set(lanes.axisXX, lanes.axisXY, lanes.axisXZ, face.turn * seen.x);
            set(lanes.axisYX, lanes.axisYY, lanes.axisYZ, face.turn * seen.y);
            set(lanes.axisZX, lanes.axisZY, lanes.axisZZ, face.turn * seen.z);
            lanes.capHeight[i] = float(seen.capHeight);
        }
        set(lanes.baseX, lanes.baseY, lanes.baseZ, base);
        // Scaled first: the square of a length may overflow or vanish.
        glm::dvec3 normal = receiver.normal;
        const double longest =
            std::max({std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)});
        if (longest > 0.0) normal = face.turn * (normal / longest);
        set(lanes.normalX, lanes.normalY, lanes.normalZ, normal);
        lanes.key[i] = keyOf(receiver.point);
        lanes.pattern[i] = receiver.pattern;
        if (normals && opaque_) continue;
        // Its own face's depth, which is the largest, says how far rays start from it.
        const double depth =
            faces_.size() == 1 ? std::abs(p.z)
                               : std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        lanes.surfaceStart[i] = float(kStartBiases * bias_.at(depth));
        lanes.mediaStart[i] =
            media_ ? float(mediaStart_ * face.projection.pixelFootprint(depth))
                   : lanes.surfaceStart[i];
    }
    if (normals && opaque_) {  // they do not matter
        std::fill_n(lanes.surfaceStart, kMost, 0.0f);
        std::fill_n(lanes.mediaStart, kMost, 0.0f);
    }
    return lanes;
}

trace::DensityTraceOptions BundleQuery::densityOptions() const noexcept {
    trace::DensityTraceOptions options;
    options.bias = bias_;
    const double threshold = thresholdOf(options_.threshold);
    options.darkDepth = threshold > 0.0 ? float(-std::log(threshold)) : trace::kDarkDepth;
    return options;
}

/// What is close to the receivers, as exactly as the casters were given; leaves the
/// bundle with the layers' part of the rays.
void BundleQuery::traceNear(const Face& face, Rays& rays) const noexcept {
    trace::RayBundle& bundle = rays.bundle;
    const int rows = bundle.receivers * bundle.groups;
    if (!face.nearSheets.empty()) return traceSheets(face, rays);
    if (!face.nearField.empty())
        trace::traceNear(face.nearField, bundle, rays.fates.nearEnd, face.nearHeight);
    if (!opaque_) {
        for (int row = 0; row < rows; ++row)
            rays.followed[row] &= bundle.open[row];
        trace::HairTraceOptions hair;
        hair.height = face.nearHeight;
        hair.start = float(kHairStart);
        hair.darkDepth = densityOptions().darkDepth;
        trace::traceHair(face.nearHair, face.projection, hair, map_.info().channels,
                         bundle, rays.depths);
        if (!bundle.hasPlanes) {
            for (float& spread : bundle.spread)
                spread *= kHairSpread;
        }
    }
    for (int row = 0; row < rows; ++row)
        std::copy_n(rays.fates.layersBegin[row], trace::kLanes, bundle.begin[row]);
}

/// The same of a map that has near sheets.
void BundleQuery::traceSheets(const Face& face, Rays& rays) const noexcept {
    trace::RayBundle& bundle = rays.bundle;
    const int rows = bundle.receivers * bundle.groups;
    alignas(64) float visible[trace::kMostRows][trace::kLanes];
    std::fill_n(visible[0], std::size_t(rows) * trace::kLanes, 1.0f);
    std::uint16_t asked[trace::kMostRows];
    std::copy_n(bundle.open, rows, asked);
    trace::SheetTraceOptions options;
    options.perspective = face.projection.kind == ProjectionKind::perspective;
    options.height = face.nearHeight;
    options.dark = std::exp(-densityOptions().darkDepth);
    trace::traceSheets(face.nearSheets, options, bundle, rays.fates.nearEnd, visible);
    for (int row = 0; row < rows; ++row) {
        for (std::uint32_t rest = asked[row]; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            const float left = visible[row][i];
            // Where layers are opaque a sheet that is not is off by a pixel at most.
            if (opaque_ && left < 0.5f) bundle.open[row] &= std::uint16_t(~(1u << i));
            if (!opaque_ && left < 1.0f)
                rays.depths.depth[0][row][i] +=
                    left > options.dark ? -std::log(left) : trace::kDarkDepth;
        }
        std::copy_n(rays.fates.layersBegin[row], trace::kLanes, bundle.begin[row]);
        if (!opaque_)
            std::copy_n(rays.fates.layersBegin[row], trace::kLanes,
                        bundle.beginSurfaces[row]);
    }
    for (float& spread : bundle.spread)
        spread *= kSheetSpread;
}

/// Follows the open rays: blocked ones are closed, others have more depth.
void BundleQuery::follow(const Face& face, Rays& rays) const noexcept {
    if (face.near) traceNear(face, rays);
    if (opaque_)
        trace::tracePatches(*face.patches, rays.bundle);
    else
        trace::traceDensity(*face.density, densityOptions(), rays.bundle, rays.depths);
}

/// The same in the other faces that rays meet. `met` [receiver]: faces, one bit each.
void BundleQuery::followBeyond(std::uint32_t home, const Receiver* receivers, int count,
                               const std::uint32_t* met, int firstGroup,
                               Rays& rays) const noexcept {
    const int groups = rays.bundle.groups;
    const auto channels = opaque_ ? 0u : map_.info().channels;
    Rays beyond;
    for (std::uint32_t f = 0; f < faces_.size(); ++f) {
        Receiver some[trace::kMostReceivers];
        int from[trace::kMostReceivers], size = 0;
        for (int i = 0; i < count; ++i) {
            if (f == home || !(met[i] >> f & 1)) continue;
            if (!leadsToEye(faces_[f], receivers[i].point)) {
                followSingly(home, f, receivers[i], i, rays);
                continue;
            }
            some[size] = receivers[i];
            from[size++] = i;
        }
        if (size == 0) continue;
        const Face& face = faces_[f];
        const bool normals = rays.bundle.hasPlanes;
        (normals ? face.withNormals : face.without)
            ->fill(lanesOf(face, some, size), firstGroup, groups, beyond.bundle,
                   beyond.fates);
        for (int row = 0; row < size * groups; ++row) {
            const int homeRow = from[row / groups] * groups + row % groups;
            beyond.bundle.open[row] &=
                rays.bundle.open[homeRow] | rays.fates.clear[homeRow];
            if (opaque_) continue;
            cut(home, f, some[row / groups], rays.fates, homeRow, row, beyond);
            for (std::uint32_t c = 0; c < channels; ++c)
                std::copy_n(rays.depths.depth[c][homeRow], trace::kLanes,
                            beyond.depths.depth[c][row]);
        }
        std::copy_n(beyond.bundle.open, size * groups, beyond.followed);
        follow(face, beyond);
        for (int row = 0; row < size * groups; ++row) {
            const int homeRow = from[row / groups] * groups + row % groups;
            if (!opaque_) {
                rays.followed[homeRow] |= beyond.followed[row];
                for (std::uint32_t c = 0; c < channels; ++c)
                    std::copy_n(beyond.depths.depth[c][row], trace::kLanes,
                                rays.depths.depth[c][homeRow]);
            }
            const auto left =
                std::uint16_t(~(beyond.followed[row] & ~beyond.bundle.open[row]));
            rays.bundle.open[homeRow] &= left;
            rays.fates.clear[homeRow] &= left;
        }
    }
}

/// The parts of a receiver's rays in a face that they do not all come nearer to the eye
/// of.
void BundleQuery::followSingly(std::uint32_t home, std::uint32_t number,
                               const Receiver& receiver, int homeReceiver,
                               Rays& rays) const noexcept {
    const Face& face = faces_[number];
    const glm::dmat3 worldFromHome = glm::transpose(faces_[home].turn);
    const glm::dvec3 start = receiver.point - faces_[0].projection.eye;
    double z[6];
    alongFaces(start, z);
    const auto& p = faces_[home].projection;
    const double footprint = p.pixelFootprint(std::abs(z[home]));
    const double surface = kStartBiases * bias_.at(z[home]);
    // Sheets are met within the bias, on both sides of where they are.
    const double height =
        std::max(kPlaneHeight * footprint, opaque_ ? 0.0 : 0.4 * surface);
    const double aside = media_ ? mediaStart_ * footprint : surface;
    const glm::dvec3 normal = unitNormal(receiver.normal);
    const glm::dvec3 forward = glm::transpose(worldFromHome) * face.projection.forward;
    const std::uint32_t channels = map_.info().channels;

    ShadowRay parts[RayQuery::kAtOnce];
    std::pair<int, int> places[RayQuery::kAtOnce];  // row and lane
    glm::vec3 visible[RayQuery::kAtOnce];
    std::size_t count = 0;
    const auto look = [&] {
        singly_->look(parts, count, visible);
        for (std::size_t k = 0; k < count; ++k) {
            const auto [row, i] = places[k];
            if (opaque_ && visible[k].x > 0.0f) continue;
            const auto bit = std::uint16_t(1u << i);
            if (opaque_) {
                rays.bundle.open[row] &= std::uint16_t(~bit);
                rays.fates.clear[row] &= std::uint16_t(~bit);
                continue;
            }
            if (visible[k] == glm::vec3(1.0f)) continue;
            rays.followed[row] |= bit;
            for (std::uint32_t c = 0; c < channels; ++c) {
                const float v = visible[k][int(c)];
                rays.depths.depth[c][row][i] +=
                    v > 0.0f ? -std::log(v) : trace::kDarkDepth;
            }
        }
        count = 0;
    };
    for (int group = 0; group < rays.bundle.groups; ++group) {
        const int row = rays.bundle.row(homeReceiver, group);
        std::uint32_t rest = rays.bundle.open[row] | rays.fates.clear[row];
        for (; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            const glm::dvec3 inHome(rays.fates.delta[0][row][i],
                                    rays.fates.delta[1][row][i],
                                    rays.fates.delta[2][row][i]);
            const double rise = glm::dot(forward, inHome);
            if (z[number] + std::max(rise, 0.0) < face.nearest) continue;
            const glm::dvec3 delta = worldFromHome * inHome;
            double change[6];
            alongFaces(delta, change);
            auto [begin, end] = partIn(number, z, change);
            const double length = glm::length(delta);
            // As far off the receiver's own surface as elsewhere.
            const double off = normal != glm::dvec3(0.0)
                                   ? height / glm::dot(normal, delta)
                                   : aside / length;
            begin = std::max(begin, off);
            end = std::min(end, 1.0);
            if (!(begin < end)) continue;
            if (count == RayQuery::kAtOnce) look();
            places[count] = {row, i};
            parts[count++] = {receiver.point + begin * delta, delta / length,
                              (end - begin) * length};
        }
    }
    if (count > 0) look();
}

/// Cuts a row of rays down to their parts in face number `number`, as those of the home
/// face have them.
void BundleQuery::cut(std::uint32_t home, std::uint32_t number, const Receiver& receiver,
                      const RayFates& homeFates, int homeRow, int row,
                      Rays& rays) const noexcept {
    const glm::dmat3 worldFromHome = glm::transpose(faces_[home].turn);
    const glm::dvec3 start = receiver.point - faces_[0].projection.eye;
    double z[6];
    alongFaces(start, z);
    trace::RayBundle& bundle = rays.bundle;
    for (std::uint32_t rest = bundle.open[row]; rest; rest &= rest - 1) {
        const int i = std::countr_zero(rest);
        const glm::dvec3 delta =
            worldFromHome * glm::dvec3(homeFates.delta[0][homeRow][i],
                                       homeFates.delta[1][homeRow][i],
                                       homeFates.delta[2][homeRow][i]);
        double change[6];
        alongFaces(delta, change);
        const auto [begin, end] = partIn(number, z, change);
        const double way = rays.fates.way[row][i];
        const double last = z[number] + way * change[number];
        const auto at = [&](double t) {
            return t / way * (last / (z[number] + t * change[number]));
        };
        const double cutTo = end < way ? at(end) : 1.0;
        const double from = begin > 0.0 ? at(begin) : 0.0;
        if (!(begin < std::min(end, way)) || !(from < cutTo)) {
            bundle.open[row] &= std::uint16_t(~(1u << i));
            rays.fates.clear[row] |= std::uint16_t(1u << i);
            continue;
        }
        if (cutTo < 1.0) {
            for (float* d : {&bundle.du[row][i], &bundle.dv[row][i], &bundle.dw[row][i]})
                *d = float(*d * cutTo);
        }
        for (float* b : {&bundle.begin[row][i], &bundle.beginSurfaces[row][i]})
            *b = float(std::max(double(*b), from) / cutTo);
    }
}

/// Adds what the rays leave of the light. `valid` [row]: the rays that there are.
void BundleQuery::addUp(Rays& rays, const std::uint16_t* valid, bool weights,
                        Sums* sums) const noexcept {
    const int rows = rays.bundle.receivers * rays.bundle.groups;
    const RayFates& fates = rays.fates;
    if (opaque_) {
        for (int receiver = 0; receiver < rays.bundle.receivers; ++receiver) {
            Sums& s = sums[receiver];
            float visible = s.visible.x;
            for (int group = 0; group < rays.bundle.groups; ++group) {
                const int row = rays.bundle.row(receiver, group);
                const auto left = std::uint16_t(rays.bundle.open[row] | fates.clear[row]);
                const auto lit = float(base::countBits(left));
                visible += weights ? sum(left, fates.weight[row]) : lit;
                if (left) s.most = 1.0f;
                if (left != valid[row]) s.least = 0.0f;
                if (errors_ && left) {
                    s.seen.sum += lit;
                    s.seen.squares = s.seen.sum;
                    if (left != valid[row]) s.seen.spread += spreadOf(left, valid[row]);
                }
            }
            s.visible = glm::vec3(visible);
        }
        return;
    }
    const std::uint32_t channels = map_.info().channels;
    trace::seeThrough(rows, channels, float(thresholdOf(options_.threshold)),
                      rays.followed, fates.clear, rays.depths);
    for (int row = 0; row < rows; ++row) {
        Sums& s = sums[row / rays.bundle.groups];
        const int count = std::popcount(valid[row]);
        float means[trace::kLanes] = {};
        for (std::uint32_t c = 0; c < channels; ++c) {
            const float* const v = rays.depths.depth[c][row];
            for (int i = 0; i < count; ++i) {
                s.least = std::min(s.least, v[i]);
                s.most = std::max(s.most, v[i]);
            }
            for (int i = 0; errors_ && i < count; ++i)
                means[i] += v[i] / float(channels);
            s.visible[int(c)] += sumOf(v, weights ? fates.weight[row] : nullptr, count);
        }
        if (channels == 1) s.visible.y = s.visible.z = s.visible.x;
        if (!errors_) continue;
        for (int i = 0; i < count; ++i) {
            s.seen.sum += means[i];
            s.seen.squares += means[i] * means[i];
        }
        for (int i = 0; i < count; i += kQuad)
            s.seen.spread += quadSpread(means + i, std::min(kQuad, count - i));
    }
}

/// The greatest w of its triangles.
static float highestOf(const NearSheets& sheets) {
    const NearBoxes& top = sheets.triangles.levels.back()[0];
    return *std::max_element(top.high[2], top.high[2] + NearBoxes::kChildren);
}

/// Does nothing lie between those that have all of the light above them and it?
bool BundleQuery::isFree(const Face& face, const Outlook& starts) const noexcept {
    const float among = neighbours(steps_.end[0], std::uint32_t(options_.pointsPerPixel),
                                   face.neighbours);
    std::optional<trace::RayHull> hull = face.outline.hull(starts, among);
    if (!hull) return false;
    if (face.near) {
        const bool perspective = face.projection.kind == ProjectionKind::perspective;
        const auto depth = [&](double footprints, float w) {
            return float(footprints * face.projection.pixelFootprint(1.0)) *
                   (perspective ? w : 1.0f);
        };
        const bool sheets = !face.nearSheets.empty();
        const float most = sheets
                               ? std::max(0.0f, highestOf(face.nearSheets) - hull->wLow)
                               : depth(face.nearMost, hull->wHigh);
        if (trace::mayMeet(face.nearField.levels, *hull, most) ||
            trace::mayMeet(face.nearHair.levels, *hull, most) ||
            trace::mayMeet(face.nearSheets.triangles.levels, *hull, most))
            return false;
        hull->spread *= sheets ? kSheetSpread : opaque_ ? 1.0f : kHairSpread;
        hull->wFirst += (1.0f - 0x1p-10f) * depth(sheets    ? kSheetLeast
                                                  : opaque_ ? kNearDepth
                                                            : kHairLeast,
                                                  hull->wLow);
    }
    return face.patches ? !trace::mayMeet(*face.patches, *hull)
                        : !trace::mayMeet(*face.density, densityOptions(), *hull);
}

/// Tells of receivers in sixteens, all at once or in fewer and fewer.
void BundleQuery::findLit(const Face& face, Outlook* outlooks, int count,
                          Glance* told) const noexcept {
    Outlook all;
    for (int i = 0; i < count; ++i)
        all.include(outlooks[i]);
    if (all.above == 0) return;
    if (isFree(face, all)) {
        for (int i = 0; i < count; ++i) {
            for (std::uint32_t rest = outlooks[i].above; rest; rest &= rest - 1)
                told[i * trace::kMostReceivers + std::countr_zero(rest)] = Glance::lit;
        }
    } else if (count > 1) {
        const int part = (count + 3) / 4;
        for (int first = 0; first < count; first += part)
            findLit(face, outlooks + first, std::min(part, count - first),
                    told + first * trace::kMostReceivers);
    }
}

void BundleQuery::glance(const Receiver* receivers, int count, Glance* told,
                         QueryStats& stats) const noexcept {
    std::fill_n(told, count, Glance::unknown);
    const std::uint32_t home = faceOf(receivers[0].point);
    const Face& face = faces_[home];
    Outlook outlooks[kMostGlances / trace::kMostReceivers];
    int parts = 0;
    for (int first = 0; first < count; first += trace::kMostReceivers, ++parts) {
        outlooks[parts] = face.outline.outlook(
            receivers + first, std::min(count - first, trace::kMostReceivers));
        for (std::uint32_t rest = outlooks[parts].below; rest; rest &= rest - 1)
            told[first + std::countr_zero(rest)] = Glance::dark;
    }
    // Nothing lies in other faces either: they are not met.
    const bool single =
        faces_.size() == 1 || facesMet(home, receivers[0].point) == 1u << home;
    if (single) findLit(face, outlooks, parts, told);
    const std::uint32_t rays = steps_.end[0];
    for (int i = 0; i < count; ++i)
        stats.rays += told[i] == Glance::lit ? rays : 0;
}

bool BundleQuery::isEnough(const Sums& sums, int step) const noexcept {
    if (step + 1 == steps_.count) return true;
    if (options_.targetError > 0.0f) return errorOf(sums, step) <= options_.targetError;
    constexpr float kSame = 1.0f / 64;
    return sums.most - sums.least <= kSame;
}

/// The mean visibilities.
glm::vec3 BundleQuery::visibleOf(const Sums& sums, int step) const noexcept {
    const bool weights = options_.weight == Weight::cosine && sums.total >= 0.0f;
    const float total = weights ? sums.total : float(steps_.end[step]);
    // All weights may vanish in the distance; below the horizon all is dark.
    if (!(total > 0.0f)) return glm::vec3(sums.above ? 1.0f : 0.0f);
    // However the weights were added up: what all rays see is seen.
    if (weights && sums.least == 1.0f) return glm::vec3(1.0f);
    return glm::clamp(sums.visible / total, 0.0f, 1.0f);
}

float BundleQuery::errorOf(const Sums& sums, int step) const noexcept {
    if (light_.isPoint()) return 0.0f;
    return sampleError(sums.seen, steps_.first(step), steps_.end[step]);
}

Answer BundleQuery::answerOfAny(const Sums& sums, int step) const noexcept {
    return {1.0f - visibleOf(sums, step), errors_ ? errorOf(sums, step) : 0.0f};
}

Answer BundleQuery::answerOf(Glance told) const noexcept {
    return {glm::vec3(told == Glance::lit ? 0.0f : 1.0f),
            errors_ ? errorOf(Sums{}, 0) : 0.0f};
}

/// Groups of rays that so many samples take.
static int groupsOf(std::uint32_t samples) noexcept {
    return int((samples + trace::kLanes - 1) / trace::kLanes);
}

void BundleQuery::look(const Receiver* receivers, int count, int step, Sums* sums,
                       QueryStats& stats) const noexcept {
    // Near media are looked at once for all rays of a receiver in a bundle; the way
    // through layers is each ray's own.
    const int groups = groupsOf(steps_.end[step]) - groupsOf(steps_.first(step));
    const int most = opaque_ ? trace::kMostReceivers
                             : std::max(trace::kMostMediaRows / std::max(groups, 1), 1);
    for (int first = 0; first < count; first += most)
        lookAtOnce(receivers + first, std::min(most, count - first), step, sums + first,
                   stats);
}

/// Of as many as a bundle has room for. Takes much of the stack.
void BundleQuery::lookAtOnce(const Receiver* receivers, int count, int step, Sums* sums,
                             QueryStats& stats) const noexcept {
    const int begin = groupsOf(steps_.first(step)), end = groupsOf(steps_.end[step]);
    const bool normals = receivers[0].normal != glm::dvec3(0.0);
    const bool weights = normals && options_.weight == Weight::cosine;
    const std::uint32_t home = faceOf(receivers[0].point);
    const Face& face = faces_[home];
    const LightRays& light = *(normals ? face.withNormals : face.without);
    const ReceiverLanes lanes = lanesOf(face, receivers, count);
    std::uint32_t met[trace::kMostReceivers] = {};
    bool goBeyond = false;
    for (int i = 0; faces_.size() > 1 && i < count; ++i) {
        met[i] = facesMet(home, receivers[i].point);
        goBeyond = goBeyond || met[i] != 1u << home;
    }

    Rays rays;
    std::uint16_t valid[trace::kMostRows];
    const int mostRows =
        opaque_ && faces_.size() == 1 ? trace::kMostRows : trace::kMostMediaRows;
    const int atOnce = std::min(trace::kMostGroups, mostRows / count);
    for (int i = 0; i < count; ++i)
        sums[i].seen.spread = 0.0f;
    for (int first = begin; first < end; first += atOnce) {
        light.fill(lanes, first, std::min(atOnce, end - first), rays.bundle, rays.fates);
        const int groups = rays.bundle.groups, rows = count * groups;
        for (int receiver = 0; receiver < count; ++receiver) {
            Sums& s = sums[receiver];
            if (!weights) s.total = -1.0f;
            for (int group = 0; group < groups; ++group) {
                const int row = rays.bundle.row(receiver, group);
                const int left = int(samples_) - (first + group) * trace::kLanes;
                valid[row] = std::uint16_t((1u << std::min(left, trace::kLanes)) - 1);
                const std::uint32_t counted =
                    rays.bundle.open[row] | rays.fates.clear[row];
                stats.rays += std::uint64_t(base::countBits(std::uint16_t(counted)));
                s.above = s.above || counted != 0;
                if (weights) s.total += sum(counted, rays.fates.weight[row]);
            }
        }
        if (!opaque_) {
            for (int row = 0; goBeyond && row < rows; ++row) {
                if (met[row / groups] != 1u << home)
                    cut(home, home, receivers[row / groups], rays.fates, row, row, rays);
            }
            std::copy_n(rays.bundle.open, rows, rays.followed);
            for (std::uint32_t c = 0; c < map_.info().channels; ++c)
                std::fill_n(rays.depths.depth[c][0], std::size_t(rows) * trace::kLanes,
                            0.0f);
        }
        follow(face, rays);
        if (goBeyond) followBeyond(home, receivers, count, met, first, rays);
        addUp(rays, valid, weights, sums);
    }
}

}  // namespace mtsm::shadow
