// mtsm-dump - what is in a map file.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>
#include <iomanip>
#include <limits>
#include <sstream>

#include "common/arguments.h"
#include "common/map_file.h"
#include "common/tool.h"
#include "mtsm/describe.h"
#include "mtsm/image.h"
#include "mtsm/plot.h"
#include "mtsm/reader.h"

namespace {

using namespace mtsm;
using namespace mtsm::tools;
using nlohmann::ordered_json;

constexpr const char* kAbout =
    "Shows what is in a map file: what it was baked for, where its bytes go, and single\n"
    "pixels. Lengths are in world units, depth z is the distance along the view axis, v "
    "the\n"
    "visibility left behind a layer, n the number of samples that it stands for.";

constexpr const char* kExamples =
    "Examples:\n"
    "  everything, for people and for scripts:\n"
    "    mtsm-dump key.mtsm\n"
    "    mtsm-dump key.mtsm --json\n"
    "  the layers of one pixel, as a list and as a plot:\n"
    "    mtsm-dump key.mtsm --pixel 512,300\n"
    "    mtsm-dump key.mtsm --plot 512,300 -o pixel.svg\n"
    "  nearest depths as an image; is the file sound?\n"
    "    mtsm-dump key.mtsm --image depth.exr --channel zmin\n"
    "    mtsm-dump key.mtsm --validate\n";

const std::vector<std::string> kChannels = {"layers", "zmin", "zmax", "visibility",
                                            "count"};

struct Arguments {
    std::string map, pixel, plot, output, image;
    std::string maxMemory = "8G";
    std::int64_t face = 0;
    std::optional<std::size_t> channel;
    bool json = false, histogram = false, validate = false;
};

void addOptions(CLI::App& app, Arguments& a) {
    app.add_option("MAP", a.map, "the map file")
        ->required()
        ->type_name("FILE")
        ->group("Input");
    const std::vector<CLI::Option*> actions = {
        addText(app, "--pixel", a.pixel, "X,Y",
                "list the layers of a pixel, nearest first"),
        addText(app, "--plot", a.plot, "X,Y",
                "visibility against depth in a pixel, as an SVG on\n"
                "stdout or in the file that -o names"),
        addText(app, "--image", a.image, "FILE.png|exr",
                "a picture of --channel: .exr holds the values, .png\n"
                "maps their range to black..white and says it"),
        app.add_flag("--histogram", a.histogram, "how many pixels have how many layers"),
        app.add_flag("--validate", a.validate,
                     "read and check every byte; prints OK, or exits with\n"
                     "4 and says what is damaged")};
    for (CLI::Option* one : actions) {
        one->group("What to show (default: a summary)");
        for (CLI::Option* other : actions) {
            if (other != one) one->excludes(other);
        }
    }
    addChoice(app, "--channel", a.channel, kChannels,
              "of --image: number of layers, nearest and farthest\n"
              "depth, visibility behind all (in colour if the map\n"
              "is), number of samples (default: layers)")
        ->group("How");
    addWhole(app, "--face", a.face, 0, 5, "face of a six-faced map, 0 to 5 (default: 0)")
        ->group("How");
    addText(app, "-o,--output", a.output, "FILE.svg",
            "where --plot goes (default: stdout)")
        ->group("How");
    app.add_flag("--json", a.json, "print as a JSON object; lengths without end are null")
        ->group("How");
    addMaxMemory(app, a.maxMemory)->group("How");
}

void printJson(const ordered_json& j) {
    print(jsonText(j));
}

ordered_json triple(const glm::dvec3& v) {
    return ordered_json::array({v.x, v.y, v.z});
}

/// Those in which some layer lets something through.
std::uint64_t translucentTiles(const Description& d) {
    return d.tiles - d.emptyTiles - d.opaqueTiles;
}

// --- summary as JSON -------------------------------------------------------------------

ordered_json attributesJson(const MapInfo& info) {
    ordered_json j = ordered_json::object();
    for (const Attribute& a : info.attributes)
        std::visit([&](const auto& value) { j[a.name] = value; }, a.value);
    return j;
}

ordered_json projectionJson(const Projection& p) {
    return {
        {"kind", p.kind == ProjectionKind::perspective ? "perspective" : "orthographic"},
        {"eye", triple(p.eye)},
        {"right", triple(p.right)},
        {"up", triple(p.up)},
        {"forward", triple(p.forward)},
        {"scale", {p.scale.x, p.scale.y}},
        {"offset", {p.offset.x, p.offset.y}},
        {"near", p.near},
        {"far", p.far}};
}

ordered_json summaryJson(const Arguments& a, const Description& d, const ShadowMap& map) {
    const MapInfo& info = map.info();
    ordered_json j;
    j["file"] = a.map;
    j["bytes"] = d.fileBytes;
    j["version"] = {d.probe.versionMajor, d.probe.versionMinor};
    j["width"] = info.width;
    j["height"] = info.height;
    j["faces"] = map.faceCount();
    j["tileSize"] = info.tileSize;
    j["channels"] = info.channels;
    j["light"] = lightJson(info.light);
    j["projections"] = ordered_json::array();
    for (std::uint32_t f = 0; f < map.faceCount(); ++f)
        j["projections"].push_back(projectionJson(map.projection(f)));
    j["bias"] = info.bias;
    j["biasPerDepth"] = info.biasPerDepth;
    j["translucent"] = info.translucent == Translucent::media ? "media" : "sheets";
    j["maxLayers"] = info.maxLayers;
    j["resets"] =
        info.resets == kAllResets ? ordered_json("all") : ordered_json(info.resets);
    j["toleranceAsked"] = info.toleranceAsked;
    j["toleranceReached"] = info.toleranceReached;
    j["metresPerUnit"] = info.metresPerUnit;
    j["castersClipped"] = info.castersClipped;
    j["samples"] = info.samples;
    j["samplesDropped"] = info.samplesDropped;
    j["software"] = info.software;
    j["settings"] = info.settings;
    j["attributes"] = attributesJson(info);
    j["layers"] = d.layers;
    j["layerSamples"] = d.samples;
    j["mostLayers"] = d.mostLayers;
    j["layerHistogram"] = d.layerHistogram;
    if (!d.z.empty()) j["zRange"] = {d.z.min, d.z.max};
    j["pixels"] = d.pixels;
    j["emptyPixels"] = d.emptyPixels;
    j["tiles"] = d.tiles;
    j["emptyTiles"] = d.emptyTiles;
    j["opaqueTiles"] = d.opaqueTiles;
    j["translucentTiles"] = translucentTiles(d);
    j["nearField"] = {{"triangles", d.nearTriangles},
                      {"segments", d.nearSegments},
                      {"textures", d.nearTextures},
                      {"chunks", d.nearChunks},
                      {"memoryBytes", d.nearBytes}};
    j["memoryBytes"] = map.memoryBytes();
    j["blocks"] = ordered_json::array();
    for (const Description::Block& b : d.blocks)
        j["blocks"].push_back({{"type", b.type},
                               {"critical", b.critical},
                               {"count", b.count},
                               {"bytes", b.bytes}});
    j["planes"] = ordered_json::array();
    for (const Description::Plane& p : d.planes)
        j["planes"].push_back({{"name", p.name},
                               {"planes", p.planes},
                               {"constant", p.constant},
                               {"raw", p.raw},
                               {"compressed", p.compressed},
                               {"storedBytes", p.storedBytes},
                               {"decodedBytes", p.decodedBytes},
                               {"leftOut", p.leftOut},
                               {"leftOutBytes", p.leftOutBytes}});
    return j;
}

// --- summary as text -------------------------------------------------------------------

/// Groups of aligned rows.
class Rows {
  public:
    void group(const std::string& name) { out_ << "\n" << name << "\n"; }
    void row(const std::string& key, const std::string& value) {
        out_ << "  " << std::left << std::setw(20) << key << value << "\n";
    }
    [[nodiscard]] std::string text() const { return out_.str(); }

  private:
    std::ostringstream out_;
};

/// The part, as `text` has it, and its share of the whole.
std::string share(std::uint64_t part, std::uint64_t whole,
                  std::string (*text)(std::uint64_t) = countText) {
    if (whole == 0) return text(part);
    std::ostringstream out;
    out << text(part) << " (" << std::fixed << std::setprecision(1)
        << 100.0 * double(part) / double(whole) << " %)";
    return out.str();
}

/// To two digits behind the point.
std::string rounded(double value) {
    return numberText(std::round(100.0 * value) / 100.0);
}

/// "1 tile", "2 tiles"
std::string counted(std::uint64_t count, const std::string& what) {
    return countText(count) + " " + what + (count == 1 ? "" : "s");
}

void lightRows(Rows& rows, const ShadowMap& map) {
    const MapInfo& info = map.info();
    rows.group("Light and view");
    rows.row("light", lightText(info.light));
    for (std::uint32_t f = 0; f < map.faceCount(); ++f) {
        const Projection& p = map.projection(f);
        const bool perspective = p.kind == ProjectionKind::perspective;
        rows.row(map.faceCount() == 1 ? "eye" : "eye of face " + std::to_string(f),
                 "(" + tripleText(p.eye) + ")");
        rows.row("looking along",
                 "(" + tripleText(p.forward) + "), up (" + tripleText(p.up) + ")");
        const double wide = info.width / p.scale.x, high = info.height / -p.scale.y;
        rows.row("window", (perspective ? "perspective, " : "parallel, ") +
                               numberText(wide) + " x " + numberText(high) +
                               (perspective ? " at depth 1" : " world units"));
        rows.row("near, far", numberText(p.near) + ", " + numberText(p.far));
    }
    rows.row("bias", info.biasPerDepth > 0.0f && info.bias == 0.0f
                         ? numberText(info.biasPerDepth) + " of a layer's depth"
                         : numberText(info.bias) + " world units");
    if (!map.isOpaque())
        rows.row("translucent", info.translucent == Translucent::media
                                    ? "media: met at exact crossings, no bias"
                                    : "sheets: met within the bias, once");
    if (info.metresPerUnit > 0)
        rows.row("world unit", numberText(info.metresPerUnit) + " m");
    if (info.castersClipped) rows.row("window", "some casters reach out of it");
}

void contentRows(Rows& rows, const MapInfo& info, const Description& d) {
    rows.group("Layers");
    rows.row("layers", countText(d.layers) + ", at most " + std::to_string(d.mostLayers) +
                           " in a pixel");
    rows.row("asked for", info.maxLayers
                              ? "at most " + std::to_string(info.maxLayers) + " per pixel"
                              : std::string("all"));
    rows.row("samples", countText(info.samples) + ", " +
                            share(info.samplesDropped, info.samples) + " dropped");
    if (d.samples > d.layers)
        rows.row("merged", countText(d.samples) + " samples into " + countText(d.layers) +
                               " layers, " +
                               rounded(double(d.samples) / double(d.layers)) +
                               " samples per layer");
    rows.row("depths", d.z.empty() ? "none: the map is empty"
                                   : numberText(d.z.min) + " to " + numberText(d.z.max) +
                                         " world units");
    rows.row("tolerance", shortText(info.toleranceAsked) + " asked for, " +
                              shortText(info.toleranceReached) + " reached");
    rows.row("resets",
             info.resets == kAllResets ? "any number" : std::to_string(info.resets));
    rows.row("empty pixels", share(d.emptyPixels, d.pixels));
    rows.row("tiles", countText(d.tiles) + " of " + std::to_string(info.tileSize) +
                          " x " + std::to_string(info.tileSize) + ", " +
                          share(d.emptyTiles, d.tiles) + " empty, " +
                          share(d.opaqueTiles, d.tiles) + " opaque, " +
                          share(translucentTiles(d), d.tiles) + " translucent");
}

void byteRows(Rows& rows, const ShadowMap& map, const Description& d) {
    rows.group("Bytes");
    rows.row("file",
             bytesText(d.fileBytes) +
                 (d.layers ? ", " + rounded(double(d.fileBytes) / double(d.layers)) +
                                 " bytes per layer"
                           : ""));
    rows.row("in memory", bytesText(map.memoryBytes()));
    if (d.nearChunks)
        rows.row(
            "near field",
            (d.nearTriangles ? counted(d.nearTriangles, "triangle") : "") +
                (d.nearTriangles && d.nearSegments ? " and " : "") +
                (d.nearSegments ? counted(d.nearSegments, "segment") : "") +
                (d.nearTextures ? " with " + counted(d.nearTextures, "opacity texture")
                                : "") +
                " in " + counted(d.nearChunks, "chunk") + ", " + bytesText(d.nearBytes) +
                " in memory");
    for (const Description::Plane& p : d.planes) {
        if (p.planes)
            rows.row("plane " + p.name, share(p.storedBytes, d.fileBytes, bytesText) +
                                            " for " + bytesText(p.decodedBytes) + ": " +
                                            countText(p.constant) + " constant, " +
                                            countText(p.raw) + " raw, " +
                                            countText(p.compressed) + " compressed");
        if (p.leftOut)
            rows.row("plane " + p.name,
                     "left out of " +
                         counted(p.leftOut, p.name == "counts" ? "empty tile" : "tile") +
                         ", where it would take " + bytesText(p.leftOutBytes));
    }
    for (const Description::Block& b : d.blocks)
        rows.row("block " + b.type, bytesText(b.bytes) + " in " + countText(b.count) +
                                        (b.critical ? "" : ", may be skipped"));
}

std::string attributeText(const Attribute& a) {
    if (const auto* text = std::get_if<std::string>(&a.value)) return *text;
    if (const auto* whole = std::get_if<std::int64_t>(&a.value))
        return std::to_string(*whole);
    std::string list;
    for (double v : std::get<std::vector<double>>(a.value))
        list += (list.empty() ? "" : ", ") + numberText(v);
    return list;
}

void attributeRow(Rows& rows, const Attribute& a) {
    const auto* count = std::get_if<std::int64_t>(&a.value);
    if (a.name == "hiddenLayers" && count && *count >= 0)
        rows.row("hidden layers", countText(std::uint64_t(*count)) +
                                      " dropped: no point of the light sees them");
    else
        rows.row(printable(a.name), printable(attributeText(a)));
}

std::string summaryText(const Arguments& a, const Description& d, const ShadowMap& map) {
    const MapInfo& info = map.info();
    Rows rows;
    rows.group("Map");
    rows.row("file", a.map);
    rows.row("format", "MTSM " + std::to_string(d.probe.versionMajor) + "." +
                           std::to_string(d.probe.versionMinor));
    rows.row("size", std::to_string(info.width) + " x " + std::to_string(info.height) +
                         " pixels, " + std::to_string(map.faceCount()) +
                         (map.faceCount() == 1 ? " face, " : " faces, ") +
                         std::to_string(info.channels) +
                         (info.channels == 1 ? " channel" : " channels"));
    rows.row("software", printable(info.software));
    rows.row("settings", printable(info.settings));
    lightRows(rows, map);
    contentRows(rows, info, d);
    byteRows(rows, map, d);
    if (!info.attributes.empty()) rows.group("Attributes");
    for (const Attribute& attribute : info.attributes)
        attributeRow(rows, attribute);
    return rows.text().substr(1);
}

// --- the other views -------------------------------------------------------------------

std::string histogramText(const Description& d) {
    constexpr double kBar = 50;
    const auto& h = d.layerHistogram;
    const std::uint64_t most = h.empty() ? 0 : *std::max_element(h.begin(), h.end());
    std::ostringstream out;
    out << "layers      pixels\n";
    for (std::size_t i = 0; i < h.size(); ++i) {
        if (h[i] == 0) continue;
        const auto bar = std::size_t(std::ceil(kBar * double(h[i]) / double(most)));
        out << std::setw(6) << i << std::setw(12) << h[i] << "  " << std::string(bar, '#')
            << "\n";
    }
    return out.str();
}

std::uint32_t checkedFace(const Arguments& a, const ShadowMap& map) {
    if (std::uint64_t(a.face) >= map.faceCount())
        throw UsageError("--face: found " + std::to_string(a.face) +
                         ", but the map has " +
                         (map.faceCount() == 1 ? "only face 0" : "faces 0 to 5"));
    return std::uint32_t(a.face);
}

glm::uvec2 checkedPixel(const std::string& option, const std::string& text,
                        const ShadowMap& map) {
    const glm::uvec2 p = parsePixel(option, text);
    const MapInfo& info = map.info();
    if (p.x >= info.width || p.y >= info.height)
        throw UsageError(option + ": found " + text + ", but the map has " +
                         std::to_string(info.width) + " x " +
                         std::to_string(info.height) + " pixels, counted from 0");
    return p;
}

/// One layer of a pixel.
struct LayerRow {
    float z = 0;
    std::vector<float> v;  // [channels]
    std::uint32_t n = 1;
    bool reset = false;
};

std::vector<LayerRow> layerRows(const PixelLayers& p, std::uint32_t channels) {
    std::vector<LayerRow> rows(p.count);
    for (std::uint32_t i = 0; i < p.count; ++i) {
        rows[i].z = p.z[i];
        rows[i].n = p.n ? p.n[i] : 1;
        rows[i].reset = true;
        for (std::uint32_t c = 0; c < channels; ++c) {
            rows[i].v.push_back(p.v ? p.v[c * p.vStride + i] : 0.0f);
            rows[i].reset = rows[i].reset && rows[i].v.back() == 0.0f;
        }
    }
    return rows;
}

std::vector<const char*> visibilityNames(std::uint32_t channels) {
    if (channels == 1) return {"v"};
    return {"v red", "v green", "v blue"};
}

void showPixel(const Arguments& a, const ShadowMap& map) {
    const std::uint32_t face = checkedFace(a, map);
    const glm::uvec2 at = checkedPixel("--pixel", a.pixel, map);
    const auto rows = layerRows(map.pixel(face, at.x, at.y), map.info().channels);
    if (a.json) {
        ordered_json j = {{"face", face}, {"x", at.x}, {"y", at.y}};
        j["layers"] = ordered_json::array();
        for (const LayerRow& r : rows)
            j["layers"].push_back(
                {{"z", r.z}, {"v", r.v}, {"n", r.n}, {"reset", r.reset}});
        return printJson(j);
    }
    std::ostringstream out;
    out << "pixel (" << at.x << ", " << at.y << "), face " << face << ": " << rows.size()
        << (rows.size() == 1 ? " layer\n" : " layers\n");
    if (!rows.empty()) {
        out << std::setw(6) << "layer" << std::setw(16) << "z";
        for (const char* name : visibilityNames(map.info().channels))
            out << std::setw(16) << name;
        out << std::setw(10) << "n"
            << "\n";
    }
    for (std::size_t i = 0; i < rows.size(); ++i) {
        out << std::setw(6) << i << std::setw(16) << numberText(rows[i].z);
        for (float v : rows[i].v)
            out << std::setw(16) << numberText(v);
        out << std::setw(10) << rows[i].n << (rows[i].reset ? "  reset" : "") << "\n";
    }
    print(out.str());
}

void showPlot(const Arguments& a, const ShadowMap& map) {
    const std::uint32_t face = checkedFace(a, map);
    const glm::uvec2 at = checkedPixel("--plot", a.plot, map);
    const std::string svg = visibilityPlot(map, face, at.x, at.y);
    if (a.output.empty()) return print(svg);
    const Writing writing(a.output);
    unwrap(writeTextFile(a.output, svg));
}

void showImage(const Arguments& a, const ShadowMap& map, Talk& talk) {
    const auto channel = static_cast<MapChannel>(a.channel.value_or(0));
    const FloatImage image = mapImage(map, checkedFace(a, map), channel);
    const Writing writing(a.image);
    if (extension(a.image) == ".exr") return unwrap(writeImageExr(a.image, image));
    float least = std::numeric_limits<float>::infinity(), most = -least;
    for (float v : image.channels.front().values) {
        if (!std::isfinite(v)) continue;
        least = std::min(least, v);
        most = std::max(most, v);
    }
    if (channel == MapChannel::visibility) {
        least = 0.0f;
        most = 1.0f;
    }
    talk.say(std::string(name(channel)) +
             (least <= most
                  ? ": black is " + numberText(least) + ", white is " + numberText(most)
                  : std::string(": there is none, the map is empty")));
    const std::uint32_t w = image.data.width, h = image.data.height;
    const auto& planes = image.channels;
    unwrap(writeImagePng(
        a.image, planes.size() == 4 ? colorImage(w, h, planes[1].values, planes[2].values,
                                                 planes[3].values, least, most)
                                    : greyImage(w, h, planes[0].values, least, most)));
}

void validate(const Arguments& a, const ReadLimits& limits) {
    const ShadowMap map = unwrapMap(readMap(a.map, limits), a.map, limits);
    const MapInfo& info = map.info();
    if (a.json) {
        return printJson(
            {{"file", a.map}, {"valid", true}, {"layers", map.layerCount()}});
    }
    print("OK " + a.map + ": " + std::to_string(info.width) + " x " +
          std::to_string(info.height) + ", " + countText(map.layerCount()) + " layers\n");
}

void checkArguments(const Arguments& a, const CLI::App& app) {
    if (app.count("--channel") && a.image.empty())
        throw UsageError("--channel: belongs to --image");
    if (!a.output.empty() && a.plot.empty())
        throw UsageError(
            "-o: belongs to --plot; an image goes to the file that --image "
            "names, everything else to stdout");
    if (a.output.ends_with(".png") || a.output.ends_with(".exr"))
        throw UsageError("-o " + a.output +
                         ": a plot is SVG; name it so, or take --image");
    if (app.count("--face") && a.pixel.empty() && a.plot.empty() && a.image.empty())
        throw UsageError("--face: belongs to --pixel, --plot and --image");
    if (a.json && (!a.plot.empty() || !a.image.empty()))
        throw UsageError("--json: a picture is no JSON; leave one of them out");
    const std::string type = extension(a.image);
    if (!a.image.empty() && type != ".png" && type != ".exr")
        throw UsageError("--image: found \"" + a.image +
                         "\", expected a name that ends in .png or .exr");
    for (const std::string& file : {a.output, a.image}) {
        if (!file.empty()) checkOutput(file, {a.map});
    }
}

void run(const Arguments& a, const CLI::App& app, Talk& talk) {
    checkArguments(a, app);
    const ReadLimits limits = readLimits(a.maxMemory);
    if (a.validate) return validate(a, limits);
    if (!a.pixel.empty() || !a.plot.empty() || !a.image.empty()) {
        const ShadowMap map = unwrapMap(readMap(a.map, limits), a.map, limits);
        if (!a.pixel.empty()) return showPixel(a, map);
        if (!a.plot.empty()) return showPlot(a, map);
        return showImage(a, map, talk);
    }
    const Description d = unwrapMap(describe(a.map, limits), a.map, limits);
    if (a.histogram && a.json) return printJson({{"layerHistogram", d.layerHistogram}});
    if (a.histogram) return print(histogramText(d));
    const ShadowMap map = unwrapMap(readMap(a.map, limits), a.map, limits);
    if (a.json) return printJson(summaryJson(a, d, map));
    print(summaryText(a, d, map));
}

}  // namespace

int main(int argc, char** argv) {
    Talk talk("mtsm-dump");
    CLI::App app(kAbout, "mtsm-dump");
    describeTool(app, kExamples);
    Arguments arguments;
    addOptions(app, arguments);
    return runTool(app, argc, argv, talk, [&] { run(arguments, app, talk); });
}
