// Every writer of this module: all or nothing, a full disk included.
#include <sys/resource.h>

#include <catch2/catch.hpp>
#include <csignal>

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
