// rasteriser.h - meshes into a k-buffer or a sample grid, in parallel.
//
//     Rasteriser raster(projection, Facing::any, buffer);
//     for (mesh : meshes) if (auto s = raster.add(mesh); !s) return s;
//     if (auto s = raster.finish(); !s) return s;
//
// Triangles are taken in batches of bounded size: corners are transformed and triangles
// set up in parallel, slice by slice; each slice sorts its triangles into bins of the
// raster; then the bins are drawn in parallel, each by one thread, so nothing is locked
// and nothing is atomic. Because neither the k-buffer nor the grid depends on the order
// of samples, neither does the result. Work runs in the caller's oneTBB arena.
//
// A grid with subsamples is drawn as a raster that is finer by their number.
#pragma once
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <vector>

#include "mtsm/map.h"
#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "raster/bins.h"
#include "raster/kbuffer.h"
#include "raster/sample_grid.h"
#include "raster/surface.h"
#include "raster/triangle.h"

namespace mtsm::raster {

class Rasteriser {
  public:
    /// Called from the calling thread with the number of triangles done, between batches;
    /// an Error stops the work.
    using AfterBatch = std::function<Status(std::uint64_t)>;

    /// Keeps the nearest samples of meshes that are all opaque. `buffer` must outlive the
    /// rasteriser.
    Rasteriser(const Projection& projection, Facing keep, KBuffer& buffer,
               AfterBatch afterBatch = {});
    /// Keeps all samples of the grid's rows. `grid` must outlive the rasteriser; width
    /// and height times its subsamples must not exceed kMaxResolution.
    Rasteriser(const Projection& projection, Facing keep, SampleGrid& grid,
               AfterBatch afterBatch = {});

    /// Takes all of a mesh with valid indices and an opacity in (0, 1]; its arrays and
    /// its texture are not needed after the call.
    Status add(const MeshView& mesh);
    /// Draws what is left. After it counts() is complete.
    Status finish();

    [[nodiscard]] const TriangleCounts& counts() const noexcept { return counts_; }

  private:
    /// Some triangles of a batch: set up by one thread, sorted by bin.
    struct Slice {
        std::uint32_t taken = 0;  ///< triangles that went in
        std::vector<PreparedTriangle> triangles;
        std::vector<Surface> surfaces;     ///< what PreparedTriangle::surface counts
        std::vector<std::uint32_t> begin;  ///< [bins + 1], into `order`
        std::vector<std::uint32_t> order;  ///< indices of triangles, bin by bin
        TriangleCounts counts;
    };

    Rasteriser(const Projection& fine, std::uint32_t fineWidth, std::uint32_t fineHeight,
               std::uint32_t subsamples, Facing keep, AfterBatch afterBatch);
    void prepare(const MeshView& mesh, std::size_t first, std::uint32_t count);
    void drawBin(std::uint32_t bin) const;
    template <ProjectionKind kind>
    void drawInGrid(const PreparedTriangle& t, const Surface& surface,
                    PixelRect bin) const;
    [[nodiscard]] PixelRect wantedPixels() const noexcept;
    Status flush();

    Projection projection_;  // of the fine raster
    std::uint32_t width_, height_;
    TriangleSetup setup_;
    KBuffer* buffer_ = nullptr;  // or:
    SampleGrid* grid_ = nullptr;
    std::uint32_t subsampleShift_ = 0;
    AfterBatch afterBatch_;
    Bins bins_;
    std::vector<Slice> slices_;
    std::uint32_t pending_ = 0;     // triangles in slices_
    std::vector<Vertex> vertices_;  // of the chunk at work
    TriangleCounts counts_;
    std::uint64_t done_ = 0;
};

}  // namespace mtsm::raster
