// guard.h - the edge where exceptions of the standard library and oneTBB become errors.
#pragma once
#include <exception>
#include <new>
#include <stdexcept>
#include <string>

#include "base/message.h"
#include "base/printable.h"

namespace mtsm::format {

/// What `work` returns, or an error in its place if it throws. `doing` is "read" or
/// "write". Messages may quote what a file holds: they leave here fit for a terminal.
template <typename Work>
auto guarded(const std::string& name, const char* doing, Work&& work)
    -> decltype(work()) {
    try {
        auto result = work();
        if (!result)
            return Error{result.error().code, base::printable(result.error().message)};
        return result;
    } catch (const std::bad_alloc&) {
        return base::makeError(ErrorCode::tooLarge, name, ": not enough memory to ",
                               doing, " it");
    } catch (const std::length_error&) {
        return base::makeError(ErrorCode::tooLarge, name, ": not enough memory to ",
                               doing, " it");
    } catch (const std::exception& e) {
        return base::makeError(ErrorCode::io, name, ": cannot ", doing,
                               " it: ", e.what());
    } catch (...) {  // a callback's
        return base::makeError(ErrorCode::io, name, ": cannot ", doing,
                               " it: something unknown was thrown");
    }
}

}  // namespace mtsm::format
