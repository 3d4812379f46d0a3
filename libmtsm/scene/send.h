// send.h - what an importing child does: reads a file and tells its parent what is in it.
#pragma once
#include <string>

#include "mtsm/scene.h"
#include "mtsm/volume_files.h"
#include "scene/frames.h"

namespace mtsm::scene {

/// Sends every mesh that passes include and exclude with all its places; if none does,
/// the names there are. Then the warnings, and the end. Fails (badFile) on a file that
/// Assimp refuses, that has no triangle, or in which a face refers to a vertex that is
/// not there.
void sendMeshes(const std::string& path, const MeshFileOptions& options,
                FrameWriter& out);

/// Sends every light but ambient ones, in the file's order, then the warnings and the
/// end.
void sendLights(const std::string& path, FrameWriter& out);

/// Sends the grid of fog that `options` ask for, then warnings and the end. Fails on a
/// file that OpenVDB refuses or that is cut off (badFile), one without such a grid
/// (badArgument, unsupported), or a grid with more blocks than importerBytes hold
/// (tooLarge).
void sendVolume(const std::string& path, const VolumeFileOptions& options,
                FrameWriter& out);

}  // namespace mtsm::scene
