#include "scene/assimp_scene.h"

#include <assimp/config.h>
#include <assimp/importerdesc.h>

#include <assimp/DefaultLogger.hpp>
#include <cstring>
#include <filesystem>
#include <string_view>

#include "base/message.h"

namespace mtsm::scene {
namespace {

/// Keeps what an importer says while it reads one file.
class ImportLog final : public Assimp::Logger {
  public:
    ImportLog() : Logger(NORMAL) {}
    bool attachStream(Assimp::LogStream*, unsigned) override { return false; }
    bool detachStream(Assimp::LogStream*, unsigned) override { return false; }

    std::string firstError;
    std::size_t errors = 0;
    bool facesDropped = false;

  protected:
    void OnDebug(const char*) override {}
    void OnVerboseDebug(const char*) override {}
    void OnInfo(const char*) override {}
    void OnWarn(const char* message) override { noticeRange(message); }
    void OnError(const char* message) override {
        // Said of every OBJ file that chooses a material before it names an object.
        if (std::strstr(message, "No object detected to attach")) return;
        noticeRange(message);
        if (errors++ == 0) firstError = message;
    }

  private:
    /// The glTF and OFF importers leave such faces out and say no more than this.
    void noticeRange(const char* message) {
        if (std::strstr(message, "out-of-range indices") ||
            std::strstr(message, "index is out of range"))
            facesDropped = true;
    }
};

}  // namespace

AssimpScene::AssimpScene(const std::string& path, FrameWriter& out) {
    auto* log = new ImportLog;  // the logger owns it
    Assimp::DefaultLogger::set(log);
    importer_.SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
    importer_.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, true);
    const aiScene* scene = importer_.ReadFile(path, 0);
    if (!scene) {
        std::string_view reason = importer_.GetErrorString();
        while (reason.ends_with('.') || reason.ends_with('\n'))
            reason.remove_suffix(1);
        if (reason.starts_with("No suitable reader found")) {
            const std::string extension =
                std::filesystem::path(path).extension().string();
            const bool known = importer_.IsExtensionSupported(extension);
            out.failure(
                known ? ErrorCode::badFile : ErrorCode::unsupported,
                base::concat(
                    path,
                    known ? ": does not hold what its name says: no reader knows its "
                            "content; "
                          : ": is no mesh file of a kind that can be read; ",
                    "meshes are PLY, OBJ, glTF, GLB, FBX, COLLADA, STL and what else "
                    "Assimp reads, hair is .hair or .tfx, fog volumes are "
                    "OpenVDB's .vdb: convert it to one of those"));
            return;
        }
        const bool old = reason.find("unsupported") != std::string_view::npos;
        out.failure(
            old ? ErrorCode::unsupported : ErrorCode::badFile,
            base::concat(path, ": ",
                         reason.starts_with("std::")
                             ? "a size that the file states is impossible; repair it"
                             : base::concat("the importer says: ", reason,
                                            "; re-export or repair the file")));
        return;
    }
    if (log->facesDropped) {
        out.failure(ErrorCode::badFile,
                    base::concat(path,
                                 ": a face refers to a vertex that its mesh does not "
                                 "have; re-export or repair the file"));
        return;
    }
    if (log->errors > 0)
        out.warning(base::concat(
            path, ": the importer reports ", log->errors,
            log->errors == 1 ? " problem: " : " problems, first: ", log->firstError));
    scene_ = scene;
}

SourceFormat AssimpScene::format() const {
    const int index = importer_.GetPropertyInteger("importerIndex", -1);
    if (index < 0) return SourceFormat::other;
    const aiImporterDesc* importer = importer_.GetImporterInfo(std::size_t(index));
    const std::string_view name = importer && importer->mName ? importer->mName : "";
    if (name.find("Collada") != name.npos) return SourceFormat::collada;
    if (name.find("glTF") != name.npos) return SourceFormat::gltf;
    if (name.find("Wavefront") != name.npos) return SourceFormat::obj;
    return SourceFormat::other;
}

glm::dmat4 toDouble(const aiMatrix4x4& m) {
    // Rows there, columns here; the last row of an affine matrix is known.
    return {{m.a1, m.b1, m.c1, 0.0},
            {m.a2, m.b2, m.c2, 0.0},
            {m.a3, m.b3, m.c3, 0.0},
            {m.a4, m.b4, m.c4, 1.0}};
}

}  // namespace mtsm::scene
