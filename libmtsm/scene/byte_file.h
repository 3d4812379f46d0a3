// byte_file.h - a regular file, read at offsets.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "mtsm/result.h"

namespace mtsm::scene {

class ByteFile {
  public:
    /// Errors: io; badFile if it is empty.
    static Result<std::unique_ptr<ByteFile>> open(const std::string& path);
    ~ByteFile();
    ByteFile(const ByteFile&) = delete;
    ByteFile& operator=(const ByteFile&) = delete;

    [[nodiscard]] const std::string& path() const noexcept { return path_; }
    [[nodiscard]] std::uint64_t size() const noexcept { return stamp_.size; }
    /// Fills `out` with the bytes from `offset` on. Anything less is an Error (io).
    Status read(std::uint64_t offset, void* out, std::size_t bytes) const;
    /// Fills [out, out + count) with the values from `offset` on.
    template <typename T>
    Status readArray(std::uint64_t offset, std::vector<T>& out, std::size_t count) const {
        out.resize(count);
        return read(offset, out.data(), count * sizeof(T));
    }

    /// Differs when the file was written to in between.
    struct Stamp {
        std::uint64_t size = 0;
        std::int64_t seconds = 0, nanoseconds = 0;
        friend bool operator==(const Stamp&, const Stamp&) = default;
    };
    [[nodiscard]] const Stamp& stamp() const noexcept { return stamp_; }

  private:
    ByteFile(std::string path, int fd, Stamp stamp)
        : path_(std::move(path)), fd_(fd), stamp_(stamp) {}

    std::string path_;
    int fd_;
    Stamp stamp_;
};

}  // namespace mtsm::scene
