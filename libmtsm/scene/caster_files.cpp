// CasterFiles: which reader a file needs, and where its casters stand.
#include "mtsm/caster_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <glm/matrix.hpp>
#include <new>
#include <utility>

#include "base/message.h"
#include "mtsm/hair_files.h"
#include "mtsm/volume_files.h"

namespace mtsm {
namespace {

using base::makeError;

std::string extension(const std::string& path) {
    std::string text = std::filesystem::path(path).extension().string();
    for (char& c : text)
        c = char(std::tolower(static_cast<unsigned char>(c)));
    return text;
}

const char* name(CasterKind kind) {
    return kind == CasterKind::mesh   ? "a mesh file"
           : kind == CasterKind::hair ? "a hair file"
                                      : "a volume";
}

bool isInvertible(const glm::dmat4& m) {
    const glm::dmat3 linear(m);
    for (int column = 0; column < 4; ++column) {
        for (int row = 0; row < 4; ++row)
            if (!std::isfinite(m[column][row])) return false;
        if (m[column][3] != (column == 3 ? 1.0 : 0.0)) return false;
    }
    const double volume = glm::determinant(linear);
    return std::isfinite(volume) && volume != 0.0;
}

/// A setting's name, whether it was made, and the kind that it is for.
struct Use {
    const char* setting;
    bool made;
    CasterKind kind;
};

constexpr std::size_t kSettings = 10;

std::array<Use, kSettings> usesOf(const CasterFile& f) {
    return {{{"opacity", f.opacity.has_value(), CasterKind::mesh},
             {"include", !f.include.empty(), CasterKind::mesh},
             {"exclude", !f.exclude.empty(), CasterKind::mesh},
             {"texture", !f.textures.empty(), CasterKind::mesh},
             {"hair-width", f.hairWidth.has_value(), CasterKind::hair},
             {"hair-tip-width", f.hairTipWidth.has_value(), CasterKind::hair},
             {"hair-opacity", f.hairOpacity.has_value(), CasterKind::hair},
             {"hair-scale", f.hairScale != 1.0f, CasterKind::hair},
             {"density-grid", !f.densityGrid.empty(), CasterKind::volume},
             {"density-scale", f.densityScale != 1.0f, CasterKind::volume}}};
}

Status checkUses(const CasterFile& f) {
    for (const Use& use : usesOf(f)) {
        if (!use.made || mayHold(f.path, use.kind)) continue;
        const CasterKind kind = casterKind(f.path);
        const bool opacity = std::string(use.setting) == "opacity";
        return makeError(ErrorCode::badArgument, f.path, ": ", use.setting, " is for ",
                         name(use.kind), ", and by its name this is ", name(kind),
                         opacity && kind == CasterKind::hair     ? ": use hair-opacity"
                         : opacity && kind == CasterKind::volume ? ": use density-scale"
                                                                 : "");
    }
    return {};
}

/// What is wrong with a number, or nothing.
Status checkNumber(const CasterFile& f, const char* setting, std::optional<float> value,
                   bool good, const char* expected) {
    if (!value || (good && std::isfinite(*value))) return {};
    return makeError(ErrorCode::badArgument, f.path, ": ", setting, " ", *value,
                     " must be ", expected);
}

constexpr const char* kLength = "a finite number of at least 0";
constexpr const char* kShare = "in [0, 1]";

bool isShare(std::optional<float> v) {
    return v && *v >= 0.0f && *v <= 1.0f;
}

Status checkNumbers(const CasterFile& f) {
    const Status found[] = {
        checkNumber(f, "opacity", f.opacity, isShare(f.opacity), kShare),
        checkNumber(f, "hair-width", f.hairWidth, f.hairWidth >= 0.0f, kLength),
        checkNumber(f, "hair-tip-width", f.hairTipWidth, f.hairTipWidth >= 0.0f, kLength),
        checkNumber(f, "hair-opacity", f.hairOpacity, isShare(f.hairOpacity), kShare),
        checkNumber(f, "hair-scale", f.hairScale, f.hairScale > 0.0f,
                    "a finite number above 0"),
        checkNumber(f, "density-scale", f.densityScale, f.densityScale >= 0.0f, kLength)};
    for (const Status& s : found)
        if (!s) return s;
    return {};
}

/// Hands casters on as they stand in a moved world.
CasterVisitor moved(const glm::dmat4& transform, const CasterVisitor& visitor) {
    return [&transform, &visitor](const CasterView& caster) {
        CasterView view = caster;
        if (auto* volume = std::get_if<VolumeView>(&view))
            volume->worldFromIndex = transform * volume->worldFromIndex;
        else if (auto* strands = std::get_if<StrandsView>(&view))
            strands->worldFromObject = transform * strands->worldFromObject;
        else if (auto* mesh = std::get_if<MeshView>(&view))
            mesh->worldFromObject = transform * mesh->worldFromObject;
        return visitor(view);
    };
}

/// Files that one reader reads: one, or meshes with the same settings.
struct Group {
    CasterKind kind = CasterKind::mesh;
    std::vector<CasterFile> files;
    std::unique_ptr<CasterSource> source = {};  // from the first visit on
    std::function<std::uint64_t()> cachedBytes = {};

    [[nodiscard]] bool takes(const CasterFile& file) const {
        const CasterFile& first = files.front();
        return kind == CasterKind::mesh && first.transform == file.transform &&
               first.opacity == file.opacity && first.include == file.include &&
               first.exclude == file.exclude && first.textures == file.textures;
    }
};

void addMeshes(const CasterFile& file, std::vector<Group>& groups) {
    for (Group& group : groups)
        if (group.takes(file)) return group.files.push_back(file);
    groups.push_back({CasterKind::mesh, {file}});
}

Result<std::vector<Group>> groupsOf(const std::vector<CasterFile>& files) {
    std::vector<Group> groups;
    for (const CasterFile& file : files) {
        const CasterKind kind = casterKind(file.path);
        if (kind != CasterKind::mesh) {
            groups.push_back({kind, {file}});
            continue;
        }
        ObjContent content{.polylines = false, .faces = true};
        if (mayHold(file.path, CasterKind::hair)) {
            const auto found = objContent(file.path);
            if (!found) return found.error();
            content = *found;
        }
        // One with neither is left to the reader of meshes to complain of.
        if (content.faces || !content.polylines) addMeshes(file, groups);
        if (content.polylines) groups.push_back({CasterKind::hair, {file}});
    }
    return groups;
}

/// Warns of settings that no file can use: an OBJ may hold meshes and strands by its
/// name, and is known only when it is read.
void warnOfUnused(const std::vector<CasterFile>& files, const std::vector<Group>& groups,
                  const CasterFilesOptions& options) {
    if (!options.warn) return;
    for (std::size_t s = 0; s < kSettings; ++s) {
        const auto made = [s](const CasterFile& file) { return usesOf(file)[s].made; };
        const auto first = std::find_if(files.begin(), files.end(), made);
        if (first == files.end()) continue;
        const Use use = usesOf(*first)[s];
        const bool used = std::any_of(groups.begin(), groups.end(), [&](const Group& g) {
            return g.kind == use.kind &&
                   std::any_of(g.files.begin(), g.files.end(), made);
        });
        if (!used)
            options.warn(base::concat(
                first->path, ": ", use.setting, " has no effect: the file holds no ",
                use.kind == CasterKind::hair ? "strands (polylines)" : "faces"));
    }
}

std::unique_ptr<MeshFiles> meshSource(const Group& group,
                                      const CasterFilesOptions& options,
                                      std::uint64_t cacheBytes) {
    const CasterFile& first = group.files.front();
    std::vector<std::string> paths;
    for (const CasterFile& file : group.files)
        paths.push_back(file.path);
    MeshFileOptions o;
    o.include = first.include;
    o.exclude = first.exclude;
    o.textures = first.textures;
    o.opacity = first.opacity;
    o.color = options.color;
    o.linesAreStrands = true;
    o.cacheBytes = cacheBytes;
    o.importerBytes = options.importerBytes;
    o.warn = options.warn;
    o.progress = options.progress;
    return std::make_unique<MeshFiles>(std::move(paths), std::move(o));
}

std::unique_ptr<CasterSource> hairSource(const CasterFile& file,
                                         const CasterFilesOptions& options) {
    HairFileOptions o;
    // The transform will multiply widths by this.
    const double grown =
        std::cbrt(std::abs(glm::determinant(glm::dmat3(file.transform))));
    if (file.hairWidth) o.width = float(*file.hairWidth / grown);
    if (file.hairTipWidth) o.tipWidth = float(*file.hairTipWidth / grown);
    o.opacity = file.hairOpacity;
    o.scale = file.hairScale;
    o.warn = options.warn;
    o.progress = options.progress;
    return std::make_unique<HairFile>(file.path, std::move(o));
}

std::unique_ptr<VolumeFile> volumeSource(const CasterFile& file,
                                         const CasterFilesOptions& options,
                                         std::uint64_t cacheBytes) {
    VolumeFileOptions o;
    o.grid = file.densityGrid;
    o.densityScale = file.densityScale;
    o.cacheBytes = cacheBytes;
    o.importerBytes = options.importerBytes;
    o.warn = options.warn;
    o.progress = options.progress;
    return std::make_unique<VolumeFile>(file.path, std::move(o));
}

/// Opens the reader of a group's files.
void openReader(Group& group, const CasterFilesOptions& options,
                std::uint64_t cacheBytes) {
    const CasterFile& first = group.files.front();
    const auto take = [&](auto source) {
        group.cachedBytes = [reader = source.get()] { return reader->cachedBytes(); };
        group.source = std::move(source);
    };
    switch (group.kind) {
        case CasterKind::mesh:
            return take(meshSource(group, options, cacheBytes));
        case CasterKind::volume:
            return take(volumeSource(first, options, cacheBytes));
        case CasterKind::hair:
            group.cachedBytes = [] { return std::uint64_t(0); };
            group.source = hairSource(first, options);
    }
}

}  // namespace

CasterKind casterKind(const std::string& path) {
    if (isHairFile(path)) return CasterKind::hair;
    return extension(path) == ".vdb" ? CasterKind::volume : CasterKind::mesh;
}

bool mayHold(const std::string& path, CasterKind kind) {
    if (kind == CasterKind::hair && extension(path) == ".obj") return true;
    return casterKind(path) == kind;
}

Status checkCaster(const CasterFile& file) {
    if (Status s = checkUses(file); !s) return s;
    if (Status s = checkNumbers(file); !s) return s;
    if (file.hairTipWidth && !file.hairWidth)
        return makeError(ErrorCode::badArgument, file.path,
                         ": hair-tip-width needs hair-width, the width at the root");
    if (!isInvertible(file.transform))
        return makeError(ErrorCode::badArgument, file.path,
                         ": transform must be finite, invertible and affine (last row "
                         "0, 0, 0, 1)");
    return {};
}

struct CasterFiles::Impl {
    std::vector<CasterFile> files;
    CasterFilesOptions options;
    std::vector<Group> groups;  // filled by open()

    Status open();
};

/// Checks everything before anything is read.
Status CasterFiles::Impl::open() {
    if (!groups.empty()) return {};
    if (files.empty())
        return makeError(ErrorCode::badArgument, "no file of casters is given");
    for (const CasterFile& file : files)
        if (Status s = checkCaster(file); !s) return s;
    auto opened = groupsOf(files);
    if (!opened) return opened.error();
    warnOfUnused(files, *opened, options);
    groups = *std::move(opened);
    return {};
}

CasterFiles::CasterFiles(std::vector<CasterFile> files, CasterFilesOptions options)
    : impl_(std::make_unique<Impl>()) {
    impl_->files = std::move(files);
    impl_->options = std::move(options);
}

CasterFiles::~CasterFiles() = default;

Status CasterFiles::visit(const CasterVisitor& visitor) {
    try {
        if (Status s = impl_->open(); !s) return s;
    } catch (const std::bad_alloc&) {
        return makeError(ErrorCode::tooLarge, impl_->files.front().path,
                         ": there is not enough memory to open it and what is read "
                         "beside it");
    }
    std::uint64_t left = impl_->options.cacheBytes;
    for (Group& group : impl_->groups) {
        if (!group.source) openReader(group, impl_->options, left);
        const Status s =
            group.source->visit(moved(group.files.front().transform, visitor));
        if (!s) return s;
        left -= std::min(left, group.cachedBytes());
    }
    return {};
}

}  // namespace mtsm
