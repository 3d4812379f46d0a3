// AtomicOutput: temporary file, fsync, rename.
#include "io/atomic_output.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "base/message.h"

namespace mtsm::io {
namespace {

namespace fs = std::filesystem;
using base::makeError;

constexpr int kNameTries = 1000;

/// Opens a new file beside `target`; its name goes to `temporary`. -1 and errno on
/// failure.
int openBeside(const fs::path& target, std::string& temporary) {
    for (int i = 0; i < kNameTries; ++i) {
        const std::string leaf = base::concat(".", target.filename().string(), ".",
                                              ::getpid(), "-", i, ".tmp");
        temporary = (target.parent_path() / leaf).string();
        const int fd =
            ::open(temporary.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (fd >= 0 || errno != EEXIST) return fd;
    }
    errno = EEXIST;
    return -1;
}

void syncFolder(const fs::path& folder) {
    // The rename is done and visible; a file system that cannot sync a folder is no
    // error.
    const std::string name = folder.empty() ? "." : folder.string();
    const int fd = ::open(name.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return;
    ::fsync(fd);
    ::close(fd);
}

}  // namespace

Result<AtomicOutput> AtomicOutput::create(const std::string& path) {
    AtomicOutput out;
    out.path_ = path;
    std::error_code problem;
    const fs::path resolved = fs::weakly_canonical(path, problem);
    out.target_ = problem || resolved.empty() ? path : resolved.string();
    const fs::file_status status = fs::status(out.target_, problem);
    if (fs::is_directory(status))
        return makeError(ErrorCode::io, path,
                         ": is a folder; give the name of a file in it");
    if (fs::exists(status) && !fs::is_regular_file(status))
        return makeError(ErrorCode::io, path,
                         ": is not a regular file, so it cannot be replaced");

    const int fd = openBeside(out.target_, out.temporary_);
    if (fd < 0) {
        out.temporary_.clear();
        out.keepError();
        return out.systemError();
    }
    const auto mode = static_cast<mode_t>(status.permissions());
    const bool kept = !fs::exists(status) || ::fchmod(fd, mode) == 0;
    out.file_ = kept ? ::fdopen(fd, "wb") : nullptr;
    if (!out.file_) {
        out.keepError();
        ::close(fd);
        return out.systemError();
    }
    return out;
}

AtomicOutput::AtomicOutput(AtomicOutput&& other) noexcept
    : path_(std::move(other.path_)),
      target_(std::move(other.target_)),
      temporary_(std::exchange(other.temporary_, {})),
      file_(std::exchange(other.file_, nullptr)),
      position_(other.position_),
      errno_(other.errno_) {}

AtomicOutput::~AtomicOutput() {
    if (file_) std::fclose(file_);
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicOutput::keepError() noexcept {
    if (errno_ == 0) errno_ = errno != 0 ? errno : EIO;
}

Error AtomicOutput::systemError() const {
    return makeError(ErrorCode::io, path_, ": cannot write: ", std::strerror(errno_));
}

bool AtomicOutput::write(const void* bytes, std::size_t size) noexcept {
    if (failed() || size == 0) return !failed();
    errno = 0;
    if (std::fwrite(bytes, 1, size, file_) != size) keepError();
    position_ += size;
    return !failed();
}

bool AtomicOutput::seek(std::uint64_t position) noexcept {
    if (failed()) return false;
    errno = 0;
    if (::fseeko(file_, static_cast<off_t>(position), SEEK_SET) != 0) keepError();
    position_ = position;
    return !failed();
}

Status AtomicOutput::commit() {
    errno = 0;
    if (!failed() && std::fflush(file_) != 0) keepError();
    if (!failed() && ::fsync(::fileno(file_)) != 0) keepError();
    if (std::fclose(std::exchange(file_, nullptr)) != 0) keepError();
    if (!failed() && std::rename(temporary_.c_str(), target_.c_str()) != 0) keepError();
    if (failed()) return systemError();
    temporary_.clear();
    syncFolder(fs::path(target_).parent_path());
    return {};
}

Status writeFileAtomically(const std::string& path, const void* bytes, std::size_t size) {
    auto out = AtomicOutput::create(path);
    if (!out) return out.error();
    out->write(bytes, size);
    return out->commit();
}

}  // namespace mtsm::io
