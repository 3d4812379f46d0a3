// crossings.h - what a shadow ray pays at each caster it crosses: the filters of the
// ray-traced reference.
//
// Embree finds the hits; a filter takes the crossing's opacity from the ray and lets it
// go on, until so little is left that it counts as dark. Products do not depend on the
// order of hits, so the order in which Embree finds them is good enough.
#pragma once
#include <embree3/rtcore.h>

#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <optional>
#include <vector>

#include "baseline/shadow_rays.h"
#include "mtsm/opacity_texture.h"

namespace mtsm::baseline {

inline constexpr float kDark = 1e-4f;  ///< rays with less visibility left end

/// For rays whose ids are their places in the stream.
struct ShadowContext : RTCIntersectContext {
    /// Per ray and channel; without colour all three are the same.
    glm::vec3 visible[kStreamRays];
    float reach[kStreamRays];  ///< where rays end; Embree shortens its own to the hit
    /// Rays come from so far behind their true start: Embree drops hits on a strand that
    /// are nearer to a ray's origin than the strand is wide.
    float back = 0.0f;
    bool color = false;
    /// Per ray: the latest crossings on a border of a triangle that were paid for. The
    /// triangles on the other side of the border, or around the corner, meet the ray at
    /// the same place: it is crossed once.
    struct Border {
        const void* mesh = nullptr;
        float t = 0.0f;
    };
    static constexpr unsigned kBorders = 4;
    Border borders[kStreamRays][kBorders];
    unsigned borderCount[kStreamRays] = {};

    /// Makes the ray new.
    void begin(unsigned ray, float length) noexcept {
        visible[ray] = glm::vec3(1.0f);
        reach[ray] = length;
        borderCount[ray] = 0;
    }
    /// Was a crossing of this mesh's borders here paid for? If not, from now on it is.
    bool paidBorder(unsigned ray, const void* mesh, float t) noexcept;

    /// What is left to a ray after a crossing; false: nothing worth tracing on.
    bool pay(unsigned ray, glm::vec3 opacity) noexcept {
        glm::vec3& left = visible[ray];
        left *= 1.0f - opacity;
        return left.x > kDark || left.y > kDark || left.z > kDark;
    }
};

/// A mesh that lets light through. User data of its geometry.
struct TranslucentMesh {
    float opacity = 1.0f;
    glm::vec3 channels{1.0f};  ///< channelOpacity(opacity, tint)
    std::optional<OpacityTexture> texture;
    std::vector<glm::vec2> uvs;              ///< [vertices], with a texture
    const std::uint32_t* indices = nullptr;  ///< [3 * triangles], Embree's copy

    [[nodiscard]] glm::vec3 opacityAt(std::uint32_t triangle, glm::vec2 uv,
                                      bool color) const noexcept;
};

/// Strands as flat linear curves: ribbons that face the ray. User data of their geometry.
struct RibbonStrands {
    /// Relative to the scene's origin; w: half the width. No point of a strand repeats.
    std::vector<glm::vec4> points;
    /// [segments] and padding: a segment's first point. Consecutive segments of a strand
    /// have consecutive first points, those of different strands have not.
    std::vector<std::uint32_t> first;
    std::size_t segments = 0;
    std::vector<float> opacities;  ///< [points], or empty: all are `opacity`
    float opacity = 1.0f;

    [[nodiscard]] bool joinsLeft(std::size_t segment) const noexcept {
        return segment > 0 && first[segment - 1] + 1 == first[segment];
    }
    [[nodiscard]] bool joinsRight(std::size_t segment) const noexcept {
        return segment + 1 < segments && first[segment] + 1 == first[segment + 1];
    }
    [[nodiscard]] float opacityAt(std::size_t segment, float u) const noexcept;
};

/// Occlusion filters, for single rays, packets and streams: every crossing is
/// paid for, on a border between triangles of a mesh once. A strand that a ray meets in
/// several consecutive segments, as around a joint, is crossed once.
void payMesh(const RTCFilterFunctionNArguments* args);
void payStrands(const RTCFilterFunctionNArguments* args);
/// Intersection filters: the holes of a textured mesh are not there, nor what Embree puts
/// round the ends of strands.
void passHoles(const RTCFilterFunctionNArguments* args);
void passEnds(const RTCFilterFunctionNArguments* args);

}  // namespace mtsm::baseline
