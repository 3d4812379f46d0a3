#include "compare/session.h"

#include <tbb/info.h>
#include <tbb/task_arena.h>
#include <tbb/version.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "baseline/content.h"
#include "common/quality_options.h"
#include "common/tool.h"
#include "mtsm/plot.h"

namespace mtsm::tools {
namespace {

using baseline::Picture;
using Json = nlohmann::ordered_json;

/// To be raised with every change of what the reference answers.
constexpr int kTruthVersion = 1;
constexpr std::size_t kTruthPoints = 4096;                  // at a time, for progress
constexpr std::size_t kTruthPixels = std::size_t(1) << 15;  // in a file of the cache
constexpr double kShortest = 0.02;  // s: what takes less is done several times
constexpr double kLong = 10.0;      // s: what takes more is done fewer times

/// What has passed since it was made: with one thread processor time of the calling
/// thread, which does all the work then, so that what else the machine does matters
/// little; with several by the clock.
class Stopwatch {
  public:
    explicit Stopwatch(int threads)
        : clock_(threads == 1 ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC),
          start_(now()) {}

    [[nodiscard]] double seconds() const { return now() - start_; }

  private:
    [[nodiscard]] double now() const {
        timespec t{};
        clock_gettime(clock_, &t);
        return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
    }

    clockid_t clock_;
    double start_;
};

Timing timingOf(std::vector<double> seconds) {
    std::sort(seconds.begin(), seconds.end());
    const std::size_t n = seconds.size();
    return {0.5 * (seconds[(n - 1) / 2] + seconds[n / 2]), seconds.front(),
            seconds.back(), int(n)};
}

/// The program itself: what another version measured is not what this one would.
std::uint64_t programContent() {
    std::ifstream in("/proc/self/exe", std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(in), {}};
    return baseline::contentOf(bytes);
}

Json timingJson(const std::optional<Timing>& t) {
    if (!t) return nullptr;
    return {t->median, t->least, t->most, t->repeats};
}

/// A method's refusal; those of the machine or the moment are not kept.
template <typename Failing>
void fail(Failing& failing, const Error& error) {
    failing.failure = error.message;
    failing.mayChange =
        error.code != ErrorCode::badArgument && error.code != ErrorCode::unsupported;
}

std::optional<Timing> readTiming(const Json& j) {
    if (j.is_null()) return std::nullopt;
    return Timing{j.at(0), j.at(1), j.at(2), j.at(3)};
}

}  // namespace

std::string processorName() {
    std::ifstream info("/proc/cpuinfo");
    std::string line;
    while (std::getline(info, line))
        if (line.starts_with("model name")) return line.substr(line.find(": ") + 2);
    return "unknown processor";
}

Session::Session(CompareScene& scene, const std::vector<PlannedRun>& plan,
                 const SessionOptions& options, Talk& talk)
    : scene_(scene), plan_(plan), options_(options), talk_(talk) {
    const Picture& picture = scene_.picture();
    sample_ = picture.part(picture.spread(options_.measuredPixels, Picture::kRun));
    lights_.resize(scene_.lights().size());
}

void Session::run() {
    if (!options_.cache.empty()) {
        std::error_code problem;
        std::filesystem::create_directories(options_.cache, problem);
        if (problem)
            throw Failure{{ErrorCode::io, options_.cache + ": cannot make the folder: " +
                                              problem.message()}};
    }
    for (std::size_t l = 0; l < lights_.size(); ++l)
        findTruth(l);
    scene_.dropReference();
    for (std::size_t l = 0; l < lights_.size(); ++l)
        compareLight(l);
    const auto failed = [](const RunResult& r) { return !r.failure.empty(); };
    if (std::all_of(results_.begin(), results_.end(), failed))
        throw Failure{{ErrorCode::badArgument,
                       "none of the methods can do this: " + results_.front().failure}};
}

std::string Session::cached(const std::string& name) const {
    return (std::filesystem::path(options_.cache) / name).string();
}

std::uint64_t Session::lightKey(std::size_t light) const {
    return baseline::combined(scene_.content(),
                              baseline::contentOf(scene_.lights()[light].light));
}

/// The truth, a piece of the picture after another, each kept as soon as it is there.
void Session::findTruth(std::size_t light) {
    LightResult& result = lights_[light];
    const Picture& picture = scene_.picture();
    const std::uint64_t key = baseline::combined(
        lightKey(light),
        baseline::contentOf("truth " + std::to_string(kTruthVersion) + " " +
                            std::to_string(options_.truthSamples)));
    baseline::ReferenceOptions options;
    options.samples = options_.truthSamples;
    result.truthCached = true;
    const Stopwatch watch(0);
    std::vector<float> points(picture.points.size());
    const std::string what = "truth of light " + std::to_string(light + 1) + " of " +
                             std::to_string(lights_.size());
    for (std::size_t p = 0; p < picture.pixels(); p += kTruthPixels) {
        const std::size_t end = std::min(picture.pixels(), p + kTruthPixels);
        const std::uint64_t pieceKey = baseline::combined(key, p);
        const std::string file =
            cached("truth-" + baseline::contentText(pieceKey) + ".values");
        if (!options_.cache.empty()) {
            const auto kept = unwrap(baseline::readValues(file, pieceKey, end - p));
            if (kept) {
                result.truth.insert(result.truth.end(), kept->begin(), kept->end());
                continue;
            }
        }
        result.truthCached = false;
        const std::size_t first = picture.first[p], last = picture.first[end];
        for (std::size_t i = first; i < last; i += kTruthPoints) {
            scene_.reference().shadowFactors(
                scene_.lights()[light].light, &picture.starts[i], &picture.normals[i],
                std::min(kTruthPoints, last - i), &points[i], options);
            (void)talk_.progress(what, double(i) / double(points.size()));
        }
        for (std::size_t k = p; k < end; ++k) {
            double sum = 0.0;
            for (std::size_t i = picture.first[k]; i < picture.first[k + 1]; ++i)
                sum += points[i];
            result.truth.push_back(
                float(sum / double(picture.first[k + 1] - picture.first[k])));
        }
        if (options_.cache.empty()) continue;
        const Writing writing(file);
        unwrap(baseline::writeValues(file, pieceKey,
                                     {result.truth.begin() + std::ptrdiff_t(p),
                                      result.truth.begin() + std::ptrdiff_t(end)}));
    }
    result.truthSeconds = watch.seconds();
    const auto [least, most] =
        std::minmax_element(result.truth.begin(), result.truth.end());
    const std::string name = "under light " + std::to_string(light + 1) + " (" +
                             lightText(scene_.lights()[light].light) + ")";
    if (*least > 0.999f)
        talk_.warn("every point is dark " + name +
                   ": it stands inside a caster, or behind all that is seen");
    else if (*most < 0.001f)
        talk_.warn("no point is in shadow " + name +
                   ": there is nothing to compare; check where the light stands");
}

Session::Built& Session::built(std::size_t light, const PlannedRun& run) {
    const std::string key =
        (run.method->perLight ? std::to_string(light) : std::string("any")) + " " +
        run.buildKey;
    const auto known = built_.find(key);
    if (known != built_.end()) return known->second;
    Built& made = built_[key];
    baseline::MethodScene scene = scene_.methodScene(light);
    const std::string what = "building " + run.label;
    scene.bake.progress = [&](const char* stage, double fraction) {
        return talk_.progress(what + ", " + stage, fraction);
    };
    (void)talk_.progress(what, -1.0);
    const auto build = [&](int threads) {
        made.method.reset();
        tbb::task_arena arena(threads);
        const Stopwatch watch(threads);
        auto method =
            arena.execute([&] { return run.method->build(scene, run.settings); });
        const double seconds = watch.seconds();
        if (method)
            made.method = *std::move(method);
        else
            fail(made, method.error());
        return seconds;
    };
    // Up to three times; with one thread not at all if that is too long.
    const auto timed = [&](int threads) {
        std::vector<double> seconds;
        double total = 0.0;
        do {
            seconds.push_back(build(threads));
            total += seconds.back();
        } while (made.failure.empty() && seconds.size() < 3 && total < kLong);
        return timingOf(seconds);
    };
    const Timing all = timed(options_.threads);
    if (!made.failure.empty()) return made;
    made.seconds.all = all;
    if (all.median < 3 * kLong) made.seconds.one = timed(1);
    return made;
}

std::uint64_t Session::heldBytes() const {
    std::uint64_t bytes = 0;
    for (const auto& [key, built] : built_)
        if (built.method) bytes += built.method->memoryBytes();
    return bytes;
}

/// Seconds that `times` answers take.
double Session::timeOnce(std::size_t light, const RunResult& result, int threads,
                         int times) const {
    const PlannedRun& run = plan_[result.run];
    const std::string key =
        (run.method->perLight ? std::to_string(light) : std::string("any")) + " " +
        run.buildKey;
    const baseline::Method& method = *built_.at(key).method;
    std::vector<float> out(sample_.points.size());
    tbb::task_arena arena(threads);
    const Stopwatch watch(threads);
    for (int i = 0; i < times; ++i) {
        const Status done = arena.execute([&] {
            return method.shadowFactors(scene_.lights()[light].light, sample_.receivers(),
                                        run.settings, out.data());
        });
        if (!done) throw Failure{done.error()};
    }
    return watch.seconds();
}

/// The whole picture, which warms the method up.
void Session::answer(std::size_t light, RunResult& result, Built& method) {
    const Picture& picture = scene_.picture();
    const PlannedRun& run = plan_[result.run];
    (void)talk_.progress("picture of " + run.label, -1.0);
    std::vector<float> out(picture.points.size());
    tbb::task_arena arena(options_.threads);
    const Stopwatch watch(options_.threads);
    const Status done = arena.execute([&] {
        return method.method->shadowFactors(
            scene_.lights()[light].light, picture.receivers(), run.settings, out.data());
    });
    if (!done) {
        fail(result, done.error());
        return;
    }
    result.firstAnswer = watch.seconds();
    // What is timed on whole pictures takes too long to be done again and again.
    if (run.method->fixedCost) result.query.all = timingOf({result.firstAnswer});
    result.values = picture.pixelMeans(out);
    result.memoryBytes = method.method->memoryBytes();
    arena.execute([&] {
        result.choice = method.method->choice(scene_.lights()[light].light,
                                              picture.receivers(), run.settings);
    });
    result.build = method.seconds;
}

void Session::timeRounds(std::size_t light, const std::vector<RunResult*>& group) {
    struct Clocked {
        RunResult* result;
        int times[2] = {1, 1}, repeats[2] = {0, 0};
        std::vector<double> seconds[2];
    };
    const int threads[2] = {1, options_.threads};
    std::vector<Clocked> clocks;
    for (RunResult* result : group) {
        if (plan_[result->run].method->fixedCost) continue;
        Clocked c{result, {}, {}, {}};
        for (int t = 0; t < 2; ++t) {
            (void)talk_.progress("warming up " + plan_[result->run].label, -1.0);
            const double once = timeOnce(light, *result, threads[t], 1);
            c.times[t] = std::max(1, int(std::ceil(kShortest / std::max(once, 1e-6))));
            c.repeats[t] = once > kLong ? 1 : options_.repeats;
            if (once > kLong) c.seconds[t].push_back(once);
        }
        clocks.push_back(std::move(c));
    }
    for (int round = 0; round < options_.repeats; ++round) {
        for (std::size_t i = 0; i < clocks.size(); ++i) {
            Clocked& c = clocks[i];
            (void)talk_.progress(
                "timing, light " + std::to_string(light + 1),
                (round + double(i) / double(clocks.size())) / options_.repeats);
            for (int t = 0; t < 2; ++t)
                if (int(c.seconds[t].size()) < c.repeats[t])
                    c.seconds[t].push_back(
                        timeOnce(light, *c.result, threads[t], c.times[t]) / c.times[t]);
        }
    }
    for (Clocked& c : clocks) {
        const double scale = double(scene_.allPoints()) / double(sample_.points.size());
        for (auto& seconds : c.seconds)
            for (double& s : seconds)
                s *= scale;
        c.result->query.one = timingOf(c.seconds[0]);
        c.result->query.all = timingOf(c.seconds[1]);
    }
}

/// A row that does not expect to be as good as its target says so, as mtsm-bake does.
void Session::sayWhatIsMissed(const RunResult& result) const {
    const PlannedRun& run = plan_[result.run];
    const double target = targetError(run);
    if (result.choice.expected > 1.0001 * target)
        talk_.warn(run.label + ": expects to be off by about " +
                   errorText(result.choice.expected) + ", more than was asked for (" +
                   result.choice.text + ")");
}

void Session::judge(std::size_t light, RunResult& result) const {
    const Picture& picture = scene_.picture();
    const std::vector<float>& truth = lights_[light].truth;
    const auto cosines = picture.cosines(scene_.lights()[light].light);
    result.unanswered = std::size_t(std::count_if(
        result.values.begin(), result.values.end(), [](float v) { return v != v; }));
    result.errors = {
        baseline::measureErrors(result.values, truth),
        baseline::measureErrors(result.values, truth, picture.object),
        baseline::measureErrors(result.values, truth, {}, cosines),
        baseline::measureErrors(result.values, truth, picture.object, cosines)};
    result.standardError =
        baseline::standardError(result.values, truth, Picture::kRun, scene_.allPixels());
}

void Session::sayWhatIsLeftOut() const {
    std::set<std::string> said;
    for (const PlannedRun& run : plan_) {
        const bool strands = scene_.counts().segments > 0 && !run.method->strands;
        const bool volumes = scene_.counts().voxels > 0 && !run.method->volumes;
        if ((!strands && !volumes) || !said.insert(run.method->name).second) continue;
        talk_.warn(run.method->name + " leaves out " +
                   (strands && volumes ? "hair and volumes"
                    : strands          ? "hair"
                                       : "volumes") +
                   ": they cast nothing in its row");
    }
}

/// All runs under one light, in groups that memory holds.
void Session::compareLight(std::size_t light) {
    if (light == 0) sayWhatIsLeftOut();
    const std::size_t first = results_.size();
    for (std::size_t r = 0; r < plan_.size(); ++r) {
        results_.emplace_back();
        results_.back().light = light;
        results_.back().run = r;
    }
    if (!readGroup(light)) {
        std::vector<RunResult*> group;
        std::set<std::string> reasons;  // said already
        const auto finish = [&] {
            timeRounds(light, group);
            group.clear();
            built_.clear();
        };
        for (std::size_t i = first; i < results_.size(); ++i) {
            RunResult& result = results_[i];
            Built& method = built(light, plan_[result.run]);
            result.failure = method.failure;
            result.mayChange = method.mayChange;
            if (result.failure.empty()) answer(light, result, method);
            if (!result.failure.empty()) {
                if (reasons.insert(result.failure).second)
                    talk_.warn(plan_[result.run].label + ": " + result.failure);
                continue;
            }
            group.push_back(&result);
            if (heldBytes() > halfOfMemory() / 2) finish();
        }
        if (!group.empty()) timeRounds(light, group);
        std::erase_if(built_, [](const auto& b) { return !b.first.starts_with("any"); });
        writeGroup(light);
    }
    for (std::size_t i = first; i < results_.size(); ++i)
        if (results_[i].failure.empty()) {
            sayWhatIsMissed(results_[i]);
            judge(light, results_[i]);
        }
}

// --- the cache
// -----------------------------------------------------------------------------

/// Of all that the times and pictures under a light depend on.
std::uint64_t Session::groupKey(std::size_t light) const {
    std::string text =
        processorName() + " " + std::to_string(tbb::info::default_concurrency()) + " " +
        std::to_string(TBB_runtime_interface_version()) + " " +
        baseline::embreeVersion() + " " + std::to_string(options_.measuredPixels) + " " +
        std::to_string(options_.repeats) + " " + std::to_string(options_.threads);
    for (const PlannedRun& run : plan_) {
        text += "\n" + run.label;  // which begins with its method
        for (const auto& [name, value] : run.settings.all())
            text += " " + name + "=" + baseline::settingText(value);
    }
    static const std::uint64_t program = programContent();
    const baseline::MethodScene scene = scene_.methodScene(light);
    const BakeOptions& b = scene.bake;
    for (const baseline::PlanarReceiver& p : scene.planes)
        text += "\n" + tripleText(p.corner) + " " + tripleText(p.edgeX) + " " +
                tripleText(p.edgeY);
    text += "\n" + std::to_string(b.cube) + std::to_string(b.aimed) +
            std::to_string(int(b.cull)) + numberText(b.fov.value_or(0)) + " " +
            numberText(b.near.value_or(-1)) + " " + numberText(b.far.value_or(-1)) +
            tripleText(b.up) + tripleText(b.target.value_or(glm::dvec3(0.0)));
    return baseline::combined(baseline::combined(lightKey(light), program),
                              baseline::contentOf(text));
}

bool Session::readGroup(std::size_t light) {
    if (options_.cache.empty()) return false;
    const std::uint64_t key = groupKey(light);
    const std::string name = cached("runs-" + baseline::contentText(key));
    std::ifstream in(name + ".json");
    if (!in) return false;
    const std::size_t pixels = scene_.picture().pixels();
    auto values =
        unwrap(baseline::readValues(name + ".values", key, plan_.size() * pixels));
    if (!values) return false;
    const Failure damaged{{ErrorCode::badFile, name +
                                                   ".json: is damaged; delete it and the "
                                                   "runs are made anew"}};
    try {
        const Json all = Json::parse(in);
        const std::size_t first = results_.size() - plan_.size();
        for (std::size_t r = 0; r < plan_.size(); ++r) {
            RunResult& result = results_[first + r];
            const Json& j = all.at(r);
            result.failure = j.at("failure");
            result.memoryBytes = j.at("memory");
            result.firstAnswer = j.at("firstAnswer");
            result.choice = {j.at("choice").at(0), j.at("choice").at(1)};
            result.build = {readTiming(j.at("build").at(0)),
                            readTiming(j.at("build").at(1))};
            result.query = {readTiming(j.at("query").at(0)),
                            readTiming(j.at("query").at(1))};
            const bool timed = result.build.all && result.query.all;
            if (result.failure.empty() && !timed) throw damaged;
            const auto from = values->begin() + std::ptrdiff_t(r * pixels);
            if (result.failure.empty())
                result.values.assign(from, from + std::ptrdiff_t(pixels));
        }
    } catch (const Json::exception&) {
        throw damaged;
    }
    lights_[light].runsCached = true;
    talk_.say("light " + std::to_string(light + 1) + ": all runs from the cache");
    return true;
}

void Session::writeGroup(std::size_t light) const {
    if (options_.cache.empty()) return;
    const std::uint64_t key = groupKey(light);
    const std::string name = cached("runs-" + baseline::contentText(key));
    const std::size_t pixels = scene_.picture().pixels(),
                      first = results_.size() - plan_.size();
    // What may be otherwise next time is found out again.
    for (std::size_t r = 0; r < plan_.size(); ++r)
        if (results_[first + r].mayChange) return;
    std::vector<float> values(plan_.size() * pixels, 0.0f);
    Json all = Json::array();
    for (std::size_t r = 0; r < plan_.size(); ++r) {
        const RunResult& result = results_[first + r];
        all.push_back(
            {{"failure", result.failure},
             {"memory", result.memoryBytes},
             {"firstAnswer", result.firstAnswer},
             {"choice", {result.choice.text, result.choice.expected}},
             {"build", {timingJson(result.build.one), timingJson(result.build.all)}},
             {"query", {timingJson(result.query.one), timingJson(result.query.all)}}});
        std::copy(result.values.begin(), result.values.end(),
                  values.begin() + std::ptrdiff_t(r * pixels));
    }
    {
        const Writing writing(name + ".values");
        unwrap(baseline::writeValues(name + ".values", key, values));
    }
    const Writing writing(name + ".json");
    unwrap(writeTextFile(name + ".json", jsonText(all)));
}

}  // namespace mtsm::tools
