// rasteriser.h - meshes into a k-buffer, in parallel.
//
//     Rasteriser raster(projection, Facing::any, buffer);
//     for (mesh : meshes) if (auto s = raster.add(mesh); !s) return s;
//     if (auto s = raster.finish(); !s) return s;
//
// Triangles are taken in batches of bounded size: corners are transformed and triangles
// set up in parallel, slice by slice; each slice sorts its triangles into bins of the
// raster; then the bins are drawn in parallel, each by one thread, so nothing is locked
// and nothing is atomic. Because the k-buffer does not depend on the order of samples,
// neither does the result. Work runs in the caller's oneTBB arena.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "raster/kbuffer.h"
#include "raster/triangle.h"

namespace mtsm::raster {

class Rasteriser {
  public:
    /// `buffer` must outlive the rasteriser. `afterBatch`, if any, is called from the
    /// calling thread with the number of triangles done; an Error stops the work.
    Rasteriser(const Projection& projection, Facing keep, KBuffer& buffer,
               std::function<Status(std::uint64_t)> afterBatch = {});

    /// Takes all of a mesh with valid indices and an opacity in (0, 1]; its arrays are
    /// not needed after the call.
    Status add(const MeshView& mesh);
    /// Draws what is left. After it counts() is complete.
    Status finish();

    [[nodiscard]] const TriangleCounts& counts() const noexcept { return counts_; }

  private:
    /// Some triangles of a batch: set up by one thread, sorted by bin.
    struct Slice {
        std::uint32_t taken = 0;  ///< triangles that went in
        std::vector<PreparedTriangle> triangles;
        std::vector<std::uint32_t> begin;  ///< [bins + 1], into `order`
        std::vector<std::uint32_t> order;  ///< indices of triangles, bin by bin
        TriangleCounts counts;
    };

    void prepare(const MeshView& mesh, std::size_t first, std::uint32_t count);
    void sortIntoBins(Slice& slice) const;
    void drawBin(std::uint32_t bin) const;
    template <ProjectionKind kind>
    void drawInBin(const PreparedTriangle& t, PixelRect bin) const;
    Status flush();

    Projection projection_;
    TriangleSetup setup_;
    KBuffer& buffer_;
    std::function<Status(std::uint64_t)> afterBatch_;
    std::uint32_t binShift_ = 0, binsX_ = 0, binsY_ = 0;
    std::vector<Slice> slices_;
    std::uint32_t pending_ = 0;     // triangles in slices_
    std::vector<Vertex> vertices_;  // of the chunk at work
    TriangleCounts counts_;
    std::uint64_t done_ = 0;
};

}  // namespace mtsm::raster
