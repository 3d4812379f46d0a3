#include "scene/import_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <new>
#include <utility>

#include "base/message.h"
#include "scene/isolate.h"

namespace mtsm::scene {
namespace {

using base::makeError;

bool isCrash(int signal) {
    return signal == SIGSEGV || signal == SIGABRT || signal == SIGBUS ||
           signal == SIGFPE || signal == SIGILL || signal == SIGTRAP || signal == SIGSYS;
}

std::string amount(std::uint64_t bytes) {
    const std::uint64_t mib = bytes >> 20;
    if (mib == 0) return base::concat(bytes, " bytes");
    if (mib % 1024 == 0) return base::concat(mib / 1024, " GiB");
    return base::concat(mib, " MiB");
}

Error outOfMemory(const std::string& path, std::uint64_t importerBytes) {
    return makeError(ErrorCode::tooLarge, path, ": reading it takes more than the ",
                     amount(importerBytes),
                     " that an importer may use (importerBytes); if the file is sound, "
                     "split it, make its images smaller, or use a machine of more "
                     "memory");
}

/// Why a child that said neither `end` nor `failure` fell silent.
Error errorOf(const ChildEnd& end, const std::string& path, std::uint64_t importerBytes) {
    switch (end.how) {
        case ChildEnd::How::outOfMemory:
            return outOfMemory(path, importerBytes);
        case ChildEnd::How::signalled:
            if (isCrash(end.number))
                return makeError(ErrorCode::badFile, path,
                                 ": the importer crashed on this file (signal ",
                                 end.number, "); re-export or repair it");
            if (end.number == SIGINT || end.number == SIGTERM)
                return makeError(ErrorCode::cancelled, path, ": reading was cancelled");
            return makeError(ErrorCode::io, path, ": the importer was killed (signal ",
                             end.number, "); try again with more free memory");
        case ChildEnd::How::exited:
        case ChildEnd::How::finished:
            break;
    }
    return makeError(ErrorCode::badFile, path,
                     ": the importer stopped on this file without a result (exit code ",
                     end.number, "); re-export or repair it");
}

Error nonsense(const std::string& path) {
    return makeError(ErrorCode::badFile, path,
                     ": the importer returned data that contradict themselves; re-export "
                     "or repair the file");
}

Error reportedFailure(const Frame& frame, const std::string& path) {
    std::uint32_t code = 0;
    if (frame.payload.size() < sizeof(code)) return nonsense(path);
    std::memcpy(&code, frame.payload.data(), sizeof(code));
    if (code > std::uint32_t(ErrorCode::cancelled)) return nonsense(path);
    return {ErrorCode(code), frame.text(sizeof(code))};
}

Status receive(Isolated& child, const std::string& path, std::uint64_t importerBytes,
               const ImportSink& sink) {
    FrameReader reader(child, importerBytes);
    while (const auto frame = reader.next()) {
        switch (frame->kind) {
            case FrameKind::end:
                return {};
            case FrameKind::failure:
                return reportedFailure(*frame, path);
            case FrameKind::warning:
                if (sink.warning) sink.warning(frame->text());
                break;
            case FrameKind::name:
                if (sink.name) sink.name(frame->text());
                break;
            case FrameKind::mesh: {
                auto mesh = reader.mesh(*frame);
                if (!mesh) return nonsense(path);
                if (!sink.mesh) break;
                if (Status s = sink.mesh(std::move(*mesh)); !s) return s;
                break;
            }
            case FrameKind::volume: {
                auto volume = reader.volume(*frame);
                if (!volume) return nonsense(path);
                if (!sink.volume) break;
                if (Status s = sink.volume(std::move(*volume)); !s) return s;
                break;
            }
            case FrameKind::texture: {
                auto image = reader.texture(*frame);
                if (!image)
                    return reader.tooLarge() ? outOfMemory(path, importerBytes)
                                             : nonsense(path);
                if (!sink.texture) break;
                if (Status s = sink.texture(std::move(*image)); !s) return s;
                break;
            }
            case FrameKind::light: {
                auto light = FrameReader::light(*frame);
                if (!light) return nonsense(path);
                if (sink.light) sink.light(std::move(*light));
                break;
            }
        }
    }
    if (!child.ended()) return nonsense(path);
    return errorOf(child.wait(), path, importerBytes);
}

Error unreadable(const std::string& path) {
    return makeError(ErrorCode::io, path, ": cannot be read: ", std::strerror(errno));
}

}  // namespace

Status checkReadable(const std::string& path) {
    // Without O_NONBLOCK a named pipe would wait here for its writer.
    const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) return unreadable(path);
    struct stat info {};
    const int failed = fstat(fd, &info);
    const int reason = errno;
    close(fd);
    errno = reason;
    if (failed != 0) return unreadable(path);
    if (S_ISDIR(info.st_mode))
        return makeError(ErrorCode::io, path, ": is a folder, not a file");
    if (!S_ISREG(info.st_mode))
        return makeError(ErrorCode::io, path, ": is not a regular file");
    if (info.st_size == 0)
        return makeError(ErrorCode::badFile, path, ": the file is empty");
    return {};
}

Status importFile(const std::string& path, std::uint64_t importerBytes,
                  const std::function<void(FrameWriter&)>& send, const ImportSink& sink) {
    if (Status s = checkReadable(path); !s) return s;
    try {
        auto child = Isolated::start(
            [&](ChildPipe& pipe) {
                FrameWriter out(pipe);
                send(out);
            },
            importerBytes);
        if (!child)
            return makeError(child.error().code, path, ": ", child.error().message);
        return receive(*child, path, importerBytes, sink);
    } catch (const std::bad_alloc&) {
        return makeError(ErrorCode::tooLarge, path,
                         ": there is not enough memory to hold its geometry");
    }
}

}  // namespace mtsm::scene
