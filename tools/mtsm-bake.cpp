// mtsm-bake - casters and a light in, a map file out.
#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <glm/trigonometric.hpp>
#include <initializer_list>

#include "common/arguments.h"
#include "common/casters.h"
#include "common/job.h"
#include "common/placement.h"
#include "common/quality_options.h"
#include "common/tool.h"
#include "mtsm/bake.h"
#include "mtsm/caster_files.h"
#include "mtsm/writer.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;

constexpr const char* kAbout =
    "Bakes what a light sees of some casters into a multilayer transparent shadow map.\n"
    "Casters are meshes (their alpha textures count), hair and fog volumes. Lengths are "
    "in\n"
    "the units of the scene, angles in degrees. Every mesh that a file holds casts; "
    "floors\n"
    "that only receive are best left out (--exclude), because the map then spends its "
    "pixels\n"
    "on what casts. What lets light through is kept as layers of visibility, simplified\n"
    "within --tolerance.";

constexpr const char* kExamples =
    "Examples:\n"
    "  a disk light of radius 0.3 above and beside a model, looking at its centre:\n"
    "    mtsm-bake dragon.ply --light-radius 0.3 --light-position 2,5,3 -o key.mtsm\n"
    "  the sun, casters chosen by name, a finer map:\n"
    "    mtsm-bake set.glb --exclude 'floor*' --light-angle 0.53 \\\n"
    "              --light-direction -1,-3,-1 --resolution 4096 -o sun.mtsm\n"
    "  a light of the scene file, made larger than it is there:\n"
    "    mtsm-bake shot.glb --light-name Key --light-shape rect \\\n"
    "              --light-size 0.6,0.4 -o key.mtsm\n"
    "  fur on a head, each strand 0.002 wide at the root and stopping 40 % of the "
    "light:\n"
    "    mtsm-bake head.obj fur.hair --hair-width 0.002 --hair-tip-width 0 \\\n"
    "              --hair-opacity 0.4 --light-radius 0.3 --light-position 2,5,3 -o "
    "fur.mtsm\n"
    "  foliage, leaves cut out by their textures, 2 x 2 centre rays per pixel:\n"
    "    mtsm-bake tree.glb --subsamples 2 --light-angle 0.53 \\\n"
    "              --light-direction -1,-3,-1 -o tree.mtsm\n"
    "  a tree whose file names no image for its leaves:\n"
    "    mtsm-bake oak.dae --texture 'Branch*=branch.png' --light-angle 0.53 \\\n"
    "              --light-direction -1,-3,-1 -o oak.mtsm\n"
    "  smoke, thinner than it is in the file, at a coarser tolerance:\n"
    "    mtsm-bake smoke.vdb --density-scale 0.2 --tolerance 0.01 \\\n"
    "              --light-radius 0.3 --light-position 2,5,3 -o smoke.mtsm\n"
    "  a bulb in the middle of a room, six faces of 512 x 512 pixels:\n"
    "    mtsm-bake room.glb --projection cube --light-shape sphere --light-radius 0.05 "
    "\\\n"
    "              --light-position 0,2,0 --resolution 512 -o bulb.mtsm\n"
    "  a map for pictures with a mean error of about 0.002, by what maps of such "
    "casters\n"
    "  were measured to have:\n"
    "    mtsm-bake dragon.ply --target-error 0.002 --light-radius 0.3 \\\n"
    "              --light-position 2,5,3 -o key.mtsm\n"
    "  a job file with settings for each caster, one of its settings overruled:\n"
    "    mtsm-bake shot.toml --resolution 512 -o preview.mtsm\n"
    "\nA job file is TOML. Keys are the options' names, in [light] without their light-; "
    "the\n"
    "command line wins; paths are relative to the job file:\n"
    "    output = \"shot.mtsm\"\n"
    "    [light]\n"
    "    radius = 0.3\n"
    "    position = [2, 5, 3]\n"
    "    [map]\n"
    "    resolution = 2048\n"
    "    [[caster]]\n"
    "    file = \"head.obj\"\n"
    "    [[caster]]\n"
    "    file = \"fur.hair\"\n"
    "    hair-width = 0.002\n"
    "    translate = [0, 1, 0]      # or transform: 16 numbers; rotate: degrees; scale\n";

constexpr const char* kJobExtension = ".toml";

struct Arguments {
    std::vector<std::string> inputs;
    std::string output;
    PlacementOptions placement;
    std::string resolution = "1024";
    std::int64_t layers = 0, subsamples = 1;  // layers 0: not given
    bool tree = false;
    std::string resets = "all", nearField = "auto";
    std::optional<double> bias, tolerance, rounding, opacity;
    std::optional<double> hairWidth, hairTipWidth, hairOpacity, hairScale, densityScale;
    std::string densityGrid;
    std::optional<std::size_t> codec;
    std::vector<std::string> include, exclude, textures;
    std::int64_t level = 3, threads = 0;
    std::string maxMemory;
    bool color = false, keepHidden = false, quiet = false, json = false;
    QualityOptions quality;
};

glm::uvec2 sizeOf(const std::string& resolution) {
    return parseResolution("--resolution", resolution, kMaxResolution);
}

std::uint32_t parseResets(const std::string& text) {
    if (text == "all") return kAllResets;
    std::uint32_t resets = 0;
    const char* const end = text.data() + text.size();
    const auto parsed = std::from_chars(text.data(), end, resets);
    if (parsed.ec != std::errc() || parsed.ptr != end || resets == kAllResets)
        throw UsageError("--resets: found \"" + text +
                         "\", expected a whole number of at least 0, or all");
    return resets;
}

std::uint64_t parseNearField(const std::string& text) {
    if (text == "none") return 0;
    if (text == "auto") return kAutomaticNearField;
    try {
        return parseBytes("--near-field", text);
    } catch (const UsageError& wrong) {
        throw UsageError(std::string(wrong.what()) + ", auto or none");
    }
}

std::uint64_t maxBytesOf(const std::string& text) {
    return parseBytes("--max-memory", text);
}

/// A text for which `parse` throws no UsageError.
template <typename Parse>
CLI::Option* addChecked(CLI::App& app, const std::string& name, std::string& value,
                        const std::string& form, Parse parse, const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [&value, parse](const std::string& text) {
                (void)parse(text);
                value = text;
            },
            help)
        ->type_name(form);
}

void addFileOptions(CLI::App& app, Arguments& a) {
    const std::string group = "Files";
    app.add_option("INPUT", a.inputs,
                   "casters: meshes (PLY, OBJ, glTF, GLB, FBX, COLLADA,\n"
                   "STL), hair (.hair, .tfx, lines of an OBJ), volumes\n"
                   "(.vdb); or one job file (.toml)")
        ->required()
        ->type_name("FILE")
        ->group(group);
    addText(app, "-o,--output", a.output, "OUT.mtsm",
            "the map file to write; needed, unless a job names it")
        ->group(group);
    addChoice(app, "--codec", a.codec, {"zstd", "none"},
              "how planes are stored (default: zstd)")
        ->group(group);
    addWhole(app, "--level", a.level, 1, 19, "zstd: effort, 1 to 19 (default: 3)")
        ->group(group);
    app.add_flag("--tree", a.tree,
                 "keep what queries go through as well, which they else\n"
                 "make anew of each map that is opened: it opens 4 to 10\n"
                 "times as fast, and its file takes some MB more")
        ->group(group);
}

void addViewOptions(CLI::App& app, Arguments& a) {
    const std::string group = "View";
    addChecked(app, "--resolution", a.resolution, "N|WxH", sizeOf,
               "pixels of the map (cube: of a face), 1 to 32768 a\n"
               "side (default: 1024)")
        ->group(group);
    addWhole(app, "--subsamples", a.subsamples, 1, 8,
             "centre rays per side of a pixel, 1, 2, 4 or 8: 2 makes\n"
             "4 rays; for meshes finer than a pixel (default: 1)")
        ->group(group);
    addNumber(app, "--bias", a.bias, {0.0, kAny}, "Z",
              "depth within which a layer is met, world units,\n"
              "stored in the map (default: the size of a pixel at\n"
              "the layer)")
        ->group(group);
}

void addQuality(CLI::App& app, Arguments& a) {
    addQualityOptions(app, a.quality,
                      "resolution, tolerance and the near field's\n"
                      "size by what the casters are and what maps were\n"
                      "measured to have",
                      "Quality");
}

void addLayerOptions(CLI::App& app, Arguments& a) {
    const std::string group = "Layers";
    addWhole(app, "--layers", a.layers, 1, kMaxPixelLayers,
             "most layers of a pixel, 1 to 1048576; of opaque\n"
             "casters the nearest are kept, others are merged\n"
             "(default: 5 if all casters are opaque, else no limit)")
        ->group(group);
    addNumber(app, "--tolerance", a.tolerance, {0.0, 1.0}, "V",
              "error of visibility along a pixel's centre ray that\n"
              "merging samples may bring, 0 to 1; 0 keeps every\n"
              "sample (default: 0.005)")
        ->group(group);
    addChecked(app, "--resets", a.resets, "N|all", parseResets,
               "times that visibility starts again at 1 behind what\n"
               "is opaque; what lies behind the last is dropped\n"
               "(default: all)")
        ->group(group);
    app.add_flag("--color", a.color,
                 "keep visibility of red, green and blue apart, for\n"
                 "casters that tint the light (default: one grey);\n"
                 "of opacity a and tint c, (1-a)(1-a(1-c)) passes,\n"
                 "so tinted glass is darker than in grey")
        ->group(group);
    app.add_flag("--keep-hidden", a.keepHidden,
                 "keep layers that no point of the light can see\n"
                 "(default: they are dropped)")
        ->group(group);
    addChecked(app, "--near-field", a.nearField, "auto|none|SIZE", parseNearField,
               "keep triangles and strands themselves as well, for\n"
               "exact shadows next to what casts them, if they take\n"
               "at most SIZE in memory: 32M; auto: 64M (default:\n"
               "auto); of casters that are all opaque triangles and\n"
               "strands of hair, or all triangles of any opacity")
        ->group(group);
    addNumber(app, "--rounding", a.rounding, {0.0, 1.0}, "S",
              "depths may be off by this share of the z threshold,\n"
              "visibilities by this share of --tolerance, for a\n"
              "smaller file; 0 keeps every bit (default: 1/64, or\n"
              "0 with --tolerance 0)")
        ->group(group);
}

void addCasterOptions(CLI::App& app, Arguments& a) {
    const std::string meshes = "Meshes", hair = "Hair", volumes = "Volumes";
    addNumber(app, "--opacity", a.opacity, {0.0, 1.0}, "A",
              "opacity of all materials, 0 (casts nothing) to 1;\n"
              "alpha textures still cut their holes (default: the\n"
              "materials' own)")
        ->group(meshes);
    const auto addList = [&](const char* name, std::vector<std::string>& list,
                             const char* form, const char* help) {
        app.add_option(name, list, help)
            ->type_name(form)
            ->allow_extra_args(false)
            ->group(meshes);
    };
    addList("--include", a.include, "GLOB",
            "only meshes whose node, mesh or material name\n"
            "matches, such as 'tree*'; case counts; may be\n"
            "repeated");
    addList("--exclude", a.exclude, "GLOB", "all but meshes that match; may be repeated");
    addList("--texture", a.textures, "GLOB=IMAGE",
            "materials of these names are as opaque as the alpha\n"
            "of IMAGE (without alpha: its brightness), whatever\n"
            "their file says; nothing behind the = is no texture;\n"
            "may be repeated, the last that matches counts");

    addNumber(app, "--hair-width", a.hairWidth, {0.0, kAny}, "W",
              "full width of all strands at the root, in world\n"
              "units; 0 leaves them out (default of .hair: the\n"
              "file's; of .tfx and OBJ: 1/2000 of the diagonal\n"
              "around all strands)")
        ->group(hair);
    addNumber(app, "--hair-tip-width", a.hairTipWidth, {0.0, kAny}, "W",
              "at the tip; needs --hair-width (default: the same)")
        ->group(hair);
    addNumber(app, "--hair-opacity", a.hairOpacity, {0.0, 1.0}, "A",
              "part of the light that crosses a strand and is\n"
              "stopped, 0 to 1 (default of .hair: the file's; of\n"
              ".tfx and OBJ: 1)")
        ->group(hair);
    addNumber(app, "--hair-scale", a.hairScale, {0.0, kAny}, "F",
              "multiplies positions and the file's widths: 0.01 for\n"
              "hair in centimetres on a head in metres (default: 1)")
        ->group(hair);

    addText(app, "--density-grid", a.densityGrid, "NAME",
            "the grid of a .vdb that is the density (default:\n"
            "\"density\", or the only fog volume)")
        ->group(volumes);
    addNumber(app, "--density-scale", a.densityScale, {0.0, kAny}, "F",
              "extinction per unit of density and length: light\n"
              "falls by exp(-F density length); 0 would make volumes\n"
              "empty (default: 1)")
        ->group(volumes);
}

void addGeneralOptions(CLI::App& app, Arguments& a) {
    const std::string group = "General";
    addWhole(app, "--threads", a.threads, 0, 1024,
             "0: as many as the machine has (default); the map\n"
             "is the same for any number")
        ->group(group);
    addChecked(app, "--max-memory", a.maxMemory, "BYTES", maxBytesOf,
               "bound on samples and map: 8G, 512M; the bake goes in\n"
               "bands to stay below (default: half of the machine's)")
        ->group(group);
    app.add_flag("--quiet", a.quiet, "say nothing but warnings and errors")->group(group);
    app.add_flag("--json", a.json, "print what was done to stdout as a JSON object")
        ->group(group);
}

void addOptions(CLI::App& app, Arguments& a) {
    addFileOptions(app, a);
    addPlacementOptions(app, a.placement);
    addQuality(app, a);
    addViewOptions(app, a);
    addLayerOptions(app, a);
    addCasterOptions(app, a);
    addGeneralOptions(app, a);
}

/// What is baked: the casters, and the job that lists them if there is one.
struct Input {
    std::optional<Job> job;
    std::vector<CasterFile> casters;
};

/// Reads the job file, and lets it speak where the command line is silent.
Input readInput(const Arguments& a, CLI::App& app) {
    Input input;
    const auto isJob = [](const std::string& path) {
        return extension(path) == kJobExtension;
    };
    if (std::any_of(a.inputs.begin(), a.inputs.end(), isJob)) {
        if (a.inputs.size() > 1)
            throw UsageError("INPUT: a job file lists all casters; give it alone");
        input.job = unwrap(readJob(a.inputs.front()));
        applyJob(*input.job, app);
        input.casters = input.job->casters;
    } else {
        for (const std::string& path : a.inputs) {
            input.casters.emplace_back();
            input.casters.back().path = path;
        }
    }
    return input;
}

/// What --texture says; its images are there.
std::vector<MaterialTexture> parseTextures(const Arguments& a) {
    std::vector<MaterialTexture> textures;
    for (const std::string& text : a.textures) {
        auto texture = parseTexture(text);
        if (!texture)
            throw UsageError("--texture: found \"" + text +
                             "\", expected the name of a material, = and an image, such "
                             "as 'Leaf*=leaf.png'");
        std::error_code problem;
        const std::string& image = texture->image;
        if (!image.empty() && !std::filesystem::exists(image, problem))
            throw Failure{{ErrorCode::io, "--texture: there is no file " + image +
                                              "; paths are relative to the folder that "
                                              "the tool runs in"}};
        textures.push_back(*std::move(texture));
    }
    return textures;
}

/// Caster options of the command line go to every caster that they are for.
void applyCasterOptions(const Arguments& a, std::vector<CasterFile>& casters) {
    const auto apply = [&](const char* option, bool given, CasterKind kind,
                           const char* kindText, auto&& set) {
        if (!given) return;
        bool used = false;
        for (CasterFile& caster : casters) {
            if (!mayHold(caster.path, kind)) continue;
            set(caster);
            used = true;
        }
        if (!used)
            throw UsageError(std::string(option) + ": none of the inputs is " + kindText);
    };
    const auto mesh = [&](const char* option, bool given, auto&& set) {
        apply(option, given, CasterKind::mesh, "a mesh file", set);
    };
    mesh("--opacity", a.opacity.has_value(),
         [&](CasterFile& c) { c.opacity = float(*a.opacity); });
    mesh("--include", !a.include.empty(), [&](CasterFile& c) { c.include = a.include; });
    mesh("--exclude", !a.exclude.empty(), [&](CasterFile& c) { c.exclude = a.exclude; });

    const auto textures = parseTextures(a);
    mesh("--texture", !textures.empty(), [&](CasterFile& c) {
        c.textures.insert(c.textures.end(), textures.begin(), textures.end());
    });

    const auto hair = [&](const char* option, std::optional<double> value, auto&& set) {
        apply(option, value.has_value(), CasterKind::hair, "hair", set);
    };
    hair("--hair-width", a.hairWidth,
         [&](CasterFile& c) { c.hairWidth = float(*a.hairWidth); });
    hair("--hair-tip-width", a.hairTipWidth,
         [&](CasterFile& c) { c.hairTipWidth = float(*a.hairTipWidth); });
    hair("--hair-opacity", a.hairOpacity,
         [&](CasterFile& c) { c.hairOpacity = float(*a.hairOpacity); });
    hair("--hair-scale", a.hairScale,
         [&](CasterFile& c) { c.hairScale = float(*a.hairScale); });

    const auto volume = [&](const char* option, bool given, auto&& set) {
        apply(option, given, CasterKind::volume, "a volume (.vdb)", set);
    };
    volume("--density-grid", !a.densityGrid.empty(),
           [&](CasterFile& c) { c.densityGrid = a.densityGrid; });
    volume("--density-scale", a.densityScale.has_value(),
           [&](CasterFile& c) { c.densityScale = float(*a.densityScale); });
    for (const CasterFile& caster : casters)
        unwrap(checkCaster(caster));
}

/// The command line as the map remembers it: what decides its content, nothing else. Of a
/// job the casters with their settings, and the options that it gave values.
std::string settingsText(const CLI::App& app, const Input& input) {
    const auto isOneOf = [](const std::string& name,
                            std::initializer_list<const char*> names) {
        return std::find(names.begin(), names.end(), name) != names.end();
    };
    std::string text = "mtsm-bake";
    for (const CasterFile& caster : input.casters)
        if (input.job) text += " " + casterText(caster);
    for (const CLI::Option* option : app.get_options()) {
        const std::string name = option->get_name();
        if (option->count() == 0 ||
            isOneOf(name, {"--output", "--threads", "--max-memory", "--quiet", "--json"}))
            continue;
        const bool ofCasters =
            option->get_positional() ||
            isOneOf(option->get_group(), {"Meshes", "Hair", "Volumes"});
        if (input.job && ofCasters) continue;
        const bool flag = option->get_items_expected_max() == 0;
        for (const std::string& value : option->results()) {
            if (!option->get_positional()) text += " " + name;
            // So that it may be pasted into a shell again.
            if (!flag) text += " " + quotedForShell(value);
        }
    }
    return text;
}

BakeOptions bakeOptions(const Arguments& a, const CLI::App& app, const Input& input,
                        Talk& talk) {
    BakeOptions bake;
    const glm::uvec2 size = sizeOf(a.resolution);
    bake.maxBytes = a.maxMemory.empty() ? halfOfMemory() : maxBytesOf(a.maxMemory);
    if (app.count("--level") && a.codec.value_or(0) != 0)
        throw UsageError("--level: is for --codec zstd only");
    bake.resets = parseResets(a.resets);
    bake.width = size.x;
    bake.height = size.y;
    applyPlacement(a.placement, input.casters, talk, bake);
    if (bake.cube && bake.width != bake.height)
        throw UsageError("--resolution: found \"" + a.resolution +
                         "\", but the faces of --projection cube are square");
    if (a.layers) bake.layers = std::uint32_t(a.layers);
    if (a.tolerance) bake.tolerance = float(*a.tolerance);
    if (a.rounding) bake.rounding = float(*a.rounding);
    bake.subsamples = std::uint32_t(a.subsamples);
    bake.color = a.color;
    bake.keepHidden = a.keepHidden;
    bake.nearField = parseNearField(a.nearField);
    if (a.bias) bake.bias = float(*a.bias);
    bake.settings = settingsText(app, input);
    bake.progress = [&talk](const char* stage, double fraction) {
        return talk.progress(stage, fraction);
    };
    return bake;
}

/// With the place in the job of what is wrong, where the job said it.
BakeOptions checkedBakeOptions(const Arguments& a, const CLI::App& app,
                               const Input& input, Talk& talk) {
    try {
        return bakeOptions(a, app, input, talk);
    } catch (const UsageError& wrong) {
        if (input.job) blameJob(*input.job, wrong);
        throw;
    }
}

CasterFilesOptions filesOptions(const Arguments& a, Talk& talk) {
    CasterFilesOptions files;
    files.color = a.color;
    files.importerBytes = std::min(files.importerBytes, 2 * halfOfMemory());
    files.cacheBytes = halfOfMemory() / 2;
    files.warn = [&talk](const std::string& text) { talk.warn(text); };
    files.progress = [&talk](const std::string& path) {
        return talk.progress("reading " + path, -1.0);
    };
    return files;
}

struct Timing {
    double trees = 0, write = 0, total = 0;
};

const char* kindText(MapKind kind) {
    switch (kind) {
        case MapKind::nearField:
            return "opaque triangles, kept whole beside the layers";
        case MapKind::surfaces:
            return "opaque triangles, not kept beside the layers";
        case MapKind::nearSheets:
            return "triangles that let light through, kept whole beside the layers";
        case MapKind::nearHair:
            return "strands, kept whole beside the layers";
        case MapKind::sheets:
            return "surfaces that let light through";
        case MapKind::volume:
            return "volumes";
        default:
            return "hair";
    }
}

bool keepsCasters(MapKind kind) {
    return kind == MapKind::nearField || kind == MapKind::nearSheets ||
           kind == MapKind::nearHair;
}

/// Puts what --quality or --target-error chooses in place of what was not given.
void chooseSettings(const Arguments& a, const CLI::App& app, CasterSource& casters,
                    Talk& talk, BakeOptions& bake) {
    const float error = *a.quality.meanError();
    MapForm form{bake.cube, bake.color};
    if (app.count("--near-field")) form.nearField = bake.nearField > 0;
    const MapSettings chosen =
        mapSettingsFor(unwrap(measureCasters(casters)), error, form);
    std::string text;
    const auto choose = [&](const char* option, const std::string& value, auto&& set) {
        if (app.count(option)) return;
        set();
        text += std::string(text.empty() ? "" : ", ") + option + " " + value;
    };
    choose("--resolution", std::to_string(chosen.resolution),
           [&] { bake.width = bake.height = chosen.resolution; });
    choose("--tolerance", shortText(chosen.tolerance),
           [&] { bake.tolerance = chosen.tolerance; });
    choose("--near-field",
           chosen.nearField ? std::to_string(chosen.nearField >> 20) + "M" : "none",
           [&] { bake.nearField = chosen.nearField; });
    talk.say("for a mean error of " + errorText(error) + ", of " + kindText(chosen.kind) +
             ": " + (text.empty() ? "nothing" : text));
}

/// What may bring the error down.
std::string adviceFor(const CLI::App& app, const ShadowMap& map) {
    const MapKind kind = kindOf(map);
    const std::uint32_t pixels = std::min(map.info().width, map.info().height);
    const char* const truth = "hold it against the truth with mtsm-compare";
    const bool couldKeep =
        kind != MapKind::volume && map.faceCount() == 1 && map.info().channels == 1;
    if (app.count("--near-field") && couldKeep && !keepsCasters(kind))
        return std::string(
                   "leave --near-field out, so that the casters are kept beside "
                   "the layers, or ") +
               truth;
    if (pixels < kMaxResolution && mapError(kind, pixels) > mapError(kind, pixels + 1))
        return "it may well be better, for this is what the worse maps of its kind have; "
               "raise --resolution, or " +
               std::string(truth);
    return std::string("more pixels are not expected to help; ") + truth;
}

/// Says what the map is expected to come to, and if that is too much.
void checkQuality(const Arguments& a, const CLI::App& app, const Baked& baked,
                  Talk& talk) {
    const float asked = *a.quality.meanError(), expected = mapError(baked.map);
    const std::string text = "the map is expected to be off by about " +
                             errorText(expected) +
                             " in the mean over a picture that it fills";
    if (expected <= asked)
        talk.say(text);
    else
        talk.warn(text + ", more than the " + errorText(asked) +
                  " asked for: " + adviceFor(app, baked.map));
}

/// Those of the counts that are not zero, with commas between.
std::string listOf(std::initializer_list<std::pair<std::uint64_t, const char*>> counts) {
    std::string list;
    for (const auto& [count, what] : counts)
        if (count) list += (list.empty() ? "" : ", ") + countText(count) + " " + what;
    return list;
}

void sayWhatWasRead(Talk& talk, const BakeReport& r) {
    std::string read;
    const auto add = [&](bool some, const std::string& text) {
        if (some) read += (read.empty() ? "" : "; ") + text;
    };
    add(r.meshes > 0, counted(r.meshes, "mesh", "meshes") + ", " +
                          counted(r.triangles, "triangle", "triangles"));
    add(r.strands > 0, counted(r.strands, "strand", "strands") + ", " +
                           counted(r.segments, "segment", "segments"));
    add(r.volumes > 0, counted(r.volumes, "volume", "volumes") + ", " +
                           counted(r.voxels, "voxel", "voxels"));
    talk.say("read " + read + " in " + secondsText(r.readSeconds));
    const std::string odd = listOf({{r.degenerate, "degenerate"},
                                    {r.nonFinite, "not finite"},
                                    {r.culled, "culled"},
                                    {r.transparent, "wholly transparent"},
                                    {r.outside, "outside window, near and far"},
                                    {r.clipped, "reaching out of the window"}});
    if (!odd.empty()) talk.say("of these: " + odd);
    if (r.strandWidth > r.segmentLength)
        talk.warn("strands are " + shortText(r.strandWidth) +
                  " wide and their segments " + shortText(r.segmentLength) +
                  " long, in the mean: at bends such segments show as pieces, and errors "
                  "of some hundredths are to be expected; give narrower strands "
                  "(--hair-width), or fewer points a strand");
    if (2 * r.outside > r.triangles + r.segments)
        talk.warn(
            "most triangles lie outside window, near and far and cast nothing: check "
            "--fov, --near, --far and where the light looks");
}

std::string nearItemsText(const BakeReport& r) {
    std::string text;
    if (r.nearTriangles > 0 || r.nearSegments == 0)
        text = counted(r.nearTriangles, "triangle", "triangles");
    if (r.nearSegments > 0)
        text += (text.empty() ? "" : " and ") +
                counted(r.nearSegments, "segment", "segments");
    return text;
}

/// What came of --near-field. That auto keeps none is no reason to worry, unless a bound
/// was given that there would be one without.
void sayNearField(Talk& talk, const BakeReport& r, const Arguments& a) {
    if (r.noNearField.empty()) {
        if (r.nearBytes)
            talk.say("near field: " + nearItemsText(r) + ", " + bytesText(r.nearBytes) +
                     " in memory, in " + secondsText(r.nearSeconds));
        return;
    }
    const std::string text = "no near field: " + r.noNearField;
    if (a.nearField == "auto" && text.find("--max-memory") == std::string::npos)
        talk.say(text);
    else
        talk.warn(text);
}

/// Pixels of six faces whose nearest layer lies within a sphere around the eye.
std::uint64_t pixelsWithin(const ShadowMap& map, double radius) {
    std::uint64_t count = 0;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        const Projection& p = map.projection(face);
        if (!(map.zRange(face).min < radius)) continue;
        for (std::uint32_t y = 0; y < map.info().height; ++y) {
            for (std::uint32_t x = 0; x < map.info().width; ++x) {
                const PixelLayers layers = map.pixel(face, x, y);
                if (layers.count == 0 || layers.z[0] >= radius) continue;
                const glm::dvec3 at =
                    p.lightFromRaster({x + 0.5, y + 0.5}, double(layers.z[0]));
                count += glm::length(at) < radius;
            }
        }
    }
    return count;
}

/// Whether a light in a map of six faces reaches into what casts.
void sayWhatIsInTheLight(Talk& talk, const ShadowMap& map) {
    const AreaLight& light = map.info().light;
    if (map.faceCount() == 1 || light.shape != LightShape::sphere) return;
    constexpr double kTouches = 0.999;
    if (const std::uint64_t pixels = pixelsWithin(map, kTouches * light.radius))
        talk.warn(
            "the light reaches into casters, as " + counted(pixels, "pixel", "pixels") +
            " of the map see: light passes through what lies inside it; move it, or "
            "give a smaller --light-radius");
}

/// The settings that lost or saved layers, and what.
void sayWhatWasKept(Talk& talk, const Baked& baked, const Arguments& a) {
    const BakeReport& r = baked.report;
    const MapInfo& info = baked.map.info();
    const std::string size =
        std::to_string(info.width) + " x " + std::to_string(info.height) +
        (baked.map.faceCount() > 1
             ? " on " + std::to_string(baked.map.faceCount()) + " faces"
             : "");
    talk.say("rasterised " + size + ": " + countText(info.samples) + " samples in " +
             counted(r.passes, "pass", "passes") + ", in " +
             secondsText(r.rasterSeconds));
    const std::string cap =
        "samples behind the nearest " + std::to_string(info.maxLayers);
    const std::string dropped =
        listOf({{r.droppedByLayers, cap.c_str()},
                {r.droppedByResets, "samples behind the last reset"},
                {r.droppedHidden, "layers that no point of the light sees"}});
    // What is neither in a layer of its own nor dropped was merged with others.
    const std::uint64_t gone =
        r.droppedByLayers + r.droppedByResets + r.droppedHidden + baked.map.layerCount();
    const std::uint64_t merged = info.samples > gone ? info.samples - gone : 0;
    talk.say("kept " + countText(baked.map.layerCount()) + " layers" +
             (merged ? ", " + countText(merged) +
                           (info.toleranceAsked > 0.0f ? " samples merged into them"
                                                       : " samples change nothing")
                     : "") +
             "; dropped " + (dropped.empty() ? "nothing" : dropped) + "; tolerance " +
             shortText(info.toleranceAsked) + ", reached " +
             shortText(info.toleranceReached) + ", in " + secondsText(r.compressSeconds));
    if (r.pixelsOverTolerance)
        talk.warn("in " + counted(r.pixelsOverTolerance, "pixel", "pixels") +
                  " the limit of " + std::to_string(info.maxLayers) +
                  " layers took more than the tolerance allows: raise --layers");
    sayNearField(talk, r, a);
    sayWhatIsInTheLight(talk, baked.map);
    if (baked.map.layerCount() == 0)
        talk.warn(
            "the map is empty: nothing that casts covers a pixel's centre as the light "
            "sees it");
}

/// What came of --tree.
void sayTrees(Talk& talk, std::uint64_t bytes, double seconds) {
    if (bytes > 0)
        talk.say("trees: " + bytesText(bytes) + " in memory, in " + secondsText(seconds));
    else
        talk.warn("no trees: queries of this map go without them");
}

void say(Talk& talk, const Baked& baked, const Arguments& a, std::uint64_t fileBytes,
         std::uint64_t treeBytes, Timing timing) {
    talk.say("light: " + lightText(baked.map.info().light));
    sayWhatWasRead(talk, baked.report);
    sayWhatWasKept(talk, baked, a);
    if (a.tree) sayTrees(talk, treeBytes, timing.trees);
    talk.say("wrote " + a.output + ": " + bytesText(fileBytes) + " in " +
             secondsText(timing.write) + " (" + secondsText(timing.total) +
             " in all, at most " + bytesText(peakMemory()) + " of memory)");
}

nlohmann::ordered_json reportJson(const Baked& baked, const Arguments& a,
                                  std::uint64_t fileBytes, std::uint64_t treeBytes,
                                  Timing timing) {
    const BakeReport& r = baked.report;
    const MapInfo& info = baked.map.info();
    nlohmann::ordered_json j;
    j["output"] = a.output;
    j["bytes"] = fileBytes;
    j["width"] = info.width;
    j["height"] = info.height;
    j["faces"] = baked.map.faceCount();
    j["channels"] = info.channels;
    j["subsamples"] = a.subsamples;
    j["light"] = lightJson(info.light);
    j["bias"] = info.bias;
    j["biasPerDepth"] = info.biasPerDepth;
    j["layers"] = baked.map.layerCount();
    j["maxLayers"] = info.maxLayers;
    j["samples"] = info.samples;
    j["samplesDropped"] = info.samplesDropped;
    j["droppedByLayers"] = r.droppedByLayers;
    j["droppedByResets"] = r.droppedByResets;
    j["droppedHidden"] = r.droppedHidden;
    j["toleranceAsked"] = info.toleranceAsked;
    j["toleranceReached"] = info.toleranceReached;
    j["pixelsOverTolerance"] = r.pixelsOverTolerance;
    if (const auto asked = a.quality.meanError())
        j["quality"] = {{"targetError", *asked}, {"mapError", mapError(baked.map)}};
    j["castersClipped"] = info.castersClipped;
    j["casters"] = {{"meshes", r.meshes},         {"triangles", r.triangles},
                    {"strands", r.strands},       {"segments", r.segments},
                    {"volumes", r.volumes},       {"voxels", r.voxels},
                    {"degenerate", r.degenerate}, {"nonFinite", r.nonFinite},
                    {"culled", r.culled},         {"transparent", r.transparent},
                    {"outside", r.outside},       {"clipped", r.clipped}};
    j["nearField"] = {{"kept", r.nearBytes > 0 && r.noNearField.empty()},
                      {"triangles", r.nearTriangles},
                      {"segments", r.nearSegments},
                      {"bytes", r.nearBytes},
                      {"reason", r.noNearField}};
    j["trees"] = {{"bytes", treeBytes}};
    j["passes"] = r.passes;
    j["peakMemory"] = peakMemory();
    j["seconds"] = {{"read", r.readSeconds},         {"raster", r.rasterSeconds},
                    {"compress", r.compressSeconds}, {"nearField", r.nearSeconds},
                    {"trees", timing.trees},         {"write", timing.write},
                    {"total", timing.total}};
    return j;
}

void run(const Arguments& a, const CLI::App& app, const Input& input, Talk& talk) {
    using Clock = std::chrono::steady_clock;
    const auto since = [](Clock::time_point start) {
        return std::chrono::duration<double>(Clock::now() - start).count();
    };
    const auto start = Clock::now();
    BakeOptions options = checkedBakeOptions(a, app, input, talk);
    CasterFiles casters(input.casters, filesOptions(a, talk));
    if (a.quality.meanError()) chooseSettings(a, app, casters, talk, options);
    auto made = bake(casters, options);
    if (!made) throw Failure{withEmptying(made.error(), input.casters)};
    const Baked baked = *std::move(made);
    if (a.quality.meanError()) checkQuality(a, app, baked, talk);

    WriteOptions write;
    write.codec = a.codec.value_or(0) == 0 ? Codec::zstd : Codec::none;
    write.level = int(a.level);
    write.trees = a.tree;
    write.progress = [&talk](double fraction) {
        return talk.progress("writing", fraction);
    };
    const auto treeStart = Clock::now();
    const std::uint64_t treeBytes =
        a.tree ? queryMemoryBytes(baked.map) - baked.map.memoryBytes() : 0;
    const double treeSeconds = since(treeStart);
    const auto writeStart = Clock::now();
    {
        const Writing writing(a.output);
        unwrap(writeMap(baked.map, a.output, write));
    }

    const Timing timing{treeSeconds, since(writeStart), since(start)};
    std::error_code problem;
    const auto size = std::filesystem::file_size(a.output, problem);
    const std::uint64_t fileBytes = problem ? 0 : size;
    say(talk, baked, a, fileBytes, treeBytes, timing);
    if (a.json) print(jsonText(reportJson(baked, a, fileBytes, treeBytes, timing)));
}

void checkOutput(const Arguments& a, const Input& input) {
    if (a.output.empty())
        throw UsageError(
            "-o: is required" +
            std::string(input.job ? ", or output = \"...\" in the job" : "") +
            ": the map needs a file, such as -o key.mtsm");
    if (a.output == "-")
        throw UsageError(
            "-o -: a map needs the name of a file; /dev/stdout writes to a pipe");
    std::vector<std::string> inputs = a.inputs;
    for (const CasterFile& caster : input.casters)
        inputs.push_back(caster.path);
    tools::checkOutput(a.output, inputs);
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-bake");
    CLI::App app(kAbout, "mtsm-bake");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    return runTool(app, argc, argv, talk, [&] {
        Input input = readInput(arguments, app);
        talk.setQuiet(arguments.quiet);
        checkOutput(arguments, input);
        refuseMaps(input.casters);
        applyCasterOptions(arguments, input.casters);
        withThreads(arguments.threads, [&] { run(arguments, app, input, talk); });
    });
}
