#include "base/printable.h"

#include <algorithm>

#include "base/utf8.h"

namespace mtsm::base {
namespace {

std::string escaped(unsigned char byte) {
    static constexpr char kDigits[] = "0123456789abcdef";
    if (byte == '\n') return "\\n";
    if (byte == '\r') return "\\r";
    if (byte == '\t') return "\\t";
    return {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
}

/// Bytes of the character of valid UTF-8 that `text` begins with; 0 if there is none.
std::size_t characterLength(std::string_view text) {
    for (std::size_t n = 1; n <= std::min<std::size_t>(4, text.size()); ++n) {
        if (isUtf8(text.substr(0, n))) return n;
    }
    return 0;
}

bool isControl(std::string_view character) {
    const auto first = static_cast<unsigned char>(character[0]);
    if (character.size() == 1) return first < 0x20 || first == 0x7f;
    // U+0080 to U+009F are c2 80 to c2 9f.
    return first == 0xc2 && static_cast<unsigned char>(character[1]) < 0xa0;
}

}  // namespace

std::string printable(std::string_view text, std::size_t most) {
    std::string out;
    for (std::size_t at = 0; at < text.size();) {
        const std::size_t known = characterLength(text.substr(at));
        const std::size_t length = std::max<std::size_t>(known, 1);
        if (length > most - std::min(most, at)) return out + "...";
        const std::string_view character = text.substr(at, length);
        if (known > 0 && !isControl(character)) {
            out += character;
        } else {
            for (char c : character)
                out += escaped(static_cast<unsigned char>(c));
        }
        at += length;
    }
    return out;
}

}  // namespace mtsm::base
