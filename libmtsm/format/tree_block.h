// tree_block.h - the trees that queries of a map go through <-> TREE.
//
// Whoever reads it need make none of them, nor read the layers that they are made of.
#pragma once
#include "format/header.h"
#include "mtsm/writer.h"

namespace mtsm::format {

/// Makes the trees if need be. In parallel; the bytes are the same for any number of
/// threads. Empty if the map has no trees: it does not fit them (trace/fits_trees.h), or
/// there is no memory for them.
[[nodiscard]] Bytes encodeTrees(const ShadowMap& map, Codec codec, int level);

/// Is it of the revision that this library makes and follows? If not it is passed over.
[[nodiscard]] bool hasKnownTrees(BytesView payload) noexcept;

/// Are they trees of a map that is opaque?
[[nodiscard]] bool areOfOpaque(BytesView payload) noexcept;

/// Gives the map its trees. No more than `most` bytes are taken for them and for the
/// work. Errors: badFile, tooLarge.
Status decodeTrees(BytesView payload, std::uint64_t most, const ShadowMap& map);

}  // namespace mtsm::format
