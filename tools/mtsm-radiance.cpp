// mtsm-radiance - casters, flat receivers and lights in, a texture of reflected radiance
// with soft shadows out for each receiver.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <glm/geometric.hpp>
#include <sstream>

#include "baseline/radiance_pack.h"
#include "baseline/radiance_texture.h"
#include "common/arguments.h"
#include "common/casters.h"
#include "common/light_options.h"
#include "common/tool.h"
#include "mtsm/caster_files.h"
#include "mtsm/image.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;
using namespace mtsm::baseline;

constexpr const char* kAbout =
    "Computes radiance textures (Heckbert and Herf 1997): for each flat receiver a "
    "picture "
    "of\n"
    "the light that it reflects diffusely, soft shadows included, as the average of "
    "hard\n"
    "shadow images from many points of the lights. Meshes cast (their alpha textures "
    "count),\n"
    "hair casts as ribbons, volumes do not. A receiver may be among the casters. Lengths "
    "are\n"
    "in the units of the scene, angles in degrees. Not for curved receivers: mtsm-bake "
    "is.";

constexpr const char* kExamples =
    "A receiver is lit on the side from which its corners run counter-clockwise: O, O + "
    "U,\n"
    "O + U + V for --receiver. The first row of its picture lies at O, U runs to the "
    "right.\n"
    "Triangles (three corners, or faces of a mesh) lie in the lower left half of their\n"
    "picture, u + v <= 1; two of them share one picture, the second one turned round in "
    "the\n"
    "upper right half. Other polygons fill a box around them.\n"
    "-o scene.exr with several pictures writes scene-0.exr, scene-1.exr and so on. An "
    ".exr\n"
    "holds radiance as R, G, B and how much of each light is visible, 0 to 1, as "
    "visibility\n"
    "(of several lights: visibility.0, visibility.1, ...); a .png holds radiance, with\n"
    "--white as white, encoded for display (sRGB). --json tells which receiver is "
    "where.\n"
    "The radiance of a light without area is its intensity, of a sun of no size its\n"
    "irradiance: what arrives is 1 / r^2 or 1 of it.\n"
    "\nExamples:\n"
    "  the shadow of a model on the floor under it, seen from above:\n"
    "    mtsm-radiance dragon.ply --receiver -2,0,2,4,0,0,0,0,-4 --light-radius 0.3 \\\n"
    "                  --light-position 2,5,3 --radiance 30 -o floor.exr\n"
    "  walls and floor of a room, which cast as well, a warm and a cold light, texels "
    "of\n"
    "  two centimetres, more light samples where a light looks large:\n"
    "    mtsm-radiance room.glb --receivers 'wall*' --receivers floor \\\n"
    "                  --light 'radius=0.2 position=1,2.5,0 radiance=9,6,3' \\\n"
    "                  --light 'size=1,0.5 position=-2,2,1 target=0,1,0 radiance=3,4,6' "
    "\\\n"
    "                  --pixel-size 0.02 --solid-angle 0.001 -o room.exr\n"
    "  a first impression after one sample, refined while one looks at it:\n"
    "    mtsm-radiance tree.glb --receiver -9,0,9,18,0,0,0,0,-18 --light-angle 0.53 \\\n"
    "                  --light-direction -1,-3,-1 --samples 1024 --progressive \\\n"
    "                  -o ground.png\n";

constexpr std::size_t kMostReceivers = 4096;
// Of the meshes that --receivers names: finding faces takes some 500 bytes for each.
constexpr std::size_t kMostFaceTriangles = std::size_t(1) << 20;
constexpr int kMostSamples = kMaxGridSide * kMaxGridSide;

struct LightArguments {
    LightOptions options;
    glm::dvec3 radiance{1.0};
};

struct Arguments {
    std::vector<std::string> inputs;
    std::vector<std::string> parallelograms, polygons, receiverNames;
    std::vector<std::string> include, exclude;
    std::optional<double> opacity, hairWidth;
    LightArguments light;
    std::vector<std::string> lights;
    std::optional<double> pixelSize, solidAngle, white, flatTolerance;
    std::int64_t resolution = 256, supersampling = 1, samples = 64, seed = 0, threads = 0;
    std::optional<std::size_t> sampling;
    glm::dvec3 reflectance{1.0}, ambient{0.0};
    std::string output;
    bool progressive = false, noCull = false, json = false, quiet = false;
};

/// "R,G,B", or one number for all three; none below 0.
glm::dvec3 parseColor(const std::string& option, const std::string& text) {
    const bool one = text.find(',') == std::string::npos;
    const auto v = parseNumbers(option, text, one ? 1 : 3, "N or R,G,B");
    const glm::dvec3 color = one ? glm::dvec3(v[0]) : glm::dvec3(v[0], v[1], v[2]);
    if (color.r < 0.0 || color.g < 0.0 || color.b < 0.0)
        throw UsageError(option + ": found \"" + text + "\", expected none below 0");
    return color;
}

CLI::Option* addColor(CLI::App& app, const std::string& name, glm::dvec3& value,
                      const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [name, &value](const std::string& text) { value = parseColor(name, text); },
            help)
        ->type_name("N|R,G,B");
}

CLI::Option* addList(CLI::App& app, const std::string& name,
                     std::vector<std::string>& list, const std::string& form,
                     const std::string& help) {
    return app.add_option(name, list, help)->type_name(form)->allow_extra_args(false);
}

void addLightOptions(CLI::App& app, LightArguments& light, const std::string& group) {
    addLightSizeOptions(app, light.options, group,
                        "what the size given belongs\nto: radius disk, size rect, angle "
                        "sun; else point");
    addLightAimOptions(app, light.options, group);
    addColor(app, "--radiance", light.radiance,
             "what the light emits, per area and solid angle, in any\n"
             "unit: the textures have the same (default: 1)")
        ->group(group);
}

void addInputOptions(CLI::App& app, Arguments& a) {
    app.add_option("CASTER", a.inputs,
                   "casters: meshes (PLY, OBJ, glTF, GLB, FBX, COLLADA,\n"
                   "STL) and hair (.hair, .tfx, lines of an OBJ)")
        ->required()
        ->type_name("FILE")
        ->group("Casters");
    addList(app, "--include", a.include, "GLOB",
            "cast only meshes whose node, mesh or material name\n"
            "matches; may be repeated")
        ->group("Casters");
    addList(app, "--exclude", a.exclude, "GLOB", "all but those; may be repeated")
        ->group("Casters");
    addNumber(app, "--opacity", a.opacity, {0.0, 1.0}, "A",
              "opacity of all meshes, 0 to 1 (default: the\n"
              "materials' own)")
        ->group("Casters");
    addNumber(app, "--hair-width", a.hairWidth, {0.0, kAny}, "W",
              "full width of all strands, in world units (default:\n"
              "as mtsm-bake)")
        ->group("Casters");

    const std::string group = "Receivers (at least one)";
    addList(app, "--receiver", a.parallelograms, "OX,OY,OZ,UX,UY,UZ,VX,VY,VZ",
            "the parallelogram O + u U + v V for u, v from 0 to\n1; may be repeated")
        ->group(group);
    addList(app, "--polygon", a.polygons, "X,Y,Z,X,Y,Z,...",
            "a flat polygon by its corners, three or more; may\nbe repeated")
        ->group(group);
    addList(app, "--receivers", a.receiverNames, "GLOB",
            "all flat faces of the inputs' meshes whose node,\n"
            "mesh or material name matches, 4096 at most; may be\n"
            "repeated. They cast as well, unless excluded")
        ->group(group);
}

void addOptions(CLI::App& app, Arguments& a) {
    addInputOptions(app, a);
    addLightOptions(app, a.light, "Light");
    addList(app, "--light", a.lights, "'KEY=VALUE ...'",
            "a light in one option, for several: keys are the\n"
            "options above without their light-; may be repeated")
        ->group("Light");

    const std::string sampling = "Sampling";
    auto* samples = addWhole(app, "--samples", a.samples, 1, kMostSamples,
                             "points on each light, rounded up to a square:\n"
                             "a grid of n x n (default: 64)")
                        ->group(sampling);
    addNumber(app, "--solid-angle", a.solidAngle, {1e-9, kAny}, "SR",
              "in place of --samples: per light and receiver as\n"
              "many as make each stand for at most so many\n"
              "steradians")
        ->group(sampling)
        ->excludes(samples);
    addChoice(app, "--sampling", a.sampling, {"jittered", "regular"},
              "points at random in the grid's cells, or in their\n"
              "middle, where edges show as steps (default:\n"
              "jittered)")
        ->group(sampling);
    addWhole(app, "--seed", a.seed, 0, 0xffffffffll,
             "same seed, same pictures on any machine (default: 0)")
        ->group(sampling);
    app.add_flag("--no-cull", a.noCull,
                 "look at all casters for every hard shadow instead\n"
                 "of those near the pyramid from the light's point to\n"
                 "the receiver; slower, the same pictures")
        ->group(sampling);

    const std::string texture = "Texture";
    auto* resolution = addWhole(app, "--resolution", a.resolution, 1, kMaxResolution,
                                "texels on the longer side, 1 to 32768 (default:\n256)")
                           ->group(texture);
    addNumber(app, "--pixel-size", a.pixelSize, {1e-12, kAny}, "W",
              "in place of --resolution: side of a texel, world\nunits")
        ->group(texture)
        ->excludes(resolution);
    addWhole(app, "--supersampling", a.supersampling, 1, 16,
             "hard shadows are finer by this on either side and\n"
             "filtered down, 1 to 16 (default: 1)")
        ->group(texture);
    addColor(app, "--reflectance", a.reflectance, "of the receivers (default: 1)")
        ->group(texture);
    addColor(app, "--ambient", a.ambient,
             "radiance that comes from everywhere (default: 0)")
        ->group(texture);
    addNumber(app, "--flat-tolerance", a.flatTolerance, {0.0, 1.0}, "E",
              "what counts as constant or linear, as a share of the\n"
              "texture's largest radiance (default: 1/256)")
        ->group(texture);

    const std::string output = "Output";
    addText(app, "-o,--output", a.output, "OUT.exr|png", "the pictures; needed")
        ->group(output);
    app.add_flag("--progressive", a.progressive,
                 "write the pictures after 1, 4, 16, ... samples of\n"
                 "each light, too")
        ->group(output);
    addNumber(app, "--white", a.white, {0.0, kAny}, "L",
              "of a .png: radiance that is white (default: the\n"
              "largest in any picture)")
        ->group(output);
    app.add_flag("--json", a.json, "print what was done to stdout as a JSON object")
        ->group(output);
    addWhole(app, "--threads", a.threads, 0, 1024,
             "0: as many as the machine has (default)")
        ->group("General");
    app.add_flag("--quiet", a.quiet, "say nothing but warnings and errors")
        ->group("General");
}

// --- input -----------------------------------------------------------------------------

std::vector<CasterFile> casterFiles(const Arguments& a) {
    std::vector<CasterFile> files;
    bool meshes = false, hair = false;
    for (const std::string& path : a.inputs) {
        CasterFile file;
        file.path = path;
        if (mayHold(path, CasterKind::mesh)) {
            meshes = true;
            file.include = a.include;
            file.exclude = a.exclude;
            if (a.opacity) file.opacity = float(*a.opacity);
        }
        if (mayHold(path, CasterKind::hair)) {
            hair = true;
            if (a.hairWidth) file.hairWidth = float(*a.hairWidth);
        }
        unwrap(checkCaster(file));
        files.push_back(std::move(file));
    }
    if (!meshes && (a.opacity || !a.include.empty() || !a.exclude.empty()))
        throw UsageError(
            "--include, --exclude and --opacity: none of the inputs is a mesh file");
    if (!hair && a.hairWidth)
        throw UsageError("--hair-width: none of the inputs is hair");
    return files;
}

CasterFilesOptions filesOptions(Talk& talk) {
    CasterFilesOptions options;
    options.warn = [&talk](const std::string& text) { talk.warn(text); };
    options.progress = [&talk](const std::string& path) {
        return talk.progress("reading " + path, -1.0);
    };
    return options;
}

RadianceReceiver parallelogram(const std::string& text) {
    const auto n = parseNumbers("--receiver", text, 9, "OX,OY,OZ,UX,UY,UZ,VX,VY,VZ");
    return parallelogramReceiver(
        {{n[0], n[1], n[2]}, {n[3], n[4], n[5]}, {n[6], n[7], n[8]}});
}

RadianceReceiver polygon(const std::string& text) {
    const auto numbers = std::size_t(std::count(text.begin(), text.end(), ',')) + 1;
    if (numbers < 9 || numbers % 3 != 0)
        throw UsageError("--polygon: found " + std::to_string(numbers) +
                         " numbers, expected X,Y,Z for each of three corners or more");
    const auto n = parseNumbers("--polygon", text, numbers, "X,Y,Z,X,Y,Z,...");
    std::vector<glm::dvec3> corners;
    for (std::size_t i = 0; i < numbers; i += 3)
        corners.emplace_back(n[i], n[i + 1], n[i + 2]);
    auto receiver = polygonReceiver(corners);
    if (!receiver) throw UsageError("--polygon: " + receiver.error().message);
    return corners.size() == 3 ? triangleReceiver(corners[0], corners[1], corners[2])
                               : std::move(*receiver);
}

/// Flat faces of the inputs' meshes that match --receivers.
std::vector<RadianceReceiver> namedReceivers(const Arguments& a, Talk& talk) {
    std::vector<CasterFile> files;
    for (const std::string& path : a.inputs) {
        if (casterKind(path) != CasterKind::mesh) continue;
        files.emplace_back();
        files.back().path = path;
        files.back().include = a.receiverNames;
    }
    if (files.empty()) throw UsageError("--receivers: none of the inputs is a mesh file");
    std::vector<RadianceReceiver> receivers;
    std::size_t triangles = 0;
    CasterFiles source(std::move(files), filesOptions(talk));
    unwrap(source.visit(meshesOnly([&](const MeshView& mesh) -> Status {
        triangles += mesh.triangleCount;
        if (triangles > kMostFaceTriangles)
            return Error{ErrorCode::badArgument,
                         "--receivers: found more than " +
                             std::to_string(kMostFaceTriangles) +
                             " triangles to find flat faces in, expected fewer; choose "
                             "by narrower names"};
        for (RadianceReceiver& receiver : meshReceivers(mesh)) {
            receiver.name = "face " + std::to_string(receivers.size());
            receivers.push_back(std::move(receiver));
            if (receivers.size() > kMostReceivers)
                return Error{ErrorCode::badArgument,
                             "--receivers: found more than " +
                                 std::to_string(kMostReceivers) +
                                 " faces, expected fewer; choose by narrower names"};
        }
        return {};
    })));
    return receivers;
}

std::vector<RadianceReceiver> receiversOf(const Arguments& a, Talk& talk) {
    std::vector<RadianceReceiver> receivers;
    const auto named = [&](RadianceReceiver receiver, const char* kind, std::size_t i) {
        receiver.name = std::string(kind) + " " + std::to_string(i);
        receivers.push_back(std::move(receiver));
    };
    for (std::size_t i = 0; i < a.parallelograms.size(); ++i)
        named(parallelogram(a.parallelograms[i]), "--receiver", i);
    for (std::size_t i = 0; i < a.polygons.size(); ++i)
        named(polygon(a.polygons[i]), "--polygon", i);
    if (!a.receiverNames.empty())
        for (RadianceReceiver& receiver : namedReceivers(a, talk))
            receivers.push_back(std::move(receiver));
    for (RadianceReceiver& receiver : receivers)
        receiver.reflectance = a.reflectance;
    return receivers;
}

/// "radius=0.3 position=2,5,3" as the options --light-radius 0.3 and so on.
LightArguments parseLight(const std::string& text) {
    LightArguments light;
    CLI::App app;
    app.set_help_flag();
    addLightOptions(app, light, "Light");
    std::vector<std::string> words;
    std::istringstream in(text);
    for (std::string word; in >> word;) {
        const std::size_t equals = word.find('=');
        const std::string key = word.substr(0, equals);
        const std::string option = key == "radiance" ? "--radiance" : "--light-" + key;
        if (equals == std::string::npos || !app.get_option_no_throw(option))
            throw UsageError("--light: found \"" + word +
                             "\", expected KEY=VALUE with one of shape, position, "
                             "radius, size, angle, "
                             "target, direction, up and radiance");
        words.push_back(option + "=" + word.substr(equals + 1));
    }
    std::reverse(words.begin(), words.end());  // as CLI11 wants them
    try {
        app.parse(words);
    } catch (const CLI::ParseError& wrong) {
        throw UsageError("--light: " + std::string(wrong.what()));
    }
    return light;
}

/// Placed and aimed: at the casters' centre unless told otherwise.
RadianceLight lightOf(const LightArguments& given, const Box& casters) {
    RadianceLight result;
    result.radiance = given.radiance;
    AreaLight& light = result.light;
    light.up = {0.0, 1.0, 0.0};
    if (const auto shape = given.options.shape()) light.shape = *shape;
    applyLightOptions(given.options, light);
    const bool sun = light.shape == LightShape::sun;
    if (!sun && !given.options.position)
        throw UsageError(std::string("--light-position is missing: a ") +
                         name(light.shape) +
                         " light needs a place, such as --light-position 2,5,3");
    if (sun && !given.options.direction)
        throw UsageError(
            "--light-direction is missing: a sun needs the way that its light travels, "
            "such as --light-direction -1,-3,-1");
    if (sun || given.options.direction) return result;
    if (!given.options.target && !(casters.low.x <= casters.high.x))
        throw UsageError(
            "--light-target is missing: nothing casts that the light could look at");
    const glm::dvec3 centre = 0.5 * (casters.low + casters.high);
    const glm::dvec3 way = given.options.target.value_or(centre) - light.position;
    if (!(glm::length(way) > 0.0))
        throw UsageError(
            "--light-target: is where the light is; give one that is elsewhere, or "
            "--light-direction");
    light.direction = glm::normalize(way);
    // As mtsm-bake: up is Y, or Z when looking along Y.
    if (!given.options.up)
        light.up = std::abs(light.direction.y) > 0.999 ? glm::dvec3(0, 0, 1)
                                                       : glm::dvec3(0, 1, 0);
    return result;
}

std::vector<RadianceLight> lightsOf(const Arguments& a, const Box& casters) {
    std::vector<RadianceLight> lights;
    if (a.light.options.any() || a.lights.empty())
        lights.push_back(lightOf(a.light, casters));
    for (const std::string& text : a.lights)
        lights.push_back(lightOf(parseLight(text), casters));
    return lights;
}

RadianceOptions radianceOptions(const Arguments& a) {
    RadianceOptions options;
    if (a.pixelSize) options.pixelSize = *a.pixelSize;
    options.resolution = int(a.resolution);
    options.supersampling = int(a.supersampling);
    options.samplesPerSide = int(std::ceil(std::sqrt(double(a.samples))));
    if (a.solidAngle) options.solidAngle = *a.solidAngle;
    options.grid = a.sampling.value_or(0) == 0 ? LightGrid::jittered : LightGrid::regular;
    options.seed = std::uint32_t(a.seed);
    options.ambient = a.ambient;
    if (a.flatTolerance) options.flatTolerance = *a.flatTolerance;
    options.cull = !a.noCull;
    return options;
}

// --- output
// ------------------------------------------------------------------------------

/// One file: a receiver's texture, or those of two triangles.
struct Picture {
    std::string path;
    std::size_t first = 0, second = TrianglePair::kNone;
    bool packed = false;
};

std::vector<Picture> picturesOf(const std::string& output,
                                const std::vector<RadianceReceiver>& receivers,
                                const std::vector<TrianglePair>& pairs) {
    std::vector<Picture> pictures;
    for (std::size_t i = 0; i < receivers.size(); ++i)
        if (receivers[i].shape != ReceiverShape::triangle)
            pictures.push_back({"", i, TrianglePair::kNone, false});
    for (const TrianglePair& pair : pairs)
        pictures.push_back(
            {"", pair.first, pair.second, pair.second != TrianglePair::kNone});
    const std::filesystem::path path(output);
    for (std::size_t i = 0; i < pictures.size(); ++i) {
        std::filesystem::path own = path;
        if (pictures.size() > 1)
            own.replace_filename(path.stem().string() + "-" + std::to_string(i) +
                                 path.extension().string());
        pictures[i].path = own.string();
    }
    return pictures;
}

/// A picture's planes: radiance, and the visibility of each light.
struct Planes {
    glm::uvec2 size{0};
    std::vector<glm::vec3> radiance;
    std::vector<std::vector<float>> visibility;
};

Planes planesOf(const Picture& picture, const std::vector<RadianceTexture>& textures) {
    const RadianceTexture& first = textures[picture.first];
    Planes planes{{first.width, first.height}, first.radiance, first.visibility};
    if (!picture.packed) return planes;
    const RadianceTexture& second = textures[picture.second];
    const glm::uvec2 size = planes.size;
    planes.size = packedSize(size);
    planes.radiance = packTriangles(first.radiance, second.radiance, size);
    for (std::size_t l = 0; l < planes.visibility.size(); ++l)
        planes.visibility[l] =
            packTriangles(first.visibility[l], second.visibility[l], size);
    return planes;
}

std::vector<float> channelOf(const std::vector<glm::vec3>& radiance, int c) {
    std::vector<float> values;
    values.reserve(radiance.size());
    for (const glm::vec3& r : radiance)
        values.push_back(r[c]);
    return values;
}

Status writeExr(const std::string& path, const Planes& planes) {
    FloatImage image(planes.size.x, planes.size.y);
    for (int c = 0; c < 3; ++c)
        image.channels.push_back(
            {std::string(1, "RGB"[c]), channelOf(planes.radiance, c)});
    const bool one = planes.visibility.size() == 1;
    for (std::size_t l = 0; l < planes.visibility.size(); ++l)
        image.channels.push_back({one ? "visibility" : "visibility." + std::to_string(l),
                                  planes.visibility[l]});
    return writeImageExr(path, image);
}

/// The sRGB curve.
float encoded(float linear) {
    return linear <= 0.0031308f ? 12.92f * linear
                                : 1.055f * std::pow(linear, 1.0f / 2.4f) - 0.055f;
}

Status writePng(const std::string& path, const Planes& planes, float white) {
    std::array<std::vector<float>, 3> colors;
    for (int c = 0; c < 3; ++c) {
        colors[std::size_t(c)] = channelOf(planes.radiance, c);
        for (float& value : colors[std::size_t(c)])
            value = white > 0.0f ? encoded(value / white) : 0.0f;
    }
    return writeImagePng(path, colorImage(planes.size.x, planes.size.y, colors[0],
                                          colors[1], colors[2], 0.0f, 1.0f));
}

float largestRadiance(const std::vector<RadianceTexture>& textures) {
    float largest = 0.0f;
    for (const RadianceTexture& texture : textures)
        for (const glm::vec3& r : texture.radiance)
            largest = std::max({largest, r.r, r.g, r.b});
    return largest;
}

void write(const Arguments& a, const std::vector<Picture>& pictures,
           const std::vector<RadianceTexture>& textures) {
    const float white = a.white ? float(*a.white) : largestRadiance(textures);
    for (const Picture& picture : pictures) {
        const Planes planes = planesOf(picture, textures);
        const Writing writing(picture.path);
        unwrap(extension(picture.path) == ".png" ? writePng(picture.path, planes, white)
                                                 : writeExr(picture.path, planes));
    }
}

nlohmann::ordered_json vectorJson(glm::dvec3 v) {
    return nlohmann::ordered_json::array({v.x, v.y, v.z});
}

/// Where the receiver's (u, v) lies in its file: origin + u * alongU + v * alongV, in
/// texture coordinates whose (0, 0) is the corner of the first texel.
nlohmann::ordered_json placeJson(const Picture& picture, std::size_t receiver,
                                 glm::uvec2 size) {
    const auto at = [&](double u, double v) {
        return picture.packed
                   ? packedCoordinates({u, v}, size, receiver == picture.second)
                   : glm::dvec2(u, v);
    };
    const glm::dvec2 origin = at(0, 0), u = at(1, 0) - origin, v = at(0, 1) - origin;
    return {
        {"origin", {origin.x, origin.y}}, {"alongU", {u.x, u.y}}, {"alongV", {v.x, v.y}}};
}

nlohmann::ordered_json receiverJson(const RadianceReceiver& receiver,
                                    const RadianceTexture& texture,
                                    const Picture& picture, std::size_t index) {
    static constexpr const char* kShapes[] = {"parallelogram", "triangle", "polygon"};
    return {{"name", receiver.name},
            {"shape", kShapes[std::size_t(receiver.shape)]},
            {"corner", vectorJson(receiver.plane.corner)},
            {"edgeX", vectorJson(receiver.plane.edgeX)},
            {"edgeY", vectorJson(receiver.plane.edgeY)},
            {"texels", {texture.width, texture.height}},
            {"samples", texture.samples},
            {"flatness", name(texture.flatness)},
            {"file", picture.path},
            {"place", placeJson(picture, index, {texture.width, texture.height})}};
}

nlohmann::ordered_json reportJson(const std::vector<RadianceReceiver>& receivers,
                                  const std::vector<RadianceTexture>& textures,
                                  const std::vector<Picture>& pictures,
                                  const std::vector<RadianceLight>& lights,
                                  const ShadowCasters& casters, double seconds) {
    nlohmann::ordered_json j;
    j["casters"] = {{"triangles", casters.triangles()}, {"segments", casters.segments()}};
    j["lights"] = nlohmann::ordered_json::array();
    for (const RadianceLight& light : lights) {
        j["lights"].push_back(lightJson(light.light));
        j["lights"].back()["radiance"] = vectorJson(light.radiance);
    }
    j["receivers"] = nlohmann::ordered_json::array();
    std::uint64_t looked = 0;
    for (std::size_t i = 0; i < receivers.size(); ++i) {
        looked += textures[i].looked;
        const auto picture =
            std::find_if(pictures.begin(), pictures.end(),
                         [&](const Picture& p) { return p.first == i || p.second == i; });
        j["receivers"].push_back(receiverJson(receivers[i], textures[i], *picture, i));
    }
    j["castersDrawn"] = looked;
    j["seconds"] = seconds;
    j["peakMemory"] = peakMemory();
    return j;
}

void say(const std::vector<RadianceReceiver>& receivers,
         const std::vector<RadianceTexture>& textures,
         const std::vector<Picture>& pictures, double seconds, Talk& talk) {
    std::uint64_t texels = 0, samples = 0, constant = 0, linear = 0;
    for (std::size_t i = 0; i < textures.size(); ++i) {
        const RadianceTexture& t = textures[i];
        texels += std::uint64_t(t.width) * t.height;
        std::uint64_t own = 0;
        for (const int n : t.samples)
            own += std::uint64_t(n);
        if (own == 0)
            talk.warn(receivers[i].name +
                      ": no light shines on its lit side, the one from which its corners "
                      "run counter-clockwise");
        samples += own;
        constant += t.flatness == Flatness::constant;
        linear += t.flatness == Flatness::linear;
    }
    talk.say(countText(textures.size()) +
             (textures.size() == 1 ? " receiver, " : " receivers, ") + countText(texels) +
             " texels, " + countText(samples) + " hard shadow images, " +
             secondsText(seconds));
    if (constant || linear)
        talk.say(countText(constant) + " constant and " + countText(linear) +
                 " linear: these need no texture");
    talk.say("wrote " + pictures.front().path +
             (pictures.size() > 1 ? " to " + pictures.back().path : ""));
}

void checkArguments(const Arguments& a, const CLI::App& app) {
    const std::string type = extension(a.output);
    if (a.output.empty())
        throw UsageError("-o is missing: the pictures need a file, such as -o floor.exr");
    if (type != ".exr" && type != ".png")
        throw UsageError("-o: found \"" + a.output +
                         "\", expected a name that ends in .exr or .png");
    if (a.white && type != ".png") throw UsageError("--white: belongs to a .png");
    if (a.parallelograms.empty() && a.polygons.empty() && a.receiverNames.empty())
        throw UsageError(
            "no receiver: give --receiver, --polygon or --receivers, such as "
            "--receiver -2,0,2,4,0,0,0,0,-4");
    if (app.count("--radiance") && !a.light.options.any() && !a.lights.empty())
        throw UsageError(
            "--radiance: belongs to the light of --light-position and its like; in "
            "--light it is radiance=R,G,B");
    for (const std::string& text : a.lights)
        (void)parseLight(text);
}

void run(const Arguments& a, const CLI::App& app, Talk& talk) {
    talk.setQuiet(a.quiet);
    checkArguments(a, app);
    checkOutput(a.output, a.inputs);
    const std::vector<CasterFile> files = casterFiles(a);
    refuseMaps(files);
    std::vector<RadianceReceiver> receivers = receiversOf(a, talk);
    CasterFiles source(files, filesOptions(talk));
    const ShadowCasters casters = unwrap(ShadowCasters::build(
        source, [&talk](const std::string& text) { talk.warn(text); }));
    talk.progressDone();
    if (casters.triangles() + casters.segments() == 0)
        if (const std::string why = emptyingSettings(files); !why.empty())
            talk.warn("nothing casts a shadow: " + why);
    const std::vector<RadianceLight> lights = lightsOf(a, casters.bounds());

    RadianceOptions options = radianceOptions(a);
    const auto pairs = pairTriangles(receivers, options);
    const auto pictures = picturesOf(a.output, receivers, pairs);
    for (const Picture& picture : pictures)
        checkOutput(picture.path, a.inputs);
    if (a.progressive)
        options.refined = [&](int samples,
                              const std::vector<RadianceTexture>& textures) -> Status {
            write(a, pictures, textures);
            talk.say("pictures of up to " + countText(std::uint64_t(samples)) +
                     (samples == 1 ? " sample" : " samples") + " of each light");
            return {};
        };
    const auto start = std::chrono::steady_clock::now();
    const auto textures = unwrap(radianceTextures(casters, receivers, lights, options));
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (!a.progressive) write(a, pictures, textures);
    say(receivers, textures, pictures, seconds, talk);
    if (a.json)
        print(jsonText(
            reportJson(receivers, textures, pictures, lights, casters, seconds)));
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-radiance");
    CLI::App app(kAbout, "mtsm-radiance");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    return runTool(app, argc, argv, talk, [&] {
        withThreads(arguments.threads, [&] { run(arguments, app, talk); });
    });
}
