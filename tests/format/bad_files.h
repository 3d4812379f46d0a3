// bad_files.h - small files that every reader has to refuse. Those in tests/bad are
// written from here; whatever else ever breaks a reader is put beside them.
#pragma once
#include <map>
#include <string>
#include <vector>

#include "format/file_surgery.h"
#include "map_fixture.h"
#include "mtsm/writer.h"

namespace mtsm::test {

struct BadFile {
    std::string name;  ///< begins with "bad_" (exit code 4) or "unsupported_" (5)
    Bytes bytes;
};

/// What the two readers have to say of a file, so that each fails for its own reason.
struct BadWords {
    std::string readMap, readerPy;
};
inline const std::map<std::string, BadWords>& badWords() {
    static const std::map<std::string, BadWords> words = {
        {"bad_empty", {"is empty", "is empty"}},
        {"bad_cut_in_half", {"no finished mark", "no finished mark"}},
        {"bad_no_trailer", {"no finished mark", "no finished mark"}},
        {"bad_byte_behind_the_end", {"no finished mark", "no finished mark"}},
        {"bad_flipped_bit_in_a_tile",
         {"tile face 0 (0, 0) at offset 576: the content is damaged",
          "tile face 0 (0, 0) at offset 576: the content is damaged"}},
        {"unsupported_major_version", {"format version 2.0", "format version 2.0"}},
        {"unsupported_critical_block", {"NEED", "NEED"}},
        {"unsupported_visibility_rule", {"visibility rule 2", "visibility rule 2"}},
        {"bad_prefix_of_nine_faces", {"prefix: 9 faces", "prefix: 9 faces"}},
        {"bad_tile_twice", {"index: tile face 0 (1, 0)", "index: tile face 0 (1, 0)"}},
        {"bad_tile_outside",
         {"offset 18446744073709551608 do not lie between", "index: tile face 0"}},
        {"bad_tiles_swapped", {"index: tile face 0 (1, 0)", "says other than the index"}},
        {"bad_tile_left_out",
         {"leaves a gap", "index: tile face 0 (1, 1) at offset 2248, not 1936"}},
        {"bad_index_of_other_prefix", {"another prefix", "another prefix"}},
        {"bad_hierarchy", {"block HIER at offset", "block HIER: is not that"}},
        {"bad_total_of_layers", {"says 18446744073709551615 layers", "number of layers"}},
        {"bad_attribute_length",
         {"attribute 0 of 3 reaches past", "block ATTR at offset 432: reaches past"}},
        {"bad_text_not_utf8", {"\"software\" is not UTF-8", "not UTF-8"}},
        {"bad_counts_do_not_add_up", {"add up to more", "do not add up"}},
        {"bad_depth_is_nan", {"depth nan", "depth nan"}},
        {"bad_plane_claims_too_much",
         {"claims 4611686018427387904", "decoded length 4611686018427387904"}},
        {"bad_constant_claims_too_much", {"add up to more", "do not add up"}},
        {"bad_filter_without_compression",
         {"not compressed", "filter without compression"}},
        {"bad_zstd_frame", {"no zstd frame", "no zstd frame"}},
        {"bad_near_cut",
         {"part 0: reaches past the end", "block NEAR at offset 576: reaches past"}},
        {"bad_near_chunks_absurd",
         {"claims 1152921504606846976 chunks", "more chunks than --max-bytes"}},
        {"bad_near_points_absurd",
         {"claims 4294967295 points for 1 chunks", "4294967295 points"}},
        {"bad_near_corner_of_no_point", {"corner 5 is a point 4 before", "corner 5"}},
        {"bad_near_not_finite",
         {"near field: chunk 0, axis v: starts at 0 with steps of inf", "step"}},
        {"bad_near_twice", {"2 blocks NEAR", "more than one block"}},
        {"bad_hair_cut",
         {"part 0: reaches past the end", "block HAIR at offset 576: reaches past"}},
        {"bad_hair_chunks_absurd",
         {"claims 1152921504606846976 chunks", "more chunks than --max-bytes"}},
        {"bad_hair_has_points", {"claims 3 points for 1 chunks", "3 points"}},
        {"bad_hair_too_wide",
         {"near field: chunk 0 of strands: steps of 0.00390625 in width", "halfStep"}},
        {"bad_hair_twice", {"2 blocks HAIR", "more than one block"}},
        {"bad_card_cut",
         {"its triangles reach past the end", "block CARD at offset 576: reaches past"}},
        {"bad_card_textures_absurd",
         {"claims 4294967295 textures", "block CARD at offset 576: reaches past"}},
        {"bad_card_texture_too_large",
         {"texture 0: 16385 x 1 texels", "16385 x 1 texels"}},
        {"bad_card_texture_of_none", {"has texture 7 of 1", "texture 7"}},
        {"bad_card_twice", {"2 blocks CARD", "more than one block"}},
        {"bad_tree_cut", {"ends within what it says", "block TREE at offset"}},
        {"bad_tree_of_other_kind", {"trees of kind 1, the map's are 0", "kind 1"}},
        {"bad_tree_groups_absurd", {"268435456 groups", "268435456 groups"}},
        {"bad_tree_list_of_nothing",
         {"tile 0 of level 0: a list of", "a list of what is not there"}},
        {"bad_tree_twice", {"2 blocks TREE", "more than one block"}},
        {"unsupported_newer_encoding",
         {"version 1.1, newer than the 1.0 that this reader knows: tile face 0 (0, 0) at "
          "offset 576: plane z: unknown encoding 3",
          "version 1.1, newer than the 1.0"}},
    };
    return words;
}

/// A near field of one triangle, written by hand: (0, 0, 0.5), (8, 0, 0.5), (0, 8, 1).
inline Bytes handmadeNear() {
    Bytes near;
    base::ByteWriter out(near);
    out.put(format::NearFixed{1, 7});
    out.put(std::uint64_t(1));         // chunks
    out.put(format::NearPart{3, 90});  // points; as it is
    // low 0, 0, 0.5 (3f000000), step 1 (3f800000), 1, 0.5: byte 0 of all first.
    out.zeros(6 + 6);
    out.bytes(std::vector<std::uint8_t>{0, 0, 0, 0x80, 0x80, 0});
    out.bytes(std::vector<std::uint8_t>{0, 0, 0x3f, 0x3f, 0x3f, 0x3f});
    out.zeros(3);  // three new points, then the same again
    for (int triangle = 1; triangle < 16; ++triangle)
        out.bytes(std::vector<std::uint8_t>{3, 2, 1});
    // Zigzag of what u, v and w change by from point to point: +8 is 16, -8 is 15.
    out.bytes(std::vector<std::uint8_t>{0, 16, 15, 0, 0, 16, 0, 0, 2});
    out.zeros(9);
    return near;
}

/// A near field of one segment, written by hand: from (0, 0, 0.5) to (8, 0, 0.5), half
/// over depth 1/512 at the first end and 1/256 at the second, opacity 0.4.
inline Bytes handmadeHair() {
    Bytes hair;
    base::ByteWriter out(hair);
    out.put(format::NearFixed{1, 7});
    out.put(std::uint64_t(1));          // chunks
    out.put(format::NearPart{0, 284});  // as it is
    // low 0, 0, 0.5 (3f000000), step 1 (3f800000), 1, 0.5, halfStep 2^-9 (3b000000): byte
    // 0 of all first.
    out.zeros(7 + 7);
    out.bytes(std::vector<std::uint8_t>{0, 0, 0, 0x80, 0x80, 0, 0});
    out.bytes(std::vector<std::uint8_t>{0, 0, 0x3f, 0x3f, 0x3f, 0x3f, 0x3b});
    // Byte 0 of all words: b.u is zigzag(8), opacity 26214 = 0x6666.
    Bytes words(7 * 16);
    words[3 * 16] = 16;
    words[6 * 16] = 0x66;
    out.bytes(words);
    words[3 * 16] = 0;
    out.bytes(words);
    Bytes halves(2 * 16);
    halves[0] = 1;
    halves[16] = 2;
    out.bytes(halves);
    return hair;
}

/// Near sheets of the same triangle, half opaque, written by hand.
inline Bytes handmadeCards() {
    Bytes cards;
    base::ByteWriter out(cards);
    out.put(std::uint32_t(1));
    out.put(format::CardTexture{1, 1, 0, 0, -1.0f, 0.5f, 1});
    out.put(std::uint8_t(255));
    const Bytes triangles = handmadeNear();
    out.put(std::uint64_t(triangles.size()));
    out.bytes(triangles);
    out.put(format::NearFixed{1, 7});
    out.put(std::uint64_t(1));                               // chunks
    out.put(format::NearPart{0, 216});                       // as it is
    out.bytes(std::vector<std::uint8_t>{0, 1, 0, 0, 0, 0});  // texture 0, one triangle
    out.zeros(18 + 192);
    return cards;
}

/// All checksums are right wherever the name does not say otherwise.
inline std::vector<BadFile> badFiles() {
    NoisySpec spec;
    spec.emptyTiles = 0.0;
    spec.width = spec.height = 9;
    spec.mostLayers = 2;
    const auto encoded = [&](Codec codec) {
        WriteOptions options;
        options.codec = codec;
        return *encodeMap(noisyMap(spec), options);
    };
    const Bytes good = encoded(Codec::none);
    std::vector<BadFile> all;
    const auto add = [&](const std::string& name,
                         const std::function<void(Surgery&)>& cut) {
        Surgery s(good);
        cut(s);
        all.push_back({name, s.close()});
    };
    using namespace format;
    const auto plane = [](Surgery& s, int n, const std::function<void(PlaneRecord&)>& f) {
        edit<PlaneRecord>(s.payload(kTile), Surgery::planeAt(n), f);
    };
    const std::size_t firstPlane = Surgery::planeAt(4);

    all.push_back({"bad_empty", {}});
    all.push_back(
        {"bad_cut_in_half", Bytes(good.begin(), good.begin() + long(good.size() / 2))});
    all.push_back({"bad_no_trailer", Bytes(good.begin(), good.end() - 32)});
    all.push_back({"bad_byte_behind_the_end", good});
    all.back().bytes.push_back(0);
    all.push_back({"bad_flipped_bit_in_a_tile", good});
    all.back().bytes[1000] ^= 0x20;
    add("unsupported_major_version", [](Surgery& s) { s.prefix.versionMajor = 2; });
    add("unsupported_critical_block", [](Surgery& s) {
        s.parts.insert(s.parts.begin() + 1,
                       {{'N', 'E', 'E', 'D'}, kCritical, Bytes(5, 1)});
    });
    add("unsupported_visibility_rule", [](Surgery& s) { poke(s.payload(kHead), 4, 2u); });
    add("bad_prefix_of_nine_faces", [](Surgery& s) { s.prefix.faces = 9; });
    add("bad_tile_twice",
        [](Surgery& s) { s.onIndex = [](Index& i) { i.tiles[1] = i.tiles[0]; }; });
    add("bad_tile_outside", [](Surgery& s) {
        s.onIndex = [](Index& i) { i.tiles[0].offset = ~std::uint64_t(7); };
    });
    add("bad_tiles_swapped", [](Surgery& s) {
        s.onIndex = [](Index& i) { std::swap(i.tiles[0], i.tiles[1]); };
    });
    add("bad_tile_left_out",
        [](Surgery& s) { s.onIndex = [](Index& i) { i.tiles[2] = {}; }; });
    add("bad_index_of_other_prefix", [](Surgery& s) {
        s.onIndexFixed = [](IndexFixed& i) { i.prefixChecksum += 1; };
    });
    add("bad_hierarchy", [](Surgery& s) { poke(s.payload(kHier), 8 + 4 * 8, 0.25f); });
    add("bad_total_of_layers", [](Surgery& s) { poke(s.payload(kTotl), 0, ~0ull); });
    add("bad_attribute_length",
        [](Surgery& s) { poke(s.payload(kAttr), 16, ~0ull - 20); });
    add("bad_text_not_utf8", [](Surgery& s) { s.payload(kHead)[300] = 0xff; });
    add("bad_counts_do_not_add_up", [&](Surgery& s) {
        edit<std::uint8_t>(s.payload(kTile), firstPlane, [](auto& count) { count += 1; });
    });
    add("bad_depth_is_nan",
        [&](Surgery& s) { poke(s.payload(kTile), firstPlane + 64, std::nanf("")); });
    add("bad_plane_claims_too_much", [&](Surgery& s) {
        plane(s, 1, [](PlaneRecord& r) { r.decodedLength = std::uint64_t(1) << 62; });
    });
    add("bad_constant_claims_too_much", [&](Surgery& s) {
        plane(s, 0, [](PlaneRecord& r) {
            r.encoding = 1, r.constant = 255, r.storedLength = 0;
        });
    });
    add("bad_filter_without_compression",
        [&](Surgery& s) { plane(s, 1, [](PlaneRecord& r) { r.filter = 1; }); });
    add("bad_zstd_frame", [&](Surgery& s) {
        plane(s, 0, [](PlaneRecord& r) { r.encoding = 2, r.storedLength = 63; });
        Bytes& tile = s.payload(kTile);
        tile.erase(tile.begin() + long(firstPlane));
    });
    // The record lies at 16, the content at 24: floats, corners at 24 + 24.
    const auto addNear = [&](const std::string& name,
                             const std::function<void(Bytes&)>& change) {
        add(name, [&](Surgery& s) {
            s.parts.insert(s.parts.begin() + 2, {kNear, 0, handmadeNear()});
            change(s.parts[2].payload);
        });
    };
    addNear("bad_near_cut", [](Bytes& near) { near.erase(near.end() - 10, near.end()); });
    addNear("bad_near_chunks_absurd", [](Bytes& near) { poke(near, 8, 1ull << 60); });
    addNear("bad_near_points_absurd", [](Bytes& near) { poke(near, 16, 0xffffffffu); });
    addNear("bad_near_corner_of_no_point", [](Bytes& near) { near[48 + 5] = 4; });
    addNear("bad_near_not_finite", [](Bytes& near) { near[24 + 18 + 4] = 0x7f; });
    add("bad_near_twice", [](Surgery& s) {
        s.parts.insert(s.parts.begin() + 2, 2, {kNear, 0, handmadeNear()});
    });
    const auto addHair = [&](const std::string& name,
                             const std::function<void(Bytes&)>& change) {
        add(name, [&](Surgery& s) {
            s.parts.insert(s.parts.begin() + 2, {kHair, 0, handmadeHair()});
            change(s.parts[2].payload);
        });
    };
    addHair("bad_hair_cut", [](Bytes& hair) { hair.erase(hair.end() - 10, hair.end()); });
    addHair("bad_hair_chunks_absurd", [](Bytes& hair) { poke(hair, 8, 1ull << 60); });
    addHair("bad_hair_has_points", [](Bytes& hair) { poke(hair, 16, 3u); });
    addHair("bad_hair_too_wide", [](Bytes& hair) {
        hair[24 + 20] = 0x80;  // 2^-8 = 3b800000
    });
    add("bad_hair_twice", [](Surgery& s) {
        s.parts.insert(s.parts.begin() + 2, 2, {kHair, 0, handmadeHair()});
    });
    const auto addCards = [&](const std::string& name,
                              const std::function<void(Bytes&)>& change) {
        add(name, [&](Surgery& s) {
            s.parts.insert(s.parts.begin() + 2, {kCard, 0, handmadeCards()});
            change(s.parts[2].payload);
        });
    };
    addCards("bad_card_cut", [](Bytes& cards) { cards.resize(60); });
    addCards("bad_card_textures_absurd",
             [](Bytes& cards) { poke(cards, 0, 0xffffffffu); });
    addCards("bad_card_texture_too_large", [](Bytes& cards) { poke(cards, 4, 16385u); });
    addCards("bad_card_texture_of_none",
             [](Bytes& cards) { cards[cards.size() - 216] = 7; });
    add("bad_card_twice", [](Surgery& s) {
        s.parts.insert(s.parts.begin() + 2, 2, {kCard, 0, handmadeCards()});
    });
    // The opaque map is one tile: so is the first array, eight bytes.
    const auto addTree = [&](const std::string& name,
                             const std::function<void(Surgery&)>& cut) {
        NoisySpec body = spec;
        body.opaque = true;
        WriteOptions options;
        options.codec = Codec::none;
        options.trees = true;
        Surgery s(*encodeMap(noisyMap(body), options));
        cut(s);
        all.push_back({name, s.close()});
    };
    addTree("bad_tree_cut", [](Surgery& s) { s.payload(kTree).resize(40); });
    addTree("bad_tree_of_other_kind", [](Surgery& s) { poke(s.payload(kTree), 4, 1u); });
    addTree("bad_tree_groups_absurd",
            [](Surgery& s) { poke(s.payload(kTree), 16, 1ull << 28); });
    addTree("bad_tree_list_of_nothing", [](Surgery& s) {
        Bytes& tree = s.payload(kTree);
        const auto record = peek<PatchTreeRecord>(tree, sizeof(TreeFixed));
        const std::size_t content = 8 + 144 * record.groups + 2 * record.covers;
        tree[tree.size() - content + 2] = 255;
    });
    addTree("bad_tree_twice", [](Surgery& s) {
        const Surgery::Part tree = s.part(kTree);
        s.parts.insert(s.parts.begin() + 2, tree);
    });
    add("unsupported_newer_encoding", [&](Surgery& s) {
        s.prefix.versionMinor = 1;
        plane(s, 1, [](PlaneRecord& r) { r.encoding = 3; });
    });
    return all;
}

}  // namespace mtsm::test
