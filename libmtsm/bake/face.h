// face.h - one view of the casters, as tiles of layers.
#pragma once
#include <cstdint>
#include <vector>

#include "bake/visits.h"
#include "mtsm/bake.h"
#include "mtsm/compress.h"
#include "mtsm/map.h"
#include "raster/triangle.h"

namespace mtsm::bake_detail {

/// What the casters are, as far as it decides how they are baked.
struct CasterKinds {
    bool translucent = false;  ///< some caster lets light through
    bool media = false;        ///< some caster is hair or a volume
};

/// Does it stop all light or none, wherever it is?
[[nodiscard]] bool isSolid(const MeshView& mesh) noexcept;
/// False: it is not there.
[[nodiscard]] bool isThere(const StrandsView& strands) noexcept;
[[nodiscard]] bool isThere(const VolumeView& volume) noexcept;

/// Visits the casters until all is known.
Result<CasterKinds> kindsOf(Visits& visits);

/// What all faces of a bake have in common.
struct FaceSettings {
    const BakeOptions& options;
    std::uint64_t triangles = 0;  ///< that the casters have; 0: not known
    std::uint32_t channels = 1;
    std::uint32_t layers = 0;     ///< cap; 0: none
    float rounding = 0.0f;        ///< what BakeOptions::rounding comes to
    std::uint64_t bytesLeft = 0;  ///< for samples and layers
};

/// Time that is spent in anything but the source of the casters.
class WorkClock {
  public:
    explicit WorkClock(const Visits& visits) : visits_(visits), start_(now()) {}
    [[nodiscard]] double seconds() const { return now() - start_; }

  private:
    [[nodiscard]] double now() const;
    const Visits& visits_;
    double start_;
};

/// What a face came to.
struct Face {
    std::vector<Tile> tiles;  ///< row-major
    std::uint64_t samples = 0, samplesDropped = 0;
    CompressReport compression;
    double rasterSeconds = 0.0, compressSeconds = 0.0;
    std::uint64_t passes = 1;          ///< visits to the casters
    raster::TriangleCounts triangles;  ///< of one pass
    std::uint64_t leavesWindow = 0;    ///< casters, whole or pieces
    BakeReport casters;  ///< meshes, triangles, strands, volumes: of one pass
};

/// The nearest samples of casters that are all opaque surfaces; settings.layers in 1..64.
Result<Face> bakeNearest(Visits& visits, const Projection& projection,
                         const FaceSettings& settings);

/// All samples of any casters, compressed; band by band where they do not fit.
Result<Face> bakeSamples(Visits& visits, const Projection& projection,
                         const FaceSettings& settings);

/// `least`: bytes that are needed, if that is known.
[[nodiscard]] Error tooLarge(const BakeOptions& options, std::uint64_t least = 0);
[[nodiscard]] raster::Facing facing(Cull cull);
/// Bytes that a tile takes in a map.
[[nodiscard]] std::uint64_t bytesOf(const Tile& tile);

}  // namespace mtsm::bake_detail
