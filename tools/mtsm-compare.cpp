// mtsm-compare - every way to compute a soft shadow, on a scene of one's own: what it
// costs and how far it is off.
#include <tbb/info.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "baseline/methods.h"
#include "common/arguments.h"
#include "common/casters.h"
#include "common/job.h"
#include "common/placement.h"
#include "common/tool.h"
#include "compare/plan.h"
#include "compare/recommend.h"
#include "compare/report.h"
#include "compare/results.h"
#include "compare/scene.h"
#include "compare/session.h"
#include "mtsm/describe.h"
#include "mtsm/plot.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;

constexpr const char* kAbout =
    "Computes the soft shadow of a scene in many ways, ray tracing of the geometry and\n"
    "shadow maps among them, and measures each: its error against ray tracing with 4096\n"
    "samples a point, its time to build and to answer, its memory. Writes tables, "
    "pictures\n"
    "and a report page into a folder, and says which settings are the cheapest that meet "
    "an\n"
    "error or a time. The scene file is a job file of mtsm-bake that says more: a "
    "camera,\n"
    "receivers, and which methods and settings to compare.";

constexpr const char* kExamples =
    "Examples:\n"
    "  a model on a floor under a disk light, all methods at usual settings:\n"
    "    mtsm-compare dragon.ply --light-radius 0.3 --light-position 2,5,3 -o out\n"
    "  the same light at three sizes; what meets a mean error of 0.005 the cheapest:\n"
    "    mtsm-compare dragon.ply --light-radius 0.3 --light-position 2,5,3 \\\n"
    "                 --light-scales 0.3,1,3 --recommend error=0.005 -o out\n"
    "  a first look in seconds, not minutes: few methods, a small picture, a rough "
    "truth:\n"
    "    mtsm-compare shot.toml --method mtsm --method embree --image 300x150 \\\n"
    "                 --truth 1024 -o out\n"
    "  what methods and settings there are:\n"
    "    mtsm-compare --list-methods\n"
    "\nA scene file is a job file of mtsm-bake (see there for [light], [map] and "
    "[[caster]])\n"
    "with more tables, which mtsm-bake passes over:\n"
    "    [camera]                          # without: one that frames the casters\n"
    "    position = [3, 2, 6]\n"
    "    target = [0, 1, 0]\n"
    "    fov = 35                          # degrees, across the larger side\n"
    "    image = [600, 300]\n"
    "    points = 1                        # per pixel: 1, 4, 9, 16, ...\n"
    "    # or: position-pass = \"shot.P.exr\" and normal-pass = \"shot.N.exr\"\n"
    "    [[receiver]]                      # is seen, but casts nothing\n"
    "    floor = true                      # or file = \"set.obj\", or plane = [9 "
    "numbers]\n"
    "    [compare]\n"
    "    light-scales = [0.3, 1, 3]        # times the size of [light]\n"
    "    truth = 4096                      # samples a point\n"
    "    [[method]]\n"
    "    name = \"mtsm\"\n"
    "    resolution = [512, 1024, 2048]    # a list: every value is tried,\n"
    "    samples = [64, 256]               # in all combinations\n"
    "    [[method]]\n"
    "    name = \"embree\"\n"
    "    samples = [1, 4, 16, 64, 256]\n"
    "    [[method]]\n"
    "    name = \"mtsm\"                     # what is not given here or in [map] is "
    "chosen,\n"
    "    target-error = [0.02, 0.005]      # as mtsm-bake and mtsm-query do; or quality "
    "= "
    "...\n"
    "\nThe folder gets results.json, results.csv, report.html (one page, no network), "
    "PNG "
    "and\n"
    "EXR pictures of every run, and cache/, from which a comparison that was stopped or "
    "is\n"
    "run again takes truths and finished lights.";

struct Arguments {
    std::vector<std::string> inputs, only;
    std::string folder, cache, recommend, command;
    PlacementOptions placement;
    CameraOptions camera;
    std::vector<double> lightScales{1.0}, targets{0.02, 0.01, 0.005, 0.002};
    std::int64_t truth = 4096, measured = 4096, repeats = 5, threads = 0;
    std::optional<std::size_t> error;
    bool noCache = false, noPictures = false, listMethods = false, quiet = false,
         json = false;
};

std::vector<double> parseList(const std::string& option, const std::string& text) {
    const auto count = std::size_t(std::count(text.begin(), text.end(), ',')) + 1;
    return parseNumbers(option, text, count, "a list such as 0.3,1,3");
}

void addList(CLI::App& app, const std::string& name, std::vector<double>& values,
             const std::string& help, const std::string& group) {
    app.add_option_function<std::string>(
           name, [&values, name](const std::string& t) { values = parseList(name, t); },
           help)
        ->type_name("A,B,...")
        ->group(group);
}

void addSceneOptions(CLI::App& app, Arguments& a) {
    app.add_option("INPUT", a.inputs,
                   "one scene file (.toml), or casters: meshes, hair and\n"
                   "volumes, which then stand on a floor")
        ->type_name("FILE")
        ->group("Files");
    addText(
        app, "-o,--folder", a.folder, "OUT",
        "the folder to write into; needed; made if it is not\nthere, with those above it")
        ->group("Files");
    addText(app, "--cache", a.cache, "DIR",
            "where truths and runs are kept (default: OUT/cache)")
        ->group("Files");
    app.add_flag("--no-cache", a.noCache, "keep nothing, use nothing that was kept")
        ->group("Files");
    app.add_flag("--no-pictures", a.noPictures,
                 "write tables alone, no pictures and no report page")
        ->group("Files");
    addPlacementOptions(app, a.placement);
    addList(app, "--light-scales", a.lightScales,
            "compare with the light so many times as large, each\n"
            "at least 0 (default: 1)",
            "Light");
}

void addCameraOptions(CLI::App& app, Arguments& a) {
    const std::string group = "Picture";
    CameraOptions& c = a.camera;
    addTriple(app, "--camera-position", c.position,
              "where the camera stands (default: so that it frames\nthe casters)")
        ->group(group);
    addTriple(app, "--camera-target", c.target,
              "what it looks at (default: the middle of the casters)")
        ->group(group);
    addTriple(app, "--camera-up", c.up, "what is up in the picture (default: 0,1,0)")
        ->group(group);
    addNumber(app, "--camera-fov", c.fovDegrees, {0.0, 180.0, true}, "DEG",
              "full field of view across the larger side\n(default: 40)")
        ->group(group);
    app.add_option_function<std::string>(
           "--image",
           [&c](const std::string& text) {
               (void)parseResolution("--image", text, 16384);
               c.image = text;
           },
           "pixels of the picture (default: 600x300)")
        ->type_name("N|WxH")
        ->group(group);
    addWhole(app, "--points", c.points, 1, 1024,
             "shaded points per pixel: 1, 4, 9, 16, ... 1024, squares\n"
             "of whole numbers (default: 1); errors are by pixel")
        ->group(group);
    addWhole(app, "--pixels", c.pixels, 0, 1 << 30,
             "compare so many pixels alone, in runs of 64 neighbours\n"
             "spread over the picture; 0: all (default). Errors of a\n"
             "few hundred are luck, and the table says how much")
        ->group(group);
    auto* pass = addText(app, "--position-pass", c.positionPass, "P.exr",
                         "shade the points of a position pass, an EXR with world\n"
                         "positions; no camera");
    pass->group(group);
    for (const char* camera :
         {"--camera-position", "--camera-target", "--camera-up", "--camera-fov"})
        pass->excludes(app.get_option(camera));
    addText(app, "--normal-pass", c.normalPass, "N.exr",
            "normals beside it (default: none)")
        ->group(group);
}

void addCompareOptions(CLI::App& app, Arguments& a) {
    const std::string group = "Comparison";
    app.add_option("--method", a.only,
                   "compare only this method of those that the scene file\n"
                   "names, or of all; may be repeated")
        ->type_name("NAME")
        ->allow_extra_args(false)
        ->group(group);
    app.add_flag("--list-methods", a.listMethods,
                 "print all methods with their settings, and stop")
        ->group(group);
    addWhole(app, "--truth", a.truth, 1, 4096,
             "samples a point of the truth, 1 to 4096 (default: 4096)")
        ->group(group);
    addWhole(app, "--measured-pixels", a.measured, 64, 1 << 28,
             "times are taken on so many pixels, 64 or more, in runs\n"
             "of 64 neighbours, and scaled to the picture (default:\n"
             "4096)")
        ->group(group);
    addWhole(app, "--repeats", a.repeats, 1, 1000,
             "times that each is timed, 1 to 1000; the median counts\n"
             "(default: 5)")
        ->group(group);
    addList(app, "--targets", a.targets,
            "mean errors for which the cheapest of each method is\n"
            "sought (default: 0.02,0.01,0.005,0.002)",
            group);
    addChoice(app, "--error", a.error,
              {"image", "object", "image-cosine", "object-cosine"},
              "the mean error that counts: over all pixels or those\n"
              "that show a caster; of the shadow factor, or times the\n"
              "cosine to the light, as shaded (default: image)")
        ->group(group);
    addText(app, "--recommend", a.recommend, "error=E|time=T",
            "print the cheapest settings that meet a mean error\n"
            "(error=0.005), or the most accurate ones whose first\n"
            "picture takes no longer (time=2s), and the lines of\n"
            "mtsm-bake and mtsm-query that make it from a map")
        ->group(group);
}

void addOptions(CLI::App& app, Arguments& a) {
    addSceneOptions(app, a);
    addCameraOptions(app, a);
    addCompareOptions(app, a);
    const std::string group = "General";
    addWhole(app, "--threads", a.threads, 0, 1024,
             "of what is timed with all threads (else with one), 1\n"
             "to what the machine has; 0: those (default)")
        ->group(group);
    app.add_flag("--quiet", a.quiet, "say nothing but warnings and errors")->group(group);
    app.add_flag("--json", a.json, "print results.json to stdout in place of tables")
        ->group(group);
}

/// What is compared: casters, receivers and methods, from a scene file or a command line.
struct Input {
    std::vector<CasterFile> casters;
    std::vector<JobReceiver> receivers;
    std::vector<JobMethod> methods;
    baseline::Settings::Given mapDefaults;  ///< of the method mtsm, from [map]
    std::optional<Job> job;
    std::string text;  ///< of the scene file
    std::string line;  ///< what stands for the casters on mtsm-bake's command line
};

/// What of the command line goes to mtsm-bake's: casters, light and view, but for the
/// light's size, which is compared.
std::string bakeLine(const Arguments& a, const CLI::App& app) {
    std::string line;
    for (const std::string& path : a.inputs)
        line += (line.empty() ? "" : " ") + quotedForShell(path);
    for (const CLI::Option* option : app.get_options()) {
        const std::string name = option->get_name(), group = option->get_group();
        if (option->count() == 0 || (group != "Light" && group != "View")) continue;
        if (name == "--light-scales" || name == "--light-radius" ||
            name == "--light-size" || name == "--light-angle")
            continue;
        line += " " + name + " " + quotedForShell(option->results().back());
    }
    return line;
}

/// What one setting of [map] says to the method mtsm; nothing of what is not its own.
std::optional<baseline::SettingValue> mapDefault(const std::string& name,
                                                 const JobSetting& setting, Talk& talk) {
    const std::string& key = setting.key;
    if (name == "resets" || name == "color" || name == "keep-hidden") {
        talk.warn(setting.place + ": " + name +
                  " is not compared: maps are grey and keep what light can see");
    } else if (name == "rounding") {
        talk.warn(setting.place +
                  ": rounding is not compared: maps have the default of mtsm-bake");
    } else if (name == "quality" || name == "target-error") {
        talk.warn(setting.place + ": " + name +
                  " in [map] is for mtsm-bake alone: to compare what it chooses, give a "
                  "[[method]] with name = \"mtsm\" a " +
                  name + " of its own");
    } else if (name == "resolution") {
        const glm::uvec2 size = parseResolution(key, setting.value, kMaxResolution);
        if (size.x != size.y)
            talk.warn(setting.place + ": maps are compared square; found " +
                      setting.value);
        return double(std::max(size.x, size.y));
    } else if (name == "near-field") {
        return setting.value;
    } else if (name == "layers" || name == "tolerance" || name == "subsamples" ||
               name == "bias") {
        return parseNumbers(key, setting.value, 1, "a number").front();
    }
    return std::nullopt;
}

/// What [map] says of the settings that the method mtsm has. What else it says of layers
/// is not compared. Failures have the place of what is wrong.
baseline::Settings::Given mapDefaults(const Job& job, Talk& talk) {
    const auto method = unwrap(baseline::findMethod("mtsm"));
    baseline::Settings::Given defaults;
    for (const JobSetting& setting : job.settings) {
        if (!setting.key.starts_with("map.")) continue;
        const std::string name = setting.key.substr(4);
        const auto fail = [&](const std::string& why) {
            return Failure{{ErrorCode::badFile, setting.place + ": " + printable(why)}};
        };
        try {
            const auto value = mapDefault(name, setting, talk);
            if (!value) continue;
            const auto good =
                baseline::Settings::complete(method->settings, {{name, *value}}, "mtsm");
            if (!good) throw fail(good.error().message);
            defaults.emplace_back(name, *value);
        } catch (const UsageError& wrong) {
            throw fail(wrong.what());
        }
    }
    return defaults;
}

/// The scene file as it stands, for a report that can be repeated.
std::string textOf(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

Input readInput(const Arguments& a, CLI::App& app, Talk& talk) {
    Input input;
    const auto isJob = [](const std::string& path) { return extension(path) == ".toml"; };
    if (a.inputs.empty())
        throw UsageError(
            "INPUT: is missing: give a scene file (.toml) or casters, such as "
            "dragon.ply");
    input.line = bakeLine(a, app);
    if (std::any_of(a.inputs.begin(), a.inputs.end(), isJob)) {
        if (a.inputs.size() > 1)
            throw UsageError("INPUT: a scene file lists all casters; give it alone");
        input.job = unwrap(readJob(a.inputs.front()));
        input.mapDefaults = mapDefaults(*input.job, talk);
        input.text = textOf(a.inputs.front());
        applyJob(*input.job, app);
        input.casters = input.job->casters;
        refuseMaps(input.casters);
        input.receivers = input.job->receivers;
        input.methods = input.job->methods;
        return input;
    }
    for (const std::string& path : a.inputs) {
        input.casters.emplace_back();
        input.casters.back().path = path;
    }
    refuseMaps(input.casters);
    input.receivers.emplace_back();
    input.receivers.back().floor = true;
    return input;
}

void makeFolder(const std::string& folder) {
    if (folder.empty())
        throw UsageError("-o: is required: the results need a folder, such as -o out");
    std::error_code problem, ignored;
    std::filesystem::create_directories(folder, problem);
    if (problem || !std::filesystem::is_directory(folder))
        throw Failure{{ErrorCode::io, folder + ": cannot make this folder: " +
                                          (std::filesystem::exists(folder, ignored)
                                               ? "a file has that name"
                                               : problem.message()) +
                                          "; results are a folder of files: give the "
                                          "name of one, such as -o out"}};
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        throw Failure{{ErrorCode::io, folder + ": cannot write into this folder: " +
                                          std::strerror(errno)}};
}

void run(const Arguments& a, const Input& input, Talk& talk) {
    const auto inFolder = [&](const std::string& name) {
        return (std::filesystem::path(a.folder) / name).string();
    };
    const auto write = [&](const std::string& name, const std::string& text) {
        const Writing writing(inFolder(name));
        unwrap(writeTextFile(inFolder(name), text));
    };
    // All that can be wrong without a look at the scene comes first.
    const auto plan = planRuns(input.methods, a.only, input.mapDefaults);
    std::optional<Wish> wish;
    if (!a.recommend.empty()) wish = parseWish(a.recommend);
    makeFolder(a.folder);

    CompareScene scene(input.casters, input.receivers, a.placement, a.camera,
                       a.lightScales, talk);
    SessionOptions options;
    options.truthSamples = int(a.truth);
    options.measuredPixels = std::size_t(a.measured);
    options.repeats = int(a.repeats);
    for (const PlannedRun& planned : plan) {
        const auto& all = planned.settings.all();
        const bool close = std::any_of(all.begin(), all.end(), [&](const auto& s) {
            const auto* samples = std::get_if<double>(&s.second);
            return s.first == "samples" && samples && 4 * *samples > double(a.truth);
        });
        if (!close || planned.method->name == "radiance" || targetError(planned) > 0.0)
            continue;
        talk.warn(
            planned.label + ": the truth has no more than " + std::to_string(a.truth) +
            " samples a point; its own noise is in the errors of what has a quarter "
            "of that or more");
        break;
    }
    const int most = tbb::info::default_concurrency();
    if (a.threads > most)
        talk.warn("--threads: found " + std::to_string(a.threads) +
                  ", but this machine has " + std::to_string(most) + ": takes those");
    options.threads = a.threads ? std::min(int(a.threads), most) : most;
    if (!a.noCache) options.cache = a.cache.empty() ? inFolder("cache") : a.cache;
    Session session(scene, plan, options, talk);
    session.run();

    ResultOptions said;
    said.scene = a.inputs.front();
    for (const CasterFile& caster : input.casters)
        said.casters.push_back(casterText(caster));
    said.targets = a.targets;
    said.error = static_cast<ErrorKind>(a.error.value_or(0));
    said.pointsPerPixel = a.camera.points;
    said.truthSamples = int(a.truth);
    said.threads = options.threads;
    said.command = a.command;
    said.sceneText = input.text;
    auto results = resultsJson(scene, plan, session, said);
    removeOld(a.folder);
    if (!a.noPictures) {
        writePictures(scene, session, a.folder, talk, results);
        const std::string page =
            unwrap(makeReport(pageResults(results, said.error), a.folder));
        write("report.html", page);
    }
    write("results.csv", resultsCsv(results));
    write("results.json", jsonText(results));
    talk.progressDone();
    print(a.json ? jsonText(results) : resultsText(results));
    // Without a renderer's passes those of the camera do.
    std::string pass = a.camera.positionPass, normals = a.camera.normalPass;
    if (pass.empty() && !a.noPictures && a.camera.points == 1) {
        pass = inFolder("P.exr");
        normals = inFolder("N.exr");
    }
    if (wish)
        talk.answer(
            "recommended for " + a.recommend + ":\n" +
            recommendation(results, *wish, said.error, input.line, pass, normals));
    talk.say("wrote " + inFolder(a.noPictures ? "results.json" : "report.html"));
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-compare");
    CLI::App app(kAbout, "mtsm-compare");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    for (int i = 0; i < argc; ++i)
        arguments.command += (i ? " " : "") + quotedForShell(argv[i]);
    return runTool(app, argc, argv, talk, [&] {
        if (arguments.listMethods) {
            print(methodsText());
            return;
        }
        const Input input = readInput(arguments, app, talk);
        talk.setQuiet(arguments.quiet);
        try {
            withThreads(arguments.threads, [&] { run(arguments, input, talk); });
        } catch (const UsageError& wrong) {
            if (input.job) blameJob(*input.job, wrong);
            throw;
        }
    });
}
