// reader_py.h - runs the second reader, format-spec/reader.py.
#pragma once
#include <sys/wait.h>

#include <catch2/catch.hpp>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

#include "format/temp_folder.h"

namespace mtsm::test {

inline const std::string kSource = MTSM_SOURCE_DIR;

inline std::string textOf(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    REQUIRE(in);
    return {std::istreambuf_iterator<char>(in), {}};
}

struct Run {
    int exitCode = -1;
    std::string out, err;
};

/// Runs the second reader on a file.
inline Run readerPy(const std::string& file, const std::string& options = "") {
    const TempFolder folder;
    const auto quoted = [](const std::string& s) { return "'" + s + "'"; };
    const std::string command = quoted(MTSM_PYTHON) + " -B " +
                                quoted(kSource + "/format-spec/reader.py") + " " +
                                options + " " + quoted(file) + " >" +
                                quoted(folder / "out") + " 2>" + quoted(folder / "err");
    const int status = std::system(command.c_str());
    Run run;
    run.exitCode = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    run.out = textOf(folder / "out");
    run.err = textOf(folder / "err");
    return run;
}

}  // namespace mtsm::test
