// unpredict.h - undoes the filter gradient, as fast as the machine allows.
//
// Where a pixel has few layers and a neighbour has as many, all of them are guessed at
// once, without a branch for each; the rest goes layer by layer. The result is that of
// forEachGuess<false> (predict.h), bit by bit.
#pragma once
#include <cstdint>
#include <span>

namespace mtsm::format {

/// Adds to the differences [layers] what is guessed of each layer; `begin` as in Tile,
/// with at least one layer. `to` [layers] gets the layers' bits.
void addGradient(std::span<const std::uint32_t> begin, std::uint32_t width,
                 const std::uint32_t* differences, float* to);

}  // namespace mtsm::format
