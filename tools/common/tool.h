// tool.h - what every tool's main has around its own few lines.
#pragma once
#include <CLI/CLI.hpp>
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "common/talk.h"
#include "mtsm/light.h"
#include "mtsm/result.h"

namespace mtsm::tools {

/// An Error on its way out of a tool; its code decides the exit code.
struct Failure {
    Error error;
};

/// The value, or the Error thrown as a Failure.
template <typename T>
T unwrap(Result<T> result) {
    if (!result) throw Failure{result.error()};
    return *std::move(result);
}
inline void unwrap(const Status& status) {
    if (!status) throw Failure{status.error()};
}

/// Adds --version and --help, and the text of exit codes below `examples`.
void describeTool(CLI::App& app, const std::string& examples);

/// Parses the command line, runs `body` and reports what goes wrong. Returns the exit
/// code: 0, or 2 usage, 3 input or output, 4 bad file, 5 unsupported.
int runTool(CLI::App& app, int argc, char** argv, Talk& talk,
            const std::function<void()>& body);

/// Runs `body` with so many threads; 0: as many as the machine has.
void withThreads(std::int64_t threads, const std::function<void()>& body);

/// Fails now where writing `path` would fail hours later: it is a folder, one of
/// `inputs`, or its folder is not there or not writable. A pipe or a device is fine.
void checkOutput(const std::string& path, const std::vector<std::string>& inputs);

/// What --json prints: ASCII alone, so that nothing of a file can steer a terminal.
[[nodiscard]] std::string jsonText(const nlohmann::ordered_json& j);

/// Writes to stdout; a failure (full disk, closed pipe) is thrown.
void print(const std::string& text);

/// Half of the machine's memory: what a bake may take unless told otherwise.
[[nodiscard]] std::uint64_t halfOfMemory();
/// The most memory that this process has held at any time.
[[nodiscard]] std::uint64_t peakMemory();

/// The file name's extension in lower case, with its dot: ".exr".
[[nodiscard]] std::string extension(const std::string& path);

/// `text` so that a shell takes it for one word: for every command that is printed.
[[nodiscard]] std::string quotedForShell(const std::string& text);

// Numbers as people read them.
[[nodiscard]] std::string bytesText(std::uint64_t bytes);  ///< "4.21 MB"
[[nodiscard]] std::string countText(std::uint64_t count);  ///< "1 234 567"
/// "1 mesh", "2 meshes"
[[nodiscard]] std::string counted(std::uint64_t count, const char* one, const char* many);
[[nodiscard]] std::string secondsText(double seconds);  ///< "0.41 s"
[[nodiscard]] std::string numberText(double value);     ///< shortest, up to 9 digits
[[nodiscard]] std::string shortText(float value);       ///< shortest, up to 6 digits
[[nodiscard]] std::string tripleText(const glm::dvec3& value);  ///< "1, 2, 3"

/// A light as --json prints it: only what its shape uses, angles in degrees.
[[nodiscard]] nlohmann::ordered_json lightJson(const AreaLight& light);
/// The same for people, on one line.
[[nodiscard]] std::string lightText(const AreaLight& light);

}  // namespace mtsm::tools
