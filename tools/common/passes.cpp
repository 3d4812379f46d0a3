#include "common/passes.h"

#include <algorithm>

#include "common/tool.h"
#include "mtsm/describe.h"

namespace mtsm::tools {

std::string layerText(const std::string& layer) {
    return layer.empty() ? "the one unnamed layer" : "layer \"" + printable(layer) + "\"";
}

namespace {

/// Of R, G, B under no known name.
void warnIfGuessed(Talk& talk, const Pass& pass, const std::string& path,
                   const std::string& noun) {
    if (pass.guessed)
        talk.warn(path + ": " + layerText(pass.layer) + " is read as " + noun +
                  " though its name does not say so, only R, G, B: if it is a picture, "
                  "give the file or the layer of the " +
                  noun);
}

}  // namespace

void warnOfPositions(Talk& talk, const Pass& positions, const std::string& path) {
    warnIfGuessed(talk, positions, path, "positions");
    if (positions.half)
        talk.warn(path + ": " + layerText(positions.layer) +
                  " has half floats, which are off by up to a two-thousandth of each "
                  "coordinate: shadows at contacts will be wrong; write positions as "
                  "32-bit floats");
}

void checkSurfaces(Talk& talk, const Pass& positions, const std::string& path,
                   const char* wayOut) {
    const std::size_t pixels = positions.pixels(), left = pixels - positions.hidden;
    const auto there = std::size_t(
        std::count(positions.surface.begin(), positions.surface.end(), std::uint8_t(1)));
    if (left == 0)
        return talk.warn(path + ": alpha is 0 in all " + countText(pixels) +
                         " pixels: no pixel has a surface, and all are lit");
    const std::string text = path + ": " + layerText(positions.layer) + ": " +
                             countText(left - there) + " of " + countText(left) +
                             " pixels" +
                             (positions.hidden ? " where alpha is above 0" : "") +
                             " have no position (NaN or infinite)";
    if (there == 0) throw Failure{{ErrorCode::badFile, text + "; " + wayOut}};
    // Background that alpha does not know of is usual; most of what it shows is not.
    if (positions.hidden > 0 && 2 * there < left)
        talk.warn(text + " and are lit; " + wayOut);
}

void warnOfNormals(Talk& talk, const Pass& normals, const std::string& path) {
    warnIfGuessed(talk, normals, path, "normals");
}

}  // namespace mtsm::tools
