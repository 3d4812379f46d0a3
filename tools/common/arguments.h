// arguments.h - values as command lines spell them. Each function adds one option to a
// CLI11 app; what does not parse or is out of range is a usage error that says what was
// found and what was expected.
#pragma once
#include <CLI/CLI.hpp>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "mtsm/reader.h"
#include "mtsm/scene.h"

namespace mtsm::tools {

/// A wrong command line: exit code 2.
struct UsageError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

inline constexpr double kAny = std::numeric_limits<double>::infinity();

/// Letters to insert, drop, change or swap with their neighbour to make `a` of `b`.
std::size_t editDistance(std::string_view a, std::string_view b);

/// Bounds of a number; infinite ones do not bound. Numbers are always finite.
struct Range {
    double least = -kAny, most = kAny;
    bool mostExcluded = false;
};

/// `count` finite numbers separated by commas; UsageError names `option` and `form`.
std::vector<double> parseNumbers(const std::string& option, const std::string& text,
                                 std::size_t count, const std::string& form);
glm::dvec3 parseTriple(const std::string& option, const std::string& text);
/// "N" or "WxH", each side 1 to `most`.
glm::uvec2 parseResolution(const std::string& option, const std::string& text,
                           std::uint32_t most);
/// "X,Y": whole numbers, not negative.
glm::uvec2 parsePixel(const std::string& option, const std::string& text);
/// "PATTERN=IMAGE"; nothing behind the = is no texture. Empty if it is of another form.
std::optional<MaterialTexture> parseTexture(const std::string& text);
/// Bytes with an optional suffix K, M, G or T (powers of 1024).
std::uint64_t parseBytes(const std::string& option, const std::string& text);

/// --max-memory of the tools that read maps, and the limits that it means.
CLI::Option* addMaxMemory(CLI::App& app, std::string& value);
ReadLimits readLimits(const std::string& maxMemory);

CLI::Option* addNumber(CLI::App& app, const std::string& name,
                       std::optional<double>& value, Range range, const std::string& unit,
                       const std::string& help);
CLI::Option* addWhole(CLI::App& app, const std::string& name, std::int64_t& value,
                      std::int64_t least, std::int64_t most, const std::string& help);
CLI::Option* addTriple(CLI::App& app, const std::string& name,
                       std::optional<glm::dvec3>& value, const std::string& help);
/// Not empty.
CLI::Option* addText(CLI::App& app, const std::string& name, std::string& value,
                     const std::string& form, const std::string& help);
/// One of `words`, by its place in the list.
CLI::Option* addChoice(CLI::App& app, const std::string& name,
                       std::optional<std::size_t>& value,
                       const std::vector<std::string>& words, const std::string& help);

}  // namespace mtsm::tools
