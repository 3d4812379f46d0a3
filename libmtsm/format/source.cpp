#include "format/source.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "base/message.h"
#include "base/system_error.h"

namespace mtsm::format {
namespace {

using base::makeError;

class FileSource final : public Source {
  public:
    FileSource(std::string path, int fd, std::uint64_t size)
        : Source(std::move(path)), fd_(fd), size_(size) {}
    ~FileSource() override { ::close(fd_); }
    FileSource(const FileSource&) = delete;
    FileSource& operator=(const FileSource&) = delete;

    std::uint64_t size() const noexcept override { return size_; }

    Status read(std::uint64_t offset, std::span<std::uint8_t> out) const override {
        while (!out.empty()) {
            const ssize_t got =
                ::pread(fd_, out.data(), out.size(), static_cast<off_t>(offset));
            if (got < 0 && errno == EINTR) continue;
            if (got < 0)
                return makeError(ErrorCode::io, name(), ": cannot read ", out.size(),
                                 " bytes at offset ", offset, ": ",
                                 base::systemReason(errno));
            if (got == 0)
                return makeError(ErrorCode::io, name(), ": ends at offset ", offset,
                                 " although it had ", size_,
                                 " bytes: it was cut while it was read");
            out = out.subspan(static_cast<std::size_t>(got));
            offset += static_cast<std::uint64_t>(got);
        }
        return {};
    }

  private:
    int fd_;
    std::uint64_t size_;
};

class MemorySource final : public Source {
  public:
    MemorySource(std::span<const std::uint8_t> bytes, std::string name)
        : Source(std::move(name)), bytes_(bytes) {}

    std::uint64_t size() const noexcept override { return bytes_.size(); }

    Status read(std::uint64_t offset, std::span<std::uint8_t> out) const override {
        if (offset > bytes_.size() || out.size() > bytes_.size() - offset)
            return makeError(ErrorCode::io, name(), ": no ", out.size(),
                             " bytes at offset ", offset);
        if (!out.empty()) std::memcpy(out.data(), bytes_.data() + offset, out.size());
        return {};
    }

  private:
    std::span<const std::uint8_t> bytes_;
};

const char* kindOf(mode_t mode) {
    if (S_ISDIR(mode)) return "a folder";
    if (S_ISFIFO(mode)) return "a pipe";
    if (S_ISSOCK(mode)) return "a socket";
    return "a device";
}

}  // namespace

Result<std::unique_ptr<Source>> openFile(const std::string& path) {
    // Opening a pipe that nobody writes to would wait for ever: O_NONBLOCK does not.
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0)
        return makeError(ErrorCode::io, path,
                         ": cannot open: ", base::systemReason(errno));
    struct stat info = {};
    if (::fstat(fd, &info) != 0) {
        const int reason = errno;
        ::close(fd);
        return makeError(ErrorCode::io, path,
                         ": cannot find its size: ", base::systemReason(reason));
    }
    if (!S_ISREG(info.st_mode)) {
        ::close(fd);
        return makeError(ErrorCode::io, path, ": is ", kindOf(info.st_mode),
                         ", a map is read from a regular file");
    }
    return std::unique_ptr<Source>(
        std::make_unique<FileSource>(path, fd, static_cast<std::uint64_t>(info.st_size)));
}

std::unique_ptr<Source> openMemory(std::span<const std::uint8_t> bytes,
                                   std::string name) {
    return std::make_unique<MemorySource>(bytes, std::move(name));
}

}  // namespace mtsm::format
