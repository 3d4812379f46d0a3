// Text that nobody vouches for, on its way to somebody's terminal.
#include "base/printable.h"

#include <catch2/catch.hpp>
#include <string>

using mtsm::base::printable;

TEST_CASE("printable text stays as it is, whatever its script", "[base][exact]") {
    for (const char* text :
         {"", "key light", "Schlüssel", "灯", "\xf0\x9f\x92\xa1", "\\n"})
        CHECK(printable(text) == text);
}

TEST_CASE("no control character reaches a terminal", "[base][exact]") {
    CHECK(printable("a\nb\rc\td") == "a\\nb\\rc\\td");
    CHECK(printable("\x1b[2J") == "\\x1b[2J");
    CHECK(printable(std::string("\0\x7f", 2)) == "\\x00\\x7f");
    // U+009B begins a terminal's command just as ESC [ does; U+00A0 is only a space.
    CHECK(printable("\xc2\x9b"
                    "2J") == "\\xc2\\x9b2J");
    CHECK(printable("\xc2\x80\xc2\xa0") == "\\xc2\\x80\xc2\xa0");
}

TEST_CASE("bytes that are no UTF-8 are shown by their numbers", "[base][exact]") {
    CHECK(printable("\x9b!") == "\\x9b!");
    CHECK(printable("\xff\xe7\x81") == "\\xff\\xe7\\x81");
}

TEST_CASE("what is cut is cut between characters and says so", "[base][exact]") {
    CHECK(printable("abcdef", 6) == "abcdef");
    CHECK(printable("abcdef", 5) == "abcde...");
    CHECK(printable("ab灯", 4) == "ab...");
}
