#include "baseline/opaque_casters.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec4.hpp>
#include <vector>

namespace mtsm::baseline {
namespace {

/// Ribbons are handed over so many segments at a time, so that a furry animal's do not
/// lie in memory all at once.
constexpr std::size_t kSegmentsAtOnce = std::size_t(1) << 16;

class Ribbons {
  public:
    Ribbons(const StrandsView& strands, Eye eye, const CasterVisitor& visitor)
        : strands_(strands),
          eye_(eye),
          visitor_(visitor),
          scale_(std::cbrt(
              std::abs(glm::determinant(glm::dmat3(strands.worldFromObject))))) {}

    Status visit() {
        for (std::size_t s = 0; s < strands_.strandCount; ++s) {
            add(strands_.begin[s], strands_.begin[s + 1]);
            if (indices_.size() < 6 * kSegmentsAtOnce) continue;
            if (Status sent = send(); !sent) return sent;
        }
        return send();
    }

  private:
    [[nodiscard]] glm::dvec3 world(std::uint32_t i) const {
        return glm::dvec3(strands_.worldFromObject *
                          glm::dvec4(glm::dvec3(strands_.points[i]), 1.0));
    }
    [[nodiscard]] bool casts(std::uint32_t i) const {
        return (strands_.opacities ? strands_.opacities[i] : strands_.opacity) > 0.0f;
    }
    /// Half the width at point i, across the strand and across the view.
    [[nodiscard]] glm::dvec3 side(std::uint32_t i, glm::dvec3 along) const {
        const glm::dvec3 view = eye_.endless ? eye_.at : eye_.at - world(i);
        const glm::dvec3 across = glm::cross(along, view);
        const double length = glm::length(across);
        if (!(length > 0.0)) return glm::dvec3(0.0);  // seen from its end
        const float width = strands_.widths ? strands_.widths[i] : strands_.width;
        return across * (0.5 * double(width) * scale_ / length);
    }
    /// The strand of points [begin, end).
    void add(std::uint32_t begin, std::uint32_t end) {
        if (end < begin + 2) return;
        if (positions_.empty()) origin_ = world(begin);
        for (std::uint32_t i = begin; i < end; ++i) {
            const glm::dvec3 along =
                world(std::min(i + 1, end - 1)) - world(i > begin ? i - 1 : begin);
            const glm::dvec3 at = world(i) - origin_, half = side(i, along);
            const auto v = std::uint32_t(positions_.size());
            positions_.emplace_back(at - half);
            positions_.emplace_back(at + half);
            if (i + 1 < end && (casts(i) || casts(i + 1)))
                indices_.insert(indices_.end(), {v, v + 1, v + 3, v, v + 3, v + 2});
        }
    }
    Status send() {
        MeshView mesh;
        mesh.positions = positions_.data();
        mesh.vertexCount = positions_.size();
        mesh.indices = indices_.data();
        mesh.triangleCount = indices_.size() / 3;
        mesh.worldFromObject[3] = glm::dvec4(origin_, 1.0);
        Status sent = mesh.triangleCount > 0 ? visitor_(mesh) : Status{};
        positions_.clear();
        indices_.clear();
        return sent;
    }

    const StrandsView& strands_;
    Eye eye_;
    const CasterVisitor& visitor_;
    double scale_;  // of widths
    glm::dvec3 origin_{0.0};
    std::vector<glm::vec3> positions_;  // relative to origin_; two for each point
    std::vector<std::uint32_t> indices_;
};

}  // namespace

Eye eyeOf(const BakeOptions& options) {
    if (options.light.shape == LightShape::sun) return {-options.light.direction, true};
    return {options.light.position, false};
}

Status OpaqueCasters::visit(const CasterVisitor& visitor) {
    return casters_.visit([&](const CasterView& caster) -> Status {
        if (const auto* strands = std::get_if<StrandsView>(&caster))
            return Ribbons(*strands, eye_, visitor).visit();
        const auto* given = std::get_if<MeshView>(&caster);
        if (!given) return {};
        MeshView mesh = *given;
        if (!mesh.texture) {
            mesh.opacity = mesh.opacity > 0.0f ? 1.0f : 0.0f;
            mesh.tint = glm::vec3(1.0f);
        }
        return visitor(mesh);
    });
}

}  // namespace mtsm::baseline
