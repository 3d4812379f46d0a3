// Values as command lines spell them.
#include "common/arguments.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <sstream>
#include <string_view>

#include "mtsm/describe.h"

namespace mtsm::tools {
namespace {

template <typename... Parts>
std::string concat(const Parts&... parts) {
    std::ostringstream out;
    (out << ... << parts);
    return out.str();
}

/// A whole field as a number; false if it is none.
template <typename T>
bool parse(std::string_view text, T& value) {
    if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
    const auto [end, problem] =
        std::from_chars(text.data(), text.data() + text.size(), value);
    return problem == std::errc() && end == text.data() + text.size();
}

std::vector<std::string> split(const std::string& text, char separator) {
    std::vector<std::string> fields;
    std::istringstream in(text);
    for (std::string field; std::getline(in, field, separator);)
        fields.push_back(field);
    if (text.ends_with(separator)) fields.emplace_back();
    for (std::string& f : fields) {
        f.erase(0, f.find_first_not_of(' '));
        f.erase(f.find_last_not_of(' ') + 1);
    }
    return fields;
}

[[noreturn]] void refuse(const std::string& option, const std::string& found,
                         const std::string& expected) {
    throw UsageError(concat(option, ": found \"", found, "\", expected ", expected));
}

std::string describe(Range range) {
    std::string text = "a finite number";
    if (range.least > -kAny && range.most < kAny)
        return concat(text, " from ", range.least,
                      range.mostExcluded ? " to below " : " to ", range.most);
    if (range.least > -kAny) return concat(text, " of at least ", range.least);
    return text;
}

bool within(double value, Range range) {
    return std::isfinite(value) && value >= range.least &&
           (range.mostExcluded ? value < range.most : value <= range.most);
}

}  // namespace

std::size_t editDistance(std::string_view a, std::string_view b) {
    std::vector<std::vector<std::size_t>> d(a.size() + 1,
                                            std::vector<std::size_t>(b.size() + 1));
    for (std::size_t i = 0; i <= a.size(); ++i) {
        for (std::size_t k = 0; k <= b.size(); ++k) {
            if (i == 0 || k == 0) {
                d[i][k] = i + k;
                continue;
            }
            d[i][k] = std::min({d[i - 1][k] + 1, d[i][k - 1] + 1,
                                d[i - 1][k - 1] + (a[i - 1] != b[k - 1])});
            if (i > 1 && k > 1 && a[i - 1] == b[k - 2] && a[i - 2] == b[k - 1])
                d[i][k] = std::min(d[i][k], d[i - 2][k - 2] + 1);
        }
    }
    return d[a.size()][b.size()];
}

std::vector<double> parseNumbers(const std::string& option, const std::string& text,
                                 std::size_t count, const std::string& form) {
    std::vector<double> values;
    for (const std::string& field : split(text, ',')) {
        double value = 0.0;
        if (!parse(field, value) || !std::isfinite(value)) {
            values.clear();
            break;
        }
        values.push_back(value);
    }
    if (values.size() != count)
        refuse(option, text,
               concat(form, ": ", count,
                      " finite numbers with commas between and no spaces"));
    return values;
}

glm::dvec3 parseTriple(const std::string& option, const std::string& text) {
    const auto v = parseNumbers(option, text, 3, "X,Y,Z");
    return {v[0], v[1], v[2]};
}

glm::uvec2 parseResolution(const std::string& option, const std::string& text,
                           std::uint32_t most) {
    const auto fields = split(text, 'x');
    glm::uvec2 size(0);
    const bool one = fields.size() == 1 && parse(fields[0], size.x);
    const bool two =
        fields.size() == 2 && parse(fields[0], size.x) && parse(fields[1], size.y);
    if (one) size.y = size.x;
    if ((!one && !two) || size.x < 1 || size.y < 1 || size.x > most || size.y > most)
        refuse(option, text, concat("N or WxH pixels, each from 1 to ", most));
    return size;
}

glm::uvec2 parsePixel(const std::string& option, const std::string& text) {
    const auto fields = split(text, ',');
    glm::uvec2 pixel(0);
    if (fields.size() != 2 || !parse(fields[0], pixel.x) || !parse(fields[1], pixel.y))
        refuse(option, text, "X,Y: column and row of a pixel, counted from 0");
    return pixel;
}

std::optional<MaterialTexture> parseTexture(const std::string& text) {
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos || equals == 0) return std::nullopt;
    return MaterialTexture{text.substr(0, equals), text.substr(equals + 1)};
}

std::uint64_t parseBytes(const std::string& option, const std::string& text) {
    const auto bytes = mtsm::parseBytes(text);
    if (!bytes) refuse(option, text, "a number of bytes such as 8G, 512M or 1000000");
    return *bytes;
}

CLI::Option* addMaxMemory(CLI::App& app, std::string& value) {
    return addText(app, "--max-memory", value, "BYTES",
                   "bound on what decoding the map takes: 8G, 512M\n(default: 8G)");
}

ReadLimits readLimits(const std::string& maxMemory) {
    ReadLimits limits;
    limits.maxBytes = parseBytes("--max-memory", maxMemory);
    return limits;
}

CLI::Option* addNumber(CLI::App& app, const std::string& name,
                       std::optional<double>& value, Range range, const std::string& unit,
                       const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [name, &value, range](const std::string& text) {
                double number = 0.0;
                if (!parse(text, number) || !within(number, range))
                    refuse(name, text, describe(range));
                value = number;
            },
            help)
        ->type_name(unit);
}

CLI::Option* addWhole(CLI::App& app, const std::string& name, std::int64_t& value,
                      std::int64_t least, std::int64_t most, const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [name, &value, least, most](const std::string& text) {
                std::int64_t number = 0;
                if (!parse(text, number) || number < least || number > most)
                    refuse(name, text,
                           concat("a whole number from ", least, " to ", most));
                value = number;
            },
            help)
        ->type_name("N");
}

CLI::Option* addTriple(CLI::App& app, const std::string& name,
                       std::optional<glm::dvec3>& value, const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [name, &value](const std::string& text) { value = parseTriple(name, text); },
            help)
        ->type_name("X,Y,Z");
}

CLI::Option* addText(CLI::App& app, const std::string& name, std::string& value,
                     const std::string& form, const std::string& help) {
    return app
        .add_option_function<std::string>(
            name,
            [name, form, &value](const std::string& text) {
                if (text.empty()) refuse(name, text, form);
                value = text;
            },
            help)
        ->type_name(form);
}

CLI::Option* addChoice(CLI::App& app, const std::string& name,
                       std::optional<std::size_t>& value,
                       const std::vector<std::string>& words, const std::string& help) {
    std::string list;
    for (const std::string& word : words)
        list += (list.empty() ? "" : "|") + word;
    return app
        .add_option_function<std::string>(
            name,
            [name, &value, words, list](const std::string& text) {
                const auto at = std::find(words.begin(), words.end(), text);
                if (at == words.end()) refuse(name, text, "one of " + list);
                value = std::size_t(at - words.begin());
            },
            help)
        ->type_name(list);
}

}  // namespace mtsm::tools
