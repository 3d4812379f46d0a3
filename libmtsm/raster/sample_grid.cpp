#include "raster/sample_grid.h"

#include <numeric>

namespace mtsm::raster {

/// Takes another chunk. Over the limit, the lower half of the rows is given up, and the
/// rest may use half as much again until settle() has freed those.
bool SampleTile::grow() {
    SampleMemory& m = *memory_;
    const auto relaxed = std::memory_order_relaxed;
    if (row_ >= m.endRow.load(relaxed) || m.overrun.load(relaxed)) return false;
    const std::uint64_t used = m.used.fetch_add(sizeof(Chunk), relaxed) + sizeof(Chunk);
    if (used > m.limit) m.overrun.store(true, relaxed);
    chunks_.emplace_back(new Chunk);
    capacity_ += kChunk;
    return true;
}

}  // namespace mtsm::raster
