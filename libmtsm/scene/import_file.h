// import_file.h - the parent's side of an import: one file, one child, checked frames.
#pragma once
#include <functional>
#include <string>

#include "mtsm/result.h"
#include "mtsm/scene.h"
#include "scene/frames.h"

namespace mtsm::scene {

/// What to do with what a file holds. Absent ones are not called.
struct ImportSink {
    std::function<Status(PlacedMesh&&)> mesh;       ///< an Error stops the import
    std::function<Status(PlacedVolume&&)> volume;   ///< the same
    std::function<Status(OpacityImage&&)> texture;  ///< in order; an Error stops as well
    std::function<void(FileLight&&)> light;
    std::function<void(std::string)> name;
    std::function<void(std::string)> warning;
};

/// Says (as an Error) what keeps `path` from being read at all: it is not there, not
/// readable, not a regular file, empty.
Status checkReadable(const std::string& path);

/// Runs `send` in a child that may map importerBytes, and hands over what it says. Errors
/// name `path`: what the child reports, what the sink returns, badFile if the child
/// crashes or talks nonsense, tooLarge if it needs more memory, cancelled if SIGINT or
/// SIGTERM ends it, io if it gets killed otherwise.
Status importFile(const std::string& path, std::uint64_t importerBytes,
                  const std::function<void(FrameWriter&)>& send, const ImportSink& sink);

}  // namespace mtsm::scene
