// Old files decode as before, for ever; and two readers that share nothing but the
// specification give the same numbers.
#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <tuple>

#include "format/bad_files.h"
#include "format/reader_py.h"
#include "format/refused.h"
#include "format/temp_folder.h"
#include "format/trees_json.h"
#include "golden/golden_maps.h"

using namespace mtsm;
using namespace mtsm::test;
using nlohmann::json;
namespace fs = std::filesystem;

namespace {

std::string goldenPath(const std::string& name) {
    return kSource + "/tests/golden/" + name + ".mtsm";
}

Bytes bytesOf(const std::string& path) {
    const std::string text = textOf(path);
    return {text.begin(), text.end()};
}

// --- a map against the other reader's JSON, bit by bit
// -------------------------------------

bool same(const json& j, double x) {
    if (std::isfinite(x))
        return j.is_number() && std::bit_cast<std::uint64_t>(j.get<double>()) ==
                                    std::bit_cast<std::uint64_t>(x);
    if (!std::isnan(x)) return j == (x > 0 ? "inf" : "-inf");
    char text[32];
    std::snprintf(text, sizeof text, "nan:%016llx",
                  static_cast<unsigned long long>(std::bit_cast<std::uint64_t>(x)));
    return j == text;
}

bool same(const json& j, float x) {
    return same(j, double(x));
}
bool same(const json& j, glm::dvec2 p) {
    return j.size() == 2 && same(j[0], p.x) && same(j[1], p.y);
}
bool same(const json& j, glm::dvec3 p) {
    return j.size() == 3 && same(j[0], p.x) && same(j[1], p.y) && same(j[2], p.z);
}

void checkInfo(const json& j, const MapInfo& info) {
    CHECK(j["version"] == json({1, 0}));
    CHECK(j["width"] == info.width);
    CHECK(j["height"] == info.height);
    CHECK(j["tileSize"] == info.tileSize);
    CHECK(j["channels"] == info.channels);
    CHECK(j["depthMeaning"] == 0);
    CHECK(j["visibilityRule"] == unsigned(info.translucent));
    const json& light = j["light"];
    CHECK(light["shape"] == unsigned(info.light.shape));
    CHECK(same(light["position"], info.light.position));
    CHECK(same(light["direction"], info.light.direction));
    CHECK(same(light["up"], info.light.up));
    CHECK(same(light["radius"], info.light.radius));
    CHECK(same(light["size"], info.light.size));
    CHECK(same(light["angularDiameter"], info.light.angularDiameter));
    CHECK(same(j["bias"], info.bias));
    CHECK(same(j["biasPerDepth"], info.biasPerDepth));
    CHECK(j["maxLayers"] == info.maxLayers);
    CHECK(j["resets"] == info.resets);
    CHECK(same(j["toleranceAsked"], info.toleranceAsked));
    CHECK(same(j["toleranceReached"], info.toleranceReached));
    CHECK(same(j["metresPerUnit"], info.metresPerUnit));
    CHECK(j["castersClipped"] == info.castersClipped);
    CHECK(j["samples"] == info.samples);
    CHECK(j["samplesDropped"] == info.samplesDropped);
    CHECK(j["software"] == info.software);
    CHECK(j["settings"] == info.settings);
}

void checkAttributes(const json& j, const std::vector<Attribute>& attributes) {
    REQUIRE(j.size() == attributes.size());
    for (std::size_t i = 0; i < attributes.size(); ++i) {
        const Attribute& a = attributes[i];
        const json& value = j[i]["value"];
        INFO("attribute " << a.name);
        CHECK(j[i]["name"] == a.name);
        if (const auto* text = std::get_if<std::string>(&a.value)) {
            CHECK(j[i]["type"] == "text");
            CHECK(value == *text);
        } else if (const auto* integer = std::get_if<std::int64_t>(&a.value)) {
            CHECK(j[i]["type"] == "integer");
            CHECK(value == *integer);
        } else {
            const auto& doubles = std::get<std::vector<double>>(a.value);
            CHECK(j[i]["type"] == "doubles");
            REQUIRE(value.size() == doubles.size());
            for (std::size_t k = 0; k < doubles.size(); ++k)
                CHECK(same(value[k], doubles[k]));
        }
    }
}

void checkProjection(const json& j, const Projection& p) {
    CHECK(j["kind"] == unsigned(p.kind));
    CHECK(same(j["eye"], p.eye));
    CHECK(same(j["right"], p.right));
    CHECK(same(j["up"], p.up));
    CHECK(same(j["forward"], p.forward));
    CHECK(same(j["scale"], p.scale));
    CHECK(same(j["offset"], p.offset));
    CHECK(same(j["near"], p.near));
    CHECK(same(j["far"], p.far));
}

bool samePixel(const json& j, const PixelLayers& layers, std::uint32_t channels) {
    if (j.size() != layers.count) return false;
    for (std::uint32_t i = 0; i < layers.count; ++i) {
        const json& layer = j[i];
        if (!same(layer[0], layers.z[i]) || layer[1].size() != channels) return false;
        for (std::uint32_t c = 0; c < channels; ++c) {
            const float v = layers.v ? layers.v[c * layers.vStride + i] : 0.0f;
            if (!same(layer[1][c], v)) return false;
        }
        if (layer[2] != (layers.n ? layers.n[i] : 1)) return false;
    }
    return true;
}

bool sameChunk(const json& j, const NearChunk& chunk) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
        if (!same(j["low"][axis], chunk.low[axis]) ||
            !same(j["step"][axis], chunk.step[axis]))
            return false;
        for (std::size_t c = 0; c < 3; ++c) {
            const auto q = j["corner"][c][axis].get<std::vector<std::uint16_t>>();
            if (!std::equal(q.begin(), q.end(), std::begin(chunk.corner[c][axis]),
                            std::end(chunk.corner[c][axis])))
                return false;
        }
    }
    return true;
}

void checkNearField(const json& j, const NearField& field) {
    REQUIRE(j.size() == field.chunks.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < j.size(); ++i)
        different += !sameChunk(j[i], field.chunks[i]);
    CHECK(different == 0);
}

bool sameChunk(const json& j, const NearHairChunk& chunk) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
        if (!same(j["low"][axis], chunk.low[axis]) ||
            !same(j["step"][axis], chunk.step[axis]))
            return false;
        for (std::size_t e = 0; e < 2; ++e) {
            if (j["end"][e][axis] != json(chunk.end[e][axis])) return false;
        }
    }
    return same(j["halfStep"], chunk.halfStep) && j["half"][0] == json(chunk.half[0]) &&
           j["half"][1] == json(chunk.half[1]) && j["opacity"] == json(chunk.opacity);
}

void checkNearHair(const json& j, const NearHair& hair) {
    REQUIRE(j.size() == hair.chunks.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < j.size(); ++i)
        different += !sameChunk(j[i], hair.chunks[i]);
    CHECK(different == 0);
}

bool sameChunk(const json& j, const NearSheetChunk& chunk) {
    for (std::size_t axis = 0; axis < 2; ++axis) {
        if (!same(j["low"][axis], chunk.low[axis]) ||
            !same(j["step"][axis], chunk.step[axis]))
            return false;
        for (std::size_t c = 0; c < 3; ++c) {
            if (j["q"][c][axis] != json(chunk.uv[c][axis])) return false;
        }
    }
    return j["texture"] == chunk.texture && j["triangles"] == chunk.triangles;
}

bool sameTexture(const json& j, const NearTexture& texture) {
    return j["width"] == texture.width && j["height"] == texture.height &&
           j["wrap"][0] == int(texture.wrapU) && j["wrap"][1] == int(texture.wrapV) &&
           same(j["cutoff"], texture.cutoff) && same(j["opacity"], texture.opacity) &&
           j["texels"].get<std::vector<std::uint8_t>>() == texture.texels;
}

void checkNearSheets(const json& j, const NearSheets& sheets) {
    REQUIRE(j.is_null() == sheets.empty());
    if (sheets.empty()) return;
    checkNearField(j["triangles"], sheets.triangles);
    REQUIRE(j["chunks"].size() == sheets.chunks.size());
    REQUIRE(j["textures"].size() == sheets.textures.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < sheets.chunks.size(); ++i)
        different += !sameChunk(j["chunks"][i], sheets.chunks[i]);
    for (std::size_t i = 0; i < sheets.textures.size(); ++i)
        different += !sameTexture(j["textures"][i], sheets.textures[i]);
    CHECK(different == 0);
}

void checkMap(const json& j, const ShadowMap& map) {
    checkInfo(j, map.info());
    checkAttributes(j["attributes"], map.info().attributes);
    CHECK(j["layers"] == map.layerCount());
    ZRange z;
    REQUIRE(j["projections"].size() == map.faceCount());
    REQUIRE(j["pixels"].size() == map.faceCount());
    checkNearSheets(j["nearSheets"], map.nearSheets(0));
    std::uint64_t different = 0;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        checkProjection(j["projections"][face], map.projection(face));
        checkNearField(j["nearField"][face], map.nearField(face));
        checkNearHair(j["nearHair"][face], map.nearHair(face));
        z.include(map.zRange(face));
        REQUIRE(j["pixels"][face].size() == map.info().height);
        for (std::uint32_t y = 0; y < map.info().height; ++y) {
            REQUIRE(j["pixels"][face][y].size() == map.info().width);
            for (std::uint32_t x = 0; x < map.info().width; ++x) {
                if (!samePixel(j["pixels"][face][y][x], map.pixel(face, x, y),
                               map.info().channels))
                    ++different;
            }
        }
    }
    CHECK(different == 0);
    CHECK(same(j["zMin"], z.min));
    CHECK(same(j["zMax"], z.max));
}

/// The bytes of the worked example: lines "0040  48 45 41 44 ...  what it is" between the
/// two marks in the specification.
Bytes hexExample(const std::string& spec) {
    const auto begin = spec.find("<!-- hex: one_pixel.mtsm -->");
    const auto end = spec.find("<!-- end of hex -->");
    REQUIRE(begin != std::string::npos);
    REQUIRE(end != std::string::npos);
    std::istringstream lines(spec.substr(begin, end - begin));
    Bytes bytes;
    for (std::string line; std::getline(lines, line);) {
        if (line.size() < 6 || line.compare(4, 2, "  ") != 0) continue;
        INFO(line);
        REQUIRE(std::stoul(line.substr(0, 4), nullptr, 16) == bytes.size());
        const std::string digits = line.substr(6, line.find("  ", 6) - 6);
        std::istringstream words(digits);
        for (std::string word; words >> word;)
            bytes.push_back(static_cast<std::uint8_t>(std::stoul(word, nullptr, 16)));
    }
    return bytes;
}

}  // namespace

TEST_CASE("every golden file still decodes to the map it was made from",
          "[format][golden]") {
    std::size_t files = 0;
    for (const Golden& golden : goldenMaps()) {
        INFO(golden.name);
        const auto map = readMap(goldenPath(golden.name));
        INFO((map ? "" : map.error().message));
        REQUIRE(map);
        CHECK(identical(*map, golden.map));
        ++files;
    }
    for (const auto& entry : fs::directory_iterator(kSource + "/tests/golden")) {
        if (entry.path().extension() == ".mtsm") --files;
    }
    CHECK(files == 0);  // none without its map
}

TEST_CASE("both readers agree on every golden file, number by number",
          "[format][golden]") {
    for (const Golden& golden : goldenMaps()) {
        INFO(golden.name);
        const Run run = readerPy(goldenPath(golden.name));
        INFO(run.err);
        REQUIRE(run.exitCode == 0);
        const auto map = readMap(goldenPath(golden.name));
        REQUIRE(map);
        const json j = json::parse(run.out);
        checkMap(j, *map);
        REQUIRE(j["trees"].is_null() != golden.trees);
        if (!golden.trees) continue;
        ReadLimits limits;
        limits.layers = false;
        const auto trees = readMap(goldenPath(golden.name), limits);
        REQUIRE(trees);
        CHECK_FALSE(trees->hasLayers());
        checkTrees(j["trees"], *trees);
    }
}

TEST_CASE("both readers refuse every file in tests/bad with the same exit code",
          "[format][bad-input]") {
    std::size_t files = 0;
    for (const auto& entry : fs::directory_iterator(kSource + "/tests/bad")) {
        const std::string path = entry.path().string();
        const std::string name = entry.path().filename().string();
        if (entry.path().extension() != ".mtsm") continue;
        INFO(name);
        const int expected = name.rfind("unsupported_", 0) == 0 ? 5 : 4;
        const auto map = readMap(path);
        REQUIRE_FALSE(map);
        CHECK(exitCode(map.error().code) == expected);
        const auto words = badWords().find(entry.path().stem().string());
        REQUIRE(words != badWords().end());
        CHECK_THAT(map.error().message, Catch::Contains(words->second.readMap));
        const Run run = readerPy(path);
        CHECK(run.exitCode == expected);
        CHECK(run.out.empty());
        CHECK_THAT(run.err, Catch::StartsWith(path + ": "));
        CHECK_THAT(run.err, Catch::Contains(words->second.readerPy));
        CHECK_THAT(run.err, !Catch::Contains("Traceback"));
        ++files;
    }
    CHECK(files >= badFiles().size());
}

TEST_CASE("both readers take the dictionary id 0 of a zstd frame for none",
          "[format][golden]") {
    using format::PlaneRecord;
    using format::TileRecord;
    Surgery s(bytesOf(goldenPath("opaque")));
    Bytes& tile = s.payload(format::kTile);
    std::size_t frame = Surgery::planeAt(int(peek<TileRecord>(tile, 0).planeCount));
    const std::size_t record = Surgery::planeAt(1);
    frame += peek<PlaneRecord>(tile, Surgery::planeAt(0)).storedLength;
    REQUIRE(peek<PlaneRecord>(tile, record).encoding == 2);
    edit<PlaneRecord>(tile, record, [](PlaneRecord& r) { r.storedLength += 2; });
    REQUIRE((tile[frame + 4] & 3) == 0);
    const bool window = (tile[frame + 4] & 0x20) == 0;
    tile[frame + 4] |= 2;  // two bytes of id, both 0
    tile.insert(tile.begin() + long(frame) + 5 + window, 2, 0);
    const TempFolder folder;
    const Bytes file = s.close();
    std::ofstream(folder / "id.mtsm", std::ios::binary)
        .write(reinterpret_cast<const char*>(file.data()), long(file.size()));
    const auto map = readMap(folder / "id.mtsm");
    INFO((map ? "" : map.error().message));
    REQUIRE(map);
    const Run run = readerPy(folder / "id.mtsm");
    INFO(run.err);
    REQUIRE(run.exitCode == 0);
    checkMap(json::parse(run.out), *map);
}

TEST_CASE("the golden files hold a plane of every kind, encoding, filter and size",
          "[format][golden]") {
    using format::PlaneRecord;
    using format::TileRecord;
    std::set<std::tuple<int, int, int, int>>
        seen;  // kind, encoding, filter, element size
    for (const Golden& golden : goldenMaps()) {
        const Surgery s(bytesOf(goldenPath(golden.name)));
        for (const auto& part : s.parts) {
            if (part.type != format::kTile) continue;
            const auto count = peek<TileRecord>(part.payload, 0).planeCount;
            for (std::uint32_t i = 0; i < count; ++i) {
                const auto r = peek<PlaneRecord>(part.payload, Surgery::planeAt(int(i)));
                seen.insert({r.kind, r.encoding, r.filter, r.elementSize});
            }
        }
    }
    const std::set<std::tuple<int, int, int, int>> wanted = {
        {0, 0, 0, 1}, {0, 0, 0, 2}, {0, 1, 0, 1}, {0, 2, 0, 1},  // counts
        {1, 0, 0, 4}, {1, 1, 0, 4}, {1, 2, 2, 4}, {1, 2, 3, 4},  // z
        {2, 0, 0, 4}, {2, 1, 0, 4}, {2, 2, 0, 4}, {2, 2, 1, 4},
        {2, 2, 2, 4}, {2, 2, 3, 4},                               // v
        {3, 0, 0, 1}, {3, 2, 0, 1}, {3, 2, 1, 2}, {3, 2, 1, 4}};  // n
    for (const auto& [kind, encoding, filter, size] : wanted) {
        INFO("kind " << kind << ", encoding " << encoding << ", filter " << filter
                     << ", size " << size);
        CHECK(seen.count({kind, encoding, filter, size}) == 1);
    }
}

TEST_CASE("the worked example of the specification is what the writer writes",
          "[format][golden]") {
    const Bytes example = hexExample(textOf(kSource + "/format-spec/mtsm-format.md"));
    CHECK(example == bytesOf(goldenPath("one_pixel")));
    CHECK(example == *encodeMap(onePixel().map));
}

TEST_CASE("the second reader refuses a file that is cut or changed anywhere",
          "[format][bad-input]") {
    const Run run = readerPy(goldenPath("one_pixel"), "--self-test");
    INFO(run.err);
    CHECK(run.exitCode == 0);
}

TEST_CASE("the second reader's checksum needs no module", "[format][bad-input]") {
    // Its own XXH3 on one length per code path, against the library's.
    std::ostringstream code;
    code << "import sys; sys.path.insert(0, '" << kSource << "/format-spec'); "
         << "import reader; data = bytes(i * 7 % 251 for i in range(3000)); "
         << "assert all(reader.xxh3_64(data[:n]) == h for n, h in [";
    Bytes data(3000);
    for (std::size_t i = 0; i < data.size(); ++i)
        data[i] = static_cast<std::uint8_t>(i * 7 % 251);
    for (std::size_t n :
         {0u,  1u,  2u,  3u,   4u,   8u,   9u,   16u,   17u,   32u,   33u,   64u,
          65u, 96u, 97u, 128u, 129u, 240u, 241u, 1024u, 1025u, 1088u, 2048u, 2999u})
        code << "(" << n << ", " << base::checksum(BytesView(data).first(n)) << "), ";
    code << "])";
    const std::string command =
        "'" + std::string(MTSM_PYTHON) + "' -B -c \"" + code.str() + "\"";
    CHECK(std::system(command.c_str()) == 0);
}
