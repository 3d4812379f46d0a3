// measureCasters(): what there is, before a bake's settings are chosen.
#include <algorithm>
#include <glm/vec3.hpp>
#include <limits>
#include <variant>

#include "bake/face.h"
#include "bake/measure.h"
#include "bake/visits.h"
#include "mtsm/bake.h"

namespace mtsm {
namespace {

using bake_detail::Extent;

/// Strands' mean width over the longest side of the box around all casters.
float widthOf(const Extent& casters) {
    const glm::dvec3 sides = casters.max - casters.min;
    const double size = casters.segmentLength * std::max({sides.x, sides.y, sides.z});
    return size > 0.0 ? float(casters.segmentArea / size) : 0.0f;
}

}  // namespace

Result<CasterMeasures> measureCasters(CasterSource& casters) {
    CasterMeasures found;
    Extent extent;
    const BakeOptions none;
    const bake_detail::Progress progress(none);
    bake_detail::Visits visits(casters, progress);
    const Projection world = bake_detail::worldFrame();
    constexpr double kAll = std::numeric_limits<double>::infinity();
    const Status status = visits.each([&](const CasterView& caster) -> Status {
        extent.addCaster(caster, world, -kAll, kAll);
        if (const auto* mesh = std::get_if<MeshView>(&caster)) {
            if (!mesh->texture && mesh->opacity == 0.0f) return {};
            found.triangles += mesh->triangleCount;
            found.letThrough = found.letThrough || !bake_detail::isSolid(*mesh);
        } else if (const auto* strands = std::get_if<StrandsView>(&caster)) {
            found.strands += strands->strandCount;
        } else if (const auto* volume = std::get_if<VolumeView>(&caster)) {
            if (volume->blockCount > 0 && volume->extinction > 0.0f) ++found.volumes;
        }
        return {};
    });
    if (!status) return status.error();
    found.strandWidth = widthOf(extent);
    return found;
}

}  // namespace mtsm
