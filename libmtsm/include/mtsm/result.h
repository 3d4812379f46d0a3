// result.h - how functions of this library report what went wrong.
//
//     auto map = mtsm::readMap("key.mtsm");                     // Result<ShadowMap>
//     if (!map) {
//         std::fprintf(stderr, "%s\n", map.error().message.c_str());
//         return mtsm::exitCode(map.error().code);
//     }
//     use(*map);
//
// Everything that touches files, memory sizes or a user's input returns Result<T> (a
// value or an Error) or Status (nothing or an Error). Nothing throws across this API. A
// message is one sentence without a trailing newline: it names the file, the place in it,
// what was found, what was expected, and where there is one the way out.
#pragma once
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace mtsm {

/// What a caller can do about an error decides its code; the message says the rest.
enum class ErrorCode {
    io,           ///< the system refused: no such file, no permission, disk full
    badFile,      ///< the file was read and is not what it claims to be
    unsupported,  ///< well-formed, but newer or other than what this version handles
    badArgument,  ///< a value that a caller passed is out of its range
    tooLarge,     ///< a size is above a limit that the caller can raise
    cancelled     ///< a progress callback asked to stop
};

struct Error {
    ErrorCode code = ErrorCode::io;
    std::string message;
};

/// The process exit code of every tool: 2 usage, 3 input or output, 4 bad file, 5
/// unsupported.
[[nodiscard]] constexpr int exitCode(ErrorCode code) noexcept {
    switch (code) {
        case ErrorCode::badArgument:
            return 2;
        case ErrorCode::tooLarge:
            return 2;
        case ErrorCode::io:
            return 3;
        case ErrorCode::cancelled:
            return 3;
        case ErrorCode::badFile:
            return 4;
        case ErrorCode::unsupported:
            return 5;
    }
    return 3;
}

/// A value of type T, or the Error that kept it from being made.
template <typename T>
class [[nodiscard]] Result {
  public:
    Result(T value) : content_(std::in_place_index<0>, std::move(value)) {}
    Result(Error error) : content_(std::in_place_index<1>, std::move(error)) {}

    [[nodiscard]] bool ok() const noexcept { return content_.index() == 0; }
    explicit operator bool() const noexcept { return ok(); }

    /// The value; only when ok().
    T& operator*() & { return std::get<0>(content_); }
    const T& operator*() const& { return std::get<0>(content_); }
    T&& operator*() && { return std::get<0>(std::move(content_)); }
    T* operator->() { return &std::get<0>(content_); }
    const T* operator->() const { return &std::get<0>(content_); }

    /// The error; only when not ok().
    [[nodiscard]] const Error& error() const { return std::get<1>(content_); }

  private:
    std::variant<T, Error> content_;
};

/// Success, or an Error. `return {};` is success.
class [[nodiscard]] Status {
  public:
    Status() = default;
    Status(Error error) : error_(std::move(error)) {}

    [[nodiscard]] bool ok() const noexcept { return !error_; }
    explicit operator bool() const noexcept { return ok(); }
    [[nodiscard]] const Error& error() const { return *error_; }

  private:
    std::optional<Error> error_;
};

}  // namespace mtsm
