// Isolated: fork, a pipe, limits, and nothing left behind.
#include "scene/isolate.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <new>
#include <utility>

#ifdef __linux__
#include <sys/prctl.h>
#endif

#include "base/message.h"

namespace mtsm::scene {
namespace {

// Exit codes of the child. Importers do not call exit, so none of theirs can collide.
constexpr int kExitOutOfMemory = 86;
constexpr int kExitThrew = 87;
constexpr int kExitPipeClosed = 88;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif

/// A handler of the host's must not run twice, and a crash must end the child with its
/// signal: everything back to what the system does by default.
void resetSignals() {
    for (int s = 1; s < NSIG; ++s)
        std::signal(s, SIG_DFL);
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, nullptr);
}

void dieWithParent([[maybe_unused]] pid_t parent) {
#ifdef __linux__
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(kExitPipeClosed);  // it went before we asked
#endif
}

/// Moves the pipe out of the way of 0, 1 and 2, points those at nothing and closes all
/// others: a second child would otherwise hold the first one's pipe open.
int keepOnlyPipe(int pipe) {
    const int kept = fcntl(pipe, F_DUPFD_CLOEXEC, 3);
    if (kept < 0) _exit(kExitPipeClosed);
    const int nothing = open("/dev/null", O_RDWR);
    for (int fd = 0; fd < 3; ++fd)
        dup2(nothing, fd);
#ifdef __linux__
    if ((kept == 3 || close_range(3, unsigned(kept) - 1, 0) == 0) &&
        close_range(unsigned(kept) + 1, ~0u, 0) == 0)
        return kept;
#endif
    const long last = std::min(sysconf(_SC_OPEN_MAX), 65536L);
    for (int fd = 3; fd < last; ++fd)
        if (fd != kept) close(fd);
    return kept;
}

/// Bytes of address space that this process has mapped; 0 where that cannot be asked.
std::uint64_t mappedBytes() {
    unsigned long long pages = 0;
    if (std::FILE* f = std::fopen("/proc/self/statm", "r")) {
        if (std::fscanf(f, "%llu", &pages) != 1) pages = 0;
        std::fclose(f);
    }
    return std::uint64_t(pages) * std::uint64_t(sysconf(_SC_PAGESIZE));
}

void lower(int resource, std::uint64_t value) {
    rlimit limit{};
    if (getrlimit(resource, &limit) != 0) return;
    limit.rlim_cur = std::min<rlim_t>(rlim_t(value), limit.rlim_max);
    setrlimit(resource, &limit);
}

void limitResources(std::uint64_t addedBytes) {
    lower(RLIMIT_CORE, 0);
    const std::uint64_t mapped = mappedBytes();
    if (!kSanitized && addedBytes < ~std::uint64_t(0) - mapped)
        lower(RLIMIT_AS, mapped + addedBytes);
    std::set_new_handler([] { _exit(kExitOutOfMemory); });
}

[[noreturn]] void runChild(const std::function<void(ChildPipe&)>& body, pid_t parent,
                           int fd, std::uint64_t addedBytes) {
    resetSignals();
    dieWithParent(parent);
    ChildPipe pipe(keepOnlyPipe(fd));
    limitResources(addedBytes);
    try {
        body(pipe);
    } catch (const std::bad_alloc&) {
        _exit(kExitOutOfMemory);
    } catch (...) {
        _exit(kExitThrew);
    }
    _exit(0);
}

/// Holds back all signals of this thread, so that no handler runs in a child that has not
/// reset them yet.
class SignalsHeld {
  public:
    SignalsHeld() {
        sigset_t all;
        sigfillset(&all);
        pthread_sigmask(SIG_SETMASK, &all, &before_);
    }
    ~SignalsHeld() { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }

  private:
    sigset_t before_;
};

Error systemError(const char* what) {
    return base::makeError(ErrorCode::io, "cannot start the importer: ", what, ": ",
                           std::strerror(errno));
}

}  // namespace

void ChildPipe::write(const void* bytes, std::size_t count) {
    const char* at = static_cast<const char*>(bytes);
    while (count > 0) {
        const ssize_t n = ::write(fd_, at, count);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) _exit(kExitPipeClosed);
        at += n;
        count -= std::size_t(n);
    }
}

Result<Isolated> Isolated::start(const std::function<void(ChildPipe&)>& body,
                                 std::uint64_t addedBytes) {
    int ends[2];
#ifdef __linux__
    if (pipe2(ends, O_CLOEXEC) != 0) return systemError("pipe");
    fcntl(ends[0], F_SETPIPE_SZ, 1 << 20);  // fewer switches; 64 KiB work as well
#else
    if (pipe(ends) != 0) return systemError("pipe");
    fcntl(ends[0], F_SETFD, FD_CLOEXEC);
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
#endif
    const pid_t parent = getpid();
    pid_t child = -1;
    {
        const SignalsHeld held;
        child = fork();
        if (child == 0) runChild(body, parent, ends[1], addedBytes);
    }
    const int forkErrno = errno;
    close(ends[1]);
    if (child < 0) {
        close(ends[0]);
        errno = forkErrno;
        return systemError("fork");
    }
    return Isolated(child, ends[0]);
}

Isolated::Isolated(Isolated&& other) noexcept
    : child_(std::exchange(other.child_, -1)),
      fd_(std::exchange(other.fd_, -1)),
      ended_(other.ended_) {}

Isolated::~Isolated() {
    ended_ = false;  // nobody asks how it would have ended
    (void)wait();
}

void Isolated::closePipe() noexcept {
    if (fd_ >= 0) close(std::exchange(fd_, -1));
}

std::size_t Isolated::read(void* to, std::size_t count) {
    std::size_t done = 0;
    while (done < count) {
        const ssize_t n = ::read(fd_, static_cast<char*>(to) + done, count - done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) break;
        done += std::size_t(n);
    }
    if (done < count) ended_ = true;
    return done;
}

ChildEnd Isolated::wait() {
    closePipe();
    if (child_ <= 0) return {};
    if (!ended_) kill(child_, SIGKILL);
    int status = 0;
    pid_t got = -1;
    do {
        got = waitpid(child_, &status, 0);
    } while (got < 0 && errno == EINTR);
    child_ = -1;
    // A host that ignores SIGCHLD, or reaps all children, leaves nothing to ask.
    if (got < 0) return {ChildEnd::How::exited, -1};
    if (WIFSIGNALED(status)) return {ChildEnd::How::signalled, WTERMSIG(status)};
    const int code = WEXITSTATUS(status);
    if (code == 0) return {};
    if (code == kExitOutOfMemory) return {ChildEnd::How::outOfMemory, code};
    return {ChildEnd::How::exited, code};
}

}  // namespace mtsm::scene
