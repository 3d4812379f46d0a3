#include "common/passes.h"

#include "mtsm/describe.h"

namespace mtsm::tools {

std::string layerText(const std::string& layer) {
    return layer.empty() ? "the one unnamed layer" : "layer \"" + printable(layer) + "\"";
}

void warnOfPositions(Talk& talk, const Pass& positions, const std::string& path) {
    const std::string read = path + ": " + layerText(positions.layer);
    if (positions.guessed)
        talk.warn(read +
                  " is read as positions though its name does not say so, only R, G, B: "
                  "if it is a picture, give the file or the layer of the positions");
    if (positions.half)
        talk.warn(read +
                  " has half floats, which are off by up to a two-thousandth of each "
                  "coordinate: shadows at contacts will be wrong; write positions as "
                  "32-bit floats");
}

}  // namespace mtsm::tools
