#include <utility>

#include "base/message.h"
#include "mtsm/scene.h"
#include "scene/import_file.h"
#include "scene/send.h"

namespace mtsm {

Result<std::vector<FileLight>> readLights(const std::string& path,
                                          const MeshFileOptions& options) {
    if (options.progress && !options.progress(path))
        return base::makeError(ErrorCode::cancelled, path, ": reading was cancelled");
    std::vector<FileLight> lights;
    scene::ImportSink sink;
    sink.light = [&](FileLight&& light) { lights.push_back(std::move(light)); };
    sink.warning = options.warn;
    const Status done = scene::importFile(
        path, options.importerBytes,
        [&](scene::FrameWriter& out) { scene::sendLights(path, out); }, sink);
    if (!done) return done.error();
    return lights;
}

}  // namespace mtsm
