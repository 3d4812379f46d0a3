// Talk on stderr, and the signals that end a job early.
#include "common/talk.h"

#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <utility>

namespace mtsm::tools {
namespace {

using namespace std::chrono_literals;

constexpr auto kBarInterval = 100ms;
constexpr auto kLineInterval = 2s;
constexpr int kBarWidth = 40;

// The only state that a signal handler may touch.
volatile std::sig_atomic_t writing = 0;
volatile std::sig_atomic_t stopSignal = 0;  // that came while a file was written

extern "C" void onStopSignal(int signal) {
    if (writing)
        stopSignal = signal;
    else
        std::raise(signal);  // what it does by default again: SA_RESETHAND
}

std::string percent(double fraction) {
    if (!(fraction >= 0.0)) return "...";
    return std::to_string(static_cast<int>(100.0 * std::min(fraction, 1.0))) + " %";
}

}  // namespace

void catchSignals() {
    struct sigaction action {
    }, before{};
    action.sa_handler = onStopSignal;
    action.sa_flags = SA_RESETHAND | SA_RESTART;
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
        ::sigaction(signal, nullptr, &before);
        if (before.sa_handler != SIG_IGN) ::sigaction(signal, &action, nullptr);
    }
    std::signal(SIGXFSZ, SIG_IGN);
}

Writing::Writing(const std::string& path) : exceptions_(std::uncaught_exceptions()) {
    std::error_code problem;
    const auto kind = std::filesystem::status(path, problem).type();
    writing = kind == std::filesystem::file_type::regular ||
              kind == std::filesystem::file_type::not_found;
}

Writing::~Writing() {
    writing = 0;
    if (stopSignal != 0 && std::uncaught_exceptions() == exceptions_)
        std::raise(stopSignal);
}

Talk::Talk(std::string tool)
    : tool_(std::move(tool)), terminal_(::isatty(STDERR_FILENO) == 1) {}

Talk::~Talk() {
    clearBar();
}

void Talk::clearBar() {
    if (barShown_) std::fputs("\r\033[K", stderr);
    barShown_ = false;
}

void Talk::progressDone() {
    const std::lock_guard lock(mutex_);
    clearBar();
}

void Talk::line(const std::string& text) {
    const std::lock_guard lock(mutex_);
    clearBar();
    std::fprintf(stderr, "%s: %s\n", tool_.c_str(), text.c_str());
}

void Talk::say(const std::string& text) {
    if (!quiet_) line(text);
}

void Talk::answer(const std::string& text) {
    line(text);
}

void Talk::warn(const std::string& text) {
    line("warning: " + text);
}

void Talk::error(const std::string& text) {
    line("error: " + text);
}

bool Talk::progress(const std::string& stage, double fraction) {
    if (stopSignal != 0) return false;
    if (quiet_) return true;
    const std::lock_guard lock(mutex_);
    const auto now = Clock::now();
    if (terminal_) {
        if (now - shown_ < kBarInterval && stage == stage_) return true;
        const int filled = static_cast<int>(kBarWidth * std::clamp(fraction, 0.0, 1.0));
        std::fprintf(stderr, "\r\033[K%s [%s%s] %s", stage.c_str(),
                     std::string(std::size_t(filled), '#').c_str(),
                     std::string(std::size_t(kBarWidth - filled), ' ').c_str(),
                     percent(fraction).c_str());
        barShown_ = true;
    } else {
        if (now - shown_ < kLineInterval) return true;
        std::fprintf(stderr, "%s: %s: %s\n", tool_.c_str(), stage.c_str(),
                     percent(fraction).c_str());
    }
    stage_ = stage;
    shown_ = now;
    return true;
}

}  // namespace mtsm::tools
