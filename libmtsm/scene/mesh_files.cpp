// MeshFiles and CasterViews: casters from files, and from memory.
#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "base/message.h"
#include "mtsm/scene.h"
#include "scene/import_file.h"
#include "scene/send.h"

namespace mtsm {
namespace {

using base::makeError;
using scene::PlacedMesh;

constexpr std::size_t kNamesShown = 20;

/// Enough to notice that a file is not what it was at the last visit.
struct Extent {
    std::uint64_t meshes = 0, vertices = 0, triangles = 0, textureBytes = 0;
    friend bool operator==(const Extent&, const Extent&) = default;
};

/// What a file holds. Meshes refer to textures by their number.
struct Content {
    std::vector<OpacityTexture> textures;
    std::vector<PlacedMesh> meshes;
};

struct File {
    std::string path;
    bool read = false;    // to its end, at least once: it has warned, extent is set
    bool cached = false;  // content is all of it
    Content content;
    Extent extent;
};

Status checkOptions(const MeshFileOptions& options, std::size_t files) {
    if (files == 0) return makeError(ErrorCode::badArgument, "no mesh file is given");
    if (options.opacity && !(*options.opacity >= 0.0f && *options.opacity <= 1.0f))
        return makeError(ErrorCode::badArgument, "opacity ", *options.opacity,
                         " must be in [0, 1]");
    return {};
}

Status show(const PlacedMesh& mesh, const std::vector<OpacityTexture>& textures,
            const CasterVisitor& visitor) {
    MeshView view;
    view.positions = mesh.positions.data();
    view.vertexCount = mesh.positions.size();
    view.indices = mesh.indices.data();
    view.triangleCount = mesh.indices.size() / 3;
    view.tint = mesh.tint;
    if (mesh.texture != scene::kNoTexture) {
        view.uvs = mesh.uvs.data();
        view.texture = &textures[mesh.texture];
    }
    for (const scene::Instance& instance : mesh.instances) {
        view.worldFromObject = instance.worldFromObject;
        view.opacity = instance.opacity;
        if (Status s = visitor(view); !s) return s;
    }
    return {};
}

/// Keeps a file's content while it fits; textures that meshes yet to come may need stay
/// in any case.
class Keeper {
  public:
    explicit Keeper(std::uint64_t room) : room_(room) {}
    void keep(OpacityTexture&& texture) {
        content_.textures.push_back(std::move(texture));
        use(content_.textures.back().memoryBytes());
    }
    void keep(PlacedMesh&& mesh) {
        use(mesh.bytes());
        if (fits_) content_.meshes.push_back(std::move(mesh));
    }
    [[nodiscard]] const std::vector<OpacityTexture>& textures() const {
        return content_.textures;
    }
    [[nodiscard]] bool fits() const { return fits_; }
    [[nodiscard]] std::uint64_t used() const { return used_; }
    [[nodiscard]] Content take() { return std::move(content_); }

  private:
    void use(std::uint64_t bytes) {
        used_ += bytes;
        fits_ = fits_ && used_ <= room_;
        if (!fits_) content_.meshes = {};
    }
    std::uint64_t room_, used_ = 0;
    bool fits_ = true;
    Content content_;
};

Error nothingPasses(std::vector<std::string> names) {
    std::string list;
    for (std::size_t i = 0; i < std::min(names.size(), kNamesShown); ++i)
        list += base::concat(i > 0 ? ", " : "", '"', names[i], '"');
    if (names.size() > kNamesShown)
        list += base::concat(" and ", names.size() - kNamesShown, " more");
    if (list.empty()) list = "none";
    return makeError(ErrorCode::badArgument,
                     "no mesh passes include and exclude; names there are: ", list);
}

}  // namespace

struct MeshFiles::Impl {
    MeshFileOptions options;
    std::vector<File> files;
    std::uint64_t cachedBytes = 0;

    Status visit(File& file, const CasterVisitor& visitor,
                 std::vector<std::string>& names);
    Status read(File& file, const CasterVisitor& visitor,
                std::vector<std::string>& names);
};

Status MeshFiles::Impl::visit(File& file, const CasterVisitor& visitor,
                              std::vector<std::string>& names) {
    if (!file.cached) return read(file, visitor, names);
    for (const PlacedMesh& mesh : file.content.meshes)
        if (Status s = show(mesh, file.content.textures, visitor); !s) return s;
    return {};
}

Status MeshFiles::Impl::read(File& file, const CasterVisitor& visitor,
                             std::vector<std::string>& names) {
    if (options.progress && !options.progress(file.path))
        return makeError(ErrorCode::cancelled, file.path, ": reading was cancelled");
    Extent extent;
    Keeper keeper(options.cacheBytes - std::min(cachedBytes, options.cacheBytes));
    scene::ImportSink sink;
    sink.texture = [&](OpacityImage&& image) -> Status {
        auto texture = OpacityTexture::create(std::move(image));
        if (!texture) return texture.error();
        extent.textureBytes += texture->memoryBytes();
        keeper.keep(std::move(*texture));
        return {};
    };
    sink.mesh = [&](PlacedMesh&& mesh) -> Status {
        extent.meshes += mesh.instances.size();
        extent.vertices += mesh.positions.size();
        extent.triangles += mesh.indices.size() / 3;
        if (Status s = show(mesh, keeper.textures(), visitor); !s) return s;
        keeper.keep(std::move(mesh));
        return {};
    };
    sink.name = [&](std::string name) {
        if (std::find(names.begin(), names.end(), name) == names.end())
            names.push_back(std::move(name));
    };
    if (!file.read) sink.warning = options.warn;
    const Status done = scene::importFile(
        file.path, options.importerBytes,
        [&](scene::FrameWriter& out) { scene::sendMeshes(file.path, options, out); },
        sink);
    if (!done) return done;
    if (file.read && extent != file.extent)
        return makeError(ErrorCode::io, file.path,
                         ": the file changed while it was in use; start again");
    file.read = true;
    file.extent = extent;
    if (keeper.fits()) {
        file.cached = true;
        file.content = keeper.take();
        cachedBytes += keeper.used();
    }
    return {};
}

MeshFiles::MeshFiles(std::vector<std::string> paths, MeshFileOptions options)
    : impl_(std::make_unique<Impl>()) {
    impl_->options = std::move(options);
    for (std::string& path : paths)
        impl_->files.push_back({.path = std::move(path), .content = {}, .extent = {}});
}

MeshFiles::~MeshFiles() = default;

std::uint64_t MeshFiles::cachedBytes() const noexcept {
    return impl_->cachedBytes;
}

Status MeshFiles::visit(const CasterVisitor& visitor) {
    if (Status s = checkOptions(impl_->options, impl_->files.size()); !s) return s;
    std::uint64_t visited = 0;
    const CasterVisitor counting = [&](const CasterView& view) {
        ++visited;
        return visitor(view);
    };
    std::vector<std::string> names;
    for (File& file : impl_->files)
        if (Status s = impl_->visit(file, counting, names); !s) return s;
    if (visited == 0) return nothingPasses(std::move(names));
    return {};
}

Status CasterViews::visit(const CasterVisitor& visitor) {
    for (const CasterView& caster : casters_)
        if (Status s = visitor(caster); !s) return s;
    return {};
}

}  // namespace mtsm
