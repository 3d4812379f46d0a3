// sink.h - where a writer's bytes go: memory, or a file that appears whole or not at all.
#pragma once
#include <sys/types.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "mtsm/result.h"

namespace mtsm::format {

/// Takes bytes in order; there is no going back, so a pipe will do.
class Sink {
  public:
    virtual ~Sink() = default;
    virtual Status write(std::span<const std::uint8_t> bytes) = 0;
};

class MemorySink final : public Sink {
  public:
    Status write(std::span<const std::uint8_t> bytes) override {
        bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
        return {};
    }
    [[nodiscard]] std::vector<std::uint8_t> take() && { return std::move(bytes_); }

  private:
    std::vector<std::uint8_t> bytes_;
};

/// A file that is replaced at once. Bytes go to a temporary in the same folder, which
/// commit() syncs to the disk and renames over the target; without commit() the
/// destructor removes it. Where the path is a symbolic link, the file it points to is
/// replaced and the link stays. The new file has the permissions of the one it replaces,
/// or those that any new file would get.
///
/// What exists and is no regular file (a pipe, a device such as /dev/stdout) cannot be
/// replaced: it is written to as it is. All errors are io and name the path.
class FileSink final : public Sink {
  public:
    explicit FileSink(std::string path) : path_(std::move(path)) {}
    ~FileSink() override;
    FileSink(const FileSink&) = delete;
    FileSink& operator=(const FileSink&) = delete;

    Status open();
    Status write(std::span<const std::uint8_t> bytes) override;
    Status commit();

  private:
    Status openTemporary(bool exists, mode_t mode);
    Status setMode(mode_t mode) const;
    Status syncFolder() const;
    [[nodiscard]] Error failed(const char* what, int reason) const;

    std::string path_;       // as the caller gave it: for messages
    std::string target_;     // what is replaced, links resolved
    std::string folder_;     // that it lies in
    std::string temporary_;  // empty: written straight to, or committed
    int fd_ = -1;
};

}  // namespace mtsm::format
