// What mtsm-compare recommends, from results made up here.
#include "compare/recommend.h"

#include <catch2/catch.hpp>
#include <string>

using namespace mtsm::tools;
using Json = nlohmann::ordered_json;

namespace {

Json mapRun(const std::string& label, double build, double query, double bytes,
            double targetError = 0.0) {
    return {{"method", "mtsm"},
            {"label", label},
            {"light", 0},
            {"given", Json::array()},
            {"settings",
             {{"resolution", 512.0},
              {"layers", 0.0},
              {"near-field", "auto"},
              {"tolerance", 0.005},
              {"subsamples", 1.0},
              {"bias", -1.0},
              {"samples", 64.0},
              {"adaptive", "false"},
              {"query-bias", -1.0},
              {"lookup", "trace"},
              {"attenuation", "multiply"},
              {"target-error", targetError}}},
            {"build", {{"all", {{"median", build}}}, {"memoryBytes", bytes}}},
            {"query", {{"all", {{"median", query}}}}},
            {"unanswered", 0},
            {"errors", {{"image", {{"mean", 0.004}}}}}};
}

std::string recommended(const Json& runs) {
    Json results;
    results["lights"] = Json::array(
        {{{"name", "radius 1"}, {"shape", "disk"}, {"light", {{"radius", 1.0}}}}});
    results["runs"] = runs;
    return recommendation(results, parseWish("error=0.005"), ErrorKind::image, "a.ply",
                          "", "");
}

bool contains(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

}  // namespace

TEST_CASE("of settings that are nearly as quick the leanest is recommended",
          "[recommend]") {
    // Pictures of 8 and of 9 ms are the same but for noise; build and memory are not.
    const std::string tie = recommended(Json::array(
        {mapRun("large", 0.905, 0.008, 23e6), mapRun("lean", 0.7, 0.009, 12e6)}));
    CHECK(contains(tie, "  lean: "));
    CHECK_FALSE(contains(tie, "large"));
    // Builds that take as long leave it to memory.
    const std::string memory = recommended(Json::array(
        {mapRun("large", 0.7, 0.009, 23e6), mapRun("lean", 0.75, 0.009, 12e6)}));
    CHECK(contains(memory, "  lean: "));
    CHECK_FALSE(contains(memory, "large"));
    // Twice as quick is no noise.
    const std::string quick = recommended(Json::array(
        {mapRun("large", 0.905, 0.004, 23e6), mapRun("lean", 0.7, 0.009, 12e6)}));
    CHECK(contains(quick, "for many pictures: large"));
}

TEST_CASE("a map that chose its settings is made again by what was asked of it",
          "[recommend]") {
    const std::string text =
        recommended(Json::array({mapRun("chosen", 0.7, 0.009, 12e6, 0.002)}));
    CHECK(contains(text, "mtsm-bake a.ply --light-radius 1 --target-error 0.002 -o "));
    CHECK(contains(text, "N.exr --target-error 0.002 -o "));
    CHECK_FALSE(contains(text, "--samples"));
}

TEST_CASE("what was given beside a target is given again", "[recommend]") {
    Json run = mapRun("chosen", 0.7, 0.009, 12e6, 0.002);
    run["given"] = {"resolution", "near-field", "samples", "target-error"};
    run["settings"]["near-field"] = "32M";
    const std::string text = recommended(Json::array({run}));
    CHECK(contains(text, "--target-error 0.002 --resolution 512 --near-field 32M -o "));
    CHECK(contains(text, "N.exr --target-error 0.002 --samples 64 -o "));
    CHECK_FALSE(contains(text, "--tolerance"));
}
