// printable.h - bytes of a file, fit for one line of a message.
#pragma once
#include <string>
#include <string_view>

namespace mtsm::io {

/// The first `most` bytes of `text`; what is not printable ASCII becomes '?'.
inline std::string printable(std::string_view text, std::size_t most) {
    std::string out(text.substr(0, most));
    for (char& c : out) {
        if (c < 0x20 || c > 0x7e) c = '?';
    }
    return text.size() > most ? out + "..." : out;
}

}  // namespace mtsm::io
