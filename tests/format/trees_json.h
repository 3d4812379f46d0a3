// trees_json.h - the trees of a map against those that the second reader found.
#pragma once
#include <array>
#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <vector>

#include "mtsm/map.h"
#include "trace/density_tree.h"
#include "trace/patch_tree.h"

namespace mtsm::test {

inline void checkTree(const nlohmann::json& j, const trace::PatchTree& tree) {
    const trace::PatchTree::Content& c = tree.content();
    CHECK(j["covers"] == c.covers);
    CHECK(j["lowest"] == double(c.lowest));
    CHECK(j["highest"] == double(c.highest));
    CHECK(j["pieceSize"] == double(c.pieceSize));
    std::vector<std::array<std::uint32_t, 3>> tiles;
    for (const auto& level : c.levels) {
        for (const trace::PatchList& t : level.tiles)
            tiles.push_back({t.group, std::uint32_t(t.groups), std::uint32_t(t.slots)});
    }
    CHECK(j["tiles"] == tiles);
    const auto column = [&](const char* name, const auto field) {
        nlohmann::json numbers = nlohmann::json::array();
        for (const trace::PatchGroup& g : c.groups) {
            for (std::size_t i = 0; i < 4; ++i) {
                const auto x = (g.*field)[i];
                numbers.push_back(x);
            }
        }
        INFO(name);
        CHECK(j[name] == numbers);
    };
    using G = trace::PatchGroup;
    column("w", &G::w), column("above", &G::above), column("below", &G::below);
    column("u0", &G::u0), column("v0", &G::v0), column("u1", &G::u1);
    column("v1", &G::v1), column("residual", &G::residual);
    column("gradientU", &G::gradientU), column("gradientV", &G::gradientV);
    column("children", &G::children), column("cover", &G::cover);
    column("childGroups", &G::childGroups), column("kind", &G::kind);
}

inline void checkPyramid(const nlohmann::json& j, const trace::DensityPyramid& pyramid) {
    REQUIRE(j.is_null() == pyramid.empty());
    if (pyramid.empty()) return;
    CHECK(j["low"] == double(pyramid.low));
    CHECK(j["high"] == double(pyramid.high));
    std::size_t i = 0;
    for (const trace::DensityLevel& level : pyramid.levels) {
        if (level.texels.empty()) continue;
        const nlohmann::json& l = j["levels"][i++];
        CHECK(l["base"] == double(level.base));
        CHECK(l["step"] == double(level.step));
        std::vector<std::uint32_t> range, begin, slabs = level.slabs;
        for (std::size_t t = 0; t < level.texelCount(); ++t) {
            range.push_back(level.texels[t].range);
            begin.push_back(level.texels[t].begin);
        }
        slabs.resize(level.texels.back().begin);
        CHECK(l["range"] == range);
        CHECK(l["begin"] == begin);
        CHECK(l["slabs"] == slabs);
    }
    CHECK(j["levels"].size() == i);
}

/// `j`: what the reader calls "trees".
inline void checkTrees(const nlohmann::json& j, const ShadowMap& map) {
    REQUIRE(j.size() == map.faceCount());
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        if (map.isOpaque()) {
            checkTree(j[face], (*trace::patchTrees(map))[face]);
            continue;
        }
        const trace::DensityTree& tree =
            (*trace::densityTrees(map, trace::DensityUse::receivers))[face];
        checkPyramid(j[face]["media"], tree.media());
        checkPyramid(j[face]["sheets"], tree.sheets());
    }
}

}  // namespace mtsm::test
