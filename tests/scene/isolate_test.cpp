// Isolated: whatever a child does, the parent learns how it ended and keeps nothing of
// it.
#include "scene/isolate.h"

#include <fcntl.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <new>
#include <stdexcept>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;
using namespace mtsm::scene;

namespace {

constexpr std::uint64_t kMiB = 1u << 20;

std::size_t openFiles() {
    std::size_t n = 0;
    for ([[maybe_unused]] const auto& entry :
         std::filesystem::directory_iterator("/proc/self/fd"))
        ++n;
    return n;
}

bool hasNoChild() {
    return waitpid(-1, nullptr, WNOHANG) == -1 && errno == ECHILD;
}

Isolated startOrFail(const std::function<void(ChildPipe&)>& body,
                     std::uint64_t bytes = 512 * kMiB) {
    auto child = Isolated::start(body, bytes);
    if (!child) FAIL(child.error().message);
    return *std::move(child);
}

ChildEnd endOf(const std::function<void(ChildPipe&)>& body,
               std::uint64_t bytes = 512 * kMiB) {
    Isolated child = startOrFail(body, bytes);
    char byte;
    while (child.read(&byte, 1) == 1) {
    }
    return child.wait();
}

/// Gives a signal back what it did before.
class HandlerGuard {
  public:
    HandlerGuard(int signal, void (*handler)(int)) : signal_(signal) {
        struct sigaction action {};
        action.sa_handler = handler;  // no SA_RESTART: calls get interrupted
        sigaction(signal, &action, &before_);
    }
    ~HandlerGuard() { sigaction(signal_, &before_, nullptr); }

  private:
    int signal_;
    struct sigaction before_ {};
};

}  // namespace

TEST_CASE("what a child writes arrives whole and in order", "[scene][exact]") {
    std::vector<std::uint32_t> sent(3'000'000);
    for (std::size_t i = 0; i < sent.size(); ++i)
        sent[i] = std::uint32_t(i * 2654435761u);
    Isolated child =
        startOrFail([&](ChildPipe& out) { out.write(sent.data(), sent.size() * 4); });
    std::vector<std::uint32_t> got(sent.size() + 1);
    CHECK(child.read(got.data(), got.size() * 4) == sent.size() * 4);
    got.pop_back();
    CHECK(got == sent);
    CHECK(child.wait().how == ChildEnd::How::finished);
}

TEST_CASE("a child that crashes is known by its signal", "[scene][bad-input]") {
    for (const int signal : {SIGSEGV, SIGABRT, SIGKILL}) {
        const ChildEnd end = endOf([&](ChildPipe&) { std::raise(signal); });
        CHECK(end.how == ChildEnd::How::signalled);
        CHECK(end.number == signal);
    }
    CHECK(hasNoChild());
}

TEST_CASE("a handler that the host has set does not run in a child", "[scene]") {
    const HandlerGuard guard(SIGSEGV, [](int) { _exit(0); });
    const ChildEnd end = endOf([](ChildPipe&) { std::raise(SIGSEGV); });
    CHECK(end.how == ChildEnd::How::signalled);
    CHECK(end.number == SIGSEGV);
}

TEST_CASE("a child that asks for endless memory is stopped at its limit",
          "[scene][bad-input]") {
    if (test::kSanitized) {
        WARN("no memory limit under a sanitizer: skipped");
        return;
    }
    const ChildEnd end = endOf([](ChildPipe&) { test::takeAllMemory(); }, 256 * kMiB);
    CHECK(end.how == ChildEnd::How::outOfMemory);
}

TEST_CASE("a child may use the memory it was promised, whatever its parent uses",
          "[scene]") {
    std::vector<char> parents(std::size_t(600) << 20, 1);
    const ChildEnd end = endOf(
        [](ChildPipe&) {
            const std::vector<char> mine(std::size_t(100) << 20, 1);
            if (mine[12345] != 1) _exit(1);
        },
        256 * kMiB);
    CHECK(end.how == ChildEnd::How::finished);
    CHECK(parents[1] == 1);
}

TEST_CASE("a child that leaves or throws is known by its exit code",
          "[scene][bad-input]") {
    const ChildEnd left = endOf([](ChildPipe&) { _exit(5); });
    CHECK(left.how == ChildEnd::How::exited);
    CHECK(left.number == 5);
    const ChildEnd threw = endOf([](ChildPipe&) { throw std::runtime_error("oops"); });
    CHECK(threw.how == ChildEnd::How::exited);
    CHECK(threw.number != 0);
}

TEST_CASE("stopping early leaves neither a process nor an open file", "[scene]") {
    const std::size_t before = openFiles();
    for (int i = 0; i < 20; ++i) {
        Isolated child = startOrFail([](ChildPipe& out) {
            const std::vector<char> noise(kMiB, 'x');
            for (;;)
                out.write(noise.data(), noise.size());
        });
        char some[1000];
        REQUIRE(child.read(some, sizeof(some)) == sizeof(some));
    }
    CHECK(openFiles() == before);
    CHECK(hasNoChild());
}

TEST_CASE("waiting for a child that never ends ends it", "[scene]") {
    Isolated child = startOrFail([](ChildPipe& out) {
        out.write("no frame", 8);
        for (;;)
            pause();
    });
    char bytes[8];
    REQUIRE(child.read(bytes, sizeof(bytes)) == sizeof(bytes));
    CHECK(!child.ended());
    const ChildEnd end = child.wait();
    CHECK(end.how == ChildEnd::How::signalled);
    CHECK(end.number == SIGKILL);
    CHECK(hasNoChild());
}

TEST_CASE("a child prints nothing and does not hold other children's pipes open",
          "[scene]") {
    Isolated first = startOrFail([](ChildPipe& out) { out.write("ab", 2); });
    Isolated second = startOrFail([](ChildPipe& out) {
        std::size_t open = 0;
        for (int fd = 3; fd < 1000; ++fd)
            open += fcntl(fd, F_GETFD) != -1;
        out.write(&open, sizeof(open));
        pause();
    });
    std::size_t open = 0;
    REQUIRE(second.read(&open, sizeof(open)) == sizeof(open));
    CHECK(open == 1);
    char bytes[3];
    CHECK(first.read(bytes, 3) == 2);  // ends although `second` lives
}

TEST_CASE("signals that interrupt the parent lose no bytes", "[scene]") {
    const HandlerGuard guard(SIGALRM, [](int) {});
    const itimerval often{{0, 500}, {0, 500}}, never{};
    Isolated child = startOrFail([](ChildPipe& out) {
        for (std::uint32_t i = 0; i < 50; ++i) {
            usleep(1000);
            out.write(&i, sizeof(i));
        }
    });
    setitimer(ITIMER_REAL, &often, nullptr);
    std::vector<std::uint32_t> got(51);
    const std::size_t bytes = child.read(got.data(), 51 * 4);
    const ChildEnd end = child.wait();
    setitimer(ITIMER_REAL, &never, nullptr);
    CHECK(bytes == 50 * 4);
    CHECK(got[49] == 49);
    CHECK(end.how == ChildEnd::How::finished);
}
