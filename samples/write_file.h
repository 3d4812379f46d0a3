// write_file.h - a file, whole or not at all.
#pragma once
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <system_error>

/// Empty, or what is wrong with the name of a file that is to be written and does not end
/// as what it will hold. A pipe or a device may have any name.
inline std::string checkEnding(const std::string& path,
                               std::initializer_list<const char*> endings) {
    namespace fs = std::filesystem;
    std::error_code problem;
    if (fs::exists(path, problem) && !fs::is_regular_file(path, problem)) return {};
    std::string expected;
    for (const char* ending : endings) {
        if (fs::path(path).extension() == ending) return {};
        expected += (expected.empty() ? "" : " or ") + std::string(ending);
    }
    return "found \"" + path + "\", expected a name that ends in " + expected;
}

/// Empty, or the reason why `path` could not be written; then what was there before still
/// is. The bytes go to a file beside it that takes its name at the end; a pipe or a
/// device is written to as it is.
inline std::string writeFile(const std::string& path, std::string_view bytes) {
    namespace fs = std::filesystem;
    std::error_code problem;
    const bool whole = !fs::exists(path, problem) || fs::is_regular_file(path, problem);
    // What a link points to is replaced, not the link.
    const fs::path target =
        fs::exists(path, problem) ? fs::canonical(path, problem) : fs::path(path);
    const std::string part =
        whole ? target.string() + ".part" + std::to_string(::getpid()) : path;
    std::FILE* file = std::fopen(part.c_str(), "wb");
    if (!file) return std::strerror(errno);
    errno = 0;
    const bool written = std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size();
    int reason = errno;
    const bool closed = std::fclose(file) == 0;
    if (written && !closed) reason = errno;
    const bool good = written && closed;
    if (!whole) return good ? std::string() : std::strerror(reason);
    problem.clear();
    if (good) fs::rename(part, target, problem);
    if (good && !problem) return {};
    std::error_code ignored;
    fs::remove(part, ignored);
    return good ? problem.message() : std::strerror(reason);
}
