#include "base/utf8.h"

#include <cstddef>
#include <cstdint>

namespace mtsm::base {

bool isUtf8(std::string_view text) noexcept {
    for (std::size_t i = 0; i < text.size();) {
        const auto lead = static_cast<std::uint8_t>(text[i++]);
        if (lead < 0x80) continue;
        // How many bytes follow, and which values the first of them may have: the
        // narrower bounds keep out overlong forms (e0, f0), surrogates (ed) and the end
        // (f4).
        int more = 0;
        std::uint8_t low = 0x80, high = 0xbf;
        if (lead >= 0xc2 && lead <= 0xdf) {
            more = 1;
        } else if (lead >= 0xe0 && lead <= 0xef) {
            more = 2;
            if (lead == 0xe0) low = 0xa0;
            if (lead == 0xed) high = 0x9f;
        } else if (lead >= 0xf0 && lead <= 0xf4) {
            more = 3;
            if (lead == 0xf0) low = 0x90;
            if (lead == 0xf4) high = 0x8f;
        } else {
            return false;
        }
        for (; more > 0; --more, low = 0x80, high = 0xbf) {
            if (i == text.size()) return false;
            const auto next = static_cast<std::uint8_t>(text[i++]);
            if (next < low || next > high) return false;
        }
    }
    return true;
}

std::string asUtf8(std::string text) {
    if (isUtf8(text)) return text;
    for (char& c : text) {
        if (static_cast<unsigned char>(c) > 0x7f) c = '?';
    }
    return text;
}

}  // namespace mtsm::base
