#include "base/file_output.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>

#include "base/message.h"
#include "base/system_error.h"

namespace mtsm::base {
namespace {

namespace fs = std::filesystem;
constexpr int kMostLinks = 40;          // as Linux follows before it says ELOOP
constexpr int kMostTemporaries = 1000;  // left over from processes that were killed
constexpr const char* kNoTemporary =
    "cannot make a temporary file in its folder; write into another one";

/// Follows symbolic links by hand, since the last one may point to what is not there yet.
fs::path followLinks(fs::path path, std::error_code& error) {
    for (int i = 0; i < kMostLinks; ++i) {
        std::error_code none;
        if (!fs::is_symlink(fs::symlink_status(path, none))) return path;
        const fs::path link = fs::read_symlink(path, error);
        if (error) return path;
        path = path.parent_path() / link;  // an absolute link replaces all of it
    }
    error = std::make_error_code(std::errc::too_many_symbolic_link_levels);
    return path;
}

}  // namespace

Error FileOutput::failed(const char* what, int reason) const {
    return makeError(ErrorCode::io, path_, ": ", what, ": ", systemReason(reason));
}

FileOutput::~FileOutput() {
    if (fd_ >= 0) ::close(fd_);
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

Status FileOutput::open() {
    struct stat info = {};
    const bool exists = ::stat(path_.c_str(), &info) == 0;
    if (!exists && errno != ENOENT) return failed("cannot write here", errno);
    if (exists && S_ISDIR(info.st_mode))
        return makeError(ErrorCode::io, path_, ": is a folder, not a file to write");
    if (exists && !S_ISREG(info.st_mode)) {
        fd_ = ::open(path_.c_str(), O_WRONLY | O_CLOEXEC);
        return fd_ < 0 ? Status(failed("cannot open for writing", errno)) : Status();
    }
    return openTemporary(exists, info.st_mode & 0777);
}

Status FileOutput::openTemporary(bool exists, mode_t mode) {
    std::error_code error;
    const fs::path target = followLinks(path_, error);
    if (error) return failed("cannot follow the link", error.value());
    target_ = target.string();
    folder_ = target.has_parent_path() ? target.parent_path().string() : ".";
    if (!target.has_filename())
        return makeError(ErrorCode::io, path_, ": names a folder, not a file to write");

    // The process id keeps processes apart, the number threads and what was left behind.
    for (int i = 0; i < kMostTemporaries; ++i) {
        std::string name = concat(folder_, "/.mtsm-", ::getpid(), "-", i, ".part");
        fd_ = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (fd_ >= 0) {
            temporary_ = std::move(name);
            break;
        }
        if (errno != EEXIST) return failed(kNoTemporary, errno);
    }
    if (fd_ < 0) return failed(kNoTemporary, EEXIST);
    return exists ? setMode(mode) : Status();
}

/// Only where they differ: some file systems let nobody set them.
Status FileOutput::setMode(mode_t mode) const {
    struct stat info = {};
    if (::fstat(fd_, &info) != 0) return failed("cannot see its permissions", errno);
    if ((info.st_mode & 0777) == mode) return {};
    return ::fchmod(fd_, mode) == 0 ? Status()
                                    : failed("cannot keep its permissions", errno);
}

Status FileOutput::write(std::span<const std::uint8_t> bytes) {
    while (!bytes.empty()) {
        const ssize_t done = ::write(fd_, bytes.data(), bytes.size());
        if (done < 0 && errno == EINTR) continue;
        if (done < 0) return failed("cannot write", errno);
        if (done == 0) return failed("cannot write", ENOSPC);
        bytes = bytes.subspan(static_cast<std::size_t>(done));
    }
    return {};
}

Status FileOutput::commit() {
    const bool replaces = !temporary_.empty();
    if (replaces && ::fsync(fd_) != 0) return failed("cannot sync to the disk", errno);
    // Some file systems say only now that a write did not succeed. Linux closes even
    // when it says EINTR.
    const int closed = ::close(fd_);
    fd_ = -1;
    if (closed != 0 && errno != EINTR) return failed("cannot close", errno);
    if (!replaces) return {};
    if (::rename(temporary_.c_str(), target_.c_str()) != 0)
        return failed("cannot move the finished file over it", errno);
    temporary_.clear();
    syncFolder();
    return {};
}

/// Makes the rename last. The file itself is in its place by now, so nothing that fails
/// here is a failure to write it.
void FileOutput::syncFolder() const {
    const int folder = ::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (folder < 0) return;
    ::fsync(folder);
    ::close(folder);
}

Status writeFile(const std::string& path, std::span<const std::uint8_t> bytes) {
    FileOutput file(path);
    if (auto s = file.open(); !s) return s;
    if (auto s = file.write(bytes); !s) return s;
    return file.commit();
}

}  // namespace mtsm::base
