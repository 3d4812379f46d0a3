// hair_reader.h - what a format of hair files has to say, piece by piece.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mtsm/hair_files.h"
#include "mtsm/result.h"
#include "scene/byte_file.h"

namespace mtsm::scene {

/// Bounds of one piece: a strand has at most kMostPoints, and a piece of less than
/// kChunkPoints may take one strand more.
inline constexpr std::size_t kChunkStrands = 65536;
inline constexpr std::size_t kChunkPoints = std::size_t(1) << 20;
inline constexpr std::size_t kMostPoints = 65536;

/// Some strands, in the file's units.
struct HairChunk {
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> begin;  ///< [strands + 1]
    std::vector<float> widths;         ///< [points], or none
    std::vector<float> transparency;   ///< [points], or none

    [[nodiscard]] std::size_t strands() const noexcept { return begin.size() - 1; }
};

/// Which of a file's arrays are of use: the others need not be read.
struct HairWanted {
    bool widths = true, transparency = true;
};

class HairReader {
  public:
    virtual ~HairReader() = default;
    /// Fills `chunk` with the next strands; false when there are no more.
    virtual Result<bool> next(HairChunk& chunk) = 0;

    /// Of all strands, where there is no array of it; as the file has it, unchecked.
    std::optional<float> width;
    float transparency = 0.0f;
};

using HairReaderResult = Result<std::unique_ptr<HairReader>>;

/// Cem Yuksel's .hair. Counts are checked against one another and the file's length.
HairReaderResult openYukselHair(const ByteFile& file, HairWanted wanted);
/// TressFX 3 and 4.
HairReaderResult openTfx(const ByteFile& file, HairWanted wanted);

/// The polylines of an OBJ file.
struct ObjCurves {
    std::vector<glm::vec3> vertices;
    std::vector<std::uint32_t> corners;  ///< indices of vertices, strand by strand
    std::vector<std::uint64_t> begin;    ///< [strands + 1], into corners
};
Result<ObjCurves> readObjCurves(const ByteFile& file);
std::unique_ptr<HairReader> openObjCurves(const ObjCurves& curves);

}  // namespace mtsm::scene
