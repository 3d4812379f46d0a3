// find_image.h - where the image is that a model file names.
#pragma once
#include <string>

namespace mtsm::scene {

/// The first of these that is a regular file, else nothing: `name` as it is, seen from
/// the model's folder; the same with / for \, with %20 and its like decoded, and without
/// file://; then its last part in the model's folder, in `textures` there, and in
/// `textures` and `materials/textures` beside it.
[[nodiscard]] std::string findImage(const std::string& modelPath,
                                    const std::string& name);

}  // namespace mtsm::scene
