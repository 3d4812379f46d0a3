// bad_file.h - the error of every reader in this module.
#pragma once
#include "base/message.h"

namespace mtsm::format {

/// The file is not what it claims to be, and `parts` say why.
template <typename... Parts>
Error bad(const Parts&... parts) {
    return base::makeError(ErrorCode::badFile, parts...);
}

}  // namespace mtsm::format
