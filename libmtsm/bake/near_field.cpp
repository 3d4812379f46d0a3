#include "bake/near_field.h"

#include <algorithm>

#include "bake/near_chunks.h"
#include "bake/near_sheets.h"
#include "bake/near_triangles.h"
#include "base/message.h"

namespace mtsm::bake_detail {
namespace {

constexpr std::uint64_t kTriangles = NearChunk::kTriangles;
constexpr std::uint64_t kMega = 1u << 20;

std::uint64_t leastBytes(std::uint64_t triangles) {
    return nearFieldBytes((triangles + kTriangles - 1) / kTriangles);
}

}  // namespace

std::string nearFieldTooSmall(std::uint64_t needed, const BakeOptions& options,
                              std::uint64_t budget) {
    const std::uint64_t size = (needed + kMega - 1) / kMega;
    if (budget < options.nearField)
        return base::concat("it takes about ", size, "M, more than a quarter of the ",
                            options.maxBytes, " bytes of --max-memory that layers leave");
    return base::concat("it takes about ", size, "M: --near-field ", size,
                        "M would hold it");
}

Status bakeNearField(Visits& visits, const BakeOptions& options, const CasterKinds& kinds,
                     std::uint64_t bytesLeft, std::vector<MapFace>& faces,
                     BakeReport& report) {
    if (options.nearField == 0) return {};
    if (kinds.media) {
        report.noNearField =
            "only casters that are all triangles have one, not hair and "
            "volumes";
        return {};
    }
    if (kinds.translucent)
        return bakeNearSheets(visits, options, bytesLeft, faces, report);
    const WorkClock clock(visits);
    const std::uint64_t budget = std::min(options.nearField, bytesLeft / 4);
    const std::uint64_t most = budget / sizeof(NearChunk) * kTriangles;
    std::uint64_t bytes = 0;
    for (MapFace& face : faces) {
        const std::uint64_t left = most - std::min(most, report.nearTriangles);
        const auto found = collectNear(visits, face.projection, options, left);
        if (!found) return found.error();
        report.nearTriangles += found->count;
        if (report.nearTriangles > most) continue;
        face.nearField = packNear(found->triangles, face.projection);
        bytes += nearFieldBytes(face.nearField.chunks.size());
    }
    // Beyond the budget chunks were not made: about one slot in 16 of them stays unused.
    const bool counted = report.nearTriangles > most;
    report.nearBytes =
        counted ? leastBytes(report.nearTriangles + report.nearTriangles / 16) : bytes;
    if (report.nearBytes > budget) {
        report.noNearField = nearFieldTooSmall(report.nearBytes, options, budget);
        for (MapFace& face : faces)
            face.nearField = {};
    }
    report.nearSeconds = clock.seconds();
    return {};
}

}  // namespace mtsm::bake_detail
