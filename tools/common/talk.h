// talk.h - what a tool says on stderr: notes, warnings, errors and a progress bar.
#pragma once
#include <chrono>
#include <mutex>
#include <string>

namespace mtsm::tools {

/// All talk of one tool; every line begins with the tool's name. May be called from any
/// thread. On a terminal progress is a bar in place; elsewhere it is a plain line every
/// two seconds, so that short jobs say nothing.
class Talk {
  public:
    explicit Talk(std::string tool);
    ~Talk();
    Talk(const Talk&) = delete;
    Talk& operator=(const Talk&) = delete;

    void setQuiet(bool quiet) { quiet_ = quiet; }  ///< errors and warnings only

    void say(const std::string& text);
    void warn(const std::string& text);
    void error(const std::string& text);

    /// What was asked for by an option of its own: said even when quiet.
    void answer(const std::string& text);

    /// Shows that `fraction` (0..1, negative: unknown) of `stage` is done. False once a
    /// signal asked to stop the writing of a file: what library callbacks must return.
    bool progress(const std::string& stage, double fraction);
    /// Takes the bar away, before something is printed to stdout.
    void progressDone();

  private:
    using Clock = std::chrono::steady_clock;
    void line(const std::string& text);
    void clearBar();

    const std::string tool_;
    const bool terminal_;
    const Clock::time_point start_ = Clock::now();
    bool quiet_ = false;
    std::mutex mutex_;
    std::string stage_;
    Clock::time_point shown_ = start_;
    bool barShown_ = false;
};

/// SIGINT, SIGTERM and SIGHUP end the process at once, as they do without this, but not
/// while it writes a file (see Writing). Those that were ignored stay ignored. Writing
/// beyond a file size limit becomes an error.
void catchSignals();

/// While one lives, the file `path` is being written: the first of these signals only
/// makes Talk::progress return false, so that the library stops and removes its temporary
/// file; a second one of the same kind kills. If the file was finished nevertheless, the
/// process ends by the signal when this goes. A pipe or a device has no temporary file:
/// writing to one ends at once.
class Writing {
  public:
    explicit Writing(const std::string& path);
    ~Writing();
    Writing(const Writing&) = delete;
    Writing& operator=(const Writing&) = delete;

  private:
    const int exceptions_;
};

}  // namespace mtsm::tools
