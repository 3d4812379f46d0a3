// baked.h - bakes that must succeed, under one lamp.
#pragma once
#include <catch2/catch.hpp>
#include <utility>
#include <vector>

#include "mtsm/bake.h"

namespace mtsm::test {

/// A disk of radius .3 straight above the origin.
inline BakeOptions diskAbove(std::uint32_t side) {
    BakeOptions o;
    o.light.shape = LightShape::disk;
    o.light.position = {0, 4, 0};
    o.light.radius = 0.3;
    o.width = o.height = side;
    return o;
}

inline Baked mustBake(CasterSource& casters, const BakeOptions& options) {
    auto baked = bake(casters, options);
    if (!baked) FAIL(baked.error().message);
    return *std::move(baked);
}
inline Baked mustBake(std::vector<CasterView> views, const BakeOptions& options) {
    CasterViews casters(std::move(views));
    return mustBake(casters, options);
}

}  // namespace mtsm::test
