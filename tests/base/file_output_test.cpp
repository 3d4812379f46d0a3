// FileOutput: all or nothing. Links, permissions, pipes and full disks are tested through
// writeMap in tests/format/writer_test.cpp.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "base/file_output.h"

using namespace mtsm;
using base::bytesOf;
using base::FileOutput;
namespace fs = std::filesystem;

namespace {

struct Folder {
    fs::path path =
        fs::temp_directory_path() / ("mtsm_file_output_" + std::to_string(::getpid()));
    Folder() { fs::create_directory(path); }
    ~Folder() { fs::remove_all(path); }
    [[nodiscard]] std::size_t files() const {
        return std::size_t(
            std::distance(fs::directory_iterator(path), fs::directory_iterator()));
    }
};

std::string contents(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    std::ostringstream out;
    out << in.rdbuf();
    return out.str();
}

}  // namespace

TEST_CASE("until commit the old file stands, and without it for ever", "[base][atomic]") {
    const Folder folder;
    const std::string path = (folder.path / "a").string();
    REQUIRE(base::writeFile(path, bytesOf("old")));
    {
        FileOutput file(path);
        REQUIRE(file.open());
        REQUIRE(file.write(bytesOf("new content")));
        CHECK(contents(path) == "old");
        CHECK(folder.files() == 2);
    }
    CHECK(contents(path) == "old");
    CHECK(folder.files() == 1);
}

TEST_CASE("two writers of one file do not meet", "[base][atomic]") {
    const Folder folder;
    const std::string path = (folder.path / "a").string();
    FileOutput a(path), b(path);
    REQUIRE(a.open());
    REQUIRE(b.open());
    REQUIRE(a.write(bytesOf("first")));
    REQUIRE(b.write(bytesOf("second")));
    REQUIRE(a.commit());
    CHECK(contents(path) == "first");
    REQUIRE(b.commit());
    CHECK(contents(path) == "second");
    CHECK(folder.files() == 1);
}
