#include "bake/near_field.h"

#include <algorithm>

#include "bake/near_chunks.h"
#include "bake/near_sheets.h"
#include "base/message.h"

namespace mtsm::bake_detail {
namespace {

constexpr std::uint64_t kOfChunk = NearChunk::kTriangles;
constexpr std::uint64_t kMega = 1u << 20;
/// A triangle, its place in the order, and its part of a chunk, twice for a moment.
constexpr std::uint64_t kWorkOfTriangle = sizeof(NearTriangle) + 16 + 2 * 20;

/// About, of as many triangles and segments: some chunks have room left.
std::uint64_t bytesOf(std::uint64_t triangles, std::uint64_t segments) {
    const auto chunks = [](std::uint64_t items) {
        return (items + items / 16 + kOfChunk - 1) / kOfChunk;
    };
    return nearFieldBytes(chunks(triangles), kMeshPoints) +
           nearHairBytes(chunks(segments));
}

}  // namespace

std::string nearFieldTooSmall(std::uint64_t needed, const BakeOptions& options,
                              std::uint64_t budget) {
    const std::uint64_t size = (needed + kMega - 1) / kMega;
    if (needed <= budget || budget < options.nearField)
        return base::concat("it takes about ", size, "M, and making it more than the ",
                            options.maxBytes, " bytes of --max-memory that layers leave");
    return base::concat("it takes about ", size, "M: --near-field ", size,
                        "M would hold it");
}

namespace {

/// All of a face.
struct Found {
    NearTriangles triangles;
    NearSegments segments;
    bool others = false;  ///< casters that a near field has no place for
};

/// Of triangles and of segments no more than what would fit if they were alone, and of
/// triangles no more than can be packed with so many bytes.
Result<Found> collect(Visits& visits, const Projection& projection,
                      const BakeOptions& options, std::uint64_t bytes,
                      std::uint64_t bytesLeft) {
    const std::uint64_t mostTriangles =
        std::min(bytes / NearChunks::memoryBytes(1, kFewestPoints) * kOfChunk,
                 bytesLeft / kWorkOfTriangle);
    const std::uint64_t mostSegments = bytes / NearHairChunks::kLeastBytes * kOfChunk;
    const glm::dvec2 window(options.width, options.height);
    Found found;
    const Status status = visits.each([&](const CasterView& caster) -> Status {
        if (auto s = visits.progress()("collecting the near field", -1.0); !s) return s;
        if (const auto* mesh = std::get_if<MeshView>(&caster)) {
            found.others = !isSolid(*mesh);
            if (!found.others && (mesh->opacity > 0.0f || mesh->texture))
                collectMesh(*mesh, projection, options, mostTriangles, found.triangles);
        } else if (const auto* strands = std::get_if<StrandsView>(&caster)) {
            collectStrands(*strands, projection, window, mostSegments, found.segments);
        } else {
            found.others = isThere(std::get<VolumeView>(caster));
        }
        if (found.others) return Error{ErrorCode::cancelled, "there is none"};
        return {};
    });
    if (!status && !found.others) return status.error();
    return found;
}

}  // namespace

Status bakeNearField(Visits& visits, const BakeOptions& options, const CasterKinds& kinds,
                     std::uint64_t bytesLeft, std::vector<MapFace>& faces,
                     BakeReport& report) {
    if (options.nearField == 0) return {};
    if (kinds.translucent && !kinds.media)
        return bakeNearSheets(visits, options, bytesLeft, faces, report);
    const WorkClock clock(visits);
    const std::uint64_t budget = std::min(options.nearField, bytesLeft / 4);
    bool others = false, counted = false;
    std::uint64_t bytes = 0;
    for (std::size_t i = 0; i < faces.size() && !others; ++i) {
        MapFace& face = faces[i];
        const std::uint64_t left = budget - std::min(budget, bytes);
        const auto found = collect(visits, face.projection, options, left,
                                   bytesLeft - std::min(bytesLeft, bytes));
        if (!found) return found.error();
        others = found->others;
        report.nearTriangles += found->triangles.count;
        report.nearSegments += found->segments.count;
        counted = counted || found->triangles.items.size() < found->triangles.count ||
                  found->segments.items.size() < found->segments.count;
        if (counted || others) continue;
        face.nearField = packNear(found->triangles.items, face.projection);
        face.nearHair = packNear(found->segments.items, face.projection);
        bytes += memoryBytes(face.nearField) + memoryBytes(face.nearHair);
    }
    if (others) {
        report.nearTriangles = report.nearSegments = 0;
        report.noNearField =
            "only casters that are all opaque triangles and strands, or all triangles, "
            "have one: no volumes, and no hair beside meshes that let light through";
    } else {
        report.nearBytes =
            counted ? bytesOf(report.nearTriangles, report.nearSegments) : bytes;
        if (counted || report.nearBytes > budget)
            report.noNearField = nearFieldTooSmall(report.nearBytes, options, budget);
    }
    if (!report.noNearField.empty()) {
        for (MapFace& face : faces) {
            face.nearField = {};
            face.nearHair = {};
        }
    }
    report.nearSeconds = clock.seconds();
    return {};
}

}  // namespace mtsm::bake_detail
