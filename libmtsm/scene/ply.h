// ply.h - what has to be known of a PLY file before an importer sees it.
//
// Assimp 5.2 fills up a truncated ASCII file with copies of the last line, and makes one
// triangle of a triangle strip. This walks through the file once, as Greg Turk's
// description of the format has it, proves that all declared elements are there, and
// takes strips apart.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

namespace mtsm::scene {

struct PlyScan {
    /// What is wrong with the file; empty if nothing is, and also if its header is none
    /// that this understands: the importer then has the word.
    std::string problem;
    bool hasStrips = false;  ///< it has a `tristrips` element: the rest is filled in
    std::vector<float> coordinates;             ///< x, y, z of one vertex after another
    std::vector<std::uint32_t> stripTriangles;  ///< three indices each, all in range
};

[[nodiscard]] PlyScan scanPly(const std::string& path);

}  // namespace mtsm::scene
