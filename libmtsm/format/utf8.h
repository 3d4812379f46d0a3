// utf8.h - is a text UTF-8?
#pragma once
#include <string_view>

namespace mtsm::format {

/// Well-formed as Unicode 15, table 3-7 has it: no overlong forms, no surrogates, nothing
/// above U+10FFFF.
[[nodiscard]] bool isUtf8(std::string_view text) noexcept;

}  // namespace mtsm::format
