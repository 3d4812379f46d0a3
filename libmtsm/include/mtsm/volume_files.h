// volume_files.h - fog volumes of files as casters.
//
//     mtsm::VolumeFileOptions options;
//     options.densityScale = 20.0f;
//     mtsm::VolumeFile smoke("smoke.vdb", options);
//     auto baked = mtsm::bake(smoke, bakeOptions);            // mtsm/bake.h
//
// A grid of densities becomes one VolumeView (mtsm/scene.h): its active voxels, and its
// active tiles cut into blocks, placed by the grid's own transform. What is not active is
// not cast, whatever value it has. Densities below 0, NaN and infinities count as 0, with
// a warning. As mesh files are, volumes are read in a child process: a file that kills
// OpenVDB is an Error like any other. Axes and units are the file's own.
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm {

struct VolumeFileOptions {
    /// Name of the grid of densities. Empty: "density" if there is one, else the only
    /// grid of floats (or doubles, or halves) that is not a level set. Of several grids
    /// of one name the first is meant; "name[1]" is the second.
    std::string grid;
    /// Extinction per unit of density and world unit of length, finite, >= 0.
    float densityScale = 1.0f;
    /// Volumes up to this size are kept between visits; others are read again. A block of
    /// 8 x 8 x 8 voxels takes 2060 bytes.
    std::uint64_t cacheBytes = std::uint64_t(1) << 30;
    /// Address space that the child may add, and the most that the blocks may take.
    std::uint64_t importerBytes = std::uint64_t(16) << 30;
    /// Called with one line each for what was ignored or looks wrong, at the first visit;
    /// from the visiting thread.
    std::function<void(const std::string&)> warn;
    /// Called with the path before the file is read; returning false cancels.
    std::function<bool(const std::string&)> progress;
};

/// A grid of an OpenVDB file (.vdb). One without a positive density is handed on as no
/// caster, with a warning.
///
/// visit() fails with io (no such file, importer killed, file changed between visits),
/// badFile (not OpenVDB, cut off, importer crashed), unsupported (a level set, a frustum
/// transform, no grid of floats), tooLarge (importerBytes), badArgument (no such grid, or
/// none that is the only one: the message lists those there are) or cancelled.
class VolumeFile final : public CasterSource {
  public:
    explicit VolumeFile(std::string path, VolumeFileOptions options = {});
    ~VolumeFile() override;
    Status visit(const CasterVisitor& visitor) override;
    /// What it holds until the next visit, of cacheBytes.
    [[nodiscard]] std::uint64_t cachedBytes() const noexcept;

    VolumeFile(const VolumeFile&) = delete;
    VolumeFile& operator=(const VolumeFile&) = delete;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace mtsm
