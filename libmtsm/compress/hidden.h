// hidden.h - layers that no point of the light can see are dropped.
#pragma once
#include <cstdint>

#include "mtsm/map.h"

namespace mtsm::compress {

struct Hidden {
    std::uint64_t layers = 0, samples = 0;  ///< dropped
};

/// Drops from the back of each pixel what is hidden from the whole light of `info`, if
/// the map has this one face. A layer is hidden if every ray that meets it, on its way to
/// any point of the light, meets an opaque layer that stays: the answers for rays to that
/// light (with the map's own z threshold) do not change, wherever they start.
///
/// The proof that is looked for: let W be the first opaque layer of a pixel. Over a
/// window of pixels that no such ray leaves before it is nearer than the least W in it,
/// every pixel has a W, in front of the layer, and W changes by no more than twice the z
/// threshold from a pixel to the eight around it. A ray begins behind W and ends in front
/// of it; where it changes sides between two pixels, it passes within the threshold of W
/// in one of the two [trace/traverse.h], and is blocked. Where no such window of up to
/// 256 pixels across is found the layer stays.
///
/// Two answers may still change, both by what lies at the edge of a threshold: receivers
/// whose tangent plane leaves the wall out but not the layer; and, if the threshold grows
/// with depth, rays that are cut at the depth of the furthest layer.
///
/// Uses width, height, tileSize, channels, light and bias of `info`. `face` has to be
/// valid (map.h). Linear in pixels and layers; takes 7 bytes a pixel. The result is the
/// same for any number of threads.
Hidden dropHidden(const MapInfo& info, MapFace& face);

}  // namespace mtsm::compress
