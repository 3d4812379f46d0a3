// scene.h - what a comparison looks at: casters, receivers, lights and a picture of them.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "baseline/method.h"
#include "baseline/picture.h"
#include "baseline/reference_embree.h"
#include "common/job.h"
#include "common/placement.h"
#include "common/talk.h"
#include "mtsm/caster_files.h"

namespace mtsm::tools {

/// The camera as the options give it; missing parts frame the casters.
struct CameraOptions {
    std::optional<glm::dvec3> position, target, up;
    std::optional<double> fovDegrees;
    std::string image = "600x300";
    std::int64_t points = 1;  ///< per pixel: 1, 4, 9, 16, ...
    std::int64_t pixels = 0;  ///< that are compared, spread over the picture; 0: all
    std::string positionPass, normalPass;
};

/// What of the scene's content the tables tell.
struct SceneCounts {
    std::uint64_t triangles = 0, segments = 0, voxels = 0;
};

/// A light of the comparison: the scene's, made larger or smaller.
struct ComparedLight {
    AreaLight light;
    double scale = 1.0;
};

class CompareScene {
  public:
    /// Reads the casters, takes the picture. Throws Failures and UsageErrors.
    CompareScene(const std::vector<CasterFile>& casters,
                 const std::vector<JobReceiver>& receivers,
                 const PlacementOptions& placement, const CameraOptions& camera,
                 const std::vector<double>& lightScales, Talk& talk);

    /// The pixels that are compared.
    [[nodiscard]] const baseline::Picture& picture() const { return picture_; }
    /// Of the whole picture: those that see something.
    [[nodiscard]] std::size_t allPixels() const { return allPixels_; }
    [[nodiscard]] std::size_t allPoints() const { return allPoints_; }
    [[nodiscard]] std::size_t allObjectPixels() const { return allObjectPixels_; }
    [[nodiscard]] const std::vector<ComparedLight>& lights() const { return lights_; }
    [[nodiscard]] const SceneCounts& counts() const { return counts_; }
    /// Of all that the truth depends on but its light and its number of samples.
    [[nodiscard]] std::uint64_t content() const { return content_; }
    /// The geometry itself, for the truth; until dropReference().
    [[nodiscard]] const baseline::EmbreeReference& reference() const {
        return *reference_;
    }
    void dropReference() { reference_.reset(); }
    /// What a method is built for under one of the lights.
    [[nodiscard]] baseline::MethodScene methodScene(std::size_t light) const;

  private:
    void readCasters(const std::vector<CasterFile>& files, Talk& talk);
    void placeReceivers(const std::vector<JobReceiver>& receivers, Talk& talk);
    void takePicture(const CameraOptions& camera, Talk& talk);
    [[nodiscard]] baseline::Camera cameraOf(const CameraOptions& camera) const;

    std::unique_ptr<CasterFiles> casters_;
    BakeOptions bake_;
    std::vector<ComparedLight> lights_;
    std::unique_ptr<baseline::EmbreeReference> reference_, receivers_;
    std::vector<baseline::PlanarReceiver> planes_;
    baseline::Picture picture_;
    std::size_t allPixels_ = 0, allPoints_ = 0, allObjectPixels_ = 0;
    SceneCounts counts_;
    std::uint64_t content_ = 0;
};

}  // namespace mtsm::tools
