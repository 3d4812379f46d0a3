// mtsm-query - a map and points, rays or a picture in, shadow factors out.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <glm/geometric.hpp>
#include <memory>
#include <random>

#include "common/arguments.h"
#include "common/light_options.h"
#include "common/map_file.h"
#include "common/passes.h"
#include "common/quality_options.h"
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
    "skipped. A ray's direction may have any length, and comes out as it was given; tmax "
    "is\n"
    "a distance in world units, inf or no such column means without end. Points that are "
    "not "
    "finite\n"
    "are lit.\n"
    "A position pass is an EXR with three float channels of world positions, called P,\n"
    "Position, RenderLayer.Position and such; a file of R, G, B alone is taken for one "
    "with\n"
    "a warning, and half floats are too coarse. Pixels without a surface (alpha 0, or "
    "not\n"
    "finite) are lit; a pass in which no position is finite is an error.\n"
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
    "  as few samples as a mean error of 0.002 needs, and where errors are expected:\n"
    "    mtsm-query key.mtsm --position beauty.exr --normal-pass beauty.exr \\\n"
    "               --target-error 0.002 --error-channel -o shadow.exr --stats\n"
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
constexpr std::uint64_t kQuicklyReady = 6'000'000;  // pixels and layers: about 2 s
constexpr std::int64_t kFewestForErrors = 4;        // samples

struct Arguments {
    std::string map;
    std::vector<glm::dvec3> points, normals;  // normals: {0, 0, 0} where none was given
    std::string pointsFile, raysFile, positionFile, normalFile, positionLayer,
        normalLayer;
    std::string plane, size;
    bool noNormal = false, noNearField = false;
    std::string output;
    std::int64_t samples = 64, seed = 0, threads = 0;
    bool adaptive = false;
    std::optional<double> bias, threshold;
    LightOptions light;
    std::optional<std::size_t> method, quantity, weight, attenuation;
    std::string maxMemory = "8G";
    bool json = false, stats = false, quiet = false, errorChannel = false;
    QualityOptions quality;
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
               if (a.normals.back() == glm::dvec3(0.0))
                   throw UsageError("--normal: found \"" + text +
                                    "\", which has no direction");
           },
           "the surface normal at the --point before it")
        ->type_name("X,Y,Z")
        ->trigger_on_parse()
        ->group("Input");
    addText(app, "--points", a.pointsFile, "FILE|-", "CSV of points; - reads stdin")
        ->group("Input");
    addText(app, "--rays", a.raysFile, "FILE|-", "CSV of shadow rays; - reads stdin")
        ->group("Input");
    addText(app, "--position", a.positionFile, "P.exr",
            "a position pass: an EXR with world positions")
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
    addText(app, "--size", a.size, "N|WxH", "pixels of --plane, which needs it")
        ->group("Input");
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
    app.add_flag("--error-channel", a.errorChannel,
                 "write the expected error of every point as well: how\n"
                 "far the shadow factor is from that of infinitely many\n"
                 "samples, told from those that were taken; the map's\n"
                 "own error is not in it. In an .exr the channel\n"
                 "shadow.error, in CSV and JSON \"error\"")
        ->group("Output");
    app.add_flag("--json", a.json,
                 "print statistics, and the results of up to 10000\n"
                 "points or rays, to stdout as a JSON object")
        ->group("Output");
    app.add_flag("--stats", a.stats,
                 "print points, rays, seconds and rays per second, the\n"
                 "mean error that is expected, and which layers of the\n"
                 "EXR were read")
        ->group("Output");

    addQualityOptions(app, a.quality,
                      "samples and how they adapt by what a part of the\n"
                      "points shows",
                      "Query");
    addWhole(app, "--samples", a.samples, 1, kMaxSamples,
             "points on the light, 1 to 4096 (default: 64; with\n"
             "--quality or --target-error the most at a point:\n"
             "4096)")
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
                 "take no more; with --method trace; --quality and\n"
                 "--target-error adapt in a way of their own")
        ->group("Query");
    addChoice(app, "--method", a.method, {"trace", "scalar", "pcf"},
              "rays through the map; the same ray by ray, as the\n"
              "paper does, slow and without the near field; or\n"
              "percentage-closer filtering, for small lights\n"
              "(default: trace)")
        ->group("Query");
    app.add_flag("--no-near-field", a.noNearField,
                 "answer from the map's layers alone, as if they were\n"
                 "all that it has; also where its near field is damaged")
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
         {"--samples", "--seed", "--adaptive", "--method", "--quality", "--target-error",
          "--error-channel", "--weight", "--light-shape", "--light-position",
          "--light-radius", "--light-size", "--light-angle"})
        only(option, kind != Kind::rays, "points; a ray needs no light");
    if (a.errorChannel && extension(a.output) == ".png")
        throw UsageError("--error-channel: a .png has no place for it; write an .exr");
    if (a.errorChannel && app.count("--samples") && a.samples < kFewestForErrors)
        throw UsageError(
            "--error-channel: fewer than 4 samples say nothing of their error");
    if (a.quality.meanError() && a.method.value_or(0) != 0)
        throw UsageError("--quality, --target-error: are for --method trace");
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

Receivers passReceivers(const Arguments& a, Talk& talk) {
    PassOptions options;
    options.layer = a.positionLayer;
    auto pass =
        std::make_shared<const Pass>(unwrap(readPositionPass(a.positionFile, options)));
    warnOfPositions(talk, *pass, a.positionFile);
    checkSurfaces(talk, *pass, a.positionFile,
                  "give the file that has them, or name their layer with "
                  "--position-layer");
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
    warnOfNormals(talk, *normals, a.normalFile);
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

Receivers receivers(const Arguments& a, Kind kind, const AreaLight& light, Talk& talk) {
    switch (kind) {
        case Kind::point:
            return pointReceivers({a.points, a.normals});
        case Kind::points:
            return pointReceivers(unwrap(readPoints(a.pointsFile)));
        case Kind::position:
            return passReceivers(a, talk);
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
    std::vector<float> error;  ///< expected, of the mean of the channels; if asked for
    QueryStats stats;
    double seconds = 0, prepareSeconds = 0;
    std::optional<std::uint64_t> memoryBytes;  ///< that the map took meanwhile
    /// Expected, if it is known: the mean over points that are surfaces, and the map's.
    std::optional<double> sampleError, mapError;
    std::uint64_t noNormal = 0;  ///< points whose normal has no direction
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

double since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
        .count();
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
    return since(start);
}

void add(QueryStats& sum, const QueryStats& s) {
    sum.points += s.points;
    sum.rays += s.rays;
    sum.notFinite += s.notFinite;
    sum.behindLight += s.behindLight;
    sum.mayBeTruncated += s.mayBeTruncated;
}

/// Are expected errors of use?
bool wantsErrors(const Arguments& a, const ShadowOptions& options) {
    return a.errorChannel || ((a.stats || a.json) && options.samples >= kFewestForErrors);
}

bool isFinite(glm::dvec3 p) {
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

bool isDirection(glm::dvec3 n) {
    return std::isfinite(n.x + n.y + n.z) && n != glm::dvec3(0.0);
}

Results queryPoints(const ShadowMap& map, const AreaLight& light,
                    const ShadowOptions& options, bool errors, const Receivers& r,
                    Talk& talk) {
    Results results;
    results.shadow.assign(map.info().channels, std::vector<float>(r.count, 0.0f));
    if (errors) results.error.assign(r.count, 0.0f);
    std::vector<std::size_t> which;
    std::vector<float> error;
    double sumOfErrors = 0.0;
    std::uint64_t surfaces = 0;
    std::vector<glm::dvec3> points, normals;
    std::vector<glm::vec3> shadow;
    const int samples =
        options.targetError > 0.0f ? options.firstSamples : options.samples;
    const std::size_t step =
        std::clamp<std::size_t>(kSliceRays / std::size_t(samples), 1024, kMostSlice);
    results.seconds =
        inSlices(r.count, step, talk, [&](std::size_t begin, std::size_t end) {
            which.clear();
            points.clear();
            normals.clear();
            for (std::size_t i = begin; i < end; ++i) {
                if (r.surface && !r.surface(i)) {
                    results.stats.notFinite += !isFinite(r.point(i));
                    continue;
                }
                which.push_back(i);
                points.push_back(r.point(i));
                if (!r.normal) continue;
                normals.push_back(r.normal(i));
                results.noNormal += !isDirection(normals.back());
            }
            shadow.resize(which.size());
            if (errors) error.resize(which.size());
            QueryStats stats;
            shadowFactorsColor(map, light, points.data(),
                               r.normal ? normals.data() : nullptr, points.size(),
                               shadow.data(), options, &stats,
                               errors ? error.data() : nullptr);
            add(results.stats, stats);
            for (std::size_t k = 0; errors && k < which.size(); ++k) {
                results.error[which[k]] = error[k];
                sumOfErrors += double(error[k]);
            }
            surfaces += which.size();
            for (std::size_t c = 0; c < results.shadow.size(); ++c)
                for (std::size_t k = 0; k < which.size(); ++k)
                    results.shadow[c][which[k]] = shadow[k][int(c)];
        });
    results.visibility = complement(results.shadow);
    if (errors && surfaces > 0) results.sampleError = sumOfErrors / double(surfaces);
    return results;
}

/// Which of `surfaces` points stand for all, by their place in the list: runs of
/// neighbours, one anywhere in each of as many stretches. (Not where stretches begin: in
/// many pictures all of them would be at the left edge.)
std::vector<std::size_t> placesToAsk(std::size_t surfaces) {
    constexpr std::size_t kRun = 16, kRuns = 512;
    std::vector<std::size_t> places;
    std::mt19937 random;
    const std::size_t runs = std::min(kRuns, (surfaces + kRun - 1) / kRun);
    for (std::size_t k = 0; k < runs; ++k) {
        std::size_t first = surfaces / runs * k;
        const std::size_t next = k + 1 < runs ? surfaces / runs * (k + 1) : surfaces;
        if (next - first > kRun) first += random() % (next - first - kRun + 1);
        for (std::size_t i = first; i < std::min(next, first + kRun); ++i)
            places.push_back(i);
    }
    return places;
}

/// Those of the receivers that have a surface and stand for all of them.
PointList pointsToAsk(const Receivers& r) {
    const auto isSurface = [&](std::size_t i) { return !r.surface || r.surface(i); };
    std::size_t surfaces = 0;
    for (std::size_t i = 0; i < r.count; ++i)
        surfaces += isSurface(i);
    const std::vector<std::size_t> places = placesToAsk(surfaces);
    PointList list;
    auto next = places.begin();
    for (std::size_t i = 0, place = 0; next != places.end(); ++i) {
        if (!isSurface(i) || place++ != *next) continue;
        ++next;
        list.points.push_back(r.point(i));
        if (r.normal) list.normals.push_back(r.normal(i));
    }
    return list;
}

/// What may bring the error down to what was asked for.
const char* adviceFor(const Arguments& a, std::optional<float> bakedFor,
                      const QueryPlan& plan, float asked) {
    if (plan.mapError <= 0.5f * asked) return "raise --samples";
    if (a.noNearField) return "leave out --no-near-field";
    // A little more than the text that the map remembers may have been rounded to.
    if (bakedFor && *bakedFor <= 1.0001f * asked)
        return "the map was baked for it, and that is what the worse maps of its kind "
               "have: it may well be better; hold it against the truth with "
               "mtsm-compare";
    return "bake the map with the same --target-error, or finer";
}

/// Options for the mean error that was asked for, by a part of the points; says what they
/// are.
ShadowOptions plannedOptions(const Arguments& a, const CLI::App& app,
                             const ShadowMap& map, const AreaLight& light,
                             ShadowOptions options, const Receivers& r, Talk& talk) {
    const PointList list = pointsToAsk(r);
    if (list.points.empty()) return options;
    if (!app.count("--samples")) options.samples = kMaxSamples;
    const float asked = *a.quality.meanError();
    const QueryPlan plan =
        planQueries(map, light, list.points.data(),
                    list.normals.empty() ? nullptr : list.normals.data(),
                    list.points.size(), asked, options);
    const ShadowOptions& o = plan.options;
    std::string text = "for a mean error of " + errorText(asked) + ": ";
    text +=
        counted(std::uint64_t(std::min(o.firstSamples, o.samples)), "sample", "samples");
    if (o.targetError > 0.0f && o.samples > o.firstSamples)
        text += " a point, up to " + std::to_string(o.samples) +
                " where more than an error of " + errorText(o.targetError) +
                " is expected";
    text += "; expected " + errorText(plan.sampleError) + " of samples and " +
            errorText(plan.mapError) + " of the map";
    if (plan.reached)
        talk.say(text);
    else
        talk.warn(text + ": more than was asked for; " +
                  adviceFor(a, bakedFor(map.info().settings), plan, asked));
    return o;
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
    if (a.errorChannel) columns.push_back({"error", results.error.data()});
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

/// Directions as they were given, so that rows can be found again by them.
void writeRayCsv(const Arguments& a, const std::vector<ShadowRay>& rays,
                 const std::vector<glm::dvec3>& directions, const Results& results) {
    static_assert(sizeof(ShadowRay) == 7 * sizeof(double));
    const ShadowRay none;
    const ShadowRay* first = rays.empty() ? &none : rays.data();
    const glm::dvec3* d = rays.empty() ? &none.direction : directions.data();
    std::vector<CsvColumn> columns{{"ox", &first->origin.x, 7},
                                   {"oy", &first->origin.y, 7},
                                   {"oz", &first->origin.z, 7},
                                   {"dx", &d->x, 3},
                                   {"dy", &d->y, 3},
                                   {"dz", &d->z, 3},
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
    if (a.errorChannel)
        image.channels.push_back({"shadow.error", std::move(results.error)});
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
    j["prepareSeconds"] = results.prepareSeconds;
    j["seconds"] = results.seconds;
    if (results.memoryBytes) j["memoryBytes"] = *results.memoryBytes;
    j["raysPerSecond"] = results.seconds > 0 ? double(s.rays) / results.seconds : 0.0;
    j["notFinite"] = s.notFinite;
    j["behindLight"] = s.behindLight;
    j["mayBeTruncated"] = s.mayBeTruncated;
    j["noNormal"] = results.noNormal;
    if (results.sampleError) j["sampleError"] = *results.sampleError;
    if (results.mapError) j["mapError"] = *results.mapError;
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
        if (a.errorChannel) value["error"] = results.error[i];
        values.push_back(std::move(value));
    }
    return values;
}

void sayStats(const Arguments& a, Kind kind, const Receivers& r, const Results& results,
              Talk& talk) {
    const QueryStats& s = results.stats;
    if (a.stats) {
        if (r.passes)
            talk.answer("positions from " + layerText(r.positionLayer) +
                        (r.normalPass ? ", normals from " + layerText(r.normalLayer)
                                      : std::string()));
        const std::string rays =
            counted(s.rays, "ray", "rays") + ", " + secondsText(results.seconds) + ", " +
            countText(std::uint64_t(double(s.rays) / std::max(results.seconds, 1e-9))) +
            " rays per second";
        if (kind == Kind::rays) return talk.answer(rays);
        talk.answer(counted(s.points, "point", "points") + ", " + rays + "; " +
                    secondsText(results.prepareSeconds) +
                    " before, to make the map ready" +
                    (results.memoryBytes ? "; it takes " + bytesText(*results.memoryBytes)
                                         : std::string()));
        if (results.sampleError && results.mapError)
            talk.answer("expected mean error: " + errorText(*results.sampleError) +
                        " of the samples, about " + errorText(*results.mapError) +
                        " of the map");
        talk.answer(counted(s.notFinite, "point", "points") + " not finite, " +
                    countText(s.behindLight) + " behind the light, " +
                    countText(s.mayBeTruncated) + " may be truncated");
    } else if (s.mayBeTruncated) {
        talk.warn(countText(s.mayBeTruncated) + " of " + countText(s.points) +
                  " points lie outside the light's view, where casters that reach out of "
                  "the map's window may be missing; bake a wider --fov");
    }
    if (results.noNormal)
        talk.warn(counted(results.noNormal, "point has", "points have") +
                  " a normal of no length, or that is not finite: they were asked for "
                  "without one");
}

void report(const Arguments& a, Kind kind, const Receivers& r, const Results& results,
            Talk& talk) {
    sayStats(a, kind, r, results, talk);
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
    std::vector<glm::dvec3> directions;
    const std::vector<ShadowRay> rays = unwrap(readRays(a.raysFile, &directions));
    const auto still = std::count_if(rays.begin(), rays.end(), [](const ShadowRay& ray) {
        return !isDirection(ray.direction);
    });
    if (still > 0)
        talk.warn(counted(std::uint64_t(still), "ray has", "rays have") +
                  " no direction: nothing is in their way");
    const auto backward = std::count_if(
        rays.begin(), rays.end(), [](const auto& ray) { return !(ray.length >= 0.0); });
    if (backward > 0)
        talk.warn(counted(std::uint64_t(backward), "ray has", "rays have") +
                  " a tmax below 0, or that is no number: nothing is in their way");
    refuseLongJson(a, rays.size());
    const Results results = queryRays(map, rays, options, talk);
    if (!a.json || !a.output.empty()) writeRayCsv(a, rays, directions, results);
    report(a, Kind::rays, {}, results, talk);
}

bool anySurface(const Receivers& r) {
    for (std::size_t i = 0; i < r.count; ++i)
        if (!r.surface || r.surface(i)) return true;
    return false;
}

/// Of the map only what queries with these options go through. Says that it may take more
/// than a second or two before it does.
void makeReady(const ShadowOptions& options, ShadowMap& map, Talk& talk) {
    if (options.method != ShadowMethod::trace) return;
    if (!map.hasLayers()) return;  // its trees came with it
    const MapInfo& info = map.info();
    const std::uint64_t pixels =
        std::uint64_t(info.width) * info.height * map.faceCount();
    if (pixels + map.layerCount() > kQuicklyReady)
        talk.say("making the map ready for queries (" +
                 counted(map.layerCount(), "layer", "layers") + ") ...");
    prepareQueries(map);
    // A map that cannot do without its layers keeps them.
    if (options.attenuation == Attenuation::multiply) (void)releaseLayers(map);
}

void runPoints(const Arguments& a, const CLI::App& app, Kind kind, ShadowMap& map,
               Talk& talk) {
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

    const Receivers r = receivers(a, kind, light, talk);
    if (options.weight == Weight::cosine && !r.normal)
        throw UsageError(
            "--weight: cosine needs the receiver's normals: columns nx,ny,nz");
    refuseLongJson(a, isPicture(kind) ? 0 : r.count);
    // Strands and fog have none.
    if (kind == Kind::position && !r.normalPass &&
        (map.isOpaque() || map.info().translucent == Translucent::sheets))
        talk.say(a.positionFile +
                 ": no normals: surfaces are told from their own blockers by a bias; "
                 "--normal-pass N.exr is better");
    const auto start = std::chrono::steady_clock::now();
    if (anySurface(r)) makeReady(options, map, talk);
    if (a.quality.meanError())
        options = plannedOptions(a, app, map, light, options, r, talk);
    const double prepareSeconds = since(start);
    Results results = queryPoints(map, light, options, wantsErrors(a, options), r, talk);
    results.prepareSeconds = prepareSeconds;
    results.memoryBytes = options.method == ShadowMethod::trace && anySurface(r)
                              ? queryMemoryBytes(map)
                              : map.memoryBytes();
    results.mapError = mapError(map);
    if (kind == Kind::point) results.noNormal = 0;  // none was given
    if (isPicture(kind) && extension(a.output) != ".csv")
        writePicture(a, r, light, results);
    else if (!a.json || !a.output.empty())
        writePointCsv(a, r, results);
    report(a, kind, r, results, talk);
}

/// What of the map these queries go through. If only its trees are of no use, others are
/// made.
ShadowMap readFor(Kind kind, const Arguments& a, Talk& talk) {
    ReadLimits limits = readLimits(a.maxMemory);
    limits.nearField = !a.noNearField;
    limits.layers = kind == Kind::rays || attenuation(a) != Attenuation::multiply ||
                    ShadowMethod(a.method.value_or(0)) != ShadowMethod::trace;
    Result<ShadowMap> map = readMap(a.map, limits);
    if (map) return *std::move(map);
    ReadLimits without = limits;
    without.trees = false;
    Result<ShadowMap> other = readMap(a.map, without);
    if (!other) throw mapFailure(map.error(), a.map, limits);
    talk.warn(map.error().message + "; now trees are made of the layers");
    return *std::move(other);
}

void run(const Arguments& a, const CLI::App& app, Talk& talk) {
    talk.setQuiet(a.quiet);
    const Kind kind = inputKind(a);
    checkArguments(a, app, kind);
    if (!a.output.empty())
        checkOutput(a.output,
                    {a.map, a.pointsFile, a.raysFile, a.positionFile, a.normalFile});
    ShadowMap map = readFor(kind, a, talk);
    if (kind == Kind::rays)
        runRays(a, map, talk);
    else
        runPoints(a, app, kind, map, talk);
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
