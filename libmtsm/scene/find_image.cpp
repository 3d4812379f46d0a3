#include "scene/find_image.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <string_view>
#include <system_error>

namespace mtsm::scene {
namespace {

namespace fs = std::filesystem;

bool isFile(const fs::path& path) {
    std::error_code error;
    return fs::is_regular_file(path, error);
}

int hexDigit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const int letter = std::tolower(static_cast<unsigned char>(c));
    return letter >= 'a' && letter <= 'f' ? letter - 'a' + 10 : -1;
}

std::string percentDecoded(const std::string& text) {
    std::string out;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const bool escape = text[i] == '%' && i + 2 < text.size() &&
                            hexDigit(text[i + 1]) >= 0 && hexDigit(text[i + 2]) >= 0;
        out +=
            escape ? char(16 * hexDigit(text[i + 1]) + hexDigit(text[i + 2])) : text[i];
        if (escape) i += 2;
    }
    return out;
}

}  // namespace

std::string findImage(const std::string& modelPath, const std::string& name) {
    const fs::path folder = fs::path(modelPath).parent_path();
    if (isFile(folder / name)) return (folder / name).string();
    std::string plain = name;
    if (plain.starts_with("file://")) plain.erase(0, 7);
    std::replace(plain.begin(), plain.end(), '\\', '/');
    for (const std::string& spelling : {plain, percentDecoded(plain)}) {
        const fs::path last = fs::path(spelling).filename();
        if (last.empty()) continue;
        for (const fs::path& place :
             {folder / spelling, folder / last, folder / "textures" / last,
              folder / ".." / "textures" / last,
              folder / ".." / "materials" / "textures" / last})
            if (isFile(place)) return place.string();
    }
    return {};
}

}  // namespace mtsm::scene
