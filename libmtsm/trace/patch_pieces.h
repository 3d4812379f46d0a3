// patch_pieces.h - from the samples of a tile to connected pieces of surface.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "trace/patch_nodes.h"

namespace mtsm::trace::patch_detail {

/// Pieces of surface in one tile of 16 x 16 pixels.
class TilePieces {
  public:
    TilePieces(const ShadowMap& map, std::uint32_t face, Footprint footprint,
               float flatness);

    /// Appends those of tile (x, y).
    void run(std::uint32_t x, std::uint32_t y, Nodes& made, Parts& parts);
    /// Of the last tile.
    [[nodiscard]] std::size_t samples() const { return w_.size(); }

  private:
    struct Sample {
        std::uint8_t x, y;  // within the tile
        float w;
    };
    struct Square {
        int x, y, size;
    };
    struct Corner {
        std::uint32_t x = 0, y = 0;
    };
    static constexpr std::uint32_t kNone = 0xffffffffu;
    /// Samples that are connected: the piece that the first of a pixel is in, and of the
    /// last one that was seen the pixel and the piece.
    struct Connected {
        std::uint32_t first = kNone, pixel = kNone, piece = kNone;
    };

    /// Samples by pixel, and how far from each its neighbours may be.
    void gather();
    /// From this pixel to the end of the row, or of the map's tile; how many pixels.
    std::uint32_t gatherRow(std::uint32_t column, std::uint32_t row);
    std::uint32_t root(std::uint32_t i);
    /// Joins the samples of two neighbouring pixels, each to the nearest one of the other
    /// pixel that is not yet taken. Both lists run from near to far: w falls.
    void join(std::uint32_t p, std::uint32_t q);
    /// Labels the samples; those whose labels have one root are connected.
    void connect();
    /// Orders the samples by piece. A piece has one sample of a pixel: of those that are
    /// connected all the same, the second makes another piece, and so on.
    void separate();
    /// A patch of these samples; if it is not flat, its quarters, or its bumps.
    Node emit(std::span<const Sample> samples, Square square, Slope likely, Parts& parts);
    /// Patches of the quarters of a square; how many.
    std::size_t divide(std::span<const Sample> samples, Square square, Slope likely,
                       std::array<Node, 4>& quarters, Parts& parts);
    static void addBits(std::span<const Sample> samples, std::uint16_t* rows);
    void addCover(std::span<const Sample> samples, Node& node, Parts& parts) const;
    void addBumps(std::span<const Sample> samples, Square square, Node& node,
                  Parts& parts) const;
    /// To the nearest, halves away from 0. (std::lround is a call.)
    static std::int16_t roundSteps(double steps);
    /// One per pixel, in one tile.
    [[nodiscard]] Moments momentsOf(std::span<const Sample> samples) const;
    [[nodiscard]] Node flatNode(std::span<const Sample> samples, Slope likely) const;

    const ShadowMap& map_;
    std::uint32_t face_;
    Footprint footprint_;
    float flatness_;
    bool perspective_;
    Corner corner_;                          // pixels
    std::array<double, kTexels> u_{}, v_{};  // centres of pixels
    // Of samples, by pixel: depth, how far neighbours may be from it, what connects it
    // and then the piece.
    std::vector<float> w_, reach_;
    std::vector<std::uint32_t> label_;
    std::array<std::uint32_t, 257> begin_{};
    std::vector<std::uint32_t> parent_;  // of labels
    std::vector<Connected> last_;        // of roots
    // Of pieces: the one of further samples of its pixels, its samples.
    std::vector<std::uint32_t> further_, pieceBegin_, next_;
    std::vector<Sample> ordered_;
};

}  // namespace mtsm::trace::patch_detail
