#include "common/map_file.h"

#include <array>
#include <filesystem>
#include <fstream>
#include <string_view>

namespace mtsm::tools {
namespace {

enum class Sort { mesh, hair, volume, job, picture, table };

/// How a file that is no map is known: by its name, or by how it begins.
struct Format {
    std::string_view extension, magic;
    Sort sort;
};

using namespace std::string_view_literals;
constexpr std::array kFormats = {
    Format{".ply", "ply\n", Sort::mesh},
    Format{".obj", "", Sort::mesh},
    Format{".gltf", "", Sort::mesh},
    Format{".glb", "glTF", Sort::mesh},
    Format{".fbx", "Kaydara", Sort::mesh},
    Format{".dae", "", Sort::mesh},
    Format{".stl", "", Sort::mesh},
    Format{".off", "OFF", Sort::mesh},
    Format{".hair", "HAIR", Sort::hair},
    Format{".tfx", "", Sort::hair},
    Format{".vdb", " BDV", Sort::volume},
    Format{".toml", "", Sort::job},
    Format{".png", "\x89PNG", Sort::picture},
    Format{".exr", "v/1\x01", Sort::picture},
    Format{".jpg", "\xff\xd8\xff", Sort::picture},
    Format{".jpeg", "", Sort::picture},
    Format{".tif", "II*\0"sv, Sort::picture},
    Format{".tiff", "MM\0*"sv, Sort::picture},
    Format{".csv", "", Sort::table},
};

/// Of a file; what a pipe holds is read but once, and by others.
std::string beginningOf(const std::string& path) {
    std::error_code problem;
    std::string begin(8, '\0');
    if (!std::filesystem::is_regular_file(path, problem)) return begin;
    std::ifstream(path, std::ios::binary)
        .read(begin.data(), std::streamsize(begin.size()));
    return begin;
}

/// What the file looks like, told by how it begins before its name; null: like nothing
/// that is known.
const Format* formatOf(const std::string& path) {
    const std::string begin = beginningOf(path), type = extension(path);
    for (const Format& format : kFormats)
        if (!format.magic.empty() && begin.starts_with(format.magic)) return &format;
    for (const Format& format : kFormats)
        if (type == format.extension) return &format;
    return nullptr;
}

/// What it is, and where it belongs.
std::string insteadOfMap(const std::string& path, Sort sort) {
    // A name that begins as an option does is no option.
    const auto argument = [](const std::string& name) {
        return quotedForShell(name.starts_with('-') ? "./" + name : name);
    };
    const std::string file = argument(path),
                      map =
                          argument(std::filesystem::path(path).stem().string() + ".mtsm");
    switch (sort) {
        case Sort::job:
            return "a job file, not a map: bake it with mtsm-bake " + file + " -o " +
                   map + " and give that map";
        case Sort::picture:
            return "a picture, not a map: give the .mtsm file that mtsm-bake wrote; a "
                   "position pass belongs to mtsm-query's --position";
        case Sort::table:
            return "a table, not a map: give the .mtsm file that mtsm-bake wrote; points "
                   "belong to mtsm-query's --points, rays to its --rays";
        default:
            return std::string(sort == Sort::mesh   ? "a mesh"
                               : sort == Sort::hair ? "hair"
                                                    : "a volume") +
                   ", not a map: bake it with mtsm-bake " + file +
                   " --light-position X,Y,Z --light-radius R -o " + map;
    }
}

}  // namespace

bool isMap(const std::string& path) {
    return beginningOf(path).starts_with("\x89MTS");
}

Failure mapFailure(Error error, const std::string& path, const ReadLimits& limits) {
    const bool damaged = error.code == ErrorCode::badFile;
    if (!damaged && error.code != ErrorCode::tooLarge) return {error};
    if (damaged && !isMap(path)) {
        if (const Format* const format = formatOf(path))
            error.message = path + ": is " + insteadOfMap(path, format->sort);
        else if (extension(path) != ".mtsm")
            error.message += "; a map is a .mtsm file that mtsm-bake wrote";
        return {error};
    }
    ReadLimits without = limits;
    without.trees = false;
    if (limits.trees && readMap(path, without)) {
        error.message += std::string(damaged ? "; only the trees are damaged"
                                             : "; that is for the trees") +
                         ": mtsm-query makes its own of the layers";
        return {error};
    }
    ReadLimits layersAlone = without;
    layersAlone.nearField = false;
    if (limits.nearField && readMap(path, layersAlone))
        error.message += std::string(damaged ? "; only the near field is damaged"
                                             : "; that is for the near field") +
                         ": mtsm-query --no-near-field answers from the layers alone";
    return {error};
}

}  // namespace mtsm::tools
