// light_rays.h - the rays of up to 16 receivers to the cells of a light, as a bundle.
//
// The light is cut into as many cells of equal area as there are samples; each receiver
// takes one point of each cell, at a place that a hash of the receiver's own key says. So
// the rays of a cell lie close together whatever the receivers are, and which points of
// the light a receiver sees does not depend on its neighbours.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "light/sample.h"
#include "mtsm/map.h"
#include "trace/bundle.h"

namespace mtsm::shadow {

/// Up to 16 receivers, in the light space of a face. All arrays are [lane]; lanes beyond
/// `count` hold copies of the first.
struct ReceiverLanes {
    using Lanes = float[trace::kLanes];
    int count = 0;
    alignas(64) Lanes x, y, z;              // position; z > 0 if perspective
    alignas(64) Lanes baseX, baseY, baseZ;  // LightView: base and axes
    alignas(64) Lanes axisXX, axisXY, axisXZ;
    alignas(64) Lanes axisYX, axisYY, axisYZ;
    alignas(64) Lanes axisZX, axisZY, axisZZ;
    alignas(64) Lanes capHeight;
    alignas(64) Lanes normalX, normalY, normalZ;  // unit; zero: none
    alignas(64) Lanes start;  // without normals: distance, world units
    std::uint32_t key[trace::kLanes];
};

/// What becomes of the rays of a bundle; [block], one bit a lane.
struct RayFates {
    std::uint16_t clear[trace::kMostBlocks];  ///< cannot meet anything: not in the bundle
    /// [block][lane]: with a near field, whose part a ray is up to here; the layers' part
    /// begins there.
    alignas(64) float nearEnd[trace::kMostBlocks][trace::kLanes];
    alignas(64) float layersBegin[trace::kMostBlocks][trace::kLanes];
    /// [block][lane]: what a ray counts for, if weights were asked for.
    alignas(64) float weight[trace::kMostBlocks][trace::kLanes];
};

class LightRays {
  public:
    /// `samples` points on the light. `normals`: the receivers' tangent planes count, and
    /// what does not lie `height` pixel footprints above them does not. `weights`: fill
    /// RayFates::weight with cosines (needs normals). `nearDepth`: the near field answers
    /// for so many pixel footprints of depth; above 0, RayBundle::begin is where its part
    /// begins, `nearHeight` footprints above the plane, or at the start divided by
    /// `nearStart`.
    struct Setting {
        std::uint32_t samples = 1;
        bool normals = false, weights = false;
        double height = 0.0;
        double nearDepth = 0.0, nearHeight = 0.0, nearStart = 1.0;
    };
    /// `depths`: of all layers of the face.
    LightRays(const Projection& projection, std::uint32_t width, std::uint32_t height,
              ZRange depths, const light::LightSampler& light, const Setting& setting);

    /// How the rays are put into bundles: every lane a receiver and every block a cell,
    /// or one receiver and sixteen cells to a block. The rays are the same.
    enum class Layout { receivers, cells };

    /// It takes so many bundles to hold all rays.
    [[nodiscard]] std::uint32_t bundles(Layout layout) const noexcept;
    /// The rays of bundle number `index`. Those below a receiver's horizon are neither
    /// open nor clear. Layout::cells: all lanes of `receivers` hold one receiver.
    void fill(const ReceiverLanes& receivers, Layout layout, std::uint32_t index,
              trace::RayBundle& bundle, RayFates& fates) const noexcept;

    /// The cells of the unit square; all [cells, rounded up to a multiple of 16].
    struct Cells {
        std::uint32_t count = 0;
        std::vector<float> u, v, width, height;
        std::vector<std::uint32_t> number;
        std::vector<std::uint8_t> threshold;  ///< part of RayBundle::threshold
    };
    /// The face, in float.
    struct View {
        bool perspective;
        float scaleU, scaleV, offsetU, offsetV;
        float nearest, farthest;       // depths beyond which there is nothing
        float width, height;           // pixels
        float highest;                 // w of nearest
        float planeHeight;             // in RayBundle's measure
        bool near;                     // is there a near field?
        float nearHeight, nearStart;   // see Setting
        float nearPerW, nearConstant;  // its depth, in w
    };

  private:
    Cells cells_;
    View view_;
    light::LightView::Domain domain_;
    bool endless_ = false;
    glm::vec3 shines_{0.0f};  // light space
    Setting setting_;
};

}  // namespace mtsm::shadow
