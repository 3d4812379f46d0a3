// points.h - points and rays from CSV files, and results into them.
//
//     auto list = mtsm::readPoints("points.csv");               // or "-": standard input
//     if (!list) return complain(list.error());
//     mtsm::shadowFactors(map, light, list->points.data(), ...);
//
// The first line that is neither blank nor a comment (#) names the columns, in any order
// and case; columns that are not asked for are ignored. Fields are separated by commas
// and may be quoted; lines end in LF or CRLF. Numbers are decimal; "nan" and "inf" are
// numbers too: such a point or ray has a defined answer (shadow.h). Errors: io, badFile
// (the message names file:line:column, what was found and what was expected), tooLarge.
#pragma once
#include <cstddef>
#include <glm/vec3.hpp>
#include <string>
#include <variant>
#include <vector>

#include "mtsm/result.h"
#include "mtsm/shadow.h"

namespace mtsm {

struct PointList {
    std::vector<glm::dvec3> points;   ///< columns x, y, z
    std::vector<glm::dvec3> normals;  ///< columns nx, ny, nz; empty if the file has none
};

Result<PointList> readPoints(const std::string& path);

/// Columns ox, oy, oz and dx, dy, dz: the direction may have any length and is normalised
/// here (no length: it stays, and the ray is clear). Column tmax, if there: the ray's
/// length in world units along the unit direction; "inf", empty or no column: without
/// end. `directions`: where they go as the file has them.
Result<std::vector<ShadowRay>> readRays(const std::string& path,
                                        std::vector<glm::dvec3>* directions = nullptr);

/// One column to be written: values[0], values[stride], values[2 * stride], ...
struct CsvColumn {
    std::string name;
    std::variant<const float*, const double*> values;
    std::size_t stride = 1;
};

/// `rows` lines below a line of names. Numbers are the shortest decimals that read back
/// to the same bits. `path` "-" is standard output; a file appears complete or not at
/// all.
Status writeCsv(const std::string& path, const std::vector<CsvColumn>& columns,
                std::size_t rows);

}  // namespace mtsm
