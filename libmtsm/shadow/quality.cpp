// quality.h: errors of maps as measured, and how many samples a batch needs.
#include "mtsm/quality.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "light/sample.h"

namespace mtsm {
namespace {

/// What maps of a kind were measured to have: the mean over a picture at 1024 x 1024, and
/// the power of the resolution by which it falls.
struct KindError {
    float at1024, power;
};
KindError errorOf(MapKind kind) noexcept {
    switch (kind) {
        case MapKind::nearField:
            return {0.0017f, 0.6f};
        case MapKind::volume:
            return {0.001f, 0.5f};
        case MapKind::sheets:
            return {0.009f, 0.75f};
        case MapKind::surfaces:
            return {0.011f, 0.7f};
        default:
            return {0.018f, 0.65f};
    }
}

constexpr std::uint32_t kResolutions[] = {512, 1024, 2048, 4096};
/// Beyond this maps of a kind were little better, or too large.
std::uint32_t mostFor(MapKind kind) noexcept {
    return kind == MapKind::surfaces ? 4096 : 2048;
}

/// Bytes that a triangle of a near field takes, a little more than it does.
constexpr std::uint64_t kTriangleBytes = 24;
constexpr std::uint64_t kUsualNearField = std::uint64_t(64) << 20;
constexpr std::uint64_t kMostNearField = std::uint64_t(1) << 30;

/// The share of an error that samples get in any case.
constexpr float kSamplesShare = 0.5f;
/// And of what they get, what they are planned to use: points that stop are more often
/// those whose error was told too small, and a part of them tells no more of all.
constexpr float kCareful = 0.7f;

/// A part of a batch that stands for all of it: runs of neighbours, spread evenly.
class Pilot {
  public:
    Pilot(const glm::dvec3* points, const glm::dvec3* normals, std::size_t count) {
        constexpr std::size_t kRun = 16, kFewest = 32, kMost = 64;
        const std::size_t all = (count + kRun - 1) / kRun;
        const std::size_t runs = std::min(all, std::clamp(all / 8, kFewest, kMost));
        for (std::size_t r = 0; r < runs; ++r) {
            const std::size_t first = runs > 1 ? r * (count - kRun) / (runs - 1) : 0;
            for (std::size_t i = first; i < std::min(count, first + kRun); ++i) {
                points_.push_back(points[i]);
                if (normals) normals_.push_back(normals[i]);
            }
        }
    }

    struct Found {
        std::vector<float> factors, errors;
    };
    [[nodiscard]] Found ask(const ShadowMap& map, const AreaLight& light,
                            ShadowOptions options, int samples) const {
        options.samples = samples;
        options.adaptive = false;
        options.targetError = 0.0f;
        Found found{std::vector<float>(points_.size()),
                    std::vector<float>(points_.size())};
        shadowFactors(map, light, points_.data(),
                      normals_.empty() ? nullptr : normals_.data(), points_.size(),
                      found.factors.data(), options, nullptr, found.errors.data());
        return found;
    }

  private:
    std::vector<glm::dvec3> points_, normals_;
};

/// Four times as many samples make an error along an edge 2.8 times smaller; where
/// blockers are finer, 2.
constexpr float kShrinks = 2.4f;

/// The mean of what errors come to where points take more samples, from `first` up to
/// `most`, until they are below `bound`.
double meanBelow(const std::vector<float>& errors, float bound, int first, int most) {
    double sum = 0.0;
    for (float error : errors) {
        for (int n = first; error > bound && n < most; n *= 4)
            error /= kShrinks;
        sum += error;
    }
    return sum / double(errors.size());
}

/// The largest bound for which that mean is at most `budget`; 0: there is none.
float boundFor(const std::vector<float>& errors, float budget, int first, int most) {
    float low = 1e-5f, high = 0.5f;
    if (meanBelow(errors, high, first, most) <= budget) return high;
    if (meanBelow(errors, low, first, most) > budget) return 0.0f;
    for (int i = 0; i < 24; ++i) {
        const float middle = std::sqrt(low * high);
        (meanBelow(errors, middle, first, most) <= budget ? low : high) = middle;
    }
    return low;
}

/// Samples that the worst of these points takes. (What is never taken need not be made.)
int mostFor(const std::vector<float>& errors, float bound, int first, int most) {
    int n = first;
    for (float error = *std::max_element(errors.begin(), errors.end());
         error > bound && n < most; n *= 4)
        error /= kShrinks;
    return std::min(n, most);
}

}  // namespace

float meanError(Quality quality) noexcept {
    switch (quality) {
        case Quality::draft:
            return 0.02f;
        case Quality::preview:
            return 0.005f;
        default:
            return 0.001f;
    }
}

MapKind kindOf(const ShadowMap& map) noexcept {
    if (!map.nearField(0).empty()) return MapKind::nearField;
    if (map.isOpaque()) return MapKind::surfaces;
    return map.info().translucent == Translucent::sheets ? MapKind::sheets
                                                         : MapKind::hair;
}

float mapError(MapKind kind, std::uint32_t resolution) noexcept {
    const KindError e = errorOf(kind);
    return e.at1024 * std::pow(1024.0f / float(std::max(resolution, 1u)), e.power);
}

float mapError(const ShadowMap& map) noexcept {
    if (map.layerCount() == 0) return 0.0f;
    return mapError(kindOf(map), std::min(map.info().width, map.info().height));
}

MapSettings mapSettingsFor(const CasterMeasures& casters, float meanError) noexcept {
    MapSettings settings;
    settings.tolerance = std::clamp(meanError, 0.002f, 0.02f);
    const bool opaque = !casters.letThrough && !casters.strands && !casters.volumes;
    const std::uint64_t nearBytes = casters.triangles * kTriangleBytes;
    if (opaque && nearBytes <= kMostNearField) {
        settings.kind = MapKind::nearField;
        settings.nearField = std::max(kUsualNearField, nearBytes);
    } else if (opaque) {
        settings.kind = MapKind::surfaces;
    } else {
        settings.kind = casters.strands     ? MapKind::hair
                        : casters.triangles ? MapKind::sheets
                                            : MapKind::volume;
    }
    const float budget = meanError * (1.0f - kSamplesShare);
    for (const std::uint32_t resolution : kResolutions) {
        if (resolution > mostFor(settings.kind)) break;
        settings.resolution = resolution;
        settings.error = mapError(settings.kind, resolution);
        settings.reached = settings.error <= budget;
        if (settings.reached) break;
    }
    return settings;
}

QueryPlan planQueries(const ShadowMap& map, const AreaLight& light,
                      const glm::dvec3* points, const glm::dvec3* normals,
                      std::size_t count, float meanError,
                      const ShadowOptions& options) noexcept {
    QueryPlan plan{options, mapError(map), 0.0f, true};
    plan.options.adaptive = false;
    plan.options.targetError = 0.0f;
    const float budget = std::max(meanError - plan.mapError, kSamplesShare * meanError);
    if (light::LightSampler(light).isPoint() || count == 0) {
        plan.options.samples = 1;
        plan.reached = plan.mapError <= meanError;
        return plan;
    }
    const Pilot pilot(points, normals, count);
    const Pilot::Found few = pilot.ask(map, light, options, 16);
    const Pilot::Found more = pilot.ask(map, light, options, 64);
    // What stays unseen where 16 samples see the same; of 64, that is a quarter.
    double unseen = 0.0;
    for (std::size_t i = 0; i < few.errors.size(); ++i)
        if (few.errors[i] == 0.0f) unseen += std::abs(few.factors[i] - more.factors[i]);
    unseen /= double(few.errors.size());
    plan.options.firstSamples = 16;
    const std::vector<float>* errors = &few.errors;
    if (unseen > 0.25 * budget) {
        plan.options.firstSamples = 64;
        errors = &more.errors;
        unseen *= 0.25;
    }
    const int first = plan.options.firstSamples, most = options.samples;
    const float bound = std::max(
        1e-5f, boundFor(*errors, float(kCareful * budget - unseen), first, most));
    plan.options.targetError = bound;
    plan.options.samples = mostFor(*errors, bound, first, most);
    plan.sampleError = float(unseen + meanBelow(*errors, bound, first, most));
    plan.reached = plan.sampleError + plan.mapError <= 1.0001f * meanError;
    return plan;
}

}  // namespace mtsm
