// measureCasters(): what there is, before a bake's settings are chosen.
#include <variant>

#include "bake/face.h"
#include "bake/visits.h"
#include "mtsm/bake.h"

namespace mtsm {

Result<CasterMeasures> measureCasters(CasterSource& casters) {
    CasterMeasures found;
    const BakeOptions none;
    const bake_detail::Progress progress(none);
    bake_detail::Visits visits(casters, progress);
    const Status status = visits.each([&](const CasterView& caster) -> Status {
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
    return found;
}

}  // namespace mtsm
