// One point's shadow factor: the mean over points on the light [Xie07, sec. 5.2], by
// rays.
#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>

#include "base/finite.h"
#include "shadow/pixel_share.h"
#include "shadow/query.h"
#include "shadow/sample_error.h"

namespace mtsm::shadow {

trace::ZBias biasOf(const ShadowMap& map, float asked) noexcept {
    if (asked >= 0.0f && std::isfinite(asked)) return {asked, 0.0};
    return {map.info().bias, map.info().biasPerDepth};
}

double thresholdOf(float asked) noexcept {
    return asked >= 0.0f ? std::min(asked, std::nextafter(1.0f, 0.0f)) : 0.0;
}

double mediaStartOf(const ShadowMap& map) noexcept {
    for (const Attribute& attribute : map.info().attributes) {
        const auto* value = std::get_if<std::vector<double>>(&attribute.value);
        if (attribute.name == "mediaStart" && value && value->size() == 1 &&
            value->front() >= 0.0)
            return std::min(value->front(), kMediaStart);
    }
    return kMediaStart;
}

Query::Query(const ShadowMap& map, const AreaLight& light, const ShadowOptions& options,
             bool errors) noexcept
    : map_(map),
      light_(light),
      options_(options),
      bias_(biasOf(map, options.bias)),
      media_(map.info().translucent == Translucent::media),
      mediaStart_(mediaStartOf(map)),
      errors_(errors) {
    const auto samples = light_.isPoint()
                             ? 1u
                             : std::uint32_t(std::clamp(options.samples, 1, kMaxSamples));
    // Ray by ray it pays to look only where an error was asked for.
    options_.adaptive = false;
    if (options.method != ShadowMethod::trace) options_.targetError = 0.0f;
    errors_ = errors_ || options_.targetError > 0.0f;
    steps_ = SampleSteps::of(options_, samples);
    if (map.hasLayers()) return;
    RayOptions rays;
    rays.bias = options.bias;
    rays.threshold = options.threshold;
    rays_.emplace(map, rays);
}

Answer Query::shadowFactor(std::size_t i, glm::dvec3 point, glm::dvec3 normal,
                           QueryStats& stats) const noexcept {
    if (!isShadowed(point)) {
        ++stats.points;
        ++(base::isFinite(point) ? stats.behindLight : stats.notFinite);
        return {};
    }
    count(point, stats);
    const Receiver receiver = receiverAt(point, normal);
    if (options_.pointsPerPixel <= 1)
        return blocked(receiver, base::pointKey(point, options_.seed), 0, stats);
    const PixelShare share(options_, PixelPoint(options_, i));
    const SequencePart part(share.part, steps_.end[steps_.count - 1]);
    return blocked(receiver, base::mix(share.key + part.sequence), part.first, stats);
}

void Query::count(glm::dvec3 point, QueryStats& stats) const noexcept {
    ++stats.points;
    if (map_.info().castersClipped && mayBeTruncated(point)) ++stats.mayBeTruncated;
}

glm::dvec3 unitNormal(glm::dvec3 normal) noexcept {
    if (!saysSomething(normal)) return glm::dvec3(0.0);
    // Scaled first: the square of a length may overflow or vanish.
    const double size =
        std::max({std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)});
    return glm::normalize(normal / size);
}

Query::Receiver Query::receiverAt(glm::dvec3 point, glm::dvec3 normal) const noexcept {
    Receiver receiver;
    receiver.point = point;
    receiver.face = trace::faceOf(map_, point);
    const Projection& p = map_.projection(receiver.face);
    const double z = glm::dot(p.forward, point - p.eye);
    receiver.surfaceStart = kStartBiases * bias_.at(z);
    receiver.mediaStart = mediaStart_ * p.pixelFootprint(std::abs(z));
    const glm::dvec3 unit = unitNormal(normal);
    receiver.hasNormal = unit != glm::dvec3(0.0);
    if (receiver.hasNormal) receiver.plane = {point, unit, kPlaneHeight};
    return receiver;
}

/// One minus the weighted mean of the visibility over the light.
Answer Query::blocked(const Receiver& receiver, std::uint64_t key,
                      std::uint32_t firstSample, QueryStats& stats) const noexcept {
    const base::SquareSequence sequence(key);
    const bool cosine = options_.weight == Weight::cosine && receiver.hasNormal;
    SeenSample seen[kMaxSamples];  // if errors matter
    glm::dvec3 visible(0.0);
    double total = 0.0;
    bool above = false;
    float error = 0.0f;
    for (int step = 0; step < steps_.count; ++step) {
        for (std::uint32_t i = steps_.first(step); i < steps_.end[step]; ++i) {
            const glm::dvec2 u =
                light_.isPoint() ? glm::dvec2(0.5) : sequence(firstSample + i);
            if (errors_) seen[i] = {placeOfSample(u), 0.0f};
            const light::LightSample sample = light_.sample(receiver.point, u);
            const double towards =
                receiver.hasNormal ? glm::dot(sample.delta, receiver.plane.normal) : 1.0;
            double weight = 1.0;
            if (cosine)
                weight =
                    std::max(0.0, towards / glm::length(sample.delta)) * sample.weight;
            // Not a comparison that NaN could pass: a sample at the receiver itself has
            // no direction.
            if (!(weight >= 0.0)) weight = 0.0;
            total += weight;
            above = above || towards > 0.0;
            if (!(towards > 0.0) || weight == 0.0)
                continue;  // below the horizon: blocked
            ++stats.rays;
            const trace::ChannelVisibility v = options_.method == ShadowMethod::pcf
                                                   ? filtered(receiver, sample)
                                                   : traced(receiver, sample);
            visible += weight * glm::dvec3(v[0], v[1], v[2]);
            if (errors_) seen[i].visibility = mean(v, map_.info().channels);
        }
        if (errors_) error = errorOf(seen, steps_.end[step]);
        if (options_.targetError > 0.0f && error <= options_.targetError) break;
    }
    // All weights may vanish in the distance; below the horizon all is dark.
    if (!(total > 0.0)) return {glm::vec3(above ? 0.0f : 1.0f), error};
    return {glm::vec3(glm::clamp(1.0 - visible / total, 0.0, 1.0)), error};
}

/// Sorts what was seen.
float Query::errorOf(SeenSample* seen, std::uint32_t samples) const noexcept {
    if (light_.isPoint()) return 0.0f;
    std::sort(seen, seen + samples,
              [](const SeenSample& a, const SeenSample& b) { return a.place < b.place; });
    Seen sums;
    for (std::uint32_t first = 0; first < samples; first += kQuad) {
        const int count = std::min(kQuad, int(samples - first));
        float quad[kQuad] = {};
        for (int i = 0; i < count; ++i) {
            const float v = quad[i] = seen[first + std::uint32_t(i)].visibility;
            sums.sum += v;
            sums.squares += v * v;
        }
        sums.spread += quadSpread(quad, count);
    }
    return sampleError(sums, 0, samples);
}

trace::ChannelVisibility Query::traced(const Receiver& receiver,
                                       const light::LightSample& sample) const noexcept {
    if (rays_) return tracedWithoutLayers(receiver, sample);
    trace::Ray ray;
    ray.origin = receiver.point;
    ray.delta = sample.delta;
    if (sample.endless) ray.tEnd = HUGE_VAL;
    if (!receiver.hasNormal) {
        const double length = glm::length(sample.delta);
        if (!(length > 0.0)) return {1.0f, 1.0f, 1.0f};
        ray.tSurfaces = receiver.surfaceStart / length;
        ray.tBegin = media_ ? receiver.mediaStart / length : ray.tSurfaces;
    }
    return trace::traceRay(map_, ray, traceOptions(receiver));
}

/// Whether there is a normal or not, rays start away from the receiver's own surface.
trace::ChannelVisibility Query::tracedWithoutLayers(
    const Receiver& receiver, const light::LightSample& sample) const noexcept {
    const double length = glm::length(sample.delta);
    if (!(length > 0.0)) return {1.0f, 1.0f, 1.0f};
    const double start =
        media_ && !receiver.hasNormal ? receiver.mediaStart : receiver.surfaceStart;
    ShadowRay ray;
    ray.direction = sample.delta / length;
    ray.origin = receiver.point + start * ray.direction;
    ray.length = sample.endless ? HUGE_VAL : length - start;
    glm::vec3 visible;
    rays_->look(&ray, 1, &visible);
    return {visible.x, visible.y, visible.z};
}

trace::TraceOptions Query::traceOptions(const Receiver& receiver) const noexcept {
    trace::TraceOptions options;
    options.bias = bias_;
    options.threshold = thresholdOf(options_.threshold);
    options.attenuation = options_.attenuation;
    if (receiver.hasNormal) options.plane = &receiver.plane;
    return options;
}

/// Is the point outside the view from the light's centre, with the window that the map
/// has?
bool Query::mayBeTruncated(glm::dvec3 point) const noexcept {
    if (map_.faceCount() > 1) return false;
    const Projection& p = map_.projection(0);
    glm::dvec3 q = p.lightFromWorld(point);
    if (p.kind == ProjectionKind::perspective) {
        q -= p.lightFromWorld(light_.centre());
        if (!(q.z > 0.0)) return true;
    }
    const glm::dvec2 r = p.rasterFromLight(q);
    return !(r.x >= 0.0 && r.y >= 0.0 && r.x <= map_.info().width &&
             r.y <= map_.info().height);
}

glm::vec3 visibilityByDefinition(const ShadowMap& map, const ShadowRay& ray,
                                 const RayOptions& options) noexcept {
    if (!isRay(ray)) return glm::vec3(1.0f);
    trace::Ray traced;
    traced.origin = ray.origin;
    traced.delta = ray.direction;
    traced.tEnd = ray.length;
    trace::TraceOptions traceOptions;
    traceOptions.bias = biasOf(map, options.bias);
    traceOptions.threshold = thresholdOf(options.threshold);
    traceOptions.attenuation = options.attenuation;
    const trace::ChannelVisibility v = trace::traceRay(map, traced, traceOptions);
    return {v[0], v[1], v[2]};
}

}  // namespace mtsm::shadow
