// shadow.h: single queries, batches, rays.
#include "mtsm/shadow.h"

#include <hwy/cache_control.h>
#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <utility>
#include <vector>

#include "base/finite.h"
#include "base/message.h"
#include "base/parallel.h"
#include "shadow/bundle_query.h"
#include "shadow/map_faces.h"
#include "shadow/query.h"
#include "shadow/ray_query.h"
#include "shadow/receiver_order.h"
#include "trace/density_tree.h"
#include "trace/fits_trees.h"
#include "trace/patch_tree.h"

namespace mtsm {
namespace {

using base::makeError;
using shadow::Answer;

constexpr std::size_t kPointsPerTask = 256;

void add(QueryStats& total, const QueryStats& part) {
    total.points += part.points;
    total.rays += part.rays;
    total.notFinite += part.notFinite;
    total.behindLight += part.behindLight;
    total.mayBeTruncated += part.mayBeTruncated;
}

/// What a batch asks.
struct Batch {
    const ShadowMap& map;
    const AreaLight& light;
    const glm::dvec3* points;
    const glm::dvec3* normals;  ///< null: there are none
    std::size_t count;
    std::size_t first;  ///< the first point's number among the caller's
    const ShadowOptions& options;
    bool errors;

    [[nodiscard]] glm::dvec3 normal(std::size_t i) const {
        return normals ? normals[i] : glm::dvec3(0.0);
    }
    /// Sets a receiver as bundles take it. (In place: by value batches of few samples
    /// take up to a fifth longer.)
    void set(shadow::Receiver& receiver, std::size_t i) const {
        receiver.point = points[i];
        const glm::dvec3 n = normal(i);
        receiver.normal = shadow::saysSomething(n) ? n : glm::dvec3(0.0);
    }
    [[nodiscard]] Batch part(std::size_t from, std::size_t size) const {
        Batch b = *this;
        b.points += from;
        if (normals) b.normals += from;
        b.count = size;
        b.first += from;
        return b;
    }
};

/// Hands the answer about point i to take(i, answer), for all points, one by one.
template <typename Take>
void answerEach(const shadow::Query& query, const Batch& batch, QueryStats& stats,
                const Take& take) {
    std::mutex mutex;
    const auto answer = [&](std::size_t begin, std::size_t end) {
        QueryStats part;
        for (std::size_t i = begin; i < end; ++i)
            take(i, query.shadowFactor(batch.first + i, batch.points[i], batch.normal(i),
                                       part));
        const std::lock_guard lock(mutex);
        add(stats, part);
    };
    base::parallelRanges(std::size_t(0), batch.count, kPointsPerTask, answer);
}

/// Points of a batch; those of which a step does not tell enough are put together anew.
template <typename Take>
class Groups {
  public:
    using Receiver = shadow::Receiver;
    Groups(const shadow::BundleQuery& bundles, QueryStats& stats, const Take& take)
        : bundles_(bundles), stats_(stats), take_(take) {}

    /// Up to 16 of them: all with normals, or none.
    void add(const Receiver* receivers, const std::size_t* points, std::size_t count) {
        shadow::BundleQuery::Sums sums[trace::kMostReceivers];
        look(0, receivers, points, sums, count);
    }

    /// The points that still wait.
    void finish() {
        for (int step = 1; step < bundles_.steps(); ++step)
            follow(step);
    }

  private:
    /// Points whose next step is the same.
    struct Waiting {
        Receiver receivers[trace::kMostReceivers];
        std::size_t points[trace::kMostReceivers];
        shadow::BundleQuery::Sums sums[trace::kMostReceivers];
        std::size_t count = 0;
    };

    void look(int step, const Receiver* receivers, const std::size_t* points,
              shadow::BundleQuery::Sums* sums, std::size_t count) {
        bundles_.look(receivers, int(count), step, sums, stats_);
        for (std::size_t k = 0; k < count; ++k) {
            if (step + 1 >= shadow::SampleSteps::kMost ||
                bundles_.isEnough(sums[k], step))
                take_(points[k], bundles_.answerOf(sums[k], step));
            else
                wait(step + 1, receivers[k], points[k], sums[k]);
        }
    }

    void wait(int step, const Receiver& receiver, std::size_t point,
              const shadow::BundleQuery::Sums& sums) {
        Waiting& w = waiting_[step];
        // Those that wait have normals as well, or none has; and are of the same face.
        if (w.count > 0 &&
            (shadow::saysSomething(receiver.normal) !=
                 shadow::saysSomething(w.receivers[0].normal) ||
             bundles_.faceOf(receiver.point) != bundles_.faceOf(w.receivers[0].point)))
            follow(step);
        w.receivers[w.count] = receiver;
        w.points[w.count] = point;
        w.sums[w.count++] = sums;
        if (w.count == trace::kMostReceivers) follow(step);
    }

    void follow(int step) {
        Waiting& w = waiting_[step];
        const std::size_t count = std::exchange(w.count, 0);
        if (count > 0) look(step, w.receivers, w.points, w.sums, count);
    }

    const shadow::BundleQuery& bundles_;
    QueryStats& stats_;
    const Take& take_;
    Waiting waiting_[shadow::SampleSteps::kMost];  // [step]; of the first nobody does
};

/// Has the points of the next runs brought into the cache, a few at a time while others
/// are answered: in their order they lie anywhere.
class Ahead {
  public:
    Ahead(const Batch& batch, const shadow::ReceiverOrder& order, std::size_t begin,
          std::size_t end)
        : batch_(batch), order_(order), next_(begin), end_(end) {}

    [[nodiscard]] std::size_t left() const { return end_ - next_; }
    void fetch(std::size_t runs) {
        for (const std::size_t to = next_ + std::min(runs, left()); next_ < to; ++next_) {
            const shadow::ReceiverOrder::Run run = order_[next_];
            // Two points and their normals for each line of the cache, about.
            for (std::size_t i = run.point; i < run.point + run.count; i += 2) {
                hwy::Prefetch(batch_.points + i);
                if (batch_.normals) hwy::Prefetch(batch_.normals + i);
            }
        }
    }

  private:
    const Batch& batch_;
    const shadow::ReceiverOrder& order_;
    std::size_t next_, end_;
};

/// Says when something that is often worth its cost is to be tried: after failures less
/// and less often.
class Worth {
  public:
    [[nodiscard]] bool isDue() { return wait_ == 0 || --wait_ == 0; }
    void learn(bool success) {
        constexpr int kMost = 15;
        pause_ = success ? 0 : std::min(2 * pause_ + 1, kMost);
        wait_ = pause_ > 0 ? pause_ + 1 : 0;
    }

  private:
    int pause_ = 0, wait_ = 0;
};

/// Of points as they come: answers those of whom a glance tells enough, which need not be
/// put in order. The keys of the others, with kLeftOut for what is answered.
template <typename Take>
std::vector<std::uint32_t> answerAtSight(const shadow::Query& query,
                                         const shadow::BundleQuery& bundles,
                                         const Batch& batch, QueryStats& stats,
                                         const Take& take) {
    using shadow::ReceiverOrder;
    using Glance = shadow::BundleQuery::Glance;
    constexpr std::size_t kPerTask = 4096, kMost = shadow::BundleQuery::kMostGlances;
    const Answer lit = bundles.answerOf(Glance::lit);
    const Answer dark = bundles.answerOf(Glance::dark);
    std::vector<std::uint32_t> keys(batch.count);
    std::mutex mutex;
    base::parallelRanges(
        std::size_t(0), batch.count, kPerTask, [&](std::size_t begin, std::size_t end) {
            QueryStats part;
            Worth worth;
            shadow::Receiver receivers[kMost];
            Glance told[kMost];
            for (std::size_t first = begin; first < end; first += kMost) {
                const std::size_t some = std::min(kMost, end - first);
                ReceiverOrder::findKeys(bundles, batch.points + first,
                                        batch.normals ? batch.normals + first : nullptr,
                                        some, &keys[first]);
                // Few are done as soon by their rays.
                const std::size_t alike =
                    ReceiverOrder::alike(bundles, &keys[first], some);
                if (alike < std::size_t(trace::kMostReceivers) || !worth.isDue())
                    continue;
                for (std::size_t k = 0; k < alike; ++k)
                    batch.set(receivers[k], first + k);
                bundles.glance(receivers, int(alike), told, part);
                std::size_t answered = 0;
                for (std::size_t k = 0; k < alike; ++k) {
                    if (told[k] == Glance::unknown) continue;
                    query.count(receivers[k].point, part);
                    take(first + k, told[k] == Glance::lit ? lit : dark);
                    keys[first + k] = ReceiverOrder::kLeftOut;
                    ++answered;
                }
                worth.learn(answered > alike / 8);
            }
            const std::lock_guard lock(mutex);
            add(stats, part);
        });
    return keys;
}

/// Answers all points by bundles, neighbours together.
template <typename Take>
void answerGroups(const shadow::Query& query, const shadow::BundleQuery& bundles,
                  const Batch& batch, QueryStats& stats, const Take& take) {
    const shadow::ReceiverOrder order(bundles,
                                      answerAtSight(query, bundles, batch, stats, take),
                                      batch.first, batch.options);
    if (order.runs() == 0) return;
    using Glance = shadow::BundleQuery::Glance;
    const Answer lit = bundles.answerOf(Glance::lit);
    const Answer dark = bundles.answerOf(Glance::dark);
    std::mutex mutex;
    const auto answer = [&](std::size_t begin, std::size_t end) {
        constexpr int kMost = shadow::BundleQuery::kMostGlances;
        QueryStats part;
        Groups groups(bundles, part, take);
        Worth worth;
        shadow::Receiver receivers[kMost];
        std::size_t indices[kMost];
        Glance told[kMost];
        for (std::size_t first = begin; first < end;) {
            const shadow::ReceiverOrder::Block block =
                order.block(first, end, std::size_t(kMost));
            std::size_t count = 0;
            for (std::size_t run = first; run < first + block.runs; ++run) {
                const shadow::ReceiverOrder::Run points = order[run];
                if (batch.options.pixelPoints)  // which setPatterns() will ask
                    hwy::Prefetch(batch.options.pixelPoints + batch.first + points.point);
                for (std::size_t i = points.point; i < points.point + points.count; ++i) {
                    indices[count] = i;
                    batch.set(receivers[count++], i);
                }
            }
            first += block.runs;
            constexpr std::size_t kAtOnce = 32;
            Ahead ahead(batch, order, first, std::min(first + block.runs, end));
            ahead.fetch(kAtOnce);
            if (!block.bundled) {
                for (std::size_t k = 0; k < count; ++k)
                    take(indices[k],
                         query.shadowFactor(batch.first + indices[k], receivers[k].point,
                                            receivers[k].normal, part));
                continue;
            }
            for (std::size_t k = 0; k < count; ++k)
                query.count(receivers[k].point, part);
            const bool due = worth.isDue();
            if (due)
                bundles.glance(receivers, int(count), told, part);
            else
                std::fill_n(told, count, Glance::unknown);
            // The others close ranks.
            std::size_t left = 0;
            for (std::size_t k = 0; k < count; ++k) {
                if (told[k] != Glance::unknown) {
                    take(indices[k], told[k] == Glance::lit ? lit : dark);
                    continue;
                }
                receivers[left] = receivers[k];
                indices[left++] = indices[k];
            }
            if (due) worth.learn(count - left > count / 8);
            bundles.setPatterns(batch.first, indices, left, receivers);
            constexpr auto kGroup = std::size_t(trace::kMostReceivers);
            for (std::size_t k = 0; k < left; k += kGroup) {
                ahead.fetch(ahead.left() * kGroup / (left - k) + 1);
                groups.add(receivers + k, indices + k, std::min(left - k, kGroup));
            }
        }
        groups.finish();
        const std::lock_guard lock(mutex);
        add(stats, part);
    };
    const std::size_t perRun = (order.points() + order.runs() - 1) / order.runs();
    base::parallelRanges(std::size_t(0), order.runs(),
                         std::max(kPointsPerTask / perRun, std::size_t(1)), answer);
}

/// Many points at once.
template <typename Take>
void answerBundles(const shadow::Query& query, const Batch& batch, QueryStats& stats,
                   const Take& take) {
    // What a point that is not finite is asked with does not matter.
    const shadow::Receiver only{batch.points[0], shadow::unitNormal(batch.normal(0))};
    const shadow::BundleQuery bundles(batch.map, batch.light, batch.options, batch.errors,
                                      batch.count == 1 ? &only : nullptr, batch.first);
    constexpr std::size_t kAtOnce = shadow::ReceiverOrder::kMostPoints;
    for (std::size_t first = 0; first < batch.count; first += kAtOnce) {
        answerGroups(
            query, bundles, batch.part(first, std::min(kAtOnce, batch.count - first)),
            stats, [&](std::size_t i, const Answer& answer) { take(first + i, answer); });
    }
}

/// One after another, which by ray needs no memory. A point alone needs little: a map
/// without layers, whose rays know no normals, has it tried.
template <typename Take>
void answerInTurn(const shadow::Query& query, const Batch& batch, QueryStats& stats,
                  const Take& take) {
    const bool bundles =
        !batch.map.hasLayers() &&
        shadow::BundleQuery::serves(batch.map, batch.light, batch.options);
    for (std::size_t i = 0; i < batch.count; ++i) {
        try {
            if (bundles) {
                answerBundles(
                    query, batch.part(i, 1), stats,
                    [&](std::size_t, const Answer& answer) { take(i, answer); });
                continue;
            }
        } catch (const std::bad_alloc&) {  // by ray, then
        }
        take(i, query.shadowFactor(batch.first + i, batch.points[i], batch.normal(i),
                                   stats));
    }
}

/// What is asked of a map without layers: there are only its trees.
template <typename Options>
Options served(const ShadowMap& map, Options options) {
    if (map.hasLayers()) return options;
    options.method = ShadowMethod::trace;
    options.attenuation = Attenuation::multiply;
    return options;
}

template <typename Take>
void answerAll(const ShadowMap& map, const AreaLight& light, const glm::dvec3* points,
               const glm::dvec3* normals, std::size_t count, const ShadowOptions& asked,
               QueryStats* stats, bool errors, const Take& take) noexcept {
    if (count == 0) return;
    ShadowOptions options = served(map, asked);
    options.pointsPerPixel = std::clamp(options.pointsPerPixel, 1, kMaxPointsPerPixel);
    const Batch batch{map, light, points, normals, count, 0, options, errors};
    const shadow::Query query(map, light, options, errors);
    QueryStats met;
    try {
        if (shadow::BundleQuery::serves(map, light, options))
            answerBundles(query, batch, met, take);
        else
            answerEach(query, batch, met, take);
    } catch (const std::bad_alloc&) {
        met = {};
        answerInTurn(query, batch, met, take);
    }
    if (stats) add(*stats, met);
}

/// Hands the visibilities of ray i to take(i, visibilities), for all rays.
template <typename Take>
void answerRays(const ShadowMap& map, const ShadowRay* rays, std::size_t count,
                const RayOptions& asked, const Take& take) noexcept {
    const RayOptions options = served(map, asked);
    const auto byDefinition = [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            take(i, shadow::visibilityByDefinition(map, rays[i], options));
    };
    std::optional<shadow::RayQuery> query;
    const auto throughTrees = [&](std::size_t begin, std::size_t end) {
        glm::vec3 visible[shadow::RayQuery::kAtOnce];
        query->look(rays + begin, end - begin, visible);
        for (std::size_t i = begin; i < end; ++i)
            take(i, visible[i - begin]);
    };
    try {
        if (!shadow::RayQuery::serves(map, options)) {
            base::parallelRanges(std::size_t(0), count, kPointsPerTask, byDefinition);
            return;
        }
        query.emplace(map, options);
        if (count <= 1) return throughTrees(0, count);
        const std::vector<std::size_t> begin = shadow::RayQuery::beginnings(rays, count);
        base::parallelFor(std::size_t(1), begin.size(),
                          [&](std::size_t i) { throughTrees(begin[i - 1], begin[i]); });
    } catch (const std::bad_alloc&) {
        if (map.hasLayers()) return byDefinition(0, count);
        for (std::size_t i = 0; i < count; ++i)
            throughTrees(i, i + 1);
    }
}

/// What queries of the map go through, made if need be.
bool hasTrees(const ShadowMap& map) {
    try {
        return shadow::hasTrees(map, Attenuation::multiply, trace::DensityUse::receivers);
    } catch (const std::bad_alloc&) {
        return false;
    }
}

}  // namespace

void prepareQueries(const ShadowMap& map) noexcept {
    (void)hasTrees(map);
}

std::uint64_t queryMemoryBytes(const ShadowMap& map) noexcept {
    std::uint64_t bytes = map.memoryBytes();
    if (!hasTrees(map)) return bytes;
    if (map.isOpaque()) {
        for (const trace::PatchTree& tree : *trace::patchTrees(map))
            bytes += tree.memoryBytes();
    } else {
        bytes += trace::densityTreeBytes(map);
    }
    return bytes;
}

Status releaseLayers(ShadowMap& map) noexcept {
    if (!map.hasLayers() || map.layerCount() == 0) return {};
    std::shared_ptr<base::Lazy> queryData;
    try {
        if (!trace::fitsTrees(map))
            return makeError(ErrorCode::unsupported, "queries of a map with ",
                             map.layerCount(), " layers in ", map.faceCount(),
                             " faces go through its layers, which stay: they can go of "
                             "maps with at most ",
                             trace::kMostLayers,
                             " layers and one face or the six of a cube");
        if (!hasTrees(map))
            return makeError(ErrorCode::tooLarge, "not enough memory for the trees over ",
                             map.layerCount(),
                             " layers: the layers stay, and queries go "
                             "through them, slowly");
        if (!map.isOpaque()) queryData = trace::densityTreesAlone(map);
    } catch (const std::bad_alloc&) {  // for the message
        return Error{ErrorCode::tooLarge, "out of memory"};
    }
    map.dropLayers();
    if (queryData) map.queryData_ = std::move(queryData);
    return {};
}

Status checkQuery(const ShadowMap& map, const AreaLight& light,
                  const ShadowOptions& options) {
    if (options.samples < 1 || options.samples > kMaxSamples)
        return makeError(ErrorCode::badArgument, options.samples,
                         " samples: must be 1 to ", kMaxSamples);
    if (options.pointsPerPixel < 1 || options.pointsPerPixel > kMaxPointsPerPixel)
        return makeError(ErrorCode::badArgument, options.pointsPerPixel,
                         " points per pixel: must be 1 to ", kMaxPointsPerPixel);
    if (!std::isfinite(options.bias))
        return makeError(ErrorCode::badArgument, "bias ", options.bias, " is not finite");
    if (!(options.threshold >= 0.0f && options.threshold < 1.0f))
        return makeError(ErrorCode::badArgument, "threshold ", options.threshold,
                         " must be in [0, 1)");
    if (!(options.targetError >= 0.0f && options.targetError <= 1.0f))
        return makeError(ErrorCode::badArgument, "target error ", options.targetError,
                         " must be in [0, 1]");
    const bool subtracts =
        options.attenuation == Attenuation::subtract && !map.isOpaque();
    if (!map.hasLayers() && (options.method != ShadowMethod::trace || subtracts))
        return makeError(ErrorCode::badArgument,
                         "the map's layers were released, and only queries by trace with "
                         "attenuation multiply go without them: read the map again");
    return lightFits(light, map.info().light);
}

glm::vec3 shadowFactorColor(const ShadowMap& map, const AreaLight& light,
                            glm::dvec3 point, glm::dvec3 normal,
                            const ShadowOptions& options) noexcept {
    ShadowOptions alone = options;
    alone.pointsPerPixel = 1;
    alone.pixelPoints = nullptr;
    glm::vec3 factor;
    shadowFactorsColor(map, light, &point, &normal, 1, &factor, alone);
    return factor;
}

float shadowFactor(const ShadowMap& map, const AreaLight& light, glm::dvec3 point,
                   glm::dvec3 normal, const ShadowOptions& options) noexcept {
    return shadow::mean(shadowFactorColor(map, light, point, normal, options),
                        map.info().channels);
}

void shadowFactorsColor(const ShadowMap& map, const AreaLight& light,
                        const glm::dvec3* points, const glm::dvec3* normals,
                        std::size_t count, glm::vec3* out, const ShadowOptions& options,
                        QueryStats* stats, float* errors) noexcept {
    answerAll(map, light, points, normals, count, options, stats, errors != nullptr,
              [&](std::size_t i, const Answer& answer) {
                  out[i] = answer.factors;
                  if (errors) errors[i] = answer.error;
              });
}

void shadowFactors(const ShadowMap& map, const AreaLight& light, const glm::dvec3* points,
                   const glm::dvec3* normals, std::size_t count, float* out,
                   const ShadowOptions& options, QueryStats* stats,
                   float* errors) noexcept {
    answerAll(map, light, points, normals, count, options, stats, errors != nullptr,
              [&](std::size_t i, const Answer& answer) {
                  out[i] = shadow::mean(answer.factors, map.info().channels);
                  if (errors) errors[i] = answer.error;
              });
}

glm::vec3 visibilityColor(const ShadowMap& map, const ShadowRay& ray,
                          const RayOptions& options) noexcept {
    glm::vec3 visible;
    visibilitiesColor(map, &ray, 1, &visible, options);
    return visible;
}

float visibility(const ShadowMap& map, const ShadowRay& ray,
                 const RayOptions& options) noexcept {
    return shadow::mean(visibilityColor(map, ray, options), map.info().channels);
}

void visibilitiesColor(const ShadowMap& map, const ShadowRay* rays, std::size_t count,
                       glm::vec3* out, const RayOptions& options) noexcept {
    answerRays(map, rays, count, options,
               [&](std::size_t i, glm::vec3 v) { out[i] = v; });
}

void visibilities(const ShadowMap& map, const ShadowRay* rays, std::size_t count,
                  float* out, const RayOptions& options) noexcept {
    answerRays(map, rays, count, options, [&](std::size_t i, glm::vec3 v) {
        out[i] = shadow::mean(v, map.info().channels);
    });
}

}  // namespace mtsm
