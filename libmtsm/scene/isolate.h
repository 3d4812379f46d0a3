// isolate.h - runs a function in a child process that may die.
//
//     auto child = Isolated::start([](ChildPipe& out) { out.write(bytes, n); }, limit);
//     if (!child) return child.error();
//     while (child->read(buffer, size) == size) use(buffer);
//     ChildEnd end = child->wait();
//
// The child is a fork of the calling thread: it sees the parent's memory as it was, can
// change nothing in it, and answers through a pipe. Mesh importers crash or ask for all
// the memory there is on some broken files; here that ends the child alone.
//
// What the function may do. After a fork from a process with several threads POSIX
// promises only async-signal-safe calls; glibc and macOS make malloc usable as well, and
// that is what this relies on: the function may allocate, read files and compute, but
// must not start threads or wait for locks that another thread of the parent may hold.
#pragma once
#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <functional>

#include "mtsm/result.h"

namespace mtsm::scene {

/// The child's end of the pipe.
class ChildPipe {
  public:
    explicit ChildPipe(int fd) : fd_(fd) {}
    /// Writes all of it. If the parent has closed its end, ends the child.
    void write(const void* bytes, std::size_t count);

  private:
    int fd_;
};

/// How a child ended.
struct ChildEnd {
    enum class How {
        finished,     ///< the function returned
        outOfMemory,  ///< an allocation was refused
        signalled,    ///< a signal ended it: `number`
        exited        ///< it left by another way: exit code `number`; -1: not known
    };
    How how = How::finished;
    int number = 0;
};

class Isolated {
  public:
    /// Runs `body` in a child. It has default signal handling, no output, none of this
    /// process's open files but the pipe, no core dump, and may map `addedBytes` more
    /// than this process has mapped now (no limit in builds with a sanitizer, which map
    /// terabytes). It dies with the calling thread where the system can do that (Linux).
    /// Errors (io): the system refuses a pipe or a process.
    static Result<Isolated> start(const std::function<void(ChildPipe&)>& body,
                                  std::uint64_t addedBytes);

    Isolated(Isolated&& other) noexcept;
    Isolated& operator=(Isolated&&) = delete;
    /// Ends the child if it still runs.
    ~Isolated();

    /// Waits for `count` bytes; gives fewer only when the child has ended.
    [[nodiscard]] std::size_t read(void* to, std::size_t count);
    /// True once read() came short.
    [[nodiscard]] bool ended() const noexcept { return ended_; }
    /// Closes the pipe and waits for the child's end. A child whose stream has not ended
    /// is killed, for it may never end by itself.
    [[nodiscard]] ChildEnd wait();

  private:
    Isolated(pid_t child, int fd) : child_(child), fd_(fd) {}
    void closePipe() noexcept;

    pid_t child_ = -1;  // -1: reaped
    int fd_ = -1;
    bool ended_ = false;
};

}  // namespace mtsm::scene
