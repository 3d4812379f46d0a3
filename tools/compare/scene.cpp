#include "compare/scene.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>

#include "baseline/content.h"
#include "common/arguments.h"
#include "common/casters.h"
#include "common/passes.h"
#include "common/tool.h"
#include "mtsm/passes.h"

namespace mtsm::tools {
namespace {

using baseline::Camera;
using baseline::EmbreeReference;
using baseline::PlanarReceiver;

/// The unit square in x and y, and where it stands.
class PlaneMesh {
  public:
    [[nodiscard]] MeshView view(const PlanarReceiver& plane) const {
        MeshView mesh;
        mesh.positions = positions_;
        mesh.vertexCount = 4;
        mesh.indices = indices_;
        mesh.triangleCount = 2;
        const glm::dvec3 n = glm::cross(plane.edgeX, plane.edgeY);
        mesh.worldFromObject =
            glm::dmat4(glm::dvec4(plane.edgeX, 0.0), glm::dvec4(plane.edgeY, 0.0),
                       glm::dvec4(n, 0.0), glm::dvec4(plane.corner, 1.0));
        return mesh;
    }

  private:
    glm::vec3 positions_[4] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    std::uint32_t indices_[6] = {0, 1, 2, 0, 2, 3};
};

/// Planes and mesh files, one after another.
class ReceiverSource final : public CasterSource {
  public:
    ReceiverSource(const std::vector<PlanarReceiver>& planes, CasterFiles* files)
        : planes_(planes), files_(files) {}
    Status visit(const CasterVisitor& visitor) override {
        for (const PlanarReceiver& plane : planes_)
            if (Status s = visitor(square_.view(plane)); !s) return s;
        return files_ ? files_->visit(visitor) : Status{};
    }

  private:
    PlaneMesh square_;
    const std::vector<PlanarReceiver>& planes_;
    CasterFiles* files_;
};

/// A square under the casters that looks up.
PlanarReceiver floorUnder(glm::dvec3 low, glm::dvec3 high, const JobReceiver& receiver) {
    const glm::dvec3 extent = high - low, centre = 0.5 * (low + high);
    const double size =
        receiver.size.value_or(3.0 * std::max({extent.x, extent.y, extent.z}));
    const double y = receiver.height.value_or(low.y);
    PlanarReceiver floor;
    floor.corner = {centre.x - 0.5 * size, y, centre.z + 0.5 * size};
    floor.edgeX = {size, 0, 0};
    floor.edgeY = {0, 0, -size};
    return floor;
}

AreaLight scaled(AreaLight light, double scale) {
    light.radius *= scale;
    light.size *= scale;
    light.angularDiameter *= scale;
    return light;
}

int sideOf(std::int64_t points) {
    const int side = int(std::lround(std::sqrt(double(points))));
    if (points < 1 || points > 1024 || std::int64_t(side) * side != points)
        throw UsageError("--points: found " + std::to_string(points) +
                         ", expected the square of a whole number up to 1024: 1, 4, 9, "
                         "16, ...");
    return side;
}

CasterFilesOptions filesOptions(Talk& talk) {
    CasterFilesOptions files;
    files.importerBytes = std::min(files.importerBytes, 2 * halfOfMemory());
    files.cacheBytes = halfOfMemory() / 2;
    files.warn = [&talk](const std::string& text) { talk.warn(text); };
    files.progress = [&talk](const std::string& path) {
        return talk.progress("reading " + path, -1.0);
    };
    return files;
}

void count(const CasterView& caster, SceneCounts& counts) {
    if (const auto* mesh = std::get_if<MeshView>(&caster))
        counts.triangles += mesh->triangleCount;
    if (const auto* strands = std::get_if<StrandsView>(&caster))
        for (std::size_t s = 0; s < strands->strandCount; ++s)
            counts.segments +=
                std::max(strands->begin[s + 1] - strands->begin[s], 1u) - 1;
    if (const auto* volume = std::get_if<VolumeView>(&caster))
        counts.voxels += volume->blockCount * VolumeView::kBlockVoxels;
}

}  // namespace

CompareScene::CompareScene(const std::vector<CasterFile>& casters,
                           const std::vector<JobReceiver>& receivers,
                           const PlacementOptions& placement, const CameraOptions& camera,
                           const std::vector<double>& lightScales, Talk& talk)
    : casters_(std::make_unique<CasterFiles>(casters, filesOptions(talk))) {
    applyPlacement(placement, casters, talk, bake_);
    if (bake_.near || bake_.far || bake_.cull != Cull::none)
        talk.warn(
            "near, far and cull leave casters out of maps alone: the truth and the "
            "methods that are no maps have all of them");
    bake_.maxBytes = halfOfMemory();
    for (const double scale : lightScales) {
        if (!(scale >= 0.0))
            throw UsageError("--light-scales: found " + numberText(scale) +
                             ", expected numbers of at least 0");
        lights_.push_back({scaled(bake_.light, scale), scale});
        if (Status good = checkLight(lights_.back().light); !good)
            throw UsageError("--light-scales: " + good.error().message);
    }
    readCasters(casters, talk);
    placeReceivers(receivers, talk);
    takePicture(camera, talk);
    allPixels_ = picture_.pixels();
    allPoints_ = picture_.points.size();
    allObjectPixels_ = std::size_t(
        std::count(picture_.object.begin(), picture_.object.end(), std::uint8_t(1)));
    if (camera.pixels > 0)
        picture_ = picture_.part(
            picture_.spread(std::size_t(camera.pixels), baseline::Picture::kRun));
    content_ = baseline::combined(unwrap(baseline::contentOf(*casters_)),
                                  baseline::contentOf(picture_.receivers()));
}

void CompareScene::readCasters(const std::vector<CasterFile>& files, Talk& talk) {
    unwrap(casters_->visit([&](const CasterView& caster) -> Status {
        count(caster, counts_);
        return {};
    }));
    talk.progress("building Embree's tree", -1.0);
    reference_ =
        std::make_unique<EmbreeReference>(unwrap(EmbreeReference::build(*casters_)));
    // A light that aims at nothing yet looks at the middle of the casters.
    const glm::dvec3 low = reference_->boundsMin(), high = reference_->boundsMax();
    if (!(low.x <= high.x))
        throw Failure{withEmptying({ErrorCode::badFile,
                                    "the casters hold nothing that casts: no triangle, "
                                    "strand or voxel of a finite place and an opacity "
                                    "above 0"},
                                   files)};
    if (bake_.light.shape == LightShape::sun || bake_.aimed) return;
    const glm::dvec3 target = bake_.target.value_or(0.5 * (low + high));
    for (ComparedLight& l : lights_) {
        const glm::dvec3 way = target - l.light.position;
        if (glm::length(way) > 0.0) l.light.direction = glm::normalize(way);
    }
    bake_.light.direction = lights_.front().light.direction;
    // A light in the very middle has nothing to look at, which baking says.
    if (target != bake_.light.position) bake_.target = target;
}

void CompareScene::placeReceivers(const std::vector<JobReceiver>& receivers, Talk& talk) {
    std::vector<CasterFile> files;
    for (const JobReceiver& receiver : receivers) {
        if (!receiver.file.empty()) {
            files.emplace_back();
            files.back().path = receiver.file;
        } else if (receiver.plane) {
            planes_.push_back(
                {receiver.plane->corner, receiver.plane->x, receiver.plane->y});
        } else {
            planes_.push_back(
                floorUnder(reference_->boundsMin(), reference_->boundsMax(), receiver));
        }
        if (receiver.file.empty() &&
            !(glm::length(glm::cross(planes_.back().edgeX, planes_.back().edgeY)) > 0.0))
            throw Failure{{ErrorCode::badFile, receiver.place +
                                                   ": this receiver has no area: its two "
                                                   "edges must not be parallel"}};
    }
    if (planes_.empty() && files.empty()) return;
    std::unique_ptr<CasterFiles> meshes;
    if (!files.empty()) meshes = std::make_unique<CasterFiles>(files, filesOptions(talk));
    ReceiverSource source(planes_, meshes.get());
    receivers_ =
        std::make_unique<EmbreeReference>(unwrap(EmbreeReference::build(source)));
}

Camera CompareScene::cameraOf(const CameraOptions& options) const {
    const glm::uvec2 size = parseResolution("--image", options.image, 16384);
    const glm::dvec3 low = reference_->boundsMin(), high = reference_->boundsMax();
    Camera camera = Camera::framing(low, high, size.x, size.y);
    if (options.position) {
        camera.position = *options.position;
        camera.target = options.target.value_or(0.5 * (low + high));
        camera.fov = glm::radians(options.fovDegrees.value_or(40.0));
    } else if (options.target || options.fovDegrees) {
        throw UsageError(
            "--camera-position is missing: a target or a field of view needs one; "
            "without "
            "any of them the camera frames the casters");
    }
    if (options.up) camera.up = *options.up;
    camera.pointsPerSide = sideOf(options.points);
    if (Status good = baseline::checkCamera(camera); !good)
        throw UsageError((options.position ? "--camera-position: " : "--camera-up: ") +
                         good.error().message);
    return camera;
}

void CompareScene::takePicture(const CameraOptions& options, Talk& talk) {
    if (!options.positionPass.empty()) {
        if (options.points != 1)
            throw UsageError("--points: a position pass has one point a pixel");
        const Pass positions = unwrap(readPositionPass(options.positionPass));
        warnOfPositions(talk, positions, options.positionPass);
        if (positions.hidden < positions.pixels())
            checkSurfaces(talk, positions, options.positionPass,
                          "give the file that has them");
        std::vector<glm::vec3> normals;
        if (!options.normalPass.empty()) {
            Pass pass = unwrap(readNormalPass(options.normalPass, positions));
            warnOfNormals(talk, pass, options.normalPass);
            normals = std::move(pass.values);
        }
        picture_ = baseline::pictureOfPass(positions.data.width, positions.data.height,
                                           positions.values, positions.surface, normals);
        if (picture_.pixels() == 0)
            throw Failure{{ErrorCode::badFile, options.positionPass +
                                                   ": no pixel of the position pass has "
                                                   "a surface: alpha is 0 everywhere"}};
        return;
    }
    if (!options.normalPass.empty())
        throw UsageError("--normal-pass: needs a position pass beside it");
    const Camera camera = cameraOf(options);
    picture_ = baseline::takePicture(
        camera, *reference_, receivers_.get(),
        [&](double done) { (void)talk.progress("taking the picture", done); });
    if (picture_.pixels() > 0) return;
    if (!options.position)
        throw UsageError("--image: " + options.image +
                         " pixels that frame the casters, and none of them shows one: "
                         "they are too thin for it; take more pixels");
    throw UsageError(
        "--camera-position: the camera at " + tripleText(camera.position) +
        " that looks at " + tripleText(camera.target) +
        " sees nothing: no caster and no receiver; the casters lie between " +
        tripleText(reference_->boundsMin()) + " and " +
        tripleText(reference_->boundsMax()));
}

baseline::MethodScene CompareScene::methodScene(std::size_t light) const {
    baseline::MethodScene scene{*casters_, bake_, planes_};
    scene.bake.light = lights_[light].light;
    return scene;
}

}  // namespace mtsm::tools
