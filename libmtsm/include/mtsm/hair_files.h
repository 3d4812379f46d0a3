// hair_files.h - strands of hair and fur from files, as casters.
//
//     mtsm::HairFileOptions options;
//     options.width = 0.0004f;
//     mtsm::HairFile fur("fox.hair", options);
//     auto baked = mtsm::bake(fur, bakeOptions);                  // mtsm/bake.h
//
// Read are Cem Yuksel's .hair, AMD's TressFX .tfx (versions 3 and 4: the strands that are
// in the file, not the follow hairs that a simulation would add) and the polylines of
// OBJ files. Binary files are read piece by piece at every visit, so one of 10^8 points
// takes no more memory than a small one; of an OBJ file the vertices and polylines are
// kept. Different sources may be used from different threads at once.
#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "mtsm/result.h"
#include "mtsm/scene.h"

namespace mtsm {

struct HairFileOptions {
    /// Full width across a strand, in units of the scaled positions, >= 0; replaces the
    /// file's. Without it: the thickness in a .hair or .tfx file, taken as the full width
    /// and scaled like positions; else 1/2000 of the diagonal of the box around all
    /// strands, which is about right for a head of hair, with a warning that says how
    /// much that is.
    std::optional<float> width;
    /// Width at a strand's last point: from `width` at the first it changes evenly from
    /// point to point. Needs `width`.
    std::optional<float> tipWidth;
    /// In [0, 1]; replaces the file's. Without it: 1 - transparency of a .hair file,
    /// else 1.
    std::optional<float> opacity;
    float scale = 1.0f;  ///< of positions and of the file's widths, > 0
    /// Called with one line each for what was ignored or looks wrong, at the first visit;
    /// from the visiting thread.
    std::function<void(const std::string&)> warn;
    /// Called with the path before each reading; returning false cancels.
    std::function<bool(const std::string&)> progress;
};

/// The strands of one file, in its order, in views of at most 65536 strands, the same at
/// every visit. Points come first to last, that is root to tip in all files we know.
/// Strands with a point that is not finite are left out, with one warning.
///
/// In OBJ files, lines of two points that follow one another and share an end are joined
/// into one strand if nothing else meets there.
///
/// visit() fails with badArgument (an option is out of its range), io (no such file, or
/// it changed between visits), badFile (it is cut off, counts do not agree, a width is
/// negative, a strand has one point, ...), unsupported (another version), cancelled, or
/// with what the visitor returns. A fault that sits in the middle of a file is found when
/// the strands before it have been handed out.
class HairFile final : public CasterSource {
  public:
    explicit HairFile(std::string path, HairFileOptions options = {});
    ~HairFile() override;
    Status visit(const CasterVisitor& visitor) override;

    HairFile(const HairFile&) = delete;
    HairFile& operator=(const HairFile&) = delete;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// True if the name ends in .hair or .tfx, in whatever case.
[[nodiscard]] bool isHairFile(const std::string& path);

struct ObjContent {
    bool polylines = false, faces = false;
};
/// What an OBJ file holds: polylines are for HairFile, faces for MeshFiles. Looks at the
/// file until it has found both. Errors: io; badFile (it is empty).
Result<ObjContent> objContent(const std::string& path);

}  // namespace mtsm
