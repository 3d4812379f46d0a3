// quality.h: errors of maps as measured, and how many samples a batch needs.
#include "mtsm/quality.h"

#include <algorithm>
#include <cmath>
#include <new>
#include <random>
#include <vector>

#include "light/sample.h"
#include "shadow/query.h"
#include "shadow/sample_error.h"

namespace mtsm {
namespace {

/// What maps of a kind were measured to have: the mean over a picture at 1024 x 1024, and
/// the power of the resolution by which it falls. Beyond `best` it does not.
struct KindError {
    float error, power;
    std::uint32_t best = kMaxResolution;
};
KindError errorOf(MapKind kind) noexcept {
    switch (kind) {
        case MapKind::nearField:
            return {0.0008f, 1.2f};
        case MapKind::nearSheets:
            return {0.0016f, 0.75f, 512};
        case MapKind::nearHair:
            return {0.003f, 0.65f, 512};
        case MapKind::volume:
            return {0.0004f, 1.0f};
        case MapKind::sheets:
            return {0.009f, 0.75f};
        case MapKind::surfaces:
            return {0.011f, 0.7f};
        default:
            return {0.018f, 0.65f};
    }
}

constexpr float kWidestStrand = 4.0f;  // pixels

constexpr std::uint32_t kResolutions[] = {256, 512, 1024, 2048, 4096};
/// The smallest and the largest of them that are chosen. Beyond, maps of a kind were
/// little better, or too large.
struct Choice {
    std::uint32_t least, most;
};
Choice choiceFor(MapKind kind, const CasterMeasures& casters, float meanError) noexcept {
    if (kind == MapKind::nearSheets || kind == MapKind::nearHair) {
        std::uint32_t one = meanError > 0.01f ? 512 : meanError < 0.005f ? 2048 : 1024;
        // Strands of many pixels have no more of it, and take the more layers.
        while (one > 512 && casters.strandWidth * float(one) > kWidestStrand)
            one /= 2;
        return {one, one};
    }
    return {kind == MapKind::volume ? 256u : 512u,
            kind == MapKind::surfaces ? 4096u : 2048u};
}

/// Bytes that a triangle of a near field takes, a little more than it does.
constexpr std::uint64_t kTriangleBytes = 24, kSheetBytes = 40;
constexpr std::uint64_t kUsualNearField = std::uint64_t(64) << 20;
constexpr std::uint64_t kMostNearField = std::uint64_t(1) << 30;

/// The share of an error that samples get in any case.
constexpr float kSamplesShare = 0.5f;
/// And of what they get, what they are planned to use: points that stop are more often
/// those whose error was told too small, and a part of them tells no more of all.
constexpr float kCareful = 0.7f;

/// A part of a batch that stands for all of it: runs of neighbours, one anywhere in each
/// of as many stretches, lest all of them lie in the same columns of a picture.
class Pilot {
  public:
    Pilot(const glm::dvec3* points, const glm::dvec3* normals, std::size_t count) {
        constexpr std::size_t kRun = 16, kFewest = 32, kMost = 64;
        const std::size_t all = (count + kRun - 1) / kRun;
        const std::size_t runs = std::min(all, std::clamp(all / 8, kFewest, kMost));
        std::mt19937 random;
        for (std::size_t r = 0; r < runs; ++r) {
            std::size_t first = count / runs * r;
            const std::size_t next = r + 1 < runs ? count / runs * (r + 1) : count;
            if (next - first > kRun) first += random() % (next - first - kRun + 1);
            for (std::size_t i = first; i < std::min(next, first + kRun); ++i) {
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
        options.pointsPerPixel = 1;  // of pixels there are single points here
        options.pixelPoints = nullptr;
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

using shadow::SampleSteps;

/// What is left of an error after the step from `before` to `after` samples. Four times
/// as many make one along an edge 2.8 times smaller, one where blockers are finer, 2: it
/// is taken to be 2.4, which is 4 to this power.
float shrink(std::uint32_t before, std::uint32_t after) noexcept {
    constexpr float kPower = 0.63f;
    return std::pow(float(before) / float(after), kPower);
}

/// The steps of points that take up to `most` samples.
SampleSteps stepsOf(int first, int most) noexcept {
    ShadowOptions options;
    options.firstSamples = first;
    options.targetError = 1.0f;
    return SampleSteps::of(options, std::uint32_t(most));
}

/// Where a point stops that has this error after the first step.
struct Stop {
    std::uint32_t samples;
    float error;
};
Stop stopOf(float error, float bound, const SampleSteps& steps) noexcept {
    int step = 0;
    for (; error > bound && step + 1 < steps.count; ++step)
        error *= shrink(steps.end[step], steps.end[step + 1]);
    return {steps.end[step], error};
}

/// The mean of what errors come to where points take samples until they are below
/// `bound`.
double meanBelow(const std::vector<float>& errors, float bound,
                 const SampleSteps& steps) noexcept {
    double sum = 0.0;
    for (float error : errors)
        sum += stopOf(error, bound, steps).error;
    return sum / double(errors.size());
}

/// The largest bound for which that mean is at most `budget`; 0: there is none.
float boundFor(const std::vector<float>& errors, float budget,
               const SampleSteps& steps) noexcept {
    float low = 1e-5f, high = 0.5f;
    if (meanBelow(errors, high, steps) <= budget) return high;
    if (meanBelow(errors, low, steps) > budget) return 0.0f;
    for (int i = 0; i < 24; ++i) {
        const float middle = std::sqrt(low * high);
        (meanBelow(errors, middle, steps) <= budget ? low : high) = middle;
    }
    return low;
}

/// Up to how many samples points take, and the error below which they stop before.
struct Bounded {
    int samples = 0;
    float bound = 0.0f;
};

/// The fewest samples that bring the mean of errors down to `budget`, `most` if nothing
/// does. `errors` are those of `first` samples.
Bounded fewestFor(std::vector<float>& errors, float budget, int first,
                  int most) noexcept {
    const bool once = most < 2 * first;  // that is no first step
    if (once) {
        for (float& error : errors)
            error *= shrink(std::uint32_t(first), std::uint32_t(most));
    }
    Bounded best{most, 1e-5f};
    double fewest = HUGE_VAL;
    // What lies between two powers of four is for the points of most error: their last
    // step is shorter.
    for (int samples = once ? most : first;; samples = std::min(2 * samples, most)) {
        const SampleSteps steps = stepsOf(first, samples);
        const float bound = boundFor(errors, budget, steps);
        double sum = 0.0;
        for (float error : errors)
            sum += stopOf(error, bound, steps).samples;
        if (bound > 0.0f && sum < fewest) {
            fewest = sum;
            best = {samples, bound};
        }
        if (samples == most) return best;
    }
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
    bool triangles = false, sheets = false, hair = false;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        triangles = triangles || !map.nearField(face).empty();
        sheets = sheets || !map.nearSheets(face).empty();
        hair = hair || !map.nearHair(face).empty();
    }
    // Six faces' strands are not asked for (shadow/bundle_query.h).
    if (hair) return map.faceCount() == 1 ? MapKind::nearHair : MapKind::hair;
    if (sheets) return MapKind::nearSheets;
    if (map.isOpaque()) return triangles ? MapKind::nearField : MapKind::surfaces;
    if (map.info().translucent == Translucent::sheets) return MapKind::sheets;
    return shadow::mediaStartOf(map) == 0.0 ? MapKind::volume : MapKind::hair;
}

float mapError(MapKind kind, std::uint32_t resolution) noexcept {
    const KindError e = errorOf(kind);
    const float pixels = float(std::clamp(resolution, 1u, e.best));
    return e.error * std::pow(float(std::min(e.best, 1024u)) / pixels, e.power);
}

float mapError(const ShadowMap& map) noexcept {
    if (map.layerCount() == 0) return 0.0f;
    return mapError(kindOf(map), std::min(map.info().width, map.info().height));
}

namespace {

/// Kind and near field for casters; the kind without one where it would be too large, or
/// of no use.
void chooseKind(const CasterMeasures& casters, const MapForm& form,
                MapSettings& settings) noexcept {
    const bool opaque = !casters.letThrough && !casters.volumes;
    const bool sheets = casters.letThrough && !casters.volumes && !casters.strands;
    const std::uint64_t bytes = sheets ? kSheetBytes : kTriangleBytes;
    const bool fits = form.nearField && casters.triangles <= kMostNearField / bytes;
    if (opaque && !casters.strands) {
        settings.kind = fits ? MapKind::nearField : MapKind::surfaces;
        if (fits)
            settings.nearField = std::max(kUsualNearField, casters.triangles * bytes);
    } else if (fits && !form.cube && (opaque || (sheets && !form.color))) {
        settings.kind = sheets ? MapKind::nearSheets : MapKind::nearHair;
        settings.nearField = kMostNearField;
    } else {
        settings.kind = casters.strands     ? MapKind::hair
                        : casters.triangles ? MapKind::sheets
                                            : MapKind::volume;
    }
}

}  // namespace

MapSettings mapSettingsFor(const CasterMeasures& casters, float meanError,
                           const MapForm& form) noexcept {
    MapSettings settings;
    settings.tolerance = std::clamp(meanError, 0.002f, 0.02f);
    chooseKind(casters, form, settings);
    const float budget = meanError * (1.0f - kSamplesShare);
    const Choice choice = choiceFor(settings.kind, casters, meanError);
    for (const std::uint32_t resolution : kResolutions) {
        if (resolution < choice.least) continue;
        if (resolution > choice.most) break;
        settings.resolution = resolution;
        settings.error = mapError(settings.kind, resolution);
        settings.reached = settings.error <= budget;
        if (settings.reached) break;
    }
    return settings;
}

namespace {

/// What a part of a batch, asked twice, tells.
QueryPlan planBy(const Pilot& pilot, const ShadowMap& map, const AreaLight& light,
                 float meanError, QueryPlan plan) {
    const ShadowOptions asked = plan.options;
    const float budget = std::max(meanError - plan.mapError, kSamplesShare * meanError);
    Pilot::Found few = pilot.ask(map, light, asked, 16);
    Pilot::Found more = pilot.ask(map, light, asked, 64);
    // What stays unseen where 16 samples see the same; of 64, that is a quarter.
    double unseen = 0.0;
    for (std::size_t i = 0; i < few.errors.size(); ++i)
        if (few.errors[i] == 0.0f) unseen += std::abs(few.factors[i] - more.factors[i]);
    unseen /= double(few.errors.size());
    plan.options.firstSamples = 16;
    std::vector<float>* errors = &few.errors;
    if (unseen > 0.25 * budget) {
        plan.options.firstSamples = 64;
        errors = &more.errors;
        unseen *= 0.25;
    }
    const int first = plan.options.firstSamples;
    const Bounded fewest = fewestFor(*errors, float(kCareful * budget - unseen), first,
                                     std::clamp(asked.samples, 1, kMaxSamples));
    plan.options.adaptive = false;
    plan.options.targetError = fewest.bound;
    plan.options.samples = fewest.samples;
    plan.sampleError =
        float(unseen + meanBelow(*errors, fewest.bound, stepsOf(first, fewest.samples)));
    plan.reached = plan.sampleError + plan.mapError <= 1.0001f * meanError;
    return plan;
}

}  // namespace

QueryPlan planQueries(const ShadowMap& map, const AreaLight& light,
                      const glm::dvec3* points, const glm::dvec3* normals,
                      std::size_t count, float meanError,
                      const ShadowOptions& options) noexcept {
    QueryPlan plan{options, mapError(map), 0.0f, false};
    if (count == 0) return plan;
    if (light::LightSampler(light).isPoint()) {
        plan.options.adaptive = false;
        plan.options.targetError = 0.0f;
        plan.options.samples = 1;
        plan.reached = plan.mapError <= meanError;
        return plan;
    }
    try {
        return planBy(Pilot(points, normals, count), map, light, meanError, plan);
    } catch (const std::bad_alloc&) {
        return plan;
    }
}

}  // namespace mtsm
