// Lights of files: kind, place, direction, cone.
#include <catch2/catch.hpp>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <string>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;
using test::contains;

namespace {

std::vector<FileLight> lightsOf(const std::string& path) {
    auto lights = readLights(path);
    if (!lights) FAIL(lights.error().message);
    return *std::move(lights);
}

bool near(glm::dvec3 a, glm::dvec3 b) {
    return glm::length(a - b) < 1e-6;
}

// A quarter turn about x: y becomes z, and -z becomes y.
const char* const kQuarterTurn =
    R"("rotation":[0.70710678118654752,0,0,0.70710678118654752])";

std::string lightNode(const std::string& name, int light, const std::string& more = "") {
    return "{" + (name.empty() ? "" : R"("name":")" + name + "\",") +
           R"("extensions":{"KHR_lights_punctual":{"light":)" + std::to_string(light) +
           "}}" + more + "}";
}

}  // namespace

TEST_CASE("glTF lights stand where their nodes put them", "[scene][exact]") {
    const test::TempFolder folder;
    // No mesh: lights alone make a file worth reading.
    const std::string file = test::gltf(
        R"("nodes":[{"name":"rig","translation":[10,0,0],"scale":[2,2,2],"children":[1,2,3]},)" +
        lightNode("key", 0, std::string(",\"translation\":[1,2,3],") + kQuarterTurn) +
        "," + lightNode("sun", 1, std::string(",") + kQuarterTurn) + "," +
        lightNode("bulb", 2, R"(,"translation":[0,1,0])") +
        R"(],"extensionsUsed":["KHR_lights_punctual"],"extensions":{"KHR_lights_punctual":
            {"lights":[{"type":"spot","spot":{"innerConeAngle":0.2,"outerConeAngle":0.5}},
            {"type":"directional"},{"type":"point"}]}},)");
    const auto lights = lightsOf(folder.write("a.gltf", file));
    REQUIRE(lights.size() == 3);

    CHECK(lights[0].name == "key");
    CHECK(lights[0].light.shape == LightShape::point);
    CHECK(near(lights[0].light.position, {12, 4, 6}));
    CHECK(near(lights[0].light.direction, {0, 1, 0}));  // -z, turned by 90 about x
    REQUIRE(lights[0].fov);
    CHECK(*lights[0].fov == Approx(1.0));  // twice the half angle

    CHECK(lights[1].name == "sun");
    CHECK(lights[1].light.shape == LightShape::sun);
    CHECK(near(lights[1].light.direction, {0, 1, 0}));
    CHECK(!lights[1].fov);

    CHECK(lights[2].name == "bulb");
    CHECK(lights[2].light.shape == LightShape::point);
    CHECK(near(lights[2].light.position, {10, 2, 0}));
    CHECK(!lights[2].fov);
}

TEST_CASE("COLLADA lights follow axes and units, ambient ones are left out",
          "[scene][exact]") {
    const test::TempFolder folder;
    const auto light = [](const std::string& id, const std::string& kind,
                          const std::string& more = "") {
        return "<light id=\"" + id + "\"><technique_common><" + kind +
               "><color>1 1 1</color>" + more + "</" + kind +
               "></technique_common></light>";
    };
    const auto node = [](const std::string& id, const std::string& name,
                         const std::string& of) {
        return "<node id=\"" + id + "\" name=\"" + name +
               "\"><translate>1 2 3</translate><instance_light url=\"#" + of +
               "\"/></node>";
    };
    const std::string file = test::collada(
        "",
        node("n1", "Haze", "amb") + node("n2", "Cone", "spot") +
            node("n3", "Day", "dir") + node("n4", "Lamp", "point"),
        light("amb", "ambient") + light("dir", "directional") + light("point", "point") +
            light("spot", "spot",
                  "<falloff_angle>60</falloff_angle>"
                  "<falloff_exponent>0.15</falloff_exponent>"),
        "<unit meter=\"0.5\"/><up_axis>Z_UP</up_axis>");
    const auto lights = lightsOf(folder.write("a.dae", file));
    REQUIRE(lights.size() == 3);
    CHECK(lights[0].name == "Cone");
    // (x, y, z) with z up is (x, z, -y) with y up; half a metre per unit.
    CHECK(near(lights[0].light.position, {0.5, 1.5, -1.0}));
    CHECK(near(lights[0].light.direction, {0, -1, 0}));
    REQUIRE(lights[0].fov);
    CHECK(*lights[0].fov == Approx(glm::pi<double>() / 3));
    CHECK(lights[1].name == "Day");
    CHECK(lights[1].light.shape == LightShape::sun);
    CHECK(near(lights[1].light.direction, {0, -1, 0}));
    CHECK(lights[2].name == "Lamp");
    CHECK(lights[2].light.shape == LightShape::point);
}

TEST_CASE("lights of one name each find their own node", "[scene][exact]") {
    const test::TempFolder folder;
    const std::string file = test::gltf(
        R"("nodes":[)" + lightNode("lamp", 0, R"(,"translation":[1,0,0])") + "," +
            lightNode("lamp", 1, R"(,"translation":[2,0,0])") +
            R"(],"extensionsUsed":["KHR_lights_punctual"],"extensions":{"KHR_lights_punctual":
            {"lights":[{"type":"point"},{"type":"point"}]}},)",
        "0,1");
    const auto lights = lightsOf(folder.write("a.gltf", file));
    REQUIRE(lights.size() == 2);
    CHECK(near(lights[0].light.position, {1, 0, 0}));
    CHECK(near(lights[1].light.position, {2, 0, 0}));
}

TEST_CASE("a file without lights has none, and a bad one is an error",
          "[scene][bad-input]") {
    const test::TempFolder folder;
    CHECK(
        lightsOf(folder.write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")).empty());
    const auto missing = readLights(folder.path("none.gltf"));
    REQUIRE(!missing);
    CHECK(missing.error().code == ErrorCode::io);
    const auto garbage = readLights(folder.write("bad.gltf", "{\"asset\":"));
    REQUIRE(!garbage);
    CHECK(garbage.error().code == ErrorCode::badFile);
}

TEST_CASE("reading lights can be cancelled", "[scene]") {
    const test::TempFolder folder;
    MeshFileOptions options;
    options.progress = [](const std::string&) { return false; };
    const auto lights = readLights(folder.write("a.obj", "v 0 0 0\n"), options);
    REQUIRE(!lights);
    CHECK(lights.error().code == ErrorCode::cancelled);
}
