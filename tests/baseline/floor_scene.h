// floor_scene.h - the simplest casters and light over a floor, for closed forms.
#pragma once
#include "bumpy_mesh.h"
#include "mtsm/light.h"

namespace mtsm::test {

/// A quad in the plane y = height, with x and z in the given ranges.
inline Mesh quad(float x0, float x1, float z0, float z1, float height) {
    Mesh mesh;
    mesh.positions = {
        {x0, height, z0}, {x1, height, z0}, {x1, height, z1}, {x0, height, z1}};
    mesh.indices = {0, 1, 2, 0, 2, 3};
    return mesh;
}

/// Over the origin, shining down.
inline AreaLight diskAbove(double height, double radius) {
    AreaLight light;
    light.shape = LightShape::disk;
    light.position = {0, height, 0};
    light.direction = {0, -1, 0};
    light.radius = radius;
    return light;
}

}  // namespace mtsm::test
