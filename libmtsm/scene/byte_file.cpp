#include "scene/byte_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

#include "base/message.h"
#include "base/system_error.h"
#include "scene/import_file.h"

namespace mtsm::scene {

using base::makeError;

Result<std::unique_ptr<ByteFile>> ByteFile::open(const std::string& path) {
    if (Status s = checkReadable(path); !s) return s.error();
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    struct stat info {};
    if (fd < 0 || ::fstat(fd, &info) != 0) {
        const int reason = errno;
        if (fd >= 0) ::close(fd);
        return makeError(ErrorCode::io, path,
                         ": cannot be read: ", base::systemReason(reason));
    }
    const Stamp stamp{std::uint64_t(info.st_size), info.st_mtim.tv_sec,
                      info.st_mtim.tv_nsec};
    return std::unique_ptr<ByteFile>(new ByteFile(path, fd, stamp));
}

ByteFile::~ByteFile() {
    ::close(fd_);
}

Status ByteFile::read(std::uint64_t offset, void* out, std::size_t bytes) const {
    auto* to = static_cast<char*>(out);
    while (bytes > 0) {
        const ssize_t got = ::pread(fd_, to, bytes, off_t(offset));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0)
            return makeError(ErrorCode::io, path_, ": cannot read ", bytes,
                             " bytes at offset ", offset, ": ",
                             base::systemReason(errno));
        if (got == 0)
            return makeError(ErrorCode::io, path_, ": ends at offset ", offset,
                             " although it had ", size(),
                             " bytes: it was cut while it was read");
        to += got;
        bytes -= std::size_t(got);
        offset += std::uint64_t(got);
    }
    return {};
}

}  // namespace mtsm::scene
