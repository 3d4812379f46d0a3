// mtsm-query - a map and points, rays or a picture in, shadow factors out.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <glm/geometric.hpp>
#include <memory>

#include "common/arguments.h"
#include "common/light_options.h"
#include "common/tool.h"
#include "mtsm/describe.h"
#include "mtsm/image.h"
#include "mtsm/passes.h"
#include "mtsm/points.h"
#include "mtsm/reader.h"
#include "mtsm/shadow.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;

constexpr const char* kAbout =
    "Answers shadow queries from a map alone. Shadow factor: 0 lit, 1 dark; visibility "
    "is\n"
    "1 minus that. World space throughout, lengths in the units of the map. Give one of\n"
    "--point, --points, --rays, --position and --plane.";

constexpr const char* kExamples =
    "Input files are CSV with a line of names: x,y,z[,nx,ny,nz] for points and\n"
    "ox,oy,oz,dx,dy,dz[,tmax] for rays; columns in any order, others ignored, lines with "
    "#\n"
    "skipped. A ray's direction may have any length; tmax is a distance in world units, "
    "none\n"
    "or inf means without end. Points that are not finite are lit.\n"
    "A position pass is an EXR with three float channels of world positions, called P,\n"
    "Position, RenderLayer.Position and such. Pixels without a surface (alpha 0, or not\n"
    "finite) are lit.\n"
    "Output by extension: .exr (channels shadow and visibility), .png (8-bit grey), "
    ".csv;\n"
    "points and rays without -o go to stdout as CSV. A map that was baked with --color\n"
    "answers red, green and blue: .exr has the shadow factors as R, G, B and "
    "visibility.R "
    "and\n"
    "so on, .png is in colour, CSV has columns shadow_r and so on.\n"
    "\nExamples:\n"
    "  one point, with the receiver's normal:\n"
    "    mtsm-query key.mtsm --point 0,0,0 --normal 0,1,0\n"
    "  a renderer's passes to a shadow pass:\n"
    "    mtsm-query key.mtsm --position beauty.exr --normal-pass beauty.exr \\\n"
    "               --samples 256 -o shadow.exr --stats\n"
    "  the floor seen from above, four units wide around the origin, x to the right\n"
    "  and z down; the first row of the picture is at O:\n"
    "    mtsm-query key.mtsm --plane -2,0,-2,4,0,0,0,0,4 --size 512x512 -o floor.png\n"
    "  rays of your own:\n"
    "    mtsm-query key.mtsm --rays rays.csv > visibility.csv\n";

constexpr std::uint32_t kMostSide = 65536;                     // of --size
constexpr std::uint64_t kMostPixels = std::uint64_t(1) << 28;  // of --size
constexpr std::size_t kSliceRays = std::size_t(1) << 20;       // between progress reports
constexpr std::size_t kMostSlice = std::size_t(1) << 16;       // points at once
constexpr std::size_t kFewValues = 10000;                      // that --json lists

struct Arguments {
    std::string map;
    std::vector<glm::dvec3> points, normals;  // normals: {0, 0, 0} where none was given
    std::string pointsFile, raysFile, positionFile, normalFile, positionLayer,
        normalLayer;
    std::string plane, size;
    bool noNormal = false;
    std::string output;
    std::int64_t samples = 64, seed = 0, threads = 0;
    bool adaptive = false;
    std::optional<double> bias, threshold;
    LightOptions light;
    std::optional<std::size_t> method, quantity, weight, attenuation;
    std::string maxMemory = "8G";
    bool json = false, stats = false, quiet = false;
};

enum class Kind { point, points, rays, position, plane };

void addOptions(CLI::App& app, Arguments& a) {
    app.add_option("MAP", a.map, "the map file")
        ->required()
        ->type_name("FILE")
        ->group("Input");
    // Callbacks run in the order of the command line only when each occurrence triggers.
    app.add_option_function<std::string>(
           "--point",
           [&a](const std::string& text) {
               a.points.push_back(parseTriple("--point", text));
               a.normals.emplace_back(0.0);
           },
           "a point; may be repeated")
        ->type_name("X,Y,Z")
        ->trigger_on_parse()
        ->group("Input");
    app.add_option_function<std::string>(
           "--normal",
           [&a](const std::string& text) {
               if (a.normals.empty())
                   throw UsageError(
                       "--normal: belongs behind the --point that it is for");
               a.normals.back() = parseTriple("--normal", text);
           },
           "the surface normal at the --point before it")
        ->type_name("X,Y,Z")
        ->trigger_on_parse()
        ->group("Input");
    addText(app, "--points", a.pointsFile, "FILE|-", "CSV of points; - reads stdin")
        ->group("Input");
    addText(app, "--rays", a.raysFile, "FILE|-", "CSV of shadow rays; - reads stdin")
        ->group("Input");
    addText(app, "--position", a.positionFile, "P.exr", "a position pass")
        ->group("Input");
    addText(app, "--position-layer", a.positionLayer, "NAME",
            "its layer, where the name is not a usual one")
        ->group("Input");
    addText(app, "--normal-pass", a.normalFile, "N.exr",
            "normals for --position; may be the same file")
        ->group("Input");
    addText(app, "--normal-layer", a.normalLayer, "NAME", "their layer")->group("Input");
    addText(app, "--plane", a.plane, "OX,OY,OZ,UX,UY,UZ,VX,VY,VZ",
            "points O + U (i + 0.5) / W + V (j + 0.5) / H of\n"
            "a W x H picture, first row at O; their normal is\n"
            "cross(U, V), turned to the light's side")
        ->group("Input");
    addText(app, "--size", a.size, "N|WxH", "pixels of --plane")->group("Input");
    app.add_flag("--no-normal", a.noNormal, "ask for --plane's points without a normal")
        ->group("Input");

    addText(app, "-o,--output", a.output, "OUT.exr|png|csv",
            "where results go; needed for pictures")
        ->group("Output");
    addChoice(app, "--quantity", a.quantity, {"shadow", "visibility"},
              "what a .png shows (default: visibility, white is\n"
              "lit), or the only one of both in CSV and JSON; an\n"
              ".exr has both always")
        ->group("Output");
    app.add_flag("--json", a.json,
                 "print statistics, and the results of up to 10000\n"
                 "points or rays, to stdout as a JSON object")
        ->group("Output");
    app.add_flag("--stats", a.stats,
                 "print points, rays, seconds, rays per second and the\n"
                 "layers that were read")
        ->group("Output");

    addWhole(app, "--samples", a.samples, 1, kMaxSamples,
             "points on the light, 1 to 4096 (default: 64)")
        ->group("Query");
    addWhole(app, "--seed", a.seed, 0, 0xffffffffll,
             "same seed, same answer on any machine (default: 0)")
        ->group("Query");
    addNumber(app, "--bias", a.bias, {0.0, kAny}, "Z",
              "depth within which a layer is met, world units\n"
              "(default: the map's); of opaque maps only with\n"
              "--method scalar and for where rays start without\n"
              "normals")
        ->group("Query");
    addNumber(app, "--threshold", a.threshold, {0.0, 1.0, true}, "V",
              "a ray with less visibility left is dark, 0 to\n"
              "below 1 (default: 1/1024)")
        ->group("Query");
    app.add_flag("--adaptive", a.adaptive,
                 "points of which the first 16 samples see the same\n"
                 "take no more; with --method trace")
        ->group("Query");
    addChoice(app, "--method", a.method, {"trace", "scalar", "pcf"},
              "rays through the map; the same ray by ray, as the\n"
              "paper does, slow and without the near field; or\n"
              "percentage-closer filtering, for small lights\n"
              "(default: trace)")
        ->group("Query");
    addChoice(app, "--weight", a.weight, {"uniform", "cosine"},
              "plain mean over the light, or the ratio of\n"
              "irradiances, which needs normals (default: uniform)")
        ->group("Query");
    addChoice(app, "--attenuation", a.attenuation, {"multiply", "subtract"},
              "a sample leaves a part of what reaches it, or takes\n"
              "its share of all, as the paper does (default:\n"
              "multiply)")
        ->group("Query");
    addLightSizeOptions(app, a.light,
                        "Light (default: the map's; another must lie within it)",
                        "the map's");
    addWhole(app, "--threads", a.threads, 0, 1024,
             "0: as many as the machine has (default)")
        ->group("General");
    addMaxMemory(app, a.maxMemory)->group("General");
    app.add_flag("--quiet", a.quiet, "say nothing but warnings and errors")
        ->group("General");
}

/// The one kind of input that was given.
Kind inputKind(const Arguments& a) {
    const std::pair<bool, Kind> given[] = {{!a.points.empty(), Kind::point},
                                           {!a.pointsFile.empty(), Kind::points},
                                           {!a.raysFile.empty(), Kind::rays},
                                           {!a.positionFile.empty(), Kind::position},
                                           {!a.plane.empty(), Kind::plane}};
    const auto count = std::count_if(std::begin(given), std::end(given),
                                     [](const auto& g) { return g.first; });
    if (count != 1)
        throw UsageError(std::string(count ? "more than one kind" : "no kind") +
                         " of input: give one of --point, --points, --rays, --position "
                         "and --plane");
    return std::find_if(std::begin(given), std::end(given),
                        [](const auto& g) { return g.first; })
        ->second;
}

bool isPicture(Kind kind) {
    return kind == Kind::position || kind == Kind::plane;
}

/// Refuses what cannot go together, before anything is read.
void checkArguments(const Arguments& a, const CLI::App& app, Kind kind) {
    const auto only = [&](const char* option, bool fits, const char* belongs) {
        if (app.count(option) && !fits)
            throw UsageError(std::string(option) + ": belongs to " + belongs);
    };
    only("--position-layer", kind == Kind::position, "--position");
    only("--normal-pass", kind == Kind::position, "--position");
    only("--normal-layer", !a.normalFile.empty(), "--normal-pass");
    only("--size", kind == Kind::plane, "--plane");
    only("--no-normal", kind == Kind::plane, "--plane");
    for (const char* option :
         {"--samples", "--seed", "--adaptive", "--method", "--weight", "--light-shape",
          "--light-position", "--light-radius", "--light-size", "--light-angle"})
        only(option, kind != Kind::rays, "points; a ray needs no light");
    if (kind == Kind::plane && a.size.empty())
        throw UsageError("--plane: needs --size WxH, such as --size 512x512");
    const bool normals = kind == Kind::point
                             ? a.normals != std::vector(a.points.size(), glm::dvec3(0.0))
                         : kind == Kind::position ? !a.normalFile.empty()
                                                  : !a.noNormal;
    if (a.weight.value_or(0) == 1 && !normals)
        throw UsageError("--weight: cosine needs the receiver's normals");

    const std::string type = extension(a.output);
    if (a.output.empty()) {
        if (isPicture(kind))
            throw UsageError(
                "-o is missing: a picture needs a file, such as -o shadow.exr");
        return;
    }
    if (type != ".exr" && type != ".png" && type != ".csv")
        throw UsageError("-o: found \"" + a.output +
                         "\", expected a name that ends in .exr, .png or .csv");
    if (type != ".csv" && !isPicture(kind))
        throw UsageError(
            "-o: points and rays are no picture; use a name that ends in .csv");
}

/// What is asked for: points, one after another, in world space.
struct Receivers {
    std::size_t count = 0;
    std::function<glm::dvec3(std::size_t)> point;
    std::function<glm::dvec3(std::size_t)> normal;  ///< empty: none is known
    std::function<bool(std::size_t)> surface;       ///< empty: there is one everywhere
    PixelWindow data, display;                      ///< of pictures
    std::string positionLayer, normalLayer;         ///< of passes: what was read
    bool passes = false, normalPass = false;
};

Receivers pointReceivers(PointList list) {
    auto shared = std::make_shared<const PointList>(std::move(list));
    Receivers r;
    r.count = shared->points.size();
    r.point = [shared](std::size_t i) { return shared->points[i]; };
    if (!shared->normals.empty())
        r.normal = [shared](std::size_t i) { return shared->normals[i]; };
    return r;
}

/// A layer of an EXR as messages have it.
std::string layerText(const std::string& layer) {
    return layer.empty() ? "the one unnamed layer" : "layer \"" + printable(layer) + "\"";
}

Receivers passReceivers(const Arguments& a) {
    PassOptions options;
    options.layer = a.positionLayer;
    auto pass =
        std::make_shared<const Pass>(unwrap(readPositionPass(a.positionFile, options)));
    Receivers r;
    r.passes = true;
    r.positionLayer = pass->layer;
    r.count = pass->pixels();
    r.data = pass->data;
    r.display = pass->display;
    r.point = [pass](std::size_t i) { return glm::dvec3(pass->values[i]); };
    r.surface = [pass](std::size_t i) { return pass->surface[i] != 0; };
    if (a.normalFile.empty()) return r;
    options.layer = a.normalLayer;
    auto normals = std::make_shared<const Pass>(
        unwrap(readNormalPass(a.normalFile, *pass, options)));
    std::error_code problem;
    if (normals->layer == pass->layer &&
        std::filesystem::equivalent(a.positionFile, a.normalFile, problem))
        throw UsageError("--normal-pass: " + layerText(pass->layer) + " of " +
                         a.normalFile +
                         " holds the positions already; name the normals with "
                         "--normal-layer, or give another file");
    r.normalPass = true;
    r.normalLayer = normals->layer;
    r.normal = [normals](std::size_t i) { return glm::dvec3(normals->values[i]); };
    return r;
}

Receivers planeReceivers(const Arguments& a, const AreaLight& light) {
    const auto n = parseNumbers("--plane", a.plane, 9, "OX,OY,OZ,UX,UY,UZ,VX,VY,VZ");
    const glm::dvec3 o(n[0], n[1], n[2]), u(n[3], n[4], n[5]), v(n[6], n[7], n[8]);
    const glm::uvec2 size = parseResolution("--size", a.size, kMostSide);
    if (std::uint64_t(size.x) * size.y > kMostPixels)
        throw UsageError("--size: found \"" + a.size + "\", expected at most " +
                         countText(kMostPixels) + " pixels");
    glm::dvec3 normal = glm::cross(u, v);
    if (!(glm::length(normal) > 0.0))
        throw UsageError("--plane: U and V span no plane: they are parallel or zero");
    normal = glm::normalize(normal);
    const glm::dvec3 toLight =
        light.shape == LightShape::sun ? -light.direction : light.position - o;
    if (glm::dot(normal, toLight) < 0.0) normal = -normal;

    Receivers r;
    r.count = std::size_t(size.x) * size.y;
    r.data = r.display = {0, 0, size.x, size.y};
    r.point = [=](std::size_t i) {
        return o + u * ((double(i % size.x) + 0.5) / size.x) +
               v * ((double(i / size.x) + 0.5) / size.y);
    };
    if (!a.noNormal) r.normal = [normal](std::size_t) { return normal; };
    return r;
}

Receivers receivers(const Arguments& a, Kind kind, const AreaLight& light) {
    switch (kind) {
        case Kind::point:
            return pointReceivers({a.points, a.normals});
        case Kind::points:
            return pointReceivers(unwrap(readPoints(a.pointsFile)));
        case Kind::position:
            return passReceivers(a);
        default:
            return planeReceivers(a, light);
    }
}

/// One of the results' quantities: a plane, or three of a map with coloured visibility.
using Planes = std::vector<std::vector<float>>;

/// What came of it, and what it took.
struct Results {
    Planes shadow;  ///< for rays: 1 - visibility
    Planes visibility;
    QueryStats stats;
    double seconds = 0;
};

constexpr const char* kColors[] = {"r", "g", "b"};

/// 1 minus each value.
Planes complement(const Planes& planes) {
    Planes result = planes;
    for (auto& plane : result)
        for (float& v : plane)
            v = 1.0f - v;
    return result;
}

/// Runs `slice(begin, end)` over all of `count`.
template <typename Slice>
double inSlices(std::size_t count, std::size_t step, Talk& talk, Slice&& slice) {
    const auto start = std::chrono::steady_clock::now();
    for (std::size_t begin = 0; begin < count; begin += step) {
        talk.progress("tracing", double(begin) / double(count));
        slice(begin, std::min(count, begin + step));
    }
    talk.progressDone();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
        .count();
}

void add(QueryStats& sum, const QueryStats& s) {
    sum.points += s.points;
    sum.rays += s.rays;
    sum.notFinite += s.notFinite;
    sum.behindLight += s.behindLight;
    sum.mayBeTruncated += s.mayBeTruncated;
}

Results queryPoints(const ShadowMap& map, const AreaLight& light,
                    const ShadowOptions& options, const Receivers& r, Talk& talk) {
    Results results;
    results.shadow.assign(map.info().channels, std::vector<float>(r.count, 0.0f));
    std::vector<std::size_t> which;
    std::vector<glm::dvec3> points, normals;
    std::vector<glm::vec3> shadow;
    const std::size_t step = std::clamp<std::size_t>(
        kSliceRays / std::size_t(options.samples), 1024, kMostSlice);
    results.seconds =
        inSlices(r.count, step, talk, [&](std::size_t begin, std::size_t end) {
            which.clear();
            points.clear();
            normals.clear();
            for (std::size_t i = begin; i < end; ++i) {
                if (r.surface && !r.surface(i)) continue;
                which.push_back(i);
                points.push_back(r.point(i));
                if (r.normal) normals.push_back(r.normal(i));
            }
            shadow.resize(which.size());
            QueryStats stats;
            shadowFactorsColor(map, light, points.data(),
                               r.normal ? normals.data() : nullptr, points.size(),
                               shadow.data(), options, &stats);
            add(results.stats, stats);
            for (std::size_t c = 0; c < results.shadow.size(); ++c)
                for (std::size_t k = 0; k < which.size(); ++k)
                    results.shadow[c][which[k]] = shadow[k][int(c)];
        });
    results.visibility = complement(results.shadow);
    return results;
}

Results queryRays(const ShadowMap& map, const std::vector<ShadowRay>& rays,
                  const RayOptions& options, Talk& talk) {
    Results results;
    results.visibility.assign(map.info().channels, std::vector<float>(rays.size()));
    std::vector<glm::vec3> visibility;
    results.seconds =
        inSlices(rays.size(), kMostSlice, talk, [&](std::size_t begin, std::size_t end) {
            visibility.resize(end - begin);
            visibilitiesColor(map, rays.data() + begin, end - begin, visibility.data(),
                              options);
            for (std::size_t c = 0; c < results.visibility.size(); ++c)
                for (std::size_t k = 0; k < visibility.size(); ++k)
                    results.visibility[c][begin + k] = visibility[k][int(c)];
        });
    results.stats.rays = rays.size();
    results.shadow = complement(results.visibility);
    return results;
}

// --- results ---------------------------------------------------------------------------

/// The result columns that --quantity leaves; `both` is the default. In colour a column
/// each for red, green and blue.
std::vector<CsvColumn> resultColumns(const Arguments& a, const Results& results,
                                     bool both) {
    std::vector<CsvColumn> columns;
    const auto add = [&](const std::string& name, const Planes& planes) {
        for (std::size_t c = 0; c < planes.size(); ++c)
            columns.push_back(
                {planes.size() == 1 ? name : name + "_" + kColors[c], planes[c].data()});
    };
    const bool all = !a.quantity && both;
    if (all || a.quantity.value_or(1) == 0) add("shadow", results.shadow);
    if (all || a.quantity.value_or(1) == 1) add("visibility", results.visibility);
    return columns;
}

void writeTable(const Arguments& a, const std::vector<CsvColumn>& columns,
                std::size_t rows) {
    if (a.output.empty()) return unwrap(writeCsv("-", columns, rows));
    const Writing writing(a.output);
    unwrap(writeCsv(a.output, columns, rows));
}

void writePointCsv(const Arguments& a, const Receivers& r, const Results& results) {
    std::vector<glm::dvec3> points(r.count);
    for (std::size_t i = 0; i < r.count; ++i)
        points[i] = r.point(i);
    const glm::dvec3 none(0.0);
    const double* first = points.empty() ? &none.x : &points[0].x;
    std::vector<CsvColumn> columns{
        {"x", first, 3}, {"y", first + 1, 3}, {"z", first + 2, 3}};
    for (CsvColumn& c : resultColumns(a, results, true))
        columns.push_back(std::move(c));
    writeTable(a, columns, r.count);
}

void writeRayCsv(const Arguments& a, const std::vector<ShadowRay>& rays,
                 const Results& results) {
    static_assert(sizeof(ShadowRay) == 7 * sizeof(double));
    const ShadowRay none;
    const ShadowRay* first = rays.empty() ? &none : rays.data();
    std::vector<CsvColumn> columns{
        {"ox", &first->origin.x, 7},    {"oy", &first->origin.y, 7},
        {"oz", &first->origin.z, 7},    {"dx", &first->direction.x, 7},
        {"dy", &first->direction.y, 7}, {"dz", &first->direction.z, 7},
        {"tmax", &first->length, 7}};
    for (CsvColumn& c : resultColumns(a, results, false))
        columns.push_back(std::move(c));
    writeTable(a, columns, rays.size());
}

void writePicture(const Arguments& a, const Receivers& r, const AreaLight& light,
                  Results& results) {
    const Writing writing(a.output);
    if (extension(a.output) == ".png") {
        const Planes& planes =
            a.quantity.value_or(1) == 0 ? results.shadow : results.visibility;
        const std::uint32_t w = r.data.width, h = r.data.height;
        unwrap(writeImagePng(a.output, planes.size() == 1
                                           ? greyImage(w, h, planes[0], 0.0f, 1.0f)
                                           : colorImage(w, h, planes[0], planes[1],
                                                        planes[2], 0.0f, 1.0f)));
        return;
    }
    FloatImage image(r.data.width, r.data.height);
    image.data = r.data;
    image.display = r.display;
    const bool colored = results.shadow.size() == 3;
    for (std::size_t c = 0; c < results.shadow.size(); ++c) {
        const std::string color = std::string(1, "RGB"[c]);
        image.channels.push_back(
            {colored ? color : "shadow", std::move(results.shadow[c])});
        image.channels.push_back({colored ? "visibility." + color : "visibility",
                                  std::move(results.visibility[c])});
    }
    image.attributes = {{"mtsm:map", a.map}, {"mtsm:light", lightText(light)}};
    unwrap(writeImageExr(a.output, image));
}

nlohmann::ordered_json statsJson(const Arguments& a, const Receivers& r,
                                 const Results& results) {
    const QueryStats& s = results.stats;
    nlohmann::ordered_json j;
    j["map"] = a.map;
    if (!a.output.empty()) j["output"] = a.output;
    if (r.passes) j["positionLayer"] = r.positionLayer;
    if (r.normalPass) j["normalLayer"] = r.normalLayer;
    j["points"] = s.points;
    j["rays"] = s.rays;
    j["seconds"] = results.seconds;
    j["raysPerSecond"] = results.seconds > 0 ? double(s.rays) / results.seconds : 0.0;
    j["notFinite"] = s.notFinite;
    j["behindLight"] = s.behindLight;
    j["mayBeTruncated"] = s.mayBeTruncated;
    return j;
}

void printJson(const nlohmann::ordered_json& j) {
    print(jsonText(j));
}

/// One object per result, unless they are a picture or too many. In colour three numbers.
nlohmann::ordered_json valuesJson(const Arguments& a, const Results& results) {
    const auto numbers = [](const Planes& planes, std::size_t i) {
        if (planes.size() == 1) return nlohmann::ordered_json(planes[0][i]);
        return nlohmann::ordered_json::array({planes[0][i], planes[1][i], planes[2][i]});
    };
    auto values = nlohmann::ordered_json::array();
    for (std::size_t i = 0; i < results.shadow.front().size(); ++i) {
        nlohmann::ordered_json value;
        if (a.quantity.value_or(0) == 0) value["shadow"] = numbers(results.shadow, i);
        if (a.quantity.value_or(1) == 1)
            value["visibility"] = numbers(results.visibility, i);
        values.push_back(std::move(value));
    }
    return values;
}

void sayStats(const Arguments& a, const Receivers& r, const Results& results,
              Talk& talk) {
    const QueryStats& s = results.stats;
    if (a.stats) {
        if (r.passes)
            talk.answer("positions from " + layerText(r.positionLayer) +
                        (r.normalPass ? ", normals from " + layerText(r.normalLayer)
                                      : std::string()));
        talk.answer(
            countText(s.points) + " points, " + countText(s.rays) + " rays, " +
            secondsText(results.seconds) + ", " +
            countText(std::uint64_t(double(s.rays) / std::max(results.seconds, 1e-9))) +
            " rays per second");
        talk.answer(countText(s.notFinite) + " points not finite, " +
                    countText(s.behindLight) + " behind the light, " +
                    countText(s.mayBeTruncated) + " may be truncated");
    } else if (s.mayBeTruncated) {
        talk.warn(countText(s.mayBeTruncated) + " of " + countText(s.points) +
                  " points lie outside the light's view, where casters that reach out of "
                  "the map's window may be missing; bake a wider --fov");
    }
}

void report(const Arguments& a, Kind kind, const Receivers& r, const Results& results,
            Talk& talk) {
    sayStats(a, r, results, talk);
    if (!a.json) return;
    auto j = statsJson(a, r, results);
    if (!isPicture(kind) && results.shadow.front().size() <= kFewValues)
        j["values"] = valuesJson(a, results);
    printJson(j);
}

// --- the two kinds of query -----------------------------------------------------------

void refuseLongJson(const Arguments& a, std::size_t count) {
    if (a.json && a.output.empty() && count > kFewValues)
        throw UsageError("--json: lists up to " + countText(kFewValues) +
                         " results and " + "there are " + countText(count) +
                         "; give -o FILE.csv for them");
}

Attenuation attenuation(const Arguments& a) {
    return a.attenuation.value_or(0) == 1 ? Attenuation::subtract : Attenuation::multiply;
}

void runRays(const Arguments& a, const ShadowMap& map, Talk& talk) {
    RayOptions options;
    if (a.bias) options.bias = float(*a.bias);
    if (a.threshold) options.threshold = float(*a.threshold);
    options.attenuation = attenuation(a);
    const std::vector<ShadowRay> rays = unwrap(readRays(a.raysFile));
    refuseLongJson(a, rays.size());
    const Results results = queryRays(map, rays, options, talk);
    if (!a.json || !a.output.empty()) writeRayCsv(a, rays, results);
    report(a, Kind::rays, {}, results, talk);
}

void runPoints(const Arguments& a, Kind kind, const ShadowMap& map, Talk& talk) {
    AreaLight light = map.info().light;
    if (const auto shape = a.light.shape(); shape && a.light.shapeIndex)
        light.shape = *shape;
    applyLightOptions(a.light, light);
    ShadowOptions options;
    options.samples = int(a.samples);
    options.adaptive = a.adaptive;
    options.seed = std::uint32_t(a.seed);
    if (a.bias) options.bias = float(*a.bias);
    if (a.threshold) options.threshold = float(*a.threshold);
    options.method = ShadowMethod(a.method.value_or(0));
    options.weight = a.weight.value_or(0) == 1 ? Weight::cosine : Weight::uniform;
    options.attenuation = attenuation(a);
    unwrap(checkQuery(map, light, options));

    const Receivers r = receivers(a, kind, light);
    if (options.weight == Weight::cosine && !r.normal)
        throw UsageError(
            "--weight: cosine needs the receiver's normals: columns nx,ny,nz");
    refuseLongJson(a, isPicture(kind) ? 0 : r.count);
    Results results = queryPoints(map, light, options, r, talk);
    if (isPicture(kind) && extension(a.output) != ".csv")
        writePicture(a, r, light, results);
    else if (!a.json || !a.output.empty())
        writePointCsv(a, r, results);
    report(a, kind, r, results, talk);
}

void run(const Arguments& a, const CLI::App& app, Talk& talk) {
    talk.setQuiet(a.quiet);
    const Kind kind = inputKind(a);
    checkArguments(a, app, kind);
    if (!a.output.empty())
        checkOutput(a.output,
                    {a.map, a.pointsFile, a.raysFile, a.positionFile, a.normalFile});
    const ShadowMap map = unwrap(readMap(a.map, readLimits(a.maxMemory)));
    if (kind == Kind::rays)
        runRays(a, map, talk);
    else
        runPoints(a, kind, map, talk);
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-query");
    CLI::App app(kAbout, "mtsm-query");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    return runTool(app, argc, argv, talk, [&] {
        withThreads(arguments.threads, [&] { run(arguments, app, talk); });
    });
}
