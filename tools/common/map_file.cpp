#include "common/map_file.h"

#include <array>
#include <filesystem>
#include <fstream>
#include <string_view>

namespace mtsm::tools {
namespace {

/// How a file of casters is known: by its name, or by how it begins.
struct CasterFormat {
    std::string_view extension, magic;
    const char* what;
};

constexpr const char *kMesh = "a mesh", *kHair = "hair", *kVolume = "a volume";
constexpr std::array kCasterFormats = {
    CasterFormat{".ply", "ply\n", kMesh},   CasterFormat{".obj", "", kMesh},
    CasterFormat{".gltf", "", kMesh},       CasterFormat{".glb", "glTF", kMesh},
    CasterFormat{".fbx", "Kaydara", kMesh}, CasterFormat{".dae", "", kMesh},
    CasterFormat{".stl", "", kMesh},        CasterFormat{".off", "OFF", kMesh},
    CasterFormat{".hair", "HAIR", kHair},   CasterFormat{".tfx", "", kHair},
    CasterFormat{".vdb", " BDV", kVolume}};

/// What sort of casters the file holds; null if it does not look like any.
const char* casterIn(const std::string& path) {
    std::string begin(8, '\0');
    std::ifstream(path, std::ios::binary)
        .read(begin.data(), std::streamsize(begin.size()));
    if (begin.starts_with("\x89MTS")) return nullptr;
    const std::string type = extension(path);
    for (const CasterFormat& format : kCasterFormats)
        if (type == format.extension ||
            (!format.magic.empty() && begin.starts_with(format.magic)))
            return format.what;
    return nullptr;
}

}  // namespace

Failure mapFailure(Error error, const std::string& path, const ReadLimits& limits) {
    const bool damaged = error.code == ErrorCode::badFile;
    if (!damaged && error.code != ErrorCode::tooLarge) return {error};
    if (const char* const caster = damaged ? casterIn(path) : nullptr) {
        const std::string map = std::filesystem::path(path).stem().string() + ".mtsm";
        error.message = path + ": is " + caster +
                        ", not a map: bake it with mtsm-bake '" + path +
                        "' --light-position X,Y,Z --light-radius R -o '" + map + "'";
        return {error};
    }
    ReadLimits layersAlone = limits;
    layersAlone.nearField = false;
    if (limits.nearField && readMap(path, layersAlone))
        error.message += std::string(damaged ? "; only the near field is damaged"
                                             : "; that is for the near field") +
                         ": mtsm-query --no-near-field answers from the layers alone";
    return {error};
}

}  // namespace mtsm::tools
