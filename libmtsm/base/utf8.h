// utf8.h - is a text UTF-8?
#pragma once
#include <string>
#include <string_view>

namespace mtsm::base {

/// Well-formed as Unicode 15, table 3-7 has it: no overlong forms, no surrogates, nothing
/// above U+10FFFF.
[[nodiscard]] bool isUtf8(std::string_view text) noexcept;

/// `text` itself if it is UTF-8; else with a question mark for every byte that is not
/// ASCII.
[[nodiscard]] std::string asUtf8(std::string text);

}  // namespace mtsm::base
