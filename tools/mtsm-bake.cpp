// mtsm-bake - casters and a light in, a map file out.
#include <chrono>
#include <filesystem>
#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>

#include "common/arguments.h"
#include "common/light_options.h"
#include "common/tool.h"
#include "mtsm/bake.h"
#include "mtsm/scene.h"
#include "mtsm/writer.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;

constexpr const char* kAbout =
    "Bakes what a light sees of some meshes into a multilayer transparent shadow map.\n"
    "Lengths are in the units of the meshes, angles in degrees. Every mesh that a file\n"
    "holds casts; floors that only receive are best left out (--exclude), because the "
    "map\n"
    "then spends its pixels on what casts.";

constexpr const char* kExamples =
    "Examples:\n"
    "  a disk light of radius 0.3 above and beside a model, looking at its centre:\n"
    "    mtsm-bake dragon.ply --light-radius 0.3 --light-position 2,5,3 -o key.mtsm\n"
    "  the sun, casters chosen by name, a finer map:\n"
    "    mtsm-bake set.glb --exclude 'floor*' --light-angle 0.53 \\\n"
    "              --light-direction -1,-3,-1 --resolution 4096 -o sun.mtsm\n"
    "  a light of the scene file, made larger than it is there:\n"
    "    mtsm-bake shot.glb --light-name Key --light-shape rect \\\n"
    "              --light-size 0.6,0.4 -o key.mtsm\n";

struct Arguments {
    std::vector<std::string> inputs;
    std::string output;
    LightOptions light;
    std::string lightName;
    std::optional<double> fovDegrees, near, far;
    std::string resolution = "1024";
    std::int64_t layers = 5;
    std::optional<double> bias, opacity;
    std::optional<std::size_t> cull, codec;
    std::vector<std::string> include, exclude;
    std::int64_t level = 3, threads = 0;
    std::string maxMemory = "8G";
    bool quiet = false, json = false;
};

void addOptions(CLI::App& app, Arguments& a) {
    app.add_option("INPUT", a.inputs,
                   "mesh files: PLY, OBJ, glTF, GLB, FBX, COLLADA, STL")
        ->required()
        ->type_name("FILE")
        ->group("Files");
    addText(app, "-o,--output", a.output, "OUT.mtsm", "the map file to write")
        ->required()
        ->group("Files");
    addChoice(app, "--codec", a.codec, {"zstd", "none"},
              "how planes are stored (default: zstd)")
        ->group("Files");
    addWhole(app, "--level", a.level, 1, 19, "zstd: effort, 1 to 19 (default: 3)")
        ->group("Files");

    addLightSizeOptions(
        app, a.light, "Light",
        "what the size given belongs\nto: radius disk, size rect, angle sun; else point");
    addLightAimOptions(app, a.light, "Light");
    addText(app, "--light-name", a.lightName, "NAME",
            "take the light of this name from the inputs; the\n"
            "other options then change single properties of it")
        ->group("Light");

    addNumber(app, "--fov", a.fovDegrees, {0.0, 180.0, true}, "DEG",
              "full field of view of a square window (default:\n"
              "the window that fits the casters); not for a sun")
        ->group("View");
    addNumber(app, "--near", a.near, {0.0, kAny}, "Z",
              "keep nothing nearer to the light than this")
        ->group("View");
    addNumber(app, "--far", a.far, {0.0, kAny}, "Z",
              "keep nothing farther from the light than this")
        ->group("View");
    addText(app, "--resolution", a.resolution, "N|WxH",
            "pixels of the map, 1 to 32768 a side (default:\n"
            "1024)")
        ->group("View");
    addWhole(app, "--layers", a.layers, 1, 64,
             "nearest samples kept per pixel, 1 to 64 (default:\n"
             "5)")
        ->group("View");
    addNumber(app, "--bias", a.bias, {0.0, kAny}, "Z",
              "depth within which a layer is met, world units,\n"
              "stored in the map (default: the size of a pixel at\n"
              "the layer)")
        ->group("View");

    addNumber(app, "--opacity", a.opacity, {0.0, 1.0}, "A",
              "opacity of all casters, 0 to 1 (default: their\n"
              "materials')")
        ->group("Casters");
    addChoice(app, "--cull", a.cull, {"none", "back", "front"},
              "leave out faces turned away from (back) or to\n"
              "(front) the light (default: none)")
        ->group("Casters");
    const auto addGlobs = [&](const char* name, std::vector<std::string>& globs,
                              const char* help) {
        app.add_option(name, globs, help)
            ->type_name("GLOB")
            ->allow_extra_args(false)
            ->group("Casters");
    };
    addGlobs("--include", a.include,
             "only meshes whose node, mesh or material name\n"
             "matches, such as 'tree*'; case counts; may be\n"
             "repeated");
    addGlobs("--exclude", a.exclude, "all but meshes that match; may be repeated");

    addWhole(app, "--threads", a.threads, 0, 1024,
             "0: as many as the machine has (default); the map\n"
             "is the same for any number")
        ->group("General");
    addText(app, "--max-memory", a.maxMemory, "BYTES",
            "bound on depth buffer and map: 8G, 512M (default:\n"
            "8G)")
        ->group("General");
    app.add_flag("--quiet", a.quiet, "say nothing but warnings and errors")
        ->group("General");
    app.add_flag("--json", a.json, "print what was done to stdout as a JSON object")
        ->group("General");
}

/// The command line as the map remembers it: what decides its content, nothing else.
std::string settingsText(const CLI::App& app) {
    std::string text = "mtsm-bake";
    for (const CLI::Option* option : app.get_options()) {
        const std::string name = option->get_name();
        if (option->count() == 0 || name == "--output" || name == "--threads" ||
            name == "--max-memory" || name == "--quiet" || name == "--json")
            continue;
        for (const std::string& value : option->results())
            text += (option->get_positional() ? " " : " " + name + " ") + value;
    }
    return text;
}

/// The light called `name` in one of the inputs.
FileLight findLight(const Arguments& a, const MeshFileOptions& files) {
    std::string names;
    for (const std::string& input : a.inputs) {
        for (FileLight& light : unwrap(readLights(input, files))) {
            if (light.name == a.lightName) return std::move(light);
            names += (names.empty() ? "" : ", ") + light.name;
        }
    }
    throw UsageError(
        "--light-name: no light \"" + a.lightName + "\" in the inputs; " +
        (names.empty() ? "they hold no light at all" : "there are: " + names));
}

/// Fills everything of `bake` that has to do with the light.
void chooseLight(const Arguments& a, const MeshFileOptions& files, Talk& talk,
                 BakeOptions& bake) {
    AreaLight& light = bake.light;
    const bool named = !a.lightName.empty();
    if (named) {
        const FileLight found = findLight(a, files);
        light = found.light;
        bake.aimed = found.fov || light.shape == LightShape::rect;
        bake.fov = found.fov;
    }
    if (const auto shape = a.light.shape(); shape && (!named || a.light.shapeIndex))
        light.shape = *shape;
    applyLightOptions(a.light, light);

    const bool sun = light.shape == LightShape::sun;
    if (!named && !sun && !a.light.position)
        throw UsageError(std::string("--light-position is missing: a ") +
                         name(light.shape) +
                         " light needs a place, such as --light-position 2,5,3");
    if (!named && sun && !a.light.direction)
        throw UsageError(
            "--light-direction is missing: a sun needs the way that its light "
            "travels, such as --light-direction -1,-3,-1");
    if (sun && a.fovDegrees)
        throw UsageError(
            "--fov: a sun's map is parallel and has no field of view; its "
            "window fits the casters");
    const bool sized = a.light.radius || a.light.size || a.light.angleDegrees;
    if (!named && !sized && light.shape != LightShape::point)
        throw UsageError(std::string("the light's size is missing: give ") +
                         (sun                               ? "--light-angle DEG"
                          : light.shape == LightShape::rect ? "--light-size W,H"
                                                            : "--light-radius R"));
    if (light.shape != LightShape::point && lightRadius(light) == 0.0)
        talk.warn(std::string("the ") + name(light.shape) +
                  "'s size is zero: its shadows are those of a point, without penumbra");

    if (a.light.direction) bake.aimed = true;
    if (a.light.target) {
        if (*a.light.target == light.position)
            throw UsageError(
                "--light-target: is where the light is; it must be elsewhere");
        bake.target = a.light.target;
        bake.aimed = false;
    }
    if (a.light.up) bake.up = *a.light.up;
}

BakeOptions bakeOptions(const Arguments& a, const CLI::App& app,
                        const MeshFileOptions& files, Talk& talk) {
    BakeOptions bake;
    const glm::uvec2 size = parseResolution("--resolution", a.resolution, kMaxResolution);
    bake.maxBytes = parseBytes("--max-memory", a.maxMemory);
    if (a.near && a.far && !(*a.near < *a.far))
        throw UsageError("--near and --far: found " + numberText(*a.near) + " and " +
                         numberText(*a.far) + ", near must be less than far");
    if (app.count("--level") && a.codec.value_or(0) != 0)
        throw UsageError("--level: is for --codec zstd only");
    chooseLight(a, files, talk, bake);
    if (a.fovDegrees) {
        if (*a.fovDegrees == 0.0) throw UsageError("--fov: must be more than 0 degrees");
        bake.fov = glm::radians(*a.fovDegrees);
    }
    bake.near = a.near;
    bake.far = a.far;
    bake.width = size.x;
    bake.height = size.y;
    bake.layers = std::uint32_t(a.layers);
    if (a.bias) bake.bias = float(*a.bias);
    bake.cull = static_cast<Cull>(a.cull.value_or(0));
    bake.settings = settingsText(app);
    bake.progress = [&talk](const char* stage, double fraction) {
        return talk.progress(stage, fraction);
    };
    return bake;
}

MeshFileOptions meshOptions(const Arguments& a, Talk& talk) {
    MeshFileOptions files;
    files.include = a.include;
    files.exclude = a.exclude;
    if (a.opacity) files.opacity = float(*a.opacity);
    files.warn = [&talk](const std::string& text) { talk.warn(text); };
    files.progress = [&talk](const std::string& path) {
        return talk.progress("reading " + path, -1.0);
    };
    return files;
}

struct Timing {
    double write = 0, total = 0;
};

void say(Talk& talk, const Baked& baked, const Arguments& a, std::uint64_t fileBytes,
         Timing timing) {
    const BakeReport& r = baked.report;
    const MapInfo& info = baked.map.info();
    talk.say("light: " + lightText(info.light));
    talk.say("read " + countText(r.meshes) + (r.meshes == 1 ? " mesh, " : " meshes, ") +
             countText(r.triangles) + " triangles in " + secondsText(r.readSeconds));
    const std::pair<std::uint64_t, const char*> odd[] = {
        {r.degenerate, "degenerate"},
        {r.nonFinite, "not finite"},
        {r.culled, "culled"},
        {r.transparent, "wholly transparent"},
        {r.outside, "outside window, near and far"},
        {r.clipped, "reaching out of the window"}};
    std::string list;
    for (const auto& [count, what] : odd) {
        if (count) list += (list.empty() ? "" : ", ") + countText(count) + " " + what;
    }
    if (!list.empty()) talk.say("of these triangles: " + list);
    if (2 * r.outside > r.triangles)
        talk.warn(
            "most triangles lie outside window, near and far and cast nothing: check "
            "--fov, --near, --far and where the light looks");
    if (baked.map.layerCount() == 0)
        talk.warn(
            "the map is empty: no triangle covers the centre of a pixel as the light "
            "sees it");
    talk.say("rasterised " + std::to_string(info.width) + " x " +
             std::to_string(info.height) + ": " + countText(info.samples) + " samples, " +
             countText(info.samplesDropped) + " dropped behind the nearest " +
             std::to_string(info.maxLayers) + ", in " + secondsText(r.rasterSeconds));
    talk.say("wrote " + a.output + ": " + countText(baked.map.layerCount()) +
             " layers, " + bytesText(fileBytes) + " in " + secondsText(timing.write) +
             " (" + secondsText(timing.total) + " in all)");
}

nlohmann::ordered_json reportJson(const Baked& baked, const Arguments& a,
                                  std::uint64_t fileBytes, Timing timing) {
    const BakeReport& r = baked.report;
    const MapInfo& info = baked.map.info();
    nlohmann::ordered_json j;
    j["output"] = a.output;
    j["bytes"] = fileBytes;
    j["width"] = info.width;
    j["height"] = info.height;
    j["faces"] = baked.map.faceCount();
    j["light"] = lightJson(info.light);
    j["bias"] = info.bias;
    j["biasPerDepth"] = info.biasPerDepth;
    j["layers"] = baked.map.layerCount();
    j["maxLayers"] = info.maxLayers;
    j["samples"] = info.samples;
    j["samplesDropped"] = info.samplesDropped;
    j["castersClipped"] = info.castersClipped;
    j["casters"] = {{"meshes", r.meshes},         {"triangles", r.triangles},
                    {"degenerate", r.degenerate}, {"nonFinite", r.nonFinite},
                    {"culled", r.culled},         {"transparent", r.transparent},
                    {"outside", r.outside},       {"clipped", r.clipped}};
    j["seconds"] = {{"read", r.readSeconds},
                    {"raster", r.rasterSeconds},
                    {"write", timing.write},
                    {"total", timing.total}};
    return j;
}

void run(const Arguments& a, const CLI::App& app, Talk& talk) {
    using Clock = std::chrono::steady_clock;
    const auto since = [](Clock::time_point start) {
        return std::chrono::duration<double>(Clock::now() - start).count();
    };
    const auto start = Clock::now();
    talk.setQuiet(a.quiet);
    if (a.output == "-")
        throw UsageError(
            "-o -: a map needs the name of a file; /dev/stdout writes to a pipe");
    checkOutput(a.output, a.inputs);
    const MeshFileOptions files = meshOptions(a, talk);
    const BakeOptions options = bakeOptions(a, app, files, talk);

    MeshFiles casters(a.inputs, files);
    const Baked baked = unwrap(bake(casters, options));

    WriteOptions write;
    write.codec = a.codec.value_or(0) == 0 ? Codec::zstd : Codec::none;
    write.level = int(a.level);
    write.progress = [&talk](double fraction) {
        return talk.progress("writing", fraction);
    };
    const auto writeStart = Clock::now();
    {
        const Writing writing(a.output);
        unwrap(writeMap(baked.map, a.output, write));
    }

    const Timing timing{since(writeStart), since(start)};
    std::error_code problem;
    const auto size = std::filesystem::file_size(a.output, problem);
    const std::uint64_t fileBytes = problem ? 0 : size;
    say(talk, baked, a, fileBytes, timing);
    if (a.json) print(jsonText(reportJson(baked, a, fileBytes, timing)));
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-bake");
    CLI::App app(kAbout, "mtsm-bake");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    return runTool(app, argc, argv, talk, [&] {
        withThreads(arguments.threads, [&] { run(arguments, app, talk); });
    });
}
