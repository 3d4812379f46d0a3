// Files that are not what they claim to be.
#include <sys/stat.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>
#include <unistd.h>
#include <zstd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <fstream>
#include <limits>

#include "format/file_surgery.h"
#include "format/refused.h"
#include "format/temp_folder.h"
#include "map_fixture.h"
#include "mtsm/reader.h"
#include "mtsm/writer.h"

using namespace mtsm;
using namespace mtsm::test;
using namespace mtsm::format;

namespace {

Bytes encoded(const ShadowMap& map, Codec codec = Codec::zstd) {
    WriteOptions options;
    options.codec = codec;
    auto bytes = encodeMap(map, options);
    REQUIRE(bytes);
    return *std::move(bytes);
}

ShadowMap smallMap(std::uint32_t faces, std::uint32_t channels, bool opaque) {
    NoisySpec spec;
    spec.width = 11;
    spec.height = 9;
    spec.faces = faces;
    spec.channels = channels;
    spec.opaque = opaque;
    spec.emptyTiles = 0.3;
    spec.seed = 4;
    return noisyMap(spec);
}

/// Four tiles of 8 x 8 pixels with all planes.
Bytes plainFile(Codec codec = Codec::zstd) {
    NoisySpec spec;
    spec.emptyTiles = 0.0;
    return encoded(noisyMap(spec), codec);
}

using EditTile = std::function<void(TileRecord&)>;
using EditPlane = std::function<void(PlaneRecord&)>;

/// A file whose first tile's record was changed.
Bytes withTile(const EditTile& change) {
    Surgery s(plainFile());
    edit<TileRecord>(s.payload(kTile), 0, change);
    return s.close();
}

/// A file whose first tile's n-th plane (0 counts, 1 z, 2 v, 3 n) was changed.
Bytes withPlane(int n, const EditPlane& change) {
    Surgery s(plainFile());
    edit<PlaneRecord>(s.payload(kTile), Surgery::planeAt(n), change);
    return s.close();
}

Bytes withIndex(const std::function<void(Index&)>& change) {
    Surgery s(plainFile());
    s.onIndex = change;
    return s.close();
}

/// What decoding takes beside the map, on one thread: the stored bytes of a tile, its
/// counts, and of its largest plane the decompressed bytes and the elements.
std::uint64_t largestTileWork(const Bytes& file) {
    std::uint64_t most = 0;
    for (const auto& part : Surgery(file).parts) {
        if (part.type != kTile) continue;
        const auto t = peek<TileRecord>(part.payload, 0);
        const std::uint64_t pixels = std::uint64_t(t.width) * t.height;
        most = std::max<std::uint64_t>(
            most, (32 + part.payload.size() + 7) / 8 * 8 + 4 * pixels +
                      8 * std::max<std::uint64_t>(pixels, t.layers));
    }
    return most;
}

/// The parts that a message may name.
bool namesAPart(const std::string& message) {
    for (const char* part :
         {"prefix", "trailer", "index", "block HEAD at offset", "block ATTR at offset",
          "block HIER at offset", "block TOTL at offset", "tile face "}) {
        if (message.find(part) != std::string::npos) return true;
    }
    return false;
}

}  // namespace

TEST_CASE("taking a file apart and putting it together gives the same file", "[format]") {
    const Bytes file = plainFile();
    CHECK(Surgery(file).close() == file);
}

// --- damage
// --------------------------------------------------------------------------------

TEST_CASE("a file that is cut off anywhere is refused and the message says where",
          "[format][bad-input]") {
    for (const Bytes& file :
         {encoded(smallMap(1, 1, true)), encoded(smallMap(1, 3, false)),
          encoded(smallMap(6, 1, true), Codec::none)}) {
        for (std::size_t n = 0; n < file.size(); ++n) {
            const auto map = readBytes(Bytes(file.begin(), file.begin() + long(n)));
            if (!map && map.error().code == ErrorCode::badFile &&
                (n == 0 || namesAPart(map.error().message)))
                continue;
            INFO("first " << n << " of " << file.size() << " bytes");
            REQUIRE_FALSE(map);
            CHECK(map.error().message == "a badFile error that names a part");
        }
        CHECK(readBytes(file));
    }
}

TEST_CASE("every single changed byte is refused and the message names the damaged part",
          "[format][bad-input]") {
    for (const Bytes& file :
         {encoded(smallMap(1, 1, true)), encoded(smallMap(1, 3, false)),
          encoded(smallMap(1, 1, false), Codec::none)}) {
        Bytes changed = file;
        for (std::size_t at = 0; at < file.size(); ++at) {
            for (int flip : {0x01, 0x80, 0x10, 0xff}) {
                changed[at] = file[at] ^ std::uint8_t(flip);
                const auto map = readBytes(changed);
                if (!map && namesAPart(map.error().message)) continue;
                INFO("byte " << at << " of " << file.size() << " ^ " << flip);
                REQUIRE_FALSE(map);
                CHECK(map.error().message == "an error that names a part");
            }
            changed[at] = file[at];
        }
    }
}

TEST_CASE("damage is reported at the part that is damaged", "[format][bad-input]") {
    const Bytes file = plainFile();
    const auto trailer = peek<Trailer>(file, file.size() - sizeof(Trailer));
    const auto flipped = [&](std::size_t at) {
        Bytes b = file;
        b[at] ^= 4;
        return b;
    };
    const auto check = [&](std::size_t at, const std::string& words) {
        checkRefused(flipped(at), ErrorCode::badFile, words);
    };
    check(20, "prefix: damaged");
    check(64 + 8, "block HEAD at offset 64: the block header is damaged");
    check(64 + 32 + 5, "block HEAD at offset 64: the content is damaged");
    check(file.size() - 30, "trailer: damaged");
    check(file.size() - 12, "trailer: no finished mark");
    check(trailer.indexOffset + 40, "index: block INDX at offset");
    const auto tile = [&] {
        for (std::size_t at = 64;;) {
            const auto h = peek<BlockHeader>(file, at);
            if (h.type == kTile) return at;
            at += blockSpan(h.length);
        }
    }();
    check(tile + 100, base::concat("tile face 0 (0, 0) at offset ", tile,
                                   ": the content is damaged"));
    const auto h = peek<BlockHeader>(file, 64);
    REQUIRE(h.length % 8 != 0);
    check(64 + 32 + h.length, "block HEAD at offset 64: the padding");
}

TEST_CASE("bytes after the end are refused", "[format][bad-input]") {
    Bytes file = plainFile();
    file.push_back(0);
    checkRefused(file, ErrorCode::badFile, "trailer: no finished mark");
    // Even if they look like a trailer.
    file = plainFile();
    const Bytes trailer(file.end() - 32, file.end());
    file.insert(file.end(), trailer.begin(), trailer.end());
    checkRefused(file, ErrorCode::badFile, "trailer: says that the file has");
}

TEST_CASE("of several bad tiles the first is reported, whatever the threads do",
          "[format][bad-input][threads]") {
    NoisySpec spec;
    spec.width = spec.height = 128;
    spec.emptyTiles = 0.0;
    Surgery s(encoded(noisyMap(spec)));
    for (int n = 30; n < 256; n += 3)
        edit<TileRecord>(s.payload(kTile, n), 0, [](TileRecord& t) { t.reserved = 1; });
    const Bytes file = s.close();
    for (int i = 0; i < 20; ++i)
        checkRefused(file, ErrorCode::badFile, "tile face 0 (14, 1) at offset ");
}

// --- prefix
// --------------------------------------------------------------------------------

TEST_CASE("a newer major version is refused with one clear message",
          "[format][bad-input]") {
    Bytes newer(200, 0x77);  // whatever the rest looks like
    poke(newer, 0, kMagic);
    poke(newer, 8, std::uint16_t(2));
    poke(newer, 10, std::uint16_t(3));
    checkRefused(newer, ErrorCode::unsupported, "format version 2.3");
    newer.resize(12);
    checkRefused(newer, ErrorCode::unsupported, "a newer libmtsm is needed");
    const auto p = probe(newer.data(), newer.size(), "n");
    REQUIRE_FALSE(p);
    CHECK(p.error().code == ErrorCode::unsupported);
}

TEST_CASE("a newer minor version is read, and what it adds is passed over",
          "[format][roundtrip]") {
    const Bytes file = plainFile();
    Surgery s(file);
    s.prefix.versionMinor = 7;
    s.payload(kHead).insert(s.payload(kHead).end(), {1, 2, 3});
    s.payload(kTotl).push_back(9);
    // An attribute of a type that is unknown here.
    Bytes& attr = s.payload(kAttr);
    edit<std::uint32_t>(attr, 0, [](std::uint32_t& count) { ++count; });
    AttributeRecord record = {};
    record.type = 200;
    record.nameLength = 1;
    record.valueLength = 5;
    base::ByteWriter out(attr);
    out.put(record);
    out.text("x12345");
    s.parts.insert(s.parts.begin() + 1, {{'n', 'e', 'w', '!'}, 0, Bytes(70001, 3)});
    const auto map = readBytes(s.close());
    INFO((map ? "" : map.error().message));
    REQUIRE(map);
    CHECK(identical(*map, *readBytes(file)));
    // In a file of this version the same things are errors.
    s.prefix.versionMinor = 0;
    checkRefused(s.close(), ErrorCode::badFile,
                 "block HEAD at offset 64: 3 bytes are left");
}

TEST_CASE("what a newer minor version may have brought is unsupported, not damage",
          "[format][bad-input]") {
    const auto check = [](const std::function<void(Surgery&)>& change,
                          const std::string& words) {
        Surgery s(plainFile());
        change(s);
        checkRefused(s.close(), ErrorCode::badFile, words);
        s.prefix.versionMinor = 3;
        const Bytes newer = s.close();
        checkRefused(newer, ErrorCode::unsupported, words);
        checkRefused(newer, ErrorCode::unsupported,
                     "t.mtsm: is of version 1.3, newer than the 1.0 that this reader "
                     "knows: ");
        checkRefused(newer, ErrorCode::unsupported, "; use a newer libmtsm");
    };
    const auto plane = [](int n, const EditPlane& edited) {
        return [=](Surgery& s) {
            edit<PlaneRecord>(s.payload(kTile), Surgery::planeAt(n), edited);
        };
    };
    check([](Surgery& s) { s.prefix.reserved[0] = 1; }, "prefix: reserved");
    check([](Surgery& s) { poke(s.payload(kHead), 8, 17u); }, "shape");
    check([](Surgery& s) { poke(s.payload(kTotl), 36, 2u); }, "unknown flags 2");
    check(plane(1, [](PlaneRecord& r) { r.encoding = 3; }), "unknown encoding 3");
    check(plane(1, [](PlaneRecord& r) { r.filter = 4; }), "unknown filter 4");
    check(plane(1, [](PlaneRecord& r) { r.reserved2 = 1; }), "reserved");
    check([](Surgery& s) { s.onIndex = [](Index& i) { i.tiles[0].planes |= 4; }; },
          "unknown planes");
    check([](Surgery& s) { s.onIndex = [](Index& i) { i.blocks[0].flags |= 2; }; },
          "unknown flags");
    // So says probe, which sees the prefix alone.
    Surgery s(plainFile());
    s.prefix.versionMinor = 3;
    s.prefix.tileSize = 512;
    const Bytes file = s.close();
    const auto p = probe(file.data(), file.size(), "n");
    REQUIRE_FALSE(p);
    CHECK(p.error().code == ErrorCode::unsupported);
    CHECK_THAT(p.error().message, Catch::StartsWith("n: is of version 1.3, newer"));
}

TEST_CASE("a prefix is refused for each field that it may not have",
          "[format][bad-input]") {
    const auto check = [](const std::function<void(Prefix&)>& change,
                          const std::string& words) {
        Surgery s(plainFile());
        change(s.prefix);
        checkRefused(s.close(), ErrorCode::badFile, "prefix: " + words);
    };
    check([](Prefix& p) { p.versionMajor = 0; }, "format version 0");
    check([](Prefix& p) { p.prefixSize = 65; }, "says that it has 65 bytes");
    check([](Prefix& p) { p.width = 0; }, "0 x 16 pixels");
    check([](Prefix& p) { p.height = 32769; }, "16 x 32769 pixels");
    check([](Prefix& p) { p.faces = 2; }, "2 faces");
    check([](Prefix& p) { p.channels = 4; }, "4 visibility channels");
    check([](Prefix& p) { p.tileSize = 24; }, "tile size 24");
    check([](Prefix& p) { p.tileSize = 4; }, "tile size 4");
    check([](Prefix& p) { p.reserved[19] = 1; }, "reserved");
    checkRefused({}, ErrorCode::badFile, "is empty");
    checkRefused(Bytes(100, 'x'), ErrorCode::badFile, "is not an MTSM file");
    Bytes mangled = plainFile();
    mangled.erase(mangled.begin() + 5);  // CR LF -> LF, as a text transfer does
    checkRefused(mangled, ErrorCode::badFile, "is not an MTSM file");
}

TEST_CASE("probe says what the first 64 bytes say", "[format]") {
    NoisySpec spec;
    spec.width = 37;
    spec.height = 19;
    spec.faces = 6;
    spec.channels = 3;
    const Bytes file = encoded(noisyMap(spec));
    const auto p = probe(file.data(), kProbeBytes, "a.mtsm");
    REQUIRE(p);
    CHECK(p->versionMajor == 1);
    CHECK(p->versionMinor == 0);
    CHECK(p->width == 37);
    CHECK(p->height == 19);
    CHECK(p->faces == 6);
    CHECK(p->channels == 3);
    CHECK(p->tileSize == 8);
    const auto cut = probe(file.data(), 63, "a.mtsm");
    REQUIRE_FALSE(cut);
    CHECK(cut.error().code == ErrorCode::badFile);
    CHECK_THAT(cut.error().message, Catch::StartsWith("a.mtsm: is cut off"));
    CHECK_FALSE(probe(nullptr, 0, "a.mtsm"));
}

// --- trailer and index
// ---------------------------------------------------------------------

TEST_CASE("a trailer that lies is refused", "[format][bad-input]") {
    for (std::uint64_t offset :
         {std::uint64_t(0), std::uint64_t(56), std::uint64_t(72), std::uint64_t(1) << 40,
          ~std::uint64_t(0), ~std::uint64_t(7)}) {
        Surgery s(plainFile());
        s.onTrailer = [&](Trailer& t) { t.indexOffset = offset; };
        checkRefused(s.close(), ErrorCode::badFile, offset == 72 ? "index" : "trailer: ");
    }
    Surgery s(plainFile());
    s.onTrailer = [](Trailer& t) { t.indexOffset = 64; };  // a block, but HEAD
    checkRefused(s.close(), ErrorCode::badFile, "there is a block HEAD instead");
}

TEST_CASE("an index that lies is refused", "[format][bad-input]") {
    const auto check = [](const std::function<void(Index&)>& change,
                          const std::string& words) {
        checkRefused(withIndex(change), ErrorCode::badFile, words);
    };
    constexpr std::uint64_t kHuge = ~std::uint64_t(0);
    // Tiles outside, overlapping, twice, out of line, with a gap.
    check([](Index& i) { i.tiles[0].offset = kHuge - 7; }, "tile face 0 (0, 0): ");
    check([](Index& i) { i.tiles[0].offset = std::uint64_t(1) << 62; }, "do not lie");
    check([](Index& i) { i.tiles[2].offset += 1; }, "no multiple of 8");
    check([](Index& i) { i.tiles[0].offset = 8; }, "do not lie");
    check([](Index& i) { i.tiles[0].length = kHuge; }, "tile face 0 (0, 0): ");
    check([](Index& i) { i.tiles[0].length = kHuge - 32; }, "tile face 0 (0, 0): ");
    check([](Index& i) { i.tiles[1] = i.tiles[0]; }, "tile face 0 (1, 0) at offset");
    check([](Index& i) { i.tiles[1].offset = i.tiles[0].offset + 8; }, "overlaps");
    check([](Index& i) { i.tiles[3] = {}; }, "leaves a gap");
    check([](Index& i) { std::swap(i.tiles[1], i.tiles[2]); }, "calls itself");
    check([](Index& i) { i.tiles[3].offset = 0; }, "not all zero");
    // Counts that cannot be, or that the tile does not have.
    check([](Index& i) { i.tiles[0].layers = 0; }, "no layers");
    check([](Index& i) { i.tiles[0].layers += 1; }, "layers, the index says");
    check([](Index& i) { i.tiles[0].layers = 0xffffffff; }, "more than 1048576 each");
    check([](Index& i) { i.tiles[0].planes = 4; }, "unknown planes");
    check([](Index& i) { i.tiles[0].length -= 8; }, "leaves a gap");
    // Not the block's own header.
    check([](Index& i) { i.tiles[0].payloadChecksum ^= 1; }, "not the index's");
    check([](Index& i) { i.blocks[0].payloadChecksum ^= 1; }, "not the index's");
    check([](Index& i) { i.blocks[0].length -= 1; }, "block HEAD at offset 64");
    check([](Index& i) { i.blocks[0].flags = 0; }, "flags 0 are not those of its type");
    check([](Index& i) { i.blocks[1].flags = 1; }, "flags 1 are not those of its type");
    check([](Index& i) { i.blocks[0].flags = 3; }, "unknown flags");
    check([](Index& i) { std::swap(i.blocks[2].type, i.blocks[3].type); }, "block HIER");
    // Blocks that are missing, twice, or not where they belong.
    check([](Index& i) { i.blocks.erase(i.blocks.begin()); }, "0 blocks HEAD");
    check([](Index& i) { i.blocks.pop_back(); }, "0 blocks TOTL");
    check([](Index& i) { i.blocks.push_back(i.blocks.back()); }, "order of the file");
    check([](Index& i) { i.blocks[1].offset = kHuge - 7; }, "block ATTR: ");
    check([](Index& i) { i.blocks[1].type = kTile; }, "no place in the directory");
    check([](Index& i) { i.blocks[1].type = kIndx; }, "no place in the directory");
    check([](Index& i) { std::swap(i.blocks[0], i.blocks[1]); }, "order of the file");
}

TEST_CASE("a tile with other planes than the index says is refused",
          "[format][bad-input]") {
    Surgery s(encoded(smallMap(1, 1, true)));
    s.onIndex = [](Index& i) {
        for (TileEntry& tile : i.tiles) {
            if (tile.offset) tile.planes = kHasN;
        }
    };
    checkRefused(s.close(), ErrorCode::badFile, "has planes 0, the index says 2");
}

TEST_CASE("an index with wrong sizes is refused", "[format][bad-input]") {
    const auto check = [](const std::function<void(IndexFixed&)>& change,
                          const std::string& words) {
        Surgery s(plainFile());
        s.onIndexFixed = change;
        checkRefused(s.close(), ErrorCode::badFile, words);
    };
    check([](IndexFixed& i) { i.tiles = 5; }, "index: lists 5 tiles, not 4");
    check([](IndexFixed& i) { i.tiles = ~std::uint64_t(0); }, "lists");
    check([](IndexFixed& i) { i.blocks = 0xffffffff; }, "lists");
    check([](IndexFixed& i) { i.blocks += 1; }, "has ");
    check([](IndexFixed& i) { i.reserved = 1; }, "reserved");
    check([](IndexFixed& i) { i.prefixChecksum ^= 1; }, "another prefix");
}

TEST_CASE("a block of another file is refused although its checksums are right",
          "[format][bad-input]") {
    NoisySpec spec;
    spec.emptyTiles = 0.0;
    const Bytes a = encoded(noisyMap(spec), Codec::none);
    Surgery s(a);
    Bytes& tile = s.payload(kTile, 3);  // its last number is the n of its last layer
    REQUIRE(peek<PlaneRecord>(tile, Surgery::planeAt(3)).elementSize == 4);
    edit<std::uint32_t>(tile, tile.size() - 4, [](std::uint32_t& n) { n += 1; });
    const Bytes other = s.close();
    REQUIRE(readBytes(other));
    REQUIRE(other.size() == a.size());
    // As if the writing of `other` over `a` had stopped before the index.
    const auto index = peek<Trailer>(a, a.size() - 32).indexOffset;
    Bytes b = a;
    std::copy(other.begin(), other.begin() + long(index), b.begin());
    checkRefused(b, ErrorCode::badFile, "tile face 0 (1, 1) at offset");
}

TEST_CASE("unknown blocks: critical ones are refused, others are passed over but checked",
          "[format][bad-input]") {
    const Bytes file = plainFile();
    for (std::size_t size : {0u, 1u, 8u, 200000u}) {
        Surgery s(file);
        s.parts.insert(s.parts.end() - 1, {{'x', '\0', 'z', '\x1b'}, 0, Bytes(size, 7)});
        Bytes with = s.close();
        REQUIRE(readBytes(with));
        CHECK(identical(*readBytes(with), *readBytes(file)));
        // Its content, its padding and its header are checked all the same.
        const auto at = std::search(with.begin(), with.end(), "x\0z\x1b", "x\0z\x1b" + 4);
        const auto offset = std::size_t(at - with.begin());
        for (std::size_t i = 0; i<33 + size; i += size> 8 ? 9973 : 1) {
            if (offset + i >= with.size() || (size % 8 == 0 && i >= 32 + size)) break;
            with[offset + i] ^= 1;
            checkRefused(with, ErrorCode::badFile, "block x\\x00z\\x1b at offset");
            with[offset + i] ^= 1;
        }
        s.part({'x', '\0', 'z', '\x1b'}).flags = kCritical;
        checkRefused(s.close(), ErrorCode::unsupported, "a newer libmtsm is needed");
    }
}

// --- HEAD, ATTR, TOTL, HIER
// ----------------------------------------------------------------

TEST_CASE("a head that lies is refused", "[format][bad-input]") {
    const auto check = [](std::size_t offset, auto value, ErrorCode code,
                          const std::string& words) {
        Surgery s(plainFile());
        poke(s.payload(kHead), offset, value);
        checkRefused(s.close(), code, words);
    };
    const double nan = std::nan("");
    const auto bad = ErrorCode::badFile;
    check(0, 1u, ErrorCode::unsupported, "depth meaning 1");
    check(4, 2u, ErrorCode::unsupported, "visibility rule 2");
    check(8, 5u, bad, "light shape 5");
    check(12, std::nanf(""), bad, "bias");
    check(16, nan, bad, "position");
    check(120, std::nanf(""), bad, "bias");
    check(124, 1.5f, bad, "tolerance");
    check(136, -1.0, bad, "metres per unit");
    check(144, 2u, bad, "projection kind 2");
    check(148, 1u, bad, "face 0: reserved");
    check(152, nan, bad, "face 0: the eye");
    check(144 + 104, -1.0, bad, "face 0: raster scale");
    check(296, 0xffffffffu, bad, "\"software\" reaches past the end");
    check(300, std::uint8_t(0xff), bad, "\"software\" is not UTF-8");
    for (std::size_t size : {0u, 100u, 144u, 200u, 298u, 303u}) {
        Surgery s(plainFile());
        s.payload(kHead).resize(size);
        checkRefused(s.close(), bad, "block HEAD at offset 64: ");
    }
}

TEST_CASE("attributes that lie are refused", "[format][bad-input]") {
    const auto check = [](const std::function<void(Bytes&)>& change,
                          const std::string& words) {
        Surgery s(plainFile());
        change(s.payload(kAttr));
        checkRefused(s.close(), ErrorCode::badFile, words);
    };
    const auto record = [&](const std::function<void(AttributeRecord&)>& change,
                            const std::string& words) {
        check([&](Bytes& b) { edit<AttributeRecord>(b, 8, change); }, words);
    };
    check([](Bytes& b) { poke(b, 0, 0xffffffffu); }, "attribute 3 of 4294967295");
    check([](Bytes& b) { poke(b, 0, 2u); }, "left over");
    check([](Bytes& b) { poke(b, 4, 1u); }, "reserved");
    check([](Bytes& b) { b.resize(7); }, "fewer than 8");
    record([](AttributeRecord& r) { r.valueLength = ~std::uint64_t(0); }, "reaches past");
    record([](AttributeRecord& r) { r.valueLength = ~std::uint64_t(0) - 20; },
           "past the");
    record([](AttributeRecord& r) { r.type = 3; }, "unknown type 3");
    record([](AttributeRecord& r) { r.type = 1; }, "an integer of 5 bytes");
    record([](AttributeRecord& r) { r.type = 2; }, "no multiple of 8");
    record([](AttributeRecord& r) { r.reserved[5] = 1; }, "reserved");
    record([](AttributeRecord& r) { r.nameLength = 0, r.valueLength += 4; }, "is empty");
    check([](Bytes& b) { b[24] = 0xff; }, "not UTF-8");
    // "frame" becomes a second "shot": found by the map itself.
    check(
        [](Bytes& b) {
            const Bytes first(b.begin() + 8, b.begin() + 8 + 16 + 9);
            b.insert(b.begin() + 8, first.begin(), first.end());
            poke(b, 0, 4u);
        },
        "\"shot\" is there twice");
    // Also when nobody here knows the type of the first.
    Surgery s(plainFile());
    s.prefix.versionMinor = 1;
    Bytes& b = s.payload(kAttr);
    Bytes first(b.begin() + 8, b.begin() + 8 + 16 + 9);
    first[0] = 77;
    b.insert(b.begin() + 8, first.begin(), first.end());
    poke(b, 0, 4u);
    checkRefused(s.close(), ErrorCode::unsupported, "\"shot\" is there twice");
}

TEST_CASE("a message quotes no control characters of a file", "[format][bad-input]") {
    Surgery s(plainFile());
    Bytes& b = s.payload(kAttr);
    edit<AttributeRecord>(b, 8, [](AttributeRecord& r) { r.type = 3; });
    poke(b, 24, std::array<char, 4>{'\x1b', '\n', '\xc2', '\x9b'});
    checkRefused(s.close(), ErrorCode::badFile, "attribute \"\\x1b\\n\\xc2\\x9b");
}

TEST_CASE("totals that are not those of the tiles are refused", "[format][bad-input]") {
    const auto check = [](const std::function<void(Totals&)>& change,
                          const std::string& words) {
        Surgery s(plainFile());
        edit<Totals>(s.payload(kTotl), 0, change);
        checkRefused(s.close(), ErrorCode::badFile, words);
    };
    check([](Totals& t) { t.layers += 1; }, "block TOTL at offset");
    check([](Totals& t) { t.z.min = std::nextafter(t.z.min, 0.0f); }, "says depths from");
    check([](Totals& t) { t.z.max = INFINITY; }, "says depths from");
    check([](Totals& t) { t.flags = 2; }, "unknown flags 2");
    check([](Totals& t) { t.toleranceReached = -1; }, "tolerance");
    Surgery s(plainFile());
    s.payload(kTotl).pop_back();
    checkRefused(s.close(), ErrorCode::badFile, "fewer than 40");
}

TEST_CASE("a hierarchy that is not exactly that of the tiles is refused",
          "[format][bad-input]") {
    Surgery s(plainFile());
    const std::size_t size = s.payload(kHier).size();
    REQUIRE(size == 8 + 5 * 8);  // 2 x 2 tiles and their parent
    for (std::size_t at = 8; at < size; at += 4) {
        for (float other : {std::nanf(""), 0.0f, -INFINITY, INFINITY, 1e-30f}) {
            Surgery changed = s;
            poke(changed.payload(kHier), at, other);
            checkRefused(changed.close(), ErrorCode::badFile, "block HIER at offset");
        }
    }
    for (std::size_t at : {0u, 4u}) {
        Surgery changed = s;
        poke(changed.payload(kHier), at, 7u);
        checkRefused(changed.close(), ErrorCode::badFile, "faces and");
    }
    s.payload(kHier).resize(size + 8);
    checkRefused(s.close(), ErrorCode::badFile, "block HIER: has 56 bytes, not 48");
}

// --- tiles
// ---------------------------------------------------------------------------------

TEST_CASE("a tile's record that lies is refused", "[format][bad-input]") {
    const auto check = [](const EditTile& change, const std::string& words) {
        checkRefused(withTile(change), ErrorCode::badFile, words);
    };
    check([](TileRecord& t) { t.width = 7; }, "has 7 x 8 pixels, not 8 x 8");
    check([](TileRecord& t) { t.height = 0xffff; }, "8 x 65535");
    check([](TileRecord& t) { t.planeCount = 0xffffffff; }, "4294967295 planes");
    check([](TileRecord& t) { t.planeCount = 3; }, "3 planes, not 4");
    check([](TileRecord& t) { t.reserved = 1; }, "reserved");
    check([](TileRecord& t) { t.layers += 1; }, "plane z: claims");
    check([](TileRecord& t) { t.face = 1; }, "index");
}

TEST_CASE("a plane's record that lies is refused", "[format][bad-input]") {
    const auto check = [](int plane, const EditPlane& change, const std::string& words) {
        checkRefused(withPlane(plane, change), ErrorCode::badFile, words);
    };
    constexpr std::uint64_t kHuge = ~std::uint64_t(0);
    check(
        1, [](PlaneRecord& r) { r.kind = 2; }, "plane z: is announced as kind 2");
    check(
        2, [](PlaneRecord& r) { r.channel = 1; }, "plane v of channel 0: is announced");
    check(
        1, [](PlaneRecord& r) { r.encoding = 3; }, "unknown encoding 3");
    check(
        1, [](PlaneRecord& r) { r.filter = 4; }, "unknown filter 4");
    check(
        0, [](PlaneRecord& r) { r.filter = 2; }, "filter 2 on");
    check(
        0, [](PlaneRecord& r) { r.filter = 1; }, "shuffle filter on");
    check(
        1, [](PlaneRecord& r) { r.shift = 32; }, "shift 32");
    check(
        0, [](PlaneRecord& r) { r.shift = 1; }, "shift 1 with filter 0");
    check(
        1, [](PlaneRecord& r) { r.elementSize = 2; }, "elements of 2 bytes");
    check(
        0, [](PlaneRecord& r) { r.elementSize = 3; }, "elements of 3 bytes");
    check(
        0, [](PlaneRecord& r) { r.elementSize = 0; }, "elements of 0 bytes");
    check(
        1, [](PlaneRecord& r) { r.decodedLength = kHuge; }, "plane z: claims");
    check(
        0, [](PlaneRecord& r) { r.decodedLength = 65; }, "plane counts: claims 65");
    check(
        1, [](PlaneRecord& r) { r.storedLength = kHuge; }, "plane z: stores");
    check(
        1, [](PlaneRecord& r) { r.storedLength = r.decodedLength; }, "plane z: stores");
    check(
        1, [](PlaneRecord& r) { r.storedLength -= 1; }, "plane z: ");
    check(
        3, [](PlaneRecord& r) { r.storedLength -= 1; }, "plane n: ");
    check(
        1, [](PlaneRecord& r) { r.reserved[0] = 1; }, "reserved");
    check(
        1, [](PlaneRecord& r) { r.reserved2 = 1; }, "reserved");
    check(
        1, [](PlaneRecord& r) { r.constant = 1; }, "a constant on a plane");
    // A plane that turns into a constant leaves its bytes behind.
    check(
        3,
        [](PlaneRecord& r) {
            r.encoding = 1, r.filter = 0, r.constant = 1, r.storedLength = 0;
        },
        "left over");
    check(
        0,
        [](PlaneRecord& r) {
            r.encoding = 1, r.filter = 0, r.constant = 256, r.storedLength = 0;
        },
        "does not fit in 1 bytes");
}

TEST_CASE("a constant plane may not claim more layers than there are",
          "[format][bad-input]") {
    // A tile of 8 x 8 pixels, all planes constant: 64 x `count` layers from no bytes.
    const auto file = [](std::uint32_t count, std::uint32_t layers) {
        Surgery s(plainFile());
        s.parts.erase(std::remove_if(s.parts.begin(), s.parts.end(),
                                     [](const auto& p) { return p.type == kTile; }),
                      s.parts.end());
        TileRecord t = {};
        t.width = t.height = 8;
        t.layers = layers;
        t.planeCount = 2;
        PlaneRecord counts = {}, z = {};
        counts.encoding = z.encoding = std::uint8_t(PlaneEncoding::constant);
        z.kind = std::uint8_t(PlaneKind::z);
        counts.elementSize = z.elementSize = 4;
        counts.constant = count;
        counts.decodedLength = 64 * 4;
        z.constant = 0x3f800000;
        z.decodedLength = std::uint64_t(layers) * 4;
        Bytes payload;
        base::ByteWriter out(payload);
        out.put(t);
        out.put(counts);
        out.put(z);
        s.parts.insert(s.parts.begin() + 1, {kTile, kCritical, payload});
        return s.close();
    };
    checkRefused(file(3, 64 * 3), ErrorCode::badFile, "block TOTL");  // all else is right
    checkRefused(file(3, 64 * 3 + 1), ErrorCode::badFile, "add up to fewer");
    checkRefused(file(4, 64 * 3), ErrorCode::badFile, "add up to more");
    checkRefused(file(0x80000001u, 64), ErrorCode::badFile, "add up to more");
    checkRefused(file(kMaxPixelLayers + 1, 64 * (kMaxPixelLayers + 1)),
                 ErrorCode::badFile, "more than 1048576 each");
    // 256 MiB of layers from a kilobyte: a limit stops it before memory is taken.
    ReadLimits limits;
    limits.maxBytes = 64 << 20;
    checkRefused(file(kMaxPixelLayers, 64 * kMaxPixelLayers), ErrorCode::tooLarge,
                 "ReadLimits::maxBytes", limits);
}

TEST_CASE("a zstd frame that is not what its plane says is refused",
          "[format][bad-input]") {
    // Plane n, the last one, gets another frame; its record says the stored size.
    const auto file = [](const Bytes& frame) {
        Surgery s(plainFile());
        Bytes& tile = s.payload(kTile);
        const auto n = peek<PlaneRecord>(tile, Surgery::planeAt(3));
        tile.resize(tile.size() - n.storedLength);
        tile.insert(tile.end(), frame.begin(), frame.end());
        edit<PlaneRecord>(tile, Surgery::planeAt(3), [&](PlaneRecord& r) {
            r.encoding = std::uint8_t(PlaneEncoding::zstd);
            r.filter = 0;
            r.storedLength = frame.size();
        });
        return s.close();
    };
    const auto decoded =
        peek<PlaneRecord>(Surgery(plainFile()).payload(kTile), Surgery::planeAt(3))
            .decodedLength;
    const auto compress = [](std::uint64_t size, bool sizeInFrame) {
        const Bytes content(size, 1);
        Bytes frame(ZSTD_compressBound(size));
        ZSTD_CCtx* c = ZSTD_createCCtx();
        ZSTD_CCtx_setParameter(c, ZSTD_c_contentSizeFlag, sizeInFrame);
        frame.resize(ZSTD_compress2(c, frame.data(), frame.size(), content.data(), size));
        ZSTD_freeCCtx(c);
        return frame;
    };
    const auto refused = [&](const Bytes& frame, const std::string& words) {
        checkRefused(file(frame), ErrorCode::badFile, "plane n: " + words);
    };
    const Bytes good = compress(decoded, true);
    REQUIRE(readBytes(file(good)));
    refused(compress(decoded + 1, true), "a zstd frame of");
    refused(compress(decoded - 1, true), "a zstd frame of");
    refused(compress(0, true), "a zstd frame of");
    refused(compress(std::uint64_t(1) << 24, true), "a zstd frame of 16777216 bytes");
    refused(compress(decoded, false), "no zstd frame that states");
    refused(Bytes(20, 0), "no zstd frame");
    refused({}, "no zstd frame");
    Bytes two = good;  // an empty skippable frame behind it
    two.insert(two.end(), {0x50, 0x2a, 0x4d, 0x18, 0, 0, 0, 0});
    refused(two, "more or less than one zstd frame");
    refused(Bytes(good.begin(), good.end() - 1), "more or less than one zstd frame");
    Bytes claims = {0x28, 0xb5, 0x2f, 0xfd, 0xe0, 0xff, 0xff, 0xff,
                    0xff, 0xff, 0xff, 0xff, 0x7f, 0x01, 0,    0};
    refused(claims, "a zstd frame of 9223372036854775807 bytes");
    // A dictionary's id of 0 is none [RFC 8878, 3.1.1.1.3]; another one is not there.
    Bytes withId = good;
    REQUIRE((good[4] & 3) == 0);
    withId[4] |= 1;
    const bool window = (good[4] & 0x20) == 0;
    withId.insert(withId.begin() + 5 + window, 0);
    CHECK(readBytes(file(withId)));
    withId[std::size_t(5 + window)] = 9;
    CHECK_FALSE(readBytes(file(withId)));
    Bytes broken = good;
    broken[broken.size() / 2] ^= 0x55;
    const auto map = readBytes(file(broken));
    CHECK_FALSE(map);
}

TEST_CASE("layers that no map may have are refused with the file's name",
          "[format][bad-input]") {
    const Bytes raw = plainFile(Codec::none);
    const std::size_t z =
        Surgery::planeAt(4) +
        peek<PlaneRecord>(Surgery(raw).payload(kTile), Surgery::planeAt(0)).storedLength;
    for (float depth : {std::nanf(""), INFINITY, -INFINITY, 0.0f, -1.0f, 1e30f}) {
        Surgery s(raw);
        poke(s.payload(kTile), z, depth);
        checkRefused(s.close(), ErrorCode::badFile, "face 0, tile (0, 0), pixel ");
    }
    const std::size_t v =
        z +
        peek<PlaneRecord>(Surgery(raw).payload(kTile), Surgery::planeAt(1)).storedLength;
    for (float visibility : {std::nanf(""), -0.5f, 1.5f}) {
        Surgery s(raw);
        poke(s.payload(kTile), v, visibility);
        checkRefused(s.close(), ErrorCode::badFile, "visibility");
    }
}

TEST_CASE("random changes behind right checksums give an error or a map, never a crash",
          "[format][bad-input]") {
    std::mt19937_64 random(5);
    const auto below = [&](std::uint64_t n) { return random() % n; };
    const auto change = [&](Bytes& bytes) {
        if (bytes.empty()) return;
        const std::size_t at = below(bytes.size());
        switch (below(4)) {
            case 0:
                bytes[at] ^= std::uint8_t(1u << below(8));
                break;
            case 1:
                bytes[at] = std::uint8_t(random());
                break;
            case 2:  // a number at its end
                for (std::size_t i = at & ~7u, n = 1u << below(4);
                     n-- && i < bytes.size();)
                    bytes[i++] = 0xff;
                break;
            default:
                bytes.resize(below(2) ? at : bytes.size() + at % 40);
        }
    };
    ReadLimits limits;
    limits.maxBytes = 16 << 20;
    const Bytes files[] = {plainFile(), plainFile(Codec::none),
                           encoded(smallMap(6, 3, false)), encoded(smallMap(1, 1, true))};
    int read = 0, refused = 0;
    for (int i = 0; i < 4000; ++i) {
        Surgery s(files[i % 4]);
        for (std::uint64_t n = 1 + below(3); n > 0; --n) {
            if (below(8) == 0) {
                s.onIndex = [&](Index& index) {
                    Bytes b(sizeof(TileEntry));
                    TileEntry& e = index.tiles[below(index.tiles.size())];
                    std::memcpy(b.data(), &e, b.size());
                    change(b);
                    b.resize(sizeof e);
                    std::memcpy(&e, b.data(), b.size());
                };
            } else {
                change(s.parts[below(s.parts.size())].payload);
            }
        }
        (readBytes(s.close(), limits) ? read : refused) += 1;
    }
    CHECK(refused > 1000);
    CHECK(read > 10);  // some changes, of a text for example, are only other content
}

// --- limits and files
// ----------------------------------------------------------------------

TEST_CASE("limits are exact, name themselves and cost nothing", "[format][bad-input]") {
    for (bool opaque : {false, true}) {
        const ShadowMap map = smallMap(6, 3, opaque);
        const Bytes file = encoded(map);
        const ShadowMap back = *readBytes(file);
        ReadLimits limits;
        limits.maxBytes = back.memoryBytes() + largestTileWork(file);
        limits.maxPixels = 6 * 11 * 9;
        const auto onThreads = [&](int threads) {
            tbb::task_arena arena(threads);
            return arena.execute([&] { return readBytes(file, limits); });
        };
        const tbb::global_control allow(tbb::global_control::max_allowed_parallelism, 2);
        CHECK(onThreads(1));
        CHECK_FALSE(onThreads(2));
        limits.maxBytes -= 1;
        CHECK_FALSE(onThreads(1));
        limits.maxBytes += 1 + largestTileWork(file);
        CHECK(onThreads(2));
        limits.maxBytes = back.memoryBytes();  // nothing left for the work
        checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
        limits.maxBytes = 1000;
        checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes", limits);
        limits = {};
        limits.maxPixels = 6 * 11 * 9 - 1;
        checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxPixels", limits);
        limits = {};
        limits.maxAttributeBytes = 20;
        checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxAttributeBytes", limits);
        limits.maxAttributeBytes = 300;
        CHECK(readBytes(file, limits));
        Surgery s(file);  // a later version may make TOTL longer, but not without limit
        s.prefix.versionMinor = 1;
        s.payload(kTotl).resize(1000);
        CHECK(readBytes(s.close()));
        checkRefused(s.close(), ErrorCode::tooLarge, "ReadLimits::maxAttributeBytes",
                     limits);
    }
    // 6 x 2^30 pixels by the prefix: refused before the index is even looked for.
    Bytes file = plainFile();
    edit<Prefix>(file, 0, [](Prefix& p) {
        p.width = p.height = 32768;
        p.faces = 6;
        p.checksum = Surgery::seal(p);
    });
    ReadLimits limits;
    limits.maxPixels -= 1;
    checkRefused(file, ErrorCode::tooLarge, "6442450944 pixels", limits);
    limits = {};  // the default refuses no resolution as such
    limits.maxBytes = ~std::uint64_t(0);
    checkRefused(file, ErrorCode::badFile, "index", limits);
    checkRefused(file, ErrorCode::tooLarge, "ReadLimits::maxBytes");
}

TEST_CASE("what is no map file gives one clear message", "[format][bad-input]") {
    const TempFolder folder;
    const auto check = [](const std::string& path, ErrorCode code,
                          const std::string& words) {
        const auto map = readMap(path);
        REQUIRE_FALSE(map);
        CHECK(map.error().code == code);
        CHECK_THAT(map.error().message, Catch::StartsWith(path + ": "));
        CHECK_THAT(map.error().message, Catch::Contains(words));
    };
    check(folder / "missing.mtsm", ErrorCode::io, "No such file");
    check(folder.path(), ErrorCode::io, "is a folder");
    const std::string pipe = folder / "pipe";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    check(pipe, ErrorCode::io, "is a pipe");
    check("/dev/null", ErrorCode::io, "is a device");
    std::ofstream(folder / "empty.mtsm").close();
    check(folder / "empty.mtsm", ErrorCode::badFile, "is empty");
    std::ofstream(folder / "text.mtsm") << "solid nothing\n";
    check(folder / "text.mtsm", ErrorCode::badFile, "is not an MTSM file");
    // A sparse terabyte costs nothing to refuse.
    const Bytes file = plainFile();
    const std::string sparse = folder / "sparse.mtsm";
    std::ofstream(sparse, std::ios::binary)
        .write(reinterpret_cast<const char*>(file.data()), long(file.size()));
    if (::truncate(sparse.c_str(), off_t(1) << 40) == 0)
        check(sparse, ErrorCode::badFile, "trailer: no finished mark");
}
