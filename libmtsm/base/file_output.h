// file_output.h - a file that appears under its name complete or not at all.
#pragma once
#include <sys/types.h>

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "mtsm/result.h"

namespace mtsm::base {

/// A file that is replaced at once. Bytes go to a temporary in the same folder, which
/// commit() syncs to the disk and renames over the target; without commit() the
/// destructor removes it. Where the path is a symbolic link, the file it points to is
/// replaced and the link stays. The new file has the permissions of the one it replaces,
/// or those that any new file would get.
///
/// What exists and is no regular file (a pipe, a device such as /dev/stdout) cannot be
/// replaced: it is written to as it is. All errors are io and name the path.
class FileOutput {
  public:
    explicit FileOutput(std::string path) : path_(std::move(path)) {}
    ~FileOutput();
    FileOutput(const FileOutput&) = delete;
    FileOutput& operator=(const FileOutput&) = delete;

    Status open();
    /// Appends.
    Status write(std::span<const std::uint8_t> bytes);
    Status commit();

  private:
    Status openTemporary(bool exists, mode_t mode);
    Status setMode(mode_t mode) const;
    void syncFolder() const;
    [[nodiscard]] Error failed(const char* what, int reason) const;

    std::string path_;       // as the caller gave it: for messages
    std::string target_;     // what is replaced, links resolved
    std::string folder_;     // that it lies in
    std::string temporary_;  // empty: written straight to, or committed
    int fd_ = -1;
};

/// The bytes of a text.
inline std::span<const std::uint8_t> bytesOf(std::string_view text) {
    return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

/// All of `bytes` as the file `path`, under the same rules.
Status writeFile(const std::string& path, std::span<const std::uint8_t> bytes);

}  // namespace mtsm::base
