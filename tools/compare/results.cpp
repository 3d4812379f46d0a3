#include "compare/results.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <glm/trigonometric.hpp>
#include <iomanip>
#include <map>
#include <set>
#include <sstream>

#include "baseline/equal_error.h"
#include "common/quality_options.h"
#include "common/tool.h"
#include "mtsm/image.h"

namespace mtsm::tools {
namespace {

using baseline::Errors;
using baseline::Measured;
using Json = nlohmann::ordered_json;

constexpr float kFullDifference = 0.1f;
// Grey where there is no answer, or nothing to see.
constexpr float kNothing = 0.25f, kNoDifference = 0.8f;

Json errorsJson(const Errors& e) {
    if (e.count == 0) return nullptr;
    return {{"mean", e.mean}, {"deviation", e.deviation}, {"p95", e.p95},
            {"p99", e.p99},   {"largest", e.largest},     {"bias", e.bias}};
}

Json timingJson(const std::optional<Timing>& t) {
    if (!t) return nullptr;
    return {{"median", t->median},
            {"least", t->least},
            {"most", t->most},
            {"repeats", t->repeats}};
}

Json settingJson(const baseline::SettingValue& value) {
    return std::visit([](const auto& v) { return Json(v); }, value);
}

std::string fileText(const std::string& text) {
    std::string name;
    for (const char c : text)
        name += std::isalnum(static_cast<unsigned char>(c)) || c == '.' ? c : '-';
    return name;
}

/// Also the name of its pictures: short, and no two are the same.
std::string idOf(const RunResult& result, const PlannedRun& run) {
    constexpr std::size_t kMost = 80;
    return std::to_string(result.light + 1) + "-" + std::to_string(result.run + 1) + "-" +
           fileText(run.label).substr(0, kMost);
}

/// What is compared of a run, with one thread or with all of them; nothing if it was not
/// timed so. With `build`, of the first frame.
std::optional<Measured> measuredOf(const RunResult& r, const PlannedRun& run,
                                   ErrorKind error, bool one, bool build) {
    const auto& query = one ? r.query.one : r.query.all;
    const auto& built = one ? r.build.one : r.build.all;
    if (!r.failure.empty() || r.unanswered > 0 || !query || (build && !built) ||
        r.errors[std::size_t(error)].count == 0)
        return std::nullopt;
    Measured m;
    m.label = run.label;
    m.error = r.errors[std::size_t(error)].mean;
    m.seconds = query->median;
    if (build) m.build = built->median;
    // Embree alone falls along a line from number to number.
    if (run.method->name == "embree" && run.settings.word("mode") == "fixed") {
        m.series = run.series;
        m.samples = run.settings.number("samples");
    }
    return m;
}

/// All runs of a method under a light.
std::vector<Measured> runsOf(const std::string& method, std::size_t light,
                             const std::vector<PlannedRun>& plan, const Session& session,
                             ErrorKind error, bool one, bool build) {
    std::vector<Measured> runs;
    for (const RunResult& r : session.results()) {
        if (r.light != light || plan[r.run].method->name != method) continue;
        if (auto m = measuredOf(r, plan[r.run], error, one, build))
            runs.push_back(*std::move(m));
    }
    return runs;
}

Json secondsJson(const std::optional<baseline::Reached>& reached) {
    return reached ? Json(reached->seconds) : Json();
}
Json labelJson(const std::optional<baseline::Reached>& reached) {
    return reached ? Json(reached->label) : Json();
}

/// One run against the cheapest way of a rival to its error; nothing if it was not timed.
Json equalErrorJson(const RunResult& r, const std::vector<PlannedRun>& plan,
                    const Session& session, const ResultOptions& options, bool one) {
    const PlannedRun& run = plan[r.run];
    const auto own = measuredOf(r, run, options.error, one, false);
    if (!own) return nullptr;
    const auto ownFirst = measuredOf(r, run, options.error, one, true);
    // Every map against Embree, and the other way round.
    const std::string rival = run.method->name == "embree" ? "mtsm" : "embree";
    if (runsOf(rival, r.light, plan, session, options.error, one, false).empty())
        return nullptr;
    const auto reach = [&](bool build) {
        return baseline::cheapest(
            runsOf(rival, r.light, plan, session, options.error, one, build), own->error);
    };
    const auto query = reach(false), first = reach(true);
    const auto ratio = [](const auto& theirs, const std::optional<Measured>& ours) {
        return theirs && ours ? Json(theirs->seconds / (ours->build + ours->seconds))
                              : Json();
    };
    Json j{{"run", idOf(r, run)},
           {"rival", rival},
           {"threads", one ? 1 : options.threads},
           {"error", own->error},
           {"seconds", own->seconds}};
    j["firstFrameSeconds"] =
        ownFirst ? Json(ownFirst->build + ownFirst->seconds) : Json();
    j["rivalSeconds"] = secondsJson(query);
    j["rivalLabel"] = labelJson(query);
    j["rivalFirstFrameSeconds"] = secondsJson(first);
    j["rivalFirstFrameLabel"] = labelJson(first);
    j["ratio"] = ratio(query, own);
    j["firstFrameRatio"] = ratio(first, ownFirst);
    return j;
}

/// The cheapest of each method that meets an error, with one thread.
Json targetsJson(std::size_t light, double error, const std::vector<PlannedRun>& plan,
                 const Session& session, ErrorKind kind) {
    std::vector<std::string> names;
    for (const PlannedRun& run : plan)
        if (std::find(names.begin(), names.end(), run.method->name) == names.end())
            names.push_back(run.method->name);
    Json cheapest = Json::array();
    for (const std::string& name : names) {
        const auto reach = [&](bool build) {
            return baseline::cheapest(
                runsOf(name, light, plan, session, kind, true, build), error);
        };
        const auto query = reach(false), first = reach(true);
        if (!query) continue;
        cheapest.push_back({{"method", name},
                            {"label", query->label},
                            {"seconds", query->seconds},
                            {"firstFrameSeconds", secondsJson(first)},
                            {"firstFrameLabel", labelJson(first)}});
    }
    return {{"light", light}, {"error", error}, {"cheapest", cheapest}};
}

Json sceneJson(const CompareScene& scene, const Session& session,
               const ResultOptions& options) {
    const baseline::Picture& picture = scene.picture();
    const std::filesystem::path file(options.scene);
    return {{"name", file.stem().string()},
            {"file", file.filename().string()},
            {"casters", options.casters},
            {"triangles", scene.counts().triangles},
            {"segments", scene.counts().segments},
            {"voxels", scene.counts().voxels},
            {"image", {picture.width, picture.height}},
            {"pointsPerPixel", options.pointsPerPixel},
            {"points", scene.allPoints()},
            {"pixels", scene.allPixels()},
            {"comparedPixels", picture.pixels()},
            {"objectPixels", scene.allObjectPixels()},
            {"measuredPixels", session.measuredPixels()}};
}

/// "radius 0.3", "0.6 x 0.4", "0.53 degrees"
std::string nameOf(const AreaLight& light) {
    const auto text = [](double v) { return shortText(float(v)); };
    switch (light.shape) {
        case LightShape::rect:
            return text(light.size.x) + " x " + text(light.size.y);
        case LightShape::sun:
            return text(glm::degrees(light.angularDiameter)) + " degrees";
        case LightShape::point:
            return "point";
        default:
            return "radius " + text(light.radius);
    }
}

Json lightsJson(const CompareScene& scene, const Session& session,
                const ResultOptions& options) {
    Json lights = Json::array();
    for (std::size_t l = 0; l < scene.lights().size(); ++l) {
        const ComparedLight& c = scene.lights()[l];
        const LightResult& found = session.lights()[l];
        const double radius = lightRadius(c.light);
        lights.push_back({{"name", nameOf(c.light)},
                          {"radius", radius},
                          {"scale", c.scale},
                          {"shape", name(c.light.shape)},
                          {"text", lightText(c.light)},
                          {"light", lightJson(c.light)},
                          {"runsCached", found.runsCached},
                          {"truth",
                           {{"samples", options.truthSamples},
                            {"seconds", found.truthSeconds},
                            {"cached", found.truthCached},
                            {"image", nullptr}}}});
    }
    return lights;
}

Json methodsJson(const std::vector<PlannedRun>& plan) {
    Json methods = Json::array();
    std::set<std::string> known;
    for (const PlannedRun& run : plan)
        if (known.insert(run.method->name).second)
            methods.push_back({{"name", run.method->name},
                               {"title", run.method->title},
                               {"source", run.method->source}});
    return methods;
}

/// What a run chose for an error that was asked for, and whether it got there.
Json choiceJson(const RunResult& r, const PlannedRun& run, ErrorKind error) {
    if (r.choice.text.empty()) return nullptr;
    const Errors& e = r.errors[std::size_t(error)];
    const double target = targetError(run);
    return {{"text", r.choice.text},
            {"target", target},
            {"expected", r.choice.expected},
            {"met", e.count == 0 ? Json() : Json(e.mean <= target)}};
}

Json runJson(const RunResult& r, const PlannedRun& run, ErrorKind error) {
    Json settings = Json::object(), errors;
    Json given = Json::array();
    for (const auto& [name, value] : run.settings.all()) {
        settings[name] = settingJson(value);
        if (run.settings.given(name)) given.push_back(name);
    }
    for (std::size_t k = 0; k < r.errors.size(); ++k)
        errors[kErrorKinds[k]] = errorsJson(r.errors[k]);
    return {{"id", idOf(r, run)},
            {"method", run.method->name},
            {"label", run.label},
            {"series", run.series},
            {"light", r.light},
            {"settings", settings},
            {"given", given},
            {"choice", choiceJson(r, run, error)},
            {"build",
             {{"seconds", r.build.all->median},
              {"one", timingJson(r.build.one)},
              {"all", timingJson(r.build.all)},
              {"memoryBytes", r.memoryBytes}}},
            {"query",
             {{"one", timingJson(r.query.one)},
              {"all", timingJson(r.query.all)},
              {"firstAnswer", r.firstAnswer}}},
            {"unanswered", r.unanswered},
            {"errors", errors},
            {"standardError",
             std::isfinite(r.standardError) ? Json(r.standardError) : Json()},
            {"image", nullptr},
            {"difference", nullptr}};
}

// --- pictures
// ------------------------------------------------------------------------------

/// Encoded for display, in [0, 1].
float displayed(float linear) {
    return std::pow(std::clamp(linear, 0.0f, 1.0f), 1.0f / 2.2f);
}

void writeShaded(const CompareScene& scene, std::size_t light,
                 const std::vector<float>& shadow, const std::string& path) {
    const baseline::Picture& picture = scene.picture();
    std::vector<float> shaded = picture.cosines(scene.lights()[light].light);
    for (std::size_t p = 0; p < shaded.size(); ++p)
        shaded[p] = std::isnan(shadow[p])
                        ? kNothing
                        : displayed(0.9f * shaded[p] * (1.0f - shadow[p]));
    const Writing writing(path);
    unwrap(writeImagePng(path, greyImage(picture.width, picture.height,
                                         picture.image(shaded, kNothing), 0.0f, 1.0f)));
}

void writeExr(const std::string& path, const FloatImage& image) {
    const Writing writing(path);
    unwrap(writeImageExr(path, image));
}

FloatImage passImage(const baseline::Picture& picture,
                     const std::vector<glm::dvec3>& values) {
    FloatImage image(picture.width, picture.height);
    const char* names[] = {"X", "Y", "Z"};
    for (int c = 0; c < 3; ++c) {
        std::vector<float> plane;
        for (const glm::dvec3& v : values)
            plane.push_back(float(v[c]));
        image.channels.push_back({names[c], picture.image(plane, NAN)});
    }
    return image;
}

void writeDifference(const baseline::Picture& picture, const std::vector<float>& d,
                     const std::string& path) {
    std::vector<float> red, green, blue;
    for (const float v : d) {
        if (std::isnan(v)) {
            for (auto* channel : {&red, &green, &blue})
                channel->push_back(kNoDifference);
            continue;
        }
        const float t = std::clamp(v / kFullDifference, -1.f, 1.f);
        red.push_back(t < 0 ? 1 + t : 1.0f);
        green.push_back(1 - std::abs(t));
        blue.push_back(t > 0 ? 1 - t : 1.0f);
    }
    unwrap(writeImagePng(
        path, colorImage(picture.width, picture.height, picture.image(red, kNoDifference),
                         picture.image(green, kNoDifference),
                         picture.image(blue, kNoDifference), 0.0f, 1.0f)));
}

}  // namespace

Json resultsJson(const CompareScene& scene, const std::vector<PlannedRun>& plan,
                 const Session& session, const ResultOptions& options) {
    Json j;
    j["format"] = "mtsm-compare";
    j["version"] = 1;
    j["scene"] = sceneJson(scene, session, options);
    j["machine"] = {
        {"processor", processorName()},
        {"threads", options.threads},
        {"software", "libmtsm " MTSM_VERSION ", Embree " + baseline::embreeVersion()}};
    j["command"] = options.command;
    j["sceneText"] = options.sceneText;
    j["errorKind"] = kErrorKinds[std::size_t(options.error)];
    j["differenceScale"] = kFullDifference;
    j["lights"] = lightsJson(scene, session, options);
    j["methods"] = methodsJson(plan);
    j["runs"] = Json::array();
    j["failed"] = Json::array();
    j["equalError"] = Json::array();
    for (const RunResult& r : session.results()) {
        const PlannedRun& run = plan[r.run];
        if (!r.failure.empty()) {
            j["failed"].push_back(
                {{"label", run.label}, {"light", r.light}, {"reason", r.failure}});
            continue;
        }
        j["runs"].push_back(runJson(r, run, options.error));
        for (const bool one : {true, false}) {
            if (!one && options.threads == 1) continue;
            Json compared = equalErrorJson(r, plan, session, options, one);
            if (!compared.is_null()) j["equalError"].push_back(std::move(compared));
        }
    }
    j["targets"] = Json::array();
    for (std::size_t l = 0; l < scene.lights().size(); ++l)
        for (const double error : options.targets)
            j["targets"].push_back(targetsJson(l, error, plan, session, options.error));
    return j;
}

std::string resultsCsv(const Json& results) {
    std::ostringstream out;
    out.imbue(std::locale::classic());
    out << std::setprecision(9);
    out << "light,radius,method,label,build_one,build_all,memory,query_one,query_one_"
           "least,query_one_most,query_all,unanswered";
    for (const char* kind : kErrorKinds)
        for (const char* what : {"mean", "deviation", "p95", "p99", "largest", "bias"})
            out << ',' << kind << '_' << what;
    out << '\n';
    for (const Json& run : results["runs"]) {
        const auto field = [](const Json& timing, const char* which) {
            return timing.is_null() ? std::string() : timing[which].dump();
        };
        const Json &build = run["build"], &one = run["query"]["one"];
        out << run["light"] << ','
            << results["lights"][run["light"].get<std::size_t>()]["radius"] << ','
            << run["method"].get<std::string>() << ",\""
            << run["label"].get<std::string>() << "\"," << field(build["one"], "median")
            << ',' << field(build["all"], "median") << ',' << build["memoryBytes"] << ','
            << field(one, "median") << ',' << field(one, "least") << ','
            << field(one, "most") << ',' << field(run["query"]["all"], "median") << ','
            << run["unanswered"];
        for (const char* kind : kErrorKinds) {
            const Json& e = run["errors"][kind];
            for (const char* what :
                 {"mean", "deviation", "p95", "p99", "largest", "bias"}) {
                out << ',';
                if (!e.is_null()) out << e[what];
            }
        }
        out << '\n';
    }
    return out.str();
}

namespace {

/// Of how many pixels the errors are and what that is worth, where it is not all.
std::string partText(const Json& results) {
    constexpr double kGood = 0.1;
    const auto compared = results["scene"]["comparedPixels"].get<std::uint64_t>(),
               all = results["scene"]["pixels"].get<std::uint64_t>();
    if (compared >= all) return "";
    // The middle one of the rows: some have next to no error, and all of it in one run.
    std::vector<double> shares;
    for (const Json& run : results["runs"]) {
        const Json &image = run["errors"]["image"], &error = run["standardError"];
        if (image.is_null() || !(image["mean"] > 0.0)) continue;
        shares.push_back(error.is_null()
                             ? HUGE_VAL
                             : error.get<double>() / image["mean"].get<double>());
    }
    const std::string text =
        "\nmeans are of " + countText(compared) + " of " + countText(all) + " pixels";
    if (shares.empty()) return text + "\n";
    std::nth_element(shares.begin(), shares.begin() + long(shares.size() / 2),
                     shares.end());
    const double share = shares[shares.size() / 2];
    const double needed = double(compared) * share * share / (kGood * kGood);
    std::string percent = "an unknown part";
    if (std::isfinite(share)) percent = numberText(std::ceil(100.0 * share)) + " %";
    std::string more;
    if (share > kGood)
        more = !(needed < double(all))
                   ? "; for 10 % take all: --pixels 0"
                   : "; for 10 % take --pixels " +
                         std::to_string(64 * (std::uint64_t(needed) / 64 + 1));
    return text + ": by chance they are off by about " + percent +
           " of themselves (standard error)" + more + "\n";
}

}  // namespace

std::string resultsText(const Json& results) {
    std::ostringstream out;
    out.imbue(std::locale::classic());
    const auto seconds = [](const Json& t) {
        std::ostringstream text;
        text.imbue(std::locale::classic());
        if (t.is_null()) return std::string("-");
        text << std::fixed << std::setprecision(3) << t["median"].get<double>();
        return text.str();
    };
    int width = 50;  // of the labels
    for (const Json& run : results["runs"])
        width = std::max(width, int(run["label"].get<std::string>().size()));
    for (std::size_t l = 0; l < results["lights"].size(); ++l) {
        const Json& light = results["lights"][l];
        out << (l ? "\n" : "") << "light " << l + 1 << ": "
            << light["text"].get<std::string>() << "\n"
            << std::left << std::setw(width + 2) << "  method" << std::right
            << std::setw(9) << "mean" << std::setw(9) << "std" << std::setw(9) << "p99"
            << std::setw(9) << "object" << std::setw(11) << "build s" << std::setw(11)
            << "query s" << std::setw(11) << "all thr. s" << std::setw(10) << "MB"
            << "\n";
        for (const Json& run : results["runs"]) {
            if (run["light"].get<std::size_t>() != l) continue;
            const Json &image = run["errors"]["image"], &object = run["errors"]["object"];
            out << "  " << std::left << std::setw(width)
                << run["label"].get<std::string>() << std::right << std::fixed
                << std::setprecision(5);
            if (image.is_null())
                out << std::setw(27) << "no answer";
            else
                out << std::setw(9) << image["mean"].get<double>() << std::setw(9)
                    << image["deviation"].get<double>() << std::setw(9)
                    << image["p99"].get<double>();
            if (object.is_null())
                out << std::setw(9) << "-";
            else
                out << std::setw(9) << object["mean"].get<double>();
            out << std::setprecision(3) << std::setw(11) << seconds(run["build"]["one"])
                << std::setw(11) << seconds(run["query"]["one"]) << std::setw(11)
                << seconds(run["query"]["all"]) << std::setprecision(1) << std::setw(10)
                << 1e-6 * run["build"]["memoryBytes"].get<double>()
                << (run["unanswered"].get<std::size_t>() ? "  (part of the picture)" : "")
                << "\n";
            if (const Json& choice = run["choice"]; !choice.is_null())
                out << "    chose " << choice["text"].get<std::string>()
                    << ", expects an error of " << errorText(choice["expected"])
                    << (choice["met"].is_null() ? ""
                        : choice["met"]         ? ": target met"
                                                : ": TARGET MISSED")
                    << "\n";
        }
    }
    out << partText(results);
    // A reason is said once, with how many it keeps away.
    std::map<std::string, std::vector<std::string>> reasons;
    for (const Json& failed : results["failed"])
        reasons[failed["reason"]].push_back(
            failed["label"].get<std::string>() + ", light " +
            numberText(failed["light"].get<double>() + 1));
    for (const auto& [reason, who] : reasons)
        out << "  not compared: " << who.front()
            << (who.size() > 1 ? " and " + numberText(double(who.size() - 1)) + " more"
                               : "")
            << ": " << reason << "\n";
    return out.str();
}

void writePictures(const CompareScene& scene, const Session& session,
                   const std::string& folder, Talk& talk, Json& results) {
    const baseline::Picture& picture = scene.picture();
    const auto path = [&](const std::string& name) {
        return (std::filesystem::path(folder) / name).string();
    };
    if (picture.points.size() == picture.pixels()) {
        writeExr(path("P.exr"), passImage(picture, picture.points));
        writeExr(path("N.exr"), passImage(picture, picture.normals));
    }
    for (std::size_t l = 0; l < scene.lights().size(); ++l) {
        const std::string name = "truth-" + std::to_string(l + 1);
        const std::vector<float>& truth = session.lights()[l].truth;
        writeShaded(scene, l, truth, path(name + ".png"));
        FloatImage image(picture.width, picture.height);
        image.channels.push_back({"shadow", picture.image(truth, NAN)});
        writeExr(path(name + ".exr"), image);
        results["lights"][l]["truth"]["image"] = name + ".png";
    }
    std::size_t at = 0;
    for (const RunResult& r : session.results()) {
        if (!r.failure.empty()) continue;
        Json& j = results["runs"][at++];
        (void)talk.progress("writing pictures",
                            double(at) / double(results["runs"].size()));
        const std::string name = j["id"];
        std::vector<float> difference(r.values.size());
        for (std::size_t p = 0; p < difference.size(); ++p)
            difference[p] = r.values[p] - session.lights()[r.light].truth[p];
        writeShaded(scene, r.light, r.values, path(name + ".png"));
        writeDifference(picture, difference, path(name + "-difference.png"));
        FloatImage image(picture.width, picture.height);
        image.channels.push_back({"shadow", picture.image(r.values, NAN)});
        image.channels.push_back({"difference", picture.image(difference, NAN)});
        writeExr(path(name + ".exr"), image);
        j["image"] = name + ".png";
        j["difference"] = name + "-difference.png";
    }
}

void removeOld(const std::string& folder) {
    namespace fs = std::filesystem;
    const fs::path in(folder);
    std::vector<std::string> names = {"report.html", "results.csv", "P.exr", "N.exr"};
    std::ifstream file(in / "results.json");
    const Json old = Json::parse(file, nullptr, false);
    if (!old.is_object() || old.value("format", Json()) != "mtsm-compare") return;
    const auto add = [&](const Json& picture) {
        if (!picture.is_string()) return;
        const fs::path name(picture.get<std::string>());
        if (name.has_parent_path() || name.extension() != ".png") return;
        names.push_back(name.string());
        names.push_back(name.stem().string() + ".exr");
    };
    for (const Json& light : old.value("lights", Json::array()))
        if (light.is_object())
            add(light.value("truth", Json::object()).value("image", Json()));
    for (const Json& run : old.value("runs", Json::array())) {
        if (!run.is_object()) continue;
        add(run.value("image", Json()));
        add(run.value("difference", Json()));
    }
    names.emplace_back("results.json");
    std::error_code ignored;
    for (const std::string& name : names)
        fs::remove(in / name, ignored);
}

Json pageResults(Json results, ErrorKind error) {
    const char* const kind = kErrorKinds[std::size_t(error)];
    std::set<std::string> keep;
    for (std::size_t l = 0; l < results["lights"].size(); ++l) {
        std::vector<Measured> runs;
        std::vector<std::string> ids, methods;
        for (const Json& run : results["runs"]) {
            if (run["light"].get<std::size_t>() != l || run["errors"][kind].is_null())
                continue;
            if (run["unanswered"].get<std::size_t>() > 0) {
                keep.insert(run["id"]);
                continue;
            }
            Measured m;
            m.error = run["errors"][kind]["mean"];
            const Json& one = run["query"]["one"];
            m.seconds = (one.is_null() ? run["query"]["all"] : one)["median"];
            runs.push_back(m);
            ids.push_back(run["id"]);
            methods.push_back(run["method"]);
        }
        for (const std::size_t i : baseline::paretoFront(runs))
            keep.insert(ids[i]);
        for (std::size_t i = 0; i < runs.size(); ++i) {
            const bool beaten = [&] {
                for (std::size_t k = 0; k < runs.size(); ++k)
                    if (methods[k] == methods[i] && runs[k].error < runs[i].error)
                        return true;
                return false;
            }();
            if (!beaten) keep.insert(ids[i]);
        }
    }
    for (Json& run : results["runs"])
        if (!keep.count(run["id"])) run["image"] = run["difference"] = nullptr;
    return results;
}

}  // namespace mtsm::tools
