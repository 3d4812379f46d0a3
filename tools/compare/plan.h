// plan.h - what is to be compared: every combination of every method's settings.
#pragma once
#include <string>
#include <vector>

#include "baseline/methods.h"
#include "common/job.h"

namespace mtsm::tools {

/// One method with one value for each of its settings.
struct PlannedRun {
    const baseline::MethodInfo* method = nullptr;
    baseline::Settings settings;
    std::string label;     ///< "mtsm resolution=512 samples=64": what is not default
    std::string buildKey;  ///< the same for runs that one build can serve
    /// The label without the number of samples: runs that differ in it alone.
    std::string series;
};

/// In the order of the job; without methods there, a sweep of every method that is quick
/// enough to wait for. `only`: names of methods to keep; empty: all. `mapDefaults`: what
/// the method mtsm takes where its settings say nothing, as the job's [map] has it.
/// Throws a Failure at the place in the job where a method or a setting is none that
/// there is.
std::vector<PlannedRun> planRuns(const std::vector<JobMethod>& methods,
                                 const std::vector<std::string>& only,
                                 const baseline::Settings::Given& mapDefaults);

/// The mean error for which the run chooses settings itself; 0: they are given.
double targetError(const PlannedRun& run);

/// Every method and every setting with its default and range, for --list-methods.
std::string methodsText();

}  // namespace mtsm::tools
