// job.h - job files: a command line written down, with settings for each caster.
//
//     output = "key.mtsm"
//
//     [light]
//     radius = 0.3                 # --light-radius
//     position = [2, 5, 3]
//
//     [map]
//     resolution = [2048, 1024]
//     tolerance = 0.01             # --tolerance
//
//     [[caster]]
//     file = "fur.hair"
//     hair-width = 0.002
//     translate = [0, 1, 0]
//
// TOML 1.0. Keys are the names of the command line's options: in [light] without their
// "light-", in [map] those that shape the map, in [[caster]] those of the file's kind,
// and at the top what says how the work is done. Paths are relative to the job file. What
// is wrong with a job is one sentence with file:line:column, what was found, what was
// expected, and the key that was meant where one is near.
//
// mtsm-compare reads the same files, and of them what mtsm-bake passes over: [camera],
// [compare], [[receiver]] and [[method]].
#pragma once
#include <CLI/CLI.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "common/arguments.h"
#include "mtsm/caster_files.h"
#include "mtsm/result.h"

namespace mtsm::tools {

/// A key that stands for an option of the command line.
struct JobSetting {
    std::string option;  ///< "--light-radius"
    std::string key;     ///< "light.radius"
    std::string value;   ///< as the command line spells it; of a flag "true"
    std::string place;   ///< "job.toml:12:1"
};

/// A parallelogram: corner, corner + x, corner + y.
struct JobPlane {
    glm::dvec3 corner{0.0}, x{0.0}, y{0.0};
};

/// A surface that is seen but casts nothing: one of the three.
struct JobReceiver {
    std::string file;               ///< meshes
    std::optional<JobPlane> plane;  ///< a parallelogram
    bool floor = false;             ///< under the casters
    std::optional<double> height;   ///< floor: its y, in place of the casters' lowest
    std::optional<double> size;  ///< floor: its sides, in place of 3 times the casters'
    std::string place;
};

/// A method to compare and the values of its settings: every combination is meant.
struct JobMethod {
    using Value = std::variant<bool, double, std::string>;
    std::string name;
    std::vector<std::pair<std::string, std::vector<Value>>> settings;
    std::string place;
};

struct Job {
    std::vector<CasterFile> casters;  ///< at least one; each has passed checkCaster()
    std::vector<JobSetting> settings;
    std::vector<JobReceiver> receivers;
    std::vector<JobMethod> methods;
};

/// Errors: io (the job or a caster's file is not there), badFile.
Result<Job> readJob(const std::string& path);

/// Gives the options of `app` what the job says. Options that the command line gave, and
/// those that it excludes or leaves without a meaning, stay as they are; settings that
/// `app` has no option for are passed over. `job` keeps the settings that were taken. A
/// value that the option refuses is a Failure (badFile) at its place.
void applyJob(Job& job, CLI::App& app);

/// Says where a setting is wrong that only shows beside others: if the text begins with
/// the option of one that was taken, throws a Failure (badFile) at its place.
void blameJob(const Job& job, const UsageError& wrong);

/// A caster and the settings that differ from the default, as a map remembers them.
[[nodiscard]] std::string casterText(const CasterFile& caster);

}  // namespace mtsm::tools
