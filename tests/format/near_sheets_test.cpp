// The sheets of near fields in files: CARD damaged at random; what is right and wrong in
// it one by one is in the golden and bad files.
#include <catch2/catch.hpp>

#include "format/bad_files.h"
#include "format/near_files.h"

using namespace mtsm;
using namespace mtsm::test;
using namespace mtsm::format;

TEST_CASE("random changes in a CARD block give an error or a map, never a crash",
          "[format][bad-input]") {
    Surgery s(encoded(mapWithFaces(1, false, [](MapFace&, std::uint32_t) {})));
    s.parts.insert(s.parts.begin() + 1, {kCard, 0, handmadeCards()});
    checkDamaged({s.close()}, kCard, 3000);
}

TEST_CASE("a file with sheets that is cut or changed anywhere is refused",
          "[format][bad-input]") {
    Surgery s(encoded(mapWithFaces(1, false, [](MapFace&, std::uint32_t) {})));
    s.parts.insert(s.parts.begin() + 1, {kCard, 0, handmadeCards()});
    const Bytes file = s.close();
    REQUIRE(readBytes(file));
    Bytes changed = file;
    for (std::size_t at = 0; at < file.size(); ++at) {
        INFO("byte " << at << " of " << file.size());
        if (readBytes(Bytes(file.begin(), file.begin() + long(at))))
            FAIL("accepted a file that is cut off");
        changed[at] ^= 0x11;
        if (readBytes(changed)) FAIL("accepted a changed byte");
        changed[at] = file[at];
    }
}
