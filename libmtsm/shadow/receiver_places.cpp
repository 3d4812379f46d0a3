#include "shadow/receiver_places.h"

#include <algorithm>
#include <cmath>
#include <glm/matrix.hpp>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "shadow/receiver_places.cpp"
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace mtsm::shadow::HWY_NAMESPACE {

/// Spreads the lowest 10 bits, two zeros between each.
HWY_INLINE std::uint32_t spread(std::uint32_t x) {
    x = (x | x << 16) & 0x030000ffu;
    x = (x | x << 8) & 0x0300f00fu;
    x = (x | x << 4) & 0x030c30c3u;
    return (x | x << 2) & 0x09249249u;
}

/// Loops that compilers turn into vectors; they hold no branches.
void findPlaces(const ReceiverPlaces::View& view, const glm::dvec3* points, int count,
                std::uint32_t* places) {
    constexpr int kAtOnce = ReceiverPlaces::kAtOnce;
    constexpr float kFarthestOutside = 8.0f;  // windows
    alignas(64) double p[3][kAtOnce], q[3][kAtOnce];
    alignas(64) double facing[kAtOnce];
    alignas(64) std::int32_t fine[kAtOnce];
    alignas(64) std::uint32_t found[kAtOnce];
    for (int i = 0; i < kAtOnce; ++i) {
        const glm::dvec3& point = points[std::min(i, count - 1)];
        for (int axis = 0; axis < 3; ++axis)
            p[axis][i] = point[axis];
    }
    for (int i = 0; i < kAtOnce; ++i) {
        // As LightSampler::isBehind.
        facing[i] = (p[0][i] - view.centre[0]) * view.shines[0] +
                    (p[1][i] - view.centre[1]) * view.shines[1] +
                    (p[2][i] - view.centre[2]) * view.shines[2];
    }
    for (int axis = 0; axis < 3; ++axis) {
        for (int i = 0; i < kAtOnce; ++i) {
            q[axis][i] = (p[0][i] - view.eye[0]) * view.turn[axis][0] +
                         (p[1][i] - view.eye[1]) * view.turn[axis][1] +
                         (p[2][i] - view.eye[2]) * view.turn[axis][2];
        }
    }
    const double oneSided = view.oneSided ? 0.0 : -HUGE_VAL;
    for (int i = 0; i < kAtOnce; ++i) {
        // Comparisons that NaN does not pass.
        const double size = std::abs(q[0][i]) + std::abs(q[1][i]) + std::abs(q[2][i]);
        fine[i] = int(size <= view.farthest) & int(q[2][i] > view.nearest) &
                  int(facing[i] > oneSided);
        found[i] = 0;
    }
    for (int axis = 0; axis < 3; ++axis) {
        for (int i = 0; i < kAtOnce; ++i) {
            const float z = float(q[2][i]);
            const float perDepth = view.perspective ? 1.0f / z : 1.0f;
            const float at = axis < 2 ? float(q[axis][i]) * perDepth
                                      : (view.perspective ? perDepth : z);
            const float place = at * view.scale[axis] + view.offset[axis];
            fine[i] &= int(axis == 2 || std::abs(place) <= kFarthestOutside);
            // Finest in the middle, and nothing is too far away.
            const float near = place / (1.0f + std::abs(place));
            const float cell = std::min(std::max(512.0f + 512.0f * near, 0.0f), 1023.0f);
            found[i] |= spread(std::uint32_t(std::int32_t(cell))) << axis;
        }
    }
    for (int i = 0; i < count; ++i)
        places[i] = fine[i] ? found[i] : ReceiverPlaces::kNone;
}

}  // namespace mtsm::shadow::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mtsm::shadow {

HWY_EXPORT(findPlaces);

ReceiverPlaces::ReceiverPlaces(const ShadowMap& map, std::uint32_t face, ZRange range,
                               const light::LightSampler& light) {
    const Projection& p = map.projection(face);
    view_.perspective = p.kind == ProjectionKind::perspective;
    const glm::dvec3 axes[3] = {p.right, p.up, p.forward};
    const glm::dvec3 shines = light.shines();
    view_.oneSided = shines != glm::dvec3(0.0);
    const glm::dvec3 centre = view_.oneSided ? light.centre() : glm::dvec3(0.0);
    for (int k = 0; k < 3; ++k) {
        for (int axis = 0; axis < 3; ++axis)
            view_.turn[axis][k] = axes[axis][k];
        view_.eye[k] = p.eye[k];
        view_.centre[k] = centre[k];
        view_.shines[k] = shines[k];
    }
    // In floats a ray is as exact as its start: to an eighth of a pixel where layers are.
    view_.farthest = 0x1p20 * p.pixelFootprint(range.min);
    view_.nearest = view_.perspective ? 0.5 * range.min : -HUGE_VAL;
    // In windows away from its middle; depth too.
    const double width = map.info().width, height = map.info().height;
    view_.scale[0] = float(p.scale.x / width);
    view_.scale[1] = float(p.scale.y / height);
    view_.offset[0] = float(p.offset.x / width - 0.5);
    view_.offset[1] = float(p.offset.y / height - 0.5);
    const double perDepth = 1.0 / (p.pixelFootprint(1.0) * std::max(width, height));
    view_.scale[2] = float(view_.perspective ? -range.max * perDepth : perDepth);
    view_.offset[2] = float(view_.perspective ? perDepth : -range.max * perDepth);
}

void ReceiverPlaces::find(const glm::dvec3* points, int count,
                          std::uint32_t* places) const noexcept {
    HWY_DYNAMIC_DISPATCH(findPlaces)(view_, points, count, places);
}

}  // namespace mtsm::shadow
#endif
