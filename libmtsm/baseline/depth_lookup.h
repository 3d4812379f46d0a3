// depth_lookup.h - what a shadow map says of a point without tracing: what lies in front
// of the point's depth in one pixel [Williams78], for maps of one layer, of several, and
// of layers that let light through, as deep shadow maps are looked up [Lokovic00].
//
//     const DepthLookup lookup(map);
//     const LookupReceiver at(point, normal);
//     float v = lookup.visibility(at, lookup.placeOf(point));
//
// The receiver's own surface. With a normal, layers count that lie above the receiver's
// tangent plane at their pixel, as for traced rays (shadow/query.h). Without, they count
// if they lie in front of the point by more than the slope bias: five times the map's own
// (for media, which have no bias, one pixel footprint). Where an opaque map has a second
// layer, half of the way to it is enough, but at least the map's own bias: dual depth
// layers [Weiskopf03], which lose less of the shadow at contact; that is what several
// layers do for filtered lookups in [Bavoil06], too. For "is anything in front" further
// layers change nothing: if any is in front, the first one is.
#pragma once
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "mtsm/map.h"
#include "shadow/query.h"
#include "trace/traverse.h"

namespace mtsm::baseline {

struct LookupReceiver {
    /// `normal`: unit; zero: none.
    LookupReceiver(glm::dvec3 at, glm::dvec3 normal)
        : point(at),
          hasNormal(normal != glm::dvec3(0.0)),
          plane{at, normal, shadow::kPlaneHeight} {}

    glm::dvec3 point;
    bool hasNormal;
    trace::ReceiverPlane plane;  // if hasNormal
};

/// A place on a map, and the depth that is compared there.
struct MapPlace {
    std::uint32_t face = 0;
    glm::dvec2 raster{-1.0};
    double z = 0.0;
};

/// Depths of what lies in front.
struct BlockerSum {
    double depths = 0.0, weight = 0.0;
};

class DepthLookup {
  public:
    explicit DepthLookup(const ShadowMap& map) noexcept;

    /// Where a point of the world lies; outside of the map if it is not in front of the
    /// eye.
    [[nodiscard]] MapPlace placeOf(glm::dvec3 point) const noexcept;
    /// What the layers in front leave of the light, mean over the channels: 1 outside of
    /// the map.
    [[nodiscard]] float visibility(const LookupReceiver& receiver,
                                   const MapPlace& at) const noexcept;
    /// Adds the depths of what lies in front: of an opaque map of every layer, of others
    /// of every layer down to the first at which nothing is left, weighted by the
    /// visibility that it takes (several samples: by their mean depth).
    void addBlockers(const LookupReceiver& receiver, const MapPlace& at,
                     BlockerSum& sum) const noexcept;

    [[nodiscard]] const ShadowMap& map() const noexcept { return map_; }

  private:
    [[nodiscard]] bool pixelAt(const MapPlace& at, glm::uvec2& pixel) const noexcept;
    [[nodiscard]] trace::Span counted(const LookupReceiver& receiver, const MapPlace& at,
                                      glm::uvec2 pixel) const noexcept;
    [[nodiscard]] bool isInFront(const LookupReceiver& receiver, const PixelLayers& pixel,
                                 std::uint32_t layer, double z) const noexcept;
    [[nodiscard]] float deepVisibility(const LookupReceiver& receiver, const MapPlace& at,
                                       glm::uvec2 pixel) const noexcept;
    void addDeepBlockers(const LookupReceiver& receiver, const MapPlace& at,
                         glm::uvec2 pixel, BlockerSum& sum) const noexcept;

    const ShadowMap& map_;
    trace::ZBias bias_;
    bool opaque_, media_;
};

}  // namespace mtsm::baseline
