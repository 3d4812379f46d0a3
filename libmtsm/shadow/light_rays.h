// light_rays.h - the rays of up to 16 receivers to a light, as a bundle.
//
// A receiver takes N points that follow each other in a scrambled (0, 2)-sequence
// (base/sampling.h), one of a few such patterns: a hash of its place says which, or its
// pixel does (shadow/pixel_share.h). So what it sees of the light does not depend on its
// neighbours. All patterns together are well spread, too, so that large areas of
// penumbra are right in the mean. The points of a pattern are in an order in which
// sixteen that follow each other lie close together: those are the groups of the bundle.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <vector>

#include "light/sample.h"
#include "mtsm/map.h"
#include "shadow/pixel_share.h"
#include "shadow/sample_error.h"
#include "trace/bundle.h"

namespace mtsm::shadow {

/// Up to 16 receivers, in the light space of a face; beyond `count` copies of the first.
struct ReceiverLanes {
    using Lanes = float[trace::kMostReceivers];
    int count = 0;
    alignas(64) Lanes x, y, z;              // position; z > 0 if perspective
    alignas(64) Lanes baseX, baseY, baseZ;  // LightView: base and axes
    alignas(64) Lanes axisXX, axisXY, axisXZ;
    alignas(64) Lanes axisYX, axisYY, axisYZ;
    alignas(64) Lanes axisZX, axisZY, axisZZ;
    alignas(64) Lanes capHeight;
    alignas(64) Lanes normalX, normalY, normalZ;  // any length; zero: none
    // Without normals: how far from it surfaces begin to count, and media; world units.
    alignas(64) Lanes surfaceStart, mediaStart;
    std::uint32_t key[trace::kMostReceivers];
    std::uint32_t pattern[trace::kMostReceivers];  // below LightRays::patterns()
};

/// What becomes of the rays of a bundle.
struct RayFates {
    /// [row], one bit a lane: cannot meet anything, and so are not open in the bundle.
    std::uint16_t clear[trace::kMostRows];
    /// [row][lane]: with a near field, whose part a ray is up to here; the layers' part
    /// begins there.
    alignas(64) float nearEnd[trace::kMostRows][trace::kLanes];
    alignas(64) float layersBegin[trace::kMostRows][trace::kLanes];
    /// [row][lane]: what a ray counts for, if weights were asked for.
    alignas(64) float weight[trace::kMostRows][trace::kLanes];
    /// [axis][row][lane], [row][lane]: if asked for, a ray's way to the light in light
    /// space, and how much of that way it is followed.
    alignas(64) float delta[3][trace::kMostMediaRows][trace::kLanes];
    alignas(64) float way[trace::kMostMediaRows][trace::kLanes];
};

class LightRays {
  public:
    /// `samples` points on the light. `normals`: the receivers' tangent planes count, and
    /// what does not lie `height` pixel footprints above them does not. `weights`: fill
    /// RayFates::weight with cosines (needs normals). `nearDepth`: the near field answers
    /// for so many pixel footprints of depth; above 0, RayBundle::begin is where its part
    /// begins, `nearHeight` footprints above the plane, or at the start times
    /// `nearStart`. `nearWidth`: if above 0, it answers for as much less, down to
    /// `nearLeast`, as the light, seen from there through the receiver, is as many pixels
    /// wide; and of rays without bounds (RayBundle::wide) for that in an opaque map, for
    /// nothing in others. `pointsPerPixel`: ShadowOptions'. `onlyPattern`: all receivers
    /// have this one.
    struct Setting {
        std::uint32_t samples = 1;
        std::uint32_t seed = 0;
        bool isPoint = false;  ///< the light: nothing but its middle matters
        bool normals = false, weights = false;
        /// Each of them is a sample of all of the light, in groups of its own.
        SampleSteps steps;
        /// A map that is not opaque: RayBundle::beginSurfaces matters; of sheets both are
        /// as far from the receiver.
        bool media = false, sheets = false;
        /// One of several faces: what lies on the border of its window counts as inside.
        bool joined = false;
        bool ways = false;  ///< fill RayFates::delta and way
        double height = 0.0;
        double nearDepth = 0.0, nearHeight = 0.0, nearStart = 1.0;
        double nearWidth = 0.0, nearLeast = 0.0;
        std::uint32_t pointsPerPixel = 1;
        Neighbours neighbours = Neighbours::own;
        std::optional<std::uint32_t> onlyPattern;
    };
    /// `depths`: of all that there is to meet, biases included. `alike`: rays of the same
    /// light and setting, but for the face and normals; their points are shared.
    LightRays(const Projection& projection, std::uint32_t width, std::uint32_t height,
              ZRange depths, const light::LightSampler& light, const Setting& setting,
              const LightRays* alike = nullptr);

    /// The depth of a face in front of which there is nothing, if that holds for layers
    /// in front of depths.min.
    [[nodiscard]] static double nearestOf(const Projection& projection,
                                          ZRange depths) noexcept;

    /// How many there are for points that have so many samples: a multiple of
    /// pointsPerPixel, the patterns of a pixel following each other.
    [[nodiscard]] static std::uint32_t patterns(std::uint32_t samples,
                                                std::uint32_t pointsPerPixel) noexcept;
    /// Of all rays of a receiver.
    [[nodiscard]] int groups() const noexcept { return groups_; }
    /// The rays of `groups` groups, all of one step, from number `first` on. Those below
    /// a receiver's horizon are neither open nor clear.
    void fill(const ReceiverLanes& receivers, int first, int groups,
              trace::RayBundle& bundle, RayFates& fates) const noexcept;

    /// Points on the light, all sequences, [pattern][16 groups]: of LightView's square or
    /// disk.
    struct Points {
        bool onlyOne = false;  ///< whatever a receiver's number says
        std::uint32_t each = 0;
        std::vector<float> a, b;
    };
    /// The face, in float.
    struct View {
        bool perspective;
        float scaleU, scaleV, offsetU, offsetV;
        float nearest, farthest;       // depths beyond which there is nothing
        float width, height;           // pixels
        float highest;                 // w of nearest
        float border;                  // of a joined face: half as wide as it is, pixels
        float planeHeight;             // in RayBundle's measure
        bool near;                     // is there a near field?
        float nearHeight, nearStart;   // see Setting
        float nearPerW, nearConstant;  // its depth, in w
        float nearWidth, nearLeast;    // ... or this share of it at least; see Setting
    };

  private:
    std::shared_ptr<const Points> points_;
    int groups_ = 0;
    View view_;
    light::LightView::Domain domain_;
    bool endless_ = false;
    glm::vec3 shines_{0.0f};  // light space
    Setting setting_;
};

}  // namespace mtsm::shadow
