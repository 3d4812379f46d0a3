// AtomicOutput: all or nothing, whatever goes wrong; and so for every writer built on it.
#include <sys/resource.h>
#include <sys/stat.h>

#include <catch2/catch.hpp>
#include <csignal>
#include <filesystem>

#include "io/atomic_output.h"
#include "io/temp_folder.h"
#include "mtsm/image.h"
#include "mtsm/plot.h"
#include "mtsm/points.h"

using namespace mtsm;
using mtsm::test::contents;
using mtsm::test::TempFolder;

namespace {

/// No file may grow beyond `bytes` while this lives: what a full disk looks like.
class FullDisk {
  public:
    explicit FullDisk(rlim_t bytes) {
        handler_ = std::signal(SIGXFSZ, SIG_IGN);
        ::getrlimit(RLIMIT_FSIZE, &old_);
        const rlimit limit{bytes, old_.rlim_max};
        ::setrlimit(RLIMIT_FSIZE, &limit);
    }
    ~FullDisk() {
        ::setrlimit(RLIMIT_FSIZE, &old_);
        std::signal(SIGXFSZ, handler_);
    }
    FullDisk(const FullDisk&) = delete;
    FullDisk& operator=(const FullDisk&) = delete;

  private:
    rlimit old_{};
    void (*handler_)(int) = nullptr;
};

FloatImage noiseImage(std::uint32_t side) {
    FloatImage image(side, side);
    std::vector<float> values(std::size_t(side) * side);
    std::uint32_t state = 1;
    for (float& v : values)
        v = float(state = state * 1664525u + 1013904223u);
    image.channels.push_back({"noise", std::move(values)});
    return image;
}

ByteImage noiseBytes(std::uint32_t side) {
    ByteImage image{side, side, 1, {}};
    std::uint32_t state = 1;
    for (std::uint32_t i = 0; i < side * side; ++i)
        image.values.push_back(
            std::uint8_t((state = state * 1664525u + 1013904223u) >> 24));
    return image;
}

}  // namespace

TEST_CASE("a file is there after commit, with nothing beside it", "[io][atomic]") {
    TempFolder folder;
    const std::string path = folder / "a.txt";
    REQUIRE(io::writeFileAtomically(path, "hello", 5));
    CHECK(contents(path) == "hello");
    REQUIRE(io::writeFileAtomically(path, "bye", 3));
    CHECK(contents(path) == "bye");
    CHECK(folder.files() == 1);
}

TEST_CASE("until commit the old file stands, and without it for ever", "[io][atomic]") {
    TempFolder folder;
    const std::string path = folder / "a.txt";
    test::write(path, "old");
    {
        auto out = io::AtomicOutput::create(path);
        REQUIRE(out);
        CHECK(out->write("new content", 11));
        CHECK(contents(path) == "old");
        CHECK(folder.files() == 2);
    }
    CHECK(contents(path) == "old");
    CHECK(folder.files() == 1);
}

TEST_CASE("two writers of one file do not meet", "[io][atomic]") {
    TempFolder folder;
    const std::string path = folder / "a.txt";
    auto a = io::AtomicOutput::create(path), b = io::AtomicOutput::create(path);
    REQUIRE(a);
    REQUIRE(b);
    a->write("first", 5);
    b->write("second", 6);
    CHECK(a->commit());
    CHECK(contents(path) == "first");
    CHECK(b->commit());
    CHECK(contents(path) == "second");
    CHECK(folder.files() == 1);
}

TEST_CASE("seek goes back and overwrites", "[io][atomic]") {
    TempFolder folder;
    const std::string path = folder / "a.txt";
    auto out = io::AtomicOutput::create(path);
    REQUIRE(out);
    out->write("0000data", 8);
    CHECK(out->tell() == 8);
    CHECK(out->seek(0));
    out->write("12", 2);
    REQUIRE(out->commit());
    CHECK(contents(path) == "1200data");
}

TEST_CASE("a new file has the permissions that the umask leaves, a replaced one its own",
          "[io][atomic]") {
    TempFolder folder;
    const std::string path = folder / "a.txt";
    const mode_t old = ::umask(027);
    const Status done = io::writeFileAtomically(path, "x", 1);
    ::umask(old);
    REQUIRE(done);
    struct stat info {};
    REQUIRE(::stat(path.c_str(), &info) == 0);
    CHECK((info.st_mode & 0777) == 0640);
    REQUIRE(::chmod(path.c_str(), 0604) == 0);
    REQUIRE(io::writeFileAtomically(path, "y", 1));
    REQUIRE(::stat(path.c_str(), &info) == 0);
    CHECK((info.st_mode & 0777) == 0604);
}

TEST_CASE("a link stays a link and its file is replaced", "[io][atomic]") {
    TempFolder folder;
    const std::string file = folder / "file", link = folder / "link";
    test::write(file, "old");
    std::filesystem::create_symlink("file", link);
    REQUIRE(io::writeFileAtomically(link, "new", 3));
    CHECK(std::filesystem::is_symlink(link));
    CHECK(contents(file) == "new");
    CHECK(folder.files() == 2);
}

TEST_CASE("what is no regular file is never replaced", "[io][atomic][bad-input]") {
    TempFolder folder;
    auto device = io::writeFileAtomically("/dev/null", "x", 1);
    REQUIRE_FALSE(device);
    CHECK(device.error().code == ErrorCode::io);
    CHECK(device.error().message.find("/dev/null") == 0);
    auto dir = io::writeFileAtomically(folder / ".", "x", 1);
    REQUIRE_FALSE(dir);
    CHECK(dir.error().message.find("folder") != std::string::npos);
    auto missing = io::writeFileAtomically(folder / "no/such/folder/a", "x", 1);
    REQUIRE_FALSE(missing);
    CHECK(missing.error().code == ErrorCode::io);
    CHECK(missing.error().message.find("No such file or directory") != std::string::npos);
    CHECK(folder.files() == 0);
}

TEST_CASE("a full disk is reported by every writer and leaves what was there",
          "[io][atomic][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "out";
    test::write(path, "precious");
    const FloatImage image = noiseImage(64);
    const ByteImage bytes = noiseBytes(128);
    const std::string text(100000, 'x');
    const auto check = [&](const auto& writeIt) {
        const Status done = [&] {
            FullDisk full(4096);
            return writeIt();
        }();
        REQUIRE_FALSE(done);
        CHECK(done.error().code == ErrorCode::io);
        CHECK(done.error().message.find(path) == 0);
        CHECK(done.error().message.find("File too large") != std::string::npos);
        CHECK(contents(path) == "precious");
        CHECK(folder.files() == 1);
    };
    check([&] { return writeImageExr(path, image); });
    check([&] { return writeImagePng(path, bytes); });
    check([&] { return writeTextFile(path, text); });
    check([&] {
        const float* values = image.channels[0].values.data();
        return writeCsv(path, {{"noise", values}}, image.channels[0].values.size());
    });
}
