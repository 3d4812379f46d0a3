// passes.h - a renderer's position and normal passes, from OpenEXR files.
//
//     auto positions = mtsm::readPositionPass("beauty.exr");
//     if (!positions) return complain(positions.error());
//     auto normals = mtsm::readNormalPass("beauty.exr", *positions);
//
// A pass is three half or float channels of one layer. Any flat EXR will do: scanlines or
// tiles, one part or many, any compression, a data window anywhere. Layers are recognised
// by the last word of their name, whatever its case:
//     position  P, Position, worldPosition, world_position, Pworld, worldP, WP
//     normal    N, Normal, Normals, worldNormal, world_normal, Nworld, worldN, WN
// so that "P.X", "Position.R", "RenderLayer.Position.x" and a part named "P" with
// channels R, G, B all count. Not recognised, because they are of another space, are
// layers and parts whose name has one of these words (split at punctuation and capitals):
// camera, cam, view (but not "ViewLayer"), object, obj, local, tangent, ref, pref, rest,
// light, screen, ndc. They can be taken by name. A layer's channels
// are X, Y, Z or R, G, B, in either case. A file that holds nothing but R, G, B (or X, Y,
// Z) and perhaps A is taken for the pass itself.
//
// Reading is safe on untrusted files: sizes are proved against the file's length and
// against PassOptions before memory is spent on them. Errors: io; badFile (damaged, or no
// EXR); unsupported (deep pixels, subsampled channels); badArgument (no layer or several
// match: the message lists what there is); tooLarge.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "mtsm/image.h"
#include "mtsm/result.h"

namespace mtsm {

struct PassOptions {
    /// The layer to take: its whole name ("RenderLayer.Position", "part:layer" if several
    /// parts have it), or as much of its end as makes it unique ("Position"). Empty: the
    /// one that is recognised.
    std::string layer;
    std::uint64_t maxPixels = std::uint64_t(1) << 28;  ///< of the data window
};

struct Pass {
    PixelWindow data;     ///< values cover this, row-major
    PixelWindow display;  ///< the frame that the data window is part of
    /// The layer that was read, as the file has it: "" for bare channels, "part:layer" in
    /// a file of many parts.
    std::string layer;
    /// Taken though nothing but its being alone in the file speaks for it: R, G, B under
    /// no known name, which may as well be a picture.
    bool guessed = false;
    bool half = false;  ///< some of its channels are half floats: three digits
    std::vector<glm::vec3> values;  ///< [data.height][data.width], as the file has them
    /// [data.height][data.width]: 1 where there is a surface, 0 where there is none. None
    /// is where a component is not finite, or where alpha is 0, negative or not a number:
    /// the layer's own alpha, or else the alpha of the picture it belongs to (A, RGBA.A
    /// or Combined.A beside it).
    std::vector<std::uint8_t> surface;
    /// Pixels without one by their alpha; the others of them have values that are not
    /// finite.
    std::size_t hidden = 0;

    [[nodiscard]] std::size_t pixels() const noexcept { return values.size(); }
};

/// World positions.
Result<Pass> readPositionPass(const std::string& path, const PassOptions& options = {});

/// World normals for the same pixels as `positions`: another size or place of the data
/// window is a badArgument error. Where there is no normal (not finite, or alpha 0) the
/// value is (0, 0, 0), which queries take for "no normal".
Result<Pass> readNormalPass(const std::string& path, const Pass& positions,
                            const PassOptions& options = {});

}  // namespace mtsm
