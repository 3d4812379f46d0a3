// atomic_output.h - a file that appears under its name complete or not at all.
//
//     auto out = AtomicOutput::create("picture.png");
//     if (!out) return out.error();
//     out->write(bytes, size);           // errors are kept ...
//     return out->commit();              // ... and come out here
//
// Bytes go to a temporary file in the same folder; commit() syncs it to the disk and
// renames it over the target. Without a successful commit() the temporary is removed and
// what stood at the target stays. One thread at a time.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>

#include "mtsm/result.h"

namespace mtsm::io {

class AtomicOutput {
  public:
    /// Opens the temporary. A target that is there and is no regular file (a folder, a
    /// device) is refused; a symbolic link stays and the file it points to is replaced.
    /// The new file keeps the permissions of the one it replaces.
    static Result<AtomicOutput> create(const std::string& path);

    AtomicOutput(AtomicOutput&& other) noexcept;
    AtomicOutput& operator=(AtomicOutput&&) = delete;
    ~AtomicOutput();

    /// Appends; false once anything failed. The first failure is what commit() returns.
    bool write(const void* bytes, std::size_t size) noexcept;
    /// Where the next write goes, in bytes from the beginning.
    [[nodiscard]] std::uint64_t tell() const noexcept { return position_; }
    bool seek(std::uint64_t position) noexcept;
    [[nodiscard]] bool failed() const noexcept { return errno_ != 0; }

    Status commit();

  private:
    AtomicOutput() = default;
    void keepError() noexcept;
    [[nodiscard]] Error systemError() const;

    std::string path_;       // as the caller spelled it, for messages
    std::string target_;     // with links resolved
    std::string temporary_;  // empty: nothing to remove
    std::FILE* file_ = nullptr;
    std::uint64_t position_ = 0;
    int errno_ = 0;  // of the first failure
};

/// All of `size` bytes as the file `path`.
Status writeFileAtomically(const std::string& path, const void* bytes, std::size_t size);

}  // namespace mtsm::io
