// session.h - runs a plan: truths, pictures and times of every method under every light,
// kept in a cache so that what was done is not done again.
//
// Times are taken side by side: all methods of a light are built (as many as memory
// holds at once), each answers the whole picture once, which warms it up, and then they
// answer a sample of the picture in turns, round after round. The sample is runs of 64
// neighbouring pixels spread over the picture; its time is scaled to the whole. Where an
// answer has costs that do not fall with the number of points, the whole picture is
// timed, once and with all threads.
#pragma once
#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "baseline/errors.h"
#include "baseline/method.h"
#include "common/talk.h"
#include "compare/plan.h"
#include "compare/scene.h"

namespace mtsm::tools {

struct SessionOptions {
    int truthSamples = 4096;
    std::size_t measuredPixels = 4096;
    int repeats = 5;
    int threads = 0;    ///< of "all threads"
    std::string cache;  ///< folder; empty: nothing is kept
};

/// The processor's name, as the system has it.
std::string processorName();

/// Seconds: the middle, the least and the most of some repeats.
struct Timing {
    double median = 0.0, least = 0.0, most = 0.0;
    int repeats = 0;
};

/// With one thread (processor time; nothing: that would have taken too long) and with all
/// of them (by the clock).
struct Timings {
    std::optional<Timing> one, all;
};

struct RunResult {
    std::size_t light = 0, run = 0;  ///< into the scene's lights and the plan
    std::string failure;             ///< not empty: the method cannot do this; why
    bool mayChange = false;          ///< the failure: it is of this machine or moment
    Timings build, query;            ///< query: of the whole picture
    /// Of the first answer: the compared pixels, cold, with all threads.
    double firstAnswer = 0.0;
    std::uint64_t memoryBytes = 0;
    baseline::Choice choice;
    std::vector<float> values;  ///< [pixels]
    std::size_t unanswered = 0;
    /// Over the image, over the object, the same two times the cosine to the light.
    std::array<baseline::Errors, 4> errors;
    /// Of the image's mean error, where a part of the picture is compared.
    double standardError = 0.0;
};

struct LightResult {
    std::vector<float> truth;  ///< [pixels]
    double truthSeconds = 0.0;
    bool truthCached = false, runsCached = false;
};

class Session {
  public:
    Session(CompareScene& scene, const std::vector<PlannedRun>& plan,
            const SessionOptions& options, Talk& talk);
    /// Throws a Failure where the cache cannot be used.
    void run();

    [[nodiscard]] const std::vector<LightResult>& lights() const { return lights_; }
    [[nodiscard]] const std::vector<RunResult>& results() const { return results_; }
    [[nodiscard]] std::size_t measuredPixels() const { return sample_.pixels(); }

  private:
    struct Built {
        std::shared_ptr<baseline::Method> method;
        Timings seconds;
        std::string failure;
        bool mayChange = false;
    };

    void findTruth(std::size_t light);
    void sayWhatIsLeftOut() const;
    void compareLight(std::size_t light);
    Built& built(std::size_t light, const PlannedRun& run);
    [[nodiscard]] std::uint64_t heldBytes() const;
    void answer(std::size_t light, RunResult& result, Built& built);
    void timeRounds(std::size_t light, const std::vector<RunResult*>& group);
    double timeOnce(std::size_t light, const RunResult& result, int threads,
                    int times) const;
    void sayWhatIsMissed(const RunResult& result) const;
    void judge(std::size_t light, RunResult& result) const;

    [[nodiscard]] std::uint64_t lightKey(std::size_t light) const;
    [[nodiscard]] std::uint64_t groupKey(std::size_t light) const;
    [[nodiscard]] std::string cached(const std::string& name) const;
    bool readGroup(std::size_t light);
    void writeGroup(std::size_t light) const;

    CompareScene& scene_;
    const std::vector<PlannedRun>& plan_;
    const SessionOptions options_;
    Talk& talk_;
    baseline::Picture sample_;
    std::vector<LightResult> lights_;
    std::vector<RunResult> results_;
    std::map<std::string, Built> built_;  // by light and build key
};

}  // namespace mtsm::tools
