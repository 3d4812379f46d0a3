// results.h - what a comparison found, as tables, pictures and advice.
#pragma once
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "compare/session.h"

namespace mtsm::tools {

/// The mean error that decides who is ahead.
enum class ErrorKind { image, object, imageCosine, objectCosine };
/// As results.json has them.
inline constexpr const char* kErrorKinds[] = {"image", "object", "imageCosine",
                                              "objectCosine"};

struct ResultOptions {
    std::string scene;                 ///< the scene file, or the first caster
    std::vector<std::string> casters;  ///< texts
    std::vector<double> targets;       ///< mean errors
    ErrorKind error = ErrorKind::image;
    std::int64_t pointsPerPixel = 1;
    int truthSamples = 0, threads = 0;
    std::string command, sceneText;  ///< what asked for it, so that it can be repeated
};

/// All of results.json (tools/README.md has its fields), but for the pictures' names.
nlohmann::ordered_json resultsJson(const CompareScene& scene,
                                   const std::vector<PlannedRun>& plan,
                                   const Session& session, const ResultOptions& options);

/// One line per run, from results.json.
std::string resultsCsv(const nlohmann::ordered_json& results);

/// The runs' errors and times for people, a block per light.
std::string resultsText(const nlohmann::ordered_json& results);

/// Writes pictures of truths and runs into `folder` and their names into `results`: PNG
/// as shaded with a white surface, EXR with the shadow factor and its difference from the
/// truth, PNG of the difference (red: too dark, blue: too light, full colour at 0.1).
/// Where each pixel has one point that a camera took, P.exr and N.exr hold positions and
/// normals, for mtsm-query.
void writePictures(const CompareScene& scene, const Session& session,
                   const std::string& folder, Talk& talk,
                   nlohmann::ordered_json& results);

/// Takes away what an earlier comparison wrote into `folder`: its page, its tables and
/// the pictures that its results.json names.
void removeOld(const std::string& folder);

/// A copy whose pictures are few enough for one page: of each light those of the Pareto
/// front, and of each method the most accurate one.
nlohmann::ordered_json pageResults(nlohmann::ordered_json results, ErrorKind error);

}  // namespace mtsm::tools
