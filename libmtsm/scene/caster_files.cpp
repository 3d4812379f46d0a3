// CasterFiles: which reader a file needs, and where its casters stand.
#include "mtsm/caster_files.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <glm/matrix.hpp>
#include <utility>

#include "base/message.h"

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

Status checkUses(const CasterFile& f) {
    const Use uses[] = {{"opacity", f.opacity.has_value(), CasterKind::mesh},
                        {"include", !f.include.empty(), CasterKind::mesh},
                        {"exclude", !f.exclude.empty(), CasterKind::mesh},
                        {"hair-width", f.hairWidth.has_value(), CasterKind::hair},
                        {"hair-tip-width", f.hairTipWidth.has_value(), CasterKind::hair},
                        {"hair-opacity", f.hairOpacity.has_value(), CasterKind::hair},
                        {"hair-scale", f.hairScale != 1.0f, CasterKind::hair},
                        {"density-grid", !f.densityGrid.empty(), CasterKind::volume},
                        {"density-scale", f.densityScale != 1.0f, CasterKind::volume}};
    for (const Use& use : uses) {
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

/// Files that one reader reads.
struct Group {
    CasterFile settings;  // of the first of them
    std::vector<std::string> paths;
    std::unique_ptr<CasterSource> source;
};

/// One reader may take both.
bool canShare(const CasterFile& a, const CasterFile& b) {
    return casterKind(a.path) == CasterKind::mesh &&
           casterKind(b.path) == CasterKind::mesh && a.transform == b.transform &&
           a.opacity == b.opacity && a.include == b.include && a.exclude == b.exclude;
}

std::vector<Group> groupsOf(std::vector<CasterFile> files) {
    std::vector<Group> groups;
    for (CasterFile& file : files) {
        auto at = std::find_if(groups.begin(), groups.end(), [&](const Group& group) {
            return canShare(group.settings, file);
        });
        if (at == groups.end()) {
            groups.emplace_back();
            at = std::prev(groups.end());
            at->settings = file;
        }
        at->paths.push_back(std::move(file.path));
    }
    return groups;
}

std::uint64_t fileBytes(const std::vector<std::string>& paths) {
    std::uint64_t sum = 1;
    for (const std::string& path : paths) {
        std::error_code problem;
        const auto size = std::filesystem::file_size(path, problem);
        if (!problem) sum += size;
    }
    return sum;
}

std::unique_ptr<CasterSource> meshSource(const Group& group,
                                         const CasterFilesOptions& options,
                                         std::uint64_t cacheBytes) {
    MeshFileOptions o;
    o.include = group.settings.include;
    o.exclude = group.settings.exclude;
    o.opacity = group.settings.opacity;
    o.cacheBytes = cacheBytes;
    o.importerBytes = options.importerBytes;
    o.warn = options.warn;
    o.progress = options.progress;
    return std::make_unique<MeshFiles>(group.paths, std::move(o));
}

/// The reader of a group's files.
Result<std::unique_ptr<CasterSource>> openGroup(const Group& group,
                                                const CasterFilesOptions& options,
                                                std::uint64_t cacheBytes) {
    switch (casterKind(group.settings.path)) {
        case CasterKind::mesh:
            return meshSource(group, options, cacheBytes);
        case CasterKind::hair:
        case CasterKind::volume:
            break;
    }
    return makeError(ErrorCode::unsupported, group.paths.front(), ": ",
                     name(casterKind(group.settings.path)), " cannot be read yet");
}

}  // namespace

CasterKind casterKind(const std::string& path) {
    const std::string type = extension(path);
    if (type == ".hair" || type == ".tfx") return CasterKind::hair;
    return type == ".vdb" ? CasterKind::volume : CasterKind::mesh;
}

bool mayHold(const std::string& path, CasterKind kind) {
    if (kind == CasterKind::hair && extension(path) == ".obj") return true;
    return casterKind(path) == kind;
}

Status checkCaster(const CasterFile& file) {
    if (Status s = checkUses(file); !s) return s;
    if (Status s = checkNumbers(file); !s) return s;
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
    std::vector<Group> opened = groupsOf(files);
    double total = 0.0;
    for (const Group& group : opened)
        total += double(fileBytes(group.paths));
    for (Group& group : opened) {
        const double share = double(fileBytes(group.paths)) / total;
        auto source =
            openGroup(group, options,
                      std::uint64_t(std::floor(double(options.cacheBytes) * share)));
        if (!source) return source.error();
        group.source = *std::move(source);
    }
    groups = std::move(opened);
    return {};
}

CasterFiles::CasterFiles(std::vector<CasterFile> files, CasterFilesOptions options)
    : impl_(std::make_unique<Impl>()) {
    impl_->files = std::move(files);
    impl_->options = std::move(options);
}

CasterFiles::~CasterFiles() = default;

Status CasterFiles::visit(const CasterVisitor& visitor) {
    if (Status s = impl_->open(); !s) return s;
    for (const Group& group : impl_->groups) {
        const Status s = group.source->visit(moved(group.settings.transform, visitor));
        if (!s) return s;
    }
    return {};
}

}  // namespace mtsm
