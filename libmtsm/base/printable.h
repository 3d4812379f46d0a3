// printable.h - text of unknown origin, fit for a terminal and for one line of a message.
#pragma once
#include <cstddef>
#include <string>
#include <string_view>

namespace mtsm::base {

/// `text`, cut behind `most` bytes with "..." in place of the rest. Control characters
/// (U+0000 to U+001F, U+007F to U+009F, so newlines and escapes too) become \n, \r, \t or
/// \xNN, and so does every byte that is not part of valid UTF-8; all else stays as it is.
/// Printable text comes back unchanged, so applying it twice does no harm.
std::string printable(std::string_view text, std::size_t most = std::string_view::npos);

}  // namespace mtsm::base
