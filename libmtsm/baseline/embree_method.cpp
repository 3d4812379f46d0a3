#include "baseline/embree_method.h"

#include <algorithm>
#include <glm/geometric.hpp>
#include <numeric>

#include "base/finite.h"
#include "base/parallel.h"
#include "base/sampling.h"
#include "baseline/methods.h"
#include "baseline/reference_embree.h"
#include "baseline/shadow_rays.h"
#include "mtsm/shadow.h"

namespace mtsm::baseline {
namespace {

constexpr std::uint32_t kSeed = 0x656du;    // not the truth's
constexpr std::size_t kSharingPixels = 16;  // of one point each
constexpr std::size_t kBlock = 64;          // points that a thread takes at once

/// A query with its settings read.
struct Query {
    std::uint32_t samples = 1, most = 1;  // most > samples: adaptive
    std::vector<SamplePattern> shared;    // [points], or empty
    std::vector<std::uint32_t> order, further;
};

class EmbreeMethod final : public Method {
  public:
    explicit EmbreeMethod(EmbreeReference scene) : scene_(std::move(scene)) {}

    [[nodiscard]] std::uint64_t memoryBytes() const noexcept override {
        return scene_.memoryBytes();
    }
    Status shadowFactors(const AreaLight& light, const Receivers& at,
                         const Settings& settings, float* out) const override {
        if (Status fine = checkLight(light); !fine) return fine;
        const light::LightSampler sampler(light);
        Query query;
        if (!sampler.isPoint()) query.samples = std::uint32_t(settings.whole("samples"));
        query.most = query.samples;
        const std::string& mode = settings.word("mode");
        if (mode == "adaptive" && !sampler.isPoint())
            query.most = std::max(query.samples, std::uint32_t(settings.whole("most")));
        if (mode == "pixel") query.shared = sharedPatterns(at, query.samples, kSeed);
        query.order = neighbourOrder(0, query.samples);
        query.further = neighbourOrder(query.samples, query.most);
        // Blocks do not depend on the number of threads: neither do the answers.
        const std::size_t blocks = (at.count + kBlock - 1) / kBlock;
        base::parallelFor(std::size_t(0), blocks, [&](std::size_t block) {
            const std::size_t begin = block * kBlock;
            answer(sampler, at, query, begin, std::min(at.count, begin + kBlock), out);
        });
        return {};
    }

  private:
    void answer(const light::LightSampler& sampler, const Receivers& at,
                const Query& query, std::size_t begin, std::size_t end,
                float* out) const {
        LightLook looks[kBlock];
        LightSeen seen[kBlock];
        std::size_t index[kBlock], n = 0;
        for (std::size_t i = begin; i < end; ++i) {
            const glm::dvec3 start = at.starts ? at.starts[i] : at.points[i];
            out[i] = 0.0f;
            if (!base::isFinite(start) || sampler.isBehind(at.points[i])) continue;
            const SamplePattern own{base::pointKey(start, kSeed), 0};
            const SamplePattern p = query.shared.empty() ? own : query.shared[i];
            index[n] = i;
            looks[n++] = {start, at.normals ? at.normals[i] : glm::dvec3(0.0), p.key,
                          p.first};
        }
        look(sampler, looks, n, query.order, seen);
        if (!query.further.empty()) refine(sampler, looks, n, query.further, seen);
        for (std::size_t k = 0; k < n; ++k)
            out[index[k]] = float(1.0 - seen[k].visible.x / seen[k].total);
    }
    /// Further samples where those so far do not agree.
    void refine(const light::LightSampler& sampler, const LightLook* looks,
                std::size_t count, const std::vector<std::uint32_t>& order,
                LightSeen* seen) const {
        LightLook again[kBlock];
        LightSeen more[kBlock];
        std::size_t index[kBlock], n = 0;
        for (std::size_t k = 0; k < count; ++k) {
            if (seen[k].clear == seen[k].total || seen[k].dark == seen[k].total) continue;
            index[n] = k;
            again[n] = looks[k];
            more[n++] = seen[k];
        }
        look(sampler, again, n, order, more);
        for (std::size_t k = 0; k < n; ++k)
            seen[index[k]] = more[k];
    }
    void look(const light::LightSampler& sampler, const LightLook* looks,
              std::size_t count, const std::vector<std::uint32_t>& order,
              LightSeen* seen) const {
        scene_.look(sampler, looks, count, order.data(), order.size(), seen, false, {});
    }

    EmbreeReference scene_;
};

Result<std::unique_ptr<Method>> build(const MethodScene& scene,
                                      const Settings& settings) {
    auto casters = EmbreeReference::build(scene.casters, settings.flag("robust"));
    if (!casters) return casters.error();
    return std::unique_ptr<Method>(new EmbreeMethod(std::move(*casters)));
}

/// Where runs of points that share a pattern begin, and the end of the last.
std::vector<std::size_t> sharingRuns(const Receivers& at) {
    const auto isSingle = [&](std::size_t p) {
        return at.first[p + 1] - at.first[p] == 1;
    };
    std::vector<std::size_t> runs{0};
    for (std::size_t p = 0; p < at.pixels;) {
        std::size_t q = p + 1;
        if (isSingle(p)) {
            while (q < at.pixels && q - p < kSharingPixels && isSingle(q))
                ++q;
        }
        runs.push_back(at.first[q]);
        p = q;
    }
    return runs;
}

/// The patterns of points [begin, end), a run. `place` is room to work in.
void shareSamples(const Receivers& at, std::size_t begin, std::size_t end,
                  std::uint32_t samples, std::uint32_t seed,
                  std::vector<std::uint32_t>& place, SamplePattern* patterns) {
    // Of a sequence the first kMaxSamples are well spread; then it takes another.
    const std::uint32_t perSequence = std::max(1u, std::uint32_t(kMaxSamples) / samples);
    // Who takes which samples is shuffled: else the place in the pixel would go with
    // the place on the light, and what both move (an edge) would be seen unevenly.
    const std::uint64_t key = base::pointKey(at.points[begin], seed);
    place.resize(end - begin);
    std::iota(place.begin(), place.end(), 0u);
    for (std::size_t k = place.size(); k > 1; --k)
        std::swap(place[k - 1], place[base::mix(key + k) % k]);
    for (std::size_t k = 0; k < place.size(); ++k) {
        const std::uint32_t sequence = place[k] / perSequence;
        patterns[begin + k].first = place[k] % perSequence * samples;
        patterns[begin + k].key = sequence == 0 ? key : base::mix(key ^ sequence);
    }
}

}  // namespace

std::vector<SamplePattern> sharedPatterns(const Receivers& at, std::uint32_t samples,
                                          std::uint32_t seed) {
    const std::vector<std::size_t> runs = sharingRuns(at);
    std::vector<SamplePattern> patterns(at.count);
    base::parallelRanges(std::size_t(0), runs.size() - 1, std::size_t(64),
                         [&](std::size_t begin, std::size_t end) {
                             std::vector<std::uint32_t> place;
                             for (std::size_t r = begin; r < end; ++r)
                                 shareSamples(at, runs[r], runs[r + 1], samples, seed,
                                              place, patterns.data());
                         });
    return patterns;
}

MethodInfo embreeMethod() {
    MethodInfo info;
    info.name = "embree";
    info.title = "casters ray traced with Embree";
    info.source = "[Cook84]";
    info.perLight = false;
    info.settings = {
        wordSetting("mode", {"fixed", "adaptive", "pixel"},
                    "the same for every point, more where they disagree, or shared"),
        wholeSetting("samples", 16, 1, kMaxSamples, "rays per point"),
        wholeSetting("most", 64, 1, kMaxSamples,
                     "adaptive: rays per point where the first ones disagree"),
    };
    info.settings.back().with = "mode=adaptive";
    info.settings.push_back(flagSetting(
        "robust", false, "Embree's robust mode: slower, no ray slips through an edge",
        SettingUse::build));
    info.build = build;
    return info;
}

}  // namespace mtsm::baseline
