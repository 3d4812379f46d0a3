// bad_files.h - small files that every reader has to refuse. Those in tests/bad are
// written from here; whatever else ever breaks a reader is put beside them.
#pragma once
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
    add("unsupported_visibility_rule", [](Surgery& s) { poke(s.payload(kHead), 4, 1u); });
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
    return all;
}

}  // namespace mtsm::test
