// What every tool's main has around its own few lines.
#include "common/tool.h"

#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/task_arena.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <glm/trigonometric.hpp>
#include <iostream>
#include <new>

#include "common/arguments.h"

namespace mtsm::tools {
namespace {

namespace fs = std::filesystem;

constexpr const char* kExitCodes =
    "\nExit codes: 0 good, 2 usage, 3 input or output failed, 4 bad file, 5 unsupported.";

std::string format(const char* pattern, double value) {
    char text[48];
    std::snprintf(text, sizeof text, pattern, value);
    return text;
}

[[noreturn]] void failOutput(const std::string& path, const std::string& reason) {
    throw Failure{{ErrorCode::io, path + ": cannot write: " + reason}};
}

/// The option that is nearest to an unknown one, if one is near.
std::string suggestion(const CLI::App& app, const std::string& unknown) {
    const std::string name = unknown.substr(0, unknown.find('='));
    std::string nearest;
    std::size_t least = 1 + std::max<std::size_t>(1, name.size() / 4);
    for (const CLI::Option* option : app.get_options()) {
        if (option->get_positional()) continue;
        const std::string known = option->get_name();
        const std::size_t d = editDistance(name, known);
        if (d >= least) continue;
        nearest = known;
        least = d;
    }
    // What was cut short, or had a shorter name once.
    for (const CLI::Option* option : app.get_options())
        if (nearest.empty() && name.size() > 4 && !option->get_positional() &&
            option->get_name().starts_with(name))
            nearest = option->get_name();
    return nearest.empty() ? "" : "; did you mean " + nearest + "?";
}

/// What CLI11 finds wrong, in our words where its own do not help.
std::string wordsFor(const CLI::App& app, const CLI::ParseError& wrong) {
    const std::string text = wrong.what();
    const auto most = text.find(": At Most 1 required but received");
    if (most != std::string::npos)
        return text.substr(0, most) + ": is given more than once; give it once";
    if (wrong.get_exit_code() != int(CLI::ExitCodes::ExtrasError)) return text;
    for (const std::string& unknown : app.remaining())
        if (unknown.starts_with("-"))
            return unknown + ": there is no such option" + suggestion(app, unknown);
    return text;
}

/// An error of the library, with options where it names fields that they set.
std::string inToolWords(std::string text) {
    static constexpr std::array<std::array<std::string_view, 2>, 2> kWords = {
        {{"ReadLimits::maxBytes", "--max-memory"}, {" (importerBytes)", ""}}};
    for (const auto& [field, option] : kWords)
        if (const auto at = text.find(field); at != std::string::npos)
            text.replace(at, field.size(), option);
    return text;
}

}  // namespace

void describeTool(CLI::App& app, const std::string& examples) {
    app.set_version_flag("--version", app.get_name() + " " MTSM_VERSION,
                         "print the version and exit");
    app.set_help_flag("-h,--help", "print this help and exit");
    app.get_option("--version")->group("General");
    app.get_option("--help")->group("General");
    app.footer("\n" + examples + kExitCodes);
    app.get_formatter()->column_width(34);
}

int runTool(CLI::App& app, int argc, char** argv, Talk& talk,
            const std::function<void()>& body) {
    const std::string seeHelp = " (" + app.get_name() + " --help explains)";
    try {
        catchSignals();
        app.parse(argc, argv);
        body();
        return 0;
    } catch (const CLI::Success& asked) {  // --help, --version
        app.exit(asked, std::cout, std::cerr);
        if (std::cout.flush()) return 0;
        talk.error("standard output: cannot write");
        return exitCode(ErrorCode::io);
    } catch (const CLI::ParseError& wrong) {
        talk.error(wordsFor(app, wrong) + seeHelp);
    } catch (const UsageError& wrong) {
        talk.error(wrong.what() + seeHelp);
    } catch (const Failure& failure) {
        talk.error(inToolWords(failure.error.message));
        return exitCode(failure.error.code);
    } catch (const std::bad_alloc&) {
        talk.error("not enough memory");
        return exitCode(ErrorCode::io);
    } catch (const std::exception& e) {
        talk.error(std::string("unexpected: ") + e.what());
        return exitCode(ErrorCode::io);
    }
    return exitCode(ErrorCode::badArgument);
}

void withThreads(std::int64_t threads, const std::function<void()>& body) {
    if (threads == 0) return body();
    const auto count = static_cast<std::size_t>(threads);
    const tbb::global_control control(tbb::global_control::max_allowed_parallelism,
                                      count);
    tbb::task_arena arena(static_cast<int>(threads));
    arena.execute(body);
}

void checkOutput(const std::string& path, const std::vector<std::string>& inputs) {
    std::error_code problem;
    if (fs::is_directory(path, problem))
        failOutput(path, "it is a folder; give the name of a file in it");
    for (const std::string& input : inputs) {
        if (fs::equivalent(path, input, problem))
            throw UsageError(path + ": the output is also an input; choose another name");
    }
    // A pipe or a device is written to as it is; what a link points to is replaced.
    if (fs::exists(path, problem) && !fs::is_regular_file(path, problem)) return;
    const fs::path target = fs::canonical(path, problem);
    const fs::path parent = (problem ? fs::path(path) : target).parent_path();
    const std::string folder = parent.empty() ? "." : parent.string();
    if (!fs::is_directory(folder, problem))
        failOutput(path, "there is no folder " + folder);
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        failOutput(path, "the folder " + folder + ": " + std::strerror(errno));
}

std::string jsonText(const nlohmann::ordered_json& j) {
    constexpr bool kAscii = true;  // else control characters beyond ASCII would come out
    return j.dump(2, ' ', kAscii, nlohmann::json::error_handler_t::replace) + "\n";
}

void print(const std::string& text) {
    errno = 0;
    const bool good = std::fwrite(text.data(), 1, text.size(), stdout) == text.size() &&
                      std::fflush(stdout) == 0;
    if (!good) failOutput("standard output", std::strerror(errno ? errno : EIO));
}

std::uint64_t halfOfMemory() {
    constexpr std::uint64_t kUnknown = std::uint64_t(8) << 30;
    const long pages = ::sysconf(_SC_PHYS_PAGES), bytes = ::sysconf(_SC_PAGESIZE);
    return pages > 0 && bytes > 0 ? std::uint64_t(pages) * std::uint64_t(bytes) / 2
                                  : kUnknown;
}

std::uint64_t peakMemory() {
    rusage usage{};
    return ::getrusage(RUSAGE_SELF, &usage) == 0 ? std::uint64_t(usage.ru_maxrss) * 1024
                                                 : 0;
}

std::string extension(const std::string& path) {
    std::string text = fs::path(path).extension().string();
    for (char& c : text)
        c = char(std::tolower(static_cast<unsigned char>(c)));
    return text;
}

std::string quotedForShell(const std::string& text) {
    const bool plain = text.find_first_not_of(
                           "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                           "0123456789._/-+,=") == std::string::npos;
    if (plain && !text.empty()) return text;
    std::string all = "'";
    for (const char c : text)
        all += c == '\'' ? std::string("'\\''") : std::string(1, c);
    return all + "'";
}

std::string bytesText(std::uint64_t bytes) {
    static constexpr std::array kUnits = {"bytes", "kB", "MB", "GB", "TB"};
    auto value = static_cast<double>(bytes);
    std::size_t unit = 0;
    for (; value >= 1000.0 && unit + 1 < kUnits.size(); ++unit)
        value /= 1000.0;
    return format(unit == 0 ? "%.0f" : "%.3g", value) + " " + kUnits[unit];
}

std::string counted(std::uint64_t count, const char* one, const char* many) {
    return countText(count) + " " + (count == 1 ? one : many);
}

std::string countText(std::uint64_t count) {
    std::string digits = std::to_string(count);
    for (std::size_t at = digits.size(); at > 3; at -= 3)
        digits.insert(at - 3, " ");
    return digits;
}

std::string secondsText(double seconds) {
    return format(seconds < 10.0 ? "%.2f" : "%.1f", seconds) + " s";
}

std::string numberText(double value) {
    return format("%.9g", value);
}

std::string shortText(float value) {
    return format("%.6g", double(value));
}

std::string tripleText(const glm::dvec3& value) {
    return numberText(value.x) + ", " + numberText(value.y) + ", " + numberText(value.z);
}

nlohmann::ordered_json lightJson(const AreaLight& light) {
    nlohmann::ordered_json j;
    j["shape"] = name(light.shape);
    const auto triple = [](const glm::dvec3& v) {
        return nlohmann::ordered_json::array({v.x, v.y, v.z});
    };
    const LightShape shape = light.shape;
    if (shape != LightShape::sun) j["position"] = triple(light.position);
    j["direction"] = triple(light.direction);
    if (shape == LightShape::disk || shape == LightShape::sphere)
        j["radius"] = light.radius;
    if (shape == LightShape::rect) {
        j["up"] = triple(light.up);
        j["size"] = {light.size.x, light.size.y};
    }
    if (shape == LightShape::sun)
        j["angularDiameterDegrees"] = glm::degrees(light.angularDiameter);
    return j;
}

std::string lightText(const AreaLight& light) {
    std::string text = name(light.shape);
    const LightShape shape = light.shape;
    if (shape == LightShape::disk || shape == LightShape::sphere)
        text += ", radius " + numberText(light.radius);
    if (shape == LightShape::rect)
        text += ", " + numberText(light.size.x) + " x " + numberText(light.size.y);
    if (shape == LightShape::sun)
        text += ", angular diameter " + numberText(glm::degrees(light.angularDiameter)) +
                " degrees";
    if (shape != LightShape::sun) text += ", at (" + tripleText(light.position) + ")";
    if (shape == LightShape::point || shape == LightShape::sphere) return text;
    return text + ", direction (" + tripleText(light.direction) + ")";
}

}  // namespace mtsm::tools
