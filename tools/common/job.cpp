// Job files: TOML into casters and into values of the command line's options.
#include "common/job.h"

#include <toml++/toml.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/trigonometric.hpp>
#include <map>
#include <optional>
#include <span>
#include <sstream>
#include <string_view>

#include "common/arguments.h"
#include "common/tool.h"
#include "mtsm/describe.h"

namespace mtsm::tools {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMostBytes = std::uintmax_t(16) << 20;
/// Of a line: each dot of a key makes a table in a table, which toml++ builds, prints and
/// frees by recursion.
constexpr std::ptrdiff_t kMostDots = 64;

// --- the keys there are
// --------------------------------------------------------------------

enum class Form {
    number,
    whole,
    text,
    path,
    flag,
    triple,
    pair,
    resolution,
    bytes,
    resets,
    nearField,
    patterns,
    textures,
    matrix,
    size,
    list,
    plane
};

struct Key {
    std::string_view table;  // "", or one of kTables
    std::string_view name;
    Form form;
    std::string_view prefix = "";  // of the option that it stands for, behind the dashes
};

constexpr Key kKeys[] = {
    {"", "output", Form::path},
    {"", "threads", Form::whole},
    {"", "max-memory", Form::bytes},
    {"", "quiet", Form::flag},
    {"", "json", Form::flag},

    {"light", "shape", Form::text, "light-"},
    {"light", "position", Form::triple, "light-"},
    {"light", "target", Form::triple, "light-"},
    {"light", "direction", Form::triple, "light-"},
    {"light", "up", Form::triple, "light-"},
    {"light", "radius", Form::number, "light-"},
    {"light", "size", Form::pair, "light-"},
    {"light", "angle", Form::number, "light-"},
    {"light", "name", Form::text, "light-"},

    {"map", "projection", Form::text},
    {"map", "fov", Form::number},
    {"map", "near", Form::number},
    {"map", "far", Form::number},
    {"map", "resolution", Form::resolution},
    {"map", "subsamples", Form::whole},
    {"map", "bias", Form::number},
    {"map", "cull", Form::text},
    {"map", "layers", Form::whole},
    {"map", "tolerance", Form::number},
    {"map", "resets", Form::resets},
    {"map", "color", Form::flag},
    {"map", "keep-hidden", Form::flag},
    {"map", "near-field", Form::nearField},
    {"map", "rounding", Form::number},
    {"map", "quality", Form::text},
    {"map", "target-error", Form::number},
    {"map", "codec", Form::text},
    {"map", "level", Form::whole},
    {"map", "tree", Form::flag},

    {"caster", "file", Form::path},
    {"caster", "transform", Form::matrix},
    {"caster", "translate", Form::triple},
    {"caster", "rotate", Form::triple},
    {"caster", "scale", Form::size},
    {"caster", "opacity", Form::number},
    {"caster", "include", Form::patterns},
    {"caster", "exclude", Form::patterns},
    {"caster", "texture", Form::textures},
    {"caster", "hair-width", Form::number},
    {"caster", "hair-tip-width", Form::number},
    {"caster", "hair-opacity", Form::number},
    {"caster", "hair-scale", Form::number},
    {"caster", "density-grid", Form::text},
    {"caster", "density-scale", Form::number},

    {"camera", "position", Form::triple, "camera-"},
    {"camera", "target", Form::triple, "camera-"},
    {"camera", "up", Form::triple, "camera-"},
    {"camera", "fov", Form::number, "camera-"},
    {"camera", "image", Form::resolution},
    {"camera", "points", Form::whole},
    {"camera", "pixels", Form::whole},
    {"camera", "position-pass", Form::path},
    {"camera", "normal-pass", Form::path},

    {"compare", "light-scales", Form::list},
    {"compare", "truth", Form::whole},
    {"compare", "measured-pixels", Form::whole},
    {"compare", "repeats", Form::whole},
    {"compare", "targets", Form::list},

    {"receiver", "file", Form::path},
    {"receiver", "plane", Form::plane},
    {"receiver", "floor", Form::flag},
    {"receiver", "height", Form::number},
    {"receiver", "size", Form::number},
};

/// What a key takes.
const char* expected(Form form) {
    switch (form) {
        case Form::number:
            return "a finite number";
        case Form::whole:
            return "a whole number";
        case Form::text:
            return "text in quotes";
        case Form::path:
            return "the name of a file, in quotes";
        case Form::flag:
            return "true or false";
        case Form::triple:
            return "three finite numbers, such as [0, 1, 0]";
        case Form::pair:
            return "two finite numbers, such as [2, 1]";
        case Form::resolution:
            return "pixels, such as 1024 or [1024, 512]";
        case Form::bytes:
            return "bytes, such as \"8G\" or 1000000";
        case Form::resets:
            return "a whole number, or \"all\"";
        case Form::nearField:
            return "bytes, such as \"32M\" or 1000000, \"auto\" or \"none\"";
        case Form::patterns:
            return "a pattern in quotes, or a list of them";
        case Form::textures:
            return "\"PATTERN=IMAGE\", such as \"Leaf*=leaf.png\", or a list of them";
        case Form::matrix:
            return "16 finite numbers, row by row, the last row 0, 0, 0, 1";
        case Form::size:
            return "a finite number, or three of them";
        case Form::list:
            return "a list of finite numbers, such as [0.3, 1, 3]";
        case Form::plane:
            return "9 finite numbers: a corner and two edges";
    }
    return "";
}

/// Tables whose keys are options, each at most once; and tables that may be repeated.
constexpr std::string_view kSettingTables[] = {"light", "map", "camera", "compare"};
constexpr std::string_view kListTables[] = {"caster", "receiver", "method"};

template <std::size_t N>
bool isOneOf(std::string_view name, const std::string_view (&names)[N]) {
    return std::find(std::begin(names), std::end(names), name) != std::end(names);
}

/// Where a table's keys stand.
std::string inTable(std::string_view table) {
    if (table.empty()) return "at the top of the file, before the first table";
    const bool list = isOneOf(table, kListTables);
    return (list ? "in [[" : "in [") + std::string(table) + (list ? "]]" : "]");
}

// --- near misses
// ---------------------------------------------------------------------------

/// An unknown key as it would be spelled here: lower case, dashes.
std::string spelled(std::string_view key) {
    std::string text(key.substr(0, 64));
    for (char& c : text)
        c = c == '_' || c == ' ' ? '-'
                                 : char(std::tolower(static_cast<unsigned char>(c)));
    while (text.starts_with('-'))
        text.erase(0, 1);
    return text;
}

std::string inQuotes(std::string_view text) {
    constexpr std::size_t kMost = 60;
    const bool cut = text.size() > kMost;
    return "\"" + printable(std::string(text.substr(0, kMost))) + (cut ? "...\"" : "\"");
}

/// What the writer of an unknown key may have meant: a key of this table, a key of
/// another one, or any of those there are.
std::string suggestion(std::string_view table, std::string_view unknown) {
    const std::string key = spelled(unknown);
    for (const Key& k : kKeys) {
        const std::string option = std::string(k.prefix) + std::string(k.name);
        if (k.table == table && (k.name == key || option == key))
            return "did you mean " + inQuotes(k.name) + "?";
    }
    for (const Key& k : kKeys) {
        const std::string option = std::string(k.prefix) + std::string(k.name);
        if (k.name == key || option == key)
            return inQuotes(k.name) + " belongs " + inTable(k.table);
    }
    if (table.empty()) {
        for (const auto& names : {std::span<const std::string_view>(kSettingTables),
                                  std::span<const std::string_view>(kListTables)})
            for (const std::string_view name : names)
                if (editDistance(key, name) <= 1)
                    return "did you mean " + inQuotes(name) + "?";
    }
    const Key* nearest = nullptr;
    std::size_t least = 1 + std::max<std::size_t>(1, key.size() / 3);
    for (const Key& k : kKeys) {
        const std::size_t d = editDistance(key, k.name);
        // Keys of the same table come first among those that are equally near.
        if (d > least || (d == least && (!nearest || k.table != table))) continue;
        if (d == least && nearest->table == table) continue;
        nearest = &k;
        least = d;
    }
    // What was cut short, or had a shorter name once.
    for (const Key& k : kKeys)
        if (!nearest && k.table == table && key.size() > 2 && k.name.starts_with(key))
            nearest = &k;
    if (nearest)
        return "did you mean " + inQuotes(nearest->name) +
               (nearest->table == table ? "?" : " " + inTable(nearest->table) + "?");
    std::string list;
    for (const Key& k : kKeys)
        if (k.table == table) list += (list.empty() ? "" : ", ") + std::string(k.name);
    return "keys there are: " + list +
           (table.empty() ? ", light, map, camera, compare, caster, receiver, method"
                          : "");
}

// --- values
// --------------------------------------------------------------------------------

std::string text(double value) {
    std::array<char, 32> buffer;
    const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
    return {buffer.data(), end.ptr};
}

std::string joined(const std::vector<double>& values) {
    std::string list;
    for (double v : values)
        list += (list.empty() ? "" : ",") + text(v);
    return list;
}

/// A value as messages show it: its type, and itself where it is short.
std::string found(const toml::node& node) {
    switch (node.type()) {
        case toml::node_type::string:
            return "text (" + inQuotes(**node.as_string()) + ")";
        case toml::node_type::integer:
            return "the whole number " + std::to_string(**node.as_integer());
        case toml::node_type::floating_point:
            return "the number " + text(**node.as_floating_point());
        case toml::node_type::boolean:
            return **node.as_boolean() ? "true" : "false";
        case toml::node_type::array: {
            const std::size_t count = node.as_array()->size();
            return "a list of " + std::to_string(count) +
                   (count == 1 ? " value" : " values");
        }
        case toml::node_type::table:
            return "a table";
        default:
            return "a date or time";
    }
}

std::optional<double> number(const toml::node& node) {
    double value = 0.0;
    if (const auto* whole = node.as_integer())
        value = double(**whole);
    else if (const auto* real = node.as_floating_point())
        value = **real;
    else
        return std::nullopt;
    return std::isfinite(value) ? std::optional(value) : std::nullopt;
}

/// `count` finite numbers in a list; empty if it is anything else.
std::vector<double> numbers(const toml::node& node, std::size_t count) {
    const auto* list = node.as_array();
    if (!list || list->size() != count) return {};
    std::vector<double> values;
    for (const toml::node& element : *list) {
        const auto value = number(element);
        if (!value) return {};
        values.push_back(*value);
    }
    return values;
}

/// One text or a list of texts; empty if it is anything else.
std::vector<std::string> texts(const toml::node& node) {
    if (const auto* one = node.as_string()) return {**one};
    std::vector<std::string> values;
    if (const auto* list = node.as_array()) {
        for (const toml::node& element : *list) {
            if (!element.is_string()) return {};
            values.push_back(**element.as_string());
        }
    }
    return values;
}

/// One PATTERN=IMAGE or a list of them; empty if it is anything else.
std::vector<MaterialTexture> textures(const toml::node& node) {
    std::vector<MaterialTexture> values;
    for (const std::string& one : texts(node)) {
        auto texture = parseTexture(one);
        if (!texture) return {};
        values.push_back(*std::move(texture));
    }
    return values;
}

/// A value of the form as the command line spells it; nothing if it is of another form.
std::optional<std::string> spell(Form form, const toml::node& node) {
    const auto* word = node.as_string();
    const auto* whole = node.as_integer();
    const auto list = [&](std::size_t count) -> std::optional<std::string> {
        const auto values = numbers(node, count);
        return values.empty() ? std::nullopt : std::optional(joined(values));
    };
    switch (form) {
        case Form::number:
            if (const auto value = number(node)) return text(*value);
            return std::nullopt;
        case Form::triple:
            return list(3);
        case Form::pair:
            return list(2);
        case Form::list:
            return list(node.is_array() ? node.as_array()->size() : 0);
        case Form::resolution: {
            if (whole) return std::to_string(**whole);
            const auto* sides = node.as_array();
            if (!sides || sides->size() != 2) return std::nullopt;
            const auto *w = (*sides)[0].as_integer(), *h = (*sides)[1].as_integer();
            if (!w || !h) return std::nullopt;
            return std::to_string(**w) + "x" + std::to_string(**h);
        }
        case Form::whole:
            return whole ? std::optional(std::to_string(**whole)) : std::nullopt;
        case Form::bytes:
        case Form::resets:
        case Form::nearField:
            if (whole) return std::to_string(**whole);
            [[fallthrough]];
        case Form::text:
        case Form::path:
            return word && !word->get().empty() ? std::optional(word->get())
                                                : std::nullopt;
        case Form::flag:
            if (!node.is_boolean()) return std::nullopt;
            return **node.as_boolean() ? "true" : "false";
        default:
            return std::nullopt;
    }
}

// --- the job
// -------------------------------------------------------------------------------

/// Reads one file; its first problem is thrown as a Failure.
class Reader {
  public:
    explicit Reader(std::string path) : path_(std::move(path)) {}
    Job read();

  private:
    [[nodiscard]] std::string place(const toml::source_position& at) const;
    [[nodiscard]] std::string place(const toml::node& node) const {
        return place(node.source().begin);
    }
    [[noreturn]] void refuse(const std::string& place, const std::string& why) const {
        throw Failure{{ErrorCode::badFile, place + ": " + why}};
    }
    [[nodiscard]] toml::table parse() const;
    void checkDepth(const std::string& bytes) const;
    /// Refuses texts that C functions would see the beginning of.
    void checkNoNul(const Key& key, const toml::node& value) const;
    const Key& find(std::string_view table, const toml::key& key) const;
    void readSettings(std::string_view table, const toml::table& content);
    /// The tables of a list; `need` is what each must have.
    [[nodiscard]] const toml::array& tablesOf(const toml::node& node, const char* name,
                                              const char* need) const;
    [[nodiscard]] static const toml::node& namedIn(const std::string& message,
                                                   const CasterFile& caster,
                                                   const toml::table& content);
    CasterFile readCaster(const toml::table& content) const;
    JobReceiver readReceiver(const toml::table& content) const;
    JobMethod readMethod(const toml::table& content) const;
    [[nodiscard]] std::vector<MaterialTexture> readTextures(
        const toml::node& value) const;
    void setCaster(CasterFile& caster, const Key& key, const toml::node& value) const;
    glm::dmat4 transformOf(const toml::table& content) const;
    /// As seen from the folder that the tool runs in.
    [[nodiscard]] std::string resolved(const std::string& file) const {
        return (fs::path(path_).parent_path() / file).string();
    }
    /// Refuses a file that a key names and that does not exist.
    void checkThere(const toml::node& node, const std::string& key,
                    const std::string& file) const;
    [[noreturn]] void refuseValue(const Key& key, const toml::node& value) const {
        refuse(place(value), std::string(key.name) + ": found " + found(value) +
                                 ", expected " + expected(key.form));
    }

    const std::string path_;
    Job job_;
};

std::string Reader::place(const toml::source_position& at) const {
    return path_ + ":" + std::to_string(at.line) + ":" + std::to_string(at.column);
}

toml::table Reader::parse() const {
    std::error_code problem;
    const auto fail = [&](ErrorCode code, const std::string& why) {
        throw Failure{{code, path_ + ": " + why}};
    };
    const bool folder = fs::is_directory(path_, problem);
    errno = 0;
    std::ifstream in(path_, std::ios::binary);
    if (!in || folder)
        fail(ErrorCode::io, std::string("cannot read: ") +
                                (folder ? "it is a folder" : std::strerror(errno)));
    std::string bytes;
    std::array<char, 65536> part;
    while (in.read(part.data(), part.size()) || in.gcount() > 0) {
        bytes.append(part.data(), std::size_t(in.gcount()));
        if (bytes.size() > kMostBytes)
            fail(ErrorCode::badFile, "is longer than 16 MiB: this is no job file");
    }
    checkDepth(bytes);
    try {
        return toml::parse(bytes);
    } catch (const toml::parse_error& wrong) {
        refuse(place(wrong.source().begin),
               "is not TOML: " + printable(std::string(wrong.description())));
    }
}

void Reader::checkDepth(const std::string& bytes) const {
    std::istringstream in(bytes);
    std::string line;
    for (std::size_t number = 1; std::getline(in, line); ++number) {
        const auto dots = std::count(line.begin(), line.end(), '.');
        if (dots > kMostDots)
            refuse(path_ + ":" + std::to_string(number),
                   "found " + std::to_string(dots) +
                       " dots in one line, expected at most " +
                       std::to_string(kMostDots) +
                       "; a long list may go over several lines");
    }
}

void Reader::checkNoNul(const Key& key, const toml::node& value) const {
    for (const std::string& text : texts(value))
        if (text.find('\0') != std::string::npos)
            refuse(place(value), std::string(key.name) +
                                     ": found a text with a NUL character (\\u0000), "
                                     "expected one without");
}

const Key& Reader::find(std::string_view table, const toml::key& key) const {
    for (const Key& k : kKeys)
        if (k.table == table && k.name == key.str()) return k;
    refuse(place(key.source().begin), "unknown key " + inQuotes(key.str()) + " " +
                                          inTable(table) + ": " +
                                          suggestion(table, key.str()));
}

void Reader::readSettings(std::string_view table, const toml::table& content) {
    for (const auto& [key, value] : content) {
        const bool isTable =
            isOneOf(key.str(), kSettingTables) || isOneOf(key.str(), kListTables);
        if (table.empty() && isTable) continue;
        const Key& known = find(table, key);
        checkNoNul(known, value);
        auto spelling = spell(known.form, value);
        if (!spelling) refuseValue(known, value);
        if (known.form == Form::path) spelling = resolved(*spelling);
        if (known.form == Form::flag && *spelling == "false") continue;
        const std::string dot = table.empty() ? "" : std::string(table) + ".";
        job_.settings.push_back(
            {"--" + std::string(known.prefix) + std::string(known.name),
             dot + std::string(known.name), *spelling, place(key.source().begin)});
    }
}

/// Translation, rotations about x, then y, then z, and scale, or the matrix itself.
glm::dmat4 Reader::transformOf(const toml::table& content) const {
    glm::dmat4 m(1.0);
    const toml::node* matrix = content.get("transform");
    for (const char* part : {"translate", "rotate", "scale"}) {
        if (matrix && content.contains(part))
            refuse(place(*matrix),
                   std::string("transform and ") + part + " exclude each other");
    }
    if (matrix) {
        const auto v = numbers(*matrix, 16);
        for (std::size_t i = 0; i < v.size(); ++i)
            m[int(i % 4)][int(i / 4)] = v[i];
        return m;
    }
    const auto triple = [&](const char* key, double otherwise) {
        const toml::node* node = content.get(key);
        if (!node) return glm::dvec3(otherwise);
        if (const auto all = number(*node)) return glm::dvec3(*all);
        const auto v = numbers(*node, 3);
        return glm::dvec3(v[0], v[1], v[2]);
    };
    const glm::dvec3 turn = glm::radians(triple("rotate", 0.0));
    m = glm::translate(m, triple("translate", 0.0));
    m = glm::rotate(m, turn.z, glm::dvec3(0, 0, 1));
    m = glm::rotate(m, turn.y, glm::dvec3(0, 1, 0));
    m = glm::rotate(m, turn.x, glm::dvec3(1, 0, 0));
    return glm::scale(m, triple("scale", 1.0));
}

void Reader::checkThere(const toml::node& node, const std::string& key,
                        const std::string& file) const {
    std::error_code problem;
    if (!fs::exists(file, problem))
        throw Failure{{ErrorCode::io, place(node) + ": " + key + ": there is no file " +
                                          file +
                                          " (paths are relative to the job file)"}};
}

/// Images as the process sees them.
std::vector<MaterialTexture> Reader::readTextures(const toml::node& value) const {
    auto list = textures(value);
    for (MaterialTexture& texture : list) {
        if (texture.image.empty()) continue;
        texture.image = resolved(texture.image);
        checkThere(value, "texture", texture.image);
    }
    return list;
}

/// Checks the value, and takes it over unless it is part of the transform.
void Reader::setCaster(CasterFile& c, const Key& key, const toml::node& value) const {
    const auto real = number(value);
    const auto* word = value.as_string();
    const bool good = key.form == Form::number     ? real.has_value()
                      : key.form == Form::triple   ? numbers(value, 3).size() == 3
                      : key.form == Form::size     ? real || numbers(value, 3).size() == 3
                      : key.form == Form::matrix   ? numbers(value, 16).size() == 16
                      : key.form == Form::patterns ? !texts(value).empty()
                      : key.form == Form::textures ? !textures(value).empty()
                                                   : word && !word->get().empty();
    if (!good) refuseValue(key, value);
    checkNoNul(key, value);
    if (key.name == "file") c.path = resolved(word->get());
    if (key.name == "opacity") c.opacity = float(*real);
    if (key.name == "include") c.include = texts(value);
    if (key.name == "exclude") c.exclude = texts(value);
    if (key.name == "texture") c.textures = readTextures(value);
    if (key.name == "hair-width") c.hairWidth = float(*real);
    if (key.name == "hair-tip-width") c.hairTipWidth = float(*real);
    if (key.name == "hair-opacity") c.hairOpacity = float(*real);
    if (key.name == "hair-scale") c.hairScale = float(*real);
    if (key.name == "density-grid") c.densityGrid = word->get();
    if (key.name == "density-scale") c.densityScale = float(*real);
}

/// The setting of a caster that a message names behind the file, or all of them.
const toml::node& Reader::namedIn(const std::string& message, const CasterFile& caster,
                                  const toml::table& content) {
    const auto names = [&](std::string_view setting) {
        const std::string start = caster.path + ": " + std::string(setting) + " ";
        return message.compare(0, start.size(), start) == 0;
    };
    for (const auto& [key, value] : content) {
        // Of a transform's parts only a scale can be wrong.
        if (names(key.str()) || (key.str() == "scale" && names("transform")))
            return value;
    }
    return content;
}

CasterFile Reader::readCaster(const toml::table& content) const {
    CasterFile caster;
    for (const auto& [key, value] : content)
        setCaster(caster, find("caster", key), value);
    const toml::node* file = content.get("file");
    if (!file) refuse(place(content), "this [[caster]] has no file = \"...\"");
    checkThere(*file, "file", caster.path);
    caster.transform = transformOf(content);
    if (const Status good = checkCaster(caster); !good)
        refuse(place(namedIn(good.error().message, caster, content)),
               good.error().message);
    return caster;
}

const toml::array& Reader::tablesOf(const toml::node& node, const char* name,
                                    const char* need) const {
    const auto* list = node.as_array();
    if (!list || !list->is_homogeneous(toml::node_type::table))
        refuse(place(node), std::string(name) + ": found " + found(node) +
                                ", expected tables that begin with [[" + name +
                                "]], each with " + need);
    return *list;
}

JobReceiver Reader::readReceiver(const toml::table& content) const {
    JobReceiver receiver;
    receiver.place = place(content);
    for (const auto& [key, value] : content) {
        const Key& known = find("receiver", key);
        const auto real = number(value);
        const auto nine = numbers(value, 9);
        const auto* word = value.as_string();
        const bool good = known.form == Form::number  ? real.has_value()
                          : known.form == Form::plane ? nine.size() == 9
                          : known.form == Form::flag  ? value.is_boolean()
                                                      : word && !word->get().empty();
        if (!good) refuseValue(known, value);
        checkNoNul(known, value);
        if (known.name == "file") receiver.file = resolved(word->get());
        if (known.name == "plane")
            receiver.plane = JobPlane{{nine[0], nine[1], nine[2]},
                                      {nine[3], nine[4], nine[5]},
                                      {nine[6], nine[7], nine[8]}};
        if (known.name == "floor") receiver.floor = **value.as_boolean();
        if (known.name == "height") receiver.height = *real;
        if (known.name == "size") receiver.size = *real;
    }
    const toml::node* file = content.get("file");
    if ((file ? 1 : 0) + (receiver.plane ? 1 : 0) + (receiver.floor ? 1 : 0) != 1)
        refuse(receiver.place,
               "this [[receiver]] needs one of file = \"...\", plane = [9 numbers] and "
               "floor = true");
    if (!receiver.floor && (receiver.height || receiver.size))
        refuse(receiver.place, "height and size are for floor = true alone");
    if (file) checkThere(*file, "file", receiver.file);
    return receiver;
}

/// One value or a list of them, each true or false, a number or a text.
JobMethod Reader::readMethod(const toml::table& content) const {
    JobMethod method;
    method.place = place(content);
    for (const auto& [key, value] : content) {
        std::vector<JobMethod::Value> values;
        const auto take = [&](const toml::node& one) {
            if (const auto real = number(one))
                values.emplace_back(*real);
            else if (const auto* word = one.as_string())
                values.emplace_back(word->get());
            else if (one.is_boolean())
                values.emplace_back(**one.as_boolean());
            else
                refuse(place(one), std::string(key.str()) + ": found " + found(one) +
                                       ", expected a finite number, a text, true or "
                                       "false, or a list of these");
        };
        if (const auto* list = value.as_array()) {
            for (const toml::node& one : *list)
                take(one);
        } else {
            take(value);
        }
        if (values.empty())
            refuse(place(value), std::string(key.str()) + ": found an empty list");
        if (key.str() == "name") {
            if (values.size() != 1 || !std::holds_alternative<std::string>(values[0]))
                refuse(place(value), "name: found " + found(value) +
                                         ", expected the name of a method, in quotes");
            method.name = std::get<std::string>(values[0]);
        } else {
            method.settings.emplace_back(std::string(key.str()), std::move(values));
        }
    }
    if (method.name.empty())
        refuse(method.place, "this [[method]] has no name = \"...\"");
    return method;
}

Job Reader::read() {
    const toml::table content = parse();
    readSettings("", content);
    for (const std::string_view name : kSettingTables) {
        const toml::node* node = content.get(name);
        if (!node) continue;
        if (!node->is_table())
            refuse(place(*node), std::string(name) + ": found " + found(*node) +
                                     ", expected a table that begins with [" +
                                     std::string(name) + "]");
        readSettings(name, *node->as_table());
    }
    const toml::node* casters = content.get("caster");
    if (!casters)
        throw Failure{{ErrorCode::badFile,
                       path_ + ": has no [[caster]]: a job needs one with file = \"...\" "
                               "for each file that casts"}};
    for (const auto& one : tablesOf(*casters, "caster", "file = \"...\""))
        job_.casters.push_back(readCaster(*one.as_table()));
    if (const toml::node* node = content.get("receiver"))
        for (const auto& one : tablesOf(*node, "receiver", "file, plane or floor"))
            job_.receivers.push_back(readReceiver(*one.as_table()));
    if (const toml::node* node = content.get("method"))
        for (const auto& one : tablesOf(*node, "method", "name = \"...\""))
            job_.methods.push_back(readMethod(*one.as_table()));
    return std::move(job_);
}

}  // namespace

Result<Job> readJob(const std::string& path) {
    try {
        return Reader(path).read();
    } catch (const Failure& failure) {
        return failure.error;
    }
}

namespace {

[[noreturn]] void refuseSetting(const JobSetting& setting, const std::string& why) {
    throw Failure{{ErrorCode::badFile, setting.place + ": " + printable(why)}};
}

/// The text of an error, beginning with a key of the job in place of its option.
[[noreturn]] void refuseSetting(const JobSetting& setting, const UsageError& wrong) {
    std::string why = wrong.what();
    if (why.starts_with(setting.option))
        why = setting.key + why.substr(setting.option.size());
    refuseSetting(setting, why);
}

/// Gives `option` the setting's value, as if the command line had.
void give(CLI::Option& option, const JobSetting& setting) {
    try {
        option.add_result(setting.value);
        option.run_callback();
    } catch (const UsageError& wrong) {
        refuseSetting(setting, wrong);
    } catch (const CLI::ParseError& wrong) {
        refuseSetting(setting, setting.key + ": " + wrong.what());
    }
}

/// What the command line alone says, and what of a job loses its meaning by it.
class CommandLine {
  public:
    CommandLine(const Job& job, const CLI::App& app) {
        for (const CLI::Option* option : app.get_options())
            if (option->count() > 0)
                given_[option->get_name()] = option->results().back();
        shape_ = shapeBeside(job);
    }
    [[nodiscard]] bool gave(const CLI::Option& option) const {
        return given_.count(option.get_name()) > 0;
    }
    [[nodiscard]] bool overrules(const JobSetting& setting) const {
        const std::string& o = setting.option;
        const bool sun = shape_ == "sun";
        if (o == "--light-shape") return !shape_.empty() && setting.value != shape_;
        if (o == "--light-radius" || o == "--light-size" || o == "--light-angle")
            return !shape_.empty() && !isSizeOf(o, shape_);
        if (o == "--light-position" || o == "--light-target") return sun;
        if (o == "--fov") return sun || says("--projection", "cube");
        if (o == "--projection") return sun || given_.count("--fov") > 0;
        return o == "--level" && says("--codec", "none");
    }

  private:
    static bool isSizeOf(std::string_view option, std::string_view shape) {
        return option == "--light-radius" ? shape == "disk" || shape == "sphere"
               : option == "--light-size" ? shape == "rect"
                                          : shape == "sun";
    }
    [[nodiscard]] bool says(const char* option, std::string_view value) const {
        const auto at = given_.find(option);
        return at != given_.end() && at->second == value;
    }
    /// The light's shape if the command line decides it: by its name, or by the size of
    /// one, unless the size is one that the job's shape has. Else empty.
    [[nodiscard]] std::string shapeBeside(const Job& job) const {
        if (const auto at = given_.find("--light-shape"); at != given_.end())
            return at->second;
        for (const auto& [size, shape] :
             {std::pair("--light-radius", "disk"), std::pair("--light-size", "rect"),
              std::pair("--light-angle", "sun")}) {
            if (given_.count(size) == 0) continue;
            for (const JobSetting& s : job.settings)
                if (s.option == "--light-shape" && isSizeOf(size, s.value))
                    return s.value;
            return shape;
        }
        return {};
    }

    std::map<std::string, std::string> given_;  // option -> value
    std::string shape_;
};

}  // namespace

void applyJob(Job& job, CLI::App& app) {
    const CommandLine line(job, app);
    std::map<const CLI::Option*, JobSetting> taken;
    std::vector<JobSetting> inOrder;
    for (const JobSetting& setting : job.settings) {
        CLI::Option* option = app.get_option_no_throw(setting.option);
        if (!option || line.gave(*option) || line.overrules(setting)) continue;
        bool overruled = false;
        for (const CLI::Option* other : option->get_excludes()) {
            overruled = overruled || line.gave(*other);
            if (const auto at = taken.find(other); at != taken.end())
                refuseSetting(setting, setting.key + " and " + at->second.key +
                                           " exclude each other");
        }
        if (overruled) continue;
        give(*option, setting);
        taken[option] = setting;
        inOrder.push_back(setting);
    }
    job.settings = std::move(inOrder);
}

void blameJob(const Job& job, const UsageError& wrong) {
    const std::string_view text = wrong.what();
    for (const JobSetting& setting : job.settings) {
        if (!text.starts_with(setting.option)) continue;
        const std::string_view rest = text.substr(setting.option.size());
        if (rest.starts_with(':') || rest.starts_with(' ')) refuseSetting(setting, wrong);
    }
}

std::string casterText(const CasterFile& c) {
    std::string list;
    const auto add = [&](const std::string& key, const std::string& value) {
        list += (list.empty() ? "" : ", ") + key + " = " + value;
    };
    const auto addNumber = [&](const char* key, std::optional<float> value) {
        if (value) add(key, shortText(*value));
    };
    const auto addAll = [&](const char* key, const std::vector<std::string>& globs) {
        for (const std::string& glob : globs)
            add(key, glob);
    };
    if (c.transform != glm::dmat4(1.0)) {
        std::string rows;
        for (int i = 0; i < 16; ++i)
            rows += (i ? "," : "") + text(c.transform[i % 4][i / 4]);
        add("transform", rows);
    }
    addNumber("opacity", c.opacity);
    addAll("include", c.include);
    addAll("exclude", c.exclude);
    for (const MaterialTexture& texture : c.textures)
        add("texture", texture.material + "=" + texture.image);
    addNumber("hair-width", c.hairWidth);
    addNumber("hair-tip-width", c.hairTipWidth);
    addNumber("hair-opacity", c.hairOpacity);
    if (c.hairScale != 1.0f) addNumber("hair-scale", c.hairScale);
    if (!c.densityGrid.empty()) add("density-grid", c.densityGrid);
    if (c.densityScale != 1.0f) addNumber("density-scale", c.densityScale);
    return c.path + (list.empty() ? "" : " {" + list + "}");
}

}  // namespace mtsm::tools
