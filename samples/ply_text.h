// ply_text.h - a triangle mesh as the bytes of a binary PLY file.
#pragma once
#include <bit>
#include <cstdint>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

static_assert(std::endian::native == std::endian::little && sizeof(glm::vec3) == 12);

inline std::string plyOf(const std::string& comment,
                         const std::vector<glm::vec3>& positions,
                         const std::vector<std::uint32_t>& indices) {
    std::string text = "ply\nformat binary_little_endian 1.0\ncomment " + comment +
                       "\nelement vertex " + std::to_string(positions.size()) +
                       "\nproperty float x\nproperty float y\nproperty float z\n"
                       "element face " +
                       std::to_string(indices.size() / 3) +
                       "\nproperty list uchar uint vertex_indices\nend_header\n";
    text.append(reinterpret_cast<const char*>(positions.data()),
                positions.size() * sizeof(glm::vec3));
    for (std::size_t i = 0; i < indices.size(); i += 3) {
        text += '\3';
        text.append(reinterpret_cast<const char*>(&indices[i]), 12);
    }
    return text;
}
