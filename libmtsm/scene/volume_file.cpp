// VolumeFile: the parent's side.
#include <cmath>
#include <optional>
#include <utility>

#include "base/message.h"
#include "mtsm/volume_files.h"
#include "scene/byte_file.h"
#include "scene/import_file.h"
#include "scene/send.h"

namespace mtsm {

using base::makeError;
using scene::PlacedVolume;

struct VolumeFile::Impl {
    std::string path;
    VolumeFileOptions options;
    std::optional<scene::ByteFile::Stamp> stamp;  // of the file at the first reading
    bool warned = false;                          // a reading has come to its end
    std::optional<PlacedVolume> kept;

    Status show(const PlacedVolume& volume, const CasterVisitor& visitor) const;
    Status read(const CasterVisitor& visitor);
};

Status VolumeFile::Impl::show(const PlacedVolume& volume,
                              const CasterVisitor& visitor) const {
    if (volume.blocks.empty()) return {};
    return visitor(VolumeView{volume.blocks.data(), volume.blocks.size(),
                              volume.density.data(), volume.worldFromIndex,
                              options.densityScale});
}

Status VolumeFile::Impl::read(const CasterVisitor& visitor) {
    if (options.progress && !options.progress(path))
        return makeError(ErrorCode::cancelled, path, ": reading was cancelled");
    const auto file = scene::ByteFile::open(path);
    if (!file) return file.error();
    if (stamp && *stamp != (*file)->stamp())
        return makeError(ErrorCode::io, path,
                         ": has changed since it was read first; start again");
    stamp = (*file)->stamp();

    std::optional<PlacedVolume> volume;
    scene::ImportSink sink;
    sink.volume = [&](PlacedVolume&& got) -> Status {
        volume = std::move(got);
        return {};
    };
    if (!warned) sink.warning = options.warn;
    const Status done = scene::importFile(
        path, options.importerBytes,
        [&](scene::FrameWriter& out) { scene::sendVolume(path, options, out); }, sink);
    if (!done) return done;
    if (!volume)
        return makeError(ErrorCode::badFile, path,
                         ": the importer returned no volume; re-export the file");
    warned = true;
    const Status shown = show(*volume, visitor);
    if (volume->bytes() <= options.cacheBytes) kept = std::move(*volume);
    return shown;
}

VolumeFile::VolumeFile(std::string path, VolumeFileOptions options)
    : impl_(std::make_unique<Impl>()) {
    impl_->path = std::move(path);
    impl_->options = std::move(options);
}

VolumeFile::~VolumeFile() = default;

std::uint64_t VolumeFile::cachedBytes() const noexcept {
    return impl_->kept ? impl_->kept->bytes() : 0;
}

Status VolumeFile::visit(const CasterVisitor& visitor) {
    const float scale = impl_->options.densityScale;
    if (!(scale >= 0.0f && std::isfinite(scale)))
        return makeError(ErrorCode::badArgument, impl_->path, ": a density scale of ",
                         scale, " must be finite and not negative");
    return impl_->kept ? impl_->show(*impl_->kept, visitor) : impl_->read(visitor);
}

}  // namespace mtsm
