// measureCasters(): what there is, before a bake's settings are chosen.
#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <variant>

#include "bake/face.h"
#include "bake/visits.h"
#include "mtsm/bake.h"

namespace mtsm {
namespace {

/// How wide strands are along all of their length, and the box around all casters but
/// volumes; world space.
class StrandWidths {
  public:
    void add(const MeshView& mesh) {
        for (std::size_t i = 0; i < mesh.vertexCount; ++i)
            include(glm::dvec3(mesh.worldFromObject *
                               glm::dvec4(glm::dvec3(mesh.positions[i]), 1.0)));
    }
    void add(const StrandsView& strands) {
        const glm::dmat4& m = strands.worldFromObject;
        const double grown = std::cbrt(std::abs(glm::determinant(glm::dmat3(m))));
        const auto at = [&](std::size_t i) {
            return glm::dvec3(m * glm::dvec4(glm::dvec3(strands.points[i]), 1.0));
        };
        const auto widthAt = [&](std::size_t i) {
            return strands.widths ? double(strands.widths[i]) : double(strands.width);
        };
        for (std::size_t s = 0; s < strands.strandCount; ++s) {
            for (std::size_t i = strands.begin[s] + 1; i < strands.begin[s + 1]; ++i) {
                const glm::dvec3 a = at(i - 1), b = at(i);
                const double length = glm::distance(a, b);
                if (!std::isfinite(length)) continue;
                include(a);
                include(b);
                length_ += length;
                area_ += length * grown * 0.5 * (widthAt(i - 1) + widthAt(i));
            }
        }
    }
    /// The mean width, of the box's longest side.
    [[nodiscard]] float mean() const {
        const glm::dvec3 sides = high_ - low_;
        const double size = length_ * std::max({sides.x, sides.y, sides.z});
        return size > 0.0 ? float(area_ / size) : 0.0f;
    }

  private:
    void include(glm::dvec3 p) {
        if (!std::isfinite(p.x + p.y + p.z)) return;
        low_ = glm::min(low_, p);
        high_ = glm::max(high_, p);
    }

    glm::dvec3 low_{HUGE_VAL}, high_{-HUGE_VAL};
    double length_ = 0.0, area_ = 0.0;
};

}  // namespace

Result<CasterMeasures> measureCasters(CasterSource& casters) {
    CasterMeasures found;
    StrandWidths widths;
    const BakeOptions none;
    const bake_detail::Progress progress(none);
    bake_detail::Visits visits(casters, progress);
    const Status status = visits.each([&](const CasterView& caster) -> Status {
        if (const auto* mesh = std::get_if<MeshView>(&caster)) {
            if (!mesh->texture && mesh->opacity == 0.0f) return {};
            found.triangles += mesh->triangleCount;
            found.letThrough = found.letThrough || !bake_detail::isSolid(*mesh);
            widths.add(*mesh);
        } else if (const auto* strands = std::get_if<StrandsView>(&caster)) {
            found.strands += strands->strandCount;
            widths.add(*strands);
        } else if (const auto* volume = std::get_if<VolumeView>(&caster)) {
            if (volume->blockCount > 0 && volume->extinction > 0.0f) ++found.volumes;
        }
        return {};
    });
    if (!status) return status.error();
    found.strandWidth = widths.mean();
    return found;
}

}  // namespace mtsm
