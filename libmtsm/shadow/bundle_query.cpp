#include "shadow/bundle_query.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/common.hpp>
#include <glm/matrix.hpp>

#include "base/sampling.h"
#include "trace/density_trace.h"
#include "trace/near_trace.h"
#include "trace/patch_trace.h"

namespace mtsm::shadow {
namespace {

/// Trees count in 32 bits.
constexpr std::uint64_t kMostLayers = std::uint64_t(1) << 28;

// Measured (tests/bench/NOTES.md): twice the depth halves the error next to receivers and
// costs little; lower planes leave acne, higher ones lose contact.
/// The near field answers for so many pixel footprints of depth.
constexpr double kNearDepth = 32.0;
/// Its triangles are the receiver's own no higher than this above its tangent plane, in
/// pixel footprints: they lie on a grid of 1/256 of one, mostly.
constexpr double kNearHeight = 0.01;
/// Without normals: rays start this much nearer to the receiver.
constexpr double kNearStart = 0.1;

/// More where the light is so far away that floats tell no such heights apart: a receiver
/// is rounded to one of them, and its own triangles' corners as well.
double nearHeightOf(const ShadowMap& map) noexcept {
    constexpr double kRoundings = 8.0;
    const double z = std::abs(map.zRange(0).max);
    return std::max(kNearHeight,
                    kRoundings * 0x1p-24 * z / map.projection(0).pixelFootprint(z));
}

LightRays raysOf(const ShadowMap& map, const light::LightSampler& light,
                 const ShadowOptions& options, bool normals,
                 std::optional<std::uint32_t> onlyKey) {
    LightRays::Setting setting;
    setting.seed = options.seed;
    setting.onlyKey = onlyKey;
    setting.isPoint = light.isPoint();
    setting.samples =
        light.isPoint() ? 1u : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples));
    setting.normals = normals;
    setting.weights = normals && options.weight == Weight::cosine;
    setting.height = kPlaneHeight;
    if (!map.nearField(0).empty()) {
        setting.nearDepth = kNearDepth;
        setting.nearHeight = nearHeightOf(map);
        setting.nearStart = kNearStart;
    }
    setting.media = !map.isOpaque();
    setting.sheets = map.info().translucent == Translucent::sheets;
    setting.steps = SampleSteps::of(options, setting.samples);
    // Sheets are met within two biases.
    ZRange depths = map.zRange(0);
    const trace::ZBias bias = biasOf(map, options.bias);
    const bool perspective = map.projection(0).kind == ProjectionKind::perspective;
    const auto nearest = float(depths.min - 2.0 * bias.at(depths.min));
    depths.min = perspective ? std::max(nearest, depths.min * 0x1p-10f) : nearest;
    depths.max += float(2.0 * bias.at(depths.max));
    return LightRays(map.projection(0), map.info().width, map.info().height, depths,
                     light, setting);
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

}  // namespace

bool BundleQuery::serves(const ShadowMap& map, const ShadowOptions& options) noexcept {
    if (options.method != ShadowMethod::trace || map.faceCount() != 1 ||
        map.layerCount() == 0 || map.layerCount() > kMostLayers)
        return false;
    if (map.isOpaque()) return true;
    return options.attenuation == Attenuation::multiply && trace::densityTree(map);
}

BundleQuery::BundleQuery(const ShadowMap& map, const AreaLight& light,
                         const ShadowOptions& options, bool errors, const Receiver* only)
    : map_(map),
      projection_(map.projection(0)),
      light_(light),
      outline_(projection_, light_),
      places_(map, light_),
      options_(options),
      bias_(biasOf(map, options.bias)),
      patches_(map.isOpaque() ? &trace::patchTrees(map)[0] : nullptr),
      density_(map.isOpaque() ? nullptr : trace::densityTree(map)),
      media_(map.info().translucent == Translucent::media),
      samples_(light_.isPoint()
                   ? 1u
                   : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples))),
      steps_(SampleSteps::of(options, samples_)),
      errors_(errors || options.targetError > 0.0f) {
    std::optional<std::uint32_t> key;
    if (only) key = keyOf(*only);
    if (!only || only->normal != glm::dvec3(0.0))
        withNormals_.emplace(raysOf(map, light_, options, true, key));
    if (!only || only->normal == glm::dvec3(0.0))
        without_.emplace(raysOf(map, light_, options, false, key));
    const light::LightView seen = light_.view(projection_.eye + projection_.forward);
    fixedAxes_ = seen.endless || seen.domain != light::LightView::Domain::cap;
    turn_ = glm::transpose(
        glm::dmat3(projection_.right, projection_.up, projection_.forward));
    const auto turn = [&](glm::dvec3 d) { return turned(d); };
    axisX_ = turn(seen.x), axisY_ = turn(seen.y), axisZ_ = turn(seen.z);
    base_ = turn(seen.base);
    capHeight_ = seen.capHeight;
    nearHeight_ = float(nearHeightOf(map) * projection_.pixelFootprint(1.0));
    if (!seen.endless) centre_ = projection_.lightFromWorld(light_.centre());
}

std::uint32_t BundleQuery::keyOf(const Receiver& receiver) const noexcept {
    std::uint64_t key = options_.seed + 1;
    for (int i = 0; i < 3; ++i)
        key = (key ^ std::bit_cast<std::uint64_t>(receiver.point[i] + 0.0)) *
              0x9e3779b97f4a7c15u;
    return std::uint32_t(base::mix(key) >> 16);
}

void BundleQuery::setLane(const Receiver& receiver, int lane,
                          ReceiverLanes& lanes) const noexcept {
    const glm::dvec3 p = turned(receiver.point - projection_.eye);
    const auto set = [lane](ReceiverLanes::Lanes& x, ReceiverLanes::Lanes& y,
                            ReceiverLanes::Lanes& z, glm::dvec3 v) {
        x[lane] = float(v.x), y[lane] = float(v.y), z[lane] = float(v.z);
    };
    glm::dvec3 base = light_.shape() == LightShape::sun ? base_ : centre_ - p;
    glm::dvec3 x = axisX_, y = axisY_, z = axisZ_;
    double capHeight = capHeight_;
    if (!fixedAxes_) {
        const light::LightView seen = light_.view(receiver.point);
        const auto turn = [&](glm::dvec3 d) { return turned(d); };
        base = turn(seen.base);
        x = turn(seen.x), y = turn(seen.y), z = turn(seen.z);
        capHeight = seen.capHeight;
    }
    set(lanes.x, lanes.y, lanes.z, p);
    set(lanes.baseX, lanes.baseY, lanes.baseZ, base);
    set(lanes.axisXX, lanes.axisXY, lanes.axisXZ, x);
    set(lanes.axisYX, lanes.axisYY, lanes.axisYZ, y);
    set(lanes.axisZX, lanes.axisZY, lanes.axisZZ, z);
    // Scaled first: the square of a length may overflow or vanish.
    glm::dvec3 normal = receiver.normal;
    const double longest =
        std::max({std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)});
    if (longest > 0.0) normal = turned(normal / longest);
    set(lanes.normalX, lanes.normalY, lanes.normalZ, normal);
    lanes.capHeight[lane] = float(capHeight);
    lanes.surfaceStart[lane] = float(kStartBiases * bias_.at(p.z));
    lanes.mediaStart[lane] =
        media_ ? float(kMediaStart * projection_.pixelFootprint(std::abs(p.z)))
               : lanes.surfaceStart[lane];
    lanes.key[lane] = keyOf(receiver);
}

/// What is close to the receivers, as exactly as the casters were given; leaves the
/// bundle with the layers' part of the rays.
void BundleQuery::traceNear(trace::RayBundle& bundle,
                            const RayFates& fates) const noexcept {
    trace::traceNear(map_.nearField(0), bundle, fates.nearEnd, nearHeight_);
    for (int row = 0; row < bundle.receivers * bundle.groups; ++row)
        std::copy_n(fates.layersBegin[row], trace::kLanes, bundle.begin[row]);
}

/// Adds what the bundle's rays leave of the light. `valid` [row]: the rays that there
/// are.
void BundleQuery::follow(trace::RayBundle& bundle, const RayFates& fates,
                         const std::uint16_t* valid, bool weights,
                         Sums* sums) const noexcept {
    const int rows = bundle.receivers * bundle.groups;
    if (patches_) {
        if (!map_.nearField(0).empty()) traceNear(bundle, fates);
        trace::tracePatches(*patches_, bundle);
        for (int row = 0; row < rows; ++row) {
            const std::uint32_t left = bundle.open[row] | fates.clear[row];
            Sums& s = sums[row / bundle.groups];
            s.visible +=
                weights ? sum(left, fates.weight[row]) : float(std::popcount(left));
            if (left) s.most = 1.0f;
            if (left != valid[row]) s.least = 0.0f;
            if (errors_ && left) {
                s.seen.sum += float(std::popcount(left));
                s.seen.squares = s.seen.sum;
                if (left != valid[row]) s.seen.spread += spreadOf(left, valid[row]);
            }
        }
        return;
    }
    const std::uint32_t channels = map_.info().channels;
    std::uint16_t followed[trace::kMostRows];
    std::copy_n(bundle.open, rows, followed);
    trace::RayDepths depths;
    for (std::uint32_t c = 0; c < channels; ++c)
        std::fill_n(depths.depth[c][0], std::size_t(rows) * trace::kLanes, 0.0f);
    trace::DensityTraceOptions options;
    options.bias = bias_;
    const double threshold = thresholdOf(options_.threshold);
    options.darkDepth = threshold > 0.0 ? float(-std::log(threshold)) : trace::kDarkDepth;
    trace::traceDensity(*density_, options, bundle, depths);
    for (int row = 0; row < rows; ++row) {
        Sums& s = sums[row / bundle.groups];
        float means[trace::kLanes];  // of the channels
        for (std::uint32_t rest = valid[row]; rest; rest &= rest - 1) {
            const int i = std::countr_zero(rest);
            glm::vec3 v(fates.clear[row] >> i & 1 ? 1.0f : 0.0f);
            if (followed[row] >> i & 1) {
                for (std::uint32_t c = 0; c < 3; ++c) {
                    const float left =
                        std::exp(-depths.depth[c < channels ? c : 0][row][i]);
                    v[int(c)] = left > float(threshold) ? left : 0.0f;
                }
            }
            s.visible += (weights ? fates.weight[row][i] : 1.0f) * v;
            s.least = std::min({s.least, v.x, v.y, v.z});
            s.most = std::max({s.most, v.x, v.y, v.z});
            means[i] = mean(v, channels);
        }
        if (!errors_) continue;
        const int rays = std::popcount(valid[row]);
        for (int i = 0; i < rays; ++i) {
            s.seen.sum += means[i];
            s.seen.squares += means[i] * means[i];
        }
        for (int i = 0; i < rays; i += kQuad)
            s.seen.spread += quadSpread(means + i, std::min(kQuad, rays - i));
    }
}

/// Does nothing lie between those that have all of the light above them and it?
bool BundleQuery::isFree(const Outlook& starts) const noexcept {
    std::optional<trace::RayHull> hull = outline_.hull(starts);
    if (!hull) return false;
    if (!map_.nearField(0).empty()) {
        const bool perspective = projection_.kind == ProjectionKind::perspective;
        const auto depth = [&](float w) {
            return float(kNearDepth * projection_.pixelFootprint(1.0)) *
                   (perspective ? w : 1.0f);
        };
        if (trace::mayMeet(map_.nearField(0), *hull, depth(hull->wHigh))) return false;
        hull->wFirst += (1.0f - 0x1p-10f) * depth(hull->wLow);
    }
    return !trace::mayMeet(*patches_, *hull);
}

/// Tells of receivers in sixteens, all at once or in fewer and fewer.
void BundleQuery::findLit(Outlook* outlooks, int count, Glance* told) const noexcept {
    Outlook all;
    for (int i = 0; i < count; ++i)
        all.include(outlooks[i]);
    if (all.above == 0) return;
    if (isFree(all)) {
        for (int i = 0; i < count; ++i) {
            for (std::uint32_t rest = outlooks[i].above; rest; rest &= rest - 1)
                told[i * trace::kMostReceivers + std::countr_zero(rest)] = Glance::lit;
        }
    } else if (count > 1) {
        const int part = (count + 3) / 4;
        for (int first = 0; first < count; first += part)
            findLit(outlooks + first, std::min(part, count - first),
                    told + first * trace::kMostReceivers);
    }
}

void BundleQuery::glance(const Receiver* receivers, int count, Glance* told,
                         QueryStats& stats) const noexcept {
    std::fill_n(told, count, Glance::unknown);
    Outlook outlooks[kMostGlances / trace::kMostReceivers];
    int parts = 0;
    for (int first = 0; first < count; first += trace::kMostReceivers, ++parts) {
        outlooks[parts] = outline_.outlook(
            receivers + first, std::min(count - first, trace::kMostReceivers));
        for (std::uint32_t rest = outlooks[parts].below; rest; rest &= rest - 1)
            told[first + std::countr_zero(rest)] = Glance::dark;
    }
    if (patches_) findLit(outlooks, parts, told);
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
    return glm::clamp(sums.visible / total, 0.0f, 1.0f);
}

float BundleQuery::errorOf(const Sums& sums, int step) const noexcept {
    if (light_.isPoint()) return 0.0f;
    return sampleError(sums.seen, steps_.first(step), steps_.end[step]);
}

Answer BundleQuery::answerOf(const Sums& sums, int step) const noexcept {
    return {1.0f - visibleOf(sums, step), errors_ ? errorOf(sums, step) : 0.0f};
}

Answer BundleQuery::answerOf(Glance told) const noexcept {
    return {glm::vec3(told == Glance::lit ? 0.0f : 1.0f),
            errors_ ? errorOf(Sums{}, 0) : 0.0f};
}

void BundleQuery::look(const Receiver* receivers, int count, int step, Sums* sums,
                       QueryStats& stats) const noexcept {
    const bool normals = receivers[0].normal != glm::dvec3(0.0);
    const bool weights = normals && options_.weight == Weight::cosine;
    const LightRays& rays = *(normals ? withNormals_ : without_);
    ReceiverLanes lanes;
    lanes.count = count;
    for (int i = 0; i < trace::kMostReceivers; ++i)
        setLane(receivers[i < count ? i : 0], i, lanes);

    trace::RayBundle bundle;
    RayFates fates;
    std::uint16_t valid[trace::kMostRows];
    const int atOnce = trace::kMostRows / count;
    for (int i = 0; i < count; ++i)
        sums[i].seen.spread = 0.0f;
    const auto groups = [](std::uint32_t samples) {
        return int((samples + trace::kLanes - 1) / trace::kLanes);
    };
    const int end = groups(steps_.end[step]);
    for (int first = groups(steps_.first(step)); first < end; first += atOnce) {
        rays.fill(lanes, first, std::min(atOnce, end - first), bundle, fates);
        for (int row = 0; row < bundle.receivers * bundle.groups; ++row) {
            const int left =
                int(samples_) - (first + row % bundle.groups) * trace::kLanes;
            valid[row] = std::uint16_t((1u << std::min(left, trace::kLanes)) - 1);
            const std::uint32_t counted = bundle.open[row] | fates.clear[row];
            stats.rays += std::uint64_t(std::popcount(counted));
            Sums& s = sums[row / bundle.groups];
            s.above = s.above || counted != 0;
            s.total = weights ? s.total + sum(counted, fates.weight[row]) : -1.0f;
        }
        follow(bundle, fates, valid, weights, sums);
    }
}

}  // namespace mtsm::shadow
