// message.h - builds the one sentence of an Error.
#pragma once
#include <locale>
#include <sstream>
#include <string>
#include <utility>

#include "mtsm/result.h"

namespace mtsm::base {

/// Its arguments, written one after another.
template <typename... Parts>
std::string concat(const Parts&... parts) {
    std::ostringstream out;
    out.imbue(std::locale::classic());  // the host's may group digits
    (out << ... << parts);
    return std::move(out).str();
}

template <typename... Parts>
Error makeError(ErrorCode code, const Parts&... parts) {
    return Error{code, concat(parts...)};
}

}  // namespace mtsm::base
