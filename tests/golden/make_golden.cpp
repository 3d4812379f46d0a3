// make_golden - writes the files of tests/golden and tests/bad.
//
//     make_golden FOLDER_OF_GOLDEN FOLDER_OF_BAD
//
// Once the format is released, files that are there already are never written again: this
// program is run for a new feature, and the new file is committed after both readers gave
// the same numbers for it (test "both readers agree on every golden file"). Until then
// (see format-spec/mtsm-format.md, "Status") a change of the format replaces them, in the
// same commit as the specification.
#include <cstdio>
#include <fstream>

#include "format/bad_files.h"
#include "golden/golden_maps.h"

namespace {

bool save(const std::string& path, const std::vector<std::uint8_t>& bytes) {
    std::ofstream out(path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()),
              static_cast<std::streamsize>(bytes.size()));
    out.close();
    std::printf("%s: %zu bytes\n", path.c_str(), bytes.size());
    return bool(out);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 3) {
        std::fprintf(stderr, "usage: make_golden FOLDER_OF_GOLDEN FOLDER_OF_BAD\n");
        return 2;
    }
    for (const auto& golden : mtsm::test::goldenMaps()) {
        mtsm::WriteOptions options;
        options.codec = golden.codec;
        options.trees = golden.trees;
        const auto bytes = mtsm::encodeMap(golden.map, options);
        if (!bytes || !save(std::string(argv[1]) + "/" + golden.name + ".mtsm", *bytes))
            return 3;
    }
    for (const auto& bad : mtsm::test::badFiles()) {
        if (!save(std::string(argv[2]) + "/" + bad.name + ".mtsm", bad.bytes)) return 3;
    }
    return 0;
}
