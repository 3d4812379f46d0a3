// system_error.h - errno in words.
#pragma once
#include <string>
#include <system_error>

namespace mtsm::base {

/// What the system calls this errno, as std::strerror but safe in any thread.
inline std::string systemReason(int error) {
    return std::generic_category().message(error);
}

}  // namespace mtsm::base
