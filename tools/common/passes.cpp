#include "common/passes.h"

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

void warnOfNormals(Talk& talk, const Pass& normals, const std::string& path) {
    warnIfGuessed(talk, normals, path, "normals");
}

}  // namespace mtsm::tools
