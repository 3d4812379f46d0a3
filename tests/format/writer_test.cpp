// A file appears whole or not at all.
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>

#include "format/refused.h"
#include "format/temp_folder.h"
#include "map_fixture.h"
#include "mtsm/writer.h"

using namespace mtsm;
using namespace mtsm::test;
namespace fs = std::filesystem;

namespace {

ShadowMap mapOf(std::uint32_t side, std::uint64_t seed = 1) {
    NoisySpec spec;
    spec.width = spec.height = side;
    spec.seed = seed;
    return noisyMap(spec);
}

Bytes contentOf(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return Bytes(std::istreambuf_iterator<char>(in), {});
}

mode_t modeOf(const std::string& path) {
    struct stat info = {};
    REQUIRE(::stat(path.c_str(), &info) == 0);
    return info.st_mode & 07777;
}

void writeText(const std::string& path, const std::string& text) {
    std::ofstream(path, std::ios::binary) << text;
}

void checkIoError(const Status& status, const std::string& path,
                  const std::string& words) {
    REQUIRE_FALSE(status);
    CHECK(status.error().code == ErrorCode::io);
    CHECK_THAT(status.error().message, Catch::StartsWith(path + ": "));
    CHECK_THAT(status.error().message, Catch::Contains(words));
}

}  // namespace

TEST_CASE("a written file holds the bytes that encodeMap gives and reads back",
          "[format][roundtrip]") {
    const TempFolder folder;
    const ShadowMap map = mapOf(70);
    const std::string path = folder / "a.mtsm";
    REQUIRE(writeMap(map, path));
    CHECK(contentOf(path) == *encodeMap(map));
    const auto back = readMap(path);
    REQUIRE(back);
    CHECK(identical(map, *back));
    CHECK(folder.files() == 1);
}

TEST_CASE("what no reader would take unasked is not written", "[format][bad-input]") {
    const TempFolder folder;
    const std::uint64_t most = ReadLimits().maxAttributeBytes;
    const auto withText = [&](std::uint64_t bytes) {
        const ShadowMap map = mapOf(8);
        MapInfo info = map.info();
        info.software.clear();
        info.settings.clear();
        info.attributes = {{"a", std::string(bytes, 'x')}};
        MapFace face;
        face.projection = map.projection(0);
        face.tiles = {map.tile(0, 0, 0)};
        return *ShadowMap::create(std::move(info), {std::move(face)});
    };
    const std::uint64_t around = 8 + 16 + 1;  // the count, the record, the name
    const ShadowMap fits = withText(most - around), exceeds = withText(most - around + 1);
    REQUIRE(writeMap(fits, folder / "a.mtsm"));
    CHECK(readMap(folder / "a.mtsm"));
    const Status done = writeMap(exceeds, folder / "b.mtsm");
    REQUIRE_FALSE(done);
    CHECK(done.error().code == ErrorCode::badArgument);
    CHECK_THAT(done.error().message, Catch::Contains("67108865 bytes, more than"));
    CHECK(folder.files() == 1);
}

TEST_CASE("the bytes do not depend on the number of threads", "[format][threads]") {
    NoisySpec spec;
    spec.width = spec.height = 200;
    spec.channels = 3;
    const ShadowMap map = noisyMap(spec);
    const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 8);
    const auto encodeWith = [&](int threads) {
        tbb::task_arena arena(threads);
        return arena.execute([&] { return *encodeMap(map); });
    };
    const Bytes one = encodeWith(1);
    CHECK(encodeWith(2) == one);
    CHECK(encodeWith(8) == one);
    tbb::task_arena(8).execute([&] { CHECK(identical(map, *readBytes(one))); });
}

TEST_CASE("a new file gets the permissions of any new file, a replaced one keeps its own",
          "[format]") {
    const TempFolder folder;
    const std::string path = folder / "a.mtsm";
    const mode_t mask = ::umask(027);
    REQUIRE(writeMap(mapOf(8), path));
    ::umask(mask);
    CHECK(modeOf(path) == 0640);
    REQUIRE(::chmod(path.c_str(), 0604) == 0);
    REQUIRE(writeMap(mapOf(9), path));
    CHECK(modeOf(path) == 0604);
    CHECK(readMap(path)->info().width == 9);
}

TEST_CASE("writing through symbolic links replaces what they point to", "[format]") {
    const TempFolder folder;
    fs::create_directory(folder / "real");
    writeText(folder / "real/a.mtsm", "old");
    fs::create_symlink("real/a.mtsm", folder / "one");
    fs::create_symlink(folder / "one", folder / "two");
    fs::create_symlink("real/new.mtsm", folder / "dangling");
    fs::create_symlink("loop", folder / "loop");
    REQUIRE(writeMap(mapOf(8), folder / "two"));
    CHECK(fs::is_symlink(folder / "two"));
    CHECK(fs::is_symlink(folder / "one"));
    CHECK(readMap(folder / "real/a.mtsm"));
    REQUIRE(writeMap(mapOf(8), folder / "dangling"));
    CHECK(fs::is_symlink(folder / "dangling"));
    CHECK(readMap(folder / "real/new.mtsm"));
    checkIoError(writeMap(mapOf(8), folder / "loop"), folder / "loop", "links");
}

TEST_CASE("a relative path without a folder is written where the process is",
          "[format]") {
    const TempFolder folder;
    const fs::path before = fs::current_path();
    fs::current_path(folder.path());
    const Status done = writeMap(mapOf(8), "a.mtsm");
    fs::current_path(before);
    CHECK(done);
    CHECK(readMap(folder / "a.mtsm"));
}

TEST_CASE("a name of 255 bytes can be written", "[format]") {
    const TempFolder folder;
    const std::string path = folder / (std::string(250, 'n') + ".mtsm");
    CHECK(writeMap(mapOf(8), path));
    CHECK(readMap(path));
}

TEST_CASE("cancelling leaves what was there and no temporary", "[format]") {
    const TempFolder folder;
    const std::string path = folder / "a.mtsm";
    writeText(path, "old");
    WriteOptions options;
    double before = 0;
    int calls = 0;
    options.progress = [&](double done) {
        CHECK(done >= before);
        CHECK(done <= 1.0);
        before = done;
        return ++calls < 3;
    };
    const Status status = writeMap(mapOf(64), path, options);
    REQUIRE_FALSE(status);
    CHECK(status.error().code == ErrorCode::cancelled);
    CHECK_THAT(status.error().message, Catch::StartsWith(path));
    CHECK(calls == 3);
    CHECK(contentOf(path) == Bytes{'o', 'l', 'd'});
    CHECK(folder.files() == 1);

    options.progress = [&](double done) {
        before = done;
        return true;
    };
    REQUIRE(writeMap(mapOf(64), path, options));
    CHECK(before == 1.0);

    options.progress = [](double) -> bool {
        throw std::runtime_error("from the caller");
    };
    checkIoError(writeMap(mapOf(64), path, options), path, "from the caller");
    CHECK(folder.files() == 1);
    CHECK(readMap(path));
}

TEST_CASE("a folder that is missing, is the target, or is no folder is an error",
          "[format][bad-input]") {
    const TempFolder folder;
    writeText(folder / "file", "x");
    const auto check = [](const std::string& path, const std::string& words) {
        checkIoError(writeMap(mapOf(8), path), path, words);
    };
    check(folder / "missing/a.mtsm", "No such file or directory");
    check(folder.path(), "is a folder");
    check(folder / "file/a.mtsm", "Not a directory");
    check(folder / "new/", "names a folder");
    check(folder / std::string(256, 'n'), "File name too long");
    CHECK(folder.files() == 1);
}

TEST_CASE("a folder that may not be written to is an error", "[format][bad-input]") {
    const TempFolder folder;
    const std::string path = folder / "a.mtsm";
    writeText(path, "old");
    REQUIRE(::chmod(folder.path().c_str(), 0555) == 0);
    // Permissions do not hold root back: a child gives that up.
    const pid_t child = ::fork();
    if (child == 0) {
        if (::geteuid() == 0 && ::setuid(65534) != 0) ::_exit(2);
        const Status status = writeMap(mapOf(8), path);
        const bool right = !status && status.error().code == ErrorCode::io &&
                           status.error().message.find("ermission") != std::string::npos;
        ::_exit(right ? 0 : 1);
    }
    int result = -1;
    REQUIRE(::waitpid(child, &result, 0) == child);
    CHECK(WIFEXITED(result));
    CHECK(WEXITSTATUS(result) == 0);
    REQUIRE(::chmod(folder.path().c_str(), 0755) == 0);
    CHECK(contentOf(path) == Bytes{'o', 'l', 'd'});
    CHECK(folder.files() == 1);
}

TEST_CASE("a full disk is an error, at whatever byte it is full", "[format][bad-input]") {
    const TempFolder folder;
    const std::string path = folder / "a.mtsm";
    writeText(path, "old");
    const ShadowMap map = mapOf(24);
    const auto size = encodeMap(map)->size();
    for (const std::size_t limit : {std::size_t(0), std::size_t(1), std::size_t(64),
                                    std::size_t(70), size / 2, size - 32, size - 1}) {
        INFO("room for " << limit << " of " << size << " bytes");
        const pid_t child = ::fork();
        if (child == 0) {
            std::signal(SIGXFSZ, SIG_IGN);  // so that write() says EFBIG
            const rlimit room = {limit, limit};
            ::setrlimit(RLIMIT_FSIZE, &room);
            tbb::task_arena arena(1);  // a forked child has no other threads
            const Status status = arena.execute([&] { return writeMap(map, path); });
            const bool right =
                !status && status.error().code == ErrorCode::io &&
                status.error().message == path + ": cannot write: File too large";
            ::_exit(right ? 0 : 1);
        }
        int result = -1;
        REQUIRE(::waitpid(child, &result, 0) == child);
        CHECK(WIFEXITED(result));
        CHECK(WEXITSTATUS(result) == 0);
        CHECK(contentOf(path) == Bytes{'o', 'l', 'd'});
        CHECK(folder.files() == 1);
    }
}

TEST_CASE("a device that is full is an error", "[format][bad-input]") {
    if (fs::exists("/dev/full"))
        checkIoError(writeMap(mapOf(8), "/dev/full"), "/dev/full", "No space left");
}

TEST_CASE("a pipe is written to as it is", "[format][roundtrip]") {
    const TempFolder folder;
    const std::string pipe = folder / "pipe";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    const ShadowMap map = mapOf(100);
    Bytes received;
    std::thread reader([&] { received = contentOf(pipe); });
    const Status done = writeMap(map, pipe);
    reader.join();
    REQUIRE(done);
    CHECK(received == *encodeMap(map));
    CHECK(fs::is_fifo(pipe));
    CHECK(folder.files() == 1);
}
